"""Hologram to display: its grid, colors and depth volume."""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from .errors import InvalidInput, real_number, real_numbers
from .optics import ON_AXIS, Lens, Optics
from .pixels import EvenSteps, Pitch, Raster, axes, coarsest
from .settings.choices import DEPTH_MAPPINGS

# Default depth range in meters from the SLM, negative behind it, for displays whose shorter side is 512 pixels of 8 µm
# or longer. Scenes at the near end and up to twice its distance are at most 1.5 mm from the SLM. Measured:
# docs/measurements.md, How near to the SLM.
DEPTH_RANGE, SHORTER_SIDE = (-4e-3, 1e-3), 4.096e-3
SHORTER_PIXELS, PIXEL = 512, 8e-6  # the same in pixels
SAME = 1e-9  # meters: planes that are nearer to each other are the same
LITTLE = 1e-6  # of a pixel: tolerance for rounding
MAX_PIXELS = 1 << 26
MIN_CAPTURED = 0.9  # fraction of the light through the aperture below which borders are visibly dark


@dataclass(frozen=True)
class Hologram:
    """Grid, wavelengths and depth volume of a hologram. The SLM lies at z = 0, light runs to +z.

    Parameters
    ----------
    width, height : int
        Numbers of pixels.
    pitch : float or (float, float)
        Pixel pitch d, meters; (x, y) for pixels that are not square. Two equal numbers become one. The recordable cone
        has the half-angle asin(wavelength / (2 d)) with the larger d: the round one that fits both directions.
    wavelengths : tuple of float
        Vacuum wavelengths, meters. Each shows the red, green or blue radiance of the scene, see `channel`.
    depth_far, depth_near : float
        Distance from the SLM of the far end (world infinity) and of the near end, meters, negative behind it. Default:
        around the SLM, so that its aperture shows both without dark edges. With a lens and ``fit`` they are distances
        from the plane of the image `in_air`; with a lens and ``eyepiece`` the far end is its front focal plane.
    depth_mapping : {'fit', 'eyepiece'}
        Mapping of world depths to the volume, see `mapping.DepthMapping`.
    near : float, optional
        World depth that `fit` maps to `depth_near`, meters. Default: the nearest visible surface.
    optics : Optics
        Bench around the SLM.

    Raises
    ------
    InvalidInput
        If a value is out of range or does not fit the others.

    Examples
    --------
    >>> from holopath_addon import engine
    >>> hologram = engine.Hologram(512, 512, pitch=8e-6)
    >>> hologram.wavelengths
    (6.4e-07, 5.165e-07, 4.554e-07)
    >>> hologram.depth_far, hologram.depth_near
    (-0.004, 0.001)
    """

    width: int
    height: int
    pitch: Pitch
    wavelengths: tuple = (640e-9, 516.5e-9, 455.4e-9)
    # pyrefly: ignore[bad-assignment]  # numbers from `__post_init__` on
    depth_far: float = None
    # pyrefly: ignore[bad-assignment]
    depth_near: float = None
    depth_mapping: str = "fit"
    near: float | None = None
    optics: Optics = field(default_factory=Optics)

    def __post_init__(self):
        object.__setattr__(self, "wavelengths", real_numbers(self.wavelengths, "wavelengths"))
        self._set_numbers()
        if self.width < 1 or self.height < 1:
            raise InvalidInput(
                f"Expected a resolution of at least 1 x 1 pixels, got {self.width} x {self.height}."
            )
        if self.width * self.height > MAX_PIXELS:
            raise InvalidInput(
                f"Expected a resolution of up to 67 megapixels, got {self.width} x {self.height} pixels."
            )
        object.__setattr__(self, "pitch", _pitch(self.pitch))
        if not self.wavelengths:
            raise InvalidInput("Expected at least one wavelength, got none.")
        for wavelength in self.wavelengths:
            if not 100e-9 <= wavelength <= 10e-6:
                raise InvalidInput(
                    f"Expected wavelengths from 100 nm to 10000 nm, got {wavelength * 1e9:g} nm."
                )
            if wavelength >= 2 * min(axes(self.pitch)):
                raise InvalidInput(
                    f"The pixel pitch {min(axes(self.pitch)) * 1e6:g} µm is too small for {wavelength * 1e9:g} nm. "
                    f"Make it larger than half the wavelength."
                )
        self._check_lens()
        for name, default in zip(("depth_far", "depth_near"), self._depth_range(), strict=True):
            if getattr(self, name) is None:
                object.__setattr__(self, name, default)
        if not (
            math.isfinite(self.depth_far)
            and math.isfinite(self.depth_near)
            and self.depth_near > self.depth_far
        ):
            raise InvalidInput(
                f"Expected a depth range whose near end is larger than its far end, got "
                f"{self.depth_far * 1e3:g} mm (far) to {self.depth_near * 1e3:g} mm (near)."
            )
        if self.depth_mapping not in DEPTH_MAPPINGS:
            raise InvalidInput(
                f"Expected a depth mapping, got '{self.depth_mapping}'. Choose one of {', '.join(DEPTH_MAPPINGS)}."
            )
        if self.near is not None and not (math.isfinite(self.near) and self.near > 0):
            raise InvalidInput(f"Expected a positive distance of the scene's near end, got {self.near:g} m.")
        self.optics.check((self.height, self.width), self.pitch, self.wavelengths)

    def _set_numbers(self):
        """Set numbers of any type to those of Python, which JSON has."""
        for name in ("width", "height"):
            try:
                object.__setattr__(self, name, operator.index(getattr(self, name)))
            except TypeError:
                raise InvalidInput(
                    f"Expected whole numbers of pixels, got {self.width} x {self.height}."
                ) from None
        for name in ("depth_far", "depth_near", "near"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, real_number(getattr(self, name), name))

    def _check_lens(self):
        """Check that the lens fits the other values."""
        lens = self.optics.lens
        if lens is None:
            return
        if self.depth_mapping != "eyepiece":
            if self.optics.stopped:
                raise InvalidInput(
                    "Carrier and stop are in a relay's Fourier plane, but behind a lens the picture itself is there. "
                    "Omit the carrier and the stop, or the lens."
                )
            if self.optics.colors_apart:
                raise InvalidInput(
                    "The scale, distance and shift of colors cannot be corrected for a picture behind a lens. Omit "
                    "these, or the lens."
                )
            pixel = _aerial_pitch(self)
            if pixel <= max(self.wavelengths):
                raise InvalidInput(
                    f"The lens makes the picture's pixels {pixel * 1e6:.3g} µm wide, too small for light of "
                    f"{max(self.wavelengths) * 1e9:g} nm. Choose a longer focal length."
                )
            return
        if lens.share != 1:
            raise InvalidInput(
                "With the depth mapping eyepiece the viewer looks through the lens, and there is no picture behind it. "
                "Omit the picture's share, or choose the depth mapping fit."
            )
        if lens.picture is not None:
            raise InvalidInput(
                "With the depth mapping eyepiece the viewer looks through the lens, and there is no picture behind it. "
                "Omit the picture's distance, or choose the depth mapping fit."
            )
        infinity = lens.distance - lens.focal
        if self.depth_far is not None and abs(self.depth_far - infinity) > SAME:
            raise InvalidInput(
                f"The lens has infinity in its front focal plane, {infinity * 1e3:g} mm from the SLM, and the depth "
                f"range has it at {self.depth_far * 1e3:g} mm. Omit the depth range, or give the lens another distance."
            )

    def _depth_range(self):
        """Default depth range, which the aperture shows without dark edges.

        Light spreads on its way to the SLM, by slope times distance, and the picture's border loses the part that
        misses the aperture. Therefore the volume lies around the SLM, and is less deep for a small display. Around the
        plane of an image behind a lens it has the same depth in depths of focus.
        """
        lens = self.optics.lens
        if lens is not None and self.depth_mapping == "eyepiece":
            far, span = lens.distance - lens.focal, DEPTH_RANGE[1] - DEPTH_RANGE[0]
            return far, far + min(1.0, self.shorter_side / SHORTER_SIDE) * span
        if lens is not None:
            pixel = _aerial_pitch(self)
            scale = min(1.0, self.shorter_side / coarsest(self.pitch) / SHORTER_PIXELS) * (pixel / PIXEL) ** 2
            return tuple(end * scale for end in DEPTH_RANGE)
        scale = min(1.0, self.shorter_side / SHORTER_SIDE)
        return tuple(end * scale for end in DEPTH_RANGE)

    @property
    def in_air(self) -> Hologram:
        """Hologram that scenes are rendered for: itself, or behind a lens the `AerialImage`.

        With the depth mapping eyepiece the volume is before the lens, and this is the hologram itself.
        """
        if self.optics.lens is None or self.depth_mapping == "eyepiece":
            return self
        pitch, (rows, columns) = _aerial_pitch(self), _cells(self)
        share = self.optics.lens.share
        values = {each.name: getattr(self, each.name) for each in fields(self)} | {
            "width": _middle_pixels(columns, share),
            "height": _middle_pixels(rows, share),
            "pitch": pitch,
            "optics": ON_AXIS,
        }
        return AerialImage(**values, panel=self, shortest=min(self.wavelengths))

    @property
    def flat_bench(self) -> bool:
        """Whether an even beam falls on the SLM, and the scene's light leaves it along the axis into free space."""
        return self.in_air is self and replace(self.optics, lens=None) == ON_AXIS

    @property
    def origin(self) -> str:
        """Origin of distances in the volume, in words."""
        return "the SLM" if self.in_air is self else self.in_air.origin

    @property
    def aperture_name(self) -> str:
        """Opening that limits the light of images away from the `origin`, in words."""
        return "the SLM's aperture"

    def captured_share(self, distance: float) -> float:
        """Fraction of the recordable cones' light from an image at `distance` in meters that passes the aperture.

        Geometric: the overlap of the image and its copies shifted by slope times distance, averaged over
        the cone of the widest wavelength.
        """
        if self.in_air is not self:
            return self.in_air.captured_share(distance)
        n = 33
        axis = np.linspace(-1, 1, n)
        slope_y, slope_x = np.meshgrid(axis, axis, indexing="ij")
        disk = slope_x**2 + slope_y**2 <= 1
        down, across = (self.widest_slope * abs(distance) / d for d in axes(self.pitch))
        overlap = np.clip(1 - np.abs(slope_x) * across / self.width, 0, 1) * np.clip(
            1 - np.abs(slope_y) * down / self.height, 0, 1
        )
        return float(overlap[disk].mean())

    def lost_light(self, distance: float) -> str:
        """Note on the light that an image at `distance` in meters loses to the aperture; empty if it is little."""
        if self.in_air is not self:
            return self.in_air.lost_light(distance)
        captured = self.captured_share(distance)
        if captured >= MIN_CAPTURED:
            return ""
        border = self.border(distance)
        return (
            f"Only {captured:.0%} of the light fits through {self.aperture_name} at {abs(distance) * 1e3:.3g} mm: the "
            f"outer {border} pixels darken"
        )

    def max_slope(self, wavelength: float) -> float:
        """Slope tan(asin(wavelength / (2 pitch))) of the recordable cone's edge, by the largest pitch.

        Behind a lens it is the slope of the cone that the aperture sends there.

        Parameters
        ----------
        wavelength : float
            Meters.
        """
        if self.in_air is not self:
            return self.in_air.max_slope(wavelength)
        return math.tan(math.asin(wavelength / (2 * self._largest_pitch)))

    @property
    def _largest_pitch(self):
        """Largest pitch of both directions and all colors, meters."""
        return coarsest(self.pitch) * max(self.optics.color_scale, default=1.0)

    @property
    def pitch_x(self) -> float:
        """Pitch of columns, meters."""
        return axes(self.pitch)[1]

    @property
    def pitch_y(self) -> float:
        """Pitch of rows, meters."""
        return axes(self.pitch)[0]

    @property
    def plain(self) -> bool:
        """Whether pixels are square and all colors coincide."""
        return not isinstance(self.pitch, tuple) and not self.optics.colors_apart

    def raster(self, wavelength: float | None = None) -> Raster:
        """Grid of the panel's pixels in the light of a wavelength, see `Optics`.

        Parameters
        ----------
        wavelength : float, optional
            Meters; one of the hologram's. Default: the panel itself.
        """
        shape = self.height, self.width
        if wavelength is None or not self.optics.colors_apart:
            return Raster(shape, self.pitch)
        scale, _, (right, up) = self.optics.color(self.wavelengths.index(wavelength))
        pitch = self.pitch_x * scale, self.pitch_y * scale, self._largest_pitch
        return Raster(shape, pitch, (-up, right))

    def pitch_at(self, wavelength: float) -> Pitch:
        """Pitch of the panel's pixels in the light of `wavelength` (meters), meters; all colors have the same cone."""
        return self.raster(wavelength).pitch

    def distance_at(self, wavelength: float) -> float:
        """Position of the panel in the light of `wavelength` (meters), meters towards the viewer; 0 by default."""
        return self.optics.color(self.wavelengths.index(wavelength))[1] if self.optics.color_distance else 0.0

    @property
    def picture(self) -> Hologram:
        """Grid of recording and of images: squares of the largest pitch that cover the panel.

        These hold all of the round cone that is recorded. With square pixels and colors that coincide it is the
        hologram itself, and behind a lens the image `in_air`.
        """
        if self.in_air is not self:
            return self.in_air
        if self.plain:
            return self
        pitch = self._largest_pitch
        width, height = (
            math.ceil(n * d / pitch - LITTLE)
            for n, d in ((self.width, self.pitch_x), (self.height, self.pitch_y))
        )
        return replace(self, width=width, height=height, pitch=pitch, optics=self.optics.of_rays)

    def panel_for(self, width: int, height: int) -> tuple[int, int]:
        """Columns and rows of a panel with the same pixels and bench whose `picture` has a given size.

        Parameters
        ----------
        width, height : int
            Numbers of pixels of the picture.

        Raises
        ------
        InvalidInput
            If there is none, for example behind a lens, which images the square in the panel's middle only.
        """
        lens = self.optics.lens
        if self.in_air is self or lens is None:
            scales = (self._largest_pitch / d for d in (self.pitch_x, self.pitch_y))
            size = [int(n * scale + LITTLE) for n, scale in zip((width, height), scales, strict=True)]
        else:
            size = [
                next(m for m in range(n, 20 * n + 20) if _middle_pixels(m, lens.share) >= n)
                for n in (width, height)
            ]
        picture = replace(
            self, width=size[0], height=size[1], optics=replace(self.optics, beam=ON_AXIS.beam)
        ).picture
        if (picture.width, picture.height) != (width, height):
            raise InvalidInput(
                f"This bench shows no picture of {width} x {height} pixels, but one of {picture.width} x "
                f"{picture.height}. Choose that."
            )
        return size[0], size[1]

    @property
    def shorter_side(self) -> float:
        """Shorter side of the panel, meters."""
        down, across = axes(self.pitch)
        return min(self.width * across, self.height * down)

    def border(self, distance: float) -> int:
        """Sideways travel of the steepest light over `distance` meters, in pixels of the smaller pitch."""
        return math.ceil(self.widest_slope * abs(distance) / min(axes(self.pitch)))

    @property
    def widest_slope(self) -> float:
        """Slope of the widest recordable cone, of all wavelengths."""
        return max(map(self.max_slope, self.wavelengths))

    @property
    def depth_of_focus(self) -> float:
        """Depth of focus 2 wavelength / slope^2 in meters, of the wavelength that has the longest."""
        return max(2 * w / self.max_slope(w) ** 2 for w in self.wavelengths)

    def illumination(self, number: int) -> np.ndarray | None:
        """Light that falls on the SLM at the wavelength of index `number`, see `Optics.illumination`."""
        return self.optics.illumination(
            (self.height, self.width), self.pitch, self.wavelengths[number], number
        )

    def to_dict(self) -> dict:
        """Return the values as JSON has them, see `from_dict`; a default bench is omitted."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        values["pitch"] = list(self.pitch) if isinstance(self.pitch, tuple) else self.pitch
        optics = values.pop("optics").to_dict()
        return values | ({"optics": optics} if optics else {})

    @classmethod
    def from_dict(cls, values: dict, folder: Path | None = None) -> Hologram:
        """Return a hologram; inverse of `to_dict`.

        Parameters
        ----------
        values : dict
            Values as of `to_dict`.
        folder : path, optional
            Folder with the arrays of its `Optics`. Default: none, for benches without measured parts.

        Raises
        ------
        InvalidInput
            If an array is missing.
        """
        return cls(**{**values, "optics": Optics.from_dict(values.get("optics", {}), folder)})


@dataclass(frozen=True)
class AerialImage(Hologram):
    """Aerial image behind the lens of a hologram, on whose grid scenes are rendered as if it were the SLM.

    z is the distance from its plane, in the space that a field lens there would make telecentric. In the back focal
    plane of a lens at its focal length behind the SLM the space is telecentric already. Elsewhere a point at z is in
    fact at z / (1 - z D / B), with B and D = 1 - L / f of the ray matrix, and is magnified by the same factor.

    It is the image of the square in the panel's middle. In each wavelength it has the square's number of pixels, which
    are as wide as the light resolves: the aperture, the circle in that square, sends all wavelengths through the same
    cone. Light is rendered and compared on these pixels (`raster`). Images have the pixels of the shortest wavelength;
    longer ones, which reach farther, are averaged over these. They show the middle of the reach, see `Lens.share`.

    Parameters
    ----------
    panel : Hologram
        The hologram behind the lens.
    shortest : float
        Shortest wavelength, which sets the pixels of images, meters.
    """

    # pyrefly: ignore[bad-assignment]  # always given
    panel: Hologram = None
    shortest: float = 0.0

    @property
    def in_air(self) -> Hologram:
        """The image itself."""
        return self

    @property
    def lens(self) -> Lens:
        """Lens of the bench."""
        lens = self.panel.optics.lens
        assert lens is not None
        return lens

    @property
    def origin(self) -> str:
        """Origin of distances in the volume, in words."""
        return "the picture's plane"

    @property
    def aperture_name(self) -> str:
        """Opening that limits the light of images away from the `origin`, in words."""
        return "what the SLM's pixels reach there"

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns of a wavelength's own pixels, those of the panel's square."""
        return _cells(self.panel)

    @property
    def whole(self) -> AerialImage:
        """The same as wide as the light of the shortest wavelength reaches, for its rays."""
        rows, columns = self.cells
        return self if (self.height, self.width) == self.cells else replace(self, width=columns, height=rows)

    def raster(self, wavelength: float | None = None) -> Raster:
        """Grid of a wavelength's own pixels; by default the grid of images."""
        if wavelength is None:
            return Raster((self.height, self.width), self.pitch)
        factor = wavelength / self.shortest
        return Raster(self.cells, self.pitch if factor == 1 else self.pitch * factor)

    def met(self, wavelength: float) -> list[EvenSteps]:
        """Rows and columns of a wavelength's own pixels that overlap the image."""
        lines = self.raster().lines_on(self.raster(wavelength))
        beside = [math.floor(line.first + 0.5 - line.step / 2 + LITTLE) for line in lines]
        return [EvenSteps(n, 1.0, count - 2 * n) for n, count in zip(beside, self.cells, strict=True)]

    def max_slope(self, wavelength: float) -> float:
        """Slope of the recordable cone's edge, by the wavelength's own pixels."""
        return math.tan(math.asin(wavelength / (2 * self.pitch_at(wavelength))))


