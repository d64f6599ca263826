"""Several recording planes: fewer rays, and far things shaded by near ones as waves."""

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.slabs import depth_slabs


def test_slabs_close_up_around_gaps():
    depths = np.concatenate([np.linspace(0, 1, 50), np.linspace(5, 6, 50), np.linspace(9, 9.5, 50)])
    assert depth_slabs(depths, 3) == [(0, 1), (5, 6), (9, 9.5)]
    assert depth_slabs(depths, 1) == [(0, 9.5)]
    assert depth_slabs(np.full(10, 2.0), 4) == [(2, 2)]


def test_slabs_share_an_even_range():
    slabs = depth_slabs(np.linspace(0, 8, 10_000), 4)
    assert [high - low for low, high in slabs] == pytest.approx([2, 2, 2, 2], abs=0.15)


def test_three_planes_with_a_tenth_of_the_rays(build, camera):
    """Each surface on a plane of its own; near focus keeps what lies behind. A deep volume, of many rays."""
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


def test_images_in_mirrors_have_planes_of_their_own(build, camera):
    """A lamp behind the viewer in a mirror beside a near and a far plane: nearer than one plane has it, with less."""
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


def test_most_rays_are_shared_by_the_planes(build, camera, small):
    plan = engine.plan(build.floor(), camera, small, engine.Settings(planes=4, spp=60))
    assert len(plan.planes) == 4 and plan.rays_per_pixel <= 60
    assert any("lose contrast" in warning for warning in plan.warnings)
