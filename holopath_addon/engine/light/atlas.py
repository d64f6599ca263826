"""Texture atlas over all surfaces of a scene: a texel for each place on each side of each triangle mesh.

A mesh's triangles are laid out on a sheet, in charts by xatlas or in cells (`unwrapping`). Each shape that shows the
mesh has its own copies of the sheet, one for each lit side; instances differ in their light only, so they share charts.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from hashlib import blake2b
from typing import TYPE_CHECKING

import drjit as dr
import mitsuba as mi
import numpy as np

from ..scene.buffers import gather_row, loaded, packed
from ..scene.lobes import nested_in, parts_of
from .unwrapping import CHARTED_TRIANGLES, cells, charts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from ..progress import PartProgress

NONE = 0xFFFFFFFF
INSTANCE, GROUP = 1024, 2048  # of mi.ShapeType, which lacks these names
GROUP_NAME = re.compile(r'ShapeGroup\[\s*name = "(\d+)"')
MAX_TEXELS = 1 << 24  # of all sheets, which are coarser if they need more
BLOCK = 8  # texels; sheets start at multiples, so that a block of texels belongs to one sheet
MIN_CHARTED_AREA = 4.0  # texels; meshes with smaller triangles on average have one texel a triangle
MAX_SHEET = 4096  # texels a side
PACKING = 1.4  # texels of a sheet over the area of its triangles
LARGE = 16.0  # area of a large triangle of a dense mesh, over the mean area
MAX_LARGE_FRACTION = 0.1  # fraction of a dense mesh's area that such triangles may have
INSET = 0.1  # distance of places from the edges of their triangle, texels ...
MAX_INSET = 0.1  # ... and its maximum, fraction of the triangle's heights
SAME = 1e-4  # relative difference of lengths up to which meshes share charts


@dataclass
class Mesh:
    """Triangle mesh.

    Attributes
    ----------
    shape : int
        Number of its shape in Mitsuba's registry.
    index : int
        Its place in a shape group.
    first : int
        Row of its first triangle.
    vertices, faces : numpy.ndarray
        Positions, meters, and corners of triangles.
    parts : numpy.ndarray
        Number of each vertex's connected part.
    """

    shape: int
    index: int
    first: int
    vertices: np.ndarray
    faces: np.ndarray
    parts: np.ndarray = field(init=False)


@dataclass
class Owner:
    """Shape that shows its own mesh, or instance that shows those of its group at a scale; `number` in the registry."""

    number: int
    instance: bool
    scale: float


@dataclass
class Family:
    """Meshes on one sheet, and the owners that show them."""

    meshes: list
    owners: list = field(default_factory=list)


class Triangles:
    """Table of all triangles of a scene, with the row of the triangle that a ray hits.

    The order of rows depends on the triangles and places of meshes alone.

    Parameters
    ----------
    scene : mitsuba.Scene
    included : callable
        ``included(shape)``: whether a shape's triangles have rows.

    Attributes
    ----------
    families : list of Family
    meshes : list of Mesh
    owners : list of Owner
    numbers : int
        Upper bound of the owners' numbers.
    parts : int
        Connected parts of meshes.
    count : int
        Number of rows.
    structure : str
        Digest of the shapes and sizes of the triangles, without their places.
    scale : mitsuba.Float
        Scale of each owner, by its number.
    shape_of, index_of, number_of, part_of : mitsuba.UInt32
        Shape, index in a group, number in the mesh, and connected part of each row.
    """

    def __init__(self, scene: mi.Scene, included: Callable[[mi.Shape], bool]) -> None:
        self.families, children, starts, self.count, self.parts = [], [NONE], {}, 0, 0
        groups, group_of = {}, _groups(scene)
        structure = blake2b(digest_size=16)
        shapes = [s for s in scene.shapes() if s.shape_type() == INSTANCE or (s.is_mesh() and included(s))]
        for (kind, *_), shape in sorted(((_sort_key(s), s) for s in shapes), key=lambda pair: pair[0]):
            number = number_of(shape)
            structure.update(kind.encode())
            if shape.shape_type() == INSTANCE:
                group = group_of[number]
                if group not in groups:
                    nested = _nested(group)
                    members = [self._mesh(child, included, n) for n, child in enumerate(nested)]
                    groups[group] = Family([m for m in members if m]), len(children)
                    children += [m.first if m else NONE for m in members]
                    kinds = [_sort_key(c)[0] for c, m in zip(nested, members, strict=True) if m]
                    structure.update(" ".join(kinds).encode())
                family, starts[number] = groups[group]
                structure.update(str(starts[number]).encode())
                matrix = np.array(mi.traverse(shape)["to_world"].matrix).reshape(-1, 4, 4)[0, :3, :3]
                family.owners.append(Owner(number, True, float(np.linalg.norm(matrix, axis=0).max())))
            else:
                mesh = self._mesh(shape, included)
                if mesh is not None:
                    starts[number] = len(children)
                    children.append(mesh.first)
                    self.families.append(Family([mesh], [Owner(number, False, 1.0)]))
        self.families += [family for family, _ in groups.values() if family.meshes]
        self.structure = structure.hexdigest()
        self.owners = [owner for family in self.families for owner in family.owners]
        self.numbers = 1 + max(starts, default=0)
        start = np.zeros(self.numbers, np.uint32)
        start[list(starts)] = list(starts.values())
        self._start = loaded(mi.UInt32, start)
        self._children = loaded(mi.UInt32, np.array(children, np.uint32))
        scale = np.ones(self.numbers, np.float32)
        for owner in self.owners:
            scale[owner.number] = owner.scale
        self.scale = loaded(mi.Float, scale)
        meshes = [mesh for family in self.families for mesh in family.meshes]
        self._index = None
        if dr.backend_v(mi.Float) == dr.JitBackend.CUDA:
            # a hit in an instance has the mesh's index in its group with Embree, the mesh itself with OptiX
            index = np.full(1 + max((mesh.shape for mesh in meshes), default=0), NONE, np.uint32)
            index[[mesh.shape for mesh in meshes]] = [mesh.index for mesh in meshes]
            self._index = loaded(mi.UInt32, index)
        self.meshes = sorted(meshes, key=lambda mesh: mesh.first)
        self.shape_of = self._rows(lambda mesh: np.full(len(mesh.faces), mesh.shape))
        self.index_of = self._rows(lambda mesh: np.full(len(mesh.faces), mesh.index))
        self.number_of = self._rows(lambda mesh: np.arange(len(mesh.faces)))
        self.part_of = self._rows(lambda mesh: mesh.parts[mesh.faces[:, 0]])

    def _rows(self, of):
        """Column of the table: a number for each row, by a function of the mesh."""
        return loaded(mi.UInt32, np.concatenate([of(mesh) for mesh in self.meshes] or [np.zeros(1)]))

    def areas(self) -> np.ndarray:
        """Area of each part, square meters of its own mesh."""
        areas = np.zeros(max(1, self.parts))
        for mesh in self.meshes:
            weights = _areas(mesh.vertices, mesh.faces)
            areas += np.bincount(mesh.parts[mesh.faces[:, 0]], weights, len(areas))
        return areas

    def _mesh(self, shape, included, index=0):
        if not (shape.is_mesh() and included(shape)) or shape.face_count() == 0:
            return None
        vertices = np.array(shape.vertex_positions_buffer(), np.float32).reshape(-1, 3)
        faces = np.array(shape.faces_buffer(), np.uint32).reshape(-1, 3)
        mesh = Mesh(number_of(shape), index, self.count, vertices, faces)
        mesh.parts = self.parts + _connected(vertices, faces)
        self.parts = int(mesh.parts.max(initial=self.parts - 1)) + 1
        self.count += len(faces)
        return mesh

    def leave_out(self, shapes: Iterable[int]) -> None:
        """Remove the meshes of shapes, given by their numbers in Mitsuba's registry; rows keep their numbers."""
        children = np.array(self._children)
        for family in self.families:
            for mesh in family.meshes:
                if mesh.shape in shapes:
                    children[children == mesh.first] = NONE
            family.meshes = [mesh for mesh in family.meshes if mesh.shape not in shapes]
        self.families = [family for family in self.families if family.meshes]
        self.meshes = [mesh for mesh in self.meshes if mesh.shape not in shapes]
        self._children = loaded(mi.UInt32, children)

    def row(self, surface: mi.PreliminaryIntersection3f, active: mi.Bool | bool = True) -> tuple:
        """Owner and row of the triangle of a ray's intersection, and whether it has a row (Dr.Jit types)."""
        shape = dr.reinterpret_array(mi.UInt32, surface.shape)
        instance = dr.reinterpret_array(mi.UInt32, surface.instance)
        owner = dr.select(instance != 0, instance, shape)
        known = active & surface.is_valid() & (owner < self.numbers)
        start = dr.gather(mi.UInt32, self._start, owner, known)
        known &= start != 0
        nested = known & (instance != 0)
        index = surface.shape_index
        if self._index is not None:
            of_mesh = nested & (shape < dr.width(self._index))
            index = dr.gather(mi.UInt32, self._index, shape, of_mesh)
            known &= ~nested | (of_mesh & (index != NONE))
        start += dr.select(nested, index, 0)
        first = dr.gather(mi.UInt32, self._children, start, known)
        known &= first != NONE
        return owner, first + surface.prim_index, known