def _cells(hologram):
    """Rows and columns of the square in the panel's middle."""
    return tuple(int(hologram.shorter_side / d + LITTLE) for d in axes(hologram.pitch))


def _middle_pixels(count, share):
    """Number of pixels in the middle that make a share of `count`."""
    return count - 2 * round((1 - share) / 2 * count)


def _aerial_pitch(hologram):
    """Pixel pitch behind a lens: the resolution of light of the shortest wavelength from the panel's square."""
    return min(hologram.wavelengths) * abs(hologram.optics.lens.reach) / hologram.shorter_side


def _pitch(pitch):
    """Pitch as one number, or as two for pixels that are not square."""
    pair = real_numbers(pitch if np.ndim(pitch) else (pitch, pitch), "the pixel pitch")
    if len(pair) != 2:
        raise InvalidInput(f"Expected one pixel pitch, or one in x and one in y, got {len(pair)}.")
    for each in pair:
        if not (math.isfinite(each) and each > 0):
            raise InvalidInput(f"Expected a positive pixel pitch, got {each * 1e6:g} µm.")
    return pair[0] if pair[0] == pair[1] else pair


def channel(wavelength: float) -> int:
    """Index (0 red, 1 green, 2 blue) of the scene's radiance channel for a wavelength in meters."""
    return 0 if wavelength > 580e-9 else 1 if wavelength > 490e-9 else 2
