"""How rays sample the diffraction integral (stages s1 and s7): a lattice with the exact kernel, or at random."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from .buffers import gather_row, packed

if TYPE_CHECKING:
    from typing import Any

    from .hologram import Hologram
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
        self.directions = packed(lattice.indices.astype(np.float32))
        offsets = lattice.offsets(hologram.pitch)
        self.indices = dr.opaque(mi.UInt32, offsets.shape[1])
        self.side = dr.opaque(mi.UInt32, int(offsets.max()) + 1)
        self.offsets = mi.Int(offsets.ravel())
        self.table = packed(np.stack(tables, axis=-1).reshape(-1, self.colours).view(np.float32))

    def random(self, first: int, size: int) -> None:
        """Random state of a block of pixels: none is needed."""
        return None

    def direction(self, step: mi.UInt32, random: None) -> tuple:
        """s1: slopes of the direction number `step`."""
        i, j = gather_row(self.directions, step, 2)
        return i * self.spacing, j * self.spacing

    def path(self, slope_x: mi.Float, slope_y: mi.Float, dz: mi.Float) -> tuple:
        """s7: offset of the grain in pixels (right, up), and the kernel as real and imaginary parts.

        The kernel of a surface on the SLM's side of the plane is the conjugate.
        """
        i, j = dr.round(slope_x / self.spacing), dr.round(slope_y / self.spacing)
        level = mi.UInt32(dr.minimum(dr.abs(dz) * self.level_scale, self.last))
        over = dr.gather(mi.Int, self.offsets, level * self.indices + mi.UInt32(dr.abs(i)))
        up = dr.gather(mi.Int, self.offsets, level * self.indices + mi.UInt32(dr.abs(j)))
        entry = (level * self.side + mi.UInt32(up)) * self.side + mi.UInt32(over)
        kernel = gather_row(self.table, entry, 2 * self.colours)
        behind = dz < 0
        for k in range(1, len(kernel), 2):
            kernel[k] = dr.select(behind, -kernel[k], kernel[k])
        return dr.select((i < 0) != behind, -over, over), dr.select((j < 0) != behind, -up, up), kernel


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
        """s1: slopes of a direction uniform in the disk of recordable slopes."""
        u = mi.Point2f(random.next_float32(), random.next_float32())
        slope = self.cone * mi.warp.square_to_uniform_disk_concentric(u)
        return slope.x, slope.y

    def path(self, slope_x: mi.Float, slope_y: mi.Float, dz: mi.Float) -> tuple:
        """s7: as `LatticeEstimator.path`; zero outside a wavelength's own cone."""
        squared = slope_x * slope_x + slope_y * slope_y
        detour = dz * squared / (1 + dr.sqrt(1 + squared))
        kernel = []
        for wavelength, limit in zip(self.wavelengths, self.limits, strict=True):
            sine, cosine = dr.sincos((-2 * math.pi / wavelength) * detour)
            weight = dz * (math.pi * self.cone**2 / (wavelength * self.rays))
            weight = dr.select(squared <= limit**2, weight, 0)
            kernel += [weight * cosine, weight * sine]
        over, up = dr.round(slope_x * dz / self.pitch), dr.round(slope_y * dz / self.pitch)
        return mi.Int(over), mi.Int(up), kernel
