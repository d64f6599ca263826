"""Runs inside a Blender window: draws all that HoloPath draws in every state it has, each reached as users reach it.

    blender --enable-event-simulate --python panels.py -- RESULT.json

A state lasts while the work that makes it is held at a report of progress. Whatever happens, RESULT.json says how far
it got, and Blender ends: by itself, or after LIMIT seconds.
"""

import json
import os
import sys
import threading
import time
import traceback
from contextlib import contextmanager
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parents[1] / "slm"))
from device import Board, Firmware

LIMIT = 900.0  # seconds
PATIENCE = 600.0  # seconds for one step
ADDON = "bl_ext.user_default.holopath"
SIZE = 48  # pixels
target = sys.argv[sys.argv.index("--") + 1]
result = {"blender": bpy.app.version_string, "states": [], "broken": []}
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


def module(name):
    return sys.modules[f"{ADDON}.{name}"]


def press(operator, **settings):
    """Invoke an operator as its button in the 3D View would."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with bpy.context.temp_override(window=window, area=area, region=region):
        return operator("INVOKE_DEFAULT", **settings)


def until(done, what):
    end = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < end, what
        yield 0.02


def at_work():
    return module("operators.session").running()


def over():
    """Wait until the running work and its operator have ended."""
    yield from until(lambda: module("operators.session").current.job is None, "still at work")
    yield 0.1


# -- what is drawn

drawn = set()
REGIONS = {"UI", "WINDOW"}
POPUPS = {
    "VIEW3D_MT_add": "wm.call_menu",
    "HOLOPATH_MT_demos": "wm.call_menu",
    "HOLOPATH_PT_display_presets": "wm.call_panel",
}


@contextmanager
def noted(name):
    """Whoever draws has come to the end, or what stopped it."""
    try:
        yield
    except BaseException:
        result["broken"].append(f"{name}: {traceback.format_exc()}")
        raise
    drawn.add(name)


def watch(cls, method="draw"):
    """Note each call of a method by the name of its class."""
    draw, name = getattr(cls, method), cls.__name__ if method == "draw" else f"{cls.__name__}.{method}"

    def watched(self, context):  # Blender counts the arguments
        with noted(name):
            draw(self, context)

    setattr(cls, method, watched)
    return name


def watch_all():
    """Note all that is drawn, and have no panel closed; names of what is in the window."""
    panels, menus, overlay = module("ui.panels"), module("ui.menus"), module("ui.overlay")
    for cls in reversed(panels.CLASSES):
        bpy.utils.unregister_class(cls)
    for cls in panels.CLASSES:
        cls.bl_options = getattr(cls, "bl_options", set()) - {"DEFAULT_CLOSED"}
        bpy.utils.register_class(cls)
    there = {watch(cls) for cls in (*panels.CLASSES, *module("ui.engine_panels").CLASSES)}
    there |= {watch(cls, "draw_header_preset") for cls in panels.CLASSES if "draw_header_preset" in vars(cls)}

    rows = bpy.types.HOLOPATH_UL_focus
    draw_item, visible_outlines, add_menu = rows.draw_item, overlay._visible_outlines, menus._add_menu
    bench = module("ui.bench_overlay")
    visible_hologram = bench.visible_hologram

    def watched_item(self, context, layout, data, item, icon, active_data, active_property, index):
        with noted(rows.__name__):
            draw_item(self, context, layout, data, item, icon, active_data, active_property, index)

    def watched_overlay(context):
        with noted("overlay"):
            return visible_outlines(context)

    def watched_menu(self, context):
        with noted("VIEW3D_MT_add"):
            add_menu(self, context)

    def watched_bench(context):
        with noted("sketch"):
            return visible_hologram(context)

    rows.draw_item, overlay._visible_outlines, bench.visible_hologram = (
        watched_item,
        watched_overlay,
        watched_bench,
    )
    menus.remove_from_menus()
    menus._add_menu = watched_menu
    menus.add_to_menus()
    for name in ("HOLOPATH_MT_demos", "HOLOPATH_PT_display_presets"):
        watch(getattr(bpy.types, name))
    return there | {rows.__name__, "overlay", "sketch"}


def lay_out():
    """Editors for all panels: sidebars of a 3D View and an Image Editor, four tabs of the properties."""
    window = bpy.context.window_manager.windows[0]
    areas = {area.type: area for area in window.screen.areas}
    view, tabs = areas["VIEW_3D"], [areas["PROPERTIES"], areas["OUTLINER"], areas["DOPESHEET_EDITOR"]]
    for area, direction in ((view, "VERTICAL"), (tabs[0], "HORIZONTAL")):
        with bpy.context.temp_override(window=window, area=area, region=area.regions[0]):
            bpy.ops.screen.area_split(direction=direction, factor=0.5)
    known = {view, *tabs}
    image, tab = sorted(set(window.screen.areas) - known, key=lambda area: area.type == "PROPERTIES")
    tabs.append(tab)
    image.type = image.ui_type = "IMAGE_EDITOR"
    for area in tabs:
        area.type = area.ui_type = "PROPERTIES"
    yield 0.2
    for area in (view, image):
        area.spaces.active.show_region_ui = True
    for area, context in zip(tabs, ("RENDER", "OUTPUT", "VIEW_LAYER", "MATERIAL"), strict=True):
        area.spaces.active.context = context
    yield 0.2
    for area in (view, image):
        next(region for region in area.regions if region.type == "UI").active_panel_category = "HoloPath"


def redraw():
    for area in bpy.context.window_manager.windows[0].screen.areas:
        for region in area.regions:
            if region.type in REGIONS:
                region.tag_redraw()


def all_drawn(state, popups=True):
    """Wait until everything was drawn since now, in the window and, one after the other, over it."""
    drawn.clear()
    redraw()
    end = time.monotonic() + PATIENCE
    while not there <= drawn:
        assert not result["broken"], state
        assert time.monotonic() < end, f"{state}: not drawn: {sorted(there - drawn)}"
        yield 0.02
        redraw()
    for name, operator in POPUPS.items() if popups else ():
        call = getattr(bpy.ops.wm, operator.partition(".")[2])
        press(call, name=name)
        yield from until(lambda name=name: name in drawn, f"{state}: {name} is not drawn")
        key("ESC")
        yield 0.02
    result["states"].append(state)


def key(name):
    window = bpy.context.window_manager.windows[0]
    for value in ("PRESS", "RELEASE"):
        window.event_simulate(type=name, value=value, x=400, y=400)


class Gate:
    """Holds the work of the session's job where it reports something, or where it is to stop.

    Attributes
    ----------
    reports : list of float
        How far the work was, at each report.
    """

    def __init__(self):
        self.reports = []
        self._at, self._reached, self._go = None, threading.Event(), threading.Event()
        job, gate = module("operators.jobs").Job, self
        progress = job._progress

        def held(self, done, message):
            if self.canceling:
                gate._hold("canceling")
            progress(self, done, message)
            if self is module("operators.session").current.job:
                gate.reports.append(done)
                gate._hold(message)

        job._progress = held

    def _hold(self, where):
        if self._at is not None and where.startswith(self._at):
            self._reached.set()
            self._go.wait(PATIENCE)

    def close(self, at):
        """Hold what comes there; what is held goes on."""
        going, self._at = self._go, at
        self._reached, self._go = threading.Event(), threading.Event()
        going.set()

    def open(self):
        self.close(None)

    def reached(self):
        yield from until(self._reached.is_set, f"never came to '{self._at}'")


# -- a whole render, watched


class Heard:
    """A layout that remembers what is asked of it and of its parts."""

    def __init__(self, layout, calls):
        self.__dict__.update(_layout=layout, _calls=calls)

    def __setattr__(self, name, value):
        setattr(self._layout, name, value)

    def __getattr__(self, name):
        def call(*values, **named):
            self._calls.append((name, values, named))
            inner = getattr(self._layout, name)(*values, **named)
            return Heard(inner, self._calls) if isinstance(inner, bpy.types.UILayout) else inner

        return call


def watching():
    """The row with the progress, each time it is drawn, and all that the status bar says."""
    session, rows, status = module("operators.session"), [], []
    panel, space = bpy.types.HOLOPATH_PT_view3d_render, bpy.types.WorkSpace
    section, tell, pressed = panel.section, space.status_text_set, time.monotonic()

    def heard(layout, context):
        calls, running = [], session.running()
        section(Heard(layout, calls), context)
        if running:
            progress = [named for name, _, named in calls if name == "progress"]
            buttons = [values[0] for name, values, _ in calls if name == "operator"]
            rows.append([time.monotonic() - pressed, progress, buttons])

    def record_status(self, text):
        status.append([time.monotonic() - pressed, text])
        tell(self, text)

    panel.section, space.status_text_set = staticmethod(heard), record_status
    gate.reports.clear()
    press(bpy.ops.holopath.render_hologram)
    while not rows:
        yield 0.01
    result["on_screen"] = time.monotonic() - pressed  # timers fire when all has been drawn
    yield from over()
    result.update(rows=rows, status=status, reports=gate.reports[:], took=time.monotonic() - pressed)
    panel.section, space.status_text_set = staticmethod(section), tell


# -- states


def configure(scene, pixels):
    """Default settings at another size, with the depth range that suits it."""
    props = scene.holopath
    for prop in props.bl_rna.properties:
        if not prop.is_readonly and prop.type not in ("COLLECTION", "POINTER"):
            props.property_unset(prop.identifier)
    props.resolution_x = props.resolution_y = pixels
    props.depth_far_mm, props.depth_near_mm = 10 * pixels / 512, 15 * pixels / 512
    props.show_bench = True


def steps():
    """The user's actions; every `yield` gives Blender time to work and redraw."""
    global there, gate
    yield 0.5
    bpy.context.preferences.view.show_splash = False
    scene = bpy.context.scene
    scene.render.engine = "HOLOPATH"
    there = watch_all()
    gate = Gate()
    yield from lay_out()
    scene.holopath.show_bench = True
    for dioptres in (2.0, 0.0):
        scene.holopath.focus_dioptres = dioptres
        press(bpy.ops.holopath.focus_list_add)
    scene.holopath.focus_dioptres = 1.0
    yield from all_drawn("nothing rendered")
    yield from unavailable()
    configure(scene, SIZE)
    yield from drafting(scene)
    configure(scene, 160)
    yield 1.0  # until nothing else has anything to be drawn
    yield from watching()
    yield from all_drawn("rendered")
    configure(scene, SIZE)
    yield from no_camera(scene)
    yield from estimating(scene)
    yield from rendering(scene)
    yield from looking(scene)
    yield from baking(scene)
    yield from encoding(scene)
    yield from streaming(scene)
    yield from choosing(scene)
    yield from in_another_scene(scene)


