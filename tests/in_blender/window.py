"""Runs inside a Blender window and does what a user does there: press Render Hologram, refocus, play, encode,
cancel, undo, delete the scene, move something or open another file meanwhile, F12.

    blender --enable-event-simulate --python window.py -- RESULT.json

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

LIMIT = 900.0  # seconds
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


class Ticks:
    """Intervals of a window's timer while HoloPath is at work, with the activities of the long ones."""

    STEP = 0.01  # seconds

    def __init__(self):
        self._gaps = []
        self._doing = ""
        self._timer = self._tick  # the very object that Blender knows
        self._last = time.monotonic()
        bpy.app.timers.register(self._timer)

    def _tick(self):
        now = time.monotonic()
        self._gaps.append((round(now - self._last, 3), self._doing))
        self._last = now
        job = session().current.job
        self._doing = job.message if job is not None and job.running else "showing"
        return self.STEP

    def stop(self):
        """The longest gaps, seconds, longest first, each with what the work was doing; all of them, and how many."""
        bpy.app.timers.unregister(self._timer)
        seconds = sum(gap for gap, _ in self._gaps)
        return {
            "longest": sorted(self._gaps, reverse=True)[:12],
            "seconds": seconds,
            "count": len(self._gaps),
        }


def session():
    """The add-on's session module, whatever Blender calls its package."""
    return next(m for name, m in sys.modules.items() if name.endswith("holopath.operators.session"))


def prepare():
    """Blender's own cube with a noise on it, camera and lamp, against black, at a size that takes a second or two."""
    bpy.context.preferences.view.show_splash = False
    scene = bpy.context.scene
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    scene.camera.location *= 0.5
    tree = bpy.data.objects["Cube"].active_material.node_tree
    noise, principled = tree.nodes.new("ShaderNodeTexNoise"), tree.nodes["Principled BSDF"]
    tree.links.new(noise.outputs["Color"], principled.inputs["Base Color"])
    configure(scene)


def configure(scene):
    """Settings that take a second or two."""
    props = scene.holopath
    props.resolution_x = props.resolution_y = SIZE
    props.depth_far_mm, props.depth_near_mm = 4.0, 6.0
    props.frames = 4
    props.quality = "preview"
    props.method = "full"
    props.focus = 5.0


def press(operator, **settings):
    """Invoke an operator as its button in the 3D View would."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator("INVOKE_DEFAULT", **settings)


def over():
    """Wait until the running work and its operator have ended."""
    while session().current.job is not None:
        yield 0.02
    yield 0.1


def picture():
    """The reconstruction, array [y, x, rgb], once there is light in it, else None."""
    image = bpy.data.images.get(NAME)
    if image is None or not image.has_data:
        return None
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    color = pixels.reshape(image.size[1], image.size[0], 4)[..., :3]
    return color if color.any() else None


def describe(color):
    """Size, and how bright the cube in the middle is against the corners."""
    rows, columns = color.shape[0] // 8, color.shape[1] // 8
    middle = color[3 * rows : -3 * rows, 3 * columns : -3 * columns].mean()
    corners = np.concatenate([color[:rows, :columns], color[-rows:, -columns:]]).mean()
    return {"size": color.shape[1::-1], "middle": float(middle), "corners": float(corners)}


def baked():
    """Notes on what was baked for the last render."""
    return [note for note in session().current.notes if "baked" in note]


def steps():
    """The user's actions; every `yield` gives Blender time to work and redraw."""
    yield 0.5
    prepare()
    yield 0.5
    yield from rendering()
    yield from refocusing()
    yield from encoding()
    yield from canceling()
    yield from disturbing()
    yield from dragging()
    yield from f12()
    yield from without_a_camera()


