"""Blender's camera against its own projection."""

import json
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon import engine  # noqa: E402
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
    data.clip_end = 90
    stage.camera.location, stage.camera.rotation_euler = (1, -2, 3), (0.7, 0.2, 0.4)
    stage.camera.scale = (2, 2, 2)
    stage.scene.unit_settings.scale_length = scale
    stage.scene.render.resolution_x, stage.scene.render.resolution_y = resolution
    camera = stage.export(resolution).camera
    assert (camera.clip_start, camera.clip_end) == pytest.approx((0.25 * scale, 90 * scale))
    for point in [(0, 0, 0), (0.5, 0.3, -0.2), (-1, 1, 0.1)]:
        from mathutils import Vector

        expected = world_to_camera_view(stage.scene, stage.camera, Vector(point))[:2]
        assert project(camera, np.array(point) * scale, resolution) == pytest.approx(expected, abs=1e-5)


def colored_corners(stage):
    """Panels of pure colors in three corners of the view."""
    for color, place in (
        ((1, 0, 0, 1), (-0.5, -0.4)),
        ((0, 1, 0, 1), (0.5, -0.4)),
        ((0, 0, 1, 1), (-0.5, 0.5)),
    ):
        stage.plane(0.3, stage.material("ShaderNodeEmission", Color=color), location=(*place, 0))


def centers(image):
    """Position of each channel's light, pixels, shape (3, 2)."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([[(c * x).sum(), (c * y).sum()] / c.sum() for c in np.moveaxis(image, 2, 0)])


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("resolution", [(48, 32), (32, 48)])
def test_shows_what_cycles_shows(stage, fit, resolution):
    colored_corners(stage)
    data = stage.camera.data
    data.sensor_fit, data.sensor_width, data.sensor_height = fit, 30, 20
    data.lens, data.shift_x, data.shift_y = 28, 0.13, -0.07
    ours, theirs = (render(resolution, spp=64) for render in (stage.mitsuba, stage.cycles))
    assert centers(ours) == pytest.approx(centers(theirs), abs=0.15)


@pytest.mark.parametrize(
    "scale", [(2, 0.5, 3), (-1, 1, 1), (1, -2, 1), (-1, -1, 1), (1, 1, -1), (-1, -1, -1)]
)
def test_scaled_and_mirrored_cameras(stage, scale):
    colored_corners(stage)
    stage.camera.scale = scale
    stage.camera.location.z *= np.sign(scale[2])
    ours, theirs = (render((48, 48), spp=64) for render in (stage.mitsuba, stage.cycles))
    assert centers(ours) == pytest.approx(centers(theirs), abs=0.15)
    assert stage.export().notes == []


def test_mirrored_cameras_have_mirrored_holograms(stage):
    colored_corners(stage)
    stage.camera.scale = (-1, 1, 1)
    stage.camera.data.shift_x = 0.05
    exported = stage.export((96, 96))
    hologram = engine.Hologram(96, 96, 8e-6, (640e-9, 516.5e-9, 455.4e-9), 0.3e-3, 1.8e-3)
    field = engine.render(exported.scene, exported.camera, hologram, engine.Settings(frames=8))
    (picture,) = engine.reconstruct(field, [4.0])
    (truth,) = engine.reference(exported.scene, exported.camera, hologram, [4.0], spp=16, near=field.near)
    theirs = centers(stage.cycles((96, 96), spp=64))
    assert centers(truth) == pytest.approx(theirs, abs=0.3)
    assert centers(picture) == pytest.approx(theirs, abs=2)


def test_parented_cameras(stage):
    colored_corners(stage)
    parent = stage.link(bpy.data.objects.new("parent", None))
    parent.location, parent.rotation_euler, parent.scale = (0.2, -0.1, 1), (0.1, -0.05, 0.4), (1.5, 1.5, 1.5)
    stage.camera.parent, stage.camera.location = parent, (0, 0, 2)
    ours, theirs = (render((48, 48), spp=64) for render in (stage.mitsuba, stage.cycles))
    assert centers(ours) == pytest.approx(centers(theirs), abs=0.15)
    assert stage.export().notes == []
    parent.scale, stage.camera.rotation_euler = (2, 1, 1), (0, 0, 0.6)
    bpy.context.view_layer.update()
    assert [note.feature.split(" (")[0] for note in stage.export().notes] == ["Sheared camera"]


@pytest.mark.parametrize("clip", [dict(clip_start=4.3), dict(clip_end=4.4)])
@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_clips_where_cycles_does(stage, clip, scale):
    """A slanted floor is cut along a line, and the world is seen beyond."""
    slope = stage.plane(8, stage.material("ShaderNodeEmission", Color=(1, 1, 1, 1)), location=(0, 0, -0.5))
    slope.rotation_euler = (1, 0, 0)
    stage.world((0.2, 0.3, 0.4))
    stage.scene.unit_settings.scale_length = scale
    for name, depth in clip.items():
        setattr(stage.camera.data, name, depth)
    ours, theirs = (render((48, 48), spp=64) for render in (stage.mitsuba, stage.cycles))
    assert 0.3 < (theirs[..., 0] > 0.9).mean() < 0.7
    assert np.abs(ours - theirs).mean() < 0.005


def view(exported, focus, resolution=(48, 48), spp=256):
    """The engine's own reference picture, all in focus."""
    hologram = engine.Hologram(*resolution, 8e-6, (640e-9, 516.5e-9, 455.4e-9), 0.3e-3, 1.8e-3)
    return engine.reference(exported.scene, exported.camera, hologram, [focus], spp=spp)[0]


