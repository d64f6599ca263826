"""What sections of the panels show: controls that do something, and words where there is none."""

from types import SimpleNamespace

import pytest

from holopath_addon.operators import session
from holopath_addon.ui import sections
from tests.addon.layout import Context, Layout


def drawn(section, scene):
    """Names of the properties that a section shows, and its words."""
    context = Context(scene)
    layout = Layout(context)
    section(layout, context)
    return layout.all("prop", "property"), layout.words


def test_display(scene):
    names, words = drawn(sections.display, scene)
    assert {"resolution_x", "resolution_y", "pitch_um", "bits"} <= set(names)
    assert "Size: 0.512 × 0.512 mm" in words
    scene.holopath.display = "ti-plm-067"
    names, words = drawn(sections.display, scene)
    assert not {"resolution_x", "resolution_y", "pitch_um", "bits"} & set(names)
    assert "1358 × 800 pixels of 10.8 µm, 4 bits of phase" in words


def test_depth(scene):
    props = scene.holopath
    names, words = drawn(sections.depth, scene)
    assert "near_auto" in names and "near" not in names and "Estimate" in words
    session.current.plan, session.current.scene = SimpleNamespace(near=0.25), scene.name
    assert "0.25 m" in drawn(sections.depth, scene)[1]
    props.near_auto = False
    assert "near" in drawn(sections.depth, scene)[0]
    props.depth_mapping = "eyepiece"
    names, words = drawn(sections.depth, scene)
    assert "near_auto" not in names and "near" not in names and "eyepiece" in words


@pytest.mark.parametrize(
    "hidden, change",
    [
        ("spp", {"limit_rays": True}),
        ("paths", {"radiance": "ray"}),
        ("virtual_image", {"most_hits": 0}),
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
