"""Polygons: the field of tilted facets, their brightness, what they block and what they hide."""

import math

import numpy as np
import pytest

from benchmarks.scenes import GREEN
from holopath_addon import engine
from holopath_addon.engine.baselines import BaselineInput, polygons
from holopath_addon.engine.baselines.layers import gain_for, random_phasor

PITCH, FAR, NEAR = 8e-6, 1e-3, 6e-3
RED = 640e-9


def job_of(side, frames=1, wavelength=GREEN, seed=0):
    """Input for the field of given facets."""
    hologram = engine.Hologram(side, side, PITCH, (wavelength,), FAR, NEAR)
    settings = engine.Settings(method="polygon", frames=frames, seed=seed)
    return BaselineInput(None, None, hologram, settings, 0.5, FAR, NEAR)


def field_of(monkeypatch, job, *sheets):
    """The field of facets given as (radiance, z)."""
    sheets = [polygons.Sheet(np.where(np.isnan(z), 0, radiance)[None], z) for radiance, z in sheets]
    monkeypatch.setattr(polygons, "sheets_of", lambda job, progress: sheets)
    return polygons.field(job, lambda done, what: None)


def pictures(field, depths, wavelength=GREEN):
    """Mean intensities over the frames, by plain FFTs on a grid without wrap-around, shape (z, y, x)."""
    side, n = field.shape[-1], field.shape[-1] + 64
    f = np.fft.fftfreq(n, PITCH)
    square = f[:, None] ** 2 + f**2
    waves = np.fft.fft2(field[:, 0], (n, n)) * (square <= (0.5 / PITCH) ** 2)
    kz = 2 * np.pi * np.sqrt(1 / wavelength**2 - square)
    images = [np.fft.ifft2(waves * np.exp(1j * kz * z))[:, :side, :side] for z in depths]
    return np.stack([(abs(image) ** 2).mean(0) for image in images])


@pytest.mark.parametrize("wavelength", [GREEN, RED])
@pytest.mark.parametrize("slope", [(0.5, 0.25), (4.0, 2.0)])
def test_spectrum_of_a_tilted_triangle_is_that_of_its_plane_at_turned_frequencies(
    monkeypatch, wavelength, slope
):
    """Matsushima's change of frequencies, summed term by term: f + slope (kz - k) / (2 pi) in place of f."""
    side, n = 48, 144
    row, column = np.mgrid[:side, :side]
    triangle = (column > 14) & (row > 16) & (row + column < 52)
    x, y = (column - side / 2) * PITCH, (side / 2 - row) * PITCH
    z = np.where(triangle, 3e-3 + slope[0] * x + slope[1] * y, np.nan)
    job = job_of(side, wavelength=wavelength)
    field = field_of(monkeypatch, job, (np.ones((side, side), np.float32), z))[0, 0]
    f = np.fft.fftfreq(n, PITCH)
    fx, fy = f[None, :], -f[:, None]
    carrier_free = np.sqrt(1 / wavelength**2 - fx**2 - fy**2) - 1 / wavelength
    turned_x, turned_y = fx + slope[0] * carrier_free, fy + slope[1] * carrier_free
    phasor = random_phasor(job, 0, 0) * gain_for(1)
    expected = np.zeros((n, n), complex)
    for r, c in np.argwhere(triangle):
        expected += phasor[r, c] * np.exp(-2j * np.pi * (turned_x * x[r, c] + turned_y * y[r, c]))
    expected *= np.exp(-2j * np.pi * carrier_free * 3e-3) * (fx**2 + fy**2 <= (0.5 / PITCH) ** 2)
    expected *= np.exp(
        2j * np.pi * (fx * x[0, 0] + fy * y[0, 0])
    )  # the first pixel is the transform's origin
    expected = np.fft.ifft2(expected)[:side, :side]
    overlap = np.vdot(expected, field)
    field = field * abs(overlap) / overlap  # whole phase, which no picture shows
    assert np.linalg.norm(field - expected) < 0.04 * np.linalg.norm(expected)


def test_a_slanted_plane_is_as_bright_as_its_radiance_and_without_steps(monkeypatch):
    """Across 18 slabs, in columns that are narrower than one."""
    side, job = 128, job_of(128, frames=8)
    z = np.broadcast_to(np.linspace(FAR, NEAR, side), (side, side))
    field = field_of(monkeypatch, job, (np.full((side, side), 0.7, np.float32), z))
    inner = slice(28, -28)
    number = np.arange(side)[inner]
    picture = pictures(field, np.linspace(FAR, NEAR, side)[inner])
    columns = np.array([picture[i, inner, c].mean() for i, c in enumerate(number)])  # each where it is sharp
    assert columns.mean() == pytest.approx(0.7, rel=0.03)
    count, _ = polygons.slabs_of(job)
    within = np.arange(side) * count / side % 1
    ends = columns[(within[inner] < 0.1) | (within[inner] > 0.9)].mean()
    assert ends / columns.mean() == pytest.approx(1, abs=0.04)


