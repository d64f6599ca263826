"""Edges of scenes: where surfaces, mirrors, lamps and numbers lie as models break."""

import math
from functools import cache

import numpy as np
import scipy.fft

from holopath_addon import engine

from ..scenes import FOV, GREEN, Scenes
from .sweep import Sweep

FRAMES = 8
SPP = 96  # of the reference
GLASS = {"bsdf": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}}
MIRROR = {"bsdf": {"type": "conductor"}}


def camera_at(position=(0, 0, 0)):
    """The camera of these scenes: looks along -z, 20 degrees wide."""
    to_world = np.eye(4)
    to_world[:3, 3] = position
    return engine.Camera(to_world, FOV)


def hologram_of(near=None, volume=(1e-3, 6e-3), pixels=128, pitch=8e-6):
    """A green hologram, its volume near the SLM as so small an aperture needs; `near` in the world, meters."""
    return engine.Hologram(pixels, pixels, pitch, (GREEN,), *volume, near=near)


def border_of(field, focus):
    """Pixels from the edge that the light of pictures at focus depths has partly missed the aperture of."""
    z = np.abs(field.mapping.depth_to_z(list(focus))).max()
    return math.ceil(field.hologram.max_slope(GREEN) * float(z) / field.hologram.pitch)


def pictures_of(scene, focus, camera=None, hologram=None, truth=None, spp=SPP, **settings):
    """Pictures and truths at focus depths, without the borders whose light the aperture cuts; and the field.

    `truth` are pictures instead of those of Mitsuba's thin lens.
    """
    camera, hologram = camera or camera_at(), hologram or hologram_of()
    chosen = engine.Settings(**{"frames": FRAMES, "method": "full"} | settings)
    field = engine.render(scene, camera, hologram, chosen)
    pictures = engine.reconstruct(field, focus)
    if truth is None:
        truth = engine.reference(
            scene, camera, hologram, focus, spp=spp, near=field.near, max_depth=chosen.max_depth
        )
    border = border_of(field, focus)
    inner = slice(border, -border or None)
    return pictures[:, inner, inner], truth[:, inner, inner], field


def against(pictures, truth, field=None):
    """Worst PSNR in dB of pictures at several focus depths, and the brightness ratio farthest from one."""
    ratios = [float(p.mean() / t.mean()) for p, t in zip(pictures, truth, strict=True)]
    return {
        "psnr": min(engine.psnr(p, t) for p, t in zip(pictures, truth, strict=True)),
        "brightness": max(ratios, key=lambda ratio: abs(math.log(max(ratio, 1e-9)))),
    }


def depth_at(z, near=0.5, volume=(1e-3, 6e-3)):
    """World depth in meters at a distance from the SLM in meters."""
    return near * (volume[1] - volume[0]) / (z - volume[0])


def through_the_plane(dz):
    """A textured plane `dz` mm before a recording plane at 4 mm."""
    s, depth = Scenes(), depth_at(4e-3 + dz * 1e-3)
    scene = s.scene(plane=s.plane(depth, s.emissive(s.texture(128, 1))))
    return against(*pictures_of(scene, [depth], hologram=hologram_of(0.5), wrp=4e-3))


def across_the_plane(wrp):
    """A plane turned by 60 degrees that lies at 2.6 to 4.6 mm, and the recording plane at `wrp` mm."""
    s = Scenes()
    scene = s.scene(plane=s.plane(1.0, s.emissive(s.texture(256, 3)), 0.8, 0.4, slant=60))
    pictures, truth, _ = pictures_of(scene, [1.0], hologram=hologram_of(0.5), wrp=wrp * 1e-3)
    strips = [
        (p.mean() / t.mean())
        for p, t in zip(np.array_split(pictures, 6, 2), np.array_split(truth, 6, 2), strict=True)
    ]
    return against(pictures, truth) | {"least bright strip": min(strips), "brightest strip": max(strips)}


