"""What of an object is as the viewport has it where renders differ, as a depsgraph of the viewport holds it."""

import math

_EFFECT = "as in the viewport, not as in renders: use F12, or set both alike"


def note_viewport_state(object, render, notes):
    """Note an object's settings that the viewport has otherwise than renders.

    Parameters
    ----------
    object : bpy.types.Object
        The original.
    render : bpy.types.RenderSettings
    notes : Notes
    """
    names = ", ".join(modifier.name for modifier in object.modifiers if _differs(modifier, render))
    if names:
        notes.add(object.name, f"Modifiers: {names}", _EFFECT)
    data = object.data
    if object.type in ("CURVE", "SURFACE", "FONT") and any(
        getattr(data, f"render_{name}") not in (0, getattr(data, name))
        for name in ("resolution_u", "resolution_v")
    ):
        notes.add(object.name, "Curve resolution", _EFFECT)
    if object.type == "META" and data.resolution > 2 * data.render_resolution:  # coarser than by default
        notes.add(object.name, "Metaball resolution", _EFFECT)
    if object.is_instancer and object.show_instancer_for_viewport != object.show_instancer_for_render:
        notes.add(object.name, "Show Instancer", _EFFECT)
    for system in object.particle_systems:
        settings = system.settings
        children = settings.child_type != "NONE" and settings.child_percent != settings.rendered_child_count
        hair = settings.type == "HAIR" and settings.render_type == "PATH"
        if children or settings.display_percentage != 100 or (hair and _coarser(settings)):
            notes.add(object.name, f"Particles '{system.name}'", _EFFECT)


def _coarser(settings):
    return settings.display_step < settings.render_step - 1  # as is the default


def _differs(modifier, render):
    """Whether renders have a modifier and the viewport has not, or at other levels, or the other way round."""
    if modifier.show_viewport != modifier.show_render:
        return True
    if modifier.type not in ("SUBSURF", "MULTIRES") or not modifier.show_render:
        return False
    top, top_of_renders = math.inf, math.inf
    if render.use_simplify:
        top, top_of_renders = render.simplify_subdivision, render.simplify_subdivision_render
    return min(modifier.levels, top) != min(modifier.render_levels, top_of_renders)
