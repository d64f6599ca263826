"""Baking of shader nodes to pictures: Cycles evaluates them, so every node works as in Blender.

Everything is made in a scene of its own that is removed afterwards. Blender's data may only be changed on the
main thread: so does everything here.
"""

import contextlib
import math
import os
import sys
import threading
from dataclasses import dataclass
from typing import Any

import bmesh
import bpy
import numpy as np

from .node_graph import (
    GENERATED_BY_DEFAULT,
    Pin,
    alphas_upstream,
    by_identifier,
    first_link,
    group_output,
    output_node,
    tree_of,
)

ATLAS = "HoloPath atlas"
_NORMAL, _TANGENT, _GENERATED = "HoloPath normal", "HoloPath tangent", "HoloPath generated"
SUNNY = 100.0  # how much brighter than the mean a world's brightest texel is, for it to be looked at closely
BRIGHTEST = 1e7  # radiance of a world, four times that of Blender's sun
_BEYOND_ALPHA = 1e30  # no alpha is greater
_NO_UV = "HoloPath none"  # an attribute that no mesh has reads as zero
_MARGIN = 4
SAMPLES = 2_000_000  # in all of a surface's texels, which get 1 to 16 each

# Modifiers that keep the mesh and move its vertices: generated coordinates are of the mesh without them.
_DEFORMING = {
    *("ARMATURE", "CAST", "CLOTH", "CORRECTIVE_SMOOTH", "CURVE", "DISPLACE", "HOOK", "LAPLACIANDEFORM"),
    *("LAPLACIANSMOOTH", "LATTICE", "MESH_CACHE", "MESH_DEFORM", "MESH_SEQUENCE_CACHE", "SHRINKWRAP"),
    *("SIMPLE_DEFORM", "SMOOTH", "SOFT_BODY", "SURFACE_DEFORM", "WARP", "WAVE"),
}

COLOR, NUMBER, NORMAL, EMISSION = "color", "number", "normal", "emission"


ELSEWHERE = "Blender's data may not be changed while it renders (F12): use Render Hologram in the sidebar"


class BakingFailed(Exception):
    """Raised where Cycles cannot bake; the text is the reason."""


def possible():
    """Whether this is the main thread, where Blender's data may be changed."""
    return threading.current_thread() is threading.main_thread()


@dataclass
class Output:
    """A socket to be evaluated over a surface.

    Attributes
    ----------
    pin : Pin or None
        The input socket whose value is wanted. None for the normals of the material's displacement alone, and for
        emission.
    kind : str
        ``COLOR``; ``NUMBER``; ``NORMAL``, the direction in the frame of the shading normal and the atlas' u,
        halved and shifted to 0 ... 1 as in a tangent-space normal map; or ``EMISSION``, all that the material emits.
    """

    pin: Pin | None
    kind: str


