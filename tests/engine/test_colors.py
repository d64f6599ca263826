"""Colors that do not lie on each other by themselves: made up for in fields and phases, and seen where they are not."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine import Hologram, InvalidInput, Optics

RGB = (640e-9, 516.5e-9, 455.4e-9)
ENDS = {"depth_far": 0.5e-3, "depth_near": 3e-3}
APART = Optics(
    color_scale=(1.02, 1.0, 0.98),
    color_distance=(0.2e-3, 0.0, -0.3e-3),
    color_shift=((12e-6, 0.0), (0.0, 0.0), (0.0, -20e-6)),
)


@pytest.fixture(scope="module")
def slanted(build):
    return build.scene(plane=build.plane(1.0, build.emissive(build.texture(512, 3)), 0.8, 0.4, slant=60))


def test_colors_that_are_as_they_should_be_are_nothing():
    plain = Optics(color_scale=(1, 1, 1), color_distance=(0.0,) * 3, color_shift=((0, 0),) * 3)
    assert plain == Optics() and plain.to_dict() == {}
    assert Hologram(64, 64, 8e-6, optics=plain).picture.width == 64


def test_where_colors_lie_is_kept_in_json():
    hologram = Hologram(64, 64, 8e-6, RGB, optics=APART)
    assert Hologram.from_dict(json.loads(json.dumps(hologram.to_dict()))) == hologram


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"color_scale": (1.0, 1.1)}, "a scale for each of 3 wavelengths, got 2"),
        ({"color_distance": (1e-3,)}, "a distance for each of 3 wavelengths, got 1"),
        ({"color_shift": ((1e-6, 0),) * 2}, "a shift for each of 3 wavelengths, got 2"),
        ({"color_scale": (1.0, 1.0, 0.0)}, "from 0.5 to 2, got 0"),
        ({"color_scale": (102.0, 1.0, 1.0)}, "got 102"),
        ({"color_scale": (math.nan, 1.0, 1.0)}, "got nan"),
        ({"color_distance": (0.0, math.inf, 0.0)}, "finite distances"),
        ({"color_shift": ((0.0, 0.0), (1.0,), (0.0, 0.0))}, "two finite numbers"),
    ],
)
def test_where_colors_cannot_lie(given, says):
    with pytest.raises(InvalidInput, match=says):
        Hologram(64, 64, 8e-6, RGB, optics=Optics(**given))


def test_equal_wavelengths_cannot_lie_apart():
    with pytest.raises(InvalidInput, match="Expected different wavelengths"):
        Hologram(64, 64, 8e-6, (RGB[0],) * 2, optics=Optics(color_scale=(1.0, 1.01)))


def test_each_color_of_a_dot_is_focused_where_it_should_be(build, camera):
    """Compared with direct sums of the field's pixels, at their place on the bench for each color."""
    hologram = Hologram(64, 64, 8e-6, RGB, **ENDS, near=0.5, optics=APART)
    across, pixel = 0.05, 2 * math.tan(camera.fov_x / 2) / 64
    dot = build.plane(1.0, build.emissive(build.gray(1.0)), 0.8 * pixel, x=across)
    settings = engine.Settings(frames=1, phase_field="smooth", randomness=0.0, method="full")
    field = engine.render(build.scene(dot=dot), camera, hologram, settings)
    place, z = across * field.mapping.focal, float(field.mapping.depth_to_z(1.0))
    axis, steps = (np.arange(64) - 31.5) * 8e-6, np.arange(-3, 3.01, 0.25) * 8e-6
    for k, wavelength in enumerate(RGB):
        (right, up), scale = APART.color_shift[k], APART.color_scale[k]
        x, y = scale * axis[None, :] + right, scale * axis[:, None] - up
        away = z - APART.color_distance[k]

        def light(x_0, y_0, x=x, y=y, away=away, k=k, wavelength=wavelength):
            ways = np.sqrt(away**2 + (x - x_0) ** 2 + (y - y_0) ** 2)
            return abs((field.data[0, k] * np.exp(2j * math.pi / wavelength * ways) / ways).sum()) ** 2

        for line in ([light(place + s, 0.0) for s in steps], [light(place, s) for s in steps]):
            assert abs(np.dot(line, steps) / np.sum(line)) < 0.2 * 8e-6


