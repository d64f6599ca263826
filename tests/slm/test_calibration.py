"""Calibration: from phases to a device's levels and back, and its file."""

import json
import math
import re

import hypothesis.extra.numpy as hypothesis_numpy
import numpy as np
import pytest
import scipy.fft
from hypothesis import example, given, settings
from hypothesis import strategies as st

from holopath_addon import engine
from holopath_addon.engine.encoding.shown_light import ShownLight
from holopath_addon.engine.scene import variants
from holopath_addon.engine.waves.display_model import DisplayModel
from holopath_addon.engine.waves.modulator import gray_levels
from holopath_addon.engine.waves.propagation import transfer_function
from holopath_addon.slm import Calibration, Response, Sensor
from holopath_addon.slm.calibration import colors_of, response_files
from tests.slm.refusals import refused

TURN = 2 * math.pi
STEP = TURN / 65536  # of the table from phase to level
RED, GREEN, BLUE = 640e-9, 516.5e-9, 455.4e-9
FORMAT = "HoloPath SLM calibration"

quick = settings(max_examples=30, database=None)


def apart(a, b):
    """Distance of two phases around the circle, radians."""
    difference = np.mod(np.subtract(a, b), TURN)
    return np.minimum(difference, TURN - difference)


def some_phases(shape=(64, 64), seed=1):
    """Any in [0, 2 pi), and those at its ends."""
    phases = (np.random.default_rng(seed).random(shape) * TURN).astype(np.float32)
    phases = np.minimum(phases, np.nextafter(np.float32(TURN), np.float32(0)))
    phases.flat[:4] = 0, np.nextafter(np.float32(TURN), np.float32(0)), math.pi, 1e-7
    return phases


# Levels


@pytest.mark.parametrize("bits", [1, 2, 4, 8, 10, 16])
def test_default_is_even_steps_of_a_turn(bits):
    phases = some_phases()
    levels = Calibration(bits=bits).levels(phases, GREEN)
    assert levels.dtype == (np.uint8 if bits <= 8 else np.uint16)
    np.testing.assert_array_equal(levels, gray_levels(phases, bits))
    assert apart(levels.astype(float) * TURN / 2**bits, phases).max() <= math.pi / 2**bits + 1e-6


def curve_of(kind, bits):
    """A measured response in 33 points, radians, not wrapped."""
    top = 2**bits - 1
    at = np.unique(np.round(np.linspace(0, top, 33)))
    share = at / max(top, 1)
    phases = {
        "1.6 turns": 1.6 * TURN * share**1.3,
        "0.7 turns, falling": 1.0 - 0.7 * TURN * share**0.8,
        "up and down": 0.9 * TURN * np.sin(2.5 * share),
        "1.05 turns, in waves": 1.05 * TURN * share + 0.4 * np.sin(9 * share),
    }[kind]
    return tuple(zip(at.tolist(), phases.tolist(), strict=True))


def phases_by_hand(response, bits, wavelength):
    """Phase of each level, by the formula: 2 pi r n / N or straight lines between points, times ratio."""
    shown = []
    for level in range(2**bits):
        if response.curve is None:
            phase = TURN * response.range * level / 2**bits
        else:
            (a, low), (b, high) = next(
                (p, q)
                for p, q in zip(response.curve, response.curve[1:], strict=False)
                if p[0] <= level <= q[0]
            )
            phase = low + (high - low) * (level - a) / (b - a)
        shown.append(phase * response.wavelength / wavelength)
    return np.array(shown)


def used(shown):
    """The phases of those levels that count: of a turn, if these are 32 or more."""
    above = shown - shown.min() if shown[-1] >= shown[0] else shown.max() - shown
    return shown[above < TURN - 1e-9] if (above < TURN - 1e-9).sum() >= 32 else shown


@pytest.mark.parametrize("bits", [1, 4, 8, 10])
@pytest.mark.parametrize("wavelength", [GREEN, BLUE])
@pytest.mark.parametrize(
    "what", [0.7, 1.0, 1.6, "1.6 turns", "0.7 turns, falling", "up and down", "1.05 turns, in waves"]
)
def test_levels_are_the_nearest_there_are(what, bits, wavelength):
    """The nearest of all levels is chosen, up to a step of the table."""
    curve = curve_of(what, bits) if isinstance(what, str) else None
    response = Response(GREEN, 1.0 if curve else what, curve)
    phases = some_phases((40, 40))
    levels = Calibration(bits=bits, responses=(response,)).levels(phases, wavelength)
    shown = phases_by_hand(response, bits, wavelength)
    best = np.min([apart(phase, phases) for phase in used(shown)], axis=0)
    assert (apart(shown[levels], phases) - best).max() <= STEP + 2e-6


