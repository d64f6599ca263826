"""F12 with the engine HOLOPATH."""

import json

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.farm.job import SharedJob
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


def test_pictures_of_pixels_that_are_not_square(f12, tmp_path):
    """F12's pixels are those of the picture, and the panel has as many of its own as that takes; depths, too."""
    f12.holopath.square_pixels, f12.holopath.pitch_um, f12.holopath.pitch_y_um = False, 6.4, 8.0
    f12.view_layers[0].use_pass_z = True
    f12.holopath.resolution_x, f12.holopath.resolution_y = 75, 40
    assert bpy.ops.holopath.match_output() == {"FINISHED"}
    assert (f12.render.resolution_x, f12.render.resolution_y) == (60, 40)
    bpy.ops.render.render(write_still=True)
    assert load(tmp_path / "picture.png").shape == (40, 60, 4)
    assert session.current.field.data.shape[-2:] == (40, 75)
    f12.view_layers[0].holopath.use_pass_phase = True
    with pytest.raises(RuntimeError, match="have the display's 75 x 40 pixels, and pictures 60 x 40"):
        bpy.ops.render.render()


def test_a_picture_behind_a_lens(f12, tmp_path):
    """It is square; with a share of the width it is of a larger panel."""
    f12.holopath.optics.use_lens = f12.holopath.optics.use_share = True
    f12.holopath.frames = 1
    with pytest.raises(
        RuntimeError, match="shows no picture of 60 x 40 pixels, but one of 40 x 40. Choose that"
    ):
        bpy.ops.render.render()
    f12.render.resolution_x = 80
    bpy.ops.render.render(write_still=True)
    assert load(tmp_path / "picture.png").shape == (40, 40, 4)
    assert session.current.field.data.shape[-2:] == (56, 56)  # of which 40 are 0.7, by even numbers


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


@pytest.fixture
def multilayer(f12, tmp_path):
    """The scene, to be rendered into a multilayer EXR of 32 bits; its channels, row 0 at the top, by their names."""
    settings = f12.render.image_settings
    if bpy.app.version >= (5, 0, 0):
        settings.media_type = "MULTI_LAYER_IMAGE"
        settings.use_exr_interleave = True  # in one part, which Mitsuba reads
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    f12.render.filepath = str(tmp_path / "layers.exr")

    def render():
        import mitsuba as mi

        bpy.ops.render.render(write_still=True)
        bitmap = mi.Bitmap(str(tmp_path / "layers.exr"))
        return {
            f.name: c for f, c in zip(bitmap.struct_(), np.moveaxis(np.array(bitmap), -1, 0), strict=True)
        }

    return render


def of_pass(channels, name, letters="RGB", layer="ViewLayer"):
    """A pass, array [y, x, channel]."""
    return np.stack([channels[f"{layer}.{name}.{letter}"] for letter in letters], axis=-1)


@pytest.mark.parametrize("colors", ["RGB", "MONO"])
def test_passes(f12, multilayer, monkeypatch, colors):
    from holopath_addon.blender import properties

    f12.holopath.colors, f12.holopath.phase_field = colors, "designed"
    f12.holopath.focus = 0.7
    f12.unit_settings.scale_length = 0.5
    monkeypatch.setattr(properties, "focus_list_of", lambda props: [0.5, 0.3333, float("inf")])
    layer = f12.view_layers[0]
    passes = layer.holopath
    passes.use_pass_focus = passes.use_pass_phase = passes.use_pass_amplitude = passes.use_pass_depth = True
    channels = multilayer()
    field = session.current.field
    wavelengths = field.hologram.wavelengths
    pictures = engine.to_rgb(engine.reconstruct(field, [0.7, 0.5, 0.3333, float("inf")]), wavelengths)
    names = ("Combined", "Focus 500 mm", "Focus 333_3 mm", "Focus inf")
    for picture, name in zip(pictures, names, strict=True):
        np.testing.assert_array_equal(of_pass(channels, name), picture)
    letters = "RGB" if colors == "RGB" else "X"
    phase, amplitude = (of_pass(channels, name, letters) for name in ("Phase", "Amplitude"))
    assert 0 <= phase.min() < 0.1 and 6.2 < phase.max() < 2 * np.pi
    wave = amplitude * np.exp(1j * phase)
    np.testing.assert_allclose(np.moveaxis(wave, -1, 0), field.data[0], atol=1e-6 * amplitude.max())
    depth = of_pass(channels, "Depth", "Z")[..., 0]
    assert depth[20, 30] == pytest.approx(0.5, rel=1e-4) and depth[2, 2] == pytest.approx(2.0, rel=1e-4)
    f12.objects["Wall"].hide_render = True
    assert of_pass(multilayer(), "Depth", "Z")[2, 2] == np.float32(1e10)  # as Cycles has it


