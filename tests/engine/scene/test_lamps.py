"""Lamps with a size that no ray meets: irradiances by formula, pictures by Mitsuba's own emitters of that shape."""

import math

import numpy as np
import pytest

COLOR = np.array([1.0, 2.0, 4.0])


@pytest.fixture
def mi(backend):
    """Mitsuba, which knows the lamps."""
    import mitsuba

    return mitsuba


def lamp(mi, kind, to_world=None, **values):
    to_world = mi.ScalarTransform4f() if to_world is None else to_world
    strength = {"point_lamp": "intensity", "area_lamp": "radiance", "sun_lamp": "irradiance"}[kind]
    return mi.load_dict({"type": kind, "to_world": to_world, strength: COLOR.tolist(), **values})


def irradiance(mi, emitter, points, normals=(0, 0, 1), count=1 << 16):
    """On surfaces at points [n, 3], shape (n, 3)."""
    import drjit as dr

    points = np.atleast_2d(points).astype(np.float32)
    normals = np.broadcast_to(np.asarray(normals, np.float32), points.shape)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, len(points) * count)
    it = dr.zeros(mi.Interaction3f, len(points) * count)
    it.p = mi.Point3f(np.repeat(points, count, 0).T)
    ds, strength = emitter.sample_direction(it, sampler.next_2d())
    assert dr.all(ds.delta) and dr.all(ds.pdf == 1)
    assert dr.all(dr.norm(ds.p - it.p - ds.dist * ds.d) < 1e-5 * ds.dist)
    facing = dr.maximum(dr.dot(ds.d, mi.Vector3f(np.repeat(normals, count, 0).T)), 0)
    return np.array(strength * facing).reshape(3, len(points), count).mean(2).T


def test_a_disk_faces_every_point(mi):
    for distance, radius in ((2.0, 0.0), (2.0, 0.5), (0.2, 0.5)):
        disk = lamp(mi, "point_lamp", radius=radius)
        (found,) = irradiance(mi, disk, [0, 0, -distance], count=1 << 20)
        assert found == pytest.approx(COLOR / (distance**2 + radius**2), rel=5e-3)


def test_a_sphere_is_bright_from_outside_and_inside(mi):
    sphere = lamp(mi, "point_lamp", radius=0.5, sphere=True)
    (found,) = irradiance(mi, sphere, [0, 0, -0.8])
    assert found == pytest.approx(COLOR / 0.8**2, rel=1e-3)
    (found,) = irradiance(mi, sphere, [0.1, 0, -0.3])
    assert found == pytest.approx(COLOR / 0.5**2, rel=2e-2)


def rectangle(width, height, distance):
    """Irradiance by unit radiance under the middle of a parallel rectangle (a view factor of any textbook)."""
    a, b = width / 2 / distance, height / 2 / distance
    part = a / math.hypot(1, a) * math.atan(b / math.hypot(1, a))
    return 2 * (part + b / math.hypot(1, b) * math.atan(a / math.hypot(1, b)))


def test_areas_shine_down_only(mi):
    (found,) = irradiance(mi, lamp(mi, "area_lamp", width=1.5, height=0.6), [0, 0, -1])
    assert found == pytest.approx(COLOR * rectangle(1.5, 0.6, 1.0), rel=3e-3)
    disk = lamp(mi, "area_lamp", width=1.4, height=1.4, round=True)
    (found,) = irradiance(mi, disk, [0, 0, -1])
    assert found == pytest.approx(COLOR * math.pi * 0.7**2 / (1 + 0.7**2), rel=3e-3)
    assert irradiance(mi, disk, [[0, 0, 1], [3, 0, 0]], normals=(0, 0, -1)).max() == 0


@pytest.mark.parametrize("spread", [3.0, 1.0, 0.2])
@pytest.mark.parametrize("round", [False, True])
def test_slats_keep_the_power(mi, spread, round):
    """A plane one meter below receives all of it: radiance times pi times the lamp's area."""
    size = 0.02
    small = lamp(mi, "area_lamp", width=size, height=size, spread=spread, round=round)
    # light at angles up to 80 degrees; beyond are 3 % of an almost open lamp's
    reach = math.tan(min(spread / 2, math.radians(80))) + size
    edges = reach * np.linspace(0, 1, 201)
    middles = (edges[1:] + edges[:-1]) / 2
    along = irradiance(mi, small, np.stack([middles, 0 * middles, -1 + 0 * middles], 1), count=2048)
    power = (along * np.pi * np.diff(edges**2)[:, None]).sum(0)
    area = size**2 * (math.pi / 4 if round else 1)
    assert power == pytest.approx(COLOR * math.pi * area, rel=0.04 if spread == 3.0 else 0.01)


