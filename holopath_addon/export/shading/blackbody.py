"""The color of a black body, as Blender has it."""

from functools import cache

import numpy as np

COOLEST, HOTTEST = 800.0, 12000.0  # kelvin: Blender's colors stay the same beyond
SECOND_RADIATION_CONSTANT = 1.438777e-2  # h c / k, meter kelvin
# ITU-R BT.709 primaries, white D65
RGB_OF_XYZ = np.array(
    [[3.240479, -1.537150, -0.498535], [-0.969256, 1.875991, 0.041556], [0.055648, -0.204043, 1.057311]]
)


def blackbody_color(kelvin):
    """Linear RGB of luminance 1, shape (3,); colors out of gamut are cut to it.

    Planck's law 1 / (w^5 (exp(c2 / (w T)) - 1)) seen by the CIE 1931 observer.
    """
    wavelengths, observer = _observer()
    kelvin = min(max(float(kelvin), COOLEST), HOTTEST)
    radiance = 1 / (wavelengths**5 * np.expm1(SECOND_RADIATION_CONSTANT / (wavelengths * kelvin)))
    xyz = observer @ radiance
    return np.maximum(RGB_OF_XYZ @ (xyz / xyz[1]), 0)


@cache
def _observer():
    """Wavelengths in meters, and the CIE 1931 color matching functions there, shape (3, n)."""
    import mitsuba as mi

    nanometers = np.arange(360.0, 831.0, 5.0)
    matching = mi.cie1931_xyz(mi.Float(nanometers.astype(np.float32)))
    return nanometers * 1e-9, np.stack([np.asarray(part, np.float64) for part in matching])
