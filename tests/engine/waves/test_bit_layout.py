"""Levels of any bits in the channels of a picture, bit by bit."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holopath_addon.engine import InvalidInput
from holopath_addon.engine.waves.bit_layout import LAYOUTS, bit_layout

PLACES = [(channel, bit) for channel in range(3) for bit in range(8)]


@st.composite
def layouts(draw):
    """Text of a layout, and the place of each bit of each hologram."""
    bits = draw(st.integers(1, 16))
    order = draw(st.permutations(PLACES))
    holograms = [order[n * bits : (n + 1) * bits] for n in range(draw(st.integers(1, 24 // bits)))]
    text = "/".join(",".join(f"{'RGB'[c]}{b}" for c, b in places) for places in holograms)
    return text, holograms


@settings(max_examples=80, database=None, deadline=None)
@given(layouts(), st.integers(0, 99))
def test_any_places(drawn, seed):
    """Each bit of each level is where the text says, nothing else is set, and all of it comes back."""
    text, holograms = drawn
    layout = bit_layout(text)
    bits = len(holograms[0])
    assert (layout.bits, layout.each) == (bits, len(holograms))
    levels = np.random.default_rng(seed).integers(0, 2**bits, (len(holograms), 3, 4)).astype(np.uint16)
    picture = layout.spread(levels)
    assert picture.shape == (3, 4, 3) and picture.dtype == np.uint8
    for y, x in np.ndindex(3, 4):
        pixel = [0, 0, 0]
        for places, level in zip(holograms, levels[:, y, x], strict=True):
            for place, digit in zip(places, f"{level:0{bits}b}", strict=True):
                pixel[place[0]] += int(digit) << place[1]
        assert picture[y, x].tolist() == pixel
    np.testing.assert_array_equal(layout.gather(picture), levels)
    assert not layout.stray(picture)


def test_runs_of_bits():
    assert bit_layout("r7-5, g7-5, b7-4") == bit_layout("R7,R6,R5,G7,G6,G5,B7,B6,B5,B4") == LAYOUTS["slm-200"]
    assert (
        bit_layout("R2-0,G2-0,B3-0") != LAYOUTS["slm-200"]
    )  # the same numbers of bits, lower in the channels


def test_what_a_panel_does_not_look_at():
    layout, picture = bit_layout("R7-0,G7-6"), np.full((2, 2, 3), 255, np.uint8)
    assert layout.stray(picture) and (layout.gather(picture)[0] == 1023).all()
    assert not layout.stray(picture & np.array([255, 192, 0], np.uint8))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "Expected the bits of a picture's channels"),
        ("R8", "Expected the bits of a picture's channels.*such as R7-5,G7-5,B7-4.*got 'R8'"),
        ("A7-0", "Expected the bits of a picture's channels"),
        ("R3,G3,B4,", "Expected the bits of a picture's channels"),
        ("R5-7,G7-5", "highest bit of a level first, got R5-7. Write R7-5"),
        ("R7-5,G7-5,R5", "name R5 twice"),
        ("R7-5/R6-4", "name R6 twice"),
        ("R7-0,G7-0,B7", "up to 16 bits, got 17"),
        ("R7-4/G7-5", "levels of 4 and 3 bits"),
    ],
)
def test_texts_that_are_no_layout(text, says):
    with pytest.raises(InvalidInput, match=says):
        bit_layout(text)


def test_levels_that_do_not_fit():
    layout = bit_layout("R7-0,G7-6")
    layout.spread([np.array([[1023]], np.uint16)])
    with pytest.raises(InvalidInput, match="levels up to 1023, for 10 bits of a picture, got 1024"):
        layout.spread([np.array([[1024]], np.uint16)])
