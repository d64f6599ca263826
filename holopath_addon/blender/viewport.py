"""RENDERED shading of the 3D View: an image of the view, sharp at all depths, that refines while nothing changes.

Blender calls for drawing and after changes, and gets the current image. A timer on the main thread does the rest: it
reads the scene, which may bake textures and so change Blender's data, and starts the thread that traces. Blender ends
its engine instances whenever it bakes, and makes new ones. So an image belongs to the region of the screen, and ends
when that has had no engine for a while.
"""

import math
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.presets import draw_texture_2d

from .. import engine
from ..engine.scene import variants
from ..export import read_scene, unit_scale
from ..export.camera import about, export_camera, find_camera
from ..export.notes import Notes
from ..export.shading import baking
from ..export.world import sees_sky, world_of
from ..operators import session
from ..operators.jobs import Job
from ..operators.long_modal import dragging
from ..workflow import failures
from . import preferences, properties

TICK = 0.05  # seconds between two calls of the timer
QUICK_READ_SECONDS = 0.1  # duration up to which a scene is read again soon after any change
CALM_SECONDS = 0.2  # seconds without a change before a slower scene is read again
MIN_PIXELS = 2000  # pixels of the first, coarse image
MAX_SAMPLES = 256  # paths per pixel of a finished image
MAX_SECONDS = 20.0  # duration after which an image counts as finished
SHOW_INTERVAL = 0.5  # seconds, as drawing takes time from the work
FIRST_IMAGE_PROGRESS = 0.1  # progress from which there is an image
THREAD_TIMEOUT = 30.0  # seconds for a thread to end; it may be compiling
ENGINE_TIMEOUT = 1.0  # seconds without an engine, after which an image ends

_viewports = {}  # by the address of their region
_jobs = []  # running jobs; one may outlive its viewport for a moment


@dataclass(frozen=True)
class RegionView:
    """View of a 3D View.

    Attributes
    ----------
    camera : engine.Camera
    size : (int, int)
        Width and height of the image, pixels.
    place : tuple of float
        Left, bottom, width and height in the region, pixels; negative sizes for a mirroring camera.
    max_depth : int
        See `engine.Settings.max_depth`.
    """

    camera: engine.Camera
    size: tuple
    place: tuple
    max_depth: int

    def same_picture(self, other):
        """Whether another `RegionView`, or None, has the same image, perhaps at another place."""
        return other is not None and (self.camera.to_dict(), self.size, self.max_depth) == (
            other.camera.to_dict(),
            other.size,
            other.max_depth,
        )


class ViewedScene:
    """A scene that was read, with its image that refines. Another view needs no compilation.

    Parameters
    ----------
    reading : export.Reading
    """

    def __init__(self, reading):
        self._reading, self._scene, self._origin = reading, None, reading.origin
        self._preview: engine.Preview | None = None
        self._max_depth = 0

    def start(self, view, shrink):
        """Start the image of a view; for one thread at a time.

        Parameters
        ----------
        view : RegionView
        shrink : float
            Ratio of the view's size to the image's.

        Returns
        -------
        engine.Preview
        """
        width, height = (max(1, round(n / shrink)) for n in view.size)
        camera = about(self._origin, view.camera)
        if self._scene is None:
            self._scene, self._reading = self._reading.build().scene, None
        if self._preview is None or self._max_depth != view.max_depth:
            self._max_depth = view.max_depth
            self._preview = engine.Preview(self._scene, camera, width, height, max_depth=view.max_depth)
        else:
            self._preview.look(camera, width, height)
        return self._preview


