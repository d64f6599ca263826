"""The command line: what it writes, what it refuses, and how it ends."""

import json
import math
import os
import platform
import re
import resource
import signal
import subprocess
import sys
import threading
import time
import types
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import cli, engine, slm
from holopath_addon.cli import render_command, sources
from holopath_addon.workflow import output, pipeline
from tests.patience import NEVER, SOON

ROOT = Path(__file__).parents[2]
SMALL = ["--resolution", "64x64", "--frames", "2", "--quality", "preview"]
GREEN = ["--wavelengths", "516.5"]
SCENE = """<scene version="3.0.0">
<sensor type="{sensor}" id="viewer"><float name="fov" value="40"/>{offset}
 <transform name="to_world"><lookat origin="0.2,0,0" target="0,0.1,1" up="0,1,0"/></transform>
 <film type="hdrfilm"><integer name="width" value="48"/><integer name="height" value="32"/>
  <rfilter type="box"/></film></sensor>
<shape type="sphere"><point name="center" x="0.02" y="0.1" z="0.5"/><float name="radius" value="0.1"/>
 <emitter type="area"><rgb name="radiance" value="1,0.2,0.1"/></emitter></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="180"/>
 <translate z="2"/></transform>
 <emitter type="area"><rgb name="radiance" value="0.1,0.4,0.2"/></emitter></shape>
</scene>"""


@pytest.fixture
def xml(tmp_path):
    """A Mitsuba scene of emitters, quick to render."""
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(sensor="perspective", offset=""))
    return path


def start(*words, **options):
    """Start the command line in its own process."""
    return subprocess.Popen(
        [sys.executable, "-m", "holopath_addon", *map(str, words)],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def refused(status, error, expected_status, says):
    """Assert an error in one line with that text."""
    assert status == expected_status, error
    lines = [line for line in error.splitlines() if line.startswith("holopath: ")]
    assert len(lines) == 1 and "Traceback" not in error, error
    assert re.search(says, lines[0]), error


def left_over(folder):
    """Names in a folder, without those of inputs."""
    return sorted(p.name for p in folder.iterdir() if p.suffix not in (".xml", ".blend"))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["missing.blend"], "missing.blend does not exist"),
        (["{xml}x"], "does not exist"),
        (["{out}.txt"], "does not exist"),
        (["demo:nowhere"], "no demo 'nowhere'"),
        (["{xml}", "--display", "nothing"], "a display preset, got 'nothing'.*pluto-2"),
        (["{xml}", "--display", "pluto-2", "--pitch", "8"], "Omit --resolution and --pitch"),
        (["{xml}", "--resolution", "0x64"], "1 x 1 pixels, got 0 x 64"),
        (["{xml}", "--resolution", "64"], "WIDTHxHEIGHT"),
        (["{xml}", "--pitch", "0"], "pitch"),
        (["{xml}", "--pitch", "8,0"], "a positive pixel pitch, got 0 µm"),
        (["{xml}", "--pitch", "8x9"], "Expected a pixel pitch, got '8x9'.*X,Y"),
        (["{xml}", "--pitch", "0.2"], "too small for 640 nm"),
        (["{xml}", "--pitch", "8e-6"], "Expected a pixel pitch in micrometers, got '8e-6'. Give 8 for"),
        (["{xml}", "--wavelengths", "red"], "nanometers"),
        (["{xml}", "--wavelengths", "5"], "5 nm"),
        (["{xml}", "--frames", "0"], "Frames"),
        (["{xml}", "--frames", "many"], "frames"),
        (["{xml}", "--depth-range", "15,10"], "depth range"),
        (["{xml}", "--depth-range", "15"], "FAR,NEAR"),
        (["{xml}", "--near", "-1"], "near end"),
        (["{xml}", "--wrp", "middle"], "Expected auto or a distance in millimeters, got 'middle'"),
        (["{xml}", "--focus", "-1m"], "in front of the camera, got -1m"),
        (["{xml}", "--focus", "0.5m,soon"], "Expected a distance, got 'soon'"),
        (["{xml}", "--pupil", "-1,0,0"], "pupil"),
        (["{xml}", "--pupil", "1,2"], "X,Y,DIAMETER"),
        (["{xml}", "--camera", "nobody"], "Expected a sensor of"),
        (["{xml}", "--method", "slow"], "invalid choice: 'slow'.*fast"),
        (["{xml}", "--cache", "x", "--no-cache"], "not allowed with"),
        (["{xml}", "--phase-field", "pink"], "invalid choice"),
        (["{xml}", "--despeckle", "-1"], "Despeckle"),
        (["{xml}", "--encode", "magic"], "invalid choice"),
        (["{xml}", "--animation"], "--animation"),
        (["{xml}", "--seed", "-1"], "Seed"),
        (["{xml}", "--quality", "high", "--spp", "3"], "not allowed with"),
        (["{xml}", "--contact-sheet", "demo.jpg"], "Expected the name of an image in DIR"),
        (["{xml}", "--contact-sheet", "../demo.png"], "Expected the name of an image in DIR"),
    ],
)
def test_bad_words(words, says, xml, tmp_path, capfd):
    out = tmp_path / "out"
    words = [word.format(xml=xml, out=out) for word in words]
    if "demo" in words[0]:
        pytest.importorskip("bpy")
    status = cli.main(["render", *words, "--out", str(out)])
    refused(status, capfd.readouterr().err, 2, says)
    assert left_over(tmp_path) == []


@pytest.mark.parametrize("words", [[], ["render"], ["stream"], ["encode"], ["reconstruct"]])
def test_bad_commands(words, capfd):
    status = cli.main(words)
    refused(status, capfd.readouterr().err, 2, "required|invalid choice")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ["render", "x.xml", "--out", "o", "--wavelength", "638"],
            r"arguments: --wavelength 638\. Did you mean --wavelengths\? See `holopath render --help`\.$",
        ),
        (["render", "x.xml", "--out", "o", "--color=red"], r"--color=red\. See `holopath render --help`\.$"),
        (["reconstruct", "o", "--distance=1"], r"mean --distances\? See `holopath reconstruct --help`\.$"),
        (["encode", "o", "more"], r"unrecognized arguments: more\. See `holopath encode --help`\.$"),
        (["--color", "devices"], r"unrecognized arguments: --color\. See `holopath --help`\.$"),
    ],
)
def test_unknown_words_name_the_help_of_their_command(words, says, capfd):
    refused(cli.main(words), capfd.readouterr().err, 2, says)


def test_words_after_two_dashes(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["blender", "--background", "x.blend", "--", "devices"])
    assert cli.main() == 0
    assert "llvm_ad_rgb" in capsys.readouterr().out


def test_runs_as_a_file():
    words = [sys.executable, ROOT / "holopath_addon" / "__main__.py", "--help"]
    done = subprocess.run(words, capture_output=True, text=True, cwd="/", check=False)
    assert done.returncode == 0 and "reconstruct" in done.stdout, done.stderr


