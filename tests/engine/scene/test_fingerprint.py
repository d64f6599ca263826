"""Digests of scenes: another for each change that may change the light, the same for the same scene."""

import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[3]
PIXELS = np.random.default_rng(1).random((3, 4, 3), np.float32)
MIRRORED = np.concatenate([PIXELS, PIXELS[:, ::-1]], axis=1)
SPARSE = np.zeros((64, 64, 1), np.float32)
SPARSE[40, 50] = 1
BENT = np.full((4, 4, 3), [0.55, 0.5, 0.99], np.float32)
PROFILE = np.ones((4, 8, 3), np.float32)
RADIANCE = {"type": "rgb", "value": [1.0, 2.0, 3.0]}


def changed(array, index=0, by=1e-3):
    """A copy with one number changed."""
    array = array.copy()
    array.flat[index] += by
    return array


def moved(*by):
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


def turned(angle):
    sine, cosine = math.sin(angle), math.cos(angle)
    matrix = np.eye(4)
    matrix[np.ix_([0, 2], [0, 2])] = [[cosine, -sine], [sine, cosine]]
    return matrix


def rgb(red, green=0.5, blue=0.5):
    return {"type": "rgb", "value": [red, green, blue]}


def bitmap(pixels=PIXELS, **settings):
    return {"type": "bitmap", "data": pixels, "raw": True, **settings}


def picture(pixels=PIXELS, **settings):
    return {"type": "picture", "bitmap": pixels, **settings}


def changes(kind, role, given, **others):
    """A plugin with and without each of the other settings; a name's last underscores tell variants apart."""
    for name, value in others.items():
        before = {"type": kind, **given}
        yield pytest.param({role: before}, {role: before | {name.rstrip("_"): value}}, id=f"{kind}-{name}")


