"""Displays whose pixels are not square: grids, propagation, rendered fields, phases and pictures."""

import json
import math

import numpy as np
import pytest
from scipy.special import j1

from holopath_addon import engine
from holopath_addon.engine import Hologram, InvalidInput
from holopath_addon.engine.pixels import EvenSteps
from holopath_addon.engine.waves import propagation

GREEN = 516.5e-9
PITCH = (6.4e-6, 8e-6)
ENDS = {"depth_far": 0.5e-3, "depth_near": 3e-3}


def places(shape, pitch=PITCH):
    """x to the right and y down of columns and rows, meters from the middle."""
    y, x = ((np.arange(n) - (n - 1) / 2) * d for n, d in zip(shape, pitch[::-1], strict=True))
    return x[None, :], y[:, None]


# What a pitch is


def test_two_equal_numbers_are_one():
    assert Hologram(64, 64, (8e-6, 8e-6)) == Hologram(64, 64, 8e-6)
    assert Hologram(64, 64, 8e-6).picture == Hologram(64, 64, 8e-6)


def test_the_cone_is_round_and_that_of_the_larger_pitch():
    wide, square = Hologram(80, 64, PITCH), Hologram(64, 64, 8e-6)
    assert wide.max_slope(GREEN) == square.max_slope(GREEN)
    assert wide.captured_share(5e-3) == pytest.approx(square.captured_share(5e-3))
    assert (wide.depth_far, wide.depth_near) == (square.depth_far, square.depth_near)
    assert (wide.picture.width, wide.picture.height, wide.picture.pitch) == (64, 64, 8e-6)
    assert Hologram(64, 80, PITCH[::-1]).picture == wide.picture
    # 100 columns of 6.4 µm are 81.9 of 7.81 µm: the picture covers them
    assert Hologram(100, 64, (6.4e-6, 7.81e-6)).picture.width == 82


def test_a_pitch_is_kept_in_json():
    wide = Hologram(80, 64, PITCH)
    assert Hologram.from_dict(json.loads(json.dumps(wide.to_dict()))) == wide
    assert Hologram(64, 64, 8e-6).to_dict()["pitch"] == 8e-6


@pytest.mark.parametrize(
    ("pitch", "says"),
    [
        ((8e-6, 0.0), "a positive pixel pitch, got 0 µm"),
        ((math.nan, 8e-6), "a positive pixel pitch"),
        ((8e-6,) * 3, "got 3"),
        ((0.2e-6, 8e-6), "0.2 µm is too small for 640 nm"),
    ],
)
def test_impossible_pitches_are_refused(pitch, says):
    with pytest.raises(InvalidInput, match=says):
        Hologram(64, 64, pitch)


# Waves on such grids


@pytest.mark.parametrize("distance", [-30e-3, 10e-3])
def test_a_gaussian_beam(distance):
    """Closed form: Saleh and Teich, Fundamentals of Photonics, eq. 3.1-7."""
    x, y = places((200, 256))
    waist = 0.2e-3

    def beam(z):
        q = 1 + 1j * z * GREEN / (math.pi * waist**2)
        return np.exp(2j * math.pi * z / GREEN) * np.exp(-(x**2 + y**2) / (waist**2 * q)) / q

    there = propagation.propagate(beam(0).astype(np.complex64), PITCH, GREEN, distance)
    assert np.linalg.norm(there - beam(distance)) < 1e-4 * np.linalg.norm(beam(distance))


def test_a_spherical_wave_comes_to_an_airy_disk():
    """Towards a point aside, through a round aperture: Goodman, Introduction to Fourier Optics, section 4.4.2."""
    shape, z, radius = (200, 250), 30e-3, 0.6e-3
    (x, y), (x_0, y_0) = places(shape), (0.0512e-3, -0.08e-3)
    distance = np.sqrt(z**2 + (x - x_0) ** 2 + (y - y_0) ** 2)
    wave = np.exp(-2j * math.pi / GREEN * distance) * (np.hypot(x, y) <= radius)
    light = np.abs(propagation.propagate(wave.astype(np.complex64), PITCH, GREEN, z)) ** 2
    v = 2 * math.pi / GREEN * radius / z * np.maximum(np.hypot(x - x_0, y - y_0), 1e-12)
    disk = (math.pi * radius**2 / (GREEN * z)) ** 2 * (2 * j1(v) / v) ** 2
    assert np.abs(light - disk).max() < 0.02 * disk.max()