@pytest.mark.parametrize("kind", ["even", "bent", "falling"])
def test_a_panel_of_more_than_a_turn_jumps_only_where_the_phase_does(kind):
    """Made for 640 nm and used at 430 nm, say: levels of a smooth phase go with it, whatever rounds nearer."""
    bent = curve_of("1.6 turns", 8)
    falling = tuple((level, 1.0 - phase) for level, phase in bent)
    response = Response(GREEN, 1.48, {"even": None, "bent": bent, "falling": falling}[kind])
    begun = 1.0 if kind == "falling" else 0.0
    ramp = begun + np.linspace(0.1, TURN - 0.1, 2000, dtype=np.float32)[None]
    levels = Calibration(responses=(response,)).levels(np.mod(ramp, TURN), GREEN).astype(int)
    assert np.abs(np.diff(levels)).max() <= 2 and np.ptp(levels) > 120


def test_a_response_that_was_written_modulo_a_turn():
    """It is that of a panel which goes on; few or irregular phases are taken as they are."""
    going_on = np.linspace(0.3, 1.4 * TURN, 33)
    at = np.linspace(0, 255, 33)
    shown, target = (
        Response(GREEN, curve=tuple(zip(at, phases, strict=True))).phases(8)
        for phases in (np.mod(going_on, TURN), going_on)
    )
    np.testing.assert_allclose(shown, target, atol=1e-9)
    few = Response(GREEN, curve=((0, 0.0), (128, 5.0), (255, 6.2)))
    assert few.phases(8)[64] == pytest.approx(2.5)
    table = engine.Levels(np.mod(np.linspace(0, 1.4 * TURN, 256), TURN))
    assert len(table) == pytest.approx(256 / 1.4, abs=1)


@pytest.mark.parametrize("what", [0.7, 1.0, 1.6, "1.6 turns"])
@pytest.mark.parametrize("bits", [1, 4, 8])
def test_a_panel_whose_phase_falls(what, bits, tmp_path):
    """Level n of N shows less the more n is; a curve may say the same itself."""
    curve = curve_of(what, bits) if isinstance(what, str) else None
    response = Response(GREEN, 1.0 if curve else what, curve)
    falling, phases = Calibration(bits=bits, responses=(response,), falling=True), some_phases((40, 40))
    shown = -phases_by_hand(response, bits, BLUE)
    levels = falling.levels(phases, BLUE)
    best = np.min([apart(phase, phases) for phase in used(shown)], axis=0)
    assert (apart(shown[levels], phases) - best).max() <= STEP + 2e-6
    assert apart(falling.shown_phases(levels, BLUE, (40, 40)), shown[levels]).max() < 1e-5
    falling.save(tmp_path / "falling.json")
    again = Calibration.load(tmp_path / "falling.json")
    assert again.falling and not again.plain
    np.testing.assert_array_equal(again.levels(phases, BLUE), levels)
    if curve is not None:
        down = Response(GREEN, curve=tuple((level, -phase) for level, phase in curve))
        np.testing.assert_array_equal(Calibration(bits=bits, responses=(down,)).levels(phases, BLUE), levels)
        with refused("falls already"):
            Calibration(bits=bits, responses=(down,), falling=True)


def test_falling_is_the_conjugate_and_not_the_complement():
    """0 stays level 0: a driver that shows 255 less the level would be off by one."""
    quarters = np.array([[0, 0.25, 0.5, 0.75]], np.float32) * TURN
    np.testing.assert_array_equal(Calibration(falling=True).levels(quarters, GREEN), [[0, 192, 128, 64]])


def test_a_response_in_a_table_beside_the_file(tmp_path):
    (tmp_path / "green.csv").write_text("level;phase (pi)\n0;0\n128;1,1\n255;2,2\n")
    data = {"format": FORMAT, "responses": [{"wavelength_nm": 516.5, "file": "green.csv"}]}
    (tmp_path / "mine.json").write_text(json.dumps(data))
    assert response_files(tmp_path / "mine.json")["table 0"] == tmp_path / "green.csv"
    shown = Calibration.load(tmp_path / "mine.json").phases(516.5e-9)
    assert shown[128] == pytest.approx(1.1 * math.pi) and shown[255] == pytest.approx(2.2 * math.pi)


