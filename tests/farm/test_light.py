"""One light for all frames of an animation: whoever makes them, in whatever order, and however fast."""

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from holopath_addon import cli, engine
from holopath_addon.engine.rendering import job_light
from holopath_addon.engine.rendering.job_light import JobLight, spread
from tests.farm import scenes
from tests.patience import NEVER

bpy = pytest.importorskip("bpy")

ROOT = Path(__file__).parents[2]
WORDS = "--resolution 32x32 --frames 1 --wavelengths 516.5 --quality preview --focus 1m".split()
FRAMES = [f"frame_{number:04d}" for number in range(1, 5)]


@pytest.fixture
def blend(tmp_path):
    """Four frames in which the camera goes along a wall, so that each sees what the one before it did not."""
    scenes.room(bpy, frames=4)
    camera = bpy.context.scene.camera
    for frame, x in ((1, -1.0), (4, 1.0)):
        camera.location.x = x
        camera.keyframe_insert("location", frame=frame)
    path = tmp_path / "room.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path), check_existing=False)
    return path


def words(blend, out, *more):
    """A command with a new cache beside the folder, unless another one is named."""
    cache = () if {"--cache", "--no-cache"} & set(more) else ("--cache", f"{out}.cache")
    return ["render", str(blend), *WORDS, "--out", str(out), *cache, *more]


def make(blend, out, *more):
    assert cli.main(words(blend, out, "--quiet", *(more or ["--animation"]))) == 0


def start(blend, out, *more):
    """Run the command in a separate process."""
    run = [sys.executable, "-m", "holopath_addon", *words(blend, out, "--animation", *more)]
    return subprocess.Popen(run, cwd=ROOT, stderr=subprocess.PIPE, text=True)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def fields(out):
    """Contents of a folder, which must be complete frames and their light only."""
    assert names(out) == [*FRAMES, "job.json", "light"]
    return [(out / name / "wavefield" / "field.npy").read_bytes() for name in FRAMES]


def method(out):
    return json.loads((out / "light" / "light.json").read_text())["method"]


def report(out, number):
    return json.loads((out / FRAMES[number - 1] / "report.json").read_text())


def contents(folder):
    return {path.name: (path.read_bytes(), path.stat().st_mode & 0o777) for path in folder.iterdir()}


@pytest.mark.slow
def test_frames_are_alike_in_whatever_order(blend, tmp_path, capfd):
    forth, back = tmp_path / "forth", tmp_path / "back"
    make(blend, forth, "--method", "fast", "--animation")
    make(blend, back, "--method", "fast", "--frame-range", "3-4")
    light = contents(back / "light")
    make(blend, back, "--method", "fast", "--frame-range", "1,2")
    assert fields(back) == fields(forth) and contents(back / "light") == light == contents(forth / "light")
    assert [mode for _, mode in light.values()] == [0o644] * 2  # other users read it, too
    reused = [report(back, number)["bake"]["reused"] for number in range(1, 5)]
    assert reused == [
        "all",
        "part",
        "part",
        "all",
    ]  # each frame between bakes what it lacks, for itself alone
    capfd.readouterr()
    assert cli.main(words(blend, back, "--method", "fast", "--animation")) == 0
    output = capfd.readouterr().err
    assert "Done: 0 frames" in output and "4 done before" in output and "light" not in output.lower()


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "fast"])
@pytest.mark.parametrize("count", [2, 4])
def test_frames_are_alike_by_however_many(count, method, blend, tmp_path):
    make(blend, tmp_path / "alone", "--method", method, "--animation")
    others = [start(blend, tmp_path / "shared", "--method", method) for _ in range(count)]
    output = [other.communicate(timeout=NEVER)[1] for other in others]
    assert [other.returncode for other in others] == [0] * count, output
    assert fields(tmp_path / "shared") == fields(tmp_path / "alone")
    assert contents(tmp_path / "shared" / "light").keys() == contents(tmp_path / "alone" / "light").keys()


@pytest.fixture
def slow_paths(monkeypatch):
    """Makes this a machine on which long paths take for ever, and all else longer."""
    from holopath_addon.engine.planning import survey
    from holopath_addon.engine.planning.machine import Slowness
    from holopath_addon.engine.planning.pilot import Pilot

    def slow():
        light = Pilot.light

        def slowed(*arguments):
            found = light(*arguments)
            return replace(found, paths_per_second=found.paths_per_second / 1e6, compiling=9.0)

        monkeypatch.setattr(Pilot, "light", slowed)
        monkeypatch.setattr(survey, "slowness", lambda folder: Slowness(30.0, 30.0, 30.0))

    return slow


@pytest.mark.slow
def test_a_slow_machine_decides_nothing_else(blend, tmp_path, slow_paths):
    here, both, there = (tmp_path / name for name in ("here", "both", "there"))
    make(blend, here)
    make(blend, both, "--frame-range", "1-2")
    slow_paths()
    make(blend, both)
    assert method(here) == "full" and fields(both) == fields(here)
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    bpy.context.scene["note"] = "saved anew"
    bpy.ops.wm.save_mainfile()
    before = (both / "light" / "light.json").read_text()
    make(blend, both)
    assert method(both) == "full" and before != (both / "light" / "light.json").read_text()
    output = report(both, 4)
    assert output["settings"]["method"] == "auto" and output["method"] == "full"
    make(blend, there, "--frame-range", "4")
    assert method(there) == "fast" and "bake" in report(there, 4)  # alone it would have


