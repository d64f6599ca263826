"""Microfacet distributions of rough surfaces, and their albedo for one bounce.

Wave vectors are local, z along the normal; `alpha` is roughness squared. Sources: Walter et al. 2007, "Microfacet
models for refraction through rough surfaces"; Heitz 2014, "Understanding the masking-shadowing function";
Dupuy and Benyoub 2023, "Sampling visible GGX normals with spherical caps".
"""

from __future__ import annotations

from functools import lru_cache

import drjit as dr
import mitsuba as mi
import numpy as np

ROWS = 32  # rows and columns of an albedo table
QUADRATURE = 1024  # sample points of an entry


class Ggx:
    """GGX (Trowbridge-Reitz) distribution of microfacet normals, with a roughness along x and one along y."""

    def __init__(self, alpha: mi.Vector2f) -> None:
        self.alpha = alpha

    def density(self, normal: mi.Normal3f) -> mi.Float:
        """Microfacet area per solid angle around a normal (Walter 2007, equation 33)."""
        x, y, z = normal.x / self.alpha.x, normal.y / self.alpha.y, normal.z
        return dr.rcp(dr.pi * self.alpha.x * self.alpha.y * dr.square(x * x + y * y + z * z))

    def masking(self, w: mi.Vector3f) -> mi.Float:
        """Smith's Lambda of a direction w (Heitz 2014, equation 72)."""
        slope = dr.square(self.alpha.x * w.x) + dr.square(self.alpha.y * w.y)
        return 0.5 * (dr.sqrt(1 + slope / dr.maximum(dr.square(w.z), 1e-12)) - 1)

    def visible_normal(self, wi: mi.Vector3f, number: mi.Point2f) -> mi.Normal3f:
        """Sample a normal visible from `wi`, above the surface, by a point of the unit square (Dupuy, Benyoub 2023)."""
        stretched = dr.normalize(mi.Vector3f(self.alpha.x * wi.x, self.alpha.y * wi.y, wi.z))
        sine, cosine = dr.sincos(2 * dr.pi * number.x)
        z = dr.fma(1 - number.y, 1 + stretched.z, -stretched.z)
        radius = dr.safe_sqrt(1 - z * z)
        half = mi.Vector3f(radius * cosine, radius * sine, z) + stretched
        return dr.normalize(
            mi.Normal3f(self.alpha.x * half.x, self.alpha.y * half.y, dr.maximum(half.z, 1e-6))
        )

    def unmasked(self, wi: mi.Vector3f, wo: mi.Vector3f) -> mi.Float:
        """Fraction of the microfacets visible from `wi` that is also visible from `wo` (Heitz 2014, equation 99)."""
        hidden = self.masking(wi)
        return (1 + hidden) / (1 + hidden + self.masking(wo))

    def visible_density(self, wi: mi.Vector3f, normal: mi.Normal3f) -> mi.Float:
        """Density of `visible_normal` over the cosine between `wi` and the normal (Heitz 2014, equation 16)."""
        return self.density(normal) / (dr.maximum(wi.z, 1e-7) * (1 + self.masking(wi)))


class Beckmann(Ggx):
    """Beckmann distribution, with Mitsuba's formulas."""

    def __init__(self, alpha: mi.Vector2f) -> None:
        super().__init__(alpha)
        self._distribution = mi.MicrofacetDistribution(mi.MicrofacetType.Beckmann, alpha.x, alpha.y, True)

    def density(self, normal: mi.Normal3f) -> mi.Float:
        """Microfacet area per solid angle around a normal."""
        return self._distribution.eval(normal)

    def masking(self, w: mi.Vector3f) -> mi.Float:
        """Smith's Lambda of a direction w."""
        w = mi.Vector3f(w.x, w.y, dr.abs(w.z))
        return dr.rcp(dr.maximum(self._distribution.smith_g1(w, mi.Normal3f(0, 0, 1)), 1e-6)) - 1

    def visible_normal(self, wi: mi.Vector3f, number: mi.Point2f) -> mi.Normal3f:
        """Sample a normal visible from `wi`, above the surface, by a point of the unit square."""
        return self._distribution.sample(wi, number)[0]


def normal_reflectance(ior: mi.Float | float) -> mi.Float | float:
    """Reflectance of a dielectric of index `ior` at normal incidence."""
    return dr.square((ior - 1) / (ior + 1))


def mean_reflectance(ior: mi.Float) -> mi.Float:
    """Reflectance of a dielectric, averaged over the hemisphere with the cosine.

    For indices below 1 by reciprocity, with a transmittance ior^2 times that of the other direction; Mitsuba's own fit
    exceeds 1 for small ones.
    """
    outside = mi.fresnel_diffuse_reflectance(dr.maximum(ior, dr.rcp(ior)))
    return dr.select(ior < 1, 1 - dr.square(ior) * (1 - outside), outside)


def grazing(cosine: mi.Float, ior: mi.Float | float) -> mi.Float:
    """Reflectance of a dielectric at a cosine, scaled to 0 at normal incidence and 1 at grazing incidence."""
    reflectance = mi.fresnel(cosine, ior)[0]
    normal = normal_reflectance(ior)
    return dr.clip((reflectance - normal) / (1 - normal), 0, 1)


