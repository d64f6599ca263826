"""Other programs' fields, in their own conventions, become ours."""

import math
from itertools import permutations, product

import numpy as np
import pytest

from holopath_addon import engine, exchange
from holopath_addon.engine import InvalidInput
from tests.exchange import fields

PITCH, WAVELENGTH, N = 8e-6, 640e-9, 64


def wave(x, y, z, sign):
    """Spherical wave towards a focus at (x right, y up, z along the light), [y rising upwards, x rising]."""
    at = (np.arange(N) - N / 2) * PITCH
    return np.exp(-sign * 2j * math.pi / WAVELENGTH * np.hypot(np.hypot(at - x, at[:, None] - y), z))


@pytest.mark.parametrize(
    ("time", "rows", "axes"), [*product("-+", ("top", "bottom"), (("y", "x"), ("x", "y")))]
)
def test_a_focus_comes_where_it_is(time, rows, axes):
    """A converging wave has the phase -k r with exp(-i omega t); rows decide which end is up, for any axes."""
    x, y, z = 10 * PITCH, 6 * PITCH, 10e-3
    field = wave(x, y, z, 1 if time == "-" else -1)
    array = field[::-1] if rows == "top" else field
    array = array if axes == ("y", "x") else array.T
    given = exchange.ReadOptions(
        convention=exchange.Convention(axes, time, rows),
        pitch=PITCH,
        wavelengths=[WAVELENGTH],
        depth_range=(5e-3, z),
    )
    found = exchange.hologram_of(exchange.Container({"u": array}), given)
    picture = engine.reconstruct(found, [exchange.holograms.DEFAULT_NEAR])[0, ..., 0]
    row, column = np.unravel_index(picture.argmax(), picture.shape)
    assert (column, row) == (N / 2 + 10, N / 2 - 1 - 6)
    assert picture.max() > 0.2 * picture.sum()


@pytest.mark.parametrize("axes", [*permutations(("frame", "wavelength", "y", "x"))])
def test_conventions_there_and_back(axes):
    ours = fields.field().data
    for time, rows in product("-+", ("top", "bottom")):
        convention = exchange.Convention(axes, time, rows)
        assert np.array_equal(convention.to_holopath(convention.from_holopath(ours)), ours)
        assert convention.from_holopath(ours).shape == tuple(
            dict(zip(("frame", "wavelength", "y", "x"), ours.shape, strict=True))[name] for name in axes
        )


