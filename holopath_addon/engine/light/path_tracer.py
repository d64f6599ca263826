"""Incoherent light: the radiance that leaves the real image point P towards the viewer (stage s5 of the paper)."""

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

DIRECT = (2,)  # vertices of a path that ends at the first surface that lamps light
CANDIDATES = 8  # lamps that one is drawn of


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
    cache : RadianceCache, optional
        Its `diffuse` tells what surfaces scatter diffusely, so that paths follow their other lobes only.
    """

    def __init__(self, max_depth: int, limit: float = dr.inf, cache: Any = None) -> None:
        # no literals: one kernel for all
        self.max_depth, self.limit = dr.opaque(mi.UInt32, max_depth), dr.opaque(mi.Float, limit)
        self.cache = cache
        self._all, self._glossy, self._matt = mi.BSDFContext(), mi.BSDFContext(), mi.BSDFContext()
        self._glossy.type_mask, self._matt.type_mask = GLOSSY, DIFFUSE

    def radiance(
        self,
        scene: mi.Scene,
        sampler: Sampler,
        ray: mi.Ray3f,
        surface: mi.PreliminaryIntersection3f,
        whole: mi.Bool,
        active: mi.Bool | bool = True,
        parts: tuple[mi.Float, mi.Bool] | None = None,
    ) -> mi.Color3f:
        """Radiance along a ray from where it meets a surface, one path.

        Parameters
        ----------
        scene : mitsuba.Scene
        sampler : Sampler
        ray : mitsuba.Ray3f
        surface : mitsuba.PreliminaryIntersection3f
            From the ray.
        whole : mitsuba.Bool
            False leaves out what the surface's δ lobes add.
        active : mitsuba.Bool
        parts : (mitsuba.Float, mitsuba.Bool), optional
            Share of the surface's glossy light, and whether its other light counts.

        Returns
        -------
        mitsuba.Color3f
        """
        direct, indirect = self.by_vertices(scene, sampler, ray, surface, whole, DIRECT, active, parts)
        return direct + self._limited(indirect)

    def by_vertices(
        self,
        scene: mi.Scene,
        sampler: Sampler,
        ray: mi.Ray3f,
        surface: mi.PreliminaryIntersection3f,
        whole: mi.Bool,
        ends: tuple[int, ...],
        active: mi.Bool | bool = True,
        parts: tuple[mi.Float, mi.Bool] | None = None,
    ) -> list[mi.Color3f]:
        """What `radiance` adds up, without its limit: light of paths with ends[0] vertices at most, of those with more
        and ends[1] at most, and so on; last of those with still more.
        """
        return self._followed(scene, _Path(ray, surface, sampler, active, ends), whole, parts).found

    def scattered(
        self,
        scene: mi.Scene,
        sampler: Sampler,
        si: mi.SurfaceInteraction3f,
        context: mi.BSDFContext,
        turn: tuple[mi.Point2f, mi.Point2f],
    ) -> tuple[mi.Color3f, mi.Color3f, mi.Float]:
        """Light from lamps, and from what they light, that some lobes of a surface scatter to si.wi; one path.

        Parameters
        ----------
        scene : mitsuba.Scene
        sampler : Sampler
        si : mitsuba.SurfaceInteraction3f
        context : mitsuba.BSDFContext
            Which lobes.
        turn : pair of mitsuba.Point2f
            Uniform in the unit square: for a point on the lamps, and for a direction.

        Returns
        -------
        direct, indirect : mitsuba.Color3f
        distance : mitsuba.Float
            To where the path went, metres.
        """
        bsdf, (lamp_turn, bsdf_turn) = si.bsdf(), turn
        light = self._next_event(scene, sampler, si, bsdf, [(context, True)], lamp_turn)
        sample, value = bsdf.sample(context, si, sampler.next_1d(), bsdf_turn)
        path = _Path(None, None, sampler, dr.max(value) > 0)
        path.leave(scene, si, sample, value)
        distance = path.surface.t
        direct, indirect = self._followed(scene, path, mi.Bool(True)).found
        return light + direct, self._limited(indirect), distance

    def _limited(self, light):
        return light * dr.minimum(1, self.limit / dr.maximum(dr.max(light), 1e-30))

    def _followed(self, scene, path, whole, parts=None):
        """The path at its end."""
        state, ends = path.state(), path.ends

        def body(*state):
            path = _Path.of(state, ends)
            active = path.active
            si = path.surface.compute_surface_interaction(path.ray, mi.RayFlags.All, active)
            bsdf = si.bsdf()
            # emission, unless next-event estimation at the last vertex would have found it
            seen = mi.DirectionSample3f(scene, si, path.before)
            by_lamp = scene.pdf_emitter_direction(path.before, seen, active & ~path.sharp)
            weight = path.share * _power(path.density, by_lamp)
            gloss = matt = mi.Bool(False)
            if parts is not None:
                share, rest = parts
                gloss = (path.depth == 0) & ~rest
                matt = (path.depth == 0) & rest & (path.sampler.next_1d() >= share)
            path.gather(0, dr.select(gloss, 0, weight * si.emitter(scene, active).eval(si, active)))
            active &= si.is_valid()
            lobes = [(self._all, active & ~gloss & ~matt)]
            if parts is not None:
                lobes += [(self._glossy, active & gloss), (self._matt, active & matt)]
            if self.cache is not None:
                light, cached = self.cache.diffuse(
                    path.surface, si, bsdf, path.sampler, path.depth == 0, active
                )
                shown = cached & ~gloss & (path.depth + 1 < self.max_depth)
                path.gather(1, dr.select(shown, path.share * light, 0))
                others = (
                    [] if self.cache.complete else [(context, lanes & ~cached) for context, lanes in lobes]
                )
                lobes = [(self.cache.others, active & cached & ~matt), *others]
            active &= path.depth + 1 < self.max_depth
            lobes = [(context, lanes & active) for context, lanes in lobes]
            near = self._next_event(scene, path.sampler, si, bsdf, lobes, path.sampler.next_2d())
            path.gather(1, path.share * near)
            chance, turn = path.sampler.next_1d(), path.sampler.next_2d()
            sample, value = dr.zeros(mi.BSDFSample3f), mi.Color3f(0)
            for context, lanes in lobes:
                drawn, drawn_value = bsdf.sample(context, si, chance, turn, lanes)
                sample, value = dr.select(lanes, drawn, sample), dr.select(lanes, drawn_value, value)
            # a path that leaves P by a δ lobe is another branch's
            sharp = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
            path.active = active & (whole | (path.depth > 0) | ~sharp)
            if self.cache is not None:
                # Russian roulette: what a cached surface does not scatter diffusely is often little
                chance = dr.select(path.depth > 0, dr.minimum(dr.max(path.share * value), 1), 1)
                path.active &= path.sampler.next_1d() < chance
                value /= dr.maximum(chance, 1e-30)
            path.leave(scene, si, sample, value)
            return path.state()

        return _Path.of(dr.while_loop(state, lambda *s: s[-1], body, label="radiance path"), ends)

    def _next_event(self, scene, sampler, si, bsdf, lobes, turn):
        """Light that comes straight from a lamp and that these lobes scatter to si.wi.

        Of several lamps one is drawn by what each would give if nothing stood before it: resampled importance sampling
        (Talbot, Cline and Egbert, EGSR 2005). Candidates are spread evenly over the lamps: all of few.
        """
        smooth = mi.Bool(False)
        for context, lanes in lobes:
            smooth |= lanes & ((bsdf.flags() & (context.type_mask & SMOOTH)) != 0)

        def scattered(turn):
            """What a lamp would give, and where it is."""
            lamp, strength = scene.sample_emitter_direction(si, turn, False, smooth)
            lit = smooth & (lamp.pdf != 0)
            towards, value, density = si.to_local(lamp.d), mi.Color3f(0), mi.Float(0)
            for context, lanes in lobes:
                lobe_value, lobe_density = bsdf.eval_pdf(context, si, towards, lanes & lit)
                value, density = value + lobe_value, density + lobe_density
            balance = dr.select(lamp.delta, 1, _power(lamp.pdf, density))
            return dr.select(lit, value * strength * balance, 0), lamp.p

        count = min(len(scene.emitters()), CANDIDATES)
        if count < 2:
            light, place = scattered(turn)
        else:
            step, last = dr.opaque(mi.Float, 1 / count), dr.opaque(mi.UInt32, count)

            def body(number, chance, total, best, light, place):
                along = turn.x + mi.Float(number) * step
                found, point = scattered(mi.Point2f(along - dr.floor(along), turn.y))
                bright = mean(found)
                bright = dr.select(dr.isfinite(bright), bright, 0)
                total += bright
                share = dr.select(bright > 0, bright / total, 0)
                taken = chance < share
                chance = dr.select(taken, chance / share, (chance - share) / (1 - share))
                best, light = dr.select(taken, bright, best), dr.select(taken, found, light)
                return number + 1, chance, total, best, light, dr.select(taken, point, place)

            state = (mi.UInt32(0), sampler.next_1d(), mi.Float(0), mi.Float(0), mi.Color3f(0), mi.Point3f(0))
            _, _, total, best, light, place = dr.while_loop(
                state, lambda number, *_: number < last, body, label="lamps"
            )
            light *= dr.select(best > 0, total * step / best, 0)
        reaches = dr.max(light) > 0
        reaches &= ~scene.ray_test(si.spawn_ray_to(place), reaches)
        return dr.select(reaches, light, 0)


class _Path:
    """A path on its way (Dr.Jit types): the ray and what it meets, vertices before, its share, the light found by
    numbers of vertices (see `PathTracer.by_vertices`), the last vertex, and how it was left.
    """

    ray: mi.Ray3f
    surface: mi.PreliminaryIntersection3f

    FIELDS = "ray surface depth share found before density sharp sampler active".split()

    def __init__(self, ray, surface, sampler, active, ends=DIRECT):
        if ray is not None:  # else it is `leave` that sets out
            self.ray, self.surface = mi.Ray3f(ray), mi.PreliminaryIntersection3f(surface)
        self.depth, self.share = mi.UInt32(0), mi.Color3f(1)
        self.ends, self.found = ends, [mi.Color3f(0) for _ in range(len(ends) + 1)]
        self.before, self.density = dr.zeros(mi.Interaction3f), mi.Float(1)
        self.sharp, self.sampler, self.active = mi.Bool(True), sampler, mi.Bool(active)

    @classmethod
    def of(cls, state, ends):
        """Inverse of `state`."""
        path = cls.__new__(cls)
        path.__dict__.update(zip(cls.FIELDS, state, strict=True), ends=ends)
        return path

    def state(self):
        """What a loop carries."""
        return tuple(getattr(self, name) for name in self.FIELDS)

    def gather(self, scatterings, light):
        """Add light that was scattered so often beyond this vertex."""
        for number, total in enumerate(self.found):
            late = self.depth + scatterings >= self.ends[number] if number < len(self.ends) else False
            self.found[number] = total + dr.select(late, 0, light)
            light = dr.select(late, light, 0)

    def leave(self, scene, si, sample, value):
        """Go on to the next surface."""
        self.share *= value
        self.active &= dr.max(self.share) > 0
        self.before = dr.select(self.active, mi.Interaction3f(si), self.before)
        self.density, self.sharp = sample.pdf, mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        self.ray = si.spawn_ray(si.to_world(sample.wo))
        self.surface = scene.ray_intersect_preliminary(self.ray, coherent=False, active=self.active)
        self.depth += 1


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

    def sampler(self, seed: int, size: int) -> Sampler:
        """Random numbers for `size` pixels."""
        return Sampler.seeded(seed, dr.arange(mi.UInt32, size))

    def amplitudes(
        self,
        scene: mi.Scene,
        rays: Rays,
        sampler: Sampler,
        seen: ImagePoint,
        grain: tuple[mi.Int, mi.Int, mi.Float],
        slope: tuple[mi.Float, mi.Float],
        channels: Sequence[int],
    ) -> tuple[list, tuple[mi.Float, mi.Float]]:
        """Roots of the radiance in each of the channels along a ray, and `Rays.tilt` of what it sees."""

        def body(number, total, sampler):
            light = self.tracer.radiance(
                scene, sampler, seen.ray, seen.surface, seen.whole, seen.exists, seen.parts
            )
            light /= seen.colour
            return number + 1, total + dr.select(dr.isfinite(light), light, 0), sampler

        paths = dr.opaque(mi.UInt32, self.paths)
        state = (mi.UInt32(0), mi.Color3f(0), sampler)
        _, total, _ = dr.while_loop(state, lambda number, *_: number < paths, body, label="paths of a ray")
        return [dr.sqrt(dr.maximum(total[c], 0) / self.paths) for c in channels], rays.tilt(seen)


def _power(chosen, other):
    """Power heuristic for the technique that was chosen."""
    chosen, other = chosen**2, other**2
    return dr.select(chosen > 0, chosen / (chosen + other), 0)