def rendering():
    """The button; the window lives meanwhile, and a second press is refused."""
    bpy.ops.wm.save_as_mainfile(filepath=target + ".blend", copy=True)
    ticks = Ticks()
    result["pressed"] = sorted(press(bpy.ops.holopath.render_hologram))
    result["twice"] = bpy.ops.holopath.render_hologram.poll()
    yield from over()
    result["gaps"] = ticks.stop()
    result.update(describe(picture()))
    result["baked"] = [baked()]
    result["steps"].append("rendered")
    session().current.field.save(target + ".wavefield")
    # Once more, with a picture in the window, where a new window need not be opened for it.
    second = bpy.context.window_manager.windows[1]
    with bpy.context.temp_override(window=second):
        bpy.ops.wm.window_close()
    areas = bpy.context.window_manager.windows[0].screen.areas
    timeline = next(area for area in areas if area.type == "DOPESHEET_EDITOR")
    timeline.type = timeline.ui_type = "IMAGE_EDITOR"
    yield 0.5
    ticks = Ticks()
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    result["gaps_again"] = ticks.stop()


def refocusing():
    """The slider, then Play and Stop."""
    near = picture()
    begin = time.monotonic()
    bpy.context.scene.holopath.focus = 0.5
    while np.array_equal(picture(), near):
        yield 0.01
    result["refocus"] = time.monotonic() - begin
    far = picture()
    press(bpy.ops.holopath.sweep)
    images, end = set(), time.monotonic() + 600
    while len(images) < 4 and time.monotonic() < end:
        images.add(picture().tobytes())
        yield 0.05
    press(bpy.ops.holopath.sweep)
    while session().is_refocusing():
        yield 0.05
    still = picture()
    yield 0.5
    result["played"] = len(images)
    result["stopped"] = bool(np.array_equal(still, picture())) and session().current.sweep_timer is None
    assert not np.array_equal(near, far)
    result["steps"].append("refocused")


def encoding():
    """Encode, and look at another frame."""
    press(bpy.ops.holopath.encode)
    yield from over()
    image = bpy.data.images["HoloPath Phase"]
    first = image.pixels[:]
    bpy.context.scene.holopath.phase_frame = 2
    yield 0.1
    result["phases"] = [len(session().current.phase.data), first != image.pixels[:], 0 <= min(first)]
    result["steps"].append("encoded")


def canceling():
    """Esc, on a render that would take long; the last picture comes back."""
    props = bpy.context.scene.holopath
    before, field = picture(), session().current.field
    props.resolution_x = props.resolution_y = 1024
    props.quality = "high"
    press(bpy.ops.holopath.render_hologram)
    while session().current.job is not None and session().current.job.done < 0.1:
        yield 0.02
    window, begin = bpy.context.window_manager.windows[0], time.monotonic()
    window.event_simulate(type="ESC", value="PRESS", x=400, y=400)
    window.event_simulate(type="ESC", value="RELEASE", x=400, y=400)
    yield from over()
    result["canceled"] = time.monotonic() - begin
    yield 1.0
    after = picture()
    result["kept"] = session().current.field is field and before.shape == after.shape
    result["steps"].append("canceled")
    configure(bpy.context.scene)


def disturbing():
    """Undo, another scene in the window, the scene deleted, another file: all while a hologram is rendered."""
    bpy.ops.ed.undo_push(message="before")
    bpy.data.objects["Cube"].location.x += 0.1
    bpy.ops.ed.undo_push(message="moved")
    press(bpy.ops.holopath.render_hologram)
    yield 0.6
    press(bpy.ops.ed.undo)
    yield from over()
    result["undone"] = session().current.error
    result["steps"].append("undone")

    window = bpy.context.window_manager.windows[0]
    other = bpy.data.scenes.new("Other")
    window.scene.holopath.quality = "high"  # takes long enough to be seen at work
    press(bpy.ops.holopath.render_hologram)
    while session().current.job.done == 0:
        yield 0.05
    rendered, window.scene = window.scene, other
    yield 0.1
    bpy.data.scenes.remove(rendered)
    yield from over()
    result["deleted"] = [session().current.error, session().current.field is not None]
    result["steps"].append("deleted")

    yield from opening_a_broken_file()

    bpy.ops.wm.read_homefile(use_empty=False, use_factory_startup=True)
    yield 0.5
    prepare()
    press(bpy.ops.holopath.render_hologram)
    yield 0.6
    bpy.ops.wm.read_homefile(use_empty=False, use_factory_startup=True)
    yield 0.5
    result["reopened"] = [session().current.job is None, session().current.field is None]
    result["steps"].append("reopened")
    prepare()
    yield 0.5


