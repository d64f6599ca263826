"""The camera of a calibration: the points at which its pixels measure light, and their values."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
import scipy.ndimage

from ..engine.errors import InvalidInput
from ..engine.files import check_palette
from ..engine.pixels import Pitch, half_sides
from ..engine.scene import variants

if TYPE_CHECKING:
    from collections.abc import Sequence

ORDER = 3  # of the B-splines that interpolate pictures
OVERSAMPLING = 2  # of pictures for that: splines are inaccurate near the finest frequencies


@dataclass(frozen=True)
class Sensor:
    """A camera: value = black + gain I^gamma, of the intensity I at its pixels.

    Parameters
    ----------
    shape : (int, int)
        Rows and columns.
    gain : float
        Value of the beam's own light where it is brightest; 1 is the highest value.
    black : float
        Value without light.
    gamma : float
        1 for a linear camera.
    homographies : dict of float to tuple of 8 floats
        For each focus distance in meters the first eight entries, row by row, of the matrix H with H[2, 2] = 1 from a
        camera pixel, (x, y, 1) in half the camera's shorter side from its middle, to the SLM's (xi, eta, 1), in half
        sides likewise (Hartley and Zisserman, Multiple View Geometry, 2nd ed., section 2.3).
    """

    shape: tuple
    gain: float = 0.5
    black: float = 0.0
    gamma: float = 1.0
    homographies: dict = field(default_factory=dict)

    def to_dict(self) -> dict:
        """JSON form, with focus distances in millimeters."""
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
    def from_dict(cls, data: dict) -> Sensor:
        """Read the JSON form of `to_dict`.

        Raises
        ------
        LookupError, TypeError, ValueError
        """
        width, height = data["size"]
        matrices = {}
        for row in data["homographies"]:
            matrix = tuple(map(float, row["matrix"]))
            if len(matrix) != 8:
                raise ValueError(f"expected eight numbers of a homography, got {len(matrix)}")
            matrices[round(float(row["focus_mm"]), 6) / 1e3] = matrix
        shape = int(height), int(width)
        return cls(shape, float(data["gain"]), float(data["black"]), float(data["gamma"]), matrices)

    def value(self, intensity: np.ndarray) -> np.ndarray:
        """Camera values of intensities."""
        return self.black + self.gain * np.maximum(intensity, 0) ** self.gamma

    def intensity(self, value: np.ndarray) -> np.ndarray:
        """Intensities of camera values: the inverse of `value`; 0 for values below black."""
        return (np.maximum(value - self.black, 0) / self.gain) ** (1 / self.gamma)

    def pixels(self, distance: float, xi: np.ndarray, eta: np.ndarray) -> np.ndarray:
        """Row and column at which points of the SLM appear: the inverse of `points`.

        Parameters
        ----------
        distance : float
            Focus distance, a key of `homographies`, meters.
        xi, eta : numpy.ndarray
            Points of the SLM, in half sides from its center; they broadcast.
        """
        half = min(self.shape) / 2
        matrix = np.linalg.inv(np.array([*self.homographies[distance], 1.0]).reshape(3, 3))
        xi, eta = np.broadcast_arrays(xi, eta)
        x, y, w = np.einsum("ij,j...->i...", matrix, np.array([xi, eta, np.ones_like(xi)]))
        rows, columns = self.shape
        return np.array([y / w * half + (rows - 1) / 2, x / w * half + (columns - 1) / 2])

    def points(self, distance: float, within: Sequence[float] = (0.0,)) -> np.ndarray:
        """Points of the SLM that appear at points of each pixel: xi and eta, shape (2, points, points, rows, columns).

        Parameters
        ----------
        distance : float
            Focus distance, a key of `homographies`, meters.
        within : sequence of float
            Positions of the points in a pixel along each side, in pixels from its center.
        """
        half = min(self.shape) / 2
        y, x = ((np.arange(n) - (n - 1) / 2 + np.array(within)[:, None]) / half for n in self.shape)
        x, y = x[None, :, None, :], y[:, None, :, None]
        a, b, c, d, e, f, g, h = self.homographies[distance]
        w = g * x + h * y + 1
        return np.array([(a * x + b * y + c) / w, (d * x + e * y + f) / w])

    def middle(self, distance: float) -> tuple[tuple[float, float], float]:
        """Position of the SLM's center in the camera's picture, and the magnification there.

        The position is x and y in half the camera's shorter side. The magnification is the number of half sides of the
        camera per half side of the SLM, the geometric mean over both axes.
        """
        matrix = np.linalg.inv(np.array([*self.homographies[distance], 1.0]).reshape(3, 3))
        x, y, w = matrix[:, 2]
        position = float(x / w), float(y / w)
        slopes = matrix[:2, :2] / w - np.outer(position, matrix[2, :2]) / w
        return position, float(np.sqrt(abs(np.linalg.det(slopes))))

    def on_slm(self, distance: float, position: tuple[float, float]) -> tuple[float, float]:
        """Point of the SLM, xi and eta, that appears at x and y in half the camera's shorter side."""
        matrix = np.array([*self.homographies[distance], 1.0]).reshape(3, 3)
        xi, eta, w = matrix @ [*position, 1.0]
        return float(xi / w), float(eta / w)

    def predict(
        self,
        picture: np.ndarray,
        size: tuple[int, int],
        grid: int,
        distance: float,
        pitch: Pitch = 1.0,
    ) -> np.ndarray:
        """Camera values of a picture of light, averaged over each pixel.

        The picture's spectrum is multiplied by that of a pixel and divided by that of the interpolating B-spline
        (Thevenaz et al., IEEE Trans. Med. Imaging 19, 739 (2000)).

        Parameters
        ----------
        picture : numpy.ndarray, shape (y, x)
            Intensity on a periodic grid whose first sample is the center of the SLM's first pixel.
        size : (int, int)
            Rows and columns of the SLM.
        grid : int
            Samples per pixel side.
        distance : float
            Focus distance, a key of `homographies`, meters.
        pitch : float or (float, float)
            Pixel pitch of the SLM, meters; needed where pixels are not square.

        Returns
        -------
        numpy.ndarray, float32, shape (rows, columns)
        """
        halves = half_sides(size, pitch)
        a, b, _, d, e, *_ = self.homographies[distance]
        down, across = (
            half / (min(self.shape) / 2) for half in halves
        )  # of a camera pixel, in pixels of the SLM
        y, x = (scipy.fft.fftfreq(n, 1 / grid).astype(np.float32) for n in picture.shape)
        y, x = y[:, None], x[None, : picture.shape[1] // 2 + 1]
        pixel = np.sinc(across * a * x + down * d * y) * np.sinc(across * b * x + down * e * y)
        fine = OVERSAMPLING * grid
        spline = np.sinc(x / fine) ** (ORDER + 1) * np.sinc(y / fine) ** (ORDER + 1)
        height, width = (OVERSAMPLING * n for n in picture.shape)
        waves = np.zeros((height, width // 2 + 1), np.complex64)
        rows = np.round(y[:, 0] * picture.shape[0] / grid).astype(int)
        waves[rows, : x.size] = scipy.fft.rfft2(picture) * (pixel / spline * OVERSAMPLING**2)
        if picture.shape[1] % 2 == 0:
            waves[:, x.size - 1] /= 2  # the Nyquist frequency, which stands for both signs
        smooth = scipy.fft.irfft2(waves, (height, width), overwrite_x=True)
        xi, eta = self.points(distance)[:, 0, 0]
        position = [
            (v * half + (n - 1) / 2) * fine for v, half, n in zip((eta, xi), halves, size, strict=True)
        ]
        means = scipy.ndimage.map_coordinates(
            smooth, position, np.float32, ORDER, "grid-wrap", prefilter=False
        )
        return self.value(means)


def read_capture(path: Path | str) -> np.ndarray:
    """Read a camera's picture: values of the file scaled to 0 to 1, averaged over colors; float32, shape (y, x).

    Raises
    ------
    InvalidInput
    """
    try:
        picture = np.array(variants.read_bitmap(path), copy=False)
    except Exception as error:  # a file may hold anything
        raise InvalidInput(
            f"The camera's picture {path} cannot be read ({error}). Give a picture file."
        ) from None
    if Path(path).suffix.lower() == ".bmp":
        check_palette(Path(path), picture)
    whole = np.iinfo(picture.dtype).max if picture.dtype.kind == "u" else 1
    values = picture.astype(np.float32) / whole
    if values.ndim == 2:
        return values
    colors = values.shape[-1] - (values.shape[-1] in (2, 4))  # without alpha
    return values[..., :colors].mean(axis=-1)
