"""Overlap-add stereogram: the wave itself against the angular spectrum, brightness, occlusion, parallax, frames."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.scenes import FOV, GREEN
from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.waves.propagation import propagate

PITCH = 8e-6


def display(width=128, height=128, wavelengths=(GREEN,)):
    return engine.Hologram(width, height, PITCH, wavelengths, 1e-3, 6e-3, near=0.5)


def render(scene, camera, hologram, frames, **settings):
    chosen = {"method": "stereogram", "max_depth": 1, "spp": 1, **settings}
    return engine.render(scene, camera, hologram, engine.Settings(frames=frames, **chosen))


@pytest.mark.parametrize("height", [-1.8e-3, 0.0, 1.3e-3])
def test_the_wave_of_a_plane_is_that_of_its_pixels(build, camera, height):
    """sqrt(L) exp(i phi) on the pixels, by the exact transfer function; above, on and below the hogels' plane."""
    from holopath_addon.engine.baselines import BaselineInput
    from holopath_addon.engine.baselines.layers import random_phasor
    from holopath_addon.engine.baselines.stereogram import hogel_side, stereogram

    scene = build.scene(wall=build.plane(1.0, build.emissive(build.texture(64, 3, contrast=4))))
    hologram = display(144, 112)
    z = float(DepthMapping.of(hologram, camera, 0.5).depth_to_z(1.0))
    settings = engine.Settings(frames=2, max_depth=1, spp=4)
    job = BaselineInput(scene, camera, hologram, settings, 0.5, z - 2e-3, z + 2e-3)
    side = hogel_side(PITCH, GREEN, 2e-3)
    waves = stereogram(job, z - height, 0, side, lambda done: None)
    assert waves.shape == (2, 112, 144) and waves.dtype == np.complex64
    radiance = engine.Preview(scene, camera, 144, 112, max_depth=1).refine(16)[..., 1]
    for m, wave in enumerate(waves):
        sources = np.sqrt(4 / np.pi * radiance) * random_phasor(job, m, 0, 1.0)
        exact = propagate(sources, PITCH, GREEN, -height)[16:-16, 16:-16]
        ours = propagate(wave, PITCH, GREEN, 0.0)[16:-16, 16:-16]
        # but for a phase that a height's light has in common
        assert abs(np.vdot(exact, ours)) > 0.95 * np.linalg.norm(exact) * np.linalg.norm(ours)
        assert np.linalg.norm(ours) == pytest.approx(np.linalg.norm(exact), rel=0.05)


@pytest.mark.parametrize("depth", [0.5, pytest.param(0.8, marks=pytest.mark.slow), 2.0])
def test_a_plane_is_as_bright_as_it_should_be(build, camera, depth):
    """Objects at both ends of the volume, so that the plane lies at any height over the hogels'."""
    half = 0.5 * np.tan(FOV / 2)
    chips = {
        f"chip_{n}": build.plane(d, build.emissive(build.gray(0.3)), 0.1 * d * half, x=1.8 * d * half)
        for n, d in enumerate((0.5, 2.0))
    }
    scene = build.scene(wall=build.plane(depth, build.emissive(build.gray(0.3))), **chips)
    hologram = display(wavelengths=(640e-9, GREEN))
    field = render(scene, camera, hologram, 4)
    picture = engine.reconstruct(field, [depth])[0, 40:-40, 40:100]
    assert picture.mean((0, 1)) == pytest.approx([0.3, 0.3], rel=0.06)


def card_before_wall(build, radiance=0.02):
    """A dark card at 0.5 m that covers the middle, before a bright wall at 2 m."""
    half = 0.5 * np.tan(FOV / 2)
    return build.scene(
        wall=build.plane(2.0, build.emissive(build.texture(64, 1, contrast=4))),
        card=build.plane(0.5, build.emissive(build.gray(radiance)), 0.5 * half),
    )


