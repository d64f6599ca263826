"""The camera of a calibration: where its pixels lie in the light at each focus, and what they say of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
import scipy.ndimage

from ..engine.errors import InvalidInput
from ..engine.pixels import Pitch, half_sides
from ..engine.scene import variants

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

ORDER = 3  # of the B-splines by which pictures are read between samples
FINER = 2  # times the samples that a picture has for that: near its finest waves a spline is off


@dataclass(frozen=True)
class Sensor:
    """A camera: value = black + gain I^gamma, of intensities I where its pixels look.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    gain : float
        Value of the brightest beam's own light; 1 is the highest value.
    black : float
        Value without light.
    gamma : float
        1 for a linear camera.
    homographies : dict of float to tuple of 8 floats
        For each focus distance in metres the first eight entries, row by row, of the matrix H with H[2, 2] = 1 from a
        camera pixel, (x, y, 1) in half the camera's shorter side from its middle, to the SLM's (xi, eta, 1), in half
        sides likewise (Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 2.3).
    """

    shape: tuple
    gain: float = 0.5
    black: float = 0.0
    gamma: float = 1.0
    homographies: dict = field(default_factory=dict)

    def to_dict(self) -> dict:
        """Form on disk, its focus distances in millimetres."""
        return {
            "size": [self.shape[1], self.shape[0]],
            "gain": self.gain,
            "black": self.black,
            "gamma": self.gamma,
            "homographies": [
                {"focus_mm": round(distance * 1e3, 6), "matrix": list(matrix)}
                for distance, matrix in self.homographies.items()
            ],
        }

    @classmethod
    def from_dict(cls, said: dict) -> Sensor:
        """Read what `to_dict` gave.

        Raises
        ------
        LookupError, TypeError, ValueError
        """
        width, height = said["size"]
        matrices = {}
        for row in said["homographies"]:
            matrix = tuple(map(float, row["matrix"]))
            if len(matrix) != 8:
                raise ValueError("a homography has eight numbers")
            matrices[round(float(row["focus_mm"]), 6) / 1e3] = matrix
        shape = int(height), int(width)
        return cls(shape, float(said["gain"]), float(said["black"]), float(said["gamma"]), matrices)

    def value(self, intensity: np.ndarray) -> np.ndarray:
        """Values of intensities."""
        return self.black + self.gain * np.maximum(intensity, 0) ** self.gamma

    def intensity(self, value: np.ndarray) -> np.ndarray:
        """Intensities of values: the reverse of `value`; 0 where they are darker than black."""
        return (np.maximum(value - self.black, 0) / self.gain) ** (1 / self.gamma)

    def pixels(self, distance: float, xi: np.ndarray, eta: np.ndarray) -> np.ndarray:
        """Where in its pixels light of points of the SLM arrives: row and column, the reverse of `points`."""
        half = min(self.shape) / 2
        matrix = np.linalg.inv(np.array([*self.homographies[distance], 1.0]).reshape(3, 3))
        xi, eta = np.broadcast_arrays(xi, eta)
        x, y, below = np.einsum("ij,j...->i...", matrix, np.array([xi, eta, np.ones_like(xi)]))
        rows, columns = self.shape
        return np.array([y / below * half + (rows - 1) / 2, x / below * half + (columns - 1) / 2])

    def points(self, distance: float, within: Sequence[float] = (0.0,)) -> np.ndarray:
        """Where points of each pixel look: xi and eta, shape (2, points, points, rows, columns).

        Parameters
        ----------
        distance : float
            At which the camera is focused, one of those of `homographies`.
        within : sequence of float
            The points, in pixels from its middle, along each side.
        """
        half = min(self.shape) / 2
        y, x = ((np.arange(n) - (n - 1) / 2 + np.array(within)[:, None]) / half for n in self.shape)
        x, y = x[None, :, None, :], y[:, None, :, None]
        a, b, c, d, e, f, g, h = self.homographies[distance]
        below = g * x + h * y + 1
        return np.array([(a * x + b * y + c) / below, (d * x + e * y + f) / below])

    def middle(self, distance: float) -> tuple[tuple[float, float], float]:
        """Where the SLM's middle is seen at a focus, x and y in half the camera's shorter side, and how large.

        The size is the ratio of lengths there, half sides of the camera in a half side of the SLM; the geometric mean
        over both axes.
        """
        matrix = np.linalg.inv(np.array([*self.homographies[distance], 1.0]).reshape(3, 3))
        x, y, below = matrix[:, 2]
        at = float(x / below), float(y / below)
        slopes = matrix[:2, :2] / below - np.outer(at, matrix[2, :2]) / below
        return at, float(np.sqrt(abs(np.linalg.det(slopes))))

    def on_slm(self, distance: float, at: tuple[float, float]) -> tuple[float, float]:
        """xi and eta of the SLM that are seen at a place, x and y in half the camera's shorter side."""
        matrix = np.array([*self.homographies[distance], 1.0]).reshape(3, 3)
        xi, eta, below = matrix @ [*at, 1.0]
        return float(xi / below), float(eta / below)

    def sees(
        self,
        picture: np.ndarray,
        size: tuple[int, int],
        grid: int,
        distance: float,
        pitch: Pitch = 1.0,
    ) -> np.ndarray:
        """Values of what the camera sees: the light's mean over each pixel.

        The picture's spectrum is taken times that of a pixel, and over that of the B-spline which is its interpolation
        (Thevenaz et al., IEEE Trans. Med. Imaging 19, 739 (2000)).

        Parameters
        ----------
        picture : numpy.ndarray, shape (y, x)
            Intensity on a periodic grid whose first sample is the middle of the SLM's first pixel.
        size : (int, int)
            Rows and columns of the SLM.
        grid : int
            Samples in a pixel's side.
        distance : float
            At which it is focused.
        pitch : float or (float, float)
            Where the SLM's pixels are not square, meters.

        Returns
        -------
        numpy.ndarray, float32, shape (rows, columns)
        """
        halves = half_sides(size, pitch)
        a, b, _, d, e, *_ = self.homographies[distance]
        down, across = (half / (min(self.shape) / 2) for half in halves)  # of a camera pixel, in the SLM's
        y, x = (scipy.fft.fftfreq(n, 1 / grid).astype(np.float32) for n in picture.shape)
        y, x = y[:, None], x[None, : picture.shape[1] // 2 + 1]
        pixel = np.sinc(across * a * x + down * d * y) * np.sinc(across * b * x + down * e * y)
        fine = FINER * grid
        spline = np.sinc(x / fine) ** (ORDER + 1) * np.sinc(y / fine) ** (ORDER + 1)
        height, width = (FINER * n for n in picture.shape)
        waves = np.zeros((height, width // 2 + 1), np.complex64)
        rows = np.round(y[:, 0] * picture.shape[0] / grid).astype(int)
        waves[rows, : x.size] = scipy.fft.rfft2(picture) * (pixel / spline * FINER**2)
        if picture.shape[1] % 2 == 0:
            waves[:, x.size - 1] /= 2  # the finest waves, which stand for both signs
        smooth = scipy.fft.irfft2(waves, (height, width), overwrite_x=True)
        xi, eta = self.points(distance)[:, 0, 0]
        at = [(v * half + (n - 1) / 2) * fine for v, half, n in zip((eta, xi), halves, size, strict=True)]
        seen = scipy.ndimage.map_coordinates(smooth, at, np.float32, ORDER, "grid-wrap", prefilter=False)
        return self.value(seen)


def read_capture(path: Path | str) -> np.ndarray:
    """A camera's picture: values of 0 to 1, as they are in the file, the mean of its colors; float32, shape (y, x).

    Raises
    ------
    InvalidInput
    """
    try:
        picture = np.array(variants.bitmaps().Bitmap(str(path)), copy=False)
    except Exception as error:  # there is no end to what a file may hold
        raise InvalidInput(f"The camera's picture {path} cannot be read ({error}).") from None
    whole = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else 1
    values = picture.astype(np.float32) / whole
    return values if values.ndim == 2 else values[..., :3].mean(axis=-1)
