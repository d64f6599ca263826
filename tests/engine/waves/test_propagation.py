"""The angular spectrum method against the Gaussian beam, torchoptics, and its own invariants."""

import math
import threading

import numpy as np
import pytest

from holopath_addon.engine.errors import InvalidInput
from holopath_addon.engine.pixels import EvenSteps
from holopath_addon.engine.waves import propagation

PITCH, WAVELENGTH, N = 8e-6, 516.5e-9, 256


def gaussian(n=N):
    axis = (np.arange(n) - (n - 1) / 2) * PITCH
    return np.exp(-(axis[:, None] ** 2 + axis**2) / (0.25e-3) ** 2).astype(np.complex64)


def beam(waist, distance, n=N):
    """The Gaussian beam in closed form: Saleh and Teich, Fundamentals of Photonics, eq. 3.1-7.

    Paraxial: at these waists the next term of the phase, k z (wavelength / (pi waist))^4 / 8, is under 1e-5 rad.
    """
    axis = (np.arange(n) - (n - 1) / 2) * PITCH
    q = 1 + 1j * distance * WAVELENGTH / (math.pi * waist**2)
    carrier = np.exp(2j * math.pi * distance / WAVELENGTH)
    return carrier * np.exp(-(axis[:, None] ** 2 + axis**2) / (waist**2 * q)) / q


def random_field(n=N, seed=0):
    """Band-limited noise with a border of zeros, so that neither program loses light at an edge."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
    axis = np.abs(np.fft.fftfreq(n))
    noise = np.fft.ifft2(np.fft.fft2(noise) * (axis[:, None] ** 2 + axis**2 < 0.15**2))
    window = np.hanning(n) ** 2
    return (noise * window[:, None] * window).astype(np.complex64)


DISTANCES = [2e-3, 10e-3, 30e-3, 100e-3]


@pytest.mark.parametrize("waist", [0.1e-3, 0.25e-3])
@pytest.mark.parametrize("distance", [-30e-3, *DISTANCES])
def test_gaussian_beam(library, waist, distance):
    """Amplitude and phase, wherever the beam is; it fills a quarter of the window at most."""
    field = library.asarray(beam(waist, 0).astype(np.complex64))
    there = propagation.propagate(field, PITCH, WAVELENGTH, distance)
    assert type(there) is type(field) and there.dtype == field.dtype
    expected = beam(waist, distance)
    assert np.linalg.norm(np.asarray(there) - expected) < 1e-4 * np.linalg.norm(expected)


def test_libraries_of_arrays_agree(other_library):
    """Stacks, real amplitudes, both bands, a distance of NumPy's, and places between pixels: roundings differ alone."""
    rng, pitch = np.random.default_rng(0), (8e-6, 9e-6)
    field = (rng.normal(size=(2, 3, 40, 50)) + 1j * rng.normal(size=(2, 3, 40, 50))).astype(np.complex64)
    for data in (field, np.ascontiguousarray(field.real)):
        for band in ("circular", "full"):
            way = pitch, WAVELENGTH, np.float64(2e-3), band
            found = propagation.propagate(other_library.asarray(data), *way)
            expected = propagation.propagate(data, *way)
            np.testing.assert_allclose(np.asarray(found), expected, atol=2e-6 * np.abs(expected).max())
    for step in (0.8, 0.777):  # by FFTs, and by chirps
        lines = [EvenSteps(1.3, step, 30)] * 2
        found = propagation.sampled(other_library.asarray(field[0, 0]), lines)
        expected = propagation.sampled(field[0, 0], lines)
        np.testing.assert_allclose(np.asarray(found), expected, atol=2e-6 * np.abs(expected).max())


def test_light_of_phases_does_not_come_round():
    """It fills aperture and band to their edges, and strays; against a grid of 16 times the window."""
    light = np.exp(2j * math.pi * np.random.default_rng(0).random((64, 64)))
    distance, wide = 1e-3, (1024, 1024)
    kernel = propagation.transfer_function(wide, PITCH, WAVELENGTH, distance)
    kernel = kernel * propagation.carrier(WAVELENGTH, distance)
    expected = np.fft.ifft2(np.fft.fft2(light, wide) * kernel)[:64, :64]
    error = propagation.propagate(light, PITCH, WAVELENGTH, distance) - expected
    assert (
        np.linalg.norm(error) ** 2 < 2e-4 * np.linalg.norm(expected) ** 2
    )  # 4e-3 on a grid without a guard band


