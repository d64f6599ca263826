"""How near a reconstruction comes to a reference picture."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

LIT = 0.05  # of the bright parts: less is not compared for speckle
PATCH = 16  # pixels along the side of speckle's patches


def display_values(
    image: np.ndarray, reference: np.ndarray, border: int = 0
) -> tuple[np.ndarray, np.ndarray, float]:
    """Image and reference on a common perceptual scale.

    The white w is the 95th percentile of sqrt(reference), so that a lamp in view does not set the scale, or its maximum
    where less than that is lit;
    the image is scaled by s = sum(I R) / sum(I^2) over the pixels with sqrt(R) <= w, all channels together;
    both become min(sqrt, w) / w.

    Parameters
    ----------
    image, reference : numpy.ndarray, shape (y, x, channel)
        Linear intensities.
    border : int
        Pixels left out on each side.

    Returns
    -------
    (numpy.ndarray, numpy.ndarray, float)
        Values in 0..1 and the scale s.
    """
    inner = slice(border, -border or None)
    image = np.asarray(image, np.float64)[inner, inner]
    reference = np.asarray(reference, np.float64)[inner, inner]
    root = np.sqrt(np.maximum(reference, 0))
    white = _white(reference, 0)
    unclipped = root <= white
    square = (image[unclipped] ** 2).sum()
    scale = (image * reference)[unclipped].sum() / square if square > 0 else 0.0
    return np.minimum(np.sqrt(scale * image), white) / white, np.minimum(root, white) / white, scale


def _white(reference, border):
    """Root of the bright parts' intensity, which counts as white."""
    inner = slice(border, -border or None)
    roots = np.sqrt(np.maximum(reference[inner, inner], 0))
    white = np.percentile(roots, 95) or roots.max()
    if white <= 0:
        raise ValueError("The reference is black: there is nothing to compare.")
    return white


def _by_halves(image, halves, border):
    """`display_values` of an image and the mean of two halves, and both halves on the same scale."""
    halves = np.asarray(halves, np.float64)
    whole = halves.mean(0)
    shown, mean, _ = display_values(image, whole, border)
    white, inner = _white(whole, border), slice(border, -border or None)
    roots = np.sqrt(np.maximum(halves[:, inner, inner], 0))
    return shown, mean, np.minimum(roots, white) / white


def squared_error(image: np.ndarray, reference: np.ndarray, border: int = 0) -> np.ndarray:
    """Squared error of each pixel on the scale of `display_values`, to which the reference's noise adds nothing.

    By halves A and B of independent noise, with x the image: x^2 - 2 x r + r^2, r the root of the truth. Its square is
    linear in A and B; the root of a noisy mean is dark, and r = 2 sqrt((A + B) / 2) - (sqrt A + sqrt B) / 2 is not, to
    first order in the variance (the jackknife; Quenouille, Biometrika 43, 353, 1956). Where noise is as large as the
    error, what is cut at the white still makes its PSNR read up to half a decibel low.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, channel)
    reference : numpy.ndarray, shape (y, x, channel) or (2, y, x, channel)
        A picture, taken as the truth, or two halves.
    border : int
        Pixels left out on each side.

    Returns
    -------
    numpy.ndarray, shape (y, x, channel)
        Without the border. Single values may be negative where there are halves; their mean counts.
    """
    if np.ndim(reference) == 3:
        a, b, _ = display_values(image, reference, border)
        return (a - b) ** 2
    shown, mean, halves = _by_halves(image, reference, border)
    root = 2 * mean - halves.mean(0)
    square = 2 * mean**2 - (halves**2).mean(0)
    return shown**2 - 2 * shown * root + square


