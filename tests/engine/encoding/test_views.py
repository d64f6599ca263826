"""Views from within the eyebox: what their pictures are, and where they lie."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.encoding import views as views_module
from holopath_addon.engine.encoding.views import ViewedVolume, Views, ViewTargets
from holopath_addon.engine.waves.propagation import transfer_function
from holopath_addon.engine.waves.supervision import FramePool
from holopath_addon.engine.waves.target_images import TargetImages
from tests.engine.encoding.fields import GREEN, PITCH, band_limited, many, wave_field


def test_whole_views_are_pictures_where_colors_lie_apart(monkeypatch):
    """Their samples are the image's pixels, between those of the panel, as in `reconstruct`."""
    monkeypatch.setattr(views_module, "OPTIMIZATION_GUARD", 0)
    shape, optics = (47, 64), engine.Optics(color_scale=(1.03,), color_shift=((9e-6, -3e-6),))
    hologram = engine.Hologram(64, 47, (0.8 * PITCH, PITCH), (GREEN,), 1e-3, 3e-3, optics=optics)
    field = replace(wave_field(band_limited(shape, frames=2)), hologram=hologram)
    raster = hologram.raster(GREEN)
    places = hologram.picture.raster().lines_on(raster)
    volume = ViewedVolume(shape, raster.pitch, GREEN, 1e-3, 2e-3, places=places)
    targets = ViewTargets(Views(volume, frames=2, seed=3, eyebox=0))
    targets.add(field.data[:, 0])
    image = engine.reconstruct(field, [math.inf])[0, ..., 0]
    error = targets.intensities[targets.views.kinds[0][1][0]] - image
    assert np.sqrt((error**2).mean()) < 0.1 * image.mean()  # edges have other bins


def test_views_are_those_of_a_field(monkeypatch):
    """Whole ones as `reconstruct` shows them, parts as `TargetImages` at every second or fourth pixel."""
    monkeypatch.setattr(
        views_module, "OPTIMIZATION_GUARD", 0
    )  # the grid of a field that has not been through an SLM
    shape = 47, 63  # whose padded ones are alike
    field = wave_field(band_limited(shape, frames=3))
    views = Views(ViewedVolume(shape, PITCH, GREEN, 1e-3, 2e-3), frames=3, seed=3)
    targets = ViewTargets(views)
    with FramePool():
        for m in range(3):
            targets.add(field.data[m : m + 1, 0])
    image = engine.reconstruct(field, [math.inf])[0, ..., 0]
    np.testing.assert_allclose(targets.intensities[views.kinds[0][1][0]], image, atol=3e-3 * image.max())
    for (_, numbers), apart in zip(views.kinds[1:], (2, 4), strict=True):
        pictures = TargetImages(shape, PITCH, GREEN, [views.viewpoints[n] for n in numbers])
        pictures.add(field.data[:, 0])
        for number, expected in zip(numbers, pictures.targets, strict=True):
            error = targets.intensities[number] - expected[::apart, ::apart]
            assert np.sqrt((error**2).mean()) < 0.2 * expected.mean()  # their edges have other bins


@pytest.mark.parametrize(("frames", "each"), [(1, (4, 8)), (8, (4, 8)), (24, (12, 24)), (96, (12, 24))])
def test_parts_of_the_pupil_that_are_looked_through_lie_all_over_it(frames, each):
    """The two closest of n disks on a spiral are about as far apart as the area of the larger disk allows."""
    views = Views(ViewedVolume((32, 32), PITCH, GREEN, 1e-3, 4e-3), frames, seed=3)
    for (_, numbers), radius, count in zip(views.kinds[1:], (0.25, 0.125), each, strict=True):
        assert len(numbers) == count * len(views.kinds[0][1])
        parts = np.array([views.viewpoints[n].part for n in numbers])
        assert (parts[:, 2] == radius).all()
        middles, room = parts[:, :2], 0.5 - radius
        assert np.hypot(*middles.T).max() <= room
        apart = np.hypot(*(middles[:, None] - middles).T)[~np.eye(len(parts), dtype=bool)].min()
        assert apart > 0.8 * room * math.sqrt(math.pi / len(parts))


