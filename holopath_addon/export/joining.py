"""Small objects that nothing tells apart, as one mesh.

Objects of one material differ in nothing else that a hologram shows: what Cycles knows of an object alone is noted,
not carried. Materials that read the object are baked, and then are its own.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine.scene.meshes.joining import MAX_TRIANGLES, groups, joined_name
from .geometry import Surface, joined


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
    triangles : int
    bounds : numpy.ndarray, shape (2, 3)
        Lower and upper corner of the box around it, meters.
    mesh : mitsuba.Mesh or None
        Where it is one of its own.
    """

    surface: Surface | None
    look: Any
    name: str
    triangles: int
    bounds: np.ndarray
    mesh: Any = None

    @classmethod
    def of(cls, surface, look, name):
        """A piece; what has too many triangles becomes a mesh at once."""
        piece = cls(surface, look, name, len(surface.faces), np.array(surface.bounds()))
        if piece.triangles > MAX_TRIANGLES:
            piece.alone()
            piece.surface = None
        return piece

    def alone(self):
        """The mesh of this piece."""
        if self.mesh is None and self.surface is not None:
            self.mesh = self.surface.to_mitsuba(self.name, self.look.bsdf)
        return self.mesh

    @property
    def kind(self):
        """Pieces of one kind may become one mesh; None where it stays one."""
        return self.surface and (id(self.look), self.surface.normals is None, self.surface.uv is None)


def assembled(parts, before):
    """A scene's parts with a mesh in place of each piece, or of those that are joined.

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
    pieces = [part for part in parts if isinstance(part, Piece)]
    bounds = np.array([piece.bounds for piece in pieces])
    together = groups([piece.kind for piece in pieces], [piece.triangles for piece in pieces], bounds)
    group_of = {group[0]: group for group in (tuple(pieces[n] for n in numbers) for numbers in together)}
    members = {piece for group in group_of.values() for piece in group}
    shapes, meshes = [], {}
    for part in parts:
        if not isinstance(part, Piece):
            shapes.append(part)
        elif part in group_of:
            group = group_of[part]
            meshes[group] = before.get(group) or _mesh(group)
            shapes.append(meshes[group])
        elif part not in members:
            shapes.append(part.alone())
    return shapes, meshes


def _mesh(group):
    """One mesh of some pieces; theirs go, for as long as they are there they cost as much."""
    for piece in group:
        piece.mesh = None
    name = joined_name([piece.name for piece in group])
    return joined([piece.surface for piece in group]).to_mitsuba(name, group[0].look.bsdf)