def psnr(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Peak signal-to-noise ratio in dB of `display_values`; parameters as of `squared_error`.

    Infinite where noise leaves nothing of the error.
    """
    return decibels(squared_error(image, reference, border).mean())


def psnr_of_halves(images: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """`psnr` of an image that was made of the reference itself, such as one blurred: one of each half.

    The mean of (x_A - a)(x_B - b), to which the noise of neither half adds.

    Parameters
    ----------
    images, reference : numpy.ndarray, shape (2, y, x, channel)
    border : int
    """
    white = _white(np.mean(reference, axis=0), border)
    inner = slice(border, -border or None)
    first, second = (
        np.minimum(np.sqrt(np.maximum(np.asarray(both, np.float64)[:, inner, inner], 0)), white) / white
        for both in (images, reference)
    )
    return decibels(np.prod(first - second, axis=0).mean())


def decibels(error: float) -> float:
    """PSNR of a mean squared error with the peak 1; infinite of none."""
    return float("inf") if error <= 0 else float(-10 * np.log10(error))


def psnr_deviation(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Standard error in dB that the noise of two halves leaves in `psnr`; parameters as of `squared_error`.

    With v the squared difference of the halves over 2, x the image and m the mean, all of one pixel, the variance of
    its (x - a)(x - b) is twice the mean of (x - m)^2 v, for Gaussian noise.
    """
    shown, mean, halves = _by_halves(image, reference, border)
    variance = 0.5 * (halves[0] - halves[1]) ** 2
    deviation = np.sqrt((2 * (shown - mean) ** 2 * variance).sum()) / shown.size
    error = squared_error(image, reference, border).mean()
    return float("inf") if error <= 0 else float(10 / np.log(10) * deviation / error)


def ssim(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Structural similarity, see `similarity`, averaged over pixels and channels; parameters as of `squared_error`."""
    return mean_similarity(similarity(image, reference, border))


def mean_similarity(values: np.ndarray) -> float:
    """Mean of `similarity` where its window sees only the picture."""
    pad = 5  # half the window
    return float(values[pad:-pad, pad:-pad].mean())


def similarity(image: np.ndarray, reference: np.ndarray, border: int = 0) -> np.ndarray:
    """Structural similarity of `display_values` at each pixel and channel.

    Wang et al., IEEE TIP 13, 600 (2004): Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03. By two halves the
    reference's variance is their covariance, to which independent noise adds nothing. Parameters as of `squared_error`.

    Returns
    -------
    numpy.ndarray, shape (y, x, channel)
        Without the border.
    """
    pair = reference if np.ndim(reference) == 4 else np.stack([reference, reference])
    a, b, own = _by_halves(image, pair, border)

    def blur(x):
        return scipy.ndimage.gaussian_filter(x, sigma=(1.5, 1.5, 0), truncate=3.5, mode="reflect")

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(own[0] * own[1]) - blur(own[0]) * blur(own[1])
    covariance = blur(a * b) - mean_a * mean_b
    var_b = np.maximum(
        var_b, covariance**2 / np.maximum(var_a, 1e-12)
    )  # as of all variances (Cauchy and Schwarz)
    c1, c2 = 0.01**2, 0.03**2
    return (
        (2 * mean_a * mean_b + c1)
        * (2 * covariance + c2)
        / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    )


def speckle_contrast(picture: np.ndarray, truth: np.ndarray, border: int = 0) -> float | None:
    """Speckle contrast: deviation over mean of picture / truth in patches, lit pixels only; their median.

    Patches that are mostly dark do not count; None where all are.

    Parameters
    ----------
    picture, truth : numpy.ndarray, shape (y, x, channel)
    border : int
        Pixels left out on each side.
    """
    inner = slice(border, -border or None)
    picture, truth = (np.asarray(p[inner, inner], np.float64) for p in (picture, truth))
    rows, columns = (n // PATCH * PATCH for n in truth.shape[:2])

    def patches(values):
        parts = values[:rows, :columns].reshape(
            rows // PATCH, PATCH, columns // PATCH, PATCH, values.shape[-1]
        )
        return parts.transpose(0, 2, 4, 1, 3).reshape(-1, PATCH * PATCH)

    picture, truth = patches(picture), patches(truth)
    lit = truth > LIT * np.percentile(truth, 95) if truth.size else np.zeros(truth.shape, bool)
    mostly = lit.mean(1) > 0.5 if len(lit) else np.zeros(0, bool)
    if not mostly.any():
        return None
    ratio = np.where(lit, picture / np.where(lit, truth, 1), np.nan)[mostly]
    return float(np.median(np.nanstd(ratio, 1) / np.nanmean(ratio, 1)))
