"""Images and output folders on disk: a file or folder appears complete or not at all."""

import json
import platform
import re
import shutil
import stat
import sys
from contextlib import suppress
from dataclasses import astuple
from importlib import metadata
from pathlib import Path

import numpy as np

from ..engine import InvalidInput, PhaseHologram, Pupil, WaveField
from ..engine.files import is_of_browser, new_folder, rename, whole_file, whole_folder
from ..engine.scene import variants
from ..engine.settings.former_names import FORMER_NAMES, with_current_names
from .lengths import format_distance

FORMAT = "HoloPath output"
FORMAT_VERSION = 1
# HoloPath's version, which only some installations know; a test compares it with pyproject.toml and the manifest.
VERSION = "0.2.0"
FRAME = re.compile(r"frame_(-?[0-9]+)")
# Of a contact sheet: maximum pixels of an image's side, pixels between two images, and gray level around them.
SHEET_SIDE, SHEET_GAP, SHEET_GRAY = 640, 8, 96
# Characters of its labels: five rows of three pixels each, an octal digit a row.
GLYPHS = dict(
    zip(
        "0123456789.-+ EFILMNS",
        "75557 26227 71747 71717 55711 74717 74757 71222 75757 75717 00002 00700 02720 00000 "
        "74647 74644 72227 44447 57755 65555 74717".split(),
        strict=True,
    )
)
GLYPH_SIZE = 4, 7  # with the space around a character
_OWN = {
    "wavefield",
    "reconstruction",
    "reference",
    "hologram",
    "pictures",
    "rgbd",
    "light_field",
    "quilt",
    "report.json",
    "report.html",
    "report.csv",
}


def exposure(images):
    """Linear value to show as white: the 99th percentile of all images together, which makes them comparable.

    Parameters
    ----------
    images : array_like

    Returns
    -------
    float
    """
    white = float(np.percentile(images, 99))
    return white if white > 0 else 1.0


def encode_exr(rgb):
    """OpenEXR file of a linear RGB image.

    Parameters
    ----------
    rgb : numpy.ndarray, float32, shape (y, x, 3)

    Returns
    -------
    bytes
    """
    mi = variants.bitmaps()
    return variants.encoded_bitmap(np.ascontiguousarray(rgb, np.float32), mi.Bitmap.FileFormat.OpenEXR)


def encode_png(rgb, white):
    """8-bit sRGB PNG file of a linear RGB image.

    Parameters
    ----------
    rgb : numpy.ndarray, shape (y, x, 3)
    white : float
        Linear value shown as white, see `exposure`.

    Returns
    -------
    bytes
    """
    return variants.encoded_bitmap(_srgb(rgb, white), variants.bitmaps().Bitmap.FileFormat.PNG)


