"""Lamps and world against Cycles."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

DIFFUSE = "ShaderNodeBsdfDiffuse"


def floor(stage, size=6.0):
    return stage.plane(size, stage.material(DIFFUSE, Color=(0.8, 0.5, 0.2, 1)))


def coarse(image, cells=8):
    """Means of blocks of pixels."""
    height, width = image.shape[:2]
    return image.reshape(cells, height // cells, cells, width // cells, 3).mean((1, 3))


def check_as_in_cycles(stage):
    """Brightness, and the mean relative difference of the regions that are lit.

    With fewer samples first: noise only adds to the mean size of differences.
    """
    for spp in (64, 1024):
        ours, theirs = stage.mitsuba(spp=spp, depth=3), stage.cycles(spp=spp, depth=3)
        regions = coarse(theirs)
        lit = regions > 0.02 * regions.max()
        ratio = ours.mean((0, 1)) / theirs.mean((0, 1))
        difference = abs(coarse(ours) / np.where(lit, regions, 1) - 1)[lit].mean()
        if abs(ratio - 1).max() < 0.005 and difference < 0.02:
            break
    assert ratio == pytest.approx(np.ones(3), abs=0.005)
    assert difference < 0.02


HARD = dict(use_soft_falloff=False)
LAMPS = {
    "point without size": ("POINT", dict(shadow_soft_size=0.0)),
    "point of a color": ("POINT", dict(shadow_soft_size=0.1, color=(1, 0.5, 0.1))),
    "point near": ("POINT", dict(shadow_soft_size=0.5, location=(0, 0, 0.6))),
    "point, temperature, exposure": ("POINT", dict(use_temperature=True, temperature=3000, exposure=1.5)),
    "point, not normalized": ("POINT", dict(normalize=False, shadow_soft_size=0.1)),
    "point without size, not normalized": ("POINT", dict(normalize=False, shadow_soft_size=0.0)),
    "sphere near": ("POINT", dict(shadow_soft_size=0.5, location=(0, 0, 0.6), **HARD)),
    "sphere through the floor": ("POINT", dict(shadow_soft_size=0.5, location=(0, 0, 0.3), **HARD)),
    "scaled point": ("POINT", dict(shadow_soft_size=0.3, location=(0, 0, 1), scale=(3, 1, 2))),
    "square": ("AREA", dict(size=1.0)),
    "rectangle": ("AREA", dict(size=1.0, size_y=0.5, shape="RECTANGLE", rotation=(0.6, 0, 0))),
    "disk": ("AREA", dict(size=0.8, shape="DISK", rotation=(0, 0.5, 0.3))),
    "ellipse": ("AREA", dict(size=1.0, size_y=2.0, shape="ELLIPSE")),
    "scaled area": ("AREA", dict(size=1.0, scale=(3, 0.5, 1))),
    "mirrored area": ("AREA", dict(size=1.0, scale=(1, 1, -1), rotation=(math.pi, 0, 0))),
    "area, not normalized": ("AREA", dict(size=0.7, normalize=False)),
    "spread of 175 degrees": ("AREA", dict(size=1.0, spread=math.radians(175))),
    "spread of 86 degrees": ("AREA", dict(size=0.3, spread=1.5)),
    "disk, spread of 20 degrees": ("AREA", dict(size=1.5, shape="DISK", spread=math.radians(20))),
    "ellipse, spread of 60 degrees": (
        "AREA",
        dict(size=1.5, size_y=0.5, shape="ELLIPSE", spread=math.radians(60), rotation=(0.3, 0, 0)),
    ),
    "spread of 1 degree": ("AREA", dict(size=1.0, spread=math.radians(1))),
    "spread of 0": ("AREA", dict(size=1.0, spread=0.0)),
    "sun without size": ("SUN", dict(angle=0.0, rotation=(0.5, 0.2, 0))),
    "sun": ("SUN", dict(angle=0.0092, rotation=(0.5, 0.2, 0))),
    "wide sun": ("SUN", dict(angle=0.5, rotation=(0.5, 0.2, 0))),
    "sun of 180 degrees": ("SUN", dict(angle=math.pi, rotation=(0.5, 0.2, 0))),
    "sun, not normalized": ("SUN", dict(angle=0.5, normalize=False)),
    "spot": ("SPOT", dict(shadow_soft_size=0.0, spot_size=1.0, spot_blend=1.0)),
    "sharp spot": ("SPOT", dict(shadow_soft_size=0.0, spot_size=1.0, spot_blend=0.0)),
    "spot with size": (
        "SPOT",
        dict(shadow_soft_size=0.1, spot_size=0.9, spot_blend=0.15, rotation=(0.2, 0, 0)),
    ),
    "spot as sphere": ("SPOT", dict(shadow_soft_size=0.4, spot_size=1.6, location=(0, 0, 1), **HARD)),
    "spot of 178 degrees": (
        "SPOT",
        dict(shadow_soft_size=0.1, spot_size=3.1, spot_blend=0.1, rotation=(1.2, 0, 0)),
    ),
    "spot of 180 degrees": (
        "SPOT",
        dict(shadow_soft_size=0.1, spot_size=math.pi, spot_blend=0, rotation=(1.2, 0, 0)),
    ),
    "elliptic spot": (
        "SPOT",
        dict(
            shadow_soft_size=0.05,
            spot_size=1.0,
            spot_blend=0.3,
            scale=(1.5, 0.5, 1),
            rotation=(0.2, 0.1, 0.5),
        ),
    ),
}


@pytest.mark.parametrize("lamp", LAMPS)
def test_lamps_are_as_bright_as_in_cycles(stage, lamp):
    kind, values = LAMPS[lamp]
    scale = values.get("scale", (1, 1, 1))
    floor(stage)
    stage.lamp(kind, **{key: value for key, value in values.items() if key != "scale"}).scale = scale
    check_as_in_cycles(stage)
    assert stage.export().notes == []


def light_tree(lamp):
    """The lamp's node tree and its Emission node."""
    lamp.data.use_nodes = True
    tree = lamp.data.node_tree
    return tree, next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")


