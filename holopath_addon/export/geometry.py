"""Conversion of evaluated Blender meshes to Mitsuba meshes, by NumPy."""

import math
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ..engine import InvalidInput

# Separation of the two sides of an emitting surface, relative to 1 m + its distance from the origin:
# hundreds of float32 roundings, and well inside the offset at which Mitsuba starts its rays.
SIDE_GAP = 5e-6


_IDENTITY = np.eye(3)


@dataclass
class MeshData:
    """A triangulated mesh in its object's space, Blender units.

    Attributes
    ----------
    vertices : float32 [vertex, 3]
    corner_vertices : int32 [corner]
        Vertex of each face corner (Blender's loop).
    triangles : int32 [triangle, 3]
        Face corners of each triangle.
    slots : int32 [triangle] or None
        Material slot; None where all are the first.
    vertex_normals : float32 [vertex, 3] or None
        None where normals differ between the faces of a vertex.
    corner_normals : float32 [corner, 3] or None
        None where every face is flat, or `vertex_normals` serves.
    uvs : dict of str to float32 [corner, 2]
        UV maps by name.
    active_uv : str or None
        The map that rendering uses by default.
    """

    vertices: np.ndarray
    corner_vertices: np.ndarray
    triangles: np.ndarray
    slots: np.ndarray | None
    vertex_normals: np.ndarray | None
    corner_normals: np.ndarray | None
    uvs: dict
    active_uv: str | None

    def used_slots(self, slot_count):
        """Material slots with triangles; indices beyond the last use the last, as in Blender."""
        if self.slots is None:
            return [0]
        return [int(slot) for slot in np.unique(np.clip(self.slots, 0, slot_count - 1))]


def read_mesh(mesh, name, uv_names):
    """Copy a Blender mesh into numpy arrays.

    Parameters
    ----------
    mesh : bpy.types.Mesh
    name : str
        Object name, for messages.
    uv_names : set of (str or None)
        UV maps to read; None stands for the active render map.

    Returns
    -------
    MeshData or None
        None if the mesh has no faces.

    Raises
    ------
    InvalidInput
        If a vertex is not finite.
    """
    mesh.calc_loop_triangles()
    count = len(mesh.loop_triangles)
    if count == 0:
        return None
    attributes = mesh.attributes
    corner_count = len(mesh.loops)
    vertices = _read(attributes["position"].data, "vector", len(mesh.vertices), 3)
    if not np.isfinite(vertices).all():
        raise InvalidInput(
            f"The mesh of object '{name}' has vertices that are not finite numbers: repair or hide it."
        )
    corner_vertices = _read(attributes[".corner_vert"].data, "value", corner_count, 1, np.int32).ravel()
    if corner_count == 3 * count:  # nothing but triangles
        triangles = np.arange(corner_count, dtype=np.int32).reshape(-1, 3)
    else:
        triangles = _read(mesh.loop_triangles, "loops", count, 3, np.int32)
    faces = slots = vertex_normals = corner_normals = None
    if "material_index" in attributes:
        faces = _read(mesh.loop_triangle_polygons, "value", count, 1, np.int32).ravel()
        slots = _read(attributes["material_index"].data, "value", len(mesh.polygons), 1, np.int32)[faces, 0]

    active = next((layer.name for layer in mesh.uv_layers if layer.active_render), None)
    uvs = {}
    for uv_name in {active if uv_name is None else uv_name for uv_name in uv_names}:
        layer = mesh.uv_layers.get(uv_name) if uv_name else None
        if layer is not None:
            uvs[uv_name] = _finite(_read(layer.uv, "vector", corner_count, 2))

    if mesh.normals_domain == "POINT" and not uvs:
        vertex_normals = _unit(_read(mesh.vertex_normals, "vector", len(vertices), 3))
    elif mesh.normals_domain != "FACE":
        corner_normals = _unit(_read(mesh.corner_normals, "vector", corner_count, 3))
    return MeshData(vertices, corner_vertices, triangles, slots, vertex_normals, corner_normals, uvs, active)


def _read(collection, attribute, count, width, dtype=np.float32):
    values = np.empty(count * width, dtype)
    collection.foreach_get(attribute, values)
    return values.reshape(count, width)


def _finite(values):
    """The values with zeros for those that are not finite; a copy only if needed."""
    return values if np.isfinite(values).all() else np.where(np.isfinite(values), values, 0)


