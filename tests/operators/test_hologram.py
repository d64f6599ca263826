"""Encoding and saving phases, by buttons."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine, slm
from holopath_addon.blender import properties
from holopath_addon.operators import session
from holopath_addon.operators.session import refocusing
from holopath_addon.workflow import pipeline
from holopath_addon.workflow.request import Encoding
from tests.patience import SOON


def test_encode_and_save(scene, tmp_path):
    assert not bpy.ops.holopath.encode.poll() and not bpy.ops.holopath.save_hologram.poll()
    scene.holopath.encoding = "sgd"
    bpy.ops.holopath.render_hologram()
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    phase = session.current.phase
    assert phase.data.shape == session.current.field.data.shape
    image = bpy.data.images[session.PHASE]
    shown = np.array(image.pixels[:]).reshape(64, 64, 4)[::-1, :, :3]
    np.testing.assert_allclose(shown, np.moveaxis(phase.data[0], 0, -1) / (2 * np.pi), atol=1e-6)
    scene.holopath.phase_frame = 3
    shown = np.array(image.pixels[:]).reshape(64, 64, 4)[::-1, :, :3]
    np.testing.assert_allclose(shown, np.moveaxis(phase.data[3], 0, -1) / (2 * np.pi), atol=1e-6)
    scene.holopath.phase_frame = 200  # there are four: the last is shown

    assert bpy.ops.holopath.save_hologram(directory=str(tmp_path)) == {"FINISHED"}
    np.testing.assert_array_equal(engine.PhaseHologram.load(tmp_path / "hologram").data, phase.data)
    with pytest.raises(RuntimeError, match="No folder"):
        bpy.ops.holopath.save_hologram()
    bpy.ops.holopath.render_hologram()
    assert session.current.phase is None  # of the field before


def test_encode_for_the_device_that_is_calibrated(scene, tmp_path):
    curve = ((0, 0.0), (1, 2.0), (2, 2.5), (3, 5.0))
    responses = tuple(slm.Response(nm * 1e-9, curve=curve) for nm in scene.holopath.wavelengths_nm)
    slm.Calibration(bits=2, responses=responses).save(tmp_path / "device.json")
    bpy.ops.holopath.render_hologram()
    scene.holopath.encoding = "sgd"
    scene.holopath.device.calibration = str(tmp_path / "device.json")
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    phases = {0.0, 2.0, 2.5, 5.0}
    assert set(np.round(np.unique(session.current.phase.data), 4)) <= phases
    scene.holopath.bits = 1  # of displays that nobody measured
    modulator, optics = properties.modulator_of(scene.holopath), session.current.field.hologram.optics
    light = refocusing.refocuser_for(session.stored_refocuser(), modulator, optics).field.data
    assert set(np.round(np.unique(np.angle(light) % (2 * np.pi)), 4)) <= phases
    scene.holopath.device.calibration = str(tmp_path / "none.json")
    with pytest.raises(RuntimeError, match="none.json"):
        bpy.ops.holopath.encode()


def test_a_hologram_is_shown_by_the_display_that_it_was_encoded_for(scene):
    bpy.ops.holopath.render_hologram()
    scene.holopath.encoding = "dpac"
    bpy.ops.holopath.encode()
    phase, optics = session.current.phase, session.current.field.hologram.optics
    models = [engine.DisplayModel(wavelength, falloff=0.5) for wavelength in phase.hologram.wavelengths]
    session.keep_phase(phase, Encoding("dpac", display=models))
    modulator = properties.modulator_of(scene.holopath)
    light = refocusing.refocuser_for(session.stored_refocuser(), modulator, optics).field
    np.testing.assert_array_equal(light.data, phase.field(display=models).data)
    half = engine.Optics(stop=engine.Stop("half"))
    with pytest.raises(engine.InvalidInput, match="fitted display, .* set the bench back, or encode again"):
        refocusing.refocuser_for(session.stored_refocuser(), modulator, half)


def test_encode_with_more_frames(scene):
    """Frames are of the scene as it was rendered, whatever was changed since."""
    scene.holopath.frames, scene.holopath.colors = 2, "MONO"
    bpy.ops.holopath.render_hologram()
    for thing in list(scene.objects):
        bpy.data.objects.remove(thing)
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    assert session.current.phase.method == "refine"


def test_stopping_an_encoding_keeps_it(scene, monkeypatch):
    bpy.ops.holopath.render_hologram()
    plain = pipeline.encode

    def encode(field, method, progress, *rest, **options):
        def stop(done, message):
            if "dB" in message:
                raise engine.Cancelled

        return plain(field, method, stop, *rest, **options)

    monkeypatch.setattr(pipeline, "encode", encode)
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    assert session.current.phase.report["stopped"]


def test_stopping_an_encoding_leaves_the_last_hologram(scene, monkeypatch):
    """A whole hologram of the same field is worth more than a part of another."""
    bpy.ops.holopath.render_hologram()
    scene.holopath.encoding = "dpac"
    bpy.ops.holopath.encode()
    before = session.current.phase
    scene.holopath.encoding = "auto"
    test = engine.encode

    def stopped(field, method, progress, **options):
        def stop(done, message):
            if "dB" in message:
                raise engine.Cancelled

        return test(field, method, stop, **options)

    monkeypatch.setattr(engine, "encode", stopped)
    assert bpy.ops.holopath.encode() == {"CANCELLED"}
    assert session.current.phase is before and not session.current.error


def test_seconds_of_encoding(scene):
    """The button makes what it can of them, and says how."""
    scene.holopath.frames = 2
    scene.holopath.colors = "MONO"
    bpy.ops.holopath.render_hologram()
    scene.holopath.limit_encoding, scene.holopath.encode_seconds = True, 1.5
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    report = session.current.phase.report
    assert report["plan"]["seconds"] <= 1.5 and report["plan"]["method"] == session.current.phase.method
    assert sum(stage["seconds"] for stage in report["stages"]) < SOON


def test_phases_of_an_earlier_field_are_dropped(scene, monkeypatch):
    bpy.ops.holopath.render_hologram()

    def encode(field, *_, **__):
        session.current.refocuser = engine.Refocuser(field.__class__(**vars(field)))  # F12, meanwhile
        return None

    monkeypatch.setattr(pipeline, "encode", encode)
    with pytest.raises(RuntimeError, match="press Encode again"):
        bpy.ops.holopath.encode()
    assert session.current.phase is None
