"""Studies: every combination a still, nothing made twice, and a table that agrees with the reports."""

import csv
import json
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.cli import render_command, sources, study_command
from holopath_addon.farm import study as studies

ROOT = Path(__file__).parents[2]
SCENE = """<scene version="3.0.0">
<sensor type="perspective" id="viewer"><float name="fov" value="20"/>
 <transform name="to_world"><lookat origin="0,0,0" target="0,0,1" up="0,1,0"/></transform></sensor>
<shape type="sphere"><point name="center" x="{x}" y="0" z="0.5"/><float name="radius" value="0.03"/>
 <emitter type="area"><rgb name="radiance" value="1,0.6,0.1"/></emitter></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="180"/>
 <translate z="2"/></transform><emitter type="area"><rgb name="radiance" value="0.1,0.4,0.2"/></emitter></shape>
</scene>"""
SMALL = """[settings]
resolution = "32x32"
wavelengths = 516.5
quality = "preview"
method = "full"
focus = "0.5m,inf"
"""


@pytest.fixture
def study(tmp_path):
    """``study(text, head)`` writes a study of a scene beside it, and of `SMALL` with more of the settings."""
    (tmp_path / "ball.xml").write_text(SCENE.format(x=0))

    def write(text="", head='scenes = ["ball.xml"]'):
        path = tmp_path / "small.toml"
        path.write_text(f"{head}\n{SMALL}{text}")
        return path

    return write


@pytest.fixture
def renders(monkeypatch):
    """Calls of the engine, as the seed and the frames of each; one whose number is in `failing` fails."""
    render, found, failing = engine.render, [], {}

    def counted(scene, camera, hologram, settings, plan, *arguments, **options):
        found.append((plan.requested.seed, plan.requested.frames))
        if len(found) in failing:
            raise failing[len(found)]
        return render(scene, camera, hologram, settings, plan, *arguments, **options)

    monkeypatch.setattr(engine, "render", counted)
    found_and_failing = type("Renders", (), {"found": found, "failing": failing})
    return found_and_failing


def run(path, *words):
    return cli.main(["study", str(path), *words])


def table(out):
    with open(out / "table.csv", newline="") as lines:
        return list(csv.DictReader(lines))


def runs(out):
    return sorted(path.name for path in (out / "runs").iterdir() if path.is_dir())