@dataclass
class Surface:
    """The triangles of one material slot, with separate vertices.

    Attributes
    ----------
    points : float32 [point, 3]
        Points of the mesh.
    welded : int32 [vertex] or None
        Point that each vertex is a copy of; None where they are the points.
    normals : float32 [vertex, 3] or None
        None for flat faces.
    uv : float32 [vertex, 2] or None
    faces : int32 [triangle, 3]
        Vertices of each triangle.
    """

    points: np.ndarray
    welded: np.ndarray | None
    normals: np.ndarray | None
    uv: np.ndarray | None
    faces: np.ndarray

    @property
    def vertices(self):
        """Coordinates of the vertices, float32 [vertex, 3]."""
        return self.points if self.welded is None else self.points.take(self.welded, axis=0)

    def transform(self, matrix):
        """Transform the surface by a 4x4 affine `matrix`; mirroring keeps normals and winding consistent."""
        linear = matrix[:3, :3]
        # in double precision: far from the origin float32 rounds the sum only once
        points = (self.points.astype(np.float64) @ linear.T + matrix[:3, 3]).astype(np.float32)
        cofactors = _cofactors(linear)
        mirrored = linear[0] @ cofactors[0] < 0
        normals = self.normals
        if normals is not None:
            # the inverse transpose times the determinant, defined for flattened objects too
            normals = _transform_normals(normals, -cofactors if mirrored else cofactors)
        faces = self.faces[:, ::-1] if mirrored else self.faces
        return Surface(points, self.welded, normals, self.uv, faces)

    def area(self):
        """Total area, in the square of the vertices' unit."""
        return 0.5 * np.linalg.norm(self._area_normals(), axis=1).sum()

    def _area_normals(self):
        """Normals of triangles times twice their area."""
        a, b, c = np.moveaxis(self.vertices[self.faces].astype(np.float64), 1, 0)
        return np.cross(b - a, c - a)

    def bounds(self):
        """Lower and upper corner of the bounding box; infinite and reversed without points."""
        return self.points.min(0, initial=np.inf), self.points.max(0, initial=-np.inf)

    def sides(self):
        """Front and back as two surfaces with a tiny gap, each facing outwards.

        Blender's emission shines from both sides of a face, Mitsuba's from the front only.
        """
        area_normals = np.repeat(self._area_normals(), 3, axis=0)
        corners = (self.faces if self.welded is None else self.welded[self.faces]).ravel()
        sums = [np.bincount(corners, area_normals[:, axis], len(self.points)) for axis in range(3)]
        gap = SIDE_GAP * (1 + np.abs(self.points).max()) * _normalize(np.stack(sums, axis=1))
        back_normals = None if self.normals is None else -self.normals
        front, back = (self.points + gap).astype(np.float32), (self.points - gap).astype(np.float32)
        return (
            replace(self, points=front),
            replace(self, points=back, normals=back_normals, faces=self.faces[:, ::-1]),
        )

    def to_mitsuba(self, name, bsdf, emitter=None):
        """Convert to a `mitsuba.Mesh` with a material, copying the arrays."""
        import mitsuba as mi

        from ..engine.scene.buffers import loaded

        properties = mi.Properties()
        properties["bsdf"] = bsdf
        if emitter is not None:
            properties["emitter"] = emitter
        vertices = self.vertices
        mesh = mi.Mesh(
            name,
            len(vertices),
            len(self.faces),
            has_vertex_normals=self.normals is not None,
            has_vertex_texcoords=self.uv is not None,
            props=properties,
        )
        buffers = {
            "vertex_positions": loaded(mi.Float, vertices.ravel()),
            "faces": loaded(mi.UInt32, np.ascontiguousarray(self.faces, np.int32).view(np.uint32).ravel()),
        }
        if self.normals is not None:
            buffers["vertex_normals"] = loaded(mi.Float, self.normals.ravel())
        if self.uv is not None:
            buffers["vertex_texcoords"] = loaded(mi.Float, self.uv.ravel())
        fill(mesh, buffers)
        return mesh


def join_surfaces(surfaces):
    """Join surfaces with the same attributes to one, in their order.

    Parameters
    ----------
    surfaces : sequence of Surface
        All or none of them have normals, and likewise UVs.

    Returns
    -------
    Surface
    """
    first = surfaces[0]
    counts = [len(surface.points if surface.welded is None else surface.welded) for surface in surfaces]
    offsets = np.cumsum([0, *counts[:-1]])
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        None,
        None if first.normals is None else np.concatenate([surface.normals for surface in surfaces]),
        None if first.uv is None else np.concatenate([surface.uv for surface in surfaces]),
        np.concatenate([s.faces + np.int32(offset) for s, offset in zip(surfaces, offsets, strict=True)]),
    )