def opening_a_broken_file():
    """While a hologram is rendered: the render ends, the one before stays, and the next one is served."""
    bpy.ops.wm.read_homefile(use_empty=False, use_factory_startup=True)
    yield 0.5
    prepare()
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    field, broken = session().current.field, target + ".broken.blend"
    bpy.ops.wm.save_as_mainfile(filepath=broken, copy=True, compress=False)
    os.truncate(broken, 4000)
    press(bpy.ops.holopath.render_hologram)
    yield 0.3
    try:
        bpy.ops.wm.open_mainfile(filepath=broken)
    except RuntimeError:
        result["broken"] = [session().current.field is field]
    yield 0.3
    move(500)
    yield from over()
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    result["broken"].append(session().current.field is not field)
    result["steps"].append("not opened")


def move(x):
    """Have the pointer lie elsewhere."""
    bpy.context.window_manager.windows[0].event_simulate(type="MOUSEMOVE", value="NOTHING", x=x, y=400)


def dragging():
    """A render ends while the cube is moved, which is then canceled: no undo step has the cube half way."""
    cube = bpy.data.objects["Cube"]
    press(bpy.ops.holopath.plan)
    result["estimating"] = session().current.job is not None
    yield from over()
    result["estimated"] = session().current.plan.seconds
    bpy.ops.ed.undo_push(message="before")
    press(bpy.ops.holopath.render_hologram)
    move(400)
    press(bpy.ops.transform.translate)
    yield 0.2
    move(600)
    yield from over()
    half_way = cube.location.copy()
    window = bpy.context.window_manager.windows[0]
    window.event_simulate(type="ESC", value="PRESS", x=600, y=400)
    window.event_simulate(type="ESC", value="RELEASE", x=600, y=400)
    yield 0.5
    bpy.data.objects["Light"].location.x += 1
    bpy.ops.ed.undo_push(message="after")
    press(bpy.ops.ed.undo)
    yield 0.2
    result["dragged"] = [half_way.length, bpy.data.objects["Cube"].location.length]
    result["steps"].append("dragged")


def f12():
    done = []
    bpy.app.handlers.render_complete.append(lambda *_: done.append(True))
    bpy.app.handlers.render_cancel.append(lambda *_: done.append(False))
    bpy.context.scene.render.engine = "HOLOPATH"
    bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 96
    bpy.context.scene.holopath.focus = 1.0
    bpy.context.scene.holopath.focus_auto = True
    press(bpy.ops.render.render)
    while not done:
        yield 0.1
    yield 0.3
    result["f12"], result["f12_focus"] = done[0], bpy.context.scene.holopath.focus
    result["baked"].append(baked())
    result["scenes"] = len(bpy.data.scenes)
    result["steps"].append("f12")


def without_a_camera():
    bpy.data.objects.remove(bpy.context.scene.camera)
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    result["without_camera"] = session().current.error
    for _ in range(5):
        yield 0.2
    result["steps"].append("alive")


run = steps()


@bpy.app.handlers.persistent
def tick():
    try:
        return next(run)
    except StopIteration:
        write()
        bpy.ops.wm.quit_blender()
        return None
    except BaseException:
        write(error=traceback.format_exc())
        os._exit(1)


bpy.app.timers.register(tick, first_interval=1.0, persistent=True)
