"""Export of the evaluated depsgraph to a Mitsuba scene."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..engine import Camera, InvalidInput
from ..engine.scene.variants import activate, made
from .cache import ExportCache
from .camera import about, export_camera, find_camera
from .census import add_notes
from .contents import Contents
from .notes import NAMED_OBJECTS, Notes
from .world import export_world, world_of

if TYPE_CHECKING:
    import mitsuba as mi

# Mitsuba starts a ray this far above its surface, times 1 m + the largest coordinate of the point...
RAY_OFFSET = 9e-5
# ... which should stay below this part of the scene's diagonal.
MAX_OFFSET = 0.03
# Mitsuba's scene has its origin near the camera, on a grid of this pitch in meters: small motions of the camera keep
# the origin, for which the cache holds.
ORIGIN_GRID = 64.0


@dataclass
class ExportedScene:
    """A Blender scene in the engine's form.

    Attributes
    ----------
    scene : mitsuba.Scene
        In meters and Blender's axes, relative to an origin near the camera.
    camera : Camera
        Relative to the same origin.
    notes : list of Note
        Everything approximated or omitted.
    """

    scene: "mi.Scene"
    camera: Camera
    notes: list


@dataclass(frozen=True)
class Reading:
    """The contents of a Blender scene, without references to bpy.

    Attributes
    ----------
    name : str
        Name of the scene.
    parts : dict
        Arguments of `mitsuba.load_dict`.
    camera : Camera
        Relative to `origin`.
    notes : Notes
    origin : numpy.ndarray
        Origin of Mitsuba's scene in Blender's world, meters.
    """

    name: str
    parts: dict
    camera: Camera
    notes: Notes
    origin: np.ndarray

    def build(self):
        """Build Mitsuba's scene, which takes long for many triangles; any thread may call it.

        Returns
        -------
        ExportedScene
        """
        scene = made(self.parts)
        _note_precision(scene, self.name, self.notes)
        return ExportedScene(scene, self.camera, list(self.notes))


def export_scene(depsgraph, resolution, camera=None, cache=None):
    """Export the evaluated scene: `read_scene` and `Reading.build` in one.

    Parameters
    ----------
    depsgraph, resolution, camera, cache
        See `read_scene`.

    Returns
    -------
    ExportedScene
    """
    return read_scene(depsgraph, resolution, camera, cache).build()


def read_scene(depsgraph, resolution, camera=None, cache=None):
    """Read the evaluated scene, on the thread that owns `depsgraph`.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
        An evaluated one; its mode decides between viewport and render settings of modifiers.
    resolution : tuple of int
        Hologram width and height in pixels; with the camera's sensor fit they set the field of view.
    camera : bpy.types.Object, str or Camera, optional
        A camera object or its name, or a camera outside the scene. Default: the scene's active camera.
    cache : ExportCache, optional
        Cache of the caller's previous export; only changes are read then.

    Returns
    -------
    Reading

    Raises
    ------
    InvalidInput
        If there is no usable camera, nothing to render, or a mesh has vertices that are not finite.
    BackendUnavailable
        If Mitsuba cannot run.
    """
    activate()
    scene = depsgraph.scene
    notes = Notes()
    scale = unit_scale(scene)
    if isinstance(camera, Camera):
        exported_camera = camera
    else:
        exported_camera = export_camera(depsgraph, find_camera(scene, camera), resolution, scale, notes)
    pixel = footprint(exported_camera, resolution, scale)
    origin = ORIGIN_GRID * np.round(exported_camera.position / ORIGIN_GRID)
    _note_settings(depsgraph, notes)
    parts = read_parts(depsgraph, scale, pixel, notes, cache, origin)
    _note_libraries(notes)
    return Reading(scene.name, parts, about(origin, exported_camera), notes, origin)


def _note_settings(depsgraph, notes):
    """Note render settings that a hologram ignores."""
    import bpy

    scene = depsgraph.scene
    colors = getattr(bpy.data, "colorspace", None)  # since Blender 5.0
    if colors is not None and colors.working_space != "Linear Rec.709":
        notes.add(
            scene.name,
            f"Working Space {colors.working_space}",
            "colors are taken as those of Linear Rec.709: choose that in Scene > Color Management",
        )
    cycles = getattr(scene, "cycles", None)  # which is not there where Blender's add-on for Cycles is off
    add_notes(scene.render, scene.name, notes)
    add_notes(cycles, scene.name, notes)
    if cycles and cycles.use_fast_gi:
        notes.add(
            scene.name, "Fast GI Approximation", "ignored: light bounces as often as Max Path Depth says"
        )
    has_limit = cycles and (
        cycles.texture_limit_render != "OFF"
        or getattr(cycles, "texture_resolution_render", 1) != 1  # since Blender 5.2
    )
    if has_limit and scene.render.use_simplify:
        notes.add(scene.name, "Texture Limit of Simplify", "ignored: images have their full size")


def _note_precision(exported_scene, name, notes):
    """Note rays of Mitsuba that start too far from their surface."""
    box = exported_scene.bbox()
    if not box.valid():
        return
    lower, upper = np.array(box.min).ravel(), np.array(box.max).ravel()
    nearest = np.clip(0, lower, upper)  # the point of the scene where rays start closest to their surface
    if RAY_OFFSET * (1 + np.abs(nearest).max()) > MAX_OFFSET * np.linalg.norm(upper - lower):
        notes.add(
            name,
            "Scene tiny, or far from the camera for its size",
            "light leaks at edges: raise Scene > Units > Unit Scale, or move it near the camera",
        )


def _note_libraries(notes):
    """Note linked libraries that are missing, or lack linked data, for which Blender has empty placeholders."""
    import bpy

    for library in bpy.data.libraries:
        absent = [thing for thing in library.users_id if thing.is_missing]
        if not absent:
            continue
        names = {True: [], False: []}  # of objects and collections; of what these consist of
        for thing in absent:
            kind = thing.id_type.lower().replace("_", " ")
            names[kind in ("object", "collection")].append(f"{kind} {thing.name}")
        effects = [f"{_enumerate(names[True])} left out"] if names[True] else []
        effects += [f"nothing in {_enumerate(names[False])}"] if names[False] else []
        if is_there(library):
            feature, advice = (
                "Linked library without what is linked",
                "save it with these names, or link them anew",
            )
        else:
            feature, advice = "Missing linked library", "put the file there, or choose it with Relocate"
        notes.add(library.filepath, feature, f"{', '.join(effects)}: {advice}")


def is_there(library):
    """Whether the file of a linked library exists."""
    import bpy

    return Path(bpy.path.abspath(library.filepath, library=library.parent)).is_file()


def _enumerate(names):
    """Some names, and the number of others."""
    names, more = sorted(names), len(names) - NAMED_OBJECTS
    return ", ".join(names[:NAMED_OBJECTS]) + (f" and {more} more" if more > 0 else "")


def footprint(camera, resolution, scale):
    """Make the function from a box (its lower and upper corner) to the size of a pixel at its nearest point.

    All in Blender units.
    """
    eye = np.asarray(camera.to_world)[:3, 3] / scale
    per_pixel = 2 * np.tan(camera.fov_x / 2) / resolution[0]
    return lambda lower, upper: per_pixel * np.linalg.norm(np.clip(eye, lower, upper) - eye)


def read_parts(depsgraph, scale, pixel, notes, cache=None, origin=(0.0, 0.0, 0.0)):
    """Read the parts of Mitsuba's scene.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
    scale : float
        Meters a Blender unit.
    pixel : callable
        See `footprint`.
    notes : Notes
    cache : ExportCache, optional
    origin : array, shape (3,)
        As of `Reading`.

    Returns
    -------
    dict
        For `mitsuba.load_dict`.
    """
    scene = depsgraph.scene
    if cache is None or depsgraph.mode != "VIEWPORT":
        cache = ExportCache()
    else:
        cache.begin(depsgraph)
    appearances = cache.appearances
    appearances.begin(notes, scene.frame_current_final)
    # on CUDA, OptiX has no cracks; Embree lets rays through where triangles meet, unless told otherwise
    parts = {"type": "scene", "embree_use_robust_intersections": True}
    try:
        contents = Contents(depsgraph, scale, pixel, cache, notes, origin)
        for number, part in enumerate([*contents.shapes(), *contents.emitters]):
            parts[f"part_{number}"] = part
        world = appearances.world(world_of(depsgraph), scene.frame_current_final, export_world)
        cache.end(contents.meshes, contents.joined_meshes)
    except BaseException:
        cache.clear()
        raise
    if len(parts) - len(contents.emitters) == 2 and world is None:
        import bpy

        absent = [library.filepath for library in bpy.data.libraries if not is_there(library)]
        advice = "add or unhide an object with faces"
        raise InvalidInput(
            f"The scene '{scene.name}' has nothing visible to render: "
            + (f"its linked library {absent[0]} is missing." if absent else f"{advice}.")
        )
    if world is not None:
        parts["world"] = world
    if world is None and not contents.emitters and not contents.emits:
        notes.add(scene.name, "No light, emission or world color", "the picture is black")
    if contents.emitters:
        for name, material in contents.smooth:
            missing = Notes(material)
            missing.add(
                material,
                "Lamps mirrored in or shining through a smooth or transparent surface",
                "missing: use an emitting mesh as lamp",
            )
            notes.add_material(name, missing)
    return parts


def unit_scale(scene):
    """Meters a Blender unit."""
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else float(units.scale_length)
