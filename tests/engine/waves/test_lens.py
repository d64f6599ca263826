"""Light behind a lens: direct sums, Goodman's formula, Gaussian beams, the angular spectrum, and torchoptics."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.waves.lens import Collins, behind_lens, spread_waves
from holopath_addon.engine.waves.propagation import propagate

GREEN, PITCH = 520e-9, 8e-6


def places(n, pitch):
    return (np.arange(n) - (n - 1) / 2) * pitch


def distance_of(found, truth):
    """Relative, but for a constant phase."""
    turn = np.vdot(found, truth)
    return np.linalg.norm(found * turn / abs(turn) - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize(
    ("curvature", "reach", "scale", "shape", "there"),
    [
        (0.0, 0.1, 1.0, (24, 24), (24, 24)),
        (0.0, 0.1, 0.7, (24, 30), (24, 27)),
        (0.3, 0.1, 0.7, (25, 31), (25, 24)),  # those in the middle
        (-0.2, -0.05, 0.8, (24, 31), (24, 24)),  # mirrored
        (0.2, -0.05, 1.0, (24, 24), (24, 24)),
        (0.0, 0.1, 0.5, (20, 24), (40, 31)),
    ],
)
def test_direct_sums(library, curvature, reach, scale, shape, there):
    """Each pixel by the integral's own sum, forward; and back by the scalar product."""
    rng = np.random.default_rng(0)
    pitch, wide = (7e-6, 8e-6), scale * GREEN * abs(reach) / (24 * 8e-6)

    def matrix(n, count, d):
        x, other = places(n, d), places(count, wide)
        found = np.exp(
            1j * math.pi * (curvature * x**2 - 2 * np.multiply.outer(other, x)) / (GREEN * reach)
        ) * math.sqrt(d * wide / (GREEN * abs(reach)))
        start = max(0, (n - count) // 2)
        found[:, :start] = found[:, start + count :] = 0
        return found

    field = rng.normal(size=(2, *shape)) + 1j * rng.normal(size=(2, *shape))
    way = Collins(shape, pitch, GREEN, curvature, reach, there, wide)
    expected = matrix(shape[0], there[0], pitch[1]) @ field @ matrix(shape[1], there[1], pitch[0]).T
    found = np.asarray(way.propagate(library.asarray(field)))
    assert np.linalg.norm(found - expected) < 1e-6 * np.linalg.norm(expected)
    other = rng.normal(size=found.shape) + 1j * rng.normal(size=found.shape)
    back = np.asarray(way.adjoint(library.asarray(other)))
    assert np.vdot(other, found) == pytest.approx(np.vdot(back, field), rel=1e-6)
    single = np.asarray(way.propagate(library.asarray(field.astype(np.complex64))))
    assert single.dtype == np.complex64 and np.linalg.norm(single - expected) < 1e-5 * np.linalg.norm(
        expected
    )


def test_pixels_of_a_fourier_transform_keep_all_light():
    way = Collins((24, 24), PITCH, GREEN, 0.0, 0.1, (24, 24), GREEN * 0.1 / (24 * PITCH))
    field = np.random.default_rng(0).normal(size=(24, 24)).astype(np.complex64)
    assert way.kind == "Fourier"
    np.testing.assert_allclose(way.adjoint(way.propagate(field)), field, atol=1e-6)
    assert Collins((24, 24), PITCH, GREEN, 0.0, 0.1, (24, 24), 40e-6).kind == "chirp-z"


def spot(n=96, pitch=PITCH, aside=(0.06e-3, -0.04e-3), waist=0.1e-3, turns=0.08):
    """A Gaussian beam aside of the axis that leaves at an angle."""
    x, y = places(n, pitch)[None, :], places(n, pitch)[:, None]
    wave = np.exp(-((x - aside[0]) ** 2 + (y - aside[1]) ** 2) / waist**2)
    return wave * np.exp(2j * math.pi * turns * (x - 0.5 * y) / pitch)


def by_parts(wave, focal, before, behind):
    """Free space, the lens's phase, free space again; by angular spectra on a wide grid."""
    n, wide = wave.shape[0], 320
    edge = (wide - n) // 2
    wave = np.pad(wave, edge).astype(np.complex64)
    x, y = places(wide, PITCH)[None, :], places(wide, PITCH)[:, None]
    wave = propagate(wave, PITCH, GREEN, before)
    wave = wave * np.exp(-1j * math.pi * (x**2 + y**2) / (GREEN * focal))
    return propagate(wave, PITCH, GREEN, behind)[edge:-edge, edge:-edge]


LAYOUTS = [(20e-3, 20e-3, 20e-3), (20e-3, 8e-3, 20e-3), (25e-3, 10e-3, 30e-3), (20e-3, 0.0, 15e-3)]


def collins(wave, lens, there_pitch=PITCH):
    """The field behind a lens, with the curvature that the transform leaves out."""
    n = wave.shape[0]
    way = Collins(wave.shape, PITCH, GREEN, lens.curvature, lens.reach, wave.shape, there_pitch)
    x, y = places(n, there_pitch)[None, :], places(n, there_pitch)[:, None]
    bend = (1 - lens.distance / lens.focal) / (GREEN * lens.reach)
    return way.propagate(wave.astype(np.complex64)) * np.exp(1j * math.pi * bend * (x**2 + y**2))


@pytest.mark.parametrize(("focal", "before", "behind"), LAYOUTS)
def test_the_angular_spectrum_agrees(focal, before, behind):
    wave, lens = spot(), engine.Lens(focal, before, behind)
    assert distance_of(collins(wave, lens), by_parts(wave, focal, before, behind)) < 1e-3


def test_goodmans_fourier_lens():
    """An object d before a lens, in its back focal plane: Introduction to Fourier Optics, eq. 5-19.

    Of a Gaussian beam aside, the transform is known in closed form.
    """
    focal, d, waist, (x_0, y_0), turns = 50e-3, 20e-3, 0.1e-3, (0.06e-3, -0.04e-3), 0.08
    lens, n = engine.Lens(focal, d), 96
    pitch = GREEN * focal / (n * PITCH)
    u, v = places(n, pitch)[None, :], places(n, pitch)[:, None]
    curvature = np.exp(1j * math.pi / (GREEN * focal) * (1 - d / focal) * (u**2 + v**2))

    def transform(w, a, f_0):
        """Transform of exp(-(x - a)^2 / waist^2 + 2 pi i f_0 x) at w / (lambda f), without a constant phase."""
        f = w / (GREEN * focal) - f_0
        return np.exp(-((math.pi * waist * f) ** 2) - 2j * math.pi * f * a)

    expected = curvature * transform(u, x_0, turns / PITCH) * transform(v, y_0, -turns / 2 / PITCH)
    expected *= math.pi * waist**2 / (GREEN * focal)
    found = collins(spot(), lens, pitch) * (PITCH / pitch)  # fields are scaled by pixels
    assert distance_of(found, expected) < 1e-3


def test_the_waist_of_a_gaussian_beam():
    """Gaussian beam through a lens: Saleh and Teich, Fundamentals of Photonics, eqs. 3.2-5 to 3.2-9."""
    waist, focal, before, n = 0.1e-3, 50e-3, 20e-3, 128
    rayleigh = math.pi * waist**2 / GREEN
    magnification = abs(focal / (before - focal)) / math.sqrt(1 + (rayleigh / (before - focal)) ** 2)
    behind = focal + magnification**2 * (before - focal)
    wave = spot(n, aside=(0.0, 0.0), waist=waist, turns=0.0)
    for moved, width in ((0.0, magnification * waist), (6e-3, None)):
        lens = engine.Lens(focal, before, behind + moved)
        if width is None:
            width = magnification * waist * math.sqrt(1 + (moved / (magnification**2 * rayleigh)) ** 2)
        pitch = 5 * width / n
        light = np.abs(collins(wave, lens, pitch)) ** 2
        x = places(n, pitch)
        assert 2 * math.sqrt((light.sum(0) * x**2).sum() / light.sum()) == pytest.approx(width, rel=1e-3)


def test_fresnels_far_field():
    """Compare a slit with Goodman, eq. 4-27, sinc, and the angular spectrum where both are sampled well."""
    n, z = 64, 40.0
    pitch = GREEN * z / (4 * n * PITCH)
    light = np.abs(
        Collins((n, n), PITCH, GREEN, 1.0, z, (n, n), pitch).propagate(np.ones((n, n), np.complex64))
    )
    x = places(n, pitch)
    expected = np.abs(np.sinc(n * PITCH * x / (GREEN * z)))
    np.testing.assert_allclose(light[n // 2] / light.max(), expected / expected.max(), atol=1e-3)
    wave, z = spot(turns=0.02), 30e-3
    found = Collins(wave.shape, PITCH, GREEN, 1.0, z, wave.shape, PITCH).propagate(wave)
    x, y = places(96, PITCH)[None, :], places(96, PITCH)[:, None]
    found = found * np.exp(1j * math.pi * (x**2 + y**2) / (GREEN * z))
    wide = propagate(np.pad(wave, 64).astype(np.complex64), PITCH, GREEN, z)[64:-64, 64:-64]
    assert distance_of(found, wide) < 1e-3


@pytest.mark.oracle
@pytest.mark.parametrize(("focal", "before", "behind"), LAYOUTS)
def test_torchoptics_agrees(focal, before, behind):
    torch, torchoptics = pytest.importorskip("torch"), pytest.importorskip("torchoptics")
    wave = spot()
    source = torchoptics.Field(torch.tensor(np.pad(wave, 112)), GREEN, spacing=PITCH)
    # its lens is round, and as wide as its grid
    lens = torchoptics.elements.Lens((320, 320), focal, z=before, spacing=PITCH).double()
    there = lens(source.propagate_to_z(before, propagation_method="ASM", asm_pad=(320, 320)))
    there = there.propagate_to_z(before + behind, propagation_method="ASM", asm_pad=(320, 320))
    expected = there.data.numpy()[112:-112, 112:-112]
    assert distance_of(collins(wave, engine.Lens(focal, before, behind)), expected) < 1e-3


def test_the_way_of_a_hologram():
    hologram = engine.Hologram(48, 32, PITCH, (640e-9, GREEN), optics=engine.Optics(lens=engine.Lens(0.1)))
    image = hologram.in_air
    assert (image.width, image.height) == (32, 32)
    assert image.pitch == pytest.approx(GREEN * 0.1 / (32 * PITCH))
    way = behind_lens(hologram, GREEN)
    assert way.propagate(np.ones((32, 48), np.complex64)).shape == (32, 32)
    assert way.adjoint(np.ones((32, 32), np.complex64)).shape == (32, 48)
    # each color has pixels of its own, of which those beside the picture see what the others have not
    assert (way.kind, behind_lens(hologram, 640e-9).kind) == ("Fourier", "Fourier")
    assert image.pitch_at(640e-9) == pytest.approx(640e-9 * 0.1 / (32 * PITCH))
    rows, columns = image.met(640e-9)
    assert rows == columns == (3, 1.0, 26)
    broken = engine.Hologram(80, 64, (6.5e-6, PITCH), (GREEN,), optics=engine.Optics(lens=engine.Lens(0.1)))
    assert behind_lens(broken, GREEN).kind == "chirp-z"
    assert behind_lens(engine.Hologram(48, 32, PITCH), GREEN) is None


@pytest.mark.parametrize("shape", [(96, 96), (64, 80)])
def test_even_waves_that_come_from_all_of_the_aperture(shape):
    """Compare by rays: the local frequency is the phase's slope, and a square becomes a disk; and by a transform."""
    waves = spread_waves(2, shape)
    np.testing.assert_allclose(np.abs(waves), 1, atol=1e-6)
    np.testing.assert_allclose(waves[1], waves[0].conj(), atol=1e-6)
    slopes = [
        np.angle(np.take(waves[0], range(1, n), axis) / np.take(waves[0], range(n - 1), axis)) / math.pi
        for axis, n in enumerate(shape)
    ]
    edge = np.hypot(slopes[0][:, -1], slopes[1][:-1, -1])
    np.testing.assert_allclose(edge, 1, atol=0.05)
    assert np.hypot(slopes[0][:, :-1], slopes[1][:-1]).max() < 1.03
    power = np.abs(np.fft.fftshift(np.fft.fft2(waves[0], norm="ortho"))) ** 2
    y, x = ((2 * np.arange(n) + 1) / n - 1 for n in shape)
    radius = np.hypot(y[:, None], x)
    assert power[radius < 1].sum() > 0.93 * power.sum()
    rings = [power[(radius >= a) & (radius < a + 0.2)].mean() for a in (0.0, 0.2, 0.4, 0.6)]
    np.testing.assert_allclose(rings, 4 / math.pi, rtol=0.3)
