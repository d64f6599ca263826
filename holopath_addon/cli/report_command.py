"""`holopath report`: what a viewer gets of a stored hologram, as one page and a table."""

import html
import math
from pathlib import Path

import numpy as np

from .. import engine
from ..engine.planning.planner import resolved
from ..engine.progress import Stages, parts, stage, with_time_left
from ..engine.viewing import assessment
from ..engine.viewing.metrics import speckle_contrast
from ..engine.viewing.reconstruction import Refocuser
from ..workflow import output
from . import options, render_command, sources
from .console import Progress
from .report_page import focus_curves, named, picture, svg_sketch, table, value_map, write

FOCI, POSITIONS, SHARE, VIEWS, SLICE = 13, 5, 0.5, 9, 0.25
COMPARED = slice(None, None, 2)  # of the foci, beside path tracing
SIZES = (1.0, 0.5, 0.25, 0.125)  # of the pupil's diameter
PATHS = 64  # a pixel and color, of a path-traced picture
LARGE = (
    1 << 19
)  # pixels, from which on parts of the pupil are looked through at no more pixels than these need


def add(command):
    """Add the command, see `render_command.add`."""
    report = command(
        "report", _report, "Show what a viewer gets of a stored hologram, as a page for a browser."
    )
    report.add_argument("folder", metavar="DIR", help="output folder of `holopath render` or `import`")
    report.add_argument(
        "--out", metavar="FILE", help="page (default DIR/report.html); its table lies beside it, as .csv"
    )
    report.add_argument(
        "--scene",
        nargs="?",
        const="",
        metavar="SCENE",
        help="also compare with path-traced pictures, over focus and over the pupil; of this scene, by default the one "
        "that DIR/report.json names",
    )
    render_command.add_at_frame(report, "the one of the field")
    render_command.add_run_scripts(report)
    render_command.add_define(report, "those of the field")
    report.add_argument(
        "--paths",
        type=options.argument(_paths),
        default=PATHS,
        metavar="N",
        help=f"a pixel and color of these pictures (default {PATHS})",
    )


def _paths(text):
    if not text.isdigit() or not 2 <= int(text) <= 1 << 16:
        raise engine.InvalidInput(f"A path-traced picture has 2 to 65536 paths a pixel, not {text}")
    return int(text)