@pytest.mark.parametrize("kelvin", [900, 2700, 6500, 11000, 20000])
def test_blackbody_node(stage, kelvin):
    floor(stage)
    lamp = stage.lamp("POINT", shadow_soft_size=0.0)
    tree, emission = light_tree(lamp)
    emission.inputs["Strength"].default_value = 2.5
    blackbody = tree.nodes.new("ShaderNodeBlackbody")
    blackbody.inputs["Temperature"].default_value = kelvin
    tree.links.new(blackbody.outputs[0], emission.inputs["Color"])
    ours, theirs = (render(spp=64).mean((0, 1)) for render in (stage.mitsuba, stage.cycles))
    assert ours == pytest.approx(theirs, rel=0.003, abs=0.003 * theirs.max())
    assert stage.export().notes == []


def test_blackbody_is_blenders():
    from holopath_addon.engine.scene import variants
    from holopath_addon.export.shading.blackbody import blackbody_color

    variants.activate()
    light = bpy.data.lights.new("light", "POINT")
    light.use_temperature = True
    for kelvin in (1200, 2000, 3000, 4500, 6500, 9000, 12000, 20000):
        light.temperature = kelvin
        assert blackbody_color(kelvin) == pytest.approx(np.array(light.temperature_color), abs=1.5e-3)


@pytest.mark.parametrize("output", ["Quadratic", "Linear", "Constant"])
@pytest.mark.parametrize("scale", [1.0, 0.1])
def test_light_falloff_node(stage, output, scale):
    floor(stage)
    lamp = stage.lamp("SPOT", shadow_soft_size=0.1, spot_size=1.2)
    tree, emission = light_tree(lamp)
    falloff = tree.nodes.new("ShaderNodeLightFalloff")
    falloff.inputs["Strength"].default_value = 1.5
    tree.links.new(falloff.outputs[output], emission.inputs["Strength"])
    stage.scene.unit_settings.scale_length = scale
    check_as_in_cycles(stage)
    assert stage.export().notes == []


def test_profile_stands_for_a_lamps_nodes(stage, backend):
    """A lamp that shines three times as bright along its own +x; the floor on that side is."""
    from holopath_addon.export.lights import emission_varies, export_lamp
    from holopath_addon.export.notes import Notes

    lamp = stage.lamp("POINT", 10.0, shadow_soft_size=0.0)
    tree, emission = light_tree(lamp)
    assert not emission_varies(lamp.data)
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs[1], emission.inputs["Color"])
    assert emission_varies(lamp.data)
    import mitsuba as mi

    profile = np.ones((4, 64, 3), np.float32)
    profile[:, :16] = profile[:, 48:] = 3
    turned = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]], float)  # +x to +y
    notes = Notes()
    emitter = mi.load_dict(export_lamp(lamp.data, turned, "lamp", 1.0, notes, profile))
    assert list(notes) == []
    it = mi.Interaction3f()
    for place, factor in (((0, 1, 2), 3), ((0, -1, 2), 1), ((0.3, 0.9, 1), 3)):
        it.p = mi.Point3f(*map(float, place))
        ds, strength = emitter.sample_direction(it, mi.Point2f(0.5))
        expected = factor * 10 / (4 * math.pi) / float(ds.dist[0]) ** 2
        assert np.array(strength).ravel() == pytest.approx(np.full(3, expected), rel=1e-4)


