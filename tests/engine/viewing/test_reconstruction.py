"""Refocusing: pupils, threads, parallax."""

import math
from dataclasses import replace

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


@pytest.mark.parametrize(
    ("view", "pupil"),
    [
        ({}, None),
        ({}, engine.Pupil(1e-3, 0.0, 2e-3)),
        ({"pitch": (8e-6, 9e-6)}, None),
        ({"optics": engine.Optics(lens=engine.Lens(0.1, 0.1)), "depth_far": -1e-3, "depth_near": 1e-3}, None),
        ({"optics": engine.Optics(carrier="auto")}, None),
    ],
    ids=["plain", "pupil", "oblong", "lens", "stop"],
)
def test_libraries_of_arrays_agree(other_library, field, view, pupil):
    """Near and far, every pixel and every second one, where the field's numbers are of other libraries."""
    focus, hologram = [0.5, 2.0, math.inf, 0.002], replace(field.hologram, **view)
    for apart in (1, 2):
        wanted, found = (
            engine.Refocuser(replace(field, data=data, hologram=hologram), max_apart=2)(
                focus, pupil, apart=apart
            )
            for data in (field.data, other_library.asarray(field.data))
        )
        assert isinstance(found, type(other_library.asarray(field.data)))
        np.testing.assert_allclose(np.asarray(found), wanted, atol=2e-6 * wanted.max())


def test_pupil_outside_the_light_is_refused(field):
    with pytest.raises(engine.InvalidInput, match="outside the light"):
        engine.reconstruct(field, [0.7], engine.Pupil(1.0, 0, 1e-3))
    with pytest.raises(engine.InvalidInput):
        engine.Pupil(0, 0, 0)
