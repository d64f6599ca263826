"""Pictures that are compared: where they lie, and what their figures tell."""

import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.chart.figures import figures, flip, of_eight_bits
from benchmarks.chart.looks import (
    FOCI,
    HALFWAY,
    HEADLINE,
    LOOKS,
    border_of,
    diffracted,
    looks_of,
    middle_of,
    others_of,
    pupil_of,
    seen,
)
from holopath_addon import engine
from holopath_addon.engine.baselines.focal_stack import DEPTHS as DEPTHS_OF_STACK
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.wavefield import WaveField
from holopath_addon.engine.waves.phase_fields import random_phasors

RGB = (640e-9, 516.5e-9, 455.4e-9)
DEPTHS = (0.5, 1.0, 2.0)
OTHERS = (0.55, 0.8, 1.7, 1.0)


@pytest.fixture
def hologram():
    return engine.Hologram(96, 96, 8e-6, RGB, 0.2e-3, 1e-3)


def test_pupil_parts_lie_within_every_cone(hologram):
    mapping = DepthMapping.of(hologram, engine.Camera(np.eye(4), 0.35), 0.5)
    radius = mapping.pupil_radius(hologram.max_slope(455.4e-9))
    looks = {look.name: look for look in looks_of(DEPTHS, OTHERS, hologram)}
    assert tuple(looks) == LOOKS
    for look in looks.values():
        pupil = pupil_of(look, hologram, mapping)
        if pupil is not None:
            assert math.hypot(pupil.x, pupil.y) + pupil.diameter / 2 <= 1.0001 * radius
    left = pupil_of(looks["left"], hologram, mapping)
    assert (left.x, left.diameter) == pytest.approx((-radius / 2, radius))
    view = pupil_of(looks["view-right"], hologram, mapping)
    # half a degree: a slope s of hologram space leaves the pupil at s beta / F
    assert view.x == pytest.approx(math.tan(math.radians(0.5)) * mapping.beta / mapping.focal)
    assert pupil_of(looks["pupil-quarter"], hologram, mapping).diameter == pytest.approx(radius / 2)


def test_depths_between_are_half_way_in_the_volume(hologram):
    mapping = DepthMapping.of(hologram, engine.Camera(np.eye(4), 0.35), 0.5)
    z = mapping.depth_to_z([look.depth for look in looks_of(DEPTHS, OTHERS, hologram)[:5]])
    assert z[1] == pytest.approx(0.5 * (z[0] + z[2]))
    assert z[3] == pytest.approx(0.5 * (z[2] + z[4]))


