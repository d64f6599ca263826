"""Tables of the page, on numbers made up."""

import json

import pytest

from benchmarks.chart import report, run
from benchmarks.chart.methods import methods
from holopath_addon import engine


def row(budget, figure, auto, rival, flat=()):
    return {"budget": budget, "figure": figure, "auto": auto, "rival": rival, "flat": [*flat]}


def test_leads_are_of_each_scene_and_budget():
    """Who is behind, who has nothing yet, and who has no rival are told apart."""
    budgets = {
        "planes": [row(1, "psnr", 20.0, 17.5, ["auto"]), row(1, "psnr_worst", 16.0, 16.25)]
        + [row(3, "psnr", None, 17.5), row(3, "psnr_worst", None, 16.0)],
        "tea": [row(1, "psnr", None, None), row(1, "psnr_worst", None, None)]
        + [row(3, "psnr", 20.0, None), row(3, "psnr_worst", 16.0, None)],
    }
    assert report._leads_table(budgets) == [
        "| scene | 1 s | 3 s |",
        "| --- | --- | --- |",
        "| planes | +2.5* / -0.2 | none / none |",
        "| tea |  | alone / alone |",
    ]


PAGE = """# A chart

## All figures

| scene | method | effort | M | s | GB | PSNR | worst |
| --- | --- | --- | --- | --- | --- | --- | --- |
| planes | auto | draft | 8 | 0.3 | 0.3 | 20.50 | 16.10 |
| tea | rgbd | high | 24 | 3 | 0.3 | 19.00 | 18.00 |

## What is lower

| scene | method | effort | M | PSNR | before | now | s before | s now |
| --- | --- | --- | --- | --- | --- | --- | --- | --- |
| tea | rgbd | high | 24 | mean | 19.50 | 19.00 | 3 | 3 |

## More

| scene | method | effort | frames | why |
| --- | --- | --- | --- | --- |
| tea | rgbd | high | 8 | over 300 s |
"""


def test_what_is_lower_than_before_is_listed(tmp_path):
    """By an earlier page or its JSON, more than 0.2 dB, the largest fall first; what is new does not count."""
    page, kept = tmp_path / "chart.md", tmp_path / "chart.json"
    page.write_text(PAGE)
    before = report.earlier(page)
    kept.write_text(json.dumps({"records": before}))
    assert report.earlier(kept) == before and len(before) == 2
    now = [
        {"scene": "planes", "method": "auto", "effort": "draft", "frames": 8, "seconds": 0.4, "psnr": 20.0}
        | {"psnr_worst": 15.0},
        {"scene": "tea", "method": "rgbd", "effort": "high", "frames": 24, "seconds": 3.0, "psnr": 18.9}
        | {"psnr_worst": 18.3},
        {"scene": "tea", "method": "rgbd", "effort": "high", "frames": 1, "seconds": 3.0, "psnr": 1.0}
        | {"psnr_worst": 1.0},
    ]
    _, _, *rows = report._falls_table(before, now)
    assert rows == [
        "| planes | auto | draft | 8 | worst | 16.10 | 15.00 | 0.3 | 0.4 |",
        "| planes | auto | draft | 8 | mean | 20.50 | 20.00 | 0.3 | 0.4 |",
    ]
    for text in ("# Nothing", ""):
        page.write_text(text)
        with pytest.raises(engine.InvalidInput, match="has no table of all figures"):
            report.earlier(page)
    kept.write_text("{}")
    with pytest.raises(engine.InvalidInput, match="is no earlier chart"):
        report.earlier(kept)


def test_phases_of_eight_bits_stand_beside_fields_and_phases():
    both = {"psnr": 21.0, "psnr_worst": 17.0, "psnr_8_bits": None, "psnr_worst_8_bits": None}
    records = [
        {"scene": "tea", "method": "auto", "effort": "balanced", "frames": 8} | both,
        {"scene": "tea", "method": "auto", "effort": "balanced, encoded", "frames": 8}
        | {"psnr": 24.0, "psnr_worst": 18.5, "psnr_8_bits": 23.9, "psnr_worst_8_bits": 18.45},
        {"scene": "tea", "method": "full", "effort": "balanced", "frames": 8} | both,
    ]
    _, _, *rows = report._levels_table(records)
    assert rows == ["| tea | 21.00 / 17.00 | 24.00 / 18.50 | 23.90 / 18.45 |"]


def test_how_many_records_are_missing_is_said():
    late, fault = {"failed": "over 150 s"}, {"failed": "MemoryError: too large"}
    assert report._count([1, 2], [3], []) == "3 of 3 records are there."
    assert report._count([1, 2], [], [late, late, fault]) == (
        "2 of 5 records are there. 2 were given up for their seconds, and 1 failed or were left out."
    )


def shown_record(scene, method, effort, frames, seconds, psnr):
    figures = {"psnr": psnr, "psnr_worst": psnr - 5, "psnr_focus": psnr + 1, "psnr_defocus": psnr - 1}
    return {
        "scene": scene,
        "method": method,
        "effort": effort,
        "frames": frames,
        "seconds": seconds,
    } | figures


def test_what_a_60_hz_slm_shows_is_of_records():
    """Phases of one frame within 100 s, of each scene; fields and what takes longer do not count."""
    records = [
        shown_record("planes", "rgbd", "phases", 1, 2.0, 15.0),
        shown_record("planes", "focal-stack", "preview", 1, 20.0, 19.25),
        shown_record("planes", "focal-stack", "balanced", 1, 150.0, 29.0),
        shown_record("planes", "auto", "balanced", 1, 2.0, 39.0),
        shown_record("planes", "auto", "preview, encoded 5 s", 1, 6.0, 20.0),
        shown_record("tea", "rgbd", "phases", 1, 2.0, 21.0),
        shown_record("tea", "auto", "preview, encoded 5 s", 1, 16.0, 20.5),
        shown_record("tea", "auto", "preview, encoded 5 s", 3, 16.0, 24.0),
    ]
    shown = report._shown(records, methods(run.full().hologram))
    assert report._one_frame_table(shown) == [
        "| method | planes | tea |",
        "| --- | --- | --- |",
        "| rgbd | 15.0 / 10.0 | 21.0 / 16.0 |",
        "| focal-stack | 19.2 / 14.2 |  |",
        "| auto | 20.0 / 15.0 | 20.5 / 15.5 |",
        "| *auto ahead* | yes / yes | no / no |",
    ]
    header, _, *rows = report._frame_table(shown, 1)
    assert header.startswith(
        "| method | mean, 10 s | worst, 10 s | in focus, 10 s | out of focus, 10 s | mean, 100 s |"
    )
    assert rows[0] == "| rgbd | 18.0 | 13.0 | 19.0 | 17.0 | 18.0 | 13.0 | 19.0 | 17.0 |"
    assert rows[1] == "| focal-stack |  |  |  |  |  |  |  |  |"  # nothing of tea
    assert rows[2] == "| auto |  |  |  |  | 20.2 | 15.2 | 21.2 | 19.2 |"
