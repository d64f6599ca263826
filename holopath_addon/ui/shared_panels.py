"""Blender's own panels (output, camera, materials, lights, world) that HoloPath uses too."""

import bpy

_ENGINE = "HOLOPATH"
# Panels that any engine may show are marked with Blender's oldest engine; these are marked as EEVEE's.
_EEVEE = {
    "EEVEE_MATERIAL_PT_context_material",
    "EEVEE_MATERIAL_PT_surface",
    "EEVEE_WORLD_PT_surface",
    "MATERIAL_PT_preview",
    "DATA_PT_EEVEE_light",
    "DATA_PT_light",
}
_EXCLUDED = {"VIEWLAYER_PT_filter", "VIEWLAYER_PT_layer_passes", "RENDER_PT_simplify"}


def _panels():
    """Sets of engines of the panels to share."""
    for name in dir(bpy.types):
        panel = getattr(bpy.types, name)
        if not (isinstance(panel, type) and issubclass(panel, bpy.types.Panel)):
            continue
        engines = getattr(panel, "COMPAT_ENGINES", None)
        if engines is None or name in _EXCLUDED:
            continue
        if "BLENDER_RENDER" in engines or name in _EEVEE:
            yield engines


def share_panels():
    """Show these panels for HoloPath."""
    for engines in _panels():
        engines.add(_ENGINE)


def unshare_panels():
    """Undo `share_panels`."""
    for engines in _panels():
        engines.discard(_ENGINE)
