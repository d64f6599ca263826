"""An SLM shows phases alone. What do the ways to get them lose, and in how many seconds?"""

import time

import bpy
from pictures import asked, save_rows, shown

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

path, pixels = asked(__file__)
variants.activate()
demo.build("suzanne")
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=8))

# The complex field, which no SLM shows, is the measure here.
focus = [0.47, 4.0]
wanted = engine.reconstruct(field, focus)
rows = [[image] for image in wanted]
for method in ("dpac", "sgd", "joint"):
    start = time.monotonic()
    phase = engine.encode(field, method, bits=8)
    seconds = time.monotonic() - start
    # `field` of a phase hologram is its light, behind an aperture that holds back all but the cone.
    seen = engine.reconstruct(phase.field(), focus)
    print(f"{method}: {engine.psnr(seen[0], wanted[0]):.1f} dB, {seconds:.0f} s")
    for row, image in zip(rows, seen, strict=True):
        row.append(image)

save_rows(path, *(shown(row) for row in rows))