def test_every_part_of_a_slanted_plane_is_sharp_at_its_own_depth(monkeypatch):
    """Lines three pixels wide, as contrasted as on a plane that faces the viewer."""
    side, job = 128, job_of(128, frames=16)
    lines = np.broadcast_to((np.arange(side) // 3 % 2 == 0)[:, None], (side, side)).astype(np.float32)

    def contrast(z):
        field = field_of(monkeypatch, job, (lines, np.broadcast_to(z, (side, side))))
        numbers = np.arange(30, side - 30, 6)
        picture = pictures(field, np.broadcast_to(z, side)[numbers])
        parts = np.concatenate([picture[i, 30:-30, c : c + 6] for i, c in enumerate(numbers)], 1)
        bright = lines[30:-30, 0] > 0
        return (parts[bright].mean() - parts[~bright].mean()) / parts.mean()

    facing, slanted = contrast(3.5e-3), contrast(np.linspace(FAR, NEAR, side))
    assert facing > 1.2
    assert slanted == pytest.approx(facing, rel=0.05)
    blurred = pictures(field_of(monkeypatch, job, (lines, np.full((side, side), FAR))), [NEAR])[
        0, 30:-30, 30:-30
    ]
    bright = lines[30:-30, 0] > 0
    assert (blurred[bright].mean() - blurred[~bright].mean()) / blurred.mean() < 0.5 * facing


def test_a_near_facet_blocks_a_far_one(monkeypatch):
    """Nothing shines through from behind a dark patch, and past its edges only at the far surface's focus."""
    side, job = 128, job_of(128, frames=8)
    ones, patch = np.ones((side, side), np.float32), np.zeros((side, side), bool)
    patch[44:84, 44:84] = True
    far = np.full((side, side), FAR)
    near = np.where(patch, NEAR, np.nan)
    at_far, at_near = pictures(field_of(monkeypatch, job, (ones, far), (0 * ones, near)), [FAR, NEAR])
    assert at_near[50:78, 50:78].mean() < 0.01
    assert at_near[24:40, 44:84].mean() == pytest.approx(1, abs=0.05)
    # 5 mm x 0.032 is 20 pixels: half the pupil sees past an edge, hardly any of it reaches the middle
    assert at_far[62:66, 62:66].mean() < 0.05
    assert at_far[50:78, 43:45].mean() == pytest.approx(0.5, abs=0.1)


def test_frames_and_colors_have_phases_of_their_own(monkeypatch):
    side = 96
    plane = np.ones((side, side), np.float32), np.full((side, side), 2e-3)
    field = field_of(monkeypatch, job_of(side, frames=6), plane)[:, 0].reshape(6, -1)
    correlation = abs(field @ field.conj().T) / np.linalg.norm(field[0]) ** 2
    np.testing.assert_allclose(np.diag(correlation), 1, atol=0.05)
    assert correlation[~np.eye(6, dtype=bool)].max() < 0.05
    again = field_of(monkeypatch, job_of(side, frames=6), plane)[:, 0].reshape(6, -1)
    np.testing.assert_array_equal(again, field)
    other = field_of(monkeypatch, job_of(side, frames=6, seed=1), plane)[:, 0].reshape(6, -1)
    assert abs(np.vdot(other[0], field[0])) < 0.05 * np.linalg.norm(field[0]) ** 2


def test_hidden_facets_keep_their_place_and_radiance(build, camera):
    """The wall that a ball hides lies behind it, not the ball's own back, and it is as bright as beside it."""
    scene = build.scene(
        wall=build.plane(2.0, build.emissive(build.gray(0.6))),
        ball={"type": "sphere", "center": [0, 0, -0.6], "radius": 0.05, **build.emissive(build.gray(0.2))},
    )
    hologram = engine.Hologram(96, 96, PITCH, (GREEN,), FAR, NEAR)
    plan = engine.plan(scene, camera, hologram, engine.Settings())
    settings = engine.Settings(method="polygon", frames=1, spp=8)
    job = BaselineInput(scene, camera, hologram, settings, plan.near, plan.z_low, plan.z_high)
    front, behind = polygons.sheets_of(job, lambda done, what: None)
    hidden = ~np.isnan(behind.z)
    wall = float(job.mapping.depth_to_z(2.0))
    np.testing.assert_allclose(behind.z[hidden], wall, atol=1e-6)
    np.testing.assert_allclose(behind.radiance[0][hidden], 0.6, rtol=1e-4)
    assert (front.z[hidden] > wall + 1e-3).all()  # all behind the ball, none beside it
    edge = np.abs(np.hypot(*(np.mgrid[:96, :96] - 47.5)) - _radius(hologram, camera, 0.05, 0.6)) < 3
    assert hidden[edge & (front.z > wall + 1e-3)].all()


def _radius(hologram, camera, radius, distance):
    """Radius of a ball's outline, pixels."""
    tangent = radius / math.sqrt(distance**2 - radius**2)
    return tangent / math.tan(camera.fov_x / 2) * hologram.width / 2


def test_two_planes_through_the_engine(build, camera):
    hologram = engine.Hologram(128, 128, PITCH, (GREEN,), 1e-3, 4e-3)
    scene, focus = build.two_planes(build.emissive), [0.5, 2.0]
    field = engine.render(scene, camera, hologram, engine.Settings(method="polygon", frames=24, spp=32))
    truth = engine.reference(scene, camera, hologram, focus, spp=64, near=field.near)
    inner = slice(20, -20)
    for picture, reference in zip(engine.reconstruct(field, focus), truth, strict=True):
        assert engine.psnr(picture, reference, 20) > 18.5
        assert picture[inner, inner].mean() / reference[inner, inner].mean() == pytest.approx(1, abs=0.04)


def test_cancel(monkeypatch):
    side = 64
    sheet = polygons.Sheet(np.ones((1, side, side), np.float32), np.full((side, side), 2e-3))
    monkeypatch.setattr(polygons, "sheets_of", lambda job, progress: [sheet])

    def stop(done, what):
        assert 0 <= done <= 1
        if done > 0.5:
            raise engine.Cancelled

    with pytest.raises(engine.Cancelled):
        polygons.field(job_of(side, frames=4), stop)