def test_less_than_a_turn():
    """Unreachable phases become the nearer end: with 0.7 turns, 0.84 becomes the top level and 0.86 level 0."""
    calibration = Calibration(bits=8, responses=(Response(GREEN, 0.7),))
    turns = np.array([[0, 0.35, 0.69, 0.84, 0.86, 0.99]], np.float32)
    np.testing.assert_array_equal(calibration.levels(turns * TURN, GREEN), [[0, 128, 252, 255, 0, 0]])


def test_phase_goes_as_one_over_wavelength():
    """A panel of 1.25 turns at 500 nm has one at 625 nm, half a turn at 1250 nm."""
    response = Response(500e-9, 1.25)
    calibration = Calibration(bits=8, responses=(response,))
    phases = np.arange(256, dtype=np.float32)[None] * np.float32(TURN / 256)
    np.testing.assert_array_equal(calibration.levels(phases, 625e-9), [range(256)])
    np.testing.assert_allclose(response.phases(8, 1250e-9), np.arange(256) * math.pi / 256, rtol=1e-12)
    curved = Response(500e-9, curve=((0, 0.5), (255, 0.5 + 4 * math.pi)))
    assert curved.phases(8, 1000e-9)[255] == pytest.approx(0.25 + 2 * math.pi)
    quarter = np.float32(0.25 * TURN)
    assert calibration.levels(np.array([[quarter]]), 1250e-9) == 128
    assert calibration.levels(np.array([[quarter]]), 500e-9) == round(0.25 * 256 / 1.25)


def test_nearest_measurement_is_taken():
    calibration = Calibration(responses=(Response(RED, 0.5), Response(BLUE, 2.0)))
    quarter = np.array([[0.25 * TURN]], np.float32)
    assert calibration.levels(quarter, RED) == 128
    # 2 turns at 455.4 nm: n / 256 * 2 * 455.4 / 470 = 0.25
    assert calibration.levels(quarter, 470e-9) == round(0.25 * 256 / 2 * 470 / 455.4)


# Correction


def test_correction_is_added_before_the_level_is_chosen():
    """A flat hologram: the levels are those of what lacks, scaled to the wavelength."""
    target = np.arange(64).reshape(8, 8)  # levels
    correction = target * (TURN / 256) * 450 / 633
    calibration = Calibration(correction=correction, correction_wavelength=633e-9)
    np.testing.assert_array_equal(calibration.levels(np.zeros((8, 8)), 450e-9), target)
    tilt = np.full((8, 8), TURN * 200 / 256, np.float32)
    np.testing.assert_array_equal(calibration.levels(tilt, 450e-9), (target + 200) % 256)


@pytest.mark.parametrize("what", [0.7, 1.6, "1.6 turns", "0.7 turns, falling"])
def test_correction_and_response_together(what):
    """Corrections of many turns and both signs work on panels of less or more than a turn."""
    curve = curve_of(what, 8) if isinstance(what, str) else None
    response = Response(GREEN, 1.0 if curve else what, curve)
    phases, correction = some_phases((24, 20)), np.random.default_rng(2).normal(size=(24, 20)) * 20
    calibration = Calibration(
        responses=(response,), correction=correction, correction_wavelength=RED, size=(20, 24)
    )
    shown = phases_by_hand(response, 8, BLUE)
    target = phases + correction.astype(np.float32) * RED / BLUE
    best = np.min([apart(phase, target) for phase in used(shown)], axis=0)
    assert (apart(shown[calibration.levels(phases, BLUE)], target) - best).max() <= STEP + 3e-5


# Where pixels land