def test_a_card_hides_what_is_behind_it(build, camera):
    field = render(card_before_wall(build), camera, display(), 4)
    near, far = engine.reconstruct(field, [0.5, 2.0])[..., 0]
    truth = engine.reference(card_before_wall(build), camera, display(), [0.5, 2.0], spp=64, near=0.5)[..., 0]
    ring = np.ones((128, 128), bool)
    ring[24:-24, 24:-24] = ring[:12] = ring[-12:] = ring[:, :12] = ring[:, -12:] = False
    assert near[40:-40, 40:-40].mean() == pytest.approx(0.02, rel=0.25)
    # points that only a part of the pupil sees lose some light at the shadow's edge, and some leaves the frame
    assert near[ring].mean() == pytest.approx(truth[0][ring].mean(), rel=0.12)
    assert far[ring].mean() == pytest.approx(truth[1][ring].mean(), rel=0.05)


def test_views_through_halves_of_the_pupil(build, camera):
    """Parallax: like the lens's pictures through the same half, unlike those through the other."""
    scene, hologram = card_before_wall(build), display()
    field = render(scene, camera, hologram, 12)
    radius = field.mapping.pupil_radius(hologram.max_slope(GREEN))
    for x, y in ((0.6, 0), (0, 0.6)):
        halves = [engine.Pupil(sign * x * radius, sign * y * radius, 0.8 * radius) for sign in (-1, 1)]
        images = [engine.reconstruct(field, [1.0], half)[0] for half in halves]
        truth = [engine.reference(scene, camera, hologram, [1.0], half, 32, 0.5)[0] for half in halves]
        for own, other in ((0, 1), (1, 0)):
            assert engine.psnr(images[own], truth[own], 16) > 1 + engine.psnr(images[own], truth[other], 16)


def test_frames_are_independent(build, camera):
    scene = build.scene(wall=build.plane(1.0, build.emissive(build.gray(0.5))))
    data = render(scene, camera, display(), 3).data[:, 0]
    gram = np.array([[abs(np.vdot(a, b)) for a in data] for b in data])
    gram /= np.sqrt(np.outer(gram.diagonal(), gram.diagonal()))
    assert (gram - np.eye(3)).max() < 0.03
    again = render(scene, camera, display(), 1).data[0, 0]
    np.testing.assert_array_equal(again, data[0])
    assert (
        abs(np.vdot(render(scene, camera, display(), 1, seed=1).data, again))
        < 0.03 * np.vdot(again, again).real
    )


def test_hogels_grow_with_depth_and_hold_a_points_light():
    from holopath_addon.engine.baselines.stereogram import MAX_SIDE, MIN_SIDE, hogel_side, point_energy

    sides = [hogel_side(PITCH, GREEN, reach) for reach in (0.0, 1e-3, 5e-3, 20e-3, 1.0)]
    assert sides == sorted(sides) and sides[0] == MIN_SIDE and sides[-1] == MAX_SIDE and len(set(sides)) == 3
    assert not any(side % 2 for side in sides)
    # all windows open, a point on the plane itself would be exp(2 pi i f x) summed over the frequencies in the band
    for spread in (0.0, 10.0, 40.0):
        side = hogel_side(1.0, 1.0, spread)
        count = np.pi / 4 * side**2
        assert 0.6 * count * side**2 < point_energy(side, spread) < 1.1 * count * side**2


def test_lit_surfaces(build, camera):
    """Radiance from paths of several vertices."""
    field = render(build.two_planes(build.diffuse), camera, display(), 2, max_depth=3, spp=8)
    truth = engine.reference(build.two_planes(build.diffuse), camera, display(), [2.0], None, 64, 0.5, 3)
    images = engine.reconstruct(field, [2.0])[0, 20:-20, 20:-20].mean()
    assert images == pytest.approx(truth[0, 20:-20, 20:-20].mean(), rel=0.05)


def test_cancelled(build, camera):
    calls = SimpleNamespace(count=0)

    def progress(done, message):
        assert 0 <= done <= 1
        calls.count += message == "Stereogram"
        if calls.count == 2:
            raise engine.Cancelled

    scene = build.scene(wall=build.plane(1.0, build.emissive(build.gray(0.5))))
    with pytest.raises(engine.Cancelled):
        settings = engine.Settings(method="stereogram", frames=1, max_depth=1)
        engine.render(scene, camera, display(), settings, progress=progress)
    assert calls.count == 2
