"""Which method for which display: the rows agree with the page, the program and what is measured."""

import pytest

from benchmarks import which_method
from documentation import pages, pictures
from holopath_addon import cli


@pytest.mark.parametrize("display", which_method.DISPLAYS.values(), ids=which_method.DISPLAYS)
def test_words_say_what_is_measured(display):
    words = ["render", "demo:planes", "--out", "out", "--frames", str(display.frames), *display.words.split()]
    options = cli.parse(words, pages.STORE)
    assert options.encode == display.encode["method"]
    assert options.encode_seconds == display.encode.get("seconds")
    assert options.eyebox == display.encode.get("eyebox")
    assert (options.bits or 8) == display.bits
    assert (options.method or "auto") == display.method


def test_each_row_has_its_picture():
    assert pictures.DISPLAYS == tuple(which_method.DISPLAYS)
    page = (pictures.ROOT / "docs" / "how-to" / "which-method.md").read_text("utf-8")
    for name, display in which_method.DISPLAYS.items():
        assert f"| {display.what} | {display.frames} | {display.bits} | `{display.words}` |" in page
        assert f"../images/which-{name}.webp" in page