def fill(mesh, buffers):
    """Replace a `mitsuba.Mesh`'s buffers by name."""
    mesh.traverse(_filler()(buffers))
    mesh.parameters_changed(list(buffers))


@cache
def _filler():
    """A traversal that replaces a mesh's own buffers, and does not visit its material.

    `mitsuba.traverse` visits every node and looks for changes by comparing; that takes three times as long
    as all of the copies.
    """
    import mitsuba as mi

    class Filler(mi.TraversalCallback):
        def __init__(self, buffers):
            super().__init__()
            self._buffers = buffers

        def put_value(self, name, value, flags, cpptype=None):
            if name in self._buffers:
                mi.set_property(value, cpptype, self._buffers[name])

        put = put_parameter = put_value

        def put_object(self, *_):
            pass

    return Filler


def split_by_slot(data, slot_count, uv_of_slot):
    """Cut a mesh into one `Surface` a material slot.

    Vertices are those of the mesh where no UV map is asked for and its faces are all flat
    or all smooth, else those of the face corners, where normals and UVs live.

    Parameters
    ----------
    data : MeshData
    slot_count : int
        Number of slots, at least 1; indices beyond the last use the last, as in Blender.
    uv_of_slot : callable
        ``uv_of_slot(slot)`` gives the name of the UV map that the slot's material reads ("" for none,
        None for the active one).

    Yields
    ------
    (int, Surface)
        Slot number and its triangles; empty slots are left out.
    """
    used_slots = data.used_slots(slot_count)
    for slot in used_slots:
        triangles = data.triangles
        if len(used_slots) > 1:
            triangles = triangles[np.clip(data.slots, 0, slot_count - 1) == slot]
        uv_name = uv_of_slot(slot)
        uv = None
        if uv_name != "":
            uv = data.uvs.get(data.active_uv if uv_name is None else uv_name)
            if uv is None:
                uv = np.zeros((len(data.corner_vertices), 2), np.float32)
        if uv is None and data.corner_normals is None:
            used, faces = _compact(data.corner_vertices[triangles], len(data.vertices))
            normals = None if data.vertex_normals is None else data.vertex_normals[used]
            yield slot, Surface(data.vertices[used], None, normals, None, faces)
            continue
        normals = data.corner_normals
        if normals is None and data.vertex_normals is not None:
            normals = data.vertex_normals[data.corner_vertices]
        used, faces = slice(None), triangles
        if len(used_slots) > 1:
            used, faces = _compact(triangles, len(data.corner_vertices))
        normals = None if normals is None else normals[used]
        uv = None if uv is None else uv[used]
        yield slot, Surface(data.vertices, data.corner_vertices[used], normals, uv, faces)


def _compact(faces, count):
    """Indices in use by `faces` out of `count`, ascending, and the faces with new indices."""
    used = np.zeros(count, bool)
    used[faces] = True
    if used.all():
        return slice(None), faces
    number = np.cumsum(used, dtype=np.int32) - 1
    return np.flatnonzero(used), number[faces]


def _cofactors(matrix):
    """Cofactors of a 3x3 matrix."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return np.array(
        [
            [e * i - f * h, f * g - d * i, d * h - e * g],
            [c * h - b * i, a * i - c * g, b * g - a * h],
            [b * f - c * e, c * d - a * f, a * e - b * d],
        ]
    )


def _transform_normals(normals, matrix):
    """Transform `normals` by a matrix, and normalize them."""
    gram = matrix @ matrix.T
    square = gram[0, 0]
    if square > 0 and np.abs(gram - square * _IDENTITY).max() < 1e-6 * square:
        return normals @ (matrix.T / math.sqrt(square)).astype(np.float32)
    size = np.abs(matrix).max()
    return _normalize(normals @ (matrix.T / (size if size > 0 else 1.0)).astype(np.float32))


def _normalize(vectors):
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), np.float32((0, 0, 1)))


def _unit(normals):
    """Blender's normals as unit vectors, which they usually are."""
    square = np.einsum("ij,ij->i", normals, normals)
    if square.min() > 0.999 and square.max() < 1.001:
        return normals
    return _normalize(_finite(normals))