def in_range(millimeters):
    """Planes at both ends of a volume around the SLM, a pixel pitch of 32 µm: each half in its own focus."""
    s, volume = Scenes(), (-0.5e-3 * millimeters, 0.5e-3 * millimeters)
    hologram = hologram_of(0.5, volume, pitch=32e-6)
    half = 0.5 * math.tan(FOV / 2)
    scene = s.scene(
        far=s.plane(2.0, s.emissive(s.texture(128, 1))),
        near=s.plane(0.5, s.emissive(s.texture(128, 2)), 0.5 * half, 1.3 * half, x=-0.5 * half),
    )
    pictures, truth, field = pictures_of(scene, [0.5, 2.0], hologram=hologram)
    middle = pictures.shape[2] // 2
    stitched = [np.concatenate([p[0, :, :middle], p[1, :, middle:]], axis=1)[None] for p in (pictures, truth)]
    return against(*stitched) | {"rays": field.plan["rays_per_pixel"]}


def rays_for(millimeters):
    """The plan of such a scene for one recording plane, at 8 µm and 256 x 256 pixels."""
    s, volume = Scenes(), (-0.5e-3 * millimeters, 0.5e-3 * millimeters)
    one = engine.Settings(planes=1)
    plan = engine.plan(s.two_planes(s.emissive), camera_at(), hologram_of(0.5, volume, pixels=256), one)
    return {"rays": plan.rays_per_pixel, "seconds": plan.seconds, "warnings": len(plan.warnings)}


def at_depth(depth):
    """A textured plane at a depth in meters, in focus; at infinity the same picture as environment."""
    s = Scenes()
    if math.isfinite(depth):
        scene = s.scene(plane=s.plane(depth, s.emissive(s.texture(128, 1))))
    else:
        blocks = np.tile(
            np.array(s.texture(128, 1)["bitmap"]), (7, 14, 1)
        )  # as large in the view as the plane's
        sky = {"type": "envmap", "bitmap": s.mi.Bitmap(blocks), "to_world": s.T().rotate([0, 1, 0], 180)}
        scene = s.scene(sky=sky)
    return against(*pictures_of(scene, [depth], hologram=hologram_of(0.5)))


def slanted(s, degrees, surface, near=0.5, far=10.0, side=64):
    """A plane through 1 m on the axis, turned about the vertical, between two depths; texture as the viewer sees it."""
    steep = math.tan(math.radians(degrees))
    tangents = 1.25 * math.tan(FOV / 2) * np.linspace(-1, 1, 2)
    if steep > 0:
        tangents = np.clip(tangents, (1 - 1 / near) / steep, (1 - 1 / far) / steep)
    v, u = np.mgrid[0 : side + 1, 0 : side + 1] / side
    across = tangents[0] + (tangents[1] - tangents[0]) * u
    depth = 1 / (1 - across * steep)
    upward = 1.25 * math.tan(FOV / 2) * (2 * v - 1)
    return s.mesh(np.stack([across * depth, upward * depth, -depth], axis=-1), surface)


def turned_by(degrees):
    """A plane that turns until it is seen edge on: between walls at its ends, and alone for its brightness."""
    s, half = Scenes(), 0.5 * 1.25 * math.tan(FOV / 2)
    edge = -0.5 / max(math.tan(math.radians(degrees)), 1e-9)  # of the near wall, which the plane begins at
    alone = s.scene(plane=slanted(s, degrees, s.emissive(s.gray(1.0))))
    textured = s.scene(
        plane=slanted(s, degrees, s.emissive(s.texture(128, 3))),
        wall=s.plane(10.0, s.emissive(s.texture(128, 1))),
        near=s.plane(0.5, s.emissive(s.texture(128, 2)), half, half, x=edge - half),
    )
    hologram = hologram_of(0.5, (1e-3, 1.5e-3))  # its pupil is 6 mm wide
    figures = against(*pictures_of(textured, [1.0], hologram=hologram))
    picture, truth, _ = pictures_of(alone, [1.0], hologram=hologram)
    return figures | {"brightness": float(picture.mean() / truth.mean())}


