"""Images in mirrors and through glass, against paraxial optics and Mitsuba's thin-lens camera."""

from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine

GREEN = 516.5e-9
BORDER = 13  # pixels from the edge that the light of the near end, at 3 mm, misses the aperture of
MIRROR = {"bsdf": {"type": "conductor"}}
GLASS = {"bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}}


def on_axis(build, scene, virtual_image="curvature", branch=0):
    """Distance of the image that a ray near the axis sees, meters."""
    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = build.mi
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([2e-4], [1e-4], [-1.0]))
    view = SpecularChains(scene, virtual_image, 8).view(scene, ray, mi.UInt32([branch]))
    assert bool(np.broadcast_to(view.exists, 1)[0])
    return float(view.distance[0])


def behind(build, place, texture=32, half=1.0):
    """A textured emitter behind the viewer at z = `place`, facing the mirrors."""
    transform = build.T().translate([0, 0, place]).rotate([0, 1, 0], 180).scale([half, half, 1])
    return {"type": "rectangle", "to_world": transform, **build.emissive(build.texture(texture, 1))}


def sphere_mirror(build, radius):
    """Mirror with its vertex at 1 m: convex for a positive radius, concave for a negative one."""
    center = [0, 0, -1 - radius]
    if radius > 0:
        return {"type": "sphere", "center": center, "radius": radius, **MIRROR}
    # only the part of the sphere beyond the viewer may be there
    return (
        {"type": "disk", **MIRROR}
        if radius == 0
        else {"type": "sphere", "center": center, "radius": -radius, "flip_normals": True, **MIRROR}
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
    scene = build.scene(slab=slab, far=build.plane(2.0, build.emissive(build.gray(1.0))))
    through = 3  # both surfaces transmit
    assert on_axis(build, scene, branch=through) == pytest.approx(2 - 0.1 * (1 - 1 / 1.5), abs=2e-3)
    assert on_axis(build, scene, "opl", branch=through) == pytest.approx(2 + 0.1 * 0.5, abs=2e-3)


def test_ball_lens_has_its_paraxial_focus(build):
    """Two refractions at a ball of radius r and index n, n = 1.5: image of a plane behind it."""
    radius, index, near, gap = 0.1, 1.5, 0.7, 0.02
    ball = {"type": "sphere", "center": [0, 0, -near - radius], "radius": radius, **GLASS}
    scene = build.scene(ball=ball, far=build.plane(near + 2 * radius + gap, build.emissive(build.gray(1.0))))
    # vergence from the object through both surfaces towards the viewer
    vergence = -1 / gap + (index - 1) / radius
    distance = 1 / vergence * index
    vergence = index / (distance - 2 * radius) + (index - 1) / radius
    image = near - 1 / vergence
    assert on_axis(build, scene, branch=3) == pytest.approx(image, abs=5e-3)


def views(scene, camera, hologram, focus, truth=None, spp=48, **settings):
    """PSNR and brightness ratio at each focus depth; against `truth` where it is known, or Mitsuba's own is not it."""
    field = engine.render(scene, camera, hologram, engine.Settings(frames=24, **settings))
    assert np.isfinite(field.data).all()
    pictures = engine.reconstruct(field, focus)
    if truth is None:
        truth = engine.reference(scene, camera, hologram, focus, spp=spp, near=field.near)
    inner = slice(BORDER, -BORDER)
    ratios = [p[inner, inner].mean() / t[inner, inner].mean() for p, t in zip(pictures, truth, strict=True)]
    return [engine.psnr(p, t, BORDER) for p, t in zip(pictures, truth, strict=True)], ratios


@pytest.mark.slow
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
    display = replace(small, near=1.0)
    truth = engine.reference(scene, camera, display, [image], spp=48, near=1.0)
    (ours,), ratios = views(scene, camera, display, [image], truth)
    assert ratios == pytest.approx([1], abs=0.03)
    (paper,), _ = views(scene, camera, display, [image], truth, virtual_image="opl")
    assert ours >= 21
    assert ours >= paper + 6


@pytest.mark.slow
def test_glass_ball_in_front_of_a_wall(build, camera, small):
    ball = {"type": "sphere", "center": [0, 0, -0.7], "radius": 0.07, **GLASS}
    scene = build.scene(ball=ball, far=build.plane(2.0, build.emissive(build.texture(128, 1))))
    display = replace(small, near=0.6)
    truth = engine.reference(scene, camera, display, [0.6, 2.0], spp=96, near=0.6)
    ours, ratios = views(scene, camera, display, [0.6, 2.0], truth)
    paper, _ = views(scene, camera, display, [0.6, 2.0], truth, virtual_image="opl")
    assert min(ours) >= 19
    assert all(a > b + 3 for a, b in zip(ours, paper, strict=True))
    assert ratios == pytest.approx([1, 1], abs=0.03)


@pytest.mark.slow
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
        **build.emissive(build.gray(2.0)),
    }
    scene = build.scene(pane=pane, side=side, far=build.plane(1.0, build.emissive(build.gray(0.5))))
    _, ratios = views(scene, camera, small, [1.0, 0.7])
    assert ratios == pytest.approx([1, 1], abs=0.03)


