"""Animations in the background: by processes of their own, and what the panel tells of them."""

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import bpy
import pytest

from holopath_addon import engine
from holopath_addon.blender import preferences
from holopath_addon.cli.supervised import COPY_PREFIX
from holopath_addon.farm import processes
from holopath_addon.operators import background
from holopath_addon.ui import sections
from tests.patience import NEVER
from tests.ui.layout import Context, Layout, draw
from tests.ui.test_words import BRITISH

MAIN = Path(background.__file__).parents[1] / "__main__.py"


@pytest.fixture
def moving(scene, tmp_path):
    """Two frames that take a second, and a folder for them."""
    props = scene.holopath
    props.resolution_x = props.resolution_y = 32
    props.frames, props.colors = 1, "MONO"
    props.animation_folder = str(tmp_path / "out")
    near = scene.objects["Near"]
    for frame, x in ((1, -0.05), (2, 0.05)):
        near.location.x = x
        near.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, 2
    yield scene
    background.current.cancel()
    assert background.current.wait(NEVER)
    background.current = background.Background()


def fields(folder):
    return {file.parents[1].name: file.stat().st_mtime_ns for file in folder.rglob("field.npy")}


def panel(scene):
    context = Context(scene)
    layout = Layout(context)
    sections.animation(layout, context)
    assert not BRITISH.search(layout.words)
    for cls in (bpy.types.HOLOPATH_PT_view3d_animation, bpy.types.HOLOPATH_PT_render_animation):
        assert draw(cls, context).words == layout.words
    return layout


def test_renders_the_scene_as_it_is_and_nothing_twice(moving, tmp_path):
    """Phases are encoded by the settings of the section Hologram."""
    props, out = moving.holopath, tmp_path / "out"
    props.encoding, props.animation_encodes = "dpac", True
    assert bpy.ops.holopath.render_animation() == {"FINISHED"}
    assert engine.PhaseHologram.load(out / "frame_0001" / "hologram").method == "dpac"
    made = fields(out)
    assert sorted(path.name for path in out.iterdir()) == ["frame_0001", "frame_0002", "job.json", "light"]
    assert bpy.data.filepath == "" and "2 Frames Done" in panel(moving).words
    background.current.scene = "Before"
    assert "Of Scene 'Before'" in panel(moving).words
    background.current.scene = moving.name
    assert "Of Scene" not in panel(moving).words
    assert bpy.ops.holopath.render_animation() == {"FINISHED"}
    assert fields(out) == made and background.current.finished == 2


def test_words_of_phases(moving, tmp_path):
    props, out = moving.holopath, tmp_path / "out"
    props.animation_encodes, props.encoding = True, "auto"
    props.limit_encoding, props.encode_seconds, props.bits = True, 5.0, 4
    words = background._words(props, Path("a.blend"), out)
    assert words[-6:] == ["--encode", "auto", "--encode-seconds", "5.0", "--bits", "4"]
    props.animation_in_turn, props.eyebox_auto, props.eyebox = True, False, 0.5
    assert background._words(props, Path("a.blend"), out)[-6:-2] == [
        "--eyebox",
        "0.5",
        "--encode-start",
        "before",
    ]
    props.device.calibration = "//my.json"
    assert background._words(props, Path("a.blend"), out)[-2:-1] == ["--response"]


