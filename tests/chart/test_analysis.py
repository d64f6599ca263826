"""What follows from records: the Pareto front, budgets, frames and Table 1; on numbers made up."""

import pytest

from benchmarks.chart.analysis import (
    best_within,
    compare,
    mean_over_scenes,
    over_frames,
    pareto,
    ratios,
    table_1,
)
from benchmarks.chart.looks import HEADLINE


def record(method, seconds, psnr, worst=None, frames=8, kind="baseline", scene="mirror", effort="balanced"):
    return {
        "method": method,
        "kind": kind,
        "scene": scene,
        "effort": effort,
        "frames": frames,
        "seconds": seconds,
        "psnr": psnr,
        "psnr_worst": psnr - 3 if worst is None else worst,
        "psnr_defocus": psnr + 1,
        "pictures": {name: {"psnr": psnr + k} for k, name in enumerate(HEADLINE)},
        "stages": {"Planning": 0.25, "Picture": 0.5, "Layers": seconds},
    }


def test_the_front_is_what_none_beats():
    points = [(1.0, 20.0), (2.0, 19.0), (2.0, 24.0), (5.0, 24.0), (9.0, 30.0), (0.5, 10.0)]
    assert pareto(points) == [5, 0, 2, 4]


def test_the_front_of_equal_points_is_one_of_them():
    assert len(pareto([(1.0, 20.0), (1.0, 20.0)])) == 1
    assert pareto([]) == []


def test_the_best_within_a_budget_may_be_less_work():
    records = [record("auto", 1.0, 22.0), record("auto", 3.0, 21.0), record("auto", 9.0, 29.0)]
    assert best_within(records, 0.5, "psnr") is None
    assert best_within(records, 3.0, "psnr") == 22.0
    assert best_within(records, 9.0, "psnr") == 29.0


def test_auto_is_ahead_of_baselines_only_where_it_is():
    records = [
        record("auto", 2.0, 25.0, 20.0, kind="ours"),
        record("auto", 50.0, 99.0, 99.0, kind="ours", frames=24),  # other frames do not count
        record("full", 1.0, 40.0, 40.0, kind="ours"),  # nor do others of ours
        record("rgbd", 0.8, 21.0, 10.0),
        record("focal-stack", 20.0, 27.0, 15.0),
    ]
    rows = {(row["budget"], row["figure"]): row for row in compare(records, (0.5, 1, 3, 30))}
    assert rows[0.5, "psnr"]["ahead"] is None
    assert rows[1, "psnr"]["ahead"] is False and rows[1, "psnr"]["auto"] is None
    assert rows[3, "psnr"]["ahead"] is True and rows[3, "psnr"]["by"] == "rgbd"
    assert rows[30, "psnr"]["ahead"] is False and rows[30, "psnr"]["by"] == "focal-stack"
    assert rows[30, "psnr_worst"]["ahead"] is True
    assert rows[30, "psnr"]["best"] == {"auto": 25.0, "full": 40.0, "rgbd": 21.0, "focal-stack": 27.0}


def test_a_draft_that_follows_no_mirrors_is_told():
    """Ours, on scenes with mirrors or glass, where it is the best that there is."""
    records = [
        record("auto", 0.5, 19.0, 14.0, kind="ours", effort="draft"),
        record("auto", 2.0, 21.0, 18.0, kind="ours", effort="preview"),
        record("rgbd", 0.5, 17.0, effort="draft"),
    ]
    assert [row["flat"] for row in compare(records, (1, 3))] == [["auto"], ["auto"], [], []]
    elsewhere = [each | {"scene": "planes"} for each in records]
    assert [row["flat"] for row in compare(elsewhere, (1,))] == [[], []]


def test_phases_within_a_budget_are_the_best_of_their_frames():
    """Of those that an SLM can show; a complex field does not count."""
    records = [
        record("auto", 1.0, 30.0, frames=1, effort="balanced"),
        record("auto", 6.0, 19.0, frames=1, effort="encoded 5 s"),
        record("auto", 50.0, 20.0, frames=1, effort="encoded 50 s"),
        record("auto", 9.0, 23.0, frames=3, effort="encoded 5 s"),
        record("rgbd", 20.0, 15.0, frames=1, effort="phases"),
    ]
    shown = {"auto": ("encoded 5 s", "encoded 50 s"), "rgbd": ("phases",)}
    best = over_frames(records, shown, 10)
    assert {name: {m: r["psnr"] for m, r in own.items()} for name, own in best.items()} == {
        "auto": {1: 19.0, 3: 23.0},
        "rgbd": {},
    }
    assert over_frames(records, shown, 100)["auto"][1]["psnr"] == 20.0
    scenes = {"mirror": best, "tea": over_frames(records, shown, 100)}
    assert mean_over_scenes(scenes, "psnr", "auto", 1) == 19.5
    assert mean_over_scenes(scenes, "psnr", "rgbd", 1) is None  # not all scenes
    assert mean_over_scenes({}, "psnr", "auto", 1) is None


def test_frames_are_compared_at_one_effort():
    records = [record("auto", 1.0 + 0.1 * m, 20, frames=m, kind="ours") for m in (1, 8, 24)]
    records += [record("auto", 70.0, 20, effort="full", kind="ours"), record("rgbd", 4.0, 20)]
    several = ratios(records, {"auto": "balanced", "rgbd": "balanced"})
    own, ratio = several["mirror", "auto"]
    assert own == pytest.approx({1: 1.1, 8: 1.8, 24: 3.4})
    assert ratio == pytest.approx(3.4 / 1.1)
    assert ("mirror", "rgbd") not in several


def test_table_1_takes_each_criterion_from_its_scenes():
    records = [
        record("rgbd", 4.0, 20.0),
        record("rgbd", 8.0, 30.0, scene="tea"),
        record("rgbd", 6.0, 10.0, scene="planes"),
    ]
    criteria, rows = table_1(records, {"rgbd": "balanced"})
    row = dict(zip((name.split(":")[0] for name in criteria), rows["rgbd"], strict=True))
    assert row["fast"] == 6.0
    assert row["multi-frame"] is None
    assert row["data"] == 0.5
    assert row["reflection, refraction"] == 20.0
    assert row["material, GI"] == 30.0
    assert row["depth between"] == 20.0 + 2  # looks 1 and 3 have 1 and 3 dB more
    assert row["view"] == 20.0 + 7.5
    assert row["out of focus"] == 21.0