# What torchoptics 1.0.2 (angular spectrum method, double precision, padded by 768 pixels on each side) makes of
# `random_field`, at five pixels; `test_the_record_is_torchoptics_own` compares it with the program itself.
ROWS, COLUMNS = [40, 100, 128, 150, 210], [120, 60, 128, 190, 140]
RECORD = {
    2e-3: [
        0.0036195 - 0.0149332j,
        -0.0449971 - 0.0224774j,
        -0.0887352 + 0.205789j,
        -0.0651585 + 0.1254351j,
        0.0036302 + 0.0089716j,
    ],
    10e-3: [
        -0.000431 - 0.0026129j,
        0.0255337 + 0.0355775j,
        -0.3307512 + 0.0716302j,
        -0.0469198 - 0.0564842j,
        -0.0315202 - 0.016079j,
    ],
    30e-3: [
        -0.0261606 + 0.0064735j,
        0.1143291 - 0.0172286j,
        0.0500859 + 0.2066773j,
        -0.0278957 - 0.0416809j,
        0.0003316 + 0.0086991j,
    ],
    100e-3: [
        0.0070636 + 0.0614916j,
        0.0169925 - 0.0881226j,
        -0.0113453 - 0.1354714j,
        0.0311697 + 0.08872j,
        -0.2058365 + 0.0068381j,
    ],
}


@pytest.mark.parametrize("distance", DISTANCES)
def test_agrees_with_the_record_of_torchoptics(distance):
    ours = propagation.propagate(random_field(), PITCH, WAVELENGTH, distance, band="full")
    np.testing.assert_allclose(ours[ROWS, COLUMNS], RECORD[distance], atol=1e-6)


def torchoptics_field(field, distance):
    torch, torchoptics = pytest.importorskip("torch"), pytest.importorskip("torchoptics")
    source = torchoptics.Field(torch.tensor(field, dtype=torch.complex128), WAVELENGTH, spacing=PITCH)
    there = source.propagate_to_z(distance, propagation_method="ASM", asm_pad=(3 * N, 3 * N))
    return there.data.numpy()


@pytest.mark.oracle
@pytest.mark.parametrize("make", [gaussian, random_field])
@pytest.mark.parametrize("distance", DISTANCES)
def test_agrees_with_torchoptics(make, distance):
    field = make()
    ours = propagation.propagate(field, PITCH, WAVELENGTH, distance, band="full")
    truth = torchoptics_field(field, distance)
    assert np.linalg.norm(ours - truth) < 1e-4 * np.linalg.norm(truth)


@pytest.mark.oracle
@pytest.mark.parametrize("distance", DISTANCES)
def test_the_record_is_torchoptics_own(distance):
    field = torchoptics_field(random_field(), distance)
    np.testing.assert_allclose(field[ROWS, COLUMNS], RECORD[distance], atol=1e-7)


@pytest.mark.oracle
def test_torch_finds_gradients():
    """Gradient of the energy in a window with respect to the field: twice its light propagated back."""
    torch = pytest.importorskip("torch")
    field = torch.asarray(random_field(64)).requires_grad_()
    window = torch.zeros((64, 64))
    window[20:40, 10:30] = 1
    there = propagation.propagate(field, PITCH, WAVELENGTH, 2e-3)
    (there.abs() ** 2 * window).sum().backward()
    back = propagation.propagate((there * window).detach(), PITCH, WAVELENGTH, -2e-3)
    assert torch.linalg.norm(field.grad - 2 * back) < 1e-5 * torch.linalg.norm(back)


def test_zero_distance_is_the_identity():
    field = random_field()
    np.testing.assert_allclose(propagation.propagate(field, PITCH, WAVELENGTH, 0.0, "full"), field, atol=2e-6)


def test_there_and_back():
    field = gaussian()
    there = propagation.propagate(field, PITCH, WAVELENGTH, 10e-3)
    back = propagation.propagate(there, PITCH, WAVELENGTH, -10e-3)
    assert np.linalg.norm(back - field) < 1e-4 * np.linalg.norm(field)


