"""Images in mirrors and through glass, against paraxial optics and Mitsuba's thin-lens camera."""

import numpy as np
import pytest

from holopath_addon import engine

GREEN = 516.5e-9
MIRROR = {"bsdf": {"type": "conductor"}}
GLASS = {"bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}}


def on_axis(build, scene, virtual_image="curvature", branch=0):
    """Distance of the image that a ray near the axis sees, metres."""
    from holopath_addon.engine.chains import SpecularChains

    mi = build.mi
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([2e-4], [1e-4], [-1.0]))
    view = SpecularChains(virtual_image, 8).view(scene, ray, mi.UInt32([branch]))
    assert bool(np.broadcast_to(view.exists, 1)[0])
    return float(view.distance[0])


def behind(build, place, texture=32, half=1.0):
    """A textured emitter behind the viewer at z = `place`, facing the mirrors."""
    transform = build.T().translate([0, 0, place]).rotate([0, 1, 0], 180).scale([half, half, 1])
    return {"type": "rectangle", "to_world": transform, **build.emissive(build.texture(texture, 1))}


def sphere_mirror(build, radius):
    """Mirror with its vertex at 1 m: convex for a positive radius, concave for a negative one."""
    centre = [0, 0, -1 - radius]
    if radius > 0:
        return {"type": "sphere", "center": centre, "radius": radius, **MIRROR}
    # only the part of the sphere beyond the viewer may be there
    return (
        {"type": "disk", **MIRROR}
        if radius == 0
        else {"type": "sphere", "center": centre, "radius": -radius, "flip_normals": True, **MIRROR}
    )


def test_convex_mirror_obeys_the_mirror_equation(build):
    """1/s' = -2/R - 1/s: radius 0.3 m, object at 1.5 m: image 0.136 m behind the mirror."""
    scene = build.scene(mirror=sphere_mirror(build, 0.3), lamp=behind(build, 0.5))
    assert on_axis(build, scene) == pytest.approx(1 + 1 / (2 / 0.3 + 1 / 1.5), abs=1e-3)
    assert on_axis(build, scene, "opl") == pytest.approx(2.5, abs=1e-3)


@pytest.mark.parametrize("radius", [0.6, 1.6])
def test_concave_mirror_in_front_of_and_behind_the_viewer(build, radius):
    """1/s' = 2/R - 1/s, object at 1.5 m from the mirror (the sphere's far side lies behind the emitter)."""
    half_space = build.T().translate([0, 0, -1 + radius]).scale(radius)
    mirror = {"type": "sphere", "to_world": half_space, "flip_normals": True, **MIRROR}
    # the ray starts inside the sphere; the lamp stands in the light's way after the mirror
    place = 0.15 if radius == 0.6 else 0.5
    scene = build.scene(mirror=mirror, lamp=behind(build, place, half=0.05))
    image = 1 / (2 / radius - 1 / (1 + place))
    assert on_axis(build, scene) == pytest.approx(1 - image, abs=5e-3)


def test_slab_brings_things_nearer(build):
    """Apparent shift t (1 - 1/n); the optical path says t (n - 1) the other way."""
    slab = {"type": "cube", "to_world": build.T().translate([0, 0, -0.7]).scale([0.2, 0.2, 0.05]), **GLASS}
    scene = build.scene(slab=slab, far=build.plane(2.0, build.emissive(build.grey(1.0))))
    through = 3  # both surfaces transmit
    assert on_axis(build, scene, branch=through) == pytest.approx(2 - 0.1 * (1 - 1 / 1.5), abs=2e-3)
    assert on_axis(build, scene, "opl", branch=through) == pytest.approx(2 + 0.1 * 0.5, abs=2e-3)


def test_ball_lens_has_its_paraxial_focus(build):
    """Two refractions at a ball of radius r and index n, n = 1.5: image of a plane behind it."""
    radius, index, near, gap = 0.1, 1.5, 0.7, 0.02
    ball = {"type": "sphere", "center": [0, 0, -near - radius], "radius": radius, **GLASS}
    scene = build.scene(ball=ball, far=build.plane(near + 2 * radius + gap, build.emissive(build.grey(1.0))))
    # vergence from the object through both surfaces towards the viewer
    vergence = -1 / gap + (index - 1) / radius
    distance = 1 / vergence * index
    vergence = index / (distance - 2 * radius) + (index - 1) / radius
    image = near - 1 / vergence
    assert on_axis(build, scene, branch=3) == pytest.approx(image, abs=5e-3)


def views(scene, camera, hologram, focus, spp=128, **settings):
    """PSNR and brightness ratio at each focus depth."""
    field = engine.render(scene, camera, hologram, engine.Settings(frames=24, **settings))
    assert np.isfinite(field.data).all()
    pictures = engine.reconstruct(field, focus)
    truth = engine.reference(scene, camera, hologram, focus, spp=spp, near=field.near)
    inner = slice(25, -25)
    ratios = [p[inner, inner].mean() / t[inner, inner].mean() for p, t in zip(pictures, truth, strict=True)]
    return [engine.psnr(p, t, 25) for p, t in zip(pictures, truth, strict=True)], ratios


