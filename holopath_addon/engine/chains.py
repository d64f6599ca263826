"""Coherent chains: what a ray meets through mirrors and clear glass (stages s4 and s6 of the paper)."""

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from .rays import intersect

SPLITS = 2  # hits at which both the reflected and the transmitted branch can be followed
REFLECTION = int(mi.BSDFFlags.DeltaReflection)
TRANSMISSION = int(mi.BSDFFlags.DeltaTransmission) | int(mi.BSDFFlags.Null)  # Null: a thin pane's
STEP = 1e-3  # of finite differences: radians, and of the chain's length


@dataclass
class View:
    """What a ray sees (Dr.Jit types).

    Attributes
    ----------
    distance : mitsuba.Float
        Along the ray to the image point, metres; negative for an image behind the viewer.
    hit : mitsuba.Bool
        Whether the image point is at a finite distance; the environment is not, but for curved mirrors and lenses.
    ray : mitsuba.Ray3f
        The last piece, on which the real image point lies.
    exists : mitsuba.Bool
        Whether the ray sees anything, in the branch asked for.
    branch : mitsuba.UInt32
        Number of the branch taken.
    weight : mitsuba.Color3f or None
        Share of the radiance that comes through; None for all of it.
    """

    distance: object
    hit: object
    ray: object
    exists: object
    branch: object
    weight: object


class FirstHits:
    """No mirror or clear glass in view: the first surface is the image point."""

    branches = 1

    def view(self, scene, ray, branch):
        """The `View` along a ray."""
        distance, hit = intersect(scene, ray)
        return View(distance, hit, ray, _lit(scene, hit), mi.UInt32(0), None)


