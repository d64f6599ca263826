"""What pictures are compared: foci, halves of the pupil, views and pupil sizes, against Mitsuba's thin lens.

Besides these there are foci halfway between the planes whose pictures `focal-stack` is given, at which no method is
taught anything, and what a person sees first: the whole pupil, focused on what is in the middle of the picture.

The pupil is that of the shortest wavelength, which all others fill; whole is each wavelength's own cone.
"""

import math
from dataclasses import dataclass

import numpy as np

from holopath_addon import engine
from holopath_addon.engine.baselines.focal_stack import planes_of
from holopath_addon.engine.mapping import DepthMapping

VIEW = math.tan(math.radians(0.5))  # slope of the views to the side
OUT_OF_FOCUS = 2.0  # radius of a point's blur, pixels, from which a pixel counts as out of focus


@dataclass(frozen=True)
class Look:
    """A picture: what is sharp, and the part of the pupil that is open.

    Attributes
    ----------
    name : str
    depth : float
        World depth in focus, meters.
    part : (float, float, float) or None
        Center, to the right and up, and radius of what is open, in radii of the pupil; None: all.
    """

    name: str
    depth: float
    part: tuple | None = None


HEADLINE = (
    "front", "front-middle", "middle", "middle-back", "back",
    "left", "right", "up", "down", "view-left", "view-right",
)  # fmt: skip
FOCI = HEADLINE[:5]  # of the whole pupil
PUPILS = ("pupil-half", "pupil-quarter")
HALFWAY = ("halfway-front", "halfway-middle", "halfway-back")
CENTER = "center"
LOOKS = (*HEADLINE, *PUPILS, *HALFWAY, CENTER)
HALVES = {"left": (-0.5, 0.0, 0.5), "right": (0.5, 0.0, 0.5), "up": (0.0, 0.5, 0.5), "down": (0.0, -0.5, 0.5)}


def slope_of(hologram):
    """Radius of the pupil that all wavelengths fill, as a slope."""
    return min(map(hologram.max_slope, hologram.wavelengths))


def looks_of(foci, others, hologram):
    """The `Look` of each name in `LOOKS`, in that order.

    Parameters
    ----------
    foci : (float, float, float)
        World depths in front, in the middle and at the back, meters.
    others : sequence of four floats
        World depths of `HALFWAY` and `CENTER`, meters.
    hologram : engine.Hologram
    """
    front, middle, back = foci
    to_the_side = VIEW / slope_of(hologram)
    depths = (front, _between(front, middle), middle, _between(middle, back), back)
    looks = [Look(name, depth) for name, depth in zip(HEADLINE, depths, strict=False)]
    looks += [Look(name, middle, part) for name, part in HALVES.items()]
    looks += [
        Look(n, middle, (x, 0.0, 0.25)) for n, x in (("view-left", -to_the_side), ("view-right", to_the_side))
    ]
    looks += [Look(n, middle, (0.0, 0.0, r)) for n, r in zip(PUPILS, (0.5, 0.25), strict=True)]
    return looks + [Look(n, float(depth)) for n, depth in zip((*HALFWAY, CENTER), others, strict=True)]


def others_of(plan, mapping, depth):
    """World depths of `HALFWAY` and `CENTER`, meters.

    Parameters
    ----------
    plan : engine.Plan
        Of `focal-stack`.
    mapping : engine.DepthMapping
    depth : numpy.ndarray, shape (y, x)
        Of what is seen at each pixel, meters.
    """
    planes = planes_of(plan.z_low, plan.z_high)
    halfway = 0.5 * (planes[:-1] + planes[1:])[::-2] if len(planes) > 1 else planes.repeat(len(HALFWAY))
    return [*map(float, mapping.z_to_depth(halfway)), float(np.median(middle_of(depth, 4)))]


