"""Extra frames of a field's light."""

from types import SimpleNamespace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.rendering import extra_frames


@pytest.mark.parametrize(
    ("max_bytes", "clocked", "sizes"),
    [(1, False, [24] * 4), (1 << 28, False, [24, 72]), (1 << 28, True, [8, 24, 24, 24, 16])],
)
def test_their_mean_is_that_of_the_field(build, camera, monkeypatch, max_bytes, clocked, sizes):
    """The mean is the same for any size of batches, and no extra frame is one of the field's own."""
    monkeypatch.setattr(extra_frames, "AT_ONCE", max_bytes)
    hologram = engine.Hologram(48, 48, 8e-6, (516.5e-9, 640e-9), 1e-3, 2e-3)
    settings = engine.Settings(frames=24, quality="preview", seed=1)
    view = build.two_planes(build.emissive), camera, hologram, settings
    plan = engine.plan(*view)
    field = engine.render(*view, plan)
    states, batches = [], []
    more = engine.extra_frames(
        *view[:3], plan, lambda *state: states.append(state), count=96, clocked=clocked
    )
    for numbers, fields in more:
        assert numbers == [0, 1]
        batches.append(fields)
    assert [len(each) for each in batches] == sizes
    done = [done for done, _ in states]
    assert done == sorted(done) and done[-1] == 1
    more = np.concatenate(batches)
    assert more.shape == (96, 2, 48, 48)
    alike = np.einsum("mkyx,nkyx->mn", more.conj(), field.data) / np.square(np.abs(field.data[0])).sum()
    assert np.abs(alike).max() < 0.2
    own, mean = (
        engine.reconstruct(engine.WaveField(data, hologram, camera, field.near), [1.0])[0, 8:-8, 8:-8]
        for data in (field.data, more)
    )
    assert mean.mean() == pytest.approx(own.mean(), rel=0.02)
    assert np.abs(mean - own).mean() < 0.15 * own.mean()


def test_equal_wavelengths_have_frames_each(build, camera):
    hologram = engine.Hologram(32, 32, 8e-6, (640e-9, 640e-9), 1e-3, 2e-3)
    view = build.two_planes(build.emissive), camera, hologram, engine.Settings(frames=1, quality="draft")
    ((numbers, fields),) = engine.extra_frames(*view[:3], engine.plan(*view), lambda *_: None, count=8)
    assert numbers == [0, 1] and fields.shape[:2] == (8, 2)


@pytest.mark.parametrize("field", ["designed", "smooth"])
def test_a_render_co_traces_the_first_of_them(build, camera, small, field):
    """Both kinds of frames are the same as when traced apart; the rest follows, or nothing where all are co-traced."""
    settings = engine.Settings(frames=2, quality="preview", phase_field=field)
    view = build.two_planes(build.diffuse), camera, small, settings
    plan, count = engine.plan(*view), 30
    first = 24 if field == "designed" else count
    alone, both = engine.render(*view, plan), engine.render(*view, plan, extra_frames=first)
    assert alone.extra_frames is None
    np.testing.assert_array_equal(both.data, alone.data)
    many, *rest = (fields for _, fields in engine.extra_frames(*view[:3], plan, lambda *_: None, count=count))
    np.testing.assert_array_equal(both.extra_frames, many)
    after = [
        fields
        for _, fields in engine.extra_frames(*view[:3], plan, lambda *_: None, count=count, begin=first)
    ]
    np.testing.assert_equal(after, rest)
    assert len(rest) == (field == "designed")


def test_other_methods_have_none(camera):
    hologram, plan = engine.Hologram(32, 32, 8e-6), SimpleNamespace(settings=engine.Settings(method="point"))
    with pytest.raises(engine.InvalidInput, match="Choose joint"):
        next(engine.extra_frames(None, camera, hologram, plan, lambda *_: None))
