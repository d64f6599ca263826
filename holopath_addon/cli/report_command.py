"""Command `holopath report`: quality of a stored hologram for a viewer, as one page and a table."""

import html
import math
from pathlib import Path

import numpy as np

from .. import engine
from ..engine.progress import Stages, parts, stage, with_time_left
from ..engine.viewing import assessment
from ..engine.viewing.metrics import speckle_contrast
from ..engine.viewing.reconstruction import Refocuser
from ..workflow import output
from . import options, render_command, sources
from .console import Progress
from .report_page import focus_curves, named, picture, svg_sketch, table, value_map, write

N_FOCI = 13  # focus distances over the volume
N_POSITIONS = 5  # positions of the eye in a row and a column of the eyebox
EYE_FRACTION = 0.5  # diameter of the eye's pupil there over that of the whole pupil
N_VIEWS = 9  # positions of the parallax slice
VIEW_FRACTION = 0.25  # diameter of its pupil over that of the whole pupil
COMPARED = slice(None, None, 2)  # focus distances that are compared with path tracing
SIZES = (1.0, 0.5, 0.25, 0.125)  # diameters of pupils over that of the whole pupil
PATHS = 64  # per pixel and color of a path-traced image
MIN_DECIMATED_PIXELS = (
    1 << 19
)  # of a field whose images through parts of the pupil have only the pixels that they need


def add(command):
    """Add the command.

    Parameters
    ----------
    command : callable
        See `render_command.add`.
    """
    report = command(
        "report", _report, "Write a page for a browser on the quality of a stored hologram for a viewer."
    )
    report.add_argument("folder", metavar="DIR", help="output folder of `holopath render` or `import`")
    report.add_argument(
        "--out",
        metavar="FILE",
        help="page to write (default DIR/report.html), with its table beside it as .csv",
    )
    report.add_argument(
        "--scene",
        nargs="?",
        const="",
        metavar="SCENE",
        help="also compare with path-traced images of this scene over focus and pupil (default: the scene in "
        "DIR/report.json)",
    )
    render_command.add_at_frame(report, "the field's")
    render_command.add_run_scripts(report)
    render_command.add_define(report, "the field's")
    report.add_argument(
        "--paths",
        type=options.argument(_paths),
        default=PATHS,
        metavar="N",
        help=f"paths per pixel and color of these images (default {PATHS})",
    )


def _paths(text):
    if not text.isdigit() or not 2 <= int(text) <= 1 << 16:
        raise engine.InvalidInput(f"Expected 2 to 65536 paths per pixel, got {text}")
    return int(text)


def _report(args):
    progress, folder = Progress(quiet=args.quiet), Path(args.folder)
    page = Path(args.out) if args.out else folder / "report.html"
    if page.suffix.lower() not in (".html", ".htm"):
        raise engine.InvalidInput(f"Expected a page with the suffix .html, got {page}. Give another name.")
    phase = output.stored_hologram(folder) if (folder / "hologram").is_dir() else None
    phases_only = phase is not None and not (folder / "wavefield").is_dir()
    field = phase.field() if phases_only else output.stored_field(folder)
    reference = _reference(args, field, progress.say)
    own_progress = stage(progress, 0.0, 0.2) if reference else progress
    stages = Stages(own_progress, {"foci": 0.4, "eyebox": 0.6, "parallax": 0.65, "phases": 1.0})
    rows, sections, depths = [], [], _depths(field)
    refocus, middle = _refocuser(field), N_FOCI // 2
    images = refocus(depths, progress=stages["foci"])
    rows += _focus(sections, field, depths, images)
    more, eye_images = _eyebox(sections, refocus, depths[middle], images[middle], stages["eyebox"])
    rows += more
    views = _parallax(sections, refocus, depths[middle], stages["parallax"])
    if phase is not None:
        rows += _phases(
            sections,
            phase,
            None if phases_only else refocus,
            depths[middle],
            images[middle : middle + 1],
            eye_images,
            stages["phases"],
        )
    sections.append(("Bench", f"<figure>{svg_sketch(field.hologram)}</figure>"))
    if reference:
        light = refocus if phase is None or phases_only else _refocuser(phase.field())
        rows += _comparison(sections, reference, light, depths, views, stage(progress, 0.2, 1.0))
    write(page, folder, field, sections, rows)
    progress(1.0, f"Done: {page}")