@dataclass
class AtlasLayout:
    """Places of triangles in the texture, from which an `Atlas` is made.

    Attributes
    ----------
    texel : numpy.ndarray, shape (parts,)
        Side of a texel on each connected part of the meshes, meters of the mesh.
    corners : numpy.ndarray, float32, shape (rows, 6)
        First corner of each triangle and the edges from it, texels of its sheet.
    copies : numpy.ndarray, int, shape (copies, 8)
        Copies of sheets: number of the owner among `Triangles.owners`, side, place, size, and the place of the
        sheet's first copy.
    size : (int, int)
        Width and height, texels.
    coarser : float
        Size of the texels over that requested, to bound memory.
    dense : int
        Triangles with one texel, or a cell, where charts would take too long.
    laid : numpy.ndarray, int
        First rows of the meshes in the texture.
    """

    texel: np.ndarray
    corners: np.ndarray
    copies: np.ndarray
    size: tuple
    coarser: float
    dense: int
    laid: np.ndarray

    def serves(self, triangles: Triangles, texel: np.ndarray, sides: set[tuple[int, int]]) -> bool:
        """Whether the layout meets a request to `lay_out`, whose texels may be half as large."""
        if self.laid.tolist() != [mesh.first for mesh in triangles.meshes]:
            return False
        available = {(triangles.owners[owner].number, side) for owner, side in self.copies[:, :2]}
        parts = np.concatenate([mesh.parts for mesh in triangles.meshes] or [np.zeros(0, int)])
        return sides <= available and bool((self.texel <= 2 * self.coarser * texel)[parts].all())