def dish(s, curvature, surface, depth=1.0, half=0.3, side=64):
    """A spherical surface at a depth, hollow towards the viewer for a positive curvature 1/R, with exact normals."""
    v, u = np.mgrid[0 : side + 1, 0 : side + 1] / side * 2 - 1
    x, y = half * u, half * v
    squared = x * x + y * y
    height = np.sqrt(1 - curvature**2 * squared)
    sag = curvature * squared / (1 + height)
    normals = np.stack([-curvature * x, -curvature * y, height], axis=-1)
    return s.mesh(np.stack([x, y, sag - depth], axis=-1), surface, normals)


def behind(s, place, half=1.0, cells=128):
    """A textured emitter behind the viewer at z = `place`, facing the mirrors."""
    transform = s.T().translate([0, 0, place]).rotate([0, 1, 0], 180).scale([half, half, 1])
    return {"type": "rectangle", "to_world": transform, **s.emissive(s.texture(cells, 1))}


def on_axis(s, scene, branch=0, aside=(2e-3, 1e-3)):
    """The `ImagePoint` of a ray on the axis, or near it."""
    from holopath_addon.engine.scene.specular_chains import SpecularChains

    mi = s.mi
    ray = mi.Ray3f(mi.Point3f([0.0], [0.0], [0.0]), mi.Vector3f([aside[0]], [aside[1]], [-1.0]))
    return SpecularChains(scene, "curvature", 8).view(scene, ray, mi.UInt32([branch]))


def image_in_mirror(power):
    """A scene with a mirror of a power 2/R in dioptres that images a plane 1.5 m away from it, in focus at 2/3
    dioptres; and where its image is, in dioptres, with the error.
    """
    s = Scenes()
    scene = s.scene(mirror=dish(s, power / 2, MIRROR), lamp=behind(s, 0.5))
    bundle = power - 1 / 1.5  # vergence of the light at the mirror
    found = 1 / float(on_axis(s, scene).distance[0])
    return scene, {"image": found, "error": found - bundle / (bundle - 1)}


def mirrored(power):
    """That mirror's pictures."""
    scene, image = image_in_mirror(power)
    # a volume through which fields without speckle reach from the farthest image
    return against(*pictures_of(scene, [1.0, math.inf], hologram=hologram_of(0.8, (1e-3, 4e-3)))) | image


def image_in_lens(distance):
    """A scene with a plane in meters behind a plano-convex lens of glass, which is in its focus at 1 m; and where its
    image is, in dioptres, with the error.
    """
    s, curvature, index, near, thick = Scenes(), 2.0, 1.5, 0.6, 0.02
    into = {"bsdf": {"type": "dielectric", "int_ior": index, "ext_ior": 1.0}}
    out = {"bsdf": {"type": "dielectric", "int_ior": 1.0, "ext_ior": index}}
    wide = math.tan(FOV / 2) * (near + thick + distance)
    scene = s.scene(
        front=s.plane(near, into, 0.2),
        back=dish(s, curvature, out, near + thick, 0.2),
        wall=s.plane(near + thick + distance, s.emissive(s.texture(128, 1)), 1.3 * wide),
    )
    inside = (index - 1) * curvature - 1 / distance
    vergence = inside / (1 - thick / index * inside)
    found = 1 / float(on_axis(s, scene, branch=3).distance[0])
    return scene, {"image": found, "error": found - vergence / (near * vergence - 1)}


def through_a_lens(distance):
    """Pictures of that plane."""
    scene, image = image_in_lens(distance)
    return against(*pictures_of(scene, [0.6, 2.0], hologram=hologram_of(0.5))) | image


def stripes(s, seed):
    """Horizontal stripes as a texture: the same picture however often it is mirrored sideways."""
    picture = np.array(s.texture(128, seed)["bitmap"], copy=True)
    picture[:] = picture[:, :1]
    return {"type": "bitmap", "bitmap": s.mi.Bitmap(picture), "raw": True}


