"""Point cloud: the waves of single points, brightness, visibility, frames, planes, canceling."""

import numpy as np
import pytest

from benchmarks.scenes import GREEN
from holopath_addon import engine

PITCH, SIDE = 8e-6, 128
RGB = (640e-9, GREEN, 455.4e-9)


@pytest.fixture
def show(backend, monkeypatch):
    """The field of points given by radiance, shape (wavelength, y, x), and z, shape (y, x); and its job."""
    from holopath_addon.engine.baselines import BaselineInput, point_cloud

    def show(radiance, z, frames, progress=lambda done, message: None, wavelengths=RGB, **constants):
        for name, value in constants.items():
            monkeypatch.setattr(point_cloud, name, value)
        monkeypatch.setattr(point_cloud, "picture_with_depth", lambda job, on_progress: (radiance, z))
        hologram = engine.Hologram(SIDE, SIDE, PITCH, wavelengths, 1e-3, 6e-3)
        settings = engine.Settings(frames=frames, method="point", seed=5)
        job = BaselineInput(None, None, hologram, settings, 1.0, z.min(), z.max())
        return point_cloud.field(job, progress), job

    return show


def wave_at_slm(row, column, z, wavelength, n=384):
    """The wave of a unit point on the grid: its plane waves within the recordable circle, by hand."""
    f = np.fft.fftfreq(n, PITCH)
    squared = f[:, None] ** 2 + f**2
    kz = 2 * np.pi * np.sqrt(wavelength**-2 - squared)
    spectrum = np.where(squared <= (0.5 / PITCH) ** 2, np.exp(-1j * z * (kz - 2 * np.pi / wavelength)), 0)
    return np.roll(np.fft.ifft2(spectrum), (row, column), (0, 1))[:SIDE, :SIDE]