class Flat:
    """A triangulated copy of an evaluated object with an atlas, ready to be baked.

    Parameters
    ----------
    evaluated : bpy.types.Object
    unwrap : callable
        ``unwrap(vertices, triangles)`` gives corners' places and the size of the picture, see `unwrapping.unwrap`.
    matrix : mathutils.Matrix
        Object to world, Blender units.
    values : InstanceValues
    generated : bool
        Whether materials read generated coordinates.

    Attributes
    ----------
    mesh : bpy.types.Mesh
    normals : float32 [corner, 3]
        Shading normals.
    size : (int, int)
        Texels of the picture.
    uv_name : str
        UV map that nodes read by default.
    deformed : bool
        Whether generated coordinates are not those of the shape as it is.
    stretched : bool
        Whether generated coordinates extend over the result of modifiers, where Cycles has those of the mesh itself.
    """

    def __init__(self, evaluated, unwrap, matrix, values, generated=False):
        self.original = evaluated.original
        self.matrix = matrix.copy()
        self.values = values
        self.stretched = False
        # without a depsgraph, with which Blender would evaluate the original again: instances that geometry nodes
        # make would become their owner, and edits in Edit Mode would be missing
        self.mesh = bpy.data.meshes.new_from_object(evaluated)
        try:
            if not self.mesh.polygons:
                raise BakingFailed("the mesh has no faces")
            _copy_custom(evaluated.data, self.mesh)
            self.deformed = self._keep_generated(evaluated.data)
            if generated and not self.deformed and self._has_other_vertices(evaluated):
                self.deformed = self._extend_generated()
                self.stretched = not self.deformed
            flat = self.mesh.normals_domain == "FACE"
            normals = _vectors(self.mesh, "corner_normals", "vector")
            self._triangulate()
            vertices = _vectors(self.mesh, "vertices", "co")
            corners = np.empty(len(self.mesh.loops), np.int32)
            self.mesh.loops.foreach_get("vertex_index", corners)
            triangles = corners.reshape(-1, 3)
            uv, self.size = unwrap(vertices, triangles)
            # custom normals do not survive triangulation unchanged, those of bent flat faces must not
            self.normals = (
                _vectors(self.mesh, "corner_normals", "vector") if flat else normals[self._source_corner]
            )
            self.uv_name = next((layer.name for layer in self.mesh.uv_layers if layer.active_render), _NO_UV)
            layer = self.mesh.uv_layers.new(name=ATLAS)
            if layer is None:
                raise BakingFailed("the mesh has eight UV maps, remove one")
            layer.uv.foreach_set("vector", uv.ravel())
            self._attribute(_NORMAL, "CORNER", self.normals)
            self._attribute(_TANGENT, "CORNER", np.repeat(_dp_du(vertices[triangles], uv), 3, axis=0))
        except BaseException:
            self.remove()
            raise

    def _triangulate(self):
        source: Any = self.mesh.attributes.new("HoloPath corner", "INT", "CORNER")
        source.data.foreach_set("value", np.arange(len(self.mesh.loops), dtype=np.int32))
        work = bmesh.new()
        try:
            work.from_mesh(self.mesh)
            # the way Blender's renderers do it: other diagonals interpolate UVs and colors differently
            bmesh.ops.triangulate(work, faces=work.faces[:], quad_method="FIXED", ngon_method="EAR_CLIP")
            work.to_mesh(self.mesh)
        finally:
            work.free()
        self._source_corner = np.empty(len(self.mesh.loops), np.int32)
        kept: Any = self.mesh.attributes["HoloPath corner"]
        kept.data.foreach_get("value", self._source_corner)

    def _keep_generated(self, data):
        """Carry over coordinates before deformation, which a copy of the mesh forgets; whether they differ."""
        if not isinstance(data, bpy.types.Mesh) or len(data.vertices) != len(self.mesh.vertices):
            return False
        points, undeformed = (_vectors(data, "vertices", name) for name in ("co", "undeformed_co"))
        if np.array_equal(points, undeformed):
            # the viewport's evaluation does not keep them: the mesh before its modifiers has them
            source = self.original.data
            # not where this is an instance of another mesh, which geometry nodes made
            of_itself = isinstance(source, bpy.types.Mesh) and source.name == data.name
            if not of_itself or len(source.vertices) != len(points):
                return False
            undeformed = _vectors(source, "vertices", "co")
            if np.allclose(points, undeformed, rtol=0, atol=1e-6 * np.abs(points).max(initial=0)):
                return False
        center, half = np.array(data.texspace_location), np.array(data.texspace_size)
        half[half == 0] = 1
        self._attribute(_GENERATED, "POINT", (undeformed - center) / (2 * half) + 0.5)
        return True

    def _has_other_vertices(self, evaluated):
        """Whether modifiers changed the vertices of the object's own mesh."""
        source = self.original.data
        return (
            self.original.type == "MESH"
            and isinstance(evaluated.data, bpy.types.Mesh)
            # else an instance of another mesh, which geometry nodes made
            and evaluated.data.name == source.name
            and any(modifier.show_viewport for modifier in self.original.modifiers)
            and len(source.vertices) != len(self.mesh.vertices)
        )

    def _extend_generated(self):
        """Generated coordinates of what modifiers made: of their result without deformation, in the mesh's own box.

        Cycles has them so: beyond 0 to 1 in the copies of an Array or behind a Mirror.
        """
        source, points = self.original.data, self._undeformed()
        if len(points) != len(self.mesh.vertices):
            return False
        center, half = np.array(source.texspace_location), np.array(source.texspace_size)
        half[half == 0] = 1
        self._attribute(_GENERATED, "POINT", (points - center) / (2 * half) + 0.5)
        return True

    def _undeformed(self):
        """Vertices of the object without shape keys and the modifiers that only deform."""
        deforming = [m.name for m in self.original.modifiers if m.show_viewport and m.type in _DEFORMING]
        if not deforming and self.original.data.shape_keys is None:
            return _vectors(self.mesh, "vertices", "co")
        scene, copy = bpy.data.scenes.new("HoloPath baking"), self.original.copy()
        copy.data = mesh = self.original.data.copy()
        try:
            copy.shape_key_clear()
            for name in deforming:
                copy.modifiers[name].show_viewport = False
            scene.collection.objects.link(copy)
            layer = scene.view_layers[0]
            with bpy.context.temp_override(scene=scene, view_layer=layer):
                result = copy.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
            return _vectors(result, "vertices", "co")
        finally:
            bpy.data.scenes.remove(scene)
            bpy.data.objects.remove(copy)
            bpy.data.meshes.remove(mesh)

    def _attribute(self, name, domain, vectors):
        attribute: Any = self.mesh.attributes.new(name, "FLOAT_VECTOR", domain)
        attribute.data.foreach_set("vector", np.ascontiguousarray(vectors, np.float32).ravel())

    def remove(self):
        """Remove the copy from the file."""
        bpy.data.meshes.remove(self.mesh)