def unfit(triangles: Triangles, texel: np.ndarray, sides: set[tuple[int, int]]) -> set[int]:
    """Numbers of the shapes for which a texture is unfit, whose light is better traced.

    These have parts so large that texels would be over twice the requested size to bound memory, such as a plain up to
    the horizon, or are too dense for charts and have some triangles much larger than the rest.

    Parameters
    ----------
    triangles, texel, sides
        See `lay_out`.
    """
    counts = np.zeros(max(1, triangles.parts))
    uneven, meshes_of = set(), {}
    for family in triangles.families:
        number = sum((owner.number, side) in sides for owner in family.owners for side in (0, 1))
        for mesh in family.meshes:
            areas, part = _areas(mesh.vertices, mesh.faces), mesh.parts[mesh.faces[:, 0]]
            counts += np.bincount(part, number * areas / texel[part] ** 2, len(counts))
            meshes_of |= dict.fromkeys(np.unique(part).tolist(), mesh.shape)
            texels = areas / texel[part] ** 2
            large = texels > LARGE * max(1.0, texels.mean())
            if len(areas) > CHARTED_TRIANGLES and texels[large].sum() > MAX_LARGE_FRACTION * texels.sum():
                uneven.add(mesh.shape)
    # maximum texels of a part, if smaller parts have all they need
    ordered = np.sort(counts)
    rest = MAX_TEXELS / PACKING - np.concatenate([[0], np.cumsum(ordered)[:-1]])
    mean = rest / np.arange(len(ordered), 0, -1)
    short = np.flatnonzero(mean < ordered)
    max_texels = mean[short[0]] if len(short) else np.inf
    return uneven | {meshes_of[part] for part in np.flatnonzero(counts > 4 * max_texels).tolist()}


