"""How time grows with frames, wavelengths and triangles."""

import time

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.scene.meshes import joining

from .scenes import FOV, GREEN, Scenes

RGB = (640e-9, 516.5e-9, 455.4e-9)


def seconds(scene, wavelengths, frames, repeats=3, pixels=256, **settings):
    """Median seconds of a render, planning and compilation left out; the plan of the first wavelength set."""
    camera = engine.Camera(np.eye(4), FOV)
    hologram = engine.Hologram(pixels, pixels, 8e-6, wavelengths, 1e-3, 6e-3)
    settings = engine.Settings(frames=frames, **settings)
    plan = engine.plan(scene, camera, hologram, settings)
    samples = []
    for _ in range(repeats + 1):
        start = time.perf_counter()
        report = engine.render(scene, camera, hologram, settings, plan).report["seconds"]
        samples.append(time.perf_counter() - start)
    return float(np.median(samples[1:])), report


def relief_mesh(s, triangles, z, half, height, waves):
    """A grid of hills around a plane z with the wished number of triangles."""
    side = max(2, round((triangles / 2) ** 0.5))
    u, v = np.meshgrid(np.linspace(-1, 1, side + 1), np.linspace(-1, 1, side + 1))
    hills = z + height * np.sin(waves[0] * u) * np.sin(waves[1] * v)
    vertices = np.stack([half * u, half * v, hills], -1).reshape(-1, 3)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + 1, corner + side + 2]),
            np.column_stack([corner, corner + side + 2, corner + side + 1]),
        ]
    )
    properties = s.mi.Properties()
    properties["bsdf"] = s.mi.load_dict({"type": "diffuse", "reflectance": s.gray(0.7)})
    mesh = s.mi.Mesh("relief", len(vertices), len(faces), props=properties)
    parameters = s.mi.traverse(mesh)
    parameters["vertex_positions"] = vertices.astype(np.float32).ravel()
    parameters["faces"] = faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh


def steep(triangles):
    """Hills with walls of up to 80 degrees at 0.9 m under the sky, one mesh: light is scattered many times."""
    s = Scenes()
    return _under_sky(s, relief=relief_mesh(s, triangles, -0.9, 0.2, 0.15, (9, 7)))


def subdivided(triangles, side=8):
    """The floor of `tiles` as one mesh of the wished number of triangles."""
    s = Scenes()
    waves = (side * np.pi, side * np.pi)
    return _under_sky(s, relief=relief_mesh(s, triangles, -0.9, 0.2, 0.3 * 0.2 / side, waves))


def _under_sky(s, **shapes):
    return s.scene(**shapes, sky={"type": "constant", "radiance": s.gray(0.5)})


def tiles(triangles, side=8):
    """A floor of instanced tiles at 0.9 m under the sky, of the wished number of triangles in all."""
    s = Scenes()
    half = 0.2 / side
    mesh = relief_mesh(s, triangles / side**2, 0, half, 0.3 * half, (np.pi, np.pi))
    copies = {
        f"tile_{i}_{j}": {
            "type": "instance",
            "tile": {"type": "ref", "id": "tile"},
            "to_world": s.T().translate([half * (2 * i + 1 - side), half * (2 * j + 1 - side), -0.9]),
        }
        for i in range(side)
        for j in range(side)
    }
    return _under_sky(s, tile={"type": "shapegroup", "mesh": mesh}, **copies)


def crowd(objects, shared=False):
    """Boxes of four materials under the sky, each with a mesh of its own or as instances."""
    s = Scenes()
    looks = [s.diffuse(s.gray(0.2 + 0.2 * n)) for n in range(4)]
    side = round(objects ** (1 / 3))
    parts = {}
    for n in range(objects):
        place = [0.3 * (k / side - 0.5) for k in (n % side, n // side % side)]
        to_world = s.T().translate([*place, -0.7 - 0.4 * (n // side**2) / side]).scale(0.1 / side)
        group = {"type": "ref", "id": f"box_{n % 4}"}
        box = {"type": "instance", "group": group} if shared else {"type": "cube"} | looks[n % 4]
        parts[f"place_{n}"] = box | {"to_world": to_world}
    groups = {f"box_{n}": {"type": "shapegroup", "box": {"type": "cube"} | looks[n]} for n in range(4)}
    return _under_sky(s, **(groups if shared else {}), **parts)


def _crowds(objects, pixels):
    """Lines on many small objects: joined, apart, and as instances."""
    joined, _ = seconds(crowd(objects), (GREEN,), 24, repeats=2, pixels=pixels)
    many, joining.MANY_MESHES = joining.MANY_MESHES, objects
    try:
        apart, report = seconds(crowd(objects), (GREEN,), 24, repeats=2, pixels=pixels)
    finally:
        joining.MANY_MESHES = many
    few = min(objects, 100)
    copies, _ = seconds(crowd(few), (GREEN,), 24, repeats=2, pixels=pixels)
    instances, _ = seconds(crowd(few, shared=True), (GREEN,), 24, repeats=2, pixels=pixels)
    return [
        f"{objects} boxes of four materials under the sky: joined {joined:.2f} s, apart {apart:.2f} s, ratio "
        f"{apart / joined:.2f} (apart: radiance {report['radiance']:.2f} s)",
        f"{few} of them: joined {copies:.2f} s, instances {instances:.2f} s, ratio {instances / copies:.1f}",
    ]


def run(pixels=256, max_triangles=4_000_000, objects=1000):
    """Tables as text."""
    s = Scenes()
    lamp_lit, box = s.two_planes(s.diffuse), s.closed_box()
    one, _ = seconds(lamp_lit, (GREEN,), 8, pixels=pixels)
    three, _ = seconds(lamp_lit, RGB, 8, pixels=pixels)
    lines = [
        f"color: lamp-lit planes, M = 8: RGB {three:.2f} s, one wavelength {one:.2f} s, ratio {three / one:.2f}"
    ]
    few, _ = seconds(box, (GREEN,), 1, pixels=pixels, radiance="ray")
    many, _ = seconds(box, (GREEN,), 24, pixels=pixels, radiance="ray")
    lines.append(
        f"frames: closed box, a path a ray: M = 24 {many:.2f} s, M = 1 {few:.2f} s, ratio {many / few:.2f}"
    )
    lines += _crowds(objects, pixels)
    lines.append("triangles under the sky, M = 24, one wavelength")
    for name, build in (
        ("hills, one mesh", subdivided),
        ("hills, 64 instances", tiles),
        ("steep, one mesh", steep),
    ):
        first = None
        for triangles in (n for n in (1_000, 30_000, 1_000_000, 4_000_000) if n <= max_triangles):
            value, report = seconds(build(triangles), (GREEN,), 24, repeats=2, pixels=pixels)
            first = first or value
            lines.append(
                f"  {name:19s} {triangles:9,d}: {value:6.2f} s ({value / first:.1f} times the first), "
                f"wave tracing {report['wave tracing']:.2f} s, radiance {report['radiance']:.2f} s"
            )
    return "\n".join(lines)
