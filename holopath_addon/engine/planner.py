"""Looks at the scene and decides how much has to be modelled, and says why."""

import math
import time
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from . import backend
from .errors import InvalidInput
from .hologram import Settings
from .kernel_table import LEVELS, Lattice
from .mapping import DepthMapping

CONE = {
    "preview": 1.0,
    "balanced": 1.15,
    "full": 1.3,
}  # of the recordable slope: how much of the kernel's tails
GRAIN_NOISE = {"preview": 0.5, "balanced": 0.3, "full": 0.15}  # of a grain's mean, as a share of the speckle
PASSES = {
    "preview": (8, 64),
    "balanced": (16, 256),
    "full": (32, 1024),
}  # fewest and most radiance paths a pixel
PAPER_RAYS = {"preview": 256, "balanced": 1024, "full": 4096}
SLAB = 0.15e-3  # metres; a small part of the depth of focus, 2 wavelength / slope^2 = 1 mm at 8 µm
MOST_SLABS = 48
GLOSSY_BINS = 2
PILOT_GRAINS, PILOT_PATHS = 4096, 32
MOST_REACH = 256  # pixels: beyond, the kernel table would outgrow memory
CHUNK_BYTES = 256 << 20  # Mitsuba and the kernels' working memory
MAP_BYTES = 1 << 30  # largest index of the radiance map
CELL_BYTES = 48  # of an occupied cell: three sums and a count of 8 bytes, and the amplitudes made of them
SURFACES = 2  # occupied slabs of a pixel column, roughly


@dataclass(frozen=True)
class Decision:
    """One choice of the plan: what, which value, and why, in plain words."""

    name: str
    value: str
    reason: str


@dataclass(frozen=True)
class Plan:
    """What will be computed. Distances in metres.

    Attributes
    ----------
    near : float
        World depth at the near end of the volume (`fit`), or of the nearest surface (`eyepiece`).
    wrp : float
        z of the recording plane.
    z_low, z_high : float
        Hologram-space depths between which surfaces were seen.
    depth_limit : float
        Largest distance of a surface from the recording plane.
    rays_per_pixel, passes, margin, slabs, bins : int
        Rays of the wave, radiance paths, and the radiance map's pixels beyond each edge, depth slabs and
        pupil bins.
    cone : float
        Half-angle of the lattice in recordable slopes.
    seconds : float
        Estimated time on this machine.
    memory_bytes : int
        Estimated peak of the arrays.
    decisions : tuple of Decision
    warnings : tuple of str
    """

    near: float
    wrp: float
    z_low: float
    z_high: float
    depth_limit: float
    rays_per_pixel: int
    passes: int
    margin: int
    slabs: int
    bins: int
    cone: float
    seconds: float
    memory_bytes: int
    decisions: tuple = field(repr=False)
    warnings: tuple = ()

    def to_dict(self):
        """JSON-able form."""
        return asdict(self)

    def __str__(self):
        lines = [f"{d.name}: {d.value} ({d.reason})" for d in self.decisions]
        lines.append(f"time: about {self.seconds:.0f} s, memory: about {self.memory_bytes / 1e6:.0f} MB")
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings])


@dataclass(frozen=True)
class Probe:
    """What a few rays saw.

    Attributes
    ----------
    depth : numpy.ndarray
        World depths, metres; inf where nothing was hit.
    sky : bool
        Whether rays that hit nothing meet an environment.
    glossy, specular : float
        Shares of rays that meet glossy, and mirror-like or clear, surfaces.
    rays_per_second, paths_per_second : float
        Speed of this machine on this scene; 0 paths when the radiance was not asked for.
    noise : float
        Variance of one radiance path relative to its grain's squared mean, weighted by brightness.
    """

    depth: np.ndarray
    sky: bool
    glossy: float
    specular: float
    rays_per_second: float
    noise: float
    paths_per_second: float