def black_around(stage, exported):
    """The world is not seen, and lights the middle as in Cycles."""
    ours, theirs = view(exported, 4.0), stage.cycles((48, 48), depth=8)
    assert theirs[:8].max() == 0 and np.abs(ours[:8]).max() < 1e-4
    middle = (slice(18, 30), slice(18, 30))
    assert ours[middle].mean((0, 1)) == pytest.approx(theirs[middle].mean((0, 1)), rel=0.02)


@pytest.mark.parametrize("case", ["diffuse", "mirror", "transparent", "glass"])
def test_transparent_film(stage, case):
    """The world lights a ball's stand-in, a tilted plate, and is seen in mirrors and through glass, not around."""
    if case == "diffuse":
        material = stage.material("ShaderNodeBsdfDiffuse", Color=(0.8, 0.5, 0.2, 1))
    elif case == "mirror":
        material = stage.material("ShaderNodeBsdfAnisotropic", Color=(0.8, 0.5, 0.2, 1), Roughness=0.0)
    elif case == "glass":
        material = stage.material("ShaderNodeBsdfGlass", Roughness=0.0)
    else:
        material = stage.material("ShaderNodeBsdfDiffuse", Color=(0.8, 0.5, 0.2, 1))
        stage.mix(material, "ShaderNodeBsdfTransparent", 0.6)
    plate = stage.plane(1.2, material)
    plate.rotation_euler = (0.1, 0, 0)
    if case == "glass":
        bpy.data.objects.remove(plate)
        stage.sphere(0.6, material)
    stage.world((0.5, 0.6, 0.7))
    stage.scene.render.film_transparent = True
    exported = stage.export((48, 48))
    assert exported.notes == [] and not exported.camera.sees_sky
    black_around(stage, exported)
    stage.scene.render.film_transparent = False
    assert stage.export((48, 48)).camera.sees_sky


def test_a_world_of_the_view_layer_that_cameras_do_not_see(stage):
    """It lights the scene, in the place of the scene's, and is black around it: as Cycles has it."""
    stage.world((0.5, 0.6, 0.7))
    stage.plane(1.2)
    own = bpy.data.worlds.new("own")
    own.use_nodes = True
    own.node_tree.nodes["Background"].inputs["Color"].default_value = (0.1, 0.8, 0.2, 1)
    bpy.context.view_layer.world_override = own
    own.cycles_visibility.camera = False
    exported = stage.export((48, 48))
    assert exported.notes == [] and not exported.camera.sees_sky
    black_around(stage, exported)


def test_transparent_glass_of_the_film_is_noted(stage):
    stage.plane()
    stage.world()
    stage.scene.cycles.film_transparent_glass = True
    assert stage.export().notes == []
    stage.scene.render.film_transparent = True
    assert [note.feature for note in stage.export().notes] == ["Transparent Glass of the film"]


def test_exposure_is_not_baked_in(stage):
    stage.plane(6, stage.material("ShaderNodeEmission", Color=(0.3, 0.2, 0.1, 1)))
    stage.scene.view_settings.exposure = 2
    stage.scene.view_settings.gamma = 2
    stage.scene.cycles.film_exposure = 4
    assert stage.mitsuba(spp=4).mean((0, 1)) == pytest.approx((0.3, 0.2, 0.1), rel=1e-3)
    assert stage.cycles(spp=4).mean((0, 1)) == pytest.approx((1.2, 0.8, 0.4), rel=1e-3)


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
