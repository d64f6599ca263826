"""Refocusing: pupils, threads, parallax."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.pixels import EvenSteps
from holopath_addon.engine.viewing import reconstruction
from holopath_addon.engine.waves.propagation import circular_band


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
    monkeypatch.setattr(reconstruction, "MAX_CACHE_BYTES", 1)
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
        by_numpy, found = (
            engine.Refocuser(replace(field, data=data, hologram=hologram), max_apart=2)(
                focus, pupil, apart=apart
            )
            for data in (field.data, other_library.asarray(field.data))
        )
        assert isinstance(found, type(other_library.asarray(field.data)))
        np.testing.assert_allclose(np.asarray(found), by_numpy, atol=2e-6 * by_numpy.max())


def test_parts_of_the_pupil_in_other_libraries(other_library, field):
    pupils = [engine.Pupil(x, 0.0, 1e-3) for x in (-5e-4, 5e-4)]
    by_numpy, found = (
        engine.Refocuser(replace(field, data=data), max_apart=2).through(1.0, pupils, apart=2)
        for data in (field.data, other_library.asarray(field.data))
    )
    np.testing.assert_allclose(np.asarray(found), by_numpy, atol=2e-6 * by_numpy.max())


def test_means_over_squares(library):
    """Compared with counted points of a fine grid."""
    rng = np.random.default_rng(0)
    picture, fine = rng.random((2, 6, 9)), 100
    rows, columns = EvenSteps(0.25, 0.5, 10), EvenSteps(1.3, 1.4, 5)
    found = np.asarray(reconstruction.averaged(library.asarray(picture), (rows, columns)))
    points = np.repeat(np.repeat(picture, fine, 1), fine, 2)
    for j, i in np.ndindex(10, 5):
        (top, bottom), (left, right) = (
            [round((line.first + 0.5 + line.step * (n + end)) * fine) for end in (-0.5, 0.5)]
            for line, n in ((rows, j), (columns, i))
        )
        np.testing.assert_allclose(found[:, j, i], points[:, top:bottom, left:right].mean((1, 2)), rtol=1e-9)


def test_pupil_outside_the_light_is_refused(field):
    with pytest.raises(engine.InvalidInput, match="outside the light"):
        engine.reconstruct(field, [0.7], engine.Pupil(1.0, 0, 1e-3))
    with pytest.raises(engine.InvalidInput):
        engine.Pupil(0, 0, 0)


def test_several_pupils_at_once(field):
    """The same as one after another, in the far field, too."""
    refocus, radius = engine.Refocuser(field, max_apart=4), 2e-3
    pupils = [engine.Pupil(x, 0.3e-3, radius) for x in (-0.5e-3, 0.0, 0.5e-3)]
    for focus in (0.5, math.inf):
        found = refocus.through(focus, pupils)
        for pupil, image in zip(pupils, found, strict=True):
            np.testing.assert_array_equal(image, refocus([focus], pupil)[0])


def test_a_pupil_is_the_bins_whose_waves_meet_it():
    """Wherever it lies, of whatever size, on pixels that are square or not: the formula on all bins."""
    random, met = np.random.default_rng(5), 0
    for _ in range(200):
        shape, pitch = tuple(random.integers(1, 60, 2)), tuple(random.uniform(0.4e-6, 9e-6, 2))
        mapping = DepthMapping(random.uniform(1e-3, 0.1), random.uniform(1e-4, 0.1), 0.08, 0.0, 0.0)
        wavelength, reach = random.uniform(4e-7, 7e-7), mapping.beta / mapping.focal
        x, y = random.normal(size=2) * reach * random.choice([0.0, 0.1, 1.0])
        pupil = engine.Pupil(x, y, reach * random.choice([0.05, 0.5, 3.0]))
        fy, fx = (np.fft.fftfreq(n, d) for n, d in zip(shape, pitch[::-1], strict=True))
        right, up = np.meshgrid(wavelength * fx, -wavelength * fy)
        cosine = np.sqrt(np.maximum(1 - right**2 - up**2, 1e-12))
        expected = np.hypot(right / cosine * reach - x, up / cosine * reach - y) <= pupil.diameter / 2
        try:
            found = reconstruction.pupil_mask(shape, pitch, wavelength, mapping, pupil)
        except engine.InvalidInput:
            assert not (expected & circular_band(shape, pitch)).any()
            continue
        np.testing.assert_array_equal(found, expected)
        met += 1
    assert met > 100


@pytest.mark.parametrize(
    ("focus", "says"), [([], "at least one focus"), (0.5, "the focus as a list of numbers")]
)
def test_no_list_of_distances(field, focus, says):
    with pytest.raises(engine.InvalidInput, match=says):
        engine.reconstruct(field, focus)
