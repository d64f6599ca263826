"""Hair as tubes and points as balls: their measures, and Cycles' picture of the same."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon.export.hair_and_points import balls, tubes  # noqa: E402

from .test_geometry import area, bounds  # noqa: E402


def curves(stage, lines, radius, material=None):
    data = bpy.data.hair_curves.new("fur")
    data.add_curves([len(line) for line in lines])
    data.attributes["position"].data.foreach_set("vector", np.concatenate(lines).astype(np.float32).ravel())
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set(
        "value", np.broadcast_to(radius, sum(map(len, lines))).astype(np.float32)
    )
    if material is not None:
        data.materials.append(material)
    return stage.link(bpy.data.objects.new("fur", data))


def test_a_tube_has_the_width_of_its_circle():
    line = np.array([(0, 0, z) for z in np.linspace(0, 2, 9)])
    surface = tubes(line, np.full(9, 0.1), np.array([9]))
    # Cauchy: the lateral area of a straight tube over its length is pi times the mean width
    assert surface.area() == pytest.approx(np.pi * 0.2 * 2, rel=1e-5)
    weighted = np.cross(
        *(surface.vertices[surface.faces[:, k]] - surface.vertices[surface.faces[:, 0]] for k in (1, 2))
    )
    outward = surface.vertices[surface.faces].mean(1) * (1, 1, 0)
    assert ((weighted * outward).sum(1) > 0).all()


def test_bent_and_broken_lines_stay_finite():
    turn = np.linspace(0, 4 * np.pi, 60)
    spiral = np.stack([np.cos(turn), np.sin(turn), 0.1 * turn], axis=1)
    hairpin = np.array([(0, 0, 0), (0, 0, 1), (0, 0, 0)])
    point = np.zeros((3, 3))
    lines = [spiral, hairpin, point, np.zeros((1, 3)), np.zeros((0, 3))]
    surface = tubes(np.concatenate(lines), np.full(67, 0.01), np.array([60, 3, 3, 1, 0]))
    assert np.isfinite(surface.vertices).all() and np.isfinite(surface.normals).all()
    assert np.linalg.norm(surface.normals, axis=1) == pytest.approx(1, abs=1e-5)
    length = np.linalg.norm(np.diff(spiral, axis=0), axis=1).sum()
    assert tubes(spiral, np.full(60, 0.01), np.array([60])).area() == pytest.approx(
        2 * np.pi * 0.01 * length, rel=0.02
    )
    assert tubes(np.zeros((1, 3)), np.zeros(1), np.array([1])) is None


def test_hair_curves_are_where_they_are(stage):
    stage.scene.unit_settings.scale_length = 0.1
    obj = curves(stage, [np.array([(0, 0, 0), (0, 0, 1), (0, 0, 2)])], 0.05)
    obj.location = (3, 0, 0)
    scene = stage.export().scene
    assert bounds(scene)[:, 2] == pytest.approx((0, 0.2), abs=1e-6)
    assert bounds(scene)[:, 0].mean() == pytest.approx(0.3)
    assert area(scene) == pytest.approx(2 * np.pi * 0.05 * 2 * 0.01, rel=1e-4)


def _lit(stage):
    stage.world((1, 1, 1), 0.5)
    stage.lamp("SUN", 2.0, rotation=(0.5, 0.2, 0))
    return stage.material("ShaderNodeBsdfDiffuse", "hair", Color=(0.7, 0.4, 0.2, 1))


def test_hair_curves_look_as_in_cycles(stage):
    material = _lit(stage)
    rng = np.random.default_rng(1)
    roots = np.column_stack([rng.uniform(-1.2, 1.2, (60, 2)), np.zeros(60)])
    steps = np.linspace(0, 1, 5)[:, None]
    lines = [root + steps * rng.normal(size=3) + 0.3 * steps**2 * rng.normal(size=3) for root in roots]
    curves(stage, lines, 0.02, material)
    stage.plane(3, stage.material("ShaderNodeBsdfDiffuse", "ground", Color=(0.1, 0.1, 0.4, 1)))
    ours, theirs = stage.mitsuba((48, 48), 128), stage.cycles((48, 48), 128)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.03)


def _hairy(stage, size, material, length, radii):
    """A plane with 60 hairs, and their settings."""
    ground = stage.plane(size, stage.material("ShaderNodeBsdfDiffuse", "ground", Color=(0.1, 0.1, 0.4, 1)))
    ground.data.materials.append(material)
    ground.modifiers.new("hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 60, length
    settings.display_step = settings.render_step = 3
    settings.brownian_factor = 0.3
    settings.material, (settings.root_radius, settings.tip_radius) = 2, radii
    return ground, settings


@pytest.mark.parametrize("shown", [True, False])
def test_particle_hair_looks_as_in_cycles(stage, shown):
    material = _lit(stage)
    ground, settings = _hairy(stage, 2.4, material, length=1.0, radii=(6.0, 2.0))
    settings.shape = -0.5
    ground.show_instancer_for_render = ground.show_instancer_for_viewport = shown
    exported = stage.export((48, 48))
    ours, theirs = stage.mitsuba((48, 48), 128, exported=exported), stage.cycles((48, 48), 128)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.03)
    assert sum('"plane"' in str(shape) for shape in exported.scene.shapes()) == 1 + shown


def test_textures_on_hair_are_noted(stage):
    material = stage.material("ShaderNodeBsdfDiffuse", "textured")
    stage.texture(material, stage.image(np.full((4, 4, 3), 0.5)), "Color")
    curves(stage, [np.array([(0, 0, 0), (0, 0, 1)])], 0.05, material)
    stage.world()
    exported = stage.export()
    assert ("fur", "UV maps on hair or points") in {(n.object, n.feature) for n in exported.notes}
    assert np.isfinite(stage.mitsuba(spp=4, exported=exported)).all()


def test_a_render_has_its_own_steps(stage):
    ground = stage.plane()
    ground.modifiers.new("hair", "PARTICLE_SYSTEM")
    settings = ground.particle_systems[0].settings
    settings.type, settings.count, settings.hair_length = "HAIR", 3, 1.0
    settings.display_step, settings.render_step = 1, 4
    faces = []

    class Probe(bpy.types.RenderEngine):
        bl_idname = "HOLOPATH_HAIR_PROBE"
        bl_label = "Probe"

        def render(self, depsgraph):
            from holopath_addon.export import export_scene

            shapes = export_scene(depsgraph, (16, 16)).scene.shapes()
            faces.append(max(shape.face_count() for shape in shapes))

    bpy.utils.register_class(Probe)
    try:
        stage.scene.render.engine = "HOLOPATH_HAIR_PROBE"
        bpy.ops.render.render()
    finally:
        bpy.utils.unregister_class(Probe)
    assert faces == [3 * 2**4 * 12]
    assert max(shape.face_count() for shape in stage.export().scene.shapes()) == 3 * 2 * 12


@pytest.mark.parametrize("kind", ["curves", "particles"])
def test_hair_moves_with_the_origin_of_what_mitsuba_has(stage, kind):
    if kind == "curves":
        thing = curves(stage, [np.array([(0, 0, 0), (0, 0, 1)])], 0.05)
    else:
        thing = stage.plane()
        thing.modifiers.new("hair", "PARTICLE_SYSTEM")
        thing.particle_systems[0].settings.type = "HAIR"
        thing.show_instancer_for_render = thing.show_instancer_for_viewport = False
    here = bounds(stage.export().scene)
    for moved in (thing, stage.camera):
        moved.location.x += 640
    assert bounds(stage.export().scene) == pytest.approx(here, abs=1e-3)


def points(stage, places, radii, material=None):
    """A point cloud; geometry nodes are how Blender makes them."""
    mesh = stage.mesh("dots", [tuple(map(float, place)) for place in places], [])
    mesh.data.attributes.new("size", "FLOAT", "POINT").data.foreach_set("value", np.float32(radii))
    group = bpy.data.node_groups.new("to points", "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
    given, made = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    turned = group.nodes.new("GeometryNodeMeshToPoints")
    size = group.nodes.new("GeometryNodeInputNamedAttribute")
    size.data_type, size.inputs["Name"].default_value = "FLOAT", "size"
    group.links.new(given.outputs[0], turned.inputs["Mesh"])
    group.links.new(size.outputs["Attribute"], turned.inputs["Radius"])
    last = turned
    if material is not None:
        last = group.nodes.new("GeometryNodeSetMaterial")
        last.inputs["Material"].default_value = material
        group.links.new(turned.outputs[0], last.inputs["Geometry"])
    group.links.new(last.outputs[0], made.inputs[0])
    mesh.modifiers.new("to points", "NODES").node_group = group
    return mesh


@pytest.mark.parametrize("count", [1, 1000, 10_000, 50_000])
def test_balls_look_as_large_as_their_spheres(count):
    """However coarse: the mean of their outline is the circle's, from each side nearly so."""
    rng = np.random.default_rng(0)
    surface = balls(rng.normal(size=(count, 3)), np.full(count, 0.3))
    assert surface.area() / count == pytest.approx(4 * np.pi * 0.3**2, rel=1e-4)
    weighted = surface._area_normals()[: len(surface.faces) // count]
    outward = surface.normals[surface.faces[: len(weighted)]].mean(1)
    assert ((weighted * outward).sum(1) > 0).all()
    for side in rng.normal(size=(8, 3)):
        outline = 0.25 * np.abs(weighted @ (side / np.linalg.norm(side))).sum()
        assert outline == pytest.approx(np.pi * 0.3**2, rel=0.06)  # by sides' chance 1.6 %


def test_points_without_a_place_or_size_are_left_out():
    places = np.array([(0, 0, 0), (np.nan, 0, 0), (1, 0, 0), (2, 0, 0)])
    kept = balls(places, np.array([0.1, 0.1, 0.0, -1.0]))
    assert np.isfinite(kept.points).all() and np.abs(kept.points).max() < 0.11
    assert balls(places[:0], np.zeros(0)) is None


def test_points_look_as_in_cycles(stage):
    rng = np.random.default_rng(2)
    places, radii = rng.uniform(-1, 1, (25, 3)), rng.uniform(0.05, 0.3, 25)
    points(stage, places, radii, _lit(stage)).scale = (1.2, 1.2, 1.2)
    stage.plane(3, stage.material("ShaderNodeBsdfDiffuse", "ground", Color=(0.1, 0.1, 0.4, 1)))
    exported = stage.export()
    assert exported.notes == []
    ours, theirs = stage.mitsuba((32, 32), 64, exported=exported), stage.cycles((32, 32), 64)
    assert ours.mean((0, 1)) == pytest.approx(theirs.mean((0, 1)), rel=0.03)
    ours, theirs = (image.reshape(8, 4, 8, 4, 3).mean((1, 3)) for image in (ours, theirs))
    assert np.abs(ours - theirs).mean() < 0.05 * theirs.mean()


def test_curves_of_straight_pieces_look_as_in_cycles(stage):
    """Poly is what nodes make of edges; a spline through the same points bulges at each corner."""
    material = stage.material("ShaderNodeEmission")
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)])
    obj = curves(stage, [corners], 0.1, material)
    assert bounds(stage.export().scene)[1, 0] > 1.15
    obj.data.attributes.new("curve_type", "INT8", "CURVE").data.foreach_set("value", [1])
    exported = stage.export((48, 48))
    assert bounds(exported.scene)[1, 0] < 1.15
    ours, theirs = stage.mitsuba((48, 48), 64, exported=exported), stage.cycles((48, 48), 64)
    assert np.abs(ours - theirs).mean() < 0.15 * theirs.mean()  # with its spline 0.9