@quick
@given(
    hologram=st.tuples(st.integers(1, 6), st.integers(1, 6)),
    margin=st.tuples(st.integers(0, 5), st.integers(0, 5)),
    flips=st.tuples(st.booleans(), st.booleans()),
    shift=st.tuples(st.integers(-9, 9), st.integers(-9, 9)),
    corrected=st.booleans(),
)
@example((2, 3), (4, 3), (True, False), (1, -2), True)
def test_where_each_pixel_lands(hologram, margin, flips, shift, corrected):
    """Pixel by pixel: mirrored, put into the middle, moved right and down; what is beside it has phase 0."""
    width, height = hologram
    across, down = width + margin[0], height + margin[1]
    numbers = np.arange(1, width * height + 1).reshape(height, width)
    correction = np.arange(across * down).reshape(down, across) * 3
    calibration = Calibration(
        size=(across, down),
        flip_x=flips[0],
        flip_y=flips[1],
        shift=shift,
        correction=correction * (TURN / 256) if corrected else None,
        correction_wavelength=GREEN if corrected else None,
    )
    expected, inside = np.zeros((down, across), int), 0
    for row in range(height):
        for column in range(width):
            x = (width - 1 - column if flips[0] else column) + (across - width) // 2 + shift[0]
            y = (height - 1 - row if flips[1] else row) + (down - height) // 2 + shift[1]
            if 0 <= x < across and 0 <= y < down:
                expected[y, x], inside = numbers[row, column], inside + 1
    phases = (numbers * (TURN / 256)).astype(np.float32)
    if not inside:
        with refused("off the device"):
            calibration.levels(phases, GREEN)
        return
    expected = (expected + correction * corrected) % 256
    np.testing.assert_array_equal(calibration.levels(phases, GREEN), expected)


@pytest.mark.parametrize("what", [1.0, 1.3, "1.6 turns", "1.05 turns, in waves"])
def test_seen_reverses_levels(what):
    """Phases come back as precisely as the levels allow; beyond the panel they are 0."""
    curve = curve_of(what, 8) if isinstance(what, str) else None
    rng = np.random.default_rng(3)
    calibration = Calibration(
        size=(30, 20),
        flip_x=True,
        flip_y=True,
        shift=(9, -4),
        responses=(Response(GREEN, 1.0 if curve else what, curve),),
        correction=rng.normal(size=(20, 30)) * 9,
        correction_wavelength=RED,
    )
    phases = some_phases((18, 28)) + np.float32(0.01)  # not 0, as what is beside the panel
    view = calibration.shown_phases(calibration.levels(phases, GREEN), GREEN, (18, 28))
    assert view.min() >= 0 and view.max() <= np.float32(TURN)
    # moved by 9 to the right of 1 pixel's margin, and mirrored: 8 columns lie beside it, the first ones
    there = np.zeros((18, 28), bool)
    there[: 18 - 3, 8:] = True  # by 4 up of 1
    assert not view[~there].any()
    steps = np.sort(np.mod(phases_by_hand(calibration.responses[0], 8, GREEN), TURN))
    widest = max(np.diff(steps).max(), TURN - steps[-1] + steps[0])
    assert apart(view, phases)[there].max() <= widest / 2 + STEP + 1e-4


def test_seen_by_the_formula():
    """Levels that no one computed: the response's phase less the correction."""
    rng = np.random.default_rng(4)
    levels, correction = rng.integers(0, 1024, (6, 5)), rng.normal(size=(6, 5))
    calibration = Calibration(
        bits=10, responses=(Response(GREEN, 1.2),), correction=correction, correction_wavelength=GREEN
    )
    expected = levels * 1.2 * TURN / 1024 * GREEN / RED - correction * GREEN / RED
    assert apart(calibration.shown_phases(levels, RED, (6, 5)), expected).max() < 1e-5


# Refusals


def test_hologram_larger_than_the_device():
    for size in ((7, 8), (8, 7)):
        with refused(f"8 x 8 pixels, the device only {size[0]} x {size[1]}"):
            Calibration(size=size).levels(np.zeros((8, 8)), GREEN)


