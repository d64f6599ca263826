"""Ray differentials over mirrors and lenses."""

import numpy as np
import pytest

GLASS = {"bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}}


def test_wavefronts_of_curved_surfaces_against_traced_neighbors(build):
    """Analytic ray differentials give the crossing that neighboring rays really have, off the axis too."""
    import drjit as dr

    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = build.mi
    ball = {"type": "sphere", "center": [0, 0, -0.8], "radius": 0.1, **GLASS}
    scene = build.scene(ball=ball, far=build.plane(2.0, build.emissive(build.gray(1.0)), 5.0))
    chains = SpecularChains(scene, "curvature", 8)
    direction = dr.normalize(mi.Vector3f([0.05], [0.02], [-1.0]))

    # the ray itself, and its neighbors a step aside and turned by a step, to either side along either axis
    axes = [np.array([a.x[0], a.y[0], a.z[0]], np.float64) for a in mi.coordinate_system(direction)]
    direction, step = np.ravel(direction), 2e-4
    origins, directions = [np.zeros(3)], [direction]
    for axis in axes:
        for turned_ in (False, True):
            for sign in (-1, 1):
                origins.append(np.zeros(3) if turned_ else sign * step * axis)
                directions.append(direction + sign * step * axis if turned_ else direction)
    rays = mi.Ray3f(mi.Point3f(np.float32(origins).T), dr.normalize(mi.Vector3f(np.float32(directions).T)))
    view = chains.view(scene, rays, mi.UInt32(3))
    points = np.array(view.surface.compute_surface_interaction(view.ray).p, np.float64).T
    leaving = np.array(view.ray.d, np.float64).T
    middle, across = points[0], leaving[0]
    # onto the plane across the last piece
    points += leaving * (((middle - points) @ across) / (leaving @ across))[:, None]
    columns = (points[2::2] - points[1::2]) / (2 * step)
    u = np.cross(across, [0, 1, 0])
    u /= np.linalg.norm(u)
    frame = np.stack([u, np.cross(across, u)])
    a = np.stack([frame @ columns[0], frame @ columns[2]], 1)
    b = np.stack([frame @ columns[1], frame @ columns[3]], 1)
    assert float(view.distance[0]) == pytest.approx(2 / np.trace(np.linalg.solve(b, a)), rel=0.02)
