"""Refocusing: the picture of the last field follows focus, pupil and bench of the settings."""

import time
from dataclasses import replace

import bpy

from ... import engine
from ...blender import properties
from ..jobs import Job
from .images import IMAGE, redraw, show, show_rgb, to_rgba, write_image
from .results import keep, stored_refocuser
from .running_job import end_timer
from .state import current, record_error

# Maximum duration, in seconds, of a refocusing done on the main thread: a redraw then shows slider and picture
# together, and a thread would take much longer.
MAX_DIRECT_SECONDS = 0.3


def refocus(focus, pupil, modulator, optics):
    """Refocus the last field, or its encoded phases, now and show the picture.

    Parameters
    ----------
    focus : float
        Distance, meters.
    pupil : engine.Pupil or None
        None: the whole pupil.
    modulator : engine.Modulator or None
        Limits of the display that shows the phases; None: the field itself.
    optics : engine.Optics
        Bench.

    Returns
    -------
    bpy.types.Image

    Raises
    ------
    engine.InvalidInput
        If there is no field, no light passes the pupil, or the bench does not fit the field's pixels.
    """
    refocuser, started = stored_refocuser(), time.monotonic()
    image = refocuser_for(refocuser, modulator, optics)([focus], pupil)[0]
    current.error, current.refocus_seconds = "", time.monotonic() - started
    return show(image, refocuser.field.hologram.wavelengths)


def refocuser_for(refocuser, modulator, optics):
    """Refocuser of the light on a bench: of the encoded phases on a display, or else of the field.

    Parameters
    ----------
    refocuser : engine.Refocuser
        Refocuser of the field.
    modulator : engine.Modulator or None
        Limits of the display; None: the field.
    optics : engine.Optics
        Bench, which may differ from the one that field and phases were made for.

    Returns
    -------
    engine.Refocuser

    Raises
    ------
    engine.InvalidInput
        If the phases were encoded for another lens, or for a fitted display and the bench is another.
    """
    # another thread may render or encode meanwhile
    phase, encoding, kept = current.phase, current.phase_encoding, current.phase_light
    if modulator is None or phase is None:
        return refocuser if optics == refocuser.field.hologram.optics else refocuser.on(optics)
    if optics.lens != phase.hologram.optics.lens:
        raise engine.InvalidInput(
            "The hologram was encoded for another lens: render and encode it for this one, or set that one again."
        )
    if kept is None or kept[0] is not phase or kept[1] is not encoding or kept[2:4] != (modulator, optics):
        on_bench = replace(phase, hologram=replace(phase.hologram, optics=optics))
        light = _shown(on_bench, modulator, encoding)
        kept = current.phase_light = phase, encoding, modulator, optics, engine.Refocuser(light)
    return kept[4]


def _shown(phase, modulator, encoding):
    """Field of phases on the display that they were encoded for, which `modulator` limits unless it was measured."""
    if encoding is None or (encoding.display is None and encoding.levels is None):
        return phase.field(modulator)
    if encoding.display is not None and not phase.hologram.flat_bench:
        raise engine.InvalidInput(
            "The hologram was encoded for a fitted display, which has a beam and a stop of its own: set the bench "
            "back, or encode again without it."
        )
    if encoding.display is not None:  # it has its own levels, pixels and crosstalk
        return phase.field(display=encoding.display)
    return phase.field(replace(modulator, bits=None), levels=encoding.levels)


def refocus_by_settings(props):
    """Request the picture that the settings describe; see `request_refocus`.

    If there is no such bench the picture stays, and the failure is recorded.

    Parameters
    ----------
    props : properties.HoloPathSettings
    """
    if current.refocuser is None:
        return
    try:
        arguments = properties.reconstruction_of(props)
    except (engine.InvalidInput, engine.BackendUnavailable) as error:
        current.refocused = None
        record_error(error)
        return
    request_refocus(*arguments)


def refocus_if_changed(props):
    """Call `refocus_by_settings`, unless the last picture was requested with the same settings."""
    try:
        changed = properties.reconstruction_of(props) != current.refocused
    except (engine.InvalidInput, engine.BackendUnavailable):
        changed = True  # which then says why
    if changed:
        refocus_by_settings(props)


