"""Looks at the scene and decides how much has to be modelled, and says why."""

import math
from dataclasses import asdict, dataclass, field
from itertools import pairwise

import numpy as np

from . import backend, despeckle
from .errors import InvalidInput
from .hologram import Settings
from .kernel_table import LEVELS, Lattice
from .mapping import DepthMapping
from .phase_fields import REACH, SETS, speckle_contrast
from .probing import LEAST_SHARE, Pilot, near_end, vergence_range

CONE = {
    "preview": 1.0,
    "balanced": 1.15,
    "full": 1.3,
}  # of the recordable slope: how much of the kernel's tails
GRAIN_NOISE = {
    "preview": 0.5,
    "balanced": 0.3,
    "full": 0.15,
}  # of a grain's mean, as a share of random speckle
PASSES = {
    "preview": (8, 64),
    "balanced": (16, 256),
    "full": (32, 1024),
}  # fewest and most radiance paths a pixel
PAPER_RAYS = {"preview": 256, "balanced": 1024, "full": 4096}
FIREFLY = 1.0  # times the bright parts of the view: most that one indirect path may add to a grain's mean
SLAB = 0.15e-3  # metres; a small part of the depth of focus, 2 wavelength / slope^2 = 1 mm at 8 µm
MOST_SLABS = 48
GLOSSY_BINS = (2, 6)  # fewest and most along each axis of the pupil
GLOSSY_TURN = 0.15  # of a lobe's width across the pupil: less is not seen
IMAGE_LIMITS = (-0.5, 1.5)  # of the near end's vergence: images beyond, as of caustics, are put there
DEPTH_BINS = 128  # that recording planes are fitted to
MOST_REACH = 256  # pixels: beyond, the kernel table would outgrow memory
CHUNK_BYTES = 256 << 20  # Mitsuba and the kernels' working memory
MAP_BYTES = 1 << 30  # largest index of the radiance map, and its largest pupil bins
CELL_BYTES = 48  # of an occupied cell: three sums and a count of 8 bytes, and the amplitudes made of them
SURFACES = 2  # occupied slabs of a pixel column, roughly
CACHED_PASSES = 4  # fewest where light is looked up
BAKED_TEXELS = 2.2  # groups of texels a pixel of the view, roughly
BAKED_SAMPLES = 32  # of each, roughly
BAKED_SPEED = 2.0  # times that of paths, which follow every bounce
BAKE_START = 5.0  # seconds, for kernels and for the light between surfaces
ATLAS_TEXELS = 40  # a pixel of the view, roughly; not all are baked
MOST_TEXELS = 1 << 25
TEXEL_BYTES = 48  # with what making them takes
CLEARLY = 0.8  # times as long as paths of this view: estimates are rough
LEAST_DIFFUSE = 0.1  # of the view: the cache is for more


@dataclass(frozen=True)
class Decision:
    """One choice of the plan: what, which value, and why, in plain words."""

    name: str
    value: str
    reason: str


@dataclass(frozen=True)
class RecordingPlane:
    """A plane that rays start from, and the slab of the volume that it records. Distances from the SLM in metres.

    Attributes
    ----------
    z : float
        Of the plane.
    far, near : float
        Ends of the slab, within which its rays see surfaces; infinite for the outermost.
    low : float
        Depth of its farthest surface.
    depth_limit : float
        Largest distance of a surface from the plane.
    rays : int
        A pixel.
    """

    z: float
    far: float
    near: float
    low: float
    depth_limit: float
    rays: int


@dataclass(frozen=True)
class Plan:
    """What will be computed. Distances in metres.

    Attributes
    ----------
    near : float
        World depth at the near end of the volume (`fit`), or of the nearest surface (`eyepiece`).
    z_low, z_high : float
        Hologram-space depths between which surfaces were seen.
    planes : tuple of RecordingPlane
        From the far end to the near one.
    rays_per_pixel, passes, margin, slabs, bins : int
        Rays of the wave on all planes, radiance paths, and the radiance map's pixels beyond each edge, depth slabs
        and pupil bins.
    cached : bool
        Whether diffuse light comes from the radiance cache.
    texel_noise, texel_samples : float, int
        Relative standard error that its texels in view are baked to, and most samples of each.
    radiance_limit : float
        Most that indirect light may add to one path.
    chain : int
        Longest chain of specular hits; 0 leaves the code for them out.
    splits : int
        Hits of a chain at which more than one way on is followed.
    virtual_image : str
        'curvature', or 'opl' where it is asked for or exact.
    coherent : bool
        Whether neighbouring rays are traced in packets.
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
    z_low: float
    z_high: float
    planes: tuple
    rays_per_pixel: int
    passes: int
    margin: int
    slabs: int
    bins: int
    cached: bool
    texel_noise: float
    texel_samples: int
    radiance_limit: float
    chain: int
    splits: int
    virtual_image: str
    coherent: bool
    cone: float
    seconds: float
    memory_bytes: int
    decisions: tuple = field(repr=False)
    warnings: tuple = ()

    def to_dict(self):
        """JSON-able form; null for what is unlimited."""
        return _finite(asdict(self))

    def __str__(self):
        lines = [f"{d.name}: {d.value} ({d.reason})" for d in self.decisions]
        lines.append(f"time: about {self.seconds:.0f} s, memory: about {self.memory_bytes / 1e6:.0f} MB")
        return "\n".join(lines + [f"warning: {w}" for w in self.warnings])


def _finite(value):
    """Infinite numbers, which JSON does not have, as None."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and math.isinf(value) else value


