"""Several recording planes: fewer rays, silhouettes between them, and planes of images in mirrors."""

import math

import numpy as np
import pytest

from holopath_addon import engine


def test_three_planes_with_a_tenth_of_the_rays(build, camera):
    """Each surface has a plane of its own in a deep volume, which needs many rays with one plane."""
    deep, edge = engine.Hologram(128, 128, 8e-6, (516.5e-9,), 1e-3, 6e-3), 25
    scene, focus = build.three_planes(), [0.5, 1.0, 2.0]
    truth = engine.reference(scene, camera, deep, focus, spp=64, near=0.5)
    values, rays = {}, {}
    for planes in (1, 3):
        field = engine.render(scene, camera, deep, engine.Settings(frames=24, planes=planes))
        pictures = engine.reconstruct(field, focus)
        values[planes] = [engine.psnr(p, t, edge) for p, t in zip(pictures, truth, strict=True)]
        rays[planes] = field.plan["rays_per_pixel"]
        inner = slice(edge, -edge)
        ratios = [
            p[inner, inner].mean() / t[inner, inner].mean() for p, t in zip(pictures, truth, strict=True)
        ]
        assert ratios == pytest.approx([1, 1, 1], abs=0.03)
    assert rays[3] < rays[1] / 5
    assert min(np.subtract(values[3], values[1])) > -0.3
    assert values[3][0] > values[1][0]


@pytest.mark.slow
def test_a_floor_without_gaps(build, camera, small):
    scene, focus = build.floor(), [0.55, 1.0, 4.0]
    field = engine.render(scene, camera, small, engine.Settings(frames=24, planes=4))
    truth = engine.reference(scene, camera, small, focus, spp=128, near=field.near)
    for picture, reference in zip(engine.reconstruct(field, focus), truth, strict=True):
        assert engine.psnr(picture, reference, 13) > 21.5
        inner = slice(13, -13)
        assert picture[inner, inner].mean() / reference[inner, inner].mean() == pytest.approx(1, abs=0.05)


@pytest.mark.slow
def test_images_in_mirrors_have_planes_of_their_own(build, camera):
    """A lamp in a mirror beside a near and a far plane is better recorded than by one plane, with fewer rays."""
    display, edge = engine.Hologram(128, 128, 8e-6, (516.5e-9,), 1e-3, 6e-3), 20
    behind = {
        "type": "rectangle",
        "to_world": build.T().translate([0, 0, 1]).rotate([0, 1, 0], 180).scale(1.5),
    }
    scene = build.scene(
        mirror=build.plane(1.0, {"bsdf": {"type": "conductor", "material": "none"}}, 0.1, 0.4, x=0.08),
        lamp=behind | build.emissive(build.texture(128, 4, contrast=4)),
        far=build.plane(1.4, build.emissive(build.texture(128, 1, contrast=4))),
        near=build.plane(0.5, build.emissive(build.texture(128, 2, contrast=4)), 0.03, 0.04, x=-0.02),
    )
    focus, values, rays = [0.5, 1.4, 3.0], {}, {}
    truth = engine.reference(scene, camera, display, focus, spp=64, near=0.5)
    for planes in (1, "auto"):
        field = engine.render(scene, camera, display, engine.Settings(frames=24, planes=planes))
        pictures = engine.reconstruct(field, focus)
        values[planes] = [engine.psnr(p, t, edge) for p, t in zip(pictures, truth, strict=True)]
        rays[planes] = field.report["rays"]["wave rays"]
        inner = slice(edge, -edge)
        ratios = [
            p[inner, inner].mean() / t[inner, inner].mean() for p, t in zip(pictures, truth, strict=True)
        ]
        assert ratios == pytest.approx([1, 1, 1], abs=0.03)
    assert {plane["sees"] for plane in field.plan["planes"]} == {"surfaces", "images"}
    assert rays["auto"] < rays[1] / 2
    assert min(np.subtract(values["auto"], values[1])) > -0.1 and values["auto"][0] > values[1][0] + 1