GRAY, RED = {"type": "diffuse"}, {"type": "diffuse", "reflectance": rgb(0.9)}
METAL, GLOSS = {"type": "conductor"}, {"type": "gloss", "roughness": 0.3}
DISNEY = ("anisotropic", "roughness", "sheen", "sheen_tint", "spec_trans", "spec_tint", "flatness")
CHANGES = [
    *changes("diffuse", "bsdf", {}, reflectance=0.50001, reflectance_=rgb(0.5, 0.5, 0.50001)),
    *changes("plastic", "bsdf", {}, int_ior=1.6, ext_ior=1.1, nonlinear=True, diffuse_reflectance=0.4),
    *changes("plastic", "bsdf", {}, specular_reflectance=0.9),
    *changes("roughplastic", "bsdf", {"alpha": 0.2}, alpha=0.20001, distribution="ggx", nonlinear=True),
    *changes("roughplastic", "bsdf", {}, int_ior=1.6, diffuse_reflectance=0.4, specular_reflectance=0.9),
    *changes("conductor", "bsdf", {"material": "Au"}, material="Ag", specular_reflectance=0.9),
    *changes("conductor", "bsdf", {"eta": 1.0, "k": 2.0}, eta=1.1, k=2.1),
    *changes("roughconductor", "bsdf", {"alpha": 0.2}, alpha=0.20001, distribution="ggx", material="Au"),
    *changes("roughconductor", "bsdf", {"alpha_u": 0.2, "alpha_v": 0.3}, alpha_u=0.3, alpha_v=0.2),
    *changes("roughconductor", "bsdf", {}, specular_reflectance=0.9),
    *changes("dielectric", "bsdf", {}, int_ior=1.6, specular_reflectance=0.9, specular_transmittance=0.9),
    *changes("thindielectric", "bsdf", {}, int_ior=1.6, specular_reflectance=0.9, specular_transmittance=0.9),
    *changes("roughdielectric", "bsdf", {"alpha": 0.2}, alpha=0.3, distribution="ggx", int_ior=1.6),
    *changes("roughdielectric", "bsdf", {}, specular_reflectance=0.9, specular_transmittance=0.9),
    *changes("principled", "bsdf", {}, base_color=rgb(0.4), **dict.fromkeys(DISNEY, 0.3)),
    *changes("principled", "bsdf", {"clearcoat": 0.1}, clearcoat=0.3, clearcoat_gloss=0.3, metallic=0.3),
    *changes("principled", "bsdf", {}, specular=0.6, eta=1.4),
    *changes("principledthin", "bsdf", {}, base_color=rgb(0.4), eta=1.4, diff_trans=0.3),
    *changes("principledthin", "bsdf", {}, **dict.fromkeys(DISNEY, 0.3)),
    *changes("twosided", "bsdf", {"a": GRAY}, a=RED, b=RED),
    *changes("mask", "bsdf", {"a": GRAY, "opacity": 0.5}, opacity=0.50001, opacity_=bitmap(SPARSE), a=RED),
    *changes("blendbsdf", "bsdf", {"a": GRAY, "b": METAL, "weight": 0.5}, weight=0.50001, a=METAL, b=RED),
    *changes("bumpmap", "bsdf", {"t": bitmap(), "a": GRAY}, scale=1.00001, t=bitmap(changed(PIXELS)), a=RED),
    *changes("bumpmap", "bsdf", {"t": bitmap(), "a": METAL}, flip_invalid_normals=False),
    *changes("bumpmap", "bsdf", {"t": bitmap(), "a": METAL}, use_shadowing_function=False),
    *changes(
        "normalmap", "bsdf", {"normalmap": bitmap(BENT), "a": GRAY}, normalmap=bitmap(changed(BENT)), a=RED
    ),
    *changes("normalmap", "bsdf", {"normalmap": bitmap(BENT), "a": GLOSS}, flip_invalid_normals=False),
    *changes("normalmap", "bsdf", {"normalmap": bitmap(BENT), "a": GLOSS}, use_shadowing_function=False),
    *changes("diffuse", "bsdf", {}, type="plastic", type_="null"),
    # ours
    *changes("gloss", "bsdf", {}, reflectance=0.9, roughness=0.2, ior=1.5, f0=rgb(0.4)),
    *changes("gloss", "bsdf", GLOSS, roughness=0.30001, aspect=0.5, rotation=0.1, distribution="ggx"),
    *changes(
        "gloss", "bsdf", GLOSS | {"distribution": "ggx", "ior": 1.5}, distribution="beckmann", ior=1.50001
    ),
    *changes("gloss", "bsdf", {"f0": rgb(0.5), "edge": rgb(0.5)}, f0=rgb(0.6), edge=rgb(0.6)),
    *changes(
        "glass", "bsdf", {}, ior=1.6, transmittance=0.9, reflectance=0.9, specular_tint=0.9, fresnel=False
    ),
    *changes("glass", "bsdf", GLOSS, roughness=0.4, distribution="ggx", distribution_="beckmann"),
    *changes("sheen", "bsdf", {}, reflectance=0.9, roughness=0.4),
    *changes("matt", "bsdf", {}, reflectance=0.4, roughness=0.4, translucent=True),
    *changes("clear", "bsdf", {}, transmittance=0.9),
    *changes(
        "mixture", "bsdf", {"a": GRAY, "b": GLOSS}, weight=0.50001, weight_=bitmap(), mode="add", mode_="over"
    ),
    *changes(
        "mixture", "bsdf", {"a": GRAY, "b": GLOSS}, a=RED, b={"type": "sheen"}, fresnel_ior=1.5, facing=1.5
    ),
    *changes(
        "mixture",
        "bsdf",
        {"a": GRAY, "b": GLOSS, "mode": "over", "tint": rgb(0.5)},
        tint=rgb(0.6),
        int_ior=1.6,
    ),
    *changes("mixture", "bsdf", {"a": GRAY, "b": GLOSS, "mode": "over"}, tint=rgb(0.5)),
    *changes("mixture", "bsdf", {"a": GRAY, "b": GLOSS, "fresnel_ior": 1.4}, fresnel_ior=1.5),
    *changes("mixture", "bsdf", {"a": GRAY, "b": GLOSS, "facing": 1.4}, facing=1.5),
    *changes(
        "dispersive_dielectric", "bsdf", {}, int_ior=1.6, abbe=30.0, ext_ior=1.1, specular_reflectance=0.9
    ),
    *changes("dispersive_dielectric", "bsdf", {}, specular_transmittance=0.9),
    # textures
    *changes(
        "bitmap", "texture", bitmap(), data=changed(PIXELS), filter_type="nearest", to_uv=moved(0.1, 0, 0)
    ),
    *changes("bitmap", "texture", bitmap(), wrap_mode="mirror", wrap_mode_="clamp"),
    *changes(
        "bitmap", "texture", bitmap(MIRRORED, wrap_mode="mirror"), wrap_mode="clamp", filter_type="nearest"
    ),
    *changes("bitmap", "texture", bitmap(MIRRORED), wrap_mode="mirror", to_uv=np.diag([1, 1.001, 1, 1])),
    *changes(
        "bitmap", "texture", bitmap(SPARSE), filter_type="nearest", wrap_mode="mirror", wrap_mode_="clamp"
    ),
    *changes("bitmap", "texture", bitmap(to_uv=turned(0.3)), filter_type="nearest", wrap_mode="mirror"),
    *changes("picture", "texture", picture(), bitmap=changed(PIXELS), srgb=True, gray=True, limit=0.5),
    *changes(
        "picture", "texture", picture(), wrap_mode="black", filter_type="cubic", to_uv=moved(1e-6, 0, 0)
    ),
    *changes("picture", "texture", picture(), power=0.5, scale_g=1.00001, offset_b=0.00001),
    *changes("picture", "texture", picture(np.ones((2, 2, 4), np.float32)), unassociate=True),
    *changes("checkerboard", "texture", {}, color0=0.5, color1=0.5, to_uv=moved(0.1, 0, 0)),
    *changes("mesh_attribute", "texture", {"name": "vertex_a"}, name="vertex_b", scale=1.001),
    # emitters
    *changes("point", "light", {}, position=[0.0, 0.0, 1e-6], intensity=RADIANCE),
    *changes(
        "spot", "light", {}, cutoff_angle=21.0, beam_width=14.0, intensity=RADIANCE, to_world=moved(0, 0, 1)
    ),
    *changes("spot", "light", {}, texture=bitmap()),
    *changes("spot", "light", {"texture": bitmap()}, texture=bitmap(wrap_mode="clamp")),
    *changes(
        "spot", "light", {"intensity": {"type": "blackbody", "temperature": 3000.0}}, intensity=RADIANCE
    ),
    *changes("directional", "light", {}, direction=[0.0, 0.1, 1.0], irradiance=RADIANCE),
    *changes("constant", "light", {}, radiance=rgb(1.0, 1.0, 1.00001)),
    *changes(
        "envmap", "light", {"bitmap": PIXELS}, bitmap=changed(PIXELS), scale=1.001, to_world=turned(1e-4)
    ),
    *changes("area", "emitter", {}, radiance=RADIANCE, sampling_weight=0.5),
    *changes("area", "emitter", {"radiance": bitmap()}, radiance=bitmap(changed(PIXELS))),
    *changes("directionalarea", "emitter", {}, radiance=RADIANCE, type="area"),
    *changes(
        "point_lamp",
        "light",
        {"to_world": np.eye(4), "intensity": [1.0, 2.0, 3.0], "cone": 0.5, "radius": 0.1, "profile": PROFILE},
        **{
            "to_world": moved(0, 0, 1e-6),
            "intensity": [1.0, 2.0, 3.00001],
            "radius": 0.10001,
            "sphere": True,
        },
        **{"cone": 0.50001, "blend": 0.1, "profile": changed(PROFILE, 50), "falloff": 1, "unit": 2.0},
        to_world_=turned(1e-6),
    ),
    *changes(
        "point_lamp",
        "light",
        {"to_world": np.eye(4), "intensity": [1.0, 2.0, 3.0]},
        profile=PROFILE,
        cone=0.5,
    ),
    *changes(
        "area_lamp",
        "light",
        {"to_world": np.eye(4), "radiance": [1.0, 2.0, 3.0], "width": 1.0, "height": 1.0},
        **{
            "to_world": moved(0, 0, 1e-6),
            "radiance": [1.0, 2.0, 3.00001],
            "width": 1.00001,
            "height": 1.00001,
        },
        **{"round": True, "spread": 3.0, "profile": PROFILE},
    ),
    *changes(
        "sun_lamp",
        "light",
        {"to_world": np.eye(4), "irradiance": [1.0, 2.0, 3.0]},
        **{"to_world": turned(1e-6), "irradiance": [1.0, 2.0, 3.00001], "radius": 0.1},
    ),
    # shapes
    *changes("sphere", "shape", {}, center=[0.0, 0.0, 1e-6], radius=1.00001, flip_normals=True, type="disk"),
    *changes("disk", "shape", {}, to_world=moved(0, 0, 1e-6), flip_normals=True, bsdf=RED),
    *changes(
        "rectangle",
        "shape",
        {},
        to_world=moved(0, 0, 1e-6),
        flip_normals=True,
        bsdf=RED,
        emitter={"type": "area"},
    ),
    *changes(
        "cylinder", "shape", {}, p0=[0.0, 0.0, 1e-6], p1=[0.0, 0.0, 2.0], radius=1.00001, flip_normals=True
    ),
    *changes("cube", "shape", {}, to_world=moved(0, 0, 1e-6), flip_normals=True, face_normals=True),
    *changes("linearcurve", "shape", {"filename": "curve.txt"}, filename="thick.txt", type="bsplinecurve"),
    *changes("sphere", "shape", {"vertex_a": bitmap()}, vertex_a=bitmap(changed(PIXELS))),
]


