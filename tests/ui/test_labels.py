"""The labels in the window are those that the pictures of it show.

Each state is that of the function of the same name in documentation/in_window.py, of a smaller scene: labels leave out
what differs.
"""

import json
from contextlib import contextmanager
from itertools import zip_longest

import bpy
import pytest

from documentation import labels, pictures
from holopath_addon import slm, ui
from holopath_addon.operators import devices, session
from tests.ui.test_panels import at_work

SHOWN = json.loads(pictures.LABELS.read_text("utf-8"))
STATES = {}  # by picture


def state(function):
    STATES[function.__name__.replace("_", "-") + ".jpg"] = contextmanager(function)
    return function


@state
def panel(scene):
    yield


@state
def rendering(scene):
    as_a_demo(scene)
    bpy.ops.holopath.render_hologram()
    session.current.draft = True
    with at_work(0.42, "Radiance"):
        yield


@state
def result(scene):
    bpy.ops.holopath.render_hologram()
    yield


@state
def phase(scene):
    as_a_demo(scene)
    encoded(scene, "dpac")
    yield


@state
def hologram(scene):
    as_a_demo(scene)
    encoded(scene, "sgd")
    scene.holopath.refocused, scene.holopath.pixel_shape = "PHASE", True
    yield


@state
def overlay(scene):
    as_a_demo(scene)
    for meters in (0.5, 1.0, 4.0):
        scene.holopath.focus = meters
        bpy.ops.holopath.focus_list_add()
    bpy.ops.holopath.plan()
    scene.holopath.focus, scene.holopath.use_pupil = 0.5, True
    yield


@state
def optics(scene):
    as_a_demo(scene)
    scene.holopath.optics.beam = "gaussian"
    scene.holopath.optics.carrier, scene.holopath.show_bench = "auto", True
    yield


@state
def viewport(scene):
    yield


@state
def baked_light(scene):
    as_a_demo(scene)
    bpy.ops.holopath.bake()
    yield


@state
def device(scene):
    as_a_demo(scene)
    encoded(scene, "sgd")
    scene.holopath.device.driver = "display"
    holograms = [session.current.phase]
    job = devices.stream(slm.VirtualDriver(*holograms), slm.Sequence(holograms), 20.0, None, None, 60.0)
    job.start()
    try:
        while not (devices.current.counts and devices.current.counts.shown):
            assert not job.wait(0.01), job.error
        yield
    finally:
        devices.stop(5.0)


def as_a_demo(scene):
    """Settings of Add > HoloPath Demo."""
    scene.render.engine = "HOLOPATH"
    scene.render.resolution_x = scene.render.resolution_y = scene.holopath.resolution_x


def encoded(scene, encoding):
    bpy.ops.holopath.render_hologram()
    scene.holopath.encoding = encoding
    bpy.ops.holopath.encode()


def drawn(scene, then):
    """The labels of today that a picture would show in place of its own."""
    if "overlay" in then:
        return {"overlay": labels.of_overlay(ui.overlay, scene)}
    # a closed panel has its header alone, and one without a header is never closed
    is_open = {name: len(texts) > 1 or not getattr(bpy.types, name).bl_label for name, texts in then.items()}
    return labels.of_panels(scene, is_open, is_open.get)


def differences(then, now):
    """Each label of a picture that is another one in the window, and that one."""
    pairs = [pair for name in then for pair in zip_longest(then[name], now[name], fillvalue="")]
    return [f"'{old}' where the window has '{new}'" for old, new in dict.fromkeys(pairs) if old != new]


def complaint(picture, found):
    command = f"HOLOPATH_BLENDER_ON_DISPLAY=blender python -m documentation pictures {picture}"
    return f"docs/images/{picture} shows {'; '.join(found)}: remake it by `{command}`, see CONTRIBUTING.md"


@pytest.fixture
def small(lit, tmp_path, monkeypatch):
    """Numbers are left out of labels, but not whether a noun has a plural. No test before has baked its light."""
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path))
    lit.holopath.frames = 2
    return lit


@pytest.mark.parametrize("picture", pictures.WINDOW)
def test_labels_are_those_of_the_picture(small, picture):
    with STATES[picture](small):
        found = differences(SHOWN[picture], drawn(small, SHOWN[picture]))
    assert not found, complaint(picture, found)


def test_panels_are_those_of_the_picture(addon):
    """No panel is new."""
    sidebar = labels.panels("HOLOPATH_PT_view3d")
    for picture, then in SHOWN.items():
        if "HOLOPATH_PT_view3d" in then:
            assert [name for name in then if name in sidebar] == sidebar, complaint(picture, ["other panels"])


def test_another_label_is_found(small, monkeypatch):
    """The test above fails for a changed label."""
    monkeypatch.setattr(
        bpy.types.HOLOPATH_PT_view3d_render,
        "section",
        staticmethod(lambda layout, context: layout.label(text="Render 3 Holograms")),
    )
    found = differences(SHOWN["panel.jpg"], drawn(small, SHOWN["panel.jpg"]))
    assert found == ["'Render Hologram' where the window has 'Render # Holograms'"]
    assert "pictures panel.jpg" in complaint("panel.jpg", found)


def test_what_varies_is_no_label():
    assert labels.words("Many Frames: About 4 min") == labels.words("Many Frames: About 12.5 s")
    assert labels.words("On Disk: 8.9 MB") == "On Disk: # MB"
    assert labels.words("towards extra frames of the same light") == ""
