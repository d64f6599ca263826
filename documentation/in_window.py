"""Runs inside a Blender window: brings it into the state that a picture shows, and waits until the picture is taken.

    blender --python in_window.py -- NAME FOLDER

NAME is a function below. ``FOLDER/ready.json`` says which part of the window the picture shows, and its labels; the
script waits for ``FOLDER/taken``. Of the film ``FOLDER/recording.json`` says that it begins, and which part it shows.
Where something fails, ``FOLDER/failed`` says what.
"""

import json
import math
import sys
import time
import traceback
from pathlib import Path
from typing import Any

import bpy
import mathutils

sys.path.insert(0, str(Path(__file__).parents[1]))  # Blender's Python does not know the checkout

from documentation import labels

api: Any = bpy  # its stubs know no operators of add-ons, and let windows be missing

PATIENCE = 240.0  # seconds for each step, on a slow machine
VIEW, IMAGE = "HOLOPATH_PT_view3d", "HOLOPATH_PT_image"  # main panels of the sidebars


def module(name):
    """A module of the add-on, whatever Blender calls its package."""
    return next(found for key, found in sys.modules.items() if key.endswith(f"holopath.{name}"))


def until(done, what):
    """Wait, while Blender works and draws."""
    end = time.monotonic() + PATIENCE
    while not done():
        assert time.monotonic() < end, what
        yield 0.02


def over():
    """Wait until what is at work has ended, and its picture is shown."""
    session = module("operators.session")
    yield from until(lambda: session.current.job is None and not session.is_refocusing(), "still at work")
    assert not session.current.error, session.current.error
    yield 0.3


def press(operator, **settings):
    """Invoke an operator as its button in the 3D View would."""
    window, area = api.context.window_manager.windows[0], editor("VIEW_3D")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with api.context.temp_override(window=window, area=area, region=region):
        return operator("INVOKE_DEFAULT", **settings)


# -- editors


def editor(kind):
    """The window's editor of a kind."""
    return next(area for area in api.context.window_manager.windows[0].screen.areas if area.type == kind)


def image_editor():
    """Put an Image Editor at the left of the 3D View: HoloPath shows its pictures there."""
    window, view = api.context.window_manager.windows[0], editor("VIEW_3D")
    with api.context.temp_override(window=window, area=view, region=view.regions[0]):
        api.ops.screen.area_split(direction="VERTICAL", factor=0.5)
    yield 0.3  # until they have their places
    areas = sorted((area for area in window.screen.areas if area.type == "VIEW_3D"), key=lambda area: area.x)
    areas[0].type = areas[0].ui_type = "IMAGE_EDITOR"
    yield 0.3


def sidebar(*sections, kind="VIEW_3D"):
    """Open an editor's tab HoloPath; without sections those are open that a user finds so, else these alone."""
    names = {f"{VIEW}_{section}" for section in sections}
    if names:
        register_with_open(names)
    area = editor(kind)
    area.spaces.active.show_region_ui = True
    yield 0.3
    region = next(region for region in area.regions if region.type == "UI")
    region.active_panel_category = "HoloPath"
    yield 0.3


def register_with_open(names):
    """Register all panels anew, for Blender offers no way to open or close one."""
    classes = module("ui.panels").CLASSES
    for cls in reversed(classes):
        api.utils.unregister_class(cls)
    for cls in classes:
        options = getattr(cls, "bl_options", set())
        if cls.__name__.startswith(f"{VIEW}_") and "HIDE_HEADER" not in options:
            cls.bl_options = options - {"DEFAULT_CLOSED"} if cls.__name__ in names else {"DEFAULT_CLOSED"}
        api.utils.register_class(cls)


def is_open(name):
    """Whether a panel is open that nobody has opened or closed by hand."""
    return "DEFAULT_CLOSED" not in getattr(getattr(api.types, name), "bl_options", ())


def drawn(*sidebars):
    """Labels of the panels in these sidebars."""
    found = {}
    for name in sidebars:
        names = []
        for panel in labels.panels(name):
            inner = panel != name and is_open(panel)
            names += [panel, *(labels.within(panel) if inner else [])]
        found |= labels.of_panels(scene(), names, is_open)
    return found