def _copy_custom(source, target):
    """Copy custom properties that Attribute nodes read: numbers and vectors."""
    for key, value in source.items():
        if isinstance(value, (int, float)) or hasattr(value, "typecode"):
            target[key] = value


def _vectors(mesh, collection, attribute):
    items = getattr(mesh, collection)
    values = np.empty(3 * len(items), np.float32)
    items.foreach_get(attribute, values)
    return values.reshape(-1, 3)


def _dp_du(points, uv):
    """Derivative of position by u of triangles, as a renderer computes it, shape (triangle, 3)."""
    (p0, p1, p2), (t0, t1, t2) = np.moveaxis(points, 1, 0), np.moveaxis(uv, 1, 0)
    dp1, dp2, d1, d2 = p1 - p0, p2 - p0, t1 - t0, t2 - t0
    determinant = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    return (d2[:, 1:] * dp1 - d1[:, 1:] * dp2) * np.sign(determinant)[:, None]


def bake_surface(flat, slots, frame):
    """Evaluate sockets of an object's materials over its atlas.

    Parameters
    ----------
    flat : Flat
    slots : list of (bpy.types.Material or None, list of Output)
        For each material slot.
    frame : float
        Of the animation.

    Returns
    -------
    list of list of float32 [y, x, 3] or [y, x, 1]
        Linear values for each slot and output, bottom row first.

    Raises
    ------
    BakingFailed
    """
    with _Studio(frame) as studio:
        thing = studio.object(flat)
        image = studio.image(*flat.size)
        samples = int(np.clip(SAMPLES / (flat.size[0] * flat.size[1]), 1, 16))
        looks = [_MaterialCopy(studio, material, outputs, image, flat) for material, outputs in slots]
        for number, look in enumerate(looks):
            if number < len(flat.mesh.materials):
                flat.mesh.materials[number] = look.material
            else:
                flat.mesh.materials.append(look.material)
        pictures = []
        for number in range(max(len(look.passes) for look in looks)):
            for look in looks:
                look.show(number)
            pictures.append(studio.bake(thing, image, "EMIT", samples))
        return [look.collect(pictures) for look in looks]


