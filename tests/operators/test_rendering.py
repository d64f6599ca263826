"""Rendering and estimating by buttons, their failures, and the check for processors."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.blender import preferences, properties
from holopath_addon.engine.waves import libraries
from holopath_addon.operators import session
from tests.operators.pixels import picture


def test_render_and_refocus(scene):
    assert bpy.ops.holopath.render_hologram() == {"FINISHED"}
    field = session.current.field
    assert field.data.shape == (4, 3, 64, 64)
    assert scene.holopath.focus == pytest.approx(0.5, rel=0.02) and scene.holopath.focus_auto
    near = picture()
    expected = engine.reconstruct(field, [properties.focus_of(scene.holopath)])[0]
    np.testing.assert_allclose(near[..., :3], expected, rtol=1e-5)
    assert (near[..., 3] == 1).all()
    assert near[36, 32, 0] > 0.2 > near[2, 2, 0]  # the triangle, the wall

    scene.holopath.focus = 2.0
    assert session.current.field is field
    far = picture()
    np.testing.assert_allclose(far[..., :3], engine.reconstruct(field, [2.0])[0], rtol=1e-5)
    assert not np.allclose(near, far)
    scene.holopath.use_pupil = True
    scene.holopath.pupil_diameter_mm = 1.0
    assert picture()[..., :3].mean() < far[..., :3].mean()
    assert bpy.ops.holopath.refocus() == {"FINISHED"}


def test_plan(scene):
    assert bpy.ops.holopath.plan() == {"FINISHED"}
    plan = session.current.plan
    assert plan.seconds > 0 and plan.decisions and session.current.field is None
    assert session.current.notes == []


def test_notes(scene):
    material = scene.objects["Near"].active_material
    material.node_tree.nodes["Principled BSDF"].inputs["Subsurface Weight"].default_value = 0.5
    bpy.ops.holopath.plan()
    assert any("Subsurface" in note for note in session.current.notes)


def no_camera(scene):
    scene.camera = None
    return "no active camera"


def orthographic(scene):
    scene.camera.data.type = "ORTHO"
    return "(?i)perspective"


def upside_down_depths(scene):
    scene.holopath.depth_near_mm = 0.5
    return "depth range"


def empty(scene):
    for name in ("Near", "Wall"):
        bpy.data.objects.remove(scene.objects[name])
    return "nothing visible"


def broken_mesh(scene):
    scene.objects["Near"].data.vertices[0].co.x = float("nan")
    return "Near"


@pytest.mark.parametrize("spoil", [no_camera, orthographic, upside_down_depths, empty, broken_mesh])
@pytest.mark.parametrize("operator", ["render_hologram", "plan"])
def test_errors(scene, spoil, operator):
    says = spoil(scene)
    with pytest.raises(RuntimeError, match=says):
        getattr(bpy.ops.holopath, operator)()
    assert session.current.error and "\n" not in session.current.error
    assert session.current.field is None


def test_a_bug_is_a_sentence_too(scene, monkeypatch):
    def fail(*_, **__):
        raise KeyError("surprise")

    monkeypatch.setattr(engine, "render", fail)
    with pytest.raises(RuntimeError, match="Unexpected KeyError"):
        bpy.ops.holopath.render_hologram()
    assert not session.running()


def test_canceled_render_keeps_the_last_one(scene, monkeypatch):
    bpy.ops.holopath.render_hologram()
    field, before = session.current.field, picture()

    def stop(*_, **__):
        raise engine.Cancelled

    monkeypatch.setattr(engine, "render", stop)
    assert bpy.ops.holopath.render_hologram() == {"CANCELLED"}
    assert session.current.field is field and session.current.error == ""
    session.images.show_rgb(np.ones((64, 64, 3), np.float32))  # as a window shows a preview of the next
    session.restore_picture()
    np.testing.assert_allclose(picture(), before, rtol=1e-5)


def test_without_a_backend(scene, monkeypatch):
    """The panel says what to install; once it is there, a press of Check Again finds it."""
    monkeypatch.setattr(engine.scene.variants, "_candidates", lambda: [])
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    with monkeypatch.context() as patch:
        patch.setattr(engine.scene.variants, "_cuda_device", lambda: (False, "no card"))
        bpy.ops.holopath.check()
        assert "install LLVM" in preferences.backend_problem()
    monkeypatch.undo()
    assert "install LLVM" in preferences.backend_problem()  # asked once, as panels are drawn often
    bpy.ops.holopath.check()
    assert preferences.backend_problem() == ""


def test_a_graphics_card_that_is_not_there(scene, monkeypatch):
    monkeypatch.setattr(engine.scene.variants, "_cuda_device", lambda: (False, "no card"))
    monkeypatch.setattr(preferences, "chosen_backend", lambda: engine.scene.variants.CUDA)
    preferences.forget_backends()
    problem = preferences.backend_problem()
    preferences.forget_backends()
    assert "no card" in problem and "choose Automatic" in problem


def test_a_card_that_computes_no_waves(scene, monkeypatch):
    """Check Again says why; Get shows the extension that would change it."""
    monkeypatch.setattr(engine.scene.variants, "_cuda_device", lambda: (True, "NVIDIA Card"))
    messages = ["it has no memory", engine.InvalidInput("HOLOPATH_ARRAYS is 'jax'."), ""]

    def chosen():
        message = messages.pop(0)
        if isinstance(message, Exception):
            raise message
        return "numpy", message

    monkeypatch.setattr(libraries, "choose", chosen)
    for message in ("it has no memory", "HOLOPATH_ARRAYS is 'jax'.", ""):
        bpy.ops.holopath.check()
        assert preferences._found["lacking"] == message
    monkeypatch.undo()
    bpy.ops.holopath.check()
    assert preferences.check_card() == ""
    bpy.ops.holopath.get_card_extension()
    assert bpy.context.window_manager.extension_search == "HoloPath for NVIDIA Cards"
    assert bpy.context.preferences.active_section == "EXTENSIONS"
    bpy.context.window_manager.extension_search = ""