def test_words_of_a_measured_bench(moving, tmp_path):
    """The copy lies elsewhere than the .blend."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    props = bpy.context.scene.holopath
    optics = props.optics
    optics.beam, optics.beam_file, optics.beam_phase = "measured", "//size.png", "//phase.npy"
    optics.stop, optics.stop_file, optics.carrier = "measured", "//stop.png", "auto"
    words = background._words(props, "c.blend", "out")[6:]
    beam = f"amplitude={tmp_path / 'size.png'},phase={tmp_path / 'phase.npy'}"
    assert words == ["--stop", str(tmp_path / "stop.png"), "--carrier=auto", "--beam", beam]
    optics.beam_holds, optics.stop = "field", "circle"
    assert background._words(props, "c.blend", "out")[6:] == ["--beam", str(tmp_path / "size.png")]


def playing(lines, then="sys.stdin.read()"):
    """A process that says so much and then waits for the end of its input, or does otherwise."""
    code = f"import json, os, sys\nfor line in {lines!r}: print(line, file=sys.stderr, flush=True)\n{then}"
    work = background.current = background.Background("scene.blend", "Scene", 250)
    ended = []
    work.start([sys.executable, "-c", code], dict(os.environ), ".", lambda: ended.append(True))
    return work, ended


def report(done, message):
    return json.dumps({"done": done, "message": message})


def until(condition):
    end = time.monotonic() + NEVER
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_panel_while_at_work_and_canceled(moving):
    lines = [
        json.dumps({"say": "frame_0001: done before, skipped"}),
        "Read blend: what Blender prints, {or others}",
        "{not json",
        report(10 / 250, "Frame 11: Exporting the scene"),
        json.dumps({"say": "frame_0011: note: Fog: left out"}),
        json.dumps({"say": "frame_0012: note: Fog: left out"}),
        report(11.5 / 250, "Frame 12: Wave tracing"),
    ]
    work, ended = playing(lines)
    until(lambda: work.message == "Wave tracing")
    layout = panel(moving)
    assert layout.all("progress", "factor") == [11.5 / 250]
    assert layout.all("progress", "text")[0].startswith("Frame 12 of 250, ")
    assert layout.all("operator", "operator") == ["holopath.cancel_animation"]
    assert "Wave tracing…" in layout.words and layout.words.count("Fog: left out") == 1
    assert "Of scene.blend" in layout.words  # another file is open
    assert not bpy.ops.holopath.render_animation.poll()
    bpy.ops.holopath.cancel_animation()
    assert work.wait(NEVER) and ended and not work.error
    layout = panel(moving)
    assert "Canceled: 11 of 250 Frames Done" in layout.words
    assert layout.all("operator", "operator") == ["holopath.render_animation"]
    assert not bpy.ops.holopath.cancel_animation.poll()


def test_panel_while_the_light_is_made(moving):
    """It is no frame, and its time tells nothing of theirs."""
    work, _ = playing([report(0.0, "Opening the scene"), report(0.0, "Light: Baking light in view")])
    until(lambda: work.lighting)
    layout = panel(moving)
    assert layout.all("progress", "text") == ["Light of 250 Frames"]
    assert "Baking light in view…" in layout.words and work.finished == 0 and work.remaining is None
    began = work._first_report[0]
    work._read_line(report(0.0, "Light: Baking light in view"))
    assert work._first_report[0] > began
    work._read_line(report(0.5 / 250, "Frame 1: Radiance"))
    assert panel(moving).all("progress", "text")[0].startswith("Frame 1 of 250, ")
    bpy.ops.holopath.cancel_animation()
    assert work.wait(NEVER)


@pytest.mark.parametrize(
    "lines, then, words",
    [
        (["holopath: No space left."], "sys.exit(1)", "No space left."),
        ([report(0.5, "Frame 2: Planning")], "os.kill(os.getpid(), 9)", "ended by signal 9"),
        ([], "sys.exit(3)", "ended with status 3"),
    ],
)
def test_panel_where_it_failed(moving, lines, then, words):
    work, ended = playing(lines, then)
    assert work.wait(NEVER) and ended
    layout = panel(moving)
    assert words in layout.words and layout.all("operator", "operator") == ["holopath.render_animation"]


def test_a_file_that_was_never_saved_needs_a_folder(moving):
    moving.holopath.animation_folder = "//holopath"
    with pytest.raises(RuntimeError, match="save the .blend, or choose a folder"):
        bpy.ops.holopath.render_animation()
    assert "choose a folder" in panel(moving).words and bpy.ops.holopath.render_animation.poll()


def test_a_folder_that_cannot_be_written(moving, tmp_path):
    (tmp_path / "file").write_text("")
    moving.holopath.animation_folder = str(tmp_path / "file" / "out")
    with pytest.raises(RuntimeError, match="choose another folder"):
        bpy.ops.holopath.render_animation()


def test_the_copy_finds_what_the_file_finds(moving, tmp_path):
    """Files by relative paths, and simulations that Blender has baked beside the file."""
    image = bpy.data.images.new("Texture", 4, 4)
    image.filepath_raw = str(tmp_path / "texture.png")
    image.save()
    moving.objects["Near"].active_material.node_tree.nodes.new("ShaderNodeTexImage").image = image
    file = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(file))
    image.filepath = "//texture.png"
    (tmp_path / "blendcache_scene").mkdir()
    (tmp_path / "blendcache_scene" / "0_01.bphys").write_text("baked")
    copy = background._save_copy(tmp_path / "a" / "b", file.name)
    assert background._is_whole(copy)
    assert copy.parent.name.startswith(COPY_PREFIX)
    assert (copy.parent / "blendcache_scene" / "0_01.bphys").read_text() == "baked"
    assert (bpy.data.filepath, image.filepath) == (str(file), "//texture.png")
    bpy.ops.wm.open_mainfile(filepath=str(copy))
    assert Path(bpy.path.abspath(bpy.data.images["Texture"].filepath)).resolve() == tmp_path / "texture.png"
    os.truncate(copy, copy.stat().st_size - 1000)
    assert not background._is_whole(copy)
    background._remove(copy)
    assert not (tmp_path / "a" / "b").exists()


def test_words(moving, monkeypatch):
    """The words name the view and the cluster; settings are in the file."""
    props, words = moving.holopath, ["render", "c.blend", "--animation", "--attended", "--out", "out"]
    assert background._words(props, "c.blend", "out") == words
    props.focus_list.add().focus = 0.5
    props.focus_auto, props.focus = False, 0.3
    props.use_pupil, props.pupil_offset_mm, props.pupil_diameter_mm = True, (-1.0, 2.0), 3.0
    monkeypatch.setattr(preferences, "cluster", lambda: "tcp://10.0.0.5:8786")
    found = background._words(props, "c.blend", "out")
    assert found[: len(words)] == words
    assert found[len(words) :] == "--focus 0.3,0.5 --pupil=-1.0,2.0,3.0 --cluster tcp://10.0.0.5:8786".split()


def test_what_the_window_shows_is_rendered(moving, tmp_path):
    """Its scene and view layer, and not where the animation of another one is."""
    moving.frame_end = 1
    layer = moving.view_layers.new("Foreground")
    assert background._opened(moving, layer)[:2] == [f"--scene-name={moving.name}", "--view-layer=Foreground"]
    for each in layer.layer_collection.children:
        each.exclude = True
    with bpy.context.temp_override(view_layer=layer):
        assert bpy.ops.holopath.render_animation() == {"FINISHED"}
    opened = json.loads((tmp_path / "out" / "frame_0001" / "report.json").read_text())["scene_state"]
    assert (opened["scene"], opened["view_layer"]) == (moving.name, "Foreground")
    background.check_free(tmp_path / "out", "saved.blend", "Since")
    job = tmp_path / "out" / "job.json"
    job.write_text(job.read_text().replace(background.UNTITLED, "shot_a.blend"))
    background.check_free(tmp_path / "out", "shot_a.blend", moving.name)
    with pytest.raises(RuntimeError, match=r"animation of shot_a.blend, which would be replaced"):
        bpy.ops.holopath.render_animation()
    with pytest.raises(engine.InvalidInput, match=f"animation of the scene '{moving.name}'"):
        background.check_free(tmp_path / "out", "shot_a.blend", "Other")


def test_command(addon, monkeypatch, tmp_path):
    """Blender runs itself, even if its preferences on disk do not list the add-on; a cluster needs Python."""
    command, _ = background._command(["render"], "/opt/blender")
    assert command == "/opt/blender --background --addons holopath_addon --command holopath render".split()
    words = ["render", "--cluster", "local:2"]
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(engine.InvalidInput, match="needs the command holopath, which was not found"):
        background._command(words, "/opt/blender")
    program = tmp_path / "holopath"
    program.touch(0o755)
    assert background._command(words, "/opt/blender")[0] == [str(program), *words]
    command, environment = background._command(words, "")
    assert command == [sys.executable, "-m", "holopath_addon", *words]
    assert environment["PYTHONPATH"].split(os.pathsep)[0] == str(MAIN.parents[1])


def test_environment(addon, monkeypatch):
    """Computes as this Blender does."""
    monkeypatch.setattr(preferences, "chosen_backend", lambda: "llvm_ad_rgb")
    found = preferences.environment()
    assert found["HOLOPATH_BACKEND"] == "llvm_ad_rgb" and found["DRJIT_CACHE_DIR"]
    assert found["HOLOPATH_CACHE"] == str(preferences.store().folder)
    monkeypatch.setattr(engine.scene.variants, "_current_variant", lambda: None)
    monkeypatch.setenv("HOLOPATH_BACKEND", "abacus")
    with pytest.raises(engine.InvalidInput, match="abacus"):
        engine.scene.variants.activate()


@pytest.mark.parametrize("killed", [pytest.param(False, marks=pytest.mark.slow), True])
def test_ends_with_its_input(tmp_path, killed):
    """The process ends when its input is closed or its parent killed; the copy of the scene goes, whole frames stay."""
    copy, out = tmp_path / f"{COPY_PREFIX}x" / "scene.blend", tmp_path / "out"
    copy.parent.mkdir()
    bpy.ops.wm.read_factory_settings()
    bpy.ops.wm.save_as_mainfile(filepath=str(copy), copy=True)
    words = (
        f"--frame-range 1-900 --resolution 32x32 --quality preview --frames 1 --wavelengths 500 --out {out}"
    )
    command = [sys.executable, str(MAIN), "render", str(copy), "--attended", *words.split()]
    code = (
        "import subprocess, sys\n"
        f"child = subprocess.Popen({command!r}, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True)\n"
        "print(child.pid, flush=True)\n"
        "for line in child.stderr: print(line, end='', flush=True)\n"
    )
    if not killed:
        process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        lines, pid = process.stderr, process.pid
    else:
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        lines = process.stdout
        pid = int(lines.readline())
    next(
        line for line in lines if re.search(r"Frame (?!1:)\d+: ", line)
    )  # those that are quick are not reported
    if killed:
        process.kill()
    else:
        process.stdin.close()
        assert "holopath: Canceled: finished frames are in" in lines.read()
    process.wait(NEVER)
    until(lambda: not processes.start_time(pid))
    assert not copy.parent.exists()
    made = len(fields(out))
    assert 0 < made < 900
    names = [f"frame_{number + 1:04d}" for number in range(made)]
    assert sorted(path.name for path in out.iterdir()) == [*names, "job.json", "light"]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="of POSIX")
def test_nobody_hears(tmp_path):
    """Signals as Blender has them: to say something to a window that is gone does not end it amid a file."""
    words = f"--frame-range 1-2 --resolution 32x32 --quality preview --frames 1 --wavelengths 500 --out {tmp_path}"
    code = (
        "import signal, sys\n"
        "signal.signal(signal.SIGPIPE, signal.SIG_DFL)\n"
        "from holopath_addon.cli import main\n"
        f"sys.exit(main({['render', 'demo:box', '--attended', *words.split()]!r}))"
    )
    pipes = {"stdin": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen([sys.executable, "-c", code], cwd=MAIN.parents[1], **pipes)
    assert process.stderr and process.stderr.readline()
    process.stderr.close()
    assert process.wait(NEVER) == 0
    assert sorted(fields(tmp_path)) == ["frame_0001", "frame_0002"]