def lay_out(
    triangles: Triangles, texel: np.ndarray, sides: set[tuple[int, int]], progress: PartProgress
) -> AtlasLayout:
    """Lay out a scene's triangles on a texture.

    Parameters
    ----------
    triangles : Triangles
    texel : numpy.ndarray, shape (triangles.parts,)
        Side of a texel on each part, meters of its own mesh.
    sides : set of (int, int)
        Sides with texels: numbers of owners in Mitsuba's registry, and 0 for the front or 1 for the back.
    progress : callable
        ``progress(done)``, may raise.
    """
    place_of = {owner.number: number for number, owner in enumerate(triangles.owners)}
    families = []
    for family in triangles.families:
        copies = [
            (place_of[o.number], side) for o in family.owners for side in (0, 1) if (o.number, side) in sides
        ]
        if copies:
            families.append((family.meshes, copies))
    texels = sum(_texels(meshes, texel) * len(copies) for meshes, copies in families)
    coarser = max(1.0, math.sqrt(texels / MAX_TEXELS))
    texel = texel * coarser
    corners = np.zeros((max(1, triangles.count), 6), np.float32)
    sizes, dense, charted = [], 0, {}
    for number, (meshes, _) in enumerate(families):
        size, cells_used = _sheet(meshes, texel, corners, charted)
        dense += cells_used
        sizes.append(size)
        progress((number + 1) / len(families))
    places, width, height = _shelves(
        [size for size, (_, copies) in zip(sizes, families, strict=True) for _ in copies]
    )
    table, places = [], iter(places)
    for size, (_, copies) in zip(sizes, families, strict=True):
        first = None
        for owner, side in copies:
            place = next(places)
            first = first or place
            table.append((owner, side, *place, *size, *first))
    table = np.array(table, np.int64).reshape(-1, 8)
    laid = np.array([mesh.first for mesh in triangles.meshes], np.int64)
    return AtlasLayout(texel, corners, table, (width, height), coarser, dense, laid)


def _sheet(meshes, texel, corners, charted):
    """Lay some meshes out side by side, into `corners`; return the sheet's size and its triangles in cells."""
    laid, dense = [], 0
    for mesh in meshes:
        part = mesh.parts[mesh.faces[:, 0]]
        areas = _areas(mesh.vertices, mesh.faces) / texel[part] ** 2
        for chosen in _selections(areas, part - part.min(initial=0)):
            count, sheet = np.count_nonzero(chosen), None
            if MIN_CHARTED_AREA * count <= areas[chosen].sum():
                sheet = _shared_charts(*_scaled(mesh, chosen, texel), charted)
            if sheet is None:
                dense += count
                room = MAX_SHEET / math.sqrt(max(1, count / 2))
                sheet = cells(count, int(min(math.sqrt(2 * areas[chosen].mean()) + 3, room)))
            laid.append((mesh.first + np.flatnonzero(chosen), *sheet))
    places, width, height = _shelves([size for _, _, size in laid])
    for (rows, triangles, _), place in zip(laid, places, strict=True):
        a, b, c = (triangles[:, k] + np.float32(place) for k in range(3))
        corners[rows] = np.concatenate([a, b - a, c - a], axis=1)
    return (width, height), dense