class _MaterialCopy:
    """A private copy of a material that emits what its sockets carry, one color or three numbers a pass."""

    def __init__(self, studio, material, outputs, image, flat):
        if material is None or not outputs:
            self.material = studio.keep(bpy.data.materials.new("HoloPath baking"))
            if self.material.node_tree is None:
                self.material.use_nodes = True
        else:
            self.material = studio.keep(material.original.copy())
            for tree in _own_groups(studio, self.material.node_tree):
                _settle_coordinates(tree, flat)
        self.tree = tree = self.material.node_tree
        if material is not None and outputs:
            _keep_alphas(material.original.node_tree, tree)
        self.outputs = outputs
        numbers = [k for k, output in enumerate(outputs) if output.kind == NUMBER]
        self.passes = [[k] for k, output in enumerate(outputs) if output.kind != NUMBER]
        self.passes += [numbers[k : k + 3] for k in range(0, len(numbers), 3)]
        self.target = target = tree.get_output_node("CYCLES") or tree.nodes.new("ShaderNodeOutputMaterial")
        self.surface = first_link(target.inputs["Surface"])
        self.surface = self.surface and self.surface.from_socket
        for link in [*target.inputs["Volume"].links, *target.inputs["Surface"].links]:
            tree.links.remove(link)
        if not any(output.kind == NORMAL for output in outputs):
            for link in target.inputs["Displacement"].links:
                tree.links.remove(link)
        if material is not None:
            self.material.displacement_method = "BUMP"
        self.emission = tree.nodes.new("ShaderNodeEmission")
        self.shown = [self._color_of(chosen) for chosen in self.passes]
        texture = tree.nodes.new("ShaderNodeTexImage")
        texture.image = image
        tree.nodes.active = texture

    def _color_of(self, chosen):
        """Socket that carries a pass as a color."""
        output = self.outputs[chosen[0]]
        if output.kind == EMISSION:
            return None
        if output.kind == NORMAL:
            return self._tangent_space(output.pin)
        if output.kind == COLOR:
            return _expose(self.tree, output.pin)
        combine = self.tree.nodes.new("ShaderNodeCombineColor")
        for channel, k in zip(combine.inputs, chosen, strict=False):
            self.tree.links.new(_expose(self.tree, self.outputs[k].pin), channel)
        return combine.outputs[0]

    def _tangent_space(self, pin):
        new, link = self.tree.nodes.new, self.tree.links.new

        def vector(operation, *sources):
            node = new("ShaderNodeVectorMath")
            node.operation = operation
            for source, socket in zip(sources, node.inputs, strict=False):
                if isinstance(source, tuple):
                    socket.default_value = source
                else:
                    link(source, socket)
            return node.outputs["Value" if operation == "DOT_PRODUCT" else "Vector"]

        def attribute(name, kind):
            read, turn = new("ShaderNodeAttribute"), new("ShaderNodeVectorTransform")
            read.attribute_name = name
            turn.vector_type, turn.convert_from, turn.convert_to = kind, "OBJECT", "WORLD"
            link(read.outputs["Vector"], turn.inputs[0])
            return vector("NORMALIZE", turn.outputs[0])

        n = attribute(_NORMAL, "NORMAL")
        t = attribute(_TANGENT, "VECTOR")
        along = new("ShaderNodeVectorMath")
        along.operation = "SCALE"
        link(n, along.inputs[0])
        link(vector("DOT_PRODUCT", n, t), along.inputs["Scale"])
        s = vector("NORMALIZE", vector("SUBTRACT", t, along.outputs[0]))
        perturbed = new("ShaderNodeNewGeometry").outputs["Normal"] if pin is None else _expose(self.tree, pin)
        perturbed = vector("NORMALIZE", perturbed)
        combine = new("ShaderNodeCombineXYZ")
        for axis, socket in zip((s, vector("CROSS_PRODUCT", n, s), n), combine.inputs, strict=True):
            link(vector("DOT_PRODUCT", perturbed, axis), socket)
        return vector("MULTIPLY_ADD", combine.outputs[0], (0.5, 0.5, 0.5), (0.5, 0.5, 0.5))

    def show(self, number):
        """Emit the values of a pass."""
        if number >= len(self.shown):
            return
        surface, color = self.emission.outputs[0], self.shown[number]
        if color is None:
            surface = self.surface
        else:
            self.tree.links.new(color, self.emission.inputs["Color"])
        self.tree.links.new(surface, self.target.inputs["Surface"])

    def collect(self, pictures):
        """Collect the pictures of the outputs."""
        found = [None] * len(self.outputs)
        for picture, chosen in zip(pictures, self.passes, strict=False):
            for channel, k in enumerate(chosen):
                wide = self.outputs[k].kind != NUMBER
                found[k] = picture[..., :3] if wide else picture[..., channel : channel + 1]
        return found


def _own_groups(studio, tree):
    """Give a tree private copies of its groups, so that they can be changed; all trees that are private then."""
    trees = [tree]
    for node in tree.nodes:
        if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None:
            node.node_tree = studio.keep(node.node_tree.copy())
            trees += _own_groups(studio, node.node_tree)
    return trees


