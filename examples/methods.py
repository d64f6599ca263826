"""The same scene by eight methods, all in one format: which of them shows what is near, and what is far?"""

import time

import bpy
from pictures import asked, save_rows, shown

from holopath_addon import demo, engine
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

METHODS = ("auto", "rgbd", "point", "polygon", "gaussian", "stereogram", "focal-stack", "light-field")

path, pixels = asked(__file__)
variants.activate()
demo.build("suzanne")
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
view = exported.scene, exported.camera, hologram

# What a perfect hologram would show: the scene by Mitsuba's path tracer, through a lens.
focus = [0.47, 1.0]
truth = engine.reference(*view, focus, spp=64)

rows = [[], []]
for method in METHODS:
    start = time.monotonic()
    # Those of supervised phases descend; sixty steps here.
    steps = {"steps": 60} if method in ("focal-stack", "light-field") else {}
    field = engine.render(*view, engine.Settings(method=method, frames=8, fixed=steps))
    seconds = time.monotonic() - start
    images = engine.reconstruct(field, focus)
    found = [engine.psnr(image, wanted) for image, wanted in zip(images, truth, strict=True)]
    print(f"{method}: near {found[0]:.1f} dB, far {found[1]:.1f} dB, {seconds:.0f} s")
    for row, image, wanted in zip(rows, images, truth, strict=True):
        row.append(image * (wanted.mean() / image.mean()))

pictures = [shown(row) for row in rows]
save_rows(path, *(row[part] for part in (slice(0, 4), slice(4, 8)) for row in pictures))
