"""The light of displays that are not ideal: by formulas, and by a bench that computes it in another way."""

import math

import numpy as np
import pytest
import scipy.ndimage

from holopath_addon import engine, slm
from holopath_addon.engine.encoding.shown_light import ShownLight
from holopath_addon.engine.waves import gaussian_points
from holopath_addon.engine.waves.display_model import GRID, DisplayLight, DisplayModel, zernike

GREEN, PITCH, SIDE, Z = 520e-9, 8e-6, 32, 3e-3
TURN = 2 * math.pi
OFF = {
    "position": (0.1, -0.2),
    "falloff": 0.3,
    "tilt": (3e-3, -1e-3),
    "unmodulated": 0.1 + 0.2j,
    "crosstalk": 0.4,
    "aberrations": (0.3, -0.2, 0.1, 0.2, -0.3, 0.1, 0.2, -0.1),
    "across": (0.1, 0.2, -0.1),
    "down": (0.2, 0.0, 0.1),
}


def picture(model, phases, distance=Z, pitch=PITCH):
    """Intensity at the SLM's pixels."""
    light = DisplayLight(model, phases.shape, pitch, distance)
    whole = light.picture(light.spectra(phases), distance)
    return whole[: GRID * phases.shape[0] : GRID, : GRID * phases.shape[1] : GRID]


def dot(side=48, distance=Z):
    """Phases of light that runs to the middle."""
    y, x = (np.indices((side, side)) - (side - 1) / 2) * PITCH
    return -TURN / GREEN * (np.sqrt(x * x + y * y + distance**2) - distance)


def middle(image):
    """Center of the brightness, x and y, meters from the first pixel."""
    rows, columns = np.indices(image.shape) * PITCH
    return np.array([(image * at).sum() / image.sum() for at in (columns, rows)])


@pytest.mark.parametrize("phase", [0.0, 1.0, 2.5])
def test_unmodulated_light_on_a_flat_field(phase):
    """|sqrt(1 - |m|^2) exp(i phase) + m|^2."""
    stray = 0.2 - 0.1j
    flat = np.full((SIDE, SIDE), phase)
    stray_light = picture(DisplayModel(GREEN, unmodulated=stray), flat, 1e-4)[12:-12, 12:-12].mean()
    plain = picture(DisplayModel(GREEN), flat, 1e-4)[12:-12, 12:-12].mean()
    light = math.sqrt(1 - abs(stray) ** 2) * np.exp(1j * phase) + stray
    assert stray_light / plain == pytest.approx(abs(light) ** 2, rel=1e-3)


