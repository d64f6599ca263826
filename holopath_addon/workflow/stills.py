"""A requested still in its output folder. The command line writes one, an animation one per frame."""

import os
import shutil
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import engine
from ..engine.progress import Clock, Stages
from ..engine.settings.former_names import current_name, with_current_names
from . import output, pipeline
from .request import Outputs
from .writers import WRITERS, Still, write_field, write_phases

# Inputs of a still, by keys of its report: those that affect only its phases, those that do not affect its field, and
# names for the user.
_PHASES = {
    "encode",
    "encoding_bits",
    "encoding_levels",
    "encoding_display",
    "encode_seconds",
    "eyebox",
    "previous_phases",
}
_VIEW = {
    "requested_focus",
    "pupil_m",
    "compare_reference",
    "rgbd",
    "light_field",
    "quilt",
    "contact_sheet",
    *_PHASES,
}
_NAMES = {
    "scene_digest": "scene",
    "requested_focus": "focus",
    "pupil_m": "pupil",
    "compare_reference": "comparison with the reference",
    "encode": "encoding",
    "encoding_bits": "bits",
    "encoding_levels": "measured levels",
    "encoding_display": "fitted display",
    "encode_seconds": "time limit of the encoding",
    "eyebox": "eyebox",
    "previous_phases": "phases of the previous frame",
    "rgbd": "image with depth",
    "light_field": "light field",
    "quilt": "quilt",
    "contact_sheet": "contact sheet",
    "method": "light of all frames",
    "network": "function",
    "settings": "setting",
}


def write(
    folder, request, progress, export_seconds, rendered=None, encoded=None, stoppable=True
) -> tuple[pipeline.Result, dict]:
    """Render a still into a folder.

    Parameters
    ----------
    folder : path
        Empty, see `output.output_folder`.
    request : Request
    progress : callable
        ``progress(done, message)``, may raise `engine.Cancelled`.
    export_seconds : float
        Time that the export of the scene took, for the report.
    rendered : engine.WaveField, optional
        Field of the same scene and settings, see `pipeline.compute`.
    encoded : engine.PhaseHologram, optional
        Phases of that field, encoded as requested.
    stoppable : bool
        Whether a canceled encoding keeps its best phases, with a warning; otherwise everything is canceled.

    Returns
    -------
    pipeline.Result
    dict
        The report, as written.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled, OSError
    """
    start, clock = time.perf_counter(), Clock()
    with clock("export"):
        inputs = request.inputs
    encoding = request.encoding
    work = "files" + ", phases" * encoding.descends + ", extras" * (request.outputs != Outputs())
    stages = Stages(progress, work)
    result = pipeline.compute(request, stages["field"], rendered)
    rgb = engine.to_rgb(result.images, request.hologram.wavelengths)
    still = Still(Path(folder), request, result, rgb, output.exposure(rgb))
    stages["phases"](0.0, "Writing")
    with clock("files"):
        write_field(still)
    phase, notes = encoded, []
    if phase is None and encoding.is_requested:
        with clock("encoding"):
            phase, notes = _encode(request, result.field, stages["phases"], stoppable)
        result.field = replace(result.field, extra_frames=None)  # extra frames are only for the encoding
    if phase is not None:
        with clock("refocusing phases"):
            still, more_notes = _with_phases(still, phase, stages["images"])
        with clock("files"):
            write_phases(still)
        notes = [*notes, *more_notes]
    report = _report(still, inputs, notes)
    extras = Stages(stages["extras"], "extras")
    for writer in WRITERS:
        if writer.is_requested(still):
            with clock(writer.stage):
                entries = writer.write(still, extras[writer.stage])
            report |= {**entries, "warnings": [*report["warnings"], *entries.get("warnings", ())]}
    report["seconds"] = {
        **result.seconds,
        **clock.seconds,
        "export": export_seconds + clock.seconds["export"],
        "total": export_seconds + time.perf_counter() - start,
    }
    report |= {"job": request.origin.job} if request.origin.job else {}
    report |= {"method": request.method} if request.method else {}
    output.write_report(folder, {**report, "versions": output.versions(), "machine": output.machine()})
    return result, report


def _encode(request, field, progress, stoppable):
    """The requested phases, and notes for the user."""
    try:
        encoding, options = request.encoding, {}
        if encoding.previous is not None and encoding.previous.data.shape == field.data.shape:
            options["start"] = encoding.previous
        scene, settings, store = request.scene, request.settings, request.store
        phase = pipeline.encode(field, encoding, progress, scene, settings, store, **options)
        phase = replace(phase, report={**phase.report, "sha256": phase.digest})
        return phase, pipeline.encoding_notes(phase)
    except engine.Cancelled as error:
        if error.kept is None or not stoppable:
            raise
        return error.kept, ["The encoding was stopped: the phases are those of its last step."]


def _with_phases(still, phase, progress):
    """The still with its phases and the images that they show, and notes for the user."""
    request = still.request
    light = phase.field(display=request.encoding.display)
    images, notes = pipeline.reconstruct(light, still.result.focus, request.pupil, progress)
    rgb = engine.to_rgb(images, request.hologram.wavelengths)
    return replace(still, phase=phase, phase_images=images, phase_rgb=rgb), notes