def test_diffuse_scenes_carry_no_chain_and_chains_can_be_left_out(build, camera, small):
    assert engine.plan(build.two_planes(build.diffuse), camera, small).chain == 0
    scene = build.scene(mirror=sphere_mirror(build, 0.3), lamp=behind(build, 0.5))
    assert engine.plan(scene, camera, small).chain > 0
    without = engine.plan(scene, camera, small, engine.Settings(max_specular_depth=0))
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
    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = build.mi
    scene = build.scene(ball=sphere_mirror(build, 0.3), sky={"type": "constant", "radiance": build.gray(0.5)})
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([2e-4], [1e-4], [-1.0]))
    view = SpecularChains(scene, "curvature", 8).view(scene, ray, mi.UInt32([0]))
    assert bool(np.asarray(view.hit)[0]) and bool(np.broadcast_to(view.exists, 1)[0])
    assert float(view.distance[0]) == pytest.approx(1.15, abs=2e-3)


def turned(build, bsdf, angle=45):
    """A square at 0.7 m, turned about the vertical."""
    place = build.T().translate([0, 0, -0.7]).rotate([0, 1, 0], angle).scale(0.3)
    return {"type": "rectangle", "to_world": place, "bsdf": bsdf}


def beside(build, texture=64):
    """What a turned square at 0.7 m reflects: a textured emitter 0.5 m to its right."""
    place = build.T().translate([0.5, 0, -0.7]).rotate([0, 1, 0], -90).scale(0.4)
    return {"type": "rectangle", "to_world": place, **build.emissive(build.texture(texture, 1))}


def lamp(build):
    place = build.T().look_at(origin=[0.5, 2, 1], target=[0, 0, -1], up=[0, 1, 0]).scale(0.5)
    return {"type": "rectangle", "to_world": place, **build.emissive(build.gray(15.0))}


def test_flat_mirror_focuses_at_its_optical_distance(build, camera, small):
    """A dot 0.9 m beside a mirror at 0.6 m is sharpest at 1.5 m, within half a depth of focus."""

    def facing_left(x, half, radiance):
        place = build.T().translate([x, 0, -0.6]).rotate([0, 1, 0], -90).scale(half)
        return {"type": "rectangle", "to_world": place, **build.emissive(build.gray(radiance))}

    tilted = build.T().translate([0, 0, -0.6]).rotate([0, 1, 0], 45).scale(0.3)
    scene = build.scene(
        dot=facing_left(0.9, 1.5e-3, 1.0),
        ground=facing_left(0.901, 1.0, 0.01),
        frame=build.plane(0.5, build.emissive(build.gray(0.05)), 0.01, x=-0.08),
        mirror={"type": "rectangle", "to_world": tilted, **MIRROR},
    )
    field = engine.render(scene, camera, small, engine.Settings(frames=24))
    truth = float(field.mapping.depth_to_z(1.5))
    z = truth + np.linspace(-1.2e-3, 1.2e-3, 49)
    middle = slice(48, 80)
    pictures = engine.reconstruct(field, field.mapping.z_to_depth(z))[:, middle, middle, 0].astype(np.float64)
    sharpness = (pictures**2).sum((1, 2)) / pictures.sum((1, 2)) ** 2
    half_focus_depth = GREEN / small.max_slope(GREEN) ** 2
    assert abs(z[np.argmax(sharpness)] - truth) < half_focus_depth