def corridor(hits):
    """Stripes at 2 m at the end of two facing mirrors, in which the edges of the view are reflected `hits` times."""
    s, T = Scenes(), Scenes().T
    half = 2 * math.tan(FOV / 2) / (2 * hits - 1) if hits else 1.0
    walls = {
        name: {
            "type": "rectangle",
            "to_world": T().translate([-side * half, 0, -1]).rotate([0, 1, 0], 90 * side).scale([1.2, 1, 1]),
            **MIRROR,
        }
        for name, side in (("left", 1), ("right", -1))
    }
    end = {
        "type": "rectangle",
        "to_world": T().translate([0, 0, -2]).scale([half, 0.5, 1]),
        **s.emissive(stripes(s, 1)),
    }
    scene = s.scene(end=end, **walls)
    return against(
        *pictures_of(
            scene, [2.0], hologram=hologram_of(0.05), max_specular_depth=hits + 1, max_depth=hits + 3
        )
    )


def panes(surfaces):
    """A wall at 2 m behind so many surfaces of glass, in focus: behind an odd number it lies nearer, in glass."""
    s = Scenes()
    stack, image = {}, 0.6
    for number in range(surfaces):
        inside, outside = (1.5, 1.0) if number % 2 == 0 else (1.0, 1.5)
        glass = {"bsdf": {"type": "dielectric", "int_ior": inside, "ext_ior": outside}}
        place = 0.6 + 0.01 * number
        stack[f"surface_{number}"] = s.plane(place, glass, 0.3)
        image += ((2.0 if number == surfaces - 1 else place + 0.01) - place) / inside
    scene = s.scene(wall=s.plane(2.0, s.emissive(s.texture(128, 1)), 1.0), **stack)
    return against(
        *pictures_of(
            scene, [image], hologram=hologram_of(0.5), max_specular_depth=surfaces, max_depth=40, spp=256
        )
    )


def around(s, radius=3.0, cells=1024):
    """A textured emitter all round."""
    ball = {"type": "sphere", "center": [0, 0, 0], "radius": radius, "flip_normals": True}
    return ball | s.emissive(s.texture(cells, 1))


def from_within(degrees):
    """A surface of glass at 0.6 m, seen from within at an angle of incidence: total reflection from 41.8 degrees."""
    s = Scenes()
    surface = {"bsdf": {"type": "dielectric", "int_ior": 1.0, "ext_ior": 1.5}}
    scene = s.scene(
        surface=s.plane(0.6, surface, 1.5, slant=degrees),
        around=around(s),
    )
    return against(*pictures_of(scene, [0.6, 3.0], hologram=hologram_of(0.5)))


def reflectance(degrees, index=1.5):
    """Fresnel's reflectance of a surface for unpolarised light, from a medium of index 1."""
    cosine = math.cos(math.radians(degrees))
    inner = math.sqrt(1 - (math.sin(math.radians(degrees)) / index) ** 2)
    across = (cosine - index * inner) / (cosine + index * inner)
    along = (index * cosine - inner) / (index * cosine + inner)
    return (across**2 + along**2) / 2


def shares_at_a_pane(degrees):
    """A scene with a thin pane of glass at an angle of incidence, between a bright wall that it reflects and one
    behind it; and what it reflects and transmits, over Fresnel's equations.
    """
    s = Scenes()
    thin = {"bsdf": {"type": "thindielectric", "int_ior": 1.5}}
    T = s.T
    side = T().translate([2, 0, -4]).rotate([0, 1, 0], -90).scale([8, 4, 1])
    scene = s.scene(
        pane=s.plane(0.6, thin, 3.0, 1.0, slant=degrees),
        side={"type": "rectangle", "to_world": side, **s.emissive(s.texture(256, 2))},
        far=s.plane(6.0, s.emissive(s.texture(128, 1))),
        back=behind(s, 2.0, 4.0),
    )
    once = reflectance(degrees)
    both = 2 * once / (1 + once)
    weights: list = [on_axis(s, scene, branch, (0, 0)).weight for branch in (0, 1)]
    shares = [float(weight.y[0]) for weight in weights]
    return scene, {"reflected": shares[0] / both, "transmitted": shares[1] / (1 - both)}