def even_plane(build, slant):
    return build.scene(plane=build.plane(1.0, build.emissive(build.gray(1.0)), 4.0, 4.0, slant=slant))


@pytest.mark.parametrize(
    ("slant", "planes"),
    [(66, 3)]
    + [pytest.param(66, j, marks=pytest.mark.slow) for j in (2, 4, 5, 6, 7, 8)]
    + [pytest.param(78, j, marks=pytest.mark.slow) for j in range(2, 9)],
)
def test_a_surface_goes_on_from_slab_to_slab(build, camera, slant, planes):
    """A slanted plane is as bright as on one plane, without dark or bright columns at the ends of slabs."""
    display, scene, edge = (
        engine.Hologram(256, 256, 8e-6, (516.5e-9,), 1e-3, 6e-3),
        even_plane(build, slant),
        24,
    )
    settings = [engine.Settings(frames=24, max_depth=1, planes=j) for j in (1, planes)]
    fields = [engine.render(scene, camera, display, each) for each in settings]
    assert len(fields[1].plan["planes"]) == planes
    one, several = (
        np.mean(engine.reconstruct(field, [0.8, 1.0, 1.3]), axis=0)[edge:-edge, edge:-edge, 0]
        for field in fields
    )
    assert several.mean() == pytest.approx(one.mean(), rel=0.01)
    columns = several.mean(0) / several.mean()
    assert columns == pytest.approx(1, abs=0.08) and columns.std() < 0.02


def test_several_planes_never_need_more_rays(build, camera):
    """A gently slanted plane is near any recording plane, so that many would need more rays than one."""
    display, scene = engine.Hologram(256, 256, 8e-6, (516.5e-9,), 1e-3, 6e-3), even_plane(build, 40)
    rays = {}
    for planes in (1, 8, "auto"):
        plan = engine.plan(scene, camera, display, engine.Settings(planes=planes, max_depth=1))
        rays[planes] = sum(plane.plain for plane in plan.planes)
    assert max(rays[8], rays["auto"]) < 1.05 * rays[1]


@pytest.mark.slow
def test_three_shining_planes_by_default(build, camera):
    display, edge = engine.Hologram(256, 256, 8e-6, (516.5e-9,), 1e-3, 6e-3), 24
    near, middle = (depth * math.tan(math.radians(10)) for depth in (0.4, 0.9))

    def surface(cells, seed):
        return build.emissive(build.texture(cells, seed, contrast=4))

    scene, focus = (
        build.scene(
            far=build.plane(3.0, surface(256, 1)),
            middle=build.plane(0.9, surface(256, 3), 0.3 * middle, 0.35 * middle, x=0.025 * middle),
            near=build.plane(0.4, surface(128, 2), 0.5 * near, 0.6 * near, x=-0.55 * near),
        ),
        [0.4, 0.9, 3.0],
    )
    field = engine.render(scene, camera, display, engine.Settings(frames=24))
    truth = engine.reference(scene, camera, display, focus, spp=256, near=field.near)
    for picture, reference in zip(engine.reconstruct(field, focus), truth, strict=True):
        assert engine.psnr(picture, reference, edge) > 27.5


def test_planes_share_the_maximum_of_rays(build, camera, small):
    plan = engine.plan(build.floor(), camera, small, engine.Settings(planes=4, spp=60))
    assert len(plan.planes) == 4
    assert 55 < sum(plane.plain + plane.chained for plane in plan.planes) <= 60
    assert any("middle views only" in warning for warning in plan.warnings)


def test_no_rays_are_cut_where_the_mean_suffices(build, camera, small):
    """The requested rays are compared with the mean of all pixels, not with the pixel that needs most."""
    scene = build.two_planes(build.emissive)
    whole = engine.plan(scene, camera, small)
    enough = math.ceil(sum(plane.plain + plane.chained for plane in whole.planes))
    assert enough < whole.rays_per_pixel
    assert engine.plan(scene, camera, small, engine.Settings(spp=enough)).planes == whole.planes