def _selections(areas, part):
    """Masks of triangles of a mesh that are laid out together, by their areas in texels and their parts.

    Where most triangles are small, parts of large ones are laid out separately.
    """
    everything = np.ones(len(areas), bool)
    if MIN_CHARTED_AREA * len(areas) <= areas.sum():
        return [everything]
    large = (MIN_CHARTED_AREA * np.bincount(part) <= np.bincount(part, areas))[part]
    return [large, ~large] if large.any() else [everything]


def _scaled(mesh, chosen, texel):
    """Vertices, in texels, and faces of some triangles of a mesh.

    Parts too far apart for a sheet are moved side by side.
    """
    vertices, parts, faces = mesh.vertices, mesh.parts, mesh.faces
    if not chosen.all():
        used, faces = np.unique(faces[chosen], return_inverse=True)
        vertices, parts, faces = vertices[used], parts[used], faces.reshape(-1, 3).astype(np.uint32)
    scale = texel[parts][:, None]
    scaled = vertices / scale.astype(np.float32)
    if not MAX_SHEET <= np.ptp(scaled, axis=0).max(initial=0) < np.inf:
        return scaled, faces
    _, part = np.unique(parts, return_inverse=True)
    exact = vertices / scale
    lower, upper = np.full((part.max() + 1, 3), np.inf), np.full((part.max() + 1, 3), -np.inf)
    np.minimum.at(lower, part, exact)
    np.maximum.at(upper, part, exact)
    extent = upper - lower
    if extent.max() >= MAX_SHEET:
        return scaled, faces
    places, *_ = _shelves((extent[:, :2] + 1).tolist())
    moved = exact - lower[part]
    moved[:, :2] += np.array(places)[part]
    return moved.astype(np.float32), faces


