"""The texture over all surfaces: a place for each hit, and back, on charts, cells, instances and both sides."""

import numpy as np
import pytest

TEXEL = 5e-3


def grid(build, side, center, half):
    """Vertices [v, u, 3] of a waved square."""
    v, u = np.mgrid[-1 : 1 : 1j * side, -1 : 1 : 1j * side]
    return np.array(center) + half * np.stack([u, v, 0.2 * np.sin(3 * u)], axis=-1)


def two_parts(build, surface):
    """One mesh of a large square and, apart from it, a small one."""
    large, small = (
        grid(build, 9, [x, 1.0, -2.0], half).reshape(-1, 3) for x, half in ((-1, 0.4), (0.3, 0.02))
    )
    corner = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 10], corner[:, None] + [0, 10, 9]])
    properties = build.mi.Properties()
    properties["bsdf"] = build.mi.load_dict(surface["bsdf"])
    mesh = build.mi.Mesh("two", 162, 2 * len(faces), properties)
    parameters = build.mi.traverse(mesh)
    parameters["vertex_positions"] = np.concatenate([large, small]).astype(np.float32).ravel()
    parameters["faces"] = np.concatenate([faces, faces + 81]).astype(np.uint32).ravel()
    parameters.update()
    return mesh


def mixed(build):
    """Charts, triangles too small for them, two instances of a group, and parts of very different size."""
    T, gray = build.T, build.diffuse(build.gray(0.5))
    group = {
        "type": "shapegroup",
        "cube": {"type": "cube", **gray},
        "ball": build.ball(0.8, [2.5, 0, 0], gray),
    }

    def instance(place):
        return {"type": "instance", "to_world": place, "group": {"type": "ref", "id": "group"}}

    return build.scene(
        ball=build.ball(0.3, [-1, 0, -2], gray),
        same=build.ball(0.3, [-1, -1, -2], gray),
        dense=build.mesh(grid(build, 151, [0, 0, -2], 0.3), gray),
        parts=two_parts(build, gray),
        group=group,
        one=instance(T().translate([1, 0, -2]).rotate([1, 1, 0], 40).scale(0.1)),
        two=instance(T().translate([1, 1, -2]).rotate([0, 1, 0], 200).scale([0.2, 0.1, 0.15])),
    )


def laid_out(scene, texel=TEXEL):
    from holopath_addon.engine.light.atlas import Atlas, Triangles, lay_out

    triangles = Triangles(scene, lambda shape: True)
    sides = {(owner.number, side) for owner in triangles.owners for side in (0, 1)}
    return Atlas(triangles, lay_out(triangles, np.full(triangles.parts, texel), sides, lambda done: None))


def hits(build, scene, count=1 << 16):
    """Where rays from all around meet a scene: the surface, whether its front, and the interaction."""
    import drjit as dr

    mi = build.mi
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, count)
    box = scene.bbox()
    center, radius = mi.Point3f(box.center()), dr.norm(box.extents())
    origin = center + radius * mi.warp.square_to_uniform_sphere(sampler.next_2d())
    target = mi.Point3f(sampler.next_1d(), sampler.next_1d(), sampler.next_1d())
    ray = mi.Ray3f(origin, dr.normalize(mi.Point3f(box.min) + target * mi.Vector3f(box.extents()) - origin))
    met = np.flatnonzero(np.array(scene.ray_intersect_preliminary(ray).is_valid()))
    ray = dr.gather(mi.Ray3f, ray, mi.UInt32(met))
    surface = scene.ray_intersect_preliminary(ray)
    si = surface.compute_surface_interaction(ray)
    return surface, dr.dot(si.n, ray.d) < 0, si


@pytest.fixture(scope="module")
def scene(build):
    return mixed(build)


@pytest.fixture(scope="module")
def atlas(scene):
    return laid_out(scene)


def test_a_hit_finds_its_own_place_again(build, scene, atlas):
    """The same shape, instance and side, and a point at most about a texel, or a triangle, away."""
    import drjit as dr

    mi = build.mi
    surface, front, si = hits(build, scene)
    texel, known = atlas.texel(surface, front, mi.Point2f(0.5))
    place, facing = atlas.place(texel, mi.Point2f(0.5))
    there = place.compute_surface_interaction(mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1)))
    owner, row, _ = atlas.triangles.row(surface, known)
    far = np.array(dr.norm(there.p - si.p) / dr.gather(mi.Float, atlas.triangles.scale, owner, known))
    same = (there.shape == si.shape) & (there.instance == si.instance) & (facing == front)
    point = atlas.points[np.array(row)]
    assert len(point) > 1000 and point.any() and not point.all()
    assert np.array(known).all() and np.array(same).all()
    assert far[~point].max() < 2 * TEXEL  # at corners where charts end
    assert np.median(far[~point]) < 0.5 * TEXEL
    assert far[point].max() < 0.012  # a triangle of the dense mesh is 4 mm long


