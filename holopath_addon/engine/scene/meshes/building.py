"""From Mitsuba's tree of a scene to the scene, the same in every process.

Mitsuba joins all meshes of one material. Which of them come first then follows from where materials lie in memory: in
another process lights have other numbers, so that noise is another one, and programs are compiled anew. Large joined
meshes have no charts for baked light, and a material on meshes whose normals are flipped and not is refused.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import mitsuba as mi
import numpy as np

from .joining import groups, joined_name

_COLLECTOR = "collected_parts"


def configuration() -> Any:
    """How scenes are parsed, a `mitsuba.parser.ParserConfig`: in one thread, as `variants.made` does."""
    config = mi.parser.ParserConfig(mi.variant())
    config.parallel = config.merge_meshes = False
    return config


def scene_of(parts: dict) -> mi.Scene:
    """A scene, of what `mitsuba.load_dict` takes."""
    config = configuration()
    state = mi.parser.parse_dict(config, parts)
    mi.parser.transform_all(config, state)
    return built(config, state)


def built(config: Any, state: Any) -> mi.Scene:
    """Build a scene with its parts in their order, and small meshes joined that nothing tells apart.

    Parameters
    ----------
    config : mitsuba.parser.ParserConfig
        From `configuration`.
    state : mitsuba.parser.ParserState
        Of a scene, transformed; its root is replaced.

    Returns
    -------
    mitsuba.Scene
    """
    parts = _joined(_parts(config, state))
    names = {part: part.id() for part in parts.values() if isinstance(part, mi.Object)}
    scene = mi.load_dict({"type": "scene"} | parts, parallel=False)
    for part, name in names.items():  # which are now those of the dictionary's keys
        part.set_id(name)
    return scene


def _parts(config, state):
    """Properties of a scene's node, and its parts as objects, by their names."""
    root = state.nodes[0]
    root.type = mi.ObjectType.Integrator
    root.props.set_plugin_name(_collector(mi.variant()))
    collector: Any = mi.parser.instantiate(config, state)
    return collector.parts


@cache
def _collector(_variant):
    """Register, in the present variant of Mitsuba's, a plugin that holds whatever it is given; its name."""

    class Collector(mi.SamplingIntegrator):
        def __init__(self, props):
            super().__init__(mi.Properties())
            self.parts = {name: props[name] for name in props.keys()}

    mi.register_integrator(_COLLECTOR, Collector)
    return _COLLECTOR


def _joined(parts):
    """Parts of a scene of which small meshes are joined, in place of the first of them."""
    names = [name for name, part in parts.items() if isinstance(part, mi.Shape)]
    shapes = [parts[name] for name in names]
    boxes = [shape.bbox() for shape in shapes]
    bounds = np.array([[np.array(box.min).ravel(), np.array(box.max).ravel()] for box in boxes])
    triangles = [shape.primitive_count() for shape in shapes]
    for numbers in groups([_kind(shape) for shape in shapes], triangles, bounds):
        members = [shapes[number] for number in numbers]
        name = joined_name([member.id() for member in members])
        group = {f"mesh_{n}": member for n, member in enumerate(members)}
        mesh = mi.load_dict({"type": "merge"} | group, parallel=False)
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