class Atlas:
    """Map from surfaces that rays hit to texels, and back.

    Parameters
    ----------
    triangles : Triangles
    layout : AtlasLayout
        Layout of these triangles.

    Attributes
    ----------
    width, size : int
        Texels of a row, and all texels.
    rows : numpy.ndarray
        Row of the triangle at each texel, or NONE.
    points : numpy.ndarray
        Whether each row's triangle has one texel.
    texel_of : mitsuba.Float
        Side of a texel on each part, meters.
    """

    def __init__(self, triangles: Triangles, layout: AtlasLayout) -> None:
        self.triangles, self.layout = triangles, layout
        self.width, height = layout.size
        self.size = self.width * height
        self.texel_of = loaded(mi.Float, layout.texel)
        corners, copies = layout.corners, layout.copies
        self.points = abs(corners[:, 2] * corners[:, 5] - corners[:, 3] * corners[:, 4]) < 1e-9
        origins = np.full((triangles.numbers, 4), -1, np.float32)
        base = np.full((max(1, triangles.count), 4), -1, np.float32)
        meshes_of = {owner.number: family.meshes for family in triangles.families for owner in family.owners}
        table = np.zeros((max(1, len(copies)), 4), np.uint32)
        for number, (owner, side, x, y, w, h, x0, y0) in enumerate(copies):
            owner = triangles.owners[owner]
            origins[owner.number, 2 * side : 2 * side + 2] = x, y
            table[number] = owner.number if owner.instance else 0, side, x, y
            for mesh in meshes_of[owner.number]:
                base[mesh.first : mesh.first + len(mesh.faces)] = x0, y0, w, h
        self._corners, self._origins = packed(corners), packed(origins)
        row = self._covered(packed(base), height)
        copy = np.zeros((height, self.width), np.uint32)
        for number, (_, _, x, y, w, h, x0, y0) in enumerate(copies):
            row[y : y + h, x : x + w] = row[y0 : y0 + h, x0 : x0 + w]
            copy[y : y + h, x : x + w] = number
        self.rows = row.ravel()
        self._row, self._copy = loaded(mi.UInt32, self.rows), loaded(mi.UInt32, copy.ravel())
        self._copies = packed(table)

    def _covered(self, base, height):
        """Row of the triangle at each texel of the first copies, with a margin of one texel, or NONE.

        Where several meet, the last one, whatever the order of threads: stored light must find its texels again.
        """
        if not self.triangles.count:
            return np.full((height, self.width), NONE, np.uint32)
        within, beyond = (self._covered_with(margin, base, height) for margin in (0.0, 1.0))
        return np.where(within != NONE, within, beyond)

    def _covered_with(self, margin, base, height):
        """Row of the triangle at each texel, with a margin in texels, or NONE."""
        count = self.triangles.count
        row = dr.zeros(mi.UInt32, self.width * height)  # counts from 1
        dr.make_opaque(row)
        number = dr.arange(mi.UInt32, count)
        u, v, *edges = gather_row(self._corners, number, 6)
        x, y, w, h = gather_row(base, number, 4)
        u, v = u + x, v + y
        a, b = mi.Vector2f(edges[0], edges[1]), mi.Vector2f(edges[2], edges[3])
        area = a.x * b.y - a.y * b.x
        left, right = (f(0, f(a.x, b.x)) for f in (dr.minimum, dr.maximum))
        low, high = (f(0, f(a.y, b.y)) for f in (dr.minimum, dr.maximum))
        # within the sheet, as another one begins beside it
        left, right = dr.maximum(u + left - margin, x), dr.minimum(u + right + margin, x + w - 1)
        low, high = dr.maximum(v + low - margin, y), dr.minimum(v + high + margin, y + h - 1)
        x0, x1, y0, y1 = (mi.Int(dr.floor(end)) for end in (left, right, low, high))
        point = dr.abs(area) < 1e-9
        x0, x1, y0, y1 = (
            dr.select(point, mi.Int(dr.floor(where)), end)
            for where, end in ((u, x0), (u, x1), (v, y0), (v, y1))
        )
        # barycentric coordinates may fall below zero by the margin over each height
        sides = (dr.norm(a), dr.norm(b), dr.norm(b - a))
        slack = [margin * side / dr.maximum(dr.abs(area), 1e-9) for side in sides]

        def body(column, line):
            p = mi.Vector2f(column + 0.5 - u, line + 0.5 - v)
            c = (a.x * p.y - a.y * p.x) / area
            s = (p.x * b.y - p.y * b.x) / area
            inside = (s >= -slack[1]) & (c >= -slack[0]) & (1 - s - c >= -slack[2])
            inside &= (column >= 0) & (column < self.width) & (line >= 0) & (line < height)
            at = mi.UInt32(line) * self.width + mi.UInt32(column)
            number = dr.arange(mi.UInt32, count) + 1
            dr.scatter_reduce(dr.ReduceOp.Max, row, number, at, (inside | point) & (x >= 0))
            last = column >= x1
            return dr.select(last, x0, column + 1), dr.select(last, line + 1, line)

        dr.while_loop((x0, y0), lambda column, line: line <= y1, body, label="texels of triangles")
        dr.eval(row)
        return np.array(row).reshape(height, self.width) - np.uint32(1)  # 0 becomes NONE

    def texel(
        self,
        surface: mi.PreliminaryIntersection3f,
        front: mi.Bool,
        aside: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.UInt32, mi.Bool]:
        """Number of the texel at a surface that a ray hits, and whether there is one (Dr.Jit types).

        Parameters
        ----------
        surface : mitsuba.PreliminaryIntersection3f
        front : mitsuba.Bool
            Whether the front is in view, or the back.
        aside : mitsuba.Point2f
            Offset, 0 to 1: a random one makes the mean of many lookups bilinear; 0.5 finds the nearest texel.
        active : mitsuba.Bool
        """
        owner, row, known = self.triangles.row(surface, active)
        x0, y0, x1, y1 = dr.gather(mi.Vector4f, self._origins, owner, known)
        x, y = dr.select(front, x0, x1), dr.select(front, y0, y1)
        known &= x >= 0
        corner = dr.gather(mi.Vector4f, self._corners, 2 * row, known)
        edge = dr.gather(mi.Vector4f, self._corners, 2 * row + 1, known)
        s, c = surface.prim_uv
        u = corner.x + s * corner.z + c * edge.x + aside.x - 0.5
        v = corner.y + s * corner.w + c * edge.y + aside.y - 0.5
        column, line = mi.UInt32(x + dr.maximum(u, 0)), mi.UInt32(y + dr.maximum(v, 0))
        number = dr.minimum(line * self.width + column, self.size - 1)
        return number, known & (dr.gather(mi.UInt32, self._row, number, known) != NONE)

    def place(self, texel: mi.UInt32, aside: mi.Point2f) -> tuple[mi.PreliminaryIntersection3f, mi.Bool]:
        """Surface at a texel (Dr.Jit types).

        Parameters
        ----------
        texel : mitsuba.UInt32
        aside : mitsuba.Point2f
            Place within the texel, 0 to 1.

        Returns
        -------
        surface : mitsuba.PreliminaryIntersection3f
        front : mitsuba.Bool
            Whether the texel belongs to the front.
        """
        row = dr.gather(mi.UInt32, self._row, texel)
        instance, side, x, y = dr.gather(mi.Vector4u, self._copies, dr.gather(mi.UInt32, self._copy, texel))
        corner = dr.gather(mi.Vector4f, self._corners, 2 * row)
        edge = dr.gather(mi.Vector4f, self._corners, 2 * row + 1)
        p = mi.Vector2f(
            mi.Float(texel % self.width - x) + aside.x - corner.x,
            mi.Float(texel // self.width - y) + aside.y - corner.y,
        )
        a, b = mi.Vector2f(corner.z, corner.w), mi.Vector2f(edge.x, edge.y)
        area = a.x * b.y - a.y * b.x
        point = dr.abs(area) < 1e-9
        s = dr.select(point, aside.x, (p.x * b.y - p.y * b.x) / area)
        c = dr.select(point, aside.y, (a.x * p.y - a.y * p.x) / area)
        # a triangle with one texel is sampled all over; others at the texel, or at their nearest point
        over = point & (s + c > 1)
        s, c = dr.select(over, 1 - s, s), dr.select(over, 1 - c, c)
        s, c = dr.clip(s, 0, 1), dr.clip(c, 0, 1)
        beyond = dr.maximum(s + c - 1, 0) / 2
        s, c = dr.clip(s - beyond, 0, 1), dr.clip(c - beyond, 0, 1)
        total = dr.maximum(s + c, 1)
        s, c = s / total, c / total
        # not on an edge, where a ray may start behind an adjoining surface and escape: the triangle is shrunk about its
        # incenter; barycentric coordinates are distances over heights
        rest = [INSET * dr.norm(edge) / dr.abs(area) for edge in (b, a, b - a)]
        rest = [dr.select(point, INSET / 3, dr.minimum(distance, MAX_INSET)) for distance in rest]
        kept = 1 - sum(rest)
        s, c = rest[0] + kept * s, rest[1] + kept * c
        surface = dr.zeros(mi.PreliminaryIntersection3f, dr.width(texel))
        surface.valid, surface.t = mi.Bool(True), mi.Float(1)
        surface.prim_uv = mi.Point2f(s, c)
        surface.prim_index = dr.gather(mi.UInt32, self.triangles.number_of, row)
        surface.shape = dr.reinterpret_array(mi.ShapePtr, dr.gather(mi.UInt32, self.triangles.shape_of, row))
        surface.shape_index = dr.gather(mi.UInt32, self.triangles.index_of, row)  # for instances
        surface.instance = dr.reinterpret_array(mi.ShapePtr, instance)
        return surface, side == 0


def number_of(shape: mi.Shape) -> int:
    """Number of a shape in Mitsuba's registry, which hits contain."""
    return int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0])


