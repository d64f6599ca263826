"""Captures in Blender: a picture with depth, and views."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.engine.scene import variants
from holopath_addon.operators import session
from holopath_addon.operators.pictures import HOLOPATH_OT_render_views, draw_options, draw_view_options
from holopath_addon.workflow import output
from tests.ui.layout import Context, Layout

SIDE = 12


@pytest.fixture
def files(tmp_path):
    """A picture of 12 x 12 pixels, near in its middle, and its depth in millimeters."""
    rng = np.random.default_rng(0)
    image = rng.uniform(0.1, 1, (SIDE, SIDE, 3)).astype(np.float32)
    depth = np.full((SIDE, SIDE), 2000, np.uint16)
    depth[4:8, 5:9] = 500
    bitmap = variants.bitmaps().Bitmap
    (tmp_path / "photo.exr").write_bytes(output.encode_exr(image))
    bitmap(depth).write(str(tmp_path / "depth.png"))
    return tmp_path / "photo.exr", tmp_path / "depth.png", image, depth * 1e-3


def add(files, **options):
    return bpy.ops.holopath.add_picture(
        picture=str(files[0]), filepath=str(files[1]), **{"unit": "mm", **options}
    )


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_the_scenes_camera_sees_the_picture(scene, files, scale):
    """The exported mesh is the picture at its depths, wherever the camera stands."""
    from holopath_addon.engine.viewing.depth import depth_map
    from holopath_addon.engine.viewing.preview import Preview
    from holopath_addon.export import export_scene

    for name in ("Near", "Wall"):
        bpy.data.objects.remove(scene.objects[name])
    scene.unit_settings.scale_length = scale
    scene.camera.location, scene.camera.rotation_euler = (3, 2, 1), (0.3, 0.2, 0.5)
    assert add(files) == {"FINISHED"}
    added = bpy.context.view_layer.objects.active
    assert added.name == "photo" and added.select_get()
    exported = export_scene(bpy.context.evaluated_depsgraph_get(), (SIDE, SIDE))
    depths = depth_map(exported.scene, exported.camera, SIDE, SIDE)
    np.testing.assert_allclose(depths, files[3], rtol=1e-3)
    shown = Preview(exported.scene, exported.camera, SIDE, SIDE).refine(4, lambda *_: None)
    np.testing.assert_allclose(shown, files[2], rtol=2e-3)


def test_it_can_be_undone(scene, files):
    """Undo itself needs a window; the operator declares it, and adds one object."""
    before = set(scene.objects.keys())
    assert add(files) == {"FINISHED"} and set(scene.objects.keys()) - before == {"photo"}
    assert {"REGISTER", "UNDO"} <= bpy.types.HOLOPATH_OT_add_picture.bl_options


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"unit": "none"}, "choose a Unit of m, mm, diopters, inverse"),
        ({"filepath": "nowhere.png"}, "does not exist"),
        ({"unit": "inverse", "far": 0.1, "near": 0.5}, "The ends of inverse depths"),
    ],
)
def test_what_it_refuses(scene, files, options, text):
    before = {type(b).__name__ + b.name for b in [*bpy.data.objects, *bpy.data.meshes, *bpy.data.materials]}
    with pytest.raises(RuntimeError, match=text):
        bpy.ops.holopath.add_picture(
            **{"picture": str(files[0]), "filepath": str(files[1]), "unit": "mm", **options}
        )
    after = {type(b).__name__ + b.name for b in [*bpy.data.objects, *bpy.data.meshes, *bpy.data.materials]}
    assert after == before


def test_what_the_file_browser_shows(scene):
    options = bpy.context.window_manager.operator_properties_last("holopath.add_picture")
    shown = {}
    for unit in ("mm", "inverse"):
        layout = Layout(Context(scene))
        options.unit = unit
        draw_options(layout, options)
        shown[unit] = layout.all("prop", "property")
    assert shown == {"mm": ["unit", "along", "fov"], "inverse": ["unit", "far", "near", "along", "fov"]}


def test_not_without_a_camera(scene):
    assert bpy.ops.holopath.choose_picture.poll()
    scene.camera = None
    assert not bpy.ops.holopath.choose_picture.poll() and not bpy.ops.holopath.add_picture.poll()


@pytest.fixture
def views(scene, tmp_path):
    """A file of 3 x 2 views of 16 x 12 pixels, and them; settings that take a second."""
    array = np.random.default_rng(0).uniform(0.1, 1, (2, 3, 12, 16, 3)).astype(np.float32)
    np.save(tmp_path / "views.npy", array)
    scene.holopath.resolution_x, scene.holopath.resolution_y = 32, 24
    scene.holopath.frames, scene.holopath.quality, scene.holopath.colours = 1, "draft", "MONO"
    return str(tmp_path / "views.npy"), array


def test_views_become_a_hologram(scene, views):
    """The field is that of the same views in Python, whatever is in the scene; it is shown, and can be encoded."""
    path, array = views
    kept = {"right": 0.02, "down": 0.01, "focus": 0.8, "fov": 30.0}
    assert bpy.ops.holopath.render_views(filepath=path, **kept) == {"FINISHED"}
    field, task = session.current.field, session.current.task
    assert field.data.shape == (1, 1, 24, 32) and session.IMAGE in bpy.data.images
    assert task.request.settings.method == "light-field" and session.current.field_scene == scene.name
    built, camera = engine.view_scene(array, (0.02, 0.01), 0.8, np.radians(30))
    expected = engine.render(built, camera, field.hologram, task.request.settings)
    np.testing.assert_allclose(field.data, expected.data, atol=1e-5 * abs(expected.data).max())
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    assert bpy.ops.holopath.render_hologram() == {"FINISHED"}  # the scene itself again
    assert session.current.task.request.settings.method != "light-field"


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({}, "give Right, the meters from the first to the last of a row, and Down"),
        ({"right": 0.1, "down": 0.1, "parallel": True}, "give Panel, a distance in the middle"),
        ({"right": 0.1}, "Expected 2 numbers for --view-span of 3 x 2 views in"),
        ({"right": 0.1, "filepath": "nowhere.npy"}, "do not exist: choose a file"),
    ],
)
def test_what_views_refuse(views, options, text):
    before = session.current.field
    with pytest.raises(RuntimeError, match=text):
        bpy.ops.holopath.render_views(**{"filepath": views[0], **options})
    assert session.current.field is before and text[:9] in session.current.error


def test_what_the_file_browser_shows_of_views(scene):
    options = bpy.context.window_manager.operator_properties_last("holopath.render_views")
    shown = {}
    for parallel in (False, True):
        layout = Layout(Context(scene))
        options.parallel = parallel
        draw_view_options(layout, options)
        shown[parallel] = layout.all("prop", "property")
    assert shown[False] == ["right", "down", "parallel", "focus", "panel", "fov"]
    assert shown[True] == ["right", "down", "parallel", "panel", "fov"]


def test_views_after_the_file_browser(views):
    """Blender ends the operator that asked for the file: another one renders, with all that was said."""

    class RecordingLayout:
        _browsing = True
        poll = staticmethod(lambda context: True)

        def as_keywords(self, ignore):
            return {"filepath": views[0], "right": 0.02, "down": 0.01, "parallel": True}

    assert hasattr(bpy.types.Operator, "as_keywords")
    with pytest.raises(RuntimeError, match="give Panel"):
        HOLOPATH_OT_render_views.execute(RecordingLayout(), bpy.context)
