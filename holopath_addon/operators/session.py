"""What this Blender session holds: the job at work, the last wave field, and what is known of it."""

import dataclasses
import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import bpy
import numpy as np

from .. import engine
from ..blender import preferences, properties
from ..blender.properties.optics import bench_changed
from ..engine import rendering
from ..engine.planning.planner import resolved
from ..engine.scene import variants
from ..export import ExportCache, ExportedScene, read_scene
from ..workflow import failures, pipeline
from ..workflow.request import Origin, Request
from .jobs import Job

IMAGE = "HoloPath Reconstruction"
TEXTURE = "HoloPath Baked Light"
PHASE = "HoloPath Phase"
# seconds in a thread, which is far less alone: one redraw then shows the slider and the picture
AT_ONCE = 0.3


@dataclass
class Session:
    """State of the running Blender; nothing of it belongs to the .blend.

    Attributes
    ----------
    job : Job or None
        The hologram being rendered, or the light being baked.
    refocuser : engine.Refocuser or None
        Holds the last wave field rendered; its picture can be refocused.
    phase : engine.PhaseHologram or None
        The field's, once it is encoded.
    phase_light : tuple of engine.PhaseHologram, engine.Modulator, engine.Optics and engine.Refocuser, or None
        What a display with such limits makes of phases on such a bench.
    task : Task or None
        What the field was rendered of.
    made : engine.Plan or None
        How the field was rendered.
    plan : engine.Plan or None
    scene : str
        Name of the scene that the last plan and notes are of.
    rendered : str
        Name of the scene that the field is of.
    draft : bool
        Whether the field is a draft, kept until there is better.
    found : float or None
        Metres at which automatic focusing found the last picture of F12, until it is written down.
    in_view : tuple of float
        Nearest and farthest thing in view of the field, dioptres.
    notes : list of str
        What the exporter approximated or left out.
    bake : dict or None
        The last `engine.baking.Bake`, of the scene `baked`.
    texture : numpy.ndarray or None
        Its picture; a render has none.
    baked : str
        Name of that scene.
    error : str
        Last failure in one sentence; empty if there was none.
    leave : callable or None
        Takes back what the running operator changed in the window, see `leave`.
    refocus : Job or None
        The picture in work, and in `wanted` what the next one is to show, see `properties.seen_of`.
    pace : float
        Seconds that the last picture of the field took.
    sweep : bpy.types.Timer or None
        Of the focus that plays.
    """

    job: Job | None = None
    refocuser: engine.Refocuser | None = None
    phase: engine.PhaseHologram | None = None
    phase_light: tuple | None = None
    task: "Task | None" = None
    made: engine.Plan | None = None
    plan: engine.Plan | None = None
    scene: str = ""
    rendered: str = ""
    draft: bool = False
    found: float | None = None
    in_view: tuple = (0.0, 0.0)
    notes: list = dataclasses.field(default_factory=list)
    bake: dict | None = None
    texture: np.ndarray | None = None
    baked: str = ""
    error: str = ""
    leave: Callable[[], None] | None = None
    refocus: Job | None = None
    wanted: tuple | None = None
    pace: float = math.inf
    sweep: bpy.types.Timer | None = None

    @property
    def field(self):
        """The last `engine.WaveField` rendered, or None."""
        return None if self.refocuser is None else self.refocuser.field


current = Session()
# What the last export read of the scene in the window.
cache = ExportCache()
# Called before a scene is exported, for whatever traces rays meanwhile to stop: callables.
making_way = []


class SceneReading(Protocol):
    """What was read of a scene, as `export.Reading`, which Mitsuba is to build."""

    @property
    def name(self) -> str:
        """Of Blender's scene whose settings count."""
        ...

    def build(self) -> ExportedScene:
        """Have Mitsuba build its scene; in any thread."""
        ...


