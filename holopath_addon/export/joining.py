"""Small objects that nothing tells apart, as one mesh.

Each time that rays are launched, Dr.Jit goes through all shapes that there are, also those of scenes that were before:
0.2 ms for each on a slow core, however few the rays are. Objects of one material differ in nothing else that a
hologram shows: what Cycles knows of an object alone is noted, not carried.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from .geometry import Surface, joined

# Meshes of a scene up to which each stays one: together they cost 10 ms a launch.
MANY_MESHES = 64
# Triangles of a joined mesh: baked light has charts on meshes of no more (`engine.light.unwrapping`).
MAX_TRIANGLES = 20_000
# Of a mesh that is joined, relative to the scene's: where texels cannot show a part of a mesh, such as a plain that
# reaches the horizon, all of the mesh's light is traced.
MAX_EXTENT = 0.25


@dataclass(eq=False)
class Piece:
    """A surface whose material does not shine, to become a mesh of its own or part of one.

    Attributes
    ----------
    surface : Surface or None
        In Mitsuba's scene, meters; None where it has too many triangles to be joined.
    look : ExportedMaterial
    name : str
        The object's.
    bounds : numpy.ndarray, shape (2, 3)
        Lower and upper corner of the box around it, meters.
    mesh : mitsuba.Mesh or None
        Where it is one of its own.
    """

    surface: Surface | None
    look: Any
    name: str
    bounds: np.ndarray
    mesh: Any = None

    @classmethod
    def of(cls, surface, look, name):
        """A piece; what has too many triangles becomes a mesh at once."""
        piece = cls(surface, look, name, np.array(surface.bounds()))
        if len(surface.faces) > MAX_TRIANGLES:
            piece.mesh, piece.surface = piece.alone(), None
        return piece

    def alone(self):
        """The mesh of this piece."""
        return self.mesh or self.surface.to_mitsuba(self.name, self.look.bsdf)

    @property
    def kind(self):
        """Pieces of one kind may become one mesh."""
        return id(self.look), self.surface.normals is None, self.surface.uv is None


def assembled(parts, before):
    """A scene's parts with a mesh in place of each piece, or of those that are joined.

    Which pieces are joined follows from their order, their triangles and their size: where things move in an
    animation, a mesh keeps its triangles, and baked light its charts.

    Parameters
    ----------
    parts : list
        Pieces, and what else `mitsuba.load_dict` takes.
    before : dict
        Joined meshes by their pieces, of the export before.

    Returns
    -------
    list
        Parts for `mitsuba.load_dict`.
    dict
        Joined meshes by their pieces.
    """
    meshes = {}
    group_of = {group[0]: group for group in _groups([part for part in parts if isinstance(part, Piece)])}
    members = {piece for group in group_of.values() for piece in group}
    shapes = []
    for part in parts:
        if not isinstance(part, Piece):
            shapes.append(part)
        elif part in group_of:
            group = group_of[part]
            meshes[group] = before.get(group) or _mesh(group)
            shapes.append(meshes[group])
        elif part not in members:
            part.mesh = part.alone()
            shapes.append(part.mesh)
    return shapes, meshes


def _groups(pieces):
    """Pieces that are joined, in tuples."""
    if len(pieces) <= MANY_MESHES:
        return []
    lower, upper = np.moveaxis([piece.bounds for piece in pieces], 1, 0)
    largest = MAX_EXTENT * np.linalg.norm(upper.max(0) - lower.min(0))
    small = np.linalg.norm(upper - lower, axis=1) <= largest
    groups, latest, triangles = [], {}, {}
    for piece in (piece for piece, is_small in zip(pieces, small, strict=True) if is_small and piece.surface):
        kind, count = piece.kind, len(piece.surface.faces)
        if kind not in latest or triangles[kind] + count > MAX_TRIANGLES:
            latest[kind], triangles[kind] = [], 0
            groups.append(latest[kind])
        latest[kind].append(piece)
        triangles[kind] += count
    return [tuple(group) for group in groups if len(group) > 1]


def _mesh(group):
    """One mesh of some pieces; theirs go, for as long as they are there they cost as much."""
    for piece in group:
        piece.mesh = None
    first = group[0]
    name = f"{first.name} and {len(group) - 1} more"
    return joined([piece.surface for piece in group]).to_mitsuba(name, first.look.bsdf)