def test_figures_of_pictures_with_known_errors(hologram):
    rng = np.random.default_rng(2)
    looks = looks_of(DEPTHS, OTHERS, hologram)
    inner = 96 - 2 * border_of(hologram)
    assert inner > 64
    root = rng.uniform(0.2, 0.8, (len(looks), 96, 96, 3))
    blurred = np.zeros((3, 96, 96), bool)
    blurred[:, :, 48:] = True
    truth = {"pictures": np.stack([root**2] * 2, 1).astype(np.float32), "blurred": blurred}
    error = rng.choice([-1.0, 1.0], root.shape) * 0.02
    error[:, :, :48] *= 0.5
    error[HEADLINE.index("up")] *= 4
    error[LOOKS.index("center")] *= 0.1
    error[LOOKS.index("center"), 40:56, 40:56] *= 20  # within its middle
    result = figures(((root + error) ** 2).astype(np.float32), truth, hologram)
    white = 0.77  # the 95th percentile; brighter pixels are cut
    expected = -20 * math.log10(0.02 / white)
    assert result["psnr_defocus"] == pytest.approx(expected, abs=0.5)
    assert result["psnr_focus"] == pytest.approx(expected + 6, abs=0.5)
    whole = expected - 10 * math.log10((1 + 0.25) / 2)
    assert result["pictures"]["front"]["psnr"] == pytest.approx(whole, abs=0.5)
    assert result["psnr_worst"] == result["pictures"]["up"]["psnr"] == pytest.approx(whole - 12, abs=0.7)
    for figure, names in (("psnr", HEADLINE), ("psnr_foci", FOCI), ("psnr_halfway", HALFWAY)):
        assert result[figure] == pytest.approx(np.mean([result["pictures"][name]["psnr"] for name in names]))
    assert 1 - result["ssim_focus"] < 0.5 * (1 - result["ssim_defocus"])
    own = (inner // 2) ** 2
    square = (0.1**2 * (own - 256) + 2**2 * 256) / own  # on the left half a quarter of it
    assert result["psnr_center"] == pytest.approx(
        expected - 10 * math.log10(square * (1 + 0.25) / 2), abs=0.5
    )


def test_unsupervised_foci_lie_halfway_between_the_planes_of_focal_stack(hologram):
    """Of seven planes, near, in the middle and far; the middle of the picture is where most of it lies."""
    mapping = DepthMapping.of(hologram, engine.Camera(np.eye(4), 0.35), 0.5)
    low, high = mapping.depth_to_z([3.0, 0.5])
    plan = SimpleNamespace(z_low=low, z_high=high)
    depth = np.full((96, 96), 2.0)
    depth[38:58, 38:58] = 0.7
    *halfway, center = others_of(plan, mapping, depth)
    steps = (mapping.depth_to_z(halfway) - low) / (high - low) * (DEPTHS_OF_STACK - 1)
    assert steps == pytest.approx([5.5, 3.5, 1.5])
    assert center == 0.7
    flat = others_of(SimpleNamespace(z_low=high, z_high=high), mapping, depth)
    assert flat[:3] == pytest.approx([0.5] * 3)


def test_the_middle_of_a_picture_is_in_its_middle():
    picture = np.arange(64).reshape(8, 8)
    assert middle_of(picture).tolist() == picture[2:6, 2:6].tolist()
    assert middle_of(picture, 4).tolist() == picture[3:5, 3:5].tolist()


def test_eight_bits_turn_phases_by_half_a_level_at_most(hologram):
    """And leave amplitudes, which are those of the light that is sent in."""
    waves = 0.7 * random_phasors(1, 96, 96)[:, None]
    green = engine.Hologram(96, 96, 8e-6, (516.5e-9,), 0.2e-3, 1e-3)
    field = WaveField(waves, green, engine.Camera(np.eye(4), 0.35), 0.5, {}, {})
    shown = of_eight_bits(field).data
    np.testing.assert_allclose(np.abs(shown), 0.7, rtol=1e-5)
    turn = np.abs(np.angle(shown * waves.conj()))
    assert 0.9 * np.pi / 256 < turn.max() < 1.01 * np.pi / 256
    assert len(np.unique(np.round(np.angle(shown) % (2 * np.pi) * 128 / np.pi) % 256)) == 256


def test_flip_is_left_out_without_its_package(hologram, monkeypatch):
    """With it, a picture that is the reference has 0, and a stranger one more."""
    calls = []

    def evaluate(wanted, shown, dynamic, **options):
        calls.append((wanted, shown))
        return None, float(np.abs(wanted - shown).mean()), {}

    rng = np.random.default_rng(5)
    pictures = rng.uniform(0.1, 1, (len(LOOKS), 96, 96, 1)).astype(np.float32)
    truth = np.stack([pictures] * 2, 1)
    monkeypatch.setitem(sys.modules, "flip_evaluator", SimpleNamespace(evaluate=evaluate, __spec__=object()))
    assert flip(pictures, truth, 8) == pytest.approx(0, abs=1e-6)
    assert [wanted.shape for wanted, _ in calls] == [(80, 80, 3)] * 3  # one wavelength is gray
    assert flip(pictures[::-1], truth, 8) > 0.1
    monkeypatch.delitem(sys.modules, "flip_evaluator")
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert flip(pictures, truth, 8) is None


def test_white_is_white_through_any_part_of_the_pupil(hologram):
    """Waves that fill every wavelength's own cone evenly: each part of it is as bright in all colors."""
    shape = hologram.height, hologram.width
    waves = np.repeat(random_phasors(16, *shape)[:, None], len(RGB), axis=1)
    field = WaveField(waves, hologram, engine.Camera(np.eye(4), 0.35), 0.5, {}, {})
    inner = slice(border_of(hologram), -border_of(hologram))
    for picture in seen(field, DEPTHS, OTHERS):
        bright = picture[inner, inner].mean((0, 1))
        np.testing.assert_allclose(bright / bright.mean(), 1, atol=0.06)


def test_a_point_through_a_quarter_of_the_pupil_is_an_airy_disk():
    """First dark ring at 0.61 / (cycles a pixel of the opening), 4.88 pixels for a quarter of the band's 0.5."""
    hologram = engine.Hologram(128, 128, 8e-6, (516.5e-9,))
    names = LOOKS
    pictures = np.zeros((len(names), 128, 128, 1), np.float32)
    pictures[:, 64, 64] = 1
    blurred = diffracted(pictures, DEPTHS, OTHERS, hologram)[..., 0]
    np.testing.assert_allclose(blurred.sum((1, 2)), 1, rtol=1e-5)
    row = blurred[names.index("pupil-quarter"), 64, 64:] / blurred[names.index("pupil-quarter"), 64, 64]
    assert row[:8].argmin() == 5
    assert row[5] < 0.005
    # Airy's second ring: 1.75 % at 6.7 pixels
    assert row[6:9].max() == pytest.approx(0.0175, rel=0.2)
    assert blurred[names.index("front"), 64, 66] < 0.05 * blurred[names.index("front"), 64, 64]
