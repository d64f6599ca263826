"""Operators of the focus list: the distances of focal stacks."""

import bpy

from .. import engine
from ..blender import properties
from ..export import depth_of, find_camera, unit_scale
from . import session
from .modal_operator import check_poll, report_error


def _has_distance(operator, context):
    """Check that the list has a distance, see `check_poll`."""
    return check_poll(operator, properties.of(context.scene).focus_list, "The focus list is empty")


class HOLOPATH_OT_focus_list_add(bpy.types.Operator):
    """Add the focus distance to the list"""

    bl_idname = "holopath.focus_list_add"
    bl_label = "Add Distance"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context):
        props = properties.of(context.scene)
        add(props, properties.focus_of(props))
        properties.mark_distance(props, properties.focus_list_of(props).index(properties.focus_of(props)))
        session.redraw()
        return {"FINISHED"}


class HOLOPATH_OT_focus_list_remove(bpy.types.Operator):
    """Remove the chosen distance from the list"""

    bl_idname = "holopath.focus_list_remove"
    bl_label = "Remove Distance"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return _has_distance(cls, context)

    def execute(self, context: bpy.types.Context):
        props = properties.of(context.scene)
        props.focus_list.remove(min(props.focus_index, len(props.focus_list) - 1))
        properties.mark_distance(props, max(0, min(props.focus_index, len(props.focus_list) - 1)))
        session.redraw()
        return {"FINISHED"}


class HOLOPATH_OT_focus_list_sort(bpy.types.Operator):
    """Sort the list, nearest first, and drop repeated distances"""

    bl_idname = "holopath.focus_list_sort"
    bl_label = "Sort Distances"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return _has_distance(cls, context)

    def execute(self, context: bpy.types.Context):
        props = properties.of(context.scene)
        distances = sorted(properties.focus_list_of(props))
        chosen = properties.focus_of(props.focus_list[min(props.focus_index, len(props.focus_list) - 1)])
        props.focus_list.clear()
        for distance in distances:
            add(props, distance)
        properties.mark_distance(props, distances.index(chosen))
        session.redraw()
        return {"FINISHED"}


class HOLOPATH_OT_focus_list_from_selected(bpy.types.Operator):
    """Add the distances of the selected objects from the camera, nearest first"""

    bl_idname = "holopath.focus_list_from_selected"
    bl_label = "Add Selected Objects"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context):
        camera = context.scene and context.scene.camera
        selected = camera is not None and any(thing != camera for thing in context.selected_objects)
        return check_poll(cls, selected, "Select objects, and give the scene a camera")

    def execute(self, context: bpy.types.Context):
        scene, props = context.scene, properties.of(context.scene)
        assert scene is not None  # by `poll`
        try:
            camera = find_camera(scene)
        except engine.InvalidInput as error:
            return report_error(self, str(error))
        depths = {
            thing.name: depth_of(camera, thing, unit_scale(scene))
            for thing in context.selected_objects
            if thing != camera
        }
        behind = ", ".join(name for name, depth in depths.items() if depth <= 0)
        visible = sorted(depth for depth in depths.values() if depth > 0)
        if not visible:
            return report_error(self, f"Behind the camera: {behind}. Select objects in front of it.")
        for depth in visible:
            add(props, depth)
        if behind:
            self.report({"WARNING"}, f"Left out, as behind the camera: {behind}.")
        session.redraw()
        return {"FINISHED"}


def add(props, distance):
    """Add a distance to the end of the list, unless the list has it.

    Parameters
    ----------
    props : properties.HoloPathSettings
    distance : float
        Meters; may be infinite.
    """
    properties.set_focus(props.focus_list.add(), distance)
    distances = [properties.focus_of(item) for item in props.focus_list]
    if distances[-1] in distances[:-1]:
        props.focus_list.remove(len(distances) - 1)


CLASSES = (
    HOLOPATH_OT_focus_list_add,
    HOLOPATH_OT_focus_list_remove,
    HOLOPATH_OT_focus_list_sort,
    HOLOPATH_OT_focus_list_from_selected,
)