@dataclass(frozen=True)
class Task:
    """What was read of a scene and what its render is to bring; holds nothing of bpy, so a thread may work on it.

    Attributes
    ----------
    reading : SceneReading
    request : Request
        Without the scene, which the reading brings.
    """

    reading: SceneReading
    request: Request

    @cached_property
    def exported(self):
        """`export.ExportedScene`, with the scene that Mitsuba builds when this is first asked for."""
        return self.reading.build()

    @property
    def built(self):
        """The `Request` with its scene."""
        exported = self.exported
        return self.request.with_scene(
            exported.scene, exported.camera, [note.to_dict() for note in exported.notes]
        )

    def put_away(self):
        """Let go of Mitsuba's scene until it is asked for again."""
        self.__dict__.pop("exported", None)

    @property
    def notes(self):
        """What the exporter approximated or left out, a line each."""
        return [str(note) for note in self.exported.notes]

    def plan(self, progress):
        """`engine.Plan` of the task."""
        progress(0.0, "Building the scene")
        built = self.built
        return engine.plan(built.scene, built.camera, built.hologram, built.settings, built.store, progress)

    def compute(self, progress, offer=None):
        """`pipeline.Result` of the task; `offer` is called with what can be looked at meanwhile, see there."""
        progress(0.0, "Building the scene")
        return pipeline.compute(self.built, progress, offer=offer)

    def bake(self, progress, anew=False):
        """Picture of the baked light and its `engine.baking.Bake`; `anew` takes nothing from the store."""
        progress(0.0, "Building the scene")
        built = self.built
        progress(0.0, "Planning")
        return rendering.baked_picture(
            built.scene, built.camera, built.hologram, built.settings, built.store, progress, anew
        )


def prepare(depsgraph, props, resolution=None, camera=None):
    """Read the scene; on the thread that owns `depsgraph`.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
    props : properties.HoloPathSettings
    resolution : tuple of int, optional
        Pixels, in place of the settings' own.
    camera : bpy.types.Object, optional
        In place of the scene's.

    Returns
    -------
    Task

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable
    """
    hologram, settings = properties.hologram_of(props, resolution), properties.settings_of(props)
    variants.activate(preferences.wanted())
    for stop in making_way:
        stop()
    size = hologram.picture.width, hologram.picture.height
    reading = read_scene(depsgraph, size, camera, cache)
    opened = {
        "frame": depsgraph.scene.frame_current,
        "camera": camera and camera.name,
        "scene": reading.name,
        "view_layer": depsgraph.view_layer.name,
    }
    origin = Origin(bpy.data.filepath or depsgraph.scene.name, opened=opened)
    return Task(reading, request_of(props, hologram, settings, origin))


def request_of(props, hologram, settings, origin):
    """The `Request` of a scene's properties: an image at their focus.

    Parameters
    ----------
    props : properties.HoloPathSettings
    hologram : engine.Hologram
    settings : engine.Settings
    origin : Origin
    """
    focus = "centre" if props.focus_auto else properties.focus_of(props)
    pupil, store = properties.pupil_or_none(props), preferences.store()
    return Request(hologram, settings, [focus], pupil, store, origin=origin)


def keep(task, result, draft=False):
    """Remember a finished render, or the draft of one."""
    field = result.field
    current.refocuser, current.draft = engine.Refocuser(field), draft
    current.task, current.made = task, result.plan
    keep_phase(None)
    current.rendered, current.pace = task.reading.name, math.inf
    current.in_view = pipeline.diopters_in_view(result.plan, field.camera, field.hologram)
    keep_plan(task, result.plan)
    if "bake" in field.report:
        current.bake, current.texture, current.baked = field.report["bake"], None, current.rendered


def keep_shown(props, task, result, draft=False):
    """`keep` a render and show it as the user looks by now; on the main thread.

    Parameters
    ----------
    props : properties.HoloPathSettings or None
        Of the scene, if it is still there.
    task : Task
    result : pipeline.Result
    draft : bool
        Whether there will be better.

    Returns
    -------
    bpy.types.Image
    """
    keep(task, result, draft)
    request = task.request
    focus = None if request.autofocus else request.focus[0]
    if props is not None and focus is None and props.focus_auto:
        properties.note_focus(props, result.focus[0])
        focus = properties.focus_of(props)
    image = bpy.data.images.get(IMAGE)
    if image is None or props is None or not _moved(props, (focus, request.pupil, request.hologram.optics)):
        return show(result.images[0], result.field.hologram.wavelengths)
    refocus_as_set(props)  # it was moved meanwhile
    return image


def _moved(props, rendered):
    """Whether focus, pupil and bench are others by now than a picture was rendered with."""
    try:
        focus, pupil, _, optics = properties.seen_of(props)
    except (engine.InvalidInput, engine.BackendUnavailable):  # which the panel says
        return False
    return (focus, pupil, optics) != rendered


def show_early(props, picture, task, draft=None):
    """Show a picture while its hologram is rendered; a draft is kept where it takes no whole hologram's place.

    Parameters
    ----------
    props : properties.HoloPathSettings or None
        See `keep_shown`.
    picture : numpy.ndarray, shape (y, x, 3)
    task : Task
    draft : pipeline.Result, optional
        What the picture is of.

    Returns
    -------
    bpy.types.Image
    """
    if draft is None or not (current.field is None or current.draft):
        return show_rgb(picture)
    image = keep_shown(props, task, draft, draft=True)
    redraw()
    return image