def test_passes_in_the_compositor(f12):
    passes = f12.view_layers[0].holopath
    passes.use_pass_phase = passes.use_pass_depth = True
    f12.holopath.focus = 0.7
    if bpy.app.version >= (5, 0, 0):
        tree = f12.compositing_node_group = bpy.data.node_groups.new("Compositing", "CompositorNodeTree")
    else:
        f12.use_nodes, tree = True, f12.node_tree
    sockets = tree.nodes.new("CompositorNodeRLayers").outputs

    def enabled():
        return {socket.name for socket in sockets if socket.enabled}

    assert enabled() == {"Image", "Alpha", "Phase", "Depth"}
    passes.use_pass_focus, passes.use_pass_depth = True, False
    f12.update_render_engine()
    assert enabled() == {"Image", "Alpha", "Phase", "Focus 700 mm"}


def test_every_view_layer_has_its_own_picture(f12, multilayer):
    f12.holopath.focus = 0.5
    inside = bpy.data.collections.new("Inside")
    f12.collection.children.link(inside)
    near = f12.objects["Near"]
    f12.collection.objects.unlink(near)
    inside.objects.link(near)
    bare = f12.view_layers.new("Bare")
    bare.layer_collection.children["Inside"].exclude = True
    channels = multilayer()
    whole, without = (of_pass(channels, "Combined", layer=name)[20, 30, 0] for name in ("ViewLayer", "Bare"))
    assert whole > 3 * without > 0


@pytest.fixture
def kept(f12, tmp_path):
    """An animation of two frames whose wave fields are kept, and what renders it: names of frames, and renders."""
    near = f12.objects["Near"]
    near.keyframe_insert("location", frame=1)
    near.location.x = 0.1
    near.keyframe_insert("location", frame=2)
    f12.frame_start, f12.frame_end = 1, 2
    f12.holopath.focus = 0.7
    f12.holopath.keep_fields = True
    f12.holopath.animation_folder = str(tmp_path / "kept")
    f12.render.filepath = str(tmp_path / "picture_")

    def names():
        return sorted(p.name for p in (tmp_path / "kept").iterdir())

    return names


def test_animation_keeps_its_wave_fields(f12, kept, tmp_path, monkeypatch):
    bpy.ops.render.render(animation=True)
    assert kept() == ["frame_0001", "frame_0002"]
    stored = engine.WaveField.load(tmp_path / "kept" / "frame_0002" / "wavefield")
    np.testing.assert_array_equal(stored.data, session.current.field.data)
    report = json.loads((tmp_path / "kept" / "frame_0002" / "report.json").read_text())
    assert report["focus_m"] == [0.7] and report["export_notes"] == []
    first = load(tmp_path / "picture_0001.png")

    monkeypatch.setattr(engine, "render", lambda *_, **__: pytest.fail("rendered again"))
    bpy.ops.render.render(animation=True)
    np.testing.assert_array_equal(load(tmp_path / "picture_0001.png"), first)
    f12.holopath.focus = 2.0
    bpy.ops.render.render(animation=True)
    assert abs(load(tmp_path / "picture_0001.png") - first).max() > 0.1
    assert [p.name for p in (tmp_path / "kept" / "frame_0001" / "reconstruction").glob("*.exr")] == [
        "focus_2m.exr"
    ]


