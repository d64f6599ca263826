"""δ lobes of a scene's surfaces (mirrors, clear refraction, straight transmission), each with its exact weight."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import drjit as dr
import mitsuba as mi

REFLECTION = int(mi.BSDFFlags.DeltaReflection)
REFRACTION = int(mi.BSDFFlags.DeltaTransmission)
PASSAGE = int(mi.BSDFFlags.Null)  # straight transmission: a thin pane, a mask
SHARP = REFLECTION | REFRACTION | PASSAGE
DIFFUSE = int(mi.BSDFFlags.Diffuse)
TRANSLUCENT = int(mi.BSDFFlags.DiffuseTransmission)
GLOSSY_TRANSMISSION = int(mi.BSDFFlags.GlossyTransmission)
GLOSSY = int(mi.BSDFFlags.GlossyReflection) | GLOSSY_TRANSMISSION
FAINT = 1e-6  # smaller weights are rounding errors: on graphics cards 6e-8 passes total reflection
SMOOTH = int(mi.BSDFFlags.Smooth)  # Mitsuba's name of all lobes that are not δ


@dataclass
class Lobe:
    """Lobe of a surface that is followed in one direction (Dr.Jit types).

    Attributes
    ----------
    direction : mitsuba.Vector3f
        Direction in the world.
    weight : mitsuba.Color3f
        Fraction of the radiance; 0 if there is no such lobe.
    eta : mitsuba.Float
        Index of refraction beyond the surface, relative to that before it.
    """

    direction: mi.Vector3f
    weight: mi.Color3f
    eta: mi.Float

    @property
    def exists(self) -> mi.Bool:
        """Whether the weight exceeds rounding errors."""
        return dr.max(self.weight) > FAINT


class SpecularLobes:
    """δ lobes of any BSDF, component by component, so that blends keep their weights; and narrow lobes as if δ.

    Parameters
    ----------
    scene : mitsuba.Scene
    """

    def __init__(self, scene: mi.Scene) -> None:
        self.components, self.mixed, self.transmits = set(), False, False
        self.rough, self.coated = set(), False
        for bsdf, emits in _surfaces(scene):
            flags = int(bsdf.flags())
            if not flags & SHARP:
                for number in range(bsdf.component_count()):
                    self.rough |= {(number, bsdf.flags(number) & GLOSSY)} - {(number, 0)}
                self.coated |= bool(flags & GLOSSY) and bool(flags & DIFFUSE)
                continue
            self.mixed |= emits or bool(flags & SMOOTH)
            self.transmits |= bool(flags & PASSAGE)
            for number in range(bsdf.component_count()):
                self.components |= {
                    (number, lobe) for lobe in (REFLECTION, REFRACTION) if bsdf.flags(number) & lobe
                }

    @property
    def refracts(self) -> bool:
        """Whether any surface changes the index of refraction."""
        return any(lobe in (REFRACTION, GLOSSY_TRANSMISSION) for _, lobe in self.components | self.rough)

    def at(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool) -> tuple:
        """Whether the surface at si scatters or emits, and its reflected and transmitted `Lobe`, where `active`."""
        bsdf = si.bsdf()
        flags = bsdf.flags()
        scatters = (flags & SMOOTH) != 0
        if self.mixed:
            scatters |= si.shape.is_emitter()
        reflected = self._lobe(bsdf, si, REFLECTION, active & ((flags & REFLECTION) != 0))
        transmitted = self._lobe(bsdf, si, REFRACTION, active & ((flags & REFRACTION) != 0))
        if self.transmits:
            straight = active & ((flags & PASSAGE) != 0)
            weight = dr.select(straight, bsdf.eval_null_transmission(si, straight), 0)
            transmitted.direction = dr.select(straight, -si.to_world(si.wi), transmitted.direction)
            transmitted.weight += weight
        return scatters, reflected, transmitted

    def glossy(self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool) -> tuple:
        """Stronger glossy lobe of the surface at si, if it has no δ lobe, in the direction of a smooth surface.

        Returns
        -------
        lobe : Lobe
        density : mitsuba.Float
            Density of the lobe in that direction; 0 if there is none.
        coated : mitsuba.Bool
            Whether the surface also scatters diffusely.
        """
        bsdf, lobe, density = si.bsdf(), Lobe(mi.Vector3f(0, 0, 1), mi.Color3f(0), mi.Float(1)), mi.Float(0)
        flags = bsdf.flags()
        active &= ~is_specular(flags)
        for number, kind in sorted(self.rough):
            context = mi.BSDFContext()
            context.type_mask, context.component = kind, number
            valid = active & ((flags & kind) != 0)
            direction, eta = mi.reflect(si.wi), mi.Float(1)
            if kind == GLOSSY_TRANSMISSION:
                sample, _ = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), valid)
                eta = dr.select(sample.eta > 0, sample.eta, 1)
                _, cosine, _, inverse = mi.fresnel(si.wi.z, dr.select(si.wi.z > 0, eta, dr.rcp(eta)))
                direction = mi.refract(si.wi, cosine, inverse)
            value, pdf = bsdf.eval_pdf(context, si, direction, valid)
            value = dr.select(valid & (pdf > 0), value / pdf, 0)
            stronger = dr.max(value) > dr.max(lobe.weight)
            lobe = dr.select(stronger, Lobe(direction, value, eta), lobe)
            density = dr.select(stronger, pdf, density)
        lobe.direction = si.to_world(lobe.direction)
        return lobe, density, (flags & DIFFUSE) != 0

    def _lobe(self, bsdf, si, kind, active):
        direction, weight, eta = mi.Vector3f(0, 0, 1), mi.Color3f(0), mi.Float(1)
        for number, lobe in sorted(self.components):
            if lobe != kind:
                continue
            context = mi.BSDFContext()
            context.type_mask, context.component = kind, number
            sample, value = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), active)
            valid = active & ((sample.sampled_type & kind) != 0) & (dr.max(value) > 0)
            direction = dr.select(valid, sample.wo, direction)
            eta = dr.select(valid, sample.eta, eta)
            weight += dr.select(valid, value, 0)
        return Lobe(si.to_world(direction), weight, eta)


def surfaces_of(scene: mi.Scene) -> list[mi.Shape]:
    """List the shapes of a scene that have a BSDF, including those in groups, once each."""
    shapes = (part for part in parts_of(scene) if isinstance(part, mi.Shape))
    return [shape for shape in shapes if shape.bsdf() is not None]


def is_specular(flags: mi.UInt32) -> mi.Bool:
    """Whether a surface of these BSDF flags has a δ lobe."""
    return (flags & SHARP) != 0


def parts_of(scene: mi.Scene) -> list[mi.Object]:
    """List the Mitsuba objects of a scene, once each: shapes, including instanced ones, BSDFs, textures."""
    pending, parts = [scene], {}
    while pending:
        part = pending.pop()
        if part in parts:
            continue
        parts[part] = None
        pending += nested_in(part)
    return list(parts)


def nested_in(part: mi.Object) -> list[mi.Object]:
    """List the Mitsuba objects nested in a part of a scene, in its order."""
    return [value for _, value, _ in held_by(part) if isinstance(value, mi.Object)]


def held_by(part: mi.Object) -> list[tuple]:
    """List name, value and C++ type of all contents of a part of a scene; the type of nested objects is None."""
    visit = _visit()()
    part.traverse(visit)
    return visit.contents


@cache
def _visit():
    """Class of a traversal of one part, defined once Mitsuba has a variant."""

    class Visit(mi.TraversalCallback):
        def __init__(self):
            super().__init__()
            self.contents = []

        def put(self, name, value, flags, cpptype=None):
            self.contents.append((name, value, cpptype))

    return Visit


def _surfaces(scene):
    """BSDFs of a scene's shapes, once each, and whether such a shape is an emitter."""
    surfaces = {}
    for shape in surfaces_of(scene):
        bsdf = shape.bsdf()
        surfaces[bsdf] = surfaces.get(bsdf, False) or shape.is_emitter()
    return surfaces.items()
