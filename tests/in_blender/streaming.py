"""Streaming in a window: a hologram on the second monitor, whose process is killed once, while the user works on.

``blender --python streaming.py -- RESULT``; it waits for RESULT.seen when RESULT.showing is there.
"""

import json
import os
import sys
import time
import traceback
from pathlib import Path

import bpy
import numpy as np

target = sys.argv[sys.argv.index("--") + 1]
result = {"steps": [], "blender": bpy.app.version_string}
SIZE = 640, 480


def module(name):
    """A module of the add-on, whatever Blender calls its package."""
    return next(m for key, m in sys.modules.items() if key.endswith(f"holopath.{name}"))


def phases():
    """Known to the test too."""
    return np.random.default_rng(9).uniform(0, 2 * np.pi, (1, 1, SIZE[1], SIZE[0])).astype(np.float32)


def press(operator, **settings):
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator("INVOKE_DEFAULT", **settings)


gaps, last = [], time.monotonic()


def tick():
    """Longest time for which the window stands still."""
    global last
    now = time.monotonic()
    gaps.append(now - last)
    last = now
    return 0.01


def until(done, seconds, what):
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, what
        yield 0.02


def steps():
    global last
    yield 1.0
    bpy.context.preferences.view.show_splash = False
    bpy.context.preferences.filepaths.auto_save_time = 1
    bpy.ops.ed.undo_push(message="a change")
    devices, session, engine = module("operators.devices"), module("operators.session"), module("engine")
    volume = engine.Hologram(*SIZE, 8e-6, (520e-9,))
    hologram = engine.PhaseHologram(phases(), volume, engine.Camera(np.eye(4), 0.7), 0.5, "dpac", (1.0,))
    session.keep_phase(hologram)
    device = bpy.context.scene.holopath.device
    press(bpy.ops.holopath.find_devices)
    found = module("blender.device_properties").found_devices
    yield from until(lambda: "monitors" in found, 20, "no devices found")
    result["monitors"] = found.pop("monitors")
    module("operators.streaming").NUMBER_SECONDS = 0.5
    press(bpy.ops.holopath.identify_monitors)
    yield from until(lambda: "monitors" in found, 20, "no numbers are shown")
    result["identified"] = found["monitors"]
    device.driver, device.rate = "display", 60.0
    result["pressed"] = sorted(press(bpy.ops.holopath.stream))
    last = time.monotonic()
    bpy.app.timers.register(tick)
    yield from until(
        lambda: devices.current.counts and devices.current.counts.shown > 60, 30, "nothing is shown"
    )
    result["opening"] = max(gaps)
    gaps.clear()
    Path(target + ".showing").touch()
    yield from until(Path(target + ".seen").exists, 30, "nobody has seen it")
    result["twice"] = bpy.ops.holopath.stream.poll()
    view = next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D")
    space = view.spaces.active
    for turn in range(60):  # the user turns the view
        space.region_3d.view_distance = 10 + turn / 20
        view.tag_redraw()
        yield 0.02
    result["gaps"] = max(gaps)
    result["steps"].append("shown")
    module("operators.long_modal").MINUTE = 0.5  # Blender saves after 60 s, HoloPath makes way twice a second

    devices.current.driver._window._process.kill()
    begin = time.monotonic()
    yield from until(lambda: devices.current.counts.lost, 5, "the loss is not noticed")
    result["noticed"], result["lost"] = time.monotonic() - begin, devices.current.counts.lost
    yield from until(lambda: devices.current.counts.reconnected == 1, 20, "not connected again")
    shown = devices.current.counts.shown
    yield from until(lambda: devices.current.counts.shown > shown + 30, 20, "nothing is shown again")
    result["steps"].append("reconnected")
    # Blender's own auto-save, see `wm_autosave_location` in its source
    saved = Path(bpy.app.tempdir).parent / f"{os.getpid()}_autosave.blend"
    yield from until(saved.exists, 90, "no auto-save")
    module("operators.long_modal").MINUTE = 60.0
    yield 1.0  # the last pause is over
    result["saved"] = [bpy.data.is_dirty, devices.streaming(), devices.current.counts.reconnected]

    window, begin = bpy.context.window_manager.windows[0], time.monotonic()
    window.event_simulate(type="ESC", value="PRESS", x=400, y=400)
    window.event_simulate(type="ESC", value="RELEASE", x=400, y=400)
    yield from until(lambda: not devices.streaming(), 5, "not stopped")
    result["stopping"] = time.monotonic() - begin
    yield from until(lambda: devices.current.timer is None, 5, "the operator has not ended")
    result["counts"], result["error"] = str(devices.current.counts), devices.current.error
    result["steps"].append("stopped")

    # another file, while it shows
    press(bpy.ops.holopath.stream)
    yield from until(
        lambda: devices.current.counts and devices.current.counts.shown > 10, 30, "not shown once more"
    )
    process = devices.current.driver._window._process
    bpy.ops.wm.read_homefile(use_empty=False, use_factory_startup=True)
    yield 0.5
    result["let_go"] = [devices.current.job is None, process.poll() is not None]
    result["steps"].append("another file")

    # disabled while it shows
    session.keep_phase(hologram)
    bpy.context.scene.holopath.device.rate = 60.0
    press(bpy.ops.holopath.stream)
    yield from until(
        lambda: devices.current.counts and devices.current.counts.shown > 10, 30, "not shown at last"
    )
    process = devices.current.driver._window._process
    name = next(name for name in bpy.context.preferences.addons.keys() if name.endswith("holopath"))
    bpy.ops.preferences.addon_disable(module=name)
    yield 1.5
    result["disabled"] = [process.poll() is not None, hasattr(bpy.types.Scene, "holopath")]
    bpy.ops.preferences.addon_enable(module=name)
    yield 0.5
    result["steps"].append("disabled")


def run():
    """A timer: the next step, and at the end the result."""
    try:
        return next(todo)
    except StopIteration:
        pass
    except BaseException:
        result["error"] = traceback.format_exc()
    Path(target).write_text(json.dumps(result, default=str), encoding="utf-8")
    bpy.ops.wm.quit_blender()
    return None


todo = steps()
bpy.app.timers.register(run, first_interval=1.0, persistent=True)
