"""What is to be displayed: the hologram's grid, colors and depth volume."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace
from pathlib import Path

import numpy as np

from .errors import InvalidInput
from .optics import ON_AXIS, Lens, Optics
from .pixels import EvenSteps, Pitch, Raster, axes, coarsest
from .settings import DEPTH_MAPPINGS

# Meters from the SLM, negative behind it, on a display whose shorter side is so long or longer, which is 512 pixels of
# 8 µm. What is looked at first, between the near end and twice its distance, is at most 1.5 mm from the SLM. Measured:
# docs/measurements.md, How near to the SLM.
DEPTH_RANGE, SHORTER_SIDE = (-4e-3, 1e-3), 4.096e-3
SHORTER_PIXELS, PIXEL = 512, 8e-6  # the same
SAME = 1e-9  # meters between planes that are one
LITTLE = 1e-6  # of a pixel: rounding
MIN_CAPTURED = 0.9  # of the light; where less passes the aperture, borders are seen to be dark


@dataclass(frozen=True)
class Hologram:
    """Grid, wavelengths and depth volume of a hologram. The SLM lies at z = 0, light runs to +z.

    Parameters
    ----------
    width, height : int
        Pixels.
    pitch : float or (float, float)
        Pixel pitch d, meters; of pixels that are not square (x, y). Two equal numbers become one. The recordable cone
        is asin(wavelength / (2 d)) with the larger d: the round one that both directions hold.
    wavelengths : tuple of float
        Vacuum wavelengths, meters; each takes the red, green or blue radiance of the scene,
        whichever is nearest (`channel`).
    depth_far, depth_near : float
        Distance from the SLM of the far end (world infinity) and of the near end, meters, negative behind it. Default:
        around the SLM, so that its aperture shows both without dark edges. With a lens and ``fit`` they are counted
        from the plane of the image `in_air`; with a lens and ``eyepiece`` the far end is its front focal plane.
    depth_mapping : {'fit', 'eyepiece'}
        How world depth fills the volume, see `mapping.DepthMapping`.
    near : float, optional
        World depth that `fit` maps to `depth_near`, meters. Default: the nearest surface in view.
    optics : Optics
        The bench around the SLM.

    Raises
    ------
    InvalidInput
        On a value that no display can have.
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
        object.__setattr__(self, "wavelengths", tuple(float(w) for w in self.wavelengths))
        if self.width < 1 or self.height < 1:
            raise InvalidInput(
                f"The hologram's resolution is {self.width} x {self.height}: both must be at least 1 pixel."
            )
        if self.width * self.height > 1 << 26:
            raise InvalidInput(
                f"The hologram's resolution {self.width} x {self.height} is over 67 megapixels: choose a smaller one."
            )
        object.__setattr__(self, "pitch", _pitch(self.pitch))
        if not self.wavelengths:
            raise InvalidInput("The hologram needs at least one wavelength.")
        for wavelength in self.wavelengths:
            if not 100e-9 <= wavelength <= 10e-6:
                raise InvalidInput(f"The wavelength {wavelength * 1e9:g} nm is outside 100 nm to 10000 nm.")
            if wavelength >= 2 * min(axes(self.pitch)):
                raise InvalidInput(
                    f"The pixel pitch {min(axes(self.pitch)) * 1e6:g} µm is too small for {wavelength * 1e9:g} nm: "
                    f"make it larger than half the wavelength."
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
                f"The depth range must run from far to near with near farther from the SLM, not "
                f"{self.depth_far * 1e3:g} mm to {self.depth_near * 1e3:g} mm: make the near end larger."
            )
        if self.depth_mapping not in DEPTH_MAPPINGS:
            raise InvalidInput(
                f"Unknown depth mapping '{self.depth_mapping}': choose one of {', '.join(DEPTH_MAPPINGS)}."
            )
        if self.near is not None and not (math.isfinite(self.near) and self.near > 0):
            raise InvalidInput(f"The near end of the scene must be a positive distance, not {self.near:g} m.")
        self.optics.check((self.height, self.width), self.pitch, self.wavelengths)

    def _check_lens(self):
        """Refuse a lens that does not go with the rest."""
        lens = self.optics.lens
        if lens is None:
            return
        if self.depth_mapping != "eyepiece":
            if self.optics.stopped:
                raise InvalidInput(
                    "A carrier or a stop is for a relay's Fourier plane, and behind a lens the picture itself lies "
                    "there: leave out the carrier and the stop, or the lens."
                )
            if self.optics.colors_apart:
                raise InvalidInput(
                    "Colors that lie apart are made up for without a picture behind a lens: leave out the scale, "
                    "distance and shift of colors, or the lens."
                )
            pixel = _aerial_pitch(self)
            if pixel <= max(self.wavelengths):
                raise InvalidInput(
                    f"The lens makes the picture's pixels {pixel * 1e6:.3g} µm wide, too small for light of "
                    f"{max(self.wavelengths) * 1e9:g} nm: choose a longer focal length."
                )
            return
        if lens.share != 1:
            raise InvalidInput(
                "With the depth mapping eyepiece somebody looks through the lens, and there is no picture behind it: "
                "leave out the picture's share, or choose the depth mapping fit."
            )
        if lens.picture is not None:
            raise InvalidInput(
                "With the depth mapping eyepiece somebody looks through the lens, and there is no picture behind it: "
                "leave out the picture's distance, or choose the depth mapping fit."
            )
        infinity = lens.distance - lens.focal
        if self.depth_far is not None and abs(self.depth_far - infinity) > SAME:
            raise InvalidInput(
                f"The lens has infinity in its front focal plane, {infinity * 1e3:g} mm from the SLM, and the depth "
                f"range has it at {self.depth_far * 1e3:g} mm: leave out the depth range, or give the lens another "
                "distance."
            )

    def _depth_range(self):
        """Depth range that the aperture shows without dark edges.

        Light spreads on its way to the SLM, by slope times distance, and what passes beside the aperture is lost to
        the picture's border. So the volume lies around the SLM, and that of a small display is less deep. Around the
        plane of an image behind a lens it is as deep in depths of focus.
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
        """The hologram as the scene meets it: itself; behind a lens the `AerialImage` that stands there.

        With the depth mapping eyepiece the volume lies before the lens, and that is the hologram itself.
        """
        if self.optics.lens is None or self.depth_mapping == "eyepiece":
            return self
        pitch, (rows, columns) = _aerial_pitch(self), _cells(self)
        share = self.optics.lens.share
        values = {each.name: getattr(self, each.name) for each in fields(self)} | {
            "width": _kept(columns, share),
            "height": _kept(rows, share),
            "pitch": pitch,
            "optics": ON_AXIS,
        }
        return AerialImage(**values, panel=self, shortest=min(self.wavelengths))

    @property
    def flat_bench(self) -> bool:
        """Whether an even beam falls on the SLM, and the scene's light leaves it along the axis, to free space."""
        return self.in_air is self and replace(self.optics, lens=None) == ON_AXIS

    @property
    def origin(self) -> str:
        """What distances of the volume are counted from, in words."""
        return "the SLM" if self.in_air is self else self.in_air.origin

    @property
    def opening(self) -> str:
        """What cuts the light of pictures away from the `origin`, in words."""
        return "the SLM's aperture"

    def captured_share(self, distance: float) -> float:
        """Share of the recordable cones' light, from a picture at `distance` in meters, that passes the aperture.

        Geometric: the overlap of the picture and its copies shifted by slope times distance, averaged over
        the cone of the widest wavelength.
        """
        if self.in_air is not self:
            return self.in_air.captured_share(distance)
        n = 33
        axis = np.linspace(-1, 1, n)
        slope_y, slope_x = np.meshgrid(axis, axis, indexing="ij")
        disk = slope_x**2 + slope_y**2 <= 1
        down, across = (self.widest_slope * abs(distance) / d for d in axes(self.pitch))
        kept = np.clip(1 - np.abs(slope_x) * across / self.width, 0, 1) * np.clip(
            1 - np.abs(slope_y) * down / self.height, 0, 1
        )
        return float(kept[disk].mean())

    def lost_light(self, distance: float) -> str:
        """What a picture at `distance` in meters loses beside the aperture, in words; empty where that is little."""
        if self.in_air is not self:
            return self.in_air.lost_light(distance)
        captured = self.captured_share(distance)
        if captured >= MIN_CAPTURED:
            return ""
        border = self.border(distance)
        return (
            f"Only {captured:.0%} of the light fits through {self.opening} at {abs(distance) * 1e3:.3g} mm: the "
            f"outer {border} pixels darken"
        )

    def max_slope(self, wavelength: float) -> float:
        """Slope tan(asin(wavelength / (2 pitch))) of the recordable cone's edge, by the largest pitch; behind a lens of
        what the aperture sends there.
        """
        if self.in_air is not self:
            return self.in_air.max_slope(wavelength)
        return math.tan(math.asin(wavelength / (2 * self._largest_pitch)))

    @property
    def _largest_pitch(self):
        """In both directions and all colors."""
        return coarsest(self.pitch) * max(self.optics.color_scale, default=1.0)

    @property
    def pitch_x(self) -> float:
        """Distance of columns, meters."""
        return axes(self.pitch)[1]

    @property
    def pitch_y(self) -> float:
        """Distance of rows, meters."""
        return axes(self.pitch)[0]

    @property
    def plain(self) -> bool:
        """Whether pixels are square, and all colors lie on each other."""
        return not isinstance(self.pitch, tuple) and not self.optics.colors_apart

    def raster(self, wavelength: float | None = None) -> Raster:
        """Where the light of a wavelength has the panel's pixels, see `Optics`; the panel itself without one."""
        shape = self.height, self.width
        if wavelength is None or not self.optics.colors_apart:
            return Raster(shape, self.pitch)
        scale, _, (right, up) = self.optics.color(self.wavelengths.index(wavelength))
        pitch = self.pitch_x * scale, self.pitch_y * scale, self._largest_pitch
        return Raster(shape, pitch, (-up, right))

    def pitch_at(self, wavelength: float) -> Pitch:
        """Pitch of the panel's pixels as the light of a wavelength has them, meters; all colors have one cone."""
        return self.raster(wavelength).pitch

    def distance_at(self, wavelength: float) -> float:
        """Where the panel lies for the light of a wavelength, meters towards the viewer; 0 by default."""
        return self.optics.color(self.wavelengths.index(wavelength))[1] if self.optics.color_distance else 0.0

    @property
    def picture(self) -> Hologram:
        """Grid of what is recorded and of pictures: squares of the largest pitch that cover the panel.

        The round cone, which is all that is recorded, has no more than that. Where nothing is to be made up for it is
        the hologram itself, and behind a lens the image `in_air`.
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
        """Columns and rows of a panel of such pixels on the same bench whose `picture` has so many.

        Raises
        ------
        InvalidInput
            If no panel's picture has, as behind a lens, where it is of the square in the panel's middle.
        """
        lens = self.optics.lens
        if self.in_air is self or lens is None:
            scales = (self._largest_pitch / d for d in (self.pitch_x, self.pitch_y))
            found = [int(n * scale + LITTLE) for n, scale in zip((width, height), scales, strict=True)]
        else:
            found = [
                next(m for m in range(n, 20 * n + 20) if _kept(m, lens.share) >= n) for n in (width, height)
            ]
        picture = replace(
            self, width=found[0], height=found[1], optics=replace(self.optics, beam=ON_AXIS.beam)
        ).picture
        if (picture.width, picture.height) != (width, height):
            raise InvalidInput(
                f"This bench shows no picture of {width} x {height} pixels, but one of {picture.width} x "
                f"{picture.height}: choose that."
            )
        return found[0], found[1]

    @property
    def shorter_side(self) -> float:
        """Of the panel, meters."""
        down, across = axes(self.pitch)
        return min(self.width * across, self.height * down)

    def border(self, distance: float) -> int:
        """Pixels, of the smaller pitch, that light walks in `distance` meters."""
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
        """Light that falls on the SLM at the wavelength of this number, see `Optics.illumination`."""
        return self.optics.illumination(
            (self.height, self.width), self.pitch, self.wavelengths[number], number
        )

    def to_dict(self) -> dict:
        """JSON-able form, see `from_dict`; a bench that is as by default is left out."""
        values = {each.name: getattr(self, each.name) for each in fields(self)}
        values["pitch"] = list(self.pitch) if isinstance(self.pitch, tuple) else self.pitch
        optics = values.pop("optics").to_dict()
        return values | ({"optics": optics} if optics else {})

    @classmethod
    def from_dict(cls, values: dict, folder: Path | None = None) -> Hologram:
        """Inverse of `to_dict`; `folder` has the arrays of its `Optics`."""
        return cls(**{**values, "optics": Optics.from_dict(values.get("optics", {}), folder)})


@dataclass(frozen=True)
class AerialImage(Hologram):
    """What stands in the air behind the lens of a hologram, as if it were the SLM: scenes are rendered on its grid.

    z is counted from its plane, in the space that a field lens there makes telecentric. In the back focal plane of a
    lens that stands its focal length behind the SLM there is nothing to be made; elsewhere what is z behind the plane
    stands at z / (1 - z D / B), with B and D = 1 - L / f of the ray matrix, and is as much larger.

    It is the image of the square in the panel's middle. Each wavelength has as many pixels there as the square, which
    are as wide as its light resolves: the aperture, the circle in that square, sends all of them through the same cone.
    Its light is rendered and compared on these (`raster`). Pictures have the pixels of the shortest one, on which those
    of longer ones, which reach farther, are averaged. They show the middle of what is reached, see `Lens.share`.

    Parameters
    ----------
    panel : Hologram
        The hologram whose image it is.
    shortest : float
        Wavelength whose pixels those of pictures are, meters.
    """

    # pyrefly: ignore[bad-assignment]  # always given
    panel: Hologram = None
    shortest: float = 0.0

    @property
    def in_air(self) -> Hologram:
        return self

    @property
    def lens(self) -> Lens:
        """That of the bench."""
        lens = self.panel.optics.lens
        assert lens is not None
        return lens

    @property
    def origin(self) -> str:
        return "the picture's plane"

    @property
    def opening(self) -> str:
        return "what the SLM's pixels reach there"

    @property
    def cells(self) -> tuple[int, int]:
        """Rows and columns of a wavelength's own pixels: as many as those of the panel's square."""
        return _cells(self.panel)

    @property
    def whole(self) -> AerialImage:
        """The same as wide as the light of the shortest wavelength reaches, for its rays."""
        rows, columns = self.cells
        return self if (self.height, self.width) == self.cells else replace(self, width=columns, height=rows)

    def raster(self, wavelength: float | None = None) -> Raster:
        if wavelength is None:
            return Raster((self.height, self.width), self.pitch)
        times = wavelength / self.shortest
        return Raster(self.cells, self.pitch if times == 1 else self.pitch * times)

    def met(self, wavelength: float) -> list[EvenSteps]:
        """Rows and columns of a wavelength's own pixels that meet the picture."""
        lines = self.raster().lines_on(self.raster(wavelength))
        beside = [math.floor(line.first + 0.5 - line.step / 2 + LITTLE) for line in lines]
        return [EvenSteps(n, 1.0, count - 2 * n) for n, count in zip(beside, self.cells, strict=True)]

    def max_slope(self, wavelength: float) -> float:
        return math.tan(math.asin(wavelength / (2 * self.pitch_at(wavelength))))


