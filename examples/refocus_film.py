"""One hologram, many pictures: the focus moves from near to far, and back."""

import bpy
import numpy as np
from pictures import asked, save_loop, shown

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

path, pixels = asked(__file__)
variants.activate()

# Suzanne at 0.5 m, a ball and a cube at 1 m, a wall at 4 m; a .blend opened by bpy goes the same way.
demo.build("suzanne")
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))

# The wave field at the display is rendered once.
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=24))

# An eye focuses evenly in diopters, not in meters. A `Refocuser` keeps spectra: each focus is one inverse FFT.
diopters = np.linspace(1 / 0.45, 1 / 4, 20)
images = engine.Refocuser(field)(1 / diopters)

save_loop(path, shown(images))
