"""Differences between Blender's viewport and its renders, and a change to the renders' state."""

from dataclasses import dataclass
from typing import Any

import bpy

# Properties of modifiers by type: for the viewport, and for renders.
_MODIFIER_LEVELS = {
    "SUBSURF": ("levels", "render_levels"),
    "MULTIRES": ("levels", "render_levels"),
    "OCEAN": ("viewport_resolution", "resolution"),
    "SCREW": ("steps", "render_steps"),
}
_PARTICLE_COUNTS = (("display_step", "render_step"), ("child_percent", "rendered_child_count"))
_SIMPLIFY = (
    ("simplify_subdivision", "simplify_subdivision_render"),
    ("simplify_child_particles", "simplify_child_particles_render"),
)


@dataclass(frozen=True)
class Difference:
    """A property whose value in the viewport differs from that of renders.

    Attributes
    ----------
    owner : str
        Name of the object, collection or scene.
    feature : str
        The difference, by its name in Blender's interface.
    block : bpy.types.bpy_struct
        Owner of the property.
    name : str
        Name of the viewport's property.
    value : object
        Value in renders.
    hidden : bool
        Whether the viewport hides what renders show.
    minor : bool
        Whether the difference is at most Blender's default one, and hardly visible.
    """

    owner: str
    feature: str
    block: Any
    name: str
    value: Any
    hidden: bool = False
    minor: bool = False


def differences(scene, view_layer):
    """Differences between viewport and renders in everything that renders of a view layer may show.

    Parameters
    ----------
    scene : bpy.types.Scene
        The original scene, not an evaluated one.
    view_layer : bpy.types.ViewLayer
        Its view layer, also the original.

    Yields
    ------
    Difference
    """
    layers = [view_layer, *background_layers(scene)]
    collections, objects = _visible_in_renders(layers)
    for each in collections:
        if each.hide_viewport:
            yield Difference(
                each.name, "Collection hidden in the viewport", each, "hide_viewport", False, True
            )
    for thing in objects:
        if thing.hide_viewport:
            yield Difference(thing.name, "Hidden in the viewport", thing, "hide_viewport", False, True)
        yield from _of_object(thing, scene.render)
    if scene.render.use_simplify:
        for name, rendered in _SIMPLIFY:
            value = getattr(scene.render, rendered)
            if getattr(scene.render, name) != value:
                yield Difference(scene.name, "Simplify", scene.render, name, value)


def background_layers(scene):
    """View layers of a scene's Background Scenes that renders show behind it, nearest first."""
    layers, background = {}, scene.background_set
    while background is not None and background.session_uid not in layers:
        used = [layer for layer in background.view_layers if layer.use] or list(background.view_layers)
        layers[background.session_uid] = used[0]
        background = background.background_set
    return list(layers.values())


def show_as_rendered(scene, view_layer):
    """Set the viewport's properties to the values of renders.

    Only for a file that nobody edits: nothing is restored. Properties that cannot be changed stay.
    """
    for layer in (view_layer, *background_layers(scene)):
        for thing in list(layer.objects):
            if not thing.hide_render and thing.hide_get(view_layer=layer):
                thing.hide_set(False, view_layer=layer)
    for each in list(differences(scene, view_layer)):
        try:
            setattr(each.block, each.name, each.value)
        except AttributeError:  # of a linked library, perhaps
            continue


def _visible_in_renders(view_layers):
    """Collections and objects that renders of view layers may show, also as instances.

    Collections that a view layer hides by the eye icon are evaluated, too.
    """
    collections, objects, waiting = {}, {}, []
    layers = [view_layer.layer_collection for view_layer in view_layers]
    while layers:
        layer = layers.pop()
        if layer.exclude or layer.collection.hide_render:
            continue
        waiting.append(layer.collection)
        layers.extend(layer.children)
    while waiting:
        collection = waiting.pop()
        if collection.session_uid in collections:
            continue
        collections[collection.session_uid] = collection
        for thing in collection.objects:
            if thing.hide_render:
                continue
            objects[thing.session_uid] = thing
            if thing.instance_type == "COLLECTION" and thing.instance_collection is not None:
                waiting += _with_children(thing.instance_collection)
    return collections.values(), objects.values()


def _with_children(collection):
    """A collection and those in it, unless renders hide them."""
    if collection.hide_render:
        return []
    return [collection, *(each for child in collection.children for each in _with_children(child))]


def _of_object(thing, render):
    """Differences in an object's instancer, modifiers, data and particles."""
    if thing.is_instancer and thing.show_instancer_for_viewport != thing.show_instancer_for_render:
        shown = thing.show_instancer_for_render
        yield Difference(
            thing.name, "Show Instancer", thing, "show_instancer_for_viewport", shown, hidden=shown
        )
    for modifier in thing.modifiers:
        words = f"Modifier '{modifier.name}'"
        if modifier.show_viewport != modifier.show_render:
            yield Difference(thing.name, words, modifier, "show_viewport", modifier.show_render)
        pair = _MODIFIER_LEVELS.get(modifier.type)
        if pair and modifier.show_render:
            in_viewport, in_renders = (getattr(modifier, name) for name in pair)
            if in_viewport != in_renders:
                limits = render.simplify_subdivision, render.simplify_subdivision_render
                has_limits = render.use_simplify and "render_levels" in pair
                alike = has_limits and min(in_viewport, limits[0]) == min(in_renders, limits[1])
                yield Difference(thing.name, words, modifier, pair[0], in_renders, minor=alike)
    yield from _of_data(thing.name, thing.data)
    for system in thing.particle_systems:
        settings, words = system.settings, f"Particles '{system.name}'"
        if settings.display_percentage != 100:
            yield Difference(thing.name, words, settings, "display_percentage", 100)
        if settings.display_method == "NONE" and settings.render_type != "NONE":
            yield Difference(thing.name, words, settings, "display_method", "RENDER")
        for name, rendered in _PARTICLE_COUNTS:
            used = settings.type == "HAIR" if name == "display_step" else settings.child_type != "NONE"
            if used and getattr(settings, name) != getattr(settings, rendered):
                minor = name == "display_step" and settings.display_step >= settings.render_step - 1
                yield Difference(thing.name, words, settings, name, getattr(settings, rendered), minor=minor)


def _of_data(owner, data):
    """Differences in the resolution of curves and metaballs."""
    if isinstance(data, bpy.types.MetaBall) and data.resolution != data.render_resolution:
        minor = data.resolution <= 2 * data.render_resolution
        yield Difference(
            owner, "Metaball resolution", data, "resolution", data.render_resolution, minor=minor
        )
    if isinstance(data, bpy.types.Curve):
        for name in ("resolution_u", "resolution_v"):
            value = getattr(data, f"render_{name}")
            for block in (data, *data.splines) if value else ():  # 0 stands for the viewport's
                if getattr(block, name) != value:
                    yield Difference(owner, "Curve resolution", block, name, value)