def _srgb(rgb, white):
    """Levels in sRGB of a linear image, IEC 61966-2-1."""
    linear = np.clip(np.asarray(rgb, np.float32) / white, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (encoded * 255 + 0.5).astype(np.uint8)


def contact_sheet(images, lens_image, focus, phases=None):
    """PNG file with an overview of a hologram.

    At the left are the phases of one frame and wavelength, black to white for a turn, each pixel as two by two,
    cropped to the sheet's height. At the right are the images in pairs, the middle one last, and beside it the image
    through a thin lens. Under each is its focus.

    Parameters
    ----------
    images : sequence of numpy.ndarray, linear RGB, shape (y, x, 3)
        Images at each focus distance, which are shown at one exposure.
    lens_image : numpy.ndarray, linear RGB, shape (y, x, 3)
        Image through a thin lens with the focus of the middle image.
    focus : sequence of float
        World depth of each image, meters.
    phases : numpy.ndarray, shape (y, x), optional
        Radians. Without them there are only images.

    Returns
    -------
    bytes
    """
    middle, white = len(images) // 2, exposure(np.stack(images))
    order = [*range(middle), *range(middle + 1, len(images)), middle]
    labels = [f"{format_distance(depth)} m" for depth in focus]
    tiles = [_tile(images[number], white, labels[number]) for number in order]
    tiles.append(_tile(lens_image, exposure(lens_image), f"{labels[middle]} lens"))
    if len(tiles) % 2:
        tiles.insert(-2, np.full_like(tiles[0], SHEET_GRAY))
    height, width = tiles[0].shape[:2]
    rows, step = len(tiles) // 2, (height + SHEET_GAP, width + SHEET_GAP)
    tall, left = rows * step[0] - SHEET_GAP, 0
    drawn = None
    if phases is not None:
        drawn = np.round(np.asarray(phases) * (256 / (2 * np.pi))).astype(np.int64) % 256
        drawn = _crop(drawn.repeat(2, 0).repeat(2, 1), tall, 2 * width + SHEET_GAP)
        left = drawn.shape[1] + SHEET_GAP
    sheet = np.full((tall, left + 2 * step[1] - SHEET_GAP, 3), SHEET_GRAY, np.uint8)
    if drawn is not None:
        top = (tall - len(drawn)) // 2
        sheet[top : top + len(drawn), : drawn.shape[1]] = drawn[..., None]
    for number, tile in enumerate(tiles):
        y, x = number // 2 * step[0], left + number % 2 * step[1]
        sheet[y : y + height, x : x + width] = tile
    return variants.encoded_bitmap(sheet, variants.bitmaps().Bitmap.FileFormat.PNG)


def _tile(rgb, white, label):
    """Levels in sRGB of an image of at most `SHEET_SIDE` pixels a side, over its label.

    They are means over blocks, which keep speckle.
    """
    rgb = np.asarray(rgb, np.float32)
    block = -(-max(rgb.shape[:2]) // SHEET_SIDE)
    height, width = (side // block for side in rgb.shape[:2])
    inner = rgb[: height * block, : width * block].reshape(height, block, width, block, 3)
    return np.concatenate([_srgb(inner.mean((1, 3)), white), _label(label, width)])


def _label(text, width):
    """Strip with a text, white on gray, which is as large as suits an image of some width."""
    across, down = GLYPH_SIZE
    scale = max(1, width // (24 * across))
    columns = [[int(row) >> bit & 1 for row in GLYPHS[each]] for each in text.upper() for bit in (2, 1, 0, 3)]
    drawn = np.array(columns, bool).T.repeat(scale, 0).repeat(scale, 1)[:, :width]
    strip = np.full((down * scale, width, 3), SHEET_GRAY, np.uint8)
    strip[scale : scale + len(drawn), : drawn.shape[1]][drawn] = 255
    return strip


def _crop(image, height, width):
    """Middle part of an image, with at most that height and width."""
    top, left = (
        max(0, (side - limit) // 2) for side, limit in zip(image.shape, (height, width), strict=True)
    )
    return image[top : top + height, left : left + width]


def frame_folder(folder, number):
    """Output folder of a frame of an animation.

    Parameters
    ----------
    folder : path
        Output folder of the animation.
    number : int

    Returns
    -------
    pathlib.Path
    """
    return Path(folder) / f"frame_{number:04d}"


def frame_folders(folder):
    """Existing output folders of an animation's frames, in order.

    Parameters
    ----------
    folder : path
        Output folder of the animation.

    Returns
    -------
    list of pathlib.Path
    """
    frames = [path for path in Path(folder).glob("frame_*") if FRAME.fullmatch(path.name)]
    return sorted(frames, key=lambda path: int(path.name[6:]))


def picture_name(focus, pupil=None):
    """Stem of the file of a refocused image.

    Parameters
    ----------
    focus : float
        Meters.
    pupil : engine.Pupil, optional
        Part of the pupil that the image is seen through.

    Returns
    -------
    str
    """
    part = "" if pupil is None else "_pupil_{:.4g}_{:.4g}_{:.4g}mm".format(*(1e3 * v for v in astuple(pupil)))
    return f"focus_{format_distance(focus)}m{part}"


def picture_files(images, focus, white=None, pupil=None, distances=None):
    """Files of refocused images: linear EXR, and with `white` a viewable PNG.

    Parameters
    ----------
    images : sequence of numpy.ndarray, shape (y, x, 3)
    focus : sequence of float
        World depths, meters.
    white : float, optional
        See `exposure`.
    pupil : engine.Pupil, optional
        Part of the pupil that the images are seen through.
    distances : sequence of float, optional
        Distances from the SLM, millimeters, to name the files by. Default: names by `focus`.

    Returns
    -------
    dict of str to bytes
        Contents by name.
    """
    files = {}
    for number, (image, depth) in enumerate(zip(images, focus, strict=True)):
        name = picture_name(depth, pupil)
        if distances is not None:
            name = name.replace(f"focus_{format_distance(depth)}m", f"distance_{distances[number]:g}mm")
        files[name + ".exr"] = encode_exr(image)
        if white is not None:
            files[name + ".png"] = encode_png(image, white)
    return files


def hologram_files(files):
    """Files of images that phases show, with names beside those of the field's images.

    Parameters
    ----------
    files : dict of str to bytes
        See `picture_files`.

    Returns
    -------
    dict of str to bytes
    """
    return {f"hologram_{name}": data for name, data in files.items()}


def pupil_of(report):
    """Part of the pupil that an output folder's images are seen through.

    Parameters
    ----------
    report : dict
        See `read_report`.

    Returns
    -------
    engine.Pupil or None
        None for the whole pupil.
    """
    return Pupil(**report["pupil_m"]) if report.get("pupil_m") else None


def first_picture(folder, report):
    """Path of an output folder's viewable image at the first focus of its report.

    Parameters
    ----------
    folder : path
    report : dict
        See `read_report`.

    Returns
    -------
    pathlib.Path
        Absolute.
    """
    name = picture_name(float(report["focus_m"][0]), pupil_of(report))
    return Path(folder).absolute() / "reconstruction" / f"{name}.png"


def write_pictures(folder, files):
    """Write files into a folder; none replaces an old one before all are written.

    Parameters
    ----------
    folder : path
        Created if it does not exist.
    files : dict of str to bytes
        Contents by name.

    Raises
    ------
    OSError
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    part = new_folder(folder, ".part-")
    try:
        for name, data in files.items():
            (part / name).write_bytes(data)
        for name in files:
            rename(part / name, folder / name)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def stored_field(folder):
    """Load the wave field of an output folder.

    Parameters
    ----------
    folder : path
        Output folder, or the folder of a field alone.

    Returns
    -------
    engine.WaveField

    Raises
    ------
    InvalidInput
        If the folder has no field.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InvalidInput(f"The folder {folder} does not exist. Give an output folder of `holopath render`.")
    inner = folder / "wavefield"
    return WaveField.load(inner if inner.is_dir() else folder)


def stored_hologram(folder):
    """Load the phase hologram of an output folder.

    Parameters
    ----------
    folder : path
        Output folder, or the folder of a hologram alone.

    Returns
    -------
    engine.PhaseHologram

    Raises
    ------
    InvalidInput
        If the folder has no hologram.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InvalidInput(f"The folder {folder} does not exist. Give a folder with a hologram.")
    inner = folder / "hologram"
    return PhaseHologram.load(inner if inner.is_dir() else folder)


def stored_holograms(folder):
    """Load the phase holograms of an animation's output folder, one per frame, or a still's only one.

    Parameters
    ----------
    folder : path
        See `stored_hologram`.

    Returns
    -------
    list of engine.PhaseHologram

    Raises
    ------
    InvalidInput
        If the folder has no hologram.
    """
    paths = Path(folder).glob("frame_*/hologram")
    matches = ((FRAME.fullmatch(path.parent.name), path) for path in paths)
    frames = sorted((int(match[1]), path) for match, path in matches if match)
    return [PhaseHologram.load(path) for _, path in frames] or [stored_hologram(folder)]


def read_report(folder):
    """Read the report of an output folder.

    Parameters
    ----------
    folder : path

    Returns
    -------
    dict
        Entries by their current names; empty if there is no readable report.
    """
    try:
        report = json.loads((Path(folder) / "report.json").read_text())
    except (OSError, ValueError):
        return {}
    if not isinstance(report, dict):
        return {}
    report = with_current_names("report entry", report, tell=lambda text: None)
    focus = report.get("requested_focus")
    if isinstance(focus, list):
        report["requested_focus"] = [FORMER_NAMES["focus"].get(depth, depth) for depth in focus]
    return report


def write_report(folder, report):
    """Write `report.json` into a folder that is not in its place yet; infinite numbers become the text ``inf``.

    Parameters
    ----------
    folder : path
    report : dict

    Raises
    ------
    OSError
    """
    (Path(folder) / "report.json").write_text(_report(report))


def replace_report(folder, report):
    """Replace `report.json` of an output folder that is in its place; there is always an old or a new one.

    Parameters
    ----------
    folder : path
    report : dict

    Raises
    ------
    OSError
    """
    folder = Path(folder)
    with whole_file(folder / "report.json", folder) as part:
        part.write_text(_report(report))


def _report(report):
    header = {"format": FORMAT, "format_version": FORMAT_VERSION}
    return json.dumps(plain({**header, **report}), indent=1) + "\n"


def plain(value):
    """Copy of a value for JSON: NumPy's numbers as Python's, infinities, NaN and other objects as text.

    Parameters
    ----------
    value : object

    Returns
    -------
    dict, list, str, int, float, bool or None
    """
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not np.isfinite(value):
        return str(value)
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)


def versions():
    """Versions of the programs that results depend on.

    Returns
    -------
    dict of str to (str or None)
        By name; None for a program that is not installed.
    """
    bpy = sys.modules.get("bpy")
    return {
        "holopath": VERSION,
        "python": platform.python_version(),
        "numpy": np.__version__,
        **{name: _installed(name) for name in ("mitsuba", "drjit", "scipy")},
        "blender": bpy.app.version_string if bpy else None,
    }


def machine() -> dict[str, str | int | None]:
    """Return the machine that the seconds of a report are of.

    Returns
    -------
    dict
        `processor`, `threads` to compute with, `system`, and `card`, None where none computes.
    """
    name = platform.processor() or platform.machine()
    with suppress(OSError):  # Python knows no more than the architecture on Linux
        found = re.search(r"model name\s*:\s*(.+)", Path("/proc/cpuinfo").read_text())
        name = found[1].strip() if found else name
    return {
        "processor": name,
        "threads": variants.threads(),
        "system": platform.system(),
        "card": variants.describe()[0]["detail"] if variants.on_card() else None,
    }


def _installed(name):
    """Version of a package, without importing it; None if it is not installed."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return getattr(sys.modules.get(name), "__version__", None)


def output_folder(folder):
    """Context manager of a folder to fill, which replaces `folder` on success and is deleted on failure.

    Parameters
    ----------
    folder : path
        New, empty, or an earlier HoloPath output, which stays until it is replaced.

    Returns
    -------
    context manager
        Gives a hidden folder beside it, `pathlib.Path`.

    Raises
    ------
    InvalidInput
        On entry, if the folder holds other files or cannot be created.
    OSError
    """
    return whole_folder(folder, _check_free)


def _check_free(folder):
    names, own = _contents(folder)
    if names and not (own and names <= _OWN | {read_report(folder).get("contact_sheet")}):
        raise InvalidInput(
            f"The output folder {folder} holds files that are not HoloPath's. Choose a new folder."
        )


def _contents(folder):
    """Names in a folder, and whether it has HoloPath's report; both of the same folder if others replace it."""
    while True:
        try:
            before = folder.stat()
            if not stat.S_ISDIR(before.st_mode):
                break
            names = {entry.name for entry in folder.iterdir() if not is_of_browser(entry.name)}
            own = read_report(folder).get("format") == FORMAT
            if folder.stat().st_ino == before.st_ino:
                return names, own
        except (FileNotFoundError, NotADirectoryError):  # it does not exist, or was moved just now
            if folder.is_symlink():
                break
            return set(), False
    raise InvalidInput(f"The output {folder} is a file. Choose a folder.")
