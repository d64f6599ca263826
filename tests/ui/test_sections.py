"""Sections of the panels: controls that have an effect, and words without any."""

from dataclasses import make_dataclass
from types import SimpleNamespace

import bpy
import pytest

from holopath_addon.operators import session
from holopath_addon.ui import sections
from holopath_addon.workflow.request import Encoding
from tests.ui.layout import Context, Layout


def drawn(section, scene):
    """Names of the properties that a section shows, and its words."""
    context = Context(scene)
    layout = Layout(context)
    section(layout, context)
    return layout.all("prop", "property"), layout.words


def test_display(scene):
    names, words = drawn(sections.display, scene)
    assert {"resolution_x", "resolution_y", "pitch_um", "bits"} <= set(names)
    assert words == "Size 0.512 × 0.512 mm" and "pitch_y_um" not in names
    scene.holopath.square_pixels, scene.holopath.pitch_y_um = False, 6.4
    names, words = drawn(sections.display, scene)
    assert "pitch_y_um" in names and words == "Size 0.512 × 0.41 mm"
    assert "8 × 6.4 µm Pitch" in drawn(sections.summary, scene)[1]
    scene.holopath.display = "ti-plm-067"
    names, words = drawn(sections.display, scene)
    assert not {"resolution_x", "resolution_y", "pitch_um", "bits"} & set(names)
    assert words == "1358 × 800 px, 10.8 µm Pitch 4 Bits, Size 14.7 × 8.64 mm"


def test_depth(scene):
    props = scene.holopath
    names, words = drawn(sections.depth, scene)
    assert "near_auto" in names and "near" not in names and "Not Estimated" in words
    session.current.plan, session.current.plan_scene = SimpleNamespace(near=0.25), scene.name
    assert "0.25 m" in drawn(sections.depth, scene)[1]
    props.near_auto = False
    assert "near" in drawn(sections.depth, scene)[0]
    props.depth_mapping = "eyepiece"
    names, words = drawn(sections.depth, scene)
    assert "near_auto" not in names and "near" not in names and "Eyepiece" in words


@pytest.mark.parametrize(
    "hidden, change",
    [
        ("spp", {"limit_rays": True}),
        ("paths", {"radiance": "ray"}),
        ("virtual_image", {"max_specular_depth": 0}),
        ("estimator", {"method": "direct"}),
    ],
)
def test_advanced_shows_what_counts(scene, hidden, change):
    before = hidden in drawn(sections.advanced, scene)[0]
    for name, value in change.items():
        setattr(scene.holopath, name, value)
    names, words = drawn(sections.advanced, scene)
    assert (hidden in names) is not before
    assert hidden != "estimator" or "Direct" in words


def f12_says(scene):
    layout = Layout(Context(scene))
    sections.render(layout, layout._context)
    return layout.words, "holopath.match_output" in layout.all("operator", "operator")


def test_which_size_f12_takes(scene):
    """The panel shows the size of F12 if HoloPath renders it, until both sizes are the same."""
    words, offered = f12_says(scene)
    assert "F12" not in words and not offered
    scene.render.engine = "HOLOPATH"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 192, 108, 50
    words, offered = f12_says(scene)
    assert "F12: 96 × 54 px" in words and offered
    assert bpy.ops.holopath.match_output() == {"FINISHED"}
    words, offered = f12_says(scene)
    assert "F12: Same Size" in words and not offered
    bpy.ops.render.render()
    assert session.current.field.data.shape[-2:] == (64, 64)


def test_a_draft_is_called_one(scene):
    bpy.ops.holopath.render_hologram()
    assert "Wave Field: 64 × 64 px 3 Wavelengths, 4 Frames" in drawn(sections.reconstruct, scene)[1]
    session.current.draft = True
    assert "Draft: 64 × 64 px" in drawn(sections.reconstruct, scene)[1]


PHASES = {
    "sgd": 1.0,  "joint": 8.0, "look": 0.0125, "light": 2.0, "rays": 0.4, "frame": 0.0125, "step": 0.1
}  # fmt: skip
MEMORY = {"sgd": 40e6, "joint": 90e6, "refine": 200e6}


@pytest.mark.parametrize(
    ("settings", "says", "names"),
    [
        (
            {"frames": 8},
            ("Many Frames: About 18 s Memory: 200 MB", "51 s of encoding would gain up to 2 dB"),
            True,
        ),
        ({}, ("Many Frames: About 17 s Memory: 200 MB", "4 frames average little speckle"), True),
        ({"limit_encoding": True}, ("Many Frames: About 20 s", "so many seconds", "100 steps"), True),
        (
            {"limit_encoding": True, "encode_seconds": 3.0},
            ("All Frames: About 3 s", "4.3 s to be worth it"),
            True,
        ),
        ({"encoding": "joint"}, ("All Frames: About 8 s Memory: 90 MB As asked",), True),
        ({"encoding": "dpac", "limit_encoding": True}, ("Double Phase As asked",), False),
        ({"encoding": "refine", "method": "point"}, ("Point", "choose joint"), True),
    ],
)
def test_what_encoding_will_do(scene, settings, says, names):
    """Once there is a plan: the method, its seconds and why, and what more seconds would bring."""
    assert "About" not in drawn(sections.hologram, scene)[1]
    fields = "phases", "phases_memory", "traversals", "requested", "settings"
    plan = make_dataclass("PlanOfPhases", fields)(PHASES, MEMORY, 1, None, None)
    session.current.plan, session.current.plan_scene = plan, scene.name
    for name, value in settings.items():
        setattr(scene.holopath, name, value)
    there, words = drawn(sections.hologram, scene)
    assert all(text.lower() in words.lower() for text in says), words
    assert ("limit_encoding" in there) is names
    assert ("encode_seconds" in there) is (names and scene.holopath.limit_encoding)
    assert ("gain" in words) is ("would gain" in " ".join(says) or scene.holopath.encode_seconds == 3.0)


def test_the_limits_of_a_fitted_display_are_not_offered(scene):
    """They have no effect: its own levels, pixels and crosstalk show the phases."""
    session.current.phase = make_dataclass("Phases", ["data"])([0])
    scene.holopath.refocused = "PHASE"
    for encoding, is_fitted in (None, False), (Encoding(), False), (Encoding(display=["a display"]), True):
        session.current.phase_encoding = encoding
        there, words = drawn(sections.hologram, scene)
        assert ("crosstalk" not in there) is is_fitted
        assert ("Shown by the Fitted Display" in words) is is_fitted
