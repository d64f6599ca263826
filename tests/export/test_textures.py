"""Images as Cycles samples them: between encoded values, by their alpha, mapping and frame."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

EMISSION = "ShaderNodeEmission"
NOISE = np.random.default_rng(1).random((80, 80, 3)) ** 2
CHECKER = np.repeat((np.indices((8, 8)).sum(0) % 2)[..., None], 3, axis=2).astype(float)
FEW = NOISE[:6, :6]
ALPHA = np.kron(0.2 + 0.8 * np.random.default_rng(2).random((6, 6)), np.ones((2, 2)))
LINEAR = dict(float_buffer=True, space="Linear Rec.709")


def features(exported):
    return {note.feature for note in exported.notes}


def assert_alike(stage, spp=64, notes=frozenset()):
    """Blocks of 8 x 8 pixels within a share of those of Cycles' picture, or of its mean where that is more."""
    exported = stage.export()
    ours, theirs = stage.mitsuba(spp=spp, exported=exported), stage.cycles(spp=spp)
    assert theirs.std() > 0.05 * theirs.mean()
    ours, theirs = (image.reshape(4, 8, 4, 8, 3).mean((1, 3)) for image in (ours, theirs))
    assert np.abs((ours - theirs) / np.maximum(theirs, theirs.mean())).max() < 0.05
    assert features(exported) == set(notes)


def shown(stage, image, **settings):
    """The Image Texture of a plane that shines, and fills the view."""
    material = stage.material(EMISSION)
    texture = stage.texture(material, image, "Color")
    for name, value in settings.items():
        setattr(texture, name, value)
    stage.plane(2.85, material)
    return texture


@pytest.mark.parametrize("pixels", [CHECKER, NOISE], ids=["few texels", "2.5 texels a pixel"])
def test_srgb_is_decoded_after_interpolation(stage, pixels):
    shown(stage, stage.image(pixels))
    assert_alike(stage, spp=256 if pixels is NOISE else 64)