def middle_of(picture, part=2):
    """The middle of a picture, a `part`-th of its height and width."""
    inner = tuple(slice((n - n // part) // 2, (n - n // part) // 2 + n // part) for n in picture.shape[:2])
    return picture[inner]


def _between(a, b):
    """The depth half-way in hologram space."""
    return 2 / (1 / a + 1 / b)


def pupil_of(look, hologram, mapping):
    """The `engine.Pupil` of a look, None where all is open."""
    if look.part is None:
        return None
    x, y, radius = (mapping.pupil_radius(slope_of(hologram)) * v for v in look.part)
    return engine.Pupil(x, y, 2 * radius)


def openings_of(look, hologram):
    """Radius of what is open in each wavelength's own cone, in cycles a pixel: the edge of the cone is at 0.5."""
    if look.part is None:
        return np.full(len(hologram.wavelengths), 0.5)
    return look.part[2] * slope_of(hologram) * hologram.pitch / np.array(hologram.wavelengths)


def border_of(hologram):
    """Pixels at each edge that lose light of the near end to the SLM's aperture."""
    slope = hologram.widest_slope
    return math.ceil(slope * max(abs(hologram.depth_far), abs(hologram.depth_near)) / hologram.pitch)


def truth_of(scene, camera, hologram, foci, spp, progress=None):
    """Pictures through a thin lens, and what is needed to compare with them.

    Parameters
    ----------
    scene, camera, hologram :
        As of `engine.render`.
    foci : (float, float, float)
        As of `looks_of`.
    spp : int
        Paths a pixel and picture, half of them in each of two independent pictures.
    progress : callable, optional
        ``progress(done, message)``.

    Returns
    -------
    dict of str to numpy.ndarray
        ``pictures`` [look, half, y, x, wavelength], ``ceiling`` [look], PSNR in dB that their noise allows, ``blurred``
        [3, y, x], what is out of focus in front, middle and back, ``others``, see `looks_of`, and ``near``, meters.
    """
    progress = progress or (lambda done, message: None)
    plan = engine.plan(scene, camera, hologram, engine.Settings(method="focal-stack"))
    near, mapping = plan.near, DepthMapping.of(hologram, camera, plan.near)
    depth = engine.depth_map(scene, camera, hologram.width, hologram.height)
    others = others_of(plan, mapping, depth)
    looks, border = looks_of(foci, others, hologram), border_of(hologram)
    pictures, ceiling = [], []
    for number, look in enumerate(looks):
        part = pupil_of(look, hologram, mapping)
        (halves,) = engine.reference(
            scene, camera, hologram, [look.depth], part, spp, near, seed=500, halves=True
        )
        pictures.append(halves)
        # their difference has four times the squared noise of their mean
        ceiling.append(engine.psnr(halves[0], halves[1], border) + 20 * math.log10(2))
        progress((number + 1) / len(looks), f"reference {look.name}")
    z = mapping.depth_to_z(depth)
    reach = slope_of(hologram) / hologram.pitch
    blurred = [np.abs(z - mapping.depth_to_z(depth)) * reach > OUT_OF_FOCUS for depth in foci]
    return {
        "pictures": np.stack(pictures).astype(np.float32),
        "ceiling": np.array(ceiling),
        "blurred": np.stack(blurred),
        "others": np.array(others),
        "near": np.array(near),
    }


def diffracted(pictures, foci, others, hologram):
    """Pictures of `truth_of` as light through what is open of the pupil shows them at best, see `engine.diffracted`."""
    looks = looks_of(foci, others, hologram)
    return np.stack(
        [
            engine.diffracted(p, hologram, openings_of(look, hologram))
            for p, look in zip(pictures, looks, strict=True)
        ]
    )


def seen(field, foci, others, count=None):
    """Pictures of a wave field, as the first `count` of `truth_of`.

    They are as bright as each wavelength's opening, whatever its share of the pupil. Red fills a wider cone than
    blue, so that a part of the pupil has less of its light: white would be blue there with any method, and hide all
    other errors.
    """
    hologram, mapping, refocuser = field.hologram, field.mapping, engine.Refocuser(field)
    pictures = []
    for look in looks_of(foci, others, hologram)[:count]:
        share = (2 * openings_of(look, hologram)) ** 2
        pictures.append(refocuser([look.depth], pupil_of(look, hologram, mapping))[0] / share)
    return np.stack(pictures)
