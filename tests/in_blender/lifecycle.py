"""Runs inside a Blender window that has the extension: renders, cancels, and takes it away in every way Blender knows.

    blender --python lifecycle.py -- RESULT.json

Whatever happens, RESULT.json says how far it got, and Blender ends: by itself, or after LIMIT seconds.
"""

import json
import os
import sys
import threading
import traceback
import weakref

import addon_utils
import bpy

sys.path.insert(0, os.path.dirname(__file__))
from traces import modules, traces

LIMIT = 900.0  # seconds
NAME = "bl_ext.user_default.holopath"
target = sys.argv[sys.argv.index("--") + 1]
result = {"steps": []}


def write(**more):
    """Write the result beside its name, then rename it."""
    result.update(more)
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
    """Blender's own cube at a size that takes a moment."""
    bpy.context.preferences.view.show_splash = False
    props = bpy.context.scene.holopath
    props.resolution_x = props.resolution_y = 256
    props.depth_far_mm, props.depth_near_mm = 4.0, 6.0
    props.frames = 4
    props.quality = "preview"


def press(operator, **settings):
    """Invoke an operator as its button would."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator("INVOKE_DEFAULT", **settings)


def rendering(tasks, cancel=False):
    """Render once, to its end or canceled when the scene is read, as a generator."""
    session, before = sys.modules[NAME + ".operators.session"], len(tasks)
    press(bpy.ops.holopath.render_hologram)
    job = session.current.job
    if cancel:
        while len(tasks) == before:
            yield
        job.cancel()
    while session.current.job is job:
        yield
    result["steps"].append("rendered" if job.error is None else type(job.error).__name__)


def watch(session):
    """Weak references to all tasks from now on."""
    tasks, prepare = [], session.prepare

    def watched(*arguments, **settings):
        task = prepare(*arguments, **settings)
        tasks.append(weakref.ref(task))
        return task

    session.prepare = watched
    return tasks


def steps():
    """Steps of a user; every `yield` gives Blender time to work and redraw."""
    yield
    result["enabled"] = traces()
    prepare()
    tasks = watch(sys.modules[NAME + ".operators.session"])
    yield from rendering(tasks)
    for _ in range(3):
        yield from rendering(tasks, cancel=True)
    yield from rendering(tasks)
    for _ in range(3):
        yield
    result["tasks"], result["held"] = len(tasks), sum(task() is not None for task in tasks)

    press(bpy.ops.holopath.render_hologram)  # and disable it while it is at work
    yield
    bpy.ops.preferences.addon_disable(module=NAME)
    for _ in range(8):  # its last timer takes back what an operator changed in the window
        yield
    result["held_disabled"] = sum(task() is not None for task in tasks)
    result["disabled"] = traces()
    for _ in range(3):
        bpy.ops.preferences.addon_enable(module=NAME)
        yield
        result["enabled_again"] = traces()
        bpy.ops.preferences.addon_disable(module=NAME)
        yield
    result["disabled_again"] = traces()

    bpy.ops.preferences.addon_enable(module=NAME)
    yield
    bpy.ops.script.reload()
    for _ in range(5):
        yield
    result["reloaded"] = traces()
    prepare()
    yield from rendering(tasks)

    folder = os.path.dirname(sys.modules[NAME].__file__)
    repositories = bpy.context.preferences.extensions.repos
    index = next(n for n, repository in enumerate(repositories) if repository.module == "user_default")
    press(bpy.ops.extensions.package_uninstall, repo_index=index, pkg_id="holopath")
    while os.path.exists(folder):
        yield
    for _ in range(5):
        yield
    result["uninstalled"] = traces()
    result["modules"] = modules(NAME)
    result["known"] = [module.__name__ for module in addon_utils.modules() if "holopath" in module.__name__]
    local = os.path.join(os.path.dirname(os.path.dirname(folder)), ".local")
    result["wheels"] = [
        name for _, names, _ in os.walk(local) for name in names if name.startswith("mitsuba")
    ]


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
    return 0.1


bpy.app.timers.register(tick, first_interval=1.0)