@pytest.mark.slow
def test_plastic_shows_its_color_and_its_mirror_image(build, camera, small):
    """The reflection focuses beyond the surface, what scatters on it."""
    plastic = {"type": "plastic", "int_ior": 1.9, "diffuse_reflectance": build.texture(64, 3, 0.1, 0.5)}
    scene = build.scene(plate=turned(build, plastic), side=beside(build), lamp=lamp(build))
    assert engine.plan(scene, camera, small).splits == 1
    values, ratios = views(scene, camera, small, [0.7, 1.2])
    assert min(values) >= 20.5
    assert ratios == pytest.approx([1, 1], abs=0.03)


@pytest.mark.slow
def test_plastic_ball_before_a_wall(build, camera, small):
    plastic = {"type": "plastic", "int_ior": 1.9, "diffuse_reflectance": build.gray(0.2)}
    scene = build.scene(
        ball={"type": "sphere", "center": [0, 0, -0.9], "radius": 0.12, "bsdf": plastic},
        wall=build.plane(2.0, build.diffuse(build.texture(128, 1))),
        back=behind(build, 0.5, texture=128),
        lamp=lamp(build),
    )
    values, ratios = views(scene, camera, small, [0.83, 2.0], spp=128)
    assert min(values) >= 21
    assert ratios == pytest.approx([1, 1], abs=0.03)


@pytest.mark.slow
def test_blend_of_mirror_and_matt(build, camera, small):
    """Mitsuba's own pictures of such blends are wrong (its pull request 1681): the truth is two pictures' sum."""
    matt = {"type": "diffuse", "reflectance": build.texture(64, 3, 0.1, 0.8)}
    blend = {"type": "blendbsdf", "weight": 0.4, "first": matt, "second": {"type": "conductor"}}
    parts = {"side": beside(build), "lamp": lamp(build)}
    truth = [
        share
        * engine.reference(
            build.scene(plate=turned(build, bsdf), **parts), camera, small, [0.7, 1.2], spp=128, near=0.6
        )
        for share, bsdf in ((0.6, matt), (0.4, {"type": "conductor"}))
    ]
    hologram = replace(small, near=0.6)
    scene = build.scene(plate=turned(build, blend), **parts)
    values, ratios = views(scene, camera, hologram, [0.7, 1.2], sum(truth))
    assert min(values) >= 20.5
    assert ratios == pytest.approx([1, 1], abs=0.03)


@pytest.mark.slow
def test_half_transparent_mask(build, camera, small):
    matt = {"type": "twosided", "matt": {"type": "diffuse", "reflectance": build.texture(64, 3, 0.1, 0.8)}}
    mask = {"type": "mask", "opacity": 0.5, "matt": matt}
    scene = build.scene(
        veil=turned(build, mask, 0),
        wall=build.plane(2.0, build.diffuse(build.texture(128, 1))),
        lamp=lamp(build),
    )
    values, ratios = views(scene, camera, small, [0.7, 2.0])
    assert min(values) >= 21
    assert ratios == pytest.approx([1, 1], abs=0.03)


