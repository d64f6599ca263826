"""Incoherent light: radiance that leaves the real image point P towards the viewer (stage s5 of the paper)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi

from ..scene.buffers import mean
from ..scene.lobes import DIFFUSE, GLOSSY, SMOOTH
from ..scene.random_numbers import Sampler

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..scene.rays import ImagePoint, Rays

DIRECT = (2,)  # vertices of a path whose light comes straight from an emitter
CANDIDATES = 8  # emitters of which one is drawn


class PathTracer:
    """Path tracer that starts at a known surface, with next-event estimation and multiple importance sampling.

    Balance and power heuristics (Veach 1997) as in Mitsuba's `path`.

    Parameters
    ----------
    max_depth : int
        Vertices of a path, as Mitsuba counts them: 1 emission only, 2 direct light.
    limit : float
        Maximum radiance of a path's light that was scattered twice or more: a rare path of great weight (a firefly)
        then spoils no grain. The excess is lost.
    cache : RadianceCache, optional
        Source of diffusely scattered light; paths then follow other lobes only.
    """

    def __init__(self, max_depth: int, limit: float = dr.inf, cache: Any = None) -> None:
        # opaque numbers, not literals: one compiled kernel for all
        self.max_depth, self.limit = dr.opaque(mi.UInt32, max_depth), dr.opaque(mi.Float, limit)
        self.cache = cache
        self._all, self._glossy, self._diffuse = mi.BSDFContext(), mi.BSDFContext(), mi.BSDFContext()
        self._glossy.type_mask, self._diffuse.type_mask = GLOSSY, DIFFUSE

    def radiance(
        self, scene: mi.Scene, sampler: Sampler, point: ImagePoint, active: mi.Bool | bool = True
    ) -> mi.Color3f:
        """Radiance of one path from an image point: the light that the point's branch shows.

        Parameters
        ----------
        scene : mitsuba.Scene
        sampler : Sampler
        point : ImagePoint
        active : mitsuba.Bool

        Returns
        -------
        mitsuba.Color3f
        """
        direct, indirect = self.by_vertices(scene, sampler, point, DIRECT, active)
        return direct + self._limited(indirect)

    def by_vertices(
        self,
        scene: mi.Scene,
        sampler: Sampler,
        point: ImagePoint,
        ends: tuple[int, ...],
        active: mi.Bool | bool = True,
    ) -> list[mi.Color3f]:
        """Light of one path by its numbers of vertices; the sum is `radiance` without its limit.

        Parameters
        ----------
        scene, sampler, point, active
            See `radiance`.
        ends : tuple of int
            Maximum vertices of each class of paths, in ascending order.

        Returns
        -------
        list of mitsuba.Color3f
            Light of paths with up to ends[0] vertices, with more and up to ends[1], and so on, and of all longer ones.
        """
        path = _Path(point.ray, point.surface, sampler, active, ends)
        return self._follow(scene, path, point.whole, point.parts).light

    def scattered_light(
        self,
        scene: mi.Scene,
        sampler: Sampler,
        si: mi.SurfaceInteraction3f,
        context: mi.BSDFContext,
        samples: tuple[mi.Point2f, mi.Point2f],
    ) -> tuple[mi.Color3f, mi.Color3f, mi.Float]:
        """Light of one path that some lobes of a surface scatter to si.wi.

        Parameters
        ----------
        scene : mitsuba.Scene
        sampler : Sampler
        si : mitsuba.SurfaceInteraction3f
        context : mitsuba.BSDFContext
            Selects the lobes.
        samples : pair of mitsuba.Point2f
            Uniform in the unit square: for a point on the emitters, and for a direction.

        Returns
        -------
        direct, indirect : mitsuba.Color3f
            Light straight from emitters, and by way of other surfaces.
        distance : mitsuba.Float
            Distance to the next surface of the path, meters.
        """
        bsdf, (emitter_sample, bsdf_sample) = si.bsdf(), samples
        light = self._next_event(scene, sampler, si, bsdf, [(context, True)], emitter_sample)
        sample, value = bsdf.sample(context, si, sampler.next_1d(), bsdf_sample)
        path = _Path(None, None, sampler, dr.max(value) > 0)
        path.leave(scene, si, sample, value)
        distance = path.surface.t
        direct, indirect = self._follow(scene, path, mi.Bool(True)).light
        return light + direct, self._limited(indirect), distance

    def _limited(self, light):
        return light * dr.minimum(1, self.limit / dr.maximum(dr.max(light), 1e-30))

    def _follow(self, scene, path, whole, parts=None):
        """Follow a path to its end."""
        state, ends = path.state(), path.ends

        def body(*state):
            path = _Path.of(state, ends)
            active = path.active
            si = path.surface.compute_surface_interaction(path.ray, mi.RayFlags.All, active)
            bsdf = si.bsdf()
            # emission, unless next-event estimation at the last vertex would have found it
            direction = mi.DirectionSample3f(scene, si, path.before)
            emitter_density = scene.pdf_emitter_direction(path.before, direction, active & ~path.sharp)
            weight = path.throughput * _power(path.density, emitter_density)
            gloss = diffuse = mi.Bool(False)
            if parts is not None:
                fraction, rest = parts
                gloss = (path.depth == 0) & ~rest
                diffuse = (path.depth == 0) & rest & (path.sampler.next_1d() >= fraction)
            path.gather(0, dr.select(gloss, 0, weight * si.emitter(scene, active).eval(si, active)))
            active &= si.is_valid()
            lobes = [(self._all, active & ~gloss & ~diffuse)]
            if parts is not None:
                lobes += [(self._glossy, active & gloss), (self._diffuse, active & diffuse)]
            if self.cache is not None:
                light, cached = self.cache.diffuse(
                    path.surface, si, bsdf, path.sampler, path.depth == 0, active
                )
                counts = cached & ~gloss & (path.depth + 1 < self.max_depth)
                path.gather(1, dr.select(counts, path.throughput * light, 0))
                others = (
                    [] if self.cache.complete else [(context, lanes & ~cached) for context, lanes in lobes]
                )
                lobes = [(self.cache.others, active & cached & ~diffuse), *others]
            active &= path.depth + 1 < self.max_depth
            lobes = [(context, lanes & active) for context, lanes in lobes]
            direct = self._next_event(scene, path.sampler, si, bsdf, lobes, path.sampler.next_2d())
            path.gather(1, path.throughput * direct)
            u, v = path.sampler.next_1d(), path.sampler.next_2d()
            sample, value = dr.zeros(mi.BSDFSample3f), mi.Color3f(0)
            for context, lanes in lobes:
                lobe_sample, lobe_value = bsdf.sample(context, si, u, v, lanes)
                sample, value = dr.select(lanes, lobe_sample, sample), dr.select(lanes, lobe_value, value)
            # a path that leaves P by a δ lobe belongs to another branch
            sharp = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            path.active = active & (whole | (path.depth > 0) | ~sharp)
            if self.cache is not None:
                # Russian roulette: other lobes of a cached surface often scatter little
                chance = dr.select(path.depth > 0, dr.minimum(dr.max(path.throughput * value), 1), 1)
                path.active &= path.sampler.next_1d() < chance
                value /= dr.maximum(chance, 1e-30)
            path.leave(scene, si, sample, value)
            return path.state()

        return _Path.of(dr.while_loop(state, lambda *s: s[-1], body, label="radiance path"), ends)

    def _next_event(self, scene, sampler, si, bsdf, lobes, sample):
        """Light straight from an emitter that some lobes scatter to si.wi.

        Of several emitters one is drawn by the light of each without shadows: resampled importance sampling (Talbot,
        Cline and Egbert, EGSR 2005). Candidates are spread evenly over the emitters: all of few.
        """
        smooth = mi.Bool(False)
        for context, lanes in lobes:
            smooth |= lanes & ((bsdf.flags() & (context.type_mask & SMOOTH)) != 0)

        def unshadowed(sample):
            """Light of an emitter without shadows, and the point on it."""
            emitter, radiance = scene.sample_emitter_direction(si, sample, False, smooth)
            lit = smooth & (emitter.pdf != 0)
            towards, value, density = si.to_local(emitter.d), mi.Color3f(0), mi.Float(0)
            for context, lanes in lobes:
                lobe_value, lobe_density = bsdf.eval_pdf(context, si, towards, lanes & lit)
                value, density = value + lobe_value, density + lobe_density
            balance = dr.select(emitter.delta, 1, _power(emitter.pdf, density))
            return dr.select(lit, value * radiance * balance, 0), emitter.p

        count = min(len(scene.emitters()), CANDIDATES)
        if count < 2:
            light, place = unshadowed(sample)
        else:
            step, last = dr.opaque(mi.Float, 1 / count), dr.opaque(mi.UInt32, count)

            def body(number, chance, total, best, light, place):
                along = sample.x + mi.Float(number) * step
                candidate, point = unshadowed(mi.Point2f(along - dr.floor(along), sample.y))
                bright = mean(candidate)
                bright = dr.select(dr.isfinite(bright), bright, 0)
                total += bright
                weight = dr.select(bright > 0, bright / total, 0)
                chosen = chance < weight
                chance = dr.select(chosen, chance / weight, (chance - weight) / (1 - weight))
                best, light = dr.select(chosen, bright, best), dr.select(chosen, candidate, light)
                return number + 1, chance, total, best, light, dr.select(chosen, point, place)

            state = (mi.UInt32(0), sampler.next_1d(), mi.Float(0), mi.Float(0), mi.Color3f(0), mi.Point3f(0))
            _, _, total, best, light, place = dr.while_loop(
                state, lambda number, *_: number < last, body, label="lamps"
            )
            light *= dr.select(best > 0, total * step / best, 0)
        reaches = dr.max(light) > 0
        reaches &= ~scene.ray_test(si.spawn_ray_to(place), reaches)
        return dr.select(reaches, light, 0)


class _Path:
    """State of a path, in Dr.Jit types.

    It has the ray and the surface that it meets, vertices before, throughput, light by numbers of vertices (see
    `PathTracer.by_vertices`), the last vertex, and density and kind of the lobe by which the ray left it.
    """

    ray: mi.Ray3f
    surface: mi.PreliminaryIntersection3f

    FIELDS = "ray surface depth throughput light before density sharp sampler active".split()

    def __init__(self, ray, surface, sampler, active, ends=DIRECT):
        if ray is not None:  # else `leave` sets both
            self.ray, self.surface = mi.Ray3f(ray), mi.PreliminaryIntersection3f(surface)
        self.depth, self.throughput = mi.UInt32(0), mi.Color3f(1)
        self.ends, self.light = ends, [mi.Color3f(0) for _ in range(len(ends) + 1)]
        self.before, self.density = dr.zeros(mi.Interaction3f), mi.Float(1)
        self.sharp, self.sampler, self.active = mi.Bool(True), sampler, mi.Bool(active)

    @classmethod
    def of(cls, state, ends):
        """Inverse of `state`."""
        path = cls.__new__(cls)
        path.__dict__.update(zip(cls.FIELDS, state, strict=True), ends=ends)
        return path

    def state(self):
        """State of a Dr.Jit loop."""
        return tuple(getattr(self, name) for name in self.FIELDS)

    def gather(self, scatterings, light):
        """Add light that was scattered `scatterings` times beyond this vertex."""
        for number, total in enumerate(self.light):
            late = self.depth + scatterings >= self.ends[number] if number < len(self.ends) else False
            self.light[number] = total + dr.select(late, 0, light)
            light = dr.select(late, light, 0)

    def leave(self, scene, si, sample, value):
        """Go on to the next surface."""
        self.throughput *= value
        self.active &= dr.max(self.throughput) > 0
        self.before = dr.select(self.active, mi.Interaction3f(si), self.before)
        self.density, self.sharp = sample.pdf, mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        self.ray = si.spawn_ray(si.to_world(sample.wo))
        self.surface = scene.ray_intersect_preliminary(self.ray, coherent=False, active=self.active)
        self.depth += 1


@dataclass(frozen=True)
class PathsPerRay:
    """Radiance of each ray by paths of its own, as in the paper: too dark where a few paths are noisy.

    Attributes
    ----------
    tracer : PathTracer
    paths : int
        Paths that are averaged before the root is taken.
    """

    tracer: PathTracer
    paths: int

    def sampler(self, seed: int, size: int) -> Sampler:
        """Random numbers for `size` pixels."""
        return Sampler.seeded(seed, dr.arange(mi.UInt32, size))

    def amplitudes(
        self,
        scene: mi.Scene,
        rays: Rays,
        sampler: Sampler,
        point: ImagePoint,
        grain: tuple[mi.Int, mi.Int, mi.Float],
        slope: tuple[mi.Float, mi.Float],
        channels: Sequence[int],
    ) -> tuple[list, tuple[mi.Float, mi.Float]]:
        """Trace paths for amplitudes, the roots of radiances, and `Rays.tilt`; see `RadianceMap.amplitudes`.

        Parameters
        ----------
        scene : mitsuba.Scene
        rays : Rays
        sampler : Sampler
        point : ImagePoint
        grain, slope
            Not used.
        channels : sequence of int
            Color channel of each wavelength.
        """

        def body(number, total, sampler):
            light = self.tracer.radiance(scene, sampler, point, point.exists)
            light /= point.color
            return number + 1, total + dr.select(dr.isfinite(light), light, 0), sampler

        paths = dr.opaque(mi.UInt32, self.paths)
        state = (mi.UInt32(0), mi.Color3f(0), sampler)
        _, total, _ = dr.while_loop(state, lambda number, *_: number < paths, body, label="paths of a ray")
        return [dr.sqrt(dr.maximum(total[c], 0) / self.paths) for c in channels], rays.tilt(point)


def _power(chosen, other):
    """Weight of the chosen technique by the power heuristic."""
    chosen, other = chosen**2, other**2
    return dr.select(chosen > 0, chosen / (chosen + other), 0)
