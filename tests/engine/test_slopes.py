"""Slanted and curved surfaces of one radiance are as bright everywhere: each grain counts once, however it is met."""

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.tracing.kernel_table import Lattice

GREEN = 516.5e-9
PITCH, LIMIT = 8e-6, 5e-3
SIDE = 128
FOCUS = (0.45, 0.6, 0.8, 1.0, 1.4, 2.0)


@pytest.mark.parametrize("distance", [3.1e-3, 1.1e-3, -1.7e-3])
@pytest.mark.parametrize("slopes", [(0.0, 0.0), (3.0, 0.0), (-1.0, 1.6)])
def test_the_shares_of_a_plane_s_grains_are_one(backend, slopes, distance):
    """Closed form: lattice directions (s_x, s_y) meet the plane dz = distance / (1 - s_x g_x - s_y g_y).

    Counted as if all lay at one depth, shares add up to 1 with a spread of 6 to 20 %.
    """
    import drjit as dr
    import mitsuba as mi

    from holopath_addon.engine.tracing.estimators import LatticeEstimator

    hologram = engine.Hologram(SIDE, SIDE, PITCH, (GREEN,), 1e-3, 6e-3)
    lattice = Lattice.of(hologram.max_slope(GREEN), LIMIT, PITCH)
    across = int(lattice.offsets(PITCH).max()) + 1
    whole = np.ones((lattice.levels, across, across), np.complex64)
    estimator = LatticeEstimator(hologram, lattice, [whole])
    slope_x, slope_y, place = estimator.direction(dr.arange(mi.UInt32, lattice.rays), None)
    dz = distance / (1 - slope_x * slopes[0] - slope_y * slopes[1])
    offset = estimator.offset(place, dz)
    share = np.array(estimator.kernel(place, offset, dz, tuple(mi.Float(s) for s in slopes))[0])
    right, up = (np.array(pixels) for pixels in offset)
    total, rim = np.zeros((2, 2 * SIDE, 2 * SIDE))
    np.add.at(total, (SIDE + up, SIDE + right), share)
    i, j = lattice.indices.T
    np.add.at(rim, (SIDE + up, SIDE + right), np.hypot(i, j) > np.hypot(i, j).max() - 2)
    inner = total[(total > 0) & (rim == 0)]
    assert len(share) > 1000 and len(inner) > 30
    assert inner.mean() == pytest.approx(1, abs=1e-3)
    assert inner.std() < 0.02  # some meet a grain in one row, and not in the next
    assert np.quantile(abs(inner - 1), 0.95) < 1e-3


def uniform(build, camera, shape, focus, lens=False, frames=24, **settings):
    """The mean of the pictures at some distances of a shape of radiance 1, or the same by a thin lens."""
    hologram = engine.Hologram(SIDE, SIDE, PITCH, (GREEN,), 1e-3, 3.5e-3, near=0.4)
    scene = build.scene(shape={**shape, **build.emissive(build.gray(1.0))})
    if lens:
        return engine.reference(scene, camera, hologram, focus, spp=32, near=0.4, max_depth=1).mean((0, 3))
    field = engine.render(scene, camera, hologram, engine.Settings(frames=frames, max_depth=1, **settings))
    return np.mean(engine.reconstruct(field, focus), axis=(0, 3))


def off(picture, known):
    """Largest error of a column's mean and their standard deviation, where all that light passes is known to be 1."""
    light = np.where(known, picture, 0).sum(0)[known.sum(0) > 20] / known.sum(0)[known.sum(0) > 20]
    assert len(light) > 20
    return np.abs(light - 1).max(), light.std()


@pytest.mark.parametrize(
    ("turned", "radiance"),
    [
        pytest.param(0, "grain", marks=pytest.mark.slow),
        pytest.param(40, "grain", marks=pytest.mark.slow),
        (66, "grain"),
        (78, "grain"),
        pytest.param(66, "ray", marks=pytest.mark.slow),
    ],
)
def test_columns_of_a_turned_plane(build, camera, turned, radiance):
    """18 % off with the directions of a grain counted as if all lay at one depth (256 x 256)."""
    plane = build.plane(1.0, {}, 4.0, 4.0, slant=turned)
    picture = uniform(build, camera, plane, FOCUS, radiance=radiance)
    edge = 16  # where light has missed the aperture
    known = np.zeros(picture.shape, bool)
    known[edge:-edge, edge:-edge] = True
    worst, spread = off(picture, known)
    assert worst < 0.08 and spread < 0.02


@pytest.mark.parametrize(
    "shape",
    [
        pytest.param({"type": "sphere", "center": [0, 0, -1.0], "radius": 0.12}, marks=pytest.mark.slow),
        {"type": "cylinder", "p0": [0.08, -0.3, -2.0], "p1": [-0.08, 0.3, -0.5], "radius": 0.08},
    ],
    ids=["sphere", "leaning cylinder"],
)
def test_curved_surfaces(build, camera, shape):
    """Away from their outlines."""
    from scipy.ndimage import minimum_filter

    picture, lens = (uniform(build, camera, shape, (0.8, 0.9, 1.0), lens) for lens in (False, True))
    known = minimum_filter(lens, 17) > 0.999
    known[:16] = known[-16:] = False
    for turned in (lambda values: values, np.transpose):
        worst, spread = off(turned(picture), turned(known))
        assert worst < 0.05 and spread < 0.02
