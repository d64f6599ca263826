"""The beam on the SLM and the stop behind it: against formulas of optics, and phases that make up for them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.encoding.views import ViewedVolume, Views, ViewTargets
from holopath_addon.engine.waves.propagation import propagate

PITCH, GREEN = 8e-6, 520e-9
SHAPE = (90, 128)


def panel(beam=None, **changes):
    optics = engine.Optics(beam or engine.Beam())
    given = {"depth_far": 1e-3, "depth_near": 1.5e-3} | changes
    return engine.Hologram(SHAPE[1], SHAPE[0], PITCH, (GREEN,), **given, optics=optics)


def phases(data, hologram):
    data = np.asarray(data, np.float32).reshape(1, 1, *SHAPE)
    return engine.PhaseHologram(data, hologram, engine.Camera(np.eye(4), 0.5), 1.0, "none", (1.0,))


def places():
    y, x = (PITCH * (np.arange(n) - (n - 1) / 2) for n in SHAPE)
    return x[None, :], -y[:, None]


@pytest.mark.parametrize("distance", [-0.1, 0.1])
def test_a_point_is_a_lens(distance):
    """Goodman, Introduction to Fourier Optics, section 5.1: a lens of focal length f has the phase -k r^2 / 2 f.

    A beam that converges on a point is what a lens of that focal length makes of a flat one.
    """
    x, y = places()
    lens = np.exp(1j * math.pi * (x**2 + y**2) / (GREEN * distance))
    light = engine.Beam("point", (distance,)).light(SHAPE, PITCH, GREEN)
    assert np.linalg.norm(light - lens) < 1e-3 * np.linalg.norm(lens)
    flat = phases(np.mod(np.angle(lens), 2 * math.pi), panel()).field().data
    beam = phases(np.zeros(SHAPE), panel(engine.Beam("point", (distance,)))).field().data
    assert np.linalg.norm(beam - flat) < 1e-3 * np.linalg.norm(flat)


def test_a_converging_beam_has_its_focus_there():
    """The Airy pattern's and sinc's width: lambda D / side between the middle and the first zero."""
    light = engine.Beam("point", (-30e-3,)).light(SHAPE, PITCH, GREEN)
    intensity = np.abs(propagate(light, PITCH, GREEN, 30e-3)) ** 2
    row = intensity[SHAPE[0] // 2 - 1 : SHAPE[0] // 2 + 1].mean(0)
    x, _ = places()
    target = np.sinc(x[0] * SHAPE[1] * PITCH / (GREEN * 30e-3)) ** 2
    assert np.abs(row / row.max() - target / target.max()).max() < 0.02


def test_a_tilt_is_a_plane_wave():
    angles = math.radians(0.7), math.radians(-0.4)
    light = engine.Beam("tilt", angles).light(SHAPE, PITCH, GREEN)
    x, y = places()
    wave = np.exp(2j * math.pi / GREEN * (x * math.sin(angles[0]) + y * math.sin(angles[1])))
    assert np.abs(light - wave).max() < 1e-5
    # forward, what runs to the right and down is found there
    spot = light * np.exp(-(x**2 + y**2) / (2 * (12 * PITCH) ** 2))
    intensity = np.abs(propagate(spot, PITCH, GREEN, 10e-3)) ** 2
    middle = [float((axis * intensity).sum() / intensity.sum()) for axis in (x, y)]
    np.testing.assert_allclose(middle, [10e-3 * math.tan(a) for a in angles], atol=0.1 * PITCH)


def test_a_gaussian_beam_has_its_waist():
    """w(z) = w_0 sqrt(1 + (z / z_R)^2), z_R = pi w_0^2 / lambda (Saleh and Teich, section 3.1)."""
    waist, at, distance = 60e-6, (40e-6, -30e-6), 40e-3
    light = engine.Beam("gaussian", (waist, *at)).light((256, 256), PITCH, GREEN)
    y, x = (PITCH * (np.arange(256) - 127.5) for _ in range(2))
    x, y = x[None, :], -y[:, None]
    for z in (0.0, distance):
        intensity = np.abs(propagate(light, PITCH, GREEN, z)) ** 2
        middle = [float((axis * intensity).sum() / intensity.sum()) for axis in (x, y)]
        np.testing.assert_allclose(middle, at, atol=1e-7)
        width = 2 * math.sqrt(float((((x - middle[0]) ** 2) * intensity).sum() / intensity.sum()))
        assert width == pytest.approx(waist * math.hypot(1, z * GREEN / (math.pi * waist**2)), rel=1e-3)


def radii():
    return np.hypot(*np.meshgrid(*(np.fft.fftfreq(n) for n in SHAPE), indexing="ij"))


def error(phase, field, beam, method="sgd"):
    """Squared error of the light by phases on a beam, relative to the field's, at the best scale.

    In the whole band, or for double phase, whose other light goes astray, in that of the field. All frames together are
    free to have other phases: there it is that of amplitudes in the volume.
    """
    alone = engine.PhaseHologram(phase.data, panel(), field.camera, 1.0, "none", (1.0,))
    shown = alone.field().data * beam.light(SHAPE, PITCH, GREEN)
    if method == "joint":
        a, b = (np.abs(propagate(data[0, 0], PITCH, GREEN, 1.25e-3)) for data in (shown, field.data))
    else:
        band = radii() <= (0.16 if method == "dpac" else 0.5)
        a, b = (np.fft.fft2(data)[0, 0][band] for data in (shown, field.data))
    scale = np.vdot(a, b) / np.vdot(a, a)
    return float(np.linalg.norm(scale * a - b) ** 2 / np.linalg.norm(b) ** 2)


@pytest.fixture(scope="module")
def target():
    """A field of narrow band, which phases can show well."""
    rng = np.random.default_rng(2)
    noise = rng.normal(size=SHAPE) + 1j * rng.normal(size=SHAPE)
    data = np.fft.ifft2(np.fft.fft2(noise) * (radii() < 0.15)).astype(np.complex64)
    return engine.WaveField(data[None, None], panel(), engine.Camera(np.eye(4), 0.5), 1.0)


BEAMS = {
    "tilt": engine.Beam("tilt", (0.01, 0.004)),
    "point": engine.Beam("point", (-50e-3,)),
    "gaussian": engine.Beam("gaussian", (0.45e-3, 0.1e-3, 0.0)),
}


@pytest.mark.parametrize("method", ["sgd", "dpac", "joint"])
@pytest.mark.parametrize("kind", BEAMS)
def test_phases_make_up_for_a_beam(target, kind, method):
    """Quality of a flat beam where each pixel has light, and better than by phases that ignore the beam."""
    beam = BEAMS[kind]
    on_beam = engine.WaveField(target.data, panel(beam), target.camera, target.near)
    steps = {"max_steps": 40} if method != "dpac" else {}
    flat, made = (engine.encode(field, method, **steps) for field in (target, on_beam))
    good, bad = (error(phase, target, beam, method) for phase in (made, flat))
    best = error(flat, target, engine.Beam(), method)
    assert made.hologram.optics.beam == beam
    if (
        kind == "gaussian"
    ):  # whose dark edges no phases make bright: 0.24 to 0.18, 0.17 to 0.05, and 0.18 to 0.06
        assert best < good < 0.8 * bad
    else:
        assert good < 1.01 * best and bad > 5 * best


def test_few_levels_make_up_for_a_beam(target):
    beam = BEAMS["point"]
    on_beam = engine.WaveField(target.data, panel(beam), target.camera, target.near)
    flat, made = (engine.encode(field, "sgd", bits=2, max_steps=40) for field in (target, on_beam))
    assert set(np.unique(np.round(made.data / (math.pi / 2)))) <= {0, 1, 2, 3}
    assert error(made, target, beam) < 1.3 * error(flat, target, engine.Beam())


def test_the_gain_counts_the_beam(target):
    """A beam that is dimmer at the edges is sent in stronger: what is seen is as bright."""
    on_beam = engine.WaveField(target.data, panel(BEAMS["gaussian"]), target.camera, target.near)
    made = [engine.encode(field, "sgd", max_steps=5).field().data for field in (target, on_beam)]
    band = radii() <= 0.5
    energies = [float((np.abs(np.fft.fft2(data)[0, 0][band]) ** 2).sum()) for data in (*made, target.data)]
    np.testing.assert_allclose(energies[:2], energies[2], rtol=1e-3)


def test_a_measured_beam_is_kept(target, tmp_path):
    x, y = places()
    measured = np.exp(-(x**2 + 2 * y**2) / 1e-3**2) * np.exp(
        2j * math.pi * 3e5 * (x**2 - y**2) / GREEN * 1e-5
    )
    beam = engine.Beam("measured", measured=5 * measured)
    np.testing.assert_allclose(beam.light(SHAPE, PITCH, GREEN), measured / np.abs(measured).max(), atol=1e-6)
    field = engine.WaveField(target.data, panel(beam), target.camera, target.near)
    phase = engine.encode(field, "sgd", max_steps=40)
    unaware = engine.encode(target, "sgd", max_steps=40)
    best, bad = error(unaware, target, engine.Beam()), error(unaware, target, beam)
    assert error(phase, target, beam) < 1.2 * best < 0.2 * bad
    phase.save(tmp_path / "hologram")
    field.save(tmp_path / "wavefield")
    for again in (
        engine.PhaseHologram.load(tmp_path / "hologram"),
        engine.WaveField.load(tmp_path / "wavefield"),
    ):
        assert again.hologram == field.hologram != panel()
        np.testing.assert_array_equal(again.hologram.optics.beam.measured, beam.measured)
    phase.save(tmp_path / "hologram")  # replaces its own
    (tmp_path / "hologram" / "beam.npy").unlink()
    with pytest.raises(engine.InvalidInput, match="Give it by --beam"):
        engine.PhaseHologram.load(tmp_path / "hologram")


def test_what_is_as_by_default_is_not_told(target, tmp_path):
    assert "optics" not in panel().to_dict()
    meta = json.loads(json.dumps(panel(BEAMS["gaussian"]).to_dict()))
    assert meta["optics"] == {"beam": {"kind": "gaussian", "numbers": [0.45e-3, 0.1e-3, 0.0]}}
    assert engine.Hologram.from_dict(meta) == panel(BEAMS["gaussian"])
    assert panel().illumination(0) is None
    target.save(tmp_path / "wavefield")
    assert {path.name for path in (tmp_path / "wavefield").iterdir()} == {"field.npy", "meta.json"}
    assert engine.WaveField.load(tmp_path / "wavefield").hologram == panel()


@pytest.mark.parametrize(
    ("kind", "numbers"),
    [
        ("round", ()),
        ("flat", (1,)),
        ("tilt", (0.1,)),
        ("tilt", (math.nan, 0)),
        ("tilt", (2, 0)),
        ("point", (0,)),
        ("gaussian", (0,)),
        ("gaussian", (1e-3, 0)),
        ("measured", ()),
    ],
)
def test_beams_that_cannot_be(kind, numbers):
    with pytest.raises(engine.InvalidInput, match="beam"):
        engine.Beam(kind, numbers)


@pytest.mark.parametrize(
    ("beam", "says"),
    [
        (engine.Beam("gaussian", (0.1e-3, 1e-3, 0)), "passes the panel"),
        (engine.Beam("tilt", (0.1, 0)), "compensate 1.86 degrees at most"),
        (engine.Beam("point", (-5e-3,)), "compensate 1.86 degrees at most"),
        (
            engine.Beam("measured", measured=np.ones((8, 8))),
            "a measured beam of 128 x 90 pixels, the panel's, got 8 x 8",
        ),
        (
            engine.Beam("measured", measured=np.ones((2, *SHAPE))),
            "for each of 1 wavelengths, or one for all, got 2",
        ),
    ],
)
def test_beams_that_do_not_fit_the_panel(beam, says):
    with pytest.raises(engine.InvalidInput, match=says):
        panel(beam)


def test_measured_beams_that_cannot_be():
    for measured, says in (
        (np.zeros(SHAPE), "with light"),
        (np.full(SHAPE, np.nan), "finite values"),
        (-np.ones(SHAPE), "amplitudes of 0 or more"),
        (np.ones(9), "shape"),
    ):
        with pytest.raises(engine.InvalidInput, match=says):
            engine.Beam("measured", measured=measured)
    with pytest.raises(engine.InvalidInput, match="one wavelength of 3"):
        beam = engine.Beam("measured", measured=np.full(SHAPE, 1j))
        engine.Hologram(SHAPE[1], SHAPE[0], PITCH, optics=engine.Optics(beam))


@pytest.mark.parametrize(
    "optics",
    [
        {"beam": BEAMS["tilt"]},
        {"carrier": "auto"},
        {"stop": engine.Stop("half")},
        {"color_scale": (1.02,)},
        {"lens": engine.Lens(0.1)},
    ],
)
def test_a_fitted_display_has_a_beam_of_its_own(target, optics):
    on_bench = replace(target.hologram, optics=engine.Optics(**optics))
    field = engine.WaveField(target.data, on_bench, target.camera, target.near)
    display = [engine.DisplayModel(GREEN)]
    with pytest.raises(engine.InvalidInput, match="a beam and a stop of its own"):
        engine.encode(field, "sgd", display=display)
    with pytest.raises(engine.InvalidInput, match="a beam and a stop of its own"):
        engine.encode(field, "dpac").field(display=display)


def bench(carrier=None, stop=None, beam=None):
    return engine.Optics(beam or engine.Beam(), carrier, stop or engine.Stop())


@pytest.mark.parametrize("carrier", [(0.5, 0.0), (-0.25, 0.5)])
def test_a_grating_sends_light_along_the_carrier(carrier):
    """A phase that rises by pi c a pixel is a prism: its first order is at c, and there is the picture's middle."""
    y, x = np.indices((64, 64))
    phase = np.mod(math.pi * (carrier[0] * x - carrier[1] * y), 2 * math.pi)
    hologram = engine.Hologram(64, 64, PITCH, (GREEN,), optics=bench(carrier))
    data = phase.astype(np.float32)[None, None]
    field = engine.PhaseHologram(data, hologram, engine.Camera(np.eye(4), 0.5), 1.0, "none", (1.0,)).field()
    spectrum = np.abs(np.fft.fft2(field.data[0, 0])) / 64**2
    assert spectrum[0, 0] == pytest.approx(1, abs=1e-4)
    # without it, the zero order of the same panel lies as far on the other side
    dark = engine.PhaseHologram(0 * data, hologram, field.camera, 1.0, "none", (1.0,)).field()
    row, column = np.unravel_index(np.argmax(np.abs(np.fft.fft2(dark.data[0, 0]))), (64, 64))
    assert (np.fft.fftfreq(64)[column], np.fft.fftfreq(64)[row]) == (-carrier[0] / 2, carrier[1] / 2)
    assert not hologram.optics.stop_mask((64, 64))[row, column]


