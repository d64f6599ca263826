"""Choices of the settings: what each is called, and what it does."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Choice:
    """One of the values of a setting.

    Attributes
    ----------
    name, label, help : str
        Name on the command line, label in Blender's menus, and description.
    number : int
        Number in .blend files, which never changes.
    """

    name: str
    label: str
    help: str
    number: int


def choices(*rows: tuple[str, str, str], numbered: tuple[str, ...] = ()) -> dict[str, Choice]:
    """Choices by name.

    Parameters
    ----------
    *rows : (str, str, str)
        Name, label and help of each.
    numbered : tuple of str
        Names in the order of their numbers. Default: the order of the rows.
    """
    order = list(numbered or [row[0] for row in rows])
    return {row[0]: Choice(*row, order.index(row[0])) for row in rows}


# name: module of `baselines`, label, description
BASELINES = {
    "point": ("point_cloud", "Point Cloud", "a spherical wave from each visible surface point"),
    "polygon": ("polygons", "Polygons", "the field of each visible facet, by its angular spectrum"),
    "rgbd": ("layers", "RGB-D Layers", "layers of an image with depth, each of which blocks those behind it"),
    "rgbd-sgd": (
        "rgbd_descent",
        "RGB-D Descent",
        "phases that show an image with depth sharp on its layers",
    ),
    "focal-stack": (
        "focal_stack",
        "Focal Stack",
        "phases that show images through a lens at several depths",
    ),
    "light-field": ("light_field", "Light Field", "phases that show views from all over the pupil"),
    "stereogram": (
        "stereogram",
        "Stereogram",
        "views from all over the pupil, by a short-time Fourier transform",
    ),
    "gaussian": (
        "gaussians",
        "Gaussians",
        "the wave of each Gaussian on the surfaces, blended from far to near",
    ),
    "network": ("network", "Network", "your own function from an image with depth to a field"),
}
METHODS = choices(
    ("auto", "Auto", "Bake diffuse light where that is faster than tracing it for this view"),
    ("full", "Full", "Trace all light for this view alone"),
    ("fast", "Fast", "Bake diffuse light into a texture, once for all views and focus distances of a scene"),
    ("direct", "Direct", "Trace straight from the SLM with random directions: the paper's slow baseline"),
    *((name, label, f"To compare with: {what}") for name, (_, label, what) in BASELINES.items()),
)
QUALITIES = choices(
    (
        "draft",
        "Draft",
        "A complete hologram at once, with much noise; mirrors and glass show images on their own surface",
    ),
    ("preview", "Preview", "Few rays and radiance samples, for a first look"),
    ("balanced", "Balanced", "Enough rays for every depth in view"),
    ("high", "High", "A wider cone of rays and more radiance samples"),
    numbered=("preview", "balanced", "high", "draft"),
)
ESTIMATORS = choices(
    ("lattice", "Lattice", "Directions on a lattice with the exact kernel: only the radiance is noisy"),
    ("paper", "Paper", "Random directions with a spherical wave, as published"),
)
PHASE_FIELDS = choices(
    ("auto", "Auto", "Smooth with up to five frames, which cannot average speckle; designed with more"),
    (
        "smooth",
        "Smooth",
        "Phases that vary little, see Randomness: little speckle with few frames, and less light at the edge "
        "of the eyebox",
    ),
    ("designed", "Designed", "Maps designed so that the frames' mean has little speckle, at any focus"),
    (
        "random",
        "Random",
        "Independent for each frame, as published: speckle contrast of 1 over the square root of the frames",
    ),
    numbered=("designed", "random", "auto", "smooth"),
)
RADIANCES = choices(
    (
        "grain",
        "Per Grain",
        "Average each grain's radiance before the square root: correct in indirect light",
    ),
    ("ray", "Per Ray", "Separate light paths for each ray, as published: too dark in indirect light"),
)
VIRTUAL_IMAGES = choices(
    ("curvature", "Wavefront", "Where neighboring rays cross: correct for curved mirrors and lenses"),
    ("opl", "Path Length", "At the optical path length, as published: correct for flat mirrors only"),
)
DEPTH_MAPPINGS = choices(
    ("fit", "Fit Scene", "Spread the scene from its near end to infinity over the depth range"),
    (
        "eyepiece",
        "Eyepiece",
        "Map depths like an eyepiece that shows the hologram in the camera's field of view",
    ),
)
ENCODINGS = choices(
    (
        "dpac",
        "Double Phase",
        "Pairs of pixels whose mean is the complex amplitude: fast, for a first look",
    ),
    (
        "auto",
        "Automatic",
        "The best in the given seconds: Many Frames where the scene is available, otherwise All Frames, or Each "
        "Frame for one frame of random phases",
    ),
    ("sgd", "Each Frame", "Gradient descent towards each frame's complex field"),
    (
        "joint",
        "All Frames",
        "Each frame, then all together, so that their mean shows what the field's does",
    ),
    (
        "refine",
        "Many Frames",
        "Each frame, then all together towards the mean of many extra frames, which are also traced: closest to the "
        "scene, and slower",
    ),
)