@pytest.fixture
def mi(backend):
    import mitsuba

    return mitsuba


@pytest.fixture
def digest(backend):
    from holopath_addon.engine.scene.fingerprint import scene_digest

    return scene_digest


@pytest.fixture
def curves(tmp_path):
    """Folder of curves' control points."""
    for name, radius in (("curve", 0.1), ("thick", 0.2)):
        points = "".join(f"{x} {x * x} 0 {radius}\n" for x in range(5))
        (tmp_path / f"{name}.txt").write_text(points)
    return tmp_path


def made(value, name="", folder=None):
    """What `mitsuba.load_dict` takes, of arrays and file names as above."""
    import mitsuba as mi

    if isinstance(value, dict):
        return {name: made(part, name, folder) for name, part in value.items()}
    if name == "filename":
        return str(folder / value)
    if not isinstance(value, np.ndarray):
        return value
    if name.startswith("to_"):
        return mi.ScalarTransform4f(value)
    return mi.Bitmap(value) if name == "bitmap" else mi.TensorXf(value)


def placed(part):
    """A scene that has the part of one role."""
    ((role, part),) = part.items()
    if role == "shape":
        return {"shape": part}
    shape = {"type": "sphere", "bsdf": GRAY}
    if role == "light":
        return {"shape": shape, "light": part}
    if role == "texture":
        role, part = "bsdf", {"type": "diffuse", "reflectance": part}
    return {"shape": shape | {role: part}}