def test_a_radius_of_each_curve(stage):
    """Nodes store it on the curves, too."""
    data = curves(stage, [np.array([(0, 0, 0), (0, 0, 1)]), np.array([(1, 0, 0), (1, 0, 1)])], 0.1).data
    data.attributes.remove(data.attributes["radius"])
    data.attributes.new("radius", "FLOAT", "CURVE").data.foreach_set("value", [0.1, 0.3])
    assert area(stage.export().scene) == pytest.approx(2 * np.pi * (0.1 + 0.3), rel=1e-3)


@pytest.mark.parametrize("case", ["scaled", "spiral", "children"])
def test_hair_as_its_emitter_and_system_have_it(stage, case):
    """Thick as the emitter's scale makes it, with the curl at its end, and children alone where there are any."""
    material = stage.material("ShaderNodeEmission")
    ground, settings = _hairy(stage, 0.8, material, length=0.6, radii=(1.0, 1.0))
    if case == "scaled":
        ground.scale = (2, 2, 2)
    elif case == "spiral":
        settings.child_type, settings.kink, settings.kink_amplitude = "SIMPLE", "SPIRAL", 0.2
        settings.child_percent = settings.rendered_child_count = 1
    else:
        settings.child_type, settings.use_parent_particles = "SIMPLE", True
        settings.child_percent = settings.rendered_child_count = 1
        settings.child_radius = 0.5
    ours, theirs = stage.mitsuba((96, 96), 32), stage.cycles((96, 96), 32)
    # ours have facets, which makes hair thinner than a pixel 5 % darker where it shines
    assert ours.mean() == pytest.approx(0.95 * theirs.mean(), rel=0.05)
