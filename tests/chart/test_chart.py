"""A tiny chart from end to end: two methods on one scene of 64 pixels."""

import csv
import json
from dataclasses import replace

import pytest

from benchmarks.chart import measure, report, run
from holopath_addon import engine

GREEN = 516.5e-9


@pytest.fixture
def tiny(tmp_path):
    """Light of a volume so near the SLM that few pixels miss the aperture."""
    hologram = engine.Hologram(64, 64, 8e-6, (GREEN,), 0.1e-3, 0.5e-3)
    efforts = {"auto": ("preview",), "rgbd": ("draft",)}
    return run.Chart(
        "tiny",
        hologram,
        8,
        60.0,
        ("planes",),
        ("rgbd", "auto"),
        efforts,
        {"planes": (1,)},
        apart=False,
        folder=tmp_path,
    )


def test_a_tiny_chart_is_written_and_kept(backend, tiny, monkeypatch):
    monkeypatch.setattr(measure, "SHORT", 0.0)
    told = []
    records, seconds = run.measured(tiny, tiny.scenes, tiny.methods, tell=told.append)
    assert {(r["method"], r["frames"]) for r in records} == {
        ("rgbd", 1),
        ("rgbd", 8),
        ("auto", 1),
        ("auto", 8),
    }
    for record in records:
        assert 0 < record["seconds"] < 60
        assert 1e7 < record["peak_bytes"] < 1e11
        assert record["psnr_worst"] <= record["psnr"] < 40
        assert 0 < record["ssim"] < 1
    by = {(r["method"], r["frames"]): r for r in records}
    for method in tiny.methods:  # speckle falls with frames, and PSNR rises
        assert by[method, 8]["psnr"] > by[method, 1]["psnr"] + 2
        assert by[method, 8]["speckle"] < by[method, 1]["speckle"]

    made = report.Made("a machine", "2026-01-01", "abc", "a command", seconds)
    assert "auto ahead" in report.write(tiny, records, made)
    chart = json.loads((tiny.folder / "chart.json").read_text())
    assert (chart["machine"], chart["date"], chart["commit"], chart["command"]) == (
        "a machine", "2026-01-01", "abc", "a command",
    )  # fmt: skip
    assert len(chart["records"]) == 4
    with (tiny.folder / "chart.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["psnr"]) for row in rows] == [record["psnr"] for record in chart["records"]]
    page = (tiny.folder / "chart.md").read_text()
    for name in ("seconds.png", "convergence.png", "frames.png", "table-1.png", "closeups-planes.jpg"):
        start = b"\x89PNG" if name.endswith("png") else b"\xff\xd8\xff"
        assert (tiny.folder / f"chart-{name}").read_bytes().startswith(start)
        assert f"(chart-{name})" in page

    before = {path: path.stat().st_mtime_ns for path in (tiny.folder / "records").iterdir()}
    again, _ = run.measured(tiny, tiny.scenes, tiny.methods, tell=told.append)
    assert again == records
    assert before == {path: path.stat().st_mtime_ns for path in (tiny.folder / "records").iterdir()}


def test_what_takes_too_long_is_given_up(backend, tiny):
    hurried = replace(tiny, limit=0.0)
    task = hurried.task("hills 200", "rgbd", [("draft", 8), ("preview", 8)])
    measure.run(task, lambda line: None)
    for effort in ("draft", "preview"):
        assert measure.kept(task, effort, 8)["failed"] == "over 0 s"


def test_another_code_is_measured_anew(tiny, monkeypatch):
    task = tiny.task("planes", "auto", [("preview", 8)])
    path = measure.record_path(task, "preview", 8)
    path.parent.mkdir(parents=True)
    method = run.methods(tiny.hologram)["auto"]
    path.write_text(json.dumps({"digest": measure.record_digest(task, method, "preview", 8)}))
    assert measure.kept(task, "preview", 8)
    monkeypatch.setattr(measure, "code_of", lambda kind: "other code")
    assert measure.kept(task, "preview", 8) is None


def test_names_that_do_not_exist_are_told():
    assert run.run("quick", "nowhere").startswith("There is no scene nowhere: choose of planes,")
    assert run.run("--methods", "magic").startswith("There is no method magic: choose of ")


def test_a_method_without_its_module_is_skipped(tiny, monkeypatch):
    from benchmarks.chart import methods

    monkeypatch.setitem(methods.BASELINES, "rgbd", ("nothing_such", "", ""))
    told = []
    monkeypatch.setattr(run, "_do", lambda task, apart, tell: None)
    records, _ = run.measured(tiny, ("planes",), ("rgbd",), tell=told.append)
    assert records == []
    assert told[0].startswith("rgbd is skipped: there is no ")
