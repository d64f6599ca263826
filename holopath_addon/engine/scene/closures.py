"""Shader closures of Cycles: BSDF types ``gloss``, ``glass``, ``sheen``, ``matt``, ``clear``.

Each is the same on both sides of a surface. Reflecting ones have an albedo, by which `mixture` reduces the layers below
them. Light that is lost after one bounce between microfacets is restored by a factor of the whole lobe (Turquin 2019,
"Practical multiple scattering compensation for microfacet models"), colored by Kulla and Conty 2017, "Revisiting
physically based shading at Imageworks".
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .buffers import mean
from .fingerprint import text_of_properties
from .microfacet import (
    Beckmann,
    Ggx,
    glass_table,
    grazing,
    mean_reflectance,
    normal_reflectance,
    reflection_table,
    refracted,
)

FLAGS = mi.BSDFFlags
SIDES = FLAGS.FrontSide | FLAGS.BackSide
MIN_ROUGHNESS = 0.02  # minimum roughness of a rough lobe


class Closure(mi.BSDF):
    """BSDF of one or two lobes; subclasses define `_sample` and `_eval_pdf` for light from above."""

    def __init__(self, props, *lobes):
        super().__init__(props)
        self._lobes, self._textures, self._settings = lobes, {}, text_of_properties(props)
        self.m_components = [lobe | SIDES for lobe in lobes]
        self.m_flags = sum(map(int, lobes)) | int(SIDES)

    def _texture(self, props, name, default):
        self._textures[name] = props.get_texture(name, default)
        return self._textures[name]

    def traverse(self, callback):
        for name, texture in self._textures.items():
            callback.put(name, texture, mi.ParamFlags.Differentiable)

    def to_string(self):
        return f"{type(self).__name__}[{self._settings}], textures {list(self._textures)}"

    def _enabled(self, ctx):
        """Whether each lobe is requested by a context."""
        return [ctx.is_enabled(lobe, number) for number, lobe in enumerate(self._lobes)]

    def _above(self, si):
        """Whether the front is in view."""
        return si.wi.z > 0

    def _sample(self, ctx, si, wi, sample1, sample2, active):
        raise NotImplementedError

    def _eval_pdf(self, ctx, si, wi, wo, active):
        raise NotImplementedError

    def sample(self, ctx, si, sample1, sample2, active=True):
        above = self._above(si)
        wi = _turned(above, si.wi)
        sample, value = self._sample(ctx, si, wi, sample1, sample2, mi.Bool(active))
        sample.wo.z = dr.select(above, sample.wo.z, -sample.wo.z)
        return sample, dr.select(sample.pdf > 0, value, 0)

    def eval_pdf(self, ctx, si, wo, active=True):
        above = self._above(si)
        value, density = self._eval_pdf(ctx, si, _turned(above, si.wi), _turned(above, wo), mi.Bool(active))
        return dr.select(density > 0, value, 0), density

    def eval(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def _scattered(self, wo, density, active, component=0, eta=1.0):
        sample = dr.zeros(mi.BSDFSample3f)
        sample.wo, sample.pdf = wo, dr.select(active, density, 0)
        sample.eta = mi.Float(eta)
        sample.sampled_type = mi.UInt32(int(self._lobes[component]))
        sample.sampled_component = mi.UInt32(component)
        return sample


class Gloss(Closure):
    """Mirror; with ``roughness`` of microfacets, else smooth.

    ``anisotropic`` widens the lobe along x by 1 / ``aspect`` and narrows it along y; x is the tangent, turned
    by ``rotation`` turns. The reflectance is that of a dielectric with ``ior`` (times ``reflectance`` at
    normal incidence), of a metal with ``f0`` and, relative to Schlick's at 82 degrees, ``edge`` (Kutz,
    Hasan and Edmondson 2021, "Novel aspects of the Adobe Standard Material"), or ``reflectance`` alone.
    The ``distribution`` is ``multiscatter_ggx``, or ``ggx`` or ``beckmann``, which lose light that bounces
    more than once.
    """

    def __init__(self, props):
        self._smooth = "roughness" not in props
        super().__init__(props, FLAGS.DeltaReflection if self._smooth else FLAGS.GlossyReflection)
        ior = props.get("ior", 0.0)
        self._ior = dr.opaque(mi.Float, ior) if ior else None
        self._metal = "f0" in props
        self._color = self._texture(props, "f0" if self._metal else "reflectance", 1.0)
        self._edge = self._texture(props, "edge", 1.0) if self._metal and "edge" in props else None
        if not self._smooth:
            self._roughness = self._texture(props, "roughness", 0.5)
            self._aspect = props.get("aspect", 1.0)
            self._turn = self._texture(props, "rotation", 0.0) if "rotation" in props else None
            self._table = reflection_table(round(ior, 4) or 1.5)
            if self._aspect == 1 and isinstance(props["roughness"], float):
                self._table = self._table.at(max(props["roughness"], MIN_ROUGHNESS))
            self._distribution, self._multiscatter = _microfacets(props)

    def _fresnel(self, si, active):
        """Reflectance as a function of the cosine, and its mean over the hemisphere."""
        color = self._color.eval(si, active)
        if self._ior is not None:
            smooth = normal_reflectance(self._ior)
            normal = dr.minimum(color * smooth, 1)
            mean = mean_reflectance(self._ior)
            average = dr.clip((mean - smooth) / (1 - smooth), 0, 1)
            return lambda cosine: dr.lerp(normal, 1, grazing(cosine, self._ior)), dr.lerp(normal, 1, average)
        if not self._metal:
            return lambda cosine: color, color
        if self._edge is None:
            return lambda cosine: dr.lerp(color, 1, (1 - cosine) ** 5), dr.lerp(color, 1, 1 / 21)
        dip = dr.lerp(color, 1, (6 / 7) ** 5) * (7 / (6 / 7) ** 6) * (1 - self._edge.eval(si, active))

        def reflectance(cosine):
            schlick = dr.lerp(color, 1, (1 - cosine) ** 5)
            return dr.clip(schlick - dip * cosine * (1 - cosine) ** 6, 0, 1)

        return reflectance, dr.lerp(color, 1, 1 / 21) - dip / 126

    def _shape(self, si, active):
        roughness = dr.clip(self._roughness.eval_1(si, active), MIN_ROUGHNESS, 1)
        alpha = mi.Vector2f(dr.square(roughness))
        if self._aspect != 1:
            alpha = dr.minimum(alpha * mi.Vector2f(1 / self._aspect, self._aspect), 1)
            roughness = dr.sqrt(dr.sqrt(alpha.x * alpha.y))
        return roughness, self._distribution(alpha)

    def _along(self, si, active, *vectors):
        """Rotate vectors, with x along the tangent; return them and the inverse rotation."""
        if self._smooth or self._turn is None:
            return (*vectors, lambda w: w)
        sine, cosine = dr.sincos(2 * dr.pi * self._turn.eval_1(si, active))

        def turned(w, s):
            return type(w)(cosine * w.x + s * w.y, cosine * w.y - s * w.x, w.z)

        return (*(turned(w, sine) for w in vectors), lambda w: turned(w, -sine))

    def _kept(self, roughness, cosine, mean, active):
        """Factor for light of more than one bounce, mean `grazing`, and albedo of one bounce."""
        single, average, towards = self._table(roughness, cosine, active)
        if not self._multiscatter:
            return 1, towards, 1
        many = mean * average / (1 - mean * (1 - average))
        return 1 + many * (1 - single) / single, towards, single

    def albedo(self, si, active=True):
        """Fraction of light that is reflected towards si.wi."""
        cosine = dr.abs(si.wi.z)
        reflectance, mean = self._fresnel(si, active)
        if self._smooth:
            return reflectance(cosine)
        roughness, _ = self._shape(si, active)
        factor, towards, single = self._kept(roughness, cosine, mean, active)
        if self._ior is None:
            return reflectance(cosine) * factor * single
        return dr.lerp(reflectance(mi.Float(1)), 1, towards) * factor * single

    def _sample(self, ctx, si, wi, sample1, sample2, active):
        active &= self._enabled(ctx)[0]
        reflectance, mean = self._fresnel(si, active)
        if self._smooth:
            wo = mi.Vector3f(-wi.x, -wi.y, wi.z)
            return self._scattered(wo, mi.Float(1), active), reflectance(wi.z)
        roughness, facets = self._shape(si, active)
        wi, back = self._along(si, active, wi)
        normal = facets.visible_normal(wi, sample2)
        wo = mi.reflect(wi, normal)
        factor, _, _ = self._kept(roughness, wi.z, mean, active)
        density = facets.visible_density(wi, normal) / 4
        value = reflectance(dr.dot(wi, normal)) * (facets.unmasked(wi, wo) * factor)
        return self._scattered(back(wo), density, active & (wo.z > 0)), value

    def _eval_pdf(self, ctx, si, wi, wo, active):
        if self._smooth:
            return mi.Color3f(0), mi.Float(0)
        active &= (wo.z > 0) & self._enabled(ctx)[0]
        reflectance, mean = self._fresnel(si, active)
        roughness, facets = self._shape(si, active)
        wi, wo, _ = self._along(si, active, wi, wo)
        normal = dr.normalize(wi + wo)
        factor, _, _ = self._kept(roughness, wi.z, mean, active)
        density = facets.visible_density(wi, normal) / 4
        value = reflectance(dr.dot(wi, normal)) * (facets.unmasked(wi, wo) * factor * density)
        return dr.select(active, value, 0), dr.select(active, density, 0)


class Glass(Closure):
    """Interface to a dielectric with ``ior``; with ``roughness`` of microfacets (Walter 2007), else smooth.

    ``reflectance`` and ``transmittance`` tint, ``specular_tint`` scales the reflectance at normal incidence.
    With ``fresnel`` false all light is transmitted, except in total reflection, and none is reflected. For
    ``distribution`` see `Gloss`. Radiance is not scaled by the square of the index as it enters and leaves: a
    closed body looks the same, and a single sheet stands for a pane.
    """

    def __init__(self, props):
        self._smooth = "roughness" not in props
        self._fresnel = props.get("fresnel", True)
        lobes = [FLAGS.DeltaReflection, FLAGS.DeltaTransmission]
        if not self._smooth:
            lobes = [FLAGS.GlossyReflection, FLAGS.GlossyTransmission]
        super().__init__(props, *lobes[not self._fresnel :])
        ior = props.get("ior", 1.5)
        self._ior = dr.opaque(mi.Float, ior)
        self._transmittance = self._texture(props, "transmittance", 1.0)
        self._tables, multiscatter = None, False
        if not self._smooth:
            self._roughness = self._texture(props, "roughness", 0.5)
            self._distribution, multiscatter = _microfacets(props)
        if self._fresnel:
            self._reflectance = self._texture(props, "reflectance", 1.0)
            tinted = "specular_tint" in props
            self._tint = self._texture(props, "specular_tint", 1.0) if tinted else None
            if multiscatter:
                self._tables = [glass_table(round(ior, 4)), glass_table(1 / round(ior, 4))]
                if isinstance(props["roughness"], float):
                    rough = max(props["roughness"], MIN_ROUGHNESS)
                    self._tables = [table.at(rough) for table in self._tables]

    def _interface(self, si, active):
        """Relative index beyond, and reflectance and transmittance as a function of the cosine."""
        ior = dr.select(si.wi.z > 0, self._ior, dr.rcp(self._ior))
        tint = self._transmittance.eval(si, active)
        if not self._fresnel:
            none = mi.Color3f(0)
            return ior, lambda cosine: (none, tint)
        mirrored = self._reflectance.eval(si, active)
        tinted = None if self._tint is None else self._tint.eval(si, active)

        def fractions(cosine):
            reflected = mi.Color3f(mi.fresnel(cosine, ior)[0])
            if tinted is not None:
                normal = dr.minimum(normal_reflectance(ior) * tinted, 1)
                reflected = dr.lerp(normal, 1, grazing(cosine, ior))
            return reflected * mirrored, (1 - reflected) * tint

        return ior, fractions

    def _microstructure(self, si, wi, active):
        """Microfacets, and the factor for light of more than one bounce."""
        roughness = dr.clip(self._roughness.eval_1(si, active), MIN_ROUGHNESS, 1)
        facets = self._distribution(mi.Vector2f(dr.square(roughness)))
        if self._tables is None:
            return facets, mi.Color3f(1)
        front, back = (table(roughness, wi.z, active) for table in self._tables)
        outside = si.wi.z > 0
        single, average = (dr.select(outside, *entries) for entries in zip(front, back, strict=True))
        tint = self._transmittance.eval(si, active)
        many = tint * average / (1 - tint * (1 - average))
        return facets, 1 + many * (1 - single) / single

    def _sample(self, ctx, si, wi, sample1, sample2, active):
        ior, fractions = self._interface(si, active)
        facets, normal, density, factor = None, mi.Normal3f(0, 0, 1), mi.Float(1), mi.Color3f(1)
        if not self._smooth:
            facets, factor = self._microstructure(si, wi, active)
            normal = facets.visible_normal(wi, sample2)
        cosine = dr.dot(wi, normal)
        reflected, transmitted = fractions(cosine)
        chance = _chance(reflected, transmitted, *self._requested(ctx))
        mirrors = sample1 < chance
        beyond, passes = refracted(wi, normal, ior)
        wo = dr.select(mirrors, mi.reflect(wi, normal), beyond)
        active &= dr.select(mirrors, wo.z > 0, passes & (wo.z < 0))
        if facets is not None:
            spread = dr.select(mirrors, 1 / (4 * cosine), _spread(wi, wo, normal, ior))
            density = facets.visible_density(wi, normal) * cosine * spread
            factor *= facets.unmasked(wi, wo)
        chosen = dr.select(mirrors, chance, 1 - chance)
        value = dr.select(mirrors, reflected, transmitted) * factor / chosen
        sample = self._scattered(wo, density * chosen, active & (density > 0))
        last = len(self._lobes) - 1
        sample.sampled_component = dr.select(mirrors, mi.UInt32(0), mi.UInt32(last))
        kinds = [mi.UInt32(int(lobe)) for lobe in self._lobes]
        sample.sampled_type = dr.select(mirrors, kinds[0], kinds[last])
        sample.eta = dr.select(mirrors, 1, ior)
        return sample, value

    def _requested(self, ctx):
        """Whether reflection and transmission are requested by a context."""
        return self._enabled(ctx) if self._fresnel else [False, *self._enabled(ctx)]

    def _eval_pdf(self, ctx, si, wi, wo, active):
        if self._smooth:
            return mi.Color3f(0), mi.Float(0)
        ior, fractions = self._interface(si, active)
        facets, factor = self._microstructure(si, wi, active)
        mirrors = wo.z > 0
        normal = dr.normalize(wi + wo * dr.select(mirrors, 1, ior))
        normal = dr.mulsign(normal, normal.z)
        cosine, beyond = dr.dot(wi, normal), dr.dot(wo, normal)
        active &= (cosine > 0) & dr.select(mirrors, beyond > 0, beyond < 0)
        reflected, transmitted = fractions(cosine)
        chance = _chance(reflected, transmitted, *self._requested(ctx))
        density = facets.visible_density(wi, normal) * cosine
        density *= dr.select(mirrors, 1 / (4 * cosine), _spread(wi, wo, normal, ior))
        value = dr.select(mirrors, reflected, transmitted)
        value *= facets.unmasked(wi, wo) * factor * density
        density *= dr.select(mirrors, chance, 1 - chance)
        return dr.select(active, value, 0), dr.select(active, density, 0)


class Sheen(Closure):
    """Sheen of fuzz, with the rational fits that MaterialX publishes.

    Zeltner, Burley and Chiang 2022, "Practical multiple-scattering sheen using linearly transformed cosines".
    """

    def __init__(self, props):
        super().__init__(props, FLAGS.DiffuseReflection)
        self._color = self._texture(props, "reflectance", 1.0)
        self._roughness = self._texture(props, "roughness", 0.5)

    def _fit(self, si, cosine, active):
        """Scale and shear that transform the cosine lobe, and the albedo."""
        x, y = cosine, dr.clip(self._roughness.eval_1(si, active), 0.01, 1)
        scale = (2.58126 * x + 0.813703 * y) * y / (1 + 0.310327 * x * x + 2.60994 * x * y)
        shear = dr.safe_sqrt(1 - x) * (y - 1) * y**3
        shear /= 0.0000254053 + 1.71228 * x - 1.71506 * x * y + 1.34174 * y * y
        width = y * (0.0206607 + 1.58491 * y) / (0.0379424 + y * (1.32227 + y))
        center = y * (-0.193854 + y * (-1.14885 + y * (1.7932 - 0.95943 * y * y))) / (0.046391 + y)
        floor = y * (0.000654023 + y * (-0.0207818 + 0.119681 * y)) / (1.26264 + y * (-1.92021 + y))
        bell = dr.exp(-0.5 * dr.square((x - center) / width)) / (width * dr.sqrt(2 * dr.pi))
        return scale, shear, dr.clip(bell + floor, 0, 1)

    def albedo(self, si, active=True):
        """Fraction of light that is reflected towards si.wi."""
        return self._color.eval(si, active) * self._fit(si, dr.abs(si.wi.z), active)[2]

    def _sample(self, ctx, si, wi, sample1, sample2, active):
        scale, shear, albedo = self._fit(si, wi.z, active)
        lobe = mi.warp.square_to_cosine_hemisphere(sample2)
        lobe = dr.normalize(mi.Vector3f((lobe.x - lobe.z * shear) / scale, lobe.y / scale, lobe.z))
        across, along = _azimuth(wi)
        wo = mi.Vector3f(across * lobe.x - along * lobe.y, along * lobe.x + across * lobe.y, lobe.z)
        density = _transformed(lobe, scale, shear)
        active &= self._enabled(ctx)[0]
        return self._scattered(wo, density, active), self._color.eval(si, active) * albedo

    def _eval_pdf(self, ctx, si, wi, wo, active):
        scale, shear, albedo = self._fit(si, wi.z, active)
        across, along = _azimuth(wi)
        lobe = mi.Vector3f(across * wo.x + along * wo.y, across * wo.y - along * wo.x, wo.z)
        active &= (wo.z > 0) & self._enabled(ctx)[0]
        density = dr.select(active, _transformed(lobe, scale, shear), 0)
        return self._color.eval(si, active) * albedo * density, density


class Matt(Closure):
    """Diffuse reflection or, if ``translucent``, diffuse transmission.

    With ``roughness`` the improved Oren-Nayar model (Fujii 2012), with light scattered more than once by the
    OpenPBR specification.
    """

    def __init__(self, props):
        self._through = props.get("translucent", False)
        super().__init__(props, FLAGS.DiffuseTransmission if self._through else FLAGS.DiffuseReflection)
        self._reflectance = self._texture(props, "reflectance", 0.5)
        self._roughness = self._texture(props, "roughness", 0.0) if "roughness" in props else None

    def _above(self, si):
        # may be in view from below the horizon of the shading normal: the side of the shape counts
        towards = dr.dot(si.n, si.to_world(si.wi))
        return dr.select(towards == 0, si.wi.z > 0, towards > 0)

    def eval_diffuse_reflectance(self, si, active=True):
        # Mitsuba's default, scattering along the normal, would be 0 for a view from the other side
        return self._reflectance.eval(si, active)

    def _value(self, si, wi, wo, active):
        color = self._reflectance.eval(si, active)
        cosine = dr.abs(wo.z)
        if self._roughness is None:
            return color * (cosine * dr.inv_pi)
        sigma = dr.clip(self._roughness.eval_1(si, active), 0, 1)
        wi.z = dr.maximum(wi.z, 0)
        scale = 1 / (dr.pi + sigma * (dr.pi / 2 - 2 / 3))
        turn = dr.dot(wi, wo) - wi.z * cosine
        turn = dr.select(turn > 0, turn / dr.maximum(dr.maximum(wi.z, cosine), 1e-6), turn)
        once = scale * (1 + sigma * turn)
        mean = scale * (dr.pi + sigma * (2 * dr.pi - 5.6) / 3)
        lost = [1 - scale * (dr.pi + sigma * _oren_nayar(c)) for c in (wi.z, cosine)]
        # one factor of the color more than in the specification, as in Cycles
        many = dr.square(color) * (mean * dr.inv_pi / dr.maximum(1 - mean, 1e-6))
        many /= 1 - color * (1 - mean)
        return color * cosine * (once + many * (lost[0] * lost[1]))

    def _sample(self, ctx, si, wi, sample1, sample2, active):
        wo = mi.warp.square_to_cosine_hemisphere(sample2)
        density = mi.warp.square_to_cosine_hemisphere_pdf(wo)
        if self._through:
            wo.z = -wo.z
        active &= self._enabled(ctx)[0] & (density > 0)
        return self._scattered(wo, density, active), self._value(si, wi, wo, active) / density

    def _eval_pdf(self, ctx, si, wi, wo, active):
        valid = wo.z < 0 if self._through else wo.z > 0
        active &= valid & self._enabled(ctx)[0]
        return (
            dr.select(active, self._value(si, wi, wo, active), 0),
            dr.select(active, dr.abs(wo.z) * dr.inv_pi, 0),
        )


class Clear(Closure):
    """Surface without any effect but its ``transmittance``."""

    def __init__(self, props):
        super().__init__(props, FLAGS.Null)
        self._transmittance = self._texture(props, "transmittance", 1.0)

    def sample(self, ctx, si, sample1, sample2, active=True):
        active = active & self._enabled(ctx)[0]
        color = dr.select(active, self._transmittance.eval(si, active), 0)
        return self._scattered(-si.wi, mi.Float(1), active), color

    def eval_pdf(self, ctx, si, wo, active=True):
        return mi.Color3f(0), mi.Float(0)

    def eval_null_transmission(self, si, active=True):
        return dr.select(active, self._transmittance.eval(si, active), 0)


KINDS = {"gloss": Gloss, "glass": Glass, "sheen": Sheen, "matt": Matt, "clear": Clear}
for name, kind in KINDS.items():
    mi.register_bsdf(name, kind)


def _microfacets(props):
    """Distribution of microfacets, and whether light that bounces more than once between them is kept."""
    distribution = props.get("distribution", "multiscatter_ggx")
    kinds = {"multiscatter_ggx": Ggx, "ggx": Ggx, "beckmann": Beckmann}
    if distribution not in kinds:
        raise ValueError(f"Expected a distribution of {', '.join(kinds)}, got '{distribution}'.")
    return kinds[distribution], distribution == "multiscatter_ggx"


def _turned(above, w):
    """Direction in the frame of the side in view, as if that were the front."""
    return mi.Vector3f(w.x, w.y, dr.select(above, w.z, -w.z))


def _chance(reflected, transmitted, reflects, transmits):
    """Probability of reflection, by reflectance and transmittance and by the requested lobes."""
    if not (reflects and transmits):
        return mi.Float(1.0 if reflects else 0.0)
    reflected, both = mean(reflected), mean(reflected + transmitted)
    return dr.select(both > 0, reflected / both, 0)


def _spread(wi, wo, normal, ior):
    """Solid angle of microfacet normals over that of refracted directions (Walter 2007, equation 17)."""
    cosine = dr.dot(wo, normal)
    return dr.square(ior) * dr.abs(cosine) / dr.square(dr.dot(wi, normal) + ior * cosine)


def _azimuth(w):
    """Cosine and sine of a direction's azimuth."""
    length = dr.rsqrt(dr.maximum(w.x * w.x + w.y * w.y, 1e-12))
    straight = w.x * w.x + w.y * w.y < 1e-12
    return dr.select(straight, 1, w.x * length), dr.select(straight, 0, w.y * length)


def _transformed(w, scale, shear):
    """Density of a cosine lobe under the transform."""
    square = dr.square(scale * w.x + shear * w.z) + dr.square(scale * w.y) + dr.square(w.z)
    return dr.inv_pi * w.z * dr.square(scale / square)


def _oren_nayar(cosine):
    """Albedo of Fujii's second term over pi (OpenPBR specification, equation 60)."""
    cosine = dr.clip(cosine, 1e-3, 1)
    sine = dr.safe_sqrt(1 - cosine * cosine)
    return sine * (dr.acos(cosine) - 2 / 3 - sine * cosine) + 2 / 3 * (sine / cosine) * (1 - sine**3)
