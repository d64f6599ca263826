"""Sequences: their pictures, order and packing."""

import itertools
import math
import weakref
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from holopath_addon import engine
from holopath_addon.slm import Calibration, Response, Sequence
from holopath_addon.slm import sequence as sequence_module
from tests.slm.refusals import refused

ORDERS = ["".join(order) for order in itertools.permutations("RGB")]
WAVELENGTHS = (640e-9, 516.5e-9, 455.4e-9)
EACH = {"time": 1, "color": 3, "bits": 24, "plm-067": 24, "plm-047": 24, "slm-200": 1, "slm-200-120hz": 2}
BITS = {"time": 8, "color": 8, "bits": 1, "plm-067": 4, "plm-047": 4, "slm-200": 10, "slm-200-120hz": 10}

quick = settings(max_examples=60, database=None)


def code(index, frame, wavelength):
    """A level that tells which hologram it is from."""
    return 1 + 60 * index + 3 * frame + wavelength


def hologram(frames=2, wavelengths=3, size=(4, 3), index=0, value=code):
    """One whose levels of 8 bits say `value(index, frame, wavelength)` everywhere."""
    width, height = size
    data = np.empty((frames, wavelengths, height, width), np.float32)
    for frame, wavelength in np.ndindex(frames, wavelengths):
        data[frame, wavelength] = value(index, frame, wavelength) * (2 * math.pi / 256)
    grid = engine.Hologram(width, height, 8e-6, WAVELENGTHS[:wavelengths], depth_far=1e-3, depth_near=2e-3)
    camera = engine.Camera(np.eye(4), 0.5)
    return engine.PhaseHologram(data, grid, camera, 0.5, "dpac", (1.0,) * wavelengths)


def made(count=1, packing="time", frames=2, wavelengths=3, **options):
    """A sequence of coded holograms."""
    holograms = [hologram(frames, wavelengths, index=index) for index in range(count)]
    return Sequence(holograms, Calibration(bits=BITS[packing]), packing, **options)


def test_micromirrors_on_a_monitor():
    """PLMs take twice the pixels along each side, and need a calibration, as their levels are uneven."""
    coded = hologram(2, 3, value=lambda *_: 16)
    with refused("uneven. Give its calibration"):
        Sequence([coded], None, "plm-067")
    sequence = Sequence([coded], Calibration(bits=4), "plm-067")
    assert sequence.size == (8, 6)
    sequence.fit(12, 10, 8, "the monitor")
    assert sequence.picture(0).pixels.shape == (10, 12, 3) and sequence.calibration.size == (6, 5)
    with refused("12 x 9 is not a multiple"):
        sequence.fit(12, 9)
    with refused("for a device of 6 x 5 pixels, this one has 5 x 5"):
        Sequence([coded], Calibration(bits=4, size=(6, 5)), "plm-067").fit(10, 10)


# A round