def grazing(degrees):
    """That pane's pictures."""
    scene, shares = shares_at_a_pane(degrees)
    return against(*pictures_of(scene, [0.6, 6.0], hologram=hologram_of(0.5))) | shares


def lit_from(radius):
    """A matt plane under a ball of a radius in meters that always shines with the same power."""
    s = Scenes()
    lamp = {
        "type": "sphere",
        "center": [1.2, 2.0, 0.2],
        "radius": radius,
        **s.emissive(s.gray(3 / radius**2)),
    }
    scene = s.scene(plane=s.plane(2.0, s.diffuse(s.texture(128, 1))), lamp=lamp)
    return against(*pictures_of(scene, [2.0], hologram=hologram_of(0.5)))


def recorded(truth):
    """What a hologram can show of pictures at best: the grains' band limit spreads bright places a little."""
    shape = [2 * n for n in truth.shape[1:3]]
    fy, fx = (np.fft.fftfreq(n) for n in shape)
    spread = np.abs(np.fft.ifft2(fx[None, :] ** 2 + fy[:, None] ** 2 <= 0.25)) ** 2
    seen = scipy.fft.ifft2(scipy.fft.fft2(truth[..., 0], s=shape) * scipy.fft.fft2(spread / spread.sum()))
    return seen.real[:, : truth.shape[1], : truth.shape[2], None]


def contrast(ratio):
    """Two patches at 1 m whose radiances are `ratio` apart; what lies between has none."""
    s = Scenes()
    scene = s.scene(
        bright=s.plane(1.0, s.emissive(s.gray(1.0)), 0.03, x=-0.06),
        dark=s.plane(1.0, s.emissive(s.gray(1 / ratio)), 0.03, x=0.06),
    )
    picture, truth, _ = pictures_of(scene, [1.0], hologram=hologram_of(0.5), frames=24)
    best, size = recorded(truth), truth.shape[1]
    middle, aside, half = size / 2, 0.06 / math.tan(FOV / 2) * 64, 0.5 * 0.03 / math.tan(FOV / 2) * 64
    rows = slice(round(middle - half), round(middle + half))
    left, right = (
        (0, rows, slice(round(place - half), round(place + half)))
        for place in (middle - aside, middle + aside)
    )
    bright, dark = (picture[part].mean() / best[part].mean() for part in (left, right))
    return {
        "brightness": dark,
        "bright": bright,
        "kept": ratio * picture[right].mean() / picture[left].mean(),
    }


def lit_planes(scale=1.0, place=(0, 0, 0)):
    """A lit wall, a mirror that shows a lit picture beside it, and an emitting plane in front; scaled, then moved."""
    s = Scenes()
    to_world = s.T().translate(place).scale(scale)

    def rectangle(transform, surface):
        return {"type": "rectangle", "to_world": to_world @ transform, **surface}

    T = s.T
    lamp = T().look_at(origin=[1.5, 2, 1], target=[0, 0, -1.5], up=[0, 1, 0]).scale(0.5)
    return s.scene(
        wall=rectangle(T().translate([0, 0, -2]).scale(0.5), s.diffuse(s.texture(128, 1))),
        mirror=rectangle(T().translate([0.05, 0, -0.8]).rotate([0, 1, 0], 45).scale(0.05), MIRROR),
        beside=rectangle(
            T().translate([0.6, 0, -0.8]).rotate([0, 1, 0], -90).scale(0.3), s.emissive(s.texture(64, 3))
        ),
        front=rectangle(T().translate([-0.05, 0, -0.5]).scale(0.03), s.emissive(s.texture(64, 2))),
        lamp=rectangle(lamp, s.emissive(s.gray(20.0))),
    )


@cache
def as_it_is():
    """The truth of that scene at unit scale and the origin."""
    return engine.reference(lit_planes(), camera_at(), hologram_of(0.5), [0.5, 2.0], spp=256, near=0.5)


