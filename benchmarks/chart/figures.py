"""How near pictures come to the reference."""

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.viewing.metrics import speckle_contrast, squared_error

from .looks import HEADLINE, PUPILS, border_of


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
        "speckle": speckle_contrast(pictures[middle], truth["pictures"][middle].mean(0), border),
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
