"""Blender's camera against its own projection."""

import json
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.engine import InvalidInput  # noqa: E402


def project(camera, point, resolution):
    """Pixel position (fractions from the left and bottom) by the engine camera's definition."""
    local = np.linalg.inv(camera.to_world) @ np.append(point, 1)
    x, y = local[:2] / -local[2] / (2 * math.tan(camera.fov_x / 2))
    width, height = resolution
    return 0.5 + x - camera.shift_x, 0.5 + (y - camera.shift_y) * width / height


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("resolution", [(64, 64), (96, 48), (48, 96)])
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_projects_as_blender_does(stage, fit, resolution, scale):
    from bpy_extras.object_utils import world_to_camera_view

    stage.plane()
    data = stage.camera.data
    data.sensor_fit, data.sensor_width, data.sensor_height = fit, 30, 20
    data.lens, data.shift_x, data.shift_y, data.clip_start = 40, 0.13, -0.21, 0.25
    stage.camera.location, stage.camera.rotation_euler = (1, -2, 3), (0.7, 0.2, 0.4)
    stage.camera.scale = (2, 2, 2)
    stage.scene.unit_settings.scale_length = scale
    stage.scene.render.resolution_x, stage.scene.render.resolution_y = resolution
    camera = stage.export(resolution).camera
    assert camera.clip_start == pytest.approx(0.25 * scale)
    for point in [(0, 0, 0), (0.5, 0.3, -0.2), (-1, 1, 0.1)]:
        from mathutils import Vector

        expected = world_to_camera_view(stage.scene, stage.camera, Vector(point))[:2]
        assert project(camera, np.array(point) * scale, resolution) == pytest.approx(expected, abs=1e-5)


def test_takes_the_named_camera(stage):
    stage.plane()
    other = stage.link(bpy.data.objects.new("second", bpy.data.cameras.new("second")))
    other.location = (5, 0, 0)
    bpy.context.view_layer.update()
    assert stage.export(camera="second").camera.position == pytest.approx((5, 0, 0))
    assert stage.export(camera=other).camera.position == pytest.approx((5, 0, 0))
    with pytest.raises(InvalidInput, match="no object 'third'"):
        stage.export(camera="third")
    with pytest.raises(InvalidInput, match="'plane' is not a camera"):
        stage.export(camera="plane")


def test_refuses_what_has_no_hologram(stage):
    stage.plane()
    stage.camera.data.type = "ORTHO"
    with pytest.raises(InvalidInput, match="orthographic.*Perspective"):
        stage.export()
    stage.camera.data.type = "PANO"
    with pytest.raises(InvalidInput, match="panoramic"):
        stage.export()
    stage.scene.camera = None
    with pytest.raises(InvalidInput, match="no active camera"):
        stage.export()


def test_notes_what_a_hologram_ignores(stage):
    stage.plane()
    stage.world()
    assert stage.export().notes == []
    stage.camera.data.dof.use_dof = True
    stage.scene.render.pixel_aspect_x = 2
    notes = stage.export().notes
    assert {note.feature for note in notes} == {"Depth of Field", "Pixel aspect"}
    assert json.loads(json.dumps([note.to_dict() for note in notes]))[0]["object"] == "camera"
