"""Two arrays of one file, or of two, become one field; what can be read in two ways is refused."""

import h5py
import numpy as np
import pytest

from holopath_addon import engine, exchange
from holopath_addon.engine import InvalidInput
from holopath_addon.exchange import parts

GIVEN = {"pitch": 8e-6, "wavelengths": [516.5e-9]}
rng = np.random.default_rng(3)
AMPLITUDE, PHASE = rng.random((16, 9)) + 0.1, rng.random((16, 9)) * 2 * np.pi
LIGHT = AMPLITUDE * np.exp(1j * PHASE)
PAIRS = [
    {"amplitude": AMPLITUDE, "phase": PHASE},
    {"holo/fieldAmp": AMPLITUDE, "holo/PHI": PHASE},
    {"intensity": AMPLITUDE**2, "phase": PHASE},
    {"re": LIGHT.real, "im": LIGHT.imag},
    {"u_real": LIGHT.real, "u_imag": LIGHT.imag, "mask": AMPLITUDE > 0},
    {"u": LIGHT, "x": AMPLITUDE},
]


def taken(arrays, **given):
    container = exchange.Container(arrays)
    return exchange.hologram_of(container, exchange.Given(**GIVEN, **given))


def test_amplitude_and_phase_keep_both():
    """By PSNR to the true field; with the amplitude left out it is 19.5 dB."""
    found = taken(PAIRS[0])
    assert isinstance(found, engine.WaveField)
    assert psnr(found.data[0, 0]) > 130
    assert psnr(np.exp(1j * PHASE)) < 20


def psnr(field):
    """Of a field to the true one, at its best scale, dB."""
    scale = np.vdot(field, LIGHT) / np.vdot(field, field)
    return -10 * np.log10(np.mean(np.abs(scale * field - LIGHT) ** 2) / np.abs(LIGHT).max() ** 2)


@pytest.mark.parametrize("arrays", PAIRS, ids=["-".join(pair) for pair in PAIRS])
def test_names_say_what_arrays_are(arrays):
    np.testing.assert_allclose(taken(arrays).data[0, 0], LIGHT, rtol=1e-6)


def test_time_and_order_are_those_of_the_field():
    arrays = {"a": AMPLITUDE.T, "b": PHASE.T}
    convention = exchange.Convention(("x", "y"), "+", "bottom")
    found = taken(arrays, array={"amplitude": "a", "phase": "b"}, convention=convention)
    np.testing.assert_allclose(found.data[0, 0], LIGHT[::-1].conj(), rtol=1e-6)


@pytest.mark.parametrize(
    ("arrays", "array", "says"),
    [
        (
            {"amplitude": AMPLITUDE},
            None,
            "gives is amplitude, which makes no field: give phase with amplitude",
        ),
        ({"real": PHASE}, None, "gives is real, which makes no field"),
        (
            {"amplitude": AMPLITUDE, "intensity": AMPLITUDE, "phase": PHASE},
            None,
            "amplitude and phase or intensity and phase: choose by --array, as --array amplitude=amplitude,phase=phase",
        ),
        ({"field": LIGHT, "phase": PHASE}, None, "as field or phase: choose by --array, as --array field or"),
        ({"phase": PHASE, "A": AMPLITUDE}, None, "has A beside phase: say --array phase for phases alone"),
        ({"a": PHASE, "b": PHASE}, None, "a, b. Name one by --array, or say what they are"),
        ({"field": PHASE}, None, "real numbers, which are no field: say --array phase=field"),
        ({"phase": LIGHT}, None, "complex numbers, and its name says otherwise: say --array field=phase"),
        ({"u": LIGHT}, {"phase": "u"}, "complex numbers, which are no phase: say --array u"),
        ({"u": LIGHT}, {"color": "u"}, "no role color: choose among phase"),
        ({"u": LIGHT}, {"phase": "v"}, "no array v of two or more axes in the file: choose among u"),
        ({"amplitude": AMPLITUDE.T, "phase": PHASE}, None, "amplitude has 9 x 16 and phase has 16 x 9"),
        ({"amplitude": -AMPLITUDE, "phase": PHASE}, None, "goes below 0: give it as real and imaginary"),
        ({"amplitude": AMPLITUDE.astype("i4"), "phase": PHASE}, None, "of int32, which has no largest value"),
        ({"u": LIGHT * 1e60}, None, "single precision does not hold"),
    ],
)
def test_what_is_refused(arrays, array, says):
    with pytest.raises(InvalidInput, match=says):
        taken(arrays, array=array)