def _keep_alphas(original, tree):
    """Make Cycles read the same alphas in a copied tree as in the original.

    It divides the color of an image by its alpha if something reads the alpha, which may be lost by baking.
    """
    output = output_node(original)
    if output is None:
        return
    for pin in alphas_upstream(*(Pin(output.inputs[name]) for name in ("Surface", "Displacement"))):
        inner = tree
        for group in pin.groups:
            inner = inner.nodes[group.name].node_tree
        color, alpha = inner.nodes[pin.node.name].outputs
        readers = [link.to_socket for link in color.links]
        if not readers:
            continue
        # zero, which Cycles does not find out beforehand
        none, kept = inner.nodes.new("ShaderNodeMath"), inner.nodes.new("ShaderNodeVectorMath")
        none.operation, none.inputs[1].default_value = "GREATER_THAN", _BEYOND_ALPHA
        inner.links.new(alpha, none.inputs[0])
        inner.links.new(color, kept.inputs[0])
        inner.links.new(none.outputs[0], kept.inputs[1])
        for reader in readers:
            inner.links.new(kept.outputs[0], reader)


def _settle_coordinates(tree, flat):
    """Name the UV map that a tree reads by default, which is the atlas now; give back generated coordinates."""
    _settle_instance(tree, flat.values)
    uv = tree.nodes.new("ShaderNodeUVMap")
    uv.uv_map = flat.uv_name
    sources = {"UV": uv.outputs["UV"]}
    if flat.deformed:
        generated = tree.nodes.new("ShaderNodeAttribute")
        generated.attribute_name = _GENERATED
        sources["Generated"] = generated.outputs["Vector"]
    for node in list(tree.nodes):
        if hasattr(node, "uv_map") and not node.uv_map:
            node.uv_map = flat.uv_name
        elif node.bl_idname == "ShaderNodeTexCoord" and not node.from_instancer:
            for name, source in sources.items():
                for link in list(node.outputs[name].links):
                    tree.links.new(source, link.to_socket)
        default = "UV" if node.bl_idname == "ShaderNodeTexImage" else "Generated"
        if default == "UV" or node.bl_idname in GENERATED_BY_DEFAULT:
            if default in sources and not node.inputs["Vector"].is_linked:
                tree.links.new(sources[default], node.inputs["Vector"])


def _settle_instance(tree, values):
    """Put constants in the place of what nodes read of an instance or its instancer, which the stand-in is not."""

    def replace_output(socket, value):
        node = tree.nodes.new("ShaderNodeCombineXYZ" if isinstance(value, tuple) else "ShaderNodeValue")
        if isinstance(value, tuple):
            for component, number in zip(node.inputs, value, strict=False):
                component.default_value = number
        else:
            node.outputs[0].default_value = value
        for link in list(socket.links):
            tree.links.new(node.outputs[0], link.to_socket)

    attributes = {
        "OBJECT": dict(values.object_attributes),
        "INSTANCER": dict(values.attributes),
        "VIEW_LAYER": dict(values.layer_attributes),
    }
    for node in list(tree.nodes):
        kind = node.bl_idname
        if kind == "ShaderNodeObjectInfo":
            replace_output(node.outputs["Random"], values.random)
        elif kind == "ShaderNodeTexCoord" and node.from_instancer:
            replace_output(node.outputs["Generated"], values.generated)
            replace_output(node.outputs["UV"], values.uv)
        elif kind == "ShaderNodeUVMap" and node.from_instancer:
            replace_output(node.outputs["UV"], values.uv)
        elif kind == "ShaderNodeAttribute" and node.attribute_type in attributes:
            found = attributes[node.attribute_type].get(node.attribute_name, (0.0, 0.0, 0.0, 0.0))
            red, green, blue, alpha = found
            replace_output(node.outputs["Color"], (red, green, blue))
            replace_output(node.outputs["Vector"], (red, green, blue))
            replace_output(node.outputs["Fac"], (red + green + blue) / 3)
            replace_output(node.outputs["Alpha"], alpha)


def _expose(tree, pin):
    """Socket at the top of a copied tree that carries what feeds a pin of the original, perhaps inside groups."""
    path, inner = [], tree
    for group in pin.groups:
        node = inner.nodes[group.name]
        path.append((inner, node))
        inner = node.node_tree
    link = first_link(by_identifier(inner.nodes[pin.node.name].inputs, pin.socket.identifier))
    assert link is not None  # something feeds the pin
    source = link.from_socket
    kind = {"RGBA": "NodeSocketColor", "VALUE": "NodeSocketFloat"}.get(source.type, "NodeSocketVector")
    for outer, node in reversed(path):
        item = inner.interface.new_socket("HoloPath", in_out="OUTPUT", socket_type=kind)
        inner.links.new(source, by_identifier(group_output(inner).inputs, item.identifier))
        source = by_identifier(node.outputs, item.identifier)
        inner = outer
    return source


