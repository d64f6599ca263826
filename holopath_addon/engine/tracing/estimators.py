"""How rays sample the diffraction integral (stages s1 and s7): a lattice with the exact kernel, or at random."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.buffers import gather_row, packed

if TYPE_CHECKING:
    from typing import Any

    from ..hologram import Hologram
    from .kernel_table import Lattice


class LatticeEstimator:
    """Each lattice direction once; the kernel from `kernel_table`.

    Parameters
    ----------
    hologram : Hologram
    lattice : Lattice
    tables : list of numpy.ndarray
        `kernel_table` of each wavelength.
    """

    def __init__(self, hologram: Hologram, lattice: Lattice, tables: list[np.ndarray]) -> None:
        self.rays = lattice.rays
        self.colours = len(tables)
        # not literals: all lattices then share one kernel
        self.spacing = dr.opaque(mi.Float, lattice.spacing)
        self.level_scale = dr.opaque(mi.Float, lattice.levels / lattice.depth_limit)
        self.last = dr.opaque(mi.Float, lattice.levels - 1)
        ends = lattice.ends[np.abs(lattice.indices)]
        self.directions = packed(np.concatenate([lattice.indices, ends[:, ::-1]], axis=1).astype(np.float32))
        self.reach = dr.opaque(mi.UInt32, int(lattice.offsets(hologram.pitch).max()))
        self.step = dr.opaque(mi.Float, lattice.spacing / hologram.pitch)
        self.table = packed(np.stack(tables, axis=-1).reshape(-1, self.colours).view(np.float32))

    def random(self, first: int, size: int) -> None:
        """Random state of a block of pixels: none is needed."""
        return None

    def direction(self, step: mi.UInt32, random: None) -> tuple:
        """s1: slopes of the direction number `step`, and its place: i, j, and the last ones of its row and column."""
        place = gather_row(self.directions, step, 4)
        return place[0] * self.spacing, place[1] * self.spacing, place

    def offset(self, place: list, dz: mi.Float) -> tuple[mi.Int, mi.Int]:
        """s7: offset in pixels (right, up) of the grain that a surface point at a distance lies in."""
        return tuple(mi.Int(dr.floor(dr.fma(index, dz * self.step, 0.5))) for index in place[:2])

    def kernel(
        self, place: list, offset: tuple[mi.Int, mi.Int], dz: mi.Float, tilt: tuple[mi.Float, mi.Float]
    ) -> list:
        """s7: the kernel of a grain, real and imaginary parts of each wavelength.

        That of a surface on the SLM's side of the plane is the conjugate. It is shared by the directions that meet in
        the grain where the surface goes on as the plane with the slopes `tilt`, (dz/dx, dz/dy).
        """
        # with directions mirrored what lies behind is as what lies before
        side = dr.select(dz < 0, -1, mi.Float(1))
        i, j = (side * index for index in place[:2])
        over, up = (mi.Float(pixels) for pixels in offset)
        tilt_x, tilt_y = (side * self.spacing * slope for slope in tilt)
        height = dr.abs(dz)
        ahead = height * self.step * (1 - i * tilt_x - j * tilt_y)
        share = _together(over, 1 - j * tilt_y, ahead, tilt_x, place[2])
        share = dr.rcp(share * _together(up, 1 - i * tilt_x, ahead, tilt_y, place[3]))
        level = mi.UInt32(dr.minimum(height * self.level_scale, self.last))
        column, row = (dr.minimum(mi.UInt32(dr.abs(pixels)), self.reach) for pixels in (over, up))
        entry = (level * (self.reach + 1) + row) * (self.reach + 1) + column
        kernel = gather_row(self.table, entry, 2 * self.colours)
        shares = share, side * share
        return [part * shares[k % 2] for k, part in enumerate(kernel)]


def _together(offset, turned, ahead, tilt, end):
    """How many directions of a row meet in a grain `offset` pixels along it, on a plane.

    Direction i of row j meets the plane X = i T / (1 - i t_x - j t_y) pixels along, where T, `ahead`, is the plane's
    distance along the axis times the step of slopes, and t its slopes times that step. The plane's point X is met by
    i = X (1 - j t_y) / (T + t_x X), in which `turned` is 1 - j t_y; where that has a pole the row's end decides.
    """

    def met(place, beyond):
        below = dr.fma(tilt, place, ahead)
        return dr.select(below * ahead > 0, place * turned / below, beyond)

    first = dr.maximum(dr.ceil(met(offset - 0.5, -end)), -end)
    after = dr.minimum(dr.ceil(met(offset + 0.5, end + 1)), end + 1)
    return dr.maximum(after - first, 1)


class RandomEstimator:
    """Directions at random in the cone and a spherical wave, as the paper has it (section 4.2).

    A ray adds A dz exp(i phi) exp(-i k rho), rho = dz (sqrt(1 + s^2) - 1) referred to the carrier; the factor
    dz is the Jacobian of the Rayleigh-Sommerfeld integral in solid angle, which the paper's listing omits.

    Parameters
    ----------
    hologram : Hologram
    rays : int
        Rays a pixel.
    seed : int
    """

    def __init__(self, hologram: Hologram, rays: int, seed: int) -> None:
        self.rays, self.seed, self.pitch = rays, seed, hologram.pitch
        self.wavelengths = hologram.wavelengths
        self.limits = [hologram.max_slope(w) for w in hologram.wavelengths]
        self.cone = max(self.limits)

    def random(self, first: int, size: int) -> Any:
        """Random state of a block of `size` pixels from pixel number `first`."""
        # pyrefly: ignore[not-callable]  # missing from Mitsuba's stubs
        return mi.PCG32(size, initstate=self.seed + 1, initseq=dr.opaque(mi.UInt64, first))

    def direction(self, step: mi.UInt32, random: Any) -> tuple:
        """s1: slopes of a direction uniform in the disk of recordable slopes, twice."""
        u = mi.Point2f(random.next_float32(), random.next_float32())
        slope = self.cone * mi.warp.square_to_uniform_disk_concentric(u)
        return slope.x, slope.y, (slope.x, slope.y)

    def offset(self, place: tuple, dz: mi.Float) -> tuple[mi.Int, mi.Int]:
        """s7: as `LatticeEstimator.offset`."""
        return tuple(mi.Int(dr.round(slope * dz / self.pitch)) for slope in place)

    def kernel(
        self, place: tuple, offset: tuple[mi.Int, mi.Int], dz: mi.Float, tilt: tuple[mi.Float, mi.Float]
    ) -> list:
        """s7: as `LatticeEstimator.kernel`; zero outside a wavelength's own cone, and the same on any slope."""
        squared = place[0] * place[0] + place[1] * place[1]
        detour = dz * squared / (1 + dr.sqrt(1 + squared))
        kernel = []
        for wavelength, limit in zip(self.wavelengths, self.limits, strict=True):
            sine, cosine = dr.sincos((-2 * math.pi / wavelength) * detour)
            weight = dz * (math.pi * self.cone**2 / (wavelength * self.rays))
            weight = dr.select(squared <= limit**2, weight, 0)
            kernel += [weight * cosine, weight * sine]
        return kernel
