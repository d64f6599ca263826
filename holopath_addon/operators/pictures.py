"""What cameras took: a picture with depth becomes a mesh in front of the camera, and views become a hologram."""

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
from .working import Working, push_undo, ready, refused


def add_picture(scene, path, options):
    """Add a picture with depth to a scene, as the scene's camera sees it.

    Parameters
    ----------
    scene : bpy.types.Scene
        Depths are true in its units.
    path : Path
        The picture.
    options : CaptureOptions
        Without a field of view the picture is as wide as the camera's view.

    Returns
    -------
    bpy.types.Object
        A mesh where the camera stands, with the material and the image of the picture.

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
    """Blender's mesh of a `PictureMesh`; its first row of texels is the bottom."""
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
    """A material that shines with a picture; each pixel is a square, and what is beyond its borders is mirrored."""
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
    """Draw what is to be said of a depth file.

    Parameters
    ----------
    layout : bpy.types.UILayout
    options : bpy.types.OperatorProperties
        Of `HOLOPATH_OT_add_picture`.
    """
    layout.use_property_split = True
    layout.prop(options, "unit")
    if options.unit == "inverse":
        layout.prop(options, "far")
        layout.prop(options, "near")
    layout.prop(options, "along")
    layout.prop(options, "fov")


class HOLOPATH_OT_choose_picture(bpy.types.Operator):
    """Choose a picture, then its depth: they become a mesh in front of the camera that shines with the picture"""

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
    """Add a mesh in front of the camera that shines with a picture, at the depth of each pixel"""

    bl_idname = "holopath.add_picture"
    bl_label = "Add Picture"
    bl_options = {"REGISTER", "UNDO"}

    picture: StringProperty(
        name="Picture", description="Picture that the depth is of", subtype="FILE_PATH", options={"HIDDEN"}
    )
    filepath: StringProperty(
        name="Depth", description="File with the depth of each pixel", subtype="FILE_PATH"
    )
    filter_glob: StringProperty(default=";".join(f"*{suffix}" for suffix in DEPTHS), options={"HIDDEN"})
    unit: EnumProperty(
        name="Unit",
        description="What the numbers of the depth file are",
        items=[
            ("none", "Choose One", "The file does not say it"),
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
        description="Along what depths are measured",
        items=[
            ("axis", "Camera's Axis", "As cameras and Blender measure it"),
            ("ray", "Line of Sight", "From the camera to the point, as Mitsuba measures it"),
        ],
    )
    fov: FloatProperty(
        name="Field of View",
        description="Of the picture's width, in degrees; 0 is that of the camera",
        min=0.0,
        max=179.0,
    )

    @classmethod
    def poll(cls, context: bpy.types.Context):
        there = context.scene is not None and context.scene.camera is not None and context.mode == "OBJECT"
        return ready(cls, there, "Change to Object Mode, and give the scene a camera")

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Ask for the depth."""
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, context: bpy.types.Context):
        """Settings beside the file browser, and after it."""
        draw_options(self.layout, self)

    def execute(self, context: bpy.types.Context):
        scene, layer = context.scene, context.view_layer
        assert scene is not None and layer is not None  # as `poll` has it
        if self.unit == "none":
            return refused(
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
            return refused(self, failures.sentence(error))
        for each in context.selected_objects:
            each.select_set(False)
        if added.name in layer.objects:
            layer.objects.active = added
            added.select_set(True)
        return {"FINISHED"}


@dataclass(frozen=True)
class ViewReading:
    """Views as a `session.Task` takes what was read of a scene.

    Attributes
    ----------
    name : str
        Of the scene whose settings count.
    file : ViewFile
    size : (int, int)
        Width and height of the hologram.
    """

    name: str
    file: ViewFile
    size: tuple

    def build(self):
        """Have Mitsuba build the scene; in any thread.

        Returns
        -------
        export.ExportedScene
        """
        built = self.file.build(self.size)
        return ExportedScene(built.scene, built.camera, [Note(**note) for note in built.notes])


def view_task(scene, path, options):
    """What is to be rendered of a file of views, by a scene's settings; on the main thread.

    Parameters
    ----------
    scene : bpy.types.Scene
        Nothing else in it is seen.
    path : Path
    options : CaptureOptions

    Returns
    -------
    session.Task

    Raises
    ------
    InvalidInput
        If an option cannot be used; the file is read later.
    """
    file, props = ViewFile(path, options), properties.of(scene)
    hologram = properties.hologram_of(props)
    for stop in session.making_way:
        stop()
    reading = ViewReading(scene.name, file, (hologram.picture.width, hologram.picture.height))
    # it shines, and reflects nothing
    settings = replace(properties.settings_of(props), method=METHODS[0], max_depth=1)
    origin = Origin(
        str(path), opened={"frame": None, "camera": None, "scene": scene.name, "view_layer": None}
    )
    return session.Task(reading, session.request_of(props, hologram, settings, origin))


def draw_view_options(layout, options):
    """Draw what is to be said of a file of views.

    Parameters
    ----------
    layout : bpy.types.UILayout
    options : bpy.types.OperatorProperties
        Of `HOLOPATH_OT_render_views`.
    """
    layout.use_property_split = True
    layout.prop(options, "right")
    layout.prop(options, "down")
    layout.prop(options, "parallel")
    if not options.parallel:
        layout.prop(options, "focus")
    layout.prop(options, "panel")
    layout.prop(options, "fov")


class HOLOPATH_OT_render_views(Working, bpy.types.Operator):
    """Render the hologram of a quilt or another array of views, by the settings of this scene, and show it"""

    bl_idname = "holopath.render_views"
    bl_label = "HoloPath Views"
    doing = "rendering"

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
    parallel: BoolProperty(name="Parallel Cameras", description="The views agree at infinity")
    focus: FloatProperty(
        name="Agree At",
        description="Distance at which all views agree, in meters",
        default=1.0,
        min=1e-3,
        precision=3,
    )
    panel: FloatProperty(
        name="Panel",
        description="Distance at which the views are put together and all is sharpest, in meters; 0: where they agree",
        min=0.0,
        precision=3,
    )
    fov: FloatProperty(
        name="Field of View",
        description="Of a view's width, in degrees; 0 is that of a 50 mm lens",
        min=0.0,
        max=179.0,
    )

    _browsing = False

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event):
        """Ask for the file, unless one is given."""
        if self.filepath:
            return super().invoke(context, event)
        self._browsing = True
        bpy.data.window_managers[0].fileselect_add(self)
        return {"RUNNING_MODAL"}

    def draw(self, context: bpy.types.Context):
        """Settings beside the file browser."""
        draw_view_options(self.layout, self)

    def execute(self, context: bpy.types.Context):
        """Render; after the file browser in a thread, of another operator: Blender ends this one."""
        if not self._browsing:
            return super().execute(context)
        if not type(self).poll(context):
            return refused(self, "The views were not rendered: HoloPath is at work.")
        given = self.as_keywords(ignore=("filter_glob",))
        # pyrefly: ignore[missing-attribute]  # Blender's stubs know no operators of others
        return bpy.ops.holopath.render_views("INVOKE_DEFAULT", **given)

    def capture_options(self):
        """`CaptureOptions` of the settings.

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
        options, path, last = (
            self.capture_options(),
            Path(bpy.path.abspath(self.filepath)),
            session.current.task,
        )
        if not path.is_file():
            raise engine.InvalidInput(f"The views {path} do not exist: choose a file that does.")
        if last is not None:
            last.put_away()  # one scene at a time in Mitsuba

        def render(job, progress):
            progress(0.0, "Starting Mitsuba")
            variants.activate(job.ask(preferences.wanted))
            task = job.ask(lambda: view_task(bpy.data.scenes[scene], path, options))
            return task, task.compute(progress)

        return render

    def finish(self, context: bpy.types.Context, result):
        self.present(context, session.keep_shown(self.scene_settings(), *result))
        push_undo(self.bl_label)
        return "Hologram of views rendered"


CLASSES = (HOLOPATH_OT_choose_picture, HOLOPATH_OT_add_picture, HOLOPATH_OT_render_views)