def start(*words):
    return subprocess.Popen(
        [sys.executable, "-m", "holopath_addon", "study", *map(str, words)],
        cwd=ROOT, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_every_combination_once(study, renders, tmp_path, capfd):
    path = study("[grid]\nframes = [1, 2]\n", 'scenes = ["ball.xml"]\nseeds = [0, 5]')
    out = tmp_path / "small"
    assert run(path) == 0
    assert sorted(renders.found) == [(0, 1), (0, 2), (5, 1), (5, 2)]
    assert [name.rpartition("-")[0] for name in runs(out)] == [
        "ball-frames-1-seed-0",
        "ball-frames-1-seed-5",
        "ball-frames-2-seed-0",
        "ball-frames-2-seed-5",
    ]
    assert "Done: 4 runs" in capfd.readouterr().err
    before = {path: path.stat().st_mtime_ns for path in (out / "runs").rglob("*.npy")}
    assert run(path) == 0
    assert len(renders.found) == 4 and capfd.readouterr().err.count("skipped") == 4
    assert {path: path.stat().st_mtime_ns for path in (out / "runs").rglob("*.npy")} == before

    # more of what varies: runs that were there stay where they are, though others would be called otherwise
    names = runs(out)
    path = study("[grid]\nframes = [1, 2, 3]\n", 'scenes = ["ball.xml"]\nseeds = [5]')
    assert run(path) == 0
    assert renders.found[4:] == [(5, 3)]
    assert set(names) < set(runs(out)) and len(runs(out)) == 5
    assert [row["run"] for row in table(out)[::2]] == sorted(set(runs(out)) - set(names[::2]))


def test_a_run_is_what_its_words_render(study, tmp_path, capfd):
    """`--list` makes nothing, and says the words that make the same field."""
    path = study()
    assert run(path, "--list") == 0
    name, words = capfd.readouterr().out.strip().split(": holopath ")
    assert not (tmp_path / "small").exists()
    assert run(path) == 0 and cli.main([*words.split(), "--out", str(tmp_path / "still")]) == 0
    fields = [
        (folder / "wavefield" / "field.npy").read_bytes()
        for folder in (tmp_path / "small" / "runs" / name, tmp_path / "still")
    ]
    assert fields[0] == fields[1]
    capfd.readouterr()
    assert run(path, "--list") == 0 and f"{name} (there)" in capfd.readouterr().out


def test_runs_that_are_there_are_known_without_their_scene(study, renders, monkeypatch):
    """The job in their reports identifies runs of any process; a folder without its field is made again."""
    path = study()
    assert run(path) == 0
    with monkeypatch.context() as patched:
        patched.setattr(render_command, "request_of", None)
        assert run(path) == 0
    (field,) = path.parent.glob("small/runs/*/wavefield/field.npy")
    field.unlink()
    assert run(path) == 0 and len(renders.found) == 2 and field.is_file()


def test_another_scene_is_rendered_anew(study, renders, tmp_path, capfd):
    path = study()
    assert run(path) == 0
    (tmp_path / "ball.xml").write_text(SCENE.format(x=0.02))
    assert run(path) == 0
    assert len(renders.found) == 2 and "rendered anew (changed: scene)" in capfd.readouterr().err
    assert len(runs(tmp_path / "small")) == 1


def test_files_that_a_mitsuba_scene_is_made_of(tmp_path):
    """Included files count: a texture that is saved again makes another scene."""
    (tmp_path / "sub").mkdir()
    (tmp_path / "a.xml").write_text('<scene version="3.0.0"><include filename="sub/b.xml"/></scene>')
    (tmp_path / "sub" / "b.xml").write_text("<scene><string name='filename' value='sub/c.png'/></scene>")
    (tmp_path / "sub" / "c.png").touch()
    assert sources.MitsubaSource(tmp_path / "a.xml").files == {
        name: tmp_path / name for name in ("a.xml", "sub/b.xml", "sub/c.png")
    }


def test_the_table_tells_what_the_reports_do(study, tmp_path):
    path = study(
        'compare_reference = true\nencode = "auto"\nencode_seconds = 0.5\n'
        "[[list]]\nframes = 1\n[[list]]\nframes = 2\nwrp = 1.2\n"
    )
    out = tmp_path / "elsewhere"
    assert run(path, "--out", str(out)) == 0
    found = table(out)
    assert len(found) == 4  # two runs, two focus distances
    for row in found:
        report = json.loads((out / row["folder"] / "report.json").read_text())
        index = [float(depth) for depth in report["focus_m"]].index(float(row["focus_m"]))
        for name in studies.FIGURES:
            assert float(row[name]) == report["comparison"][index][name]
        assert float(row["planned_seconds"]) == report["plan"]["seconds"]
        assert float(row["measured_seconds"]) == report["estimated"]["seconds"]["measured"]
        assert float(row["planned_field_error"]) == report["plan"]["error"]
        assert float(row["measured_field_error"]) == report["estimated"]["field_error"]["measured"]
        assert float(row["planned_memory_bytes"]) == report["plan"]["memory_bytes"]
        assert float(row["seconds_total"]) == report["seconds"]["total"]
        assert float(row["seconds_wave_tracing"]) == report["seconds"]["wave tracing"]
        for name in set(engine.settings.DECLARED) - {"wrp", "fixed"}:
            assert row[name] == ("" if report["settings"][name] is None else str(report["settings"][name]))
        assert (
            float(row["pitch_m"]) == 8e-6
            and row["encoding_method"] == report["encoding"]["method"]
            and row["error"] == ""
        )
        assert 0 < float(row["planned_seconds_encoding"]) <= 0.5
        assert (out / row["picture"]).is_file()
    assert [(row["frames"], row["wrp"]) for row in found[::2]] == [("1", ""), ("2", "1.2")]
    assert [row["wrp_m"] for row in found[::2]] == ["auto", "0.0012"]
    assert [float(row["focus_m"]) for row in found] == [0.5, math.inf] * 2

    h5py = pytest.importorskip("h5py")
    with h5py.File(out / "table.h5") as file:
        stored = file["table"]
        assert stored.dtype.names == tuple(found[0])
        for name in ("psnr_db", "phases_psnr_db"):
            np.testing.assert_array_equal(stored[name], [float(row[name]) for row in found])
        np.testing.assert_array_equal(stored["frames"], [1, 1, 2, 2])
        assert stored["frames"].dtype == np.int64 and np.isnan(stored["wrp"][:2]).all()
        assert stored["run"].astype(object)[0].decode() == found[0]["run"]
        assert file["study"][()].decode() == path.read_text()


def test_without_h5py(study, tmp_path, capfd, monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert run(study()) == 0
    assert "note: table.h5 is not written" in capfd.readouterr().err
    assert (tmp_path / "small" / "table.csv").is_file() and not (tmp_path / "small" / "table.h5").exists()


def test_a_run_that_fails_does_not_end_the_study(study, renders, tmp_path, capfd):
    renders.failing.update({1: MemoryError(), 3: engine.InvalidInput("Nothing is there: look elsewhere.")})
    path, out = study("[grid]\nframes = [1, 2, 3]\n"), tmp_path / "small"
    assert run(path) == 1
    error = capfd.readouterr().err
    assert "failed: Not enough memory" in error and error.count(": failed: ") == 2
    assert error.splitlines()[-1] == (
        f"holopath: 2 of 3 runs failed. See the column error in {out / 'table.csv'}."
    )
    found = table(out)
    assert [row["error"][:12] for row in found] == ["Not enough m", "", "", "Nothing is t"]
    assert [row["frames"] for row in found] == ["1", "2", "2", "3"] and found[0]["psnr_db"] == ""
    assert run(path) == 0  # what failed is tried again
    assert len(renders.found) == 5 and not any(row["error"] for row in table(out))


def test_goes_on_where_it_was_cancelled(study, renders, tmp_path, capfd):
    renders.failing[2] = engine.Cancelled()
    path = study("[grid]\nframes = [1, 2, 3]\n")
    assert run(path) == 1
    error = capfd.readouterr().err.splitlines()[-1]
    assert error.startswith("holopath: Canceled: finished runs are in")
    assert [row["error"] for row in table(tmp_path / "small")] == ["", "", *["This run is not made yet."] * 2]
    assert run(path) == 0
    assert [frames for _, frames in renders.found] == [1, 2, 2, 3]
    assert not list((tmp_path / "small").rglob(".*"))  # nothing half written, no claims


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("frame = 3\n", "Expected a setting among quality, "),
        ('out = "x"\n', "got 'out'"),
        ("[grid]\nframes = [1, 0]\n", "Frames must be from 1 to 256, got 0"),
        ('[grid]\nquality = ["best"]\n', "argument --quality: invalid choice: 'best'"),
        ("[grid]\nframes = 3\n", "Expected frames in [grid] as a list of one or more"),
        ("[grid]\nframes = []\n", "Expected frames in [grid] as a list of one or more"),
        ("[grid]\nframes = [[1, [2]]]\n", "got [1, [2]]"),
        ("[grid]\nframes = [1]\n[[list]]\nframes = 2\n", "frames is given twice"),
        ('[grid]\nmove = ["0,0,0"]\n[views]\nright = 1\n', "move is given twice"),
        ("[[list]]\nspeckle = 0.2\nframes = 2\n", "not allowed with"),
        ('rgbd = "yes"\n', "Expected rgbd to be true or false, got yes"),
        ('resolution = "32"\nsd = 1\n', "cannot be read"),
        ('[grid]\nresolution = ["32"]\n', "Expected WIDTHxHEIGHT in pixels, for example 512x512, got '32'"),
        ("[grid]\npitch = [-8]\n", "Expected a positive pixel pitch"),
        ('[grid]\ndisplay = ["leto-3"]\n', "--display sets resolution and pitch"),
        ('[grid]\nencode = ["best"]\n', "argument --encode: invalid choice"),
        ("[grid]\npupil = [[0, 0, -1]]\n", "positive diameter"),
        ("[grid]\nat_frame = [1.5]\n", "got '1.5'"),
        ("light_field = 1\n", "Expected 2 to 32 views in a row, got 1"),
        ("[views]\ncount = 0\n", "Expected count and seed of [views] as whole numbers"),
        ('[views]\nright = "far"\n', "Expected right of [views] as a range"),
        ("[views]\nleft = 1\n", "got 'left'"),
        ("[view]\nright = 1\n", "Expected a part among scenes, seeds"),
    ],
)
def test_refuses_before_anything_is_rendered(text, says, study, renders, tmp_path, capfd):
    assert run(study(text)) == 2
    error = capfd.readouterr().err
    assert error.startswith("holopath: ") and error.count("\n") == 1 and "small.toml" in error
    assert says in error
    assert not renders.found and not (tmp_path / "small").exists()


