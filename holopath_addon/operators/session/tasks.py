"""Tasks: scenes that were read, with the request for their render."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import bpy

from ... import engine
from ...blender import preferences, properties
from ...engine import rendering
from ...engine.scene import variants
from ...export import ExportCache, ExportedScene, read_scene
from ...workflow import pipeline
from ...workflow.request import CENTER, Origin, Request

# Results of the last export of the window's scene.
cache = ExportCache()
# Functions called before a scene is exported, to end other threads that trace rays.
before_export: list[Callable[[], None]] = []


class SceneReading(Protocol):
    """A scene that was read for Mitsuba to build, such as `export.Reading`."""

    @property
    def name(self) -> str:
        """Name of Blender's scene, whose settings count."""
        ...

    def build(self) -> ExportedScene:
        """Build Mitsuba's scene; in any thread."""
        ...


@dataclass(frozen=True)
class Task:
    """A scene that was read, and the request for its render. Holds nothing of bpy, so a thread may work on it.

    Attributes
    ----------
    reading : SceneReading
    request : Request
        Request without the scene, which the reading builds.
    """

    reading: SceneReading
    request: Request

    @cached_property
    def exported(self):
        """`export.ExportedScene`, which Mitsuba builds at the first access."""
        return self.reading.build()

    @property
    def full_request(self):
        """The `Request` with its scene."""
        exported = self.exported
        return self.request.with_scene(
            exported.scene, exported.camera, [note.to_dict() for note in exported.notes]
        )

    def release_scene(self):
        """Free Mitsuba's scene, which the next access builds again."""
        self.__dict__.pop("exported", None)

    @property
    def notes(self):
        """Features that the exporter approximated or left out, a line each."""
        return [str(note) for note in self.exported.notes]

    def plan(self, progress):
        """Plan the render.

        Parameters
        ----------
        progress : callable
            As in `jobs.Job`; also below.

        Returns
        -------
        engine.Plan
        """
        progress(0.0, "Building the scene")
        request = self.full_request
        return engine.plan(
            request.scene, request.camera, request.hologram, request.settings, request.store, progress
        )

    def compute(self, progress, offer=None):
        """Render.

        Parameters
        ----------
        progress : callable
        offer : callable, optional
            Takes previews and drafts, see `pipeline.compute`.

        Returns
        -------
        pipeline.Result
        """
        progress(0.0, "Building the scene")
        return pipeline.compute(self.full_request, progress, offer=offer)

    def bake(self, progress, anew=False):
        """Bake the scene's light.

        Parameters
        ----------
        progress : callable
        anew : bool
            Bake light that is stored on disk again.

        Returns
        -------
        texture : numpy.ndarray, shape (y, x, 3)
            Image of the baked light.
        bake : engine.baking.Bake
        """
        progress(0.0, "Building the scene")
        request = self.full_request
        progress(0.0, "Planning")
        return rendering.baked_picture(
            request.scene, request.camera, request.hologram, request.settings, request.store, progress, anew
        )


def prepare(depsgraph, props, resolution=None, camera=None):
    """Read a scene; on the thread that owns `depsgraph`.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
    props : properties.HoloPathSettings
    resolution : tuple of int, optional
        Width and height, pixels, in place of the settings' own.
    camera : bpy.types.Object, optional
        Camera in place of the scene's.

    Returns
    -------
    Task

    Raises
    ------
    engine.InvalidInput
        If the settings or the scene cannot be rendered.
    engine.BackendUnavailable
        If Mitsuba cannot compute as the preferences choose.
    """
    hologram, settings = properties.hologram_of(props, resolution), properties.settings_of(props)
    variants.activate(preferences.chosen_backend())
    for stop in before_export:
        stop()
    size = hologram.picture.width, hologram.picture.height
    reading = read_scene(depsgraph, size, camera, cache)
    scene_state = {
        "frame": depsgraph.scene.frame_current,
        "camera": camera and camera.name,
        "scene": reading.name,
        "view_layer": depsgraph.view_layer.name,
    }
    origin = Origin(bpy.data.filepath or depsgraph.scene.name, scene_state=scene_state)
    return Task(reading, request_of(props, hologram, settings, origin))


def request_of(props, hologram, settings, origin):
    """The `Request` for a picture at the focus of a scene's settings.

    Parameters
    ----------
    props : properties.HoloPathSettings
    hologram : engine.Hologram
    settings : engine.Settings
    origin : Origin

    Returns
    -------
    Request
        Request without the scene.
    """
    focus = CENTER if props.focus_auto else properties.focus_of(props)
    pupil, store = properties.pupil_or_none(props), preferences.store()
    return Request(hologram, settings, [focus], pupil, store, origin=origin)
