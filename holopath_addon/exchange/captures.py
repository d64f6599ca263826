"""Files of pictures, depths, point clouds and views, and the scenes that they are."""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..engine import Camera, InvalidInput
from ..engine.scene import variants
from ..engine.scene.captured.picture import FIELD_OF_VIEW, picture_scene
from ..engine.scene.captured.points import MAX_POINTS, VIEWERS, point_scene
from ..engine.scene.captured.views import view_scene

if TYPE_CHECKING:
    import mitsuba as mi

PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".exr", ".hdr")
DEPTHS = (".exr", ".png", ".npy")
POINTS = (".ply",)
VIEWS = (".npy",)  # besides quilts, which are pictures
SUFFIXES = (*PICTURES, *POINTS, *VIEWS)
# End of a quilt's name, as Looking Glass displays read it: columns, rows, and the width of a view over its height.
QUILT = re.compile(r"_qs([1-9]\d*)x([1-9]\d*)a(\d+(?:\.\d+)?)$")
UNITS = ("m", "mm", "diopters", "inverse")  # of the numbers of a depth file
UNIT_WORDS = (
    "m, mm, diopters (1/m), or inverse (from 0 at the far one of --depth-ends FAR,NEAR to 1 at the near one)"
)
ALONG = ("axis", "ray")  # the camera's axis, or the line of sight
# Axes of a point cloud as the viewer's right, up and back: rows of what turns its points into view.
AXES = {
    "y-up": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "y-down": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "z-up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}
AXES_WORDS = (
    "y-up (seen along -z, as in glTF), y-down (along +z, as cameras of OpenCV and COLMAP have it), or z-up (along +y, "
    "as in Blender)"
)
DEPTH_CHANNELS = ("z", "depth", "v", "y")  # last words of the names that renderers give it, in small letters
MAX_PIXELS = 1 << 26  # of a picture, as of a hologram
ANOTHER_SHAPE = 0.01  # relative difference of aspects
_NUMBERS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4",
    "double": "f8", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
MAX_HEADER = 1 << 16  # bytes of a PLY file's header


@dataclass(frozen=True)
class CaptureOptions:
    """What the files of a capture do not say of themselves.

    Attributes
    ----------
    depth : str or None
        File of a picture's depth.
    depth_unit : str or None
        One of `UNITS`.
    depth_ends : sequence of float, or None
        Depths in meters of the inverse depths 0 and 1.
    depth_along : str or None
        One of `ALONG`: of what depths are distances. Default: the axis.
    fov : float or None
        Full horizontal field of view, degrees.
    axes : str or None
        One of `AXES`, of a point cloud.
    point_radius : float or None
        Meters.
    view_span : sequence of float, or None
        Distance from the first view to the last, to the right, and down where there are several rows, meters.
    view_focus : float or None
        Distance of the plane at which all views agree, meters.
    view_panel : float or None
        Distance of the panel that shows them, meters. Default: that at which they agree.
    """

    depth: str | None = None
    depth_unit: str | None = None
    depth_ends: tuple | None = None
    depth_along: str | None = None
    fov: float | None = None
    axes: str | None = None
    point_radius: float | None = None
    view_span: tuple | None = None
    view_focus: float | None = None
    view_panel: float | None = None

    @property
    def given(self) -> list[str]:
        """Names of those that are given."""
        return [each.name for each in fields(self) if getattr(self, each.name) is not None]

    def to_dict(self) -> dict:
        """JSON-able form of those that are given, with the depth file's whole path; see `from_dict`."""
        kept = {name: value for name, value in asdict(self).items() if value is not None}
        if self.depth is not None:
            kept["depth"] = str(Path(self.depth).absolute())
        return kept

    @classmethod
    def from_dict(cls, values: dict) -> CaptureOptions:
        """Inverse of `to_dict`."""
        known = {each.name for each in fields(cls)}
        kept = {name: value for name, value in values.items() if name in known}
        if "view_focus" in kept:
            kept["view_focus"] = float(kept["view_focus"])  # JSON has no infinity, so it is text there
        return cls(**kept)


@dataclass(frozen=True)
class CapturedScene:
    """A capture as a scene.

    Attributes
    ----------
    scene : mitsuba.Scene
    camera : Camera
    notes : list of dict
        What was taken for granted: object, feature, effect, material.
    """

    scene: mi.Scene
    camera: Camera
    notes: list


def capture(path: Path, options: CaptureOptions) -> PictureFile | PointFile | ViewFile:
    """Open a picture with depth, a point cloud or views; its options are checked, and its files are not read yet.

    Raises
    ------
    InvalidInput
        If an option is missing, or is not for such a file.
    """
    suffix = path.suffix.lower()
    if suffix in POINTS:
        return PointFile(path, options)
    named = QUILT.search(path.stem) and options.depth is None
    given = any(name.startswith("view_") for name in options.given)
    return (ViewFile if suffix in VIEWS or named or given else PictureFile)(path, options)


class PictureFile:
    """A picture with a depth for each pixel.

    Parameters
    ----------
    path : Path
        The picture; see `PICTURES`.
    options : CaptureOptions
    """

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self.path, self._options = path, options
        _refuse(options, ("axes", "point_radius"), f"{path} is a picture, not a .ply")
        if options.depth is None:
            raise InvalidInput(
                f"{path} is a picture without depth: add --depth FILE and --depth-unit, or end the name of a quilt "
                "with its layout, as _qs8x6a0.75."
            )
        self.depth_path = Path(options.depth)
        if not self.depth_path.is_file():
            raise InvalidInput(f"The depth {options.depth} does not exist: give a file that does.")
        if self.depth_path.suffix.lower() not in DEPTHS:
            raise InvalidInput(f"The depth {options.depth} must end on one of {', '.join(DEPTHS)}.")
        if options.depth_unit not in UNITS:
            raise InvalidInput(
                f"{options.depth} does not say what its numbers are: add --depth-unit with {UNIT_WORDS}."
            )
        if (options.depth_unit == "inverse") != (options.depth_ends is not None):
            raise InvalidInput(
                "--depth-unit inverse needs --depth-ends FAR,NEAR, in meters, and no other unit has them: give both or "
                "neither."
            )
        _check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths by names."""
        return {"picture": self.path, "depth": self.depth_path}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.image.shape[1], self.image.shape[0]

    @property
    def size_from(self) -> str:
        """Where the size is from, as words."""
        return f"the picture {self.path.name}"

    @cached_property
    def image(self) -> np.ndarray:
        """Linear radiance, float32, shape (y, x, 3)."""
        return read_picture(self.path)

    def depth(self, fov: float) -> np.ndarray:
        """Distance of each pixel along the camera's axis, meters, float64, shape (y, x).

        Parameters
        ----------
        fov : float
            Full horizontal field of view, radians, by which distances along the line of sight are converted.

        Raises
        ------
        InvalidInput
            If the files cannot be read, their sizes differ or a depth is not positive and finite.
        """
        depth = read_depth(self.depth_path, self._options.depth_unit or "", self._options.depth_ends)
        if depth.shape != self.image.shape[:2]:
            raise InvalidInput(
                f"{self.path} has {self.size[0]} x {self.size[1]} pixels and {self.depth_path} has {depth.shape[1]} x "
                f"{depth.shape[0]}: give a depth for each pixel."
            )
        return depth / _lengths(self.size, fov) if self._options.depth_along == "ray" else depth

    def build(self, size: tuple[int, int], camera: str | None = None) -> CapturedScene:
        """Make the scene, for a hologram of `size` pixels.

        Raises
        ------
        InvalidInput
            As of `depth`, or if a `camera` is named.
        """
        if camera is not None:
            raise InvalidInput(f"{self.path} has no camera '{camera}': leave out --camera.")
        fov = _fov(self._options)
        depth = self.depth(fov)
        notes = [_fov_note(self.path, self._options)] if self._options.fov is None else []
        notes += _shape_notes(self.path, self.size, size)
        image, depth, (kept, _) = reduced(self.image, depth, size)
        try:
            scene, viewer = picture_scene(image, depth, 2 * math.atan(kept * math.tan(fov / 2)))
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}, {self.depth_path}: {error}") from None
        return CapturedScene(scene, viewer, notes)


class ViewFile:
    """Views from a row or a grid of viewpoints: a quilt, or an array.

    Parameters
    ----------
    path : Path
        A picture whose name ends as `QUILT`; or an .npy of the shape (view, y, x, 3), from the left to the right, or
        (view row, view column, y, x, 3), from the top left. Whole numbers are sRGB, floating-point numbers are linear.
    options : CaptureOptions
    """

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self.path, self._options = path, options
        _refuse(
            options,
            ("depth", "depth_unit", "depth_ends", "depth_along", "axes", "point_radius"),
            f"{path} holds views, without depth",
        )
        self._layout = QUILT.search(path.stem)
        if self._layout is None and path.suffix.lower() not in VIEWS:
            raise InvalidInput(
                f"{path} does not say how its views lie: end its name with columns, rows and the width of a view over "
                "its height, as quilt_qs8x6a0.75.png, or leave out --view-span, --view-focus and --view-panel."
            )
        if options.view_span is None or options.view_focus is None:
            raise InvalidInput(
                f"{path} does not say where its views were seen from: add --view-span with the meters from the first "
                "view to the last, and --view-focus with the distance at which all views agree."
            )
        if options.view_focus == math.inf and options.view_panel is None:
            raise InvalidInput(
                f"{path} has views that agree at infinity: add --view-panel with a distance in the middle of what they "
                "show, at which it is sharpest."
            )
        _check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths by names."""
        return {"views": self.path}

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a view in square pixels."""
        height, width = self.views.shape[2:4]
        return width, max(1, round(width / self._aspect)) if self._layout else height

    @property
    def size_from(self) -> str:
        """Where the size is from, as words."""
        return f"a view of {self.path.name}"

    @property
    def _aspect(self):
        height, width = self.views.shape[2:4]
        return float(self._layout[3]) if self._layout else width / height

    @cached_property
    def views(self) -> np.ndarray:
        """Linear radiance, float32, shape (view row, view column, y, x, 3).

        Raises
        ------
        InvalidInput
            If the file cannot be read, or has another shape.
        """
        if self._layout is None:
            return _view_array(self.path)
        columns, rows, aspect = int(self._layout[1]), int(self._layout[2]), float(self._layout[3])
        image = read_picture(self.path)
        height, width = image.shape[:2]
        if height % rows or width % columns or aspect == 0:
            raise InvalidInput(
                f"{self.path} has {width} x {height} pixels, which are not {columns} x {rows} views of one size: crop "
                "it, or correct its name."
            )
        cut = image.reshape(rows, height // rows, columns, width // columns, 3).swapaxes(1, 2)
        return cut[::-1].reshape(1, -1, *cut.shape[2:])  # the first view is at the lower left

    def build(self, size: tuple[int, int], camera: str | None = None) -> CapturedScene:
        """Make the scene, for a hologram of `size` pixels.

        Raises
        ------
        InvalidInput
            As of `views`, if the span is not of such views, or if a `camera` is named.
        """
        options, views = self._options, self.views
        if camera is not None:
            raise InvalidInput(f"{self.path} has no camera '{camera}': leave out --camera.")
        rows, columns = views.shape[:2]
        span, needed = tuple(options.view_span or ()), 2 if rows > 1 and columns > 1 else 1
        if len(span) != needed:
            raise InvalidInput(
                f"{self.path} has {columns} x {rows} views: give {needed} number{'s' if needed > 1 else ''} with "
                f"--view-span, {'RIGHT,DOWN' if needed > 1 else 'from the first view to the last'}, not {len(span)}."
            )
        if needed == 1:
            span = (0.0, *span) if columns == 1 else (*span, 0.0)
        notes = [_fov_note(self.path, options)] if options.fov is None else []
        notes += _shape_notes(self.path, self.size, size)
        if rows == 1 or columns == 1:
            effect = "no parallax across the row: before and behind the panel lines along it stay focused on the panel"
            notes.append(_note(self.path, "one row of views", effect))
        try:
            scene, viewer = view_scene(
                views, span, options.view_focus or 0.0, _fov(options), self._aspect, options.view_panel
            )
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}: {error}") from None
        return CapturedScene(scene, viewer, notes)


class PointFile:
    """A point cloud with a color for each point.

    Parameters
    ----------
    path : Path
        A .ply.
    options : CaptureOptions
    """

    size, size_from = (512, 512), "HoloPath's default"

    def __init__(self, path: Path, options: CaptureOptions) -> None:
        self.path, self._options = path, options
        _refuse(
            options,
            ("depth", "depth_unit", "depth_ends", "depth_along", "view_span", "view_focus", "view_panel"),
            f"{path} is a point cloud, not a picture",
        )
        if options.axes not in AXES:
            raise InvalidInput(f"{path} does not say how its axes lie: add --axes with {AXES_WORDS}.")
        _check_fov(options)

    @property
    def files(self) -> dict[str, Path]:
        """Paths by names."""
        return {"points": self.path}

    def build(self, size: tuple[int, int], camera: str | None = None) -> CapturedScene:
        """Make the scene, for a hologram of `size` pixels; `camera` is `front`, which is the default, or `origin`.

        Raises
        ------
        InvalidInput
            If the file cannot be read, or there is no such camera.
        """
        options = self._options
        camera = camera or VIEWERS[0]
        if camera not in VIEWERS:
            raise InvalidInput(
                f"{self.path} has no camera '{camera}': choose --camera front, before all points, or --camera origin."
            )
        places, colors = read_points(self.path)
        notes = [_fov_note(self.path, options)] if options.fov is None else []
        there = np.isfinite(places).all(1) & np.isfinite(colors).all(1)
        if not there.all():
            count = np.count_nonzero(~there)
            notes.append(_note(self.path, f"{count} points that are not finite numbers", "left out"))
        places = places[there] @ np.array(AXES[options.axes or ""], float).T
        try:
            scene, viewer = point_scene(
                places, colors[there], options.point_radius, _fov(options), size[0] / size[1], camera
            )
        except InvalidInput as error:
            raise InvalidInput(f"{self.path}: {error}") from None
        return CapturedScene(scene, viewer, notes)


def _refuse(options, names, why):
    for name in names:
        if name in options.given:
            raise InvalidInput(f"{why}: leave out --{name.replace('_', '-')}.")


def _check_fov(options):
    if options.fov is not None and not 0 < options.fov < 180:
        raise InvalidInput(f"The field of view must lie between 0 and 180 degrees, not {options.fov:g}.")


def _fov(options):
    return FIELD_OF_VIEW if options.fov is None else math.radians(options.fov)


def _lengths(size, fov):
    """Of the line of sight through each pixel's center, to depth 1."""
    pixel = 2 * math.tan(fov / 2) / size[0]
    across, down = ((np.arange(side) - 0.5 * (side - 1)) * pixel for side in size)
    return np.sqrt(1 + across**2 + down[:, None] ** 2)


def _fov_note(path, options):
    effect = "that of a 50 mm lens on 36 mm of film, for nothing else is said; --fov DEGREES for another one"
    return _note(path, f"field of view of {math.degrees(_fov(options)):.1f} degrees", effect)


def _shape_notes(path, own, size):
    """A note where a hologram of another shape does not show all of a picture of `own` width and height."""
    if abs(size[0] * own[1] / (size[1] * own[0]) - 1) <= ANOTHER_SHAPE:
        return []
    effect = (
        f"the hologram's {size[0]} x {size[1]} have another shape: the width of the view is kept; leave out "
        "--resolution and --display to see all"
    )
    return [_note(path, f"{own[0]} x {own[1]} pixels", effect)]


def _note(path, feature, effect):
    return {"object": path.name, "feature": feature, "effect": effect, "material": ""}


def read_picture(path: Path) -> np.ndarray:
    """Read a picture: EXR and HDR files are linear, the others sRGB, which is decoded.

    Returns
    -------
    numpy.ndarray, float32, shape (y, x, 3)
        Linear RGB.

    Raises
    ------
    InvalidInput
        If it cannot be read, or is partly transparent.
    """
    pixels, names = _pixels(path)
    full = np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1.0
    alpha = next((k for k, name in enumerate(names) if name == "A"), None)
    if alpha is not None and (pixels[..., alpha] < full).any():
        raise InvalidInput(f"{path} is transparent in places: lay it on a color first.")
    wanted = ["R", "G", "B"] if {"R", "G", "B"} <= set(names) else ["Y"] * 3
    if not set(wanted) <= set(names):
        raise InvalidInput(f"{path} has no colors, but {', '.join(names)}: give a picture of RGB or gray.")
    color = pixels[..., [names.index(name) for name in wanted]].astype(np.float32)
    return np.ascontiguousarray(color if pixels.dtype.kind == "f" else linear(color / np.float32(full)))


def linear(encoded: np.ndarray) -> np.ndarray:
    """Decode sRGB (IEC 61966-2-1), 0 to 1."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def read_depth(path: Path, unit: str, ends: tuple | None = None) -> np.ndarray:
    """Read the depth of each pixel of a picture.

    Parameters
    ----------
    path : Path
        An EXR file of any floating-point numbers, a PNG file of 8 or 16 bits, or a NumPy array of either. Levels of
        whole numbers are taken as they are; of inverse depth the highest level is 1.
    unit : str
        One of `UNITS`.
    ends : (float, float), optional
        Depths in meters of the inverse depths 0 and 1.

    Returns
    -------
    numpy.ndarray, float64, shape (y, x)
        Meters.

    Raises
    ------
    InvalidInput
        If it cannot be read, has several channels that differ, or a number that is not a positive, finite depth.
    """
    if unit not in UNITS:
        raise InvalidInput(f"There is no unit of depth '{unit}': choose {UNIT_WORDS}.")
    pixels, names = _pixels(path)
    numbers = pixels[..., _depth_channel(path, pixels, names)].astype(np.float64)
    if unit == "inverse":
        return _between(path, numbers / (np.iinfo(pixels.dtype).max if pixels.dtype.kind == "u" else 1), ends)
    good = np.isfinite(numbers) & (numbers > 0)
    if not good.all():
        row, column = np.argwhere(~good)[0]
        raise InvalidInput(
            f"{path} has {np.count_nonzero(~good)} pixels without a positive, finite depth, the first of them "
            f"{numbers[row, column]:g} in column {column}, row {row}: fill them in, and give what is far away a depth "
            "such as 1000 m."
        )
    return 1 / numbers if unit == "diopters" else numbers * (1e-3 if unit == "mm" else 1.0)


def _between(path, share, ends):
    """Depths of shares of the way from the inverse depth of one end to that of the other."""
    if ends is None or not (math.isfinite(ends[0]) and ends[0] > ends[1] > 0):
        raise InvalidInput(
            "The ends of inverse depths (--depth-ends FAR,NEAR) must be positive and finite, and the far one larger."
        )
    if not ((share >= 0) & (share <= 1)).all():
        raise InvalidInput(
            f"{path} has numbers from {np.nanmin(share):g} to {np.nanmax(share):g}: inverse depths must lie between 0 "
            "at the far end and 1 at the near one."
        )
    return 1 / (1 / ends[0] + share * (1 / ends[1] - 1 / ends[0]))


def _depth_channel(path, pixels, names):
    """Number of the channel that holds the depth."""
    colors = [k for k, name in enumerate(names) if name != "A"]
    if len(colors) == 1:
        return colors[0]
    named = [k for k in colors if names[k].lower().rpartition(".")[2] in DEPTH_CHANNELS]
    if len(named) == 1:
        return named[0]
    if all(np.array_equal(pixels[..., k], pixels[..., colors[0]], equal_nan=True) for k in colors[1:]):
        return colors[0]
    raise InvalidInput(
        f"{path} has several channels that differ ({', '.join(names)}): give a depth file of one channel."
    )


def _pixels(path):
    """Pixels [y, x, channel] of an image file, of unsigned or floating-point numbers, and the channels' names."""
    try:
        pixels, names = _array(path) if path.suffix.lower() == ".npy" else _bitmap(path)
    except Exception as error:  # there is no end to what a file may hold
        reason = " ".join(str(error).split())[:200]
        raise InvalidInput(f"{path} cannot be read as a picture ({reason}): give another file.") from None
    if pixels.dtype.kind not in "uf":
        raise InvalidInput(
            f"{path} has pixels of {pixels.dtype}: give 8 or 16 bits, or floating-point numbers."
        )
    return pixels.reshape(*pixels.shape[:2], -1), names


def _bitmap(path):
    bitmap = variants.bitmaps().Bitmap(str(path))
    if bitmap.pixel_count() > MAX_PIXELS:
        raise ValueError(f"it has over {MAX_PIXELS >> 20} megapixels")
    return np.array(bitmap), [field.name for field in bitmap.struct_()]


def _array(path):
    pixels = np.load(path, allow_pickle=False)
    if pixels.ndim != 2:
        raise ValueError(f"it has the shape {pixels.shape} instead of rows and columns")
    return pixels, ["Y"]


def _view_array(path):
    """Views of an array's file, as of `ViewFile.views`."""
    try:
        array = np.load(path, allow_pickle=False, mmap_mode="r")
        if array.ndim not in (4, 5) or array.shape[-1] != 3 or not array.size:
            raise ValueError(
                f"it has the shape {array.shape} instead of (view, y, x, 3) or (view row, view column, y, x, 3)"
            )
        if array.size > 3 * MAX_PIXELS:
            raise ValueError(f"it has over {MAX_PIXELS >> 20} megapixels")
        if array.dtype not in (np.uint8, np.uint16) and array.dtype.kind != "f":
            raise ValueError(
                f"it has numbers of {array.dtype} instead of 8 or 16 bits, or floating-point ones"
            )
        views = np.array(array, np.float32)
    except Exception as error:  # there is no end to what a file may hold
        reason = " ".join(str(error).split())[:200]
        raise InvalidInput(f"{path} cannot be read as views ({reason}): give another file.") from None
    if array.dtype.kind == "u":
        views = linear(views / np.float32(np.iinfo(array.dtype).max)).astype(np.float32)
    return views.reshape(-1, *views.shape[-4:])


def reduced(
    image: np.ndarray, depth: np.ndarray, size: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Make a picture with depth smaller, if along both sides it has twice the pixels of a hologram of `size`, or more.

    Blocks of pixels become one, with the mean of their colors and the median of their depths, the nearer one of two.
    What is over at the borders is left out.

    Returns
    -------
    image : numpy.ndarray, shape (y, x, 3)
    depth : numpy.ndarray, shape (y, x)
    kept : (float, float)
        Fractions of width and height.
    """
    block = min(image.shape[1] // size[0], image.shape[0] // size[1])
    if block < 2:
        return image, depth, (1.0, 1.0)
    height, width = depth.shape
    rows, columns = height // block, width // block
    inner = tuple(
        slice((side - count * block) // 2, (side - count * block) // 2 + count * block)
        for side, count in ((height, rows), (width, columns))
    )
    image = image[inner].reshape(rows, block, columns, block, 3).mean((1, 3))
    blocks = depth[inner].reshape(rows, block, columns, block).swapaxes(1, 2).reshape(rows, columns, -1)
    middle = (block**2 - 1) // 2
    kept = columns * block / width, rows * block / height
    return image, np.partition(blocks, middle, axis=-1)[..., middle], kept


def read_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Read the vertices of a PLY file, of text or binary.

    Returns
    -------
    points : numpy.ndarray, float64, shape (point, 3)
    colors : numpy.ndarray, float32, shape (point, 3)
        Linear RGB: whole numbers are decoded as sRGB, floating-point ones are taken as they are.

    Raises
    ------
    InvalidInput
        If it cannot be read, has faces, or its vertices have no colors.
    """
    try:
        with open(path, "rb") as file:
            order, elements = _ply_header(file)
            vertices = _ply_vertices(path, file, order, elements)
    except InvalidInput:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InvalidInput(f"{path} cannot be read as a PLY file ({reason}): give another file.") from None
    places = np.stack([vertices[name].astype(np.float64) for name in "xyz"], -1)
    channels = [vertices[name] for name in ("red", "green", "blue")]
    colors = np.stack([channel.astype(np.float32) for channel in channels], -1)
    if channels[0].dtype.kind in "iu":
        colors = linear(colors / np.float32(np.iinfo(channels[0].dtype).max))
    return places, colors


def _ply_header(file):
    """Byte order, and the elements in order: name, count and properties, which are names with types, None of a list."""
    if file.readline(8).strip() != b"ply":
        raise ValueError("it does not begin with the line ply")
    order, elements, size = None, [], 0
    while True:
        line = file.readline(MAX_HEADER)
        size += len(line)
        if not line or size > MAX_HEADER:
            raise ValueError("its header does not end")
        words = line.decode("ascii", "replace").split()
        if words[:1] == ["end_header"]:
            break
        if words[:1] == ["format"]:
            order = words[1]
        elif words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            elements[-1][2].append((words[-1], None if words[1] == "list" else _NUMBERS[words[1]]))
    if order not in _ORDERS:
        raise ValueError(f"its format is {order}")
    return order, elements


def _ply_vertices(path, file, order, elements):
    """Arrays of the vertices' properties by name."""
    counts = {name: count for name, count, _ in elements}
    if counts.get("face"):
        raise InvalidInput(
            f"{path} has faces: leave them out to show its points, or make it a shape of type ply of a Mitsuba .xml to "
            "show its surface."
        )
    if not counts.get("vertex"):
        raise InvalidInput(f"{path} has no vertices: give a PLY file with points.")
    if counts["vertex"] > MAX_POINTS:
        raise InvalidInput(f"{path} has {counts['vertex']} points: thin them out to {MAX_POINTS} at most.")
    for name, count, properties in elements:
        lists = any(kind is None for _, kind in properties)
        if name == "vertex":
            break
        if order == "ascii":
            for _ in range(count):
                file.readline()
        elif lists and count:
            raise ValueError(f"lists of the element {name} come before its vertices")
        else:
            file.seek(count * sum(np.dtype(kind).itemsize for _, kind in properties), 1)
    names = [each for each, _ in properties]
    missing = [each for each in ("x", "y", "z", "red", "green", "blue") if each not in names]
    if missing:
        raise InvalidInput(
            f"{path} has no {', '.join(missing)} of its vertices: give points with the properties x, y, z, red, green "
            "and blue."
        )
    if lists:
        raise ValueError("its vertices have lists")
    kinds = np.dtype([(each, _ORDERS[order] + kind) for each, kind in properties])
    if order == "ascii":
        table = np.loadtxt(file, max_rows=count, ndmin=2, dtype=np.float64)
        if table.shape != (count, len(names)):
            raise ValueError(f"it has {len(table)} vertices of {count}")
        return {each: table[:, k].astype(kinds[each]) for k, each in enumerate(names)}
    table = np.frombuffer(file.read(count * kinds.itemsize), kinds)
    if len(table) != count:
        raise ValueError(f"it has {len(table)} vertices of {count}")
    return {each: table[each] for each in names}


def with_depth_beside(options: CaptureOptions, path: Path) -> CaptureOptions:
    """The options, with a depth file that is not there looked for beside the picture."""
    if options.depth is None or Path(options.depth).exists():
        return options
    return replace(options, depth=str(path.parent / Path(options.depth).name))
