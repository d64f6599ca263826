"""Picture comparison: DESIGN's measure, and SSIM against scikit-image."""

import math

import numpy as np
import pytest
from scipy import ndimage

from holopath_addon.engine.viewing import metrics


@pytest.fixture
def pictures():
    rng = np.random.default_rng(1)
    reference = rng.random((64, 80, 3)) ** 2
    return reference * rng.gamma(10, 0.1, reference.shape), reference


def test_scale_does_not_matter(pictures):
    image, reference = pictures
    assert metrics.psnr(7.5 * image, reference) == pytest.approx(metrics.psnr(image, reference))


def test_equal_pictures_are_perfect(pictures):
    _, reference = pictures
    assert metrics.psnr(reference * (1 + 1e-6 * reference), reference) > 100
    assert metrics.ssim(reference, reference) == pytest.approx(1)


def test_known_error():
    reference = np.full((40, 40, 1), 0.64)
    reference[:20] = 0.16
    image = reference.copy()
    image[:, ::2] *= 1.21
    image[:, 1::2] *= 0.81
    a, b, _ = metrics.display_values(image, reference)
    expected = -10 * np.log10(np.mean((a - b) ** 2))
    assert metrics.psnr(image, reference) == pytest.approx(expected)
    assert 20 < expected < 26


def test_lamps_do_not_set_the_white(pictures):
    image, reference = pictures
    with_lamp, lamp_image = reference.copy(), image.copy()
    with_lamp[30:32, 30:32] = 1e4
    lamp_image[30:32, 30:32] = 0.9e4
    assert metrics.psnr(lamp_image, with_lamp) == pytest.approx(metrics.psnr(image, reference), abs=0.2)


@pytest.fixture(scope="module")
def smooth():
    """A picture from black to white, and its roots with an error of known size, both free of noise."""
    rng = np.random.default_rng(0)
    truth = 5 * np.clip(ndimage.gaussian_filter(rng.random((192, 192, 3)), (4, 4, 0)) - 0.42, 0.002, None)
    return truth, (np.sqrt(truth) + rng.normal(size=truth.shape) * 0.03) ** 2


def halves_of(truth, paths, seed=5):
    """Pictures by so many paths in all, 30 dB from the truth with 64 of them, as a lit room's references are."""
    rng = np.random.default_rng(seed)
    return np.stack([truth * rng.gamma(2 * paths, 0.5 / paths, truth.shape) for _ in range(2)])


def test_halves_take_the_noise_of_the_reference_out_of_the_error(smooth):
    truth, image = smooth
    known, known_ssim = metrics.psnr(image, truth), metrics.ssim(image, truth)
    assert 28 < known < 32
    for paths in (64, 256, 1024):
        halves = halves_of(truth, paths)
        assert metrics.psnr(image, halves) == pytest.approx(known, abs=0.15), paths
        assert metrics.ssim(image, halves) == pytest.approx(known_ssim, abs=0.01), paths
    noisy = halves_of(truth, 64)
    assert metrics.psnr(image, noisy.mean(0)) < known - 1
    assert metrics.ssim(image, noisy.mean(0)) < known_ssim - 0.01


def test_what_noise_the_halves_leave_is_told(smooth):
    truth, image = smooth
    found, deviations = [], []
    for seed in range(12):
        halves = halves_of(truth, 64, seed)
        found.append(metrics.psnr(image, halves))
        deviations.append(metrics.psnr_deviation(image, halves))
    assert np.std(found) == pytest.approx(np.mean(deviations), rel=0.6)
    assert metrics.psnr_deviation(image, halves_of(truth, 1024)) < 0.5 * np.mean(deviations)


def test_a_blurred_reference_has_its_blur_as_its_error(smooth):
    truth, _ = smooth

    def blurred(x):
        return ndimage.gaussian_filter(x, (*[0] * (x.ndim - 3), 3, 3, 0))

    known = metrics.psnr_of_halves(np.stack([blurred(truth)] * 2), np.stack([truth] * 2))
    halves = halves_of(truth, 64)
    assert metrics.psnr_of_halves(blurred(halves), halves) == pytest.approx(known, abs=0.2)
    assert metrics.psnr(blurred(halves.mean(0)), halves.mean(0)) < known - 1


def test_a_small_thing_before_black():
    """The brightest pixel counts as white where less than a twentieth is lit."""
    lit = np.zeros((40, 40, 1))
    lit[18:22, 18:22] = 4.0
    half = lit / 4
    half[18:20, 18:22] = 0
    assert metrics.psnr(lit, 3 * lit) == np.inf
    # the scale is 1 for what is there; a half of 16 in 1600 pixels is wrong by white
    assert metrics.psnr(half, lit) == pytest.approx(-10 * math.log10(8 / 1600))


def test_what_is_no_number_is_not_perfect(pictures):
    image, reference = pictures
    broken = np.array(reference)
    broken[20, 20] = np.nan
    with np.errstate(invalid="ignore"):
        assert not metrics.psnr(image, broken) > 0


def test_black_reference_is_refused(pictures):
    with pytest.raises(ValueError, match="black"):
        metrics.psnr(pictures[0], np.zeros_like(pictures[1]))


SSIM = 0.9561132112773164  # of these pictures, by scikit-image 0.26.0


def test_ssim_agrees_with_the_record_of_scikit_image(pictures):
    assert metrics.ssim(*pictures) == pytest.approx(SSIM, abs=1e-6)


@pytest.mark.oracle
def test_ssim_agrees_with_scikit_image(pictures):
    structural_similarity = pytest.importorskip("skimage.metrics").structural_similarity
    a, b, _ = metrics.display_values(*pictures)
    truth = structural_similarity(
        a, b, channel_axis=-1, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    assert metrics.ssim(*pictures) == pytest.approx(truth, abs=1e-6)
    assert truth == pytest.approx(SSIM, abs=1e-9)


def test_speckle_of_so_many_independent_frames_is_known():
    rng = np.random.default_rng(1)
    truth = np.broadcast_to(np.linspace(0.5, 1, 128)[:, None, None], (128, 128, 3))
    for frames in (1, 16):
        picture = truth * rng.exponential(size=(frames, 128, 128, 3)).mean(0)
        assert metrics.speckle_contrast(picture, truth) == pytest.approx(frames**-0.5, rel=0.05)
    assert metrics.speckle_contrast(picture, 0 * truth) is None


def test_speckle_of_pictures_without_a_whole_patch():
    """None, as of dark ones: nothing can be told."""
    picture = np.ones((6, 20, 3))
    assert metrics.speckle_contrast(picture, picture) is None
    assert metrics.speckle_contrast(np.ones((16, 16, 1)), np.ones((16, 16, 1))) == 0