def loaded(parts, folder=None):
    import mitsuba as mi

    return mi.load_dict({"type": "scene"} | made(parts, "", folder))


@pytest.mark.parametrize(("before", "after"), CHANGES)
def test_every_change_is_seen(digest, curves, before, after):
    first, again, other = (digest(loaded(placed(part), curves)) for part in (before, before, after))
    assert first == again
    assert first != other


def mesh(mi, vertices, faces, color=0.5, bsdf=None):
    """A mesh with an attribute of its vertices."""
    properties = mi.Properties()
    properties["bsdf"] = bsdf or mi.load_dict(GRAY)
    found = mi.Mesh("mesh", len(vertices), len(faces), props=properties, has_vertex_texcoords=True)
    found.add_attribute("vertex_color", 3, np.full(3 * len(vertices), color, np.float32))
    parameters = mi.traverse(found)
    parameters["vertex_positions"], parameters["faces"] = np.ravel(vertices), np.ravel(faces)
    parameters.update()
    return found


def test_meshes(mi, digest):
    vertices = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0.5]])
    faces = np.uint32([[0, 1, 2], [2, 1, 3]])
    turned_face = np.uint32([[0, 1, 2], [2, 3, 1]])
    kinds = [
        (vertices, faces),
        (changed(vertices, 11, 1e-6), faces),
        (vertices, turned_face),
        (vertices, faces, 0.6),
    ]
    found = [digest(mi.load_dict({"type": "scene", "mesh": mesh(mi, *kind)})) for kind in kinds]
    assert len(set(found)) == 4
    assert digest(mi.load_dict({"type": "scene", "another": mesh(mi, *kinds[0])})) == found[0]


def test_attributes_of_rectangles_are_not_seen_so_they_match_nothing(mi, digest):
    rectangle = mi.load_dict({"type": "rectangle"})
    scene = mi.load_dict({"type": "scene", "shape": rectangle})
    assert digest(scene) == digest(scene)
    rectangle.add_attribute("vertex_color", 3, [0.5] * 12)
    assert digest(scene) != digest(scene)


def instances(mi, radii=(1.0, 2.0), shown=(0, 1), place=3.0):
    """Two groups of one name and the instances of those `shown`."""
    groups = [
        mi.load_dict({"type": "shapegroup", "ball": {"type": "sphere", "radius": r}, "box": {"type": "cube"}})
        for r in radii
    ]
    parts = {f"group_{number}": group for number, group in enumerate(groups)}
    for number, group in enumerate(shown):
        to_world = mi.ScalarTransform4f().translate([place * number, 0, 0])
        parts[f"instance_{number}"] = {"type": "instance", "group": groups[group], "to_world": to_world}
    return mi.load_dict({"type": "scene", **parts})


def test_instances(mi, digest):
    kinds = {}, {"radii": (1.0, 2.1)}, {"shown": (1, 0)}, {"shown": (0, 0)}, {"place": 3.001}
    found = [digest(instances(mi, **kind)) for kind in kinds]
    assert len(set(found)) == len(kinds)
    scene = instances(mi)
    names = str(scene)
    assert digest(scene) == digest(scene) == found[0]
    assert str(scene) == names


