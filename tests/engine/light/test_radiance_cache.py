"""Baked light: right against Mitsuba's path tracer, reused where it holds and only there, whatever the scene."""

import json
import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks.scenes import FOV, GREEN
from holopath_addon import engine

SIZE = 32
HOLOGRAM = engine.Hologram(SIZE, SIZE, 8e-6, (GREEN,), depth_far=0.3e-3, depth_near=1.5e-3)
FRAMES = 24


@pytest.fixture(autouse=True)
def few_lanes(monkeypatch):
    """Pictures are small here: no need to fill a large launch."""
    from holopath_addon.engine.light import radiance_cache

    monkeypatch.setattr(radiance_cache, "MAX_LANES", 1 << 14)


def bake(scene, camera, store=None, progress=None, noise=0.05, **settings):
    """The cache of a view, with texels of a known noise, of which a region has dozens, and what was done."""
    from holopath_addon.engine.light import baking

    settings = engine.Settings(**{"method": "fast", "frames": FRAMES, **settings})
    plan = engine.plan(scene, camera, HOLOGRAM, settings, store)
    assert plan.cached == (settings.max_depth > 1)
    plan = replace(plan, texel_noise=noise, texel_samples=256)
    return baking.bake(scene, camera, HOLOGRAM, plan, store=store, progress=progress)


@pytest.mark.slow
def test_groups_together_or_apart(build, camera, monkeypatch):
    """However many are sampled at once, the same light."""
    from holopath_addon.engine.light import gathering, radiance_cache

    monkeypatch.setattr(radiance_cache, "MAX_LANES", 1 << 9)
    monkeypatch.setattr(radiance_cache, "MIN_LANES", 1 << 9)
    scene, found, parts = build.closed_box(), [], []
    for size in (1, 3, 100):

        def paced(units, most, size=size):
            parts.append(len(units))
            return (units[first : first + size] for first in range(0, len(units), size))

        monkeypatch.setattr(gathering, "paced", paced)
        cache, _ = bake(scene, camera, noise=0.3)
        found.append((np.array(cache.source), np.array(cache.fine)))
    assert max(parts) > 3
    for source, fine in found[1:]:
        assert np.array_equal(source, found[0][0]) and np.array_equal(fine, found[0][1])