def keep_phase(phase):
    """Remember an encoded hologram, or that there is none of the field yet."""
    current.phase, current.phase_light = phase, None


def keep_plan(task, plan):
    """Remember what was decided for a scene, and what its export left out."""
    current.plan, current.scene = plan, task.reading.name
    current.notes, current.error = task.notes, ""


def rendered():
    """The `engine.Refocuser` of the last wave field rendered.

    Raises
    ------
    engine.InvalidInput
        If there is none yet.
    """
    if current.refocuser is None:
        raise engine.InvalidInput("There is no wave field yet: press Render Hologram first.")
    return current.refocuser


def encoded():
    """The `engine.PhaseHologram` of that field.

    Raises
    ------
    engine.InvalidInput
        If it is not encoded yet.
    """
    if current.phase is None:
        raise engine.InvalidInput("There is no hologram yet: press Encode first.")
    return current.phase


def plan_of(scene):
    """The last `engine.Plan`, if it is that scene's, else None."""
    return current.plan if scene.name == current.scene else None


def encoding_of(scene):
    """What *Encode* would do: of the field's scene, or before there is one of what was planned of the window's.

    Parameters
    ----------
    scene : bpy.types.Scene

    Returns
    -------
    engine.EncodingPlan or None
        None where nothing is planned yet.

    Raises
    ------
    engine.InvalidInput
    """
    props, along = properties.of(scene), 0
    field, task = current.field, current.task
    if field is not None and task is not None:
        plan = current.made
        along = 0 if field.more is None else len(field.more)
    else:
        plan, settings = plan_of(scene), properties.settings_of(props)
        plan = plan and replace(plan, requested=settings, settings=resolved(settings))
    if plan is None:
        return None
    seconds = properties.encode_seconds_of(props)
    return engine.plan_encoding(plan, props.encoding, seconds, along, properties.eyebox_of(props))


def keep_baked(task, texture, done):
    """Remember what was baked."""
    current.bake, current.texture, current.baked = dataclasses.asdict(done), texture, task.reading.name
    current.error = ""
    if current.baked == current.scene:
        current.notes = task.notes


def bake_of(scene):
    """The last `engine.baking.Bake`, if it is that scene's, else None."""
    return current.bake if scene.name == current.baked else None


def texture_of(scene):
    """Its picture, if there is one and it is that scene's, else None."""
    return current.texture if scene.name == current.baked else None


def fail(error):
    """Remember a failure; its sentence."""
    current.error = "" if failures.cancelled(error) else failures.sentence(error)
    return current.error


def leave(soon=False):
    """Take back what the running operator changed in the window, once; `soon` as in `take_back`."""
    undo, current.leave = current.leave, None
    if undo is not None:
        take_back(undo, soon)


def take_back(undo, soon):
    """Call `undo` now, or `soon`: when the operator's timer has fired once more.

    Blender lets go of an unregistered operator at the window's next event, and crashes where another one
    starts before.
    """
    if soon:
        bpy.app.timers.register(undo, first_interval=0.5)
    else:
        undo()


def end_timer(timer, soon=False):
    """Take an operator's timer away; `soon` as in `take_back`."""
    take_back(lambda: bpy.data.window_managers[0].event_timer_remove(timer), soon)


def running():
    """Whether a hologram is being rendered, or light baked."""
    return current.job is not None and current.job.running


def picture(image, wavelengths):
    """Rows of RGBA, bottom row first, as Blender's images and render passes take them.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, wavelength)
    wavelengths : sequence of float

    Returns
    -------
    numpy.ndarray, float32, shape (y, x, 4)
    """
    return rgba(engine.to_rgb(image, wavelengths))


def rgba(rgb):
    """Rows of a picture, array [y, x, 3], as Blender takes them: see `picture`."""
    return np.concatenate([rgb[::-1], np.ones_like(rgb[..., :1])], axis=-1)


def show(image, wavelengths):
    """Put a reconstruction into the image datablock; on the main thread.

    Returns
    -------
    bpy.types.Image
    """
    return shown(IMAGE, picture(image, wavelengths))


def show_rgb(rgb):
    """Put a picture, array [y, x, 3], in the reconstruction's place, see `show`."""
    return shown(IMAGE, rgba(rgb))


