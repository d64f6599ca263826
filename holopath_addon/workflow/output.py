"""Pictures and the output folder on disk. Imports no bpy; everything appears whole or not at all."""

import json
import os
import platform
import re
import shutil
import stat
import sys
import tempfile
from dataclasses import astuple
from importlib import metadata
from pathlib import Path

import numpy as np

from ..engine import InvalidInput, PhaseHologram, Pupil, WaveField
from ..engine.files import BROWSER_FILES, whole_file, whole_folder
from ..engine.scene import variants
from .lengths import format_distance

FORMAT = "HoloPath output"
FORMAT_VERSION = 1
# HoloPath's own, which only some installations tell; a test holds that pyproject.toml and the manifest say the same.
VERSION = "0.2.0"
FRAME = re.compile(r"frame_(-?[0-9]+)")
SHEET_SIDE, SHEET_GAP, SHEET_GRAY = (
    640,
    8,
    96,
)  # of a contact sheet: pixels of a picture, between two, and around them
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
    """Linear value to show as white: the 99th percentile of all pictures together, so that they compare."""
    white = float(np.percentile(images, 99))
    return white if white > 0 else 1.0


def encode_exr(rgb):
    """OpenEXR file of a linear RGB picture.

    Parameters
    ----------
    rgb : numpy.ndarray, float32, shape (y, x, 3)

    Returns
    -------
    bytes
    """
    mi = variants.bitmaps()
    return _encode(np.ascontiguousarray(rgb, np.float32), mi.Bitmap.FileFormat.OpenEXR)


def encode_png(rgb, white):
    """8-bit sRGB PNG file of a linear RGB picture.

    Parameters
    ----------
    rgb : numpy.ndarray, shape (y, x, 3)
    white : float
        Linear value that becomes white, see `exposure`.

    Returns
    -------
    bytes
    """
    return _encode(_srgb(rgb, white), variants.bitmaps().Bitmap.FileFormat.PNG)