@pytest.mark.parametrize("interpolation", ["Cubic", pytest.param("Smart", marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", [{}, LINEAR], ids=["sRGB", "float"])
def test_cubic_interpolation(stage, interpolation, kind):
    shown(stage, stage.image(FEW, **kind), interpolation=interpolation)
    assert_alike(stage)


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["Linear", "Cubic", "Closest"])
@pytest.mark.parametrize("extension", ["REPEAT", "EXTEND", "CLIP", "MIRROR"])
def test_extension(stage, extension, interpolation):
    texture = shown(stage, stage.image(FEW), extension=extension, interpolation=interpolation)
    texture.texture_mapping.scale, texture.texture_mapping.translation = (2.2, 1.7, 1), (-0.4, -0.6, 0)
    assert_alike(stage)


@pytest.mark.parametrize(
    "settings",
    [
        dict(vector_type="TEXTURE"),
        pytest.param(dict(vector_type="POINT"), marks=pytest.mark.slow),
        pytest.param(dict(vector_type="VECTOR"), marks=pytest.mark.slow),
        pytest.param(dict(vector_type="NORMAL"), marks=pytest.mark.slow),
        pytest.param(dict(mapping_x="Y", mapping_y="X"), marks=pytest.mark.slow),
        pytest.param(dict(mapping_y="NONE", use_min=True, min=(0.4, 0.4, 0)), marks=pytest.mark.slow),
    ],
)
def test_texture_mapping_of_the_node(stage, settings):
    mapping = shown(stage, stage.image(FEW)).texture_mapping
    mapping.scale, mapping.translation, mapping.rotation = (1.3, 1.7, 0.8), (-0.4, 0.3, 0.5), (0.3, 0.5, 0.4)
    for name, value in settings.items():
        setattr(mapping, name, value)
    normal = settings.get("vector_type") == "NORMAL"
    assert_alike(stage, notes={"Image Texture node into Color"} if normal else ())


@pytest.mark.slow
def test_texture_mapping_that_reads_the_height_of_a_mapping_is_baked(stage):
    texture = shown(stage, stage.image(FEW))
    texture.texture_mapping.rotation = (0.5, 0.3, 0)
    tree = texture.id_data
    mapping, uv = tree.nodes.new("ShaderNodeMapping"), tree.nodes.new("ShaderNodeTexCoord")
    mapping.inputs["Location"].default_value = (0.1, 0.2, 0.7)
    tree.links.new(uv.outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    assert_alike(stage, notes={"Image Texture node into Color"})


def with_alpha(stage, path=None, deep=False):
    """An image of several opacities, made here or loaded from a file of 8 or 16 bits."""
    pixels = np.ones((12, 12, 4), np.float32)
    pixels[..., :3] = np.kron(FEW, np.ones((2, 2, 1)))
    pixels[..., 3] = ALPHA
    image = bpy.data.images.new("alpha", 12, 12, alpha=True, float_buffer=deep)
    if deep:
        image.colorspace_settings.name = "Linear Rec.709"
        pixels[..., :3] *= pixels[..., 3:]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    if path is None:
        image.pack()
        return image
    kind = {"png": "PNG", "exr": "OPEN_EXR", "tif": "TIFF", "webp": "WEBP"}[path.suffix[1:]]
    if deep:
        settings = stage.scene.render.image_settings
        settings.file_format, settings.color_mode, settings.color_depth = kind, "RGBA", "16"
        stage.scene.view_settings.view_transform = "Standard"
        image.save_render(str(path), scene=stage.scene)
    else:
        image.filepath_raw, image.file_format = str(path), kind
        image.save()
    return bpy.data.images.load(str(path))


def add_material(stage, image, alpha, between=None):
    """A plane of the image's color, and its alpha if that is read, in a gray world."""
    material = stage.material("ShaderNodeBsdfPrincipled", Roughness=1.0, Specular_IOR_Level=0.0)
    texture = stage.texture(material, image, "Base Color")
    tree = material.node_tree
    shader = next(node for node in tree.nodes if "Base Color" in node.inputs)
    if between:
        node = tree.nodes.new(between)
        tree.links.new(texture.outputs["Color"], node.inputs["Color"])
        tree.links.new(node.outputs[0], shader.inputs["Base Color"])
    if alpha:
        tree.links.new(texture.outputs["Alpha"], shader.inputs["Alpha"])
    stage.plane(2.85, material)
    stage.world((0.5, 0.5, 0.5))


@pytest.mark.parametrize(
    ("name", "deep", "alpha"),
    [
        pytest.param(name, deep, alpha, marks=() if quick else pytest.mark.slow)
        for name, deep, alpha, quick in [
            (None, False, False, False),
            (None, False, True, True),
            ("a.png", False, False, False),
            ("a.png", True, False, False),
            ("a.png", True, True, True),
            ("a.exr", True, False, False),
            ("a.exr", True, True, False),
        ]
    ],
)
def test_alpha_as_in_cycles(stage, tmp_path, name, deep, alpha):
    add_material(stage, with_alpha(stage, name and tmp_path / name, deep), alpha)
    assert_alike(stage, spp=256)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["PREMUL", "CHANNEL_PACKED", "NONE"])
@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize(("name", "deep"), [("a.png", False), ("a.png", True), ("a.exr", True)])
def test_alpha_modes(stage, tmp_path, name, deep, packed, mode):
    image = with_alpha(stage, tmp_path / name, deep)
    image.alpha_mode = mode
    if packed:
        image.pack()
    shown(stage, image)
    baked = mode == "PREMUL" and name == "a.png" and not packed
    assert_alike(stage, spp=256, notes={"Image Texture node into Color"} if baked else ())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.tif", "a.webp"])
def test_files_of_which_cycles_reads_the_alpha_in_ways_of_its_own_are_baked(stage, tmp_path, name):
    add_material(stage, with_alpha(stage, tmp_path / name), False)
    assert_alike(stage, spp=512, notes={"Image Texture node into Base Color"})


def test_baked_colors_are_divided_by_an_alpha_that_is_read(stage):
    """A node that is not part of the bake."""
    add_material(stage, with_alpha(stage), True, between="ShaderNodeInvert")
    assert_alike(stage, notes={"Invert Color node into Base Color", "Image Texture node into Alpha"})


def test_an_alpha_that_leads_nowhere_is_not_read(stage):
    texture = shown(stage, with_alpha(stage))
    tree = texture.id_data
    tree.links.new(texture.outputs["Alpha"], tree.nodes.new("ShaderNodeMath").inputs[0])
    assert_alike(stage)


def sequence(stage, folder):
    """Frames 5 to 8 of a sequence, the others are missing."""
    for number in range(5, 9):
        image = stage.image(NOISE[number : number + 6, :6] * (np.arange(3) == number % 3))
        image.filepath_raw, image.file_format = str(folder / f"frame_{number:04d}.png"), "PNG"
        image.save()
    loaded = bpy.data.images.load(str(folder / "frame_0005.png"))
    loaded.source, loaded.filepath = "SEQUENCE", str(folder / "frame_0000.png")
    return loaded


@pytest.mark.parametrize("where", ["material", pytest.param("world", marks=pytest.mark.slow)])
def test_the_frame_of_a_sequence_that_the_scene_shows(stage, tmp_path, small_worlds, where):
    image = sequence(stage, tmp_path)
    if where == "material":
        node = shown(stage, image)
    else:
        tree = stage.world().node_tree
        node = tree.nodes.new("ShaderNodeTexEnvironment")
        node.image = image
        tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])
        stage.plane(0.01)
    user = node.image_user
    user.frame_start, user.frame_duration, user.frame_offset, user.use_cyclic = 1, 3, 4, True
    stage.scene.frame_set(8)
    assert_alike(stage, notes={"Image Texture node into Color" if where == "material" else "Background node"})
    user.use_cyclic, user.frame_duration = False, 90
    assert features(stage.export()) == {"Frame 12 of a sequence"}


