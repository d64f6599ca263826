"""The same scene by eight methods: which of them shows what is near, what is far, and what an eye at the side sees?"""

import time

import bpy
from pictures import asked, save_rows, shown

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.engine.viewing import assessment
from holopath_addon.export import export_scene
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding

METHODS = ("auto", "focal-stack", "light-field", "rgbd", "point", "polygon", "gaussian", "stereogram")

path, pixels = asked(__file__)
variants.activate()
demo.build("suzanne")
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
view = exported.scene, exported.camera, hologram

truth, rows = None, [[], [], []]
for method in METHODS:
    start = time.monotonic()
    # Supervised phases, with a hundred steps; all others give a field, and then its phases are found.
    settings = engine.Settings(method=method, frames=8, fixed={"steps": 100} if "-" in method else {})
    field = engine.render(*view, settings)
    if "-" not in method:
        phase = pipeline.encode(field, Encoding("auto"), lambda done, what: None, exported.scene, settings)
        field = phase.field()
    seconds = time.monotonic() - start

    # At Suzanne and at the ball behind her through all of the pupil; and through the right half of it.
    side = engine.Pupil(assessment.pupil_radius(field) / 2, 0.0, assessment.pupil_radius(field))
    looks = (0.47, None), (1.0, None), (0.7, side)
    if truth is None:  # what a perfect hologram would show: Mitsuba's path tracer, through a lens
        truth = [engine.reference(*view, [focus], pupil, spp=64)[0] for focus, pupil in looks]
    told = []
    for row, wanted, (focus, pupil) in zip(rows, truth, looks, strict=True):
        image = engine.reconstruct(field, [focus], pupil)[0]
        image = image if pupil is None else assessment.balance_colors(field, image, pupil)
        told.append(f"{engine.psnr(image, wanted):.1f}")
        row.append(image * (wanted.mean() / image.mean()))
    print(f"{method}: near {told[0]}, far {told[1]}, at the side {told[2]} dB, {seconds:.0f} s")

save_rows(path, *(shown(row) for row in rows))
