"""Estimators of the diffraction integral (stages s1 and s7): a lattice with the exact kernel, or random directions."""

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
    """Estimator with each lattice direction once, and the kernel of `kernel_table`.

    Parameters
    ----------
    hologram : Hologram
    lattice : Lattice
    tables : list of numpy.ndarray
        Result of `kernel_table` for each wavelength.
    """

    def __init__(self, hologram: Hologram, lattice: Lattice, tables: list[np.ndarray]) -> None:
        self.rays = lattice.rays
        self.colors = len(tables)
        # opaque numbers, not literals: all lattices then share one compiled kernel
        self.spacing = dr.opaque(mi.Float, lattice.spacing)
        self.level_scale = dr.opaque(mi.Float, lattice.levels / lattice.depth_limit)
        self.last = dr.opaque(mi.Float, lattice.levels - 1)
        ends = lattice.ends[np.abs(lattice.indices)]
        self.directions = packed(np.concatenate([lattice.indices, ends[:, ::-1]], axis=1).astype(np.float32))
        self.reach = dr.opaque(mi.UInt32, int(lattice.offsets(hologram.pitch).max()))
        self.step = dr.opaque(mi.Float, lattice.spacing / hologram.pitch)
        self.table = packed(np.stack(tables, axis=-1).reshape(-1, self.colors).view(np.float32))

    def random(self, first: int, size: int) -> None:
        """Return None: no random numbers are needed."""
        return None

    def direction(self, step: mi.UInt32, random: None) -> tuple:
        """s1: direction number `step`; `random` is not used.

        Returns
        -------
        slope_x, slope_y : mitsuba.Float
        direction : list of mitsuba.Float
            Lattice indices i and j, and the largest ones in their row and column.
        """
        direction = gather_row(self.directions, step, 4)
        return direction[0] * self.spacing, direction[1] * self.spacing, direction

    def offset(self, direction: list, dz: mi.Float) -> tuple[mi.Int, mi.Int]:
        """s7: offset in pixels (right, up) of the grain of a point at height `dz` over the plane, meters."""
        return tuple(mi.Int(dr.floor(dr.fma(index, dz * self.step, 0.5))) for index in direction[:2])

    def kernel(
        self, direction: list, offset: tuple[mi.Int, mi.Int], dz: mi.Float, tilt: tuple[mi.Float, mi.Float]
    ) -> list:
        """s7: the kernel of a grain, real and imaginary parts of each wavelength.

        The directions that meet in the grain share it, as if the surface continued as a plane.

        Parameters
        ----------
        direction : list of mitsuba.Float
            Result of `direction`.
        offset : tuple of mitsuba.Int
            Result of `offset`.
        dz : mitsuba.Float
            Height over the recording plane, meters; on the SLM's side the kernel is the conjugate.
        tilt : tuple of mitsuba.Float
            Slopes of the surface, (dz/dx, dz/dy).
        """
        # with mirrored directions a surface behind the plane is like one before it
        side = dr.select(dz < 0, -1, mi.Float(1))
        i, j = (side * index for index in direction[:2])
        over, up = (mi.Float(pixels) for pixels in offset)
        tilt_x, tilt_y = (side * self.spacing * slope for slope in tilt)
        height = dr.abs(dz)
        ahead = height * self.step * (1 - i * tilt_x - j * tilt_y)
        weight = _directions_in_grain(over, 1 - j * tilt_y, ahead, tilt_x, direction[2])
        weight = dr.rcp(weight * _directions_in_grain(up, 1 - i * tilt_x, ahead, tilt_y, direction[3]))
        level = mi.UInt32(dr.minimum(height * self.level_scale, self.last))
        column, row = (dr.minimum(mi.UInt32(dr.abs(pixels)), self.reach) for pixels in (over, up))
        entry = (level * (self.reach + 1) + row) * (self.reach + 1) + column
        kernel = gather_row(self.table, entry, 2 * self.colors)
        weights = weight, side * weight
        return [part * weights[k % 2] for k, part in enumerate(kernel)]


def _directions_in_grain(offset, turned, ahead, tilt, end):
    """Number of directions of a row that meet in a grain `offset` pixels along it, on a plane.

    Direction i of row j meets the plane X = i T / (1 - i t_x - j t_y) pixels along, where T, `ahead`, is the plane's
    distance along the axis times the step of slopes, and t its slopes times that step. So the point X of the plane has
    the index i = X (1 - j t_y) / (T + t_x X), in which `turned` is 1 - j t_y; beyond its pole the row's end counts.
    """

    def index_at(x, beyond):
        below = dr.fma(tilt, x, ahead)
        return dr.select(below * ahead > 0, x * turned / below, beyond)

    first = dr.maximum(dr.ceil(index_at(offset - 0.5, -end)), -end)
    after = dr.minimum(dr.ceil(index_at(offset + 0.5, end + 1)), end + 1)
    return dr.maximum(after - first, 1)


class RandomEstimator:
    """Estimator with random directions in the cone and a spherical wave, as in the paper (section 4.2).

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
        """s1: slopes of a direction, uniform in the disk of recordable slopes, and again as a pair."""
        u = mi.Point2f(random.next_float32(), random.next_float32())
        slope = self.cone * mi.warp.square_to_uniform_disk_concentric(u)
        return slope.x, slope.y, (slope.x, slope.y)

    def offset(self, direction: tuple, dz: mi.Float) -> tuple[mi.Int, mi.Int]:
        """s7: offset of a grain, see `LatticeEstimator.offset`; `direction` has the slopes."""
        return tuple(mi.Int(dr.round(slope * dz / self.pitch)) for slope in direction)

    def kernel(
        self, direction: tuple, offset: tuple[mi.Int, mi.Int], dz: mi.Float, tilt: tuple[mi.Float, mi.Float]
    ) -> list:
        """s7: the kernel, see `LatticeEstimator.kernel`; 0 outside a wavelength's cone, the same for any tilt."""
        squared = direction[0] * direction[0] + direction[1] * direction[1]
        detour = dz * squared / (1 + dr.sqrt(1 + squared))
        kernel = []
        for wavelength, limit in zip(self.wavelengths, self.limits, strict=True):
            sine, cosine = dr.sincos((-2 * math.pi / wavelength) * detour)
            weight = dz * (math.pi * self.cone**2 / (wavelength * self.rays))
            weight = dr.select(squared <= limit**2, weight, 0)
            kernel += [weight * cosine, weight * sine]
        return kernel