def test_areas_and_places_of_stops():
    def share(optics, total=math.pi / 4):
        return float(optics.stop_mask((500, 500)).mean()) / total

    assert share(bench()) == pytest.approx(1, rel=5e-3)
    assert share(bench(stop=engine.Stop("circle", (0.5,)))) == pytest.approx(0.25, rel=1e-2)
    assert share(bench("auto")) == pytest.approx(0.48**2, rel=1e-2)
    assert share(bench(stop=engine.Stop("half"), carrier=(0, 0))) == pytest.approx(0.5, rel=1e-2)
    assert share(bench("auto", engine.Stop("rectangle", (0.5, 0.8))), 1) == pytest.approx(0.1, rel=2e-2)
    up = bench((0, 0), engine.Stop("half", (math.pi / 2,))).stop_mask((32, 32))
    assert up[-5, 3] and not up[5, 3]  # rows count downwards, and so do their frequencies
    right = bench((0, 0), engine.Stop("half")).stop_mask((32, 32))
    assert right[3, 5] and not right[3, -5]
    upper_left = np.zeros((4, 4), bool)
    upper_left[:2, :2] = True
    measured = bench((0, 0), engine.Stop("measured", measured=upper_left)).stop_mask((32, 32))
    assert measured[-5, -5] and not (measured[5, 5] or measured[-5, 5] or measured[5, -5])
    assert bench("auto", engine.Stop("measured", measured=upper_left)).carrier == (-0.5, 0.5)
    for optics, opening in (
        (bench("auto"), (0, 0, 0.48)),
        (bench((0, 0), engine.Stop("half")), (0.5, 0, 0.49)),
        (bench("auto", engine.Stop("rectangle", (0.5, 0.8))), (0, 0, 0.25)),
    ):
        np.testing.assert_allclose(optics.stop_circle, opening, atol=0.04)


