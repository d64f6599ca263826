"""Values that shader nodes read of an instance: its random number, its instancer, attributes of the view layer."""

import contextlib
from dataclasses import dataclass

import bpy

_NO_ID = 0x7FFFFFFF  # where Blender's persistent IDs have no further level


@dataclass(frozen=True)
class InstanceValues:
    """Values of an instance that nodes read, as in Cycles.

    Attributes
    ----------
    random : float
        Object Info > Random.
    generated, uv : tuple of 3 floats
        Texture Coordinate > From Instancer.
    color : tuple of 4 floats
        Object Info > Color.
    index : int
        Object Info > Object Index.
    attributes : tuple of (str, tuple of 4 floats)
        Of the instancer, by name.
    object_attributes : tuple of (str, tuple of 4 floats)
        Of the object or its data.
    layer_attributes : tuple of (str, tuple of 4 floats)
        Of the view layer, its scene or its world.
    """

    random: float = 0.0
    generated: tuple = (0.0, 0.0, 0.0)
    uv: tuple = (0.0, 0.0, 0.0)
    color: tuple = (1.0, 1.0, 1.0, 1.0)
    index: int = 0
    attributes: tuple = ()
    object_attributes: tuple = ()
    layer_attributes: tuple = ()


def values_of(instance, object, names):
    """Values that nodes read of an instance, in Cycles' own terms (its `sync_object`).

    Parameters
    ----------
    instance : bpy.types.DepsgraphObjectInstance
    object : bpy.types.Object
    names : set of str
        Attributes of the instancer that nodes read.

    Returns
    -------
    InstanceValues
    """
    if not instance.is_instance:  # which then is its own instancer
        return InstanceValues(
            random=_hash_of(object.name) / 0xFFFFFFFF, attributes=tuple(object_attributes(object, names))
        )
    return InstanceValues(
        random=(instance.random_id & 0xFFFFFFFF) / 0xFFFFFFFF,
        generated=tuple(0.5 * v - 0.5 for v in instance.orco),
        uv=(*instance.uv, 0.0),
        attributes=_instancer_attributes(instance, object, names) if names else (),
    )


def _hash_of(name):
    """Hash behind Object Info > Random: Cycles' `hash_uint2` (Jenkins' lookup3) of `hash_string`."""
    text = 0
    for byte in name.encode("utf-8"):
        text = (37 * text + byte - 256 * (byte > 127)) & 0xFFFFFFFF  # of signed characters
    a = b = c = 0xDEADBEEF + (2 << 2) + 13
    a = (a + text) & 0xFFFFFFFF

    def mix(x, y, bits):
        return ((x ^ y) - ((y << bits) | (y >> (32 - bits)))) & 0xFFFFFFFF

    c = mix(c, b, 14)
    a = mix(a, c, 11)
    b = mix(b, a, 25)
    c = mix(c, b, 16)
    a = mix(a, c, 4)
    b = mix(b, a, 14)
    return mix(c, b, 24)


def object_attributes(object, names):
    """Attributes of type Object: custom properties and RNA paths of an object or its data, as Cycles looks.

    Parameters
    ----------
    object : bpy.types.Object
        Evaluated.
    names : iterable of str

    Returns
    -------
    iterator of (str, tuple of 4 floats)
        Name and RGBA of those that are found.
    """
    return _attributes((object, object.data), names)


def _attributes(blocks, names):
    """Name and RGBA of the attributes that are found, each in the first block that has it."""
    for name in sorted(names):
        for block in blocks:
            value = None if block is None else block.get(name)
            if value is None and block is not None:
                with contextlib.suppress(ValueError):
                    value = block.path_resolve(name)
            found = {} if value is None else _as_rgba(name, value)
            if found:
                yield from found.items()
                break


def _instancer_attributes(instance, object, names):
    """Numbers that an Attribute node of type Instancer finds, as name and RGBA.

    Blender looks at the particle settings, then at the attributes of instances that geometry nodes made, then at the
    instancer's custom properties, and at last at those of the object itself.
    """
    found = {}
    particles = instance.particle_system
    for block in (instance.object.original, instance.parent.original, particles and particles.settings):
        for name, value in block.items() if block else ():
            found |= _as_rgba(name, value)
    geometry = _instance_points(instance.parent)
    number = [n for n in instance.persistent_id if n != _NO_ID][-1]  # of the outermost level
    if geometry is not None and number < len(geometry[1].points):
        points = geometry[1]
        for attribute in points.attributes:
            values = attribute.data[number] if attribute.domain == "POINT" else None
            for kind in ("color", "vector", "value"):
                if hasattr(values, kind):
                    found |= _as_rgba(attribute.name, getattr(values, kind))
                    break
    found.pop("position", None)  # of instances' points Blender leaves it undefined
    found |= dict(_attributes((instance.parent, object, object.data), names - found.keys()))
    return tuple((name, found[name]) for name in sorted(names & found.keys()))


def _as_rgba(name, value):
    """A number or vector of an attribute as Cycles' four numbers, or nothing."""
    if isinstance(value, str) or (hasattr(value, "__len__") and not 1 <= len(value) <= 4):
        return {}
    try:
        numbers = tuple(map(float, value)) if hasattr(value, "__len__") else (float(value),) * 3
    except (TypeError, ValueError):
        return {}
    return {name: (*numbers, 0.0, 1.0)[:3] + (1.0,) if len(numbers) < 4 else numbers[:4]}


def lacks_attributes(instance):
    """Whether an instance may have attributes of geometry nodes that this Blender does not expose."""
    if not instance.is_instance or hasattr(bpy.types, "GeometrySet"):
        return False
    return any(modifier.type == "NODES" for modifier in instance.parent.modifiers)


def _instance_points(instancer):
    """The geometry of an object with instances that geometry nodes make, since Blender 5.0, and its points; or None."""
    if not hasattr(bpy.types, "GeometrySet") or not any(m.type == "NODES" for m in instancer.modifiers):
        return None
    geometry = bpy.types.GeometrySet.from_evaluated_object(instancer)
    points = geometry.instances_pointcloud()
    return points and (geometry, points)  # which is gone where its geometry is


def layer_attributes(depsgraph, names):
    """Attributes of type View Layer: of the layer, its scene or its world, as Cycles looks.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
    names : iterable of str

    Returns
    -------
    iterator of (str, tuple of 4 floats)
        Name and RGBA of those that are found.
    """
    scene = depsgraph.scene.original
    return _attributes((scene.view_layers[depsgraph.view_layer.name], scene, scene.world), names)