def show_phase(frame):
    """Put a frame of the encoded hologram into an image datablock of its own: a turn is white, see `show`."""
    phase = encoded()
    levels = np.moveaxis(phase.data[min(frame, len(phase.data) - 1)], 0, -1) / (2 * math.pi)
    return shown(PHASE, rgba(engine.to_rgb(levels, phase.hologram.wavelengths)), light=False)


def show_texture():
    """Put the picture of the baked light into an image datablock of its own, see `show`."""
    return shown(TEXTURE, rgba(current.texture))


def shown(name, pixels, light=True):
    """The image datablock of a name, with these rows of RGBA: light, or plain numbers."""
    height, width = pixels.shape[:2]
    block, other = bpy.data.images.get(name), None
    if block is not None and (block.source != "GENERATED" or not block.is_float):
        block.name = name + " (other)"
        other, block = block, None
    if block is None:
        block = bpy.data.images.new(name, width, height, alpha=False, float_buffer=True)
        # pyrefly: ignore[bad-assignment, missing-attribute]  # Blender's stubs know no names of spaces
        block.colorspace_settings.name = "Linear Rec.709" if light else "Non-Color"
        block.use_view_as_render = light
        _replace_in_editors(other, block)
    elif tuple(block.size) != (width, height):
        block.scale(width, height)
    # pyrefly: ignore[missing-attribute]  # in Blender's stubs an array of numbers is one
    block.pixels.foreach_set(pixels.ravel())
    block.update()
    return block


def _replace_in_editors(old, new):
    """Show another image where one is shown that is the user's own now, as it was saved."""
    if old is None:
        return
    for window in bpy.data.window_managers[0].windows:
        for area in window.screen.areas:
            space = area.spaces.active
            if isinstance(space, bpy.types.SpaceImageEditor) and space.image == old:
                space.image = new


def redraw(images=True):
    """Redraw the panels of every window, the pictures of Image Editors and the overlay of 3D Views.

    Parameters
    ----------
    images : bool
        Whether the pictures, the plan or the focus may have changed: else panels alone.
    """
    for window in bpy.data.window_managers[0].windows:
        for area in window.screen.areas:
            if area.type == "PROPERTIES":
                area.tag_redraw()
            elif area.type in {"VIEW_3D", "IMAGE_EDITOR"}:
                for region in area.regions:
                    if images or region.type == "UI":
                        region.tag_redraw()


def light_of(refocuser, modulator, optics):
    """`engine.Refocuser` of what a display makes of the encoded phases; the field's where none is given or encoded.

    Either is seen on the bench `optics`, whatever it was made for.
    """
    phase, kept = current.phase, current.phase_light  # another thread may render or encode meanwhile
    if modulator is None or phase is None:
        return refocuser if optics == refocuser.field.hologram.optics else refocuser.on(optics)
    if optics.lens != phase.hologram.optics.lens:
        raise engine.InvalidInput(
            "The hologram was encoded for another lens: render and encode it for this one, or set that one again."
        )
    if kept is None or kept[0] is not phase or kept[1:3] != (modulator, optics):
        light = replace(phase, hologram=replace(phase.hologram, optics=optics)).field(modulator)
        kept = current.phase_light = phase, modulator, optics, engine.Refocuser(light)
    return kept[3]


def refocus(focus, pupil, modulator, optics):
    """Refocus the stored field, or the encoded phases, now and show it.

    Parameters
    ----------
    focus : float
        Metres.
    pupil : engine.Pupil or None
    modulator : engine.Modulator or None
        Of the display that shows the phases; None: the field.
    optics : engine.Optics
        The bench.

    Returns
    -------
    bpy.types.Image

    Raises
    ------
    engine.InvalidInput
        If there is no field yet, the pupil misses its light, or the bench does not go with its pixels.
    """
    refocuser, started = rendered(), time.monotonic()
    image = light_of(refocuser, modulator, optics)([focus], pupil)[0]
    current.error, current.pace = "", time.monotonic() - started
    return show(image, refocuser.field.hologram.wavelengths)


def request_refocus(focus, pupil, modulator, optics):
    """`refocus`: at once where that is quick, else soon, in a thread.

    Requests made meanwhile replace each other.
    """
    if current.refocuser is None:
        return
    current.error = ""
    if bpy.app.background or (current.pace < AT_ONCE and not refocusing()):
        try:
            refocus(focus, pupil, modulator, optics)
        except Exception as error:
            fail(error)
        return
    current.wanted = (focus, pupil, modulator, optics)
    _start_refocus()
    if not bpy.app.timers.is_registered(_poll_refocus):
        bpy.app.timers.register(_poll_refocus, first_interval=0.01)