def test_flat_mirror(build, camera, small):
    """A plane 0.9 m beside a mirror at 0.6 m, turned by 45 degrees, appears at 1.5 m."""
    T = build.T
    side = {
        "type": "rectangle",
        "to_world": T().translate([0.9, 0, -0.6]).rotate([0, 1, 0], -90).scale(0.3),
        **build.emissive(build.texture(64, 1)),
    }
    mirror = {
        "type": "rectangle",
        "to_world": T().translate([0, 0, -0.6]).rotate([0, 1, 0], 45).scale(0.3),
        **MIRROR,
    }
    scene = build.scene(side=side, mirror=mirror)
    values, ratios = views(scene, camera, small, [0.6, 1.0, 1.5])
    assert min(values) >= 21
    assert ratios == pytest.approx([1, 1, 1], abs=0.03)


def test_convex_mirror_beats_the_optical_path(build, camera, small):
    scene = build.scene(mirror=sphere_mirror(build, 0.3), lamp=behind(build, 0.5, texture=128))
    image = 1 + 1 / (2 / 0.3 + 1 / 1.5)
    (ours,), ratios = views(scene, camera, small, [image])
    assert ratios == pytest.approx([1], abs=0.03)
    (paper,), _ = views(scene, camera, small, [image], virtual_image="opl")
    assert ours >= 21
    assert ours >= paper + 6


def test_glass_ball_in_front_of_a_wall(build, camera, small):
    ball = {"type": "sphere", "center": [0, 0, -0.7], "radius": 0.07, **GLASS}
    scene = build.scene(ball=ball, far=build.plane(2.0, build.emissive(build.texture(256, 1))))
    ours, ratios = views(scene, camera, small, [0.6, 2.0])
    paper, _ = views(scene, camera, small, [0.6, 2.0], virtual_image="opl")
    assert min(ours) >= 19
    assert all(a > b + 3 for a, b in zip(ours, paper, strict=True))
    assert ratios == pytest.approx([1, 1], abs=0.03)


def test_pane_adds_reflection_and_view_without_interference(build, camera, small):
    """Both branches land on the same plane: their intensities add."""
    T = build.T
    pane = {
        "type": "rectangle",
        "to_world": T().translate([0, 0, -0.5]).rotate([0, 1, 0], 45).scale(0.3),
        "bsdf": {"type": "thindielectric", "int_ior": 1.9},
    }
    side = {
        "type": "rectangle",
        "to_world": T().translate([0.5, 0, -0.5]).rotate([0, 1, 0], -90).scale(0.3),
        **build.emissive(build.grey(2.0)),
    }
    scene = build.scene(pane=pane, side=side, far=build.plane(1.0, build.emissive(build.grey(0.5))))
    _, ratios = views(scene, camera, small, [1.0, 0.7])
    assert ratios == pytest.approx([1, 1], abs=0.03)


def test_diffuse_scenes_carry_no_chain_and_chains_can_be_left_out(build, camera, small):
    assert engine.plan(build.two_planes(build.diffuse), camera, small).chain == 0
    scene = build.scene(mirror=sphere_mirror(build, 0.3), lamp=behind(build, 0.5))
    assert engine.plan(scene, camera, small).chain > 0
    without = engine.plan(scene, camera, small, engine.Settings(most_hits=0))
    assert without.chain == 0 and any("mirror" in w for w in without.warnings)


def test_mirrors_facing_each_other_end(build, camera):
    """A chain that never ends is black, not endless."""
    front = build.plane(1.0, MIRROR)
    back = {
        "type": "rectangle",
        "to_world": build.T().translate([0, 0, 0.2]).rotate([0, 1, 0], 180),
        **MIRROR,
    }
    hologram = engine.Hologram(48, 48, 8e-6, (GREEN,), 0.5e-3, 2e-3)
    field = engine.render(build.scene(front=front, back=back), camera, hologram, engine.Settings(frames=2))
    assert np.abs(field.data).max() == 0


def test_sky_in_a_ball_is_at_its_focal_point(build):
    """The image of infinity in a convex mirror lies R/2 behind its vertex."""
    from holopath_addon.engine.chains import SpecularChains

    mi = build.mi
    scene = build.scene(ball=sphere_mirror(build, 0.3), sky={"type": "constant", "radiance": build.grey(0.5)})
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([2e-4], [1e-4], [-1.0]))
    view = SpecularChains("curvature", 8).view(scene, ray, mi.UInt32([0]))
    assert bool(np.asarray(view.hit)[0]) and bool(np.broadcast_to(view.exists, 1)[0])
    assert float(view.distance[0]) == pytest.approx(1.15, abs=2e-3)
