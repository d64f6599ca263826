"""State of the devices in this Blender session: the stream, the controller and the virtual bench."""

import dataclasses
import threading
from dataclasses import dataclass

import bpy

from .. import engine, slm
from . import session
from .jobs import Job

CAMERA = "HoloPath Camera"
RELEASE_TIMEOUT = 3.0  # seconds to wait for a device to stop


@dataclass
class Devices:
    """State of the running Blender, of which nothing is saved in the .blend.

    Attributes
    ----------
    job : Job or None
        Current or last stream.
    counts : slm.Counts or None
        Counts of its pictures at its last report.
    driver : slm.Driver or None
        Its driver; a virtual one still has the last picture.
    phase : engine.PhaseHologram or None
        Its hologram.
    controller : slm.Controller or None
        Open controller of focus and triggers.
    port : tuple
        Name and baud rate of the controller's port, as set.
    error : str
        Last failure in one sentence; empty without one.
    timer : bpy.types.Timer or None
        Timer of the operator that watches the stream.
    """

    job: Job | None = None
    counts: slm.Counts | None = None
    driver: slm.Driver | None = None
    phase: engine.PhaseHologram | None = None
    controller: slm.Controller | None = None
    port: tuple = ()
    error: str = ""
    timer: bpy.types.Timer | None = None


current = Devices()


def streaming():
    """Whether a stream is running."""
    return current.job is not None and current.job.running


def stream(driver, sequence, rate, loops, trigger, patience):
    """Prepare a stream.

    Parameters
    ----------
    driver : slm.Driver
    sequence : slm.Sequence
    rate, loops, trigger, patience
        As in `slm.stream`.

    Returns
    -------
    Job
        Not started yet.
    """

    def work(progress):
        def on_progress(counts):
            if current.job is job:  # otherwise another file was opened
                current.counts = dataclasses.replace(counts)
            progress((counts.shown + counts.dropped) / counts.total if counts.total else 0.0, str(counts))

        return slm.stream(sequence, driver, rate, loops, on_progress, trigger, patience)

    current.driver, current.phase, current.counts, current.error = driver, sequence.holograms[0], None, ""
    job = current.job = Job(work)
    return job


def controller(port, baud):
    """Controller on a port: that of the stream if it uses the port, or one that stays open.

    Many controllers restart when their port is opened, and would lose the position of the focus.

    Parameters
    ----------
    port : str
        Name of the serial port; empty: the only one.
    baud : int
        Baud rate.

    Returns
    -------
    slm.Controller

    Raises
    ------
    engine.InvalidInput
        If the port cannot be opened, or no controller answers.
    """
    own = getattr(current.driver, "controller", None)
    if streaming() and own is not None and current.port == (port, baud):
        return own
    if current.controller is None or current.port != (port, baud):
        release()
        current.controller, current.port = slm.Controller(port or None, baud), (port, baud)
    return current.controller


def release():
    """Close the controller's port."""
    controller, current.controller = current.controller, None
    if controller is not None:
        controller.close()


def load(path):
    """Load an image file into the datablock of camera images, packed: the file may be deleted.

    Parameters
    ----------
    path : path

    Returns
    -------
    bpy.types.Image

    Raises
    ------
    engine.InvalidInput
        If Blender cannot read it.
    """
    image, old = bpy.data.images.load(str(path)), bpy.data.images.get(CAMERA)
    if not all(image.size):
        bpy.data.images.remove(image)
        raise engine.InvalidInput(
            f"The camera's picture {path} cannot be read: have it written as PNG, TIFF or EXR."
        )
    image.pack()
    if old is not None:
        old.user_remap(image)
        bpy.data.images.remove(old)
    image.name = CAMERA
    return image


def stop(wait=0.0):
    """Stop the stream, and wait for at most some seconds for its end."""
    if current.job is not None:
        current.job.cancel()
        current.job.wait(wait)


def end_watching(deferred=False):
    """Remove the watching operator's timer, once; `deferred` as in `session.end_timer`."""
    timer, current.timer = current.timer, None
    if timer is not None:
        session.end_timer(timer, deferred)


@bpy.app.handlers.persistent
def _forget(*_):
    """Stop, and free the devices, before another file is opened."""
    stop(RELEASE_TIMEOUT)
    end_watching()
    _free_devices()


def _free_devices():
    controller = current.controller
    current.__dict__.update(vars(Devices()))
    if controller is not None:
        threading.Thread(target=controller.close, daemon=True).start()


def handlers():
    """Callback for opened files, see `session.handlers`."""
    return [(bpy.app.handlers.load_pre, _forget)]


def detach():
    """Stop all work and free everything."""
    stop(RELEASE_TIMEOUT)
    end_watching(deferred=True)
    _free_devices()