@pytest.mark.parametrize(("curve", "bits"), [(((1, 0), (255, 6)), 8), (((0, 0), (254, 6)), 8)])
def test_curve_that_does_not_span_the_levels(curve, bits):
    with refused(f"from 0 to {2**bits - 1}, or give a range of {2**bits}/L instead"):
        Calibration(bits=bits, responses=(Response(GREEN, curve=curve),)).levels(np.zeros((2, 2)), GREEN)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"wavelength": 5.0}, "from 100 to 100000 nm"),
        ({"wavelength": math.nan}, "from 100 to 100000 nm"),
        ({"range": 0}, "have about 1"),
        ({"range": math.nan}, "have about 1"),
        ({"curve": ((0, 1),)}, "two or more pairs"),
        ({"curve": ((0, 1, 2), (1, 2, 3))}, "pairs"),
        ({"curve": ((0, 0), (255, math.nan))}, "pairs"),
        ({"curve": ((0, 0), (128, 1), (128, 2), (255, 6))}, "must increase"),
        ({"curve": ((255, 0), (0, 6))}, "must increase"),
        ({"curve": ((0, 0), (255, 360))}, "in radians"),
    ],
)
def test_responses_that_are_none(values, says):
    with refused(says):
        Response(**{"wavelength": GREEN} | values)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"bits": 0}, "1 to 16"),
        ({"bits": 17}, "1 to 16"),
        ({"size": (0, 5)}, "from 1 to 32768"),
        ({"correction": np.zeros((4, 4)), "size": (4, 5), "correction_wavelength": RED}, "4 x 5.*4 x 4"),
        ({"correction": np.zeros((4, 4))}, "lacks its wavelength"),
        ({"correction": np.full((4, 4), np.nan), "correction_wavelength": RED}, "finite"),
        ({"correction": np.zeros(4), "correction_wavelength": RED}, "one phase per pixel"),
        ({"correction": np.zeros((4, 4), complex), "correction_wavelength": RED}, "one phase per pixel"),
        ({"correction": np.full((4, 4), 1e30), "correction_wavelength": RED}, "finite correction"),
        ({"shift": (1 << 20, 0)}, "at most 32768 pixels"),
        ({"correction": np.ones((4, 4)), "correction_wavelength": 0.0}, "wavelength"),
        ({"correction": np.ones((4, 4)), "correction_wavelength": math.nan}, "wavelength"),
        ({"correction": np.ones((4, 4)), "correction_wavelength": 633.0}, "wavelength"),
    ],
)
def test_calibrations_that_are_none(values, says):
    with refused(says):
        Calibration(**values)


def test_correction_of_another_size_than_what_is_shown():
    calibration = Calibration(correction=np.zeros((4, 4)), correction_wavelength=RED)
    with refused("4 x 4 pixels, the hologram 5 x 4"):
        calibration.levels(np.zeros((4, 5)), GREEN)


# The file

finite = st.floats(-1e3, 1e3)
wavelengths = st.floats(200e-9, 2000e-9)


@st.composite
def responses(draw, bits):
    curve = None
    if draw(st.booleans()):
        top = 2**bits - draw(st.booleans())  # the last level, or a whole turn after it
        at = {-1, top, *draw(st.lists(st.floats(-1, top), max_size=4))}
        curve = tuple((level, draw(st.floats(-125, 125))) for level in sorted(at))
    return Response(draw(wavelengths), draw(st.floats(0.05, 20)), curve)


