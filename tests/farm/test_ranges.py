"""Lists of frames in words."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holopath_addon.engine import InvalidInput
from holopath_addon.farm import ranges

NUMBERS = st.integers(-3000, 3000)
PARTS = st.one_of(
    NUMBERS.map(lambda n: (str(n), {n})),
    st.tuples(NUMBERS, st.integers(0, 50), st.integers(1, 9)).map(
        lambda t: (f"{t[0]}-{t[0] + t[1]}:{t[2]}", set(range(t[0], t[0] + t[1] + 1, t[2])))
    ),
    st.tuples(NUMBERS, st.integers(0, 50)).map(
        lambda t: (f" {t[0]}-{t[0] + t[1]}", set(range(t[0], t[0] + t[1] + 1)))
    ),
)


def test_frames():
    assert ranges.frames("1-5,9,20-40:2") == (1, 2, 3, 4, 5, 9, *range(20, 41, 2))
    assert ranges.frames("-5--1") == (-5, -4, -3, -2, -1)
    assert ranges.frames("3,-2-1, 0") == (-2, -1, 0, 1, 3)


@settings(max_examples=30)
@given(st.lists(PARTS, min_size=1, max_size=8))
def test_each_frame_once_in_order(parts):
    text = ",".join(text for text, _ in parts)
    assert ranges.frames(text) == tuple(sorted(set.union(*(numbers for _, numbers in parts))))


@given(st.text("0123456789-:, x\n٣", max_size=12))
def test_anything_else_is_refused_in_one_sentence(text):
    try:
        found = ranges.frames(text)
    except InvalidInput as error:
        assert str(error).endswith(".")
    else:
        assert found and list(found) == sorted(set(found))
        assert all(ranges.FIRST <= frame <= ranges.LAST for frame in found)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "Expected frames such as"),
        ("1,,3", "Expected frames such as"),
        ("first", "Expected frames such as"),
        ("1-2-3", "Expected frames such as"),
        ("5-1", "'5-1' is empty"),
        ("1-9:0", "The step of the range"),
        ("3:2", "Expected frames such as"),
        ("0-2000000", "Expected frames from -1048574 to 1048574, as Blender has them, got"),
        ("99999999999999999999", "Expected frames such as"),
        ("1-60000,100000-160000", "Expected at most 100000 frames, got more in"),
    ],
)
def test_refused(text, says):
    with pytest.raises(InvalidInput, match=says):
        ranges.frames(text)
