"""Phases for levels as they were measured, shown by a virtual bench whose SLM has those levels."""

import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import cli, engine, slm
from holopath_addon.engine.viewing import metrics
from holopath_addon.slm.calibration import measured_levels, response_files
from holopath_addon.slm.drivers.virtual import VirtualDriver
from tests.engine.encoding.fields import GREEN, smooth, wave_field

TURN, EVEN = 2 * math.pi, np.arange(256) / 255
# Of Texas Instruments' PLM, as its software has them: height of the mirrors, of a turn.
PLM = [0, 0.01, 0.0205, 0.0422, 0.056, 0.0727, 0.1131, 0.1734, 0.3426, 0.3707, 0.4228, 0.4916, 0.5994]
PLM += [0.6671, 0.797, 0.9375]
RESPONSES = {
    "plm": (4, np.array(PLM) * TURN),
    "bent": (8, (EVEN + 0.1 * np.sin(TURN * EVEN) - 0.1 * np.sin(math.pi * EVEN) ** 2) * TURN),
    "short": (8, 0.9 * EVEN * TURN),  # a panel of 1.8 pi
    "binary": (1, np.array([0.4, 0.4 + 0.8 * math.pi])),
}


def calibration(name):
    bits, phases = RESPONSES[name]
    return slm.Calibration(
        bits=bits, responses=(slm.Response(GREEN, curve=tuple(enumerate(phases.tolist()))),)
    )


@pytest.fixture(scope="module")
def field():
    return wave_field(smooth(4), depth_far=1e-3, depth_near=3e-3)


def decibels(field, phase, calibration, sent=None):
    """PSNR of what the bench's camera sees of phases, against the field itself; `sent` says how they become levels."""
    bench = VirtualDriver(phase, calibration)
    slm.stream(slm.Sequence([phase], sent or calibration), bench)
    bench.focus_at(2e-3)
    target = engine.reconstruct(field, [bench.focus])[0]
    return metrics.psnr(bench.capture(), target, border=4)


@pytest.mark.parametrize("name", RESPONSES)
@pytest.mark.parametrize("method", ["dpac", "sgd", "joint"])
def test_phases_are_levels(name, method, field):
    levels = calibration(name).levels_of(field.hologram)
    phase = engine.encode(field, method, levels=levels, max_steps=12)
    apart = np.abs(phase.data[..., None] - levels[0].phases.astype(np.float32))
    assert apart.min(axis=-1).max() < 1e-5


@pytest.mark.slow
def test_what_measured_levels_gain(field):
    """Gain over even levels, and over the nearest levels of free phases."""
    gains = {}
    for name in RESPONSES:
        device, even = calibration(name), slm.Calibration(bits=RESPONSES[name][0])
        free = engine.encode(field, "joint")
        ideal = engine.encode(field, "joint", bits=device.bits)
        measured = engine.encode(field, "joint", levels=device.levels_of(field.hologram))
        shown = decibels(field, measured, device)
        gains[name] = shown - decibels(field, ideal, device, even), shown - decibels(field, free, device)
    assert all(gains[name][0] > 1.5 for name in ("plm", "bent", "short")), gains
    assert min(over for _, over in gains.values()) > -0.1, gains
    assert gains["plm"][1] > 0.2, gains


def test_by_command_line(field, tmp_path, capsys):
    folder, text = tmp_path / "out", tmp_path / "levels.txt"
    field.save(folder / "wavefield")
    calibration("plm").save(tmp_path / "plm.json")
    text.write_text("\n".join(map(str, RESPONSES["plm"][1])))
    words = ["encode", str(folder), "--method", "sgd", "--quiet"]
    assert cli.main([*words, "--response", str(tmp_path / "plm.json")]) == 0
    ours = engine.PhaseHologram.load(folder / "hologram")
    assert len(np.unique(ours.data)) == 16 and ours.report["measured_levels"]
    assert cli.main([*words, "--response", str(text), "--out", str(tmp_path / "other")]) == 0
    assert np.array_equal(engine.PhaseHologram.load(tmp_path / "other").data, ours.data)
    text.write_text("0 3.1 pi")
    assert cli.main([*words, "--response", str(text)]) == 2
    assert "no phases" in capsys.readouterr().err
    assert cli.main([*words, "--response", str(tmp_path / "plm.json"), "--bits", "4"]) == 2
    assert "Omit the bits" in capsys.readouterr().err


def test_levels_scale_with_the_wavelength(tmp_path):
    calibration("plm").save(tmp_path / "plm.json")
    hologram = engine.Hologram(8, 8, 8e-6, (GREEN, 2 * GREEN))
    green, red = measured_levels(tmp_path / "plm.json", hologram)
    np.testing.assert_allclose(green.phases, RESPONSES["plm"][1])
    np.testing.assert_allclose(red.phases, RESPONSES["plm"][1] / 2)


@pytest.mark.parametrize(
    ("levels", "says"),
    [
        ([[0, 1], [0, 1]], "one set of levels for each of the wavelengths, 1, got 2"),
        ([[0, TURN]], "two or more"),
        ([[0, math.nan]], "two or more"),
    ],
)
def test_levels_that_cannot_be(levels, says, field):
    with pytest.raises(engine.InvalidInput, match=says):
        engine.encode(field, "sgd", levels=levels)


