"""List view of the focus list."""

import bpy


class HOLOPATH_UL_focus(bpy.types.UIList):
    """List with a row per distance: meters, diopters, infinity."""

    def draw_item(
        self, context: bpy.types.Context, layout, data, item, icon, active_data, active_property, index
    ):
        row = layout.row(align=True)
        if item.focus_infinity:
            row.label(text="Infinity")
        else:
            row.prop(item, "focus", text="", emboss=False)
            row.prop(item, "focus_dioptres", text="", emboss=False)
        end = row.row(align=True)
        end.ui_units_x = 1.2
        end.prop(item, "focus_infinity", text="∞", toggle=True)


CLASSES = (HOLOPATH_UL_focus,)
