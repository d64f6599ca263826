"""Where Blender's viewport shows a scene otherwise than its renders do, and the render's state in its place."""

from dataclasses import dataclass
from typing import Any

import bpy

# Of a modifier's type: its property for the viewport, and the one for renders.
_MODIFIER_LEVELS = {
    "SUBSURF": ("levels", "render_levels"),
    "MULTIRES": ("levels", "render_levels"),
    "OCEAN": ("viewport_resolution", "resolution"),
    "SCREW": ("steps", "render_steps"),
}
_PARTICLE_COUNTS = (("display_step", "render_step"), ("child_percent", "rendered_child_count"))
_SIMPLIFIED = (
    ("simplify_subdivision", "simplify_subdivision_render"),
    ("simplify_child_particles", "simplify_child_particles_render"),
)


@dataclass(frozen=True)
class Difference:
    """One property whose value in the viewport is not the one that renders use.

    Attributes
    ----------
    owner : str
        Name of the object, collection or scene that it concerns.
    feature : str
        What differs, as Blender's interface calls it.
    block : bpy.types.bpy_struct
    name : str
        Of the viewport's property.
    value : object
        What renders use.
    hidden : bool
        Whether the viewport leaves out what renders show.
    minor : bool
        Whether it is no more than the difference that Blender makes by default, and hardly seen.
    """

    owner: str
    feature: str
    block: Any
    name: str
    value: Any
    hidden: bool = False
    minor: bool = False


def differences(scene, view_layer):
    """Properties in which the viewport differs from renders, of all that renders of a view layer may show.

    Parameters
    ----------
    scene : bpy.types.Scene
        The original one, not evaluated.
    view_layer : bpy.types.ViewLayer
        Likewise.

    Yields
    ------
    Difference
    """
    layers = [view_layer, *background_layers(scene)]
    collections, objects = _rendered(layers)
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
        for name, rendered in _SIMPLIFIED:
            wanted = getattr(scene.render, rendered)
            if getattr(scene.render, name) != wanted:
                yield Difference(scene.name, "Simplify", scene.render, name, wanted)


def background_layers(scene):
    """View layers of a scene's Background Scenes that renders show behind it, nearest first."""
    found, background = {}, scene.background_set
    while background is not None and background.session_uid not in found:
        used = [layer for layer in background.view_layers if layer.use] or list(background.view_layers)
        found[background.session_uid] = used[0]
        background = background.background_set
    return list(found.values())


def show_as_rendered(scene, view_layer):
    """Give the viewport's properties the values that renders use.

    Only for a file that nobody is working on: nothing is put back. What Blender does not let be changed stays.
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


def _rendered(view_layers):
    """Collections and objects that renders of view layers may show, also as instances.

    A collection that a view layer hides by its eye is evaluated all the same.
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
                waiting += [thing.instance_collection, *thing.instance_collection.children_recursive]
    return collections.values(), objects.values()


def _of_object(thing, render):
    """Differences in what an object is made of."""
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
            seen, wanted = (getattr(modifier, name) for name in pair)
            if seen != wanted:
                limits = render.simplify_subdivision, render.simplify_subdivision_render
                limited = render.use_simplify and "render_levels" in pair
                alike = limited and min(seen, limits[0]) == min(wanted, limits[1])
                yield Difference(thing.name, words, modifier, pair[0], wanted, minor=alike)
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
    """Differences in how finely curves and metaballs are divided."""
    if isinstance(data, bpy.types.MetaBall) and data.resolution != data.render_resolution:
        minor = data.resolution <= 2 * data.render_resolution
        yield Difference(
            owner, "Metaball resolution", data, "resolution", data.render_resolution, minor=minor
        )
    if isinstance(data, bpy.types.Curve):
        for name in ("resolution_u", "resolution_v"):
            wanted = getattr(data, f"render_{name}")
            for block in (data, *data.splines) if wanted else ():  # 0 stands for the viewport's
                if getattr(block, name) != wanted:
                    yield Difference(owner, "Curve resolution", block, name, wanted)