def unavailable():
    """The preferences choose a graphics card where there is none."""
    preferences = bpy.context.preferences.addons[ADDON].preferences
    preferences.backend = "cuda_ad_rgb"
    assert module("blender.preferences").backend_problem(), (
        "this machine has a graphics card: name none to this test"
    )
    yield from all_drawn("Mitsuba unavailable")
    preferences.backend = "AUTO"


def drafting(scene):
    """A draft first, however little it saves: it can be refocused, stays after Esc, and gives way to the hologram."""
    pipeline, session = module("workflow.pipeline"), module("operators.session")
    usual, pipeline.MIN_PREVIEW_SECONDS, pipeline.MIN_DRAFT_RATIO = (
        (pipeline.MIN_PREVIEW_SECONDS, pipeline.MIN_DRAFT_RATIO),
        0.0,
        0.0,
    )
    gate.close("Draft")
    press(bpy.ops.holopath.render_hologram)
    yield from gate.reached()
    assert session.current.field is None
    yield from all_drawn("drafting")
    gate.close("Radiance")
    yield from gate.reached()
    yield from until(lambda: session.current.draft, "no draft is kept")
    yield from all_drawn("a draft")
    assert at_work()
    draft, before = session.current.field, picture()
    scene.holopath.focus = 2.0
    yield from until(lambda: not session.is_refocusing(), "the draft is not refocused")
    assert picture() != before
    key("ESC")
    yield from until(lambda: session.current.job.canceling, "Esc does nothing")
    gate.open()
    yield from over()
    assert session.current.field is draft and session.current.draft and not session.current.error
    yield from until(lambda: not session.is_refocusing(), "its picture does not come back")
    yield from all_drawn("the draft stays")
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    assert session.current.field is not draft and not session.current.draft
    assert scene.holopath.focus == 2.0
    pipeline.MIN_PREVIEW_SECONDS, pipeline.MIN_DRAFT_RATIO = usual


