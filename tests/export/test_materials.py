"""Materials and textures against Cycles, which is inside the bpy module, and against known pictures."""

import importlib.util
import itertools

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

DIFFUSE = "ShaderNodeBsdfDiffuse"
PRINCIPLED = "ShaderNodeBsdfPrincipled"
EMISSION = "ShaderNodeEmission"
MIDDLE = (slice(11, 21), slice(11, 21))
BALL = (slice(4, 28), slice(4, 28))
QUADRANTS = {
    "top left": (1, 0, 0),
    "top right": (0, 1, 0),
    "bottom left": (0, 0, 1),
    "bottom right": (1, 1, 1),
}


def quadrant_image(stage, space="Non-Color"):
    """Four colors, 8 x 8 pixels (linear: Cycles interpolates between sRGB values before it decodes them)."""
    pixels = np.zeros((8, 8, 3))
    pixels[:4, :4], pixels[:4, 4:], pixels[4:, :4], pixels[4:, 4:] = QUADRANTS.values()
    return stage.image(pixels, space=space)


def features(exported):
    return {note.feature for note in exported.notes}


def lobes(exported):
    """Kinds of lobe of the first shape's BSDF."""
    import mitsuba as mi

    names = ("DeltaReflection", "DeltaTransmission", "Null", "DiffuseReflection", "GlossyReflection")
    flags = exported.scene.shapes()[0].bsdf().flags()
    return {name for name in names if mi.has_flag(flags, getattr(mi.BSDFFlags, name))}


@pytest.mark.parametrize(
    "node, values, tolerance",
    [
        (DIFFUSE, dict(Color=(0.8, 0.5, 0.2, 1)), 0.01),
        (PRINCIPLED, dict(Base_Color=(0.8, 0.5, 0.2, 1)), 0.01),
        (PRINCIPLED, dict(Base_Color=(0.8, 0.5, 0.2, 1), Roughness=0.2), 0.02),
        (PRINCIPLED, dict(Base_Color=(0.8, 0.5, 0.2, 1), Roughness=1.0), 0.03),
        (PRINCIPLED, dict(Base_Color=(0.8, 0.5, 0.2, 1), Metallic=1.0, Roughness=0.3), 0.03),
        (PRINCIPLED, dict(Base_Color=(0.1, 0.1, 0.1, 1), Roughness=0.4, IOR=2.0), 0.04),
        (
            PRINCIPLED,
            dict(Base_Color=(0, 0, 0, 1), Emission_Color=(1, 0.5, 0.1, 1), Emission_Strength=3.0),
            0.01,
        ),
        ("ShaderNodeBsdfAnisotropic", dict(Color=(0.8, 0.5, 0.2, 1), Roughness=0.3), 0.03),
        (EMISSION, dict(Color=(0.8, 0.5, 0.2, 1), Strength=2.0), 0.001),
    ],
)
@pytest.mark.parametrize("lit_by", ["world", "lamp"])
def test_as_bright_as_in_cycles(stage, node, values, tolerance, lit_by):
    stage.plane(6, stage.material(node, **values))
    if lit_by == "world":
        stage.world((0.3, 0.4, 0.5))
    else:
        stage.lamp("AREA", 100, (2, 1, 3), (0, 0.6, 0.4))
    assert stage.ratio(spp=32) == pytest.approx(np.ones(3), abs=tolerance)
    assert stage.export().notes == []


@pytest.mark.parametrize(
    "node, values",
    [
        ("ShaderNodeBsdfGlass", dict(Color=(0.8, 0.5, 0.2, 1), Roughness=0.0)),
        (PRINCIPLED, dict(Base_Color=(0.8, 0.5, 0.2, 1), Transmission_Weight=1.0, Roughness=0.0)),
        (PRINCIPLED, dict(Base_Color=(0.8, 0.5, 0.2, 1), Transmission_Weight=1.0, Roughness=0.3)),
    ],
)
def test_glass_ball_tints_as_in_cycles(stage, node, values):
    stage.sphere(1, stage.material(node, **values))
    stage.world((0.5, 0.5, 0.5))
    assert stage.ratio(MIDDLE, depth=12) == pytest.approx(np.ones(3), abs=0.03)


