"""How much speckle is left of how many frames? Phases at random, and phases designed against it."""

import bpy
import numpy as np
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

# Without any phases: the scene through a lens as wide as the hologram's cone of light.
focus = [0.47]
plan = engine.plan(exported.scene, exported.camera, hologram)
truth = engine.reference(exported.scene, exported.camera, hologram, focus, spp=256, near=plan.near)[0]

rows = []
for phase_field in ("random", "designed"):
    row = []
    for frames in (1, 8, 24):
        settings = engine.Settings(frames=frames, phase_field=phase_field)
        field = engine.render(exported.scene, exported.camera, hologram, settings)
        row.append(engine.reconstruct(field, focus)[0])
        # What an eye sees is the mean of the frames; independent ones have a contrast of one over the root of M.
        print(f"{phase_field}, M = {frames}: {engine.psnr(row[-1], truth):.1f} dB")
    rows.append(row)

pictures = shown(np.concatenate(rows))
save_rows(path, pictures[:3], pictures[3:])
