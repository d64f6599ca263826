"""How near pictures come to the reference."""

import importlib.util
from dataclasses import replace

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.viewing.metrics import (
    decibels,
    display_values,
    mean_similarity,
    similarity,
    speckle_contrast,
    squared_error,
)
from holopath_addon.engine.waves.modulator import Modulator

from .looks import CENTER, FOCI, HALFWAY, HEADLINE, LOOKS, border_of, middle_of

SHARP = ("front", "middle", "back")  # foci of what is in focus and out of focus, and of FLIP
FLIP_MODULE = "flip_evaluator"


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
        and SSIM of each look; ``psnr_foci`` and ``psnr_halfway``, means over `FOCI` and `HALFWAY`; ``psnr_center``, of
        the middle of the picture, focused there; ``psnr_focus``, ``psnr_defocus``, ``ssim_focus`` and
        ``ssim_defocus``, of what is in focus and of what is not; ``flip``, mean of `SHARP`, None without its package;
        and ``speckle``, the contrast in the middle.
    """
    border, wanted = border_of(hologram), truth["pictures"]
    errors, alike = (
        {
            name: measure(picture, half, border)
            for name, picture, half in zip(LOOKS, pictures, wanted, strict=True)
        }
        for measure in (squared_error, similarity)
    )
    each = {
        name: {"psnr": decibels(errors[name].mean()), "ssim": mean_similarity(alike[name])} for name in LOOKS
    }
    psnr, ssim = ([each[name][kind] for name in HEADLINE] for kind in ("psnr", "ssim"))
    middle = LOOKS.index("middle")
    result = {
        "psnr": float(np.mean(psnr)),
        "psnr_worst": min(psnr),
        "ssim": float(np.mean(ssim)),
        "ssim_worst": min(ssim),
        "pictures": each,
        "psnr_foci": float(np.mean([each[name]["psnr"] for name in FOCI])),
        "psnr_halfway": float(np.mean([each[name]["psnr"] for name in HALFWAY])),
        "psnr_center": _psnr_of(middle_of(errors[CENTER])),
        "flip": flip(pictures, wanted, border),
        "speckle": speckle_contrast(pictures[middle], wanted[middle].mean(0), border),
    }
    for kind, chosen in (("focus", ~truth["blurred"]), ("defocus", truth["blurred"])):
        result[f"psnr_{kind}"] = _psnr_of(_where(errors, chosen, border))
        own = _where(alike, chosen, border)
        result[f"ssim_{kind}"] = float(own.mean()) if own.size else None
    return result


def psnr_of_headline(pictures, truth, hologram):
    """Mean and worst PSNR in dB over `HEADLINE`; parameters as of `figures`, of which these are two."""
    border, wanted = border_of(hologram), truth["pictures"]
    count = len(HEADLINE)
    each = [engine.psnr(*pair, border) for pair in zip(pictures[:count], wanted[:count], strict=True)]
    return float(np.mean(each)), min(each)


def _where(values, chosen, border):
    """Values of chosen pixels, [3, y, x], of `SHARP`, one after the other."""
    inner = slice(border, -border or None)
    return np.concatenate(
        [values[name][pixels[inner, inner]].ravel() for name, pixels in zip(SHARP, chosen, strict=True)]
    )


def _psnr_of(errors):
    """PSNR in dB of squared errors; None of none."""
    return decibels(max(errors.mean(), 1e-12)) if errors.size else None


def flip(pictures, truth, border):
    """Mean FLIP of `SHARP`, 0 to 1, less is better; None where its package is not installed.

    Andersson et al., Proc. ACM Comput. Graph. Interact. Tech. 3(2), 15 (2020): how much a person sees who goes back and
    forth between picture and reference, at 67 pixels a degree. The wavelengths are red, green and blue of sRGB.
    """
    if importlib.util.find_spec(FLIP_MODULE) is None:
        return None
    evaluate = importlib.import_module(FLIP_MODULE).evaluate
    means = []
    for name in SHARP:
        number = LOOKS.index(name)
        shown, wanted, _ = display_values(pictures[number], truth[number].mean(0), border)
        linear = (np.float32(values**2) * np.ones(3, np.float32) for values in (wanted, shown))
        means.append(evaluate(*linear, "LDR", inputsRGB=False, applyMagma=False)[1])
    return float(np.mean(means))


def of_eight_bits(field):
    """The light of a field of phases alone, if an SLM shows each as the nearest of 256 levels."""
    light = Modulator(bits=8).light(np.angle(field.data) % (2 * np.pi))
    return replace(field, data=(np.abs(field.data) * light).astype(np.complex64))
