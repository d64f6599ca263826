"""Results that the session keeps, and whose they are."""

import bpy
import pytest

from holopath_addon.operators import session


def test_diopters_in_view(scene):
    bpy.ops.holopath.render_hologram()
    near, far = session.current.diopter_range
    assert near == pytest.approx(2, rel=0.02) and far == pytest.approx(0.5, rel=0.02)
    assert session.plan_of(scene) is session.current.plan
    assert session.plan_of(bpy.data.scenes.new("Another")) is None


def test_what_encoding_will_do_is_told_of_the_field(scene):
    """Whatever is planned since: Encode works on what was rendered."""
    bpy.ops.holopath.render_hologram()
    made = session.encoding_of(scene)
    assert made.method == "refine"
    scene.holopath.frames = 1
    bpy.ops.holopath.plan()
    assert session.encoding_of(scene) == made


def test_baked_light_is_that_of_its_scene(lit):
    bpy.ops.holopath.bake()
    other = bpy.data.scenes.new("Other")
    assert session.bake_of(lit) and session.texture_of(lit) is not None
    assert session.bake_of(other) is None and session.texture_of(other) is None
    with bpy.context.temp_override(scene=other):
        assert not bpy.ops.holopath.show_texture.poll()


def test_a_render_that_fails_leaves_what_was_there(scene):
    """The field before, and its scene, which the best phases want."""
    bpy.ops.holopath.render_hologram()
    field, task = session.current.field, session.current.task
    scene.camera = None
    with pytest.raises(RuntimeError, match="no active camera"):
        bpy.ops.holopath.render_hologram()
    assert session.current.field is field and session.current.task is task
    scene.holopath.encoding, scene.holopath.limit_encoding = "refine", True
    scene.holopath.encode_seconds = 1.0
    assert bpy.ops.holopath.encode() == {"FINISHED"} and session.current.phase.method == "refine"
