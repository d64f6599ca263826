"""Many small objects as few meshes: the same light everywhere, and apart where something tells them apart."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.engine.light.unwrapping import CHARTED_TRIANGLES  # noqa: E402
from holopath_addon.engine.scene.meshes import joining  # noqa: E402
from holopath_addon.export import ExportCache, contents  # noqa: E402
from tests.export.test_cache import assert_same, exported  # noqa: E402


@pytest.fixture
def crowd(stage):
    """Boxes, every third with a UV map that its material reads, on a floor; half of them smooth."""
    rng = np.random.default_rng(0)
    picture = stage.image(rng.random((4, 4, 3)))
    looks = [
        stage.material("ShaderNodeBsdfDiffuse", f"color {k}", Color=(*rng.random(3), 1)) for k in range(3)
    ]
    stage.texture(looks[0], picture, "Color")
    stage.plane(4, looks[1], "floor")
    for number in range(80):
        box = stage.plane(0.3, looks[number % 3], f"box {number}")
        box.data.polygons[0].use_smooth = number % 2 == 1
        box.location = (number % 9 / 2.5 - 1.6, number // 9 / 2.5 - 1.6, 0.3 + 0.1 * rng.random())
        box.rotation_euler = rng.random(3)
    stage.lamp("POINT", 20.0, (0.5, 0.2, 2))
    return stage


def apart(monkeypatch):
    monkeypatch.setattr(joining, "MANY_MESHES", 10**9)


def shapes_of(scene):
    """Shapes by their names, of which each is there once."""
    shapes = {str(shape).split('name = "')[1].split('"')[0]: shape for shape in scene.shapes()}
    assert len(shapes) == len(scene.shapes())
    return shapes


def test_paths_are_the_same_to_the_bit(crowd, monkeypatch):
    joined = crowd.export()
    # floor, and for each color smooth and flat ones
    assert set(shapes_of(joined.scene)) >= {"floor", "box 0 and 13 more", "box 4 and 12 more"}
    assert len(joined.scene.shapes()) == 1 + 6
    view = crowd.mitsuba(exported=joined, spp=16)
    apart(monkeypatch)
    separate = crowd.export()
    assert len(separate.scene.shapes()) == 1 + 80
    assert np.array_equal(view, crowd.mitsuba(exported=separate, spp=16))
    assert [str(note) for note in joined.notes] == [str(note) for note in separate.notes]


@pytest.mark.slow
def test_baked_light_is_the_same(crowd, monkeypatch):
    """Holograms by light that was baked twice, each with noise of its own."""
    from holopath_addon import engine

    crowd.camera.location = (0, 0, 6)
    hologram = engine.Hologram(width=96, height=96, pitch=8e-6, wavelengths=(516.5e-9,))
    settings = engine.Settings(frames=8, method="fast", seed=1, quality="preview")

    def view():
        scene = crowd.export((96, 96))
        field = engine.render(scene.scene, scene.camera, hologram, settings)
        assert not field.report["bake"]["traced"]
        return np.asarray(engine.reconstruct(field, focus=[6.0]))[0, 8:-8, 8:-8, 0], field.report["bake"]

    joined, bake = view()
    apart(monkeypatch)
    separate, baked_apart = view()
    difference = np.linalg.norm(joined - separate) / np.linalg.norm(separate)
    assert difference < np.hypot(bake["error"], baked_apart["error"])
    assert joined.mean() == pytest.approx(separate.mean(), rel=0.01)


def test_what_stays_a_mesh_of_its_own(crowd):
    lamp = crowd.material("ShaderNodeEmission", "lamp")
    for number in range(70):
        crowd.plane(0.05, lamp, f"lamp {number}", (0, 0, 1 + 0.01 * number))
    long = crowd.plane(0.1, bpy.data.materials["color 1"], "long", (0, 0, 0.5))
    long.scale = (20, 1, 1)
    crowd.sphere(0.1, bpy.data.materials["color 2"], (0, 0, 0.6), "fine")
    fine = bpy.data.objects["fine"].modifiers.new("fine", "SUBSURF")
    fine.levels = fine.render_levels = 2
    exported = crowd.export()
    shapes = [str(shape).split('name = "')[1].split('"')[0] for shape in exported.scene.shapes()]
    assert {"floor", "long", "fine"} < set(shapes)
    assert sum(name.startswith("lamp ") for name in shapes) == 2 * 70 == len(exported.scene.emitters()) - 1
    assert len(shapes) == 3 + 140 + 6


def test_joined_meshes_have_charts(stage):
    """Joined meshes have at most the triangles that baked light unwraps."""
    if CHARTED_TRIANGLES:  # there is xatlas
        assert joining.MAX_TRIANGLES == CHARTED_TRIANGLES
    gray = stage.material("ShaderNodeBsdfDiffuse", "gray")
    stage.sphere(0.1, gray)
    sphere = bpy.data.objects["sphere"]
    for number in range(joining.MANY_MESHES):
        copy = stage.link(bpy.data.objects.new(f"copy {number}", sphere.data))
        copy.location = (number % 8, number // 8, 0)
    faces = [shape.face_count() for shape in stage.export().scene.shapes()]
    assert max(faces) <= joining.MAX_TRIANGLES
    assert len(faces) == -(-sum(faces) // max(faces)) > 1


def test_what_moves_leaves_the_triangles_of_meshes(crowd):
    """So that baked light keeps its charts from one frame of an animation to the next."""
    before = shapes_of(crowd.export().scene)
    for number in range(0, 80, 7):
        bpy.data.objects[f"box {number}"].location.x *= -1
    bpy.context.view_layer.update()
    after = shapes_of(crowd.export().scene)
    assert set(before) == set(after)
    for name, shape in before.items():
        assert np.array_equal(np.array(shape.faces_buffer()), np.array(after[name].faces_buffer()))


def test_a_kept_export_joins_anew_what_changed(crowd):
    cache = ExportCache()
    try:
        before = shapes_of(exported(cache).scene)
        bpy.data.objects["box 4"].location.z += 0.5
        after = shapes_of(exported(cache).scene)
        assert [name for name in before if after[name] is not before[name]] == ["box 4 and 12 more"]
        assert_same(cache)
        for number in range(40):  # few are left, which are no longer joined
            bpy.data.objects[f"box {number}"].hide_render = True
        assert_same(cache)
        for number in range(40):
            bpy.data.objects[f"box {number}"].hide_render = False
        assert_same(cache)
        # a mesh beside the joined one would cost as much as before, though no scene shows it
        shapes = [shape for kept in cache._meshes.values() for shape in kept.shapes.values()]
        pieces = [piece for _, done in shapes for slot in done.values() for piece in slot]
        assert [piece.name for piece in pieces if piece.mesh is not None] == ["floor"]
        assert len(pieces) == 81
    finally:
        cache.close()


def test_repeated_meshes_are_copied_within_bounds(stage, monkeypatch):
    """The first ones, as far as there is room for copies: the cost of instances grows with their number's square."""
    gray = stage.material("ShaderNodeBsdfDiffuse", "gray")
    for kind in ("a", "b", "c"):
        first = stage.plane(0.1, gray, kind)
        for number in range(29):
            copy = stage.link(bpy.data.objects.new(f"{kind} {number}", first.data))
            copy.location = (number, ord(kind), 0)
    monkeypatch.setattr(contents, "MAX_COPIED_TRIANGLES", 2 * 30 * 2)
    shapes = stage.export().scene.shapes()
    assert sum(shape.is_mesh() for shape in shapes) == 2 * 30
    assert len(shapes) == 3 * 30