class SpecularChains:
    """Rays are followed over mirrors and through clear glass to the first surface that scatters.

    At the first `splits` hits that can both reflect and transmit, one bit of the branch number chooses; later
    ones take the stronger. The image point P' lies on the first piece, at the distance where neighbouring rays
    from the same real point P cross (mean curvature of the wavefront), or at the optical path length, which is
    the paper's choice and exact for flat mirrors only.

    Parameters
    ----------
    virtual_image : {'curvature', 'opl'}
    most_hits : int
        Longest chain; what is beyond is black.
    splits : int
        0 where mirrors only are in view.
    """

    def __init__(self, virtual_image, most_hits, splits=SPLITS):
        self.virtual_image, self.most_hits, self.splits = virtual_image, most_hits, splits
        self.branches = 1 << splits

    def view(self, scene, ray, branch):
        """The `View` of a branch along a ray."""
        last, weight, length, hits, splits, ended = self._follow(scene, ray, branch, self.most_hits)
        distance, hit = intersect(scene, last)
        # a chain that was cut off, or whose light is zero, shows nothing
        exists = ended & ((branch >> splits) == 0) & dr.any(weight > 0)
        taken = branch & ((1 << splits) - 1)
        total = length + dr.select(hit, distance, dr.inf)
        if self.virtual_image == "curvature":
            total = self._image_distance(scene, ray, last, branch, hits, length, distance, hit)
        return View(total, dr.isfinite(total), last, exists & _lit(scene, hit), taken, weight)

    def _follow(self, scene, ray, branch, most):
        """Chain of at most `most` specular hits.

        Returns the last piece, the radiance's share, the optical length before it, hits, splits, and whether the
        chain has ended at a surface that scatters or in the environment.
        """
        state = (
            mi.Ray3f(ray),
            mi.Color3f(1),
            mi.Float(0),
            mi.Float(1),
            mi.UInt32(0),
            mi.UInt32(0),
            mi.Bool(False),
            mi.Bool(True),
        )

        def body(ray, weight, length, index, hits, splits, ended, active):
            si = scene.ray_intersect(ray, active)
            bsdf = si.bsdf()
            reflects, transmits = specular_lobes(bsdf.flags())
            reflects, transmits = si.is_valid() & reflects, si.is_valid() & transmits
            specular = reflects | transmits
            ended |= active & ~specular
            active &= specular & (hits < most)
            mirror, mirror_weight = _lobe(bsdf, si, REFLECTION, active & reflects)
            window, window_weight = _lobe(bsdf, si, TRANSMISSION, active & transmits)
            both = active & (dr.max(mirror_weight) > 0) & (dr.max(window_weight) > 0)
            choosing = both & (splits < self.splits)
            bit = ((branch >> splits) & 1) == 1
            stronger = dr.max(window_weight) > dr.max(mirror_weight)
            through = dr.select(choosing, bit, stronger)
            direction = dr.select(through, window.wo, mirror.wo)
            weight = dr.select(active, weight * dr.select(through, window_weight, mirror_weight), weight)
            length = dr.select(active, length + si.t * index, length)
            index = dr.select(active & through, index * window.eta, index)
            onward = si.spawn_ray(si.to_world(direction))
            ray = dr.select(active, onward, ray)
            hits = dr.select(active, hits + 1, hits)
            splits = dr.select(choosing, splits + 1, splits)
            active &= dr.any(weight > 0)
            return ray, weight, length, index, hits, splits, ended, active

        out = dr.while_loop(state, lambda *s: s[-1], body, label="specular chain")
        ray, weight, length, _, hits, splits, ended, _ = out
        return ray, weight, length, hits, splits, ended

    def _image_distance(self, scene, ray, last, branch, hits, length, distance, hit):
        """Distance along the first piece where rays from the same real point cross.

        With dP = A dO + B dv, the move of P across the last piece under a shift dO of the origin and a turn dv
        of the direction, rays through the same P have dv = -B^-1 A dO; they cross the first at distance
        t = 2 / trace(B^-1 A), the mean of the two focal distances' inverses. Without mirrors A = 1, B = t.
        """
        chained = hits > 0
        reach = dr.select(hit, distance, 1e4)
        point = last(reach)
        over, up = mi.coordinate_system(ray.d)
        across, along = mi.coordinate_system(last.d)
        shift = STEP * dr.maximum(length + dr.select(hit, distance, 0), 1e-3)
        columns, sound = [], mi.Bool(chained)
        for axis in (over, up):
            for origin, direction, step in (
                (ray.o + shift * axis, ray.d, shift),
                (ray.o, dr.normalize(ray.d + STEP * axis), STEP),
            ):
                neighbour = mi.Ray3f(origin, direction)
                piece, _, _, reached, _, _ = self._follow(scene, neighbour, branch, hits)
                sound &= reached == hits
                cosine = dr.dot(piece.d, last.d)
                landing = piece(dr.dot(point - piece.o, last.d) / cosine)
                move = (landing - point) / step
                columns.append((dr.dot(move, across), dr.dot(move, along)))
        (a11, a21), (b11, b21), (a12, a22), (b12, b22) = columns
        determinant = b11 * b22 - b12 * b21
        trace = b22 * a11 - b12 * a21 + b11 * a22 - b21 * a12
        image = dr.select(trace != 0, 2 * determinant / trace, dr.inf)
        return dr.select(chained & sound, image, length + dr.select(hit, distance, dr.inf))


def specular_lobes(flags):
    """Whether surfaces of these BSDF flags only mirror, and only let through; neither where they also scatter."""
    alone = (flags & int(mi.BSDFFlags.Smooth)) == 0
    return alone & ((flags & REFLECTION) != 0), alone & ((flags & TRANSMISSION) != 0)


def _lit(scene, hit):
    """Whether there is anything to see: a surface, or an environment beyond all surfaces."""
    return hit if scene.environment() is None else mi.Bool(True)


def _lobe(bsdf, si, lobe, active):
    """Direction and weight of one specular lobe; weight zero where there is none."""
    context = mi.BSDFContext()
    context.type_mask = lobe
    sample, weight = bsdf.sample(context, si, 0.5, mi.Point2f(0.5), active)
    return sample, dr.select(active, weight, 0)