@pytest.mark.parametrize(
    ("settings", "frame", "number"),
    [
        ((1, 100, 0, False), 1, 1),
        ((1, 100, 0, False), 7.5, 7),
        ((1, 2, 4, True), 7, 5),
        ((1, 2, 4, True), 0, 6),
        ((10, 5, 0, False), 3, 0),
        ((1, 5, 2, False), 50, 7),
        ((1, 0, 2, False), 50, 0),
    ],
)
def test_frames_shown(settings, frame, number):
    from types import SimpleNamespace

    from holopath_addon.export.shading.textures import frame_shown

    names = ("frame_start", "frame_duration", "frame_offset", "use_cyclic")
    assert frame_shown(SimpleNamespace(**dict(zip(names, settings, strict=True))), frame) == number


def tiled(stage, folder, saved, used):
    """An image of UDIM tiles, each with noise of its own."""
    noise = np.random.default_rng(3).random((len(saved), 6, 6, 3)) ** 2
    for number, pixels in zip(saved, noise, strict=True):
        image = stage.image(pixels)
        image.filepath_raw, image.file_format = str(folder / f"tile.{number}.png"), "PNG"
        image.save()
    image = bpy.data.images.load(str(folder / f"tile.{saved[0]}.png"))
    image.source, image.filepath = "TILED", str(folder / "tile.<UDIM>.png")
    for number in used:
        if number not in [tile.number for tile in image.tiles]:
            image.tiles.new(number)
    return image


def test_tiles(stage, tmp_path):
    numbers = (1001, 1002, 1011)
    shown(stage, tiled(stage, tmp_path, numbers, numbers)).texture_mapping.scale = (3, 2, 1)
    assert_alike(stage, notes={"Image Texture node into Color"})