def make_blend(path, kind):
    """A .blend that cannot be rendered."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    mesh = bpy.data.meshes.new("Broken")
    corner = math.nan if kind == "nan" else 0.0
    size = 0.0 if kind == "zero" else 1.0
    mesh.from_pydata([(-size, -size, corner), (size, -size, 0), (0, size, 0)], [], [(0, 1, 2)])
    scene.collection.objects.link(bpy.data.objects.new("Broken", mesh))
    if kind != "no camera":
        camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        camera.location = (0, 0, 3 if kind != "behind" else -3)
        camera.data.type = "ORTHO" if kind == "orthographic" else "PERSP"
        scene.collection.objects.link(camera)
        scene.camera = camera
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("no camera", "no active camera"),
        ("nan", "Broken"),
        ("zero", "(?i)nothing"),
        ("behind", "Nothing is in the camera's view"),
        ("orthographic", "(?i)perspective"),
    ],
)
def test_bad_blends(kind, says, tmp_path, capfd):
    make_blend(tmp_path / "bad.blend", kind)
    words = ["render", str(tmp_path / "bad.blend"), *SMALL, "--out", str(tmp_path / "out"), "--quiet"]
    status = cli.main(words)
    refused(status, capfd.readouterr().err, 2, says)
    assert left_over(tmp_path) == []


def test_files_that_are_no_scenes(tmp_path, capfd):
    pytest.importorskip("bpy")
    for name in ("bad.blend", "bad.xml"):
        (tmp_path / name).write_text("nothing of the kind")
        status = cli.main(["render", str(tmp_path / name), "--out", str(tmp_path / "out")])
        refused(status, capfd.readouterr().err, 2, f"{name} cannot be")
    assert left_over(tmp_path) == []


def test_scene_without_bpy(tmp_path):
    (tmp_path / "scene.blend").write_text("")
    code = "import sys; sys.modules['bpy'] = None; from holopath_addon.cli import main; sys.exit(main())"
    for scene in (tmp_path / "scene.blend", "demo:planes"):
        words = [sys.executable, "-c", code, "plan", scene]
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
        refused(done.returncode, done.stderr, 1, "needs Blender.*pip install bpy")


def test_wrong_llvm(xml, tmp_path):
    library = next(iter(Path("/").glob("lib*/*-linux-gnu/libm.so.6")), None)
    if library is None:
        pytest.skip("no library to take for an LLVM")
    process = start(
        "render",
        xml,
        *SMALL,
        "--out",
        tmp_path / "out",
        env=os.environ | {"DRJIT_LIBLLVM_PATH": str(library)},
    )
    _, error = process.communicate(timeout=NEVER)
    if engine.scene.variants.describe()[0]["available"]:
        pytest.skip("CUDA needs no LLVM")
    refused(process.returncode, error, 1, "DRJIT_LIBLLVM_PATH.*install LLVM")
    assert left_over(tmp_path) == []


def test_full_disk(xml, tmp_path):
    full = tmp_path / "full"
    words = [xml, "--resolution", "128x128", "--frames", "4", "--quality", "preview", "--out", full]
    limit = 1 << 20  # bytes a file; the field takes 1.5 MiB

    def set_limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    process = start("render", *words, preexec_fn=set_limit)
    _, error = process.communicate(timeout=NEVER)
    refused(process.returncode, error, 1, "could not be written")
    assert left_over(tmp_path) == []


def test_folder_that_cannot_be_made(xml, tmp_path, capfd):
    (tmp_path / "file.xml").write_text("")
    for out in (tmp_path / "file.xml", tmp_path / "file.xml" / "below", "/proc/holopath"):
        refused(cli.main(["render", str(xml), "--out", str(out)]), capfd.readouterr().err, 2, "output")
    assert left_over(tmp_path) == []


@pytest.mark.parametrize(
    ("number", "method", "at"),
    [
        (signal.SIGINT, "full", "Radiance|Wave tracing"),
        pytest.param(signal.SIGTERM, "fast", "Looking for baked light|Baking light", marks=pytest.mark.slow),
    ],
)
def test_interrupt(number, method, at, tmp_path):
    pytest.importorskip("bpy")
    out = tmp_path / "out"
    # each stage takes seconds, and is told at once to who attends
    words = ["--resolution", "512x512", "--quality", "full", "--frames", "50", "--method", method]
    words += ["--no-cache", "--attended", "--out", out]
    process = start("render", "demo:planes", *words, stdin=subprocess.PIPE)
    heard = ""
    while not re.search(at, heard):
        line = process.stderr.readline()
        assert line, heard
        heard += line
    sent = time.monotonic()
    process.send_signal(number)
    _, error = process.communicate(timeout=NEVER)
    assert time.monotonic() - sent < SOON
    refused(process.returncode, error, 1, "Canceled: nothing was written")
    assert left_over(tmp_path) == []


@pytest.mark.parametrize("over", [False, True])
def test_input_that_ends_interrupts_only_work_that_is_under_way(over, tmp_path, monkeypatch):
    """Later it would meet Blender in the middle of its own end."""
    from holopath_addon.cli import supervised

    ended, calls = threading.Event(), []
    monkeypatch.setattr(
        supervised,
        "os",
        types.SimpleNamespace(name="nt", _exit=lambda _: calls.append("exit")),
    )

    def blocks():
        assert ended.wait(NEVER)
        yield from ()

    monkeypatch.setattr(supervised, "standard_input", types.SimpleNamespace(blocks=blocks))
    monkeypatch.setattr(
        supervised, "_thread", types.SimpleNamespace(interrupt_main=lambda: calls.append("interrupt"))
    )
    monkeypatch.setattr(supervised, "time", types.SimpleNamespace(sleep=lambda _: None))

    def listener():
        return next(thread for thread in threading.enumerate() if thread.name == "holopath supervised")

    with supervised.supervised(tmp_path / "scene.blend"):
        thread = listener()
        if not over:
            ended.set()
            thread.join(NEVER)
    ended.set()
    thread.join(NEVER)
    assert calls == ([] if over else ["interrupt", "exit"])


def test_interrupt_waits_for_blender_to_load(tmp_path):
    (tmp_path / "bpy.py").write_text(
        "import os, pathlib, signal, time\n"
        "os.kill(os.getpid(), signal.SIGINT)\n"
        "time.sleep(0.1)\n"
        "pathlib.Path(__file__).with_name('whole').touch()\n"
    )
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    process = start("render", "demo:planes", "--out", tmp_path / "out", env=os.environ | {"PYTHONPATH": path})
    _, error = process.communicate(timeout=NEVER)
    refused(process.returncode, error, 1, "Canceled: nothing was written")
    assert (tmp_path / "whole").exists()  # bpy crashes where its import is torn
    assert not (tmp_path / "out").exists()


def test_interrupt_within_mitsuba(xml, tmp_path, capfd, monkeypatch):
    def torn(*arguments, **options):
        raise RuntimeError("drjit.custom: error in a custom operation") from KeyboardInterrupt()

    monkeypatch.setattr(engine, "reference", torn)
    words = ["render", str(xml), *SMALL, "--compare-reference", "--out", str(tmp_path / "out")]
    refused(cli.main(words), capfd.readouterr().err, 1, "Canceled: nothing was written")
    assert left_over(tmp_path) == []


def test_refuses_a_pupil_before_it_renders(xml, tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(engine, "render", lambda *a, **k: pytest.fail("rendered"))
    words = ["render", str(xml), *SMALL, "--pupil", "900,0,1", "--out", str(tmp_path / "out")]
    refused(cli.main(words), capfd.readouterr().err, 2, "outside the light")


@pytest.mark.parametrize(
    ("words", "bits"),
    [
        (["--display", "ti-plm-067"], 4),
        (["--display", "ti-plm-067", "--bits", "1"], 1),
        (["--display", "ti-plm-067", "--response", "levels.txt"], None),
        (["--display", "pluto-2"], None),
        (["--display", "santec-slm-210"], None),
        (["--bits", "2"], 2),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else str(value),
)
def test_levels_of_a_display(words, bits):
    """A panel of few levels has phases for these."""
    args = cli._parser(engine.BakeStore.default()).parse_args(["plan", "scene.xml", *words])
    assert render_command.bits_of(args) == bits


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Output folder of a small demo, compared with its reference."""
    pytest.importorskip("bpy")
    out = tmp_path_factory.mktemp("cli") / "deep" / "out"
    words = ["render", "demo:planes", *SMALL, "--focus", "0.5m,2m,inf", "--compare-reference", "--quiet"]
    assert cli.main([*words, "--out", str(out)]) == 0
    return out


