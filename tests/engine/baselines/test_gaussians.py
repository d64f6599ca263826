"""Gaussians on surfaces: which are taken, how they are blended, and what they show."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.scenes import GREEN
from holopath_addon import engine
from holopath_addon.engine.baselines.gaussians import CONTRAST, SIGMA, Gaussians, blended
from holopath_addon.engine.waves.propagation import propagate

PITCH = 8e-6
SIDE = 128


def hologram(wavelengths=(GREEN,), **more):
    return engine.Hologram(SIDE, SIDE, PITCH, wavelengths, 0.5e-3, 3e-3, **more)


def job(frames, wavelengths=(GREEN,), seed=0):
    settings = engine.Settings(frames=frames, method="gaussian", seed=seed)
    return SimpleNamespace(hologram=hologram(wavelengths), settings=settings, shape=(SIDE, SIDE))


def disk(row, column, z, side, radiance, down=0.0, right=0.0):
    values = [np.array([value]) for value in (row, column, z, down, right, side)]
    return Gaussians(*values, np.array([radiance]))


def joined(*parts):
    names = ("row", "column", "z", "down", "right", "side", "radiance")
    return Gaussians(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def quiet(done, message):
    pass


def gauss(row, column, sigma):
    y, x = np.indices((SIDE, SIDE))
    return np.exp(-((y - row) ** 2 + (x - column) ** 2) / (2 * sigma**2))


def test_opacity_is_a_gaussian_and_light_its_radiance_times_that():
    opacity, light = disk(60.0, 47.5, 1e-3, 8, [0.3, 2.0]).between(0, 1, (SIDE, SIDE))
    expected = gauss(60, 47.5, 8 * SIGMA)
    assert np.abs(opacity - expected).max() < 0.012  # of three standard deviations and more
    assert opacity[60, 50] == pytest.approx(expected[60, 50], rel=1e-6)
    np.testing.assert_allclose(light, np.multiply.outer([0.3, 2.0], opacity), rtol=1e-12)


def test_an_inclined_disk_is_parted_by_depth():
    inclined = disk(60.0, 64.0, 1e-3, 8, [1.0], down=2e-6, right=-5e-6)
    whole, _ = inclined.between(0, 1, (SIDE, SIDE))
    y, x = np.indices((SIDE, SIDE))
    behind = 2e-6 * (y - 60) - 5e-6 * (x - 64) < 4.5e-6
    far, _ = inclined.between(-1, 1.0045e-3, (SIDE, SIDE))
    near, _ = inclined.between(1.0045e-3, 1, (SIDE, SIDE))
    np.testing.assert_array_equal(far, np.where(behind, whole, 0))
    np.testing.assert_array_equal(near, np.where(behind, 0, whole))


def test_sizes_follow_radiance_and_depth():
    y, x = np.indices((67, 61))
    plane = 1e-3 + 30e-6 * y - 50e-6 * x
    even = np.full((2, *plane.shape), 0.7)
    smooth = Gaussians.of(even, plane, 1e-6)
    covered = (smooth.side**2).sum()
    assert (
        covered == plane.size and (smooth.side == 8).sum() == 8 * 7
    )  # inclined, but large wherever 8 x 8 fit
    np.testing.assert_allclose(smooth.z, 1e-3 + 30e-6 * smooth.row - 50e-6 * smooth.column, atol=1e-12)
    np.testing.assert_allclose([smooth.down.mean(), smooth.right.mean()], [30e-6, -50e-6], rtol=1e-6)

    step = np.where(x < 30, even, 0.1)
    edge = Gaussians.of(step, plane, 1e-6)
    for side in (2, 4, 8):
        crosses = (np.abs(edge.column - 29.5) < side / 2) & (edge.side == side)
        assert not crosses.any()
    assert (edge.side[(edge.column < 24) & (edge.row < 64)] == 8).all()
    assert set(np.round(edge.radiance[:, 0], 6)) == {0.1, 0.7}

    curved = 1e-3 + 2e-6 * (x - 30.0) ** 2
    assert (Gaussians.of(even, curved, 1e-6).side <= 2).all()
    outline = np.where(x < 31, plane, plane + 1e-3)
    found = Gaussians.of(even, outline, 1e-6)
    np.testing.assert_allclose(found.right, -50e-6, rtol=1e-6)  # no slope across the outline

    faint = 0.7 * (1 + 1.9 * CONTRAST * (x % 2))
    assert (Gaussians.of(np.stack([faint, faint]), plane, 1e-6).side[:50] == 8).any()


def test_side_by_side_they_are_as_bright_as_the_surface_and_opaque():
    z = np.full((SIDE, SIDE), 1e-3)
    for shades in (np.full((1, SIDE, SIDE), 0.4), 0.4 * gauss(64, 64, 12)[None] + 0.1):
        surface = Gaussians.of(shades, z, 1e-6)
        opacity, light = surface.between(0, 1, (SIDE, SIDE))
        assert opacity[2:-2, 2:-2].min() > 0.97
        assert np.abs(light / shades - 1)[0, 2:-2, 2:-2].max() < 0.12
        assert light.mean() == pytest.approx(shades.mean(), rel=0.02)


def by_hand(wave, z):
    """Free space from the angular spectrum, within the circle that pixels record."""
    f = np.fft.fftfreq(4 * SIDE, PITCH)
    square = f[:, None] ** 2 + f**2
    inside = square <= (0.5 / PITCH) ** 2
    transfer = np.where(inside, np.exp(2j * np.pi * z * np.sqrt(np.where(inside, GREEN**-2 - square, 0))), 0)
    return np.fft.ifft2(np.fft.fft2(wave, (4 * SIDE, 4 * SIDE)) * transfer)[..., :SIDE, :SIDE]


def test_a_wave_is_dimmed_where_it_passes_a_nearer_disk():
    far, black = disk(55.0, 60.0, 0.6e-3, 8, [0.9]), disk(56.0, 62.0, 2.1e-3, 8, [0.0])
    depths = np.array([0.5e-3, 2.2e-3])
    clear = disk(0.0, 0.0, 2.1e-3, 1, [0.0])  # far off
    before = by_hand(blended(job(2), joined(far, clear), depths, quiet)[:, 0], depths[1])
    dimmed, _ = black.between(0, 1, (SIDE, SIDE))
    expected, other = by_hand(np.sqrt(1 - dimmed) * before, -depths[1]), by_hand(before, -depths[1])
    wave = blended(job(2), joined(far, black), depths, quiet)[:, 0]
    # 0.05: what a sharp band spreads beyond the window, which is lost on the way there and back
    assert np.linalg.norm(wave - expected) < 0.06 * np.linalg.norm(expected)
    assert np.linalg.norm(wave - other) > 0.25 * np.linalg.norm(expected)


def test_a_disk_is_seen_in_its_plane():
    waves = blended(job(64), disk(60.0, 66.0, 2.1e-3, 8, [0.5]), np.array([2.2e-3]), quiet)
    image = (np.abs(propagate(waves[:, 0], PITCH, GREEN, 2.2e-3)) ** 2).mean(0)
    a = gauss(60, 66, 8 * SIGMA)
    assert image.sum() == pytest.approx(0.5 * a.sum(), rel=0.05)
    for ring in (a > 0.6, (a > 0.3) & (a < 0.6), (a > 0.1) & (a < 0.3)):
        assert image[ring].mean() == pytest.approx(0.5 * a[ring].mean(), rel=0.1)


def test_frames_average_to_blended_radiance():
    """a L + (1 - a) of what is behind, though the two interfere in each frame."""
    front = disk(64.0, 64.0, 2e-3, 8, [0.2])
    z = np.full((SIDE, SIDE), 1.9e-3)  # just behind
    back = Gaussians.of(np.full((1, SIDE, SIDE), 1.0), z, 1e-6)
    wave = blended(job(48), joined(back, front), np.array([1.9e-3, 2e-3]), quiet)
    image = np.mean(np.abs(propagate(wave[:, 0], PITCH, GREEN, 1.95e-3)) ** 2, axis=0)
    a = gauss(64, 64, 8 * SIGMA)
    expected = 0.2 * a + 1 - a
    for ring in (a > 0.7, (a > 0.3) & (a < 0.7), (a > 0.02) & (a < 0.3)):
        assert image[ring].mean() == pytest.approx(expected[ring].mean(), rel=0.12, abs=0.02)
    assert image[20:-20, 20:-20][a[20:-20, 20:-20] < 1e-3].mean() == pytest.approx(1, rel=0.03)


def test_large_ones_fill_the_pupil():
    z = np.full((SIDE, SIDE), 1e-3)
    surface = Gaussians.of(np.full((1, SIDE, SIDE), 1.0), z, 1e-6)
    assert (surface.side == 8).all()
    wave = blended(job(6), surface, np.array([1e-3]), quiet)
    power = np.mean(np.abs(np.fft.fft2(wave[:, 0])) ** 2, axis=0)
    f = np.hypot(*np.meshgrid(np.fft.fftfreq(SIDE), np.fft.fftfreq(SIDE)))
    rim, middle = power[(f > 0.35) & (f < 0.45)].mean(), power[f < 0.1].mean()
    assert rim == pytest.approx(middle, rel=0.15)


def test_frames_and_colors_are_independent_and_repeatable():
    surface = Gaussians.of(np.full((2, SIDE, SIDE), 1.0), np.full((SIDE, SIDE), 1e-3), 1e-6)
    two = (GREEN, 516.4e-9)
    wave = blended(job(6, two), surface, np.array([1e-3]), quiet)
    np.testing.assert_array_equal(wave, blended(job(6, two), surface, np.array([1e-3]), quiet))
    other = blended(job(6, two, seed=1), surface, np.array([1e-3]), quiet)
    waves = [w / np.linalg.norm(w) for w in (*wave.reshape(12, -1), other[0, 0].ravel())]
    products = np.abs([[np.vdot(a, b) for a in waves] for b in waves])
    assert (products[~np.eye(13, dtype=bool)] < 0.05).all()


def test_pictures_of_two_planes(build, camera):
    scene, shown = build.two_planes(build.emissive), hologram((640e-9, GREEN))
    field = engine.render(scene, camera, shown, engine.Settings(frames=8, spp=32, method="gaussian"))
    assert field.data.shape == (8, 2, SIDE, SIDE) and field.data.dtype == np.complex64
    focus = [0.5, 2.0]
    truth = engine.reference(scene, camera, shown, focus, spp=32, near=field.near)
    for picture, reference in zip(engine.reconstruct(field, focus), truth, strict=True):
        assert engine.psnr(picture, reference, 16) > 17.4  # over seeds 17.60, deviation 0.06
        inner = slice(16, -16)
        shares = picture[inner, inner].mean((0, 1)) / reference[inner, inner].mean((0, 1))
        np.testing.assert_allclose(shares, 1, atol=0.05)


def test_a_dark_surface_hides_what_is_behind(build, camera):
    scene = build.scene(
        far=build.plane(2.0, build.emissive(build.gray(1.0))),
        near=build.plane(0.5, build.diffuse(build.gray(0.0)), 0.04, 0.04),
    )
    field = engine.render(scene, camera, hologram(), engine.Settings(frames=4, spp=16, method="gaussian"))
    picture = engine.reconstruct(field, [0.5])[0, ..., 0]
    assert picture[52:76, 52:76].mean() < 0.02
    assert picture[16:-16, 10:20].mean() == pytest.approx(1, rel=0.1)


def test_cancel(build, camera):
    scene = build.scene(far=build.plane(1.0, build.emissive(build.gray(1.0))))
    reports = []

    def progress(done, message):
        reports.append((done, message))
        if message == "Gaussians":
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        settings = engine.Settings(frames=2, spp=1, method="gaussian")
        engine.render(scene, camera, hologram(), settings, progress=progress)
    assert reports[-1][1] == "Gaussians"
