"""Refocusing: pupils, threads, parallax."""

import math

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.viewing import reconstruction


def test_refocusing_in_two_threads(field):
    """Distances that need grids of other sizes, at once: as in one thread."""
    from concurrent.futures import ThreadPoolExecutor

    refocuser, focus = engine.Refocuser(field), [0.05, 0.5, 3.0, math.inf] * 6
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda depth: refocuser([depth])[0], focus))
    for depth, image in zip(focus, found, strict=True):
        expected = engine.reconstruct(field, [depth])[0]
        np.testing.assert_allclose(image, expected, rtol=1e-5, atol=1e-6 * expected.max())


def test_however_many_distances_fit_into_memory_at_once(field, monkeypatch):
    focus = [0.05, 0.5, 3.0, math.inf]
    parts = None, engine.Pupil(0.0, 0.0, 2e-3)
    together = [engine.reconstruct(field, focus, part) for part in parts]
    monkeypatch.setattr(reconstruction, "MOST_BYTES", 1)
    for part, expected in zip(parts, together, strict=True):
        np.testing.assert_array_equal(engine.reconstruct(field, focus, part), expected)


def test_pupil_outside_the_light_is_refused(field):
    with pytest.raises(engine.InvalidInput, match="outside the light"):
        engine.reconstruct(field, [0.7], engine.Pupil(1.0, 0, 1e-3))
    with pytest.raises(engine.InvalidInput):
        engine.Pupil(0, 0, 0)
