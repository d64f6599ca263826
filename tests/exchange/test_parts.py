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
    return exchange.hologram_of(container, exchange.ReadOptions(**GIVEN, **given))


def test_amplitude_and_phase_keep_both():
    """PSNR against the true field is high; without the amplitude it is 19.5 dB."""
    found = taken(PAIRS[0])
    assert isinstance(found, engine.WaveField)
    assert psnr(found.data[0, 0]) > 130
    assert psnr(np.exp(1j * PHASE)) < 20


def psnr(field):
    """PSNR of a field against the true one, at the best scale, dB."""
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
            "The file gives amplitude, but a field needs phase with amplitude",
        ),
        ({"real": PHASE}, None, "The file gives real, but a field needs"),
        (
            {"amplitude": AMPLITUDE, "intensity": AMPLITUDE, "phase": PHASE},
            None,
            "The file can be read as amplitude and phase or intensity",
        ),
        ({"field": LIGHT, "phase": PHASE}, None, "The file can be read as field or phase. Choose by"),
        ({"phase": PHASE, "A": AMPLITUDE}, None, "The file has A besides phase. Give --array phase for only"),
        ({"a": PHASE, "b": PHASE}, None, "Expected one array, found a, b. Name one by --array, or"),
        ({"field": PHASE}, None, "field has real numbers, which cannot be a field. Give --array"),
        (
            {"phase": LIGHT},
            None,
            "phase has complex numbers, which contradict its name. Give --array field=phase",
        ),
        ({"u": LIGHT}, {"phase": "u"}, "u has complex numbers, which cannot be a phase. Give --array"),
        (
            {"u": LIGHT},
            {"color": "u"},
            "Expected roles among phase, amplitude, intensity, real, imaginary, got color",
        ),
        ({"u": LIGHT}, {"phase": "v"}, "Expected an array of two or more axes in the file"),
        ({"amplitude": AMPLITUDE.T, "phase": PHASE}, None, "amplitude has 9 x 16 and phase has 16 x 9"),
        (
            {"amplitude": -AMPLITUDE, "phase": PHASE},
            None,
            "The amplitude has negative values",
        ),
        (
            {"amplitude": AMPLITUDE.astype("i4"), "phase": PHASE},
            None,
            "of int32, whose largest value is unclear",
        ),
        ({"u": LIGHT * 1e60}, None, "The field has values beyond single precision. Scale it down"),
    ],
)
def test_what_is_refused(arrays, array, says):
    with pytest.raises(InvalidInput, match=says):
        taken(arrays, array=array)


@pytest.mark.parametrize(
    ("arrays", "given", "says"),
    [
        ({"u": LIGHT}, {"units": "turns"}, "Units and bits apply to phases, and there are none. Omit"),
        ({"u": LIGHT}, {"bits": 8}, "Units and bits apply to phases, and there are none. Omit"),
        ({"u": LIGHT}, {"packing": "bits"}, "phases in a color picture, and there is none"),
        (PAIRS[0], {"transfer": "srgb"}, "in whole numbers, and there are none"),
        (
            {"amplitude": np.eye(3, dtype="u1"), "phase": np.eye(3)},
            {"transfer": "log"},
            "Expected a transfer function linear or srgb, got log",
        ),
    ],
)
def test_what_is_said_of_nothing_is_refused(arrays, given, says):
    with pytest.raises(InvalidInput, match=says):
        taken(arrays, **given)


def test_screens_encode_amplitudes():
    """188 of 255 is half of the light by IEC 61966-2-1."""
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
    found = exchange.hologram_of(
        exchange.read(tmp_path / "a.h5"), exchange.ReadOptions(wavelengths=[516.5e-9])
    )
    np.testing.assert_allclose(found.data[0, 0], AMPLITUDE * np.exp(2j * np.pi * PHASE), rtol=1e-5)
    assert found.hologram.pitch == 4e-6


def test_two_files_are_one_field(tmp_path):
    np.savez(tmp_path / "a.npz", v=AMPLITUDE, w=AMPLITUDE, pitch_m=4e-6)
    np.savez(tmp_path / "p.npz", u=PHASE / np.pi, pitch_m=4e-6, units="pi")
    files = {"amplitude": tmp_path / "a.npz", "phase": tmp_path / "p.npz"}
    with pytest.raises(InvalidInput, match="Expected one array for the amplitude in"):
        parts.read_parts(files)
    container = parts.read_parts(files, {"amplitude": "w"})
    found = exchange.hologram_of(container, exchange.ReadOptions(wavelengths=[516.5e-9]))
    np.testing.assert_allclose(found.data[0, 0], LIGHT, rtol=1e-6)
    np.savez(tmp_path / "p.npz", u=PHASE, pitch_m=5e-6)
    with pytest.raises(InvalidInput, match="The files differ in pitch_m. Write the same in both"):
        parts.read_parts(files, {"amplitude": "w"})
    with pytest.raises(InvalidInput, match="The files give amplitude, but"):
        parts.read_parts({"amplitude": tmp_path / "a.npz"})
