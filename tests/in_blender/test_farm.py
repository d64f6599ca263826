"""Farms' work in a real Blender: the tasks of Flamenco's job type, and its own job with the engine HoloPath."""

import json
from pathlib import Path

import pytest

from tests.farm import flamenco

ROOT = Path(__file__).parents[2]
NAME = "bl_ext.user_default.holopath"
WORDS = "--resolution 32x32 --frames 1 --quality preview --method fast --focus 0.5m"

pytestmark = [pytest.mark.blender, pytest.mark.slow]


def save_room(blender, path, more=""):
    """A .blend with the scene of tests/farm."""
    code = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r})\n"
        "import bpy\nfrom tests.farm import scenes\nscenes.room(bpy, frames=3)\nscene = bpy.context.scene\n"
        f"{more}\nbpy.ops.wm.save_as_mainfile(filepath={str(path)!r})\n"
    )
    script = path.with_suffix(".py")
    script.write_text(code)
    status, output = blender("--background", "--python-exit-code", "3", "--python", script)
    assert status == 0, output


def test_the_tasks_of_a_job(blender, tmp_path):
    """Tasks run as Flamenco's worker starts them; all frames use the light that was baked before them."""
    save_room(blender, tmp_path / "my scene.blend")
    settings = {
        "frames": "1-3",
        "chunk_size": 2,
        "render_output_path": f"{tmp_path}/my film",
        "encode": "dpac",
    }
    job = flamenco.compiled(settings | {"words": WORDS, "blendfile": f"{tmp_path}/my scene.blend"})
    for task in flamenco.in_order(job["tasks"]):
        (command,) = task["commands"]
        status, output = blender(*flamenco.words(command, {"blender": "blender", "blenderArgs": "-b -y"})[1:])
        assert status == 0, output
        pictures, steps = flamenco.produced(output)
        assert len(pictures) == steps == command["steps"] and all(map(Path.is_file, pictures)), output
    frames = [tmp_path / "my film" / f"frame_{number:04d}" for number in (1, 2, 3)]
    reports = [json.loads((frame / "report.json").read_text()) for frame in frames]
    assert [report["bake"]["reused"] for report in reports] == ["all", "all", "all"]
    assert all((frame / "hologram" / "phase.npy").is_file() for frame in frames)


def test_a_task_that_fails(blender, tmp_path):
    settings = {"frames": "1", "chunk_size": 1, "render_output_path": f"{tmp_path}/film", "words": ""}
    (task,) = flamenco.compiled(settings | {"blendfile": f"{tmp_path}/none.blend"})["tasks"]
    words = flamenco.words(task["commands"][0], {"blender": "blender", "blenderArgs": "-b -y"})[1:]
    status, output = blender(*words)
    assert status == 2 and "none.blend does not exist" in output
    assert not (tmp_path / "film").exists()


def test_blenders_own_job_with_the_engine(blender, tmp_path):
    """Simple Blender Render, as Flamenco's script asks for it; wave fields are kept beside the pictures."""
    more = (
        "scene.render.engine = 'HOLOPATH'\n"
        "scene.render.resolution_x = scene.render.resolution_y = 32\n"
        "scene.holopath.frames, scene.holopath.quality = 1, 'preview'\n"
        "scene.holopath.depth_far_mm, scene.holopath.depth_near_mm = 1.25, 1.9\n"
        "scene.holopath.keep_fields = True\n"
        f"scene.holopath.animation_folder = {str(tmp_path / 'fields')!r}\n"
    )
    save_room(blender, tmp_path / "scene.blend", f"bpy.ops.preferences.addon_enable(module={NAME!r})\n{more}")
    overwrite = "import bpy; r = bpy.context.scene.render; r.use_overwrite = False; r.use_placeholder = False"
    words = ["--python-expr", overwrite, "--render-output", tmp_path / "film" / "######"]
    words += ["--render-format", "PNG", "--render-frame", "2..3"]
    status, output = blender("-b", "-y", tmp_path / "scene.blend", "--scene", "Scene", *words)
    assert status == 0, output
    pictures, steps = flamenco.produced(output)
    assert pictures == [tmp_path / "film" / f"00000{number}.png" for number in (2, 3)] and steps == 2
    assert sorted(path.name for path in (tmp_path / "fields").iterdir()) == ["frame_0002", "frame_0003"]