@st.composite
def calibrations(draw):
    size = draw(st.none() | st.tuples(st.integers(1, 5), st.integers(1, 5)))
    correction = at = None
    if draw(st.booleans()):
        shape = size[::-1] if size else (3, 2)
        elements = st.floats(-(2**20), 2**20, width=32)
        correction, at = (
            draw(hypothesis_numpy.arrays(np.float32, shape, elements=elements)),
            draw(wavelengths),
        )
    bits = draw(st.integers(1, 16))
    return Calibration(
        draw(st.text('Pluto 2µ"\\\n漢', max_size=9)),
        bits,
        size,
        draw(st.booleans()),
        draw(st.booleans()),
        draw(st.tuples(st.integers(-2000, 2000), st.integers(-2000, 2000))),
        tuple(draw(st.lists(responses(bits), max_size=3))),
        correction,
        at,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("calibration")


def test_round_trip(folder):
    @quick
    @given(calibrations())
    def check(calibration):
        path = folder / "device.json"
        calibration.save(path)
        found = Calibration.load(path)
        for name in ("device", "bits", "size", "flip_x", "flip_y", "shift"):
            assert getattr(found, name) == getattr(calibration, name), name
        assert len(found.responses) == len(calibration.responses)
        for a, b in zip(found.responses, calibration.responses, strict=True):
            assert (a.range, a.curve) == (b.range, b.curve)
            assert a.wavelength == pytest.approx(b.wavelength, rel=1e-12)
        if calibration.correction is None:
            assert found.correction is None
        else:
            assert found.correction.dtype == np.float32
            assert found.correction.tobytes() == calibration.correction.tobytes()
            assert found.correction_wavelength == pytest.approx(calibration.correction_wavelength, rel=1e-12)

    check()
    assert {path.name for path in folder.iterdir()} == {"device.json", "device.correction.npy"}


def write(folder, **data):
    path = folder / "foreign.json"
    path.write_text(json.dumps({"format": FORMAT} | data), encoding="utf-8")
    return path


def test_written_by_hand(folder):
    found = Calibration.load(write(folder))
    assert (found.bits, found.size, found.shift, found.responses) == (8, None, (0, 0), ())
    found = Calibration.load(write(folder, responses=[{"wavelength_nm": 532}], bits=10))
    assert found.bits == 10 and found.responses[0] == Response(found.responses[0].wavelength)
    assert found.responses[0].wavelength == pytest.approx(532e-9)


@pytest.mark.parametrize("channels", [1, 3])
def test_correction_from_a_picture(channels, tmp_path):
    """A maker's correction is a picture with 256 levels per turn."""
    mi = variants.bitmaps()
    levels = np.arange(256, dtype=np.uint8).reshape(8, 32)
    picture = levels if channels == 1 else np.repeat(levels[..., None], 3, axis=-1)
    mi.Bitmap(picture).write(str(tmp_path / "flat.png"))
    found = Calibration.load(write(tmp_path, correction={"file": "flat.png", "wavelength_nm": 633}))
    np.testing.assert_allclose(found.correction, levels * (TURN / 256), rtol=1e-6)
    np.testing.assert_array_equal(found.levels(np.zeros((8, 32)), 633e-9), levels)


def test_a_correction_of_more_than_a_turn_is_a_picture_too(tmp_path):
    """Two turns of a bowl at 633 nm, wrapped as pictures are: at 450 nm it takes more turns, without a jump."""
    y, x = np.indices((48, 64)) - [[[24]], [[32]]]
    bowl = 2 * TURN * (x**2 + y**2) / 1600
    variants.bitmaps().Bitmap(np.uint8(np.round(bowl * 256 / TURN) % 256)).write(str(tmp_path / "bowl.png"))
    calibration = Calibration.load(write(tmp_path, correction={"file": "bowl.png", "wavelength_nm": 633}))
    levels = calibration.levels(np.zeros((48, 64)), 450e-9).astype(float)
    off = (levels - bowl * 633 / 450 * 256 / TURN + calibration.correction[24, 32]) % 256
    off = (off - off[24, 32] + 128) % 256 - 128
    assert np.abs(off).max() <= 2


def test_the_nearest_display_is_taken():
    """The nearer one of two models, calibrated a nanometer apart, counts."""
    models = [DisplayModel(nm * 1e-9, crosstalk=0.1 * nm / 638) for nm in (640, 638.5)]
    sensors = [Sensor((4, 4), 1.0, 0.0, 1.0, {})] * 2
    calibration = Calibration(models=tuple(models), sensors=tuple(sensors))
    for model in models:
        assert calibration.display([model.wavelength])[0] == model


def seen_by(scale, right, up):
    """A camera that has no lens, of a picture so much larger and so far aside, in half sides of the SLM."""
    turn = 0.1
    turned = np.array(
        [[math.cos(turn), -math.sin(turn), 0.02], [math.sin(turn), math.cos(turn), -0.01], [0, 0, 1]]
    )
    there = turned @ np.array([[scale, 0, right], [0, scale, -up], [0, 0, 1]])
    back = np.linalg.inv(there)
    return Sensor((80, 100), 1.0, 0.0, 1.0, {1e-3: tuple((back / back[2, 2]).ravel()[:8])})


def calibrated(tmp_path):
    """Red is 2 % too large and aside, blue too small and defocused, as a calibration has them."""
    models = DisplayModel(RED), DisplayModel(GREEN), DisplayModel(BLUE, aberrations=(2.0, *7 * (0.0,)))
    sensors = seen_by(1.02, 0.05, -0.02), seen_by(1.0, 0.0, 0.0), seen_by(0.98, 0.0, 0.0)
    Calibration(models=models, sensors=sensors).save(tmp_path / "slm.json")
    return tmp_path / "slm.json", models[-1]


def test_where_a_camera_saw_each_color(tmp_path):
    """Scale and place in terms of green; the distance is where a lens of phases has its focus by the same model."""
    path, blue = calibrated(tmp_path)
    pitch, side, focal = 8e-6, 64, 6e-3
    found = colors_of(path, engine.Hologram(side, side, pitch, (RED, GREEN, BLUE)))
    assert found["color_scale"] == pytest.approx((1.02, 1.0, 0.98), abs=1e-5)
    half = pitch * side / 2
    assert found["color_shift"][0] == pytest.approx((0.05 * half, -0.02 * half), abs=1e-8)
    assert np.abs(found["color_shift"][1:]).max() < 1e-8
    assert found["color_distance"][:2] == (0.0, 0.0)
    y, x = np.indices((side, side)) * pitch - (side - 1) / 2 * pitch
    lens = np.where(np.hypot(x, y) < half, -math.pi / (BLUE * focal) * (x**2 + y**2), 0.0)
    places = focal + np.linspace(-1e-3, 2e-3, 61)

    def focus(light):
        padded = scipy.fft.fft2(light, (256, 256))
        waves = (padded * transfer_function((256, 256), pitch, BLUE, z) for z in places)
        peaks = [np.abs(scipy.fft.ifft2(wave)).max() for wave in waves]
        return places[int(np.argmax(peaks))]

    shown = ShownLight(blue, (side, side), pitch).light(lens)
    ideal = ShownLight(DisplayModel(BLUE), (side, side), pitch).light(lens)
    assert focus(shown) - focus(ideal) == pytest.approx(found["color_distance"][2], rel=0.1)
    with refused("calibrated .*, got 500 nm"):
        colors_of(path, engine.Hologram(side, side, pitch, (RED, 500e-9)))


def test_pictures_that_are_no_correction(tmp_path):
    mi = variants.bitmaps()
    mi.Bitmap(np.zeros((4, 4), np.uint16)).write(str(tmp_path / "deep.png"))
    with refused("not a picture of 8 bits"):
        Calibration.load(write(tmp_path, correction={"file": "deep.png", "wavelength_nm": 633}))
    (tmp_path / "torn.png").write_bytes(b"\x89PNG\r\n\x1a\nno")
    with refused("cannot be read"):
        Calibration.load(write(tmp_path, correction={"file": "torn.png", "wavelength_nm": 633}))


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ({"format": "another"}, "another format"),
        ({"faling": True}, r"keys of the file \(.*\), got 'faling'. Write falling, or remove it"),
        ({"responses": [{"wavelength_nm": 532, "rnage": 0.9}]}, "keys of responses .*'rnage'. Write range"),
        ({"correction": {"file": "map.npy", "wavelength": 633}}, "keys of correction .*Write wavelength_nm"),
        ({"variation": {"map": "map.npy"}}, "keys of variation .*got 'map'. Remove it"),
        ({"displays": [{"wavelength_nm": 532, "crostalk": 0.2}]}, "Write crosstalk"),
        ({"displays": [{"wavelength_nm": 532, "camera": {"gian": 1}}]}, "keys of camera .*Write gain"),
        ({"format_version": 2}, "newer"),
        ({"bits": 99}, "1 to 16"),
        ({"size": [1, 2, 3]}, "cannot be read"),
        ({"responses": [{"range": 1}]}, "lacks 'wavelength_nm'"),
        ({"responses": [{"wavelength_nm": 0.5}]}, "from 100 to 100000 nm"),
        ({"correction": {"file": "map.npy"}}, "lacks 'wavelength_nm'"),
        ({"correction": {"wavelength_nm": 633}}, "lacks 'file'"),
        ({"correction": {"file": "missing.npy", "wavelength_nm": 633}}, "cannot be read"),
        ({"correction": {"file": "missing.png", "wavelength_nm": 633}}, "cannot be read"),
        ({"size": [5, 4], "correction": {"file": "map.npy", "wavelength_nm": 633}}, "3 x 2"),
        ({"correction": {"file": "map.npy", "wavelength_nm": 0}}, "wavelength"),
    ],
)
def test_files_that_are_refused(data, says, tmp_path):
    np.save(tmp_path / "map.npy", np.zeros((2, 3), np.float32))
    path = write(tmp_path, **data)
    with refused(says) as _:
        Calibration.load(path)
    with pytest.raises(engine.InvalidInput, match=re.escape(str(path))):
        Calibration.load(path)


