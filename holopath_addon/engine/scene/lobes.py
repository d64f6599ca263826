"""The δ lobes of a scene's surfaces: mirrors, clear refraction and straight passage, each with its exact share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import drjit as dr
import mitsuba as mi

REFLECTION = int(mi.BSDFFlags.DeltaReflection)
REFRACTION = int(mi.BSDFFlags.DeltaTransmission)
PASSAGE = int(mi.BSDFFlags.Null)  # straight on: a thin pane, a mask
SHARP = REFLECTION | REFRACTION | PASSAGE
DIFFUSE = int(mi.BSDFFlags.Diffuse)
TRANSLUCENT = int(mi.BSDFFlags.DiffuseTransmission)
GLOSSY_TRANSMISSION = int(mi.BSDFFlags.GlossyTransmission)
GLOSSY = int(mi.BSDFFlags.GlossyReflection) | GLOSSY_TRANSMISSION
FAINT = 1e-6  # shares of less are rounding: on graphics cards total reflection lets 6e-8 through
SMOOTH = int(mi.BSDFFlags.Smooth)  # Mitsuba's word for all lobes that are not δ


@dataclass
class Lobe:
    """One way on from a surface (Dr.Jit types).

    Attributes
    ----------
    direction : mitsuba.Vector3f
        In the world.
    weight : mitsuba.Color3f
        Share of the radiance, zero where there is no such lobe.
    eta : mitsuba.Float
        Index of refraction beyond the surface relative to before.
    """

    direction: mi.Vector3f
    weight: mi.Color3f
    eta: mi.Float

    @property
    def exists(self) -> mi.Bool:
        """Whether any light comes this way, and not only what rounding leaves of 1 - 1."""
        return dr.max(self.weight) > FAINT


class SpecularLobes:
    """Samples the δ lobes of any BSDF without chance: component by component, so that blends keep their shares; and
    tells of narrow lobes as if they were δ.

    Parameters
    ----------
    scene : mitsuba.Scene
    """

    def __init__(self, scene: mi.Scene) -> None:
        self.components, self.mixed, self.passes = set(), False, False
        self.rough, self.coated = set(), False
        for bsdf, emits in _surfaces(scene):
            flags = int(bsdf.flags())
            if not flags & SHARP:
                for number in range(bsdf.component_count()):
                    self.rough |= {(number, bsdf.flags(number) & GLOSSY)} - {(number, 0)}
                self.coated |= bool(flags & GLOSSY) and bool(flags & DIFFUSE)
                continue
            self.mixed |= emits or bool(flags & SMOOTH)
            self.passes |= bool(flags & PASSAGE)
            for number in range(bsdf.component_count()):
                self.components |= {
                    (number, lobe) for lobe in (REFLECTION, REFRACTION) if bsdf.flags(number) & lobe
                }

    @property
    def refracts(self) -> bool:
        """Whether any surface changes the index of refraction."""
        return any(lobe in (REFRACTION, GLOSSY_TRANSMISSION) for _, lobe in self.components | self.rough)

    def at(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool) -> tuple:
        """Whether a surface scatters or emits, and its reflecting and transmitting `Lobe`."""
        bsdf = si.bsdf()
        flags = bsdf.flags()
        scatters = (flags & SMOOTH) != 0
        if self.mixed:
            scatters |= si.shape.is_emitter()
        reflected = self._lobe(bsdf, si, REFLECTION, active & ((flags & REFLECTION) != 0))
        transmitted = self._lobe(bsdf, si, REFRACTION, active & ((flags & REFRACTION) != 0))
        if self.passes:
            straight = active & ((flags & PASSAGE) != 0)
            share = dr.select(straight, bsdf.eval_null_transmission(si, straight), 0)
            transmitted.direction = dr.select(straight, -si.to_world(si.wi), transmitted.direction)
            transmitted.weight += share
        return scatters, reflected, transmitted

    def glossy(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool) -> tuple:
        """The stronger glossy lobe of a surface without δ lobes, followed as if it were smooth: its `Lobe`, its density
        in that direction, 0 where there is none, and whether the surface scatters otherwise, too.
        """
        bsdf, lobe, density = si.bsdf(), Lobe(mi.Vector3f(0, 0, 1), mi.Color3f(0), mi.Float(1)), mi.Float(0)
        flags = bsdf.flags()
        active &= ~is_specular(flags)
        for number, kind in sorted(self.rough):
            context = mi.BSDFContext()
            context.type_mask, context.component = kind, number
            there = active & ((flags & kind) != 0)
            direction, eta = mi.reflect(si.wi), mi.Float(1)
            if kind == GLOSSY_TRANSMISSION:
                sample, _ = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), there)
                eta = dr.select(sample.eta > 0, sample.eta, 1)
                _, cosine, _, inverse = mi.fresnel(si.wi.z, dr.select(si.wi.z > 0, eta, dr.rcp(eta)))
                direction = mi.refract(si.wi, cosine, inverse)
            value, seen = bsdf.eval_pdf(context, si, direction, there)
            value = dr.select(there & (seen > 0), value / seen, 0)
            stronger = dr.max(value) > dr.max(lobe.weight)
            lobe = dr.select(stronger, Lobe(direction, value, eta), lobe)
            density = dr.select(stronger, seen, density)
        lobe.direction = si.to_world(lobe.direction)
        return lobe, density, (flags & DIFFUSE) != 0

    def _lobe(self, bsdf, si, kind, active):
        direction, weight, eta = mi.Vector3f(0, 0, 1), mi.Color3f(0), mi.Float(1)
        for number, lobe in sorted(self.components):
            if lobe != kind:
                continue
            context = mi.BSDFContext()
            context.type_mask, context.component = kind, number
            sample, share = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), active)
            found = active & ((sample.sampled_type & kind) != 0) & (dr.max(share) > 0)
            direction = dr.select(found, sample.wo, direction)
            eta = dr.select(found, sample.eta, eta)
            weight += dr.select(found, share, 0)
        return Lobe(si.to_world(direction), weight, eta)


def surfaces_of(scene: mi.Scene) -> list[mi.Shape]:
    """Shapes of a scene that have a BSDF, those in groups too, once each."""
    shapes = (part for part in parts_of(scene) if isinstance(part, mi.Shape))
    return [shape for shape in shapes if shape.bsdf() is not None]


def is_specular(flags: mi.UInt32) -> mi.Bool:
    """Whether a surface of these BSDF flags has a δ lobe."""
    return (flags & SHARP) != 0


def parts_of(scene: mi.Scene) -> list[mi.Object]:
    """Every object of Mitsuba's that a scene is made of, once: shapes, instanced ones too, BSDFs, textures."""
    pending, seen = [scene], {}
    while pending:
        part = pending.pop()
        if part in seen:
            continue
        seen[part] = None
        pending += nested_in(part)
    return list(seen)


def nested_in(part: mi.Object) -> list[mi.Object]:
    """The objects of Mitsuba's that one of them holds, in its order."""
    return [value for _, value, _ in held_by(part) if isinstance(value, mi.Object)]


def held_by(part: mi.Object) -> list[tuple]:
    """Name and value of all that an object of Mitsuba's holds; of what is no object, its C++ type too, else None."""
    visit = _visit()()
    part.traverse(visit)
    return visit.found


@cache
def _visit():
    """A traversal of one part only, defined when Mitsuba has a variant."""

    class Visit(mi.TraversalCallback):
        def __init__(self):
            super().__init__()
            self.found = []

        def put(self, name, value, flags, cpptype=None):
            self.found.append((name, value, cpptype))

    return Visit


def _surfaces(scene):
    """Each BSDF that a shape of the scene has, once, and whether such a shape shines."""
    surfaces = {}
    for shape in surfaces_of(scene):
        bsdf = shape.bsdf()
        surfaces[bsdf] = surfaces.get(bsdf, False) or shape.is_emitter()
    return surfaces.items()