@pytest.mark.parametrize("steps", [(0.7, 1.23), (0.8, 1.25), (1.5, 31 / 30)])
def test_waves_between_pixels_are_direct_sums(steps):
    """Chirps, and FFTs where steps are whole parts of the grid."""
    rng = np.random.default_rng(0)
    shape, rows, columns = (24, 35), EvenSteps(-0.3, steps[0], 16), EvenSteps(2.1, steps[1], 17)
    band = np.hypot(*np.meshgrid(*map(np.fft.fftfreq, shape), indexing="ij")) < 0.3
    spectrum = (band * (rng.normal(size=shape) + 1j * rng.normal(size=shape))).astype(np.complex64)
    down, across = (line.first + line.step * np.arange(line.count) for line in (rows, columns))
    fy, fx = (np.fft.fftfreq(n) for n in shape)
    expected = (
        np.exp(2j * math.pi * np.outer(down, fy)) @ spectrum @ np.exp(2j * math.pi * np.outer(fx, across))
    )
    np.testing.assert_allclose(
        propagation.sampled(spectrum, (rows, columns)), expected / spectrum.size, atol=1e-6
    )


@pytest.mark.oracle
def test_torchoptics_agrees():
    torch, torchoptics = pytest.importorskip("torch"), pytest.importorskip("torchoptics")
    rng = np.random.default_rng(1)
    noise = rng.normal(size=(128, 160)) + 1j * rng.normal(size=(128, 160))
    fy, fx = (np.fft.fftfreq(n) for n in noise.shape)
    field = np.fft.ifft2(np.fft.fft2(noise) * (np.hypot(fy[:, None], fx) < 0.15))
    field = (field * np.hanning(128)[:, None] ** 2 * np.hanning(160) ** 2).astype(np.complex64)
    source = torchoptics.Field(torch.tensor(field, dtype=torch.complex128), GREEN, spacing=PITCH[::-1])
    there = source.propagate_to_z(10e-3, propagation_method="ASM", asm_pad=(384, 480)).data.numpy()
    ours = propagation.propagate(field, PITCH, GREEN, 10e-3, band="full")
    assert np.linalg.norm(ours - there) < 1e-4 * np.linalg.norm(there)


# Fields of scenes


@pytest.fixture(scope="module")
def slanted(build):
    return build.scene(plane=build.plane(1.0, build.emissive(build.texture(512, 3)), 0.8, 0.4, slant=60))


@pytest.mark.parametrize(("size", "pitch"), [((80, 64), PITCH), ((64, 75), (8e-6, 6.9e-6))])
def test_a_dot_is_focused_where_it_should_be(build, camera, size, pitch):
    """Compared with direct sums of the field's pixels: a round spot at the distance of the mapping."""
    hologram = Hologram(*size, pitch, (GREEN,), **ENDS, near=0.5)
    across, upward = 0.05, -0.08  # of the view, tangents
    pixel = 2 * math.tan(camera.fov_x / 2) / 64
    dot = build.plane(1.0, build.emissive(build.gray(1.0)), 0.8 * pixel, x=across)
    dot["to_world"] = build.T().translate([0, upward, 0]) @ dot["to_world"]
    settings = engine.Settings(frames=1, phase_field="smooth", randomness=0.0, method="full")
    field = engine.render(build.scene(dot=dot), camera, hologram, settings)
    mapping = field.mapping
    place, z = (across * mapping.focal, -upward * mapping.focal), float(mapping.depth_to_z(1.0))
    (x, y), steps = places(field.data.shape[-2:], pitch), np.arange(-3, 3.01, 0.25) * 8e-6

    def light(x_0, y_0):
        ways = np.sqrt(z**2 + (x - x_0) ** 2 + (y - y_0) ** 2)
        return abs((field.data[0, 0] * np.exp(2j * math.pi / GREEN * ways) / ways).sum()) ** 2

    lines = np.array(
        [[light(place[0] + s, place[1]) for s in steps], [light(place[0], place[1] + s) for s in steps]]
    )
    middle = (lines * steps).sum(1) / lines.sum(1)
    assert np.abs(middle).max() < 0.2 * 8e-6
    widths = np.sqrt((lines * (steps - middle[:, None]) ** 2).sum(1) / lines.sum(1))
    assert widths[0] == pytest.approx(widths[1], rel=0.1)


