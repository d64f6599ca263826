"""Runs inside a Blender window: shades the 3D View RENDERED with HoloPath, and does to it what users do.

    blender --window-geometry 0 0 800 600 --python viewport.py -- RESULT.json

Whatever happens, RESULT.json says how far it got, and Blender ends: by itself, or after LIMIT seconds.
"""

import json
import os
import sys
import threading
import time
import traceback

import addon_utils
import bpy
import numpy as np

LIMIT = 900.0  # seconds
ADDON = "bl_ext.user_default.holopath"
target = sys.argv[sys.argv.index("--") + 1]
result = {"steps": [], "blender": bpy.app.version_string}
started = time.monotonic()
exports = []


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


def reached(step):
    result["steps"].append(step)


def module(name):
    return sys.modules[f"{ADDON}.{name}"]


def areas():
    """The 3D Views."""
    screen = bpy.context.window_manager.windows[0].screen
    return [area for area in screen.areas if area.type == "VIEW_3D"]


def call(operator, *arguments, **settings):
    """Call an operator as from the first 3D View."""
    window, area = bpy.context.window_manager.windows[0], areas()[0]
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator(*arguments, **settings)


def shade(shading, view="CAMERA"):
    for area in areas():
        area.spaces.active.region_3d.view_perspective = view
        area.spaces.active.shading.type = shading


def threads():
    return [thread for thread in threading.enumerate() if thread.name == "HoloPath"]


def picture():
    """Image in the only view, shape (y, x, rgb), row 0 at the top, and whether anything is still to be done."""
    views = list(module("blender.viewport")._viewports.values())
    if len(views) != 1 or views[0]._texture is None:
        return None, True
    (view,) = views
    pixels = np.array(view._texture.read().to_list(), np.float32).reshape(
        view._texture.height, view._texture.width, 4
    )
    return pixels[::-1, :, :3], view.unfinished or view._pixels is not None


def settled_image(before=None):
    """Wait for a picture, other than the one before, of all that has changed; yields, then returns it."""
    while True:
        yield
        found, unfinished = picture()
        if found is not None and not unfinished and found.shape[1] > 60:
            if (
                before is None
                or before.shape != found.shape
                or abs(coarse(before) - coarse(found)).max() > 0.05
            ):
                return found