def test_total_internal_reflection_in_a_prism(build):
    """In at a right angle, reflected at 45 degrees, out at a right angle: all light but two Fresnel losses."""
    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = build.mi
    prism = mi.Mesh("prism", 6, 5, props=_glass(mi))
    corners = [
        (-0.1, -0.8),
        (0.1, -0.8),
        (0.1, -1.0),
    ]  # entry in front, exit to the right, hypotenuse between
    parameters = mi.traverse(prism)
    parameters["vertex_positions"] = [v for y in (-0.1, 0.1) for x, z in corners for v in (x, y, z)]
    sides = [(0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3)]
    parameters["faces"] = np.array(sides, np.uint32).ravel()
    parameters.update()
    scene = build.scene(prism=prism, side=beside(build))
    ray = mi.Ray3f(mi.Point3f([0.02], [-0.03], [0.0]), mi.Vector3f([0.0], [0.0], [-1.0]))
    view = SpecularChains(scene, "curvature", 8).view(scene, ray, mi.UInt32([3]))
    assert bool(np.asarray(view.exists)[0])
    assert float(view.weight.x[0]) == pytest.approx(0.96**2, abs=2e-3)
    inside = 0.12 + 0.08  # to the hypotenuse, and on to the exit
    outside = 0.8 + 0.4
    assert float(view.distance[0]) == pytest.approx(outside + inside / 1.5, abs=2e-3)
    assert float(view.path[0]) == pytest.approx(outside + inside * 1.5, abs=2e-3)


def _glass(mi):
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    return properties


def test_touching_media_have_one_surface_between_them(build):
    """Air, glass, water, air: each layer brings what lies behind nearer by t (1 - 1/n)."""
    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = build.mi

    def surface(depth, inside, outside):
        return build.plane(depth, {"bsdf": {"type": "dielectric", "int_ior": inside, "ext_ior": outside}})

    scene = build.scene(
        front=surface(0.5, 1.5, 1.0),  # a rectangle's inside is behind its normal, here the far side
        between=surface(0.6, 1.33, 1.5),
        back=surface(0.8, 1.0, 1.33),
        far=build.plane(2.0, build.emissive(build.gray(1.0))),
    )
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([2e-4], [1e-4], [-1.0]))
    view = SpecularChains(scene, "curvature", 8, splits=0).view(scene, ray, mi.UInt32([0]))
    shift = 0.1 * (1 - 1 / 1.5) + 0.2 * (1 - 1 / 1.33)
    share = np.prod([1 - ((a - b) / (a + b)) ** 2 for a, b in ((1, 1.5), (1.5, 1.33), (1.33, 1))])
    assert float(view.distance[0]) == pytest.approx(2 - shift, abs=2e-3)
    assert float(view.weight.x[0]) == pytest.approx(share, abs=2e-3)


def test_back_faces_are_black(build, camera):
    """One-sided mirrors and matt surfaces show nothing from behind, and hide what is behind them."""
    hologram = engine.Hologram(64, 64, 8e-6, (GREEN,), 0.3e-3, 1.5e-3)
    for bsdf in ({"type": "conductor"}, {"type": "plastic"}, {"type": "diffuse"}):
        away = {
            "type": "rectangle",
            "to_world": build.T().translate([0, 0, -0.7]).rotate([0, 1, 0], 180).scale(0.05),
        }
        scene = build.scene(
            away=away | {"bsdf": bsdf}, wall=build.plane(2.0, build.emissive(build.gray(1.0)), 1.0)
        )
        field = engine.render(scene, camera, hologram, engine.Settings(frames=8))
        picture = engine.reconstruct(field, [0.7])[0, ..., 0]
        assert picture[24:40, 24:40].mean() < 0.02
        assert picture[16:-16, 10:14].mean() > 0.5


def rough(alpha, **colors):
    return {"bsdf": {"type": "roughconductor", "distribution": "ggx", "alpha": alpha, **colors}}