def _groups(scene):
    """Shape group of each instance, by its number."""
    instances = [shape for shape in scene.shapes() if shape.shape_type() == INSTANCE]
    groups = [part for part in parts_of(scene) if isinstance(part, mi.Shape) and part.shape_type() == GROUP]
    names = [group.id() for group in groups]
    try:
        for place, group in enumerate(groups):
            # an instance reveals its group by the name in its description only
            group.set_id(str(place))
        return {number_of(shape): groups[int(GROUP_NAME.search(str(shape))[1])] for shape in instances}
    finally:
        for group, name in zip(groups, names, strict=True):
            group.set_id(name)


def _nested(group):
    """Members of a shape group in their order."""
    return [part for part in nested_in(group) if isinstance(part, mi.Shape)]


def _sort_key(shape):
    """Key that sorts shapes by their geometry, then by their places."""
    kind, place = shape.class_name(), b""
    if shape.is_mesh():
        faces = blake2b(np.array(shape.faces_buffer()).tobytes(), digest_size=16).hexdigest()
        vertices = np.array(shape.vertex_positions_buffer())
        corners = vertices.reshape(-1, 3)[np.array(shape.faces_buffer()).reshape(-1, 3)]
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).sum(dtype=float)
        kind += f"{faces} {float(dr.sum(shape.surface_area())[0]):.3g} {edges:.3g}"
        place = blake2b(vertices.tobytes()).digest()
    elif shape.shape_type() == INSTANCE:
        place = np.array(mi.traverse(shape)["to_world"].matrix).tobytes()
    box = shape.bbox()
    return kind, tuple(np.array(box.min).ravel().tolist()), tuple(np.array(box.max).ravel().tolist()), place