class Viewport:
    """The image in one 3D View, see `of`."""

    def __init__(self):
        self._engine: weakref.ref | None = None
        self._ended = 0.0
        self._view: RegionView | None = None
        self._where = "", ""  # scene and view layer by name
        self._viewed: ViewedScene | None = None
        self._outdated = True
        self._facts: tuple | None = None
        self._change_time, self._read_time, self._read_seconds = 0.0, 0.0, 0.0
        self._job: Job | None = None
        self._traced: tuple[ViewedScene, RegionView] | None = None
        self._pixels: np.ndarray | None = None
        self._texture: gpu.types.GPUTexture | None = None
        self._complaint, self._error = "", ""

    def belong(self, engine):
        """Belong to this engine instance of Blender's until it ends."""
        if self._engine is None or self._engine() is not engine:
            self._engine = weakref.ref(engine, self._end)

    def _end(self, engine):
        if engine is self._engine:
            self._engine, self._ended = None, time.monotonic()
            _wake()

    @property
    def over(self):
        """Whether Blender no longer shows it."""
        return self._engine is None and time.monotonic() - self._ended > ENGINE_TIMEOUT

    def note(self, depsgraph):
        """Take note that Blender has evaluated a `bpy.types.Depsgraph` again, which may be the shown one."""
        if (depsgraph.scene.name, depsgraph.view_layer.name) == self._where and self._matters(depsgraph):
            self._outdated, self._change_time = True, time.monotonic()
            _wake()

    def _matters(self, depsgraph):
        """Whether the exported scene may have changed: not if a camera has moved, or something was selected."""
        scene_only = False
        for update in depsgraph.updates:
            block = update.id
            if isinstance(block, bpy.types.Scene):
                scene_only = True
            elif not isinstance(block, bpy.types.Camera) and getattr(block, "type", None) != "CAMERA":
                return True
        return scene_only and _facts(depsgraph) != self._facts

    def draw(self, context, depsgraph, shrink):
        """Draw the current image, and note the view, which may have changed.

        Parameters
        ----------
        context : bpy.types.Context
        depsgraph : bpy.types.Depsgraph
        shrink : float
            Pixels of the screen per pixel of the image.

        Returns
        -------
        str
            Message to the user in one line.
        """
        where = depsgraph.scene.name, depsgraph.view_layer.name
        if where != self._where:
            self._where, self._outdated = where, True
        try:
            self._view, self._complaint = view_of(context, depsgraph, shrink), ""
        except Exception as error:
            self._view, self._complaint = None, failures.sentence(error)
        pixels, self._pixels = self._pixels, None
        if pixels is not None:
            self._texture = _texture(pixels)
        if self._view is not None and self._texture is not None and not self._error:
            left, bottom, width, height = self._view.place
            draw_texture_2d(self._texture, (left, bottom), width, height)
        if self.unfinished:
            _wake()
        return self._complaint or self._error or _ignored(context.space_data)

    @property
    def unfinished(self):
        """Whether the timer has anything to do."""
        if self._job is not None or self._engine is None:
            return True
        return self._view is not None and (self._outdated or not self._up_to_date(self._view))

    def _up_to_date(self, view):
        """Whether a view was traced, is being traced, or cannot be traced."""
        return self._viewed is None or (
            self._traced is not None
            and self._traced[0] is self._viewed
            and view.same_picture(self._traced[1])
        )

    def interrupt(self):
        """End the thread soon; it starts again later."""
        if self._job is not None:
            self._job.cancel()

    def make_way(self):
        """End the thread once it has shown an image, so that a view that moves all the time is shown too.

        Returns
        -------
        bool
            Whether no thread traces.
        """
        if self._job is not None and self._job.done >= FIRST_IMAGE_PROGRESS:
            self._job.cancel()
        return self._job is None

    def collect(self):
        """Take the thread's image or error; whether there is something new to draw."""
        job = self._job
        if job is not None and not job.running:
            self._job = None
            error, job.error = job.error, None  # it holds the thread's variables, the scene among them
            if failures.cancelled(error):
                self._traced = None
            elif error is not None:
                self._error = failures.sentence(error)
                return True
        return self._pixels is not None

    @property
    def needs_reading(self):
        """Whether to read the scene now: soon if that is quick, else when the user pauses."""
        if self._view is None or not self._outdated:
            return False
        now = time.monotonic()
        if self._read_seconds < QUICK_READ_SECONDS and not session.cache.bakes:
            return now - self._read_time > CALM_SECONDS
        return now - self._change_time > CALM_SECONDS and not dragging()

    def read(self):
        """Export the scene."""
        assert self._view is not None  # by `needs_reading`
        started, (name, layer), view = time.monotonic(), self._where, self._view
        self._outdated, self._error = False, ""
        try:
            scene = bpy.data.scenes[name]
            with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[layer]):
                depsgraph = bpy.context.evaluated_depsgraph_get()
                self._facts = _facts(depsgraph)
                variants.activate(preferences.chosen_backend())
                reading = read_scene(depsgraph, view.size, view.camera, session.cache)
            self._viewed = ViewedScene(reading)
        except Exception as error:
            self._viewed, self._texture = None, None
            self._error = failures.sentence(error)
        self._read_time = time.monotonic()
        self._read_seconds = self._read_time - started

    def trace(self):
        """Trace the view in a thread if it is a new one and the last thread has ended."""
        viewed, view = self._viewed, self._view
        if view is None:
            self.interrupt()
        elif viewed is not None and not self._outdated and not self._up_to_date(view) and self.make_way():
            self._start(viewed, view)

    def _start(self, viewed, view):
        this = weakref.ref(self)

        def show(image):
            viewport = this()
            if viewport is not None:
                viewport._pixels = session.rgba_rows(image)

        self._error = ""
        self._traced = viewed, view
        job = self._job = Job(lambda progress: refine(viewed, view, show, progress))
        _jobs.append(job)
        job.start()