def scattered(count, low, high, seed=0):
    """Points in the middle, far enough from the edges for all of their light."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(low, high, (SIDE, SIDE))
    radiance = np.zeros((3, SIDE, SIDE), np.float32)
    for row, column in rng.integers(40, SIDE - 40, (count, 2)):
        radiance[:, row, column] = rng.uniform(0.2, 1, 3)
    return radiance, z


@pytest.mark.parametrize("plane_points", [10, 1e6])
@pytest.mark.parametrize("low", [1e-3, -2e-3])
def test_the_field_is_the_sum_of_the_points_waves(show, plane_points, low):
    from holopath_addon.engine.baselines.layers import gain_for, random_phasor
    from holopath_addon.engine.baselines.point_cloud import slabs_of

    radiance, z = scattered(12, low, low + 5e-3)
    field, job = show(radiance, z, 3, PLANE_POINTS=plane_points)
    planes = len(slabs_of(job.hologram, z))
    assert planes == 1 if plane_points > 1e5 else planes > 3
    exact = np.zeros(field.shape, complex)
    for row, column in np.argwhere(radiance[0]):
        for k, wavelength in enumerate(RGB):
            wave = wave_at_slm(row, column, z[row, column], wavelength)
            for m in range(3):
                phasor = random_phasor(job, m, 0)[row, column]
                exact[m, k] += gain_for(3) * np.sqrt(radiance[k, row, column]) * phasor * wave
    for k in range(3):  # the table's waves are cut at the rim
        assert np.linalg.norm(field[:, k] - exact[:, k]) < 0.11 * np.linalg.norm(exact[:, k])
        assert np.linalg.norm(field[:, k]) == pytest.approx(np.linalg.norm(exact[:, k]), rel=0.01)


def test_a_wider_table_is_nearer_to_the_exact_waves(show):
    """The cut at the rim is all that is missing."""
    radiance, z = scattered(1, 1e-3, 6e-3)
    ((row, column),) = np.argwhere(radiance[0])
    z[row, column], z[0, 0], z[0, 1] = 5.5e-3, 1e-3, 6e-3  # far from the one plane, in the middle
    errors = []
    for tail in (-2.0, 2.0, 20.0):
        field, _ = show(radiance, z, 1, TAIL=tail, PLANE_POINTS=1e6)
        wave = wave_at_slm(row, column, z[row, column], GREEN)
        overlap = abs(np.vdot(wave, field[0, 1])) / np.linalg.norm(wave) / np.linalg.norm(field[0, 1])
        errors.append(1 - overlap)
    assert errors[0] > 2 * errors[1] > 4 * errors[2]


def test_as_many_planes_as_the_depths_need(backend):
    from holopath_addon.engine.baselines.point_cloud import slabs_of

    hologram = engine.Hologram(SIDE, SIDE, PITCH, RGB, 1e-3, 6e-3)
    ramp = np.linspace(0, 1, SIDE * SIDE).reshape(SIDE, SIDE)
    counts = [len(slabs_of(hologram, 1e-3 + depth * ramp)) for depth in (0, 0.2e-3, 5e-3, 50e-3)]
    assert counts[:2] == [1, 1] and 1 < counts[2] < counts[3]
    apart = slabs_of(hologram, np.where(ramp < 0.5, 1e-3, 6e-3))
    np.testing.assert_allclose(apart, [(1e-3, 1e-3), (6e-3, 6e-3)])


def test_a_slanted_picture_is_as_bright_and_nearly_as_sharp_as_the_truth(build, camera):
    scene = build.scene(
        plane=build.plane(1.0, build.emissive(build.texture(128, 3, 0.1)), 0.8, 0.4, slant=50)
    )
    hologram = engine.Hologram(SIDE, SIDE, PITCH, RGB[:2], 1e-3, 4e-3)
    field = engine.render(scene, camera, hologram, engine.Settings(method="point", frames=8, spp=16))
    truth = engine.reference(scene, camera, hologram, [1.0], spp=64, near=field.near)[0]
    picture = engine.reconstruct(field, [1.0])[0]
    inner = slice(24, -24)
    ratio = picture[inner, inner].mean((0, 1)) / truth[inner, inner].mean((0, 1))
    np.testing.assert_allclose(ratio, 1, atol=0.04)
    assert engine.psnr(picture, truth, 24) > 17


def test_what_is_hidden_from_the_pupils_center_is_not_shown(build, camera):
    """A bright wall behind a black one that covers the left half, seen through the middle of the pupil."""
    near = build.plane(0.5, build.emissive(build.gray(0.0)), 0.1, 0.15, x=-0.1)
    scene = build.scene(wall=build.plane(2.0, build.emissive(build.gray(1.0))), near=near)
    hologram = engine.Hologram(SIDE, SIDE, PITCH, (GREEN,), 1e-3, 4e-3)
    field = engine.render(scene, camera, hologram, engine.Settings(method="point", frames=8, spp=4))
    diameter = field.mapping.pupil_radius(hologram.max_slope(GREEN))
    picture = engine.reconstruct(field, [2.0], engine.Pupil(0, 0, diameter))[0, ..., 0]
    left, right = picture[24:-24, 24:52].mean(), picture[24:-24, 76:-24].mean()
    assert left < 0.01 * right


def test_frames_are_independent_however_they_are_grouped(show):
    rng = np.random.default_rng(1)
    radiance = rng.random((1, SIDE, SIDE), dtype=np.float32)
    z = rng.uniform(1e-3, 2e-3, (SIDE, SIDE))
    whole, _ = show(radiance, z, 6, wavelengths=(GREEN,))
    split, _ = show(radiance, z, 6, wavelengths=(GREEN,), FRAMES_TOGETHER=2, CHUNK_POINTS=1 << 18)
    assert np.linalg.norm(whole - split) < 1e-5 * np.linalg.norm(whole)
    frames = whole.reshape(6, -1)
    products = np.abs(frames @ frames.conj().T) / np.linalg.norm(frames[0]) ** 2
    np.testing.assert_allclose(np.diag(products), 1, atol=0.1)
    assert (products - np.diag(np.diag(products))).max() < 6 / SIDE


def test_progress_rises_to_one_and_may_cancel(show):
    fractions = []
    black = np.zeros((3, SIDE, SIDE), np.float32)
    radiance, z = scattered(20, 1e-3, 6e-3)
    show(radiance, z, 2, lambda done, message: fractions.append(done))
    assert len(fractions) > 8 and fractions == sorted(fractions) and fractions[-1] == pytest.approx(1)

    def cancel(done, message):
        raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        show(radiance, z, 2, cancel)
    dark, _ = show(black, z, 1)
    assert not dark.any()