@cache
def same_picture(scale=1.0, place=(0, 0, 0), seed=0):
    """That scene against the truth of one of unit scale at the origin."""
    scene, camera, hologram = lit_planes(scale, place), camera_at(place), hologram_of(0.5 * scale)
    focus = [0.5 * scale, 2.0 * scale]
    return against(*pictures_of(scene, focus, camera, hologram, truth=as_it_is(), seed=seed))


def moved(meters):
    """The scene and its camera together, so far from the origin along every axis."""
    return same_picture(place=(meters, meters, -meters))


def seeded(seed):
    """The same scene with another seed."""
    return same_picture(seed=seed)


SWEEPS = [
    Sweep(
        "recording plane",
        "a plane passes through the recording plane",
        "mm before it",
        (
            -2,
            -1.5,
            -1.2,
            -1,
            -0.8,
            -0.7,
            -0.6,
            -0.5,
            -0.4,
            -0.35,
            -0.3,
            -0.27,
            -0.25,
            -0.22,
            -0.2,
            -0.17,
            -0.15,
        )
        + (
            -0.12,
            -0.1,
            -0.05,
            0,
            0.05,
            0.1,
            0.12,
            0.15,
            0.17,
            0.2,
            0.22,
            0.25,
            0.27,
            0.3,
            0.35,
            0.4,
            0.5,
            0.7,
            1,
        )
        + (1.2, 1.5, 2),
        through_the_plane,
        "nowhere: best in the plane itself, where a grain is one pixel",
        (-0.05, 0, 0.05),
    ),
    Sweep(
        "slanted through the recording plane",
        "the recording plane moves through a plane that is turned by 60 degrees",
        "mm from the SLM",
        (1, 1.5, 2, 2.5, 3, 3.25, 3.5, 3.75, 4, 4.5, 5, 6),
        across_the_plane,
        "nowhere: the plane may lie before, in or behind the scene",
        (2, 3.5, 5),
    ),
    Sweep(
        "depth range",
        "the volume grows from less than a depth of focus to a hundred millimeters, around an SLM of 32 µm",
        "mm",
        (0.1, 0.2, 0.5, 1, 2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 17, 20, 25, 30, 40, 50, 60, 70, 80, 90, 100),
        in_range,
        "nowhere; designed phases gain less the farther from focus",
        (1, 2.5),
        log=True,
    ),
    Sweep(
        "rays for a depth range",
        "the volume at 8 µm, with one recording plane, outgrows what a lattice of directions can serve",
        "mm",
        (0.1, 1, 5, 10, 20, 50, 100, 140, 150, 200),
        rays_for,
        "rays go as the range squared, and the plan tells the seconds; beyond 256 pixels of reach it refuses",
        (1, 100, 200),
        log=True,
    ),
    Sweep(
        "infinity",
        "a plane recedes from the near end of the volume to beyond what single precision tells from infinity",
        "m",
        (0.5, 0.52, 0.55, 0.6, 0.7, 0.85, 1, 1.5, 2, 5, 10, 100, 1e3, 1e4, 1e5, 1e6, math.inf),
        at_depth,
        "nowhere; the last is an environment alone",
        (0.5, 2, 1e6, math.inf),
        log=True,
    ),
    Sweep(
        "slope",
        "a plane turns until it is seen edge on",
        "degrees",
        (
            0,
            10,
            30,
            45,
            55,
            60,
            65,
            70,
            73,
            76,
            78,
            79,
            80,
            80.2,
            80.5,
            81,
            82,
            83,
            84,
            85,
            86,
            87,
            87.5,
            88,
            88.5,
            89,
        ),
        turned_by,
        "brightness rises by a quarter of (tangent x pupil radius / depth) squared: 5 % once the pupil sees it at "
        "angles from half to one and a half times the mean; beyond, the pupil sees its back",
        (81, 82),
    ),
    Sweep(
        "mirror through its focus",
        "a mirror's image goes from before the viewer to infinity and to behind the viewer",
        "dioptres",
        (
            -2,
            -1,
            -0.5,
            0,
            0.2,
            0.4,
            0.5,
            0.6,
            0.65,
            2 / 3,
            0.7,
            0.75,
            0.8,
            0.9,
            1,
            1.03,
            1.06,
            1.1,
            1.15,
            1.2,
            1.25,
        ),
        mirrored,
        "images nearer behind the viewer than two thirds of the near end are put there",
        (2 / 3, 1),
    ),
    Sweep(
        "lens through its focus",
        "a plane behind a lens passes through its focus",
        "m",
        (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 1, 1.02, 1.05, 1.1, 1.3, 1.6, 2, 2.4, 3),
        through_a_lens,
        "from 0.45 m on the plane goes beside the image, whose depths differ from direction to direction",
        (0.9, 1.02),
        log=True,
    ),
    Sweep(
        "mirrors in a row",
        "light comes by way of more and more mirrors",
        "reflections",
        (1, 2, 3, 4, 8, 12, 16, 24, 32),
        corridor,
        "what takes more than `Settings.max_specular_depth` is black",
        (1, 32),
    ),
    Sweep(
        "glass in a row",
        "a wall behind more and more surfaces of glass",
        "surfaces",
        (1, 2, 3, 4, 6, 8, 10, 12, 16, 20, 24, 28, 32),
        panes,
        "light that is reflected to and fro beyond the second surface is not followed: 1 % is missing behind 4 "
        "surfaces, 4 % behind 8, 12 % from 16 on",
        (2, 4),
    ),
    Sweep(
        "total reflection",
        "the angle of incidence passes the critical one, 41.8 degrees, within glass",
        "degrees",
        (
            0,
            10,
            20,
            25,
            28,
            30,
            31,
            32,
            33,
            34,
            35,
            36,
            37,
            38,
            40,
            41.5,
            41.8,
            42,
            43,
            45,
            47,
            48,
            49,
            50,
            52,
            55,
            58,
            60,
            70,
        ),
        from_within,
        "nowhere: each ray reflects all its light or divides",
        (41.5, 42),
    ),
    Sweep(
        "grazing incidence",
        "a pane is turned from the normal to grazing",
        "degrees",
        (0, 10, 20, 30, 45, 50, 55, 60, 65, 70, 72, 75, 77, 80, 82, 84, 85, 86, 87, 88, 89, 89.5, 89.9),
        grazing,
        "nowhere",
        (84, 85),
    ),
    Sweep(
        "size of a lamp",
        "a lamp shrinks from a meter to a millimeter at constant power",
        "m",
        (1, 0.7, 0.5, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3),
        lit_from,
        "nowhere: lamps are sampled by solid angle",
        (0.5, 0.1, 1e-3),
        log=True,
    ),
    Sweep(
        "dynamic range",
        "a dark patch beside a bright one, against what the recordable band lets a hologram show",
        "times as bright",
        tuple(10 ** (k / 4) for k in range(25)),
        contrast,
        "from a ratio of about 1000 on light of the bright patch, which the band limit spreads, fills the dark one",
        (1, 10, 100, 300),
        log=True,
    ),
    Sweep(
        "scale",
        "scene and camera together shrink and grow",
        "times",
        (1e-3, 1.5e-3, 2e-3, 3e-3, 5e-3, 1e-2, 3e-2, 0.1, 1, 10, 100, 1e3, 1e4),
        same_picture,
        "rays start 0.09 mm off surfaces: 0.2 dB at 1e-2, 2 dB at 1e-3, no picture at 1e-4; the plan warns "
        "where that is 3 % of the near end's depth",
        (1e-2, 1, 1e4),
        log=True,
    ),
    Sweep(
        "distance from the origin",
        "scene and camera together are moved off the world's origin",
        "m",
        (0, 1, 10, 30, 100, 200, 300, 500, 700, 1e3),
        moved,
        "rays start 9e-5 of the distance off surfaces: 0.2 dB at 100 m, 2 dB at 1 km, no picture at 10 km; "
        "the plan warns where that is 3 % of the near end's depth; scenes of Blender are moved near the camera before",
        (0, 100),
    ),
    Sweep(
        "seeds",
        "random numbers of another seed",
        "",
        tuple(range(8)),
        seeded,
        "nowhere",
        (0, 1),
    ),
]