def refine(viewed, view, show, progress):
    """Show better and better images of a view, from coarse to fine and then with more samples.

    Parameters
    ----------
    viewed : ViewedScene
    view : RegionView
    show : callable
        ``show(image)`` takes each image, float32, shape (y, x, 3), row 0 at the top.
    progress : callable
        Progress of a `Job`, which raises `engine.Cancelled`.
    """
    done = 0.0

    def check(*_):
        progress(done, "Preview")

    started, spp = time.monotonic(), 1
    width, height = view.size
    halvings = max(0, int(math.log2(max(1.0, width * height / MIN_PIXELS)) / 2))
    for shrink in (2**k for k in range(halvings, -1, -1)):
        preview = viewed.start(view, shrink)
        start = time.monotonic()
        show(preview.refine(1, check))
        done = FIRST_IMAGE_PROGRESS
        check()
    while preview.spp < MAX_SAMPLES and time.monotonic() - started < MAX_SECONDS:
        seconds = time.monotonic() - start
        spp = min(max(1, int(spp * SHOW_INTERVAL / max(seconds, 1e-3))), 2 * spp, MAX_SAMPLES - preview.spp)
        start = time.monotonic()
        show(preview.refine(spp, check))
        check()


def _ignored(space):
    """Message on what a 3D View hides, but its image shows; empty without any."""
    if space.local_view is not None:
        return "HoloPath shows all objects of the view layer, in Local View, too."
    if space.use_local_collections:
        return "HoloPath shows all collections of the view layer, whatever this view hides."
    return ""


def view_of(context, depsgraph, shrink):
    """View of a context's 3D View.

    Parameters
    ----------
    context : bpy.types.Context
    depsgraph : bpy.types.Depsgraph
    shrink : float
        Pixels of the screen per pixel of the image.

    Returns
    -------
    RegionView

    Raises
    ------
    engine.InvalidInput
        If it is not a perspective, or the scene has no usable camera.
    """
    scene, space = depsgraph.scene, context.space_data
    region, region_view = context.region, context.region_data
    scale = unit_scale(scene)
    if region_view.view_perspective == "CAMERA":
        size = scene.render.resolution_x, scene.render.resolution_y
        object = find_camera(scene, space.camera)
        camera = export_camera(depsgraph, object, size, scale, Notes())
        place = _frame(object.evaluated_get(depsgraph), scene, region, region_view)
    elif region_view.is_perspective:
        camera = _free_camera(region_view, space, scale, sees_sky(depsgraph))
        place = 0.0, 0.0, region.width, region.height
    else:
        raise engine.InvalidInput(
            "HoloPath shows no orthographic views: change to perspective (Numpad 5) or to the camera (Numpad 0)."
        )
    # a camera frame larger than the region gets no more pixels than that
    area = abs(place[2] * place[3])
    shrink *= max(1.0, math.sqrt(area / (region.width * region.height)))
    size = tuple(max(1, round(abs(n) / shrink)) for n in place[2:])
    return RegionView(camera, size, place, properties.of(context.scene).max_depth)


def _frame(camera, scene, region, region_view):
    """Left, bottom, width and height of an evaluated camera's frame in the region, pixels."""
    matrix = camera.matrix_world.normalized()
    upper, _, lower, _ = (matrix @ corner for corner in camera.data.view_frame(scene=scene))
    (right, top), (left, bottom) = (location_3d_to_region_2d(region, region_view, p) for p in (upper, lower))
    return left, bottom, right - left, top - bottom