@pytest.mark.slow
def test_missing_tiles_are_noted(stage, tmp_path):
    image = tiled(stage, tmp_path, (1001, 1002), (1002, 1003))
    shown(stage, image).texture_mapping.scale = (3, 1, 1)
    assert features(stage.export()) == {"UDIM tile 1003", "Image Texture node into Color"}


@pytest.mark.slow
def test_colors_outside_rec709_are_noted(stage):
    shown(stage, stage.image(np.tile([0.0, 1.0, 0.0], (6, 6, 1)), space="ACEScg"))
    effects = {note.feature: note.effect for note in stage.export().notes}
    assert "negative values" in effects.pop("Image Texture node into Color")
    assert effects == {"Negative emission": "ignored"}


@pytest.mark.parametrize("pixels", [CHECKER, pytest.param(NOISE, marks=pytest.mark.slow)])
def test_worlds_of_few_texels(stage, pixels):
    tree = stage.world().node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = stage.image(pixels)
    tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    stage.plane(0.01)
    stage.camera.rotation_euler = (math.radians(70), 0, 0.3)
    assert_alike(stage)


@pytest.mark.parametrize("noisy", [True, False])
def test_wide_worlds_that_are_too_bright_between_texels_are_noted(stage, noisy):
    """Path of an image of white noise; photographs are smoother."""
    x = np.linspace(0, 1, 1100)[None, :, None] * np.ones((4, 1, 3))
    pixels = np.random.default_rng(4).random((4, 1100, 3)) ** 2 if noisy else x
    tree = stage.world().node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = stage.image(pixels)
    tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    stage.plane(0.01)
    assert features(stage.export()) == ({"sRGB image of more than 1024 columns"} if noisy else set())


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["Linear", "Cubic"])
def test_worlds_are_baked_where_their_texture_is_mapped_or_smoothed(stage, small_worlds, interpolation):
    tree = stage.world().node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image, node.interpolation = stage.image(FEW), interpolation
    if interpolation == "Linear":
        node.texture_mapping.rotation = (0, 0, 1)
    tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    stage.plane(0.01)
    assert_alike(stage, notes={"Background node"})


@pytest.mark.parametrize("node", ["ShaderNodeUVMap", "ShaderNodeTexCoord"])
def test_a_map_of_the_instancer(stage, node):
    """Without an instancer it is 0 everywhere: the picture's corner."""
    texture = shown(stage, stage.image(FEW))
    tree = texture.id_data
    source = tree.nodes.new(node)
    source.from_instancer = True
    tree.links.new(source.outputs["UV"], texture.inputs["Vector"])
    ours, theirs = stage.mitsuba(spp=4), stage.cycles(spp=4)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.02)
    assert np.ptp(ours[4:-4, 4:-4], axis=(0, 1)).max() < 1e-3


@pytest.mark.skipif(bpy.app.version < (5, 0, 0), reason="Blender has one working space")
def test_another_working_space_is_noted(stage):
    stage.plane(2.85, stage.material(EMISSION, Color=(0.5, 0.2, 0.1, 1)))
    assert stage.export().notes == []
    bpy.ops.wm.set_working_color_space(working_space="ACEScg", convert_colors=False)
    assert features(stage.export()) == {"Working Space ACEScg"}


def test_more_light_than_there_is(stage):
    """Color fields of Blender take more than 1, and Cycles reflects it."""
    stage.plane(2.85, stage.material("ShaderNodeBsdfDiffuse", Color=(2.0, 0.5, 0.5, 1)))
    stage.lamp("POINT", location=(0, 0, 1))
    assert features(stage.export()) == {"Color above 1"}


@pytest.mark.parametrize("bright", [0.9, 2.0])
def test_an_image_of_more_light_than_there_is(stage, bright):
    material = stage.material("ShaderNodeBsdfDiffuse")
    stage.texture(material, stage.image(np.full((4, 4, 3), bright), **LINEAR), "Color")
    stage.plane(2.85, material)
    stage.lamp("POINT", location=(0, 0, 1))
    assert features(stage.export()) == ({"Color above 1"} if bright > 1 else set())