@pytest.mark.parametrize(
    "content", [b"", b"no", b"\xff\xfe{", b"null", b"5", b'"x"', b"[]", b"{}", b"[" * 99999]
)
def test_foreign_files(content, tmp_path):
    (tmp_path / "x.json").write_bytes(content)
    with pytest.raises(engine.InvalidInput, match="x.json cannot be read"):
        Calibration.load(tmp_path / "x.json")
    with refused("cannot be read"):
        Calibration.load(tmp_path / "missing.json")


def test_a_table_or_a_slip_in_place_of_a_calibration(tmp_path):
    """A table of levels is told from JSON with a slip, whose place is named."""
    for name, content, says in (
        ("lut.txt", "0 0\n1 0.02\n", "a table of levels goes into a calibration"),
        ("slip.json", '{\n"format" 1}', "line 2"),
    ):
        (tmp_path / name).write_text(content)
        with refused(says):
            Calibration.load(tmp_path / name)


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
KEYS = ("device", "bits", "size", "flip_x", "flip_y", "shift", "responses", "correction", "format_version")
near_responses = st.fixed_dictionaries(
    {"wavelength_nm": st.just(532) | json_values},
    optional={"range": json_values, "curve": json_values | st.just([[0, 0], [255, 6]])},
)
near_corrections = st.fixed_dictionaries(
    {"file": st.sampled_from(["map.npy", "", ".", "..", "/", "a\0b", "map"]) | json_values},
    optional={"wavelength_nm": json_values},
)
near_values = (
    st.fixed_dictionaries({}, optional={key: json_values for key in KEYS})
    | st.fixed_dictionaries({"responses": st.lists(near_responses, max_size=2)})
    | st.fixed_dictionaries({"correction": near_corrections})
)