def _free_camera(region_view, space, scale, sees_sky):
    """The engine's camera for a perspective without a camera object."""
    window = region_view.window_matrix
    to_world = np.array(region_view.view_matrix.inverted(), dtype=np.float64)
    to_world[:3, 3] *= scale
    return engine.Camera(
        to_world,
        2 * math.atan(1 / window[0][0]),
        window[0][2] / 2,
        window[1][2] / 2 * window[0][0] / window[1][1],
        space.clip_start * scale,
        space.clip_end * scale,
        sees_sky,
    )


def _facts(depsgraph):
    """Facts of a scene whose changes Blender reports like a selection, for comparison."""
    layer = depsgraph.view_layer
    visible = [thing.session_uid for thing in layer.objects if thing.visible_get(view_layer=layer)]
    blocks = [block and block.session_uid for block in (world_of(depsgraph), layer.material_override)]
    return unit_scale(depsgraph.scene), blocks, visible


def _texture(pixels):
    """Texture on the graphics card."""
    height, width = pixels.shape[:2]
    # pyrefly: ignore[bad-argument-count]  # neither is made in Blender's stubs
    data = gpu.types.Buffer("FLOAT", pixels.size, pixels.ravel())
    # pyrefly: ignore[bad-argument-count, unexpected-keyword]
    return gpu.types.GPUTexture((width, height), format="RGBA16F", data=data)


def _paused():
    """Whether the processor is busy with a render."""
    return session.running() or bpy.app.is_job_running("RENDER")


def _all_make_way():
    """End all threads soon; whether none traces. None may trace while a scene is read."""
    return all([viewport.make_way() for viewport in _viewports.values()]) and not any(
        job.running for job in _jobs
    )


def of(engine, region):
    """The image in a region of the screen.

    Parameters
    ----------
    engine : bpy.types.RenderEngine
        Engine instance of Blender's that draws the region.
    region : bpy.types.Region

    Returns
    -------
    Viewport
    """
    viewport = _viewports.setdefault(region.as_pointer(), Viewport())
    viewport.belong(engine)
    return viewport


def _wake():
    """Start the timer, unless it runs."""
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick)


def _tick():
    """Read scenes, start threads and redraw; as a timer."""
    _jobs[:] = [job for job in _jobs if job.running]
    for address, viewport in list(_viewports.items()):
        if viewport.over:
            viewport.interrupt()
            del _viewports[address]
    changed = any([viewport.collect() for viewport in _viewports.values()])
    waiting = [viewport for viewport in _viewports.values() if viewport.needs_reading]
    if _paused():
        for viewport in _viewports.values():
            viewport.interrupt()
    elif waiting:
        if _all_make_way():
            waiting[0].read()
            changed = True
    else:
        for viewport in _viewports.values():
            viewport.trace()
    if changed:
        _redraw()
    return TICK if any(viewport.unfinished for viewport in _viewports.values()) else None


def _redraw():
    """Redraw the 3D Views that are shaded RENDERED."""
    for window in bpy.data.window_managers[0].windows:
        for area in window.screen.areas:
            space = area.spaces.active
            if isinstance(space, bpy.types.SpaceView3D) and space.shading.type == "RENDERED":
                for region in area.regions:
                    if region.type == "WINDOW":
                        region.tag_redraw()


def stop_tracing():
    """End all threads now. Those of open views start again later."""
    for job in _jobs:
        job.cancel()
    for job in _jobs:
        job.wait(THREAD_TIMEOUT)


@bpy.app.handlers.persistent
def _evaluated(scene, depsgraph):
    """Note that Blender has evaluated a scene again."""
    if depsgraph.mode == "VIEWPORT" and not baking.busy():
        for viewport in _viewports.values():
            viewport.note(depsgraph)


@bpy.app.handlers.persistent
def _forget(*_):
    """End all images before another file is opened."""
    stop_tracing()
    _viewports.clear()


def handlers() -> tuple[tuple[list, Callable], ...]:
    """Callbacks for changes, opened files and exports, see `session.handlers`."""
    handlers = bpy.app.handlers
    return (
        (handlers.depsgraph_update_post, _evaluated),
        (handlers.frame_change_post, _evaluated),
        (handlers.load_pre, _forget),
        (session.before_export, stop_tracing),
    )


def detach():
    """End all images and the timer."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _forget()
