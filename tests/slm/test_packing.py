"""Holograms in a picture: in channels, in bits, on electrodes."""

import itertools

import numpy as np
import pytest

from holopath_addon.slm import PACKINGS, packing_of
from holopath_addon.slm.packing import pack, unpack
from tests.slm.refusals import refused

ORDERS = ["".join(order) for order in itertools.permutations("RGB")]


@pytest.mark.parametrize("order", ORDERS)
def test_three_in_red_green_and_blue(order):
    levels = list(np.random.default_rng(1).integers(0, 256, (3, 4, 5), np.uint8))
    picture = pack(levels, "color", order)
    assert picture.shape == (4, 5, 3) and picture.dtype == np.uint8
    for place, level in enumerate(levels):
        np.testing.assert_array_equal(picture[..., {"R": 0, "G": 1, "B": 2}[order[place]]], level)


@pytest.mark.parametrize("order", ORDERS)
def test_twenty_four_in_bits(order):
    """Hologram n is bit n % 8 of the channel that is shown as the n // 8-th."""
    levels = list(np.random.default_rng(2).integers(0, 2, (24, 4, 5), np.uint8))
    picture = pack(levels, "bits", order)
    assert picture.shape == (4, 5, 3) and picture.dtype == np.uint8
    for y, x in np.ndindex(4, 5):
        numbers = dict.fromkeys("RGB", 0)
        for n in range(24):
            numbers[order[n // 8]] += int(levels[n][y, x]) * 2 ** (n % 8)
        assert picture[y, x].tolist() == [numbers[channel] for channel in "RGB"]


@pytest.mark.parametrize("packing", PACKINGS)
@pytest.mark.parametrize("order", ORDERS)
def test_unpack_is_the_reverse(packing, order):
    kind = packing_of(packing)
    bits = min(kind.max_bits, 12)
    levels = list(np.random.default_rng(3).integers(0, 2**bits, (kind.each, 4, 5), np.uint16))
    levels = levels if bits > 8 else [level.astype(np.uint8) for level in levels]
    found = unpack(pack(levels, packing, order), packing, order)
    np.testing.assert_array_equal(found, levels)


def test_unpacks_any_picture():
    """Bit by bit, of a picture that `pack` did not make."""
    picture = np.random.default_rng(4).integers(0, 256, (3, 2, 3), np.uint8)
    found = unpack(picture, "bits", "BRG")
    assert len(found) == 24
    for n, level in enumerate(found):
        channel = [2, 0, 1][n // 8]
        expected = [[(int(pixel[channel]) // 2 ** (n % 8)) % 2 for pixel in row] for row in picture]
        np.testing.assert_array_equal(level, expected)


def memory_of(height):
    """M3 to M0 of a mirror's height 0 to 15, as the software of those who use DLP6750Q1EVM computes them."""
    odd = height == 3
    rest = height != 4
    return (
        int(height >= 8),
        int(odd or (rest and height % 8 >= 4)),
        int(odd or (rest and height % 4 < 2)),
        int(odd or (rest and height % 2 == 0)),
    )


@pytest.mark.parametrize("order", ["RGB", "GBR"])
def test_twenty_four_for_micromirrors(order):
    """Two by two electrodes a mirror: M1 M3 over M0 M2, then left and right change places; by another's formula."""
    levels = list(np.random.default_rng(5).integers(0, 16, (24, 3, 5), np.uint8))
    levels[7][:] = np.arange(15).reshape(3, 5) + 1  # all heights are among them
    picture = pack(levels, "plm-067", order)
    assert picture.shape == (6, 10, 3) and picture.dtype == np.uint8
    for n, level in enumerate(levels):
        plane = picture[..., "RGB".index(order[n // 8])] >> (n % 8) & 1
        for y, x in np.ndindex(3, 5):
            m3, m2, m1, m0 = memory_of(int(level[y, x]))
            right = 10 - 2 * x  # the mirror's last column in the picture, and one more
            assert plane[2 * y : 2 * y + 2, right - 2 : right].tolist() == [[m3, m1], [m2, m0]]


def test_micromirrors_of_the_smaller_device():
    """M2 M3 over M0 M1, nothing changes places."""
    levels = [np.arange(16, dtype=np.uint8).reshape(4, 4)] * 24
    picture = pack(levels, "plm-047")
    assert set(np.unique(picture)) == {0, 255}
    for y, x in np.ndindex(4, 4):
        m3, m2, m1, m0 = memory_of(4 * y + x)
        assert (picture[2 * y : 2 * y + 2, 2 * x : 2 * x + 2, 1] // 255).tolist() == [[m2, m3], [m0, m1]]


def test_what_is_packed_is_not_changed():
    levels = [np.full((2, 2), 7, np.uint8) for _ in range(3)]
    pack(levels, "color")
    assert all((level == 7).all() for level in levels)


def test_ten_bits_of_an_slm_200():
    """Santec's figure 3.6-1: R7 R6 R5 G7 G6 G5 B7 B6 B5 B4, and the lower half of each for the frame after it."""
    one, two = (np.arange(1024, dtype=np.uint16).reshape(32, 32) for _ in range(2))
    two = two[::-1].copy()
    alone, both = pack([one], "slm-200"), pack([one, two], "slm-200-120hz")
    for y, x in np.ndindex(32, 32):
        high, low = f"{one[y, x]:010b}", f"{two[y, x]:010b}"
        assert [f"{number:08b}" for number in alone[y, x]] == [
            high[:3] + "00000",
            high[3:6] + "00000",
            high[6:] + "0000",
        ]
        expected = [f"{high[:3]}0{low[:3]}0", f"{high[3:6]}0{low[3:6]}0", high[6:] + low[6:]]
        assert [f"{number:08b}" for number in both[y, x]] == expected


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("magic", "no packing magic: choose one of time, color.*or name the bits"),
        ("", "no packing"),
        ("R7-5;G7", "Expected the bits of a picture's channels"),
    ],
)
def test_packings_that_are_none(name, says):
    with refused(says):
        packing_of(name)