def bowl(height, width, seed=0):
    """A panel that is bent by some turns and rough besides, radians."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    return 30 * ((x - 0.4) ** 2 + 2 * (y - 0.6) ** 2) + np.random.default_rng(seed).uniform(
        0, 3, (height, width)
    )


def test_what_a_correction_costs(field):
    """Nothing, where phases are found for levels that it has turned; all that was gained where it is added later."""
    plain = calibration("plm")
    shape = field.hologram.height, field.hologram.width
    bent = replace(plain, correction=bowl(*shape), correction_wavelength=1.1 * GREEN)
    flat = engine.encode(field, "sgd", levels=plain.levels_of(field.hologram))
    known = engine.encode(field, "sgd", levels=bent.levels_of(field.hologram))
    found = [decibels(field, flat, plain), decibels(field, known, bent), decibels(field, flat, bent)]
    assert abs(found[1] - found[0]) < 0.3, found
    assert found[1] > found[2] + 0.3, found


def test_the_device_shows_exactly_what_was_encoded(field):
    """The calibration of a larger panel that is mirrored, moved and bent."""
    height, width = field.hologram.height, field.hologram.width
    device = replace(
        calibration("plm"),
        size=(width + 9, height + 6),
        flip_x=True,
        shift=(3, -2),
        correction=bowl(height + 6, width + 9),
        correction_wavelength=1.2 * GREEN,
    )
    phase = engine.encode(field, "dpac", levels=device.levels_of(field.hologram))
    levels = slm.Sequence([phase], device).picture(0).pixels
    view = device.shown_phases(levels, GREEN, (height, width))
    assert np.abs(np.exp(1j * view) - np.exp(1j * phase.data[0, 0])).max() < 1e-5
    assert len(np.unique(phase.data)) > 1000 and len(np.unique(levels)) == 16


def test_a_correction_of_another_size(field):
    with pytest.raises(engine.InvalidInput, match="has 3 x 2 pixels, the field"):
        engine.encode(field, "sgd", levels=[engine.Levels((0, 1), np.zeros((2, 3)))])
    small = slm.Calibration(correction=np.zeros((2, 3)), correction_wavelength=GREEN)
    with pytest.raises(engine.InvalidInput, match="3 x 2 pixels, the hologram"):
        small.levels_of(field.hologram)


def thickness(height, width):
    """Factors of the response of pixels, as in a cell that is thinner at one side."""
    y, x = np.mgrid[:height, :width] / max(height, width)
    return 1 + 0.25 * (x - 0.5) + 0.1 * np.sin(5 * y)


# Over seeds known ones lose 0.45 (deviation 0.09) and -0.1 (0.4) dB to even ones, as thin places lack levels; where the
# variation is not known, it is 2.4 (0.11) and 7.3 (0.25) dB.
@pytest.mark.parametrize(
    ("name", "gain", "loss"), [("plm", 2, 0.8), pytest.param("bent", 5, 1.2, marks=pytest.mark.slow)]
)
def test_a_response_that_varies_over_the_panel(name, gain, loss, field):
    """A known variation of a larger panel, mirrored, moved and bent, costs little, an unknown one decibels."""
    height, width = field.hologram.height, field.hologram.width
    plain = calibration(name)
    device = replace(
        plain,
        size=(width + 9, height + 6),
        flip_x=True,
        shift=(3, -2),
        correction=bowl(height + 6, width + 9),
        correction_wavelength=1.2 * GREEN,
        variation=thickness(height + 6, width + 9),
    )
    alike = replace(device, variation=None)
    known, unknown, even = (
        engine.encode(field, "joint", levels=each.levels_of(field.hologram))
        for each in (device, alike, plain)
    )
    found = [
        decibels(field, known, device),
        decibels(field, unknown, device, alike),
        decibels(field, even, plain),
    ]
    assert found[0] > found[1] + gain and found[0] > found[2] - loss, found
    if name == "plm":  # 16 levels of which none is missed: the device shows exactly what was encoded
        levels = slm.Sequence([known], device).picture(0).pixels
        view = device.shown_phases(levels, GREEN, (height, width))
        # two levels a turn apart may be as near: to what the device's table resolves
        assert np.abs(np.exp(1j * view) - np.exp(1j * known.data[0, 0])).max() < 0.01


def test_files_of_a_response_that_varies(field, tmp_path, capsys):
    height, width = field.hologram.height, field.hologram.width
    device = replace(calibration("plm"), variation=thickness(height, width))
    path = tmp_path / "plm.json"
    device.save(path)
    again = slm.Calibration.load(path)
    assert again.variation.tobytes() == device.variation.tobytes() and not again.plain
    assert set(response_files(path)) == {"response", "variation"}
    levels = again.levels_of(field.hologram)
    assert levels[0].to_dict() == device.levels_of(field.hologram)[0].to_dict()
    field.save(tmp_path / "out" / "wavefield")
    words = ["encode", str(tmp_path / "out"), "--method", "sgd", "--max-steps", "2", "--quiet"]
    assert cli.main([*words, "--response", str(path)]) == 0
    np.save(tmp_path / "plm.variation.npy", np.full((height, width), 9.0))
    assert cli.main([*words, "--response", str(path)]) == 2
    assert "0.5 to 2 times" in capsys.readouterr().err
    (tmp_path / "plm.variation.npy").unlink()
    assert cli.main([*words, "--response", str(path)]) == 2
    assert "cannot be read" in capsys.readouterr().err
    with pytest.raises(engine.InvalidInput, match="variation of the levels has 3 x 2"):
        engine.encode(field, "sgd", levels=[engine.Levels((0, 1), variation=np.ones((2, 3)))])
    with pytest.raises(engine.InvalidInput, match="3 x 2 pixels, the hologram"):
        slm.Calibration(variation=np.ones((2, 3))).levels(np.zeros((4, 4)), GREEN)
    with pytest.raises(engine.InvalidInput, match="4 x 4 pixels, got 3 x 2"):
        slm.Calibration(variation=np.ones((2, 3)), size=(4, 4))