def read(path):
    """Pixels of a picture file."""
    import mitsuba as mi

    return np.array(mi.Bitmap(str(path)))


def test_output_folder(rendered):
    names = {str(p.relative_to(rendered)) for p in rendered.rglob("*") if p.is_file()}
    pictures = {f"reconstruction/focus_{f}m.{kind}" for f in ("0.5", "2", "inf") for kind in ("exr", "png")}
    references = {name.replace("reconstruction", "reference") for name in pictures}
    assert names == {"wavefield/field.npy", "wavefield/meta.json", "report.json"} | pictures | references
    assert os.listdir(rendered.parent) == ["out"]


def test_pictures(rendered):
    field = engine.WaveField.load(rendered / "wavefield")
    assert field.data.shape == (2, 3, 64, 64)
    images = engine.to_rgb(engine.reconstruct(field, [0.5, 2.0, math.inf]), field.hologram.wavelengths)
    white = output.exposure(images)
    for image, name in zip(images, ("0.5", "2", "inf"), strict=True):
        stored = read(rendered / "reconstruction" / f"focus_{name}m.exr")
        assert stored.dtype == np.float32
        np.testing.assert_array_equal(stored, image)
        png = read(rendered / "reconstruction" / f"focus_{name}m.png")
        assert png.dtype == np.uint8 and png.shape == (64, 64, 3)
        saturated = (image >= white).all(-1)
        assert (png[saturated] == 255).all()


def test_report(rendered):
    report = json.loads((rendered / "report.json").read_text())
    assert report["hologram"]["depth_far"] == pytest.approx(-0.5e-3)
    assert report["settings"]["quality"] == "preview"
    assert report["focus_m"] == [0.5, 2.0, "inf"]
    assert report["spp"] == report["plan"]["rays_per_pixel"] > 0
    assert all(decision["reason"] for decision in report["plan"]["decisions"])
    parts = {**report["seconds"]}
    total = parts.pop("total")
    assert parts.get("wave tracing", 0) > 0 and parts["plan"] > 0.01, report["seconds"]
    assert 0.97 * total < sum(parts.values()) <= total
    assert report["rays"]["wave rays"] > 0
    assert report["versions"]["mitsuba"] and report["versions"]["blender"]
    machine = report["machine"]
    assert machine["processor"] and machine["threads"] >= 1 and machine["system"] == platform.system()
    assert report["warnings"] == [] and report["export_notes"] == [] and report["bake"] is None
    assert [row["focus_m"] for row in report["comparison"]] == [0.5, 2.0, "inf"]
    assert all(row["psnr_db"] > 10 and 0 < row["ssim"] <= 1 for row in report["comparison"])


def test_a_note_says_that_refocusing_ran_out_of_the_cards_memory(rendered, tmp_path, monkeypatch, capfd):
    from holopath_addon.engine.waves import libraries

    reconstruct = pipeline.reconstruct
    monkeypatch.setattr(pipeline, "reconstruct", lambda *args: (reconstruct(*args)[0], [libraries.RAN_OUT]))
    assert cli.main(["reconstruct", str(rendered), "--focus", "1m", "--out", str(tmp_path / "out")]) == 0
    assert capfd.readouterr().err.count(f"note: {libraries.RAN_OUT}") == 1


def test_reconstruct_again(rendered, tmp_path, capfd):
    before = {p.name: p.read_bytes() for p in (rendered / "reconstruction").iterdir()}
    assert cli.main(["reconstruct", str(rendered), "--out", str(tmp_path / "again"), "--quiet"]) == 0
    again = {p.name: p.read_bytes() for p in (tmp_path / "again").iterdir()}
    assert again == before
    words = ["--focus", "1D", "--pupil", "-1,0,3", "--out", str(tmp_path / "part"), "--quiet"]
    assert cli.main(["reconstruct", str(rendered), *words]) == 0
    name = "focus_1m_pupil_-1_0_3mm"  # beside the image through all of it
    assert sorted(os.listdir(tmp_path / "part")) == [f"{name}.exr", f"{name}.png"]
    assert capfd.readouterr().err == ""
    refused(
        cli.main(["reconstruct", str(rendered), "--pupil", "500,0,1"]),
        capfd.readouterr().err,
        2,
        "outside the light",
    )
    refused(cli.main(["reconstruct", str(tmp_path)]), capfd.readouterr().err, 2, "no wave field")
    both = ["reconstruct", str(rendered), "--focus", "1m", "--distances", "0"]
    refused(cli.main(both), capfd.readouterr().err, 2, "either --focus or --distances")
    refused(cli.main(["reconstruct", str(tmp_path / "none")]), capfd.readouterr().err, 2, "does not exist")


def test_impossible_encodings_are_refused_before_the_render(xml, tmp_path, capfd):
    levels = tmp_path / "levels.txt"
    levels.write_text(" ".join(f"{2 * math.pi * k / 16:.6f}" for k in range(16)))
    words = [str(xml), *SMALL, "--encode", "auto", "--bits", "4", "--response", str(levels)]
    refused(cli.main(["plan", *words]), capfd.readouterr().err, 2, "Omit --bits")
    out = tmp_path / "out"
    refused(cli.main(["render", *words, "--out", str(out)]), capfd.readouterr().err, 2, "Omit --bits")
    words = ["plan", str(xml), *SMALL, "--encode", "auto", "--encode-start", "before"]
    refused(cli.main(words), capfd.readouterr().err, 2, "Expected an animation")
    for option in (["--bits", "4"], ["--response", str(levels)]):  # for phases, and there are none
        words = [str(xml), *SMALL, *option]
        refused(cli.main(["plan", *words]), capfd.readouterr().err, 2, "Add --encode auto")
    assert not out.exists()


