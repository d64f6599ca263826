"""A display that switches fast has few bits. Phases that are found for its levels lose less than rounded ones."""

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
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=8))

focus = [0.47]
wanted = engine.reconstruct(field, focus)
ideal = engine.encode(field, "sgd")
rows = []
for bits in (8, 2, 1):
    # Rounded: the ideal phases, shown by a modulator of so many levels.
    rounded = engine.reconstruct(ideal.field(engine.Modulator(bits=bits)), focus)[0]
    # Found: the descent ends on the levels, and makes up on some pixels for what others lose.
    found = engine.reconstruct(engine.encode(field, "sgd", bits=bits).field(), focus)[0]
    rows.append((rounded, found))
    print(
        f"{bits} bits: rounded {engine.psnr(rounded, wanted[0]):.1f} dB, found {engine.psnr(found, wanted[0]):.1f} dB"
    )

pictures = shown(np.concatenate(rows))
save_rows(path, pictures[0::2], pictures[1::2])