def picture():
    return bpy.data.images["HoloPath Reconstruction"].pixels[:]


def no_camera(scene):
    camera, scene.camera = scene.camera, None
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    assert "camera" in module("operators.session").current.error
    yield from all_drawn("no camera")
    scene.camera = camera


def estimating(scene):
    """Estimate a scene with export notes, and a method without an estimate."""
    tree = bpy.data.objects["Cube"].active_material.node_tree
    tree.nodes["Principled BSDF"].inputs["Subsurface Weight"].default_value = 0.5
    for method in ("point", "auto"):
        scene.holopath.method = method
        press(bpy.ops.holopath.plan)
        while module("operators.session").current.job is not None:
            yield 0.05
        yield from all_drawn(f"estimated, {method}")
    assert module("operators.session").current.notes


def rendering(scene):
    """Held at its stages; canceled, and once more to the end."""
    scene.holopath.method = "full"
    gate.close("Building the scene")
    press(bpy.ops.holopath.render_hologram)
    for stage in ("Planning", "Radiance", "Wave tracing"):
        yield from gate.reached()
        gate.close(stage)
    yield from gate.reached()
    yield 1.1  # until there is something to tell about the time left
    yield from all_drawn("rendering")
    assert at_work()
    press(bpy.ops.holopath.cancel)
    gate.close("canceling")
    yield from gate.reached()
    yield from all_drawn("canceling")
    assert at_work() and module("operators.session").current.job.canceling
    gate.open()
    yield from over()
    yield from all_drawn("canceled")
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    assert not module("operators.session").current.error
    yield from all_drawn("rendered again")


