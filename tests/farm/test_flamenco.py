"""The job type HoloPath: what it makes of a job, in node as Flamenco's manager runs it, and what its tasks render."""

import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from holopath_addon.engine.settings.choices import ENCODINGS
from tests.farm import flamenco, scenes

ROOT = Path(__file__).parents[2]
SETTINGS = {
    "frames": "1-10",
    "chunk_size": 3,
    "render_output_path": "{shared}/films/my film",
    "encode": "none",
    "words": "",
    "blendfile": "{shared}/my scene.flamenco.blend",
}


def setting(key):
    """The job type's declaration of a setting."""
    (found,) = [each for each in flamenco.compiled()["type"]["settings"] if each["key"] == key]
    return found


def test_a_job_of_ten_frames():
    tasks = flamenco.compiled(SETTINGS)["tasks"]
    assert [task["name"] for task in tasks] == ["render-1", "render-2-4", "render-5-7", "render-8-10"]
    assert {task["type"] for task in tasks} == {"blender"}
    first, *others = tasks
    assert first["needs"] == [] and all(task["needs"] == [first["id"]] for task in others)
    (command,) = others[1]["commands"]
    assert command["steps"] == 3
    variables = {"blender": "/opt/blender", "blenderArgs": "-b -y", "shared": "/srv"}
    assert flamenco.words(command, variables) == [
        *("/opt/blender", "-b", "-y", "--background", "--command", "holopath"),
        *("render", "/srv/my scene.flamenco.blend", "--out", "/srv/films/my film", "--frame-range", "5-7"),
    ]


def test_phases_and_further_words():
    more = {"encode": "joint", "words": "--method fast --camera 'Left Eye'", "frames": "47"}
    (task,) = flamenco.compiled(SETTINGS | more)["tasks"]
    arguments = task["commands"][0]["parameters"]["args"]
    assert arguments[-6:] == ["--encode", "joint", "--method", "fast", "--camera", "Left Eye"]
    assert setting("encode")["choices"] == ["none", *ENCODINGS]


@pytest.mark.parametrize(
    ("frames", "chunk", "names"),
    [
        ("7", 3, ["7"]),
        ("3, 5-7, 40", 2, ["3", "5,6", "7,40"]),
        ("1-3,2-5", 10, ["1", "2-5"]),
    ],
)
def test_frames_in_pieces(frames, chunk, names):
    tasks = flamenco.compiled(SETTINGS | {"frames": frames, "chunk_size": chunk})["tasks"]
    assert [task["name"] for task in tasks] == [f"render-{name}" for name in names]


def test_what_blender_offers_to_choose():
    """Evaluated as the add-on does, of a scene with a step and one without."""
    scene = SimpleNamespace(frame_start=3, frame_end=8, frame_step=1)

    def evaluated(key, **names):
        return eval(setting(key)["eval"], {}, {"C": SimpleNamespace(scene=scene), "Path": Path, **names})

    assert evaluated("frames") == "3-8"
    scene.frame_step = 2
    assert evaluated("frames") == "3,5,7"
    settings = SimpleNamespace(render_output_root="/srv", add_path_components=1)
    folder = evaluated(
        "render_output_path",
        settings=settings,
        jobname="film",
        abspath=Path,
        last_n_dir_parts=lambda n: Path("shot"),
    )
    assert folder == "/srv/shot/film"


@pytest.mark.slow
def test_its_tasks_render_the_animation(tmp_path):
    """Run the commands as a worker does, with Blender as a Python module; the first one bakes for all."""
    bpy = pytest.importorskip("bpy")
    shared = tmp_path / "shared folder"
    shared.mkdir()
    scenes.room(bpy, frames=10)
    bpy.ops.wm.save_as_mainfile(filepath=str(shared / "my scene.flamenco.blend"), check_existing=False)
    more = {"words": "--resolution 32x32 --frames 1 --quality preview --method fast --focus 0.5m,2m"}
    tasks = flamenco.in_order(flamenco.compiled(SETTINGS | more)["tasks"])
    module = [sys.executable, "-m", "holopath_addon"]  # stands for: blender --background --command holopath
    view = []
    for task in tasks:
        (command,) = task["commands"]
        words = flamenco.words(command, {"blender": "b", "blenderArgs": "-b -y", "shared": str(shared)})
        run = subprocess.run(
            module + words[words.index("holopath") + 1 :],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        assert run.returncode == 0, run.stdout
        pictures, steps = flamenco.produced(run.stdout)
        assert len(pictures) == steps == command["steps"]
        view += pictures
    film = shared / "films" / "my film"
    frames = [film / f"frame_{number:04d}" for number in range(1, 11)]
    assert sorted(view) == [frame / "reconstruction" / "focus_0.5m.png" for frame in frames]
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in view)
    assert sorted(film.iterdir()) == [*frames, film / "job.json", film / "light"]
    reports = [json.loads((frame / "report.json").read_text()) for frame in frames]
    assert [report["bake"]["reused"] for report in reports] == 10 * ["all"]
