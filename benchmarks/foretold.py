"""What plans foretell, and what came: ten scenes, on a machine without compiled programs and baked light, and again."""

import json
import math
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

RGB = (640e-9, 516.5e-9, 455.4e-9)
SIDE, FRAMES = 384, 8
SCENES = ("planes", "suzanne", "mirror", "glass", "tea", "box", "room", "cube", "lamps", "hills 100000")
DEMOS = ("demo:suzanne", "demo:box", "demo:planes")


def exported(name, pixels):
    """Blender's own default scene, or a demo, by the exporter; needs bpy."""
    from holopath_addon.cli.sources import open_source

    if name == "cube":
        import bpy

        bpy.ops.wm.read_factory_settings()
        name = os.path.join(tempfile.mkdtemp(prefix="holopath-foretold-"), "cube.blend")
        bpy.ops.wm.save_as_mainfile(filepath=name)
    loaded = open_source(name).load(pixels, pixels)
    return loaded.scene, loaded.camera


def lamps():
    """Two balls before a wall, under twelve lamps of which some matter."""
    from holopath_addon import engine

    from .scenes import FOV, Scenes

    s = Scenes()
    place = np.random.default_rng(5).uniform([-1.2, 0.3, -1.9], [1.2, 1.4, 0.2], (12, 3))
    many = {
        f"lamp_{k}": {"type": "sphere", "center": list(at), "radius": 0.03, **s.emissive(s.gray(4.0 * 3**-k))}
        for k, at in enumerate(place)
    }
    scene = s.scene(
        wall=s.plane(2.0, s.diffuse(s.texture(256, 1))),
        near=s.ball(0.06, [-0.05, -0.02, -0.6], s.diffuse(s.texture(128, 2))),
        far=s.ball(0.12, [0.12, 0.05, -1.2], s.diffuse(s.texture(128, 4))),
        **many,
    )
    return scene, engine.Camera(np.eye(4), FOV)


def built(name, pixels=SIDE):
    """A scene of `SCENES` or `DEMOS` and its camera."""
    if name == "lamps":
        return lamps()
    if name == "cube" or name in DEMOS:
        return exported(name, pixels)
    from .chart.scenes import built

    return built(name, pixels)


def once(name, method="auto", pixels=SIDE):
    """Seconds foretold and measured of one render in this process, a dict."""
    from holopath_addon import engine
    from holopath_addon.engine.light.bake_store import BakeStore
    from holopath_addon.engine.scene import variants

    variants.activate()
    pixels = int(pixels)
    scene, camera = built(name, pixels)
    nearer = min(1.0, pixels / 256)
    hologram = engine.Hologram(pixels, pixels, 8e-6, RGB, 1e-3 * nearer, 6e-3 * nearer)
    store = BakeStore(Path(os.environ["HOLOPATH_CACHE"]))
    start = time.perf_counter()
    field = engine.render(scene, camera, hologram, engine.Settings(frames=FRAMES, method=method), store=store)
    return {
        "wall": time.perf_counter() - start,
        "foretold": field.report["estimated"]["stages"],
        "came": field.report["seconds"],
        "cached": field.plan["cached"],
        "bake": field.report.get("bake"),
        "passes": field.plan["passes"],
        "taken": field.report["radiance_passes"],
    }


def measured(name, folder, pixels=SIDE, method="auto"):
    """The same in a process of its own, with programs and baked light of a folder."""
    environment = os.environ | {
        "HOLOPATH_CACHE": os.path.join(folder, "cache"),
        "DRJIT_CACHE_DIR": os.path.join(folder, "programs"),
    }
    words = [sys.executable, "-m", "benchmarks.foretold", name, method, str(pixels)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return json.loads(done.stdout.splitlines()[-1])


def stages_of(row):
    """Stages with their seconds foretold and measured, in words."""
    names = dict.fromkeys([*row["foretold"], *row["came"]])
    pairs = ((name, row["foretold"].get(name, 0.0), row["came"].get(name, 0.0)) for name in names)
    return ", ".join(f"{name} {a:.2f}/{b:.2f}" for name, a, b in pairs if max(a, b) > 0.05)


def run(*names, pixels=SIDE):
    """The table as text, for all scenes or those named."""
    lines = [
        f"foretold: {pixels} x {pixels}, 8 µm, three wavelengths, M = {FRAMES}, nothing else set; seconds of the "
        "render without its plan; each run is a process",
        f"  {'scene':14s} {'run':12s} {'light':>6s} {'foretold':>9s} {'came':>7s} {'ratio':>6s} {'plan':>6s} "
        "paths a pixel, planned and taken",
    ]
    within = total = 0
    for name in names or SCENES + DEMOS:
        with tempfile.TemporaryDirectory(prefix="holopath-foretold-") as folder:
            for kind in ("first", "second"):
                row = measured(name, folder, pixels)
                foretold = sum(row["foretold"].values())
                came = sum(seconds for stage, seconds in row["came"].items() if stage != "plan")
                ratio = came / foretold
                within, total = within + (abs(math.log(ratio)) < math.log(1.5)), total + 1
                lines.append(
                    f"  {name:14s} {kind:12s} {'bake' if row['cached'] else 'paths':>6s} {foretold:9.2f} {came:7.2f} "
                    f"{ratio:6.2f} {row['came'].get('plan', 0.0):6.2f} {row['passes']:4d} {row['taken']:4d}"
                )
                print(lines[-1], stages_of(row), sep="\n    ", file=sys.stderr, flush=True)
    lines.append(f"  within 1.5 times: {within} of {total}")
    return "\n".join(lines)


if __name__ == "__main__":
    print(json.dumps(once(*sys.argv[1:])))