def bake_world(world, width, height, frame):
    """Bake the world around the origin.

    Parameters
    ----------
    world : bpy.types.World
    width, height : int
    frame : float

    Returns
    -------
    float32 [y, x, 3]
        Radiance over Blender's equirectangular directions, bottom row first.
    """
    with _Studio(frame) as studio:
        studio.scene.world = world.original
        image = studio.image(width, height)
        radiance = studio.bake(_globe(studio, image), image, "ENVIRONMENT", 4)[..., :3]
        brightness = radiance.sum(axis=2)
        if brightness.max() > SUNNY * brightness.mean():
            # few texels hold all the light: their shares of the sun's disk decide how much there is
            row, column = (int(n) for n in np.unravel_index(np.argmax(brightness), brightness.shape))
            rows = np.arange(max(row - 16, 0), min(row + 16, height))
            columns, fine = np.arange(column - 32, column + 32), 8
            patch = studio.image(fine * len(columns), fine * len(rows))
            window = columns[0] / width, (columns[-1] + 1) / width, rows[0] / height, (rows[-1] + 1) / height
            pixels = studio.bake(_globe(studio, patch, *window), patch, "ENVIRONMENT", 16)[..., :3]
            blocks = pixels.reshape(len(rows), fine, len(columns), fine, 3).mean((1, 3))
            radiance[rows[:, None], columns % width] = blocks
        return np.nan_to_num(radiance, nan=0, posinf=BRIGHTEST, neginf=0).clip(0, BRIGHTEST)


def bake_lamp(light, width, height, frame):
    """Bake the emission of a light's nodes by direction.

    Parameters
    ----------
    light : bpy.types.Light
    width, height : int
    frame : float

    Returns
    -------
    float32 [y, x, 3]
        Factor on the lamp's own light by direction, one unit away, as `engine.scene.lamps` has it.
    """
    with _Studio(frame) as studio:
        image = studio.image(width, height)
        globe = _globe(studio, image)
        copy = studio.keep(light.original.copy())
        copy.type = "POINT"
        copy = bpy.data.lights[copy.name]
        copy.energy, copy.color, copy.shadow_soft_size = 100, (1, 1, 1), 0
        for name, value in (("use_temperature", False), ("exposure", 0)):
            if hasattr(copy, name):  # since Blender 4.5
                setattr(copy, name, value)
        lamp = studio.keep(bpy.data.objects.new("HoloPath baking", copy))
        studio.scene.collection.objects.link(lamp)
        shone = studio.bake(globe, image, "DIFFUSE", 1, {"DIRECT"})
        copy.use_nodes = False
        plain = studio.bake(globe, image, "DIFFUSE", 1, {"DIRECT"})
        # of Blender's equirectangular longitudes, pi to -pi and bottom up, to 0 to 2 pi and top down
        column_order = (width // 2 - 1 - np.arange(width)) % width
        return shone[::-1, column_order, :3] / plain[..., :3].mean(dtype=float)


def _globe(studio, image, left=0.0, right=1.0, bottom=0.0, top=1.0):
    """A sphere around the origin, or a part of it, over whose equirectangular directions a picture extends."""
    across, up = 256, 128
    places = np.stack(np.meshgrid(np.linspace(0, 1, across + 1), np.linspace(0, 1, up + 1)), axis=-1)
    u, v = left + (right - left) * places[..., 0], bottom + (top - bottom) * places[..., 1]
    longitude = (0.5 - u) * 2 * np.pi
    latitude = np.clip((v - 0.5) * np.pi, -1.569, 1.569)  # triangles at the poles, too, have a normal
    x, y = np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude)
    points = np.stack([x, y, np.sin(latitude)], axis=-1).reshape(-1, 3)
    first = (np.arange(up)[:, None] * (across + 1) + np.arange(across)).ravel()
    faces = first[:, None] + np.array([0, 1, across + 2, across + 1])  # facing inwards
    mesh = studio.keep(bpy.data.meshes.new("HoloPath baking"))
    mesh.from_pydata(points, [], faces)
    uv = places.reshape(-1, 2)[faces.ravel()]
    mesh.uv_layers.new(name=ATLAS).uv.foreach_set("vector", uv.astype(np.float32).ravel())
    material = studio.keep(bpy.data.materials.new("HoloPath baking"))
    nodes = tree_of(material).nodes
    nodes.active = nodes.new("ShaderNodeTexImage")
    nodes.active.image = image
    mesh.materials.append(material)
    thing = studio.keep(bpy.data.objects.new("HoloPath baking", mesh))
    studio.scene.collection.objects.link(thing)
    return thing


