"""Runs inside a Blender window: presses Render Hologram, refocuses the picture, then renders with F12.

    blender --python window.py -- RESULT.json

Whatever happens, RESULT.json says how far it got, and Blender ends: by itself, or after LIMIT seconds.
"""

import json
import os
import sys
import threading
import time
import traceback

import bpy
import numpy as np

LIMIT = 240.0  # seconds
SIZE = 256  # pixels
NAME = "HoloPath Reconstruction"
target = sys.argv[sys.argv.index("--") + 1]
result = {"steps": [], "blender": bpy.app.version_string}
started = time.monotonic()


def write(**more):
    """Write the result beside its name, then rename it."""
    result.update(more, seconds=round(time.monotonic() - started, 1))
    with open(target + ".part", "w", encoding="utf-8") as file:
        json.dump(result, file)
    os.replace(target + ".part", target)


def give_up():
    write(error=f"not finished after {LIMIT:.0f} s")
    os._exit(1)


watchdog = threading.Timer(LIMIT, give_up)
watchdog.daemon = True
watchdog.start()


def prepare():
    """Blender's own cube with a noise on it, camera and lamp, against black, at a size that takes a second or two."""
    bpy.context.preferences.view.show_splash = False
    scene = bpy.context.scene
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    scene.camera.location *= 0.5
    tree = bpy.data.objects["Cube"].active_material.node_tree
    noise, principled = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes["Principled BSDF"]
    tree.links.new(noise.outputs["Color"], principled.inputs["Base Color"])
    props = scene.holopath
    props.resolution_x = props.resolution_y = SIZE
    props.depth_far_mm, props.depth_near_mm = 4.0, 6.0
    props.frames = 4
    props.quality = "preview"
    props.focus = 5.0


def press(operator):
    """Invoke an operator as its button in the 3D View would."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator("INVOKE_DEFAULT")


def picture():
    """The reconstruction, array [y, x, rgb], once there is light in it, else None."""
    image = bpy.data.images.get(NAME)
    if image is None or not image.has_data:
        return None
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    colour = pixels.reshape(image.size[1], image.size[0], 4)[..., :3]
    return colour if colour.any() else None


def describe(colour):
    """Size, and how bright the cube in the middle is against the corners."""
    rows, columns = colour.shape[0] // 8, colour.shape[1] // 8
    middle = colour[3 * rows : -3 * rows, 3 * columns : -3 * columns].mean()
    corners = np.concatenate([colour[:rows, :columns], colour[-rows:, -columns:]]).mean()
    return {"size": colour.shape[1::-1], "middle": float(middle), "corners": float(corners)}


def baked():
    """Notes on what was baked for the last render."""
    session = next(m for name, m in sys.modules.items() if name.endswith("operators.session"))
    return [note for note in session.current.notes if "baked" in note]


def steps():
    """The user's actions; every `yield` gives Blender time to work and redraw."""
    yield
    prepare()
    yield
    result["pressed"] = sorted(press(bpy.ops.holopath.render_hologram))
    result["steps"].append("pressed")
    while (near := picture()) is None:
        yield
    result.update(describe(near))
    result["steps"].append("pictured")
    result["baked"] = [baked()]
    yield
    bpy.context.scene.holopath.focus = 0.5
    while (far := picture()) is None or np.array_equal(far, near):
        yield
    result["steps"].append("refocused")
    yield
    done = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    bpy.app.handlers.render_cancel.append(lambda *_: done.append(False))
    bpy.context.scene.render.engine = "HOLOPATH"
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 96
    press(bpy.ops.render.render)
    while not done:
        yield
    result["rendered"] = done[0]
    result["baked"].append(baked())
    result["scenes"] = len(bpy.data.scenes)
    result["steps"].append("rendered")
    bpy.data.objects.remove(bpy.context.scene.camera)
    try:
        result["without_camera"] = sorted(press(bpy.ops.holopath.render_hologram))
    except RuntimeError as error:
        result["without_camera"] = str(error)
    for _ in range(5):
        yield
    result["steps"].append("alive")


run = steps()


def tick():
    try:
        next(run)
    except StopIteration:
        write()
        bpy.ops.wm.quit_blender()
        return None
    except BaseException:
        write(error=traceback.format_exc())
        os._exit(1)
    return 0.2


bpy.app.timers.register(tick, first_interval=1.0)