def _refocuser(field):
    return Refocuser(field, max_apart=_decimation(field, VIEW_FRACTION))


def _decimation(field, fraction):
    """Distance in pixels between those of images through that fraction of the pupil, which resolves fewer."""
    return round(1 / fraction) if math.prod(field.data.shape[-2:]) >= MIN_DECIMATED_PIXELS else 1


def _through(refocus, focus, grid, progress):
    """Positions on a grid of parts of the pupil, the parts, and the images through them."""
    positions = [(row, column) for row, line in enumerate(grid) for column, pupil in enumerate(line) if pupil]
    pupils = [grid[row][column] for row, column in positions]
    return (
        positions,
        pupils,
        refocus.through(focus, pupils, progress, _decimation(refocus.field, EYE_FRACTION)),
    )


def _depths(field):
    """World depths evenly spaced over the volume, meters."""
    hologram = field.hologram
    ends = hologram.depth_far, hologram.depth_near
    low, high = field.plan.get("z_low", ends[0]), field.plan.get("z_high", ends[1])
    return [float(field.mapping.z_to_depth(z)) for z in np.linspace(low, high, N_FOCI)]


def _focus(sections, field, depths, images):
    """Section of images and of sharpness over focus; rows of the table."""
    rgb = engine.to_rgb(images, field.hologram.wavelengths)
    white = output.exposure(rgb)
    chosen = (0, N_FOCI // 2, N_FOCI - 1)
    pictures = "".join(picture(rgb[n], white, f"Focus at {named(depths[n])}") for n in chosen)
    curves = assessment.sharpness(images)
    sections.append(("Pictures", f'<div class="pictures">{pictures}</div>'))
    text = (
        "<p>Sharpness of nine parts of the image over the focus distance. Each has its peak at the depth of its "
        "surfaces.</p>"
    )
    sections.append(("Focus", text + focus_curves(depths, curves.reshape(len(depths), -1))))
    return [
        ("sharpness", f"focus {named(depth)}, row {row + 1}, column {column + 1}", curves[n, row, column])
        for n, depth in enumerate(depths)
        for row in range(assessment.PATCHES)
        for column in range(assessment.PATCHES)
    ]


def _eyebox(sections, refocus, focus, whole, progress):
    """Section of brightness over the eyebox; rows of the table, and the images there."""
    field = refocus.field
    grid = assessment.pupils(field, EYE_FRACTION, N_POSITIONS)
    values = np.full((N_POSITIONS, N_POSITIONS), math.nan)
    positions, pupils, images = _through(refocus, focus, grid, lambda done, _: progress(done, "Eyebox"))
    for position, pupil, image in zip(positions, pupils, images, strict=True):
        values[position] = assessment.brightness(field, image, whole, pupil)
    radius = assessment.pupil_radius(field)
    text = (
        f"<p>The pupil that all colors fill is {2e3 * radius:.3g} mm wide. The map shows the brightness of the image "
        "for an eye with half that pupil, by its position. 1 everywhere is an even eyebox.</p>"
        f"{value_map(values, '{:.2f}')}"
    )
    sections.append(("Eyebox", text))
    return _map_rows("eyebox brightness", grid, values), images


def _parallax(sections, refocus, focus, progress):
    """Section of a slice through the parallax; the pupils of its lines."""
    field = refocus.field
    reach = assessment.pupil_radius(field) * (1 - VIEW_FRACTION)
    right, up = assessment.pupil_center(field)
    pupils = [
        engine.Pupil(float(x) + right, up, 2 * VIEW_FRACTION * assessment.pupil_radius(field))
        for x in np.linspace(-reach, reach, N_VIEWS)
    ]
    lines = assessment.epipolar_slices(
        refocus,
        focus,
        pupils,
        field.hologram.picture.height // 2,
        lambda done, _: progress(done, "Parallax"),
        _decimation(field, VIEW_FRACTION),
    )
    text = (
        "Middle row of the image through a quarter of the pupil, which moves from left to right over "
        f"{2e3 * reach:.3g} mm; focus at {named(focus)}. Vertical lines are at the focus distance, inclined ones "
        "before or behind it."
    )
    sections.append(("Parallax", picture(_enlarged(lines), output.exposure(lines), text)))
    return pupils


def _enlarged(lines):
    """A slice enlarged for viewing."""
    return np.repeat(np.repeat(lines, 12, axis=0), max(1, 768 // lines.shape[1]), axis=1)


def _phases(sections, phase, refocus, focus, whole, eye_images, progress):
    """Section of the phases compared with the field, through the whole pupil and its parts; rows of the table."""
    fractions = assessment.efficiency(phase, stage(progress, 0.0, 0.2))
    names = [f"{w * 1e9:.4g} nm" for w in phase.hologram.wavelengths]
    rows = [("efficiency", name, fraction) for name, fraction in zip(names, fractions, strict=True)]
    cells = "".join(f"<tr><th>{name}</th><td>{fraction:.0%}</td></tr>" for _, name, fraction in rows)
    text = (
        "<p>Efficiency: fraction of the pixels' light that stays within the cone of the image.</p>"
        f"<table>{cells}</table>"
    )
    if refocus is not None:
        phase_refocus = _refocuser(phase.field())
        grid = assessment.pupils(refocus.field, EYE_FRACTION, N_POSITIONS)
        values = np.full((N_POSITIONS, N_POSITIONS), math.nan)
        eye_progress = stage(progress, 0.2, 0.95)
        positions, _, images = _through(
            phase_refocus, focus, grid, lambda done, _: eye_progress(done, "Phases")
        )
        for position, decibels in zip(positions, assessment.loss(images, eye_images), strict=True):
            values[position] = decibels
        (whole_loss,) = assessment.loss(phase_refocus([focus], progress=stage(progress, 0.95, 1.0)), whole)
        note = ""
        if phase.method == "refine":
            note = (
                " The phases approximate the mean of extra frames, so most of this is speckle of the field."
            )
        text += (
            f"<p>PSNR of images of the phases relative to those of the complex field:{note} "
            f"{whole_loss:.1f} dB through the whole pupil; through half of it, by its position:</p>"
            + value_map(values, "{:.1f}")
        )
        rows += [("phases, dB", "whole pupil", whole_loss), *_map_rows("phases, dB", grid, values)]
    sections.append((f"Phases ({html.escape(phase.method)})", text))
    return rows


def _reference(args, field, say):
    """`assessment.PathTraced` of the requested scene, or of that in the report; None without a comparison."""
    if args.scene is None:
        if args.at_frame is not None or args.run_scripts or args.define:
            flag = (
                "--at-frame"
                if args.at_frame is not None
                else "--run-scripts"
                if args.run_scripts
                else "--define"
            )
            raise engine.InvalidInput(f"Expected --scene with {flag}. Add it, or omit {flag}.")
        return None
    define = dict(args.define or ())
    reopened = sources.reopen(args.folder, field, args.scene or None, args.at_frame, args.run_scripts, define)
    if not reopened.same and not args.scene:
        raise engine.InvalidInput(
            f"{reopened.name} has changed since the render, or is at another frame. Name it after --scene to compare "
            "nevertheless, or give --at-frame N."
        )
    if not reopened.same:
        say(f"note: {reopened.name} is not the scene of the field.")
    return assessment.PathTraced(reopened.scene, field, args.paths, reopened.max_depth)


def _comparison(sections, reference, refocus, depths, views, progress):
    """Section that compares with path-traced images, over focus, over the pupil, and in the slice; table rows."""
    grid, compared = assessment.pupils(refocus.field, EYE_FRACTION, N_POSITIONS), depths[COMPARED]
    n_pupils = sum(pupil is not None for line in grid for pupil in line) + len(SIZES)
    ends = np.cumsum([len(compared), n_pupils, len(views)]) / (len(compared) + n_pupils + len(views))
    stages = Stages(with_time_left(progress), dict(zip(("foci", "pupils", "slices"), ends, strict=True)))
    focus = depths[N_FOCI // 2]
    foci, rows = _compare_foci(reference, refocus, compared, stages["foci"])
    pupils, more = _compare_pupils(reference, refocus, focus, grid, stages["pupils"])
    slices = _compare_slices(reference, refocus, focus, views, stages["slices"])
    sections.append(("Beside Path Tracing", foci + pupils + slices))
    return rows + more


def _compare_foci(reference, refocus, depths, progress):
    """Text of the comparison over focus; rows of the table."""
    border, cells, rows = reference.border, [], []
    for halves, depth, image in zip(reference(depths, None, progress), depths, refocus(depths), strict=True):
        psnr = _measured(engine.psnr, image, halves, border)
        ssim = _measured(engine.ssim, image, halves, border)
        speckle = speckle_contrast(image, halves.mean(0), border)
        percent = "" if speckle is None else f"{speckle:.0%}"
        cells.append((named(depth), f"{psnr:.1f} dB", f"{ssim:.2f}", percent))
        figures = [("PSNR, dB", psnr), ("SSIM", ssim), ("speckle", speckle)]
        rows += [(name, f"focus {named(depth)}", value) for name, value in figures if value is not None]
    light = "phases" if refocus.field.modulated else "field"
    text = (
        f"<p>Images of the {light} compared with Mitsuba's path tracer, {reference.paths} paths per pixel and color, "
        "through a lens as wide as the pupil. Speckle is the deviation over the mean of the images' ratio in small "
        "patches. It includes the path tracer's noise; PSNR and SSIM do not.</p>"
    )
    return text + table(("Focus", "PSNR", "SSIM", "Speckle"), cells), rows


def _measured(measure, image, halves, border):
    """PSNR or SSIM; NaN if the reference is dark."""
    try:
        return measure(image, halves, border)
    except ValueError:
        return math.nan


def _compare_pupils(reference, refocus, focus, grid, progress):
    """Text of the comparison through parts of the pupil; rows of the table."""
    field = refocus.field
    radius = assessment.pupil_radius(field)
    centered = [engine.Pupil(0.0, 0.0, 2 * size * radius) for size in SIZES]
    pupils = [pupil for line in grid for pupil in line if pupil is not None] + centered
    decibels = {}
    for pupil, pupil_progress in zip(pupils, parts(progress, len(pupils)), strict=True):
        (halves,) = reference([focus], pupil, pupil_progress)
        image = assessment.balance_colors(field, refocus([focus], pupil)[0], pupil)
        decibels[pupil] = _measured(engine.psnr, image, halves, reference.border)
    values = np.array([[math.nan if pupil is None else decibels[pupil] for pupil in line] for line in grid])
    widths = [f"{1e3 * pupil.diameter:.3g} mm" for pupil in centered]
    cells = [(width, f"{decibels[pupil]:.1f} dB") for width, pupil in zip(widths, centered, strict=True)]
    text = (
        f"<p>PSNR in dB through half of the pupil, by its position; focus at {named(focus)}:</p>"
        f"{value_map(values, '{:.1f}')}<p>PSNR through smaller pupils in the middle, whose diffraction blur the path "
        "tracer lacks. The first one is the same for all colors, while above each color fills its own cone; through "
        f"smaller pupils speckle is stronger:</p>{table(('Pupil', 'PSNR'), cells)}"
    )
    rows = [
        ("PSNR, dB", f"pupil {width} wide", decibels[pupil])
        for width, pupil in zip(widths, centered, strict=True)
    ]
    return text, [*_map_rows("PSNR, dB", grid, values), *rows]


def _compare_slices(reference, refocus, focus, views, progress):
    """Figure of the parallax slices by the hologram and by the path tracer."""
    hologram = reference.field.hologram.picture
    row = hologram.height // 2
    lines = assessment.epipolar_slices(refocus, focus, views, row, stage(progress, 0.0, 0.1))
    traced = []
    for pupil, view_progress in zip(views, parts(stage(progress, 0.1, 1.0), len(views)), strict=True):
        (halves,) = reference([focus], pupil, view_progress)
        traced.append(engine.to_rgb(halves.mean(0), hologram.wavelengths)[row])
    traced = np.stack(traced)
    scaled = traced * (lines.mean() / max(traced.mean(), 1e-30))
    both = np.concatenate([_enlarged(lines), _enlarged(scaled)])
    return picture(
        both, output.exposure(lines), "Parallax as above, of the hologram; below, by the path tracer."
    )


def _map_rows(name, grid, values):
    """Rows of the table for a map over the eyebox."""
    return [
        (name, f"pupil at {1e3 * pupil.x:.3g}, {1e3 * pupil.y:.3g} mm", values[row, column])
        for row, line in enumerate(grid)
        for column, pupil in enumerate(line)
        if pupil is not None
    ]
