"""Parts of Mitsuba scenes that holograms do not show: an error for some, a warning for others."""

import mitsuba as mi
import numpy as np

from ..errors import InvalidInput
from ..scene import variants
from ..scene.captured.views import METHODS
from ..scene.lobes import REFLECTION, REFRACTION, nested_in, parts_of

MAX_NAMES = 3  # in a warning
# Types that Mitsuba's RGB variants load but cannot evaluate, with what to use instead
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
    "LinearPolarizer": "Polarization is not modeled: a polarizer lets half of all light pass.",
    "LinearRetarder": "Polarization is not modeled: a retarder is clear.",
    "CircularPolarizer": "Polarization is not modeled: a circular polarizer lets half of all light pass.",
    "DirectionalArea": "An emitter of type 'directionalarea' gives no light, as no path from the viewer finds its one "
    "direction. Use 'directional', 'projector' or 'spot'.",
    "Ellipsoids": "Volumetric primitives (ellipsoids) are shown as solid surfaces.",
    "EllipsoidsMesh": "Volumetric primitives (ellipsoidsmesh) are shown as solid surfaces.",
}
# Radius over the scene's extent; on a graphics card spheres of 1/30 lose nothing, and of 1/300 an eighth of the light.
MIN_SPHERE_RADIUS = 1 / 100
CURVE_END = 4  # control points of the last segment of a B-spline


def unmodeled_warnings(scene: mi.Scene) -> list[str]:
    """Warnings about parts of a scene that look different from Mitsuba's own renders.

    Parameters
    ----------
    scene : mitsuba.Scene

    Returns
    -------
    list of str

    Raises
    ------
    InvalidInput
        If a part of the scene cannot be evaluated at all.
    """
    parts, kinds = parts_of(scene), {}
    for part in parts:
        kinds.setdefault(_kind(part), []).append(part)
    for kind, problem in REFUSED.items():
        if kind in kinds:
            raise InvalidInput(f"The scene has {problem}.")
    for curve in kinds.get("BSplineCurve", []):
        if np.any(np.array(mi.traverse(curve)["control_points"])[3::4][-CURVE_END:]):
            raise InvalidInput(
                f"The shape {_named([curve])} of type 'bsplinecurve' may crash Mitsuba 3.9, where a ray meets the end "
                "of its last curve. Add one of four points of radius 0 at the end of its file, or use 'linearcurve'."
            )
    warnings = [note for kind, note in NOTED.items() if kind in kinds]
    if any(int(mask.flags()) & (REFLECTION | REFRACTION) for mask in kinds.get("MaskBSDF", [])):
        warnings.append(
            "A polished surface under a BSDF of type 'mask' loses its mirror image. Use 'mixture' with 'null' instead."
        )
    if variants.activate() == variants.CUDA:
        min_radius = MIN_SPHERE_RADIUS * np.linalg.norm(scene.bbox().extents())
        lamps = [shape for shape in kinds.get("Sphere", []) if shape.is_emitter()]
        small = [shape for shape in lamps if max(shape.bbox().extents()) < 2 * min_radius]
        if small:
            warnings.append(
                "On a graphics card Mitsuba's spheres are inexact where they are small beside the scene: "
                f"{_named(small)} may light too little. Use a 'point' emitter, a ball of triangles, or llvm_ad_rgb."
            )
    if any(isinstance(part, mi.Medium) for part in parts):
        around = [part for part in parts if any(isinstance(inner, mi.Medium) for inner in nested_in(part))]
        warnings.append(
            f"Scattering media are not modeled: what is in or around {_named(around)} is shown as clear."
        )
    return warnings


def check_method(scene: mi.Scene, method: str) -> None:
    """Check that a method can show a scene.

    Parameters
    ----------
    scene : mitsuba.Scene
    method : str

    Raises
    ------
    InvalidInput
        If the scene is a panel of views, and the method is not for those.
    """
    if method not in METHODS and any(type(part).__name__ == "ViewTexture" for part in parts_of(scene)):
        raise InvalidInput(
            f"The method {method} would show views as a flat picture, as they have no depth. Choose "
            f"{' or '.join(METHODS)}."
        )


def _kind(part):
    """Mitsuba's name of a part's type."""
    return part.class_name().partition("[")[0]


def _named(parts):
    """Ids of some parts, or their types where they have none."""
    names = [part.id() or f"a {_kind(part)}" for part in parts[:MAX_NAMES]]
    return ", ".join(names) + (f" and {len(parts) - MAX_NAMES} more" if len(parts) > MAX_NAMES else "")
