"""Picture comparison: DESIGN's measure, and SSIM against scikit-image."""

import numpy as np
import pytest

from holopath_addon.engine import metrics


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