@pytest.mark.parametrize("case", ["portal", "no shader", "no power", "no size", "flat", "not a number"])
def test_lamps_without_light(stage, case):
    floor(stage)
    stage.world((0.1, 0.1, 0.1))
    lamp = stage.lamp("AREA", size=1.0)
    if case == "portal":
        lamp.data.cycles.is_portal = True
    elif case == "no shader":
        light_tree(lamp)[0].links.clear()
    elif case == "no power":
        lamp.data.energy = 0
    elif case == "no size":
        lamp.data.size = 0
    elif case == "flat":
        lamp.scale = (1, 0, 1)
    else:
        lamp.location.x = math.nan
    bpy.context.view_layer.update()
    exported = stage.export()
    assert len(exported.scene.emitters()) == 1
    degenerate = case in ("flat", "not a number")
    assert [n.feature for n in exported.notes] == ["Lamp with a degenerate transform"] * degenerate


def test_factors_that_eevee_alone_knows_change_nothing(stage):
    floor(stage)
    lamp = stage.lamp("POINT", 100)
    for kind in ("diffuse", "specular", "transmission", "volume"):
        setattr(lamp.data, f"{kind}_factor", 0.0)
    exported = stage.export()
    assert exported.notes == []
    ours, theirs = stage.mitsuba(spp=16, depth=3, exported=exported), stage.cycles(spp=16, depth=3)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.01) and theirs.mean() > 0.1


def test_what_lamps_cannot_do_is_noted(stage):
    floor(stage)
    lamp = stage.lamp("POINT")
    lamp.data.use_shadow = False
    lamp.data.cycles.max_bounces = 0
    lamp.visible_camera, lamp.visible_glossy = True, False
    lamp.light_linking.receiver_collection = bpy.data.collections.new("lit")
    tree, emission = light_tree(lamp)
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Normal"], noise.inputs["Vector"])
    tree.links.new(noise.outputs[1], emission.inputs["Color"])
    assert {n.feature for n in stage.export().notes} == {
        "Light without shadow",
        "Max Bounces of a light",
        "Ray visibility: lamp shown to the camera",
        "Ray visibility: lamp hidden from some rays",
        "Light Linking",
        "Light nodes",
    }


def test_area_lamps_shine_one_way_and_are_not_seen(stage):
    floor(stage)
    lamp = stage.lamp("AREA", 100, (0, 0, 2), (math.pi, 0, 0))
    assert stage.mitsuba().max() == 0
    lamp.rotation_euler = (0, 0, 0)
    bpy.context.view_layer.update()
    ours = stage.mitsuba()
    assert ours.min() > 0
    assert ours == pytest.approx(stage.cycles(), rel=0.1)
    import mitsuba as mi

    hit = stage.export().scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 0, 4), mi.Vector3f(0, 0, -1)))
    assert float(hit.t[0]) == pytest.approx(4)


@pytest.mark.parametrize(
    "kind, values",
    [
        ("POINT", dict(shadow_soft_size=0.4)),
        ("AREA", dict(size=0.6)),
        ("SUN", dict(angle=0.3)),
        ("SPOT", dict(shadow_soft_size=0.3, spot_size=1.5)),
    ],
)
def test_shadows_are_soft_as_in_cycles(stage, kind, values):
    """A penumbra as wide as the view: a lamp of many small ones would show steps along it."""
    floor(stage)
    stage.plane(0.5, stage.material(DIFFUSE, "blocker", Color=(0, 0, 0, 1)), "blocker", (0.3, 0, 0.5))
    stage.lamp(kind, 100, (-1.5, 0, 2.5), (0, -0.54, 0), **values)
    stage.camera.location, stage.camera.data.lens = (0.44, 0, 0.45), 45
    for spp in (256, 2048):  # noise adds to the largest difference
        ours, theirs = (render(spp=spp, depth=3).mean(0) for render in (stage.mitsuba, stage.cycles))
        difference = np.abs(ours - theirs).max() / theirs.max()
        if difference < 0.007:
            break
    assert theirs.min() < 0.05 * theirs.max()
    assert difference < 0.007