def test_light_that_passes_beside_the_slm_is_made_up_for():
    """Half of the cone of a pixel at an edge meets the SLM, a quarter in a corner, plus the part of half a pixel."""
    views = Views(ViewedVolume((128, 128), PITCH, GREEN, 1e-3, 4e-3), 8, seed=3)
    targets = ViewTargets(views)
    radius = math.tan(math.asin(GREEN / (2 * PITCH))) * 4e-3 / PITCH
    edge = 1 / 2 + 1 / (math.pi * radius)
    corner = 1 / 4 + 1 / (math.pi * radius) + 1 / (4 * math.pi * radius**2)
    for expected in targets.intensities:
        expected[:] = 1
    targets.unvignette()
    for _, numbers in views.kinds:
        farthest = targets.intensities[numbers[-1]]
        middle = len(farthest) // 2
        assert farthest[middle, middle] == pytest.approx(1, rel=1e-5)
        assert farthest[0, middle] == pytest.approx(1 / edge, rel=0.02)
        assert farthest[0, 0] == pytest.approx(1 / corner, rel=0.02)


def test_the_whole_pupil_alone():
    volume = ViewedVolume((32, 32), PITCH, GREEN, 1e-3, 4e-3)
    views = Views(volume, 3, 0, eyebox=0)
    assert len(views.kinds) == 1 and views.kinds[0][0].weight == 1 and len(views) == len(views.kinds[0][1])
    weights = [kind.weight for kind, _ in Views(volume, 3, 0, eyebox=0.5).kinds]
    assert weights == pytest.approx([0.95, 0.025, 0.025])


def test_refined_pictures_have_no_dark_border():
    """An even plane that shines: its pictures by a field of its size are dark where a part of the cone is lost."""
    side, distance = 48, 1e-3
    there = np.exp(2j * np.pi * np.random.default_rng(5).random((36, 64, 64)))
    there[:, side:], there[:, :, side:] = 0, 0
    data = np.fft.ifft2(np.fft.fft2(there) * transfer_function((64, 64), PITCH, GREEN, -distance))
    data = data[:, None, :side, :side]
    field = wave_field(data[:4], depth_far=distance)
    phase = engine.encode(field, "refine", extra_frames=many(data[4:]), max_steps=100)

    def edge(light):
        picture = engine.reconstruct(light, [math.inf])[0, ..., 0]
        rows = np.concatenate(
            [picture[:2, 8:-8], picture[-2:, 8:-8], picture[8:-8, :2].T, picture[8:-8, -2:].T]
        )
        return rows.mean() / picture[8:-8, 8:-8].mean()

    assert edge(wave_field(data, depth_far=distance)) < 0.75
    assert edge(phase.field()) == pytest.approx(1, abs=0.12)  # over seeds 0.91, deviation 0.005


def test_images_of_colors_far_apart_fit_their_grid():
    """One that reaches beyond the fields by more than the guard band came round, or ended in a traceback."""
    shape, optics = (24, 400), engine.Optics(color_scale=(0.75,))
    hologram = engine.Hologram(400, 24, PITCH, (GREEN,), 1e-3, 3e-3, optics=optics)
    raster = hologram.raster(GREEN)
    wide = engine.Hologram(560, 24, PITCH, (GREEN,), 1e-3, 3e-3)
    places = wide.raster().lines_on(raster)
    volume = ViewedVolume(shape, raster.pitch, GREEN, 1e-3, 2e-3, places=places)
    targets = ViewTargets(Views(volume, frames=1, seed=3, eyebox=0))
    targets.add(band_limited(shape, frames=1)[:, 0])
    assert np.isfinite(targets.intensities[targets.views.kinds[0][1][0]]).all()
