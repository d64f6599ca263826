"""Processes that share a folder: of several, killed and in each other's way, an animation is as one makes it."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from holopath_addon import cli
from holopath_addon.farm import claims, processes
from holopath_addon.farm.claims import Claims
from holopath_addon.workflow import output
from tests.patience import NEVER

bpy = pytest.importorskip("bpy")

ROOT = Path(__file__).parents[2]
# auto would decide by measured times
WORDS = [
    "--resolution",
    "32x32",
    "--frames",
    "1",
    "--wavelengths",
    "516.5",
    "--quality",
    "preview",
    "--method",
    "full",
]
FRAMES = [f"frame_{number:04d}" for number in range(1, 5)]


def animated(folder):
    """A .blend of four frames in which a textured plane comes near."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    bpy.ops.mesh.primitive_plane_add(size=1.0)
    plane = bpy.context.object
    for frame, depth in ((1, -3.0), (4, -1.0)):
        plane.location.z = depth
        plane.keyframe_insert("location", frame=frame)
    material = bpy.data.materials.new("Shining")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    plane.data.materials.append(material)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    principled.inputs["Emission Strength"].default_value = 1
    image = bpy.data.images.new("Texture", 4, 4)
    image.pixels[:] = [0.1 * (n % 10) for n in range(64)]
    image.filepath_raw, image.file_format = str(folder / "texture.png"), "PNG"
    image.save()
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = image
    links.new(texture.outputs["Color"], principled.inputs["Emission Color"])
    scene.frame_start, scene.frame_end = 1, 4
    path = folder / "near.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), relative_remap=True)
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile()
    return path


@pytest.fixture
def blend(tmp_path):
    return animated(tmp_path)


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    """The result of one process."""
    folder = tmp_path_factory.mktemp("alone")
    ended(start(animated(folder), folder / "out"))
    return fields(folder / "out")


def words(blend, out, *more):
    return ["render", str(blend), *WORDS, "--animation", "--out", str(out), *more]


def start(blend, out, *more, code=None):
    """The command line in a process of its own, or a program that is given its words."""
    run = ["-c", code] if code else ["-m", "holopath_addon"]
    return subprocess.Popen(
        [sys.executable, *run, *words(blend, out, *more)], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )


def ended(*others):
    """Output of processes, which must succeed."""
    messages = [other.communicate(timeout=NEVER)[1] for other in others]
    assert [other.returncode for other in others] == [0] * len(others), messages
    return messages


def refused(status, error, says):
    """An error is one line, and the status 2."""
    lines = [line for line in error.splitlines() if line.startswith("holopath: ")]
    assert status == 2 and len(lines) == 1 and "Traceback" not in error, error
    assert re.search(says, lines[0]), error


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def fields(out):
    """Bytes of all wave fields of a folder that holds nothing but whole frames."""
    assert names(out) == [*FRAMES, "job.json"]
    for name in FRAMES:
        assert names(out / name) == ["reconstruction", "report.json", "wavefield"]
    return [(out / name / "wavefield" / "field.npy").read_bytes() for name in FRAMES]


def wait_for(found, process=None):
    """Something that a process does in a while."""
    deadline = time.monotonic() + NEVER
    while not found():
        assert time.monotonic() < deadline and (process is None or process.poll() is None)
        time.sleep(0.002)


def made(messages):
    """Frames that processes say that they made."""
    return sum(int(re.search(r"Done: (\d+) frame", each)[1]) for each in messages)


@pytest.mark.slow  # two share what a third has left when it was killed, below
@pytest.mark.parametrize("count", [2, 4])
def test_processes_share_an_animation(count, alone, blend, tmp_path):
    messages = ended(*(start(blend, tmp_path / "out") for _ in range(count)))
    assert fields(tmp_path / "out") == alone
    assert made(messages) == len(FRAMES)  # none twice


def stop(process, found):
    """Stop a process where something is found, and surely still is."""

    def stopped():
        if not found():
            return False
        process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
        if not found():
            process.send_signal(signal.SIGCONT)
            os.waitid(os.P_PID, process.pid, os.WCONTINUED | os.WEXITED | os.WNOWAIT)
            return False
        return True

    wait_for(stopped, process)