def test_pictures_are_those_of_square_pixels(slanted, camera):
    """Sharpness and brightness of 8 x 8 µm at the same size, by the thin lens; phases, too."""
    found, focus = {}, [0.8, 1.4]
    for pitch, width in ((8e-6, 96), (PITCH, 120)):
        hologram = Hologram(width, 96, pitch, (GREEN,), **ENDS)
        settings = engine.Settings(frames=8, phase_field="designed", method="full")
        field = engine.render(slanted, camera, hologram, settings)
        assert field.data.shape == (8, 1, 96, width)
        truth = engine.reference(slanted, camera, hologram, focus, spp=32, near=field.near, halves=True)
        phases = engine.encode(field, "joint", max_steps=30)
        rows = []
        for light in (field, phases.field()):
            for picture, halves in zip(engine.reconstruct(light, focus), truth, strict=True):
                inner = np.s_[12:-12, 12:-12]
                bright = picture[inner].mean() / halves.mean(0)[inner].mean()
                rows.append((engine.psnr(picture, halves, 12), 100 * bright))
        found[pitch] = np.array(rows)
    assert np.abs(found[8e-6] - found[PITCH])[:2].max() < 0.5  # dB, and hundredths
    assert (found[PITCH] - found[8e-6])[2:, 0].min() > -0.5  # of phases, which are more pixels
    np.testing.assert_allclose(found[PITCH][:, 1], 100, atol=2)


@pytest.mark.parametrize("method", ["rgbd", "stereogram"])
def test_other_methods_show_the_same(slanted, camera, method):
    pictures = []
    for pitch, width in ((8e-6, 48), (PITCH, 60)):
        settings = engine.Settings(frames=4, method=method, quality="draft")
        field = engine.render(slanted, camera, Hologram(width, 48, pitch, (GREEN,), **ENDS), settings)
        pictures.append(engine.reconstruct(field, [1.0])[0, 6:-6, 6:-6])
    difference = np.linalg.norm(pictures[1] - pictures[0]) / np.linalg.norm(pictures[0])
    assert difference < 0.05


@pytest.mark.parametrize("method", ["focal-stack", "light-field", "rgbd-sgd"])
def test_methods_that_find_phases_find_those_of_own_pixels(slanted, camera, method):
    """Sharpness and brightness of square pixels, by the thin lens; the light is of one modulus at the panel's own."""
    found = []
    for pitch, width in ((8e-6, 48), (PITCH, 60)):
        hologram = Hologram(width, 48, pitch, (GREEN,), **ENDS)
        settings = engine.Settings(frames=4, method=method, quality="draft")
        field = engine.render(slanted, camera, hologram, settings)
        assert (
            field.data.shape == (4, 1, 48, width)
            and np.abs(field.data).std() < 1e-4 * np.abs(field.data).mean()
        )
        truth = engine.reference(slanted, camera, hologram, [1.0], spp=64, near=field.near)[0]
        picture = engine.reconstruct(field, [1.0])[0]
        bright = picture[6:-6, 6:-6].mean() / truth[6:-6, 6:-6].mean()
        found.append((engine.psnr(picture, truth, 6), bright))
    (square, bright), (oblong, as_bright) = found
    assert oblong > square - 0.5
    # 30 steps look at each view of a light field once or twice; with 100 both are as bright within 3 %
    assert as_bright == pytest.approx(bright, rel=0.1 if method == "light-field" else 0.03)


@pytest.mark.parametrize("pitch", [8e-6, PITCH])
def test_rays_beside_the_picture_meet_no_measured_beam(slanted, camera, pitch):
    beam = engine.Beam("measured", measured=np.linspace(0.5, 1, 32 * 40).reshape(32, 40))
    hologram = Hologram(40, 32, pitch, (GREEN,), -0.1e-3, 0.1e-3, optics=engine.Optics(beam))
    field = engine.render(slanted, camera, hologram, engine.Settings(frames=1, method="full"))
    assert field.plan["beside"] > 0 and field.hologram.illumination(0).shape == field.data.shape[-2:]