def _report(still, inputs, notes):
    """Entries of the report that do not depend on further outputs."""
    origin, plan, result = still.request.origin, still.result.plan, still.result
    found = result.field.report
    report: dict[str, Any] = {
        "scene": origin.name,
        "scene_path": os.path.abspath(origin.name) if os.path.isfile(origin.name) else None,
        "scene_state": origin.scene_state,
        **inputs,
        "plan": plan.to_dict(),
        "focus_m": result.focus,
        "exposure_white": still.white,
        "rays": found.get("rays", {}),
        "spp": plan.rays_per_pixel,
        "variant": found.get("variant"),
        "field_seconds": found.get("seconds", {}),
        "bake": found.get("bake"),
        "estimated": found.get("estimated"),
        "warnings": list(dict.fromkeys([*plan.warnings, *pipeline.bake_notes(found.get("bake")), *notes])),
        "export_notes": origin.notes,
    }
    if still.phase is not None:
        report["encoding"] = {"method": still.phase.method, **still.phase.report}
    return report


def update(folder, request, progress, export_seconds, say) -> tuple[pipeline.Result | None, dict]:
    """Render a still into its output folder, except for what is already there.

    Parameters
    ----------
    folder : path
        Folder of an earlier `write`, or any that `output.output_folder` takes.
    request, progress, export_seconds :
        See `write`.
    say : callable
        ``say(text)`` receives a line on what was there.

    Returns
    -------
    pipeline.Result or None
        None if everything was there.
    dict
        The report.

    Raises
    ------
    engine.InvalidInput, engine.BackendUnavailable, engine.Cancelled, OSError
    """
    report, rendered, encoded = output.read_report(folder), None, None
    if report and _mapped(folder) is not None:
        changed = _changes(report, output.plain(request.inputs))
        if request.encoding.is_requested and not _PHASES & changed.keys():
            encoded = _load_phases(folder)
            if encoded is None:
                changed["encode"] = [_NAMES["encode"]]
        if not changed:
            if request.origin.job and report.get("job") != request.origin.job:
                report |= {"job": request.origin.job}
                output.replace_report(folder, report)
            say("done before, skipped")
            return None, report
        if changed.keys() <= _VIEW:
            rendered = load_field(folder)
        if rendered is None:
            encoded = None
        names = ", ".join(name for names in changed.values() for name in names)
        say(f"{'refocused' if rendered else 'rendered anew'} (changed: {names})")
    with output.output_folder(folder) as part:
        done = write(part, request, progress, export_seconds, rendered, encoded, stoppable=False)
        phases = Path(folder) / "hologram"
        if rendered is not None and not request.encoding.is_requested and phases.is_dir():
            shutil.copytree(phases, part / "hologram")  # by `holopath encode`, of the same field
        return done


def is_complete(folder, job, encode, previous=None):
    """Whether a still's output folder has everything that a job requests.

    Parameters
    ----------
    folder : path
    job : str
        See `Origin.job`.
    encode : str
        See `Encoding.method`.
    previous : path, optional
        Output folder of the previous frame, if the phases start from its phases; they are to be those of now.

    Returns
    -------
    bool
    """
    report = output.read_report(folder)
    if report.get("job") != job or _mapped(folder) is None:
        return False
    if previous is not None:
        before = _phases(previous)
        if before is None or report.get("previous_phases") != before.report.get("sha256"):
            return False
    return encode == "none" or _phases(folder) is not None


def load_field(folder):
    """Load an output folder's wave field into memory, because Windows does not replace mapped files.

    Parameters
    ----------
    folder : path

    Returns
    -------
    engine.WaveField or None
        None without a complete one.
    """
    field = _mapped(folder)
    return field and replace(field, data=np.array(field.data))


def _load_phases(folder):
    """The phases of an output folder in memory, see `_phases`."""
    phase = _phases(folder)
    return phase and replace(phase, data=np.array(phase.data))


def _phases(folder):
    """The finished phases of an output folder's render; None without them, or if `holopath encode` replaced them."""
    try:
        phase = engine.PhaseHologram.load(Path(folder) / "hologram")
    except engine.InvalidInput:
        return None
    entry = output.plain({"method": phase.method, **phase.report})
    is_own = entry == output.read_report(folder).get("encoding")
    return phase if is_own and not phase.report.get("stopped") else None


def _mapped(folder):
    """The memory-mapped wave field of an output folder; None without a complete one."""
    try:
        return engine.WaveField.load(Path(folder) / "wavefield")
    except engine.InvalidInput:
        return None


def _current_settings(values):
    """Settings of a report by their current names."""
    values = with_current_names("setting", values, tell=lambda text: None)
    return {k: current_name(k, v, lambda text: None) if isinstance(v, str) else v for k, v in values.items()}


def _changes(report, inputs):
    """Inputs that differ from the report's: readable names of the differences, by key."""
    changes = {}
    for key, value in inputs.items():
        old, name = report.get(key), _NAMES.get(key, key)
        if key == "settings" and old:  # of the previous version, too
            old = _current_settings(old)
        if old == value:
            continue
        changes[key] = [name]
        if isinstance(old, dict) and isinstance(value, dict):
            parts = [f"{name} {k.replace('_', ' ')}" for k in value if old.get(k) != value[k]]
            changes[key] = parts or [name]
    return changes