@pytest.mark.parametrize("times", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_killed_in_the_middle_of_a_frame_others_go_on(times, alone, blend, tmp_path):
    """Two processes share what is left."""
    out = tmp_path / "out"
    for before in range(times):
        other = start(blend, out)

        def writing(before=before):
            done, claimed = list(out.glob("frame_*")), list(out.glob(".claims/frame_*"))
            return len(done) > before and claimed and list(out.glob(".frame_*.part-*/wavefield"))

        stop(other, writing)
        other.kill()
        other.communicate()
        assert json.loads((out / "job.json").read_text())["unfinished"] == FRAMES
    left = len(FRAMES) - len(list(out.glob("frame_*")))
    messages = ended(start(blend, out), start(blend, out))
    assert fields(out) == alone and made(messages) == left  # none twice
    assert json.loads((out / "job.json").read_text())["unfinished"] == []


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_interrupted_it_gives_its_frame_back(number, blend, tmp_path):
    out = tmp_path / "out"
    other = start(blend, out, "--frame-range", "1-300")
    wait_for(lambda: (out / FRAMES[0]).exists() and list(out.glob(".claims/frame_*")), other)
    other.send_signal(number)
    _, error = other.communicate(timeout=NEVER)
    assert other.returncode == 1 and "Canceled: finished frames are in" in error, error
    assert all(re.fullmatch(r"frame_\d+|job.json", name) for name in names(out)) and FRAMES[0] in names(out)


@pytest.mark.slow
def test_other_settings_wait_for_another_folder(alone, blend, tmp_path, capfd):
    """Other settings are refused as long as another process works, also between its frames."""
    out = tmp_path / "out"
    other = start(blend, out)
    stop(other, lambda: list(out.glob(".claims/frame_*")))
    refused(
        cli.main(words(blend, out, "--seed", "1")),
        capfd.readouterr().err,
        f"is being rendered by {processes.host()} with other settings.*. Wait, or choose another folder",
    )
    other.send_signal(signal.SIGCONT)
    ended(other)
    assert fields(out) == alone


def test_of_two_jobs_that_begin_at_once_one_is_done(blend, tmp_path):
    out = tmp_path / "out"
    others = [start(blend, out, "--seed", seed) for seed in "12"]
    errors = [other.communicate(timeout=NEVER)[1] for other in others]
    statuses = [other.returncode for other in others]
    assert sorted(statuses) == [0, 2], errors
    refused(2, errors[statuses.index(2)], "with other settings")
    assert len(fields(out)) == len(FRAMES)
    seeds = {json.loads((out / name / "report.json").read_text())["settings"]["seed"] for name in FRAMES}
    assert seeds == {1 + statuses.index(0)}


@pytest.fixture
def begun(blend, tmp_path, capfd):
    """A folder with one frame done and one that was begun."""
    out = tmp_path / "out"
    assert cli.main([*words(blend, out), "--frame-range", "1"]) == 0
    messages = json.loads((out / "job.json").read_text())
    (out / "job.json").write_text(json.dumps({**messages, "unfinished": FRAMES[1:2]}))
    capfd.readouterr()
    return out


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_was_begun_goes_on_with_the_same_versions(blend, begun, monkeypatch, capfd):
    before, versions = contents(begun), output.versions()
    monkeypatch.setattr(output, "versions", lambda: {**versions, "mitsuba": "3.0.0"})
    refused(
        cli.main(words(blend, begun)),
        capfd.readouterr().err,
        rf"started with mitsuba {versions['mitsuba']}, but {processes.host()} has 3.0.0. Use the same",
    )
    assert contents(begun) == before


def test_a_file_that_only_others_have_is_named(blend, begun, capfd):
    before, texture = contents(begun), blend.with_name("texture.png")
    whole = texture.read_bytes()
    texture.unlink()
    refused(
        cli.main(words(blend, begun)),
        capfd.readouterr().err,
        f"started with the file texture.png, which is missing on {processes.host()}. Copy it there",
    )
    texture.write_bytes(whole[:-1])
    refused(cli.main(words(blend, begun)), capfd.readouterr().err, "another file texture.png than")
    assert contents(begun) == before
    texture.write_bytes(whole)
    assert cli.main([*words(blend, begun), "--frame-range", "1-2"]) == 0
    assert "frame_0001: done before, skipped" in capfd.readouterr().err
    assert json.loads((begun / "job.json").read_text())["unfinished"] == []


def test_a_file_of_another_program_is_not_replaced(blend, begun, capfd):
    (begun / "job.json").write_text("{}")
    refused(cli.main(words(blend, begun)), capfd.readouterr().err, "job.json is not HoloPath's")
    assert (begun / "job.json").read_text() == "{}"


def test_frames_are_known_by_the_job_without_their_scene(blend, begun, monkeypatch, capfd):
    """Frames of a file that was saved again are checked once."""
    report = json.loads((begun / FRAMES[0] / "report.json").read_text())
    bpy.context.scene["note"] = "saved anew"
    bpy.ops.wm.save_mainfile()
    again = [*words(blend, begun), "--frame-range", "1"]
    assert cli.main(again) == 0
    assert "frame_0001: done before, skipped" in capfd.readouterr().err
    now = json.loads((begun / FRAMES[0] / "report.json").read_text())
    assert now["job"] != report["job"] and {**now, "job": report["job"]} == report
    monkeypatch.setattr("holopath_addon.cli.render_command.request_of", None)  # nor is it exported
    assert cli.main(again) == 0
    assert "frame_0001: done before, skipped" in capfd.readouterr().err
    assert names(begun) == [FRAMES[0], "job.json"]


def test_nothing_is_left_where_no_frame_can_be_made(blend, tmp_path, capfd):
    out = tmp_path / "out"
    refused(cli.main(words(blend, out, "--camera", "nobody")), capfd.readouterr().err, "Frame 1: .*nobody")
    assert not out.exists()


def test_a_frame_of_another_machine_is_taken_over_when_its_heart_stops(blend, begun, capfd):
    messages = json.loads((begun / "job.json").read_text())
    with Claims(begun, messages["digest"]) as elsewhere, elsewhere.claim(FRAMES[1]):
        file = begun / claims.FOLDER / FRAMES[1]
        claim = json.loads(file.read_text())
        file.write_text(json.dumps({**claim, "host": "elsewhere", "place": "elsewhere"}))
        os.utime(file, (time.time() - 2 * claims.STALE_AFTER,) * 2)
        assert cli.main([*words(blend, begun), "--frame-range", "1-2"]) == 0
    assert names(begun) == [*FRAMES[:2], "job.json"]


# The command line, on a disk that is full as soon as a field is to be written.
FULL = """
import resource, sys
from holopath_addon import cli, engine
save, most = engine.WaveField.save, 4096
def full(*arguments):
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    return save(*arguments)
engine.WaveField.save = full
sys.exit(cli.main(sys.argv[1:]))
"""


def is_full(other, out, status, says):
    """One sentence, and nothing but what was there."""
    _, error = other.communicate(timeout=NEVER)
    lines = [line for line in error.splitlines() if line.startswith("holopath: ")]
    assert other.returncode == status and len(lines) == 1 and "Traceback" not in error, error
    assert says in lines[0], error
    assert names(out) == [FRAMES[0], "job.json"]


def test_files_that_cannot_grow(blend, begun):
    before = contents(begun / FRAMES[0])
    is_full(start(blend, begun, code=FULL), begun, 1, "could not be written")
    assert contents(begun / FRAMES[0]) == before


@pytest.fixture
def disk(tmp_path):
    """A file system of a megabyte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("no file system can be mounted")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize(
    ("free", "status", "says"),
    [(64 << 10, 1, "could not be written"), (0, 2, "cannot be created (No space left")],
)
def test_a_full_disk(free, status, says, blend, disk, capfd):
    """While a frame is written, which takes more, or before a frame can be claimed."""
    out = disk / "out"
    assert cli.main([*words(blend, out, "--resolution", "96x96"), "--frame-range", "1"]) == 0
    before = contents(out)
    (disk / "other").write_bytes(bytes(shutil.disk_usage(disk).free - free))
    is_full(start(blend, out, "--resolution", "96x96"), out, status, says)
    now = contents(out)
    assert now.pop(out / "job.json") and before.pop(out / "job.json") and now == before
    (disk / "other").unlink()
    assert cli.main([*words(blend, out, "--resolution", "96x96"), "--frame-range", "1-2"]) == 0
    assert names(out) == [*FRAMES[:2], "job.json"]
