"""What this Blender session knows of devices: what streams, the controller, the virtual bench."""

import dataclasses
import threading
from dataclasses import dataclass

import bpy

from .. import engine, slm
from ..workflow import failures
from . import session
from .jobs import Job

CAMERA = "HoloPath Camera"
PATIENCE = 3.0  # seconds that a device is given to let go


@dataclass
class Devices:
    """State of the running Blender; nothing of it belongs to the .blend.

    Attributes
    ----------
    job : Job or None
        That streams, or streamed last.
    counts : slm.Counts or None
        Of the pictures, as the job last told.
    driver : slm.Driver or None
        That streams, or streamed last; a virtual one still has what it was shown.
    phase : engine.PhaseHologram or None
        That it shows.
    controller : slm.Controller or None
        Open, of focus and triggers.
    port : tuple
        Name and speed of its port, as they are set.
    error : str
        Last failure in one sentence; empty if there was none.
    timer : bpy.types.Timer or None
        Of the operator that watches the job.
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
    """Whether pictures are being shown."""
    return current.job is not None and current.job.running


def fail(error):
    """Remember a failure; its sentence."""
    current.error = "" if failures.cancelled(error) else failures.sentence(error)
    return current.error


def stream(driver, sequence, rate, loops, trigger, patience):
    """The work of showing a sequence, which is not begun yet.

    Parameters
    ----------
    driver : slm.Driver
    sequence : slm.Sequence
    rate : float or None
    loops : int or None
    trigger : callable or None
    patience : float
        See `slm.stream`.

    Returns
    -------
    Job
    """

    def work(progress):
        def told(counts):
            if current.job is job:  # else another file has been opened
                current.counts = dataclasses.replace(counts)
            progress((counts.shown + counts.dropped) / counts.total if counts.total else 0.0, str(counts))

        return slm.stream(sequence, driver, rate, loops, told, trigger, patience)

    current.driver, current.phase, current.counts, current.error = driver, sequence.holograms[0], None, ""
    job = current.job = Job(work)
    return job


def controller(port, baud):
    """The controller on a port: the device's own while it streams there, or one that stays open once it is used.

    Many controllers restart when their port is opened, and would forget where the focus is.

    Raises
    ------
    engine.InvalidInput
    """
    own = getattr(current.driver, "controller", None)
    if streaming() and own is not None and current.port == (port, baud):
        return own
    if current.controller is None or current.port != (port, baud):
        release()
        current.controller, current.port = slm.Controller(port or None, baud), (port, baud)
    return current.controller


def release():
    """Let go of the controller's port."""
    held, current.controller = current.controller, None
    if held is not None:
        held.close()


def show(picture, wavelengths):
    """Put a camera's picture into an image datablock of its own; on the main thread.

    Parameters
    ----------
    picture : numpy.ndarray, shape (y, x, wavelength)
        Linear.
    wavelengths : sequence of float

    Returns
    -------
    bpy.types.Image
    """
    return session.shown(CAMERA, session.picture(picture, wavelengths))


def load(path):
    """Put a picture file, which is then no longer needed, into the place of `show`.

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
    """Ask what streams to stop; wait at most so many seconds for it."""
    if current.job is not None:
        current.job.cancel()
        current.job.wait(wait)


def leave(soon=False):
    """Take the watching operator's timer away, once; `soon` as in `session.take_back`."""
    timer, current.timer = current.timer, None
    if timer is not None:
        session.end_timer(timer, soon)


@bpy.app.handlers.persistent
def _forget(*_):
    """Another file is about to be opened: stop, and let go of the devices."""
    stop(PATIENCE)
    leave()
    _let_go()


def _let_go():
    held = current.controller
    current.__dict__.update(vars(Devices()))
    if held is not None:
        threading.Thread(target=held.close, daemon=True).start()


def handlers():
    """What listens to files being opened: see `registration`."""
    return [(bpy.app.handlers.load_pre, _forget)]


def detach():
    """Stop all work and forget everything."""
    stop(PATIENCE)
    leave(soon=True)
    _let_go()