def test_any_json_is_read_or_refused(folder):
    np.save(folder / "map.npy", np.zeros((2, 3), np.float32))

    @settings(quick, max_examples=200)
    @given(json_values | near_values.map(lambda data: {"format": FORMAT} | data))
    @example({"format": FORMAT, "bits": math.inf})
    @example({"format": FORMAT, "responses": [{"wavelength_nm": 10**400}]})
    @example({"format": FORMAT, "responses": [{"wavelength_nm": 532, "curve": [[0, 0], [255, 10**400]]}]})
    def check(data):
        (folder / "any.json").write_text(json.dumps(data), encoding="utf-8")
        try:
            found = Calibration.load(folder / "any.json")
        except engine.InvalidInput as error:
            assert "any.json" in str(error)
        else:
            assert 1 <= found.bits <= 16

    check()


def npy(header):
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"no array",
        npy(b"{'descr':'<f4','fortran_order':False,'shape':(\n"),
        npy(b"{'descr':'<f4','fortran_order':False,'shape':(2, 3)}\n") + b"short",
        npy(b"{'descr':'<f4','fortran_order':False,'shape':(100000000, 100000)}\n"),
        npy(b"{'descr':'|O','fortran_order':False,'shape':(2, 3)}\n"),
    ],
    ids=["empty", "text", "torn header", "torn", "much larger than memory", "objects"],
)
def test_damaged_corrections(content, tmp_path):
    (tmp_path / "map.npy").write_bytes(content)
    path = write(tmp_path, correction={"file": "map.npy", "wavelength_nm": 633})
    with pytest.raises(engine.InvalidInput, match="foreign.json"):
        Calibration.load(path)


def test_a_curve_of_more_levels_than_there_are():
    """Its first levels alone would be a part of a turn."""
    curve = tuple((level, TURN * level / 256) for level in range(256))
    assert Calibration(bits=8, responses=(Response(RED, curve=curve),)).levels(np.zeros((1, 1)), RED) == 0
    whole = ((0, 0), (256, TURN))
    np.testing.assert_allclose(Response(RED, curve=whole).phases(8), np.arange(256) * TURN / 256)
    with refused("runs to level 255, but the highest level of 4 bits is 15"):
        Response(RED, curve=curve).phases(4)


@pytest.mark.parametrize(
    ("values", "name", "says"),
    [
        (np.zeros((4, 4), np.uint8), "flat.npy", "whole numbers instead of radians"),
        (
            np.dstack([np.zeros((4, 4)), np.ones((4, 4)), np.zeros((4, 4))]).astype(np.uint8),
            "flat.png",
            "colors",
        ),
    ],
)
def test_a_correction_that_is_no_phase(values, name, says, tmp_path):
    if name.endswith("npy"):
        np.save(tmp_path / name, values)
    else:
        variants.bitmaps().Bitmap(values).write(str(tmp_path / name))
    with refused(says):
        Calibration.load(write(tmp_path, correction={"file": name, "wavelength_nm": 633}))
