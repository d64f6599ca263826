"""Places of the overlay, against Blender's own projection; the drawing itself needs a window."""

import math
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector

from holopath_addon import engine
from holopath_addon.blender import properties
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.export import view_of
from holopath_addon.operators import session
from holopath_addon.ui import overlay


@pytest.fixture
def turned(scene):
    """A camera with everything that moves its frame, in a scene whose unit is a centimeter."""
    data, props = scene.camera.data, scene.holopath
    data.sensor_width, data.sensor_height, data.lens = 30, 20, 40
    data.shift_x, data.shift_y, data.clip_end = 0.13, -0.21, 5000
    scene.camera.location, scene.camera.rotation_euler = (1, -2, 3), (0.7, 0.2, 0.4)
    scene.unit_settings.scale_length = 0.01
    props.near_auto, props.near = False, 0.4
    for meters in (0.5, 2.0, math.inf):
        properties.set_focus(props.focus_list.add(), meters)
    properties.set_focus(props, 2.0)
    return scene


def by_label(scene):
    return {outline.label: outline for outline in overlay.outlines(scene)}


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(96, 48), (48, 96)])
def test_frames_fill_the_view(turned, fit, size):
    turned.camera.data.sensor_fit = fit
    turned.holopath.resolution_x, turned.holopath.resolution_y = size
    turned.render.resolution_x, turned.render.resolution_y = size
    bpy.context.view_layer.update()
    found = by_label(turned)
    for label, depth in {
        "0.5 m (2 D)": 50,
        "2 m (0.5 D)": 200,
        "∞ (0 D)": 5000,  # the camera's end
        "Near End 0.4 m (2.5 D)": 40,
    }.items():
        corners = [
            world_to_camera_view(turned, turned.camera, Vector(corner)) for corner in found[label].corners
        ]
        expected = [(0, 1, depth), (0, 0, depth), (1, 0, depth), (1, 1, depth)]
        np.testing.assert_allclose(corners, expected, rtol=1e-4, atol=1e-4)
    assert found["2 m (0.5 D)"].color == overlay._FOCUS != found["0.5 m (2 D)"].color


def test_pupil_is_where_the_engine_has_it(turned):
    props, camera = turned.holopath, turned.camera
    props.use_pupil, props.pupil_offset_mm, props.pupil_diameter_mm = True, (3.0, -1.0), 2.0
    bpy.context.view_layer.update()
    found = [outline for outline in overlay.outlines(turned) if outline.at_camera]
    hologram = properties.hologram_of(props)
    mapping = DepthMapping.of(hologram, view_of(camera, (hologram.width, hologram.height), 0.01))
    radii = [mapping.pupil_radius(hologram.max_slope(w)) for w in hologram.wavelengths]
    assert found[0].label == f"Pupil {2e3 * radii[2]:.3g} to {2e3 * radii[0]:.3g} mm"
    to_camera = camera.matrix_world.inverted()
    for outline, radius, center in zip(found, [*radii, 1e-3], [(0, 0)] * 3 + [(3e-3, -1e-3)], strict=True):
        local = np.array([to_camera @ Vector(corner) for corner in outline.corners]) * 0.01
        np.testing.assert_allclose(np.hypot(*(local[:, :2] - center).T), radius, rtol=1e-3)
        np.testing.assert_allclose(local[:, 2], 0, atol=1e-6)


def test_near_end_of_the_last_plan(turned):
    turned.holopath.near_auto = True
    assert len(overlay.outlines(turned)) == 3  # the distances: the rest is not known yet
    session.current.plan, session.current.plan_scene = SimpleNamespace(near=0.25), turned.name
    assert "Near End 0.25 m (4 D)" in by_label(turned)
    turned.holopath.depth_mapping = "eyepiece"
    session.current.plan = None
    assert any(label.startswith("Near End") for label in by_label(turned))
    turned.holopath.depth_near_mm = turned.holopath.depth_far_mm - 1  # no hologram: its frames remain
    assert len(overlay.outlines(turned)) == 3


def test_nothing_to_draw(turned, monkeypatch):
    """No camera, or one without a hologram: an error for `outlines`, nothing for the viewport."""
    space = SimpleNamespace(overlay=SimpleNamespace(show_overlays=True), show_region_ui=True)
    tab = SimpleNamespace(type="UI", active_panel_category="HoloPath")
    context = SimpleNamespace(
        scene=turned,
        space_data=space,
        area=SimpleNamespace(regions=[tab]),
        region_data=SimpleNamespace(view_perspective="PERSP"),
    )
    assert len(overlay._visible_outlines(context)) == 7
    context.region_data.view_perspective = "CAMERA"
    assert len(overlay._visible_outlines(context)) == 4  # the pupil lies in the eye
    tab.active_panel_category = "View"
    assert overlay._visible_outlines(context) == []
    turned.render.engine = "HOLOPATH"
    assert len(overlay._visible_outlines(context)) == 4
    space.overlay.show_overlays = False
    assert overlay._visible_outlines(context) == []
    space.overlay.show_overlays = True
    turned.holopath.show_overlay = False
    assert overlay._visible_outlines(context) == []
    turned.holopath.show_overlay = True
    for spoil in (
        lambda: setattr(turned.camera.data, "type", "ORTHO"),
        lambda: setattr(turned, "camera", turned.objects["Wall"]),
        lambda: setattr(turned, "camera", None),
    ):
        spoil()
        with pytest.raises(engine.InvalidInput):
            overlay.outlines(turned)
        assert overlay._visible_outlines(context) == []


def test_what_lens_and_stop_leave_is_drawn(turned):
    """Frames are those of the picture, a square behind a lens; the pupil is where the stop is open."""
    props = turned.holopath
    props.resolution_x, props.resolution_y, optics = 96, 48, props.optics

    def aspect():
        corners = by_label(turned)["2 m (0.5 D)"].corners
        return np.linalg.norm(corners[3] - corners[0]) / np.linalg.norm(corners[1] - corners[0])

    assert aspect() == pytest.approx(2)
    optics.use_lens = True
    assert aspect() == pytest.approx(1)
    optics.use_lens, optics.stop = False, "half"
    hologram = properties.hologram_of(props)
    circle = next(o for o in overlay.outlines(turned) if o.at_camera)
    x, y, radius = hologram.optics.stop_circle
    mapping = DepthMapping.of(hologram, view_of(turned.camera, (96, 48), 0.01), 0.4)
    reach = mapping.pupil_radius(hologram.max_slope(max(hologram.wavelengths)))
    to_camera = turned.camera.matrix_world.inverted()
    local = np.array([to_camera @ Vector(corner) for corner in circle.corners])[:, :2] * 0.01
    np.testing.assert_allclose(local.mean(0), (x * reach, y * reach), atol=1e-3 * reach)
    np.testing.assert_allclose(np.hypot(*(local - local.mean(0)).T), radius * reach, rtol=1e-3)
