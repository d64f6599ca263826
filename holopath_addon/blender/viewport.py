"""RENDERED shading of the 3D View: a picture of the view, sharp at all depths, that refines while nothing changes.

Blender tells when to draw and what has changed, and gets what is there. All else is done from a timer, on the main
thread: reading the scene, which may bake textures and so change Blender's data, and starting the thread that traces.
Blender ends its engine instances whenever it bakes, and begins new ones; so a picture belongs to the region of the
screen, and only ends when that has had no engine for a while.
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
from ..operators.working import dragging
from ..workflow import failures
from . import preferences, properties

TICK = 0.05  # seconds between two looks at what is to be done
CALM = 0.2  # seconds without a change, before a scene that takes longer to read than QUICK is read again
QUICK = 0.1
LEAST_PIXELS = 2000  # of the first, coarse picture
SAMPLES = 256  # paths a pixel, and ...
LONGEST = 20.0  # ... seconds, after which a picture is good enough
SHOWN_EVERY = 0.5  # seconds, as drawing takes time from the work
SEEN = 0.1  # progress once there is a picture
PATIENCE = 30.0  # seconds for a thread to end; it may be compiling
GRACE = 1.0  # seconds without an engine

_viewports = {}  # by the address of their region
_jobs = []  # those at work; one may outlive its viewport for a moment


@dataclass(frozen=True)
class RegionView:
    """What a 3D View shows.

    Attributes
    ----------
    camera : engine.Camera
    size : (int, int)
        Pixels of the picture.
    place : tuple of float
        Left, bottom, width and height in the region, pixels; negative where the camera mirrors.
    max_depth : int
        As `engine.Settings.max_depth`.
    """

    camera: engine.Camera
    size: tuple
    place: tuple
    max_depth: int

    def same_picture(self, other):
        """Whether another view, or None, has the same picture; it may be at another place."""
        return other is not None and (self.camera.to_dict(), self.size, self.max_depth) == (
            other.camera.to_dict(),
            other.size,
            other.max_depth,
        )


class Stage:
    """A scene as it was read, and the picture of it that refines; other views cost no compilation."""

    def __init__(self, reading):
        self._reading, self._scene, self._origin = reading, None, reading.origin
        self._preview: engine.Preview | None = None
        self._max_depth = 0

    def look(self, view, shrink):
        """The picture of a view, begun anew and so many times smaller; for one thread at a time."""
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
    """The picture in one 3D View, see `of`."""

    def __init__(self):
        self._engine: weakref.ref | None = None
        self._ended = 0.0
        self._view: RegionView | None = None
        self._where = "", ""  # scene and view layer by name
        self._stage: Stage | None = None
        self._outdated = True
        self._facts: tuple | None = None
        self._changed, self._read, self._reading = 0.0, 0.0, 0.0  # moments, and seconds
        self._job: Job | None = None
        self._traced: tuple[Stage, RegionView] | None = None
        self._pixels: np.ndarray | None = None
        self._texture: gpu.types.GPUTexture | None = None
        self._complaint, self._error = "", ""

    def belong(self, engine):
        """Last as long as this engine instance of Blender's."""
        if self._engine is None or self._engine() is not engine:
            self._engine = weakref.ref(engine, self._end)

    def _end(self, engine):
        if engine is self._engine:
            self._engine, self._ended = None, time.monotonic()
            _wake()

    @property
    def over(self):
        """Whether Blender shows it no more."""
        return self._engine is None and time.monotonic() - self._ended > GRACE

    def note(self, depsgraph):
        """Blender has evaluated something again; it may be what is shown."""
        if (depsgraph.scene.name, depsgraph.view_layer.name) == self._where and self._matters(depsgraph):
            self._outdated, self._changed = True, time.monotonic()
            _wake()

    def _matters(self, depsgraph):
        """Whether the exported scene may differ now: not where a camera has moved, or something was selected."""
        scene_only = False
        for update in depsgraph.updates:
            block = update.id
            if isinstance(block, bpy.types.Scene):
                scene_only = True
            elif not isinstance(block, bpy.types.Camera) and getattr(block, "type", None) != "CAMERA":
                return True
        return scene_only and _facts(depsgraph) != self._facts

    def draw(self, context, depsgraph, shrink):
        """Draw the picture as far as it is; what it is of may have changed.

        Parameters
        ----------
        context : bpy.types.Context
        depsgraph : bpy.types.Depsgraph
        shrink : float
            Pixels of the screen to a pixel of the picture.

        Returns
        -------
        str
            What to tell the user, in one line.
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
        return self._complaint or self._error

    @property
    def unfinished(self):
        """Whether there is anything to be done."""
        if self._job is not None or self._engine is None:
            return True
        return self._view is not None and (self._outdated or not self._up_to_date(self._view))

    def _up_to_date(self, view):
        """Whether a view has been traced, is being traced, or cannot be."""
        return self._stage is None or (
            self._traced is not None and self._traced[0] is self._stage and view.same_picture(self._traced[1])
        )

    def interrupt(self):
        """Ask the thread to end; it begins anew later."""
        if self._job is not None:
            self._job.cancel()

    def gives_way(self):
        """Whether no thread of it traces; if one does, it is to end once it has shown something.

        So a view that moves all the time is seen, too.
        """
        if self._job is not None and self._job.done >= SEEN:
            self._job.cancel()
        return self._job is None

    def collect(self):
        """Take what the thread has done; whether there is something new to be seen."""
        job = self._job
        if job is not None and not job.running:
            self._job = None
            error, job.error = job.error, None  # which holds the thread's variables, the scene among them
            if failures.cancelled(error):
                self._traced = None
            elif error is not None:
                self._error = failures.sentence(error)
                return True
        return self._pixels is not None

    @property
    def to_be_read(self):
        """Whether to read the scene now: soon where that is quick, else when the user pauses."""
        if self._view is None or not self._outdated:
            return False
        now = time.monotonic()
        if self._reading < QUICK and not session.cache.bakes:
            return now - self._read > CALM
        return now - self._changed > CALM and not dragging()

    def read(self):
        """Export the scene."""
        assert self._view is not None  # it is `to_be_read`
        started, (name, layer), view = time.monotonic(), self._where, self._view
        self._outdated, self._error = False, ""
        try:
            scene = bpy.data.scenes[name]
            with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[layer]):
                depsgraph = bpy.context.evaluated_depsgraph_get()
                self._facts = _facts(depsgraph)
                variants.activate(preferences.wanted())
                reading = read_scene(depsgraph, view.size, view.camera, session.cache)
            self._stage = Stage(reading)
        except Exception as error:
            self._stage, self._texture = None, None
            self._error = failures.sentence(error)
        self._read = time.monotonic()
        self._reading = self._read - started

    def trace(self):
        """Trace the view in a thread, where it is another one and the last has given way."""
        stage, view = self._stage, self._view
        if view is None:
            self.interrupt()
        elif stage is not None and not self._outdated and not self._up_to_date(view) and self.gives_way():
            self._start(stage, view)

    def _start(self, stage, view):
        this = weakref.ref(self)

        def show(picture):
            viewport = this()
            if viewport is not None:
                viewport._pixels = session.rgba(picture)

        self._error = ""
        self._traced = stage, view
        job = self._job = Job(lambda progress: refine(stage, view, show, progress))
        _jobs.append(job)
        job.start()


def refine(stage, view, show, progress):
    """Show ever better pictures of a view.

    Parameters
    ----------
    stage : Stage
    view : RegionView
    show : callable
        ``show(picture)`` takes each picture, float32 [y, x, 3], row 0 top.
    progress : callable
        As of `Job`: raises `engine.Cancelled`.
    """
    done = 0.0

    def still(*_):
        progress(done, "Preview")

    started, spp = time.monotonic(), 1
    width, height = view.size
    finest = max(0, int(math.log2(max(1.0, width * height / LEAST_PIXELS)) / 2))
    for shrink in (2**k for k in range(finest, -1, -1)):
        preview = stage.look(view, shrink)
        began = time.monotonic()
        show(preview.refine(1, still))
        done = SEEN
        still()
    while preview.spp < SAMPLES and time.monotonic() - started < LONGEST:
        seconds = time.monotonic() - began
        spp = min(max(1, int(spp * SHOWN_EVERY / max(seconds, 1e-3))), 2 * spp, SAMPLES - preview.spp)
        began = time.monotonic()
        show(preview.refine(spp, still))
        still()


def view_of(context, depsgraph, shrink):
    """What the 3D View of a context shows.

    Parameters
    ----------
    context : bpy.types.Context
    depsgraph : bpy.types.Depsgraph
    shrink : float
        Pixels of the screen to a pixel of the picture.

    Returns
    -------
    RegionView

    Raises
    ------
    engine.InvalidInput
        Where it is not a perspective.
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
    # a frame larger than the region has no more pixels than that
    area = abs(place[2] * place[3])
    shrink *= max(1.0, math.sqrt(area / (region.width * region.height)))
    size = tuple(max(1, round(abs(n) / shrink)) for n in place[2:])
    return RegionView(camera, size, place, properties.of(context.scene).max_depth)


