"""Measures of the difference between an image and a reference: PSNR, SSIM, speckle contrast."""

from __future__ import annotations

import numpy as np
import scipy.ndimage

MIN_LIT = 0.05  # fraction of the bright parts' intensity: darker pixels do not count for speckle
PATCH = 16  # pixels along a side of the patches of `speckle_contrast`


def display_values(
    image: np.ndarray, reference: np.ndarray, border: int = 0
) -> tuple[np.ndarray, np.ndarray, float]:
    """Image and reference on a common perceptual scale.

    The white w is the 95th percentile of sqrt(reference), so that a light in view does not set the scale, or its
    maximum where that percentile is 0. The image is scaled by s = sum(I R) / sum(I^2) over the pixels with
    sqrt(R) <= w, all channels together. Both become min(sqrt, w) / w.

    Parameters
    ----------
    image, reference : numpy.ndarray, shape (y, x, channel)
        Linear intensities.
    border : int
        Number of pixels to leave out on each side.

    Returns
    -------
    (numpy.ndarray, numpy.ndarray, float)
        Values in 0..1 of both, and the scale s.

    Raises
    ------
    ValueError
        If the reference is black.
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
    """Root of the intensity of the bright parts, which counts as white."""
    inner = slice(border, -border or None)
    roots = np.sqrt(np.maximum(reference[inner, inner], 0))
    white = np.percentile(roots, 95) or roots.max()
    if white <= 0:
        raise ValueError("Expected a reference with light, got one that is black.")
    return white


def _by_halves(image, halves, border):
    """`display_values` of an image and the mean of two halves, and both halves on the same scale."""
    halves = np.asarray(halves, np.float64)
    whole = halves.mean(0)
    values, mean, _ = display_values(image, whole, border)
    white, inner = _white(whole, border), slice(border, -border or None)
    roots = np.sqrt(np.maximum(halves[:, inner, inner], 0))
    return values, mean, np.minimum(roots, white) / white


def squared_error(image: np.ndarray, reference: np.ndarray, border: int = 0) -> np.ndarray:
    """Squared error of each pixel on the scale of `display_values`, unbiased by the reference's noise.

    With halves A and B of independent noise and the image x it is x^2 - 2 x r + r^2, r the root of the truth. Its
    square is linear in A and B. The root of a noisy mean is too dark; r = 2 sqrt((A + B) / 2) - (sqrt A + sqrt B) / 2
    is not, to first order in the variance (the jackknife; Quenouille, Biometrika 43, 353, 1956). Where noise is as
    large as the error, clipping at the white still lowers the PSNR by up to half a decibel.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, channel)
        Linear intensities, of any scale.
    reference : numpy.ndarray, shape (y, x, channel) or (2, y, x, channel)
        The truth, or two halves of it with independent noise.
    border : int
        Number of pixels to leave out on each side.

    Returns
    -------
    numpy.ndarray, shape (y, x, channel)
        Without the border. With halves, single values may be negative; only their mean is meaningful.

    Raises
    ------
    ValueError
        If the reference is black.
    """
    if np.ndim(reference) == 3:
        a, b, _ = display_values(image, reference, border)
        return (a - b) ** 2
    values, mean, halves = _by_halves(image, reference, border)
    root = 2 * mean - halves.mean(0)
    square = 2 * mean**2 - (halves**2).mean(0)
    return values**2 - 2 * values * root + square


def psnr(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Peak signal-to-noise ratio of an image on the scale of `display_values`, dB.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, channel)
        Linear intensities, of any scale: the best scale is found.
    reference : numpy.ndarray, shape (y, x, channel) or (2, y, x, channel)
        The truth, or two halves of it with independent noise, which then does not count, see `reference`.
    border : int
        Number of pixels to leave out on each side.

    Returns
    -------
    float
        Infinite where the error does not exceed the noise.

    Raises
    ------
    ValueError
        If the reference is black.

    Examples
    --------
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> reference = np.linspace(0.0, 1.0, 300).reshape(10, 10, 3)
    >>> engine.psnr(3.0 * reference, reference) > 300  # the scale does not count
    True
    >>> round(engine.psnr(reference + 0.01, reference), 1)
    39.3
    """
    return decibels(squared_error(image, reference, border).mean())


