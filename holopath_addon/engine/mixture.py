"""BSDF type ``mixture``: what Mitsuba's `blendbsdf` is for, with mirrors and Fresnel's reflectance.

Mitsuba 3.9's `blendbsdf` divides a sampled mirror direction by a density that mixes it with those of lobes which
scatter (its pull request 1681): a mirror over black at a weight of one half reflects 38 %. Nor can its weight
depend on the angle, as a coat's does.
"""

ALL_COMPONENTS = 0xFFFFFFFF


def register():
    """Make the type known to the active variant of Mitsuba."""
    import drjit as dr
    import mitsuba as mi

    class Mixture(mi.BSDF):
        """Two nested BSDFs; ``weight``, a number or texture, is the second's share.

        With ``int_ior`` the share is the weight times the reflectance of a smooth surface of that index of
        refraction towards the viewer: the second BSDF is a coat's gloss, the first is what lies below.
        """

        def __init__(self, props):
            super().__init__(props)
            self._weight = props.get_texture("weight", 0.5)
            self._ior = dr.opaque(mi.Float, props["int_ior"]) if "int_ior" in props else None
            self._nested = [part for _, part in props.objects() if isinstance(part, mi.BSDF)]
            self._counts = [part.component_count() for part in self._nested]
            components = [part.flags(i) for part in self._nested for i in range(part.component_count())]
            self.m_components = components
            flags = 0
            for component in components:
                flags |= component
            self.m_flags = flags

        def _share(self, si, active):
            share = dr.clip(self._weight.eval_1(si, active), 0, 1)
            if self._ior is None:
                return share
            return share * mi.fresnel(dr.abs(mi.Frame3f.cos_theta(si.wi)), self._ior)[0]

        def _parts(self, ctx, si, active):
            """Nested BSDFs that the context asks for: number, BSDF, its context and its share."""
            share = self._share(si, active)
            shares = (1 - share, share)
            if ctx.component == ALL_COMPONENTS:
                return [(i, part, ctx, shares[i]) for i, part in enumerate(self._nested)]
            chosen = int(ctx.component >= self._counts[0])
            inner = mi.BSDFContext(ctx.mode, ctx.type_mask, ctx.component - chosen * self._counts[0])
            return [(chosen, self._nested[chosen], inner, shares[chosen])]

        def sample(self, ctx, si, sample1, sample2, active=True):
            parts = self._parts(ctx, si, active)
            if len(parts) == 1:
                ((number, part, inner, share),) = parts
                sample, value = part.sample(inner, si, sample1, sample2, active)
                sample.sampled_component += number * self._counts[0]
                return sample, value * share
            share = parts[1][3]
            second = sample1 < share
            below, value_below = self._nested[0].sample(
                ctx, si, (sample1 - share) / (1 - share), sample2, active & ~second
            )
            above, value_above = self._nested[1].sample(ctx, si, sample1 / share, sample2, active & second)
            above.sampled_component += self._counts[0]
            sample = dr.select(second, above, below)
            value = dr.select(second, value_above, value_below)
            sample.pdf *= dr.select(second, share, 1 - share)
            # the other part may scatter the same way, but never exactly as a mirror does
            scattered = active & ~mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta) & (sample.pdf > 0)
            both, density = self.eval_pdf(ctx, si, sample.wo, scattered)
            value = dr.select(scattered, dr.select(density > 0, both / density, 0), value)
            sample.pdf = dr.select(scattered, density, sample.pdf)
            return sample, dr.select(active, value, 0)

        def eval(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[0]

        def pdf(self, ctx, si, wo, active=True):
            return self.eval_pdf(ctx, si, wo, active)[1]

        def eval_pdf(self, ctx, si, wo, active=True):
            parts = self._parts(ctx, si, active)
            value, density = mi.Color3f(0), mi.Float(0)
            for _, part, inner, share in parts:
                part_value, part_density = part.eval_pdf(inner, si, wo, active)
                value += share * part_value
                density += part_density if len(parts) == 1 else share * part_density
            return value, density

        def eval_null_transmission(self, si, active=True):
            share = self._share(si, active)
            below, above = (part.eval_null_transmission(si, active) for part in self._nested)
            return (1 - share) * below + share * above

        def traverse(self, callback):
            callback.put("weight", self._weight, mi.ParamFlags.Differentiable)
            for name, part in zip(("first", "second"), self._nested, strict=True):
                callback.put(name, part, mi.ParamFlags.Differentiable)

        def to_string(self):
            return f"Mixture[weight={self._weight}, {self._nested[0]}, {self._nested[1]}]"

    mi.register_bsdf("mixture", Mixture)
