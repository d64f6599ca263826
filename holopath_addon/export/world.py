"""Conversion of Blender's world to a Mitsuba environment."""

import numpy as np

from .census import add_notes
from .shading import baking
from .shading.node_graph import Pin, all_nodes, follow, output_node, upstream, uses_nodes
from .shading.textures import MAGENTA, ImageValue, decode_srgb, effect_beside_surfaces, missing, own_mapping

# Texels over all directions of a world that is baked: 0.18 degrees, a third of the sun.
WIDTH, HEIGHT = 2048, 1024
# Columns up to which an sRGB image is refined, as Mitsuba interpolates between linear values, and how much at most:
# of the mean of a checker, 1 % is missing with 9 places a texel.
MAX_REFINED, MAX_FINER = 3072, 33
MAX_EXCESS = 0.02  # of the brightness halfway between texels, without a note


def world_of(depsgraph):
    """World of an evaluated view layer, `bpy.types.World`: its own, or the scene's; None without sky."""
    if not depsgraph.view_layer.use_sky:
        return None
    return getattr(depsgraph.view_layer, "world_override", None) or depsgraph.scene.world


def sees_sky(depsgraph):
    """Whether the world is visible around the scene; it lights the scene in any case."""
    world = world_of(depsgraph)
    rays = getattr(world, "cycles_visibility", None)  # not where Cycles is switched off
    return not depsgraph.scene.render.film_transparent and (rays is None or rays.camera)


def export_world(world, frame, textures, notes):
    """Convert the world to one Mitsuba environment emitter.

    Parameters
    ----------
    world : bpy.types.World or None
    frame : int
        Of the animation.
    textures : Textures
    notes : Notes

    Returns
    -------
    dict or None
        For `mitsuba.load_dict`; None where the world is black.
    """
    if world is None:
        return None
    rays = getattr(world, "cycles_visibility", None)  # not where Cycles is switched off
    for kind in ("diffuse", "glossy", "transmission") if rays else ():
        if not getattr(rays, kind):
            notes.add(
                world.name,
                f"World > Ray Visibility > {kind.title()} off",
                "ignored: the world lights everything",
            )
    if world.node_tree is None or not uses_nodes(world):
        return _uniform(world.color)
    output = output_node(world.node_tree)
    if output is None:
        return None
    add_notes(getattr(world, "cycles", None), world.name, notes)
    if output.inputs["Volume"].is_linked:
        notes.add(world.name, "World volume", "ignored")
    source = follow(Pin(output.inputs["Surface"]))
    if not source.socket.is_output:
        return None
    direct = _direct(source, world.name, frame, textures, notes)
    if direct is None:
        return _bake(source, world, frame, notes)
    color, strength, rotation = direct
    if strength <= 0:
        return None
    if not isinstance(color, ImageValue):
        return _uniform(np.array(color) * strength)
    image = textures.stored(color.image)
    return _everywhere(_radiance(image, world.name, notes) * np.float32(strength), rotation)


