"""Tables of the page, on numbers made up."""

from benchmarks.chart import report


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