def seen_on_axis(build, scene, virtual_image="curvature", splits=0, branch=0, pupil=0.016):
    """The `ImagePoint` of a ray near the axis."""
    import drjit as dr

    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = build.mi
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([2e-4], [1e-4], [-1.0]))
    view = SpecularChains(scene, virtual_image, 8, splits, pupil=pupil).view(scene, ray, mi.UInt32([branch]))
    dr.eval(view)
    return view


@pytest.mark.parametrize("virtual_image", ["curvature", "opl"])
def test_light_of_a_rough_mirror_moves_from_its_image_to_the_surface(build, virtual_image):
    """The broader the lobe the nearer to the surface at 0.7 m, in dioptres, from the image at 1.2 m on; the radiance is
    the surface's own at any roughness.
    """
    found = []
    for alpha in (1e-4, 0.004, 0.006, 0.008, 0.01, 0.05):
        view = seen_on_axis(
            build, build.scene(plate=turned(build, **rough(alpha)), side=beside(build)), virtual_image
        )
        assert bool(np.broadcast_to(view.exists, 1)[0])
        assert float(np.broadcast_to(view.surface.t, 1)[0]) == pytest.approx(0.7, abs=2e-3)
        found.append(1 / float(view.distance[0]))
    assert found[0] == pytest.approx(1 / 1.2, abs=2e-3)
    assert found[-1] == pytest.approx(1 / 0.7, abs=2e-3)
    assert all(a <= b + 1e-4 for a, b in zip(found[:-1], found[1:], strict=True)) and found[2] < found[4]


def test_rough_convex_mirror_shows_the_mirror_equations_image(build):
    ball = sphere_mirror(build, 0.3) | rough(5e-4)
    view = seen_on_axis(build, build.scene(mirror=ball, lamp=behind(build, 0.5)))
    assert float(view.distance[0]) == pytest.approx(1 + 1 / (2 / 0.3 + 1 / 1.5), abs=1e-3)


def test_rough_glass_brings_what_is_behind_nearer(build):
    """By t (1 - 1/n), as clear glass does."""
    glass = {"type": "roughdielectric", "alpha": 2e-4, "int_ior": 1.5, "ext_ior": 1.0}
    slab = build.box([-0.3, -0.3, -0.8], [0.3, 0.3, -0.6], {"bsdf": glass})
    view = seen_on_axis(build, build.scene(slab=slab, far=build.plane(2.0, build.emissive(build.gray(1.0)))))
    assert float(view.distance[0]) == pytest.approx(2 - 0.2 / 3, abs=2e-3)
    assert float(view.surface.t[0]) == pytest.approx(0.6, abs=2e-3)


def test_rough_coat_and_what_it_covers_are_two_branches(build):
    """Their light adds up to that of the whole surface."""
    from holopath_addon.engine.light.path_tracer import PathTracer

    mi = build.mi
    plastic = {"type": "roughplastic", "alpha": 6e-3, "int_ior": 1.9, "diffuse_reflectance": build.gray(0.4)}
    scene = build.scene(plate=turned(build, plastic), side=beside(build), lamp=lamp(build))
    views = [seen_on_axis(build, scene, splits=1, branch=branch) for branch in (0, 1)]
    assert float(np.broadcast_to(views[0].distance, 1)[0]) == pytest.approx(0.7, abs=2e-3)
    assert float(views[1].distance[0]) == pytest.approx(1.2, abs=2e-3)

    def light(view, parts):
        import drjit as dr

        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(1, 1 << 16)
        point = replace(view, whole=mi.Bool(True), parts=parts)
        found = PathTracer(4).radiance(scene, sampler, point)
        return np.array([float(dr.mean(channel)[0]) for channel in found])

    whole = light(views[0], None)
    below, coat = (light(view, view.parts) for view in views)
    share = np.array([float(np.broadcast_to(value, 1)[0]) for value in (views[1].weight / views[1].color)])
    assert below + share * coat == pytest.approx(whole, rel=0.03)