def request_refocus(focus, pupil, modulator, optics):
    """`refocus` at once if that is quick, else soon in a thread; a new request replaces a waiting one.

    Parameters
    ----------
    focus, pupil, modulator, optics
        As in `refocus`.
    """
    if current.refocuser is None:
        return
    current.error, current.refocused = "", (focus, pupil, modulator, optics)
    if bpy.app.background or (current.refocus_seconds < MAX_DIRECT_SECONDS and not is_refocusing()):
        try:
            refocus(focus, pupil, modulator, optics)
        except Exception as error:
            record_error(error)
        return
    current.refocus_request = (focus, pupil, modulator, optics)
    _start_refocus()
    if not bpy.app.timers.is_registered(_poll_refocus):
        bpy.app.timers.register(_poll_refocus, first_interval=0.01)


def is_refocusing():
    """Whether a requested picture is not shown yet."""
    return current.refocus_job is not None or current.refocus_request is not None


def _start_refocus():
    """Start the requested picture, unless another one is being refocused."""
    if current.refocus_job is not None or current.refocus_request is None or current.refocuser is None:
        return
    (focus, pupil, modulator, optics), current.refocus_request = current.refocus_request, None
    refocuser = current.refocuser
    wavelengths = refocuser.field.hologram.wavelengths

    def work(progress):
        started = time.monotonic()
        image = refocuser_for(refocuser, modulator, optics)([focus], pupil, progress)[0]
        return refocuser, to_rgba(image, wavelengths), time.monotonic() - started

    current.refocus_job = Job(work)
    current.refocus_job.start()


def _poll_refocus():
    """Show a finished picture and start the next one; as a timer."""
    job = current.refocus_job
    if job is not None:
        if job.running:
            return 0.01
        current.refocus_job = None
        if job.error is not None:
            record_error(job.error)
        else:
            refocuser, pixels, current.refocus_seconds = job.result
            if refocuser is current.refocuser:  # otherwise another field has been rendered
                write_image(IMAGE, pixels)
        redraw(images=False)  # the changed image redraws its editor
    _start_refocus()
    return None if current.refocus_job is None else 0.01


def stop_polling():
    """Stop the timer of waiting requests."""
    if bpy.app.timers.is_registered(_poll_refocus):
        bpy.app.timers.unregister(_poll_refocus)


def stop_sweep(timer=None, deferred=False):
    """Stop *Play Focus*.

    Parameters
    ----------
    timer : bpy.types.Timer, optional
        Stop it only if it has this timer.
    deferred : bool
        See `running_job.undo_window_change`.
    """
    playing = current.sweep_timer
    if playing is not None and timer in (None, playing):
        current.sweep_timer = None
        end_timer(playing, deferred)


def keep_and_show(props, task, result, draft=False):
    """Keep a render and show it with the focus, pupil and bench of the settings by now; on the main thread.

    Parameters
    ----------
    props : properties.HoloPathSettings or None
        Settings of the scene; None if it was deleted.
    task : Task
    result : pipeline.Result
    draft : bool
        Whether a better result will follow.

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
    if image is None or props is None or not _differs(props, (focus, request.pupil, request.hologram.optics)):
        return show(result.images[0], result.field.hologram.wavelengths)
    refocus_by_settings(props)  # the user changed them during the render
    return image


def _differs(props, rendered):
    """Whether the settings have another focus, pupil or bench than a picture was rendered with."""
    try:
        focus, pupil, _, optics = properties.reconstruction_of(props)
    except (engine.InvalidInput, engine.BackendUnavailable):  # which the panel says
        return False
    return (focus, pupil, optics) != rendered


def show_preview(props, image, task, draft=None):
    """Show a preview while its hologram is rendered. A draft is kept, unless a whole hologram is there already.

    Parameters
    ----------
    props : properties.HoloPathSettings or None
        See `keep_and_show`.
    image : numpy.ndarray, shape (y, x, 3)
    task : Task
    draft : pipeline.Result, optional
        Draft that the image shows.

    Returns
    -------
    bpy.types.Image
    """
    if draft is None or not (current.field is None or current.draft):
        return show_rgb(image)
    block = keep_and_show(props, task, draft, draft=True)
    redraw()
    return block


def restore_picture():
    """Show the last field again in place of the preview of a canceled render. Does nothing without a field."""
    scene = bpy.context.scene
    if current.refocuser is not None and IMAGE in bpy.data.images and scene is not None:
        refocus_by_settings(properties.of(scene))
