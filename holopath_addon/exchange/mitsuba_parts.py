"""From Mitsuba's tree of a scene file to its scene, the same in every process.

Mitsuba joins meshes of one material, too. Which comes first then follows from where they happen to lie in memory: in
another process lights have other numbers, so that noise is another one, and programs are compiled anew. It joins all
there are, so that baked light has no charts, and refuses a material on meshes whose normals are flipped and not.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from ..engine.scene import variants
from ..engine.scene.meshes.joining import groups, joined_name

if TYPE_CHECKING:
    import mitsuba as mi

_COLLECTOR = "collected_parts"


def built(config: Any, state: Any) -> mi.Scene:
    """Build a scene with its parts in the file's order, and small meshes joined that nothing tells apart.

    Parameters
    ----------
    config : mitsuba.parser.ParserConfig
    state : mitsuba.parser.ParserState
        Of a scene, transformed; its root is replaced.

    Returns
    -------
    mitsuba.Scene
    """
    import mitsuba as mi

    parts = _joined(_parts(config, state))
    names = {part: part.id() for part in parts.values() if isinstance(part, mi.Object)}
    scene = variants.made({"type": "scene"} | parts)
    for part, name in names.items():  # which are now those of the dictionary's keys
        part.set_id(name)
    return scene


def _parts(config, state):
    """Properties of a scene's node, and its parts as objects, by their names."""
    import mitsuba as mi

    root = state.nodes[0]
    root.type = mi.ObjectType.Integrator
    root.props.set_plugin_name(_collector(variants.activate()))
    return mi.parser.instantiate(config, state).parts


@cache
def _collector(variant):
    """Register, in a variant of Mitsuba's, a plugin that holds whatever it is given; its name."""
    import mitsuba as mi

    class Collector(mi.SamplingIntegrator):
        def __init__(self, props):
            super().__init__(mi.Properties())
            self.parts = {name: props[name] for name in props.keys()}

    mi.register_integrator(_COLLECTOR, Collector)
    return _COLLECTOR


def _joined(parts):
    """Parts of a scene of which small meshes are joined, in place of the first of them."""
    import mitsuba as mi

    names = [name for name, part in parts.items() if isinstance(part, mi.Shape)]
    shapes = [parts[name] for name in names]
    bounds = np.array(
        [[np.array(box.min).ravel(), np.array(box.max).ravel()] for box in (s.bbox() for s in shapes)]
    )
    triangles = [shape.primitive_count() for shape in shapes]
    for numbers in groups([_kind(shape) for shape in shapes], triangles, bounds):
        members = [shapes[number] for number in numbers]
        name = joined_name([member.id() for member in members])
        mesh = variants.made({"type": "merge"} | {f"mesh_{n}": member for n, member in enumerate(members)})
        mesh.set_id(name)
        parts[names[numbers[0]]] = mesh
        for number in numbers[1:]:
            del parts[names[number]]
    return parts


def _kind(shape):
    """What meshes have in common that may be joined; None of what stays as it is."""
    plain = (
        shape.is_mesh()
        and not shape.has_mesh_attributes()
        and not (shape.is_emitter() or shape.is_sensor())
        and shape.interior_medium() is None
        and shape.exterior_medium() is None
    )
    flags = "has_vertex_normals", "has_vertex_texcoords", "has_face_normals", "has_flipped_normals"
    return (id(shape.bsdf()), *(getattr(shape, flag)() for flag in flags)) if plain else None
