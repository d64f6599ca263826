"""Reports in output folders."""

import json

import pytest

from holopath_addon.engine.settings.former_names import FORMER_NAMES
from holopath_addon.workflow import output


def test_reports_of_the_version_before_are_read_by_current_names(tmp_path, recwarn):
    former = {name: number for number, name in enumerate(FORMER_NAMES["report entry"])}
    (tmp_path / "report.json").write_text(json.dumps(former | {"focus_asked": ["center", 2.5], "spp": 3}))
    report = output.read_report(tmp_path)
    assert report.pop("requested_focus") == ["center", 2.5] and report.pop("spp") == 3
    current = {new: former[old] for old, new in FORMER_NAMES["report entry"].items() if old != "focus_asked"}
    assert report == current and not recwarn.list


@pytest.mark.parametrize("text", ["[]", "no JSON", None])
def test_no_readable_report(tmp_path, text):
    if text is not None:
        (tmp_path / "report.json").write_text(text)
    assert output.read_report(tmp_path) == {}