def psnr_of_halves(images: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """PSNR in dB of an image that was made from the reference itself, for example by blurring each half.

    The mean of (x_A - a)(x_B - b), to which the noise of neither half adds.

    Parameters
    ----------
    images, reference : numpy.ndarray, shape (2, y, x, channel)
        Linear intensities of two halves of independent noise: the image of each, and the reference.
    border : int
        Number of pixels to leave out on each side.

    Raises
    ------
    ValueError
        If the reference is black.
    """
    white = _white(np.mean(reference, axis=0), border)
    inner = slice(border, -border or None)
    first, second = (
        np.minimum(np.sqrt(np.maximum(np.asarray(both, np.float64)[:, inner, inner], 0)), white) / white
        for both in (images, reference)
    )
    return decibels(np.prod(first - second, axis=0).mean())


def decibels(error: float) -> float:
    """PSNR in dB of a mean squared error for the peak 1; infinite for an error of 0 or below."""
    return float("inf") if error <= 0 else float(-10 * np.log10(error))


def psnr_deviation(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Standard error of `psnr` in dB, from the noise of two halves of the reference.

    With v the squared difference of the halves over 2, x the image and m the mean, all of one pixel, the variance of
    its (x - a)(x - b) is twice the mean of (x - m)^2 v, for Gaussian noise.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, channel)
        Linear intensities, of any scale.
    reference : numpy.ndarray, shape (2, y, x, channel)
        Two halves with independent noise.
    border : int
        Number of pixels to leave out on each side.

    Raises
    ------
    ValueError
        If the reference is black.
    """
    values, mean, halves = _by_halves(image, reference, border)
    variance = 0.5 * (halves[0] - halves[1]) ** 2
    deviation = np.sqrt((2 * (values - mean) ** 2 * variance).sum()) / values.size
    error = squared_error(image, reference, border).mean()
    return float("inf") if error <= 0 else float(10 / np.log(10) * deviation / error)


def ssim(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Structural similarity, see `similarity`, averaged over pixels and channels.

    Parameters
    ----------
    image : numpy.ndarray, shape (y, x, channel)
        Linear intensities, of any scale; 11 pixels along a side or more, without the border.
    reference : numpy.ndarray, shape (y, x, channel) or (2, y, x, channel)
        The truth, or two halves of it with independent noise.
    border : int
        Number of pixels to leave out on each side.

    Returns
    -------
    float
        1 for images that are alike but for their scale.

    Raises
    ------
    ValueError
        If the reference is black.
    """
    return mean_similarity(similarity(image, reference, border))


def mean_similarity(values: np.ndarray) -> float:
    """Mean of `similarity` over the pixels whose window lies within the image."""
    pad = 5  # half the window
    return float(values[pad:-pad, pad:-pad].mean())


def similarity(image: np.ndarray, reference: np.ndarray, border: int = 0) -> np.ndarray:
    """Structural similarity of `display_values` at each pixel and channel.

    Wang et al., IEEE TIP 13, 600 (2004): Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03. With two halves the
    reference's variance is their covariance, to which independent noise adds nothing. Parameters as of `ssim`.

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
    var_b = np.maximum(var_b, covariance**2 / np.maximum(var_a, 1e-12))  # Cauchy-Schwarz inequality
    c1, c2 = 0.01**2, 0.03**2
    return (
        (2 * mean_a * mean_b + c1)
        * (2 * covariance + c2)
        / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    )


def speckle_contrast(image: np.ndarray, truth: np.ndarray, border: int = 0) -> float | None:
    """Speckle contrast: standard deviation over mean of image / truth in a patch's lit pixels; median of all patches.

    Parameters
    ----------
    image, truth : numpy.ndarray, shape (y, x, channel)
        Linear intensities.
    border : int
        Number of pixels to leave out on each side.

    Returns
    -------
    float or None
        None where every patch is mostly dark; such patches do not count.
    """
    inner = slice(border, -border or None)
    image, truth = (np.asarray(values[inner, inner], np.float64) for values in (image, truth))
    rows, columns = (n // PATCH * PATCH for n in truth.shape[:2])

    def patches(values):
        parts = values[:rows, :columns].reshape(
            rows // PATCH, PATCH, columns // PATCH, PATCH, values.shape[-1]
        )
        return parts.transpose(0, 2, 4, 1, 3).reshape(-1, PATCH * PATCH)

    image, truth = patches(image), patches(truth)
    lit = truth > MIN_LIT * np.percentile(truth, 95) if truth.size else np.zeros(truth.shape, bool)
    mostly_lit = lit.mean(1) > 0.5 if len(lit) else np.zeros(0, bool)
    if not mostly_lit.any():
        return None
    ratio = np.where(lit, image / np.where(lit, truth, 1), np.nan)[mostly_lit]
    return float(np.median(np.nanstd(ratio, 1) / np.nanmean(ratio, 1)))