def test_texels_lie_in_triangles_of_their_own(build, atlas):
    """A texel's place leads back to it, and no triangle takes another one's texels."""
    mi = build.mi
    texels = np.flatnonzero(atlas.rows != 0xFFFFFFFF).astype(np.uint32)
    surface, front = atlas.place(mi.UInt32(texels), mi.Point2f(0.5))
    back, known = atlas.texel(surface, front, mi.Point2f(0.5))
    back = np.array(back).astype(int)
    inside = back == texels
    assert np.array(known).all() and inside.mean() > 0.5
    steps = [abs(back // atlas.width - texels // atlas.width), abs(back % atlas.width - texels % atlas.width)]
    assert np.max(steps) <= 2  # beyond edges: the nearest point
    corners = atlas.layout.corners.astype(float)
    area = abs(corners[:, 2] * corners[:, 5] - corners[:, 3] * corners[:, 4]) / 2
    for family in atlas.triangles.families:
        owners = len(family.owners)
        for mesh in family.meshes:
            rows = slice(mesh.first, mesh.first + len(mesh.faces))
            own = (atlas.rows[texels[inside]] >= rows.start) & (atlas.rows[texels[inside]] < rows.stop)
            wanted = np.where(atlas.points[rows], 1, area[rows]).sum()
            assert own.sum() / (2 * owners) == pytest.approx(wanted, rel=0.05, abs=5)


def test_front_and_back_and_instances_have_texels_of_their_own(build, scene, atlas):
    mi = build.mi
    surface, _, _ = hits(build, scene)
    fronts, backs = (np.array(atlas.texel(surface, mi.Bool(s), mi.Point2f(0.5))[0]) for s in (True, False))
    assert not set(fronts) & set(backs)
    owner_of = {}
    for texel, owner in zip(fronts, np.array(atlas.triangles.row(surface)[0]), strict=True):
        assert owner_of.setdefault(texel, owner) == owner


def test_instances_and_like_meshes_share_charts(atlas):
    shared = [family for family in atlas.triangles.families if len(family.owners) == 2]
    assert len(shared) == 1 and len(shared[0].meshes) == 2
    of_instances = [copy for copy in atlas.layout.copies.tolist() if atlas.triangles.owners[copy[0]].instance]
    assert len(of_instances) == 4 and len({tuple(copy[4:]) for copy in of_instances}) == 1
    balls = [mesh for mesh in atlas.triangles.meshes if len(mesh.faces) == 2304]
    first, second = (
        atlas.layout.corners[mesh.first : mesh.first + 2304]
        for mesh in balls
        if abs(np.ptp(mesh.vertices, 0)[0] - 0.6) < 0.01
    )
    np.testing.assert_array_equal(first, second)


def test_the_same_scene_is_laid_out_the_same(build, atlas):
    """Whatever the order in which its shapes are named."""
    again = laid_out(mixed(build))
    assert again.triangles.structure == atlas.triangles.structure
    for name in ("texel", "corners", "copies"):
        np.testing.assert_array_equal(getattr(again.layout, name), getattr(atlas.layout, name))
    np.testing.assert_array_equal(again.rows, atlas.rows)


def test_texels_where_triangles_meet_are_the_same_each_time(build):
    """Baked light is found by them: many triangles race for the texels at their edges."""
    angle = np.linspace(0, np.pi, 200)
    ball = build.turned(
        0.3 * np.sin(angle), -0.3 * np.cos(angle), [0, 0, -1], build.diffuse(build.gray(0.5)), 200
    )
    atlas = laid_out(build.scene(ball=ball))
    assert atlas.triangles.count > 70_000
    for _ in range(3):
        np.testing.assert_array_equal(type(atlas)(atlas.triangles, atlas.layout).rows, atlas.rows)


def test_shapes_in_the_same_bounds_keep_their_rows(build):
    """Two crossing sheets in one bounding box, named in either order."""

    def sheet(angle):  # of different colors: Mitsuba makes one mesh of others
        place = build.T().rotate([0, 1, 0], angle).scale([0.5, 0.5, 1])
        return {"type": "rectangle", "to_world": place, **build.diffuse(build.gray(0.5 + angle / 1000))}

    one, other = (laid_out(build.scene(a=sheet(a), b=sheet(-a))) for a in (45, -45))
    for mine, theirs in zip(one.triangles.meshes, other.triangles.meshes, strict=True):
        np.testing.assert_array_equal(mine.vertices, theirs.vertices)


def test_too_many_texels_are_made_larger(build, monkeypatch):
    from holopath_addon.engine.light import atlas

    monkeypatch.setattr(atlas, "MAX_TEXELS", 1 << 16)
    scene = build.scene(a=build.ball(0.3, [0, 0, -1], build.diffuse(build.gray(0.5))))
    laid = laid_out(scene, 5e-4)
    assert laid.layout.coarser > 3 and laid.size < 2 << 16
    assert laid.layout.texel[0] == pytest.approx(5e-4 * laid.layout.coarser)


@pytest.mark.parametrize("scale", [1e-5, 1e6])
def test_scale_does_not_matter(build, scale):
    gray = build.diffuse(build.gray(0.5))
    scene = build.scene(a=build.ball(scale, [0, 0, 0], gray), b=build.ball(scale, [2 * scale, 0, 0], gray))
    atlas = laid_out(scene, 0.02 * scale)
    surface, front, _ = hits(build, scene, 1 << 12)
    _, known = atlas.texel(surface, front, build.mi.Point2f(0.5))
    assert np.array(known).all() and atlas.layout.dense == 0


def test_broken_triangles_do_no_harm(build):
    """No area, no extent, not a number: what can be hit is found."""
    flat = grid(build, 9, [0, 0, -1], 0.3)
    flat[3], flat[:, 5] = flat[2], flat[:, 4]
    wild = grid(build, 9, [1, 0, -1], 0.3)
    wild[0, 0], wild[4, 0] = np.nan, np.inf
    gray = build.diffuse(build.gray(0.5))
    nothing = build.mesh(0 * flat - 1, gray)
    scene = build.scene(
        a=build.mesh(flat, gray), b=build.mesh(flat, gray), c=nothing, d=build.mesh(wild, gray)
    )
    atlas = laid_out(scene)
    mi = build.mi
    origin = mi.Point3f(*np.random.default_rng(0).uniform(-0.2, 0.2, (2, 1000)).astype(np.float32), 0)
    ray = mi.Ray3f(origin, mi.Vector3f(0, 0, -1))
    surface = scene.ray_intersect_preliminary(ray)
    texel, known = atlas.texel(surface, mi.Bool(True), mi.Point2f(0.5))
    place, _ = atlas.place(texel, mi.Point2f(0.5))
    assert np.array(known).all()
    assert np.array(place.shape == surface.shape).all()


def joined(build, texels, places):
    """Triangles with a texel for each mesh: squares of 128 triangles at places along x, all of them one mesh."""
    from holopath_addon.engine.light.atlas import Triangles

    squares = [grid(build, 9, [x, 0.0, 0.0], 0.4).reshape(-1, 3) for x in places]
    corner = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 10], corner[:, None] + [0, 10, 9]])
    mesh = build.mi.Mesh("joined", 81 * len(places), 128 * len(places))
    parameters = build.mi.traverse(mesh)
    parameters["vertex_positions"] = np.concatenate(squares).astype(np.float32).ravel()
    every = [faces + 81 * number for number in range(len(places))]
    parameters["faces"] = np.concatenate(every).astype(np.uint32).ravel()
    parameters.update()
    triangles = Triangles(build.scene(joined=mesh), lambda shape: True)
    assert triangles.parts == len(places)
    return triangles, np.array(texels, float)


def sheet_of(triangles, texel):
    """Each triangle's area in texels, and the layout."""
    from holopath_addon.engine.light.atlas import lay_out

    layout = lay_out(triangles, texel, {(triangles.owners[0].number, 0)}, lambda done: None)
    edges = layout.corners[:, 2:].reshape(-1, 2, 2)
    return 0.5 * np.abs(np.linalg.det(edges)), layout


def test_parts_far_apart_in_texels_have_charts(build):
    """A small thing a kilometer away, as fine as a near one: no sheet spans what lies between them."""
    triangles, texel = joined(build, [0.01, 0.01], [0.0, 1000.0])
    areas, layout = sheet_of(triangles, texel)
    assert layout.dense == 0
    assert areas.sum() == pytest.approx(triangles.areas().sum() / 0.01**2, rel=0.02)


def test_large_triangles_keep_their_charts_among_many_small_ones(build):
    triangles, texel = joined(build, [0.01, *[0.5] * 99], 2.0 * np.arange(100))
    areas, layout = sheet_of(triangles, texel)
    assert layout.dense == 99 * 128
    assert areas[:128].sum() == pytest.approx(triangles.areas()[0] / 0.01**2, rel=0.02)
    assert not areas[128:].any()