def test_a_canceled_animation_goes_on(f12, kept, monkeypatch):
    render, frames = engine.render, []

    def canceled_once(*arguments, **options):
        frames.append(None)
        if len(frames) == 1:
            raise engine.Cancelled
        return render(*arguments, **options)

    monkeypatch.setattr(engine, "render", canceled_once)
    bpy.ops.render.render(animation=True)  # in a window Esc would end it here
    assert kept() == ["frame_0002"] and session.current.error == ""
    bpy.ops.render.render(animation=True)
    assert kept() == ["frame_0001", "frame_0002"] and len(frames) == 3


def test_frames_of_another_animation_stay(f12, kept, tmp_path):
    """A folder where *Render Animation* has put another file's frames is refused, as by that button."""
    (tmp_path / "kept").mkdir()
    with SharedJob("another.blend", {}, {}, {}).join(tmp_path / "kept", ["frame_0001"]):
        pass
    with pytest.raises(RuntimeError, match="holds the animation of another.blend"):
        bpy.ops.render.render(animation=True)
    assert not [name for name in kept() if name.startswith("frame")]


def test_frames_of_another_scene_stay(f12, kept, tmp_path):
    bpy.ops.render.render(animation=True)
    before = (tmp_path / "kept" / "frame_0001" / "report.json").read_bytes()
    f12.name = "Another"
    with pytest.raises(RuntimeError, match="holds a frame of .*scene 'Scene', which would be replaced"):
        bpy.ops.render.render(animation=True)
    assert (tmp_path / "kept" / "frame_0001" / "report.json").read_bytes() == before


def test_stills_write_no_folder(f12, kept, tmp_path):
    f12.render.filepath = str(tmp_path / "picture.png")
    bpy.ops.render.render(write_still=True)
    assert not (tmp_path / "kept").exists()


def test_an_unsaved_file_has_no_place_for_wave_fields(f12, kept):
    f12.holopath.animation_folder = "//holopath"
    with pytest.raises(RuntimeError, match="save the .blend"):
        bpy.ops.render.render(animation=True)


def test_wave_fields_of_several_view_layers(f12, kept, tmp_path):
    f12.view_layers.new("Second")
    f12.frame_end = 1
    bpy.ops.render.render(animation=True)
    assert kept() == ["Second", "ViewLayer"]
    assert (tmp_path / "kept" / "Second" / "frame_0001" / "report.json").exists()


@pytest.mark.parametrize("crop", [False, True])
def test_render_region(f12, tmp_path, crop):
    """Blender takes a part of the picture, which is rendered whole: it is where it would be without."""
    f12.render.image_settings.file_format = "OPEN_EXR"
    f12.render.image_settings.color_depth = "32"
    f12.render.filepath = str(tmp_path / "picture.exr")
    f12.holopath.focus = 0.7
    f12.render.use_border, f12.render.use_crop_to_border = True, crop
    f12.render.border_min_x, f12.render.border_max_x = 0.21, 0.77
    f12.render.border_min_y, f12.render.border_max_y = 0.13, 0.52
    bpy.ops.render.render(write_still=True)
    found = load(tmp_path / "picture.exr")[..., :3]
    whole = engine.reconstruct(session.current.field, [0.7])[0]
    rows, columns = slice(40 - int(0.52 * 40), 40 - int(0.13 * 40)), slice(int(0.21 * 60), int(0.77 * 60))
    if not crop:
        assert found.shape[:2] == (40, 60) and not found[0].any()
        found = found[rows, columns]
    expected = whole[rows, columns]
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-5)


def test_the_pass_of_automatic_focusing(f12, multilayer):
    """It is the picture's, by one name in each frame, whatever distance was found before."""
    f12.holopath.focus_auto = True
    f12.view_layers[0].holopath.use_pass_focus = True
    channels = multilayer()
    np.testing.assert_array_equal(of_pass(channels, "Focus Auto"), of_pass(channels, "Combined"))
    assert not any("mm" in name for name in channels)