def refracted(wi: mi.Vector3f, normal: mi.Normal3f, ior: mi.Float) -> tuple[mi.Vector3f, mi.Bool]:
    """Direction of light from `wi`, refracted by a microfacet of a normal, and whether any is transmitted."""
    cosine = dr.dot(wi, normal)
    _, cosine_t, _, inverse = mi.fresnel(cosine, ior)
    return normal * dr.fma(cosine, inverse, cosine_t) - wi * inverse, cosine_t != 0


class AlbedoTable:
    """Interpolated table by roughness and cosine of the viewing angle.

    Parameters
    ----------
    values : numpy.ndarray, shape (ROWS, ROWS, channels)
        Entries by roughness and the root of the cosine, which is finer towards grazing angles.
    """

    def __init__(self, values: np.ndarray) -> None:
        self._values = np.asarray(values, np.float32)
        # pyrefly: ignore[not-callable]  # missing from Mitsuba's stubs
        self._texture = mi.Texture2f(mi.TensorXf(self._values), use_accel=False)

    def __call__(self, roughness: mi.Float, cosine: mi.Float, active: mi.Bool | bool) -> mi.Float:
        """Entry for a roughness and a cosine, interpolated."""
        place = mi.Point2f(dr.sqrt(dr.clip(cosine, 0, 1)), roughness)
        return self._texture.eval((place * (ROWS - 1) + 0.5) / ROWS, active)

    def at(self, roughness: float) -> _AlbedoRow:
        """Table for one roughness, which is faster to look up."""
        row = np.nan_to_num(np.clip(roughness, 0, 1)) * (ROWS - 1)
        first = min(int(row), ROWS - 2)
        lower, upper = self._values[first : first + 2]
        return _AlbedoRow(lower + (row - first) * (upper - lower))


class _AlbedoRow:
    def __init__(self, values):
        # pyrefly: ignore[not-callable]  # missing from Mitsuba's stubs
        self._texture = mi.Texture1f(mi.TensorXf(np.asarray(values, np.float32)), use_accel=False)

    def __call__(self, _, cosine, active):
        place = mi.Point1f(dr.sqrt(dr.clip(cosine, 0, 1)))
        return self._texture.eval((place * (ROWS - 1) + 0.5) / ROWS, active)


def reflection_table(ior: float = 1.5) -> AlbedoTable:
    """Albedo of a rough mirror, its mean over the hemisphere, and the mean `grazing` of a dielectric of index `ior`."""
    return _reflection_table(ior, mi.variant())


def glass_table(ior: float) -> AlbedoTable:
    """Fraction of light that a rough interface of index `ior` reflects or transmits, and the hemispherical mean."""
    return _glass_table(ior, mi.variant())


@lru_cache(maxsize=64)
def _reflection_table(ior, _):
    wi, normal, facets = _visible_normals()
    wo = mi.reflect(wi, normal)
    kept = dr.select(wo.z > 0, facets.unmasked(wi, wo), 0)
    albedo = _averaged(kept)
    towards = _averaged(kept * grazing(dr.dot(wi, normal), ior))
    return AlbedoTable(np.stack([albedo, _hemispherical(albedo), towards / albedo], axis=-1))


@lru_cache(maxsize=64)
def _glass_table(ior, _):
    wi, normal, facets = _visible_normals()
    reflectance = mi.fresnel(dr.dot(wi, normal), ior)[0]
    wo = mi.reflect(wi, normal)
    kept = dr.select(wo.z > 0, reflectance * facets.unmasked(wi, wo), 0)
    wo, passes = refracted(wi, normal, ior)
    kept += dr.select(passes & (wo.z < 0), (1 - reflectance) * facets.unmasked(wi, wo), 0)
    albedo = _averaged(kept)
    return AlbedoTable(np.stack([albedo, _hemispherical(albedo)], axis=-1))


def _visible_normals():
    """Viewing directions, visible normals and microfacets of all sample points of a table."""
    index = dr.arange(mi.UInt32, ROWS * ROWS * QUADRATURE)
    point, entry = index % QUADRATURE, index // QUADRATURE
    number = mi.Point2f(point * 0.7548776662466927, point * 0.5698402909980532) + 0.5 / QUADRATURE
    number -= dr.floor(number)  # the R2 sequence
    cosine = dr.square(dr.maximum(mi.Float(entry % ROWS), 0.2) / (ROWS - 1))
    alpha = mi.Vector2f(dr.square(dr.maximum(mi.Float(entry // ROWS), 0.2) / (ROWS - 1)))
    wi = mi.Vector3f(dr.sqrt(1 - cosine * cosine), 0, cosine)
    facets = Ggx(alpha)
    return wi, facets.visible_normal(wi, number), facets


def _averaged(values):
    return np.asarray(values).reshape(ROWS, ROWS, QUADRATURE).mean(2)


def _hemispherical(albedo):
    """Cosine-weighted mean over the hemisphere, for each roughness."""
    root = np.linspace(0, 1, ROWS)
    values = albedo * 4 * root**3  # the cosine is the root's square
    mean = (values[:, 1:] + values[:, :-1]).sum(1) / (2 * (ROWS - 1))
    return np.repeat(mean[:, None], ROWS, axis=1)