def apart(stage, bound, region=slice(None), spp=256):
    """Mean difference from Cycles' picture, relative, in blocks of 4 x 4 pixels: the noise is not meant.

    It only adds to the mean size of a difference: what is within the bound with a few samples is.
    """
    for few in (min(64, spp), spp):
        ours, theirs = (render(spp=few, depth=8)[region] for render in (stage.mitsuba, stage.cycles))
        ours, theirs = (v.reshape(len(v) // 4, 4, len(v) // 4, 4, 3).mean((1, 3)) for v in (ours, theirs))
        difference = np.abs(ours - theirs).mean() / theirs.mean()
        if difference < bound:
            break
    return difference


@pytest.mark.parametrize(
    ("metallic", "transmission", "roughness"),
    [  # each value of one beside each of another; the others are slow
        pytest.param(i / 2, j / 2, (0.0, 0.3, 1.0)[k], marks=pytest.mark.slow if (i + j + k) % 3 else ())
        for i, j, k in itertools.product(range(3), repeat=3)
    ],
)
def test_principled_ball(stage, metallic, transmission, roughness):
    values = dict(Metallic=metallic, Transmission_Weight=transmission, Roughness=roughness)
    stage.sphere(1, stage.material(PRINCIPLED, Base_Color=(0.8, 0.5, 0.2, 1), **values))
    stage.world((0.5, 0.5, 0.5))
    ratio = stage.ratio(BALL, depth=8, spp=64)
    assert ratio == pytest.approx(np.ones(3), abs=0.03)
    exported = stage.export()
    assert exported.notes == []
    sharp = {"DeltaReflection"} | ({"DeltaTransmission"} if transmission > 0 and metallic < 1 else set())
    assert lobes(exported) & {"DeltaReflection", "DeltaTransmission", "Null"} == (
        sharp if roughness == 0 else set()
    )


BASE = {"Base_Color": (0.8, 0.5, 0.2, 1)}
COLOR = {"Color": (0.8, 0.5, 0.2, 1)}
TINT = (0.9, 0.4, 0.2, 1)
GLOSSY, GLASS = "ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfGlass"
METALLIC, REFRACTION = "ShaderNodeBsdfMetallic", "ShaderNodeBsdfRefraction"


@pytest.mark.slow
@pytest.mark.parametrize(
    "node, values, settings",
    [
        (PRINCIPLED, dict(BASE, Roughness=0.3, Specular_IOR_Level=1.0), {}),
        (PRINCIPLED, dict(BASE, Roughness=0.3, IOR=2.0, Specular_Tint=TINT), {}),
        (PRINCIPLED, dict(BASE, Roughness=1.0), {"distribution": "GGX"}),
        (PRINCIPLED, dict(BASE, Roughness=0.5, Diffuse_Roughness=1.0), {}),
        (PRINCIPLED, dict(BASE, Metallic=1.0, Roughness=0.0, Specular_Tint=TINT), {}),
        (PRINCIPLED, dict(BASE, Metallic=1.0, Roughness=0.4, Specular_Tint=TINT), {}),
        (PRINCIPLED, dict(BASE, Metallic=1.0, Roughness=1.0), {"distribution": "GGX"}),
        (PRINCIPLED, dict(BASE, Sheen_Weight=1.0), {}),
        (PRINCIPLED, dict(BASE, Sheen_Weight=0.7, Sheen_Roughness=0.2, Sheen_Tint=TINT), {}),
        (PRINCIPLED, dict(BASE, Coat_Weight=1.0, Coat_Tint=TINT), {}),
        (PRINCIPLED, dict(BASE, Coat_Weight=0.5, Coat_Roughness=0.5, Coat_IOR=1.8, Coat_Tint=TINT), {}),
        (PRINCIPLED, dict(BASE, Transmission_Weight=1.0, Roughness=0.4, Specular_Tint=TINT), {}),
        (PRINCIPLED, dict(BASE, Transmission_Weight=0.5, Roughness=0.6, Coat_Weight=1.0), {}),
        (GLOSSY, dict(COLOR, Roughness=1.0), {}),
        (GLOSSY, dict(COLOR, Roughness=0.5), {"distribution": "BECKMANN"}),
        (GLASS, dict(COLOR, Roughness=0.3), {}),
        (GLASS, dict(COLOR, Roughness=1.0), {}),
        (GLASS, dict(COLOR, Roughness=0.7), {"distribution": "GGX"}),
        (REFRACTION, dict(COLOR, Roughness=0.0), {}),
        (REFRACTION, dict(COLOR, Roughness=0.4), {}),
        (REFRACTION, dict(COLOR, Roughness=0.4), {"distribution": "GGX"}),
        (METALLIC, dict(Roughness=0.3), {}),
        (METALLIC, dict(Roughness=0.3), {"fresnel_type": "PHYSICAL_CONDUCTOR"}),
        (DIFFUSE, dict(COLOR, Roughness=0.7), {}),
        ("ShaderNodeBsdfTranslucent", COLOR, {}),
        ("ShaderNodeBsdfSheen", COLOR, {}),
        ("ShaderNodeBsdfTransparent", COLOR, {}),
    ],
)
@pytest.mark.parametrize("lit_by", [pytest.param("world", marks=pytest.mark.slow), "panel"])
def test_ball_of_each_closure(stage, node, values, settings, lit_by):
    """The whole ball's brightness and, in blocks of 4 x 4 pixels, where it is: highlights too."""
    material = stage.material(node, **values)
    shader = next(n for n in material.node_tree.nodes if n.bl_idname == node)
    for name, value in settings.items():
        setattr(shader, name, value)
    stage.sphere(1, material)
    # paths that find a small panel through rough glass are rare
    size, spp = (3.0, 1024) if "Transmission_Weight" in values else (1.5, 512)
    light(stage, lit_by, size)
    assert apart(stage, 0.03, BALL, spp) < 0.03
    assert stage.export().notes == []


def light(stage, by, size=1.5):
    """A gray world, or a dim one with a bright panel behind the camera: the larger, the dimmer."""
    stage.world((0.5, 0.5, 0.5) if by == "world" else (0.1, 0.1, 0.1))
    if by == "panel":
        glow = stage.material(EMISSION, "panel", Strength=45.0 / size**2)
        panel = stage.plane(size, glow, "panel", (1.5, 1, 4.5))
        panel.rotation_euler = (np.pi - 0.2, 0.3, 0)
    # Cycles widens what a rough surface shows in another to spare noise: a setting, no property of the material
    stage.scene.cycles.blur_glossy = 0


@pytest.mark.parametrize(
    "node, values",
    [
        (PRINCIPLED, dict(BASE, Metallic=1.0, Roughness=0.5, Anisotropic=0.8)),
        (PRINCIPLED, dict(BASE, Roughness=0.4, Anisotropic=0.8, Anisotropic_Rotation=0.15)),
        pytest.param(GLOSSY, dict(COLOR, Roughness=0.5, Anisotropy=0.7), marks=pytest.mark.slow),
        (GLOSSY, dict(COLOR, Roughness=0.5, Anisotropy=-0.7, Rotation=0.1)),
        pytest.param(METALLIC, dict(Roughness=0.5, Anisotropy=0.7), marks=pytest.mark.slow),
    ],
)
def test_anisotropy_along_a_uv_map(stage, node, values):
    material = stage.material(node, **values)
    nodes, links = material.node_tree.nodes, material.node_tree.links
    tangent = nodes.new("ShaderNodeTangent")
    tangent.direction_type, tangent.uv_map = "UV_MAP", "UVMap"
    links.new(tangent.outputs[0], next(n for n in nodes if n.bl_idname == node).inputs["Tangent"])
    stage.plane(6, material)
    light(stage, "panel")
    assert apart(stage, 0.03, spp=512) < 0.03
    assert stage.export().notes == []
    links.remove(links[-1])
    assert features(stage.export()) == {"Anisotropy about an axis"}


@pytest.mark.parametrize(
    "node, values, socket",
    [
        (GLASS, COLOR, "Roughness"),
        (GLOSSY, COLOR, "Roughness"),
        (REFRACTION, COLOR, "Roughness"),
        (PRINCIPLED, dict(BASE, Coat_Weight=1.0), "Coat Roughness"),
        (PRINCIPLED, dict(BASE, Sheen_Weight=1.0), "Sheen Roughness"),
        (PRINCIPLED, dict(BASE, Roughness=1.0), "Diffuse Roughness"),
        (PRINCIPLED, dict(BASE, Metallic=1.0), "Specular Tint"),
        (PRINCIPLED, dict(BASE, Coat_Weight=1.0), "Coat Tint"),
        ("ShaderNodeBsdfTransparent", {}, "Color"),
    ],
)
def test_closure_inputs_by_texture(stage, node, values, socket):
    material = stage.material(node, **values)
    steps = np.kron(np.linspace(0.2, 0.9, 4), np.ones((4, 4)))
    stage.texture(material, stage.float_image(steps), socket).interpolation = "Closest"
    ball = stage.sphere(1, material)
    assert ball.data.uv_layers
    light(stage, "world")
    assert apart(stage, 0.02, BALL) < 0.02
    assert stage.export().notes == []


@pytest.mark.parametrize(
    "node, values, settings, bound, feature",
    [
        (PRINCIPLED, dict(BASE, Subsurface_Weight=0.5), {}, 0.03, "Principled Subsurface Weight"),
        ("ShaderNodeSubsurfaceScattering", COLOR, {}, 0.05, "Subsurface Scattering node"),
        (
            GLOSSY,
            dict(COLOR, Roughness=0.5),
            {"distribution": "ASHIKHMIN_SHIRLEY"},
            0.08,
            "Glossy BSDF of the Ashikhmin_Shirley kind",
        ),
        (
            "ShaderNodeBsdfSheen",
            COLOR,
            {"distribution": "ASHIKHMIN"},
            0.1,
            "Sheen BSDF of the Ashikhmin kind",
        ),
    ],
)
def test_stated_approximations(stage, node, values, settings, bound, feature):
    material = stage.material(node, **values)
    shader = next(n for n in material.node_tree.nodes if n.bl_idname == node)
    for name, value in settings.items():
        setattr(shader, name, value)
    stage.sphere(1, material)
    light(stage, "world")
    assert apart(stage, bound, BALL) < bound
    assert features(stage.export()) == {feature}


@pytest.mark.parametrize(
    "values",
    [
        dict(Roughness=0.0),
        dict(Roughness=0.0, IOR=1.8),
        dict(Roughness=0.5, Coat_Weight=1.0),
        dict(Roughness=0.5, Coat_Weight=0.5, Coat_IOR=1.8, Coat_Roughness=0.3),
        dict(Roughness=0.4, Metallic=1.0, Coat_Weight=1.0, Coat_Roughness=0.0),
        dict(Roughness=0.0, Coat_Weight=1.0, Coat_Roughness=0.0),
    ],
)
@pytest.mark.parametrize("tilt", [0, 45])
def test_polish_and_coat(stage, values, tilt):
    plane = stage.plane(12, stage.material(PRINCIPLED, Base_Color=(0.5, 0.4, 0.2, 1), **values))
    plane.rotation_euler = (np.radians(tilt), 0, 0)
    stage.world((0.5, 0.5, 0.5))
    assert stage.ratio(spp=64) == pytest.approx(np.ones(3), abs=0.03)
    exported = stage.export()
    assert exported.notes == []
    assert ("DeltaReflection" in lobes(exported)) == (values.get("Coat_Roughness", 0.03) < 0.3)


def test_emission_under_a_coat(stage):
    values = dict(
        Emission_Color=(0.2, 0.5, 1, 1), Emission_Strength=1.0, Base_Color=(0, 0, 0, 1), Coat_IOR=2.0
    )
    stage.sphere(1, stage.material(PRINCIPLED, Coat_Weight=0.8, **values))
    assert stage.ratio(BALL, spp=64) == pytest.approx(np.ones(3), abs=0.02)


def test_polish_under_a_lamp(stage):
    stage.plane(6, stage.material(PRINCIPLED, Base_Color=(0.8, 0.5, 0.2, 1), Roughness=0.0))
    stage.lamp("AREA", 100, (2, 1, 3), (0, 0.6, 0.4))
    assert stage.ratio(MIDDLE) == pytest.approx(np.ones(3), abs=0.01)


@pytest.mark.parametrize("socket", ["Metallic", "Transmission Weight", "Coat Weight", "Alpha"])
def test_weights_by_texture(stage, socket):
    material = stage.material(PRINCIPLED, Base_Color=(0.8, 0.5, 0.2, 1), Roughness=0.0, Coat_Roughness=0.0)
    steps = np.kron(np.linspace(0, 1, 4), np.ones((4, 4)))
    stage.texture(material, stage.float_image(steps), socket).interpolation = "Closest"
    if socket == "Transmission Weight":
        ball = stage.sphere(1, material)
        assert ball.data.uv_layers
    else:
        stage.plane(2.4, material)
    stage.world((0.6, 0.4, 0.2))
    region = BALL if socket == "Transmission Weight" else slice(None)
    assert apart(stage, 0.02, region) < 0.02
    assert "DeltaReflection" in lobes(stage.export())
    assert stage.export().notes == []


@pytest.mark.parametrize("case", ["alpha", "mix", "mix, swapped", "gray", "tinted", "emission"])
@pytest.mark.parametrize("lit_by", ["world", "lamp"])
def test_transparency(stage, case, lit_by):
    """A pane over a floor: what is seen through it, and the shadow it casts."""
    values = dict(Color=(0.2, 0.4, 0.8, 1))
    if case == "gray":
        material = stage.material("ShaderNodeBsdfTransparent", "pane", Color=(0.3, 0.3, 0.3, 1))
    elif case == "tinted":
        material = stage.material("ShaderNodeBsdfTransparent", "pane", **values)
    elif case == "alpha":
        material = stage.material(PRINCIPLED, "pane", Alpha=0.4, Base_Color=values["Color"], Roughness=1.0)
    elif case == "emission":
        material = stage.material(EMISSION, "pane", Strength=0.3, **values)
        stage.mix(material, "ShaderNodeBsdfTransparent", 0.6)
    else:
        material = stage.material(DIFFUSE, "pane", **values)
        stage.mix(material, "ShaderNodeBsdfTransparent", 0.3, first=case == "mix")
    stage.plane(1, material, "pane", (0.3, 0.3, 0.8))
    stage.plane(5, stage.material(DIFFUSE, "floor", Color=(0.7, 0.7, 0.7, 1)), "floor")
    if lit_by == "world":
        stage.world((0.5, 0.5, 0.5))
    else:
        stage.lamp("AREA", 100, (-1, 0, 3), (0, -0.4, 0), size=0.3)
    assert apart(stage, 0.02) < 0.02
    exported = stage.export()
    assert "Null" in lobes(exported)
    assert features(exported) == (
        {"Lamps mirrored in or shining through a smooth or transparent surface"}
        if lit_by == "lamp"
        else set()
    )


def test_alpha_of_vertex_colors_casts_its_shadow(stage):
    """The floor is lit through a pane with values from 0 to 1 as in Cycles."""
    leaf = stage.material(PRINCIPLED, "leaf", Base_Color=(0.2, 0.4, 0.8, 1), Roughness=1.0)
    tree = leaf.node_tree
    colors = tree.nodes.new("ShaderNodeVertexColor")
    colors.layer_name = "painted"
    shader = next(n for n in tree.nodes if n.bl_idname == PRINCIPLED)
    tree.links.new(colors.outputs["Alpha"], shader.inputs["Alpha"])
    pane = stage.plane(1.4, leaf, "leaf", (0.2, 0.2, 0.8))
    painted = pane.data.color_attributes.new("painted", "BYTE_COLOR", "CORNER")
    painted.data.foreach_set("color", np.repeat(np.float32([0, 1, 1, 0]), 4))
    stage.plane(5, stage.material(DIFFUSE, "floor", Color=(0.7, 0.7, 0.7, 1)), "floor")
    stage.lamp("SUN", 3.0, rotation=(0, -0.6, 0))
    assert apart(stage, 0.02) < 0.02
    assert "Color Attribute node into Alpha" in features(stage.export())


def test_cut_out_by_texture(stage):
    """Leaves as billboards: a texture's alpha, by Principled and by Mix, one the other's negative."""
    holes = stage.float_image(np.kron([[1, 0], [0, 1]], np.ones((4, 4))))
    leaf = stage.material(PRINCIPLED, "leaf", Base_Color=(0.2, 0.6, 0.1, 1), Roughness=1.0)
    stage.texture(leaf, holes, "Alpha").interpolation = "Closest"
    glow = stage.material(EMISSION, "glow", Color=(1, 0.5, 0.1, 1), Strength=0.8)
    mix, _ = stage.mix(glow, "ShaderNodeBsdfTransparent")
    stage.texture(glow, holes, mix.inputs[0].name, mix).interpolation = "Closest"
    stage.plane(1.4, leaf, "leaf", (-0.7, 0, 0.5))
    stage.plane(1.4, glow, "glow", (0.7, 0, 0.5))
    stage.plane(6, stage.material(DIFFUSE, "floor", Color=(0.7, 0.7, 0.7, 1)), "floor")
    stage.world((0.5, 0.5, 0.5))
    assert apart(stage, 0.02) < 0.02
    assert stage.export().notes == []


def test_add_with_transparent(stage):
    """A glow, and then a surface, over what is behind them."""
    material = stage.material(EMISSION, Color=(0.3, 0.2, 0.1, 1))
    mix, clear = stage.mix(material, "ShaderNodeBsdfTransparent")
    nodes, links = material.node_tree.nodes, material.node_tree.links
    add = nodes.new("ShaderNodeAddShader")
    output = next(n for n in nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    links.new(clear.outputs[0], add.inputs[0])
    links.new(mix.inputs[1].links[0].from_socket, add.inputs[1])
    links.new(add.outputs[0], output.inputs["Surface"])
    stage.plane(6, material)
    stage.world((0.4, 0.4, 0.4))
    assert stage.ratio(MIDDLE, spp=16) == pytest.approx(np.ones(3), abs=0.005)
    assert stage.export().notes == []
    links.new(nodes.new(DIFFUSE).outputs[0], add.inputs[1])
    clear.inputs["Color"].default_value = (0.6, 0.3, 0.1, 1)
    assert stage.ratio(spp=32) == pytest.approx(np.ones(3), abs=0.01)
    exported = stage.export()
    assert lobes(exported) == {"DiffuseReflection", "Null"}
    assert exported.notes == []


def test_sum_of_surfaces(stage):
    """Diffuse and mirror, each with all its light."""
    material = stage.material(DIFFUSE, Color=(0.4, 0.3, 0.2, 1))
    nodes, links = material.node_tree.nodes, material.node_tree.links
    add, mirror = nodes.new("ShaderNodeAddShader"), nodes.new(GLOSSY)
    mirror.inputs["Color"].default_value, mirror.inputs["Roughness"].default_value = (0.5, 0.5, 0.5, 1), 0.0
    output = next(n for n in nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    links.new(output.inputs["Surface"].links[0].from_socket, add.inputs[0])
    links.new(mirror.outputs[0], add.inputs[1])
    links.new(add.outputs[0], output.inputs["Surface"])
    stage.sphere(1, material)
    light(stage, "panel")
    assert apart(stage, 0.02, BALL, spp=1024) < 0.02
    assert "DeltaReflection" in lobes(stage.export())


def test_nothing_but_transparent(stage):
    stage.plane(2, stage.material("ShaderNodeBsdfTransparent", Color=(1, 1, 1, 1)))
    stage.world((0.2, 0.4, 0.6))
    assert stage.mitsuba(spp=4) == pytest.approx(stage.cycles(spp=4), abs=1e-4)
    assert lobes(stage.export()) == {"Null"}


@pytest.fixture
def abbe():
    """The properties, registered if they are not."""
    from holopath_addon.blender import properties

    if not hasattr(bpy.types.Material, "holopath"):
        properties.register()


@pytest.mark.parametrize(
    "node, values, disperses",
    [
        ("ShaderNodeBsdfGlass", dict(Roughness=0.0, IOR=1.6), True),
        (PRINCIPLED, dict(Roughness=0.0, Transmission_Weight=1.0, IOR=1.6), True),
        ("ShaderNodeBsdfGlass", dict(Roughness=0.3, IOR=1.6), False),
        (DIFFUSE, dict(), False),
    ],
)
def test_abbe_number(stage, abbe, node, values, disperses):
    from holopath_addon.export.notes import Notes
    from holopath_addon.export.shading.materials import read_material
    from holopath_addon.export.shading.textures import Textures

    material = stage.material(node, **values)
    notes = Notes()
    for number in (0.0, 36.0):
        material.holopath.abbe_number = number
        bsdf = read_material(material, Textures(notes), notes)[0].bsdf
        assert (bsdf["type"] == "dispersive_dielectric") == (disperses and number > 0)
        assert bsdf.get("abbe") == (36.0 if disperses and number > 0 else None)
        assert "int_ior" not in bsdf or bsdf["int_ior"] == pytest.approx(1.6)
    assert [note.feature for note in notes] == ([] if disperses else ["Abbe number"])


@pytest.mark.skipif(
    importlib.util.find_spec("holopath_addon.engine.scene.dispersion") is None,
    reason="the engine has no dispersive glass yet",
)
def test_dispersive_glass_loads(stage, abbe):
    material = stage.material("ShaderNodeBsdfGlass", Roughness=0.0)
    material.holopath.abbe_number = 36.0
    stage.sphere(1, material)
    stage.world()
    assert {"DeltaReflection", "DeltaTransmission"} <= lobes(stage.export())


def test_backs_reflect_and_emit(stage):
    plane = stage.plane(6, stage.material(DIFFUSE, Color=(0.8, 0.5, 0.2, 1)))
    plane.rotation_euler = (np.pi, 0, 0)
    stage.world((0.4, 0.4, 0.4))
    assert stage.ratio(spp=32) == pytest.approx(np.ones(3), abs=0.01)
    plane.data.materials[0] = stage.material(EMISSION, Color=(1, 2, 3, 1))
    for turn in (0, np.pi):
        plane.rotation_euler = (turn, 0, 0)
        bpy.context.view_layer.update()
        assert stage.mitsuba(spp=4)[MIDDLE].min((0, 1)) == pytest.approx((1, 2, 3))


def test_emitters_light_both_their_sides(stage):
    """Two floors, one on each side of an emitting disk seen by neither camera nor floor edge-on."""
    emitter = stage.plane(
        0.5, stage.material(EMISSION, Color=(1, 1, 1, 1), Strength=20), "emitter", (0, 0, 1.5)
    )
    floor = stage.plane(2, stage.material(DIFFUSE, Color=(0.8, 0.8, 0.8, 1)))
    emitter.location = (0, 1.5, 1)
    region = (slice(8, 24), slice(4, 28))
    for turn in (0, np.pi):
        emitter.rotation_euler = (turn, 0, 0)
        bpy.context.view_layer.update()
        assert stage.ratio(region) == pytest.approx(np.ones(3), abs=0.03)
    assert floor.name == "plane"


@pytest.mark.parametrize("socket", ["emission", "base color"])
def test_textures_are_upright(stage, socket):
    material = stage.material(EMISSION) if socket == "emission" else stage.material(DIFFUSE)
    stage.texture(material, quadrant_image(stage), "Color")
    stage.plane(2, material)
    stage.world()
    image = stage.mitsuba(spp=64)
    near, far = 13, 19
    corners = image[near, near], image[near, far], image[far, near], image[far, far]
    for color, view in zip(QUADRANTS.values(), corners, strict=True):
        assert view == pytest.approx(color, abs=0.05)
    assert stage.ratio((slice(9, 23), slice(9, 23)), spp=64) == pytest.approx(np.ones(3), abs=0.02)


@pytest.mark.parametrize("extension", ["REPEAT", "EXTEND", "CLIP", "MIRROR"])
def test_extension_and_mapping(stage, extension):
    material = stage.material(EMISSION)
    texture = stage.texture(material, quadrant_image(stage), "Color")
    texture.extension = extension
    tree = material.node_tree
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Location"].default_value = (0.3, -0.6, 0)
    mapping.inputs["Rotation"].default_value = (0, 0, 0.5)
    mapping.inputs["Scale"].default_value = (1.7, 2.3, 1)
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["UV"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    stage.plane(2.6, material)
    ours, theirs = stage.mitsuba(spp=64), stage.cycles(spp=64)
    assert np.abs(ours - theirs).mean() < 0.01
    assert theirs.std() > 0.2


@pytest.mark.parametrize(
    "space, float_buffer", [("sRGB", False), ("Non-Color", False), ("Linear Rec.709", True)]
)
def test_color_spaces(stage, space, float_buffer):
    material = stage.material(EMISSION)
    gray = stage.image(np.full((4, 4, 3), 0.5), float_buffer=float_buffer, space=space)
    stage.texture(material, gray, "Color")
    stage.plane(6, material)
    ours, theirs = stage.mitsuba(spp=4)[MIDDLE].mean(), stage.cycles(spp=4)[MIDDLE].mean()
    assert ours == pytest.approx(theirs, rel=0.005)
    assert ours == pytest.approx(0.2140 if space == "sRGB" else 0.5, rel=0.01)


def test_files_and_missing_files(stage, tmp_path):
    image = quadrant_image(stage)
    image.filepath_raw, image.file_format = str(tmp_path / "quadrants.png"), "PNG"
    image.save()
    loaded = bpy.data.images.load(str(tmp_path / "quadrants.png"))
    material = stage.material(EMISSION)
    texture = stage.texture(material, loaded, "Color")
    stage.plane(2, material)
    assert stage.mitsuba(spp=16)[13, 13] == pytest.approx((1, 0, 0), abs=0.02)
    lost = bpy.data.images.new("lost", 4, 4)
    lost.source, lost.filepath = "FILE", str(tmp_path / "nowhere.png")
    lost.reload()
    texture.image = lost
    exported = stage.export()
    assert ("lost", "Image file") in {(n.object, n.feature) for n in exported.notes}
    assert stage.mitsuba(spp=4, exported=exported)[MIDDLE].mean((0, 1)) == pytest.approx((1, 0, 1))


@pytest.mark.parametrize("lost", ["file", "image"])
@pytest.mark.parametrize(
    "output, socket, values",
    [
        ("Color", "Base Color", {}),
        ("Alpha", "Alpha", {}),
        ("Color", "Alpha", {}),
        ("Color", "Transmission Weight", {"Roughness": 0.0}),
        ("Color", "Emission Strength", {"Emission_Color": (0.2, 0.5, 0.8, 1)}),
    ],
)
def test_missing_images_are_opaque_and_magenta(stage, lost, output, socket, values):
    """Also where only a number is read of them."""
    material = stage.material(PRINCIPLED, **{"Base_Color": (0.8, 0.5, 0.2, 1), "Roughness": 1.0} | values)
    image = None
    if lost == "file":
        image = bpy.data.images.new("lost", 4, 4)
        image.source, image.filepath = "FILE", "//nowhere.png"
        image.reload()
    texture = stage.texture(material, image, socket)
    shader = next(n for n in material.node_tree.nodes if n.bl_idname == PRINCIPLED)
    material.node_tree.links.new(texture.outputs[output], shader.inputs[socket])
    stage.plane(2, material)
    stage.world((0.5, 0.5, 0.5))
    assert stage.ratio(MIDDLE, spp=64) == pytest.approx(np.ones(3), abs=0.02)
    assert features(stage.export()) == {"Image file" if image else "Image Texture without an image"}


@pytest.mark.parametrize("roughness", [0.0, 0.5])
def test_principled_with_an_index_of_zero_mirrors_all(stage, roughness):
    stage.sphere(1, stage.material(PRINCIPLED, Base_Color=(0.1, 0.4, 0.2, 1), IOR=0.0, Roughness=roughness))
    light(stage, "world")
    assert apart(stage, 0.03, BALL) < 0.03
    assert stage.export().notes == []


@pytest.mark.parametrize("ior", [0.5, 0.9])
@pytest.mark.parametrize("roughness", [0.0, 0.5])
def test_principled_below_an_index_of_one(stage, ior, roughness):
    """Total reflection beyond an angle, as in Cycles, on a black surface.

    A white one is as bright as what is around it: no light is lost or gained. (Cycles' gains some: it takes the light
    that the index's inverse reflects from what is below.)
    """
    black = stage.material(PRINCIPLED, Base_Color=(0, 0, 0, 1), IOR=ior, Roughness=roughness)
    ball = stage.sphere(1, black)
    light(stage, "world")
    assert apart(stage, 0.03, BALL) < 0.03
    white = stage.material(PRINCIPLED, Base_Color=(1, 1, 1, 1), IOR=ior, Roughness=roughness)
    ball.data.materials[0] = white
    assert stage.mitsuba(spp=64, depth=8)[BALL].mean() == pytest.approx(0.5, rel=0.02)


def test_nothing_but_a_volume_is_clear(stage):
    material = stage.material()
    tree = material.node_tree
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    mist = tree.nodes.new("ShaderNodeVolumeScatter")
    mist.inputs["Density"].default_value = 0.0
    tree.links.new(mist.outputs[0], output.inputs["Volume"])
    stage.sphere(1, material)
    stage.world((0.2, 0.4, 0.6))
    assert stage.mitsuba(spp=4) == pytest.approx(stage.cycles(spp=4), abs=1e-4)
    assert features(stage.export()) == {"Volume"}


def test_named_uv_map(stage):
    material = stage.material(EMISSION)
    texture = stage.texture(material, quadrant_image(stage), "Color")
    plane = stage.plane(2, material)
    second = plane.data.uv_layers.new(name="second")
    second.uv.foreach_set("vector", np.tile([0.25, 0.25], 4).astype(np.float32))
    assert stage.mitsuba(spp=16)[13, 13] == pytest.approx((1, 0, 0), abs=0.02)
    node = material.node_tree.nodes.new("ShaderNodeUVMap")
    node.uv_map = "second"
    material.node_tree.links.new(node.outputs["UV"], texture.inputs["Vector"])
    assert stage.mitsuba(spp=16)[13, 13] == pytest.approx((0, 0, 1), abs=0.02)
    second.active_render = True
    material.node_tree.nodes.remove(node)
    assert stage.mitsuba(spp=16)[13, 13] == pytest.approx((0, 0, 1), abs=0.02)


def test_roughness_texture_equals_the_constant(stage):
    constant = stage.material(PRINCIPLED, Base_Color=(0.2, 0.2, 0.2, 1), Roughness=0.3)
    textured = stage.material(PRINCIPLED, Base_Color=(0.2, 0.2, 0.2, 1))
    stage.texture(
        textured, stage.image(np.full((4, 4, 3), 0.3), space="Non-Color", float_buffer=True), "Roughness"
    )
    plane = stage.plane(6, constant)
    stage.lamp("AREA", 100, (0.5, 0, 3), size=0.3)
    first = stage.mitsuba(spp=64)
    plane.data.materials[0] = textured
    assert stage.mitsuba(spp=64) == pytest.approx(first, rel=0.01)


def test_mix_add_and_groups(stage):
    material = stage.material(EMISSION, Color=(1, 0, 0, 1), Strength=2.0)
    tree = material.node_tree
    emission = next(n for n in tree.nodes if n.bl_idname == EMISSION)
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    group = bpy.data.node_groups.new("inner", "ShaderNodeTree")
    group.interface.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    group.interface.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    inside, outside = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    diffuse = group.nodes.new(DIFFUSE)
    group.links.new(inside.outputs["Tint"], diffuse.inputs["Color"])
    group.links.new(diffuse.outputs[0], outside.inputs[0])
    node = tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.inputs["Tint"].default_value = (0.2, 0.6, 0.4, 1)
    mix = tree.nodes.new("ShaderNodeMixShader")
    mix.inputs[0].default_value = 0.25
    tree.links.new(emission.outputs[0], mix.inputs[1])
    tree.links.new(node.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    plane = stage.plane(6, material)
    stage.world((1, 1, 1))
    assert stage.mitsuba()[MIDDLE].mean((0, 1)) == pytest.approx((1.55, 0.15, 0.1), abs=0.01)
    assert stage.ratio(spp=32) == pytest.approx(np.ones(3), abs=0.02)
    add = tree.nodes.new("ShaderNodeAddShader")
    tree.links.new(emission.outputs[0], add.inputs[0])
    tree.links.new(node.outputs[0], add.inputs[1])
    tree.links.new(add.outputs[0], output.inputs["Surface"])
    assert stage.mitsuba()[MIDDLE].mean((0, 1)) == pytest.approx((2.2, 0.6, 0.4), abs=0.02)
    assert stage.export().notes == []
    assert plane.data.materials[0] == material


def test_finds_the_active_output(stage):
    material = stage.material(EMISSION, Color=(1, 0, 0, 1))
    tree = material.node_tree
    other = tree.nodes.new(EMISSION)
    other.inputs["Color"].default_value = (0, 1, 0, 1)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(other.outputs[0], output.inputs["Surface"])
    for node in tree.nodes:
        if node.bl_idname == "ShaderNodeOutputMaterial":
            node.is_active_output = node == output
    stage.plane(6, material)
    assert stage.mitsuba(spp=4)[MIDDLE].mean((0, 1)) == pytest.approx((0, 1, 0))


def test_unsupported_features_are_noted(stage):
    material = stage.material(PRINCIPLED, Subsurface_Weight=0.5, Thin_Film_Thickness=400.0)
    tree = material.node_tree
    principled = next(n for n in tree.nodes if n.bl_idname == PRINCIPLED)
    output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[1], principled.inputs["Base Color"])
    tree.links.new(tree.nodes.new("ShaderNodeBump").outputs[0], principled.inputs["Normal"])
    tree.links.new(tree.nodes.new("ShaderNodeVolumePrincipled").outputs[0], output.inputs["Volume"])
    stage.plane(6, material)
    stage.world()
    assert features(stage.export()) == {
        "Principled Subsurface Weight",
        "Principled Thin Film Thickness",
        "Noise Texture node into Base Color",
        "Bump node into Normal",
        "Volume",
    }


def test_unknown_shaders_fall_back_to_the_viewport_color(stage):
    material = stage.material("ShaderNodeBsdfToon")
    material.diffuse_color = (0.2, 0.4, 0.6, 1)
    stage.plane(6, material)
    stage.world()
    assert stage.mitsuba()[MIDDLE].mean((0, 1)) == pytest.approx((0.2, 0.4, 0.6), abs=0.01)
    assert features(stage.export()) == {"Toon BSDF node"}
