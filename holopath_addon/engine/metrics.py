"""How near a reconstruction comes to a reference picture."""

from __future__ import annotations

import numpy as np
import scipy.ndimage


def display_values(
    image: np.ndarray, reference: np.ndarray, border: int = 0
) -> tuple[np.ndarray, np.ndarray, float]:
    """Image and reference on a common perceptual scale.

    The white w is the 95th percentile of sqrt(reference), so that a lamp in view does not set the scale;
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
    white = np.percentile(root, 95)
    if white <= 0:
        raise ValueError("The reference is black: there is nothing to compare.")
    unclipped = root <= white
    square = (image[unclipped] ** 2).sum()
    scale = (image * reference)[unclipped].sum() / square if square > 0 else 0.0
    return np.minimum(np.sqrt(scale * image), white) / white, np.minimum(root, white) / white, scale


def psnr(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Peak signal-to-noise ratio in dB of `display_values`."""
    a, b, _ = display_values(image, reference, border)
    return float(-10 * np.log10(np.mean((a - b) ** 2)))


def ssim(image: np.ndarray, reference: np.ndarray, border: int = 0) -> float:
    """Structural similarity of `display_values`, averaged over channels.

    Wang et al., IEEE TIP 13, 600 (2004): Gaussian window of sigma 1.5, K1 = 0.01, K2 = 0.03.
    """
    a, b, _ = display_values(image, reference, border)

    def blur(x):
        return scipy.ndimage.gaussian_filter(x, sigma=(1.5, 1.5, 0), truncate=3.5, mode="reflect")

    mean_a, mean_b = blur(a), blur(b)
    var_a, var_b = blur(a * a) - mean_a**2, blur(b * b) - mean_b**2
    covariance = blur(a * b) - mean_a * mean_b
    c1, c2 = 0.01**2, 0.03**2
    similarity = (
        (2 * mean_a * mean_b + c1)
        * (2 * covariance + c2)
        / ((mean_a**2 + mean_b**2 + c1) * (var_a + var_b + c2))
    )
    pad = 5  # half the window: where it sees only the picture
    return float(similarity[pad:-pad, pad:-pad].mean())
