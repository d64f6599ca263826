"""Writers of a still's output folder, one for each kind of output."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import engine
from ..engine.mapping import squared
from ..engine.pixels import coarsest
from ..engine.progress import Progress
from ..engine.viewing import assessment
from ..engine.viewing.depth import image_depth_map
from ..engine.viewing.light_field import pinhole_pictures, pupil_points, pupil_row, quilt
from . import output
from .lengths import format_distance
from .pipeline import Result
from .request import Request

VIEW_PATHS = 64  # paths per pixel of each view of a light field or quilt
SHEET_PATHS = 16  # paths per pixel of the thin lens's image on a contact sheet
MAX_PSNR_DEVIATION = 0.2  # dB, above which the user is warned


@dataclass(frozen=True)
class Still:
    """A computed still, and the folder for it.

    Attributes
    ----------
    folder : Path
    request : Request
    result : Result
    rgb : numpy.ndarray, shape (focus, y, x, 3)
        The field's images, linear RGB.
    white : float
        Linear value shown as white, see `output.exposure`.
    phase : engine.PhaseHologram or None
    phase_images : numpy.ndarray or None, shape (focus, y, x, wavelength)
        Images that the phases show.
    phase_rgb : numpy.ndarray or None, shape (focus, y, x, 3)
        The same, linear RGB.
    """

    folder: Path
    request: Request
    result: Result
    rgb: np.ndarray
    white: float
    phase: engine.PhaseHologram | None = None
    phase_images: np.ndarray | None = None
    phase_rgb: np.ndarray | None = None

    @property
    def is_stopped(self):
        """Whether the user stopped the encoding."""
        return self.phase is not None and bool(self.phase.report.get("stopped"))


def write_field(still):
    """Write the wave field and its images.

    Parameters
    ----------
    still : Still

    Raises
    ------
    OSError
    """
    still.result.field.save(still.folder / "wavefield")
    files = output.picture_files(still.rgb, still.result.focus, still.white, still.request.pupil)
    output.write_pictures(still.folder / "reconstruction", files)


def write_phases(still):
    """Write the phases and the images that they show.

    Parameters
    ----------
    still : Still

    Raises
    ------
    OSError
    """
    still.phase.save(still.folder / "hologram")
    files = output.picture_files(still.phase_rgb, still.result.focus, still.white, still.request.pupil)
    output.write_pictures(still.folder / "reconstruction", output.hologram_files(files))


def _write_reference(still, progress):
    """Images through a thin lens; the report's comparison with them."""
    request, focus, field = still.request, still.result.focus, still.result.field
    reference = engine.reference(
        request.scene,
        request.camera,
        field.hologram,
        focus,
        request.pupil,
        near=field.near,
        max_depth=request.max_depth,
        progress=progress,
        halves=True,
    )
    rgb = engine.to_rgb(reference.mean(1), field.hologram.wavelengths)
    files = output.picture_files(rgb, focus, output.exposure(rgb), request.pupil)
    output.write_pictures(still.folder / "reference", files)
    rows = _comparison(still, reference)
    compared = {row["focus_m"] for row in rows}
    notes = _noise_notes(rows)
    if dark := [format_distance(depth) for depth in focus if depth not in compared]:
        notes.insert(
            0, f"The reference is black at the focus {', '.join(dark)} m: nothing is compared there."
        )
    return {"comparison": rows, "warnings": notes}


def _comparison(still, reference):
    """PSNR and SSIM of the images at each focus whose reference is not black.

    The border that light from outside the view reaches is left out. `psnr_of_diffracted_db` compares with the best
    image that light through the pupil can show, see `engine.diffracted`.
    """
    result, pupil = still.result, still.request.pupil
    field, hologram = result.field, result.field.hologram
    openings = _openings(hologram, field.mapping, pupil)
    phase_images = [None] * len(result.focus) if still.phase_images is None else still.phase_images
    rows = []
    for depth, image, light, halves in zip(result.focus, result.images, phase_images, reference, strict=True):
        border = _border(result, depth)
        inner = slice(border, -border or None)
        if not (halves.mean(0)[inner, inner] > 0).any():
            continue
        if pupil is not None:
            image = assessment.balance_colors(field, image, pupil)
            light = light if light is None else assessment.balance_colors(field, light, pupil)
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


def _openings(hologram, mapping, pupil):
    """Radius of the pupil's opening at each wavelength, cycles per pixel, see `engine.diffracted`."""
    picture = hologram.picture
    radii = [mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]
    return [
        0.5
        * picture.pitch
        / coarsest(picture.pitch_at(w))
        * (min(1.0, pupil.diameter / (2 * r)) if pupil else 1)
        for w, r in zip(hologram.wavelengths, radii, strict=True)
    ]


