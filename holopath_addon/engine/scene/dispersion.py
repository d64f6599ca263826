"""Glass with dispersion: Mitsuba BSDF type ``dispersive_dielectric``."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

import mitsuba as mi

from .lobes import parts_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

# Fraunhofer lines that define the Abbe number, meters.
LINE_D, LINE_F, LINE_C = 587.6e-9, 486.1e-9, 656.3e-9


def cauchy(index: float, abbe: float, wavelength: float) -> float:
    """Index of refraction by Cauchy's equation n = A + B / wavelength^2.

    Parameters
    ----------
    index : float
        Index n_d at 587.6 nm.
    abbe : float
        Abbe number (n_d - 1) / (n_F - n_C).
    wavelength : float
        Meters.

    Returns
    -------
    float
    """
    slope = (index - 1) / abbe / (LINE_F**-2 - LINE_C**-2)
    return index + slope * (wavelength**-2 - LINE_D**-2)


class DispersiveDielectric(mi.BSDF):
    """Mitsuba's `dielectric` with ``int_ior`` at 587.6 nm and the Abbe number ``abbe``.

    It renders one wavelength at a time, which `tuned` sets.
    """

    def __init__(self, props):
        super().__init__(props)
        self.index, self.abbe = props.get("int_ior", 1.5168), props.get("abbe", 64.17)
        if self.abbe <= 0:
            raise ValueError("dispersive_dielectric: 'abbe' must be positive, such as 64 for crown glass.")
        self.outside = props.get("ext_ior", 1.0)
        # the same as in `tune`, to the last bit
        glass = {"type": "dielectric", "int_ior": self.index / self.outside, "ext_ior": 1.0}
        for name in ("specular_transmittance", "specular_reflectance"):
            if name in props:
                glass[name] = props.get_texture(name)
        self.glass = mi.load_dict(glass)
        self.m_components = [self.glass.flags(i) for i in range(self.glass.component_count())]
        self.m_flags = self.glass.flags()

    def tune(self, wavelength):
        """Set the index of refraction at a wavelength, meters."""
        parameters = mi.traverse(self.glass)
        parameters["eta"] = cauchy(self.index, self.abbe, wavelength) / self.outside
        parameters.update()

    def sample(self, ctx, si, sample1, sample2, active=True):
        # transport of importance, as in `closures.Glass`, where radiance is not scaled by the square of the index
        ctx = mi.BSDFContext(mi.TransportMode.Importance, ctx.type_mask, ctx.component)
        return self.glass.sample(ctx, si, sample1, sample2, active)

    def eval(self, ctx, si, wo, active=True):
        return self.glass.eval(ctx, si, wo, active)

    def pdf(self, ctx, si, wo, active=True):
        return self.glass.pdf(ctx, si, wo, active)

    def eval_pdf(self, ctx, si, wo, active=True):
        return self.glass.eval_pdf(ctx, si, wo, active)

    def traverse(self, callback):
        callback.put("glass", self.glass, mi.ParamFlags.Differentiable)

    def to_string(self):
        return f"DispersiveDielectric[int_ior={self.index}, abbe={self.abbe}, ext_ior={self.outside}]"


mi.register_bsdf("dispersive_dielectric", DispersiveDielectric)


def wavelength_groups(scene: mi.Scene, wavelengths: Sequence[float]) -> list[tuple[float, ...]]:
    """Divide wavelengths into groups that share their rays: one of all, or one each if the scene has dispersion."""
    disperses = any(hasattr(part, "tune") for part in parts_of(scene))
    return [(w,) for w in wavelengths] if disperses and len(wavelengths) > 1 else [tuple(wavelengths)]


@contextmanager
def tuned(scene: mi.Scene, wavelengths: Sequence[float]) -> Iterator[None]:
    """Set the indices of refraction of a scene for one group of wavelengths, meters; afterwards for 587.6 nm."""
    tune_all = [part.tune for part in parts_of(scene) if hasattr(part, "tune")]
    try:
        for tune in tune_all:
            tune(wavelengths[0])
        yield
    finally:
        for tune in tune_all:
            tune(LINE_D)
