"""Operators on captures: a picture with depth becomes a mesh in front of the camera, and views a hologram."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
from bpy.props import BoolProperty, EnumProperty, FloatProperty, StringProperty
from mathutils import Matrix

from .. import engine
from ..blender import preferences, properties
from ..engine.scene import variants
from ..engine.scene.captured.picture import PictureMesh, picture_mesh
from ..engine.scene.captured.views import METHODS
from ..exchange.captures import (
    DEPTHS,
    PICTURES,
    UNITS,
    VIEWS,
    CaptureOptions,
    PictureFile,
    ViewFile,
    downsample,
)
from ..export import ExportedScene, unit_scale
from ..export.camera import find_camera, view_of
from ..export.notes import Note
from ..export.shading.node_graph import tree_of
from ..workflow import failures
from ..workflow.request import Origin
from . import session
from .long_modal import is_paused
from .modal_operator import ModalOperator, check_poll, push_undo, report_error


def add_picture(scene, path, options):
    """Add a picture with depth to a scene, fitted to its camera's view.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene, in whose units depths are true.
    path : Path
        Picture.
    options : CaptureOptions
        Options of the depth file. Without a field of view the picture is as wide as the camera's view.

    Returns
    -------
    bpy.types.Object
        Mesh at the camera, with a material that shows the picture.

    Raises
    ------
    InvalidInput
        If a file or an option cannot be used, or the scene has no perspective camera.
    """
    picture = PictureFile(path, options)
    scale = unit_scale(scene)
    view = view_of(find_camera(scene), picture.size, scale)
    fov = view.fov_x if options.fov is None else np.radians(options.fov)
    hologram = properties.hologram_of(properties.of(scene)).picture
    _, depth, kept = downsample(picture.image, picture.depth(fov), (hologram.width, hologram.height))
    surface = picture_mesh(depth, 2 * np.arctan(kept[0] * np.tan(fov / 2)))
    uv = 0.5 + (surface.uv - 0.5) * kept
    material = _material(path)
    mesh = _mesh(path.stem, PictureMesh(surface.vertices / scale, uv, surface.triangles))
    mesh.materials.append(material)
    added = bpy.data.objects.new(path.stem, mesh)
    scene.collection.objects.link(added)
    matrix = view.to_world.copy()
    matrix[:3, 3] /= scale
    added.matrix_world = Matrix(matrix.tolist())
    return added


def _mesh(name, surface):
    """Blender's mesh of a `PictureMesh`, with v from the bottom up."""
    mesh = bpy.data.meshes.new(name)
    triangles = surface.triangles
    mesh.vertices.add(len(surface.vertices))
    mesh.vertices.foreach_set("co", surface.vertices.astype(np.float32).ravel())
    mesh.loops.add(triangles.size)
    mesh.loops.foreach_set("vertex_index", triangles.ravel())
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    corners = surface.uv[triangles.ravel()] * (1, -1) + (0, 1)
    mesh.uv_layers.new(name="UVMap").uv.foreach_set("vector", corners.astype(np.float32).ravel())
    mesh.shade_flat()
    return mesh


def _material(path):
    """Material that emits a picture, with square pixels and mirrored borders."""
    material = bpy.data.materials.new(path.stem)
    tree = tree_of(material)
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    shader = tree.nodes.new("ShaderNodeEmission")
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.load(str(path.absolute()), check_existing=True)
    texture.interpolation, texture.extension = "Closest", "MIRROR"
    tree.links.new(texture.outputs["Color"], shader.inputs["Color"])
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    return material


def draw_options(layout, options):
    """Draw the options of a depth file.

    Parameters
    ----------
    layout : bpy.types.UILayout
    options : bpy.types.OperatorProperties
        Properties of `HOLOPATH_OT_add_picture`.
    """
    layout.use_property_split = True
    layout.prop(options, "unit")
    if options.unit == "inverse":
        layout.prop(options, "far")
        layout.prop(options, "near")
    layout.prop(options, "along")
    layout.prop(options, "fov")