def _srgb(rgb, white):
    """Bytes of a linear picture, IEC 61966-2-1."""
    linear = np.clip(np.asarray(rgb, np.float32) / white, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return (encoded * 255 + 0.5).astype(np.uint8)


def contact_sheet(pictures, lens, phases=None):
    """PNG file that shows a hologram at a glance.

    At the left are the phases of one frame and wavelength, black to white for a turn, each pixel as two by two; the
    middle of them where there are more than fit. At the right are the pictures in pairs, the middle one last, and
    beside it the picture through a thin lens.

    Parameters
    ----------
    pictures : sequence of numpy.ndarray, linear RGB, shape (y, x, 3)
        Focused at each distance, to be shown at one exposure.
    lens : numpy.ndarray, linear RGB, shape (y, x, 3)
        Of a thin lens that is focused as the middle one of the pictures, `middle`.
    phases : numpy.ndarray, shape (y, x), optional
        Radians. Without them there are pictures alone.

    Returns
    -------
    bytes
    """
    order = list(pictures)
    compared = order.pop(middle(order))
    whites = exposure(np.stack(pictures)), exposure(lens)
    tiles = [_tile(picture, whites[0]) for picture in [*order, compared]] + [_tile(lens, whites[1])]
    if len(tiles) % 2:
        tiles.insert(-2, np.full_like(tiles[0], SHEET_GRAY))
    height, width = tiles[0].shape[:2]
    rows, step = len(tiles) // 2, (height + SHEET_GAP, width + SHEET_GAP)
    tall, left = rows * step[0] - SHEET_GAP, 0
    drawn = None
    if phases is not None:
        drawn = np.round(np.asarray(phases) * (256 / (2 * np.pi))).astype(np.int64) % 256
        drawn = _inner(drawn.repeat(2, 0).repeat(2, 1), tall, 2 * width + SHEET_GAP)
        left = drawn.shape[1] + SHEET_GAP
    sheet = np.full((tall, left + 2 * step[1] - SHEET_GAP, 3), SHEET_GRAY, np.uint8)
    if drawn is not None:
        top = (tall - len(drawn)) // 2
        sheet[top : top + len(drawn), : drawn.shape[1]] = drawn[..., None]
    for number, tile in enumerate(tiles):
        y, x = number // 2 * step[0], left + number % 2 * step[1]
        sheet[y : y + height, x : x + width] = tile
    return _encode(sheet, variants.bitmaps().Bitmap.FileFormat.PNG)


def middle(pictures):
    """Index of the picture that a contact sheet compares with a thin lens's."""
    return len(pictures) // 2


def _tile(rgb, white):
    """Bytes of a picture, at most `SHEET_SIDE` pixels wide and high: means of blocks of pixels, which keep speckle."""
    rgb = np.asarray(rgb, np.float32)
    block = -(-max(rgb.shape[:2]) // SHEET_SIDE)
    height, width = (side // block for side in rgb.shape[:2])
    inner = rgb[: height * block, : width * block].reshape(height, block, width, block, 3)
    return _srgb(inner.mean((1, 3)), white)


def _inner(image, height, width):
    """The middle of an image, no larger than that."""
    top, left = (max(0, (have - want) // 2) for have, want in zip(image.shape, (height, width), strict=True))
    return image[top : top + height, left : left + width]


def _encode(pixels, file_format):
    mi = variants.bitmaps()
    stream = mi.MemoryStream()
    mi.Bitmap(pixels).write(stream, file_format)
    return stream.raw_buffer()


def frame_folder(folder, number):
    """Output folder of a frame of an animation that is kept in `folder`."""
    return Path(folder) / f"frame_{number:04d}"


def frame_folders(folder):
    """Output folders of the frames that `folder` keeps of an animation, in order."""
    frames = [path for path in Path(folder).glob("frame_*") if FRAME.fullmatch(path.name)]
    return sorted(frames, key=lambda path: int(path.name[6:]))


def picture_name(focus, pupil=None):
    """Stem of the file of a picture focused at `focus` metres, through a part of the pupil."""
    part = "" if pupil is None else "_pupil_{:.4g}_{:.4g}_{:.4g}mm".format(*(1e3 * v for v in astuple(pupil)))
    return f"focus_{format_distance(focus)}m{part}"


def picture_files(images, focus, white=None, pupil=None, distances=None):
    """Files of focused pictures: linear EXR, and with `white` a viewable PNG.

    Parameters
    ----------
    images : sequence of numpy.ndarray, shape (y, x, 3)
    focus : sequence of float
        Metres.
    white : float, optional
        See `exposure`.
    pupil : engine.Pupil, optional
        The part of it that they are seen through.
    distances : sequence of float, optional
        Millimeters from the SLM, if these were asked for: files are named by them, not by depths in the scene.

    Returns
    -------
    dict
        File name to bytes.
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


def of_phases(files):
    """`picture_files` under the names that pictures of phases have, beside those of the field."""
    return {f"hologram_{name}": data for name, data in files.items()}


def pupil_of(report):
    """The part of the pupil that an output folder's pictures were rendered through; None: all of it."""
    return Pupil(**report["pupil_m"]) if report.get("pupil_m") else None


def first_picture(folder, report):
    """The viewable picture of an output folder that is focused where its report's first focus is; an absolute path."""
    name = picture_name(float(report["focus_m"][0]), pupil_of(report))
    return Path(folder).absolute() / "reconstruction" / f"{name}.png"


def write_pictures(folder, files):
    """Write files into a folder, each replaced only when all have been written beside it.

    Parameters
    ----------
    folder : path
        Made if it does not exist.
    files : dict
        File name to bytes.

    Raises
    ------
    OSError
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=".part-", dir=folder))
    try:
        for name, data in files.items():
            (part / name).write_bytes(data)
        for name in files:
            os.replace(part / name, folder / name)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def stored_field(folder):
    """The wave field of an output folder, or of one that holds nothing else.

    Raises
    ------
    InvalidInput
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InvalidInput(f"The folder {folder} does not exist: give `holopath render`'s output folder.")
    inner = folder / "wavefield"
    return WaveField.load(inner if inner.is_dir() else folder)


def stored_hologram(folder):
    """The phase hologram of an output folder, or of one that holds nothing else.

    Raises
    ------
    InvalidInput
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InvalidInput(f"The folder {folder} does not exist: give one that holds a hologram.")
    inner = folder / "hologram"
    return PhaseHologram.load(inner if inner.is_dir() else folder)


def stored_holograms(folder):
    """Those of an animation's output folder, frame after frame, else the only one.

    Raises
    ------
    InvalidInput
    """
    named = ((FRAME.fullmatch(path.parent.name), path) for path in Path(folder).glob("frame_*/hologram"))
    frames = sorted((int(match[1]), path) for match, path in named if match)
    return [PhaseHologram.load(path) for _, path in frames] or [stored_hologram(folder)]


def read_report(folder):
    """The report of an output folder; empty if it has none that can be read."""
    try:
        report = json.loads((Path(folder) / "report.json").read_text())
    except (OSError, ValueError):
        return {}
    return report if isinstance(report, dict) else {}


def write_report(folder, report):
    """Write `report.json`; infinite numbers become the text ``inf``.

    Raises
    ------
    OSError
    """
    (Path(folder) / "report.json").write_text(_report(report))


def replace_report(folder, report):
    """Write `report.json` of an output folder that is in its place: the old one or the new one is there.

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
    """JSON-able copy: numpy numbers as Python's, infinities and NaN as text."""
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
    """Versions of what the result depends on; names to text. Says `None` for what is not there."""
    bpy = sys.modules.get("bpy")
    return {
        "holopath": VERSION,
        "python": platform.python_version(),
        "numpy": np.__version__,
        **{name: _installed(name) for name in ("mitsuba", "drjit", "scipy")},
        "blender": bpy.app.version_string if bpy else None,
    }


def _installed(name):
    """Version of a package, which is not imported for that."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return getattr(sys.modules.get(name), "__version__", None)


def output_folder(folder):
    """Folder to fill; it takes the place of `folder` when the block ends well, and vanishes otherwise.

    Parameters
    ----------
    folder : path
        New, empty, or an earlier HoloPath output, which stays until it is replaced.

    Returns
    -------
    context manager
        Of a hidden folder beside it, `pathlib.Path`.

    Raises
    ------
    InvalidInput
        At once if the folder holds something else or cannot be made.
    OSError
    """
    return whole_folder(folder, _check_free)


def _check_free(folder):
    names, own = _contents(folder)
    if names and not (own and names <= _OWN | {read_report(folder).get("contact_sheet")}):
        raise InvalidInput(
            f"The output folder {folder} holds files that are not HoloPath's: choose a new folder."
        )


def _contents(folder):
    """Names in a folder, and whether it has a report of ours; of one and the same folder where others replace it."""
    while True:
        try:
            before = folder.stat()
            if not stat.S_ISDIR(before.st_mode):
                break
            names = {entry.name for entry in folder.iterdir()}.difference(BROWSER_FILES)
            own = read_report(folder).get("format") == FORMAT
            if folder.stat().st_ino == before.st_ino:
                return names, own
        except (FileNotFoundError, NotADirectoryError):  # never there, or moved away just now
            if folder.is_symlink():
                break
            return set(), False
    raise InvalidInput(f"The output {folder} is a file: choose a folder.")
