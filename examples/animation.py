"""A hologram for each frame of an animation: Suzanne looks around, sharp in front of a wall that is not."""

import time

import bpy
from pictures import asked, save_loop, shown

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.export import ExportCache, export_scene

path, pixels = asked(__file__)
variants.activate()
demo.build("suzanne")

# Any animation of Blender's will do: keys, drivers, armatures, simulations.
scene, suzanne = bpy.context.scene, bpy.data.objects["Suzanne, 0.5 m"]
turn = suzanne.rotation_euler.z
for frame, angle in ((1, -0.7), (12, 0.7)):
    suzanne.rotation_euler.z = turn + angle
    suzanne.keyframe_insert("rotation_euler", frame=frame)

hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
cache, images = ExportCache(), []  # what does not move is exported once
for frame in range(1, 13):
    start = time.monotonic()
    scene.frame_set(frame)
    exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels), cache=cache)
    field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=24))
    images.append(engine.reconstruct(field, [0.47])[0])
    print(f"frame {frame}: {time.monotonic() - start:.1f} s")

save_loop(path, shown(images), milliseconds=80)
