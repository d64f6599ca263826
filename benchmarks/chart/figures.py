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
        and SSIM of each look, ``psnr_focus`` and ``psnr_defocus``, of what is in focus and of what is not, and
        ``speckle``, the contrast in the middle.
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
        "psnr_focus": _psnr_where(pictures, truth, border, ~truth["blurred"]),
        "psnr_defocus": _psnr_where(pictures, truth, border, truth["blurred"]),
        "speckle": speckle_contrast(pictures[middle], truth["pictures"][middle].mean(0), border),
    }


def _psnr_where(pictures, truth, border, chosen):
    """PSNR in dB of chosen pixels, [3, y, x], in front, middle and back together; None where there are none."""
    inner = slice(border, -border or None)
    squares = []
    for name, pixels in zip(("front", "middle", "back"), chosen, strict=True):
        number = HEADLINE.index(name)
        errors = squared_error(pictures[number], truth["pictures"][number], border)
        squares.append(errors[pixels[inner, inner]].ravel())
    squares = np.concatenate(squares)
    return float(-10 * np.log10(max(squares.mean(), 1e-12))) if squares.size else None