def scene():
    """The scene that the window shows."""
    return api.context.window_manager.windows[0].scene


# -- scenes


def suzanne():
    """The demo of the guide, seen through its camera."""
    press(api.ops.holopath.add_demo, name="suzanne")
    yield 0.5


def rendered():
    """Press Render Hologram, and wait for the hologram."""
    press(api.ops.holopath.render_hologram)
    yield from over()


def encoded(encoding):
    """Press Encode, and wait for the phases."""
    scene().holopath.encoding = encoding
    press(api.ops.holopath.encode)
    yield from over()


# -- pictures: each returns the editors that it shows, and its labels


def panel():
    """The tab on the default scene, before anything was done."""
    yield from sidebar()
    return ["VIEW_3D"], drawn(VIEW)


def rendering():
    """A draft that can be refocused, while its hologram is computed."""
    yield from image_editor()
    yield from sidebar(kind="IMAGE_EDITOR")
    yield from sidebar()
    yield from suzanne()
    props = scene().holopath
    props.frames, props.quality = 24, "high"  # or the hologram is there too soon for a draft
    session = module("operators.session")
    press(api.ops.holopath.render_hologram)
    yield from until(lambda: session.current.draft and not session.is_refocusing(), "no draft is shown")
    yield from until(lambda: session.current.job.done > 0.3, "the hologram does not go on")
    return ["IMAGE_EDITOR", "VIEW_3D"], drawn(VIEW, IMAGE)


def result():
    """The hologram of the default scene, with nothing set."""
    yield from image_editor()
    yield from sidebar()
    yield from rendered()
    return ["IMAGE_EDITOR", "VIEW_3D"], drawn(VIEW)


def phase():
    """The phases of the demo."""
    yield from image_editor()
    yield from sidebar()
    yield from suzanne()
    yield from rendered()
    yield from encoded("dpac")
    return ["IMAGE_EDITOR", "VIEW_3D"], drawn(VIEW)


def hologram():
    """What the demo's phases show through a display with its limits, focused on the wall."""
    yield from image_editor()
    yield from sidebar()
    yield from suzanne()
    yield from rendered()
    yield from encoded("sgd")
    props = scene().holopath
    props.refocused = "PHASE"
    props.pixel_shape, props.fill_factor, props.unmodulated, props.crosstalk = True, 0.9, 0.03, 0.4
    props.focus = 4.0
    editor("IMAGE_EDITOR").spaces.active.image = api.data.images["HoloPath Reconstruction"]
    yield 0.3
    yield from over()
    return ["IMAGE_EDITOR", "VIEW_3D"], drawn(VIEW)


def overlay():
    """Distances, near end and pupil in the demo, from outside its camera."""
    yield from suzanne()
    press(api.ops.holopath.plan)
    yield from over()
    props = scene().holopath
    props.focus, props.use_pupil = 0.5, True
    space = editor("VIEW_3D").spaces.active
    space.shading.color_type = "TEXTURE"
    look(space.region_3d, scene().camera, 1.2)
    yield 0.5
    return ["VIEW_3D"], {"overlay": labels.of_overlay(module("ui.overlay"), scene())}


def optics():
    """A bench with a Gaussian beam and a round stop beside the zero order: its section, and its sketch."""
    yield from sidebar("display", "display_optics")
    yield from suzanne()
    props = scene().holopath
    props.optics.beam, props.optics.middle_mm = "gaussian", (0.2, 0.0)
    props.optics.carrier, props.show_bench = "auto", True
    yield 0.5
    return ["VIEW_3D"], drawn(VIEW)


def look(view, camera, distance):
    """See what lies before a camera from its right, above it and behind it."""
    forward = camera.matrix_world.to_quaternion() @ mathutils.Vector((0, 0, -1))
    view.view_perspective = "PERSP"
    view.view_location = camera.matrix_world.translation + 0.45 * forward
    turned = mathutils.Euler((math.radians(-25), math.radians(-50), 0))
    view.view_rotation = camera.matrix_world.to_quaternion() @ turned.to_quaternion()
    view.view_distance = distance


