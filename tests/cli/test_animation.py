"""Animations on the command line: every frame is a complete output folder, and nothing is made twice."""

import json
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.workflow import output

bpy = pytest.importorskip("bpy")

WORDS = ["--resolution", "32x32", "--frames", "1", "--wavelengths", "516.5", "--quality", "preview"]
FRAMES = ["frame_0003", "frame_0005", "frame_0007"]


def triangle(name, size, depth, radiance):
    """An emissive triangle in front of a camera at the origin."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-size, -size, 0), (size, -size, 0), (0, size, 0)], [], [(0, 1, 2)])
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    principled = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    principled.inputs["Emission Color"].default_value = (radiance,) * 3 + (1,)
    principled.inputs["Emission Strength"].default_value = 1
    mesh.materials.append(material)
    thing = bpy.data.objects.new(name, mesh)
    thing.location = (0, 0, -depth)
    bpy.context.scene.collection.objects.link(thing)
    return thing


@pytest.fixture
def moving(empty_scene, tmp_path):
    """A .blend of three frames, 3, 5 and 7: a triangle that moves at first and then rests."""
    scene = empty_scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    triangle("Wall", 9.0, 2.0, 0.1)
    near = triangle("Near", 0.1, 0.5, 1.0)
    for frame, x in ((3, -0.05), (5, 0.05), (7, 0.05)):
        near.location.x = x
        near.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end, scene.frame_step = 3, 8, 2
    path = tmp_path / "moving.blend"

    def save():
        bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
        return path

    return save


@pytest.fixture
def renders(monkeypatch):
    """Count calls of the engine; those with a number in `canceled` are canceled."""
    render = engine.render

    class Renders:
        count, canceled = 0, ()

    def counted(*arguments, **options):
        Renders.count += 1
        if Renders.count in Renders.canceled:
            raise engine.Cancelled
        return render(*arguments, **options)

    monkeypatch.setattr(engine, "render", counted)
    return Renders


def animate(blend, out, *more, words=WORDS):
    return cli.main(["render", str(blend), *words, "--out", str(out), "--animation", *more])


def names(folder):
    """Names in a folder, without those of the job and its light."""
    return sorted(p.name for p in folder.iterdir() if p.name not in ("job.json", "light"))


def field(folder):
    return np.load(folder / "wavefield" / "field.npy")


def test_every_frame_is_a_still(moving, tmp_path, capfd):
    out, still = tmp_path / "out", tmp_path / "still"
    blend = moving()
    assert animate(blend, out, "--focus", "0.5m,inf") == 0
    assert "Done: 3 frames" in capfd.readouterr().err
    assert names(out) == FRAMES
    bpy.context.scene.frame_set(5)
    blend = moving()
    assert cli.main(["render", str(blend), *WORDS, "--focus", "0.5m,inf", "--out", str(still)]) == 0
    for name in FRAMES:
        contents = {str(p.relative_to(out / name)) for p in (out / name).rglob("*")}
        assert contents == {str(p.relative_to(still)) for p in still.rglob("*")}
    first, second, third = (field(out / name) for name in FRAMES)
    np.testing.assert_array_equal(second, field(still))
    np.testing.assert_array_equal(second, third)
    assert abs(first - second).max() > 0.1 * abs(second).max()


def test_phases_begin_with_the_previous_frame(moving, tmp_path, monkeypatch):
    """Frames are made in turn: the third, which equals the second, continues from it and is better."""
    starts, encode = [], engine.encode

    def encode_briefly(field, method="auto", progress=None, **options):
        starts.append(options.get("start"))
        return encode(field, method, progress, **{**options, "extra_frames": None, "max_steps": 30})

    monkeypatch.setattr(engine, "encode", encode_briefly)
    monkeypatch.setattr(engine, "extra_frame_count", lambda *_: 0)
    words = tmp_path / "out", "--encode", "joint", "--encode-start", "before"
    blend = moving()
    assert animate(blend, *words) == 0
    assert starts[0] is None
    for before, name in zip(starts[1:], FRAMES, strict=False):
        phases = engine.PhaseHologram.load(tmp_path / "out" / name / "hologram").data
        np.testing.assert_array_equal(before.data, phases)
    loss = [
        json.loads((tmp_path / "out" / name / "report.json").read_text())["encoding"]["stages"][-1]["loss"]
        for name in FRAMES[1:]
    ]
    assert loss[1] <= loss[0]

    def pretend_first_was_found_anew():
        """Other phases of the same scene, as with a limit of seconds."""
        folder = tmp_path / "out" / FRAMES[0]
        phase = engine.PhaseHologram.load(folder / "hologram")
        phase = replace(phase, data=np.array(phase.data) / 2)
        phase = replace(phase, report={**phase.report, "sha256": phase.digest})
        phase.save(folder / "hologram")
        report = output.read_report(folder)
        report["encoding"] = {"method": phase.method, **phase.report}
        output.replace_report(folder, report)
        return phase.data

    del starts[:]
    first = pretend_first_was_found_anew()
    assert animate(blend, *words) == 0
    assert len(starts) == 2  # the second's, and then the third's, which began with those of the second
    np.testing.assert_array_equal(starts[0].data, first)
    del starts[:]
    assert animate(blend, *words) == 0
    assert not starts


def test_starts_without_a_previous_frame(moving, tmp_path, capfd):
    assert animate(moving(), tmp_path / "out", "--encode-start", "before") == 2
    assert (
        "Expected an animation and a method with gradient descent for --encode-start before"
        in capfd.readouterr().err
    )


def test_continues_after_a_cancellation(moving, renders, tmp_path, capfd):
    out, blend = tmp_path / "out", moving()
    renders.canceled = (2,)
    assert animate(blend, out) == 1
    error = capfd.readouterr().err.splitlines()[-1]
    assert error.startswith("holopath: Canceled: finished frames are in") and "\n" not in error
    assert names(out) == FRAMES[:1]
    assert animate(blend, out) == 0
    assert renders.count == 4 and names(out) == FRAMES
    error = capfd.readouterr().err
    assert "frame_0003: done before, skipped" in error and error.count("skipped") == 1
    assert "Done: 2 frames" in error and "1 done before" in error


def test_only_changed_frames_are_rendered_again(moving, renders, tmp_path, capfd):
    out = tmp_path / "out"
    assert animate(moving(), out, "--focus", "0.5m") == 0
    before = [field(out / name) for name in FRAMES]
    near = bpy.data.objects["Near"]
    near.location.x = -0.05
    near.keyframe_insert("location", frame=7)
    blend = moving()
    assert animate(blend, out, "--focus", "0.5m") == 0
    assert renders.count == 4
    assert "frame_0007: rendered anew (changed: scene)" in capfd.readouterr().err
    np.testing.assert_array_equal(field(out / FRAMES[1]), before[1])
    np.testing.assert_array_equal(field(out / FRAMES[2]), before[0])  # where it was in the first

    assert animate(blend, out, "--focus", "2m,inf", "--pupil", "0,0,1") == 0
    assert renders.count == 4  # a field holds every focus
    assert "frame_0005: refocused (changed: focus, pupil)" in capfd.readouterr().err
    assert names(out / FRAMES[1] / "reconstruction") == [
        "focus_2m_pupil_0_0_1mm.exr",
        "focus_2m_pupil_0_0_1mm.png",
        "focus_infm_pupil_0_0_1mm.exr",
        "focus_infm_pupil_0_0_1mm.png",
    ]
    assert json.loads((out / FRAMES[1] / "report.json").read_text())["focus_m"] == [2.0, "inf"]
    np.testing.assert_array_equal(field(out / FRAMES[1]), before[1])

    assert animate(blend, out, "--focus", "2m,inf", "--pupil", "0,0,1", "--seed", "1") == 0
    assert renders.count == 7
    assert "frame_0003: rendered anew (changed: setting seed)" in capfd.readouterr().err


def test_only_changed_frames_are_encoded_again(moving, tmp_path, capfd, monkeypatch):
    count, encode = [], engine.encode

    def counted(*words, **options):
        count.append(words[1])
        return encode(*words, max_steps=3, **options)

    monkeypatch.setattr(engine, "encode", counted)
    out, blend = tmp_path / "out", moving()
    assert animate(blend, out, "--encode", "sgd") == 0
    assert animate(blend, out, "--encode", "sgd", "--focus", "2m") == 0
    assert count == ["sgd"] * 3  # phases do not depend on the focus
    stored = engine.PhaseHologram.load(out / FRAMES[1] / "hologram")
    assert stored.method == "sgd"
    assert json.loads((out / FRAMES[1] / "report.json").read_text())["encoding"]["method"] == "sgd"
    (out / FRAMES[1] / "hologram" / "phase.npy").unlink()
    assert animate(blend, out, "--encode", "sgd", "--focus", "2m") == 0
    assert len(count) == 4
    capfd.readouterr()
    assert animate(blend, out, "--encode", "sgd", "--focus", "2m", "--bits", "2") == 0
    assert len(count) == 7 and "changed: bits" in capfd.readouterr().err


def test_a_damaged_frame_is_rendered_again(moving, renders, tmp_path):
    out, blend = tmp_path / "out", moving()
    assert animate(blend, out) == 0
    whole = (out / FRAMES[1] / "wavefield" / "field.npy").read_bytes()
    (out / FRAMES[1] / "wavefield" / "field.npy").write_bytes(whole[:-8])
    assert animate(blend, out) == 0
    assert renders.count == 4
    assert (out / FRAMES[1] / "wavefield" / "field.npy").read_bytes() == whole


def test_a_frame_that_cannot_be_rendered_is_named(moving, tmp_path, capfd):
    bpy.context.scene.camera.keyframe_insert("rotation_euler", frame=3)
    bpy.context.scene.camera.rotation_euler.x = 3.1
    bpy.context.scene.camera.keyframe_insert("rotation_euler", frame=7)
    assert animate(moving(), tmp_path / "out") == 2
    assert "holopath: Frame 7: Nothing is in the camera's view" in capfd.readouterr().err
    assert names(tmp_path / "out") == FRAMES[:2]


@pytest.mark.parametrize("words", [["--animation"], ["--frame-range", "1-3"]])
def test_a_scene_without_animation(words, tmp_path, capfd):
    assert cli.main(["render", "scene.xml", "--out", str(tmp_path / "out"), *words]) == 2
    assert capfd.readouterr().err == (
        f"holopath: scene.xml has no animation. Give a .blend, or omit {words[0]}.\n"
    )
    assert not (tmp_path / "out").exists()


def test_frames_may_be_listed_and_lie_beyond_the_range(moving, tmp_path, capfd):
    out, blend = tmp_path / "out", moving()
    words = ["render", str(blend), *WORDS, "--out", str(out)]
    assert cli.main([*words, "--frame-range", "-1,4-5"]) == 0
    assert names(out) == ["frame_-001", "frame_0004", "frame_0005"]
    assert "Done: 3 frames" in capfd.readouterr().err
    assert animate(blend, out) == 0
    error = capfd.readouterr().err
    assert "frame_0005: done before, skipped" in error and "Done: 2 frames" in error
    assert cli.main([*words, "--frame-range", "5-1"]) == 2
    assert "The range '5-1' is empty" in capfd.readouterr().err


@pytest.mark.slow
def test_frames_of_a_demo(tmp_path):
    out = tmp_path / "out"
    assert cli.main(["render", "demo:planes", *WORDS, "--frame-range", "2-3", "--out", str(out)]) == 0
    assert names(out) == ["frame_0002", "frame_0003"]
    np.testing.assert_array_equal(field(out / "frame_0002"), field(out / "frame_0003"))


def test_settings_may_be_animated(moving, tmp_path):
    if not hasattr(bpy.types.Scene, "holopath"):
        from holopath_addon.blender import properties

        properties.register()
    props = bpy.context.scene.holopath
    for frame, far in ((3, 0.5), (7, 0.7)):
        props.depth_far_mm, props.depth_near_mm = far, 1.0
        props.keyframe_insert("depth_far_mm", frame=frame)
    props.resolution_x = props.resolution_y = 32
    props.colors = "MONO"
    assert animate(moving(), tmp_path / "out", words=["--frames", "1", "--quality", "preview"]) == 0
    reports = [json.loads((tmp_path / "out" / name / "report.json").read_text()) for name in FRAMES]
    assert [r["hologram"]["depth_far"] for r in reports] == pytest.approx([0.5e-3, 0.6e-3, 0.7e-3])
