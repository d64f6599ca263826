"""A tiny chart from end to end: two methods on one scene of 64 pixels."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.chart import archive, measure, renewal, report, run
from benchmarks.chart.methods import Method
from holopath_addon import engine
from tests.patience import NEVER

GREEN = 516.5e-9


@pytest.fixture
def tiny(tmp_path):
    """Light of a volume so near the SLM that few pixels miss the aperture."""
    hologram = engine.Hologram(64, 64, 8e-6, (GREEN,), 0.1e-3, 0.5e-3)
    efforts = {"auto": ("preview",), "rgbd": ("draft", "phases")}
    return run.Chart(
        "tiny",
        hologram,
        8,
        60.0,
        ("planes",),
        ("rgbd", "auto"),
        efforts,
        {"planes": (1,)},
        {"planes": (1,)},
        apart=False,
        folder=tmp_path,
    )


def test_a_tiny_chart_is_written_and_kept(backend, tiny, monkeypatch):
    monkeypatch.setattr(measure, "SHORT", 0.0)
    told = []
    records, seconds = run.measured(tiny, tiny.scenes, tiny.methods, tell=told.append)
    assert {(r["method"], r["effort"], r["frames"]) for r in records} == {
        *(("rgbd", effort, m) for effort in ("draft", "phases") for m in (1, 8)),
        *(("auto", "preview", m) for m in (1, 8)),
    }
    for record in records:
        assert 0 < record["seconds"] < NEVER
        assert 1e7 < record["peak_bytes"] < 1e11
        assert record["psnr_worst"] <= record["psnr"] < 40
        assert 0 < record["ssim"] < 1
    by = {(r["effort"], r["frames"]): r for r in records}
    # one frame has smooth phases, which show little through parts of the pupil
    assert by["preview", 8]["psnr_worst"] > by["preview", 1]["psnr_worst"] + 2
    assert by["phases", 1]["psnr"] < by["draft", 1]["psnr"]  # phases alone show less
    assert by["preview", 8]["psnr_8_bits"] is None
    # 256 levels hardly differ from any phase: as much light is lost as has an angle of 2 pi / 256 / sqrt(12)
    assert by["phases", 8]["psnr_8_bits"] == pytest.approx(by["phases", 8]["psnr"], abs=0.1)
    assert by["phases", 8]["psnr_8_bits"] != by["phases", 8]["psnr"]

    made = report.Made("a machine", "2026-01-01", "abc", "a command", seconds)
    tables, faults = report.write(tiny, records, made)
    assert "auto ahead" in tables and faults == []
    page = (tiny.folder / "chart.md").read_text()
    first = page[page.index("\n| method ") :]
    assert page.index("## What a 60 Hz SLM shows") < page.index(first) < page.index("## Frames")
    alone = page[page.index("The same of phases alone") :]
    assert alone.split("\n")[4].endswith("| none / none |")  # within 100 s rgbd has phases, auto fields
    one = by["phases", 1]
    assert "**M = 1**, dB" in page and "**M = 3**, dB" not in page
    assert f"| rgbd | {one['psnr']:.1f} / {one['psnr_worst']:.1f} |" in first
    chart = json.loads((tiny.folder / "chart.json").read_text())
    assert (chart["machine"], chart["date"], chart["commit"], chart["command"]) == (
        "a machine", "2026-01-01", "abc", "a command",
    )  # fmt: skip
    assert len(chart["records"]) == 6 and "6 of 6 records are there." in page
    halfway = np.mean([by["draft", 8]["pictures"][name]["psnr"] for name in report.looks.HALFWAY])
    assert by["draft", 8]["psnr_halfway"] == pytest.approx(halfway)
    with (tiny.folder / "chart.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["psnr"]) for row in rows] == [record["psnr"] for record in chart["records"]]
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


def test_what_is_more_work_than_what_was_given_up_is_not_tried(tiny, monkeypatch):
    """More frames of the same effort or a larger one."""
    tried = []

    def measured(task, method, effort, frames, scene, camera, hologram, truth):
        tried.append((effort, frames))
        return (
            {"failed": f"over {task.limit:g} s"}
            if effort == "balanced"
            else {"seconds": 1.0, "psnr": None, "peak_bytes": 1}
        )

    monkeypatch.setattr(measure, "_measured", measured)
    records = [
        ("preview", 1),
        ("preview", 8),
        ("balanced", 1),
        ("balanced", 3),
        ("balanced", 8),
        ("high", 24),
    ]
    task = replace(tiny, limit=150.0).task("hills 200", "focal-stack", records)
    measure.run(task, lambda line: None)
    assert tried == [("preview", 1), ("preview", 8), ("balanced", 1)]
    assert measure.kept(task, "balanced", 3)["failed"] == "over 150 s"
    assert measure.kept(task, "high", 24)["failed"] == "over 150 s"


def test_the_whole_chart_has_few_and_many_frames_of_the_best_rivals():
    chart = run.full()
    known = run.methods(chart.hologram)
    for name, efforts in (
        ("auto", ("balanced, encoded",)),
        ("focal-stack", ("preview", "balanced")),
        ("light-field", ("preview",)),
        ("rgbd-sgd", ("preview",)),
        ("rgbd", ("dpac",)),
    ):
        for scene in chart.scenes:
            frames = {m for own, m in chart.records(scene, known[name]) if own in efforts}
            assert frames >= {1, 3, 8}, (name, scene)
            assert (24 in frames) == (scene in run.MANY_FRAMES), (name, scene)


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
    with pytest.raises(engine.InvalidInput, match="^There is no scene nowhere: choose of planes,"):
        run.run("quick", "nowhere")
    with pytest.raises(engine.InvalidInput, match="^There is no method magic: choose of "):
        run.run("--methods", "magic")


@pytest.mark.parametrize("make", [run.quick, run.full])
def test_every_method_has_an_effort(make):
    """Of all methods, for any may be named: the usual effort is among those that are measured."""
    chart = make()
    for name, method in run.methods(chart.hologram).items():
        assert chart.usual(method) in chart.efforts_of(method), name
        for scene in chart.scenes:
            records = chart.records(scene, method)
            assert {effort for effort, _ in records} == {*chart.efforts_of(method)}
            assert {frames for _, frames in records} >= {run.M}
    tasks = chart.tasks(chart.scenes, chart.methods)
    assert {task.method for task in tasks} == {"reference", *chart.methods}
    assert "auto" in chart.methods and "mirror" in chart.scenes
    assert {task.scene for task in tasks} == {*chart.scenes, *(f"hills {n}" for n in chart.triangles)}


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"efforts": {"rgbd": ("much",)}}, "There is no effort of rgbd much: choose of draft, "),
        ({"efforts": {"rgbd": ()}}, "The chart tiny gives rgbd no effort."),
        ({"efforts": {"point": ("draft",)}}, "There is no method of this chart point: choose of rgbd, auto."),
        ({"methods": ("rgbd", "auto", "magic")}, "There is no method magic: choose of "),
        ({"scenes": ("nowhere",)}, "There is no scene nowhere: choose of "),
        ({"frames": {"tea": (1,)}}, "There is no scene of this chart tea: choose of planes."),
    ],
)
def test_a_chart_that_could_not_be_written_is_refused(tiny, changes, said):
    with pytest.raises(engine.InvalidInput) as caught:
        replace(tiny, **changes)
    assert str(caught.value).startswith(said)
    with pytest.raises(ValueError, match="^toy has no effort 'much': it has some"):
        Method("toy", "ours", {"some": {}}, "much")


def test_what_is_missing_is_named(tiny, monkeypatch):
    """A method that fails, and Ctrl-C at the next one: the page is written, and says so."""

    def work(task, apart):
        if task.method == "auto":
            raise KeyboardInterrupt
        return "MemoryError: too | large" if task.method == "rgbd" else None

    monkeypatch.setattr(run, "_do", work)
    records, seconds = run.measured(tiny, tiny.scenes, tiny.methods, tell=lambda line: None)
    assert {(r["method"], r["frames"], r["failed"]) for r in records} == {
        ("rgbd", 1, "MemoryError: too | large"),
        ("rgbd", 8, "MemoryError: too | large"),
        ("auto", 1, "interrupted"),
        ("auto", 8, "interrupted"),
    }
    made = report.Made("a machine", "2026-01-01", "abc", "a command", seconds)
    _, faults = report.write(tiny, records, made)
    assert len(faults) == 6
    assert faults[0] == "planes: rgbd, draft, M = 1: MemoryError: too | large"
    page = (tiny.folder / "chart.md").read_text()
    assert "| planes | rgbd | draft | 8 | MemoryError: too / large |" in page
    assert "| planes | auto | preview | 8 | interrupted |" in page


def test_without_a_reference_nothing_of_a_scene_is_tried(tiny, monkeypatch):
    tried = []

    def work(task, apart):
        tried.append(task.method)
        return "OSError: no disk"

    monkeypatch.setattr(run, "_do", work)
    records, _ = run.measured(tiny, tiny.scenes, tiny.methods, tell=lambda line: None)
    assert tried == ["reference"]
    assert {record["failed"] for record in records} == {"no reference: OSError: no disk"}


def test_a_part_of_the_page_that_fails_leaves_the_others(tiny, monkeypatch):
    """A picture and a table: each is named with its reason."""

    def fail(*_):
        raise ZeroDivisionError("no light")

    looks = {name: {"psnr": 20.0, "ssim": 0.5} for name in report.LOOKS}
    figures = dict.fromkeys(report.PLAIN, 1.0) | {
        "kind": "ours",
        "pixels": 64,
        "pictures": looks,
        "stages": {},
    }
    records = [
        {"scene": "planes", "method": "auto", "effort": "preview", "frames": m} | figures for m in (1, 8)
    ]
    monkeypatch.setattr(report.pictures, "_seconds", fail)
    monkeypatch.setattr(report, "_frames_table", fail)
    made = report.Made("a machine", "2026-01-01", "abc", "a command", 1.0)
    tables, faults = report.write(tiny, records, made)
    assert {
        "chart-seconds.png: ZeroDivisionError: no light",
        "seconds over frames: ZeroDivisionError: no light",
        "tables: ZeroDivisionError: no light",  # those of the terminal
    } == {*faults}
    page = (tiny.folder / "chart.md").read_text()
    assert "(chart-convergence.png)" in page and "(chart-seconds.png)" not in page
    assert "chart-seconds.png: ZeroDivisionError: no light |" in page


def test_what_failed_is_tried_again(tiny, monkeypatch):
    """A limit is a result; an error may be another machine's, or a full memory's."""
    task = tiny.task("planes", "auto", [("preview", 8)])
    path = measure.record_path(task, "preview", 8)
    path.parent.mkdir(parents=True)
    digest = measure.record_digest(task, run.methods(tiny.hologram)["auto"], "preview", 8)
    for failed, done in (("over 60 s", True), ("MemoryError: too large", False)):
        path.write_text(json.dumps({"digest": digest, "failed": failed}))
        assert measure.is_done(task) == done


def test_a_method_without_its_module_is_skipped(tiny, monkeypatch):
    from benchmarks.chart import methods

    monkeypatch.setitem(methods.BASELINES, "rgbd", ("nothing_such", "", ""))
    told = []
    monkeypatch.setattr(run, "_do", lambda task, apart: None)
    records, seconds = run.measured(tiny, ("planes",), ("rgbd",), tell=told.append)
    assert all(record["failed"].startswith("rgbd is skipped: there is no ") for record in records)
    assert any(line.startswith("rgbd is skipped: there is no ") for line in told)
    _, faults = report.write(
        tiny, records, report.Made("a machine", "2026-01-01", "abc", "a command", seconds)
    )
    assert faults == []  # it is no fault of the chart


def test_scenes_are_published_one_by_one(tiny, tmp_path, monkeypatch):
    """A scene that is whole replaces what was published of it; others stay, with their machine and day."""
    monkeypatch.setattr(archive, "FOLDER", tmp_path / "docs" / "chart")
    monkeypatch.setattr(report, "PAGE", tmp_path / "docs" / "chart.md")
    monkeypatch.setattr(report, "IMAGES", tmp_path / "docs" / "images")
    two = replace(tiny, scenes=("planes", "tea"))
    looks = {name: {"psnr": 20.0, "ssim": 0.5} for name in report.LOOKS}
    figures = dict.fromkeys(report.PLAIN, 1 / 3) | {
        "kind": "ours",
        "pixels": 64,
        "pictures": looks,
        "stages": {},
    }

    def records(scene, psnr):
        tasks = [task for task in two.tasks((scene,), two.methods) if task.records]
        head = [(task.method, *record) for task in tasks for record in task.records]
        return [
            {"scene": scene, "method": method, "effort": effort, "frames": m} | figures | {"psnr": psnr}
            for method, effort, m in head
        ]

    def publish(records, day):
        report.write(two, records, report.Made("a machine", day, "abc", "a command", 1.0), docs=True)
        return report.PAGE.read_text()

    page = publish(records("planes", 20.0), "2026-01-01")
    assert "| a machine | 2026-01-01 | abc | planes |" in page and "Not measured of this code: tea.\n" in page
    page = publish(records("tea", 21.0) + records("planes", 22.0)[1:], "2026-01-02")  # planes lack a record
    assert "| a machine | 2026-01-01 | abc | planes |\n| a machine | 2026-01-02 | abc | tea |" in page
    assert "Not measured" not in page
    before, now = (
        archive.load(("planes", "tea"), archive.FOLDER)[name]["records"][0] for name in ("planes", "tea")
    )
    assert (before["psnr"], now["psnr"], now["seconds"]) == (20.0, 21.0, 0.333333)
    assert "21.00" in page and "20.00" in page and "22.00" not in page
    assert publish([], "2026-01-03") == page  # as of --page, which measures nothing


def test_records_of_some_frames_are_renewed_in_the_seconds_of_their_machine(tmp_path, monkeypatch):
    """This machine takes twice as long, so that limits are twice as many of its seconds; what failed stays."""
    monkeypatch.setattr(archive, "FOLDER", tmp_path)
    chart, names = run.full(), ("rgbd", "rgbd-sgd", "auto")
    timed, renewed = renewal.tasks_of(chart, "tea", names, (1, 3))
    assert {(task.method, *record) for task in renewed for record in task.records} == {
        *(("rgbd", effort, m) for effort in ("phases", "joint phases", "dpac") for m in (1, 3)),
        *(("rgbd-sgd", "preview", m) for m in (1, 3)),
        *(("auto", effort, m) for effort in ("preview, encoded 5 s", "balanced, encoded") for m in (1, 3)),
    }
    efforts = ("phases", "preview, encoded 5 s")
    _, chosen = renewal.tasks_of(chart, "tea", names, (3, 8), efforts)
    assert {(task.method, *record) for task in chosen for record in task.records} == {
        *((name, effort, m) for name, effort in zip(("rgbd", "auto"), efforts, strict=True) for m in (3, 8)),
    }

    def records(tasks, seconds, psnr):
        heads = [(task.method, *record) for task in tasks for record in task.records]
        figures = {"scene": "tea", "seconds": seconds, "psnr": psnr, "stages": {"Planning": seconds}}
        return [{"method": name, "effort": effort, "frames": m} | figures for name, effort, m in heads]

    made, later = (report.Made(name, "2026-01-01", "abc", "a command", 1.0) for name in ("fast", "slow"))
    archive.save(archive.parts_of(records([*timed, *renewed], 3.0, 20.0), made, {}), tmp_path)
    limited, failed = [], {"method": "auto", "effort": "balanced, encoded", "frames": 1, "scene": "tea"}

    def do(chart, tasks):
        limited.append(tasks[-1])
        done = records(tasks, 6.0, 21.0)
        return [r | {"failed": "no light"} if failed.items() <= r.items() else r for r in done]

    for _ in range(2):  # a second time replaces the first
        faults = renewal.renew(chart, ["tea"], names, (1, 3), (), do, lambda: later)
        part = archive.load(["tea"], tmp_path)["tea"]
        by = {(r["method"], r["effort"], r["frames"]): (r["seconds"], r["psnr"]) for r in part["records"]}
        assert by["rgbd", "balanced", 8] == (3.0, 20.0)  # which only tells how fast the machine is
        assert by["auto", "balanced, encoded", 3] == (3.0, 21.0)
        assert by["auto", "balanced, encoded", 1] == (3.0, 20.0)
        auto = run.methods(chart.hologram)["auto"]
        assert limited[-1].limit == 2 * chart.limit
        assert limited[-1].encoding(auto, "preview, encoded 5 s")["seconds"] == 10
        assert limited[-2].slower == 1
        [run_of] = part["renewals"]
        assert (part["made"]["machine"], run_of["machine"], run_of["slower"]) == ("fast", "slow", 2.0)
        assert len(run_of["records"]) == 11 and failed["effort"] in faults[0] and "no light" in faults[0]
    table = report._made_table({"tea": part["made"]}, {"tea": part["renewals"]})
    assert "tea (rgbd, rgbd-sgd, auto: 11 records of 1, 3 frames, seconds divided by 2.00)" in table[-1]
    over = records(renewed[:1], 1.0, 1.0)[0] | {"failed": "over 200 s"}
    part = renewal.merged(part, [over], {"machine": "third"}, 2.0)
    assert [len(run_of["records"]) for run_of in part["renewals"]] == [10, 1]
    assert part["records"][-1]["failed"] == "over 100 s"
    stopped = []

    def stop(chart, tasks):
        stopped.append(tasks)
        return [record | {"failed": renewal.INTERRUPTED} for record in records(tasks, 1.0, 1.0)]

    renewal.renew(chart, ["tea", "tea"], names, (1, 3), (), stop, lambda: later)
    assert len(stopped) == 1 and len(archive.load(["tea"], tmp_path)["tea"]["renewals"]) == 1
    with pytest.raises(
        engine.InvalidInput, match="^No record has such a scene, method, effort and number of frames"
    ):
        renewal.renew(chart, ["tea"], names, (5,), (), do, lambda: later)
    with pytest.raises(
        engine.InvalidInput, match="^The scene room is not published in .*, without --frames.$"
    ):
        renewal.renew(chart, ["room"], names, (1, 3), (), do, lambda: later)


def test_the_quick_chart_is_not_published():
    with pytest.raises(
        engine.InvalidInput, match="^The quick chart is not published: leave out --docs, or quick.$"
    ):
        run.run("quick", "--docs")


def test_a_page_of_what_is_published(monkeypatch, tmp_path):
    with pytest.raises(engine.InvalidInput, match="^The page is of all that is published"):
        run.run("quick", "--page")
    monkeypatch.setattr(archive, "FOLDER", tmp_path)
    with pytest.raises(engine.InvalidInput, match="^Nothing is published in .* yet: measure a scene"):
        run.run("--page")