def test_no_spread_is_parallel_light(mi):
    wide = lamp(mi, "area_lamp", width=1.0, height=2.0, spread=0.0)
    found = irradiance(mi, wide, [[0.45, 0.9, -3], [0.55, 0.9, -3], [0.45, 1.1, -3]])
    assert found[0] == pytest.approx(COLOR * math.pi, rel=1e-2)
    assert found[1:].max() == 0


def test_a_spot_has_a_smooth_edge_and_takes_scale(mi):
    cone, blend = 0.6, 0.4
    scaled = mi.ScalarTransform4f().rotate([0, 0, 1], 30).scale([2.0, 0.5, 1.0])
    spot = lamp(mi, "point_lamp", scaled, cone=cone, blend=blend)
    turn = np.array([[math.cos(math.pi / 6), -0.5], [0.5, math.cos(math.pi / 6)]])
    places = np.random.default_rng(2).uniform(-1.5, 1.5, (200, 2))
    found = irradiance(mi, spot, np.column_stack([places, -np.ones(200)]), count=1)
    local = places @ turn / [2.0, 0.5]
    cosine = 1 / np.sqrt(1 + (local**2).sum(1))
    t = np.clip((cosine - math.cos(cone)) / (blend * (1 - math.cos(cone))), 0, 1)
    expected = t**2 * (3 - 2 * t) / (1 + (places**2).sum(1)) ** 1.5
    assert 0.1 < (t > 0).mean() < (t < 1).mean()
    assert found == pytest.approx(expected[:, None] * COLOR, abs=1e-4)


def test_a_sun_fills_its_disk(mi):
    for radius in (0.0, 0.005, 0.3, math.pi / 2):
        solid_angle = 2 * math.pi * (1 - math.cos(radius))
        facing = math.pi * math.sin(radius) ** 2 / solid_angle if radius else 1.0
        (found,) = irradiance(mi, lamp(mi, "sun_lamp", radius=radius), [7, 0, -5])
        assert found == pytest.approx(COLOR * facing, rel=3e-3)


def test_falloff(mi):
    for power in (0, 1, 2):
        (found,) = irradiance(mi, lamp(mi, "point_lamp", falloff=power, unit=0.1), [0, 0, -2], count=1)
        assert found == pytest.approx(COLOR / 4 * 20**power, rel=1e-5)


def test_profile_is_in_the_lamps_own_frame(mi):
    def factor(x, y, z):
        return np.stack([2 + x - 0.5 * y, 1.5 + z + x * y, 2 - y - 0.5 * z], axis=-1)

    rows, columns = 64, 128
    polar = (np.arange(rows)[:, None] + 0.5) / rows * math.pi
    azimuth = (np.arange(columns) + 0.5) / columns * 2 * math.pi
    table = factor(
        np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar) + 0 * azimuth
    )
    turned = mi.ScalarTransform4f().rotate([0.6, 0, 0.8], 70).scale(3.0)
    profiled = lamp(mi, "point_lamp", turned, profile=mi.TensorXf(table.astype(np.float32)))
    rng = np.random.default_rng(0)
    leaving = rng.normal(size=(1000, 3))
    leaving /= np.linalg.norm(leaving, axis=1, keepdims=True)
    found = irradiance(mi, profiled, leaving, normals=-leaving, count=1)
    local = leaving @ np.array(turned.matrix)[:3, :3] / 3
    assert found == pytest.approx(COLOR * factor(*local.T), abs=0.02 * COLOR.max())


def test_profiles_of_all_kinds(mi):
    """A profile of twos doubles the light, at every call."""
    profile = mi.TensorXf(np.full((4, 8, 3), 2, np.float32))
    for kind, values in (("point_lamp", {}), ("area_lamp", dict(width=0.1, height=0.1)), ("sun_lamp", {})):
        plain, doubled = lamp(mi, kind, **values), lamp(mi, kind, profile=profile, **values)
        for _ in range(2):
            expected = 2 * irradiance(mi, plain, [0, 0, -1], count=64)
            assert irradiance(mi, doubled, [0, 0, -1], count=64) == pytest.approx(expected, rel=1e-4)


