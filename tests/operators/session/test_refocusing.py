"""The picture follows the settings, at once and in a thread."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.operators import session
from tests.operators.pixels import picture
from tests.patience import NEVER


def test_a_pupil_beside_the_light(scene):
    bpy.ops.holopath.render_hologram()
    before = picture()
    scene.holopath.pupil_offset_mm = (900.0, 0.0)
    scene.holopath.use_pupil = True
    assert "outside the light" in session.current.error
    with pytest.raises(RuntimeError, match="outside the light"):
        bpy.ops.holopath.refocus()
    np.testing.assert_array_equal(picture(), before)
    scene.holopath.use_pupil = False
    assert session.current.error == ""


def test_a_failure_outlives_the_picture_that_comes_back(scene):
    """A window refocuses the earlier picture in a thread, which ends after the failure was reported."""
    bpy.ops.holopath.render_hologram()
    session.current.refocus_request = (2.0, None, None, engine.Optics())
    session.refocusing._start_refocus()
    session.record_error(engine.InvalidInput("No."))
    assert session.current.refocus_job.wait(NEVER)
    session.refocusing._poll_refocus()
    assert session.current.error == "No."
    scene.holopath.focus = 1.0
    assert session.current.error == ""


def test_a_picture_of_an_earlier_field_is_dropped(scene):
    bpy.ops.holopath.render_hologram()
    session.current.refocus_request = (2.0, None, None, engine.Optics())
    session.refocusing._start_refocus()
    assert session.current.refocus_job.wait(NEVER)
    scene.holopath.resolution_x = 48
    bpy.ops.holopath.render_hologram()
    before = picture()
    session.refocusing._poll_refocus()
    assert not session.is_refocusing() and tuple(bpy.data.images[session.IMAGE].size) == (48, 64)
    np.testing.assert_array_equal(picture(), before)


def test_refocus_the_hologram(scene):
    """Once it is encoded, the picture is of the phases, as the display shows them, where that is chosen."""
    bpy.ops.holopath.render_hologram()
    of_the_field = picture()
    scene.holopath.refocused = "PHASE"  # nothing is encoded yet
    np.testing.assert_array_equal(picture(), of_the_field)
    scene.holopath.encoding = "sgd"
    bpy.ops.holopath.encode()
    props = session.current.phase
    assert props.method == "sgd"
    of_the_phases = picture()
    assert np.abs(of_the_phases - of_the_field).max() > 0.01 * of_the_field.max()
    scene.holopath.bits = 1
    coarse = picture()
    assert np.abs(coarse - of_the_phases).mean() > 0.01 * of_the_phases.mean()
    scene.holopath.crosstalk = 1.0
    assert np.abs(picture() - coarse).mean() > 0.01 * coarse.mean()
    scene.holopath.refocused = "FIELD"
    np.testing.assert_array_equal(picture(), of_the_field)
    bpy.ops.holopath.encode()  # bits in the loop
    levels = session.current.phase.data / np.pi
    np.testing.assert_allclose(levels, np.round(levels), atol=1e-5)


def test_the_picture_follows_an_undo(scene, monkeypatch):
    """Blender restores settings without a call for each; what has not changed is not refocused again."""
    bpy.ops.holopath.render_hologram()
    scene.holopath.focus = 2.0
    before, calls = picture(), []
    monkeypatch.setattr(session.refocusing.properties, "on_view_change", [])
    scene.holopath.focus = 1.0
    np.testing.assert_array_equal(picture(), before)
    session._show_undone()
    assert np.abs(picture() - before).max() > 0
    monkeypatch.setattr(session.refocusing, "refocus_by_settings", calls.append)
    session._show_undone()
    assert calls == []
