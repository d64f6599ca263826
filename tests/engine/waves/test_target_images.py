"""Target images of supervised descents."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.waves.target_images import TargetImages, Viewpoint
from tests.engine.encoding.fields import GREEN, PITCH, band_limited, wave_field


def test_pictures_count_frames_as_they_come():
    """One by one or together, and as `reconstruct` shows them."""
    field = wave_field(band_limited((40, 56), frames=3))
    viewpoints = [Viewpoint(1e-3), Viewpoint(2e-3, (0.1, 0.05, 0.2))]
    together, single = (TargetImages((40, 56), PITCH, GREEN, viewpoints) for _ in range(2))
    together.add(field.data[:, 0])
    for m in range(3):
        single.add(field.data[m : m + 1, 0])
    np.testing.assert_allclose(single.targets, together.targets, rtol=1e-4, atol=1e-5)
    assert single.energy == pytest.approx(together.energy, rel=1e-5)
    image = engine.reconstruct(field, [math.inf])[0, ..., 0]
    np.testing.assert_allclose(together.targets[0], image, atol=2e-3 * image.max())
    radius = field.mapping.pupil_radius(field.hologram.max_slope(GREEN))
    pupil = engine.Pupil(0.2 * radius, -0.1 * radius, 0.8 * radius)
    image = engine.reconstruct(field, [field.near], pupil)[0, ..., 0]
    np.testing.assert_allclose(together.targets[1], image, atol=0.02 * image.max())
