"""Texture atlases: what may hang in the library that makes them."""

import time
import weakref

import numpy as np
import pytest

from holopath_addon.engine.light import unwrapping

xatlas = pytest.importorskip("xatlas")


def test_an_atlas_goes_only_after_its_threads_have_come_to_rest(monkeypatch):
    """Else one of some ten thousand waits for a thread forever."""
    rested = []

    class Atlas(xatlas.Atlas):
        def generate(self, **options):
            super().generate(**options)
            done = time.monotonic()
            weakref.finalize(self, lambda: rested.append(time.monotonic() - done))

    monkeypatch.setattr(unwrapping.xatlas, "Atlas", Atlas)
    corners = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    for _ in range(12):
        places, size = unwrapping.charts(corners, np.array([[0, 1, 2], [0, 2, 3]]), texels_per_unit=8.0)
        assert places.shape == (2, 3, 2) and min(size) >= 8
    assert len(unwrapping._waiting) == unwrapping.MAX_WAITING
    assert len(rested) >= 12 - unwrapping.MAX_WAITING - 1 and min(rested) >= unwrapping.DELETION_DELAY