@pytest.mark.parametrize(
    ("head", "says"),
    [
        ('scenes = ["ball.xml", "none.blend"]', "none.blend does not exist"),
        ('scenes = ["demo:none"]', "There is no demo 'none'"),
        ('scenes = ["ball.ply"]', "Expected a .blend, an .xml or a demo, got ball.ply"),
        ("", "Expected scenes as a list of one or more"),
        ("scenes = [1]", "Expected scenes as files or demo:NAME"),
        ('scenes = ["ball.xml"]\nseeds = [-1]', "Seed must be 0 or more, got -1"),
        ('scenes = ["ball.xml"]\nlist = [1]', "Expected list as tables of settings"),
        ('scenes = ["ball.xml"]\ngrid = 1', "Expected grid as a table"),
    ],
)
def test_refuses_scenes_that_are_not_there(head, says, study, renders, tmp_path, capfd):
    assert run(study(head=head)) == 2
    error = capfd.readouterr().err
    assert says in error and error.count("\n") == 1
    assert not renders.found and not (tmp_path / "small").exists()


def test_refuses_other_people_s_folders(study, tmp_path, capfd):
    path = study()
    (tmp_path / "small").mkdir()
    (tmp_path / "small" / "table.csv").write_text("mine")
    assert run(path) == 2 and "does not hold a study" in capfd.readouterr().err
    assert (tmp_path / "small" / "table.csv").read_text() == "mine"
    assert run(path, "--out", str(path)) == 2 and "is a file" in capfd.readouterr().err
    assert run(tmp_path / "none.toml") == 2 and "cannot be read" in capfd.readouterr().err


