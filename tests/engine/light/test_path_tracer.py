"""Radiance at the end of a chain: against Mitsuba's path tracer, with rare bright paths, by several paths a ray."""

import math

import numpy as np
import pytest

from holopath_addon import engine

GREEN = 516.5e-9


def test_path_tracer_agrees_with_mitsuba(build):
    """The same mean as Mitsuba's `path`, in every channel, where nearly all light is indirect."""
    import drjit as dr

    from holopath_addon.engine.light.path_tracer import PathTracer
    from holopath_addon.engine.scene.specular_chains import FirstHits

    mi, scene, rays = build.mi, build.closed_box(), 1 << 17
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, rays)
    u = 2 * sampler.next_2d() - 1
    ray = mi.Ray3f(mi.Point3f(0), dr.normalize(mi.Vector3f(0.18 * u.x, 0.18 * u.y, -1)))
    for depth in (2, 8):
        path = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": 8})
        theirs, _, _ = path.sample(scene, sampler, mi.RayDifferential3f(ray), None, True)
        point = FirstHits(coherent=False).view(scene, ray, mi.UInt32(0))
        ours = PathTracer(depth).radiance(scene, sampler, point)
        theirs, ours = (np.stack([np.asarray(c) for c in light]) for light in (theirs, ours))
        error = np.sqrt((theirs.var(1) + ours.var(1)) / rays)
        assert (abs(theirs.mean(1) - ours.mean(1)) <= 4 * error).all(), depth


def test_light_by_vertices_is_that_of_shorter_paths(build):
    """One look tells what paths of any length find: path by path, by the same random numbers."""
    import drjit as dr

    from holopath_addon.engine.light.path_tracer import PathTracer
    from holopath_addon.engine.scene.specular_chains import FirstHits

    mi, scene, rays, ends = build.mi, build.closed_box(), 1 << 10, (1, 2, 4)

    def light(tracer, *ends):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, rays)
        u = 2 * sampler.next_2d() - 1
        ray = mi.Ray3f(mi.Point3f(0), dr.normalize(mi.Vector3f(0.5 * u.x, 0.5 * u.y, -1)))
        point = FirstHits(coherent=False).view(scene, ray, mi.UInt32(0))
        return np.array(tracer.by_vertices(scene, sampler, point, ends or (1,)))

    bands = light(PathTracer(6), *ends)
    assert (bands[1:].max((1, 2)) > 0).all()
    for number, depth in enumerate((*ends, 6)):
        shorter = light(PathTracer(depth)).sum(0)
        np.testing.assert_allclose(bands[: number + 1].sum(0), shorter, rtol=1e-4, atol=1e-6)


def test_of_many_lamps_the_one_that_matters_is_drawn(build, monkeypatch):
    """Twelve lamps, one of them bright, and a shining card: the mean of Mitsuba's `path`, a quarter of the variance."""
    import drjit as dr

    from holopath_addon.engine.light import path_tracer
    from holopath_addon.engine.scene.specular_chains import FirstHits

    mi, rays, rng = build.mi, 1 << 16, np.random.default_rng(0)
    parts = {"wall": build.plane(1.2, build.diffuse({"type": "rgb", "value": [0.7, 0.5, 0.2]}), 2.0)}
    parts["card"] = build.plane(0.9, build.emissive(build.gray(0.5)), 0.02, x=0.3)
    for number in range(12):
        x, y = rng.uniform(-0.5, 0.5, 2)
        place = build.T().translate([float(x), float(y), -0.6])
        light = {"intensity": [0.2 if number == 0 else 0.01] * 3, "radius": 0.05}
        parts[f"lamp{number}"] = {"type": "point_lamp", "to_world": place, **light}
    scene = build.scene(**parts)
    assert len(scene.emitters()) == 13

    def light_of(trace, seed):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, rays)
        u = 2 * sampler.next_2d() - 1
        ray = mi.Ray3f(mi.Point3f(0), dr.normalize(mi.Vector3f(0.2 * u.x, 0.2 * u.y, -1)))
        return np.stack([np.asarray(c) for c in trace(sampler, ray)])

    def ours(sampler, ray):
        point = FirstHits(coherent=False).view(scene, ray, mi.UInt32(0))
        return path_tracer.PathTracer(3).radiance(scene, sampler, point)

    path = mi.load_dict({"type": "path", "max_depth": 3, "rr_depth": 8})
    theirs = light_of(lambda s, ray: path.sample(scene, s, mi.RayDifferential3f(ray), None, True)[0], 1)
    resampled = light_of(ours, 2)
    monkeypatch.setattr(path_tracer, "CANDIDATES", 1)
    plain = light_of(ours, 3)
    for light in (resampled, plain):
        error = np.sqrt((theirs.var(1) + light.var(1)) / rays)
        assert (abs(theirs.mean(1) - light.mean(1)) <= 4 * error).all()
    assert (resampled.var(1) < 0.25 * plain.var(1)).all()


@pytest.mark.slow
def test_more_paths_a_ray_are_less_dark(build):
    camera = engine.Camera(np.eye(4), math.radians(36))
    hologram = engine.Hologram(32, 32, 8e-6, (GREEN,), 0.1e-3, 0.6e-3)
    scene = build.closed_box()
    truth = engine.reference(scene, camera, hologram, [1.0], spp=64, near=0.9).mean()
    bright = []
    for paths in (1, 16):
        settings = engine.Settings(frames=8, radiance="ray", paths=paths)
        field = engine.render(scene, camera, hologram, settings)
        bright.append(float(engine.reconstruct(field, [1.0]).mean() / truth))
    assert bright[0] < 0.87
    assert bright[0] + 0.1 < bright[1] < 1