def _border(result, depth):
    """Pixels of the border that light from outside the view reaches, focused at a depth."""
    plan, picture = result.plan, result.field.hologram.picture
    z = float(result.field.mapping.depth_to_z(depth))
    slope = result.field.hologram.widest_slope
    border = math.ceil(slope * max(abs(z - plan.z_low), abs(z - plan.z_high)) / picture.pitch_x)
    return max(0, min(border, (min(picture.width, picture.height) - 12) // 2))


def _noise_notes(rows):
    """Warnings of comparisons that the reference's noise makes uncertain."""
    deviation = max((row["psnr_deviation_db"] for row in rows), default=0.0)
    if deviation <= MAX_PSNR_DEVIATION:
        return []
    if not math.isfinite(deviation):
        return ["The reference is too noisy for a PSNR of this comparison."]
    return [
        f"The reference is noisy: the PSNR of this comparison is uncertain by {deviation:.2g} dB. "
        "Most of such noise is from small lights behind glass or corners."
    ]


def _write_rgbd(still, progress):
    """A pinhole image, the depth of the first surfaces, and that of what mirrors and glass show."""
    request, folder = still.request, still.folder / "rgbd"
    camera, grid = squared(request.camera, request.hologram)
    size = grid.width, grid.height
    image = pinhole_pictures(
        request.scene,
        request.camera,
        request.hologram,
        [(0.0, 0.0)],
        max_depth=request.max_depth,
        progress=progress,
    )
    rgb = engine.to_rgb(image[0], request.hologram.wavelengths)
    folder.mkdir()
    (folder / "rgb.exr").write_bytes(output.encode_exr(rgb))
    (folder / "rgb.png").write_bytes(output.encode_png(rgb, still.white))
    np.save(folder / "depth.npy", image_depth_map(request.scene, camera, still.result.plan, *size))
    np.save(folder / "surface_depth.npy", engine.depth_map(request.scene, camera, *size))
    return {}


def _write_light_field(still, progress):
    """Pinhole images through a grid of points of the pupil, and the points."""
    request, count, folder = still.request, still.request.outputs.light_field, still.folder / "light_field"
    points = pupil_points(count, request.hologram, still.result.field.mapping, request.pupil)
    rgb = _views(request, points.reshape(-1, 2), progress)
    folder.mkdir()
    np.save(folder / "views.npy", rgb.reshape(count, count, *rgb.shape[1:]))
    np.save(folder / "points.npy", points)
    return {}


def _write_quilt(still, progress):
    """Views through points along the pupil in one image; the display lies at the first focus."""
    request, (columns, rows), folder = still.request, still.request.outputs.quilt, still.folder / "quilt"
    picture = request.hologram.picture
    points = pupil_row(columns * rows, request.hologram, still.result.field.mapping, request.pupil)
    views = _views(request, points, progress, still.result.focus[0])
    folder.mkdir()
    name = f"quilt_qs{columns}x{rows}a{picture.width / picture.height:.5g}.png"
    (folder / name).write_bytes(output.encode_png(quilt(views, columns), output.exposure(views)))
    return {}


def _views(request, points, progress, focus=None):
    """Linear RGB of pinhole images through points of the pupil."""
    images = pinhole_pictures(
        request.scene,
        request.camera,
        request.hologram,
        points,
        VIEW_PATHS,
        max_depth=request.max_depth,
        progress=progress,
        focus=focus,
    )
    return engine.to_rgb(images, request.hologram.wavelengths)


def _write_contact_sheet(still, progress):
    """Phases of the first frame at the middle wavelength, images, and one through a thin lens."""
    request, focus, field = still.request, still.result.focus, still.result.field
    lens_image = engine.reference(
        request.scene,
        request.camera,
        field.hologram,
        [focus[len(focus) // 2]],  # that beside which a contact sheet sets it
        request.pupil,
        SHEET_PATHS,
        field.near,
        request.max_depth,
        progress,
    )[0]
    images, phases = still.rgb, None
    if still.phase is not None:
        images, phases = still.phase_rgb, still.phase.data[0, still.phase.data.shape[1] // 2]
    lens_rgb = engine.to_rgb(lens_image, field.hologram.wavelengths)
    sheet = output.contact_sheet(images, lens_rgb, focus, phases)
    (still.folder / request.outputs.contact_sheet).write_bytes(sheet)
    return {}


@dataclass(frozen=True)
class Writer:
    """Writer of an output that a request may add to a still.

    Attributes
    ----------
    output : str
        Field of `request.Outputs` that requests it.
    write : callable
        ``write(still, progress)`` writes the files, and gives entries of the report.
    needs_final_phases : bool
        Whether nothing is written if the encoding was stopped.
    """

    output: str
    write: Callable[[Still, Progress], dict]
    needs_final_phases: bool = False

    @property
    def stage(self):
        """Name of its stage of progress, and of its seconds in the report."""
        return self.output.replace("_", " ")

    def is_requested(self, still):
        """Whether it has something to write.

        Parameters
        ----------
        still : Still
        """
        requested = getattr(still.request.outputs, self.output)
        return bool(requested) and not (self.needs_final_phases and still.is_stopped)


WRITERS = (
    Writer("reference", _write_reference, needs_final_phases=True),
    Writer("rgbd", _write_rgbd),
    Writer("light_field", _write_light_field),
    Writer("quilt", _write_quilt),
    Writer("contact_sheet", _write_contact_sheet, needs_final_phases=True),
)