def _report(args):
    progress, folder = Progress(quiet=args.quiet), Path(args.folder)
    page = Path(args.out) if args.out else folder / "report.html"
    if page.suffix.lower() not in (".html", ".htm"):
        raise engine.InvalidInput(f"{page} is no page: end its name on .html.")
    phase = output.stored_hologram(folder) if (folder / "hologram").is_dir() else None
    lone = phase is not None and not (folder / "wavefield").is_dir()
    field = phase.field() if lone else output.stored_field(folder)
    truth = _truth(args, field, progress.say)
    stored = stage(progress, 0.0, 0.2) if truth else progress
    told = Stages(stored, {"foci": 0.4, "eyebox": 0.6, "parallax": 0.65, "phases": 1.0})
    rows, sections, depths = [], [], _depths(field)
    refocus, middle = _refocuser(field), depths[FOCI // 2]
    images = refocus(depths, progress=told["foci"])
    rows += _focus(sections, field, depths, images)
    more, through = _eyebox(sections, refocus, middle, images[FOCI // 2], told["eyebox"])
    rows += more
    seen = _parallax(sections, refocus, middle, told["parallax"])
    if phase is not None:
        rows += _phases(
            sections,
            phase,
            None if lone else refocus,
            middle,
            images[FOCI // 2 : FOCI // 2 + 1],
            through,
            told["phases"],
        )
    sections.append(("Bench", f"<figure>{svg_sketch(field.hologram)}</figure>"))
    if truth:
        light = refocus if phase is None or lone else _refocuser(phase.field())
        rows += _beside_paths(sections, truth, light, depths, seen, stage(progress, 0.2, 1.0))
    write(page, folder, field, sections, rows)
    progress(1.0, f"Done: {page}")


def _refocuser(field):
    return Refocuser(field, max_apart=_apart(field, SLICE))


def _apart(field, share):
    """Pixels between those of pictures through such a share of the pupil, whose light needs no more of them."""
    return round(1 / share) if math.prod(field.data.shape[-2:]) >= LARGE else 1


def _through(refocus, focus, grid, progress):
    """Places on a grid of parts of the pupil, these, and what is seen through them."""
    places = [(row, column) for row, line in enumerate(grid) for column, pupil in enumerate(line) if pupil]
    chosen = [grid[row][column] for row, column in places]
    return places, chosen, refocus.through(focus, chosen, progress, _apart(refocus.field, SHARE))


def _depths(field):
    """Distances evenly spread over the volume, in world meters."""
    hologram = field.hologram
    ends = hologram.depth_far, hologram.depth_near
    low, high = field.plan.get("z_low", ends[0]), field.plan.get("z_high", ends[1])
    return [float(field.mapping.z_to_depth(z)) for z in np.linspace(low, high, FOCI)]


def _focus(sections, field, depths, images):
    rgb = engine.to_rgb(images, field.hologram.wavelengths)
    white = output.exposure(rgb)
    chosen = (0, FOCI // 2, FOCI - 1)
    pictures = "".join(picture(rgb[n], white, f"Focus at {named(depths[n])}") for n in chosen)
    curves = assessment.sharpness(images)
    sections.append(("Pictures", f'<div class="pictures">{pictures}</div>'))
    text = (
        "<p>Sharpness of nine parts of the picture over the distance of focus. Each has its peak where its surfaces "
        "lie.</p>"
    )
    sections.append(("Focus", text + focus_curves(depths, curves.reshape(len(depths), -1))))
    return [
        ("sharpness", f"focus {named(depth)}, row {row + 1}, column {column + 1}", curves[n, row, column])
        for n, depth in enumerate(depths)
        for row in range(assessment.PATCHES)
        for column in range(assessment.PATCHES)
    ]


def _eyebox(sections, refocus, focus, whole, progress):
    field = refocus.field
    grid = assessment.pupils(field, SHARE, POSITIONS)
    found = np.full((POSITIONS, POSITIONS), math.nan)
    places, chosen, pictures = _through(refocus, focus, grid, lambda done, _: progress(done, "Eyebox"))
    for place, pupil, image in zip(places, chosen, pictures, strict=True):
        found[place] = assessment.brightness(field, image, whole, pupil)
    radius = assessment.pupil_radius(field)
    text = (
        f"<p>The pupil that all colors fill is {2e3 * radius:.3g} mm wide. How bright is the picture for an eye whose "
        f"pupil has half of that, wherever it is? 1 is an even eyebox.</p>{value_map(found, '{:.2f}')}"
    )
    sections.append(("Eyebox", text))
    return _of_map("eyebox brightness", grid, found), pictures


def _parallax(sections, refocus, focus, progress):
    """The slice, and the pupils that it is seen through."""
    field = refocus.field
    reach = assessment.pupil_radius(field) * (1 - SLICE)
    right, up = assessment.pupil_center(field)
    seen = [
        engine.Pupil(float(x) + right, up, 2 * SLICE * assessment.pupil_radius(field))
        for x in np.linspace(-reach, reach, VIEWS)
    ]
    what = refocus, focus, seen, field.hologram.picture.height // 2
    lines = assessment.epipolar_slices(
        *what, lambda done, _: progress(done, "Parallax"), _apart(field, SLICE)
    )
    text = (
        f"The middle row of the picture, through a quarter of the pupil that goes from left to right, over "
        f"{2e3 * reach:.3g} mm; focus at {named(focus)}. What stands still lies at the focus; what leans lies before "
        "it or behind it."
    )
    sections.append(("Parallax", picture(_tall(lines), output.exposure(lines), text)))
    return seen


def _tall(lines):
    """A slice large enough to look at."""
    return np.repeat(np.repeat(lines, 12, axis=0), max(1, 768 // lines.shape[1]), axis=1)


def _phases(sections, phase, refocus, focus, whole, through, progress):
    """Beside pictures of the field through the whole pupil, and through its parts."""
    shares = assessment.efficiency(phase, stage(progress, 0.0, 0.2))
    names = [f"{w * 1e9:.4g} nm" for w in phase.hologram.wavelengths]
    cells = "".join(
        f"<tr><th>{name}</th><td>{share:.0%}</td></tr>" for name, share in zip(names, shares, strict=True)
    )
    text = (
        "<p>Of the light that the pixels send out, so much stays within the cone that makes the picture.</p>"
        f"<table>{cells}</table>"
    )
    rows = [("efficiency", name, share) for name, share in zip(names, shares, strict=True)]
    if refocus is not None:
        shown = _refocuser(phase.field())
        grid = assessment.pupils(refocus.field, SHARE, POSITIONS)
        found = np.full((POSITIONS, POSITIONS), math.nan)
        at = stage(progress, 0.2, 0.95)
        places, _, pictures = _through(shown, focus, grid, lambda done, _: at(done, "Phases"))
        for place, decibels in zip(places, assessment.loss(pictures, through), strict=True):
            found[place] = decibels
        at = stage(progress, 0.95, 1.0)
        (middle,) = assessment.loss(shown([focus], progress=at), whole)
        more = ""
        if phase.method == "refine":
            more = (
                " They go towards the mean of more frames: much of the difference is the field's own speckle."
            )
        text += (
            f"<p>How near do pictures of the phases come to those of the complex field?{more} "
            f"{middle:.1f} dB through the whole pupil; through half of it, wherever it is:</p>"
            + value_map(found, "{:.1f}")
        )
        rows += [("phases, dB", "whole pupil", middle), *_of_map("phases, dB", grid, found)]
    sections.append((f"Phases ({html.escape(phase.method)})", text))
    return rows


def _truth(args, field, say):
    """`assessment.PathTraced` of the scene that the words name, or else its report; None if none is wanted."""
    if args.scene is None:
        if args.at_frame is not None or args.run_scripts or args.define:
            flag = (
                "--at-frame"
                if args.at_frame is not None
                else "--run-scripts"
                if args.run_scripts
                else "--define"
            )
            raise engine.InvalidInput(f"{flag} is of the scene to compare with: add --scene.")
        return None
    define = dict(args.define or ())
    found = sources.reopen(args.folder, field, args.scene or None, args.at_frame, args.run_scripts, define)
    if not found.same and not args.scene:
        raise engine.InvalidInput(
            f"{found.name} has changed since the field was rendered, or is at another frame: name it after --scene to "
            "compare all the same, or give --at-frame N."
        )
    if not found.same:
        say(f"note: {found.name} is not what the field was rendered of.")
    settings = resolved(found.settings or engine.Settings())
    return assessment.PathTraced(found.scene, field, args.paths, settings.max_depth)


def _beside_paths(sections, truth, refocus, depths, seen, progress):
    """How near pictures come to path-traced ones: over focus, over the pupil, and the slice."""
    grid, compared = assessment.pupils(refocus.field, SHARE, POSITIONS), depths[COMPARED]
    looks = sum(pupil is not None for line in grid for pupil in line) + len(SIZES)
    ends = np.cumsum([len(compared), looks, len(seen)]) / (len(compared) + looks + len(seen))
    told = Stages(with_time_left(progress), dict(zip(("foci", "pupils", "slices"), ends, strict=True)))
    focus = depths[FOCI // 2]
    over_focus, rows = _foci_beside(truth, refocus, compared, told["foci"])
    over_pupil, more = _pupils_beside(truth, refocus, focus, grid, told["pupils"])
    beside = _slices_beside(truth, refocus, focus, seen, told["slices"])
    sections.append(("Beside Path Tracing", over_focus + over_pupil + beside))
    return rows + more


def _foci_beside(truth, refocus, depths, progress):
    border, cells, rows = truth.border, [], []
    for halves, depth, image in zip(truth(depths, None, progress), depths, refocus(depths), strict=True):
        nearness = (
            _compared(engine.psnr, image, halves, border),
            _compared(engine.ssim, image, halves, border),
        )
        speckle = speckle_contrast(image, halves.mean(0), border)
        cells.append(
            (
                named(depth),
                f"{nearness[0]:.1f} dB",
                f"{nearness[1]:.2f}",
                "" if speckle is None else f"{speckle:.0%}",
            )
        )
        found = [("PSNR, dB", nearness[0]), ("SSIM", nearness[1]), ("speckle", speckle)]
        rows += [(what, f"focus {named(depth)}", value) for what, value in found if value is not None]
    what = "do the phases come" if refocus.field.modulated else "does the field come"
    text = (
        f"<p>How near {what} to Mitsuba's path tracer, {truth.paths} paths a pixel and color, through a lens as wide "
        "as the pupil? Speckle is the deviation over the mean of both pictures' ratio in small patches. It holds the "
        "path tracer's own noise, too; PSNR and SSIM do not.</p>"
    )
    return text + table(("Focus", "PSNR", "SSIM", "Speckle"), cells), rows


def _compared(measure, image, halves, border):
    """PSNR or SSIM; NaN where what is compared with is dark."""
    try:
        return measure(image, halves, border)
    except ValueError:
        return math.nan


def _pupils_beside(truth, refocus, focus, grid, progress):
    field = refocus.field
    radius = assessment.pupil_radius(field)
    sizes = [engine.Pupil(0.0, 0.0, 2 * size * radius) for size in SIZES]
    chosen = [pupil for line in grid for pupil in line if pupil is not None] + sizes
    found = {}
    for pupil, told in zip(chosen, parts(progress, len(chosen)), strict=True):
        (halves,) = truth([focus], pupil, told)
        shown = assessment.balance_colors(field, refocus([focus], pupil)[0], pupil)
        found[pupil] = _compared(engine.psnr, shown, halves, truth.border)
    values = np.array([[math.nan if pupil is None else found[pupil] for pupil in line] for line in grid])
    widths = [f"{1e3 * pupil.diameter:.3g} mm" for pupil in sizes]
    cells = [(width, f"{found[pupil]:.1f} dB") for width, pupil in zip(widths, sizes, strict=True)]
    text = (
        f"<p>PSNR in dB through half of the pupil, wherever it is; focus at {named(focus)}:</p>"
        f"{value_map(values, '{:.1f}')}<p>And through smaller and smaller pupils in the middle, where diffraction "
        f"blurs, which the path tracer does not know. The first has one opening for all colors, where above each fills "
        f"its own cone; frames speckle more through less than all of it:</p>{table(('Pupil', 'PSNR'), cells)}"
    )
    rows = [
        ("PSNR, dB", f"pupil {width} wide", found[pupil]) for width, pupil in zip(widths, sizes, strict=True)
    ]
    return text, [*_of_map("PSNR, dB", grid, values), *rows]


def _slices_beside(truth, refocus, focus, seen, progress):
    hologram, traced = truth.field.hologram.picture, []
    begin, end = (stage(progress, *ends) for ends in ((0.0, 0.1), (0.1, 1.0)))
    lines = assessment.epipolar_slices(refocus, focus, seen, hologram.height // 2, begin)
    for pupil, told in zip(seen, parts(end, len(seen)), strict=True):
        (halves,) = truth([focus], pupil, told)
        traced.append(engine.to_rgb(halves.mean(0), hologram.wavelengths)[hologram.height // 2])
    traced = np.stack(traced)
    both = np.concatenate([_tall(lines), _tall(traced * (lines.mean() / max(traced.mean(), 1e-30)))])
    return picture(
        both, output.exposure(lines), "Parallax as above, of the hologram; below, by the path tracer."
    )


def _of_map(what, grid, values):
    return [
        (what, f"pupil at {1e3 * pupil.x:.3g}, {1e3 * pupil.y:.3g} mm", values[row, column])
        for row, line in enumerate(grid)
        for column, pupil in enumerate(line)
        if pupil is not None
    ]