@quick
@given(
    frames=st.integers(1, 12),
    wavelengths=st.integers(1, 3),
    packing=st.sampled_from(sorted(EACH)),
    count=st.integers(1, 3),
    repeats=st.integers(1, 3),
)
@example(8, 1, "color", 1, 1)
def test_a_round_is_balanced(frames, wavelengths, packing, count, repeats):
    """Every frame and wavelength equally often, in the fewest pictures, one after the other."""
    small = [hologram(frames, wavelengths, (1, 1), index) for index in range(count)]
    sequence = Sequence(small, Calibration(bits=BITS[packing]), packing, repeats=repeats)
    pictures = [sequence.picture(number) for number in range(len(sequence))]
    of_one = len(pictures) // (count * repeats)
    assert of_one * EACH[packing] == math.lcm(frames * wavelengths, EACH[packing])
    parts = [part for picture in pictures for part in picture.parts]
    shown = Counter(parts)
    assert len(shown) == frames * wavelengths and len(set(shown.values())) == 1
    assert all(len(picture.parts) == EACH[packing] for picture in pictures)
    for slot, part in enumerate(parts):
        assert part == (slot // wavelengths % frames, slot % wavelengths)


def test_bits_of_a_packing_are_those_of_the_levels():
    """Packings of bits need a monitor of 8 bits per channel, for any levels."""
    sequence = Sequence([hologram(value=lambda *_: 255)], None, "R7-0,G7-4")
    sequence.fit(6, 5, 8, "the monitor")
    assert sequence.calibration.bits == 12
    picture = sequence.picture(0)
    assert picture.pixels.shape == (5, 6, 3) and picture.pixels.dtype == np.uint8
    level = 4080  # 255 of 256
    assert picture.pixels[2, 3].tolist() == [level >> 4, (level & 15) << 4, 0]


def test_eight_frames_in_threes_take_eight_pictures():
    sequence = made(frames=8, wavelengths=1, packing="color")
    assert len(sequence) == 8
    assert [part[0] for part in sequence.picture(2).parts] == [6, 7, 0]


@pytest.mark.parametrize(
    ("nanometers", "order", "note"),
    [
        ((640, 520, 455), "RGB", None),
        ((640,), "RGB", None),
        ((455, 520, 640), "RGB", "Pictures have 455 nm in red, 520 nm in green, 640 nm in blue"),
        ((455, 520, 640), "GRB", "Pictures have 455 nm in green, 520 nm in red, 640 nm in blue"),
        ((640, 520), "RGB", "the first picture has 640 nm in red, 520 nm in green, 640 nm in blue"),
    ],
)
def test_which_wavelength_is_in_which_channel(nanometers, order, note):
    coded = hologram(1, len(nanometers))
    coded = replace(coded, hologram=replace(coded.hologram, wavelengths=tuple(n * 1e-9 for n in nanometers)))
    assert Sequence([coded]).notes == []
    sequence = Sequence([coded], packing="color", order=order)
    if note is None:
        assert sequence.notes == []
        return
    assert note in sequence.notes[0]
    pixels, parts = sequence.picture(0).pixels[0, 0], sequence.picture(0).parts
    for channel, color in enumerate(("red", "green", "blue")):
        k = next(k for _, k in parts if pixels[channel] == code(0, 0, k))
        assert f"{nanometers[k]} nm in {color}" in note


@pytest.mark.parametrize("packing", ["time", "color"])
@pytest.mark.parametrize("order", ["RGB", "BRG"])
def test_pictures_hold_what_their_parts_say(packing, order):
    """Counted through frames, repeats, holograms and rounds, each pixel has its hologram's level."""
    sequence = made(3, packing, frames=4, wavelengths=2, order=order, repeats=2)
    each = EACH[packing]
    of_one = math.lcm(8, each) // each
    assert len(sequence) == 3 * 2 * of_one
    for number in [*range(len(sequence) + 5), 10**12 * len(sequence) + 7]:
        index, slot = number // (2 * of_one) % 3, number % of_one * each
        parts = [((slot + n) // 2 % 4, (slot + n) % 2) for n in range(each)]
        levels = [code(index, *part) for part in parts]
        picture = sequence.picture(number)
        assert list(picture.parts) == parts
        if each == 3:
            levels = [levels[order.index(channel)] for channel in "RGB"]
        assert (picture.pixels.reshape(12, each) == levels).all()


def test_bits_of_twenty_four_holograms():
    """One bit each: those of the frames whose number is odd."""
    data = hologram(8, 3, value=lambda index, frame, wavelength: 128 * ((frame + wavelength) % 2))
    sequence = Sequence([data], Calibration(bits=1), "bits")
    assert len(sequence) == 1
    bits = [(frame + wavelength) % 2 for frame in range(8) for wavelength in range(3)]
    expected = [sum(bit << n for n, bit in enumerate(bits[8 * c : 8 * c + 8])) for c in range(3)]
    assert (sequence.picture(0).pixels == expected).all()


def test_equal_keys_are_equal_pictures():
    """Keys are the same in repeats and rounds, and differ between holograms and places."""
    sequence = made(2, frames=2, wavelengths=1, repeats=3)
    pictures = [sequence.picture(number) for number in range(2 * len(sequence))]
    for a, b in itertools.combinations(pictures, 2):
        assert (a.key == b.key) == np.array_equal(a.pixels, b.pixels)
    assert len({picture.key for picture in pictures}) == 4


def test_ten_bits():
    data = hologram(1, 1, value=lambda *_: 100.25)  # of 256: 401 of 1024
    picture = Sequence([data], Calibration(bits=10)).picture(0)
    assert picture.pixels.dtype == np.uint16 and (picture.pixels == 401).all()


def test_each_wavelength_has_its_own_response():
    """A turn at 455.4 nm is 455.4 / 640 turns at 640 nm: it takes the higher a level."""
    data = hologram(1, 3, value=lambda *_: 64)
    sequence = Sequence([data], Calibration(responses=(Response(455.4e-9),)))
    found = [int(sequence.picture(k).pixels[0, 0]) for k in range(3)]
    assert found == [round(64 * w / 455.4e-9) for w in WAVELENGTHS]


# What is kept


@pytest.mark.parametrize("room", [0, 1, 3])
def test_memory_is_bounded(room, monkeypatch):
    """Only so many pictures live at a time, and each is right."""
    sequence = made(3, frames=4, wavelengths=1)
    size = sequence.picture(0).pixels.nbytes
    monkeypatch.setattr(sequence_module, "MAX_CACHE_BYTES", room * size + size // 2)
    alive = []
    for number in itertools.chain(range(30), [7, 7, 0, 8, 7, 3]):
        picture = sequence.picture(number)
        assert (picture.pixels == code(number // 4 % 3, number % 4, 0)).all()
        if all(other() is not picture for other in alive):
            alive.append(weakref.ref(picture))
        del picture
        assert sum(other() is not None for other in alive) <= max(room, 1)


def test_what_fits_is_made_once(monkeypatch):
    """A second round costs nothing."""
    sequence, calls = made(2, frames=3, wavelengths=1), []
    levels = Calibration.levels
    monkeypatch.setattr(Calibration, "levels", lambda *words: calls.append(1) or levels(*words))
    for number in range(3 * len(sequence)):
        sequence.picture(number)
    assert len(calls) == len(sequence) == 6


def test_in_several_threads(monkeypatch):
    """Several threads get the pictures of one thread, within the same bound of memory."""
    sequence = made(3, frames=5, wavelengths=2)
    monkeypatch.setattr(sequence_module, "MAX_CACHE_BYTES", 4 * sequence.picture(0).pixels.nbytes)
    numbers = np.random.default_rng(5).integers(0, 300, 600).tolist()
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda number: sequence.picture(number).pixels[0, 0], numbers))
    for number, level in zip(numbers, found, strict=True):
        assert level == code(number // 10 % 3, number // 2 % 5, number % 2)
    assert sum(picture.pixels.nbytes for picture in sequence._cache.values()) == sequence._bytes
    assert sequence._bytes <= sequence_module.MAX_CACHE_BYTES


# The device's size


def test_fit_puts_the_hologram_in_the_middle():
    sequence = made(frames=1, wavelengths=1)
    assert sequence.size == (4, 3) and sequence.picture(0).pixels.shape == (3, 4)
    sequence.fit(8, 7)
    assert sequence.size == (8, 7)
    expected = np.zeros((7, 8), int)
    expected[2:5, 2:6] = code(0, 0, 0)
    np.testing.assert_array_equal(sequence.picture(0).pixels, expected)
    sequence.fit(8, 7)
    sequence.fit(4, 3)  # another device
    np.testing.assert_array_equal(sequence.picture(0).pixels, expected[2:5, 2:6])


def test_fit_with_a_size_of_the_calibration():
    sequence = Sequence([hologram()], Calibration(size=(6, 5)))
    assert sequence.size == (6, 5)
    sequence.fit(6, 5)
    with refused("6 x 5 pixels, this one has 4 x 3"):
        sequence.fit(4, 3)
    assert sequence.picture(0).pixels.shape == (5, 6)


def test_fit_to_what_is_smaller_is_refused_and_changes_nothing():
    sequence = made()
    with refused("4 x 3"):
        sequence.fit(3, 3)
    assert sequence.size == (4, 3) and sequence.picture(0).pixels.shape == (3, 4)


def test_fit_where_the_correction_is_of_another_size():
    calibration = Calibration(correction=np.zeros((3, 4)), correction_wavelength=640e-9)
    sequence = Sequence([hologram()], calibration)
    with refused("correction of the device's 6 x 5 pixels, got 4 x 3"):
        sequence.fit(6, 5)
    assert sequence.picture(0).pixels.shape == (3, 4)


# Refusals


@pytest.mark.parametrize(
    ("holograms", "options", "says"),
    [
        ([], {}, "no hologram"),
        ([{}], {"packing": "magic"}, "time, color, bits"),
        ([{}], {"order": "RGG"}, "order of the channels R, G and B"),
        ([{}], {"order": "RGBA"}, "order of the channels R, G and B"),
        ([{}], {"order": ""}, "order of the channels R, G and B"),
        ([{}], {"repeats": 0}, "at least 1"),
        ([{}, {"size": (4, 4)}], {}, "Hologram 1 differs from the first"),
        ([{}, {}, {"frames": 3}], {}, "Hologram 2 differs from the first"),
        ([{}, {"wavelengths": 2}], {}, "Hologram 1 differs from the first in size or wavelengths"),
        ([{}], {"packing": "bits", "calibration": Calibration()}, "at most 1 bit, got 8"),
        ([{}], {"packing": "color", "calibration": Calibration(bits=9)}, "at most 8 bits, got 9"),
        ([{}], {"packing": "slm-200", "calibration": Calibration()}, "levels of 10 bits, got 8"),
        (
            [{}],
            {"packing": "slm-200", "calibration": Calibration(bits=12)},
            "levels of 10 bits, got 12",
        ),
        ([{}], {"packing": "R7-5,R5-0"}, "name R5 twice"),
        ([{}], {"packing": "slm-200", "order": "GBR"}, "names its channels itself. Omit the order GBR"),
    ],
)
def test_refusals(holograms, options, says):
    with refused(says):
        Sequence([hologram(**words) for words in holograms], **options)


def test_other_wavelengths_of_equal_number():
    other = hologram(wavelengths=1)
    grid = engine.Hologram(4, 3, 8e-6, (532e-9,), depth_far=1e-3, depth_near=2e-3)
    other = engine.PhaseHologram(other.data, grid, other.camera, 0.5, "dpac", (1.0,))
    with refused("Hologram 1"):
        Sequence([hologram(wavelengths=1), other])


def test_a_hologram_that_does_not_fit_its_calibration():
    with refused("only 3 x 3"):
        Sequence([hologram()], Calibration(size=(3, 3))).picture(0)


def test_bits_of_the_device():
    """Levels span the device's without a calibration: half a turn is half of them."""
    half = hologram(1, 1)
    half.data[:] = np.pi
    for bits in (4, 8, 10):
        sequence = Sequence([half])
        sequence.fit(4, 3, bits)
        picture = sequence.picture(0)
        assert picture.bits == bits and (picture.pixels == 2 ** (bits - 1)).all()
    packed = Sequence([half], packing="bits")
    packed.fit(4, 3, 8)
    assert packed.picture(0).bits == 1 and (packed.picture(0).pixels == 255).all()