def looking(scene):
    """The focus plays; a part of the pupil that no light passes."""
    session, props = module("operators.session"), scene.holopath
    press(bpy.ops.holopath.sweep)
    yield from all_drawn("playing")
    assert session.current.sweep_timer is not None
    press(bpy.ops.holopath.sweep)
    yield from until(lambda: not session.is_refocusing(), "it plays on")
    props.pupil_offset_mm, props.use_pupil = (900.0, 0.0), True
    yield from until(lambda: session.current.error, "no error")
    yield from all_drawn("an error")
    props.use_pupil = False


def baking(scene):
    """Bake by the button, then by a render, which keeps no texture."""
    session = module("operators.session")
    gate.close("Baking light in view")
    press(bpy.ops.holopath.bake, anew=True, show=True)
    yield from gate.reached()
    yield from all_drawn("baking")
    assert at_work()
    gate.open()
    yield from over()
    assert session.current.texture is not None
    yield from all_drawn("baked")
    scene.holopath.method = "fast"
    press(bpy.ops.holopath.render_hologram)
    yield from over()
    assert session.current.bake and session.current.texture is None
    yield from all_drawn("rendered with baked light")


def encoding(scene):
    gate.close("Phases")
    press(bpy.ops.holopath.encode)
    yield from gate.reached()
    yield from all_drawn("encoding")
    assert at_work()
    gate.open()
    yield from over()
    yield from all_drawn("encoded")
    scene.holopath.refocused = "PHASE"
    yield from all_drawn("encoded, refocused")


def streaming(scene):
    """Stream to a board behind a pty, which is silent at first and unplugged at last; then to a virtual bench."""
    devices, device = module("operators.devices"), scene.holopath.device
    board = Board(Firmware(size=(SIZE, SIZE)))
    board.mute = True
    device.driver, device.port, device.rate = "serial", board.path, 20.0
    press(bpy.ops.holopath.stream)
    yield from all_drawn("opening the device")
    assert devices.streaming() and devices.current.counts is None
    board.mute = False
    yield from until(lambda: devices.current.counts and devices.current.counts.shown > 2, "nothing is shown")
    yield from all_drawn("streaming")
    assert devices.streaming() and not devices.current.counts.lost
    board.unplug()
    yield from until(lambda: devices.current.counts.lost, "the loss is not noticed")
    yield from all_drawn("device lost")
    assert devices.current.counts.lost
    press(bpy.ops.holopath.stop_streaming)
    yield from until(lambda: devices.current.timer is None, "not stopped")
    yield from all_drawn("stopped")
    press(bpy.ops.holopath.stream)
    yield from until(lambda: devices.current.error, "a port that is gone is opened")
    yield from all_drawn("device refused")
    device.driver, device.rate = "virtual", 1.0
    press(bpy.ops.holopath.stream)
    yield from until(lambda: devices.current.counts and devices.current.counts.shown, "nothing is shown")
    yield from all_drawn("streaming, virtual")
    assert devices.streaming()
    press(bpy.ops.holopath.stop_streaming)
    yield from until(lambda: devices.current.timer is None, "not stopped")


def choosing(scene):
    """Every value of every choice and switch, some at a time."""
    layer = bpy.context.view_layer.holopath
    choices = [
        (props, prop.identifier, prop.enum_items.keys() if prop.type == "ENUM" else [True, False])
        for props in (scene.holopath, scene.holopath.device, layer)
        for prop in props.bl_rna.properties
        if prop.type in ("ENUM", "BOOLEAN") and not prop.is_readonly
    ]
    max_count = max(len(values) for _, _, values in choices)
    for step in range(max_count):
        for props, name, values in choices:
            setattr(props, name, values[step % len(values)])
        yield from all_drawn(f"settings {step}", popups=False)
    configure(scene, SIZE)


def in_another_scene(scene):
    window = bpy.context.window_manager.windows[0]
    window.scene = other = bpy.data.scenes.new("Other")
    other.render.engine = "HOLOPATH"
    other.holopath.focus_list.add()
    # without an object it has no material
    global there
    there = there - {"HOLOPATH_PT_material"}
    yield from all_drawn("another scene")


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