def test_unit_scale_keeps_the_picture(stage):
    floor(stage)
    stage.lamp("POINT", shadow_soft_size=0.1)
    stage.lamp("AREA", location=(1, 0, 2), size=0.5)
    stage.lamp("SUN")
    stage.lamp("SPOT", location=(-1, 0, 2))
    before = stage.mitsuba().mean((0, 1))
    stage.scene.unit_settings.scale_length = 0.1
    assert stage.mitsuba().mean((0, 1)) == pytest.approx(before, rel=0.01)


def test_world_color(stage):
    floor(stage, 1)
    stage.world((0.2, 0.4, 0.6), 1.5)
    image = stage.mitsuba()
    assert image[0, 0] == pytest.approx((0.3, 0.6, 0.9), rel=1e-3)
    assert stage.ratio() == pytest.approx(np.ones(3), abs=0.005)


@pytest.mark.parametrize("rotation", [None, (0, 0, 0.7), (0.4, -0.3, 1.1)])
@pytest.mark.parametrize("vector_type", ["POINT", "TEXTURE"])
def test_environment_is_oriented_as_in_cycles(stage, rotation, vector_type):
    if rotation is None and vector_type == "TEXTURE":
        pytest.skip("same as without mapping")
    rng = np.random.default_rng(5)
    pixels = np.kron(rng.random((8, 16, 3)), np.ones((8, 8, 1)))
    image = stage.image(pixels, float_buffer=True, space="Linear Rec.709")
    tree = stage.world().node_tree
    background = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBackground")
    background.inputs["Strength"].default_value = 2.0
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    tree.links.new(texture.outputs["Color"], background.inputs["Color"])
    if rotation:
        mapping = tree.nodes.new("ShaderNodeMapping")
        mapping.vector_type = vector_type
        mapping.inputs["Rotation"].default_value = rotation
        tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs["Vector"])
        tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    stage.camera.rotation_euler = (1.2, 0.1, 0.5)
    stage.camera.data.lens = 18
    ours, theirs = stage.mitsuba(spp=64), stage.cycles(spp=64)
    assert theirs.std() > 0.3
    assert np.abs(ours - theirs).mean() < 0.03
    assert stage.export().notes == []


def test_world_nodes_beyond_that_are_noted(stage, small_worlds):
    floor(stage)
    tree = stage.world().node_tree
    background = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeBackground")
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs[0], background.inputs["Color"])
    assert [n.object for n in stage.export().notes] == ["world"]


def test_darkness_is_noted(stage):
    floor(stage)
    assert [n.feature for n in stage.export().notes] == ["No light, emission or world color"]


@pytest.mark.parametrize(
    ("node", "socket"), [("ShaderNodeLightPath", "Is Glossy Ray"), ("ShaderNodeAttribute", "Fac")]
)
@pytest.mark.parametrize("kind", ["lamp", "world"])
def test_nodes_whose_value_a_bake_cannot_know_are_noted(stage, small_worlds, node, socket, kind):
    """Also where what comes out is the same in every direction, and within groups."""
    floor(stage)
    owner = stage.lamp("POINT", location=(0, 0, 1)).data
    if kind == "world":
        owner = stage.scene.world = bpy.data.worlds.new("World")
    if owner.node_tree is None:
        owner.use_nodes = True
    group = bpy.data.node_groups.new("Inside", "ShaderNodeTree")
    group.interface.new_socket("Value", in_out="OUTPUT", socket_type="NodeSocketFloat")
    source, out = group.nodes.new(node), group.nodes.new("NodeGroupOutput")
    if node == "ShaderNodeAttribute":
        source.attribute_type, source.attribute_name = "VIEW_LAYER", "strength"
    group.links.new(source.outputs[socket], out.inputs[0])
    tree = owner.node_tree
    inner = tree.nodes.new("ShaderNodeGroup")
    inner.node_tree = group
    shader = next(
        each for each in tree.nodes if each.bl_idname in ("ShaderNodeEmission", "ShaderNodeBackground")
    )
    tree.links.new(inner.outputs[0], shader.inputs["Strength"])
    label = source.bl_label
    assert f"{label} node" in {note.feature for note in stage.export().notes}


def test_a_portal_that_became_another_lamp_shines(stage):
    """The flag stays where its checkbox is gone."""
    floor(stage)
    lamp = stage.lamp("POINT", location=(0, 0, 1))
    lamp.data.cycles.is_portal = True
    ours, theirs = stage.mitsuba(spp=16), stage.cycles(spp=16)
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.05) and theirs.mean() > 0
