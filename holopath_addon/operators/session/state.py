"""State of this Blender session: the running job, the last results and the picture being refocused."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ... import engine
from ...workflow import failures
from ...workflow.request import Encoding
from ..jobs import Job
from .tasks import Task


@dataclass
class Session:
    """State of the running Blender, of which nothing is saved in the .blend.

    Attributes
    ----------
    job : Job or None
        Work under way: a render, a bake, an encoding, an estimate or a file being written.
    restore_window : callable or None
        Takes back what the running operator changed in the window, see `running_job.restore_window`.
    error : str
        Last failure in one sentence; empty without one.
    refocuser : engine.Refocuser or None
        Refocuses the last rendered wave field.
    task : Task or None
        Task of that field.
    field_plan : engine.Plan or None
        Plan of that field.
    field_scene : str
        Name of that field's scene.
    draft : bool
        Whether that field is a draft, kept until there is a better one.
    autofocus_distance : float or None
        Distance, meters, at which automatic focusing found the last picture of F12, until it is written down.
    diopter_range : tuple of float
        Inverse distances, 1/m, of the nearest and the farthest thing in that field's view.
    phase : engine.PhaseHologram or None
        Phases encoded of that field.
    phase_encoding : workflow.request.Encoding or None
        What they were encoded for, such as the display's measured levels; None: unknown.
    shown_frame : int
        Frame of those phases whose image was shown last.
    phase_light : tuple, or None
        `engine.PhaseHologram`, `Encoding`, `engine.Modulator` and `engine.Optics`, and last the `engine.Refocuser` of
        the light of those phases on a display with these limits, on this bench.
    plan : engine.Plan or None
        Last plan.
    plan_scene : str
        Name of the scene of the last plan and of the notes.
    notes : list of str
        Features that the exporter approximated or left out.
    bake : dict or None
        Last `engine.baking.Bake`.
    texture : numpy.ndarray or None
        Image of that bake; None if a render baked it.
    bake_scene : str
        Name of that bake's scene.
    refocus_job : Job or None
        Picture being refocused.
    refocus_request : tuple or None
        Arguments of the picture to refocus next, see `properties.reconstruction_of`.
    refocused : tuple or None
        Arguments of the picture requested last.
    refocus_seconds : float
        Duration of the last refocusing of that field.
    sweep_timer : bpy.types.Timer or None
        Timer of *Play Focus*.
    """

    job: Job | None = None
    restore_window: Callable[[], None] | None = None
    error: str = ""
    refocuser: engine.Refocuser | None = None
    task: Task | None = None
    field_plan: engine.Plan | None = None
    field_scene: str = ""
    draft: bool = False
    autofocus_distance: float | None = None
    diopter_range: tuple = (0.0, 0.0)
    phase: engine.PhaseHologram | None = None
    phase_encoding: Encoding | None = None
    shown_frame: int = 0
    phase_light: tuple | None = None
    plan: engine.Plan | None = None
    plan_scene: str = ""
    notes: list = dataclasses.field(default_factory=list)
    bake: dict | None = None
    texture: np.ndarray | None = None
    bake_scene: str = ""
    refocus_job: Job | None = None
    refocus_request: tuple | None = None
    refocused: tuple | None = None
    refocus_seconds: float = math.inf
    sweep_timer: bpy.types.Timer | None = None

    @property
    def field(self):
        """Last rendered `engine.WaveField`, or None."""
        return None if self.refocuser is None else self.refocuser.field


current = Session()


def forget_all():
    """Reset the state. Stops nothing."""
    current.__dict__.update(vars(Session()))


def record_error(error, state=None):
    """Keep a failure for the panels.

    Parameters
    ----------
    error : BaseException
    state : Session or devices.Devices, optional
        Whose failure it is. Default: the session's.

    Returns
    -------
    str
        Its sentence; empty for a cancellation.
    """
    state = current if state is None else state
    state.error = "" if failures.cancelled(error) else failures.sentence(error)
    return state.error