def opened(blend, *words):
    args = cli.parse(["render", str(blend), "--out", "out", *words])
    return sources.open_requested(args)


def test_scenes_view_layers_and_scripts_of_a_file(empty_scene, tmp_path):
    import bpy

    text = bpy.data.texts.new("far.py")
    text.write("import bpy\nbpy.app.driver_namespace['far'] = lambda: 7.0")
    text.use_module = True
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.driver_add("location", 0).driver.expression = "far()"
    other = bpy.data.scenes.new("Other")
    for scene in (empty_scene, other):
        scene.collection.objects.link(camera)
        scene.camera = camera
    kept = bpy.data.collections.new("Kept")
    other.collection.children.link(kept)
    bpy.ops.mesh.primitive_plane_add(location=(0, 0, -2))
    kept.objects.link(bpy.context.object)
    other.view_layers.new("Bare").layer_collection.children["Kept"].exclude = True
    blend = tmp_path / "two.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))

    loaded = opened(blend).load(16, 16)
    assert loaded.camera.position[0] == 0 and "--run-scripts" in loaded.notes[-1]["effect"]
    loaded = opened(blend, "--run-scripts").load(16, 16)
    assert loaded.camera.position[0] == 7 and not any("--run-scripts" in n["effect"] for n in loaded.notes)
    assert opened(blend, "--scene-name", "Other").load(16, 16).scene.shapes()
    with pytest.raises(engine.InvalidInput, match="nothing visible"):
        opened(blend, "--scene-name", "Other", "--view-layer", "Bare").load(16, 16)
    with pytest.raises(engine.InvalidInput, match="no view layer 'Front'. Choose one of 'ViewLayer', 'Bare'"):
        opened(blend, "--scene-name", "Other", "--view-layer", "Front")
    with pytest.raises(engine.InvalidInput, match="no scene 'None'"):
        opened(blend, "--scene-name", "None")


def test_encode(rendered, xml, tmp_path, capfd):
    """Encode a stored field without its scene, and a render with double phase."""
    phases = str(tmp_path / "phases")
    words = ["--out", phases, "--max-steps", "20", "--quiet", "--scene", "none"]
    assert cli.main(["encode", str(rendered), *words]) == 0
    phase = engine.PhaseHologram.load(phases)
    field = engine.WaveField.load(rendered / "wavefield")
    assert phase.method == "joint" and len(field.data) > 1
    np.testing.assert_array_equal(phase.data, engine.encode(field, "auto", max_steps=20).data)
    refused(cli.main(["encode", str(tmp_path / "none")]), capfd.readouterr().err, 2, "does not exist")
    refused(cli.main(["encode", str(tmp_path)]), capfd.readouterr().err, 2, "no wave field")

    words = ["render", str(xml), *SMALL, "--encode", "dpac", "--out", str(tmp_path / "out"), "--quiet"]
    assert cli.main(words) == 0
    names = os.listdir(tmp_path / "out" / "hologram")
    assert {"phase.npy", "meta.json", "frame_000_640nm.png"} <= set(names)
    stored = engine.PhaseHologram.load(tmp_path / "out" / "hologram").data
    again = engine.encode(engine.WaveField.load(tmp_path / "out" / "wavefield"), "dpac")
    np.testing.assert_array_equal(stored, again.data)


def test_contact_sheet(xml, tmp_path):
    """The sheet has the phases and images of the files, and a render with phases has images of them."""
    out = tmp_path / "out"
    words = ["render", str(xml), *SMALL, *GREEN, "--focus", "0.5m,1m,2m", "--out", str(out)]
    words += ["--encode", "dpac", "--contact-sheet", "a.png", "--compare-reference", "--quiet"]
    words += ["--phase-field", "designed"]
    assert cli.main(words) == 0
    sheet, side, gap, label = read(out / "a.png"), 64, output.SHEET_GAP, output.GLYPH_SIZE[1]
    assert sheet.shape == (2 * (side + label) + gap, 4 * side + 2 * gap, 3)
    phases = read(out / "hologram" / "frame_000_516nm.png")
    top = gap // 2 + label
    np.testing.assert_array_equal(sheet[top : top + 2 * side : 2, : 2 * side : 2, 0], np.squeeze(phases))
    left, below = 2 * side + gap, side + label + gap
    for number, focus in enumerate(("0.5", "2", "1")):
        y, x = number // 2 * below, left + number % 2 * (side + gap)
        shown = read(out / "reconstruction" / f"hologram_focus_{focus}m.exr")
        assert np.abs(shown - read(out / "reconstruction" / f"focus_{focus}m.exr")).max() > 0
        tile = sheet[y : y + side, x : x + side].astype(float)
        png = read(out / "reconstruction" / f"hologram_focus_{focus}m.png")
        assert np.corrcoef(tile.ravel(), png.ravel())[0, 1] > 0.95  # exposed otherwise
    lens = sheet[below : below + side, left + side + gap :].astype(float)
    truth = read(out / "reference" / "focus_1m.png")
    assert np.corrcoef(lens.ravel(), truth.ravel())[0, 1] > 0.95
    report = json.loads((out / "report.json").read_text())
    assert all(5 < row["phases_psnr_db"] < row["psnr_db"] + 1 for row in report["comparison"])
    assert cli.main(words) == 0  # its own folder, which is replaced
    assert left_over(tmp_path) == ["out"]


@pytest.mark.parametrize(
    ("count", "phases", "rows"),
    [(1, True, 1), (2, True, 2), (4, False, 3), (5, True, 3)],
)
def test_contact_sheets_of_any_number(count, phases, rows, backend, tmp_path, monkeypatch):
    """Pictures in pairs, the middle one beside the lens's; large ones are made smaller, phases are cut."""
    monkeypatch.setattr(output, "SHEET_SIDE", 64)
    shape, gap = (output.SHEET_SIDE * 2, output.SHEET_SIDE * 2 - 6), output.SHEET_GAP
    pictures = [np.full((*shape, 3), n + 1.0) for n in range(count)]
    focus = [0.25 * (n + 1) for n in range(count)]
    data = output.contact_sheet(pictures, np.ones((*shape, 3)), focus, np.zeros(shape) if phases else None)
    (tmp_path / "a.png").write_bytes(data)
    sheet = read(tmp_path / "a.png")
    height, width, label = shape[0] // 2, shape[1] // 2, output.GLYPH_SIZE[1]
    across = 2 * width + gap
    total = rows * (height + label + gap) - gap
    assert sheet.shape[:2] == (total, 2 * across + gap if phases else across)
    assert (sheet[-label - 1, -1] == 255).all()  # the lens's
    # the middle image's label, and the lens's, which says so besides
    middle, lens = (
        strip[:, :, 0] == 255 for strip in (sheet[-label:, -across : -width - gap], sheet[-label:, -width:])
    )
    middle, lens = middle[:, :width], lens[:, :width]
    assert middle.any() and (lens >= middle).all() and lens.sum() > 1.5 * middle.sum()


