"""Construction of scenes from Mitsuba's tree, the same in every process.

Mitsuba joins all meshes of one material, in an order that depends on the addresses of materials: in another process
emitters have other numbers, so that noise differs and programs are compiled again. Large joined meshes have no charts
for baked light, and Mitsuba rejects a material on meshes with flipped and unflipped normals.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import mitsuba as mi
import numpy as np

from .joining import groups, joined_name

_COLLECTOR = "collected_parts"


def configuration() -> Any:
    """Make a `mitsuba.parser.ParserConfig` for scenes: in one thread, see `variants.made`."""
    config = mi.parser.ParserConfig(mi.variant())
    config.parallel = config.merge_meshes = False
    return config


def scene_of(parts: dict) -> mi.Scene:
    """Build a scene from its parts, a dictionary of `mitsuba.load_dict`."""
    config = configuration()
    state = mi.parser.parse_dict(config, parts)
    mi.parser.transform_all(config, state)
    return built(config, state)


def built(config: Any, state: Any) -> mi.Scene:
    """Build a scene with its parts in their order, and join small meshes with the same properties.

    Parameters
    ----------
    config : mitsuba.parser.ParserConfig
        Result of `configuration`.
    state : mitsuba.parser.ParserState
        Transformed state of a scene; its root is replaced.

    Returns
    -------
    mitsuba.Scene
    """
    parts = _join(_parts(config, state))
    names = {part: part.id() for part in parts.values() if isinstance(part, mi.Object)}
    scene = mi.load_dict({"type": "scene"} | parts, parallel=False)
    for part, name in names.items():  # load_dict renamed them by the dictionary's keys
        part.set_id(name)
    return scene


def _parts(config, state):
    """Properties of a scene's node and its parts, as objects, by name."""
    root = state.nodes[0]
    root.type = mi.ObjectType.Integrator
    root.props.set_plugin_name(_collector(mi.variant()))
    collector: Any = mi.parser.instantiate(config, state)
    return collector.parts


@cache
def _collector(_variant):
    """Register a plugin that collects its properties, in the current variant of Mitsuba; return its name."""

    class Collector(mi.SamplingIntegrator):
        def __init__(self, props):
            super().__init__(mi.Properties())
            self.parts = {name: props[name] for name in props.keys()}

    mi.register_integrator(_COLLECTOR, Collector)
    return _COLLECTOR


def _join(parts):
    """Join small meshes among the parts of a scene, in place of the first of them."""
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
    """Properties that meshes must share to be joined; None for a shape that stays as it is."""
    plain = (
        shape.is_mesh()
        and not shape.has_mesh_attributes()
        and not (shape.is_emitter() or shape.is_sensor())
        and shape.interior_medium() is None
        and shape.exterior_medium() is None
    )
    flags = "has_vertex_normals", "has_vertex_texcoords", "has_face_normals", "has_flipped_normals"
    return (id(shape.bsdf()), *(getattr(shape, flag)() for flag in flags)) if plain else None