def plan(scene, camera, hologram, settings=None, store=None):
    """Decide what to compute for a scene on a display; computes nothing but a few probe rays.

    Parameters
    ----------
    scene : mitsuba.Scene
    camera : Camera
    hologram : Hologram
    settings : Settings, optional
    store : BakeStore, optional
        Where baked light may be found.

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
    from .chains import FirstHits, SpecularChains
    from .radiance import PathTracer

    settings = (settings or Settings()).resolved()
    decisions, warnings = [], []
    near = near_end(scene, camera, hologram, settings.seed)
    mapping = DepthMapping.of(hologram, camera, near)
    pilot = Pilot(scene, hologram, camera, mapping, settings.seed)
    seen, optics = pilot.first_hits(), FirstHits(sky=camera.sees_sky)
    image = settings.virtual_image
    chain = settings.most_hits if seen.specular > LEAST_SHARE else 0
    if chain:
        optics = SpecularChains(scene, image, chain, sky=camera.sees_sky)
        seen = pilot.images(seen, optics)
        image = image if seen.bent else "opl"
    light = pilot.light(PathTracer(settings.max_depth), optics)
    low, high = vergence_range(seen, chain)
    if chain:
        low, high = max(low, IMAGE_LIMITS[0] / near), min(high, IMAGE_LIMITS[1] / near)
    z_low, z_high = mapping.z_far + mapping.beta * low, mapping.z_far + mapping.beta * high
    decisions.append(
        Decision(
            "depth",
            f"{near:.3g} m to {'infinity' if z_low <= mapping.z_far else f'{mapping.z_to_depth(z_low):.3g} m'} "
            f"at {z_high * 1e3:.2f} to {z_low * 1e3:.2f} mm from the SLM",
            "the volume ends at the nearest surface in view"
            if hologram.depth_mapping == "fit" and not hologram.near
            else f"{hologram.depth_mapping} mapping",
        )
    )
    depths = np.clip(mapping.z_far + mapping.beta * np.array([low, *seen.vergence, high]), z_low, z_high)
    gloss = mapping.z_far + mapping.beta * seen.gloss if seen.turn > GLOSSY_TURN else np.empty(0)
    planes = _planes(hologram, settings, z_low, z_high, depths, gloss, chain, decisions, warnings)
    rays = sum(plane.rays for plane in planes)
    middle = 0.5 * (planes[0].z + planes[-1].z)
    reach = 1.02 * CONE[settings.quality] * _slope(hologram) * max(z_high - middle, middle - z_low)
    margin = math.ceil(reach / hologram.pitch) + 3
    cached = _cached(scene, hologram, settings, seen, light, margin, store, decisions)
    passes, slabs, bins = _radiance(
        hologram, settings, seen, light, margin, z_high - z_low, cached, decisions
    )

    if chain:
        reason = f"{seen.specular:.1%} of the view mirrors or lets through; images by "
        reason += "curvature" if image == "curvature" else "optical path"
        if image != settings.virtual_image:
            reason += ", which is exact here"
        reason += f"; {1 << seen.splits} branches of each ray" if seen.splits else ""
        decisions.append(Decision("specular hits", f"up to {chain}", reason))
    elif seen.specular > LEAST_SHARE:
        warnings.append(
            f"{seen.specular:.0%} of the view is mirror or clear glass: it is shown as a picture on its own "
            f"surface, not at the depth of what it reflects; allow chains of mirrors to change that."
        )
    captured = captured_share(hologram, 0.5 * (z_low + z_high))
    if captured < 0.75:
        warnings.append(
            f"Only {captured:.0%} of the light fits through the SLM's aperture at {z_high * 1e3:.0f} mm: edges darken; "
            f"bring the depth range nearer to the SLM or use more pixels."
        )

    speckle = speckle_contrast(settings.phase_field, settings.frames)
    reason = f"{settings.phase_field} phase fields leave a speckle contrast of about {speckle:.0%}"
    reach = REACH * hologram.pitch**2 / max(hologram.wavelengths)
    if settings.phase_field == "designed" and reach < z_high - z_low:
        reason += f" up to {reach * 1e3:.2g} mm from focus, {speckle_contrast('random', settings.frames):.0%} beyond"
    decisions.append(Decision("frames", str(settings.frames), reason))
    if settings.despeckle:
        decisions.append(
            Decision(
                "despeckling",
                f"{settings.despeckle} steps",
                f"towards the mean of {despeckle.BATCHES * SETS[-1]} frames of the same paths, which are traced too",
            )
        )
    seconds, memory = _costs(
        hologram, settings, seen, light, rays << seen.splits, passes, margin, slabs, bins, cached
    )
    return Plan(
        near,
        z_low,
        z_high,
        planes,
        rays,
        passes,
        margin,
        slabs,
        bins,
        cached is not None,
        texel_noise(settings),
        PASSES[settings.quality][1],
        FIREFLY * light.bright * (passes or PASSES[settings.quality][1]),
        chain,
        seen.splits,
        image,
        seen.coherent,
        CONE[settings.quality],
        seconds,
        memory,
        tuple(decisions),
        tuple(warnings),
    )


def _planes(hologram, settings, z_low, z_high, depths, gloss, chain, decisions, warnings):
    """The recording planes, each in the middle of its slab of the depths in view."""
    count = settings.planes
    if settings.method == "direct":
        z, reason = 0.0, "the SLM itself: method direct"
    elif settings.wrp != "auto":
        z, reason = float(settings.wrp), "as asked"
    elif count > 1 and not chain and not len(gloss):
        slabs = depth_slabs(depths, count)
        ends = [-math.inf, *(0.5 * (a[1] + b[0]) for a, b in pairwise(slabs)), math.inf]
        planes = tuple(
            RecordingPlane(
                0.5 * (low + high),
                far,
                near,
                low,
                *_rays(hologram, settings, 0.5 * (high - low), warnings, len(slabs)),
            )
            for (low, high), far, near in zip(slabs, ends[:-1], ends[1:], strict=True)
        )
        places = ", ".join(f"{plane.z * 1e3:.2f}" for plane in planes)
        decisions.append(
            Decision("recording planes", f"{places} mm from the SLM", "fitted to the depths in view")
        )
        decisions.append(_ray_decision(settings, sum(plane.rays for plane in planes), planes))
        return planes
    else:
        z, reason = 0.5 * (z_low + z_high), "the middle of the depths in view needs the fewest rays"
        if len(gloss):
            z = _beside_gloss(z_low, z_high, gloss, depth_of_focus(hologram))
            reason = "a depth of focus beside gloss, which looks different across the pupil"
        if count > 1:
            reason += "; one only, since "
            reason += (
                "silhouettes do not hold for images in mirrors" if chain else "gloss needs it beside itself"
            )
    decisions.append(Decision("recording plane", f"{z * 1e3:.3f} mm from the SLM", reason))
    limit, rays = _rays(hologram, settings, max(z_high - z, z - z_low), warnings)
    planes = (RecordingPlane(z, -math.inf, math.inf, z_low, limit, rays),)
    decisions.append(_ray_decision(settings, rays, planes))
    return planes


def depth_of_focus(hologram):
    """Depth of focus 2 wavelength / slope^2 in metres, of the wavelength that has the longest."""
    return max(2 * w / hologram.max_slope(w) ** 2 for w in hologram.wavelengths)


def _beside_gloss(z_low, z_high, gloss, distance):
    """The plane nearest to the middle that has hardly any glossy surface within a distance.

    Nearer than about a depth of focus all directions of a grain fall into one pixel, which cannot hold that
    they differ.
    """
    middle = 0.5 * (z_low + z_high)
    candidates = np.linspace(z_low - 1.05 * distance, z_high + 1.05 * distance, DEPTH_BINS)
    candidates = candidates[np.argsort(abs(candidates - middle), kind="stable")]
    near = [(abs(gloss - z) < distance).mean() for z in candidates]
    return float(candidates[np.argmax(np.array(near) < 0.01)])


def _ray_decision(settings, rays, planes):
    if settings.estimator == "paper":
        return Decision("rays a pixel", str(rays), "random directions, the paper's estimator")
    limit = max(plane.depth_limit for plane in planes)
    cone = CONE[settings.quality]
    reason = f"one a grain at {limit * 1e3:.2f} mm from the recording plane, cone {cone:g} of the recordable"
    return Decision("rays a pixel", str(rays), reason)


def depth_slabs(depths, count):
    """Split depths into at most `count` slabs that need the fewest rays, whose number goes as the thickness squared.

    Parameters
    ----------
    depths : numpy.ndarray
    count : int

    Returns
    -------
    list of (float, float)
        Lowest and highest depth in each slab, from low to high.
    """
    low, high = float(depths.min()), float(depths.max())
    bins = np.minimum(((depths - low) / max(high - low, 1e-12) * DEPTH_BINS).astype(int), DEPTH_BINS - 1)
    used = np.unique(bins)
    first = np.array([depths[bins == b].min() for b in used])
    last = np.array([depths[bins == b].max() for b in used])
    cost = (last[None, :] - first[:, None]) ** 2  # of one slab from bin i to bin j
    best, cuts = cost[0], []
    for _ in range(min(count, len(used)) - 1):
        options = best[:-1, None] + cost[1:]
        options[np.tril_indices_from(options)] = np.inf
        cuts.append(options.argmin(0))
        best = options.min(0)
    slabs, end = [], len(used) - 1
    for cut in cuts[::-1]:
        begin = cut[end] + 1
        slabs.append((float(first[begin]), float(last[end])))
        end = cut[end]
    return [(float(first[0]), float(last[end])), *slabs[::-1]]


def _rays(hologram, settings, thickness, warnings, planes=1):
    """Depth limit of a plane, one of several, with surfaces up to `thickness` away, and its rays a pixel."""
    slope, cone = _slope(hologram), CONE[settings.quality]
    # rays between the probe's may meet surfaces a little beyond what it saw
    limit = 1.02 * thickness + 0.1 * hologram.pitch / slope
    if settings.estimator == "paper":
        return limit, settings.spp or PAPER_RAYS[settings.quality]
    if cone * slope * limit / hologram.pitch > MOST_REACH:
        raise InvalidInput(
            f"The recording plane is {limit * 1e3:.1f} mm from a surface, which would need over "
            f"{math.pi * MOST_REACH**2:.0f} rays a pixel: put it nearer to the scene (auto does), reduce the depth "
            f"range, or use the paper's estimator."
        )
    whole = Lattice.of(slope, limit, hologram.pitch, cone)
    most = settings.spp and max(1, settings.spp // planes)
    lattice = Lattice.of(slope, limit, hologram.pitch, cone, most)
    if lattice.rays < whole.rays:
        warnings.append(
            f"{lattice.rays} rays a pixel are fewer than the {whole.rays} that this depth range needs: the farthest "
            f"depths lose contrast; raise the rays a pixel or reduce the depth range."
        )
    return limit, lattice.rays


def wanted_noise(settings):
    """Relative standard error of a grain's mean radiance that hardly shows in the frames' speckle."""
    return GRAIN_NOISE[settings.quality] * speckle_contrast("random", settings.frames)


def texel_noise(settings):
    """The same of a texel that is baked; baked light serves any number of frames, so that of many counts."""
    return GRAIN_NOISE[settings.quality] * speckle_contrast("random", SETS[-1])


def passes_for(settings, noise, fewest=None):
    """Radiance paths a pixel where one has a relative variance of `noise`."""
    least, most = PASSES[settings.quality]
    return min(max(fewest or least, math.ceil(noise / wanted_noise(settings) ** 2)), most)


def _cached(scene, hologram, settings, seen, light, margin, store, decisions):
    """Seconds that the radiance cache will take, None where it is not used."""
    if settings.method == "direct" or settings.max_depth < 2:
        return None
    if settings.method == "full":
        decisions.append(Decision("diffuse light", "paths of this view", "as asked"))
        return None
    from .baking import is_baked

    pixels = hologram.width * hologram.height
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    paths = 0.6 * columns * passes_for(settings, light.noise) / light.paths_per_second
    if settings.radiance == "ray":
        paths = math.inf
    most = PASSES[settings.quality][1]
    baked = store is not None and is_baked(scene, settings, texel_noise(settings), most, store)
    seconds = 0.6 * columns * CACHED_PASSES / light.paths_per_second
    if not baked:
        seconds += BAKE_START + pixels * BAKED_TEXELS * BAKED_SAMPLES / (BAKED_SPEED * light.paths_per_second)
    compared = f"about {seconds:.1f} s, paths of this view about {paths:.1f} s"
    compared = f"light baked before, {compared}" if baked else f"to be baked, {compared}"
    if settings.method == "fast":
        decisions.append(Decision("diffuse light", "radiance cache", f"as asked; {compared}"))
        return seconds
    if seen.diffuse < LEAST_DIFFUSE or settings.radiance == "ray":
        reason = (
            "as asked" if settings.radiance == "ray" else f"only {seen.diffuse:.0%} of the view is diffuse"
        )
        decisions.append(Decision("diffuse light", "paths of this view", reason))
        return None
    better = seconds < CLEARLY * paths
    decisions.append(
        Decision("diffuse light", "radiance cache" if better else "paths of this view", compared)
    )
    return seconds if better else None


def _radiance(hologram, settings, seen, light, margin, thickness, cached, decisions):
    """Radiance paths a pixel, depth slabs and pupil bins."""
    if settings.radiance == "ray":
        reason = "as asked" if cached is not None else "as asked; dark where light is indirect"
        decisions.append(Decision("radiance", f"{settings.paths} paths a ray", reason))
        return 0, 1, 1
    passes = passes_for(settings, light.noise)
    left, speckle = math.sqrt(light.noise / passes), speckle_contrast("random", settings.frames)
    glossy = seen.turn > 0 or seen.specular > LEAST_SHARE
    bins = min(GLOSSY_BINS[0] + math.floor(1.5 * seen.turn), GLOSSY_BINS[1]) if glossy else 1
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    room = MAP_BYTES / (columns * SURFACES * _binned(seen) * CELL_BYTES)
    bins = max(1, min(bins, math.floor(math.sqrt(room))))
    most_slabs = min(MOST_SLABS, MAP_BYTES // (4 * columns << seen.splits))
    slabs = max(1, min(most_slabs, math.ceil(thickness / SLAB)))
    decisions.append(
        Decision(
            "radiance paths a pixel",
            str(passes) if cached is None else f"{CACHED_PASSES} to {passes}",
            "as many as what shines and mirrors needs once diffuse light is baked"
            if cached is not None
            else f"leaves {left:.1%} noise in a grain's mean where frames of random phase leave {speckle:.0%} speckle",
        )
    )
    decisions.append(
        Decision(
            "radiance map",
            f"{slabs} depth slabs, {bins} x {bins} pupil bins",
            f"across the pupil the view turns {seen.turn:.2g} widths of the sharpest gloss"
            if glossy
            else "all surfaces in view are diffuse",
        )
    )
    return passes, slabs, bins


def _binned(seen):
    """Share of the occupied cells that have all pupil bins."""
    return min(1.0, max(0.01, len(seen.gloss) / max(len(seen.vergence), 1) + seen.specular))


def _costs(hologram, settings, seen, light, rays, passes, margin, slabs, bins, cached):
    """Estimated seconds and bytes, from the probe's speed and the sizes of the arrays."""
    pixels, frames, colours = hologram.width * hologram.height, settings.frames, len(hologram.wavelengths)
    columns = (hologram.width + 2 * margin) * (hologram.height + 2 * margin)
    seconds = 2.0 + pixels * rays * (1.3 / seen.rays_per_second + (2 + 0.3 * frames * colours) * 1e-9)
    paths = columns * passes if settings.radiance == "grain" else pixels * rays * settings.paths
    seconds += cached if cached is not None else 0.6 * paths / light.paths_per_second
    seconds += pixels * frames * colours * 0.1e-6
    fields = pixels * frames * (colours + 1) * 8
    if settings.despeckle:
        many = despeckle.BATCHES * SETS[-1]
        seconds += pixels * rays * despeckle.BATCHES * 1.3 / seen.rays_per_second
        seconds += pixels * many * colours * (rays * 0.3e-9 + 1e-6)
        seconds += pixels * frames * colours * settings.despeckle * 25e-9
        # a batch and its spectra, or the fields, Adam's memory, spectra, waves and slopes of a colour
        fields += pixels * 8 * max(SETS[-1] * (colours + 1), 7 * frames) + pixels * colours * 40 * 4
    tables = LEVELS * margin**2 * 8 * colours
    rows = 1 + (bins**2 - 1) * _binned(seen)
    radiance = columns * ((4 * slabs << seen.splits) + SURFACES * rows * CELL_BYTES)
    texels = 0 if cached is None else min(pixels * ATLAS_TEXELS, MOST_TEXELS) * TEXEL_BYTES
    return seconds, fields + tables + radiance + texels + CHUNK_BYTES


def _slope(hologram):
    return max(hologram.max_slope(w) for w in hologram.wavelengths)


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
