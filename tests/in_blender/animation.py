"""Runs inside a Blender window: an animation in the background, in which Blender is killed; once more to its end.

    blender --python animation.py -- FOLDER

Without FOLDER/scene.blend the first part, which ends without a word; RESULT.json in FOLDER says what the second saw.
"""

import json
import os
import signal
import sys
import threading
import time
import traceback
from pathlib import Path

import bpy

LIMIT = 900.0  # seconds
FRAMES = 4
folder = Path(sys.argv[sys.argv.index("--") + 1])
scene_file = folder / "scene.blend"


def write(name, **result):
    part = folder / "part"
    part.write_text(json.dumps(result), encoding="utf-8")
    os.replace(part, folder / name)


def give_up():
    write("RESULT.json", error=f"not finished after {LIMIT:.0f} s")
    os._exit(1)


watchdog = threading.Timer(LIMIT, give_up)
watchdog.daemon = True
watchdog.start()


def module(name):
    return sys.modules[f"bl_ext.user_default.holopath.operators.{name}"]


def press(operator):
    """Invoke an operator as its button in the 3D View would."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator("INVOKE_DEFAULT")


def prepare():
    """Blender's cube moves; settings that take a second a frame."""
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, FRAMES
    cube = bpy.data.objects["Cube"]
    for frame in (1, FRAMES):
        cube.location.x = 0.1 * frame
        cube.keyframe_insert("location", frame=frame)
    props = scene.holopath
    props.resolution_x = props.resolution_y = (
        320  # a frame takes longer than it takes to notice the one before
    )
    props.depth_far_mm, props.depth_near_mm = 1.25, 1.875
    props.frames, props.quality, props.colours = 1, "preview", "MONO"
    bpy.ops.wm.save_as_mainfile(filepath=str(scene_file))


def first():
    """Killed in the middle, as by the system for want of memory."""
    prepare()
    bpy.data.objects["Cube"].location.y = 0.25  # which is not saved
    press(bpy.ops.ed.undo_push)
    before = [bpy.data.is_dirty, bpy.data.filepath]
    assert press(bpy.ops.holopath.render_animation) == {"FINISHED"}
    work = module("background").current
    while work.finished < 2 or work.message == "Exporting the scene":
        assert not work.ended, work.error
        yield 0.02
    after = [bpy.data.is_dirty, bpy.data.filepath]
    write("killed.json", pid=work._process.pid, before=before, after=after)
    os.kill(os.getpid(), signal.SIGKILL)


def second():
    """The button goes on; a second press is refused; the window lives; again, and nothing is made."""
    bpy.ops.wm.open_mainfile(filepath=str(scene_file))
    yield 0.5
    bpy.data.objects["Cube"].location.y = 0.25
    result = {"first": [], "longest": 0.0}
    begin = last = time.monotonic()
    press(bpy.ops.holopath.render_animation)
    work = module("background").current
    result["twice"] = bpy.ops.holopath.render_animation.poll()
    while not work.ended:
        now = time.monotonic()
        result["longest"], last = max(result["longest"], now - last), now
        result["first"].append(work.finished)
        yield 0.02
    result["seconds"] = last - begin
    result["ended"] = [work.error, work.finished, work.canceled]
    press(bpy.ops.holopath.render_animation)
    work = module("background").current
    while not work.ended:
        yield 0.02
    result["again"] = [work.error, work.finished, work.message]
    press(bpy.ops.holopath.render_animation)
    work = module("background").current
    press(bpy.ops.holopath.cancel_animation)
    while not work.ended:
        yield 0.02
    result["canceled"] = [work.error, work.canceled]
    write("RESULT.json", **result)
    bpy.ops.wm.quit_blender()


run = second() if scene_file.exists() else first()


@bpy.app.handlers.persistent
def tick():
    try:
        return next(run)
    except StopIteration:
        return None
    except BaseException:
        write("RESULT.json", error=traceback.format_exc())
        os._exit(1)


bpy.app.timers.register(tick, first_interval=1.0, persistent=True)
