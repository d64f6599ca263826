"""Every panel and menu in every state that a user may see, without a window: a real one draws them in
tests/in_blender/test_panels.py.
"""

import re
import threading
from contextlib import contextmanager
from types import SimpleNamespace

import bpy
import pytest

from holopath_addon import engine, slm, ui
from holopath_addon.blender import preferences
from holopath_addon.engine.waves import libraries
from holopath_addon.operators import devices, session
from holopath_addon.operators.jobs import Job
from holopath_addon.ui import menus, sections
from tests.patience import NEVER
from tests.ui.layout import Context, Layout, draw
from tests.ui.test_words import BRITISH

SHOWN = [
    cls
    for cls in (*ui.CLASSES, preferences.HoloPathPreferences)
    if issubclass(cls, bpy.types.Panel | bpy.types.Menu | bpy.types.AddonPreferences)
    and cls.__name__ != "HOLOPATH_PT_display_presets"  # which Blender's own code draws
]
STATES = {}  # each, by name, lasts as long as its context
_left = {}  # what the session held after each kind of work, done once for all tests


def state(function):
    STATES[function.__name__] = contextmanager(function)
    return function


def after(work, scene):
    """Bring the session into the state after an operator."""
    if work not in _left:
        if work == "rendered":
            scene.holopath.method, scene.holopath.frames = "fast", 2
            material = scene.objects["Near"].active_material  # with a note
            material.node_tree.nodes["Principled BSDF"].inputs["Subsurface Weight"].default_value = 0.5
            bpy.ops.holopath.render_hologram()
        elif work == "encoded":
            after("rendered", scene)
            scene.holopath.encoding = "dpac"
            bpy.ops.holopath.encode()
        elif work == "baked":
            bpy.ops.holopath.bake()
        _left[work] = dict(vars(session.current))
    session.current.__dict__.update(_left[work])


@contextmanager
def at_work(done, message, seconds=0.0):
    """A job that has come so far in so many seconds, and stays there."""
    there, go = threading.Event(), threading.Event()

    def work(progress):
        progress(done, message)
        there.set()
        go.wait()

    job = session.current.job = Job(work)
    job._started -= seconds
    job.start()
    assert there.wait(NEVER)
    try:
        yield
    finally:
        go.set()
        assert job.wait(NEVER)
        session.current.job = None


class Bench(slm.VirtualDriver):
    """Opens when it is on_progress; lost, if it is to be, after the first picture."""

    def __init__(self, hologram, opens, lost):
        super().__init__(hologram)
        self.opened, self._lost, self._number = threading.Event(), lost, -1
        if opens:
            self.opened.set()

    def open(self, rate, on_progress):
        self.opened.wait()
        self._alive()

    def show(self, number, picture):
        self._number = number
        self._alive()
        super().show(number, picture)

    def _alive(self):
        if self._lost and self._number > 0:
            raise slm.DeviceLost("The device does not answer.")


@contextmanager
def shown(scene, until, opens=True, lost=False):
    """A device shows the encoded hologram, and has come so far with it."""
    after("encoded", scene)
    driver = Bench(session.current.phase, opens, lost)
    job = devices.stream(driver, slm.Sequence([session.current.phase]), 20.0, None, None, 60.0)
    job.start()
    try:
        while not until(devices.current.counts):
            assert not job.wait(0.01), job.error
        yield
    finally:
        driver.opened.set()
        devices.stop(5.0)


@state
def nothing_rendered(scene, monkeypatch):
    yield


@state
def no_camera(scene, monkeypatch):
    camera, scene.camera = scene.camera, None
    with pytest.raises(RuntimeError, match="no active camera"):
        bpy.ops.holopath.render_hologram()
    yield
    scene.camera = camera


@state
def mitsuba_unavailable(scene, monkeypatch):
    monkeypatch.setattr(engine.scene.variants, "_candidates", lambda: [])
    monkeypatch.setattr(engine.scene.variants, "_cuda_device", lambda: (False, "no card"))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    preferences.forget_backends()
    yield
    monkeypatch.undo()
    preferences.forget_backends()


@contextmanager
def a_card(monkeypatch, *installed, lacking=""):
    """A machine with an NVIDIA card, and these libraries."""
    monkeypatch.setattr(engine.scene.variants, "_cuda_device", lambda: (True, "NVIDIA Card"))
    monkeypatch.setattr(libraries, "installed", lambda: list(installed))
    monkeypatch.setattr(libraries, "choose", lambda: ("numpy" if lacking else "cupy", lacking))
    preferences.forget_backends()
    if lacking:
        preferences.check_card()
    yield
    monkeypatch.undo()
    preferences.forget_backends()


@state
def a_card_without_a_library(scene, monkeypatch):
    with a_card(monkeypatch):
        yield