def test_two_percent_apart_uncorrected_and_corrected(slanted, camera):
    """PSNR of the color picture by the thin lens, of fields and phases: within 0.3 dB of colors that lie right."""
    focus, side = [0.8], 64
    plain = Hologram(side, side, 8e-6, RGB, **ENDS)
    apart = replace(plain, optics=Optics(color_scale=(1.02, 1.0, 0.98)))
    settings = engine.Settings(frames=8, phase_field="designed", method="full")

    def score(light, hologram):
        truth = engine.reference(slanted, camera, hologram, focus, spp=32, near=light.near, halves=True)
        picture = engine.reconstruct(light, focus)[0]
        if light is made_up:
            inner = np.s_[10:-10, 10:-10]
            bright = picture[inner].mean((0, 1)) / truth[0].mean(0)[inner].mean((0, 1))
            np.testing.assert_allclose(bright, 1, atol=0.02)
        return engine.psnr(picture, truth[0], 10)

    straight, made_up = (engine.render(slanted, camera, each, settings) for each in (plain, apart))
    best, left, found = (
        score(straight, plain),
        score(replace(straight, hologram=apart), apart),
        score(made_up, apart),
    )
    assert left < best - 3 and found > best - 0.3
    phases = [engine.encode(field, "joint", max_steps=30) for field in (straight, made_up)]
    left, found = score(replace(phases[0], hologram=apart).field(), apart), score(phases[1].field(), apart)
    assert left < found - 2 and found > score(phases[0].field(), plain) - 0.3


def test_a_stored_field_goes_to_another_panel(slanted, camera):
    """The same as rendered for it, except for the border, whose light its own panel had lost."""
    settings = engine.Settings(frames=2, method="full", seed=1)
    plain = engine.render(slanted, camera, Hologram(64, 64, 8e-6, RGB, **ENDS), settings)
    moved = engine.at_panel(plain, APART)
    assert moved.hologram.optics == APART
    focus, picture = [1.0], plain.hologram.picture
    shown, target = engine.reconstruct(moved, focus)[0], engine.reconstruct(plain, focus)[0]
    assert picture.width == 64 and shown.shape == (63, 63, 3)
    a, b = (each[10:-10, 10:-10].mean((0, 1)) for each in (shown, target))
    np.testing.assert_allclose(a, b, rtol=0.03)
    back = engine.at_panel(moved, Optics())
    inner = np.s_[..., 16:-16, 16:-16]
    error = np.linalg.norm(back.data[inner] - plain.data[inner]) / np.linalg.norm(plain.data[inner])
    assert error < 0.15  # of directions beyond the cone of the largest pitch
    assert engine.at_panel(plain, Optics()).data is plain.data


@pytest.mark.parametrize(
    "method", ["rgbd", "focal-stack", pytest.param("light-field", marks=pytest.mark.slow), "rgbd-sgd"]
)
def test_other_methods_make_up_for_it(slanted, camera, method):
    found = []
    for optics in (Optics(), APART):
        hologram = Hologram(64, 64, 8e-6, RGB, **ENDS, optics=optics)
        settings = engine.Settings(frames=4, method=method, quality="draft")
        field = engine.render(slanted, camera, hologram, settings)
        truth = engine.reference(slanted, camera, hologram, [1.0], spp=16, near=field.near)[0]
        found.append(engine.psnr(engine.reconstruct(field, [1.0])[0], truth, 10))
    assert found[1] > min(found[0], 29) - 1  # pictures are brought to each color's pixels to 30 dB
