"""BSDF type ``mixture``: Mitsuba's `blendbsdf` with correct mirrors, with layers and sums.

Mitsuba 3.9's `blendbsdf` divides a sampled mirror direction by a density that includes those of other lobes (its
pull request 1681): a mirror over black at a weight of one half reflects 38 %. Its weight cannot depend on the angle,
as that of a coat does, and it cannot add.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .buffers import mean
from .fingerprint import text_of_properties

ALL_COMPONENTS = 0xFFFFFFFF


class Mixture(mi.BSDF):
    """Mixture of two nested BSDFs, of which ``weight``, a number or texture, is the weight of the second.

    The weight of the first follows from ``mode``:
    ``blend``: one minus that of the second; ``fresnel_ior`` multiplies the second's weight by a dielectric's
    reflectance towards the viewer, ``facing`` by one minus this power of the cosine;
    ``over``: the light that the second, which lies over it, does not reflect towards the viewer; it crosses a
    layer of color ``tint``, if given, whose index of refraction is ``int_ior``;
    ``add``: one.
    """

    def __init__(self, props):
        super().__init__(props)
        self._settings = text_of_properties(props)
        self._mode = props.get("mode", "blend")
        if self._mode not in ("blend", "over", "add"):
            raise ValueError(f"mixture: expected a mode of blend, over or add, got '{self._mode}'.")
        self._weight = props.get_texture("weight", 0.5)
        self._tint = props.get_texture("tint") if "tint" in props else None
        self._ior = dr.opaque(mi.Float, props.get("int_ior", 1.5))
        self._fresnel = dr.opaque(mi.Float, props["fresnel_ior"]) if "fresnel_ior" in props else None
        self._facing = dr.opaque(mi.Float, props["facing"]) if "facing" in props else None
        self._nested: list = [part for _, part in props.objects() if isinstance(part, mi.BSDF)]
        if self._mode == "over" and not hasattr(self._nested[1], "albedo"):
            raise ValueError("mixture: what lies over the rest must be 'gloss' or 'sheen'.")
        # mixtures of mixtures choose among all their lobes at once
        self._leaves = [
            leaf for part in self._nested for leaf in (part._leaves if _is_mixture(part) else [part])
        ]
        self.m_components = [leaf.flags(i) for leaf in self._leaves for i in range(leaf.component_count())]
        self._owners = [
            (number, i) for number, leaf in enumerate(self._leaves) for i in range(leaf.component_count())
        ]
        flags = 0
        for component in self.m_components:
            flags |= component
        self.m_flags = flags

    def _albedos(self, si, active):
        """Albedo of each leaf that has one."""
        return {leaf: leaf.albedo(si, active) for leaf in self._leaves if hasattr(leaf, "albedo")}

    def _weights(self, si, albedos, active):
        """Weight of each leaf."""
        weight = dr.clip(self._weight.eval_1(si, active), 0, 1)
        cosine = si.wi.z
        if self._fresnel is not None:
            weight *= mi.fresnel(dr.abs(cosine), dr.select(cosine > 0, self._fresnel, 1 / self._fresnel))[0]
        if self._facing is not None:
            weight *= 1 - dr.abs(cosine) ** self._facing
        first, second = self._nested
        below, above = 1, weight
        if self._mode == "blend":
            below = 1 - weight
        elif self._mode == "add":
            above = 1
        else:
            below = dr.clip(1 - weight * dr.max(albedos[second]), 0, 1)
            if self._tint is not None:
                # Beer's law along the refracted ray; the tint is that at normal incidence
                cosine = dr.safe_sqrt(1 - (1 - dr.square(si.wi.z)) / dr.square(self._ior))
                color = dr.maximum(self._tint.eval(si, active), 1e-6) ** dr.rcp(cosine)
                below = below * dr.lerp(mi.Color3f(1), color, weight)
        return [
            outer * inner
            for part, outer in ((first, below), (second, above))
            for inner in (part._weights(si, albedos, active) if _is_mixture(part) else [1])
        ]

    def _weights_and_chances(self, si, active):
        """Weight of each leaf, and its probability to be sampled."""
        albedos = self._albedos(si, active)
        weights = self._weights(si, albedos, active)
        chances = [
            _gray(weight) * _gray(albedos.get(leaf, 1.0))
            for leaf, weight in zip(self._leaves, weights, strict=True)
        ]
        total = sum(chances)
        return weights, [dr.select(total > 0, chance / total, 1 / len(chances)) for chance in chances]

    def _one(self, ctx, si, active):
        """Number of the leaf that a context requests, its context and its weight."""
        number, component = self._owners[ctx.component]
        inner = mi.BSDFContext(ctx.mode, ctx.type_mask, component)
        return number, inner, self._weights(si, self._albedos(si, active), active)[number]

    def _first_component(self, number):
        return sum(leaf.component_count() for leaf in self._leaves[:number])

    def sample(self, ctx, si, sample1, sample2, active=True):
        if ctx.component != ALL_COMPONENTS:
            if ctx.component >= len(self._owners):
                return dr.zeros(mi.BSDFSample3f), mi.Color3f(0)
            number, inner, weight = self._one(ctx, si, active)
            sample, value = self._leaves[number].sample(inner, si, sample1, sample2, active)
            sample.sampled_component += self._first_component(number)
            return sample, dr.select(active, value * weight, 0)
        weights, chances = self._weights_and_chances(si, active)
        sample, sharp = dr.zeros(mi.BSDFSample3f), mi.Color3f(0)
        left, number = mi.Bool(active), mi.Float(sample1)
        for i, (leaf, weight, chance) in enumerate(zip(self._leaves, weights, chances, strict=True)):
            mine = left & (number < chance) if i + 1 < len(chances) else left
            rest = dr.clip(number / chance, 0, dr.one_minus_epsilon(mi.Float))
            leaf_sample, value = leaf.sample(ctx, si, rest, sample2, mine)
            leaf_sample.sampled_component += self._first_component(i)
            leaf_sample.pdf *= chance
            sample = dr.select(mine, leaf_sample, sample)
            if mi.has_flag(leaf.flags(), mi.BSDFFlags.Delta):
                sharp = dr.select(mine & (chance > 0), value * weight / chance, sharp)
            left &= ~mine
            number -= chance
        # other leaves may scatter in the same direction, but none exactly as a mirror
        scattered = active & ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) & (sample.pdf > 0)
        value, density = self._sums(ctx, si, sample.wo, weights, chances, scattered)
        value = dr.select(scattered, dr.select(density > 0, value / density, 0), sharp)
        sample.pdf = dr.select(scattered, density, sample.pdf)
        return sample, dr.select(active & (sample.pdf > 0), value, 0)

    def _sums(self, ctx, si, wo, weights, chances, active):
        value, density = mi.Color3f(0), mi.Float(0)
        for leaf, weight, chance in zip(self._leaves, weights, chances, strict=True):
            if mi.has_flag(leaf.flags(), mi.BSDFFlags.Smooth):
                leaf_value, leaf_density = leaf.eval_pdf(ctx, si, wo, active)
                value += weight * leaf_value
                density += chance * leaf_density
        return value, density

    def eval(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[0]

    def pdf(self, ctx, si, wo, active=True):
        return self.eval_pdf(ctx, si, wo, active)[1]

    def eval_pdf(self, ctx, si, wo, active=True):
        if ctx.component != ALL_COMPONENTS:
            if ctx.component >= len(self._owners):
                return mi.Color3f(0), mi.Float(0)
            number, inner, weight = self._one(ctx, si, active)
            value, density = self._leaves[number].eval_pdf(inner, si, wo, active)
            return weight * value, density
        return self._sums(ctx, si, wo, *self._weights_and_chances(si, active), active)

    def eval_diffuse_reflectance(self, si, active=True):
        return self._sum(
            mi.BSDFFlags.Diffuse, lambda leaf: leaf.eval_diffuse_reflectance(si, active), si, active
        )

    def eval_null_transmission(self, si, active=True):
        return self._sum(mi.BSDFFlags.Null, lambda leaf: leaf.eval_null_transmission(si, active), si, active)

    def _sum(self, kind, value, si, active):
        """Weighted sum of values of the leaves with a lobe of this kind."""
        weights = self._weights(si, self._albedos(si, active), active)
        leaves = zip(self._leaves, weights, strict=True)
        parts = (weight * value(leaf) for leaf, weight in leaves if mi.has_flag(leaf.flags(), kind))
        return sum(parts, mi.Color3f(0))

    def traverse(self, callback):
        callback.put("weight", self._weight, mi.ParamFlags.Differentiable)
        for name, part in zip(("first", "second"), self._nested, strict=True):
            callback.put(name, part, mi.ParamFlags.Differentiable)
        if self._tint is not None:
            callback.put("tint", self._tint, mi.ParamFlags.Differentiable)

    def to_string(self):
        return f"Mixture[{self._settings}, weight={self._weight}, {self._nested[0]}, {self._nested[1]}]"


def _is_mixture(part):
    return isinstance(part, Mixture)


def _gray(weight):
    return mean(weight) if isinstance(weight, mi.Color3f) else weight


mi.register_bsdf("mixture", Mixture)
