"""A glass ball shows the room upside down, and its picture floats before the ball: focus there, and it is sharp."""

import bpy
from pictures import asked, save_rows, shown

from holopath_addon import engine
from holopath_addon.blender import demo
from holopath_addon.engine.scene import variants
from holopath_addon.export import export_scene

path, pixels = asked(__file__)
variants.activate()
demo.build("suzanne")

# The striped ball becomes clear glass and comes nearer.
BALL, RADIUS, INDEX, WALL = 0.62, 0.11, 1.5, 4.0
ball = bpy.data.objects["Ball, 1 m"]
ball.location = (0.07, BALL, 0.0)
tree = ball.data.materials[0].node_tree
shader = tree.nodes["Principled BSDF"]
tree.links.remove(shader.inputs["Base Color"].links[0])
for name, value in {
    "Base Color": (1, 1, 1, 1),
    "Roughness": 0.0,
    "Transmission Weight": 1.0,
    "IOR": INDEX,
}.items():
    shader.inputs[name].default_value = value
exported = export_scene(bpy.context.evaluated_depsgraph_get(), (pixels, pixels))

# A ball is a lens of this focal length, measured from its center; the wall's image is a real one.
length = INDEX * RADIUS / (2 * (INDEX - 1))
image = BALL - length * (WALL - BALL) / (WALL - BALL - length)
print(f"the wall's image floats at {image:.3f} m, {BALL - RADIUS - image:.3f} m before the ball")

hologram = engine.Hologram(pixels, pixels, pitch=8e-6, near=0.4)
field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=24))
save_rows(path, shown(engine.reconstruct(field, [image, BALL, WALL])))
