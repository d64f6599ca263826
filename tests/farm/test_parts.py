"""`holopath render --divide`: a still in parts, made by one process or several, is as one process renders it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from holopath_addon import cli
from holopath_addon.farm.claims import FOLDER
from tests.patience import NEVER

ROOT = Path(__file__).parents[2]
SCENE = """<scene version="3.0.0">
<sensor type="perspective"><float name="fov" value="30"/></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="180"/><translate z="2"/>
</transform><emitter type="area"><rgb name="radiance" value="0.2"/></emitter></shape>
<shape type="sphere"><point name="center" x="0" y="0" z="1"/><float name="radius" value="0.15"/>
<bsdf type="diffuse"><texture type="bitmap" name="reflectance">
<string name="filename" value="{texture}"/></texture></bsdf>
</shape><emitter type="constant"/></scene>"""
WORDS = [
    "--resolution",
    "64x64",
    "--frames",
    "2",
    "--quality",
    "preview",
    "--method",
    "full",
    "--focus",
    "1m",
]


@pytest.fixture
def scene(backend, tmp_path):
    import mitsuba as mi
    import numpy as np

    pixels = (np.indices((8, 8)).sum(0) % 2 * 200).astype(np.uint8)[..., None].repeat(3, -1)
    mi.Bitmap(pixels).write(str(tmp_path / "chess.png"))
    path = tmp_path / "scene.xml"
    path.write_text(SCENE.format(texture="chess.png"))
    return path


def words(scene, out, *more):
    return ["render", str(scene), *WORDS, "--out", str(out), *more]


def start(scene, out, *more):
    """A process of its own."""
    run = [sys.executable, "-m", "holopath_addon", *words(scene, out, *more)]
    return subprocess.Popen(run, cwd=ROOT, stderr=subprocess.PIPE, text=True)


def field(out):
    return (out / "wavefield" / "field.npy").read_bytes()


@pytest.fixture
def whole(scene, tmp_path):
    """The field that one process renders at once."""
    assert cli.main([*words(scene, tmp_path / "whole"), "--quiet"]) == 0
    return field(tmp_path / "whole")


def beside(tmp_path):
    """What there is beside the scene and the still made at once."""
    return {path.name for path in tmp_path.iterdir()} - {"scene.xml", "chess.png", "whole"}


def test_joins_to_what_is_rendered_at_once(scene, tmp_path, whole, capsys):
    out = tmp_path / "divided"
    assert cli.main(words(scene, out, "--divide", "3")) == 0
    assert field(out) == whole and beside(tmp_path) == {"divided"}
    pictures = [folder / "reconstruction" / "focus_1m.exr" for folder in (out, tmp_path / "whole")]
    assert pictures[0].read_bytes() == pictures[1].read_bytes()
    made = (out / "report.json").stat().st_mtime_ns
    assert cli.main(words(scene, out, "--divide", "5")) == 0
    assert "done before, skipped" in capsys.readouterr().err
    assert (out / "report.json").stat().st_mtime_ns == made and beside(tmp_path) == {"divided"}


@pytest.mark.slow
@pytest.mark.parametrize("count", [2, 4])
def test_processes_share_the_parts(scene, tmp_path, whole, count):
    out = tmp_path / "divided"
    running = [start(scene, out, "--divide", "16") for _ in range(count)]
    assert [process.communicate()[1] and process.returncode for process in running] == [0] * count
    assert field(out) == whole and beside(tmp_path) == {"divided"}


@pytest.mark.slow
def test_killed_three_times(scene, tmp_path, whole):
    out, parts = tmp_path / "divided", tmp_path / ".divided.parts"
    for unit in ("prepared", "traced-2-of-5", "gathered-3-of-5-of-5"):
        running = start(scene, out, "--divide", "5")
        end = time.monotonic() + NEVER  # for a claim that was killed before it said whose it is
        while not (parts / FOLDER / unit).exists():
            assert running.poll() is None and time.monotonic() < end, unit
            time.sleep(0.001)
        os.kill(running.pid, signal.SIGKILL)
        running.communicate()
        assert not out.exists()
    assert start(scene, out, "--divide", "5").communicate() and field(out) == whole
    assert beside(tmp_path) == {"divided"}


def test_refuses_other_settings_while_someone_is_at_work(scene, tmp_path, capsys):
    from holopath_addon.farm.claims import Claims

    parts = tmp_path / ".divided.parts"
    parts.mkdir()
    with Claims(parts, "other settings") as others, others.claim("traced-1-of-2"):
        assert cli.main(words(scene, tmp_path / "divided", "--divide", "2")) == 2
    assert "is being rendered by" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("more", "sentence"),
    [
        (["--divide", "0"], "divides into 1 to 4096 parts, not 0"),
        (["--divide", "2", "--method", "point"], "point does not divide into parts: leave out --divide"),
        (["--divide", "2", "--frame-range", "1-3"], "leave out --divide"),
    ],
)
def test_bad_input(scene, tmp_path, capsys, more, sentence):
    assert cli.main(words(scene, tmp_path / "divided", *more)) == 2
    assert sentence in capsys.readouterr().err and not beside(tmp_path)