def boxes():
    """Shapes with equal materials, which Mitsuba merges."""
    return {
        f"box_{x}": {"type": "cube", "to_world": moved(3 * x, 9, 0), "bsdf": (GRAY, RED)[x % 2]}
        for x in range(9)
    }


def gallery():
    """A scene of everything that the exporter makes, and more."""
    wood = bitmap(filter_type="nearest", wrap_mode="mirror", to_uv=turned(0.1))
    layers = {
        "type": "mixture",
        "a": {"type": "matt", "reflectance": wood},
        "b": GLOSS | {"ior": 1.5},
        "mode": "over",
    }
    painted = {"type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}
    bent = {"type": "normalmap", "normalmap": bitmap(BENT), "a": {"type": "twosided", "a": painted}}
    return {
        "layered": {"type": "sphere", "bsdf": layers},
        "bent": {"type": "rectangle", "to_world": moved(0, 2, 0), "bsdf": bent},
        "bumpy": {"type": "disk", "bsdf": {"type": "bumpmap", "t": bitmap(), "a": layers}},
        "glass": {
            "type": "cube",
            "to_world": moved(2, 0, 0),
            "bsdf": {"type": "dispersive_dielectric", "ext_ior": 1.33},
        },
        "shining": {"type": "sphere", "radius": 0.1, "emitter": {"type": "area", "radiance": bitmap()}},
        "half": {
            "type": "sphere",
            "center": [0.0, 3.0, 0.0],
            "bsdf": {"type": "diffuse", "reflectance": bitmap(format="fp16")},
        },
        "lamp": {
            "type": "point_lamp",
            "to_world": np.eye(4),
            "intensity": [1.0, 2.0, 3.0],
            "profile": PROFILE,
        },
        "sky": {"type": "envmap", "bitmap": PIXELS, "to_world": turned(0.2)},
    }


def test_another_process_finds_the_same(digest, backend):
    script = (
        "from holopath_addon.engine.scene import variants\n"
        f"variants.activate({backend!r})\n"
        "from holopath_addon.engine.scene.fingerprint import scene_digest\n"
        "from test_fingerprint import boxes, gallery, loaded\n"
        "print(scene_digest(loaded(gallery() | boxes())))"
    )
    paths = [str(ROOT), str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    there = subprocess.run(
        [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
    )
    assert there.stdout.split()[-1] == digest(loaded(gallery() | boxes()))


def test_a_processor_that_rounds_otherwise_finds_the_same(monkeypatch, digest):
    from holopath_addon.engine.scene import fingerprint

    expected = digest(loaded(gallery()))
    scattered = fingerprint._scattered
    monkeypatch.setattr(fingerprint, "_scattered", lambda bsdf: scattered(bsdf).astype(np.float16))
    assert digest(loaded(gallery())) == expected


def test_names_order_cameras_and_renders_do_not_matter(mi, digest):
    from holopath_addon.engine.scene.dispersion import tuned

    parts = gallery()
    scene = loaded(parts)
    expected = digest(scene)
    assert digest(loaded({f"my_{name}": parts[name] for name in sorted(parts)})) == expected
    for place in (5, 500):
        film = {"type": "hdrfilm", "width": 4, "height": 4}
        camera = {"type": "perspective", "to_world": moved(0, 0, place), "film": film}
        viewed = loaded(parts | {"camera": camera, "integrator": {"type": "path", "max_depth": place}})
        assert digest(viewed) == expected
    mi.render(viewed, spp=1).numpy()
    assert digest(viewed) == expected
    with tuned(scene, [486e-9]):
        assert digest(scene) != expected
    assert digest(scene) == expected


def test_profiles_may_be_pictures(mi, digest):
    lamp = {"type": "point_lamp", "to_world": mi.ScalarTransform4f(), "intensity": [1.0, 2.0, 3.0]}
    pictures = [mi.Bitmap(PROFILE), mi.Bitmap(changed(PROFILE, 50))]
    first, other = (
        mi.load_dict({"type": "scene", "lamp": lamp | {"profile": picture}}) for picture in pictures
    )
    assert digest(first) != digest(other)


def test_what_is_not_known_matches_nothing(mi, digest):
    class Own(mi.BSDF):
        def to_string(self):
            return "Own[]"

        def traverse(self, callback):
            pass

    mi.register_bsdf("own_of_this_test", Own)
    flat = {"type": "diffuse", "reflectance": bitmap(to_uv=np.diag([0.0, 1, 1, 1]))}
    for bsdf in ({"type": "hair"}, {"type": "own_of_this_test"}, flat):
        scene = loaded({"shape": {"type": "sphere", "bsdf": bsdf}})
        assert digest(scene) != digest(scene)