def pictured(mi, scene, integrator):
    """Mean radiance [16, 16, 3] of a floor of 2 m from above."""
    import drjit as dr

    cells, paths = 16, 4096
    count = cells * cells * paths
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, count)
    cell = dr.arange(mi.UInt32, count) // paths
    place = (mi.Point2f(cell % cells, cell // cells) + sampler.next_2d()) * (2 / cells) - 1
    ray = mi.Ray3f(mi.Point3f(place.x, place.y, 0.1), mi.Vector3f(0, 0, -1))
    light = integrator(scene, sampler, ray)
    parts = [np.asarray(part).reshape(cells, cells, paths).mean(2) for part in light]
    return np.stack(parts, axis=-1)


@pytest.mark.parametrize("shape", ["rectangle", "sphere"])
def test_shadows_are_those_of_a_real_emitter(mi, shape):
    """A floor under a card: our path tracer and the lamp, Mitsuba's `path` and an emitting shape that rays meet."""
    from holopath_addon.engine.light.path_tracer import PathTracer
    from holopath_addon.engine.scene.specular_chains import FirstHits

    T = mi.ScalarTransform4f()
    parts = {
        "type": "scene",
        "floor": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": 0.5}},
        "card": {
            "type": "rectangle",
            "to_world": T.translate([0.2, 0, 0.4]).scale(0.3),
            "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": 0.0}},
        },
    }
    radiance = {"type": "area", "radiance": {"type": "rgb", "value": COLOR.tolist()}}
    at = T.translate([-0.3, 0.1, 1.2])
    if shape == "rectangle":
        ours = {"type": "area_lamp", "width": 0.8, "height": 0.4, "radiance": COLOR.tolist()}
        theirs = {"to_world": at.rotate([1, 0, 0], 180).scale([0.4, 0.2, 1])}
    else:
        intensity = (COLOR * math.pi * 0.25**2).tolist()
        ours = {"type": "point_lamp", "radius": 0.25, "sphere": True, "intensity": intensity}
        theirs = {"to_world": at.scale(0.25)}
    lit = mi.load_dict({**parts, "lamp": {**ours, "to_world": at}})
    real = mi.load_dict({**parts, "lamp": {"type": shape, "emitter": radiance, **theirs}})
    path = mi.load_dict({"type": "path", "max_depth": 3})
    expected = pictured(
        mi,
        real,
        lambda scene, sampler, ray: path.sample(scene, sampler, mi.RayDifferential3f(ray), None, True)[0],
    )
    tracer = PathTracer(3)
    found = pictured(
        mi,
        lit,
        lambda scene, sampler, ray: tracer.radiance(
            scene, sampler, FirstHits(coherent=False).view(scene, ray, mi.UInt32(0))
        ),
    )
    assert expected.min() < 0.3 * expected.max()
    assert abs(found - expected).mean() < 0.005 * expected.mean()
    assert abs(found - expected).max() < 0.02 * expected.max()


def test_moving_a_lamp_compiles_nothing(mi):
    import drjit as dr

    path = mi.load_dict({"type": "path", "max_depth": 3})

    def render(x):
        scene = mi.load_dict(
            {
                "type": "scene",
                "floor": {"type": "rectangle"},
                "one": lamp(
                    mi, "area_lamp", mi.ScalarTransform4f().translate([x, 0, 1 + x]), width=x, height=0.4
                ),
                "other": lamp(
                    mi, "point_lamp", mi.ScalarTransform4f().translate([0, x, 2 - x]), radius=0.1 * x
                ),
            }
        )
        return pictured(
            mi, scene, lambda scene, sampler, ray: path.sample(scene, sampler, mi.RayDifferential3f(ray))[0]
        )

    first = render(0.3)
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        second = render(0.7)
        kernels = dr.kernel_history([dr.KernelType.JIT])
    assert abs(first - second).max() > 0.01
    assert kernels and all(kernel["cache_hit"] for kernel in kernels)
