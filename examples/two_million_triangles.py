"""Two million triangles: rays care little how many there are, methods that visit each of them do."""

import math
import time

import bpy
import numpy as np
from pictures import asked, save_rows, shown

from holopath_addon import engine
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

path, pixels = asked(__file__)
variants.activate()
for thing in list(bpy.data.objects):
    bpy.data.objects.remove(thing)

# Hills: a grid of a million squares, lifted by waves of many lengths.
bpy.ops.mesh.primitive_grid_add(x_subdivisions=1000, y_subdivisions=1000, size=4)
mesh = bpy.context.object.data
places = np.empty(3 * len(mesh.vertices), np.float32)
mesh.vertices.foreach_get("co", places)
x, y, z = places.reshape(-1, 3).T
rng = np.random.default_rng(5)
for octave in range(9):
    angle, phase = rng.random(2) * 2 * math.pi
    wave = 2.5 * 1.9**octave * (x * math.cos(angle) + y * math.sin(angle)) + phase
    z += 0.3 * 0.5**octave * np.abs(np.sin(wave))
mesh.vertices.foreach_set("co", places)
mesh.update()
rock = bpy.data.materials.new("rock")
rock.use_nodes = True
rock.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.55, 0.24, 0.08, 1)
mesh.materials.append(rock)
bpy.ops.object.light_add(type="SUN", rotation=(1.1, 0.2, 0.5))
bpy.context.object.data.energy = 1.2
bpy.ops.object.camera_add(location=(0, -2.2, 1.1), rotation=(math.radians(72), 0, 0))
bpy.context.scene.camera = bpy.context.object

start = time.monotonic()
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))
print(f"{2 * len(mesh.polygons)} triangles, exported in {time.monotonic() - start:.1f} s")
hologram = engine.Hologram(pixels, pixels, pitch=8e-6)
start = time.monotonic()
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=24))
print(f"rendered in {time.monotonic() - start:.1f} s")

save_rows(path, shown(engine.reconstruct(field, [0.8, 1.2, 3.0])))