def rays(build, camera, each):
    """Through every pixel of the view of a pinhole, and random numbers for them."""
    import drjit as dr

    mi, count = build.mi, SIZE * SIZE * each
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, count)
    index, jitter = dr.arange(mi.UInt32, count) // each, sampler.next_2d()
    x = (2 * (mi.Float(index % SIZE) + jitter.x) / SIZE - 1) * math.tan(camera.fov_x / 2)
    y = (1 - 2 * (mi.Float(index // SIZE) + jitter.y) / SIZE) * math.tan(camera.fov_x / 2)
    axes = [mi.Vector3f(*map(float, axis)) for axis in camera.axes]
    direction = dr.normalize(x * axes[0] + y * axes[1] + axes[2])
    return mi.Ray3f(mi.Point3f(*map(float, camera.position)), direction), sampler


def averages(light, each):
    light = np.stack([np.asarray(c) for c in light], axis=-1)
    return light.reshape(SIZE, SIZE, each, 3).mean(2)


def cached(build, scene, camera, cache, depth=8, each=32):
    """Radiance by the cache."""
    from holopath_addon.engine.light.path_tracer import PathTracer
    from holopath_addon.engine.scene.specular_chains import FirstHits

    ray, sampler = rays(build, camera, each)
    point = FirstHits(coherent=False).view(scene, ray, build.mi.UInt32(0))
    return averages(PathTracer(depth, cache=cache).radiance(scene, sampler, point), each)


def truth(build, scene, camera, depth=8, each=256):
    """Radiance by Mitsuba's own path tracer, and the number of the shape in each pixel's middle."""
    import drjit as dr

    mi = build.mi
    path = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": max(5, depth)})
    ray, sampler = rays(build, camera, each)
    light, _, _ = path.sample(scene, sampler, mi.RayDifferential3f(ray), None, True)
    shapes = dr.reinterpret_array(mi.UInt32, scene.ray_intersect(ray).shape)
    return averages(light, each), np.array(shapes).reshape(SIZE, SIZE, each)[..., 0]


def errors(one, other, regions, least=20):
    """Relative differences of regions' mean brightness."""
    return [
        one[regions == r].mean() / other[regions == r].mean() - 1
        for r in np.unique(regions)
        if (regions == r).sum() >= least
    ]


def quarters():
    y, x = np.mgrid[0:SIZE, 0:SIZE] * 2 // SIZE
    return 2 * y + x


def moved(x=0.0, z=0.0, turn=0.0):
    cosine, sine = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    matrix = np.eye(4)
    matrix[np.ix_([0, 2], [0, 2])] = [[cosine, sine], [-sine, cosine]]
    matrix[[0, 2], 3] = x, z
    return engine.Camera(matrix, FOV)


def rgb(*color):
    return {"type": "rgb", "value": list(color)}


def lamp(build, radiance=20.0, scale=1.0):
    place = build.T().look_at(origin=[1.5, 2, 1], target=[0, 0, -1.5], up=[0, 1, 0])
    return {
        "type": "rectangle",
        "to_world": build.T().scale(scale) @ place.scale(0.5),
        **build.emissive(build.gray(radiance)),
    }


def stage(build, wall=None, **shapes):
    """A wall and a floor below a lamp."""
    floor = build.T().translate([0, -0.12, -0.6]).rotate([1, 0, 0], -90).scale([0.4, 0.5, 1])
    return build.scene(
        wall=build.plane(1.0, wall or build.diffuse(build.gray(0.7)), 0.4),
        floor={"type": "rectangle", "to_world": floor, **build.diffuse(rgb(0.6, 0.5, 0.3))},
        lamp=lamp(build),
        **shapes,
    )


def boxes(build, materials, **others):
    """The stage with a box of each material."""
    shapes = {}
    for number, material in enumerate(materials):
        x, y = 0.1 * (number % 3) - 0.1, 0.1 * (number // 3) - 0.06
        low, high = [x - 0.025, y - 0.025, -0.75], [x + 0.025, y + 0.025, -0.7]
        shapes[f"box_{number}"] = build.box(low, high, {"bsdf": material}, 30)
    return stage(build, **shapes, **others)


def surfaces(build):
    """Materials of which a part is not diffuse, or passes, under a lamp and a sky."""
    leaf = rgb(0.3, 0.6, 0.2)
    diffuse, through = {"type": "diffuse"}, {"type": "matt", "translucent": True, "reflectance": leaf}
    coat = {"type": "gloss", "roughness": 0.3, "ior": 1.5}
    materials = [
        {"type": "plastic", "diffuse_reflectance": rgb(0.6, 0.2, 0.1)},
        {"type": "roughplastic", "diffuse_reflectance": rgb(0.1, 0.5, 0.3), "alpha": 0.2},
        {"type": "roughconductor", "alpha": 0.3, "distribution": "ggx"},
        {"type": "mixture", "mode": "over", "a": diffuse, "b": coat, "weight": 1.0},
        {"type": "mixture", "weight": 0.5, "a": {"type": "diffuse", "reflectance": leaf}, "b": through},
    ]
    sheet = build.T().translate([0.1, 0.04, -0.7]).rotate([0, 1, 0], 150).scale([0.03, 0.03, 1])
    return boxes(
        build,
        materials,
        sheet={"type": "rectangle", "to_world": sheet, "bsdf": through},
        glow=build.box(
            [-0.12, -0.11, -0.8],
            [-0.05, -0.09, -0.7],
            build.diffuse(rgb(0.7, 0.3, 0.3)) | build.emissive(build.gray(0.1)),
        ),
        sky={"type": "constant", "radiance": rgb(0.1, 0.15, 0.2)},
    )


@pytest.mark.slow
@pytest.mark.parametrize("depth", [2, 3, 8])
def test_split_adds_up_on_diffuse_walls(build, camera, depth):
    """Nearly all light is indirect; each quarter of the view."""
    scene = build.closed_box()
    cache, _ = bake(scene, camera, max_depth=depth)
    light, _ = truth(build, scene, camera, depth, 2048)
    mine = cached(build, scene, camera, cache, depth)
    if depth == 2:  # a sliver of light
        assert mine.mean() == pytest.approx(light.mean(), rel=0.03)
    else:
        assert np.abs(errors(mine, light, quarters())).max() < 0.06


def test_an_evenly_lit_room_has_no_dark_edges(build, camera):
    """A closed room whose walls all shine E and reflect a share r: the radiance is E / (1 - r) everywhere.

    Where walls meet, rays from edges would start behind the other wall and get away.
    """
    emitted, share = 0.5, 0.6
    walls = {
        "type": "cube",
        "flip_normals": True,
        "to_world": build.T().translate([0, 0, -1]).scale([0.5, 0.5, 1.1]),
    }
    scene = build.scene(walls=walls | build.diffuse(build.gray(share)) | build.emissive(build.gray(emitted)))
    cache, done = bake(scene, camera, max_depth=24)  # 5e-6 of the light is left then
    found = np.array(cache.fine).reshape(-1, 4)[1:]
    assert done.traced == () and (found[:, 3] > 0).all()
    texels = found[:, 0] * (1 - share) / emitted
    assert texels.mean() == pytest.approx(1, abs=0.005)
    assert texels.min() > 0.95


@pytest.mark.parametrize("depth", [2, pytest.param(8, marks=pytest.mark.slow)])
def test_split_adds_up_on_every_surface(build, camera, depth):
    """What is diffuse of a surface comes from the cache, the rest from paths."""
    scene = surfaces(build)
    cache, done = bake(scene, camera, max_depth=depth)
    light, shapes = truth(build, scene, camera, depth, 512)
    assert done.traced == () and done.note == ""
    found = errors(cached(build, scene, camera, cache, depth), light, shapes)
    assert len(found) >= 8 and np.abs(found).max() < 0.05 and abs(np.mean(found)) < 0.02


@pytest.mark.slow
def test_branches_of_a_clear_coat_add_up(build, camera):
    """Without its δ lobe a coat shows what it scatters, also by the cache."""
    from holopath_addon.engine.light.path_tracer import PathTracer
    from holopath_addon.engine.scene.specular_chains import FirstHits

    coat = {"bsdf": {"type": "plastic", "diffuse_reflectance": rgb(0.5, 0.3, 0.2)}}
    scene = stage(build, coat, sky={"type": "constant", "radiance": build.gray(1.0)})
    cache, _ = bake(scene, camera)
    light = {}
    for known in (cache, None):
        for whole in (True, False):
            ray, sampler = rays(build, camera, 32)
            point = FirstHits(coherent=False).view(scene, ray, build.mi.UInt32(0))
            point.whole = build.mi.Bool(whole)
            colors = PathTracer(8, cache=known).radiance(scene, sampler, point)
            light[known is cache, whole] = averages(colors, 32)[: SIZE // 2].mean()
    assert light[True, True] == pytest.approx(light[False, True], rel=0.02)
    assert light[True, False] == pytest.approx(light[False, False], rel=0.02)
    assert light[True, False] < 0.95 * light[True, True]


def test_patterns_finer_than_texels_stay_sharp(build, camera):
    """Along each ray, where a texel covers black and white squares."""
    squares = {
        "type": "checkerboard",
        "color0": build.gray(0.0),
        "color1": build.gray(0.9),
        "to_uv": build.T().scale([300, 300, 1]),
    }
    scene = stage(build, build.diffuse(squares))
    cache, _ = bake(scene, camera)
    ray, sampler = rays(build, camera, 64)
    si = scene.ray_intersect(ray)
    white = np.array(si.bsdf().eval_diffuse_reflectance(si).x)
    upper = np.arange(len(white)) < len(white) // 2  # the wall alone
    light, _ = cache.diffuse(
        scene.ray_intersect_preliminary(ray), si, si.bsdf(), sampler, build.mi.Bool(True), True
    )
    light = np.array(light.x)
    exact, _ = truth(build, scene, camera)
    assert 0.4 < (white[upper] == 0).mean() < 0.6
    assert (light[upper & (white == 0)] == 0).all()
    assert light[upper].mean() == pytest.approx(exact[: SIZE // 2, :, 0].mean(), rel=0.03)
    bright = light[upper & (white > 0)]
    assert bright.std() < 0.15 * bright.mean()


@pytest.mark.slow
def test_what_is_no_product_is_traced(build, camera):
    """Its diffuse light is not the same from everywhere."""
    materials = [
        {"type": "principled", "base_color": rgb(0.6, 0.3, 0.2), "roughness": 0.5, "specular": 0.5},
        {"type": "matt", "roughness": 0.8, "reflectance": rgb(0.6, 0.6, 0.2)},
        {"type": "sheen", "reflectance": rgb(0.6, 0.6, 0.9)},
        {"type": "diffuse"},
    ]
    ball = {"type": "sphere", "center": [0.1, 0.06, -0.7], "radius": 0.03, **build.diffuse(0.5)}
    scene = boxes(build, materials, ball=ball)
    cache, done = bake(scene, camera)
    assert done.traced == ("ball", "box_0", "box_1", "box_2")
    light, shapes = truth(build, scene, camera)
    found = errors(cached(build, scene, camera, cache), light, shapes)
    assert len(found) >= 6 and np.abs(found).max() < 0.05 and abs(np.mean(found)) < 0.02


@pytest.mark.parametrize(
    "kind",
    [
        "principled",
        pytest.param("sphere", marks=pytest.mark.slow),
        pytest.param("metal", marks=pytest.mark.slow),
        pytest.param("lamp", marks=pytest.mark.slow),
    ],
)
def test_views_without_anything_to_bake(build, camera, kind):
    things = {
        "principled": {"thing": build.plane(1.0, {"bsdf": {"type": "principled"}}, 0.4)},
        "sphere": {"thing": {"type": "sphere", "center": [0, 0, -1.4], "radius": 0.5, **build.diffuse(0.5)}},
        "metal": {"thing": build.plane(1.0, {"bsdf": {"type": "roughconductor", "alpha": 0.3}}, 0.4)},
        "lamp": {"thing": build.plane(1.0, build.emissive(build.gray(1.0)), 0.4)},
    }
    bulb = {"type": "sphere", "center": [0.5, 0.5, 0.5], "radius": 0.2, **build.emissive(build.gray(5.0))}
    scene = build.scene(**things[kind], bulb=bulb)
    cache, _ = bake(scene, camera)
    light, _ = truth(build, scene, camera, each=64)
    assert cached(build, scene, camera, cache).mean() == pytest.approx(light.mean(), rel=0.03)


@pytest.mark.slow
def test_light_is_used_again_where_it_holds(build, camera, tmp_path):
    """The same view, other views, other scenes, other settings; the picture is right each time."""
    store = engine.BakeStore(tmp_path)

    def again(reused, camera=camera, scene=None, **settings):
        scene = scene or build.closed_box()
        cache, done = bake(scene, camera, store, **{"noise": 0.1, **settings})
        assert (done.reused, done.note) == (reused, "")
        assert (done.samples == 0) == (reused == "all")
        json.dumps(asdict(done))
        picture = cached(build, scene, camera, cache)
        light, _ = truth(build, scene, camera, 8, 256)
        assert picture.mean() == pytest.approx(light.mean(), rel=0.05)
        assert picture.max(-1).min() > 0
        return picture, done.samples

    first, _ = again("nothing")
    second, _ = again("all")  # built from scratch
    np.testing.assert_array_equal(first, second)
    again("all", moved(0.02, 0.01, 1.0))
    again("part", moved(turn=60.0))
    again("all", moved(turn=60.0))
    np.testing.assert_array_equal(again("all")[0], first)
    again("charts", noise=0.08)


@pytest.mark.slow
def test_plans_ask_what_baking_asks(build, camera, tmp_path, monkeypatch):
    """Light of another view is told apart from this one's, and what the plan found is not looked for again."""
    from holopath_addon.engine.light import baking

    scene, store = build.closed_box(), engine.BakeStore(tmp_path)
    settings, aside = engine.Settings(method="fast"), moved(turn=60.0)

    def told(camera):
        plan = engine.plan(scene, camera, HOLOGRAM, settings, store)
        (light,) = (str(decision) for decision in plan.decisions if decision.name == "diffuse light")
        return plan, light

    def reused(camera, plan=None):
        return engine.render(scene, camera, HOLOGRAM, settings, plan, store=store).report["bake"]["reused"]

    anew, light = told(camera)
    assert "to be baked" in light and reused(camera, anew) == "nothing"
    there, light = told(camera)
    assert "light baked before," in light
    find, calls = baking.find, []
    monkeypatch.setattr(baking, "find", lambda *what: calls.append(what) or find(*what))
    assert reused(camera, there) == "all" and not calls
    part, light = told(aside)
    assert "light baked before for other views" in light
    assert there.stages["bake"] < part.stages["bake"] < anew.stages["bake"]
    assert reused(aside, part) == "part" and len(calls) == 1
    reused(camera, there)
    assert len(calls) == 2  # kept for another view
    told(camera)
    fewer = engine.Settings(method="fast", max_depth=3)
    changed, right = (engine.render(scene, camera, HOLOGRAM, fewer, store=each) for each in (store, None))
    np.testing.assert_array_equal(changed.data, right.data)  # nothing of what was kept for other bounces


@pytest.mark.slow
def test_light_is_baked_anew_when_the_scene_changes(build, camera, tmp_path):
    store = engine.BakeStore(tmp_path)

    def again(x=0.0, radiance=20.0, depth=8):
        block = build.box([x, -0.1, -0.8], [x + 0.08, 0.0, -0.7], build.diffuse(rgb(0.2, 0.3, 0.8)))
        scene = stage(build, block=block, bulb=lamp(build, radiance, 0.9))
        cache, done = bake(scene, camera, store, max_depth=depth, noise=0.05)
        light, shapes = truth(build, scene, camera, depth, 512)
        found = errors(cached(build, scene, camera, cache, depth), light, shapes)
        assert np.abs(found).max() < 0.03
        return done.reused

    assert [again(), again()] == ["nothing", "all"]
    assert again(radiance=60.0) == "charts"
    assert again(x=0.05) in ("charts", "nothing")
    assert again(depth=3) in ("charts", "nothing")


@pytest.mark.slow
def test_a_side_that_was_never_seen_is_not_black(build, camera, tmp_path):
    """A sheet lit from both sides, with nothing that its back could light."""
    store, white = engine.BakeStore(tmp_path), {"type": "diffuse", "reflectance": 0.6}
    bulbs = {
        f"bulb_{z}": {
            "type": "sphere",
            "center": [0.3, 0.6, z],
            "radius": 0.2,
            **build.emissive(build.gray(5)),
        }
        for z in (0, -2)
    }
    scene = build.scene(sheet=build.plane(1.0, {"bsdf": {"type": "twosided", "bsdf": white}}, 0.4), **bulbs)
    for place in (camera, moved(z=-2.0, turn=180.0)):
        cache, _ = bake(scene, place, store, noise=0.1)
        light, _ = truth(build, scene, place, each=64)
        assert cached(build, scene, place, cache).mean() == pytest.approx(light.mean(), rel=0.03)


@pytest.mark.slow
def test_broken_files_and_folders_cost_no_picture(build, camera, tmp_path):
    scene, store = stage(build), engine.BakeStore(tmp_path)
    bake(scene, camera, store, noise=0.1)
    (file,) = store.files()
    file.write_bytes(file.read_bytes()[:1000])
    _, done = bake(scene, camera, store, noise=0.1)
    assert done.reused == "nothing" and "baked again" in done.note
    _, done = bake(scene, camera, store, noise=0.1)
    assert done.reused == "all" and done.note == ""
    (tmp_path / "file").write_text("in the way")
    cache, done = bake(scene, camera, engine.BakeStore(tmp_path / "file"), noise=0.1)
    assert "cannot be stored" in done.note and done.bytes == 0
    assert cache.groups


@pytest.mark.parametrize(
    "kind",
    [
        pytest.param("degenerate", marks=pytest.mark.slow),
        "nan vertices",
        pytest.param("nan texture", marks=pytest.mark.slow),
    ],
)
def test_broken_input(build, camera, kind):
    """Right where it is defined."""
    v, u = np.mgrid[-1:1:9j, -1:1:9j]
    vertices = np.stack([0.4 * u, 0.4 * v, np.full_like(u, -0.95)], axis=-1)
    texture = np.full((8, 8, 3), 0.6, np.float32)
    if kind == "degenerate":
        vertices[3], vertices[:, 5] = vertices[2], vertices[:, 4]
    elif kind == "nan vertices":
        vertices[0, 0], vertices[4, 0] = np.nan, np.inf
    else:
        texture[:, :4] = np.nan

    def sheet():
        texels = {"type": "bitmap", "data": build.mi.TensorXf(texture), "raw": True, "filter_type": "nearest"}
        return build.mesh(vertices, build.diffuse(texels))

    scene = stage(build, sheet=sheet(), again=sheet())
    # of what has met undefined light nothing is defined: one bounce then
    depth = 2 if kind == "nan texture" else 8
    cache, _ = bake(scene, camera, noise=0.1, max_depth=depth)
    mine, light = cached(build, scene, camera, cache, depth), truth(build, scene, camera, depth, 128)[0]
    defined = np.isfinite(light).all(-1)
    assert defined.mean() > 0.4 and np.isfinite(mine[defined]).all()
    # a texel beside one without light is darker: a column of these few pixels
    close = 0.07 if kind == "nan texture" else 0.03
    assert mine[defined].mean() == pytest.approx(light[defined].mean(), rel=close)


def test_surfaces_that_touch(build, camera, monkeypatch):
    """Rays from between them end at once: their inverse distance is bounded all the same."""
    from holopath_addon.engine.light import gathering

    found, sums = [], gathering._Sampling.sums

    def seen(*arguments):
        found.append(sums(*arguments))
        return found[-1]

    monkeypatch.setattr(gathering._Sampling, "sums", seen)
    gray, places = build.diffuse(build.gray(0.6)), ((-0.15, 20), (0.0, 40), (0.15, 65))
    bricks = {
        f"brick_{turn}": build.box([x - 0.05, -0.1, -0.8], [x + 0.05, 0.0, -0.7], gray, turn)
        for x, turn in places
    }
    bake(
        stage(build, table=build.box([-0.4, -0.13, -1.1], [0.4, -0.1, -0.3], gray), **bricks),
        camera,
        noise=0.3,
    )
    assert found and all(np.isfinite(values).all() for values in found)


@pytest.mark.parametrize("scale", [1e-5, pytest.param(1e6, marks=pytest.mark.slow)])
def test_scale_does_not_matter(build, scale):
    T, diffuse = build.T, build.diffuse
    floor = T().scale(scale) @ T().translate([0, -0.12, -0.6]).rotate([1, 0, 0], -90).scale([0.4, 0.5, 1])
    camera = engine.Camera(np.eye(4), FOV, clip_start=0.01 * scale, clip_end=10 * scale)
    scene = build.scene(
        wall=build.plane(scale, diffuse(build.gray(0.7)), 0.4 * scale),
        floor={"type": "rectangle", "to_world": floor, **diffuse(rgb(0.6, 0.5, 0.3))},
        lamp=lamp(build, scale=scale),
    )
    cache, done = bake(scene, camera, noise=0.1)
    light, shapes = truth(build, scene, camera, each=64)
    assert done.texels > SIZE**2 and light.mean() > 0.01
    assert np.abs(errors(cached(build, scene, camera, cache), light, shapes)).max() < 0.03


@pytest.mark.slow
def test_progress_and_cancel_in_each_stage(build, camera, tmp_path):
    store, scene, seen = engine.BakeStore(tmp_path), stage(build), []
    bake(scene, camera, progress=lambda done, message: seen.append((done, message)), noise=0.3)
    done = [d for d, _ in seen]
    assert done[0] == 0 and done[-1] == 1 and done == sorted(done)
    stages = sorted({message for _, message in seen})
    assert len(stages) == 4

    for stage_name in stages:

        def cancel(done, message, stage_name=stage_name):
            if message == stage_name:
                raise engine.Cancelled

        with pytest.raises(engine.Cancelled):
            bake(scene, camera, store, progress=cancel, noise=0.3)
        assert not list(tmp_path.glob("*holobake*"))
    _, last = bake(scene, camera, store, noise=0.3)
    assert last.reused == "nothing" and len(store.files()) == 1


def test_any_seed(build, camera):
    _, done = bake(stage(build), camera, seed=10**7, noise=0.3)
    assert done.samples > 0


def test_hologram_of_baked_light(build, camera, tmp_path):
    """From the scene to the refocused picture, first and second time, as bright as by paths alone."""
    scene, store = build.closed_box(), engine.BakeStore(tmp_path)
    settings = engine.Settings(method="full", frames=8)
    paths = engine.reconstruct(engine.render(scene, camera, HOLOGRAM, settings), [2.0])
    for reused in ("nothing", "all"):
        field = engine.render(scene, camera, HOLOGRAM, replace(settings, method="fast"), store=store)
        assert field.report["bake"]["reused"] == reused
        picture = engine.reconstruct(field, [2.0])
        assert picture.mean() == pytest.approx(paths.mean(), rel=0.04)


@pytest.mark.slow
def test_materials_that_come_and_go_are_no_damage(build, camera, tmp_path):
    """A block that is cached, then traced, then scatters nothing diffusely, then is cached again."""
    store = engine.BakeStore(tmp_path)
    for kind in ("diffuse", "principled", "roughconductor", "diffuse"):
        block = build.box([-0.1, -0.1, -0.9], [0.1, 0.1, -0.8], {"bsdf": {"type": kind}})
        scene = stage(build, block=block, bulb=lamp(build, 20.0, 0.9))
        _, done = bake(scene, camera, store, noise=0.3)
        assert done.reused != "all" and done.note == ""
        assert ("block" in done.traced) == (kind == "principled")


@pytest.mark.slow
def test_a_plain_to_the_horizon_coarsens_nothing_else(build, camera, tmp_path):
    """It is traced, here and when the light is used again; what stands on it keeps texels of a pixel."""
    T, store = build.T(), engine.BakeStore(tmp_path)
    place = T.translate([0, -0.2, 0]).rotate([1, 0, 0], -90).scale(500.0)
    white = build.diffuse(build.gray(0.6))
    scene = build.scene(
        ground={"type": "rectangle", "to_world": place, "bsdf": {"type": "twosided", "bsdf": white["bsdf"]}},
        block=build.box([-0.1, -0.2, -1.2], [0.1, 0.1, -1.0], build.diffuse(rgb(0.2, 0.3, 0.8))),
        bulb={"type": "sphere", "center": [2, 3, 0], "radius": 0.5, **build.emissive(build.gray(20))},
    )
    for reused in ("nothing", "all"):
        cache, done = bake(scene, camera, store, noise=0.05)
        assert (done.reused, done.coarser) == (reused, 1.0) and "ground" in done.traced
        picture, (light, _) = cached(build, scene, camera, cache), truth(build, scene, camera)
        assert picture.mean() == pytest.approx(light.mean(), rel=0.03)


def test_plan_chooses_and_tells_why(build, camera):
    """Nothing to bake on a lamp, much to gain in a closed room."""

    def light(scene, hologram=HOLOGRAM, **settings):
        plan = engine.plan(scene, camera, hologram, engine.Settings(**settings))
        return plan.cached, [d for d in plan.decisions if d.name == "diffuse light"]

    cached, why = light(build.scene(a=build.plane(1.0, build.emissive(build.gray(1.0)))))
    assert not cached and why[0].value == "paths of this view"
    box = build.closed_box()
    cached, why = light(box, replace(HOLOGRAM, width=1024, height=1024), frames=FRAMES)
    assert cached and why[0].value == "radiance cache" and "to be baked" in why[0].reason
    quick = {"quality": "preview"}
    assert light(box, method="full", **quick)[0] is False
    assert light(box, method="fast", **quick)[0] is True
    assert light(box, method="fast", max_depth=1, **quick)[0] is False
    with pytest.raises(engine.InvalidInput, match="Choose one of auto, full, fast, direct"):
        engine.Settings(method="slow")