@pytest.mark.slow
def test_encoding_afterwards_is_encoding_with_the_render(xml, tmp_path, capfd):
    out, later = tmp_path / "out", tmp_path / "later"
    assert cli.main(["render", str(xml), *SMALL, "--encode", "auto", "--out", str(out), "--quiet"]) == 0
    with_it = engine.PhaseHologram.load(out / "hologram")
    assert cli.main(["encode", str(out), "--out", str(later), "--quiet"]) == 0
    assert capfd.readouterr().err == ""
    afterwards = engine.PhaseHologram.load(later)
    assert afterwards.method == with_it.method == "refine"
    np.testing.assert_array_equal(afterwards.data, with_it.data)


def test_encoding_afterwards_of_a_scene_that_is_another(xml, tmp_path, capfd):
    """The scene that the report names is opened, where it is what it was; else phases go towards the field alone."""
    out, later = tmp_path / "out", tmp_path / "later"
    assert cli.main(["render", str(xml), *SMALL, *GREEN, "--out", str(out), "--quiet"]) == 0
    assert cli.main(["encode", str(out), "--out", str(later), "--max-steps", "2", "--quiet"]) == 0
    assert capfd.readouterr().err == ""
    assert engine.PhaseHologram.load(later).method == "refine"
    xml.write_text(xml.read_text().replace('value="0.1"', 'value="0.12"'))
    again = ["encode", str(out), "--out", str(later), "--max-steps", "2"]
    assert cli.main(again) == 0
    assert "has changed since the render" in capfd.readouterr().err
    assert engine.PhaseHologram.load(later).method == "joint"
    refused(cli.main([*again, "--method", "refine"]), capfd.readouterr().err, 2, "has changed")
    xml.unlink()
    assert cli.main([*again, "--encode-seconds", "0.5"]) == 0
    assert "does not exist" in capfd.readouterr().err
    refused(cli.main([*again, "--scene", str(xml)]), capfd.readouterr().err, 2, "does not exist")


def test_the_camera_and_the_frame_of_a_render_are_found_again(empty_scene, tmp_path, capfd):
    """So that its scene is the same one: far from the origin that depends on the camera."""
    import bpy

    for name, place in (("Camera", (0.0, 0.0, 0.0)), ("Far", (500.0, 0.0, 0.0))):
        camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
        camera.location = place
        empty_scene.collection.objects.link(camera)
    empty_scene.camera = bpy.data.objects["Camera"]
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    for frame, depth in ((1, -3.0), (6, -1.0)):
        bpy.context.object.location = 500, 0, depth
        bpy.context.object.keyframe_insert("location", frame=frame)
    light = bpy.data.objects.new("Light", bpy.data.lights.new("Light", "POINT"))
    light.location = 500, 0, 0
    empty_scene.collection.objects.link(light)
    blend, out = tmp_path / "far.blend", tmp_path / "out"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    words = ["--camera", "Far", "--at-frame", "3", "--wavelengths", "516.5", "--method", "full"]
    assert cli.main(["render", str(blend), *SMALL, *words, "--out", str(out), "--quiet"]) == 0
    words = ["--method", "refine", "--encode-seconds", "2", "--quiet"]
    assert cli.main(["encode", str(out), *words]) == 0, capfd.readouterr().err
    report = json.loads((out / "report.json").read_text())
    assert report["scene_state"] == {"frame": 3, "camera": "Far", "scene": None, "view_layer": None}
    report["scene_state"]["frame"] = 4
    (out / "report.json").write_text(json.dumps(report))
    refused(cli.main(["encode", str(out), *words]), capfd.readouterr().err, 2, "has changed")


def test_encode_in_other_ways(rendered, tmp_path, capfd):
    first, second = str(tmp_path / "first"), str(tmp_path / "second")
    words = ["encode", str(rendered), "--method", "sgd", "--quiet", "--max-steps", "6"]
    assert cli.main([*words, "--bits", "2", "--no-stop", "--out", first]) == 0
    levels = engine.PhaseHologram.load(first).data / (math.pi / 2)
    np.testing.assert_allclose(levels, np.round(levels), atol=1e-5)
    refused(cli.main([*words, "--method", "joint", "--no-stop"]), capfd.readouterr().err, 2, "only sgd")
    assert cli.main([*words, "--method", "joint", "--no-aperture"]) == 2
    assert "--no-aperture is called --no-stop now" in capfd.readouterr().err
    words += ["--supervision", "amplitude", "--compared-planes", "2", "--tolerance", "0.01", "--start", first]
    assert cli.main([*words, "--out", second]) == 0
    assert engine.PhaseHologram.load(second).report["stages"][0]["steps"] <= 6
    for more, says in (
        (["--start", str(tmp_path)], "no hologram"),
        (["--method", "refine", "--scene", "none"], "needs extra frames of the scene"),
        (["--bits", "40"], "1 to 16 bits"),
    ):
        refused(cli.main([*words, *more]), capfd.readouterr().err, 2, says)


def test_stopping_an_encoding(rendered, tmp_path, capfd, monkeypatch):
    """Ctrl-C keeps the phases of the last step."""
    count = []

    def progress(self, done, message):
        count.append(message)
        if len(count) == 8:
            raise KeyboardInterrupt

    monkeypatch.setattr(cli.Progress, "__call__", progress)
    out = tmp_path / "phases"
    refused(
        cli.main(["encode", str(rendered), "--out", str(out)]),
        capfd.readouterr().err,
        1,
        "phases of the last step are in",
    )
    assert engine.PhaseHologram.load(out).report["stopped"]


def test_stopping_the_encoding_of_a_render(xml, tmp_path, capfd, monkeypatch):
    """The render is kept, and the report says that the encoding was stopped."""

    def progress(self, done, message):
        if "dB" in message:
            raise KeyboardInterrupt

    monkeypatch.setattr(cli.Progress, "__call__", progress)
    out = tmp_path / "out"
    words = [
        "render",
        str(xml),
        *SMALL,
        *GREEN,
        "--encode",
        "joint",
        "--compare-reference",
        "--out",
        str(out),
    ]
    refused(cli.main(words), capfd.readouterr().err, 1, "Canceled while encoding: .* has the render")
    assert engine.PhaseHologram.load(out / "hologram").report["stopped"]
    report = json.loads((out / "report.json").read_text())
    assert report["encoding"]["stages"] and "comparison" not in report
    assert any("encoding was stopped" in text for text in report["warnings"])