def viewport():
    """The demo's view, shaded Rendered."""
    yield from suzanne()
    space = editor("VIEW_3D").spaces.active
    space.shading.type, space.region_3d.view_camera_zoom = "RENDERED", 7
    views = module("blender.viewport")._viewports
    yield from until(lambda: views, "nothing is traced")
    yield 3.0
    yield from until(lambda: not any(view.unfinished for view in views.values()), "still refining")
    return ["VIEW_3D"], {}


def baked_light():
    """Baked light of the color box as a texture, and its section."""
    yield from image_editor()
    yield from sidebar("baked_light")
    press(api.ops.holopath.add_demo, name="box")
    yield 0.5
    press(api.ops.holopath.bake, show=True)
    yield from over()
    area = editor("IMAGE_EDITOR")
    region = next(region for region in area.regions if region.type == "WINDOW")
    with api.context.temp_override(window=api.context.window_manager.windows[0], area=area, region=region):
        api.ops.image.view_all(fit_view=True)
    return ["IMAGE_EDITOR", "VIEW_3D"], drawn(VIEW)


def device():
    """The section that sends a hologram to the second monitor."""
    api.context.preferences.view.ui_scale = 0.9  # or the sidebar does not fit into the window
    yield from image_editor()
    yield from sidebar("device")
    yield from suzanne()
    yield from rendered()
    yield from encoded("sgd")
    props, devices = scene().holopath.device, module("operators.devices")
    press(api.ops.holopath.find_devices)
    yield from until(
        lambda: "monitors" in module("blender.device_properties").found_devices, "no devices are found"
    )
    props.driver, props.rate = "display", 10.0  # which the slowest machine keeps
    press(api.ops.holopath.stream)
    yield from until(lambda: devices.current.counts and devices.current.counts.shown > 50, "nothing is shown")
    return ["VIEW_3D"], drawn(VIEW)


# -- the film


def film():
    """From the default scene to a hologram of the demo that is refocused; a second or two for each step."""
    begin = ["IMAGE_EDITOR", "VIEW_3D"]
    yield from image_editor()
    tell("recording", {"box": box(begin)})
    yield 2.0
    yield from sidebar()
    yield 2.0
    yield from suzanne()
    yield 2.0
    yield from rendered()
    yield 2.0
    props = scene().holopath
    for focus in (0.5, 0.6, 0.75, 1.0, 1.5, 2.5, 4.0, 0.5):
        props.focus = focus
        yield from over()
        yield 0.7
    yield 1.0
    return begin, {}


# -- the run


def tell(name, content):
    """Tell who takes the picture: a file that is there only when it is whole."""
    part = target / f"{name}.part"
    part.write_text(json.dumps(content), "utf-8")
    part.rename(target / f"{name}.json")


def box(kinds):
    """Left, top, width and height of editors in the window, pixels."""
    window = api.context.window_manager.windows[0]
    areas = [area for area in window.screen.areas if area.type in kinds]
    left, bottom = min(area.x for area in areas), min(area.y for area in areas)
    right = max(area.x + area.width for area in areas)
    top = max(area.y + area.height for area in areas)
    return left, window.height - top, right - left, top - bottom


def steps(name, folder):
    """Reach the state, tell it, and wait."""
    yield 0.5
    kinds, texts = yield from globals()[name]()
    for _ in range(20):  # panels that have grown push those below them away little by little
        for area in api.context.window_manager.windows[0].screen.areas:
            area.tag_redraw()
        yield 0.05
    tell("ready", {"box": box(kinds), "labels": texts})
    yield from until((folder / "taken").exists, "nobody takes the picture")


def tick():
    """A timer: the next step, and at the end of all Blender's end."""
    try:
        return next(run)
    except StopIteration:
        pass
    except BaseException:
        (target / "failed").write_text(traceback.format_exc(), "utf-8")
    api.ops.wm.quit_blender()


wanted, told = sys.argv[sys.argv.index("--") + 1 :]
target = Path(told)
run = steps(wanted, target)
api.context.preferences.view.show_splash = False  # before it opens
api.app.timers.register(tick, first_interval=1.0, persistent=True)
