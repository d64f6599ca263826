"""What a Mitsuba scene may hold that a hologram does not show: refused with a sentence, or told of."""

import mitsuba as mi
import numpy as np

from ..errors import InvalidInput
from ..scene import variants
from ..scene.captured.views import METHODS
from ..scene.lobes import REFLECTION, REFRACTION, nested_in, parts_of

MOST_NAMES = 3
# what Mitsuba's RGB variants load but cannot evaluate, by Mitsuba's names of the types, and what to do
SPECTRA = (
    "a spectrum of type '{}', which Mitsuba evaluates in its spectral variants only: give a color (<rgb>)"
)
REFUSED = {
    "BlackBodySpectrum": SPECTRA.format("blackbody"),
    "RegularSpectrum": SPECTRA.format("regular"),
    "IrregularSpectrum": SPECTRA.format("irregular"),
    "TimedSunskyEmitter": "an emitter of type 'timed_sunsky', which Mitsuba cannot sample here: use 'sunsky'",
}
NOTED = {
    "LinearPolarizer": "Polarization is not modelled: a polarizer lets half of all light pass.",
    "LinearRetarder": "Polarization is not modelled: a retarder is clear.",
    "CircularPolarizer": "Polarization is not modelled: a circular polarizer lets half of all light pass.",
    "DirectionalArea": "An emitter of type 'directionalarea' gives no light, as no path from the viewer finds its one "
    "direction: use 'directional', 'projector' or 'spot'.",
    "Ellipsoids": "Volumetric primitives (ellipsoids) are shown as solid surfaces.",
    "EllipsoidsMesh": "Volumetric primitives (ellipsoidsmesh) are shown as solid surfaces.",
}
# Radius beside the scene's extent: on a graphics card 1/30 loses nothing, 1/300 an eighth of the light.
LEAST_SPHERE = 1 / 100
CURVE_END = 4  # control points of the last segment of a B-spline


def unmodelled(scene):
    """What of a scene is shown otherwise than Mitsuba's own integrators might.

    Parameters
    ----------
    scene : mitsuba.Scene

    Returns
    -------
    list of str
        A warning each.

    Raises
    ------
    InvalidInput
        If a part of it cannot be evaluated at all.
    """
    parts, kinds = parts_of(scene), {}
    for part in parts:
        kinds.setdefault(_kind(part), []).append(part)
    for kind, what in REFUSED.items():
        if kind in kinds:
            raise InvalidInput(f"The scene has {what}.")
    for curve in kinds.get("BSplineCurve", []):
        if np.any(np.array(mi.traverse(curve)["control_points"])[3::4][-CURVE_END:]):
            raise InvalidInput(
                f"The shape {_named([curve])} of type 'bsplinecurve' may crash Mitsuba 3.9, where a ray meets the end "
                "of its last curve: add one of four points of radius 0 at the end of its file, or use 'linearcurve'."
            )
    warnings = [note for kind, note in NOTED.items() if kind in kinds]
    if any(int(mask.flags()) & (REFLECTION | REFRACTION) for mask in kinds.get("MaskBSDF", [])):
        warnings.append(
            "A polished surface under a BSDF of type 'mask' loses its mirror image: use 'mixture' with 'null' instead."
        )
    if variants.activate() == variants.CUDA:
        least = LEAST_SPHERE * np.linalg.norm(scene.bbox().extents())
        lamps = [shape for shape in kinds.get("Sphere", []) if shape.is_emitter()]
        small = [shape for shape in lamps if max(shape.bbox().extents()) < 2 * least]
        if small:
            warnings.append(
                f"Mitsuba's spheres are not exact on a graphics card: so small beside the scene, {_named(small)} may "
                "light too little. Use a 'point' emitter, a ball of triangles, or llvm_ad_rgb."
            )
    if any(isinstance(part, mi.Medium) for part in parts):
        around = [part for part in parts if any(isinstance(inner, mi.Medium) for inner in nested_in(part))]
        warnings.append(
            f"Scattering media are not modelled: what is in or around {_named(around)} is shown as clear."
        )
    return warnings


def refuse_method(scene, method):
    """Refuse a method that would show a scene otherwise than it is.

    Parameters
    ----------
    scene : mitsuba.Scene
    method : str

    Raises
    ------
    InvalidInput
        If the scene is a panel of views, and the method is not for these.
    """
    if method not in METHODS and any(type(part).__name__ == "ViewTexture" for part in parts_of(scene)):
        raise InvalidInput(
            f"The method {method} would show views as a flat picture, for they tell no depth: choose "
            f"{' or '.join(METHODS)}."
        )


def _kind(part):
    """Mitsuba's name of the type of a part."""
    return part.class_name().partition("[")[0]


def _named(parts):
    """The ids of some parts, their types where they have none."""
    names = [part.id() or f"a {_kind(part)}" for part in parts[:MOST_NAMES]]
    return ", ".join(names) + (f" and {len(parts) - MOST_NAMES} more" if len(parts) > MOST_NAMES else "")