@pytest.mark.parametrize("plane", [-2e-3, 4e-3])
def test_a_field_on_another_plane_is_brought_to_the_slm(plane):
    z = 10e-3
    array = wave(0.0, 0.0, z - plane, 1)
    given = exchange.ReadOptions(
        pitch=PITCH, wavelengths=[WAVELENGTH], distance=plane, depth_range=(z - 3e-3, z + 3e-3)
    )
    found = exchange.hologram_of(exchange.Container({"u": array}), given)
    depths = found.mapping.z_to_depth(np.linspace(z - 2e-3, z + 2e-3, 9))
    middle = engine.reconstruct(found, depths)[:, N // 2, N // 2, 0]
    assert middle.argmax() == 4


@pytest.mark.parametrize(("dtype", "bits", "turn"), [("u1", 8, 256), ("u2", 16, 65536), ("u1", 4, 16)])
def test_levels_are_phases(dtype, bits, turn):
    levels = np.arange(16).reshape(4, 4).astype(dtype)
    given = exchange.ReadOptions(pitch=PITCH, wavelengths=[WAVELENGTH], bits=bits)
    found = exchange.hologram_of(exchange.Container({"levels": levels}), given)
    assert isinstance(found, engine.PhaseHologram) and found.gains == (1.0,)
    np.testing.assert_allclose(found.data[0, 0], levels * (2 * math.pi / turn), rtol=1e-6)


FIELD = np.ones((4, 5), np.complex64)
GIVEN = {"pitch": PITCH, "wavelengths": [WAVELENGTH]}


@pytest.mark.parametrize(
    ("array", "attributes", "given", "says"),
    [
        (
            FIELD,
            {},
            {"wavelengths": [WAVELENGTH]},
            "The file has no pixel pitch. Give --pitch, in micrometers",
        ),
        (FIELD, {}, {"pitch": PITCH}, "The file has no wavelengths. Give --wavelengths, in nanometers"),
        (
            FIELD,
            {},
            {**GIVEN, "wavelengths": [5e-7, 6e-7]},
            "array of 4 x 5 has 1 on the axis of wavelengths, got 2",
        ),
        (FIELD[None, None, None], {}, GIVEN, "Expected an array of at most 4 axes, frame, wavelength, y"),
        (
            FIELD,
            {},
            {**GIVEN, "convention": exchange.Convention(("frame", "y", "x"))},
            "Expected 3 axes, frame,y,x, got 2",
        ),
        (FIELD * np.nan, {}, GIVEN, "not finite"),
        (FIELD[:0], {}, GIVEN, "An array of 0 x 5 cannot be a hologram. Name"),
        (
            FIELD.real,
            {},
            {**GIVEN, "distance": 1e-3},
            "Phases are those of the SLM itself. Omit the distance from",
        ),
        (FIELD.real, {}, {**GIVEN, "bits": 8, "units": "pi"}, "no bits"),
        (
            FIELD.real,
            {"units": "mm"},
            GIVEN,
            "Give those of the phases by --units: radians, turns, pi, degrees",
        ),
        (FIELD, {}, {**GIVEN, "array": "v"}, "Expected an array of two or more axes in the file"),
        (
            FIELD,
            {"pitch_m": "wide"},
            {"wavelengths": [WAVELENGTH]},
            "Expected pitch_m of the file to be a number, got",
        ),
        (
            FIELD,
            {"pitch_m": [1.0, 2.0, 3.0]},
            {"wavelengths": [WAVELENGTH]},
            "Expected pitch_m of the file to be one number, or those",
        ),
        (FIELD, {"row_0": "left"}, GIVEN, "Expected row 0 at the top or bottom, got"),
        (
            FIELD,
            {"axes": "y,z"},
            GIVEN,
            "Expected axes frame,wavelength,y,x in any order",
        ),
        (FIELD, {"time_dependence": "none"}, GIVEN, "Expected a sign of time"),
        (FIELD, {"camera": "{}"}, GIVEN, "camera cannot be read"),
        (FIELD, {"near_m": -1.0}, GIVEN, "The near end of the scene must be at a positive"),
        (FIELD, {}, {**GIVEN, "pitch": 1e-7}, "too small for 640 nm"),
        (FIELD, {"pitch_m": PITCH}, {**GIVEN, "pitch": 0.0}, "Expected a positive pixel pitch"),
        (FIELD, {"near_m": 2.0}, {**GIVEN, "near": 0.0}, "The near end of the scene must be at a positive"),
        (FIELD, {}, {**GIVEN, "fov": 0.0}, "field of view of the camera between 0 and 180"),
        (FIELD, {}, {**GIVEN, "distance": math.nan}, "Expected a finite distance of the field"),
    ],
)
def test_what_does_not_fit(array, attributes, given, says):
    with pytest.raises(InvalidInput, match=says):
        exchange.hologram_of(exchange.Container({"u": array}, attributes), exchange.ReadOptions(**given))


def test_one_of_several_arrays_is_to_be_named():
    container = exchange.Container({"left": FIELD, "right": 2 * FIELD})
    with pytest.raises(InvalidInput, match="as left or right. Choose by --array"):
        exchange.hologram_of(container, exchange.ReadOptions(**GIVEN))
    assert exchange.hologram_of(container, exchange.ReadOptions("right", **GIVEN)).data.max() == 2


def test_a_convention_without_an_axis_for_frames():
    with pytest.raises(InvalidInput, match="There are 3 frames, but no axis for them. Name it"):
        exchange.container_of(fields.field(), exchange.CONVENTIONS["odak"])


@pytest.mark.parametrize("given", [{"axes": ("x", "y")}, {"time": "+"}, {"rows": "bottom"}])
def test_what_is_given_of_a_convention_leaves_the_rest_to_the_file(given):
    """Also where the file's own is none that can be read."""
    convention = exchange.Convention(("x", "y"), "+", "bottom")
    ours = fields.field(frames=1).data[:, :1]
    attributes = {"axes": "x,y", "time_dependence": "exp(+i omega t)", "row_0": "bottom"}
    names = {"axes": "axes", "time": "time_dependence", "rows": "row_0"}
    for wrong in ({}, {names[name]: "nothing" for name in given}):
        container = exchange.Container({"u": convention.from_holopath(ours)}, attributes | wrong)
        found = exchange.hologram_of(container, exchange.ReadOptions(convention=given, **GIVEN))
        np.testing.assert_array_equal(found.data, ours)


def test_what_is_given_of_a_bench_leaves_the_rest_to_the_file():
    """A beam that was measured is not in the file, and need not be if another one is given."""
    measured = engine.Beam("measured", measured=np.ones((6, 9)))
    lens = engine.Lens(0.1, 0.1)
    kept = fields.field()
    for beam, rest in (
        (measured, {"stop": engine.Stop("half")}),
        (engine.Beam("point", (0.2,)), {"lens": lens}),
    ):
        optics = engine.Optics(beam, **rest)
        hologram = engine.Hologram(9, 6, 8e-6, fields.WAVELENGTHS, -1e-3, 1e-3, optics=optics)
        container = exchange.container_of(engine.WaveField(kept.data, hologram, kept.camera, 0.7))
        tilt = engine.Beam("point", (-0.3,))
        found = exchange.hologram_of(container, exchange.ReadOptions(optics={"beam": tilt}))
        assert found.hologram.optics == engine.Optics(tilt, **rest)
    with pytest.raises(InvalidInput, match="Expected a carrier within the band"):
        exchange.hologram_of(container, exchange.ReadOptions(optics={"carrier": (2.0, 0.0)}))


@pytest.mark.parametrize("bits", ["12 bit", 0, 17])
def test_bits_of_an_amplitude_that_no_file_can_have(bits):
    arrays = {"amplitude": np.ones((4, 5), np.uint16), "phase": np.linspace(0, 2 * math.pi, 20).reshape(4, 5)}
    container = exchange.Container(arrays, array_attributes={"amplitude": {"bits": bits}})
    with pytest.raises(InvalidInput, match="bits"):
        exchange.hologram_of(container, exchange.ReadOptions(transfer="linear", **GIVEN))
