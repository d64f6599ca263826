"""A bench that is off in everything: what does it show, before a camera has looked at it and afterwards?"""

import bpy
import numpy as np
from pictures import asked, save_rows, shown
from PIL import Image

from holopath_addon import engine, slm
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

GREEN, PITCH, FOCI = 520e-9, 8e-6, (2e-3, 4.5e-3, 7e-3)

path, pixels = asked(__file__, 192)
side = max(16, pixels // 4)  # of the SLM: to fit 59 parameters takes minutes with 48 x 48 pixels
variants.activate()
demo.build("suzanne")
lens = bpy.context.scene.camera.data
lens.angle, lens.shift_x, lens.shift_y = 0.55 * lens.angle, -0.3, 0.05  # Suzanne alone
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (side, side))
hologram = engine.Hologram(side, side, PITCH, (GREEN,), FOCI[0], FOCI[-1])
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=8))

# The bench: beam, levels, crosstalk, unmodulated light, lenses and camera are wrong, each anywhere in its range.
window, view = slm.PatternWindow(side, PITCH, GREEN), (0.95, 0.95)
camera = round(1.4 * side), round(1.4 * side)
bench, truth = slm.perturbed_bench(slm.nominal_setup(window, FOCI, camera, view), window, seed=1)
found = slm.calibrate(bench.capture_values, window, FOCI, view)
print(f"crosstalk: {found.setup.model.crosstalk:.3f} pixels, in truth {truth.model.crosstalk:.3f}")

rows = [[], []]
depths = 0.47, 1.0  # Suzanne's eyes, and the ball
for name, calibration in (("as it is", slm.Calibration()), ("calibrated", slm.calibration_of(found, window))):
    levels = calibration.levels_of(hologram) if calibration.models else None
    phase = engine.encode(field, "joint", display=calibration.display([GREEN]), levels=levels)
    told = []
    for row, depth in zip(rows, depths, strict=True):
        wanted = engine.reconstruct(field, [depth])[0]
        distance = float(field.mapping.depth_to_z(depth))
        frames = [bench.phases[calibration.levels(frame[0], GREEN)] for frame in phase.data]
        seen = np.mean([bench.picture(frame, distance) for frame in frames], axis=0)[..., None]
        row[:] = row or [wanted]  # on the left: what the wave field shows
        row.append(seen * (wanted.mean() / seen.mean()))
        told.append(f"{engine.psnr(seen, wanted, border=4):.1f}")
    print(f"{name}: near {told[0]}, far {told[1]} dB")

larger = [
    [picture.resize((pixels, pixels), Image.Resampling.NEAREST) for picture in shown(np.repeat(row, 3, -1))]
    for row in rows
]
save_rows(path, *larger)