@pytest.mark.parametrize("sigma", [0.0, 0.3, 0.6])
def test_crosstalk_on_a_weak_grating(sigma):
    """Bars of four pixels and a small phase: their first order is sinc(f) exp(-2 pi^2 sigma^2 f^2) as strong."""
    bars = np.where(np.arange(64) // 4 % 2, 0.02, -0.02) * np.ones((64, 1))
    light = DisplayLight(DisplayModel(GREEN, crosstalk=sigma), bars.shape, PITCH, 0.0)
    spectrum = light.spectra(bars)[GREEN][0]
    f = np.fft.fftfreq(len(spectrum), 1 / GRID)
    direct = np.exp(-1j * TURN * np.outer(f, np.arange(64))) @ np.sin(bars[0])
    expected = direct * np.sinc(f) * np.exp(-2 * (math.pi * sigma * f) ** 2) * 64 * GRID**2
    near = (np.abs(f) > 0.1) & (np.abs(f) < 0.5)
    flat = DisplayLight(DisplayModel(GREEN, crosstalk=sigma), bars.shape, PITCH, 0.0).spectra(0 * bars)[
        GREEN
    ][0]
    error = np.abs(spectrum - flat * math.cos(0.02) - 1j * expected)
    assert error[near].max() < (0.02 if sigma else 1e-5) * np.abs(expected[near]).max()


def test_light_of_the_stop_comes_round_from_no_side(monkeypatch):
    """Compare with a grid that is large enough for all of its light."""
    phases = np.random.default_rng(0).uniform(0, TURN, (64, 64))

    def field():
        light = DisplayLight(DisplayModel(GREEN, crosstalk=0.3), phases.shape, PITCH, 2e-3)
        return np.fft.ifft2(light.relayed(light.spectra(phases)[GREEN]))[: 64 * GRID, : 64 * GRID]

    wave = field()
    monkeypatch.setattr("holopath_addon.engine.waves.display_model.GUARD", 300)
    assert np.linalg.norm(wave - field()) < 0.004 * np.linalg.norm(wave)


def test_tilt_moves_a_dot():
    """It is the sine times the distance."""
    tilt = (2.5e-3, -1.5e-3)
    still, moved = (picture(DisplayModel(GREEN, tilt=t), dot())[19:29, 19:29] for t in ((0, 0), tilt))
    assert middle(moved) - middle(still) == pytest.approx(np.array(tilt) * Z, abs=0.1 * PITCH)


def test_a_source_of_some_size_blurs_by_it():
    """Pictures are those of a point, blurred by size times distance (van Cittert and Zernike)."""
    size, rng = 0.8e-3, np.random.default_rng(1)
    phases = scipy.ndimage.gaussian_filter(rng.uniform(0, 20, (SIDE, SIDE)), 1.5)  # nothing meets the stop
    sharp, image = (picture(DisplayModel(GREEN, size=s), phases) for s in (0.0, size))
    f = np.fft.fftfreq(SIDE)
    blur = np.exp(-2 * (math.pi * size * Z / PITCH) ** 2 * (f[:, None] ** 2 + f[None, :] ** 2))
    blurred = np.fft.ifft2(np.fft.fft2(sharp) * blur).real
    inner = slice(6, -6)
    error = np.std((image - blurred)[inner, inner])
    assert error < 0.2 * np.std((sharp - blurred)[inner, inner])  # over seeds 0.11, deviation 0.025


@pytest.mark.parametrize(("rule", "degree"), [("THIRD", 3), ("FIFTH", 5), ("SEVENTH", 7)])
def test_points_have_the_moments_of_a_gaussian(rule, degree):
    """Moments of even powers of a coordinate are 1, 1, 3, 15, and of odd ones 0, up to the degree of the rule only."""
    *places, weights = np.array(getattr(gaussian_points, rule)).T
    even = [1, 0, 1, 0, 3, 0, 15, 0, 105]

    def off(total):
        powers = [(i, j, total - i - j) for i in range(total + 1) for j in range(total + 1 - i)]
        means = [
            (weights * np.prod([x**n for x, n in zip(places, p, strict=True)], axis=0)).sum() for p in powers
        ]
        return np.abs(np.array(means) - [math.prod(even[n] for n in p) for p in powers]).max()

    assert max(map(off, range(degree + 1))) < 1e-12 < off(degree + 1)
    assert weights.min() > 0


def test_zernike_polynomials_are_orthonormal():
    y, x = (np.indices((401, 401)) - 200) / 200
    inside = x * x + y * y <= 1
    terms = np.array([each[inside] for each in zernike(x, y)])
    assert terms @ terms.T / inside.sum() == pytest.approx(np.eye(8), abs=0.02)


@pytest.mark.parametrize("shape", [(24, 30), (23, 31)])
def test_gradient_of_the_light_with_respect_to_phases(library, shape):
    rng = np.random.default_rng(0)
    shown = ShownLight(DisplayModel(GREEN, **OFF), shape, PITCH, 4, library.zeros(0))
    phases, way = rng.uniform(0, 6, shape), rng.normal(size=shape)
    back = rng.normal(size=(2, *(n + 8 for n in shape)))
    back = back[0] + 1j * back[1]
    ends = (np.asarray(shown.light(library.asarray(phases + s * way))) for s in (0.01, -0.01))
    change = np.subtract(*ends) / 0.02
    slope = np.asarray(shown.slope(library.asarray(phases), library.asarray(back)))
    assert (slope * way).sum() == pytest.approx(2 * np.vdot(back, change).real, rel=1e-3)


@pytest.mark.parametrize(
    ("source", "pitch"),
    [({}, PITCH), ({"size": 3e-4, "bandwidth": 6e-9}, PITCH), ({}, (0.8 * PITCH, PITCH))],
)
def test_the_bench_agrees(source, pitch):
    """The bench has finer samples and frequencies, and other points of the source and of the field."""
    model = DisplayModel(GREEN, **OFF, **source)
    phases = np.random.default_rng(2).uniform(0, TURN, (SIDE, SIDE))
    bench = slm.Bench(model, np.arange(256), slm.Sensor((8, 8)), phases.shape, pitch)
    image, other = picture(model, phases, pitch=pitch), bench.picture(phases, Z)
    assert np.std(image - other) < 0.006 * np.std(other)


@pytest.mark.parametrize("source", [{}, {"size": 3e-4, "bandwidth": 6e-9}], ids=["point", "wide"])
def test_libraries_of_arrays_agree(other_library, source):
    """Compare images, and the field of descents, with its slope and its starting phases."""
    model, rng = DisplayModel(GREEN, **OFF, **source), np.random.default_rng(4)
    phases = rng.uniform(0, TURN, (23, 32)).astype(np.float32)
    back = (rng.normal(size=(29, 38)) + 1j * rng.normal(size=(29, 38))).astype(np.complex64)
    found = []
    for library in (np, other_library):
        own, on = library.asarray(phases), library.asarray(back)
        light, shown = (
            DisplayLight(model, phases.shape, PITCH, Z, gaussian_points.THIRD, on),
            ShownLight(model, phases.shape, PITCH, 3, on),
        )
        image, begun = light.picture(light.spectra(own), Z), shown.phases_for(on)
        values = image, begun, shown.light(own), shown.slope(own, on)
        assert all(isinstance(each, type(own)) for each in values)
        image, begun, *rest = map(np.asarray, values)
        found.append([image, np.exp(1j * begun), *rest])
    for expected, values in zip(*found, strict=True):
        assert np.linalg.norm(values - expected) < 1e-5 * np.linalg.norm(expected)


@pytest.mark.oracle
def test_torchoptics_agrees():
    """Compare the light behind an ideal display's stop, propagated to the same distance."""
    torch, torchoptics = pytest.importorskip("torch"), pytest.importorskip("torchoptics")
    phases = np.random.default_rng(3).uniform(0, TURN, (SIDE, SIDE))
    light = DisplayLight(DisplayModel(GREEN), phases.shape, PITCH, Z)
    spectrum = light.relayed(light.spectra(phases)[GREEN])
    field = np.fft.ifft2(spectrum)
    rolled = np.fft.fftshift(field)
    torchoptics.set_default_spacing(PITCH / GRID)
    torchoptics.set_default_wavelength(GREEN)
    wave = torchoptics.Field(torch.tensor(rolled)).propagate_to_z(Z)
    theirs = np.fft.ifftshift(np.abs(wave.data.numpy()) ** 2)[: GRID * SIDE : GRID, : GRID * SIDE : GRID]
    assert np.std(picture(DisplayModel(GREEN), phases) - theirs) < 0.03 * np.std(theirs)


@pytest.mark.parametrize(
    "wrong",
    [
        {"unmodulated": 1.5},
        {"crosstalk": -1},
        {"tilt": (0.0,)},
        {"size": -1e-3},
        {"aberrations": (math.nan,) * 8},
    ],
)
def test_no_display_is_so(wrong):
    with pytest.raises(engine.InvalidInput, match="display model|crosstalk"):
        DisplayModel(GREEN, **wrong)


def test_crosstalk_too_short_to_be_sampled_is_refused_in_a_file():
    for crosstalk in (0.0, 0.15):
        assert DisplayModel.from_dict({"wavelength_nm": 520, "crosstalk": crosstalk}).crosstalk == crosstalk
    with pytest.raises(engine.InvalidInput, match="0.1 pixels is too short"):
        DisplayModel.from_dict({"wavelength_nm": 520, "crosstalk": 0.1})


def test_form_on_disk():
    model = DisplayModel(GREEN, **OFF, size=1e-4, bandwidth=2e-9, half=1e-3)
    again = DisplayModel.from_dict(model.to_dict())
    assert again.to_dict() == model.to_dict() and again.half == pytest.approx(1e-3)
