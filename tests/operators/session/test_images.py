"""Image datablocks of the results."""

import bpy

from holopath_addon.operators import session


def test_another_resolution_takes_the_same_image(scene):
    bpy.ops.holopath.render_hologram()
    image = bpy.data.images[session.IMAGE]
    scene.holopath.resolution_x = 48
    bpy.ops.holopath.render_hologram()
    assert bpy.data.images[session.IMAGE] == image and tuple(image.size) == (48, 64)
    assert sum(i.name.startswith("HoloPath") for i in bpy.data.images) == 1


def test_a_saved_picture_is_the_users(scene, tmp_path):
    bpy.ops.holopath.render_hologram()
    image = bpy.data.images[session.IMAGE]
    image.filepath_raw, image.file_format = str(tmp_path / "kept.png"), "PNG"
    image.save()
    saved = (tmp_path / "kept.png").read_bytes()
    scene.holopath.focus = 2.0
    assert bpy.data.images[session.IMAGE] != image
    assert (tmp_path / "kept.png").read_bytes() == saved
