"""The eye moves within the pupil: what stands near hides other parts of what stands far."""

import bpy
import numpy as np
from pictures import asked, save_loop, shown

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.engine.viewing import assessment
from holopath_addon.export import export_scene

path, pixels = asked(__file__)
variants.activate()
demo.build("suzanne")
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=24))
refocus = engine.Refocuser(field)

# A third of the pupil goes from its left edge to its right one, and the focus stays at half a meter.
radius = assessment.pupil_radius(field)
images = []
for x in np.linspace(-2 / 3, 2 / 3, 12) * radius:
    pupil = engine.Pupil(x, 0.0, 2 / 3 * radius)
    # Red fills a wider cone than blue, so that a part of the pupil has less of its light.
    images.append(assessment.balance_colors(field, refocus([0.5], pupil)[0], pupil))
print(f"The pupil that all colors fill is {2e3 * radius:.2f} mm wide.")

save_loop(path, shown(images))
