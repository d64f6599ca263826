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


def test_they_go_on_after_loops(backend):
    """As Mitsuba's do: who drops what a loop returns must not draw the same numbers again."""
    import drjit as dr
    import mitsuba as mi

    from holopath_addon.engine.scene.random_numbers import Sampler

    def drawn(sampler):
        def inner(number, total, sampler):
            return number + 1, total + sampler.next_1d(), sampler

        def outer(number, total, sampler):
            _, found, _ = dr.while_loop((mi.UInt32(0), mi.Float(0), sampler), lambda n, *_: n < 2, inner)
            return number + 1, total + found, sampler

        first = sampler.next_1d()
        _, total, _ = dr.while_loop((mi.UInt32(0), mi.Float(0), sampler), lambda n, *_: n < 3, outer)
        return np.array([first, total, sampler.next_1d()])

    theirs = mi.load_dict({"type": "independent"})
    theirs.seed(5, 100)
    assert np.array_equal(drawn(Sampler.seeded(5, dr.arange(mi.UInt32, 100))), drawn(theirs))
