"""A draft first, where the hologram takes several times as long, and what becomes of it."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.blender import properties
from holopath_addon.operators import session
from holopath_addon.workflow import pipeline


@pytest.fixture
def eager(monkeypatch):
    """Drafts however little they save."""
    monkeypatch.setattr(pipeline, "MIN_PREVIEW_SECONDS", 0.0)
    monkeypatch.setattr(pipeline, "MIN_DRAFT_RATIO", 0.0)


def task_of(scene):
    return session.prepare(bpy.context.evaluated_depsgraph_get(), scene.holopath)


def watched(task, at=None):
    """Offers (drafts or None), messages and result of a task, canceled at a message."""
    offered, messages = [], []

    def progress(done, message):
        messages.append((done, message))
        if at is not None and message.startswith(at):
            raise engine.Cancelled

    try:
        result = task.compute(progress, lambda picture, draft=None: offered.append((picture, draft)))
    except engine.Cancelled:
        result = None
    return offered, messages, result


def picture():
    image = bpy.data.images[session.IMAGE]
    return np.array(image.pixels[:]).reshape(image.size[1], image.size[0], 4)[::-1, :, :3]


@pytest.mark.parametrize("method", ["full", pytest.param("fast", marks=pytest.mark.slow)])
def test_the_hologram_is_the_same_with_a_draft(lit, eager, monkeypatch, tmp_path, method):
    """Bit for bit; no light is baked before in either."""
    lit.holopath.method, lit.holopath.frames = method, 6
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path / "plain"))
    plain = task_of(lit).compute(lambda done, message: None)
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path / "watched"))
    offered, messages, result = watched(task_of(lit))
    assert result.field.data.tobytes() == plain.field.data.tobytes()
    np.testing.assert_array_equal(result.images, plain.images)
    *lens, (early, draft) = offered
    assert lens and all(of is None for _, of in lens)
    assert len(draft.field.data) == pipeline.MAX_DRAFT_FRAMES and draft.focus == result.focus
    assert draft.field.data.shape[1:] == result.field.data.shape[1:]
    np.testing.assert_array_equal(early, draft.images[0])
    shares = [done for done, _ in messages]
    assert shares == sorted(shares) and shares[0] == 0 and shares[-1] == 1
    assert any(message.startswith("Draft: ") for _, message in messages)


def test_a_draft_shows_the_scene(lit, eager):
    """Not the hologram's noise, but its light: alike in the large."""
    lit.holopath.resolution_x = lit.holopath.resolution_y = 64
    offered, _, result = watched(task_of(lit))
    blocks = [image.reshape(4, 16, 4, 16, 3).mean((1, 3)) for image in (offered[-1][0], result.images[0])]
    np.testing.assert_allclose(*blocks, rtol=0.35, atol=0.02 * blocks[1].max())


def drafted(scene):
    """The draft that a plan of the scene has, or None."""
    task = task_of(scene)
    return pipeline._draft(task.full_request, task.plan(lambda *_: None))


@pytest.mark.parametrize("settings", [{"quality": "draft"}, {"method": "direct"}, {"method": "point"}])
def test_no_draft_of_drafts_and_other_methods(scene, eager, settings):
    assert drafted(scene) is not None
    for name, value in settings.items():
        setattr(scene.holopath, name, value)
    assert drafted(scene) is None


def test_no_draft_where_it_would_take_much_of_the_time(scene, eager, monkeypatch):
    draft, plan = drafted(scene), task_of(scene).plan(lambda *_: None)
    assert 0 < draft.seconds < plan.seconds
    monkeypatch.setattr(pipeline, "MIN_DRAFT_RATIO", 1e6)
    assert drafted(scene) is None


def test_nobody_watches(scene, eager):
    """Neither the command line nor scripts that press the button get drafts."""
    messages = []
    task_of(scene).compute(lambda done, message: messages.append(message))
    assert messages and not any(message.startswith("Draft") for message in messages)


def test_it_is_canceled_as_all_work(scene, eager):
    offered, _, result = watched(task_of(scene), at="Draft")
    assert result is None and all(draft is None for _, draft in offered)
    offered, messages, result = watched(task_of(scene), at="Wave tracing")
    assert result is None and offered[-1][1] is not None


def early(scene, eager):
    """A draft as the window has it, its task and the whole hologram."""
    task = task_of(scene)
    offered, _, result = watched(task)
    session.show_preview(scene.holopath, offered[0][0], task)
    assert session.current.field is None
    return task, offered[-1], result


def test_a_draft_can_be_refocused_until_there_is_better(scene, eager):
    task, (picture_of_it, draft), result = early(scene, eager)
    session.show_preview(scene.holopath, picture_of_it, task, draft)
    assert session.current.field is draft.field and session.current.draft
    assert scene.holopath.focus == pytest.approx(draft.focus[0]) and scene.holopath.focus_auto
    np.testing.assert_allclose(picture(), picture_of_it, rtol=1e-5)
    scene.holopath.focus = 2.0
    np.testing.assert_allclose(picture(), engine.reconstruct(draft.field, [2.0])[0], rtol=1e-5)
    session.keep_and_show(scene.holopath, task, result)
    assert session.current.field is result.field and not session.current.draft
    assert scene.holopath.focus == 2.0  # the user's
    np.testing.assert_allclose(picture(), engine.reconstruct(result.field, [2.0])[0], rtol=1e-5)


def test_a_draft_takes_no_holograms_place(scene, eager):
    bpy.ops.holopath.render_hologram()
    field = session.current.field
    task = task_of(scene)
    offered, _, _ = watched(task)
    session.show_preview(scene.holopath, *offered[-1][:1], task, offered[-1][1])
    assert session.current.field is field and not session.current.draft
    np.testing.assert_allclose(picture(), offered[-1][0], rtol=1e-5)  # but it is seen
    session.restore_picture()
    scene.holopath.focus_auto = True
    np.testing.assert_allclose(
        picture(), engine.reconstruct(field, [properties.focus_of(scene.holopath)])[0], rtol=1e-5
    )
