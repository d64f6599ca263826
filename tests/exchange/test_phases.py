"""Numbers become radians as they are said to be, or are refused with what they can be."""

import math

import numpy as np
import pytest

from holopath_addon.engine import InvalidInput
from holopath_addon.exchange.phases import parse_units, radians_of

TURN = 2 * math.pi
RAMP = np.linspace(0, 1, 100, endpoint=False).reshape(1, 1, 10, 10)
BYTES = np.arange(256).reshape(1, 1, 16, 16)


def radians(array, *attributes):
    return radians_of(array, *attributes)(array)


@pytest.mark.parametrize(
    ("units", "turn"), [("radians", TURN), ("turns", 1), ("pi", 2), ("degrees", 360), (None, TURN)]
)
@pytest.mark.parametrize("start", [0, -0.5])
def test_units_are_as_said_and_radians_where_they_fill_a_turn(units, turn, start):
    np.testing.assert_allclose(radians((RAMP + start) * turn, units), (RAMP + start) * TURN, atol=1e-12)


@pytest.mark.parametrize(
    ("array", "ways"),
    [
        (RAMP, ["radians", "turns", "pi"]),
        (RAMP - 0.5, ["radians", "turns", "pi"]),
        (RAMP * 2, ["radians", "pi"]),
        (RAMP * 5, ["radians", "turns"]),
        (RAMP * 360, ["radians", "turns", "degrees"]),
        (RAMP * 1000, ["radians", "turns"]),
        (BYTES * 1.0, ["radians", "degrees", "--bits 8"]),
        (np.round(RAMP * 6.5), ["radians", "--bits 3"]),
        (RAMP * TURN + 1, ["radians", "turns"]),
    ],
)
def test_other_ranges_are_refused_with_what_they_can_be(array, ways):
    with pytest.raises(InvalidInput) as output:
        radians_of(array)
    assert all(way in str(output.value) for way in ways)
    assert str(output.value).count("--") == len(ways)


def test_each_layer_is_to_fill_a_turn():
    """Amplitudes and phases in one array are no two frames of phases."""
    with pytest.raises(InvalidInput, match="from 0 to 0.99"):
        radians_of(np.concatenate([RAMP * TURN, RAMP]))
    assert radians(np.concatenate([RAMP * TURN, 0 * RAMP])).shape == (2, 1, 10, 10)


@pytest.mark.parametrize(
    ("array", "attributes", "turn"),
    [
        (BYTES.astype("u1"), (), 256),
        ((BYTES << 8).astype("u2"), (), 65536),  # 8 bits at the top are the same phases
        (BYTES.astype("u2"), (None, 8), 256),
        ((BYTES << 8).astype("u2"), (None, 8), 65536),
        ((BYTES * 257).astype("u2"), (None, 8), 65535 * 256 / 255),
        ((BYTES % 2 * 255).astype("u1"), (None, 1), 510),
        ((BYTES % 2).astype(bool), (), 2),
        (BYTES.astype("i8"), (None, 10), 1024),
        (BYTES.astype("f4"), (None, 8), 256),
        (BYTES.astype("i2"), ("degrees",), 360),
        (RAMP * 250, ("levels", 8), 256),
        (np.array([[[[0, 8, 16]]]], "u1"), ("levels", 5), 32),
        (np.array([[[[0, 8, 16]]]], "u1"), (None, 8), 256),
        (0 * BYTES, (), 1),
    ],
)
def test_levels(array, attributes, turn):
    np.testing.assert_allclose(radians(array, *attributes), array * (TURN / turn), atol=1e-12)


@pytest.mark.parametrize("bits", [4, 10, 12])
@pytest.mark.parametrize("rounded", [np.round, np.floor])
def test_stretched_levels_are_found(bits, rounded):
    """Programs stretch 12 bits to 16 by rounding or truncation."""
    levels = np.arange(2**bits).reshape(1, 1, -1, 4)
    stretched = rounded(levels * (65535 / (2**bits - 1)) + 1e-9).astype("u2")
    with pytest.raises(InvalidInput, match=rf"stretched to 0 to 65535 \(--bits {bits}\)"):
        radians_of(stretched)
    np.testing.assert_allclose(radians(stretched, None, bits), levels * (TURN / 2**bits), atol=1e-12)


@pytest.mark.parametrize(
    ("array", "attributes", "says"),
    [
        (BYTES.astype("u2"), (), "Give --bits 8 for 256 levels or --bits 16 for 65536"),
        (BYTES.astype("u2"), (None, 6), "up to 255, and --bits 6 has 0 to 63. Give --bits 8 or more"),
        ((BYTES * 257).astype("u2"), (), "The levels can be 8 bits stretched to 0 to 65535"),
        (BYTES, (), r"int64 up to 255 can be levels of any number of bits \(--bits N\), or degrees"),
        (BYTES - 5, (), "The whole numbers go down to -5, and levels start at"),
        (BYTES + 65400, (None, 8), "The levels go up to 65655, and an SLM has at"),
        (np.array([[[[0, 8, 16]]]], "u1"), (None, 5), "5 bits as they are .* or the top 5 bits of 8"),
        (BYTES > 3, (None, 8), "true or false have one bit"),
        (BYTES, (None, 17), "Expected 1 to 16 bits, got 17. Give those of the"),
        (BYTES * 1.0, (None, 4), "go from 0 to 255, and --bits 4 has 0 to 15"),
        (RAMP * 255, (None, 8), "Levels of --bits are whole numbers, the phases are not. Omit"),
        (RAMP, ("levels",), "Levels of a floating-point type may have any number of bits"),
        (RAMP, ("radians", 8), "Phases in radians have no bits. Omit --bits, or give --units"),
        (RAMP, ("gradians",), "Expected units radians, turns, pi, degrees, levels, got"),
    ],
)
def test_what_is_refused(array, attributes, says):
    with pytest.raises(InvalidInput, match=says):
        radians_of(array, *attributes)


def test_words_of_files():
    assert [parse_units(text) for text in ("radians; wrapped", "Rad", "waves", "deg", "m", 3)] == [
        "radians",
        "radians",
        "turns",
        "degrees",
        None,
        None,
    ]
