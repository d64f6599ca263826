"""Random numbers that do not depend on how many lanes are traced together."""

import numpy as np


def test_they_are_those_of_mitsuba(backend):
    import drjit as dr
    import mitsuba as mi

    from holopath_addon.engine.scene.random_numbers import Sampler

    theirs = mi.load_dict({"type": "independent"})
    theirs.seed(7, 1000)
    ours = Sampler.seeded(7 + (1 << 32), dr.arange(mi.UInt32, 1000))
    for _ in range(3):
        assert np.array_equal(ours.next_1d(), theirs.next_1d())
        assert np.array_equal(ours.next_2d(), theirs.next_2d())
    part = Sampler.seeded(mi.UInt32([7]), dr.arange(mi.UInt32, 10) + 990)
    theirs.seed(7, 1000)
    assert np.array_equal(part.next_1d(), np.array(theirs.next_1d())[990:])
