"""BSDF type ``mixture``: what Mitsuba's `blendbsdf` is for, with mirrors, layers and sums.

Mitsuba 3.9's `blendbsdf` divides a sampled mirror direction by a density that mixes it with those of lobes which
scatter (its pull request 1681): a mirror over black at a weight of one half reflects 38 %. Nor can its weight
depend on the angle, as a coat's does, nor can it add.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from .buffers import mean
from .fingerprint import text_of_properties

ALL_COMPONENTS = 0xFFFFFFFF


class Mixture(mi.BSDF):
    """Two nested BSDFs; ``weight``, a number or texture, is the second's share, and by ``mode`` the first has

    ``blend``: the rest; ``fresnel_ior`` makes the second's share that times a dielectric's reflectance towards
    the viewer, ``facing`` that times one minus this power of the cosine;
    ``over``: what the second, which lies over it, does not reflect towards the viewer; its light crosses a
    layer of colour ``tint``, if given, whose index of refraction is ``int_ior``;
    ``add``: all.
    """

    def __init__(self, props):
        super().__init__(props)
        self._settings = text_of_properties(props)
        self._mode = props.get("mode", "blend")
        if self._mode not in ("blend", "over", "add"):
            raise ValueError(f"mixture: there is no mode '{self._mode}': choose blend, over or add.")
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
        """Albedo of each leaf that tells it."""
        return {leaf: leaf.albedo(si, active) for leaf in self._leaves if hasattr(leaf, "albedo")}

    def _shares(self, si, albedos, active):
        """Share of each leaf."""
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
                # Beer's law along the refracted ray; the tint is that of the way straight through
                cosine = dr.safe_sqrt(1 - (1 - dr.square(si.wi.z)) / dr.square(self._ior))
                colour = dr.maximum(self._tint.eval(si, active), 1e-6) ** dr.rcp(cosine)
                below = below * dr.lerp(mi.Color3f(1), colour, weight)
        return [
            share * inner
            for part, share in ((first, below), (second, above))
            for inner in (part._shares(si, albedos, active) if _is_mixture(part) else [1])
        ]

    def _shared(self, si, active):
        """Share of each leaf, and its chance to be sampled."""
        albedos = self._albedos(si, active)
        shares = self._shares(si, albedos, active)
        chances = [
            _grey(share) * _grey(albedos.get(leaf, 1.0))
            for leaf, share in zip(self._leaves, shares, strict=True)
        ]
        total = sum(chances)
        return shares, [dr.select(total > 0, chance / total, 1 / len(chances)) for chance in chances]

    def _one(self, ctx, si, active):
        """Number of the leaf that the context asks for, its context and its share."""
        number, component = self._owners[ctx.component]
        inner = mi.BSDFContext(ctx.mode, ctx.type_mask, component)
        return number, inner, self._shares(si, self._albedos(si, active), active)[number]

    def _first_component(self, number):
        return sum(leaf.component_count() for leaf in self._leaves[:number])

    def sample(self, ctx, si, sample1, sample2, active=True):
        if ctx.component != ALL_COMPONENTS:
            if ctx.component >= len(self._owners):
                return dr.zeros(mi.BSDFSample3f), mi.Color3f(0)
            number, inner, share = self._one(ctx, si, active)
            sample, value = self._leaves[number].sample(inner, si, sample1, sample2, active)
            sample.sampled_component += self._first_component(number)
            return sample, dr.select(active, value * share, 0)
        shares, chances = self._shared(si, active)
        sample, sharp = dr.zeros(mi.BSDFSample3f), mi.Color3f(0)
        left, number = mi.Bool(active), mi.Float(sample1)
        for i, (leaf, share, chance) in enumerate(zip(self._leaves, shares, chances, strict=True)):
            mine = left & (number < chance) if i + 1 < len(chances) else left
            rest = dr.clip(number / chance, 0, dr.one_minus_epsilon(mi.Float))
            drawn, value = leaf.sample(ctx, si, rest, sample2, mine)
            drawn.sampled_component += self._first_component(i)
            drawn.pdf *= chance
            sample = dr.select(mine, drawn, sample)
            if mi.has_flag(leaf.flags(), mi.BSDFFlags.Delta):
                sharp = dr.select(mine & (chance > 0), value * share / chance, sharp)
            left &= ~mine
            number -= chance
        # the others may scatter the same way, but never exactly as a mirror does
        scattered = active & ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) & (sample.pdf > 0)
        value, density = self._sums(ctx, si, sample.wo, shares, chances, scattered)
        value = dr.select(scattered, dr.select(density > 0, value / density, 0), sharp)
        sample.pdf = dr.select(scattered, density, sample.pdf)
        return sample, dr.select(active & (sample.pdf > 0), value, 0)

    def _sums(self, ctx, si, wo, shares, chances, active):
        value, density = mi.Color3f(0), mi.Float(0)
        for leaf, share, chance in zip(self._leaves, shares, chances, strict=True):
            if mi.has_flag(leaf.flags(), mi.BSDFFlags.Smooth):
                leaf_value, leaf_density = leaf.eval_pdf(ctx, si, wo, active)
                value += share * leaf_value
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
            number, inner, share = self._one(ctx, si, active)
            value, density = self._leaves[number].eval_pdf(inner, si, wo, active)
            return share * value, density
        return self._sums(ctx, si, wo, *self._shared(si, active), active)

    def eval_diffuse_reflectance(self, si, active=True):
        return self._sum(
            mi.BSDFFlags.Diffuse, lambda leaf: leaf.eval_diffuse_reflectance(si, active), si, active
        )

    def eval_null_transmission(self, si, active=True):
        return self._sum(mi.BSDFFlags.Null, lambda leaf: leaf.eval_null_transmission(si, active), si, active)

    def _sum(self, kind, value, si, active):
        """Values of the leaves with a lobe of this kind, by their shares."""
        shares = self._shares(si, self._albedos(si, active), active)
        leaves = zip(self._leaves, shares, strict=True)
        parts = (share * value(leaf) for leaf, share in leaves if mi.has_flag(leaf.flags(), kind))
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


def _grey(share):
    return mean(share) if isinstance(share, mi.Color3f) else share


mi.register_bsdf("mixture", Mixture)