def test_energy_is_kept():
    field = gaussian()
    there = propagation.propagate(field, PITCH, WAVELENGTH, 10e-3)
    assert np.vdot(there, there).real == pytest.approx(np.vdot(field, field).real, rel=1e-5)


@pytest.mark.parametrize("distance", [3e-3, 80e-3])
def test_adjoint_is_propagation_back(distance):
    a, b = random_field(seed=1), random_field(seed=2)
    forward = np.vdot(b, propagation.propagate(a, PITCH, WAVELENGTH, distance))
    adjoint = np.vdot(propagation.propagate(b, PITCH, WAVELENGTH, -distance), a)
    assert abs(forward - adjoint) < 1e-5 * np.linalg.norm(a) * np.linalg.norm(b)


def test_phase_keeps_its_digits_at_300_mm():
    """Finding F8: against the transfer function in extended precision."""
    shape, distance = (64, 64), 0.3
    ours = propagation.transfer_function(shape, PITCH, WAVELENGTH, distance, "full")
    fy, fx = (WAVELENGTH * np.fft.fftfreq(n, PITCH).astype(np.longdouble) for n in shape)
    u = fy[:, None] ** 2 + fx**2
    phase = 2 * np.pi * distance / np.longdouble(WAVELENGTH) * (np.sqrt(1 - u) - 1)
    kept = ours != 0
    error = np.angle(ours[kept] * np.exp(-1j * (phase[kept] % (2 * np.pi)).astype(np.float64)))
    assert np.sqrt(np.mean(error**2)) < 1e-4


def test_no_light_wraps_around():
    """A spot at the edge walks out of the window; a circular convolution would bring it back."""
    field = np.zeros((N, N), np.complex64)
    field[:, :8] = 1
    there = propagation.propagate(field, PITCH, WAVELENGTH, 20e-3)
    assert np.abs(there[:, -32:]).max() < 0.02


@pytest.mark.parametrize("count", [1, 3])
def test_fields_that_are_moved_at_once(monkeypatch, count):
    """They equal fields propagated one by one, in order, if results overwrite fields that have been yielded."""
    monkeypatch.setattr(propagation, "threads", lambda: count)
    rng = np.random.default_rng(0)
    fields = (rng.normal(size=(8, 40, 50)) + 1j * rng.normal(size=(8, 40, 50))).astype(np.complex64)
    distance, pitch, wavelength = 1e-3, 8e-6, 516.5e-9
    alone = np.stack([propagation.propagate(field, pitch, wavelength, distance) for field in fields])
    assert np.array_equal(propagation.propagate(fields, pitch, wavelength, distance), alone)
    shape = propagation.padded_shape(fields.shape[1:], pitch, wavelength, distance)
    transfer = propagation.transfer_function(shape, pitch, wavelength, distance)
    expected = np.stack(list(propagation.propagate_stack(fields.copy(), transfer)))
    for field, wave in zip(fields, propagation.propagate_stack(fields, transfer), strict=True):
        field[:] = wave
    assert np.array_equal(fields, expected)


def test_moving_that_is_given_up_leaves_no_thread(monkeypatch):
    monkeypatch.setattr(propagation, "threads", lambda: 3)
    before = threading.active_count()
    moving = propagation.propagate_stack(np.ones((8, 16, 16), np.complex64), np.ones((16, 16), np.complex64))
    next(moving)
    assert threading.active_count() > before
    moving.close()
    assert threading.active_count() == before


@pytest.mark.parametrize(("memory", "fields"), [(None, 1), (1 << 30, 1), (16 << 30, 4), (1 << 50, 8)])
def test_no_more_fields_are_moved_than_memory_is_for(monkeypatch, memory, fields):
    monkeypatch.setattr(propagation, "installed", lambda: memory)
    monkeypatch.setattr(propagation, "threads", lambda: 8)
    assert propagation.stack_bytes(250 << 20, 100) == fields * (250 << 20)


def test_the_former_order_of_arguments_is_refused():
    for pitch in (PITCH, (8e-6, 9e-6)):
        with pytest.raises(InvalidInput, match="Put the distance last"):
            propagation.propagate(random_field(), 1e-3, pitch, WAVELENGTH)
