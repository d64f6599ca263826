"""Slabs of depth: they close up around gaps, overlap, and share all."""

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.slabs import overlapping_slabs, split_depths


def test_slabs_close_up_around_gaps():
    depths = np.concatenate([np.linspace(0, 1, 50), np.linspace(5, 6, 50), np.linspace(9, 9.5, 50)])
    assert split_depths(depths, 3) == [(0, 1), (5, 6), (9, 9.5)]
    assert split_depths(depths, 1) == [(0, 9.5)]
    assert split_depths(np.full(10, 2.0), 4) == [(2, 2)]


def test_slabs_share_an_even_range():
    slabs = split_depths(np.linspace(0, 8, 10_000), 4)
    assert [high - low for low, high in slabs] == pytest.approx([2, 2, 2, 2], abs=0.15)


def test_weights_of_overlapping_slabs(backend):
    """Whatever the depth, the weights add up to 1, and no more than two are not zero."""
    import mitsuba as mi

    from holopath_addon.engine.scene.rays import Rays

    slabs = overlapping_slabs([(0.0, 1e-3), (1e-3, 1.4e-3), (2e-3, 5e-3)])
    z = np.linspace(-1e-3, 6e-3, 1001, dtype=np.float32)
    hologram, camera = engine.Hologram(8, 8, 8e-6, (516.5e-9,), 0.0, 5e-3), engine.Camera(np.eye(4), 0.3)
    mapping, weights = DepthMapping.of(hologram, camera, 0.5), []
    for slab in slabs:
        rays = Rays(hologram, camera, mapping, 2e-3, slab=slab)
        weight = np.asarray(rays.weight(mi.Float(z - 2e-3), mi.Float(0)))
        assert not weight[~slab.holds(z)].any()
        weights.append(weight)
    np.testing.assert_allclose(np.sum(weights, axis=0), 1, atol=1e-5)
    assert (np.array(weights) > 0).sum(0).max() == 2
    assert Rays(hologram, camera, mapping, 2e-3).weight(mi.Float(z), mi.Float(0)) is None