@pytest.mark.parametrize(
    ("method", "frames", "steps"), [("auto", 96, 200), pytest.param("full", 192, 400, marks=pytest.mark.slow)]
)
def test_extra_frames_of_a_known_scene(xml, tmp_path, monkeypatch, method, frames, steps):
    """`auto` uses extra frames, the method full more of them; the first are traced with the field's own."""
    out, trace, starts = tmp_path / "out", engine.extra_frames, []

    def extra_frames(*words):
        starts.append(words[-2])
        return trace(*words)

    monkeypatch.setattr(engine, "extra_frames", extra_frames)
    words = ["render", str(xml), *SMALL, *GREEN, "--method", method, "--encode", "auto"]
    assert cli.main([*words, "--phase-field", "designed", "--out", str(out), "--quiet"]) == 0
    phase = engine.PhaseHologram.load(out / "hologram")
    assert phase.method == "refine"
    stages = {stage["stage"]: stage for stage in phase.report["stages"]}
    assert stages["extra frames"]["frames"] == frames and stages["refine"]["steps"] == steps
    assert starts == [24]


def test_seconds_of_encoding(xml, tmp_path, capfd):
    """The time limit holds for the whole encoding, and `plan` prints the choice by it."""
    out = tmp_path / "out"
    words = [str(xml), *SMALL, *GREEN]
    render = ["render", *words, "--quiet", "--out", str(out)]
    for encode, seconds, says in (
        ("none", "1", "Add --encode auto"),
        ("auto", "0", "0.1 or more"),
        ("dpac", "1", "dpac"),
    ):
        refused(
            cli.main([*render, "--encode", encode, "--encode-seconds", seconds]),
            capfd.readouterr().err,
            2,
            says,
        )
    assert not out.exists()
    assert cli.main(["plan", *words, "--encode", "auto", "--encode-seconds", "1000"]) == 0
    plan = capfd.readouterr().out
    assert re.search(
        r"encoding: refine towards up to 192 extra frames, about 1000 s, [\d.]+ .B \(the best", plan
    ), plan
    assert cli.main(["plan", *words, "--encode", "auto", "--json"]) == 0
    encoding = json.loads(capfd.readouterr().out)["encoding"]
    assert encoding["method"] == "refine" and encoding["seconds"] > 0 and encoding["reason"]
    assert cli.main(["plan", *words, "--json"]) == 0
    assert json.loads(capfd.readouterr().out)["encoding"] is None
    started = time.perf_counter()
    assert cli.main([*render, "--encode", "auto", "--encode-seconds", "2"]) == 0
    assert time.perf_counter() - started < SOON
    report = json.loads((out / "report.json").read_text())
    assert report["encoding"]["plan"]["seconds"] == 2 and report["encode_seconds"] == 2
    assert 0 < report["seconds"]["encoding"] < SOON


def by_torchoptics(pictures, gain, pitch, wavelength, z):
    """Mean intensity of images of phases at a distance from the SLM, behind a round stop in its Fourier plane.

    Computed in double precision on a grid that is wide enough to avoid wraparound.
    """
    torch, torchoptics = pytest.importorskip("torch"), pytest.importorskip("torchoptics")
    (rows, columns), pad = pictures[0].shape, 256
    fy, fx = (torch.fft.fftfreq(n + 2 * pad, pitch, dtype=torch.float64) for n in (rows, columns))
    stop = torch.hypot(fx[None, :], fy[:, None]) <= 0.5 / pitch
    total = 0.0
    for picture in pictures:
        phases = torch.tensor(picture.astype(float)) * (2 * math.pi / 256)
        sent = torch.nn.functional.pad(gain * torch.exp(1j * phases), (pad, pad, pad, pad))
        field = torchoptics.Field(torch.fft.ifft2(torch.fft.fft2(sent) * stop), wavelength, spacing=pitch)
        there = field.propagate_to_z(z, propagation_method="ASM", asm_pad=(0, 0)).data
        total = total + there[pad : pad + rows, pad : pad + columns].abs() ** 2
    return (total / len(pictures)).numpy()


@pytest.mark.oracle
def test_images_of_phases_agree_with_torchoptics(xml, tmp_path):
    """Images by the device's files are those of HoloPath and of the thin lens, near, far and between."""
    out, focus, side = tmp_path / "out", [0.4, 0.6, 2.0], 256
    words = ["render", str(xml), "--resolution", f"{side}x{side}", "--frames", "4", "--wavelengths", "516.5"]
    assert cli.main([*words, "--encode", "refine", "--out", str(out), "--quiet"]) == 0
    import mitsuba as mi

    stored = engine.PhaseHologram.load(out / "hologram")
    assert stored.method == "refine"
    files = sorted((out / "hologram").glob("frame_*nm.png"))
    pictures = [np.squeeze(np.array(mi.Bitmap(str(file)))) for file in files]
    assert len(pictures) == 4
    loaded = sources.open_source(str(xml)).load(side, side, None)
    hologram, field = stored.hologram, engine.WaveField.load(out / "wavefield")
    truth = engine.reference(loaded.scene, loaded.camera, hologram, focus, spp=256, near=field.near)
    ours = engine.reconstruct(stored.field(engine.Modulator(8)), focus)
    for depth, own, target in zip(focus, ours, truth, strict=True):
        z = float(field.mapping.depth_to_z(depth))
        theirs = by_torchoptics(pictures, stored.gains[0], hologram.pitch, hologram.wavelengths[0], z)[
            ..., None
        ]
        assert engine.psnr(theirs, own, 12) > 50  # 53 to 55: our grid has less room for strays
        assert engine.psnr(theirs, target, 12) > 30  # 33 to 39
        assert theirs.mean() == pytest.approx(own.mean(), rel=0.005)


def test_pictures_of_stored_phases(rendered, tmp_path, capfd):
    """Images of phases on a display differ from the field's, and are written beside them."""
    words = ["encode", str(rendered), "--method", "dpac", "--out", str(tmp_path / "hologram"), "--quiet"]
    assert cli.main(words) == 0
    (tmp_path / "response.txt").write_text(" ".join(str(0.09 * n**1.1) for n in range(16)))
    words = ["reconstruct", str(tmp_path), "--hologram", "--focus", "1m", "--quiet"]
    assert cli.main(words) == 0
    path = tmp_path / "reconstruction" / "hologram_focus_1m.exr"
    ideal = path.read_bytes()
    limits = ["--fill-factor", "0.8", "--unmodulated", "0.05", "--crosstalk", "0.3"]
    assert cli.main([*words, *limits, "--bits", "4"]) == 0
    assert path.read_bytes() != ideal
    for more, says in (
        (["--response", str(tmp_path / "none.txt")], "cannot be read"),
        (["--bits", "4", "--response", str(tmp_path / "response.txt")], "Omit --bits"),
        (["--fill-factor", "2"], "fill factor"),
    ):
        refused(cli.main([*words, *more]), capfd.readouterr().err, 2, says)
    refused(
        cli.main(["reconstruct", str(rendered), "--bits", "4"]), capfd.readouterr().err, 2, "Add --hologram"
    )
    refused(cli.main(["reconstruct", str(rendered), "--hologram"]), capfd.readouterr().err, 2, "no hologram")