@pytest.mark.parametrize(
    ("arrays", "given", "says"),
    [
        ({"u": LIGHT}, {"units": "turns"}, "leave out --units and --bits"),
        ({"u": LIGHT}, {"bits": 8}, "leave out --units and --bits"),
        ({"u": LIGHT}, {"packing": "bits"}, "phases in a color picture, and there is none"),
        (PAIRS[0], {"transfer": "srgb"}, "in whole numbers, and there are none"),
        (
            {"amplitude": np.eye(3, dtype="u1"), "phase": np.eye(3)},
            {"transfer": "log"},
            "no transfer function log",
        ),
    ],
)
def test_what_is_said_of_nothing_is_refused(arrays, given, says):
    with pytest.raises(InvalidInput, match=says):
        taken(arrays, **given)


def test_screens_encode_amplitudes():
    """By IEC 61966-2-1: 188 of 255 is half of the light."""
    arrays = {"intensity": np.full((2, 2), 188, "u1"), "phase": np.zeros((2, 2))}
    with pytest.raises(
        InvalidInput, match=r"\(--transfer linear\) or encoded for screens \(--transfer srgb\)"
    ):
        taken(arrays)
    assert taken(arrays, transfer="srgb").data.real == pytest.approx(np.sqrt(0.5029), abs=1e-4)
    assert taken(arrays, transfer="linear").data.real == pytest.approx(np.sqrt(188 / 255), abs=1e-6)


def test_units_in_hdf5_belong_to_their_array(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, array, units in (
            ("amplitude", AMPLITUDE, "V/m"),
            ("phase", PHASE, "turns"),
            ("x", PHASE[0], "m"),
        ):
            file[name] = array
            file[name].attrs["units"] = units
            file[name].attrs["pitch_m"] = 4e-6
    found = exchange.hologram_of(exchange.read(tmp_path / "a.h5"), exchange.Given(wavelengths=[516.5e-9]))
    np.testing.assert_allclose(found.data[0, 0], AMPLITUDE * np.exp(2j * np.pi * PHASE), rtol=1e-5)
    assert found.hologram.pitch == 4e-6


def test_two_files_are_one_field(tmp_path):
    np.savez(tmp_path / "a.npz", v=AMPLITUDE, w=AMPLITUDE, pitch_m=4e-6)
    np.savez(tmp_path / "p.npz", u=PHASE / np.pi, pitch_m=4e-6, units="pi")
    files = {"amplitude": tmp_path / "a.npz", "phase": tmp_path / "p.npz"}
    with pytest.raises(InvalidInput, match="is the amplitude: v, w. Say it by --array amplitude=NAME"):
        parts.read_parts(files)
    container = parts.read_parts(files, {"amplitude": "w"})
    found = exchange.hologram_of(container, exchange.Given(wavelengths=[516.5e-9]))
    np.testing.assert_allclose(found.data[0, 0], LIGHT, rtol=1e-6)
    np.savez(tmp_path / "p.npz", u=PHASE, pitch_m=5e-6)
    with pytest.raises(InvalidInput, match="different things of pitch_m"):
        parts.read_parts(files, {"amplitude": "w"})
    with pytest.raises(InvalidInput, match="give is amplitude, which makes no field"):
        parts.read_parts({"amplitude": tmp_path / "a.npz"})
