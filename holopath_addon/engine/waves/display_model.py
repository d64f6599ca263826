"""Light of a real display with given phases of its pixels: source, pixels, relay, and the image at a focus.

Coordinates: x to the right, y down; (xi, eta) are those of the SLM from its center, in half its shorter side; rho is a
ray's sine in terms of the steepest that a pixel grid records, lambda / (2 pitch) of the larger pitch, at the model's
wavelength.

    source    E(x)  = exp(-q |xi - xi_0|^2) exp(i k s.x)                        Gaussian beam, tilted by sines s
    pixels    u(x)  = E(x) [sqrt(1 - |m|^2) exp(i (G * phi)(x)) + m]            within pixels, too
    relay     a(x)  = inverse FT of  [ |rho| <= 1 ] exp(i W(rho; xi)) FT u      stop in its Fourier plane, aberrations
    image     I(x)  = sum_n w_n |P_z a_n|^2                                     source points and wavelengths n

G is a Gaussian of `crosstalk` pixels, m the unmodulated light, W = sum_j (a_j + b_j xi + c_j eta) Z_j(rho) with Noll's
Zernike polynomials, P_z the engine's angular spectrum propagation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
import scipy.sparse
from scipy.special import erf, j1

from ..errors import InvalidInput
from ..pixels import Pitch, axes, coarsest, half_sides, scaled
from . import arrays
from .arrays import PROCESSOR, Array
from .gaussian_points import FIFTH
from .propagation import padded_shape, resized, transfer_function

if TYPE_CHECKING:
    from collections.abc import Sequence

GRID = 2  # samples of an image per pixel side: an intensity has twice the band of its field
FINE = 4  # samples per pixel side of the light that leaves a pixel, whose phase is blurred within it
GUARD = 24  # pixels of guard band around the SLM for the stop's diffraction, see `padded_shape`
NODES = (
    math.sqrt(3) / 2 * np.array([-1.0, 0.0, 1.0])
)  # Chebyshev nodes of the field, for a parabola of aberrations
FIELD_TERMS = 3  # number of the first aberrations, which change over the field
FLAT = 0.7  # fraction of half a padded side up to which the light of the stop's edge is exact, see `_stop`
MIN_CROSSTALK = 0.15  # pixels; smaller values, except 0, are not sampled within a pixel
DARK = 1e-4  # transmission of the stop below which light is not computed

COUNTS = {"position": 2, "tilt": 2, "aberrations": 8, "across": FIELD_TERMS, "down": FIELD_TERMS}


@dataclass(frozen=True)
class DisplayModel:
    """Model of a display at one wavelength; the defaults are an ideal display. The module has the formulas.

    Parameters
    ----------
    wavelength : float
        Central wavelength of the spectrum, meters.
    position : (float, float)
        Center of the beam on the SLM, xi and eta (half sides).
    falloff : float
        q: the beam's amplitude is exp(-q) at half a side from its center; its radius at 1/e^2 of the intensity is
        1 / sqrt(q) half sides.
    tilt : (float, float)
        Sines of the beam's direction, to +x and +y.
    size : float
        Size of the source: standard deviation of the sines of its points' directions (partial spatial coherence:
        Goodman, Statistical Optics, section 5.6).
    bandwidth : float
        Standard deviation of the source's spectrum, meters.
    unmodulated : complex
        m: amplitude and phase of the unmodulated light, the fraction abs(m)^2 of the whole.
    crosstalk : float
        Standard deviation, pixels, of the Gaussian that blurs phases (fringing fields: Moser et al., Opt. Express 27,
        25046 (2019)).
    aberrations : tuple of 8 floats
        a_j, radians root mean square, of Noll's Zernike polynomials 4 to 11 (J. Opt. Soc. Am. 66, 207 (1976)): defocus,
        two of astigmatism, two of coma, two of trefoil, spherical.
    across, down : tuple of 3 floats
        b_j and c_j: increase of the first three over half a side, to the right and down. A misaligned relay's defocus
        and astigmatism are linear in the field (Thompson, J. Opt. Soc. Am. A 22, 1389 (2005)). Beyond half a side they
        are constant.
    half : float
        Half a side, meters; 0: half the shorter side of the SLM.

    Raises
    ------
    InvalidInput
    """

    wavelength: float
    position: tuple = (0.0, 0.0)
    falloff: float = 0.0
    tilt: tuple = (0.0, 0.0)
    size: float = 0.0
    bandwidth: float = 0.0
    unmodulated: complex = 0j
    crosstalk: float = 0.0
    aberrations: tuple = (0.0,) * 8
    across: tuple = (0.0,) * FIELD_TERMS
    down: tuple = (0.0,) * FIELD_TERMS
    half: float = 0.0

    def __post_init__(self):
        for name, count in COUNTS.items():
            values = tuple(map(float, getattr(self, name)))
            if len(values) != count or not all(map(math.isfinite, values)):
                raise InvalidInput(f"Expected {count} numbers as {name} of a display model, got {values}.")
            object.__setattr__(self, name, values)
        if not 1e-7 < self.wavelength < 1e-4:
            raise InvalidInput(
                f"Expected the wavelength of a display model from 100 to 100000 nm, got {self.wavelength * 1e9:g} nm."
            )
        if not abs(self.unmodulated) < 1:
            raise InvalidInput(
                "Expected an amplitude from 0 to below 1 as unmodulated light of a display model, got "
                f"{abs(self.unmodulated):g}."
            )
        if not 0 <= self.crosstalk < 10:
            raise InvalidInput(f"Expected a crosstalk from 0 to below 10 pixels, got {self.crosstalk:g}.")
        if not (self.falloff >= 0 and 0 <= self.size < 0.1 and 0 <= self.bandwidth < self.wavelength / 5):
            raise InvalidInput("Expected falloff, size and bandwidth of a display model of 0 or more.")

    def to_dict(self) -> dict:
        """Return the form on disk: lengths in nanometers and millimeters, other units as here."""
        entries: dict = {name: list(getattr(self, name)) for name in COUNTS}
        entries |= {name: getattr(self, name) for name in ("falloff", "size", "crosstalk")}
        entries["unmodulated"] = [self.unmodulated.real, self.unmodulated.imag]
        lengths = {"wavelength_nm": self.wavelength * 1e9, "bandwidth_nm": self.bandwidth * 1e9}
        return {**lengths, "half_side_mm": self.half * 1e3, **entries}

    @classmethod
    def from_dict(cls, entries: dict) -> DisplayModel:
        """Read the result of `to_dict`; all entries except the wavelength are optional.

        Raises
        ------
        InvalidInput, LookupError, TypeError, ValueError
        """
        values = {name: tuple(entries[name]) for name in COUNTS if name in entries}
        values |= {name: float(entries[name]) for name in ("falloff", "size", "crosstalk") if name in entries}
        if 0 < values.get("crosstalk", 0.0) < MIN_CROSSTALK:
            raise InvalidInput(
                f"A crosstalk of {values['crosstalk']:g} pixels is too short to be computed. Set that of the display "
                f"model to 0, or to {MIN_CROSSTALK:g} or more."
            )
        real, imaginary = entries.get("unmodulated", (0, 0))
        return cls(
            float(entries["wavelength_nm"]) * 1e-9,
            bandwidth=float(entries.get("bandwidth_nm", 0)) * 1e-9,
            unmodulated=complex(real, imaginary),
            half=float(entries.get("half_side_mm", 0)) * 1e-3,
            **values,
        )


class DisplayLight:
    """Light of a `DisplayModel` on grids, from phases to images.

    Parameters
    ----------
    model : DisplayModel
    shape : (int, int)
        Rows and columns of the SLM.
    pitch : float or (float, float)
        Pixel pitch, meters.
    reach : float
        Largest distance from the SLM of an image, meters; 0 for light at the SLM only.
    source : tuple
        One of `gaussian_points`, for the source's points and spectrum.
    on : array, optional
        Array whose library and device compute. Default: NumPy.
    """

    def __init__(
        self,
        model: DisplayModel,
        shape: Sequence[int],
        pitch: Pitch,
        reach: float,
        source: tuple = FIFTH,
        on: Array = PROCESSOR,
    ) -> None:
        self.model, self.shape, self.pitch = model, tuple(shape), pitch
        self._half = half_sides(shape, pitch, model.half)
        padded = padded_shape(shape, pitch, model.wavelength, reach, GUARD)
        if reach:  # all light that the stop spreads within the window of an image
            padded = [
                scipy.fft.next_fast_len(max(n, 2 * size)) for n, size in zip(padded, shape, strict=True)
            ]
        self.padded = tuple(GRID * n for n in padded)
        self._blurs = [_blurred_pixels(n, model.crosstalk) for n in shape]
        if not isinstance(on, np.ndarray):  # the standard has no sparse matrices
            self._blurs = [arrays.like(blur.toarray(), on) for blur in self._blurs]
        self._boxes = [arrays.like(_unaliased(n, model.crosstalk), on) for n in self.padded]
        points = source if model.size or model.bandwidth else [(0.0, 0.0, 0.0, 1.0)]
        self._points = [
            ((model.size * x, model.size * y), model.wavelength + model.bandwidth * c, weight)
            for x, y, c, weight in points
        ]
        self._transfers: dict[float, list[Array]] = {}
        self._illuminations = {
            wavelength: arrays.like(self._illumination(wavelength), on) for _, wavelength, _ in self._points
        }
        self._relays, self._slopes, self._places = [], [], []
        varies = any(model.across) or any(model.down)
        for sines, wavelength, _ in self._points:
            relay = _relay(self.padded, pitch, wavelength, model, sines)
            self._relays.append((arrays.like(relay, on), wavelength))
            if varies and len(self._points) > 1:
                slopes = _slopes(self.padded, pitch, wavelength, model, sines)
                self._slopes.append([arrays.like(slope, on) for slope in slopes])
        if varies:
            at = [self._half_sides(axis).astype(np.float32) for axis in (0, 1)]
            self._at = [arrays.like(each, on) for each in (at[1][None, :], at[0][:, None])]
            rows, columns = map(_lagrange, at)
            for eta, row in zip(NODES, rows, strict=True):
                for xi, column in zip(NODES, columns, strict=True):
                    relay = _relay(self.padded, pitch, model.wavelength, model, (0.0, 0.0), (xi, eta))
                    parts = relay, row[:, None], column[None, :]
                    self._places.append([arrays.like(each, on) for each in parts])

    def spectra(self, phases: Array) -> dict[float, Array]:
        """Compute the spectrum of the light that leaves the pixels, at each wavelength of the source.

        Parameters
        ----------
        phases : array, shape (y, x)
            Radians, at the model's wavelength; the optical path is the same at others.
        """
        model, smooth = self.model, self.blurred(phases)
        spectra = {}
        for wavelength, beam in self._illuminations.items():
            light = arrays.phasors(smooth * (model.wavelength / wavelength))
            light *= math.sqrt(1 - abs(model.unmodulated) ** 2)
            light += complex(model.unmodulated)
            light *= beam
            for axis in (1, 0):  # dark rows, and frequencies beyond the grid's, are left out
                light = arrays.fft(light, FINE * self.padded[axis] // GRID, axis)
                light = resized(light, self.padded[axis], axis)
            light *= self._boxes[0][:, None]
            light *= self._boxes[1][None, :]
            spectra[wavelength] = light
        return spectra

    def picture(self, spectra: dict[float, Array], distance: float) -> Array:
        """Compute the intensity on the padded grid, `GRID` samples per pixel side, float32.

        Parameters
        ----------
        spectra : dict of float to array
            See `spectra`.
        distance : float
            Distance from the SLM, meters.
        """
        relayed = self.relayed(spectra[self.model.wavelength])
        image = arrays.zeros(self.padded, "float32", self._boxes[0])
        transfers = self._transfers_to(distance)
        center = self._relays[0][0] * spectra[self.model.wavelength]
        for number, ((relay, wavelength), transfer) in enumerate(zip(self._relays, transfers, strict=True)):
            wave = relayed
            if number:
                light = relay * spectra[wavelength]
                wave = relayed + (light - center)
                if self._slopes:
                    wave += self._field_change(light, center, number)
            wave = arrays.ifft2(wave * transfer, overwrite=True)
            image += self._points[number][2] * arrays.intensity(wave)
        return image

    def _field_change(self, light, center, number):
        """Spectrum, to first order, of a source point's change of aberrations over the field, less the center's."""
        change = arrays.zeros(self.padded, "complex64", self._boxes[0])
        for at, slope, own in zip(self._at, self._slopes[number], self._slopes[0], strict=True):
            change += at * arrays.ifft2(slope * light - own * center, overwrite=True)
        change *= 1j
        return arrays.fft2(change, overwrite=True)

    def relayed(self, spectrum: Array) -> Array:
        """Return the spectrum of the light behind the relay, at the SLM's image."""
        if not self._places:
            return self._relays[0][0] * spectrum
        light = arrays.zeros(self.padded, "complex64", self._boxes[0])
        for relay, rows, columns in self._places:
            wave = arrays.ifft2(relay * spectrum, overwrite=True)
            wave *= rows
            wave *= columns
            light += wave
        return arrays.fft2(light, overwrite=True)

    def relayed_adjoint(self, spectrum: Array) -> Array:
        """Apply the adjoint of `relayed`."""
        xp = arrays.namespace(spectrum)
        if not self._places:
            return xp.conj(self._relays[0][0]) * spectrum
        light = arrays.ifft2(spectrum)
        wave = arrays.zeros(self.padded, "complex64", self._boxes[0])
        for relay, rows, columns in self._places:
            wave += xp.conj(relay) * arrays.fft2(light * rows * columns, overwrite=True)
        return wave

    def spectra_adjoint(self, spectrum: Array) -> Array:
        """Apply the adjoint of the steps from phasors to `spectra`, with the beam, at the model's wavelength."""
        xp = arrays.namespace(spectrum)
        light = spectrum * xp.conj(self._boxes[0])[:, None]
        light *= xp.conj(self._boxes[1])[None, :]
        for axis in (0, 1):
            light = resized(light, FINE * self.padded[axis] // GRID, axis)
            light = arrays.ifft(light, None, axis, "forward", overwrite=True)
            count = FINE * self.shape[axis]
            light = light[:count, :] if axis == 0 else light[:, :count]
        return light * xp.conj(self._illuminations[self.model.wavelength])

    def blurred(self, phases: Array) -> Array:
        """Return the phases within the pixels, float32, `FINE` samples per pixel side."""
        rows, columns = self._blurs
        return rows @ (columns @ arrays.as_type(arrays.known(phases), "float32").T).T

    def at_pixels(self, fine: Array) -> Array:
        """Apply the adjoint of `blurred`."""
        rows, columns = self._blurs
        return rows.T @ (columns.T @ fine.T).T

    def _transfers_to(self, distance):
        if distance not in self._transfers:
            pitch = scaled(self.pitch, 1 / GRID)
            self._transfers[distance] = [
                transfer_function(self.padded, pitch, wavelength, distance, "full", sines, self._boxes[0])
                for sines, wavelength, _ in self._points
            ]
        return self._transfers[distance]

    def _half_sides(self, axis):
        """Coordinates xi or eta of the padded grid's samples; those beyond the left of the SLM are at the right end."""
        count, size = self.padded[axis], self.shape[axis]
        at = np.arange(count) / GRID
        at = np.where(at > (count / GRID + size) / 2, at - count / GRID, at)
        return np.clip((at - (size - 1) / 2) / self._half[axis], -1, 1)

    def _illumination(self, wavelength):
        """Beam at the samples within the pixels."""
        model = self.model
        eta, xi = ((_samples(n) - (n - 1) / 2) / half for n, half in zip(self.shape, self._half, strict=True))
        half = self._half[0] * axes(self.pitch)[0]
        turns = 2j * math.pi * half / wavelength
        rows = np.exp(-model.falloff * (eta - model.position[1]) ** 2 + turns * model.tilt[1] * eta)
        columns = np.exp(-model.falloff * (xi - model.position[0]) ** 2 + turns * model.tilt[0] * xi)
        return (rows[:, None] * columns[None, :]).astype(np.complex64)


def zernike(x: np.ndarray, y: np.ndarray) -> list[np.ndarray]:
    """Noll's Zernike polynomials 4 to 11 at points of the unit disk, each of mean square 1 over it."""
    square = x * x + y * y
    return [
        math.sqrt(3) * (2 * square - 1),
        2 * math.sqrt(6) * x * y,
        math.sqrt(6) * (x * x - y * y),
        math.sqrt(8) * (3 * square - 2) * y,
        math.sqrt(8) * (3 * square - 2) * x,
        math.sqrt(8) * (3 * x * x - y * y) * y,
        math.sqrt(8) * (x * x - 3 * y * y) * x,
        math.sqrt(5) * (6 * square**2 - 6 * square + 1),
    ]


def _samples(count):
    """Positions of samples within pixels, in pixels from the center of the first one."""
    return (np.arange(count * FINE) + 0.5) / FINE - 0.5


@lru_cache(16)
def _blurred_pixels(count, sigma):
    """Matrix from pixels to their samples, blurred by a Gaussian: boxes whose edges are error functions."""
    edges = np.arange(count + 1) - 0.5
    edges[[0, -1]] = -math.inf, math.inf  # phases are continued beyond the outermost pixels
    distance = _samples(count)[:, None] - edges[None, :]
    scale = 1 / (math.sqrt(2) * sigma) if sigma else math.inf
    weights = -np.diff(erf(distance * scale), axis=1) / 2
    weights[weights < 1e-7] = 0
    return scipy.sparse.csr_array((weights / weights.sum(axis=1, keepdims=True)).astype(np.float32))


@lru_cache(16)
def _unaliased(count, sigma):
    """Factor from the samples' spectrum to that of the continuous light, exact for small phases.

    Samples add up the spectrum sinc(f) exp(-2 pi^2 sigma^2 f^2) of a blurred pixel at all f + n `FINE`, times (-1)^n,
    as they are half a sample off its center. The factor also includes the position of the first sample, and the smaller
    number of the image's samples.
    """
    f = scipy.fft.fftfreq(count, 1 / GRID)  # cycles per pixel
    n = np.arange(-400, 401)[:, None]
    aliases = f + FINE * n
    spectra = (-1.0) ** n * np.sinc(aliases) * np.exp(-2 * (math.pi * sigma * aliases) ** 2)
    shift = np.exp(-2j * math.pi * f * _samples(1)[0])
    ratio = spectra[400] / np.where(np.abs(f) < 1, spectra.sum(axis=0), 1)  # both are 0 at the ends
    return (GRID / FINE * ratio * shift).astype(np.complex64)


@lru_cache(2)
def _zernike_on(shape, pitch, wavelength, sines, stop):
    """Mask, transmission of the stop, and polynomials where a grid's frequencies pass the relay's Fourier plane."""
    y, x = (
        (scipy.fft.fftfreq(n, d / GRID) * wavelength + s) / stop
        for n, d, s in zip(shape, axes(pitch), sines[::-1], strict=True)
    )
    y, x = y[:, None], x[None, :]
    mask = _stop(
        shape, axes(scaled(pitch, 1 / GRID)), stop / wavelength, [sine / wavelength for sine in sines[::-1]]
    )
    inside = np.abs(mask) > DARK
    terms = np.array([np.broadcast_to(each, shape)[inside] for each in zernike(x, y)], np.float32)
    return inside, mask[inside], terms


def _stop(shape, spacings, radius, shift):
    """Transmission of a stop in the Fourier plane: 1 up to a radius around a frequency.

    The light of its edge falls only with the distance's power of 1.5, and would wrap around on a periodic grid. So the
    transmission is the spectrum of a round stop's point spread (Goodman, Introduction to Fourier Optics, 3rd ed.,
    section 4.4.2), tapered to 0 at half of the grid.
    """
    near = [np.minimum(np.arange(n), n - np.arange(n)) for n in shape]
    y, x = (spacing * np.arange(n // 2 + 1) for n, spacing in zip(shape, spacings, strict=True))
    distance = np.hypot(y[:, None], x[None, :])
    distance[0, 0] = 1e-3 * spacings[0]
    spread = radius * j1(2 * math.pi * radius * distance) / distance * math.prod(spacings)
    for axis, n in enumerate(shape):
        fall = np.clip((np.arange(n // 2 + 1) / (n / 2) - FLAT) / (1 - FLAT), 0, 1)
        taper = np.cos(math.pi / 2 * fall) ** 2
        spread *= taper[:, None] if axis == 0 else taper[None, :]
    spread = spread[near[0]][:, near[1]].astype(np.complex64)
    for axis, (n, s, spacing) in enumerate(zip(shape, shift, spacings, strict=True)):
        ramp = np.exp(-2j * math.pi * s * spacing * scipy.fft.fftfreq(n, 1 / n)).astype(np.complex64)
        spread *= ramp[:, None] if axis == 0 else ramp[None, :]
    return scipy.fft.fft2(spread, overwrite_x=True).real


def _relay(shape, pitch, wavelength, model, sines, at=(0.0, 0.0)):
    """Transfer function of stop and aberrations at a point of the field, for a point of the source."""
    stop = model.wavelength / (2 * coarsest(pitch))
    inside, mask, terms = _zernike_on(shape, pitch, wavelength, sines, stop)
    amounts = np.array(model.aberrations)
    amounts[:FIELD_TERMS] += np.array(model.across) * at[0] + np.array(model.down) * at[1]
    phase = (amounts * (model.wavelength / wavelength)).astype(np.float32) @ terms
    relay = np.zeros(shape, np.complex64)
    relay[inside] = mask * np.exp(1j * phase)
    return relay


def _slopes(shape, pitch, wavelength, model, sines):
    """Changes of the aberrations to the right and down, radians per half side."""
    inside, _, terms = _zernike_on(shape, pitch, wavelength, sines, model.wavelength / (2 * coarsest(pitch)))
    slopes = np.zeros((2, *shape), np.float32)
    for slope, amounts in zip(slopes, (model.across, model.down), strict=True):
        slope[inside] = (np.array(amounts) * (model.wavelength / wavelength)).astype(np.float32) @ terms[
            :FIELD_TERMS
        ]
    return slopes


def _lagrange(at):
    """Lagrange weights of the `NODES`, float32."""
    weights = []
    for i, node in enumerate(NODES):
        others = np.delete(NODES, i)
        weights.append(np.prod([(at - o) / (node - o) for o in others], axis=0).astype(np.float32))
    return weights
