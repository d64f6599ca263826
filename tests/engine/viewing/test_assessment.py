"""Figures of what a viewer gets, against what optics says of simple waves."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.viewing import assessment, reconstruction
from holopath_addon.engine.viewing.reconstruction import Refocuser

N, PITCH, WAVELENGTH = 96, 8e-6, 516.5e-9
FAR, NEAR = 4e-3, 10e-3


def quiet(done, message):
    pass


def of_waves(data):
    grid = engine.Hologram(N, N, PITCH, (WAVELENGTH,), FAR, NEAR)
    return engine.WaveField(data[:, None].astype(np.complex64), grid, engine.Camera(np.eye(4), 0.3), 0.5)


def points(*places):
    """Waves towards points at (x, y, z), in pixels right and down of the middle, and meters from the SLM."""
    y, x = np.indices((N, N)) - N / 2
    waves = 0
    for right, down, z in places:
        aside = np.hypot(x - right, y - down) * PITCH
        recordable = aside <= 0.031 * z  # steeper waves are under two pixels long
        waves = waves + recordable * np.exp(-2j * math.pi / WAVELENGTH * np.hypot(aside, z))
    return of_waves(waves[None])


def noise(frames=6, seed=0):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(frames, N, N)) + 1j * rng.normal(size=(frames, N, N))


def test_sharpness_peaks_where_points_lie():
    field = points((-32, -32, 5e-3), (32, 32, 9e-3))
    distances = np.linspace(4.5e-3, 9.5e-3, 11)
    pictures = engine.reconstruct(field, field.mapping.z_to_depth(distances))
    found = assessment.sharpness(pictures)
    assert found.shape == (11, 3, 3)
    assert distances[found[:, 0, 0].argmax()] == pytest.approx(5e-3)
    assert distances[found[:, 2, 2].argmax()] == pytest.approx(9e-3)


def test_darkness_is_not_sharp():
    assert not assessment.sharpness(np.zeros((2, 8, 8, 1))).any()


def test_an_even_eyebox_and_a_narrow_one():
    """Noise fills the cone; within half of the band it leaves the edges dark, and is 4 times as dense in the middle."""
    for radius, middle, edge in ((0.5, 1.0, 1.0), (0.25, 4.0, 0.0)):
        fy, fx = np.meshgrid(np.fft.fftfreq(N), np.fft.fftfreq(N), indexing="ij")
        field = of_waves(np.fft.ifft2(np.fft.fft2(noise()) * (np.hypot(fx, fy) <= radius)))
        refocus, focus = Refocuser(field), field.mapping.z_to_depth(FAR + 1e-6)
        whole, grid = refocus([focus])[0], assessment.pupils(field, 0.25, 5)
        for pupil, expected in ((grid[2][2], middle), (grid[2][0], edge), (grid[0][2], edge)):
            picture = refocus([focus], pupil)[0]
            assert assessment.brightness(field, picture, whole, pupil) == pytest.approx(expected, abs=0.35)


@pytest.mark.parametrize(
    ("share", "apart", "fewer", "error"),
    [(0.45, 2, True, 1e-4), (0.5, 2, True, 0.02), (0.22, 4, True, 1e-4), (0.8, 2, False, 1e-6)],
)
def test_parts_of_the_pupil_at_fewer_pixels(share, apart, fewer, error, monkeypatch):
    """They show what they show at all pixels, wherever they are; one that is too large is seen at all of them."""
    field, shapes = of_waves(noise(2)), []
    refocus, focus = Refocuser(field, max_apart=4), [field.mapping.z_to_depth(FAR + 1e-3)]
    inverse = reconstruction.field_of

    def noted(waves, *words, **options):
        shapes.append(waves.shape[0])
        return inverse(waves, *words, **options)

    monkeypatch.setattr(reconstruction, "field_of", noted)
    for line in assessment.pupils(field, share, 3):
        for pupil in filter(None, line):
            whole, some = refocus(focus, pupil)[0], refocus(focus, pupil, apart=apart)[0]
            np.testing.assert_allclose(some, whole[::apart, ::apart], atol=error * whole.max())
            assert shapes[-1] == (shapes[0] // apart if fewer else shapes[0])


def test_pupils_lie_within_the_light():
    field = points((0, 0, 5e-3))
    radius, grid = assessment.pupil_radius(field), assessment.pupils(field, 0.5, 5)
    inside = [pupil for row in grid for pupil in row if pupil is not None]
    assert len(inside) == 13
    assert max(math.hypot(p.x, p.y) + p.diameter / 2 for p in inside) == pytest.approx(radius)
    assert grid[0][2].y > 0 and grid[2][0].x < 0 and grid[0][0] is None
    assert assessment.pupils(field, 1.0, 1) == [[engine.Pupil(0.0, 0.0, 2 * radius)]]


@pytest.mark.parametrize(("x", "diameter"), [(0, 0.4), (0.5, 1), (0.9, 0.6), (0, 2.5), (0.5, 1.6), (0, 2)])
def test_shares_of_a_part_of_the_pupil(x, diameter):
    """Compared with counted points; parts are in radii of the pupil that light fills."""
    field = points((0, 0, 5e-3))
    radius = field.mapping.pupil_radius(field.hologram.max_slope(WAVELENGTH))
    across, up = np.meshgrid(*[np.linspace(-1, 1, 1001)] * 2)
    inside = np.hypot(across, up) <= 1
    covered = inside & (np.hypot(across - x, up) <= diameter / 2)
    (share,) = assessment.opening_fractions(field, engine.Pupil(x * radius, 0.0, diameter * radius))
    assert share == pytest.approx(covered.sum() / inside.sum(), abs=2e-3)


def test_depth_is_a_slope_in_slices():
    """A point at dz before the focus is seen by slope s at -s dz: x runs with the pupil, or against it behind."""
    for z, sign in ((9e-3, -1), (5e-3, 1)):
        field, focus = points((0, 0, z)), 7e-3
        reach, mapping = 0.5 * assessment.pupil_radius(field), field.mapping
        pupils = [engine.Pupil(x, 0.0, reach / 2) for x in (-reach, reach)]
        lines = assessment.epipolar_slices(
            Refocuser(field), float(mapping.z_to_depth(focus)), pupils, N // 2, quiet
        )
        at = [int(np.convolve(line, np.ones(5), "same").argmax()) for line in lines[..., 0]]
        slope = reach * mapping.focal / mapping.beta
        assert lines.shape == (2, N, 3)
        assert at[1] - at[0] == pytest.approx(sign * 2 * slope * abs(z - focus) / PITCH, abs=2)


@pytest.mark.parametrize(("phases", "share"), [(np.zeros((1, 1, N, N)), 1.0), (None, math.pi / 4)])
def test_light_that_stays_within_the_cone(phases, share):
    """All of a plane wave; of random phases the circle's share of the square."""
    phases = np.angle(noise(2))[:, None] if phases is None else phases
    field = of_waves(np.exp(1j * phases[:, 0]))
    phase = engine.PhaseHologram(phases.astype("f4"), field.hologram, field.camera, 0.5, "sgd", (1.0,))
    assert assessment.efficiency(phase, quiet) == [pytest.approx(share, abs=0.02)]


def test_loss_of_views():
    picture = np.random.default_rng(0).random((2, 9, 9, 1))
    same, dark = assessment.loss(picture, picture * [[[[1]]], [[[0]]]])
    assert same > 100 and math.isnan(dark)
