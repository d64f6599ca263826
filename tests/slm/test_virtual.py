"""The simulated bench: what its camera sees of the levels that it is sent."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.slm import Calibration, Picture, Response, Sequence, VirtualDriver, stream

TURN = 2 * math.pi
PITCH = 8e-6
SIDE = 64
FAR, NEAR = 4e-3, 7e-3
DISTANCES = (4.5e-3, 5.5e-3, 6.5e-3)  # of dots
WAVELENGTHS = (640e-9, 516.5e-9)


def of_phases(phases, wavelengths=WAVELENGTHS, gains=(0.7, 1.3), far=FAR, near=NEAR):
    """A hologram of phases in radians, shape (frame, wavelength, y, x)."""
    phases = np.mod(phases, TURN).astype(np.float32)
    phases[phases >= np.float32(TURN)] = 0
    grid = engine.Hologram(
        phases.shape[3], phases.shape[2], PITCH, wavelengths, depth_far=far, depth_near=near
    )
    return engine.PhaseHologram(
        phases, grid, engine.Camera(np.eye(4), 0.5), 0.5, "dpac", gains[: len(wavelengths)]
    )


def coordinates(height=SIDE, width=SIDE):
    """Meters from pixel (height // 2, width // 2), to the right and down."""
    y, x = np.indices((height, width))
    return (x - width // 2) * PITCH, (y - height // 2) * PITCH


def dots(frames=2, seed=1):
    """Three dots, at three distances and nowhere symmetric: the phase of the waves that run to them."""
    rng, (x, y) = np.random.default_rng(seed), coordinates()
    phases = np.empty((frames, len(WAVELENGTHS), SIDE, SIDE))
    for m, k in np.ndindex(phases.shape[:2]):
        wave = 0
        for z, (at_x, at_y) in zip(DISTANCES, ((-12, -7), (5, 13), (14, -16)), strict=True):
            way = np.sqrt((x - at_x * PITCH) ** 2 + (y - at_y * PITCH) ** 2 + z * z)
            wave = wave + np.exp(1j * (rng.random() * TURN - TURN / WAVELENGTHS[k] * way))
        phases[m, k] = np.angle(wave)
    return of_phases(phases)


@pytest.fixture(scope="module")
def hologram():
    return dots()


def decibels(picture, ideal):
    """Signal to noise: the ideal picture's energy over the error's; brightness counts."""
    error = np.sum((picture.astype(float) - ideal) ** 2)
    return 10 * math.log10(np.sum(ideal.astype(float) ** 2) / max(error, 1e-300))


def ideal_of(hologram, bits=8, distances=DISTANCES):
    """The engine's view of these levels, shape (distance, y, x, wavelength)."""
    field = hologram.field(engine.Modulator(bits=bits))
    return engine.reconstruct(field, field.mapping.z_to_depth(distances))


def view(bench, distances=DISTANCES):
    pictures = []
    for distance in distances:
        bench.focus_at(distance)
        pictures.append(bench.capture())
    return np.stack(pictures)


def shown(hologram, calibration=None, bench=None, packing="time", order="RGB", **options):
    """A bench on which a hologram was shown."""
    bench = bench or VirtualDriver(hologram, packing=packing, order=order, **options)
    stream(Sequence([hologram], calibration, packing, order), bench)
    return bench


# As the engine sees it


@pytest.mark.parametrize(
    ("packing", "order", "bits"),
    [
        ("time", "RGB", 8),
        ("color", "RGB", 8),
        ("color", "BRG", 8),
        ("bits", "RGB", 1),
        ("bits", "GBR", 1),
        ("plm-067", "RGB", 4),
        ("plm-047", "BGR", 4),
        ("slm-200", "RGB", 10),
        ("slm-200-120hz", "RGB", 10),
        ("B7-0,G5-3,R0", "RGB", 12),
    ],
)
def test_sees_what_the_engine_reconstructs(packing, order, bits, hologram):
    """Two frames in two colors at three distances, whatever the pictures are packed in."""
    calibration = Calibration(bits=bits)
    bench = shown(hologram, calibration, None, packing, order, truth=calibration)
    found, ideal = view(bench), ideal_of(hologram, bits)
    assert found.shape == ideal.shape == (3, SIDE, SIDE, 2) and found.dtype == np.float32
    for a, b in zip(found, ideal, strict=True):
        assert decibels(a, b) > 120  # at the time of writing there was no difference at all
    # the test can tell: another distance, one frame alone, or colors that are exchanged
    assert decibels(found[0], ideal[1]) < 30
    one = of_phases(hologram.data[:1])
    assert decibels(found[0], ideal_of(one, bits)[0]) < 30
    assert decibels(found[0, ..., ::-1], ideal[0]) < 30


@pytest.mark.parametrize(
    "optics",
    [
        engine.Optics(color_scale=(1.02, 0.99), color_distance=(0.1e-3, 0.0)),
        engine.Optics(lens=engine.Lens(0.1)),
    ],
    ids=["apart", "lens"],
)
def test_colors_on_one_grid(hologram, optics):
    apart = replace(hologram, hologram=replace(hologram.hologram, optics=optics))
    bench = shown(apart, Calibration())
    assert view(bench).shape == ideal_of(apart).shape
    assert decibels(view(bench), ideal_of(apart)) > 100


@pytest.mark.parametrize("bits", [2, 10])
def test_other_bits(bits, hologram):
    calibration = Calibration(bits=bits)
    bench = shown(hologram, calibration, truth=calibration)
    assert decibels(view(bench), ideal_of(hologram, bits)) > 100


def test_a_panel_takes_the_bits_that_it_has(hologram):
    """The same bits at the other end of the channels are other levels; and a bench of other bits is none."""
    bench = VirtualDriver(hologram, packing="R2-0,G2-0,B3-0")
    stream(Sequence([hologram], None, "slm-200"), bench)
    assert decibels(view(bench), ideal_of(hologram, 10)) < 30
    with pytest.raises(engine.InvalidInput, match="slm-200 takes levels of 10 bits, got 8"):
        VirtualDriver(hologram, Calibration(), packing="slm-200")


def test_order_of_channels_matters(hologram):
    bench = VirtualDriver(hologram, packing="color", order="RGB")
    stream(Sequence([hologram], None, "color", "GBR"), bench)
    assert decibels(view(bench), ideal_of(hologram)) < 30


def test_several_rounds_are_averaged(hologram):
    """Pictures shown twice count once; `expose` clears them."""
    bench = VirtualDriver(hologram)
    stream(Sequence([hologram]), bench, loops=3)
    assert decibels(view(bench), ideal_of(hologram)) > 100
    bench.expose()
    sequence = Sequence([hologram])
    for number in (2, 3):  # the second frame
        bench.show(number, sequence.picture(number))
    second = of_phases(hologram.data[1:])
    assert decibels(view(bench), ideal_of(second)) > 100


def test_keeps_what_it_was_shown(hologram):
    """Not the array that it was handed."""
    bench, pixels = VirtualDriver(hologram), []
    sequence = Sequence([hologram])
    for number in range(4):
        picture = sequence.picture(number)
        pixels.append(picture.pixels.copy())
        bench.show(number, Picture(pixels[-1], number, picture.parts))
        pixels[-1][:] = 0
    assert decibels(view(bench), ideal_of(hologram)) > 100


# As physics has it


def lens(focal, wavelength):
    """Converging: light runs to +z, its time dependence is exp(-i omega t)."""
    x, y = coordinates()
    return -TURN / wavelength * (np.sqrt(x * x + y * y + focal * focal) - focal)


@pytest.mark.parametrize(("bits", "share"), [(8, 1.0), (3, 0.950), (2, 0.811), (1, 0.405)])
def test_lens(bits, share):
    """A square lens has a peak of (side^2 / (lambda f))^2, of which N levels keep sinc^2(1 / N)."""
    focal, wavelength, gain = 12e-3, WAVELENGTHS[0], 0.7
    # tilted by 8 pixels a period: the orders that few levels make lie elsewhere
    x, _ = coordinates()
    tilt = wavelength / (8 * PITCH)
    phases = lens(focal, wavelength) + TURN / wavelength * tilt * x
    hologram = of_phases(phases[None, None], (wavelength,), (gain,), 8e-3, 16e-3)
    calibration = Calibration(bits=bits)
    bench = shown(hologram, calibration, truth=calibration)
    bench.focus_at(focal)
    picture = bench.capture()[..., 0]
    assert np.unravel_index(picture.argmax(), picture.shape) == (SIDE // 2, SIDE // 2 + focal * tilt / PITCH)
    peak = gain**2 * ((SIDE * PITCH) ** 2 / (wavelength * focal)) ** 2
    assert picture.max() == pytest.approx(peak * share, rel=0.06)


def test_focus_moves(hologram):
    """Each dot is brightest where it lies, and there where it is focused."""
    bench = shown(hologram)
    at = ((-7, -12), (13, 5), (-16, 14))
    away = (4.5e-3, 4.75e-3, 5e-3, 5.25e-3, 5.5e-3, 5.75e-3, 6e-3, 6.25e-3, 6.5e-3)
    pictures = view(bench, away).sum(axis=-1)
    for number, (row, column) in enumerate(at):
        there = pictures[:, SIDE // 2 + row, SIDE // 2 + column]
        assert away[there.argmax()] == pytest.approx(DISTANCES[number], abs=0.26e-3)
        assert there.max() > 2 * there.min()


def test_focus_at_first_is_the_middle(hologram):
    """The focus is in world meters, by the formula of the depths."""
    bench = VirtualDriver(hologram)
    beta = (NEAR - FAR) * 0.5
    assert bench.focus == pytest.approx(beta / ((FAR + NEAR) / 2 - FAR))
    bench.focus_at(NEAR)
    assert bench.focus == pytest.approx(0.5)


def test_focus_at_the_far_end(hologram):
    """World infinity."""
    bench = shown(hologram)
    bench.focus_at(FAR)
    assert bench.focus == math.inf
    field = hologram.field(engine.Modulator(bits=8))
    assert decibels(bench.capture(), engine.reconstruct(field, [math.inf])[0]) > 100


def flat(level=0):
    """All pixels of a phase of `level` / 256 turns."""
    return of_phases(np.full((1, 1, SIDE, SIDE), level * TURN / 256), WAVELENGTHS[:1], (1.0,))


@pytest.mark.parametrize(
    ("level", "options", "ratio"),
    [
        (0, {"fill_factor": 0.8}, 0.8**2),
        (64, {"unmodulated": 0.1}, 1.0),  # a quarter turn apart: the sum of both
        (0, {"unmodulated": 0.1}, 1 + 2 * math.sqrt(0.1 * 0.9)),
        (128, {"unmodulated": 0.1}, 1 - 2 * math.sqrt(0.1 * 0.9)),
        (128, {"unmodulated": 0.1, "fill_factor": 0.5}, 0.25 * (1 - 2 * math.sqrt(0.1 * 0.9))),
    ],
)
def test_modulator(level, options, ratio):
    """A flat hologram gives light of amplitude F (sqrt(1 - u) exp(i phase) + sqrt(u))."""
    plain = view(shown(flat(level)))
    limited = view(shown(flat(level), modulator=engine.Modulator(**options)))
    np.testing.assert_allclose(limited, plain * ratio, rtol=1e-3, atol=1e-4 * plain.max())


def test_crosstalk():
    """Columns of 0 and pi blur to pi / 2 everywhere: to nothing but a flat mirror."""
    columns = np.tile(np.arange(SIDE) % 2 * math.pi, (1, 1, SIDE, 1))
    columns = of_phases(columns, WAVELENGTHS[:1], (1.0,))
    plain, mirror = view(shown(columns)), view(shown(flat()))
    blurred = view(shown(columns, modulator=engine.Modulator(crosstalk=3)))
    inner = slice(16, -16)  # at the edge pixels blur with themselves
    assert decibels(blurred[:, inner, inner], mirror[:, inner, inner]) > 20
    assert decibels(plain[:, inner, inner], mirror[:, inner, inner]) < 10


def test_crosstalk_of_a_panel_of_more_than_a_turn():
    """Levels a turn apart are not alike: neighbors blur the panel's own phases.

    A checkerboard of both keeps the share a of its waves, and the light of a flat mirror falls to cos(pi a)^2.
    """
    hologram = flat(20)
    panel = Calibration(responses=(Response(WAVELENGTHS[0], 2.0),))
    bench = VirtualDriver(hologram, panel, engine.Modulator(crosstalk=0.4))
    alike = np.full((SIDE, SIDE), 10, np.uint8)
    side = math.exp(-0.5 / 0.4**2)
    kept = ((1 - 2 * side) / (1 + 2 * side)) ** 2

    def middle(levels):
        bench.show(0, replace(Sequence([hologram], panel).picture(0), pixels=levels))
        return view(bench)[:, 24:40, 24:40].mean()

    board = alike + np.uint8(128) * (np.indices(alike.shape).sum(0) % 2).astype(np.uint8)
    assert middle(board) / middle(alike) == pytest.approx(math.cos(math.pi * kept) ** 2, rel=0.05)
    assert np.array_equal(panel.levels(hologram.data[0, 0], WAVELENGTHS[0]), alike)


def test_bits_are_the_calibrations(hologram):
    with pytest.raises(engine.InvalidInput, match="bits from the calibration"):
        VirtualDriver(hologram, modulator=engine.Modulator(bits=8))


# A panel that is not ideal


def aberration(height, width):
    """Bent and twisted, by many turns: no symmetry that a flip keeps."""
    y, x = np.indices((height, width), float)
    x, y = 2 * x / width - 1, 2 * y / height - 1
    return 14 * x * x + 9 * x * y - 11 * y * y + 8 * x**3 - 5 * x * x * y + 4 * np.sin(3 * x + y)


def curve():
    """A bent response of 1.3 turns at 532 nm."""
    share = np.linspace(0, 1, 17)
    return tuple(
        zip(
            (255 * share).tolist(),
            (0.3 + 1.3 * TURN * share**1.5 + 0.3 * np.sin(8 * share)).tolist(),
            strict=True,
        )
    )


TRUTH = {
    "size": (90, 80),
    "flip_x": True,
    "flip_y": True,
    "shift": (5, -4),
    "responses": (Response(532e-9, curve=curve()),),
    "correction": aberration(80, 90),
    "correction_wavelength": 633e-9,
}
NONE = {
    "flip_x": False,
    "flip_y": False,
    "shift": (0, 0),
    "responses": (),
    "correction": None,
    "correction_wavelength": None,
}


@pytest.fixture(scope="module")
def bench(hologram):
    """One whose panel is bent, mirrored, shifted and larger than the hologram, and has a response of its own."""
    return VirtualDriver(hologram, Calibration(**TRUTH))


def test_the_panel_by_hand(bench, hologram):
    """Any levels: the response's phase less what would make the panel flat, at the hologram's pixels, mirrored."""
    levels = np.random.default_rng(5).integers(0, 256, (2, 80, 90), np.uint8)
    bench.expose()
    for k, level in enumerate(levels):
        bench.show(k, Picture(level, k, ((0, k),)))
    light = np.empty((1, 2, SIDE, SIDE), np.complex64)
    for k, wavelength in enumerate(WAVELENGTHS):
        phases = np.interp(levels[k], *zip(*curve(), strict=True)) * 532e-9 / wavelength
        phases = phases - aberration(80, 90) * 633e-9 / wavelength
        # (80 - 64) / 2 - 4 = 4 rows from the top, (90 - 64) / 2 + 5 = 18 columns from the left
        light[0, k] = hologram.gains[k] * np.exp(1j * phases[4 : 4 + SIDE, 18 : 18 + SIDE][::-1, ::-1])
    field = engine.WaveField(light, hologram.hologram, hologram.camera, hologram.near, modulated=True)
    ideal = engine.reconstruct(field, field.mapping.z_to_depth(DISTANCES))
    assert decibels(view(bench), ideal) > 90


def test_the_right_calibration(bench, hologram):
    """The ideal picture comes back, as near as levels of up to 1.6 turns allow."""
    bench.expose()
    found = view(shown(hologram, Calibration(**TRUTH), bench))
    assert decibels(found, ideal_of(hologram)) > 45


@pytest.mark.parametrize(
    "lacks", ["all", "flip_x", "flip_y", "shift", "responses", "correction", "correction_wavelength"]
)
def test_a_wrong_calibration(lacks, bench, hologram):
    """The picture is clearly worse without any part of the calibration."""
    names = NONE if lacks == "all" else {lacks: NONE[lacks]}
    if lacks == "correction":
        names = {"correction": None, "correction_wavelength": None}
    if lacks == "correction_wavelength":
        names = {lacks: 532e-9}
    bench.expose()
    found = view(shown(hologram, Calibration(**TRUTH | names), bench))
    assert decibels(found, ideal_of(hologram)) < 15


def test_the_default_calibration_on_a_panel_of_the_same_size(hologram):
    """Bent, with a response of its own: as users meet it who calibrate nothing."""
    truth = Calibration(
        responses=TRUTH["responses"], correction=aberration(SIDE, SIDE), correction_wavelength=633e-9
    )
    ideal = ideal_of(hologram)
    right, wrong = (view(shown(hologram, used, truth=truth)) for used in (truth, None))
    assert decibels(right, ideal) > 40 and decibels(wrong, ideal) < 15


def test_the_default_calibration_is_fitted_to_the_panel(hologram):
    """Larger than the hologram, and else ideal: it lies in the middle of either."""
    bench = shown(hologram, truth=Calibration(size=(90, 81)))
    assert bench.info.width == 90 and decibels(view(bench), ideal_of(hologram)) > 100


# Refusals


def test_nothing_was_shown(hologram):
    bench = VirtualDriver(hologram)
    with pytest.raises(engine.InvalidInput, match="Nothing was shown"):
        bench.capture()
    shown(hologram, bench=bench).capture()
    bench.expose()
    with pytest.raises(engine.InvalidInput, match="Nothing was shown"):
        bench.capture()


def test_pictures_of_another_size(hologram):
    bench = VirtualDriver(hologram)
    with pytest.raises(engine.InvalidInput, match="64 x 64 pixels for the virtual SLM, got 5 x 4"):
        bench.show(0, Picture(np.zeros((4, 5), np.uint8), 0, ((0, 0),)))
    with pytest.raises(engine.InvalidInput, match="70 x 70 pixels, this one has 64 x 64"):
        stream(Sequence([hologram], Calibration(size=(70, 70))), bench)
    with pytest.raises(engine.InvalidInput, match="holds 3 holograms, the packing time of the virtual SLM 1"):
        stream(Sequence([hologram], None, "color"), bench)
    with pytest.raises(engine.InvalidInput, match="10 bits, virtual takes 8"):
        stream(Sequence([hologram], Calibration(bits=10)), bench)
