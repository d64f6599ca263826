"""F12 with the engine HOLOPATH."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.operators import session


@pytest.fixture
def f12(scene, tmp_path):
    """The scene, to be rendered with HoloPath into a PNG."""
    scene.render.engine = "HOLOPATH"
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 120, 80, 50
    scene.render.image_settings.file_format = "PNG"
    scene.render.filepath = str(tmp_path / "picture.png")
    return scene


def load(path):
    """Pixels of a picture file as Blender reads it, row 0 at the top."""
    image = bpy.data.images.load(str(path))
    pixels = np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], 4)[::-1]
    bpy.data.images.remove(image)
    return pixels


def test_png(f12, tmp_path):
    assert bpy.ops.render.render(write_still=True) == {"FINISHED"}
    picture = load(tmp_path / "picture.png")
    assert picture.shape == (40, 60, 4)
    assert session.current.field.data.shape == (4, 3, 40, 60)
    inside, outside = picture[18:26, 28:33, 0].mean(), picture[:5, :, 0].mean()
    assert inside > 2 * outside > 0


def test_pixels_are_the_reconstruction(f12, tmp_path):
    f12.holopath.focus = 0.7
    f12.render.image_settings.file_format = "OPEN_EXR"
    f12.render.image_settings.color_depth = "32"
    f12.render.filepath = str(tmp_path / "picture.exr")
    bpy.ops.render.render(write_still=True)
    expected = engine.reconstruct(session.current.field, [0.7])[0]
    np.testing.assert_allclose(load(tmp_path / "picture.exr")[..., :3], expected, rtol=1e-3, atol=1e-5)
    f12.holopath.focus = 2.0  # refocuses what F12 has rendered
    assert tuple(bpy.data.images[session.IMAGE].size) == (60, 40)


def test_animation(f12, tmp_path):
    near = f12.objects["Near"]
    near.keyframe_insert("location", frame=1)
    near.location.x = 0.1
    near.keyframe_insert("location", frame=2)
    f12.frame_start, f12.frame_end = 1, 2
    f12.render.filepath = str(tmp_path / "frame_")
    bpy.ops.render.render(animation=True)
    first, second = (load(tmp_path / f"frame_000{n}.png")[..., 0] for n in (1, 2))
    columns = np.arange(60)
    assert (second.mean(0) @ columns / second.sum() - first.mean(0) @ columns / first.sum()) * 40 > 1


@pytest.mark.parametrize("file_format", ["PNG", "OPEN_EXR_MULTILAYER"])
def test_errors_are_reported(f12, tmp_path, file_format):
    if bpy.app.version >= (5, 0, 0) and file_format == "OPEN_EXR_MULTILAYER":
        f12.render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    f12.render.image_settings.file_format = file_format
    f12.objects["Near"].data.vertices[0].co.x = float("nan")
    with pytest.raises(RuntimeError, match="Near"):
        bpy.ops.render.render(write_still=True)
    assert "Near" in session.current.error


def test_no_camera(f12):
    f12.camera = None
    with pytest.raises(RuntimeError, match="camera"):
        bpy.ops.render.render()