@pytest.mark.slow
def test_a_slow_machine_bakes_the_same(blend, tmp_path, slow_paths):
    make(blend, tmp_path / "quick", "--method", "fast", "--frame-range", "1-4")
    slow_paths()
    make(blend, tmp_path / "slow", "--method", "fast", "--frame-range", "1-4")
    assert fields(tmp_path / "slow") == fields(tmp_path / "quick")


@pytest.mark.slow
def test_killed_while_the_light_is_made(blend, tmp_path):
    out = tmp_path / "out"
    other = start(blend, out, "--method", "fast")
    end = time.monotonic() + NEVER
    while not list(out.glob(".light.part-*/*.holobake.npz")):
        assert other.poll() is None and time.monotonic() < end
        time.sleep(0.001)
    other.kill()
    other.communicate()
    assert "light" not in names(out)
    make(blend, out, "--method", "fast", "--animation")
    make(blend, tmp_path / "alone", "--method", "fast", "--animation")
    assert fields(out) == fields(tmp_path / "alone")


def test_what_was_baked_before_serves_and_another_job_has_its_own(blend, tmp_path, monkeypatch):
    from holopath_addon.engine.light import baking

    out, again = tmp_path / "out", tmp_path / "again"
    request = ["--method", "fast", "--frame-range", "1"]
    make(blend, out, *request)
    before, light = contents(tmp_path / "out.cache"), contents(out / "light")
    monkeypatch.setattr(baking, "gather", None)  # nothing is baked any more
    monkeypatch.setattr(baking, "solve", None)
    make(blend, again, *request, "--cache", str(tmp_path / "out.cache"))
    make(blend, out, *request, "--focus", "0.5m")
    monkeypatch.undo()
    texture, record = sorted(light)
    for folder in (out, again):
        assert contents(folder / "light")[texture] == light[texture]
    assert contents(out / "light")[record] != light[record]
    assert contents(tmp_path / "out.cache") == before
    make(blend, out, *request, "--seed", "1", "--no-cache")
    assert contents(out / "light")[texture] != light[texture]


def test_light_of_a_scene_that_moves_is_decided_as_of_none(blend, tmp_path, monkeypatch):
    """An existing first frame is useless for the others."""
    wall = bpy.data.objects["Wall"]
    for frame, z in ((1, -1.0), (4, -1.2)):
        wall.location.z = z
        wall.keyframe_insert("location", frame=frame)
    bpy.ops.wm.save_mainfile()
    baked, looked = [], []
    bake = job_light.RenderContext.bake
    planned = job_light.planner.plan

    def counted(render, store, progress):
        baked.append(render.camera)
        bake(render, store, progress)

    def plan(scene, camera, hologram, settings, store, progress):
        looked.append(store.files())
        return planned(scene, camera, hologram, settings, store, progress)

    monkeypatch.setattr(job_light.RenderContext, "bake", counted)
    monkeypatch.setattr(job_light.planner, "plan", plan)
    out = tmp_path / "out"
    store = engine.BakeStore(f"{out}.cache")
    make(blend, out, "--method", "fast", "--frame-range", "1")
    assert len(baked) == 2 and store.files()  # the light, and the frame
    looked.clear()
    make(blend, out, "--frame-range", "2")
    assert looked[0] == [] and method(out) == "full"


def test_views_that_cannot_be_planned_are_passed_over(blend, tmp_path, capfd):
    """Nothing may be in view at first; where there never is, one sentence tells it, and nothing stays."""
    camera = bpy.context.scene.camera
    for frame, turn in ((1, 3.14), (4, 0.0)):
        camera.rotation_euler.x = turn
        camera.keyframe_insert("rotation_euler", frame=frame)
    bpy.ops.wm.save_mainfile()
    out = tmp_path / "out"
    make(blend, out, "--method", "fast", "--frame-range", "4")
    assert report(out, 4)["bake"]["reused"] == "all"
    assert cli.main(words(blend, tmp_path / "none", "--animation", "--camera", "nobody")) == 2
    assert "holopath: Frame 1: " in capfd.readouterr().err and not (tmp_path / "none").exists()


def test_another_folder_of_that_name_is_left_alone(tmp_path):
    (tmp_path / "light").mkdir()
    (tmp_path / "light" / "lamps.txt").write_text("mine")
    light = JobLight(tmp_path / "light", "job", None)
    assert not light.done()
    with pytest.raises(engine.InvalidInput, match="something other than HoloPath's light"):
        light.make(range(1, 3), lambda frame: None, lambda done, message: None)
    assert (tmp_path / "light" / "lamps.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("frames", "views"),
    [
        (range(5, 6), [5]),
        (range(1, 4), [1, 3]),
        (range(1, 25), [1, 13, 24]),
        (range(0, 1000, 10), [0, 140, 280, 420, 570, 710, 850, 990]),
    ],
)
def test_views_are_spread(frames, views):
    assert spread(frames) == views