def test_distances_name_their_files_and_a_note_says_far_field(rendered, capfd):
    """Distances are millimeters from the SLM. 1 km away is one transform, with pixels of lambda z / D."""
    field = engine.WaveField.load(rendered / "wavefield")
    near = 1e3 * field.hologram.depth_near
    assert cli.main(["reconstruct", str(rendered), "--distances", f"{near:g}", "--quiet"]) == 0
    assert (rendered / "reconstruction" / f"distance_{near:g}mm.exr").exists()
    capfd.readouterr()
    assert cli.main(["reconstruct", str(rendered), "--distances", f"{near:g},1000000"]) == 0
    pixel = min(field.hologram.wavelengths) * 1000 / (64 * field.hologram.pitch)
    assert f"with pixels of the image {pixel * 1e3:.4g} mm wide" in capfd.readouterr().err
    assert read(rendered / "reconstruction" / "distance_1e+06mm.exr").any()


def test_an_image_behind_a_lens(xml, tmp_path, capfd):
    """A scene becomes phases and images, and its field goes to another program's file and back."""
    out, back, lens = tmp_path / "out", tmp_path / "back", "100@80"
    words = ["render", str(xml), "--resolution", "48x32", *GREEN, "--frames", "2", "--lens", lens]
    words += ["--encode", "joint", "--encode-seconds", "1", "--compare-reference"]
    assert cli.main([*words, "--focus", "0.5m,2m", "--out", str(out), "--quiet"]) == 0
    field, report = engine.WaveField.load(out / "wavefield"), output.read_report(out)
    assert field.hologram.optics.lens == engine.Lens(0.1, 0.08)
    assert field.data.shape[-2:] == (32, 48) and report["hologram"]["optics"]["lens"]["focal"] == 0.1
    assert any(each["name"] == "propagation" for each in report["plan"]["decisions"])
    assert read(out / "reconstruction" / "focus_0.5m.exr").shape[:2] == (
        32,
        32,
    )  # the square in its middle
    assert read(out / "reference" / "focus_0.5m.exr").shape[:2] == (32, 32)
    assert min(row["psnr_db"] for row in report["comparison"]) > 15
    assert cli.main(["reconstruct", str(out), "--hologram", "--distances", "0", "--quiet"]) == 0
    assert cli.main(["export", str(out), str(tmp_path / "field.h5"), "--quiet"]) == 0
    assert cli.main(["import", str(tmp_path / "field.h5"), "--out", str(back), "--quiet"]) == 0
    assert engine.WaveField.load(back / "wavefield").hologram == field.hologram
    # Phases of another program, for a lens by the options.
    np.save(tmp_path / "phase.npy", np.zeros((32, 32), np.float32))
    take = ["import", str(tmp_path / "phase.npy"), "--units", "radians", "--pitch", "8", *GREEN, "--quiet"]
    assert cli.main([*take, "--lens", "50", "--out", str(tmp_path / "flat")]) == 0
    assert cli.main(["reconstruct", str(tmp_path / "flat"), "--hologram", "--distances", "0", "--quiet"]) == 0
    (picture,) = (tmp_path / "flat" / "reconstruction").glob("*.exr")
    light = read(picture)[..., 1]
    assert light[15:17, 15:17].sum() > 0.5 * light.sum()  # the zero order, in the middle
    capfd.readouterr()
    for more, says in (
        (["encode", str(out), "--lens", "90"], "rendered for another lens"),
        (["plan", str(xml), "--lens", "0"], "finite and not 0, got 0 mm"),
        (["plan", str(xml), "--lens", "100@200@200"], "the SLM's own image"),
        (["plan", str(xml), "--lens", "near"], "Expected a lens"),
        (
            ["plan", str(xml), "--lens", "100", "--carrier", "auto"],
            "Omit the carrier and the stop, or the lens",
        ),
        (["plan", str(xml), "--lens", "100", "--color-scale", "1,1,1.02"], "or the lens"),
        (["reconstruct", str(out), "--distances=-1000"], "mm from the picture's plane is beyond infinity"),
    ):
        refused(cli.main(more), capfd.readouterr().err, 2, says)
    assert cli.main(["plan", str(xml), "--lens", "50@52", "--depth-mapping", "eyepiece", *GREEN]) == 0
    plan = capfd.readouterr().out  # f^2 / D before infinity, which is 2 mm before the SLM
    assert "2.29 m at 7.78 to 3.09 mm from the SLM" in plan and "0.44 degrees wide of the camera's 40" in plan


def test_pixels_that_are_not_square(xml, tmp_path):
    """A scene becomes phases and images, and its field goes to another program's file and back."""
    out, back = tmp_path / "out", tmp_path / "back"
    words = [
        "render",
        str(xml),
        "--resolution",
        "60x40",
        "--pitch",
        "6.4,8",
        "--frames",
        "2",
        "--out",
        str(out),
    ]
    words += [*GREEN, "--quality", "preview", "--encode", "dpac", "--compare-reference", "--quiet"]
    assert cli.main([*words, "--rgbd", "--quilt", "2x1", "--contact-sheet", "sheet.png"]) == 0
    field = engine.WaveField.load(out / "wavefield")
    assert field.hologram.pitch == (6.4e-6, 8e-6) and field.data.shape == (2, 1, 40, 60)
    assert json.loads((out / "wavefield/meta.json").read_text())["pitch_m"] == [6.4e-6, 8e-6]
    assert engine.PhaseHologram.load(out / "hologram").data.shape == (2, 1, 40, 60)
    assert engine.reconstruct(field, [1.0]).shape == (1, 40, 48, 1)
    assert np.load(out / "rgbd/depth.npy").shape == (40, 48)
    assert (out / "quilt/quilt_qs2x1a1.2.png").exists()
    assert cli.main(["report", str(out), "--quiet"]) == 0
    assert "60 &#215; 40 pixels of 6.4 &#215; 8 &#181;m" in (out / "report.html").read_text()
    assert cli.main(["export", str(out), str(tmp_path / "u.h5"), "--quiet"]) == 0
    assert cli.main(["import", str(tmp_path / "u.h5"), "--out", str(back), "--quiet"]) == 0
    assert engine.WaveField.load(back / "wavefield").hologram == field.hologram


def test_a_response_means_the_same_when_encoding_and_when_refocusing(rendered, tmp_path, capfd):
    """Phases of a device's levels are unchanged by its response, a list of phases or a calibration."""
    (tmp_path / "list.txt").write_text(" ".join(str(0.29 * n**1.1) for n in range(16)))
    calibration = {
        "format": "HoloPath SLM calibration",
        "bits": 4,
        "responses": [{"wavelength_nm": 516.5, "range": 0.8}],
    }
    (tmp_path / "device.json").write_text(json.dumps(calibration))
    for name in ("list.txt", "device.json"):
        response, out = ["--response", str(tmp_path / name)], tmp_path / name[:4]
        words = ["encode", str(rendered), "--method", "dpac", *response, "--out", str(out), "--quiet"]
        assert cli.main(words) == 0, capfd.readouterr().err
        path, shown = out / "reconstruction" / "hologram_focus_1m.exr", []
        for limits in ([], response, ["--bits", "4"]):
            assert cli.main(["reconstruct", str(out), "--hologram", "--focus", "1m", "--quiet", *limits]) == 0
            shown.append(path.read_bytes())
        assert shown[0] == shown[1] != shown[2]


