"""Evaluated Blender objects to Mitsuba meshes, through numpy."""

from dataclasses import dataclass

import numpy as np

from ..engine import InvalidInput

# Separation of the two sides of an emitting surface, relative to 1 m + its distance from the origin:
# hundreds of float32 roundings, and well inside the offset at which Mitsuba starts its rays.
SIDE_GAP = 5e-6


@dataclass
class MeshData:
    """A triangulated mesh in its object's space, Blender units.

    Attributes
    ----------
    vertices : float32 [vertex, 3]
    triangles : int32 [triangle, 3]
        Vertex of each triangle's corner.
    corners : int32 [triangle, 3]
        Face corner (Blender's loop) of each triangle's corner.
    slots : int32 [triangle]
        Material slot.
    normals : float32 [corner, 3] or None
        Corner normals; None where every face is flat.
    uvs : dict of str to float32 [corner, 2]
        UV maps by name.
    active_uv : str or None
        The map that rendering uses by default.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    corners: np.ndarray
    slots: np.ndarray
    normals: np.ndarray | None
    uvs: dict
    active_uv: str | None


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
    vertices = _read(mesh.vertices, "co", len(mesh.vertices), 3)
    if not np.isfinite(vertices).all():
        raise InvalidInput(
            f"The mesh of object '{name}' has vertices that are not finite numbers: repair or hide it."
        )
    triangles = _read(mesh.loop_triangles, "vertices", count, 3, np.int32)
    corners = _read(mesh.loop_triangles, "loops", count, 3, np.int32)
    slots = _read(mesh.loop_triangles, "material_index", count, 1, np.int32).ravel()
    normals = None
    if mesh.normals_domain != "FACE":
        normals = _read(mesh.corner_normals, "vector", len(mesh.loops), 3)
        normals[~np.isfinite(normals).all(axis=1)] = 0
    active = next((layer.name for layer in mesh.uv_layers if layer.active_render), None)
    uvs = {}
    for wanted in {active if uv_name is None else uv_name for uv_name in uv_names}:
        layer = mesh.uv_layers.get(wanted) if wanted else None
        if layer is not None:
            uvs[wanted] = np.nan_to_num(_read(layer.uv, "vector", len(mesh.loops), 2))
    return MeshData(vertices, triangles, corners, slots, normals, uvs, active)


def _read(collection, attribute, count, width, dtype=np.float32):
    values = np.empty(count * width, dtype)
    collection.foreach_get(attribute, values)
    return values.reshape(count, width)


@dataclass
class Surface:
    """The triangles of one material slot, indexed on vertices of their own.

    Attributes
    ----------
    vertices, normals : float64 [vertex, 3]
        `normals` is None for flat faces.
    uv : float32 [vertex, 2] or None
    faces : int64 [triangle, 3]
    welded : int64 [vertex]
        Number of the mesh vertex that each vertex is a copy of.
    """

    vertices: np.ndarray
    normals: np.ndarray | None
    uv: np.ndarray | None
    faces: np.ndarray
    welded: np.ndarray

    def transformed(self, matrix):
        """The surface under a 4x4 affine `matrix`; mirrored ones keep normals and winding consistent."""
        linear = matrix[:3, :3]
        vertices = self.vertices @ linear.T + matrix[:3, 3]
        mirrored = np.linalg.det(linear) < 0
        normals = self.normals
        if normals is not None:
            # cofactors: the inverse transpose times the determinant, defined for flattened objects too
            cofactors = np.stack([np.cross(linear[(i + 1) % 3], linear[(i + 2) % 3]) for i in range(3)])
            normals = _normalised(normals @ (-cofactors if mirrored else cofactors).T)
        faces = self.faces[:, ::-1] if mirrored else self.faces
        return Surface(vertices, normals, self.uv, faces, self.welded)

    def area(self):
        """Total area, in the square of the vertices' unit."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()

    def sides(self):
        """Front and back as two surfaces a hair apart, each facing outwards.

        Blender's emission shines from both sides of a face, Mitsuba's from the front only.
        """
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        weighted = np.cross(b - a, c - a)
        summed = np.zeros((self.welded.max() + 1, 3))
        for corner in range(3):
            np.add.at(summed, self.welded[self.faces[:, corner]], weighted)
        outward = _normalised(summed)[self.welded]
        gap = SIDE_GAP * (1 + np.abs(self.vertices).max()) * outward
        back_normals = None if self.normals is None else -self.normals
        return (
            Surface(self.vertices + gap, self.normals, self.uv, self.faces, self.welded),
            Surface(self.vertices - gap, back_normals, self.uv, self.faces[:, ::-1], self.welded),
        )

    def to_mitsuba(self, name, bsdf, emitter=None):
        """A `mitsuba.Mesh` with this material, its arrays copied."""
        import mitsuba as mi

        properties = mi.Properties()
        properties["bsdf"] = bsdf
        if emitter is not None:
            properties["emitter"] = emitter
        mesh = mi.Mesh(
            name,
            len(self.vertices),
            len(self.faces),
            has_vertex_normals=self.normals is not None,
            has_vertex_texcoords=self.uv is not None,
            props=properties,
        )
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"] = mi.Float(np.ascontiguousarray(self.vertices, np.float32).ravel())
        parameters["faces"] = mi.UInt32(np.ascontiguousarray(self.faces, np.uint32).ravel())
        if self.normals is not None:
            parameters["vertex_normals"] = mi.Float(np.ascontiguousarray(self.normals, np.float32).ravel())
        if self.uv is not None:
            parameters["vertex_texcoords"] = mi.Float(np.ascontiguousarray(self.uv, np.float32).ravel())
        parameters.update()
        return mesh


def split_by_slot(data, slot_count, uv_of_slot):
    """Cut a mesh into one `Surface` a material slot.

    Vertices are those of the mesh where all faces are flat and no UV map is asked for, else those of the
    face corners, where normals and UVs live.

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
    slots = np.clip(data.slots, 0, slot_count - 1)
    for slot in np.unique(slots):
        chosen = slots == slot
        uv_name = uv_of_slot(int(slot))
        corner_uv = data.uvs.get(data.active_uv if uv_name is None else uv_name)
        if uv_name != "" and corner_uv is None:
            corner_uv = np.zeros((data.corners.max() + 1, 2), np.float32)
        triangles = data.triangles[chosen]
        if data.normals is None and corner_uv is None:
            used, faces = np.unique(triangles, return_inverse=True)
            yield int(slot), Surface(_double(data.vertices[used]), None, None, faces.reshape(-1, 3), used)
            continue
        used, first, faces = np.unique(data.corners[chosen], return_index=True, return_inverse=True)
        welded = triangles.ravel()[first]
        yield (
            int(slot),
            Surface(
                _double(data.vertices[welded]),
                None if data.normals is None else _double(data.normals[used]),
                None if corner_uv is None else corner_uv[used],
                faces.reshape(-1, 3),
                welded,
            ),
        )


def _double(values):
    return values.astype(np.float64)


def _normalised(vectors):
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), (0.0, 0.0, 1.0))
