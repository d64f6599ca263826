"""Add > HoloPath Picture With Depth."""

import bpy
import numpy as np
import pytest

from holopath_addon import output
from holopath_addon.engine.scene import variants
from holopath_addon.operators.pictures import draw_options
from tests.addon.layout import Context, Layout

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
    """What is exported of it again is the picture, at its depths, wherever the camera stands."""
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
    seen = depth_map(exported.scene, exported.camera, SIDE, SIDE)
    np.testing.assert_allclose(seen, files[3], rtol=1e-3)
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
        ({"unit": "inverse", "far": 0.1, "near": 0.5}, "far one larger"),
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