def _cells(hologram):
    """Rows and columns of the square in the panel's middle."""
    return tuple(int(hologram.shorter_side / d + LITTLE) for d in axes(hologram.pitch))


def _kept(count, share):
    """Pixels in the middle that a share of them has."""
    return count - 2 * round((1 - share) / 2 * count)


def _aerial_pitch(hologram):
    """Pixel pitch behind a lens: as fine as light of the shortest wavelength from all of the panel's square."""
    return min(hologram.wavelengths) * abs(hologram.optics.lens.reach) / hologram.shorter_side


def _pitch(pitch):
    """One number, or the two of pixels that are not square."""
    pair = tuple(map(float, pitch)) if isinstance(pitch, (tuple, list)) else (pitch, pitch)
    if len(pair) != 2:
        raise InvalidInput(f"A pixel has one pitch, or one in x and one in y, not {len(pair)}.")
    for each in pair:
        if not (math.isfinite(each) and each > 0):
            raise InvalidInput(f"The pixel pitch must be positive, not {each * 1e6:g} µm.")
    return pair[0] if pair[0] == pair[1] else pair


def channel(wavelength: float) -> int:
    """Index (0 red, 1 green, 2 blue) of the scene's radiance channel that a wavelength in meters shows."""
    return 0 if wavelength > 580e-9 else 1 if wavelength > 490e-9 else 2