@contextlib.contextmanager
def _silence():
    """Suppress the output of Blender's C code about each bake."""
    sys.stdout.flush()
    stdout_copy, nothing = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nothing, 1)
        yield
    finally:
        os.dup2(stdout_copy, 1)
        os.close(stdout_copy)
        os.close(nothing)


def busy():
    """Whether a bake runs: evaluations of Blender are not the user's changes then."""
    return bool(_Studio.open)


class _Studio:
    """A scene for Cycles that leaves nothing behind."""

    open = []

    def __init__(self, frame):
        self._frame = frame
        self._blocks = []

    def __enter__(self):
        if not possible():
            raise BakingFailed(ELSEWHERE)
        self.scene = bpy.data.scenes.new("HoloPath baking")
        self.open.append(self)
        self.scene.frame_current = math.floor(self._frame)
        self.scene.frame_subframe = self._frame - math.floor(self._frame)
        try:
            # pyrefly: ignore[bad-assignment]  # Blender's stubs know no engines of add-ons
            self.scene.render.engine = "CYCLES"
        except TypeError:
            self.__exit__()
            raise BakingFailed(
                "the add-on Cycles Render Engine is off, enable it in the preferences"
            ) from None
        settings: Any = self.scene.cycles
        settings.device = "CPU"
        settings.use_adaptive_sampling = settings.use_denoising = False
        settings.sample_clamp_direct = settings.sample_clamp_indirect = 0
        self._settings = settings
        return self

    def __exit__(self, *_):
        bpy.data.scenes.remove(self.scene)
        bpy.data.batch_remove(self._blocks)
        self.open.remove(self)

    def keep(self, block):
        """Register a new data-block to be removed in the end."""
        self._blocks.append(block)
        return block

    def image(self, width, height):
        """A picture of linear numbers."""
        image = self.keep(
            bpy.data.images.new("HoloPath baking", width, height, alpha=True, float_buffer=True)
        )
        image.colorspace_settings.name = "Non-Color"
        return image

    def object(self, flat):
        """A stand-in for an object: its place and properties, another mesh."""
        if flat.original.type == "MESH":
            thing = self.keep(flat.original.copy())
            thing.animation_data_clear()
            thing.modifiers.clear()
            thing.constraints.clear()
            thing.parent = None
            thing.data = flat.mesh
        else:
            thing = self.keep(bpy.data.objects.new("HoloPath baking", flat.mesh))
            _copy_custom(flat.original, thing)
        for slot in thing.material_slots:
            slot.link = "DATA"
        # by way of a parent, as only that may shear
        parent = self.keep(bpy.data.objects.new("HoloPath baking", None))
        self.scene.collection.objects.link(parent)
        thing.parent, thing.parent_type, thing.matrix_parent_inverse = parent, "OBJECT", flat.matrix
        thing.delta_location, thing.delta_scale = (0, 0, 0), (1, 1, 1)
        thing.delta_rotation_euler, thing.delta_rotation_quaternion = (0, 0, 0), (1, 0, 0, 0)
        thing.matrix_basis.identity()
        thing.color, thing.pass_index = flat.values.color, flat.values.index
        thing.hide_render = thing.hide_viewport = thing.is_holdout = thing.is_shadow_catcher = False
        self.scene.collection.objects.link(thing)
        return thing

    def bake(self, thing, image, kind, samples, filters=frozenset()):
        """Pixels [y, x, 4] of a bake, bottom row first."""
        self._settings.samples = samples
        layer = self.scene.view_layers[0]
        layer.objects.active = thing
        thing.select_set(True, view_layer=layer)
        with bpy.context.temp_override(
            scene=self.scene, view_layer=layer, object=thing, active_object=thing, selected_objects=[thing]
        ):
            try:
                with _silence():
                    bpy.ops.object.bake(
                        type=kind,
                        pass_filter=set(filters),
                        margin=_MARGIN,
                        margin_type="EXTEND",
                        use_clear=True,
                        uv_layer=ATLAS,
                    )
            except RuntimeError as error:
                raise BakingFailed(" ".join(str(error).split())) from error
        width, height = image.size
        pixels = np.empty(4 * width * height, np.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(height, width, 4)