def test_replaces_only_its_own(xml, tmp_path, capfd, monkeypatch):
    out = tmp_path / "out"
    words = ["render", str(xml), *SMALL, *GREEN, "--out", str(out), "--quiet"]
    assert cli.main(words) == 0
    first = (out / "report.json").read_bytes()
    assert len(os.listdir(out / "reconstruction")) == 6  # three default depths

    def fail(*_, **__):
        raise MemoryError

    with monkeypatch.context() as patch:
        patch.setattr(engine, "reconstruct", fail)
        refused(cli.main(words), capfd.readouterr().err, 1, "memory")
    assert (out / "report.json").read_bytes() == first
    assert cli.main([*words, "--seed", "1"]) == 0
    assert (out / "report.json").read_bytes() != first
    (out / "thesis.txt").write_text("mine")
    refused(cli.main(words), capfd.readouterr().err, 2, "not HoloPath's")
    assert (out / "thesis.txt").exists()
    assert left_over(tmp_path) == ["out"]


def test_plan_as_json_and_a_blend_brings_its_settings(tmp_path, capfd):
    """The plan of a demo, and of a file with the demo's scene and its own settings."""
    bpy = pytest.importorskip("bpy")
    path = str(tmp_path / "scene.blend")
    assert cli.main(["plan", "demo:planes", *SMALL, "--json"]) == 0  # settings are registered now
    plan = json.loads(capfd.readouterr().out)
    assert plan["near"] == pytest.approx(0.5, rel=0.01) and plan["decisions"]
    assert plan["hologram"]["width"] == 64
    settings = bpy.context.scene.holopath
    settings.frames, settings.resolution_x, settings.resolution_y = 3, 48, 40
    settings.depth_far_mm, settings.depth_near_mm = 1.0, 1.5
    bpy.ops.wm.save_as_mainfile(filepath=path, check_existing=False)
    capfd.readouterr()
    assert cli.main(["plan", path, "--json"]) == 0
    plan = json.loads(capfd.readouterr().out)
    assert (plan["hologram"]["width"], plan["hologram"]["height"]) == (48, 40)
    assert plan["hologram"]["depth_near"] == 1.5e-3 and plan["settings"]["frames"] == 3
    assert cli.main(["plan", path, "--json", "--frames", "5", "--resolution", "64x64"]) == 0
    plan = json.loads(capfd.readouterr().out)
    assert plan["settings"]["frames"] == 5 and plan["hologram"]["depth_near"] == pytest.approx(0.125e-3)


def test_plan_as_text(xml, capfd):
    assert cli.main(["plan", str(xml), *SMALL]) == 0
    printed = capfd.readouterr()
    assert "recording plane" in printed.out and printed.err == ""


def test_progress(capfd):
    progress = cli.Progress()
    progress._last_time = -math.inf
    progress(0.5, "Half")
    progress(0.51, "Half")
    progress(1.0, "Done")
    assert capfd.readouterr().err.splitlines() == [" 50% Half", "100% Done"]
    cli.Progress(quiet=True)(1.0, "Done")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("shift", [(0, 0), (0.2, 0), (0, -0.1)])
def test_mitsuba_camera(shift, tmp_path, backend):
    """The engine's image through the scene's sensor is that of Mitsuba."""
    import mitsuba as mi

    path = tmp_path / "scene.xml"
    line = '<float name="principal_point_offset_{}" value="{}"/>'
    offset = line.format("x", shift[0]) + line.format("y", shift[1])
    path.write_text(SCENE.format(sensor="perspective", offset=offset))
    source = sources.open_source(str(path))
    loaded = source.load(48, 32)
    hologram = engine.Hologram(48, 32, 8e-6, depth_far=1e-3, depth_near=1.001e-3)  # a pupil of a few µm
    image = engine.to_rgb(
        engine.reference(loaded.scene, loaded.camera, hologram, [1.0], spp=64)[0], hologram.wavelengths
    )
    truth = np.array(mi.render(loaded.scene, integrator=mi.load_dict({"type": "path"}), spp=64))
    assert np.abs(image - truth).mean() < 0.01 < truth.std()


def test_sensor_of_another_kind(tmp_path, capfd):
    path = tmp_path / "scene.xml"
    path.write_text(
        SCENE.format(sensor="orthographic", offset="").replace('<float name="fov" value="40"/>', "")
    )
    refused(cli.main(["plan", str(path), *SMALL]), capfd.readouterr().err, 2, "not a perspective one")


LIT = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="40"/>
 <transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform></sensor>
<shape type="rectangle" id="wall"><transform name="to_world"><rotate y="1" angle="180"/><translate z="1"/></transform>
 <bsdf type="diffuse"/></shape>
<shape type="sphere" id="ball"><point name="center" x="0" y="0" z="0.6"/><float name="radius" value="0.05"/>
 <bsdf type="diffuse"/></shape>
<emitter type="point"><point name="position" x="0.2" y="0.3" z="0"/></emitter>
</scene>"""


def test_baked_light_is_kept(tmp_path, capfd):
    """A second run reads it from the given folder; without a folder nothing is kept."""
    (tmp_path / "lit.xml").write_text(LIT)
    folder = tmp_path / "baked"
    words = [str(tmp_path / "lit.xml"), *SMALL, *GREEN, "--resolution", "32x32", "--method", "fast"]

    def bake_of(*more):
        out = tmp_path / "out"
        assert cli.main(["render", *words, "--focus", "0.6m", "--out", str(out), *more]) == 0
        return json.loads((out / "report.json").read_text())

    assert bake_of("--no-cache")["bake"]["reused"] == "nothing" and not folder.exists()
    capfd.readouterr()
    report = bake_of("--cache", str(folder))
    assert report["bake"]["reused"] == "nothing" and report["bake"]["traced"] == ["ball"]
    assert "note: 1 shape's diffuse light is traced, not baked: ball." in capfd.readouterr().err
    assert bake_of("--cache", str(folder))["bake"]["reused"] == "all"
    capfd.readouterr()
    assert cli.main(["plan", *words, "--cache", str(folder)]) == 0
    assert "light baked before" in capfd.readouterr().out
    assert cli.main(["cache", "--cache", str(folder)]) == 0
    assert re.search(rf"{folder}: 1 file, \d+\.\d MB\n", capfd.readouterr().out)
    assert cli.main(["cache", "--cache", str(folder), "--clear"]) == 0
    assert "MB freed" in capfd.readouterr().out and not list(folder.glob("*holobake*"))
    assert cli.main(["cache", "--cache", str(folder)]) == 0
    assert capfd.readouterr().out == f"{folder}: 0 files, 0.0 MB\n"


def test_files_that_phases_depend_on(tmp_path):
    """A calibration that is saved again makes them anew, whichever option names it."""
    path = tmp_path / "mine.json"
    slm.Calibration(bits=4).save(path)
    args = cli.parse(["render", "demo:planes", "--colors-from", str(path), "--out", "out"])
    assert render_command.files_of(args) == {"colors response": path}
