"""Condition and background plates that the overlays of the 3D View share."""

import gpu
from gpu_extras.batch import batch_for_shader


def tab_open(area, space):
    """Whether the tab HoloPath is open in the sidebar of a 3D View.

    Parameters
    ----------
    area : bpy.types.Area
    space : bpy.types.SpaceView3D
        Active space of the area.
    """
    return space.show_region_ui and any(
        region.type == "UI" and region.active_panel_category == "HoloPath" for region in area.regions
    )


def draw_plate(x, y, width, height, opacity=0.5):
    """Draw a dark rectangle.

    Parameters
    ----------
    x, y : float
        Lower left corner in the region, pixels.
    width, height : float
        Pixels.
    opacity : float
    """
    plain = gpu.shader.from_builtin("UNIFORM_COLOR")
    plain.uniform_float("color", (0.0, 0.0, 0.0, opacity))
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    gpu.state.blend_set("ALPHA")
    batch_for_shader(plain, "TRIS", {"pos": corners}, indices=[(0, 1, 2), (0, 2, 3)]).draw(plain)
    gpu.state.blend_set("NONE")