def _frame(camera, scene, region, region_view):
    """Left, bottom, width and height of what an evaluated camera frames, in the region."""
    matrix = camera.matrix_world.normalized()
    upper, _, lower, _ = (matrix @ corner for corner in camera.data.view_frame(scene=scene))
    (right, top), (left, bottom) = (location_3d_to_region_2d(region, region_view, p) for p in (upper, lower))
    return left, bottom, right - left, top - bottom


def _free_camera(region_view, space, scale, sees_sky):
    """The engine's camera of a perspective that belongs to no camera object."""
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
    """What Blender reports like a selection, as a change of the scene: compared in its stead."""
    layer = depsgraph.view_layer
    shown = [thing.session_uid for thing in layer.objects if thing.visible_get(view_layer=layer)]
    taken = [block and block.session_uid for block in (world_of(depsgraph), layer.material_override)]
    return unit_scale(depsgraph.scene), taken, shown


def _texture(pixels):
    height, width = pixels.shape[:2]
    # pyrefly: ignore[bad-argument-count]  # neither is made in Blender's stubs
    data = gpu.types.Buffer("FLOAT", pixels.size, pixels.ravel())
    # pyrefly: ignore[bad-argument-count, unexpected-keyword]
    return gpu.types.GPUTexture((width, height), format="RGBA16F", data=data)


