"""Number of radiance paths a pixel: the target noise, and the noise that the pilot's light predicts."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..tracing.measurement import rays_for_textures
from ..waves.phase_fields import SETS, speckle_contrast

if TYPE_CHECKING:
    from ..settings import Settings
    from .pilot_light import Light

# Noise of a grain's mean, a fraction of the contrast of random speckle in as many frames
SPECKLE_FRACTION = {"draft": 1.0, "preview": 0.5, "balanced": 0.35, "high": 0.15}
REFERENCE_FRAMES = 8  # frames for which `SPECKLE_FRACTION` was set
# The target noise falls as frames to this power: not all errors fall with frames as speckle does, by 1/2.
FRAMES_EXPONENT = 1 / 3
PASSES = {"draft": (4, 4), "preview": (8, 64), "balanced": (16, 256), "high": (32, 1024)}  # minimum, maximum
# Maximum that an indirect path may add to the mean of the minimum of paths, in radiances of the view's bright parts
FIREFLY_LIMIT = 2.0
SHARING_GAIN = (
    16.0  # times less variance, textures apart, where grains share light; halves show where it is not so
)
# Variances that renders have over those that the pilot finds, light and textures, in ten scenes
LIGHT_VARIANCE_RATIO, TEXTURE_VARIANCE_RATIO = 1.2, 2.0


def target_noise(settings: Settings) -> float:
    """Relative standard error of a grain's mean radiance that hardly shows in images of that many frames."""
    reference = SPECKLE_FRACTION[settings.quality] * speckle_contrast("random", REFERENCE_FRAMES)
    return reference * (REFERENCE_FRAMES / settings.frames) ** FRAMES_EXPONENT


def texel_noise(settings: Settings) -> float:
    """Target noise of a baked texel, for the largest set of frames: baked light serves any number of frames."""
    return SPECKLE_FRACTION[settings.quality] * speckle_contrast("random", SETS[-1])


def max_passes(settings: Settings) -> int:
    """Maximum radiance paths a pixel, and samples of a texel."""
    return PASSES[settings.quality][1]


def passes_for(settings: Settings, variance: float, min_passes: int | None = None) -> int:
    """Radiance paths a pixel that reach `target_noise`.

    Parameters
    ----------
    settings : Settings
    variance : float
        Relative variance of one path.
    min_passes : int, optional
        Default: the minimum of `PASSES`.
    """
    if "passes" in settings.fixed:
        return settings.fixed["passes"]
    fewest, limit = PASSES[settings.quality]
    return min(max(min_passes or fewest, math.ceil(variance / target_noise(settings) ** 2)), limit)


def path_variance(settings: Settings, light: Light) -> float:
    """Relative variance of a grain's mean times its paths; textures apart where grains share light."""
    gain = sharing_gain(settings)
    return light.noise if gain == 1 else max(light.noise - light.texture, 0) / gain


def texture_variance(settings: Settings, light: Light, rays: int) -> float:
    """Relative variance of a grain's mean by its texture, which so many rays sample."""
    return 0.0 if sharing_gain(settings) == 1 else TEXTURE_VARIANCE_RATIO * light.texture / rays


def sharing_gain(settings: Settings) -> float:
    """Paths that count for a grain's mean, over its own; estimated."""
    return SHARING_GAIN if settings.fixed.get("filter", 1) else 1.0


def firefly_limit(settings: Settings) -> float:
    """Maximum that one path of the minimum may count, in radiances of the bright parts of the view."""
    return FIREFLY_LIMIT * PASSES[settings.quality][0]


def radiance_limit(settings: Settings, light: Light, passes: int) -> float:
    """Maximum radiance that indirect light may add to one of `passes` paths; infinite where no light was found."""
    if not light.bright:
        return math.inf
    return FIREFLY_LIMIT * light.bright * (passes or max_passes(settings)) * sharing_gain(settings)


def requested_texture_rays(settings: Settings) -> int | None:
    """Rays a pixel that see textures alone; None where the first paths determine the number."""
    return settings.fixed.get("textures", 0 if settings.quality == "draft" else None)


def estimated_rays(settings: Settings, light: Light) -> tuple[int, int]:
    """Estimate the radiance paths a pixel that a render takes, and its rays a pixel for textures.

    Halves of a render's paths differ by more than the pilot's few paths do.
    """
    passes = passes_for(settings, LIGHT_VARIANCE_RATIO * path_variance(settings, light))
    return passes, estimated_texture_rays(settings, light, passes)


def estimated_texture_rays(settings: Settings, light: Light, passes: int) -> int:
    """Estimate the rays a pixel that see its texture alone, beside so many paths."""
    if sharing_gain(settings) == 1:
        return 0
    error = 0.5 * math.sqrt(texture_variance(settings, light, passes))
    requested = requested_texture_rays(settings)
    return rays_for_textures(error, 0.5 * target_noise(settings), passes) if requested is None else requested
