"""Conversion of Blender's camera to the engine's."""

import dataclasses
import math

import numpy as np

from ..engine import Camera, InvalidInput
from .world import sees_sky


def find_camera(scene, camera=None):
    """Find the camera object to render from.

    Parameters
    ----------
    scene : bpy.types.Scene
    camera : bpy.types.Object, str or None
        A camera object or its name. None for that of Blender's renders of the current frame: a timeline marker's
        camera, or the scene's active one.

    Raises
    ------
    InvalidInput
        If there is none, or the object is not a camera.
    """
    if isinstance(camera, str):
        name, camera = camera, scene.objects.get(camera)
        if camera is None:
            raise InvalidInput(f"The scene has no object '{name}'. Give the name of one of its cameras.")
    elif camera is None:
        camera = _marked_camera(scene) or scene.camera
        if camera is None:
            raise InvalidInput(
                f"The scene '{scene.name}' has no active camera. Add one (Add > Camera) and make it active."
            )
    if camera.type != "CAMERA":
        raise InvalidInput(f"The object '{camera.name}' is not a camera. Choose a camera object.")
    return camera


def _marked_camera(scene):
    """Camera of the last marker up to the current frame, or of the first one, as in Blender's renders."""
    markers = [m for m in scene.timeline_markers if m.camera is not None and not m.camera.hide_render]
    earlier = [marker for marker in markers if marker.frame <= scene.frame_current]
    if earlier:
        return max(earlier, key=lambda marker: marker.frame).camera
    return min(markers, key=lambda marker: marker.frame).camera if markers else None


def export_camera(depsgraph, camera, resolution, scale, notes):
    """Turn a Blender camera into an engine camera for square hologram pixels.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
    camera : bpy.types.Object
        A camera object, see `find_camera`.
    resolution : tuple of int
        Hologram width and height, pixels.
    scale : float
        Meters a Blender unit.
    notes : Notes

    Returns
    -------
    Camera

    Raises
    ------
    InvalidInput
        If the camera is not a perspective one, or its transform is degenerate.
    """
    evaluated = camera.evaluated_get(depsgraph)
    view = view_of(evaluated, resolution, scale)
    _note_differences(depsgraph.scene, evaluated, notes)
    return dataclasses.replace(view, sees_sky=sees_sky(depsgraph))


def view_of(camera, resolution, scale):
    """Convert a Blender camera without notes, for square hologram pixels.

    Parameters
    ----------
    camera : bpy.types.Object
        A camera object, evaluated, or the original as its last evaluation left it.
    resolution : tuple of int
        Width and height of the hologram's pictures, `Hologram.picture`.
    scale : float
        Meters a Blender unit.

    Returns
    -------
    Camera

    Raises
    ------
    InvalidInput
        If the camera is not a perspective one, or its transform is degenerate.
    """
    data = camera.data
    if data.type != "PERSP":
        kind = {"ORTHO": "orthographic", "PANO": "panoramic"}.get(data.type, data.type.lower())
        raise InvalidInput(
            f"The camera '{camera.name}' is {kind}: a hologram needs a perspective camera, so set its lens "
            "type to Perspective."
        )
    width, height = resolution
    horizontal = data.sensor_fit == "HORIZONTAL" or (data.sensor_fit == "AUTO" and width >= height)
    sensor = data.sensor_height if data.sensor_fit == "VERTICAL" else data.sensor_width
    fitted = width if horizontal else height  # the side, in pixels, that the sensor size spans
    tan_half_x = 0.5 * sensor / data.lens * width / fitted
    return Camera(
        to_world=_rigid(np.array(camera.matrix_world, dtype=np.float64), scale, camera.name),
        fov_x=2 * math.atan(tan_half_x),
        shift_x=data.shift_x * fitted / width,
        shift_y=data.shift_y * fitted / width,
        clip_start=data.clip_start * scale,
        clip_end=data.clip_end * scale,
    )


def about(origin, camera):
    """The camera in coordinates relative to `origin`, meters."""
    to_world = camera.to_world.copy()
    to_world[:3, 3] -= origin
    return dataclasses.replace(camera, to_world=to_world)


def depth_of(camera, thing, scale):
    """Depth of an object's origin along a camera's axis, meters; negative behind the camera."""
    eye = camera.matrix_world
    offset = thing.matrix_world.translation - eye.translation
    return -offset.dot(eye.to_3x3().col[2].normalized()) * scale


def _rigid(matrix, scale, name):
    """Drop scale, as Blender does, and shear, which a hologram's camera cannot have; keep mirroring."""
    axes = matrix[:3, :3]
    if not np.isfinite(matrix).all() or abs(np.linalg.det(axes)) < 1e-30:
        raise InvalidInput(f"The transform of camera '{name}' is degenerate. Clear its scale (Alt S).")
    back = axes[:, 2] / np.linalg.norm(axes[:, 2])
    up = axes[:, 1] - back * (back @ axes[:, 1])
    up /= np.linalg.norm(up)
    right = np.cross(up, back)
    if right @ axes[:, 0] < 0:
        right = -right  # a negative scale mirrors the view
    rigid = np.eye(4)
    rigid[:3, :3] = np.stack([right, up, back], axis=1)
    rigid[:3, 3] = matrix[:3, 3] * scale
    return rigid


def _note_differences(scene, camera, notes):
    axes = np.array(camera.matrix_world.to_3x3(), dtype=np.float64)
    axes /= np.linalg.norm(axes, axis=0)
    if abs(axes.T @ axes - np.eye(3)).max() > 1e-3:
        notes.add(
            camera.name,
            "Sheared camera (rotated in an unequally scaled parent)",
            "rendered without the shear",
        )
    if camera.data.dof.use_dof:
        notes.add(camera.name, "Depth of Field", "ignored: a hologram is focused when it is viewed")
    if scene.render.pixel_aspect_x != scene.render.pixel_aspect_y:
        notes.add(camera.name, "Pixel aspect", "ignored: a hologram's pixels have the display's pitch")
    if scene.render.use_border:
        notes.add(camera.name, "Render Region", "ignored: the whole view is rendered")
    cycles = getattr(scene, "cycles", None)  # which is not there where Blender's add-on for Cycles is off
    if scene.render.film_transparent and cycles and cycles.film_transparent_glass:
        notes.add(scene.name, "Transparent Glass of the film", "ignored: the world is seen through glass")
    if scene.render.use_motion_blur:
        notes.add(camera.name, "Motion Blur", "ignored")
