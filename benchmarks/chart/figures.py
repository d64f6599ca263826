"""How near pictures come to the reference."""

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.viewing.metrics import squared_error

from .looks import HEADLINE, PUPILS, border_of

LIT = 0.05  # of the bright parts: less is not compared for speckle
PATCH = 16  # pixels along the side of speckle's patches


def figures(pictures, truth, hologram):
    """How near pictures come to the truth.

    Parameters
    ----------
    pictures : numpy.ndarray, shape (look, y, x, wavelength)
    truth : dict
        Of `looks.truth_of`.
    hologram : engine.Hologram

    Returns
    -------
    dict
        ``psnr`` and ``ssim``, means over `HEADLINE`, ``psnr_worst`` and ``ssim_worst`` of these, ``pictures``, PSNR
        and SSIM of each look, ``psnr_defocus``, of what is out of focus, and ``speckle``, the contrast in the middle.
    """
    border, names = border_of(hologram), (*HEADLINE, *PUPILS)
    each = {
        name: {"psnr": engine.psnr(picture, wanted, border), "ssim": engine.ssim(picture, wanted, border)}
        for name, picture, wanted in zip(names, pictures, truth["pictures"], strict=True)
    }
    psnr, ssim = ([each[name][kind] for name in HEADLINE] for kind in ("psnr", "ssim"))
    middle = names.index("middle")
    return {
        "psnr": float(np.mean(psnr)),
        "psnr_worst": min(psnr),
        "ssim": float(np.mean(ssim)),
        "ssim_worst": min(ssim),
        "pictures": each,
        "psnr_defocus": _defocus(pictures, truth, border),
        "speckle": speckle(pictures[middle], truth["pictures"][middle].mean(0), border),
    }


def _defocus(pictures, truth, border):
    """PSNR in dB of all pixels out of focus in front, middle and back together; None where all is sharp."""
    inner = slice(border, -border or None)
    squares = []
    for name, blurred in zip(("front", "middle", "back"), truth["blurred"], strict=True):
        number = HEADLINE.index(name)
        errors = squared_error(pictures[number], truth["pictures"][number], border)
        squares.append(errors[blurred[inner, inner]].ravel())
    squares = np.concatenate(squares)
    return float(-10 * np.log10(max(squares.mean(), 1e-12))) if squares.size else None


def speckle(picture, truth, border):
    """Speckle contrast: deviation over mean of picture / truth in patches, lit pixels only; their median.

    Patches that are mostly dark do not count; None where all are.
    """
    inner = slice(border, -border or None)
    picture, truth = (np.asarray(p[inner, inner], np.float64) for p in (picture, truth))
    rows, columns = (n // PATCH * PATCH for n in truth.shape[:2])

    def patches(values):
        parts = values[:rows, :columns].reshape(rows // PATCH, PATCH, columns // PATCH, PATCH, -1)
        return parts.transpose(0, 2, 4, 1, 3).reshape(-1, PATCH * PATCH)

    picture, truth = patches(picture), patches(truth)
    lit = truth > LIT * np.percentile(truth, 95) if truth.size else np.zeros(truth.shape, bool)
    mostly = lit.mean(1) > 0.5 if len(lit) else np.zeros(0, bool)
    if not mostly.any():
        return None
    ratio = np.where(lit, picture / np.where(lit, truth, 1), np.nan)[mostly]
    return float(np.median(np.nanstd(ratio, 1) / np.nanmean(ratio, 1)))