def _paused():
    """Whether the processor is wanted for something better."""
    return session.running() or bpy.app.is_job_running("RENDER")


def _all_give_way():
    """Whether no thread traces; those that do are to end soon. None may while a scene is read."""
    return all([viewport.gives_way() for viewport in _viewports.values()]) and not any(
        job.running for job in _jobs
    )


def of(engine, region):
    """The picture in a region of the screen, of which this engine instance of Blender's is in charge.

    Parameters
    ----------
    engine : bpy.types.RenderEngine
    region : bpy.types.Region

    Returns
    -------
    Viewport
    """
    viewport = _viewports.setdefault(region.as_pointer(), Viewport())
    viewport.belong(engine)
    return viewport


def _wake():
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick)


def _tick():
    _jobs[:] = [job for job in _jobs if job.running]
    for address, viewport in list(_viewports.items()):
        if viewport.over:
            viewport.interrupt()
            del _viewports[address]
    seen = any([viewport.collect() for viewport in _viewports.values()])
    waiting = [viewport for viewport in _viewports.values() if viewport.to_be_read]
    if _paused():
        for viewport in _viewports.values():
            viewport.interrupt()
    elif waiting:
        if _all_give_way():
            waiting[0].read()
            seen = True
    else:
        for viewport in _viewports.values():
            viewport.trace()
    if seen:
        _redraw()
    return TICK if any(viewport.unfinished for viewport in _viewports.values()) else None


def _redraw():
    """Redraw the 3D Views that show our pictures."""
    for window in bpy.data.window_managers[0].windows:
        for area in window.screen.areas:
            space = area.spaces.active
            if isinstance(space, bpy.types.SpaceView3D) and space.shading.type == "RENDERED":
                for region in area.regions:
                    if region.type == "WINDOW":
                        region.tag_redraw()


def stop_tracing():
    """End all threads, now; those of views that are still open begin anew."""
    for job in _jobs:
        job.cancel()
    for job in _jobs:
        job.wait(PATIENCE)


@bpy.app.handlers.persistent
def _evaluated(scene, depsgraph):
    """Blender has evaluated something again."""
    if depsgraph.mode == "VIEWPORT" and not baking.busy():
        for viewport in _viewports.values():
            viewport.note(depsgraph)


@bpy.app.handlers.persistent
def _forget(*_):
    """Another file is about to be opened."""
    stop_tracing()
    _viewports.clear()


def handlers() -> tuple[tuple[list, Callable], ...]:
    """What listens to changes, to files being opened, and to scenes being exported: see `registration`."""
    handlers = bpy.app.handlers
    return (
        (handlers.depsgraph_update_post, _evaluated),
        (handlers.frame_change_post, _evaluated),
        (handlers.load_pre, _forget),
        (session.making_way, stop_tracing),
    )


def detach():
    """End everything."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _forget()