def probe(scene, hologram, camera, mapping, plane, seed=0, max_depth=0):
    """Trace up to about a million rays over the hologram and the pupil, first hits only.

    Parameters
    ----------
    scene : mitsuba.Scene
    hologram : Hologram
    camera : Camera
    mapping : DepthMapping
        With beta = 0 the rays start at the pupil's centre.
    plane : float
        z of the plane that the rays start from, metres.
    seed : int
    max_depth : int
        Of radiance paths; 0 does not look at the radiance.

    Returns
    -------
    Probe
    """
    import drjit as dr
    import mitsuba as mi

    from .rays import Rays

    rays = Rays(hologram, camera, mapping, plane)
    stride = max(1, math.ceil(math.sqrt(hologram.width * hologram.height / (1 << 16))))
    columns, rows, directions = -(-hologram.width // stride), -(-hologram.height // stride), 16
    size = columns * rows * directions
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, size)
    index = dr.arange(mi.UInt32, size)
    pixel, number = index // directions, index % directions
    jitter = sampler.next_2d()
    column = dr.minimum((pixel % columns + jitter.x) * stride, hologram.width) - 0.5
    row = dr.minimum((pixel // columns + jitter.y) * stride, hologram.height) - 0.5
    turn = sampler.next_2d()
    u = mi.Point2f(number * 0.7548776662466927 + turn.x, number * 0.5698402909980532 + turn.y)
    limit = max(hologram.max_slope(w) for w in hologram.wavelengths)
    slope = limit * mi.warp.square_to_uniform_disk_concentric(u - dr.floor(u))
    ray, depth_rate = rays.world(*rays.place(column, row), slope.x, slope.y)
    si = scene.ray_intersect(ray, ray_flags=mi.RayFlags.Minimal, coherent=True)
    hit = si.is_valid()
    depth = dr.select(hit, camera.clip_start + si.t * depth_rate, dr.inf)
    flags = si.bsdf().flags()
    glossy = hit & mi.has_flag(flags, mi.BSDFFlags.Glossy)
    specular = hit & mi.has_flag(flags, mi.BSDFFlags.Delta)
    shares = [float(dr.mean(dr.select(mask, mi.Float(1), 0))[0]) for mask in (glossy, specular)]
    noise, paths_per_second = _radiance_noise(scene, ray, max_depth, seed) if max_depth else (0.0, 0.0)
    speed = size / _timed(lambda: dr.eval(scene.ray_intersect_preliminary(ray, coherent=True).t))
    return Probe(np.asarray(depth), scene.environment() is not None, *shares, speed, noise, paths_per_second)


def _timed(work):
    """Seconds of the second of two calls, which compiles nothing."""
    import drjit as dr

    for _ in range(2):
        dr.sync_thread()
        start = time.perf_counter()
        work()
        dr.sync_thread()
    return time.perf_counter() - start


def _radiance_noise(scene, ray, max_depth, seed):
    """Relative variance of a radiance path, and paths a second, from a few paths along some of the rays."""
    import drjit as dr
    import mitsuba as mi

    from .grains import radiance_integrator

    integrator = radiance_integrator(max_depth)
    rays = dr.width(ray)
    grains = min(rays, PILOT_GRAINS)
    index = dr.arange(mi.UInt32, grains * PILOT_PATHS) // PILOT_PATHS
    chosen = dr.gather(mi.Ray3f, ray, mi.UInt32(mi.Float(index) * (rays / grains)))
    dr.eval(chosen)
    light = None

    def trace():
        nonlocal light
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, grains * PILOT_PATHS)
        colour, _, _ = integrator.sample(scene, sampler, mi.RayDifferential3f(chosen), None, True)
        light = colour.x + colour.y + colour.z
        dr.eval(light)

    seconds = _timed(trace)
    light = np.nan_to_num(np.asarray(light, np.float64)).reshape(grains, PILOT_PATHS)
    mean, variance = light.mean(1), light.var(1, ddof=1)
    lit = mean > 0
    if not lit.any():
        return 0.0, grains * PILOT_PATHS / seconds
    # weighted by brightness, in which lamps in view must not hide the rest
    weight = np.minimum(mean[lit], np.percentile(mean[lit], 75))
    noise = (weight * variance[lit] / mean[lit] ** 2).sum() / weight.sum()
    return float(noise), grains * PILOT_PATHS / seconds


def plan(scene, camera, hologram, settings=None):
    """Decide what to compute for a scene on a display; computes nothing but a few probe rays.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional

    Returns
    -------
    Plan

    Raises
    ------
    InvalidInput
        If nothing is in view.
    BackendUnavailable
        If Mitsuba cannot compute here.
    """
    backend.activate()
    settings = settings or Settings()
    decisions, warnings = [], []
    near = near_end(scene, camera, hologram, settings.seed)
    mapping = DepthMapping.of(hologram, camera, near)
    seen = probe(scene, hologram, camera, mapping, mapping.z_far, settings.seed, settings.max_depth)
    hit = np.isfinite(seen.depth)
    z_high = float(mapping.depth_to_z(seen.depth[hit].min())) if hit.any() else mapping.z_far
    z_low = mapping.z_far if seen.sky and not hit.all() else float(mapping.depth_to_z(seen.depth[hit].max()))
    decisions.append(
        Decision(
            "depth",
            f"{near:.3g} m to {'infinity' if z_low == mapping.z_far else f'{mapping.z_to_depth(z_low):.3g} m'} "
            f"at {z_high * 1e3:.2f} to {z_low * 1e3:.2f} mm from the SLM",
            "the volume ends at the nearest surface in view"
            if hologram.depth_mapping == "fit" and not hologram.near
            else f"{hologram.depth_mapping} mapping",
        )
    )

    if settings.wrp == "auto":
        wrp = 0.5 * (z_low + z_high)
        reason = "the middle of the depths in view needs the fewest rays"
    else:
        wrp, reason = float(settings.wrp), "as asked"
    decisions.append(Decision("recording plane", f"{wrp * 1e3:.3f} mm from the SLM", reason))
    # rays between the probe's may meet surfaces a little beyond what it saw
    depth_limit = 1.02 * max(z_high - wrp, wrp - z_low) + 0.1 * hologram.pitch / _slope(hologram)

    rays, reach = _rays(hologram, settings, depth_limit, decisions, warnings)
    margin = reach + 1
    passes, slabs, bins = _radiance(hologram, settings, seen, margin, z_high - z_low, decisions)

    if seen.specular > 1e-3:
        warnings.append(
            f"{seen.specular:.0%} of the view is mirror or clear glass: it is shown as a picture on its own "
            f"surface, not at the depth of what it reflects."
        )
    captured = captured_share(hologram, 0.5 * (z_low + z_high))
    if captured < 0.75:
        warnings.append(
            f"Only {captured:.0%} of the light fits through the SLM's aperture at {z_high * 1e3:.0f} mm: edges darken; "
            f"bring the depth range nearer to the SLM or use more pixels."
        )

    decisions.append(
        Decision(
            "settings.frames",
            str(settings.frames),
            f"speckle contrast about {1 / math.sqrt(settings.frames):.0%}",
        )
    )
    seconds, memory = _costs(hologram, settings, seen, rays, passes, margin, slabs, bins)
    return Plan(
        near,
        wrp,
        z_low,
        z_high,
        depth_limit,
        rays,
        passes,
        margin,
        slabs,
        bins,
        CONE[settings.quality],
        seconds,
        memory,
        tuple(decisions),
        tuple(warnings),
    )


def _rays(hologram, settings, depth_limit, decisions, warnings):
    """Rays a pixel, and the farthest grain in pixels that they reach."""
    slope, cone = _slope(hologram), CONE[settings.quality]
    if settings.estimator == "paper":
        rays = settings.spp or PAPER_RAYS[settings.quality]
        decisions.append(Decision("rays a pixel", str(rays), "random directions, the paper's estimator"))
        return rays, math.ceil(slope * depth_limit / hologram.pitch) + 1
    if cone * slope * depth_limit / hologram.pitch > MOST_REACH:
        raise InvalidInput(
            f"The recording plane is {depth_limit * 1e3:.1f} mm from a surface, which would need over "
            f"{math.pi * MOST_REACH**2:.0f} rays a pixel: put it nearer to the scene (auto does), reduce the depth "
            f"range, or use the paper's estimator."
        )
    whole = Lattice.of(slope, depth_limit, hologram.pitch, cone)
    lattice = Lattice.of(slope, depth_limit, hologram.pitch, cone, settings.spp)
    reason = (
        f"one a grain at {depth_limit * 1e3:.2f} mm from the recording plane, cone {cone:g} of the recordable"
    )
    decisions.append(Decision("rays a pixel", str(lattice.rays), reason))
    if lattice.rays < whole.rays:
        warnings.append(
            f"{lattice.rays} rays a pixel are fewer than the {whole.rays} that this depth range needs: the farthest "
            f"depths lose contrast; raise the rays a pixel or reduce the depth range."
        )
    return lattice.rays, int(lattice.offsets(hologram.pitch).max())


def _radiance(hologram, settings, seen, margin, thickness, decisions):
    """Radiance paths a pixel, depth slabs and pupil bins."""
    if settings.radiance == "ray":
        decisions.append(Decision("radiance", "one path a ray", "as asked; dark where light is indirect"))
        return 0, 1, 1
    fewest, most = PASSES[settings.quality]
    wanted = GRAIN_NOISE[settings.quality] / math.sqrt(settings.frames)
    passes = min(max(fewest, math.ceil(seen.noise / wanted**2)), most)
    left = math.sqrt(seen.noise / passes)
    glossy = seen.glossy + seen.specular > 1e-3
    bins = GLOSSY_BINS if glossy else 1
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    slabs = max(1, min(MOST_SLABS, MAP_BYTES // (4 * columns), math.ceil(thickness / SLAB)))
    decisions.append(
        Decision(
            "radiance paths a pixel",
            str(passes),
            f"leaves {left:.1%} noise in a grain's mean where {1 / math.sqrt(settings.frames):.0%} is speckle",
        )
    )
    decisions.append(
        Decision(
            "radiance map",
            f"{slabs} depth slabs, {bins} x {bins} pupil bins",
            "glossy surfaces look different across the pupil"
            if glossy
            else "all surfaces in view are diffuse",
        )
    )
    return passes, slabs, bins


def _costs(hologram, settings, seen, rays, passes, margin, slabs, bins):
    """Estimated seconds and bytes, from the probe's speed and the sizes of the arrays."""
    pixels, frames, colours = hologram.width * hologram.height, settings.frames, len(hologram.wavelengths)
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    seconds = 2.0 + pixels * rays * (1.3 / seen.rays_per_second + (2 + 0.3 * frames * colours) * 1e-9)
    paths = columns * passes if settings.radiance == "grain" else pixels * rays
    seconds += 0.6 * paths / seen.paths_per_second + pixels * frames * colours * 0.1e-6
    fields = pixels * frames * (colours + 1) * 8
    tables = LEVELS * margin**2 * 8 * colours
    radiance = columns * (4 * slabs + SURFACES * bins**2 * CELL_BYTES)
    return seconds, fields + tables + radiance + CHUNK_BYTES


def _slope(hologram):
    return max(hologram.max_slope(w) for w in hologram.wavelengths)


def near_end(scene, camera, hologram, seed=0):
    """World depth of the volume's near end: as given, or the nearest surface that the pupil sees."""
    pinhole = DepthMapping.of(replace(hologram, depth_mapping="fit"), camera, 1e-9)
    nearest = probe(scene, hologram, camera, pinhole, pinhole.z_far, seed).depth.min()
    if not math.isfinite(nearest):
        if scene.environment() is None:
            raise InvalidInput(
                "Nothing is in the camera's view: point the camera at an object or light the world."
            )
        return hologram.near or 1.0
    if hologram.near:
        return hologram.near
    if hologram.depth_mapping == "eyepiece":
        return float(nearest)
    mapping = DepthMapping.of(hologram, camera, nearest)
    return float(min(nearest, probe(scene, hologram, camera, mapping, mapping.z_far, seed).depth.min()))


def captured_share(hologram, distance):
    """Share of the recordable cones' light, from a picture at `distance`, that passes the SLM's aperture.

    Geometric: the overlap of the picture and its copies shifted by slope times distance, averaged over
    the cone of the widest wavelength.
    """
    n = 33
    axis = np.linspace(-1, 1, n)
    slope_y, slope_x = np.meshgrid(axis, axis, indexing="ij")
    disk = slope_x**2 + slope_y**2 <= 1
    walk = _slope(hologram) * abs(distance) / hologram.pitch
    kept = np.clip(1 - np.abs(slope_x) * walk / hologram.width, 0, 1) * np.clip(
        1 - np.abs(slope_y) * walk / hologram.height, 0, 1
    )
    return float(kept[disk].mean())