def refocusing():
    """Whether a picture that was requested is not shown yet."""
    return current.refocus is not None or current.wanted is not None


def stop_sweep(timer=None, soon=False):
    """End the focus that plays; with a timer, only if it is the one of that timer; `soon` as in `take_back`."""
    playing = current.sweep
    if playing is not None and timer in (None, playing):
        current.sweep = None
        end_timer(playing, soon)


def _start_refocus():
    """Begin with what is wanted, unless another picture is still in work."""
    if current.refocus is not None or current.wanted is None or current.refocuser is None:
        return
    (focus, pupil, modulator, optics), current.wanted = current.wanted, None
    refocuser = current.refocuser
    wavelengths = refocuser.field.hologram.wavelengths

    def refocus(progress):
        started = time.monotonic()
        image = light_of(refocuser, modulator, optics)([focus], pupil, progress)[0]
        return refocuser, picture(image, wavelengths), time.monotonic() - started

    current.refocus = Job(refocus)
    current.refocus.start()


def _poll_refocus():
    job = current.refocus
    if job is not None:
        if job.running:
            return 0.01
        current.refocus = None
        if job.error is not None:
            fail(job.error)
        else:
            refocuser, pixels, current.pace = job.result
            if refocuser is current.refocuser:  # else another field has been rendered since
                shown(IMAGE, pixels)
        redraw(images=False)  # the picture's own change has it drawn
    _start_refocus()
    return None if current.refocus is None else 0.01


def show_again():
    """Show the stored field's picture in place of what a cancelled render left; nothing where there is none."""
    scene = bpy.context.scene
    if current.refocuser is not None and IMAGE in bpy.data.images and scene is not None:
        refocus_as_set(properties.of(scene))


def progress_text(job):
    """How far a job is, in a few words: ``42% Wave tracing, 12 s left``, ``Compiling…`` before there is a share."""
    doing, left = "Compiling" if job.compiling else job.message, job.remaining
    if job.cancelling:
        return "Canceling…"
    if not job.done:
        return f"{doing}…"
    return f"{job.done:.0%} {doing}" + ("" if left is None else f", {math.ceil(left)} s left")


@bpy.app.handlers.persistent
def _stop(*_):
    """Another file is about to be opened: stop the work. What there is stays, as the file may be a broken one."""
    for job in (current.job, current.refocus):
        if job is not None:
            job.cancel()
            job.wait(5.0)
    leave()
    stop_sweep()


@bpy.app.handlers.persistent
def _forget(*_):
    """Another file is open: let go of the last file's field."""
    current.__dict__.update(vars(Session()))


@bpy.app.handlers.persistent
def _rendered(*_):
    """F12 has left a new field or an error; in a window it says so from a thread of its own."""
    if threading.current_thread() is threading.main_thread():
        _after_f12()
    else:
        bpy.app.timers.register(_after_f12)


def _after_f12():
    """Write down where F12 focused by itself, and show what there is."""
    metres, current.found = current.found, None
    scene = bpy.data.scenes.get(current.rendered)
    if metres is not None and scene is not None and properties.of(scene).focus_auto:
        properties.note_focus(properties.of(scene), metres)
    redraw()


def refocus_as_set(props):
    """`request_refocus` as settings say; where there is no such bench, the picture stays, and the failure is kept."""
    if current.refocuser is None:
        return
    try:
        seen = properties.seen_of(props)
    except (engine.InvalidInput, engine.BackendUnavailable) as error:
        fail(error)
        return
    request_refocus(*seen)


def _bench_changed(scene):
    refocus_as_set(properties.of(scene))


def _show_frame_as_set(props):
    if current.phase is not None:
        show_phase(props.phase_frame)


def handlers():
    """What listens to changed settings, to files being opened and to the end of F12's renders: see `registration`."""
    handlers = bpy.app.handlers
    return [
        (properties.looking_elsewhere, refocus_as_set),
        (bench_changed, _bench_changed),
        (properties.frame_chosen, _show_frame_as_set),
        (handlers.load_pre, _stop),
        (handlers.load_post, _forget),
        (handlers.render_complete, _rendered),
        (handlers.render_cancel, _rendered),
    ]


def detach():
    """Stop all work and forget everything."""
    if bpy.app.timers.is_registered(_poll_refocus):
        bpy.app.timers.unregister(_poll_refocus)
    leave(soon=True)
    stop_sweep(soon=True)
    _stop()
    _forget()
    cache.close()
