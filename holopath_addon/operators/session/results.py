"""The last results: wave field, phases, plan and baked light."""

import dataclasses
import math
from dataclasses import replace

from ... import engine
from ...blender import properties
from ...engine.planning.planner import resolved
from ...workflow import pipeline
from .state import current


def keep(task, result, draft=False):
    """Keep a render in place of the last one.

    Parameters
    ----------
    task : Task
    result : pipeline.Result
    draft : bool
        Whether a better result will follow.
    """
    field = result.field
    current.refocuser, current.draft = engine.Refocuser(field), draft
    current.task, current.field_plan = task, result.plan
    keep_phase(None)
    current.field_scene, current.refocus_seconds = task.reading.name, math.inf
    current.refocused = None
    current.diopter_range = pipeline.diopters_in_view(result.plan, field.camera, field.hologram)
    keep_plan(task, result.plan)
    if "bake" in field.report:
        current.bake, current.texture, current.bake_scene = field.report["bake"], None, current.field_scene


def keep_phase(phase, encoding=None):
    """Keep the phases of the last field.

    Parameters
    ----------
    phase : engine.PhaseHologram or None
        None: it is not encoded yet.
    encoding : workflow.request.Encoding, optional
        What they were encoded for; by its display, or its levels, they are shown.
    """
    current.phase, current.phase_encoding, current.phase_light = phase, encoding, None


def keep_plan(task, plan):
    """Keep the `engine.Plan` of a `Task`, and the notes of the task's export."""
    current.plan, current.plan_scene = plan, task.reading.name
    current.notes, current.error = task.notes, ""


def keep_bake(task, texture, bake):
    """Keep baked light.

    Parameters
    ----------
    task : Task
    texture : numpy.ndarray, shape (y, x, 3)
        Image of the light.
    bake : engine.baking.Bake
    """
    current.bake, current.texture, current.bake_scene = dataclasses.asdict(bake), texture, task.reading.name
    current.error = ""
    if current.bake_scene == current.plan_scene:
        current.notes = task.notes


def stored_refocuser():
    """The `engine.Refocuser` of the last rendered wave field.

    Raises
    ------
    engine.InvalidInput
        If nothing was rendered.
    """
    if current.refocuser is None:
        raise engine.InvalidInput("There is no wave field yet: press Render Hologram first.")
    return current.refocuser


def encoded_hologram():
    """The `engine.PhaseHologram` of that field.

    Raises
    ------
    engine.InvalidInput
        If the field was not encoded.
    """
    if current.phase is None:
        raise engine.InvalidInput("There is no hologram yet: press Encode first.")
    return current.phase


def plan_of(scene):
    """The last `engine.Plan` if it belongs to a `bpy.types.Scene`, else None."""
    return current.plan if scene.name == current.plan_scene else None


def bake_of(scene):
    """The last `engine.baking.Bake`, as a dict, if it belongs to a `bpy.types.Scene`, else None."""
    return current.bake if scene.name == current.bake_scene else None


def texture_of(scene):
    """Image of that bake, shape (y, x, 3), if there is one and it belongs to a `bpy.types.Scene`, else None."""
    return current.texture if scene.name == current.bake_scene else None


def encoding_of(scene):
    """Plan of *Encode*: for the last field, or without one for the last plan of the window's scene.

    Parameters
    ----------
    scene : bpy.types.Scene

    Returns
    -------
    engine.EncodingPlan or None
        None without a plan.

    Raises
    ------
    engine.InvalidInput
        If the settings contradict each other.
    """
    props, extra_frames = properties.of(scene), 0
    field, task = current.field, current.task
    if field is not None and task is not None:
        plan = current.field_plan
        extra_frames = 0 if field.extra_frames is None else len(field.extra_frames)
    else:
        plan, settings = plan_of(scene), properties.settings_of(props)
        plan = plan and replace(plan, requested=settings, settings=resolved(settings))
    if plan is None:
        return None
    seconds = properties.encode_seconds_of(props)
    return engine.plan_encoding(plan, props.encoding, seconds, extra_frames, properties.eyebox_of(props))
