"""The angular spectrum method against torchoptics, and against its own invariants."""

import math

import numpy as np
import pytest

from holopath_addon.engine import propagation

PITCH, WAVELENGTH, N = 8e-6, 516.5e-9, 256


def gaussian(n=N):
    axis = (np.arange(n) - (n - 1) / 2) * PITCH
    return np.exp(-(axis[:, None] ** 2 + axis**2) / (0.25e-3) ** 2).astype(np.complex64)


def random_field(n=N, seed=0):
    """Band-limited noise with a border of zeros, so that neither program loses light at an edge."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    axis = np.abs(np.fft.fftfreq(n))
    noise = np.fft.ifft2(np.fft.fft2(noise) * (axis[:, None] ** 2 + axis**2 < 0.15**2))
    window = np.hanning(n) ** 2
    return (noise * window[:, None] * window).astype(np.complex64)


def torchoptics_field(field, distance):
    torch = pytest.importorskip("torch")
    torchoptics = pytest.importorskip("torchoptics")
    source = torchoptics.Field(torch.tensor(field, dtype=torch.complex128), WAVELENGTH, spacing=PITCH)
    there = source.propagate_to_z(distance, propagation_method="ASM", asm_pad=(3 * N, 3 * N))
    return there.data.numpy()


@pytest.mark.parametrize("make", [gaussian, random_field])
@pytest.mark.parametrize("distance", [2e-3, 10e-3, 30e-3, 100e-3])
def test_agrees_with_torchoptics(make, distance):
    field = make()
    ours = propagation.propagate(field, distance, PITCH, WAVELENGTH, band="full")
    truth = torchoptics_field(field, distance)
    assert np.linalg.norm(ours - truth) < 1e-4 * np.linalg.norm(truth)


def test_zero_distance_is_the_identity():
    field = random_field()
    np.testing.assert_allclose(propagation.propagate(field, 0.0, PITCH, WAVELENGTH, "full"), field, atol=2e-6)


def test_there_and_back():
    field = gaussian()
    there = propagation.propagate(field, 10e-3, PITCH, WAVELENGTH)
    back = propagation.propagate(there, -10e-3, PITCH, WAVELENGTH)
    assert np.linalg.norm(back - field) < 1e-4 * np.linalg.norm(field)


def test_energy_is_kept():
    field = gaussian()
    there = propagation.propagate(field, 10e-3, PITCH, WAVELENGTH)
    assert np.vdot(there, there).real == pytest.approx(np.vdot(field, field).real, rel=1e-5)


@pytest.mark.parametrize("distance", [3e-3, 80e-3])
def test_adjoint_is_propagation_back(distance):
    a, b = random_field(seed=1), random_field(seed=2)
    forward = np.vdot(b, propagation.propagate(a, distance, PITCH, WAVELENGTH))
    adjoint = np.vdot(propagation.propagate(b, -distance, PITCH, WAVELENGTH), a)
    assert abs(forward - adjoint) < 1e-5 * np.linalg.norm(a) * np.linalg.norm(b)


def test_gaussian_beam_widens_as_the_analytic_one():
    waist, distance = 0.1e-3, 60e-3
    axis = (np.arange(N) - (N - 1) / 2) * PITCH
    beam = np.exp(-(axis[:, None] ** 2 + axis**2) / waist**2)
    intensity = np.abs(propagation.propagate(beam, distance, PITCH, WAVELENGTH)) ** 2
    width = 2 * math.sqrt((intensity.sum(0) * axis**2).sum() / intensity.sum())
    rayleigh = math.pi * waist**2 / WAVELENGTH
    assert width == pytest.approx(waist * math.hypot(1, distance / rayleigh), rel=1e-3)


def test_phase_keeps_its_digits_at_300_mm():
    """Finding F8: against the transfer function in extended precision."""
    shape, distance = (64, 64), 0.3
    ours = propagation.transfer_function(shape, PITCH, WAVELENGTH, distance, "full")
    u = propagation.spectral_u(shape, PITCH, WAVELENGTH).astype(np.longdouble)
    phase = 2 * np.pi * distance / np.longdouble(WAVELENGTH) * (np.sqrt(1 - u) - 1)
    kept = ours != 0
    error = np.angle(ours[kept] * np.exp(-1j * (phase[kept] % (2 * np.pi)).astype(np.float64)))
    assert np.sqrt(np.mean(error**2)) < 1e-4


def test_no_light_wraps_around():
    """A spot at the edge walks out of the window; a circular convolution would bring it back."""
    field = np.zeros((N, N), np.complex64)
    field[:, :8] = 1
    there = propagation.propagate(field, 20e-3, PITCH, WAVELENGTH)
    assert np.abs(there[:, -32:]).max() < 0.02
