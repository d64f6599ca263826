"""Tables of the page, on numbers made up."""

from benchmarks.chart import report, run
from benchmarks.chart.methods import methods


def row(budget, figure, auto, rival):
    return {"budget": budget, "figure": figure, "auto": auto, "rival": rival}


def test_leads_are_of_each_scene_and_budget():
    """Who is behind, who has nothing yet, and who has no rival are told apart."""
    budgets = {
        "planes": [row(1, "psnr", 20.0, 17.5), row(1, "psnr_worst", 16.0, 16.25)]
        + [row(3, "psnr", None, 17.5), row(3, "psnr_worst", None, 16.0)],
        "tea": [row(1, "psnr", None, None), row(1, "psnr_worst", None, None)]
        + [row(3, "psnr", 20.0, None), row(3, "psnr_worst", 16.0, None)],
    }
    assert report._leads_table(budgets) == [
        "| scene | 1 s | 3 s |",
        "| --- | --- | --- |",
        "| planes | +2.5 / -0.2 | none / none |",
        "| tea |  /  | alone / alone |",
    ]


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
