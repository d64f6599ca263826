"""Joining of small objects with the same material to one mesh.

Objects of one material do not differ in a hologram otherwise: Cycles' settings of single objects are noted, not
exported. Materials that read the object are baked, and then differ.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..engine.scene.meshes.joining import MAX_TRIANGLES, groups, joined_name
from .geometry import Surface, join_surfaces


@dataclass(eq=False)
class Piece:
    """A surface without emission, which becomes a mesh or a part of one.

    Attributes
    ----------
    surface : Surface or None
        In Mitsuba's scene, meters; None if it has too many triangles to be joined.
    look : ExportedMaterial
    name : str
        Name of the object.
    triangles : int
    bounds : numpy.ndarray, shape (2, 3)
        Lower and upper corner of its box, meters.
    mesh : mitsuba.Mesh or None
        A mesh of this piece only.
    """

    surface: Surface | None
    look: Any
    name: str
    triangles: int
    bounds: np.ndarray
    mesh: Any = None

    @classmethod
    def of(cls, surface, look, name):
        """Make a piece, which becomes a mesh at once if it has too many triangles."""
        piece = cls(surface, look, name, len(surface.faces), np.array(surface.bounds()))
        if piece.triangles > MAX_TRIANGLES:
            piece.alone()
            piece.surface = None
        return piece

    def alone(self):
        """Mesh of this piece only."""
        if self.mesh is None and self.surface is not None:
            self.mesh = self.surface.to_mitsuba(self.name, self.look.bsdf)
        return self.mesh

    @property
    def kind(self):
        """Kind of a piece: pieces of one kind may be joined; None for those that are not."""
        return self.surface and (id(self.look), self.surface.normals is None, self.surface.uv is None)


def assemble(parts, previous):
    """Replace the pieces of a scene's parts by meshes, and join some of them.

    Parameters
    ----------
    parts : list
        Pieces, and other parts for `mitsuba.load_dict`.
    before : dict
        Joined meshes by their pieces, of the previous export.

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
            meshes[group] = previous.get(group) or _mesh(group)
            shapes.append(meshes[group])
        elif part not in members:
            shapes.append(part.alone())
    return shapes, meshes


def _mesh(group):
    """Join pieces to one mesh, and free their own meshes."""
    for piece in group:
        piece.mesh = None
    name = joined_name([piece.name for piece in group])
    return join_surfaces([piece.surface for piece in group]).to_mitsuba(name, group[0].look.bsdf)
