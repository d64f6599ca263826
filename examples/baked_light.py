"""Light that walls throw on each other is baked once; then the camera moves, and only its own view is traced."""

import tempfile
import time

import bpy
import numpy as np
from pictures import asked, save_loop, shown

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

path, pixels = asked(__file__)
variants.activate()
demo.build("box")  # a closed room, lit by a lamp that faces its ceiling
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
settings = engine.Settings(frames=8, method="fast")

images = []
with tempfile.TemporaryDirectory() as folder:
    store = engine.BakeStore(folder)  # without it, baked light stays in the user's cache
    for x in np.linspace(-0.06, 0.06, 8):
        start = time.monotonic()
        camera = exported.camera.moved((x, 0.0, 0.0), yaw=x)
        field = engine.render(exported.scene, camera, hologram, settings, store=store)
        baking = field.report["seconds"]["bake"]
        print(f"{x:+.3f} m: {time.monotonic() - start:.1f} s, of these {baking:.1f} for baking")
        images.append(engine.reconstruct(field, [0.75])[0])

save_loop(path, shown(images), milliseconds=120)
