"""What is requested of a still, in its output folder: the command line writes one, an animation one a frame. Imports
no bpy.
"""

import math
import os
import shutil
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import engine
from ..engine.mapping import squared
from ..engine.pixels import coarsest
from ..engine.progress import Clock, Stages
from ..engine.settings import current
from ..engine.viewing import assessment
from ..engine.viewing.depth import image_depth_map
from ..engine.viewing.light_field import pinhole_pictures, pupil_points, pupil_row, quilt
from . import output, pipeline
from .lengths import format_distance
from .request import Outputs

VIEW_PATHS = 64  # a pixel, of each view of a light field
SHEET_PATHS = 16  # and of the thin lens's picture on a contact sheet
NOISY = 0.2  # dB of uncertainty that a user is warned of

# Of what a still is asked: what the wave field does not depend on, and names for the user.
_PHASES = {
    "encoded",
    "encoding_bits",
    "encoding_levels",
    "encoding_display",
    "encode_seconds",
    "eyebox",
    "phases_before",
}
_VIEW = {"focus_asked", "pupil_m", "compared", "rgbd", "light_field", "quilt", "contact_sheet", *_PHASES}
_NAMES = {
    "scene_digest": "scene",
    "focus_asked": "focus",
    "pupil_m": "pupil",
    "compared": "comparison with the reference",
    "encoded": "encoding",
    "encoding_bits": "bits",
    "encoding_levels": "measured levels",
    "encoding_display": "fitted display",
    "encode_seconds": "seconds of the encoding",
    "eyebox": "eyebox",
    "phases_before": "phases of the frame before",
    "rgbd": "picture with depth",
    "light_field": "light field",
    "quilt": "quilt",
    "contact_sheet": "contact sheet",
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
        What its export took, for the report.
    rendered : engine.WaveField, optional
        Of the same scene and settings, see `pipeline.compute`.
    encoded : engine.PhaseHologram, optional
        Of that field, as it is asked for.
    stoppable : bool
        Whether phases that the user did not wait for are kept as they are, with a warning; else all is cancelled.

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
        asked = request.inputs
    encoding, outputs, origin = request.encoding, request.outputs, request.origin
    work = "files" + ", phases" * encoding.descends + ", extras" * (outputs != Outputs())
    stages = Stages(progress, work)
    extras = Stages(stages["extras"], "extras")
    result = pipeline.compute(request, stages["field"], rendered)
    wavelengths = request.hologram.wavelengths
    rgb = engine.to_rgb(result.images, wavelengths)
    white = output.exposure(rgb)
    stages["phases"](0.0, "Writing")
    with clock("files"):
        result.field.save(folder / "wavefield")
        output.write_pictures(
            folder / "reconstruction", output.picture_files(rgb, result.focus, white, request.pupil)
        )
    phase, told = encoded, []
    if phase is None and encoding.is_requested:
        with clock("encoding"):
            phase, told = _encode(request, result.field, stages["phases"], stoppable)
        result.field = replace(result.field, more=None)  # which has done what it was for
    seen, shown = rgb, None
    if phase is not None:
        with clock("refocusing phases"):
            light = phase.field(display=encoding.display)
            shown, notes = pipeline.reconstruct(light, result.focus, request.pupil, stages["images"])
            told = [*told, *notes]
            seen = engine.to_rgb(shown, wavelengths)
        with clock("files"):
            phase.save(folder / "hologram")
            files = output.picture_files(seen, result.focus, white, request.pupil)
            output.write_pictures(folder / "reconstruction", output.of_phases(files))
    bake = result.field.report.get("bake")
    notes = list(dict.fromkeys([*result.plan.warnings, *pipeline.bake_notes(bake), *told]))
    report = {
        "scene": origin.name,
        "scene_path": os.path.abspath(origin.name) if os.path.isfile(origin.name) else None,
        "opened": origin.opened,
        **asked,
        "plan": result.plan.to_dict(),
        "focus_m": result.focus,
        "exposure_white": white,
        "rays": result.field.report.get("rays", {}),
        "spp": result.plan.rays_per_pixel,
        "variant": result.field.report.get("variant"),
        "field_seconds": result.field.report.get("seconds", {}),
        "bake": bake,
        "foretold": result.field.report.get("foretold"),
        "warnings": notes,
        "export_notes": origin.notes,
    }
    if phase is not None:
        report["encoding"] = {"method": phase.method, **phase.report}
    stopped = phase is not None and phase.report.get("stopped")
    if outputs.reference and not stopped:
        with clock("reference"):
            rows = _compare(folder, request, result, extras["reference"], shown)
        dark = [
            format_distance(depth) for depth in result.focus if depth not in {row["focus_m"] for row in rows}
        ]
        black = (
            [f"The reference is black, focused at {', '.join(dark)} m: nothing is compared."] if dark else []
        )
        report |= {"comparison": rows, "warnings": [*notes, *black, *_noise_notes(rows)]}
    if outputs.rgbd:
        with clock("rgbd"):
            _write_rgbd(folder / "rgbd", request, result, white, extras["rgbd"])
    if outputs.light_field:
        with clock("light field"):
            _write_light_field(folder / "light_field", request, result, extras["light field"])
    if outputs.quilt:
        with clock("quilt"):
            _write_quilt(folder / "quilt", request, result, extras["quilt"])
    if outputs.contact_sheet and not stopped:
        with clock("contact sheet"):
            _write_sheet(
                folder / outputs.contact_sheet, request, result, seen, phase, extras["contact sheet"]
            )
    report["seconds"] = {
        **result.seconds,
        **clock.seconds,
        "export": export_seconds + clock.seconds["export"],
        "total": export_seconds + time.perf_counter() - start,
    }
    report |= {"job": origin.job} if origin.job else {}
    report |= {"method": request.method} if request.method else {}
    output.write_report(folder, {**report, "versions": output.versions()})
    return result, report


def _encode(request, field, progress, stoppable):
    """The phases that are asked for, and what to know of them."""
    try:
        encoding, options = request.encoding, {}
        if encoding.before is not None:
            before = engine.PhaseHologram.load(encoding.before)
            if before.data.shape == field.data.shape:
                options["start"] = before
        scene, settings, store = request.scene, request.settings, request.store
        phase = pipeline.encode(field, encoding, progress, scene, settings, store, **options)
        advice, own = phase.report["plan"]["advice"], phase.report.get("advice")
        return phase, [f"{advice} See --encode-seconds."] * bool(advice) + [own] * bool(own)
    except engine.Cancelled as error:
        if error.kept is None or not stoppable:
            raise
        return error.kept, ["The encoding was stopped: the phases are those of its last step."]


def _noise_notes(rows):
    """What a user must know of comparisons that the reference's noise makes uncertain."""
    worst = max((row["psnr_deviation_db"] for row in rows), default=0.0)
    if worst <= NOISY:
        return []
    return [
        f"The reference is noisy: a PSNR of this comparison is uncertain by {worst:.2g} dB. "
        "Small lamps behind glass or corners make most of such noise."
        if math.isfinite(worst)
        else "The reference is too noisy to tell the PSNR of this comparison."
    ]


def _compare(folder, request, result, progress, shown=None):
    """References of the pictures, into the folder, and rows of PSNR and SSIM by them.

    The border that light from outside the view reaches is left out. PSNR also against what light through the pupil
    shows at best, see `engine.diffracted`. Where there are phases, `shown` are their pictures, which are compared, too.
    """
    hologram, plan, mapping, pupil = result.field.hologram, result.plan, result.field.mapping, request.pupil
    picture = hologram.picture
    truth = engine.reference(
        request.scene,
        request.camera,
        hologram,
        result.focus,
        pupil,
        near=result.field.near,
        max_depth=request.max_depth,
        progress=progress,
        halves=True,
    )
    truth_rgb = engine.to_rgb(truth.mean(1), hologram.wavelengths)
    files = output.picture_files(truth_rgb, result.focus, output.exposure(truth_rgb), request.pupil)
    output.write_pictures(folder / "reference", files)
    radii = [mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]
    openings = [
        0.5
        * picture.pitch
        / coarsest(picture.pitch_at(w))
        * (min(1.0, pupil.diameter / (2 * r)) if pupil else 1)
        for w, r in zip(hologram.wavelengths, radii, strict=True)
    ]
    slope = hologram.widest_slope
    rows = []
    of_phases = [None] * len(result.focus) if shown is None else shown
    for depth, image, light, halves in zip(result.focus, result.images, of_phases, truth, strict=True):
        z = float(mapping.depth_to_z(depth))
        border = math.ceil(slope * max(abs(z - plan.z_low), abs(z - plan.z_high)) / picture.pitch_x)
        border = max(0, min(border, (min(picture.width, picture.height) - 12) // 2))
        inner = slice(border, -border or None)
        if not (halves.mean(0)[inner, inner] > 0).any():
            continue
        if pupil is not None:
            image = assessment.even(result.field, image, pupil)
            light = light if light is None else assessment.even(result.field, light, pupil)
        perfect = engine.diffracted(halves, hologram, openings)
        row = {
            "focus_m": depth,
            "psnr_db": engine.psnr(image, halves, border),
            "psnr_deviation_db": engine.psnr_deviation(image, halves, border),
            "psnr_of_diffracted_db": engine.psnr(image, perfect, border),
            "psnr_ceiling_db": engine.psnr_of_halves(perfect, halves, border),
            "ssim": engine.ssim(image, halves, border),
            "border_pixels": border,
        }
        if light is not None:
            row["phases_psnr_db"] = engine.psnr(light, halves, border)
            row["phases_ssim"] = engine.ssim(light, halves, border)
        rows.append(row)
    return rows


def _write_sheet(path, request, result, pictures, phase, progress):
    """The contact sheet: phases of the first frame in the middle wavelength, pictures, and one through a thin lens."""
    hologram, depth = result.field.hologram, result.focus[output.middle(result.focus)]
    lens = engine.reference(
        request.scene,
        request.camera,
        hologram,
        [depth],
        request.pupil,
        SHEET_PATHS,
        result.field.near,
        request.max_depth,
        progress,
    )
    rgb = engine.to_rgb(lens[0], hologram.wavelengths)
    phases = None if phase is None else phase.data[0, phase.data.shape[1] // 2]
    path.write_bytes(output.contact_sheet(pictures, rgb, phases))


def _write_rgbd(folder, request, result, white, progress):
    """The picture of a pinhole, the depth of the first surfaces, and that of what they show."""
    hologram = request.hologram
    camera, grid = squared(request.camera, hologram)
    size = grid.width, grid.height
    picture = pinhole_pictures(
        request.scene,
        request.camera,
        hologram,
        [(0.0, 0.0)],
        max_depth=request.max_depth,
        progress=progress,
    )
    rgb = engine.to_rgb(picture[0], hologram.wavelengths)
    folder.mkdir()
    (folder / "rgb.exr").write_bytes(output.encode_exr(rgb))
    (folder / "rgb.png").write_bytes(output.encode_png(rgb, white))
    np.save(folder / "depth.npy", image_depth_map(request.scene, camera, result.plan, *size))
    np.save(folder / "surface_depth.npy", engine.depth_map(request.scene, camera, *size))


def _write_light_field(folder, request, result, progress):
    """Pictures through a grid of points of the pupil, and where these are."""
    count = request.outputs.light_field
    points = pupil_points(count, request.hologram, result.field.mapping, request.pupil)
    rgb = _views(request, points.reshape(-1, 2), progress)
    folder.mkdir()
    np.save(folder / "views.npy", rgb.reshape(count, count, *rgb.shape[1:]))
    np.save(folder / "points.npy", points)


def _write_quilt(folder, request, result, progress):
    """Pictures through points along the pupil as one, which its name describes; the display lies at the first focus."""
    hologram, (columns, rows) = request.hologram, request.outputs.quilt
    picture = hologram.picture
    points = pupil_row(columns * rows, hologram, result.field.mapping, request.pupil)
    views = _views(request, points, progress, result.focus[0])
    folder.mkdir()
    name = f"quilt_qs{columns}x{rows}a{picture.width / picture.height:.5g}.png"
    (folder / name).write_bytes(output.encode_png(quilt(views, columns), output.exposure(views)))


def _views(request, points, progress, focus=None):
    """RGB of pictures through points of the pupil, in which everything is sharp."""
    hologram, depth = request.hologram, request.max_depth
    what = request.scene, request.camera, hologram, points, VIEW_PATHS
    pictures = pinhole_pictures(*what, max_depth=depth, progress=progress, focus=focus)
    return engine.to_rgb(pictures, hologram.wavelengths)


def update(folder, request, progress, export_seconds, say) -> tuple[pipeline.Result | None, dict]:
    """Have a still's render in its output folder: what is there of it is not made again.

    Parameters
    ----------
    folder : path
        Where `write` put a still before, or anything that `output.output_folder` takes.
    request, progress, export_seconds :
        See `write`.
    say : callable
        ``say(text)`` of what was there.

    Returns
    -------
    pipeline.Result or None
        None where all of it was there.
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
            encoded = _whole_hologram(folder)
            if encoded is None:
                changed["encoded"] = [_NAMES["encoded"]]
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
        encoded = Path(folder) / "hologram"
        if rendered is not None and not request.encoding.is_requested and encoded.is_dir():
            shutil.copytree(encoded, part / "hologram")  # `holopath encode` made it of the same field
        return done


def is_complete(folder, job, encode):
    """Whether a still's output folder is there, whole, as a job asks for it.

    Parameters
    ----------
    folder : path
    job : str
        As `Origin.job`.
    encode : str
        As `Encoding.method`.

    Returns
    -------
    bool
    """
    if output.read_report(folder).get("job") != job or _mapped(folder) is None:
        return False
    return encode == "none" or _phases(folder) is not None


def load_field(folder):
    """The wave field of an output folder; in memory, as Windows replaces no file that is mapped.

    Returns
    -------
    engine.WaveField or None
        None where there is no whole one.
    """
    field = _mapped(folder)
    return field and replace(field, data=np.array(field.data))


def _whole_hologram(folder):
    """The phases of an output folder, in memory; None where there are none as its report tells, see `_phases`."""
    phase = _phases(folder)
    return phase and replace(phase, data=np.array(phase.data))


def _phases(folder):
    """The phases that its render made to their end: `holopath encode` may have put others in their place."""
    try:
        phase = engine.PhaseHologram.load(Path(folder) / "hologram")
    except engine.InvalidInput:
        return None
    own = output.plain({"method": phase.method, **phase.report}) == output.read_report(folder).get("encoding")
    return phase if own and not phase.report.get("stopped") else None


def _mapped(folder):
    try:
        return engine.WaveField.load(Path(folder) / "wavefield")
    except engine.InvalidInput:
        return None


def _changes(report, asked):
    """What was asked otherwise: entries of the report, and readable names of what differs in each."""
    changed = {}
    for key, value in asked.items():
        made, name = report.get(key), _NAMES.get(key, key)
        if key == "settings" and made:  # of the version before, too
            made = {k: current(k, v, lambda text: None) for k, v in made.items()}
        if made != value:
            both = isinstance(made, dict) and isinstance(value, dict)
            within = (
                [f"{name} {k.replace('_', ' ')}" for k in value if made.get(k) != value[k]] if both else []
            )
            changed[key] = within or [name]
    return changed
