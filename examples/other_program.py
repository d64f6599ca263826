"""From HoloPath to a program of your own: one file, and an angular spectrum in ten lines of NumPy."""

import bpy
import numpy as np
from pictures import asked, save_rows, shown

from holopath_addon import engine, exchange
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

path, pixels = asked(__file__)
variants.activate()
demo.build("planes")
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=8))
exchange.write(path.with_suffix(".npz"), exchange.container_of(field, exchange.CONVENTIONS["holopath"]))

# From here on nothing is HoloPath's. The array is [frame, wavelength, y, x].
u = np.load(path.with_suffix(".npz"))["field"]
pad = pixels // 2  # so that nothing comes back from the other side
u = np.pad(u, ((0, 0), (0, 0), (pad, pad), (pad, pad)))
f = np.fft.fftfreq(u.shape[-1], 8e-6)
across = f[:, None] ** 2 + f**2
cone = across <= (0.5 / 8e-6) ** 2  # of the light that the display can steer


def intensity(z):
    """Mean of the frames at a distance z from the SLM."""
    picture = []
    for wavelength, waves in zip((640e-9, 516.5e-9, 455.4e-9), u.swapaxes(0, 1), strict=True):
        along = np.sqrt(np.maximum(1 / wavelength**2 - across, 0))
        seen = np.fft.ifft2(cone * np.fft.fft2(waves) * np.exp(2j * np.pi * z * along))
        picture.append((np.abs(seen) ** 2).mean(0)[pad:-pad, pad:-pad])
    return np.stack(picture, axis=-1)


depths = 0.5, 2.0
theirs = [intensity(float(field.mapping.depth_to_z(depth))) for depth in depths]
for image, own in zip(theirs, engine.reconstruct(field, depths), strict=True):
    print(f"differs by {np.abs(image - own).mean() / own.mean():.1e} of the brightness")
save_rows(path, shown(theirs))
