"""How long the exporter takes beside the bare copies of the same arrays, and beside Mitsuba's own building."""

import os
import tempfile
import time

import numpy as np

OBJECTS = 1000
SEGMENTS, RINGS = 32, 17


def build(objects=OBJECTS):
    """A Blender file of smooth spheres of 1024 triangles, each a mesh of its own, with UVs and a material."""
    os.environ.setdefault("BLENDER_USER_RESOURCES", tempfile.mkdtemp(prefix="holopath-bench-"))
    import bpy  # noqa: I001 (bmesh comes with it)
    import bmesh

    bpy.ops.wm.read_factory_settings(use_empty=True)
    sphere = bmesh.new()
    sphere.loops.layers.uv.new("UVMap")
    bmesh.ops.create_uvsphere(sphere, u_segments=SEGMENTS, v_segments=RINGS, radius=0.4, calc_uvs=True)
    first = bpy.data.meshes.new("sphere")
    sphere.to_mesh(first)
    sphere.free()
    first.shade_smooth()
    first.materials.append(_textured())
    side, scene, collection = round(objects ** (1 / 3)), bpy.context.scene, bpy.context.collection
    assert scene is not None and collection is not None  # a new file has both
    for number in range(objects):
        obj = bpy.data.objects.new(f"sphere {number}", first.copy())
        obj.location = (number % side, number // side % side, number // side**2)
        obj.rotation_euler = (0.1 * number, 0.2 * number, 0.3 * number)
        collection.objects.link(obj)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.location = (side / 2, side / 2, 4 * side)
    collection.objects.link(camera)
    scene.camera = camera


def _textured():
    import bpy

    from holopath_addon.export.shading.node_graph import tree_of

    material = bpy.data.materials.new("textured")
    tree = tree_of(material)
    nodes = tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = bpy.data.images.new("colors", 64, 64)
    shader = next(node for node in nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")
    tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return material


def bare_copies(depsgraph):
    """Read the arrays that are needed of every evaluated mesh, and make Mitsuba meshes that hold them.

    Nothing is transformed, checked or looked up.
    """
    import mitsuba as mi

    from holopath_addon.export.geometry import fill

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "diffuse"})
    meshes = []
    for instance in depsgraph.object_instances:
        data = instance.object.data
        if instance.object.type != "MESH":
            continue
        data.calc_loop_triangles()
        corners, triangles = len(data.loops), len(data.loop_triangles)
        positions = _read(data.attributes["position"].data, "vector", 3 * len(data.vertices))
        vertices = _read(data.attributes[".corner_vert"].data, "value", corners, np.int32)
        faces = _read(data.loop_triangles, "loops", 3 * triangles, np.int32)
        normals = _read(data.corner_normals, "vector", 3 * corners)
        uv = _read(data.uv_layers[0].uv, "vector", 2 * corners)
        mesh = mi.Mesh("mesh", corners, triangles, properties, True, True)
        buffers = {
            "vertex_positions": mi.Float(positions.reshape(-1, 3).take(vertices, axis=0).ravel()),
            "faces": mi.UInt32(faces.view(np.uint32)),
            "vertex_normals": mi.Float(normals),
            "vertex_texcoords": mi.Float(uv),
        }
        fill(mesh, buffers)
        meshes.append(mesh)
    return meshes


def _read(collection, attribute, count, dtype=np.float32):
    values = np.empty(count, dtype)
    collection.foreach_get(attribute, values)
    return values


def _timed(work):
    start = time.perf_counter()
    result = work()
    return time.perf_counter() - start, result


def run(repeats=5, objects=OBJECTS):
    """Table as text; the shortest of `repeats` runs, as other work on the machine only adds."""
    build(objects)
    import bpy

    from holopath_addon.engine.scene.variants import made
    from holopath_addon.export import ExportCache
    from holopath_addon.export.notes import Notes
    from holopath_addon.export.scene import read_parts

    rows = []
    for _ in range(repeats):
        depsgraph = bpy.context.evaluated_depsgraph_get()
        bare_copies(depsgraph)  # Blender computes triangles and normals at the first reading
        cache = ExportCache()
        bare, _ = _timed(lambda depsgraph=depsgraph: bare_copies(depsgraph))
        first, parts = _timed(
            lambda depsgraph=depsgraph, cache=cache: read_parts(depsgraph, 1.0, None, Notes(), cache)
        )
        building, _ = _timed(lambda parts=parts: made(parts))
        bpy.data.objects[f"sphere {objects // 2}"].location.x += 0.1
        depsgraph = bpy.context.evaluated_depsgraph_get()
        second, parts = _timed(
            lambda depsgraph=depsgraph, cache=cache: read_parts(depsgraph, 1.0, None, Notes(), cache)
        )
        again, _ = _timed(lambda parts=parts: made(parts))
        cache.close()
        rows.append((bare, first, second, building, again))
    bare, first, second, building, again = np.min(rows, axis=0)
    triangles = objects * SEGMENTS * (RINGS - 1) * 2
    return "\n".join(
        [
            f"export of {triangles:,d} triangles in {objects} objects with UVs, normals and a material",
            f"  bare copies          {bare:6.3f} s",
            f"  first export         {first:6.3f} s, {first / bare:.2f} times the bare copies",
            f"  after one move       {second:6.3f} s, {second / first:.3f} of the first",
            f"  Mitsuba's own scene  {building:6.3f} s, after the move {again:6.3f} s (it keeps no tree)",
        ]
    )