def test_what_is_seen_through_a_rectangle():
    """Fraunhofer: a point has the image sinc^2(W x / 2 pitch) sinc^2(H y / 2 pitch), Goodman, section 4.4.1."""
    width, height, side = 0.5, 0.8, 65
    optics = bench("auto", engine.Stop("rectangle", (width, height)))
    hologram = engine.Hologram(side, side, PITCH, (GREEN,), -1e-3, 1e-3, optics=optics)
    point = np.zeros((1, 1, side, side), np.complex64)
    point[0, 0, side // 2, side // 2] = 1
    field = engine.WaveField(point, hologram, engine.Camera(np.eye(4), 0.5), 1.0)
    at_slm = float(field.mapping.z_to_depth(0.0))
    intensity = engine.reconstruct(field, [at_slm])[0, ..., 0]
    x = np.arange(side) - side // 2
    target = (np.sinc(width * x / 2)[None, :] * np.sinc(height * x / 2)[:, None]) ** 2
    # bins of the grid make the rectangle wider or narrower by one
    assert np.abs(intensity / intensity.max() - target).max() < 0.04
    with pytest.raises(engine.InvalidInput, match="outside the light that passes the stop"):
        radius = field.mapping.pupil_radius(hologram.max_slope(GREEN))
        engine.reconstruct(field, [at_slm], engine.Pupil(0.8 * radius, 0, 0.1 * radius))


OFF_AXIS = {
    "circle": bench("auto"),
    "half": bench(stop=engine.Stop("half", (math.radians(30),))),
    "rectangle": bench("auto", engine.Stop("rectangle", (0.6, 1.2))),
}


def off_axis(target, optics):
    hologram = engine.Hologram(SHAPE[1], SHAPE[0], PITCH, (GREEN,), 1e-3, 1.5e-3, optics=optics)
    return engine.WaveField(target.data, hologram, target.camera, target.near)


@pytest.mark.parametrize("kind", OFF_AXIS)
def test_a_binary_panel_shows_no_twin_off_axis(target, kind):
    """Light of phases 0 and pi is real: on axis as much of it is the field's conjugate, the twin, as the field."""

    def shares(field, optics):
        phase = engine.encode(field, "sgd", bits=1, max_steps=40)
        assert set(np.unique(phase.data).round(4)) == {0, np.float32(math.pi).round(4)}
        shown = np.fft.fft2(phase.field().data[0, 0]) * optics.stop_mask(SHAPE)
        picture = np.fft.fft2(field.data[0, 0])
        twin = np.fft.fft2(field.data[0, 0].conj())
        own, other = (
            abs(np.vdot(each, shown)) ** 2 / np.vdot(each, each).real / np.vdot(shown, shown).real
            for each in (picture, twin)
        )
        return own, other

    on_axis = shares(target, engine.Optics())
    own, twin = shares(off_axis(target, OFF_AXIS[kind]), OFF_AXIS[kind])
    assert on_axis[0] == pytest.approx(on_axis[1], rel=1e-3)
    assert own > 1.4 * on_axis[0] and twin < 0.01 * own


def test_the_zero_order_is_left_out(target):
    """Light that leaves as it came changes nothing behind an off-axis stop but the brightness."""
    leaking = engine.Modulator(unmodulated=0.1)
    for optics, changed in ((OFF_AXIS["circle"], False), (engine.Optics(), True)):
        phase = engine.encode(off_axis(target, optics), "sgd", max_steps=10)
        ideal, real = (engine.reconstruct(phase.field(each), [1.2])[0] for each in (None, leaking))
        change = np.linalg.norm(real / 0.9 - ideal) / np.linalg.norm(ideal)
        assert (change > 0.3) == changed and (change < 0.1) == (not changed)


@pytest.mark.parametrize("method", ["sgd", "dpac", "joint"])
def test_encodings_go_towards_what_passes_the_stop(target, method):
    """Phases without rounding show the field as well as on axis, and a beam changes nothing of it."""
    for optics in (OFF_AXIS["circle"], bench("auto", beam=BEAMS["point"])):
        phase = engine.encode(
            off_axis(target, optics), method, **({} if method == "dpac" else {"max_steps": 40})
        )
        intensity = engine.reconstruct(phase.field(), [1.2])[0].ravel()
        assert np.corrcoef(intensity, engine.reconstruct(target, [1.2])[0].ravel())[0, 1] > 0.95


def blocks(size):
    """A picture with hard edges, of squares of so many pixels."""
    rng = np.random.default_rng(3)
    return np.kron(rng.uniform(0.05, 1, (64 // size, 64 // size)), np.ones((size, size)))[..., None]


def test_pictures_are_found_before_a_stop_blurs_them():
    """Incoherent images through the stop, by Goodman, give back the picture; parts of the pupil stay."""
    optics, picture = OFF_AXIS["circle"], blocks(8)
    hologram = engine.Hologram(64, 64, PITCH, (GREEN,), optics=optics)
    targets = ViewTargets(Views(ViewedVolume((64, 64), PITCH, GREEN, -1e-4, 1e-4, optics), 24, 0))
    blurred = engine.diffracted(picture, hologram)[..., 0]
    for target in targets.intensities:
        target[:] = blurred if target.shape == (64, 64) else 1
    targets.sharpen()
    inner = np.s_[8:-8, 8:-8]
    for target, viewpoint in zip(targets.intensities, targets.views.viewpoints, strict=True):
        if viewpoint.part is not None:
            assert (target == 1).all()
            continue
        before, after = (np.linalg.norm((each - picture[..., 0])[inner]) for each in (blurred, target))
        assert after < 0.7 * before and target.min() >= 0
        assert target[inner].mean() == pytest.approx(blurred[inner].mean(), rel=0.01)


@pytest.mark.slow
def test_phases_of_one_bit_are_sharper_than_the_stop_is_by_itself(monkeypatch):
    """A gain of more than a decibel against the picture itself, for frames that go towards many of random phases."""
    picture, optics = blocks(4), OFF_AXIS["circle"]
    hologram = engine.Hologram(64, 64, PITCH, (GREEN,), -1e-4, 1e-4, optics=optics)
    rng = np.random.default_rng(0)
    light = np.sqrt(picture[None, ..., 0]) * np.exp(2j * math.pi * rng.random((200, 64, 64)))
    spectrum = np.fft.fft2(light) * engine.Optics().stop_mask((64, 64))
    light = np.fft.ifft2(spectrum).astype(np.complex64)[:, None]
    field = engine.WaveField(light[:16], hologram, engine.Camera(np.eye(4), 0.5), 1.0)

    def shown():
        many = [([0], light[16:])]
        phase = engine.encode(field, "refine", extra_frames=lambda progress: many, bits=1, max_steps=60)
        at_slm = float(field.mapping.z_to_depth(0.0))
        return engine.psnr(engine.reconstruct(phase.field(engine.Modulator(bits=1)), [at_slm])[0], picture, 8)

    sharp = shown()
    monkeypatch.setattr(ViewTargets, "sharpen", lambda targets: None)
    assert sharp > shown() + 1


def test_a_thin_lens_behind_the_same_stop(build, camera):
    """Rays and waves agree where a half stop moves what is out of focus: by the middle of a half disk, 4 r / 3 pi."""
    scene = build.scene(wall=build.plane(1.0, build.emissive(build.texture(32, 1)), 0.08, 0.08))
    optics = bench((0, 0), engine.Stop("half", (math.pi / 2,)))
    hologram = engine.Hologram(64, 64, PITCH, (GREEN,), -0.4e-3, 0.6e-3, near=0.5, optics=optics)
    middles = {}
    field = engine.render(scene, camera, hologram, engine.Settings(frames=4, method="direct"))
    for focus in (0.5, 1.0):
        truth = engine.reference(scene, camera, hologram, [focus], spp=64)[0, ..., 0]
        intensity = engine.reconstruct(field, [focus])[0, ..., 0]
        rows = np.arange(64)[:, None]
        middles[focus] = [float((rows * each).sum() / each.sum()) for each in (truth, intensity)]
    moved = np.subtract(middles[0.5], middles[1.0])
    z = field.mapping.depth_to_z([0.5, 1.0])
    pixels = 4 / (3 * math.pi) * hologram.max_slope(GREEN) * (z[0] - z[1]) / PITCH
    assert abs(pixels) > 0.5
    np.testing.assert_allclose(np.abs(moved), abs(pixels), rtol=0.2)
    assert moved[0] * moved[1] > 0


def test_a_stop_is_kept(target, tmp_path):
    mask = np.zeros((20, 30), bool)
    mask[:, 16:] = True
    optics = bench("auto", engine.Stop("measured", measured=mask))
    field = off_axis(target, optics)
    field.save(tmp_path / "wavefield")
    again = engine.WaveField.load(tmp_path / "wavefield").hologram
    assert again == field.hologram and again.optics.carrier == optics.carrier
    np.testing.assert_array_equal(again.optics.stop.measured, mask)
    for optics in OFF_AXIS.values():
        meta = json.loads(json.dumps(off_axis(target, optics).hologram.to_dict()))
        assert engine.Hologram.from_dict(meta).optics == optics


@pytest.mark.parametrize(
    ("carrier", "stop", "says"),
    [
        ((1, 0), None, "closer than 1 to the zero order, got 1, 0"),
        ((0.5, math.nan), None, "Expected a carrier within the band"),
        ((0.5, 0), ("circle", (0.6,)), "within the band, .* reaches 1.1 times as far"),
        ((0.5, 0), ("rectangle", (1.5, 1)), "reaches 1.25 times"),
        (None, ("circle", (0,)), "a radius over 0"),
        (None, ("rectangle", (1,)), "a width and a height"),
        (None, ("half", (math.inf,)), "an angle"),
        (None, ("slit", ()), "a kind of stop, got 'slit'"),
        ((0.01, 0), ("circle", (0.005,)), "passes nothing of the picture"),
    ],
)
def test_stops_that_cannot_be(carrier, stop, says):
    with pytest.raises(engine.InvalidInput, match=says):
        bench(carrier, stop and engine.Stop(*stop))


def test_without_a_stop_there_is_no_stop(target):
    with pytest.raises(engine.InvalidInput, match="Omit one of them"):
        engine.encode(off_axis(target, OFF_AXIS["half"]), "sgd", has_stop=False)


@pytest.mark.parametrize(("turn", "passes"), [(0.0, False), (0.5, True), (-0.5, False), (0.1, True)])
def test_the_zero_order_goes_where_a_tilted_beam_does(turn, passes):
    """Sines of wavelength / (2 pitch) lie at the band's edge; the stop is a circle around half of that."""
    angle = math.asin(turn * GREEN / (2 * PITCH))
    optics = engine.Optics(engine.Beam("tilt", (angle, 0.0)), "auto")
    assert ("zero order passes the stop at 520 nm" in optics.zero_order_note(PITCH, (GREEN,))) == passes
    light = replace(panel(), optics=optics).illumination(0)
    spectrum = np.abs(np.fft.fft2(light)) ** 2
    assert (spectrum[optics.stop_mask(SHAPE)].sum() > 0.5 * spectrum.sum()) == passes


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"carrier": "left"}, "Expected the carrier as a list of numbers"),
        ({"color_scale": 1.02}, "Expected color_scale as a list"),
        ({"color_shift": (1e-5, 0.0)}, "Expected a pair of numbers for each color_shift"),
    ],
)
def test_values_that_are_no_list_of_numbers(values, says):
    with pytest.raises(engine.InvalidInput, match=says):
        engine.Optics(**values)
    with pytest.raises(engine.InvalidInput, match="Expected the numbers of the stop as a list"):
        engine.Stop("circle", 0.3)
    assert engine.Optics(carrier=np.array([0.5, 0.0])) == engine.Optics(carrier=(0.5, 0.0))


def test_maps_of_levels_that_do_not_fit():
    """As many pixels in another shape would be scrambled."""
    levels = engine.Levels(np.arange(16) * (math.pi / 8), correction=np.zeros((64, 180), np.float32))
    with pytest.raises(engine.InvalidInput, match="correction of the levels has the shape .64, 180"):
        phases(np.zeros(SHAPE), panel()).field(levels=[levels])
