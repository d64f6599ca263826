"""What the overlays of the 3D View share: when they are drawn, and what their words stand on."""

import gpu
from gpu_extras.batch import batch_for_shader


def tab_open(area, space):
    """Whether the sidebar's tab HoloPath is open in a 3D View."""
    return space.show_region_ui and any(
        region.type == "UI" and region.active_panel_category == "HoloPath" for region in area.regions
    )


def draw_plate(x, y, width, height, opacity=0.5):
    """Draw a dark rectangle, in pixels of the region."""
    plain = gpu.shader.from_builtin("UNIFORM_COLOR")
    plain.uniform_float("color", (0.0, 0.0, 0.0, opacity))
    corners = [(x, y), (x + width, y), (x + width, y + height), (x, y + height)]
    gpu.state.blend_set("ALPHA")
    batch_for_shader(plain, "TRIS", {"pos": corners}, indices=[(0, 1, 2), (0, 2, 3)]).draw(plain)
    gpu.state.blend_set("NONE")
