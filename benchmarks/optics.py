"""Mirrors, lenses and gloss against Mitsuba's thin-lens camera: both virtual images, three focus depths each."""

import math
import time
from itertools import islice

import numpy as np
import scipy.ndimage

from holopath_addon import engine
from holopath_addon.engine.mapping import DepthMapping

from .parts import joined
from .scenes import FOV, GREEN, Scenes

PIXELS = 256
BORDER = 25  # of those


def scenes():
    """Name, scene and focus depths of each arrangement."""
    s = Scenes()
    t = s.T
    conductor = {"bsdf": {"type": "conductor"}}
    glass = {"bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}}
    wall = s.plane(2.0, s.emissive(s.texture(256, 1)))

    def behind(place, half):
        turn = t().translate([0, 0, place]).rotate([0, 1, 0], 180).scale([half, half, 1])
        return {"type": "rectangle", "to_world": turn, **s.emissive(s.texture(128, 1))}

    side = t().translate([0.9, 0, -0.6]).rotate([0, 1, 0], -90).scale(0.3)
    turned = t().translate([0, 0, -0.6]).rotate([0, 1, 0], 45).scale(0.3)
    yield (
        "flat mirror",
        s.scene(
            side={"type": "rectangle", "to_world": side, **s.emissive(s.texture(128, 1))},
            mirror={"type": "rectangle", "to_world": turned, **conductor},
        ),
        (0.6, 1.0, 1.5),
    )
    convex = {"type": "sphere", "center": [0, 0, -1.3], "radius": 0.3, **conductor}
    yield "convex mirror, R = 0.3 m", s.scene(mirror=convex, lamp=behind(0.5, 1.0)), (1.0, 1.136, 1.4)
    hollow = _concave(s, radius=0.6, aperture=0.3, vertex=1.0)
    yield "concave mirror, R = 0.6 m", s.scene(mirror=hollow, lamp=behind(0.15, 0.1)), (0.55, 0.594, 0.7)
    cube = t().translate([0, 0, -0.7]).rotate([0, 1, 0], 20).scale([0.15, 0.15, 0.05])
    yield "glass slab", s.scene(slab={"type": "cube", "to_world": cube, **glass}, wall=wall), (0.7, 1.2, 1.96)
    ball = {"type": "sphere", "center": [0, 0, -0.7], "radius": 0.07, **glass}
    yield "glass ball", s.scene(ball=ball, wall=wall), (0.6, 0.9, 2.0)
    front, back, rim = _plano_convex(s)
    yield "plano-convex lens", s.scene(front=front, back=back, rim=rim, wall=wall), (0.6, 1.0, 2.0)


def _disc(radius, rings, spokes):
    """Vertices, shape (n, 2), and triangles of a disc."""
    angle = np.linspace(0, 2 * np.pi, spokes, endpoint=False)
    r = np.linspace(0, radius, rings)[1:]
    grid = np.stack([np.outer(r, np.cos(angle)), np.outer(r, np.sin(angle))], -1).reshape(-1, 2)
    faces = [(0, 1 + k, 1 + (k + 1) % spokes) for k in range(spokes)]
    for ring in range(rings - 2):
        for k in range(spokes):
            a, b = 1 + ring * spokes + k, 1 + ring * spokes + (k + 1) % spokes
            faces += [(a, a + spokes, b + spokes), (a, b + spokes, b)]
    return np.concatenate([[[0, 0]], grid]), np.array(faces)


def _mesh(s, name, bsdf, vertices, triangles, normals=None):
    properties = s.mi.Properties()
    properties["bsdf"] = s.mi.load_dict(bsdf)
    mesh = s.mi.Mesh(
        name, len(vertices), len(triangles), has_vertex_normals=normals is not None, props=properties
    )
    parameters = s.mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = triangles.astype(np.uint32).ravel()
    if normals is not None:
        parameters["vertex_normals"] = normals.astype(np.float32).ravel()
    parameters.update()
    return mesh


def _concave(s, radius, aperture, vertex, rings=96, spokes=192):
    """A bowl that mirrors, as a mesh with exact normals, open to the viewer; `vertex` is the depth of its middle."""
    xy, faces = _disc(aperture, rings, spokes)
    height = np.sqrt(radius**2 - (xy**2).sum(1))
    points = np.column_stack([xy, radius - vertex - height])
    normals = np.column_stack([-xy, height]) / radius
    return _mesh(s, "mirror", {"type": "conductor"}, points, faces, normals)


def _plano_convex(s, radius=0.5, aperture=0.12, vertex=0.6, rings=96, spokes=192):
    """A lens as a mesh with exact normals: flat towards the viewer, its curved back at `vertex` + sag."""
    xy, faces = _disc(aperture, rings, spokes)
    sag = np.sqrt(radius**2 - (xy**2).sum(1)) - (radius**2 - aperture**2) ** 0.5
    back = np.column_stack([xy, -vertex - 0.01 - sag])
    front = np.column_stack([xy, np.full(len(xy), -vertex)])
    edge = 1 + (rings - 2) * spokes + np.arange(spokes)
    after = np.roll(edge, -1)
    n = len(xy)
    rim = np.concatenate(
        [np.column_stack([edge, edge + n, after + n]), np.column_stack([edge, after + n, after])]
    )
    normals_back = np.column_stack([xy, -np.sqrt(radius**2 - (xy**2).sum(1))]) / radius
    parts = {
        "front": (front, faces, np.tile([0.0, 0, 1], (n, 1))),
        "back": (back, faces[:, ::-1], normals_back),
        "rim": (np.concatenate([front, back]), rim, None),
    }
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    return [_mesh(s, name, glass, *part) for name, part in parts.items()]


def measured(scene, focus, options, spp=128, pixels=PIXELS):
    """For each of a few options, PSNR and brightness ratio at each focus, and seconds of the second render."""
    camera, hologram = engine.Camera(np.eye(4), FOV), _hologram(pixels)
    border = round(BORDER * pixels / PIXELS)
    near = engine.plan(scene, camera, hologram, engine.Settings(frames=24)).near
    truth = engine.reference(scene, camera, hologram, focus, spp=spp, near=near)
    inner = slice(border, -border)
    for option in options:
        settings = engine.Settings(frames=24, **option)
        plan = engine.plan(scene, camera, hologram, settings)
        engine.render(scene, camera, hologram, settings, plan)
        start = time.perf_counter()
        field = engine.render(scene, camera, hologram, settings, plan)
        seconds = time.perf_counter() - start
        pairs = list(zip(engine.reconstruct(field, focus), truth, strict=True))
        values = [engine.psnr(picture, t, border) for picture, t in pairs]
        ratios = [picture[inner, inner].mean() / t[inner, inner].mean() for picture, t in pairs]
        cells = "  ".join(f"{v:5.1f} ({r:.2f})" for v, r in zip(values, ratios, strict=True))
        yield f"{cells}   {seconds:5.1f} s"


def gloss():
    """A rough metal ball under a lamp, roughness as in Blender (alpha is its square)."""
    s = Scenes()
    place = s.T().look_at(origin=[0.8, 1.0, 0.3], target=[0, 0, -0.8], up=[0, 1, 0]).scale(0.15)
    for roughness in (0.0, 0.05, 0.1, 0.2, 0.4, 0.8):
        metal = (
            {"type": "roughconductor", "alpha": max(roughness**2, 1e-4)}
            if roughness
            else {"type": "conductor"}
        )
        yield (
            roughness,
            s.scene(
                ball={"type": "sphere", "center": [0, 0, -0.8], "radius": 0.12, "bsdf": metal},
                wall=s.plane(2.0, s.diffuse(s.texture(256, 1))),
                lamp={"type": "rectangle", "to_world": place, **s.emissive(s.gray(30.0))},
                sky={"type": "constant", "radiance": s.gray(0.2)},
            ),
        )


def displacement(picture, truth, edge=30):
    """Pixels to the right by which a picture lies off the truth, least squares over contrast and shift."""
    inner = slice(edge, -edge)
    a, t = (scipy.ndimage.gaussian_filter(p[..., 0].astype(float), 2)[inner, inner] for p in (picture, truth))
    model = np.stack([np.ones_like(t), t, -np.gradient(t, axis=1)], -1).reshape(-1, 3)
    _, contrast, moved = np.linalg.lstsq(model, a.ravel(), rcond=None)[0]
    return moved / contrast


def _hologram(pixels):
    size = pixels / PIXELS
    return engine.Hologram(pixels, pixels, 8e-6, (GREEN,), 1e-3 * size, 6e-3 * size)


def highlights(roughness, seeds=4, pixels=PIXELS):
    """Error of the disparity between views half a degree to either side, for each of a few seeds, and the disparity."""
    camera, hologram = engine.Camera(np.eye(4), FOV), _hologram(pixels)
    scene = Scenes().glossy_dome(roughness)
    plan = engine.plan(scene, camera, hologram, engine.Settings(frames=24))
    mapping = DepthMapping.of(hologram, camera, plan.near)
    radius = mapping.pupil_radius(hologram.max_slope(GREEN))
    aside = math.tan(math.radians(0.5)) * mapping.beta / mapping.focal
    pupils = [engine.Pupil(x, 0, 0.6 * radius) for x in (-aside, aside)]
    views = [engine.reference(scene, camera, hologram, [0.81], p, spp=256, near=plan.near)[0] for p in pupils]
    errors, edge = [], round(30 * pixels / PIXELS)
    for seed in range(seeds):
        settings = engine.Settings(frames=24, phase_field="random", seed=seed)
        field = engine.render(scene, camera, hologram, settings, plan)
        pictures = [engine.reconstruct(field, [0.81], pupil)[0] for pupil in pupils]
        left, right = (displacement(p, v, edge) for p, v in zip(pictures, views, strict=True))
        errors.append(right - left)
    return plan, errors, displacement(views[1], views[0], edge)


def run(pixels=PIXELS, scenes=None):
    """All three tables as text; each of so many scenes, or of all."""
    tables = {"mirrors": mirrors, "gloss": rough, "highlights": disparities}
    return joined({name: lambda table=table: table(pixels, scenes) for name, table in tables.items()})


def mirrors(pixels, count):
    """Pictures of mirrors and lenses."""
    random = {"phase_field": "random"}
    lines = [
        f"mirrors and lenses: {pixels} x {pixels}, 8 µm, M = 24; PSNR in dB (brightness ratio) at three focus depths"
    ]
    for name, scene, focus in islice(scenes(), count):
        kinds = ("default", "random", "random, opl")
        options = ({}, random, random | {"virtual_image": "opl"})
        for kind, cells in zip(kinds, measured(scene, focus, options, pixels=pixels), strict=True):
            lines.append(f"  {name:26s} {kind:12s} {cells}")
    return "\n".join(lines)


def rough(pixels, count):
    """Pictures of a rough metal ball."""
    lines = ["gloss: metal ball of roughness r, lamp-lit; focus 0.7, 0.9, 2 m"]
    options = {"default": {}, "random": {"phase_field": "random"}}
    for roughness, scene in islice(gloss(), count):
        rows = measured(scene, (0.7, 0.9, 2.0), options.values(), 512, pixels)
        for kind, cells in zip(options, rows, strict=True):
            lines.append(f"  r = {roughness:<23g} {kind:12s} {cells}")
    return "\n".join(lines)


def disparities(pixels, count):
    """Where highlights lie in two views."""
    lines = [
        "highlights of a dome that mirrors 25 lamps: disparity of views at -0.5 and +0.5 degrees, pixels; 4 seeds"
    ]
    for roughness in (0.05, 0.1, 0.2, 0.4, 0.8)[:count]:
        plan, errors, disparity = highlights(roughness, pixels=pixels)
        cells = " ".join(f"{error:+.2f}" for error in errors)
        lines.append(
            f"  r = {roughness:<6g} {disparity:.2f}; error {np.mean(errors):+.2f} ({cells}); {plan.bins} pupil bins"
        )
    return "\n".join(lines)