@state
def a_card_whose_driver_is_too_old(scene, monkeypatch):
    why = "CuPy cannot compute there (CUDA driver version is insufficient)"
    with a_card(monkeypatch, "cupy", lacking=libraries.advice(why)):
        yield


@state
def a_card_that_computes_waves(scene, monkeypatch):
    with a_card(monkeypatch, "cupy"):
        yield


@state
def starting(scene, monkeypatch):
    with at_work(0.0, "Starting Mitsuba"):
        yield


@state
def rendering(scene, monkeypatch):
    with at_work(0.25, "Wave tracing", seconds=10):
        yield


@state
def rendering_again(scene, monkeypatch):
    after("encoded", scene)
    with at_work(0.25, "Wave tracing", seconds=10):
        yield


@state
def canceling(scene, monkeypatch):
    with at_work(0.25, "Wave tracing"):
        bpy.ops.holopath.cancel()
        yield


@state
def baking(scene, monkeypatch):
    with at_work(0.5, "Baking light in view"):
        yield


@state
def baked(scene, monkeypatch):
    after("baked", scene)
    yield


@state
def estimated(scene, monkeypatch):
    bpy.ops.holopath.plan()
    yield


@state
def rendered(scene, monkeypatch):
    after("rendered", scene)
    yield


@state
def rendered_in_another_scene(scene, monkeypatch):
    after("rendered", scene)
    session.current.plan_scene = session.current.field_scene = "Another"
    yield


@state
def playing(scene, monkeypatch):
    after("rendered", scene)
    monkeypatch.setattr(session.current, "sweep_timer", object())  # in place of a window's timer
    yield


@state
def error_after_a_render(scene, monkeypatch):
    after("rendered", scene)
    scene.holopath.pupil_offset_mm, scene.holopath.use_pupil = (900.0, 0.0), True
    assert "outside the light" in session.current.error
    yield


@state
def encoded(scene, monkeypatch):
    after("encoded", scene)
    yield


@state
def encoding_by_the_clock(scene, monkeypatch):
    after("rendered", scene)
    scene.holopath.limit_encoding, scene.holopath.encode_seconds = True, 0.1
    yield


@state
def encoding_again(scene, monkeypatch):
    after("encoded", scene)
    with at_work(0.6, "Towards many frames, 31.2 dB", seconds=10):
        yield


@state
def on_another_bench(scene, monkeypatch):
    after("encoded", scene)
    scene.holopath.optics.stop = "half"
    yield


@state
def no_such_bench(scene, monkeypatch):
    scene.holopath.optics.beam, scene.holopath.optics.stop = "measured", "measured"
    yield


@state
def opening_the_device(scene, monkeypatch):
    with shown(scene, lambda counts: True, opens=False):
        yield


@state
def streaming(scene, monkeypatch):
    with shown(scene, lambda counts: counts and counts.shown):
        yield


@state
def device_lost(scene, monkeypatch):
    with shown(scene, lambda counts: counts and counts.lost, lost=True):
        yield


@state
def streamed(scene, monkeypatch):
    after("encoded", scene)
    scene.holopath.device.driver = "virtual"
    bpy.ops.holopath.stream()
    yield


@state
def device_refused(scene, monkeypatch):
    after("encoded", scene)
    scene.holopath.device.driver = "files"
    with pytest.raises(RuntimeError, match="No folder"):
        bpy.ops.holopath.stream()
    yield


# -- tests


@pytest.fixture
def window(lit):
    """A context in which all panels are shown."""
    for distance in (1.0, 0.0):
        lit.holopath.focus_diopters = distance
        bpy.ops.holopath.focus_list_add()
    context = Context(lit)
    context.material = lit.objects["Wall"].active_material
    return context


@pytest.mark.parametrize("name", STATES)
def test_every_panel_in_every_state(window, monkeypatch, name):
    with STATES[name](window.scene, monkeypatch):
        for cls in SHOWN:
            layout = draw(cls, window)
            assert layout.drawn and not BRITISH.search(layout.words), cls
        for header in (bpy.types.HOLOPATH_PT_view3d_display, bpy.types.HOLOPATH_PT_render_display):
            draw(header, window, "draw_header_preset")
        menus._add_menu(SimpleNamespace(layout=Layout(window)), window)


def choices(props):
    """Every value of each setting that is a choice or a switch."""
    for prop in props.bl_rna.properties:
        if prop.type in ("ENUM", "BOOLEAN") and not prop.is_readonly:
            values = prop.enum_items.keys() if prop.type == "ENUM" else (False, True)
            yield from ((prop.identifier, value) for value in values)