def coarse(color):
    """Means of 16 x 16 pixels, with little noise."""
    rows, columns = (n // 16 * 16 for n in color.shape[:2])
    return color[:rows, :columns].reshape(rows // 16, 16, columns // 16, 16, 3).mean((1, 3))


def cube(color):
    """Place of the cube: center of the pixels that differ from the gray world, in fractions of width and height."""
    color = coarse(color)
    there = abs(color - color[0, 0]).max(axis=2) > 0.02
    rows, columns = np.nonzero(there)
    return [float(columns.mean() / there.shape[1]), float(rows.mean() / there.shape[0])]


def text():
    """Message in the view."""
    (view,) = module("blender.viewport")._viewports.values()
    return view._complaint or view._error


def steps():
    """The user's actions; every `yield` gives Blender time to work and redraw."""
    yield
    bpy.context.preferences.view.show_splash = False
    scene = bpy.context.scene
    scene.render.engine = "HOLOPATH"
    call(bpy.ops.ed.undo_push, message="Engine")
    viewport = module("blender.viewport")
    viewport.MAX_SAMPLES = 16
    read = viewport.Viewport.read
    viewport.Viewport.read = lambda self: (exports.append(time.monotonic()), read(self))
    yield
    shaded = time.monotonic()
    shade("RENDERED")
    first = yield from settled_image()
    result["first_picture"] = round(time.monotonic() - shaded, 1)
    result["cube"] = cube(first)
    reached("seen")
    bpy.data.objects["Cube"].location.z += 0.7  # up
    call(bpy.ops.ed.undo_push, message="Move")
    result["raised"] = cube((yield from settled_image(first)))
    bpy.data.objects["Camera"].data.shift_x = 0.2
    count = len(exports)
    result["shifted"] = cube((yield from settled_image(first)))
    result["exports_by_camera"] = len(exports) - count
    bpy.data.objects["Camera"].data.shift_x = 0.0
    yield
    yield from settled_image()
    bpy.data.objects["Light"].select_set(True)
    for _ in range(3):
        yield
    result["exports_by_selection"] = len(exports) - count
    reached("moved")
    yield
    before = yield from settled_image()
    call(bpy.ops.ed.undo)
    result["undone"] = cube((yield from settled_image(before)))
    reached("undone")
    # baked by Cycles, which changes Blender's data while nothing else does
    tree = bpy.data.objects["Cube"].active_material.node_tree
    noise, principled = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes["Principled BSDF"]
    tree.links.new(noise.outputs["Color"], principled.inputs["Base Color"])
    count, before = len(exports), picture()[0]
    baked = yield from settled_image(before)
    colors = baked[baked.shape[0] // 2 - 10 :, baked.shape[1] // 2 + 5 :][:20, :20]
    result["colorful"] = float(np.ptp(colors, axis=2).mean() / colors.mean())
    for _ in range(8):
        yield
    result["exports_by_bake"] = len(exports) - count
    reached("baked")
    shade("RENDERED", "PERSP")
    free = yield from settled_image(baked)
    (view,) = viewport._viewports.values()
    result["free"] = [free.shape[1::-1], [areas()[0].regions[-1].width, areas()[0].regions[-1].height]]
    call(bpy.ops.view3d.view_orbit, angle=0.5, type="ORBITLEFT")
    yield from settled_image(free)
    reached("orbited")
    shade("RENDERED", "ORTHO")
    while not text():
        yield
    result["orthographic"] = text()
    shade("RENDERED")
    yield from settled_image()
    props = bpy.context.scene.holopath
    props.resolution_x = props.resolution_y = 64
    props.depth_far_mm, props.depth_near_mm, props.frames, props.quality = 1.25, 1.875, 4, "preview"
    call(bpy.ops.holopath.render_hologram, "INVOKE_DEFAULT")
    session = module("operators.session")
    result["together"] = session.running() and any(job.running for job in viewport._jobs)
    while session.running():
        yield
    yield from settled_image()
    reached("rendered")
    call(bpy.ops.ed.undo_push, message="Rendered")
    bpy.data.objects.remove(bpy.data.objects["Cube"])
    bpy.data.objects.remove(bpy.data.objects["Light"])
    bpy.data.worlds.remove(bpy.data.worlds[0])
    call(bpy.ops.ed.undo_push, message="Remove")
    while not text():
        yield
    result["empty"], count = text(), len(exports)
    for _ in range(5):
        yield
    result["exports_of_nothing"] = len(exports) - count
    reached("emptied")
    call(bpy.ops.ed.undo)
    yield from settled_image()
    reached("filled")
    shade("SOLID")
    for _ in range(10):
        yield
    result["threads_after_solid"], result["views_after_solid"] = len(threads()), len(viewport._viewports)
    shade("RENDERED")
    yield from settled_image()
    call(bpy.ops.screen.area_split, direction="VERTICAL", factor=0.5)
    yield
    result["views"] = len(areas())
    shade("RENDERED")
    while len(viewport._viewports) < 2 or any(v._texture is None for v in viewport._viewports.values()):
        yield
    call(bpy.ops.screen.area_close)
    while len(viewport._viewports) > 1:
        yield
    yield from settled_image()
    reached("closed")
    file = os.path.join(os.path.dirname(target), "shaded.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.data.objects["Cube"].location.x += 0.1
    yield
    bpy.ops.wm.open_mainfile(filepath=file)
    yield
    result["threads_after_loading"] = len(threads())
    shade("RENDERED")  # Blender opens files with solid views
    yield from settled_image()
    reached("loaded")
    bpy.data.objects["Cube"].location.x += 0.1
    yield
    addon_utils.disable(ADDON)
    result["threads_after_disabling"] = len(threads())
    for _ in range(3):
        yield
    reached("disabled")
    addon_utils.enable(ADDON)
    bpy.context.scene.render.engine = "HOLOPATH"
    yield
    shade("RENDERED")
    yield from settled_image()
    bpy.data.objects["Cube"].location.x += 0.1
    yield
    reached("alive")


run = steps()


def tick():
    try:
        next(run)
    except StopIteration:
        write()
        bpy.ops.wm.quit_blender()  # while it traces
        return None
    except BaseException:
        write(error=traceback.format_exc())
        os._exit(1)
    return 0.2


bpy.app.timers.register(tick, first_interval=1.0, persistent=True)