def _radiance(image, owner, notes):
    """Linear values of an image [y, x, 3], on a finer grid if Cycles interpolates between encoded ones."""
    pixels = image.numbers[..., :3]
    if not image.srgb:
        return pixels
    height, width = pixels.shape[:2]
    finer = min(MAX_REFINED // max(width, 2 * height), MAX_FINER)
    finer -= finer % 2 == 0  # an odd number, so that the centers of texels are among the places
    if finer > 1:
        return decode_srgb(_refine(_refine(pixels, 0, finer), 1, finer))
    linear = decode_srgb(pixels)
    excess = _excess(pixels, linear)
    if excess > MAX_EXCESS:
        notes.add(
            owner,
            f"sRGB image of more than {MAX_REFINED // 3} columns",
            f"up to {excess:.0%} too bright between texels: save it with linear values, as an .exr",
        )
    return linear


def _excess(pixels, linear):
    """Relative excess of the mean between neighboring texels that are decoded before interpolation."""
    between = decode_srgb((pixels[:, 1:] + pixels[:, :-1]) / 2).mean(dtype=float)
    return float(
        (linear[:, 1:].mean(dtype=float) + linear[:, :-1].mean(dtype=float)) / 2 / max(between, 1e-9) - 1
    )


def _refine(pixels, axis, finer):
    """Linear interpolation of pixels at `finer` times as many points along an axis, periodic as in Cycles."""
    pixels = np.moveaxis(np.pad(pixels, [(int(axis == k),) * 2 for k in range(3)], "wrap"), axis, 0)
    places = (np.arange(finer * (len(pixels) - 2)) + 0.5) / finer + 0.5
    first = places.astype(int)
    weight = (places - first).astype(np.float32)[:, None, None]
    return np.moveaxis((1 - weight) * pixels[first] + weight * pixels[first + 1], 0, axis)


def _direct(source, owner, frame, textures, notes):
    """Color or image, strength, and the 3x3 rotation from world directions to the image's; None if it must be baked."""
    if source.node.bl_idname not in ("ShaderNodeBackground", "ShaderNodeEmission") or source.node.mute:
        return None
    strength, color = follow(source.input("Strength")), follow(source.input("Color"))
    if strength.socket.is_output:
        return None
    strength = float(strength.socket.default_value)
    if not color.socket.is_output:
        return tuple(color.socket.default_value)[:3], strength, np.eye(3)
    node = color.node
    if node.bl_idname != "ShaderNodeTexEnvironment" or node.mute:
        return None
    if missing(node, owner, frame, notes):
        return MAGENTA, strength, np.eye(3)
    if (
        node.projection != "EQUIRECTANGULAR"
        or node.interpolation != "Linear"
        or node.image.source not in ("FILE", "GENERATED")
        or not textures.is_known(node.image)
        or not np.array_equal(own_mapping(node), np.eye(4))
    ):
        return None
    rotation = np.eye(3)
    vector = follow(color.input("Vector"))
    if vector.socket.is_output and vector.node.bl_idname == "ShaderNodeMapping":
        rotation = _rotation(vector)
        vector = follow(vector.input("Vector"))
    generated = vector.socket.is_output and (
        vector.node.bl_idname == "ShaderNodeTexCoord" and vector.socket.name == "Generated"
    )
    if rotation is None or (vector.socket.is_output and not generated):
        return None
    return ImageValue(node.image), strength, rotation


def _rotation(source):
    """Rotation of directions by a Mapping node; None if it does anything else."""
    from mathutils import Euler

    values = {}
    for name in ("Location", "Rotation", "Scale"):
        side = follow(source.input(name)) if source.input(name) else None
        if side is not None and side.socket.is_output:
            return None
        values[name] = tuple(side.socket.default_value) if side else (0.0, 0.0, 0.0)
    moves = np.any(values["Location"]) and source.node.vector_type in ("POINT", "TEXTURE")
    if moves or np.ptp(values["Scale"]) > 1e-6 or values["Scale"][0] <= 0:
        return None
    rotation = np.array(Euler(values["Rotation"], "XYZ").to_matrix())
    return rotation.T if source.node.vector_type == "TEXTURE" else rotation


def _bake(source, world, frame, notes):
    """World of any nodes, which Cycles evaluates in every direction."""
    feature = f"{source.node.bl_label} node" if source.groups == () else "World nodes"
    if any(node.bl_idname == "ShaderNodeLightPath" for node in all_nodes(world)):
        notes.add(world.name, "Light Path node", "the world is the same for all kinds of rays")
    for part in (
        source,
        *(part for name in source.node.inputs for part in upstream(Pin(name, source.groups))),
    ):
        effect, name = effect_beside_surfaces(part), part.socket.name
        if part.node.bl_idname == "ShaderNodeTexCoord" and name in ("Camera", "Window"):
            effect = "not as the camera sees it"
        if effect:
            notes.add(world.name, f"{part.node.bl_label} node", effect)
    try:
        radiance = baking.bake_world(world, WIDTH, HEIGHT, frame)
    except baking.BakingFailed as error:
        notes.add(world.name, feature, f"not baked, {error}: the world's viewport color is used")
        return _uniform(world.color)
    if np.ptp(radiance, axis=(0, 1)).max() <= 1e-4 * radiance.max():
        return _uniform(radiance.mean((0, 1), float))
    notes.add(world.name, feature, f"baked to an environment texture of {WIDTH} x {HEIGHT}")
    return _everywhere(radiance, np.eye(3))


def _uniform(radiance):
    radiance = np.maximum(np.array(radiance, float), 0)
    if not np.any(radiance > 0):
        return None
    return {"type": "constant", "radiance": {"type": "rgb", "value": [float(v) for v in radiance]}}


def _everywhere(radiance, rotation):
    """Environment of pixels, bottom row first, whose directions are rotated."""
    import mitsuba as mi

    # Mitsuba has the first and the last row at the poles, Blender half a row away from them
    rows = np.ascontiguousarray(radiance[::-1, :, :3])
    between = np.concatenate([rows[:1], 0.5 * (rows[:-1] + rows[1:]), rows[-1:]])
    radiance = np.empty((2 * len(rows) + 1, *rows.shape[1:]), np.float32)
    radiance[::2], radiance[1::2] = between, rows
    # Mitsuba's local y is up and z the middle of the picture: Blender's z and x
    to_world = np.eye(4)
    to_world[:3, :3] = np.linalg.inv(rotation) @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(np.maximum(radiance, 0)),
        "to_world": mi.ScalarTransform4f(to_world),
    }