@pytest.mark.parametrize("name", ["nothing_rendered", "encoded"])
def test_every_panel_with_every_setting(window, monkeypatch, name):
    scene, count = window.scene, 0
    # the Render properties have the same sections
    shown = [cls for cls in SHOWN if not cls.__name__.startswith("HOLOPATH_PT_render")]
    with STATES[name](scene, monkeypatch):
        settings = scene.holopath
        for props in (settings, settings.device, settings.optics, bpy.context.view_layer.holopath):
            for setting, value in list(choices(props)):
                before = getattr(props, setting)
                setattr(props, setting, value)
                for cls in shown:
                    draw(cls, window)
                setattr(props, setting, before)
                count += 1
    assert count > 60


def row(window):
    layout = Layout(window)
    sections.render(layout, window)
    return layout


def test_progress_and_cancel(window, monkeypatch):
    """The row with the button is progress while anything is at work, with a button that ends it."""
    assert "holopath.render_hologram" in row(window).all("operator", "operator")
    for name, factor, text in (
        ("starting", 0.0, "Starting Mitsuba…"),
        ("rendering", 0.25, r"25%, \d+ s left: Wave tracing"),
        ("canceling", 0.25, "Canceling…"),
        ("baking", 0.5, "50% Baking light in view"),
    ):
        with STATES[name](window.scene, monkeypatch):
            layout = row(window)
            assert layout.all("progress", "factor") == [factor]
            assert re.fullmatch(text, *layout.all("progress", "text"))
            assert layout.all("operator", "operator") == ["holopath.cancel"]


def test_what_went_wrong_is_said(window, monkeypatch):
    for name, words in (
        ("no_camera", "no active camera"),
        ("mitsuba_unavailable", "install LLVM"),
        ("error_after_a_render", "outside the light"),
    ):
        with STATES[name](window.scene, monkeypatch):
            assert words in row(window).words
        session.current.error = ""
    for name, words in (("device_lost", "Waiting for it"), ("device_refused", "No folder")):
        with STATES[name](window.scene, monkeypatch):
            layout = Layout(window)
            ui.panels.device(layout, window)
            assert words in layout.words


def test_what_the_preferences_say_of_a_card(window, monkeypatch):
    """Nothing without one; with one what computes waves there, or what it lacks, what that gains, and what to press."""
    get, drawn = "holopath.get_card_extension", {}
    for name in ("nothing_rendered", *(name for name in STATES if name.startswith("a_card"))):
        with STATES[name](window.scene, monkeypatch):
            if name == "nothing_rendered":
                monkeypatch.setattr(engine.scene.variants, "_cuda_device", lambda: (False, "no card"))
                preferences.forget_backends()
            layout = draw(preferences.HoloPathPreferences, window)
            drawn[name] = layout.words, get in layout.all("operator", "operator")
            lines = [text for text in layout.all("label", "text") if not text.startswith(("cuda_", "llvm_"))]
            assert all(len(line) <= preferences.LINE_LENGTH for line in lines)
    monkeypatch.undo()
    preferences.forget_backends()
    (none, pressed), (without, offered), (old, _), (computes, _) = drawn.values()
    assert "Waves" not in none and not pressed
    assert "computed by the processor, as neither CuPy nor PyTorch is installed" in without and offered
    assert "HoloPath for NVIDIA Cards is an extension of 470 MB" in without and "third of the time" in without
    assert "driver version is insufficient" in old and "newer NVIDIA driver" in old and "third" not in old
    assert "computed on the card by CuPy" in computes
    assert [offered for _, offered in drawn.values()] == [False, True, False, False]


def test_the_processor_that_the_preferences_choose(window, monkeypatch):
    """Then nothing is said of a card's waves."""
    monkeypatch.setattr(preferences, "chosen_backend", lambda: engine.scene.variants.LLVM)
    with STATES["a_card_without_a_library"](window.scene, monkeypatch):
        assert preferences.wave_status() == ("", "") and preferences.check_card() == ""
    monkeypatch.undo()
    preferences.forget_backends()


def test_a_layout_is_strict(window):
    """The layout of these tests refuses what a window's layout would refuse or complain of."""
    layout, props = Layout(window), window.scene.holopath
    for wrong in (
        lambda: layout.props(props, "seed"),
        lambda: layout.prop(props, "sead"),
        lambda: layout.prop(props, "wavelengths_nm", index=3),
        lambda: layout.prop(props, "seed", icon="NO_SUCH"),
        lambda: layout.prop(props),
        lambda: layout.label("text", color=1),
        lambda: layout.label(text=1),
        lambda: layout.operator("holopath.no_such"),
        lambda: setattr(layout.operator("holopath.bake"), "again", True),
        lambda: setattr(layout, "scale_z", 2),
        lambda: setattr(layout, "emboss", "FLAT"),
    ):
        with pytest.raises((AssertionError, KeyError)):
            wrong()