class HOLOPATH_OT_choose_picture(bpy.types.Operator):
    """Choose a picture, then its depth: they become a mesh in front of the camera that emits the picture"""

    bl_idname = "holopath.choose_picture"
    bl_label = "HoloPath Picture With Depth"

    filepath: StringProperty(name="Picture", description="Picture to add", subtype="FILE_PATH")
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in PICTURES), options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context):
        return HOLOPATH_OT_add_picture.poll(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Ask for the picture."""
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context):
        # pyrefly: ignore[missing-attribute]  # Blender's stubs know no operators of others
        return bpy.ops.holopath.add_picture("INVOKE_DEFAULT", picture=self.filepath)


class HOLOPATH_OT_add_picture(bpy.types.Operator):
    """Add a mesh in front of the camera that emits a picture, at the depth of each pixel"""

    bl_idname = "holopath.add_picture"
    bl_label = "Add Picture"
    bl_options = {"REGISTER", "UNDO"}

    picture: StringProperty(
        name="Picture",
        description="Picture that the depth belongs to",
        subtype="FILE_PATH",
        options={"HIDDEN"},
    )
    filepath: StringProperty(
        name="Depth", description="File with the depth of each pixel", subtype="FILE_PATH"
    )
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in DEPTHS), options={"HIDDEN"})
    unit: EnumProperty(
        name="Unit",
        description="Unit of the numbers in the depth file",
        items=[
            ("none", "Choose One", "Files do not name their unit"),
            ("m", "Meters", "Depths in meters"),
            ("mm", "Millimeters", "Depths in millimeters"),
            ("diopters", "Diopters", "Inverse depths in 1/m"),
            ("inverse", "Inverse, 0 to 1", "Inverse depths from 0 at the far end to 1 at the near one"),
        ],
    )
    far: FloatProperty(
        name="Far End", description="Depth of the inverse depth 0, in meters", default=10.0, min=1e-3
    )
    near: FloatProperty(
        name="Near End", description="Depth of the inverse depth 1, in meters", default=0.5, min=1e-3
    )
    along: EnumProperty(
        name="Along",
        description="Direction along which depths are measured",
        items=[
            ("axis", "Camera's Axis", "Along the optical axis, as depth cameras and Blender measure"),
            ("ray", "Line of Sight", "From the camera to the point, as Mitsuba measures"),
        ],
    )
    fov: FloatProperty(
        name="Field of View",
        description="Field of view over the picture's width, in degrees; 0: that of the camera",
        min=0.0,
        max=179.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context):
        ready = context.scene is not None and context.scene.camera is not None and context.mode == "OBJECT"
        return check_poll(cls, ready, "Change to Object Mode, and give the scene a camera")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Ask for the depth."""
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, context: bpy.types.Context):
        """Draw the settings beside the file browser, and after it."""
        draw_options(self.layout, self)

    def execute(self, context: bpy.types.Context):
        scene, layer = context.scene, context.view_layer
        assert scene is not None and layer is not None  # by `poll`
        if self.unit == "none":
            return report_error(
                self,
                f"The depth file does not say what its numbers are: choose a Unit of {', '.join(UNITS)}.",
            )
        options = CaptureOptions(
            bpy.path.abspath(self.filepath),
            self.unit,
            (self.far, self.near) if self.unit == "inverse" else None,
            self.along,
            self.fov or None,
        )
        try:
            added = add_picture(scene, Path(bpy.path.abspath(self.picture)), options)
        except Exception as error:
            return report_error(self, failures.sentence(error))
        for each in context.selected_objects:
            each.select_set(False)
        if added.name in layer.objects:
            layer.objects.active = added
            added.select_set(True)
        return {"FINISHED"}


@dataclass(frozen=True)
class ViewReading:
    """A file of views in place of a scene, for a `session.Task`.

    Attributes
    ----------
    name : str
        Name of the scene whose settings count.
    file : ViewFile
    size : (int, int)
        Width and height of the hologram.
    """

    name: str
    file: ViewFile
    size: tuple

    def build(self):
        """Build Mitsuba's scene; in any thread.

        Returns
        -------
        export.ExportedScene
        """
        built = self.file.build(self.size)
        return ExportedScene(built.scene, built.camera, [Note(**note) for note in built.notes])


def view_task(scene, path, options):
    """Task of rendering a file of views with a scene's settings; on the main thread.

    Parameters
    ----------
    scene : bpy.types.Scene
        Scene with the settings; its objects are not rendered.
    path : Path
        File of views.
    options : CaptureOptions

    Returns
    -------
    session.Task

    Raises
    ------
    InvalidInput
        If an option is invalid; the file is read later.
    """
    file, props = ViewFile(path, options), properties.of(scene)
    hologram = properties.hologram_of(props)
    for stop in session.before_export:
        stop()
    reading = ViewReading(scene.name, file, (hologram.picture.width, hologram.picture.height))
    # its surface emits, and reflects nothing
    settings = replace(properties.settings_of(props), method=METHODS[0], max_depth=1)
    origin = Origin(
        str(path), scene_state={"frame": None, "camera": None, "scene": scene.name, "view_layer": None}
    )
    return session.Task(reading, session.request_of(props, hologram, settings, origin))


