"""Incoherent light: the radiance that leaves the real image point P towards the viewer (stage s5 of the paper)."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi


class PathTracer:
    """Path tracing with next-event estimation and multiple importance sampling (Veach 1997, balance and power
    heuristics as in Mitsuba's `path`), from a surface that is already found.

    Parameters
    ----------
    max_depth : int
        Vertices of a path, as Mitsuba counts them: 1 emission only, 2 direct light.
    limit : float
        Most that light which was scattered twice or more may add to a path, in radiance: a rare path of great
        weight (a firefly) then spoils no grain. What is cut is lost.
    """

    def __init__(self, max_depth, limit=dr.inf):
        self.max_depth, self.limit = max_depth, limit

    def radiance(self, scene, sampler, ray, surface, whole, active=True):
        """Radiance along a ray from where it meets a surface, one path.

        Parameters
        ----------
        scene : mitsuba.Scene
        sampler : mitsuba.Sampler
        ray : mitsuba.Ray3f
        surface : mitsuba.PreliminaryIntersection3f
            From the ray.
        whole : mitsuba.Bool
            False leaves out what the surface's δ lobes add.
        active : mitsuba.Bool

        Returns
        -------
        mitsuba.Color3f
        """
        context = mi.BSDFContext()
        state = (
            mi.Ray3f(ray),
            mi.PreliminaryIntersection3f(surface),
            mi.UInt32(0),
            mi.Color3f(1),
            mi.Color3f(0),
            mi.Color3f(0),
            dr.zeros(mi.Interaction3f),
            mi.Float(1),
            mi.Bool(True),
            sampler,
            mi.Bool(active),
        )

        def body(ray, surface, depth, share, direct, indirect, before, density, sharp, sampler, active):
            si = surface.compute_surface_interaction(ray, mi.RayFlags.All, active)
            bsdf = si.bsdf()
            # emission, unless next-event estimation at the last vertex would have found it
            seen = mi.DirectionSample3f(scene, si, before)
            by_lamp = scene.pdf_emitter_direction(before, seen, active & ~sharp)
            light = share * _power(density, by_lamp) * si.emitter(scene, active).eval(si, active)
            active &= (depth + 1 < self.max_depth) & si.is_valid()
            # next event
            lit = active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            lamp, strength = scene.sample_emitter_direction(si, sampler.next_2d(), True, lit)
            lit &= lamp.pdf != 0
            value, by_bsdf = bsdf.eval_pdf(context, si, si.to_local(lamp.d), lit)
            balance = dr.select(lamp.delta, 1, _power(lamp.pdf, by_bsdf))
            near = dr.select(lit, share * value * strength * balance, 0)
            # a path that leaves P by a δ lobe is another branch's
            sample, value = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
            sharp = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            direct += dr.select(depth <= 1, light, 0) + dr.select(depth == 0, near, 0)
            indirect += dr.select(depth > 1, light, 0) + dr.select(depth > 0, near, 0)
            active &= whole | (depth > 0) | ~sharp
            share *= value
            active &= dr.max(share) > 0
            before = dr.select(active, mi.Interaction3f(si), before)
            ray = si.spawn_ray(si.to_world(sample.wo))
            surface = scene.ray_intersect_preliminary(ray, coherent=False, active=active)
            return (
                ray,
                surface,
                depth + 1,
                share,
                direct,
                indirect,
                before,
                sample.pdf,
                sharp,
                sampler,
                active,
            )

        out = dr.while_loop(state, lambda *s: s[-1], body, label="radiance path")
        direct, indirect = out[4], out[5]
        return direct + indirect * dr.minimum(1, self.limit / dr.maximum(dr.max(indirect), 1e-30))


@dataclass(frozen=True)
class PathsPerRay:
    """The radiance of each ray by paths of its own, as the paper has it: dark where a few paths are noisy.

    Parameters
    ----------
    tracer : PathTracer
    paths : int
        Averaged before the root is taken.
    """

    tracer: PathTracer
    paths: int

    def sampler(self, seed, size):
        """Random numbers for `size` pixels."""
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, size)
        return sampler

    def amplitudes(self, scene, sampler, seen, grain, slope, channels):
        """Roots of the radiance in each of the channels along a ray."""

        def body(number, total, sampler):
            light = self.tracer.radiance(scene, sampler, seen.ray, seen.surface, seen.whole, seen.exists)
            return number + 1, total + dr.select(dr.isfinite(light), light, 0), sampler

        paths = dr.opaque(mi.UInt32, self.paths)
        state = (mi.UInt32(0), mi.Color3f(0), sampler)
        _, total, _ = dr.while_loop(state, lambda number, *_: number < paths, body, label="paths of a ray")
        return [dr.sqrt(dr.maximum(total[c], 0) / self.paths) for c in channels]


def _power(chosen, other):
    """Power heuristic for the technique that was chosen."""
    chosen, other = chosen**2, other**2
    return dr.select(chosen > 0, chosen / (chosen + other), 0)