def _connected(vertices, faces):
    """Number of each vertex's connected part; dense meshes are one part."""
    if len(faces) > CHARTED_TRIANGLES or len(faces) < 3:
        return np.zeros(len(vertices), np.int64)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    _, same = np.unique(vertices, axis=0, return_inverse=True)
    corners = same.ravel()[faces]
    ends = np.concatenate([corners[:, [0, 1]], corners[:, [0, 2]]])
    links = coo_array((np.ones(len(ends), np.int8), ends.T), (len(vertices), len(vertices)))
    numbers = connected_components(links, directed=False)[1][same.ravel()]
    return np.unique(numbers, return_inverse=True)[1].ravel()


def _areas(vertices, faces):
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.nan_to_num(areas, posinf=0.0)


def _texels(meshes, texel):
    """Estimate of a sheet's texels."""
    count = 0
    for mesh in meshes:
        areas = _areas(mesh.vertices, mesh.faces) / texel[mesh.parts[mesh.faces[:, 0]]] ** 2
        count += max(PACKING * areas.sum(), len(mesh.faces))
    return count


def _shared_charts(vertices, faces, charted):
    """Charts with one texel a unit, shared by meshes of the same shape; None if there are none."""
    ends = vertices[faces]
    lengths = np.linalg.norm(ends - np.roll(ends, 1, axis=1), axis=2)
    known = charted.setdefault(faces.tobytes(), [])
    for other, laid in known:
        if np.allclose(lengths, other, rtol=SAME, atol=1e-3):
            return laid
    extent = np.ptp(vertices, axis=0).max(initial=0)
    laid = None
    if 0 < extent < MAX_SHEET:
        laid = charts(vertices - vertices.min(0), faces, texels_per_unit=1.0)
    known.append((lengths, laid))
    return laid


def _shelves(sizes):
    """Place rectangles side by side in rows; return their corners, and the width and height of all."""
    if not sizes:
        return [], BLOCK, BLOCK
    padded = np.ceil(np.array(sizes) / BLOCK).astype(int) * BLOCK
    total = float((padded[:, 0] * padded[:, 1]).sum())
    width = max(int(padded[:, 0].max()), math.ceil(1.1 * math.sqrt(total) / BLOCK) * BLOCK)
    places, x, y, shelf = [(0, 0)] * len(sizes), 0, 0, 0
    for number in np.argsort(-padded[:, 1], kind="stable"):
        w, h = (int(v) for v in padded[number])
        if x + w > width:
            x, y, shelf = 0, y + shelf, 0
        places[number] = x, y
        x, shelf = x + w, max(shelf, h)
    return places, width, y + shelf