def draw_view_options(layout, options):
    """Draw the options of a file of views.

    Parameters
    ----------
    layout : bpy.types.UILayout
    options : bpy.types.OperatorProperties
        Properties of `HOLOPATH_OT_render_views`.
    """
    layout.use_property_split = True
    layout.prop(options, "right")
    layout.prop(options, "down")
    layout.prop(options, "parallel")
    if not options.parallel:
        layout.prop(options, "focus")
    layout.prop(options, "panel")
    layout.prop(options, "fov")


class HOLOPATH_OT_render_views(ModalOperator, bpy.types.Operator):
    """Render the hologram of a quilt or another array of views with the settings of this scene, and show it"""

    bl_idname = "holopath.render_views"
    bl_label = "HoloPath Views"
    activity = "rendering"

    filepath: StringProperty(
        name="Views",
        description="Quilt, or array of views, to make the hologram of",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    filter_glob: StringProperty(
        default=";".join(f"*{suffix}" for suffix in (*PICTURES, *VIEWS)), options={"HIDDEN"}
    )
    right: FloatProperty(
        name="Right",
        description="Distance from the first view to the last of a row, in meters",
        min=0.0,
        precision=4,
    )
    down: FloatProperty(
        name="Down",
        description="Distance from the first row of views to the last, in meters",
        min=0.0,
        precision=4,
    )
    parallel: BoolProperty(
        name="Parallel Cameras", description="The cameras are parallel: views agree at infinity"
    )
    focus: FloatProperty(
        name="Agree At",
        description="Distance at which all views agree, in meters",
        default=1.0,
        min=1e-3,
        precision=3,
    )
    panel: FloatProperty(
        name="Panel",
        description="Distance of the plane that combines the views and is sharpest, in meters; 0: where they agree",
        min=0.0,
        precision=3,
    )
    fov: FloatProperty(
        name="Field of View",
        description="Field of view over a view's width, in degrees; 0: that of a 50 mm lens",
        min=0.0,
        max=179.0,
    )

    _browsing = False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Ask for the file, unless one is given."""
        if self.filepath or is_paused(type(self)):
            return super().invoke(context, event)
        self._browsing = True
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, context: bpy.types.Context):
        """Draw the settings beside the file browser."""
        draw_view_options(self.layout, self)

    def execute(self, context: bpy.types.Context):
        """Render; after the file browser, which ends this operator, in the thread of another one."""
        if not self._browsing:
            return super().execute(context)
        if not type(self).poll(context):
            return report_error(self, "The views were not rendered: HoloPath is at work.")
        settings = self.as_keywords(ignore=("filter_glob",))
        # pyrefly: ignore[missing-attribute]  # Blender's stubs know no operators of others
        return bpy.ops.holopath.render_views("INVOKE_DEFAULT", **settings)

    def capture_options(self):
        """The `CaptureOptions` of the settings.

        Raises
        ------
        InvalidInput
            If the distances of the views are missing.
        """
        span = tuple(length for length in (self.right, self.down) if length)
        if not span:
            raise engine.InvalidInput(
                "The views do not say where they were seen from: give Right, the meters from the first to the last of "
                "a row, and Down if there are several rows."
            )
        if self.parallel and not self.panel:
            raise engine.InvalidInput(
                "Views of parallel cameras agree at infinity: give Panel, a distance in the middle of what they show."
            )
        return CaptureOptions(
            fov=self.fov or None,
            view_span=span,
            view_focus=math.inf if self.parallel else self.focus,
            view_panel=self.panel or None,
        )

    def work(self, scene):
        options, path = self.capture_options(), Path(bpy.path.abspath(self.filepath))
        last = session.current.task
        if not path.is_file():
            raise engine.InvalidInput(f"The views {path} do not exist: choose a file that does.")
        if last is not None:
            last.release_scene()  # Mitsuba holds one scene at a time

        def render(job, progress):
            progress(0.0, "Starting Mitsuba")
            variants.activate(job.query(preferences.chosen_backend))
            task = job.query(lambda: view_task(bpy.data.scenes[scene], path, options))
            return task, task.compute(progress)

        return render

    def finish(self, context: bpy.types.Context, result):
        self.present(context, session.keep_and_show(self.scene_settings(), *result))
        push_undo(self.bl_label)
        return "Hologram of views rendered"


CLASSES = (HOLOPATH_OT_choose_picture, HOLOPATH_OT_add_picture, HOLOPATH_OT_render_views)