@pytest.mark.slow
def test_processes_share_a_study_and_outlive_each_other(study, tmp_path):
    """Three processes, one killed as soon as it renders: each run is rendered once more at most, and all are there."""
    path = study(
        'compare_reference = true\n[grid]\nframes = [1, 2, 3, 4]\nquality = ["preview", "balanced"]\n'
    )
    out = tmp_path / "small"
    first = start(path)
    claims = out / "runs" / ".claims"
    while not [name for name in (os.listdir(claims) if claims.is_dir() else ()) if name[0] != "."]:
        assert first.poll() is None
        time.sleep(0.02)
    time.sleep(1.0)
    first.send_signal(signal.SIGKILL)
    first.communicate()
    both = [start(path), start(path)]
    errors = [process.communicate()[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], errors
    assert len(runs(out)) == 8 and not [path for path in out.rglob(".*")]
    assert len(table(out)) == 16 and not any(row["error"] for row in table(out))
    made = sum(error.count("skipped") + error.count("done by another") for error in errors)
    assert made >= 7  # what one made, the other took
    alone = tmp_path / "alone"
    assert start(path, "--out", alone).wait() == 0
    for row in table(out):
        assert (out / row["folder"] / "wavefield" / "field.npy").read_bytes() == (
            alone / row["folder"] / "wavefield" / "field.npy"
        ).read_bytes()
    shutil.rmtree(alone)


def test_parameters_of_a_scene_file(study):
    """Each is a word of its own, whatever its value, and stands in the table as it was written."""
    path = study('[grid]\ndefine = [{ color = "1, 0, 0", sharp = true }, { size = 16 }]\n')
    runs = studies.read(path).runs
    words = [study_command.words_of(studies.read(path), run) for run in runs]
    assert [[word for word in each if "define" in word] for each in words] == [
        ["--define=color=1, 0, 0", "--define=sharp=true"],
        ["--define=size=16"],
    ]
    assert [run.row()["define"] for run in runs] == ["color=1, 0, 0 sharp=true", "size=16"]
    assert len({run.digest for run in runs}) == 2


def test_more_views_leave_those_that_are_there(tmp_path):
    """And so do more frames."""

    def places(count, frames):
        views = studies._views({"count": count, "seed": 3, "frames": frames, "right": 0.1, "turn_up": 2})
        return {(options["at_frame"], options["move"]) for _, options in views}

    few, more_views, more_frames = places(2, "1-3"), places(3, "1-3"), places(2, "1-4")
    assert few < more_views and few < more_frames
    assert len({move for _, move in more_views}) == 9  # each has a place of its own


def test_rows_of_another_job_are_missing(study, tmp_path):
    """Figures of the scene as it was before are none of the table's."""
    path, out = study(), tmp_path / "small"
    assert run(path) == 0
    read = studies.read(path)
    assert [row["error"] for row in studies.rows(read, out)] == [None, None]
    assert [row["error"] for row in studies.rows(read, out, "another")] == [
        "This run is not checked yet: its scene or HoloPath may have changed."
    ]
