"""How many radiance paths a pixel takes: noise that hardly shows, and what the pilot's light foretells of it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..tracing.measurement import rays_for_textures
from ..waves.phase_fields import SETS, speckle_contrast

if TYPE_CHECKING:
    from ..settings import Settings
    from .pilot_light import Light

# of a grain's mean, as a share of the random speckle of as many frames as these
GRAIN_NOISE = {"draft": 1.0, "preview": 0.5, "balanced": 0.35, "high": 0.15}
USUAL_FRAMES = 8
# power of the frames by which less is wanted: not all errors fall with them, as speckle does by 1/2
LESS_NOISE = 1 / 3
# fewest and most radiance paths a pixel
PASSES = {"draft": (4, 4), "preview": (8, 64), "balanced": (16, 256), "high": (32, 1024)}
# times the bright parts of the view: most that one indirect path may add to a mean of the fewest
FIREFLY = 2.0
FILTERED = 16.0  # times less variance, textures apart, where grains share their light; halves tell where it is not so
UNTOLD = 1.2, 2.0  # times the variances that the pilot finds, of light and of textures, over ten scenes


def wanted_noise(settings: Settings) -> float:
    """Relative standard error of a grain's mean radiance that hardly shows in pictures of so many frames."""
    usual = GRAIN_NOISE[settings.quality] * speckle_contrast("random", USUAL_FRAMES)
    return usual * (USUAL_FRAMES / settings.frames) ** LESS_NOISE


def texel_noise(settings: Settings) -> float:
    """The same of a texel that is baked; baked light serves any number of frames, so that of many counts."""
    return GRAIN_NOISE[settings.quality] * speckle_contrast("random", SETS[-1])


def most_passes(settings: Settings) -> int:
    """Radiance paths a pixel, and samples of a texel, at most."""
    return PASSES[settings.quality][1]


def passes_for(settings: Settings, noise: float, fewest: int | None = None) -> int:
    """Radiance paths a pixel where one has a relative variance of `noise`."""
    if "passes" in settings.fixed:
        return settings.fixed["passes"]
    least, most = PASSES[settings.quality]
    return min(max(fewest or least, math.ceil(noise / wanted_noise(settings) ** 2)), most)


def noise_left(settings: Settings, light: Light) -> float:
    """Relative variance of a grain's mean, times its paths, textures apart where grains share their light."""
    shared = sharing(settings)
    return light.noise if shared == 1 else max(light.noise - light.texture, 0) / shared


def sharing(settings: Settings) -> float:
    """Times as many paths as its own that a grain's mean is of, roughly."""
    return FILTERED if settings.fixed.get("filter", 1) else 1.0


def firefly(settings: Settings) -> float:
    """Most that one path may count, in radiances of the bright parts of the view, where there are the fewest."""
    return FIREFLY * PASSES[settings.quality][0]


def radiance_limit(settings: Settings, light: Light, passes: int) -> float:
    """Most that indirect light may add to one path of so many."""
    return FIREFLY * light.bright * (passes or most_passes(settings)) * sharing(settings)


def asked_textures(settings: Settings) -> int | None:
    """Rays a pixel that see textures alone; None where the first paths tell how many."""
    return settings.fixed.get("textures", 0 if settings.quality == "draft" else None)


def likely(settings: Settings, light: Light) -> tuple[int, int]:
    """Radiance paths a pixel that will be taken, and rays that see its texture alone, roughly: halves differ by more
    than the pilot's few paths tell.
    """
    passes = passes_for(settings, UNTOLD[0] * noise_left(settings, light))
    return passes, likely_textures(settings, light, passes)


def likely_textures(settings: Settings, light: Light, passes: int) -> int:
    """Rays a pixel that see its texture alone, roughly."""
    if sharing(settings) == 1:
        return 0
    error = 0.5 * math.sqrt(texture_left(settings, light, passes))
    asked = asked_textures(settings)
    return rays_for_textures(error, 0.5 * wanted_noise(settings), passes) if asked is None else asked


def texture_left(settings: Settings, light: Light, rays: int) -> float:
    """Relative variance of a grain's mean by its texture, of which so many rays tell."""
    return 0.0 if sharing(settings) == 1 else UNTOLD[1] * light.texture / rays
