"""What an export keeps for the next one, so that a scene update costs what changed.

Blender tells which datablocks changed: `depsgraph_update_post` and `frame_change_post` list those that were
evaluated again, by their `session_uid`, which outlives renames and is never given twice. Whatever is cheap
(transforms, material slots, visibility, lamps) is read at every export and compared instead. Undo, redo and
opening a file forget everything.
"""

import os
import weakref
import zlib
from dataclasses import dataclass, field

import bpy

from ..engine.scene.variants import made
from .notes import Notes
from .shading import baking
from .shading.materials import export_material
from .shading.textures import MaterialReading, Textures

_listening = weakref.WeakSet()


class ExportCache:
    """Meshes, materials and textures of the last export, for the viewport's depsgraph.

    A render's own depsgraph (F12) is never cached: Blender makes it anew for every render, and the window's
    updates say nothing about it. What Blender does not report is never kept either: metaballs, objects in
    another mode than Object Mode, images that were painted on but not saved, image sequences.

    Memory: the Mitsuba meshes (44 bytes a face corner with normals and UVs, 12 a triangle) and bitmaps of
    the last exported scene, which that scene holds anyway; the arrays of meshes that may be joined, half as much
    again; and the pixels of its images, 4 bytes each,
    16 where they are floats. `clear` lets go of them, `close` also stops listening.
    """

    def __init__(self):
        self._moved, self._changed = set(), set()
        self.clear()

    def begin(self, depsgraph):
        """Forget what changed since the last export; to be called before anything is read.

        Parameters
        ----------
        depsgraph : bpy.types.Depsgraph
        """
        context = _context(depsgraph)
        if not _listen(self) or context != self._context:
            self.clear()
        self._context = context
        moved, changed = self._moved, self._changed
        self._moved, self._changed = set(), set()
        self.appearances.forget(moved | changed)
        self._meshes = {key: mesh for key, mesh in self._meshes.items() if not mesh.sources & changed}

    def mesh(self, key, sources):
        """The kept mesh of an evaluated mesh, or an empty one.

        Parameters
        ----------
        key : hashable
            Identity of the evaluated mesh. Blender may give the address of a freed mesh to another one, so
            it only counts for objects that used it before and were not evaluated since.
        sources : frozenset of int
            `session_uid` of the datablocks it comes from.

        Returns
        -------
        KeptMesh
        """
        kept = self._meshes.get(key)
        return kept if kept is not None and sources <= kept.sources else KeptMesh()

    def end(self, meshes, joined):
        """Keep these meshes, and no others.

        Parameters
        ----------
        meshes : dict of KeptMesh
        joined : dict
            Joined meshes by their pieces.
        """
        self.joined = joined
        self._meshes = {key: mesh for key, mesh in meshes.items() if mesh.tracked}
        self.appearances.drop_unused()

    @property
    def bakes(self):
        """Whether the last export has a mesh whose materials had to be baked, which takes long."""
        return any(mesh.bake for mesh in self._meshes.values())

    def changed(self, uid, moved_only):
        """Blender has evaluated a datablock again."""
        (self._moved if moved_only else self._changed).add(uid)

    def clear(self):
        """Forget everything."""
        self._meshes, self.joined, self._context = {}, {}, None
        self.appearances = Appearances()

    def close(self):
        """Forget everything and stop listening to Blender."""
        self.clear()
        _listening.discard(self)
        if not _listening:
            _detach()


@dataclass
class MeshBake:
    """What was baked of a mesh.

    Attributes
    ----------
    unbaked : list of ExportedMaterial
        Of its slots, that asked for it.
    read : tuple
        Object to world, colour and index of the object: some nodes read them.
    pixel : float
        What a pixel of the hologram covered where it was nearest, Blender units.
    looks : list of ExportedMaterial
        The finished materials.
    data : MeshData
        The mesh with the atlas.
    """

    unbaked: list
    read: tuple
    pixel: float
    looks: list | None = None
    data: object = None


@dataclass
class KeptMesh:
    """One evaluated mesh and the Mitsuba shapes that were made of it.

    Attributes
    ----------
    sources : set of int
        `session_uid` of the datablocks it was read from.
    tracked : bool
        Whether Blender reports all its changes.
    triangles : int or None
        Number of them; None before the mesh was read.
    slots : list of int
        Material slots in use.
    lacking : set of str
        UV maps that were asked for in vain.
    shapes : dict
        Finished Mitsuba shapes, or pieces of some, by all that they depend on.
    bake : MeshBake or None
        Where its materials had to be baked.
    """

    sources: set = field(default_factory=set)
    tracked: bool = True
    triangles: int | None = None
    slots: list = field(default_factory=list)
    lacking: set = field(default_factory=set)
    shapes: dict = field(default_factory=dict)
    bake: MeshBake | None = None


@dataclass
class _Kept:
    result: object
    notes: Notes
    sources: set
    images: dict


class Appearances:
    """Exported materials, world and lamps' profiles, each kept with the notes it gave rise to."""

    def __init__(self):
        self._kept = {}
        self._frame = 0.0
        self._renew_textures()
        self.begin(Notes())

    def begin(self, notes, frame=0.0):
        """Start an export at a frame; what is got from now on adds its notes to `notes`."""
        self._notes = notes
        self._current = {}
        self._frame = self.textures.frame = frame

    def get(self, material, can_bake=True):
        """`ExportedMaterial` of a material or None; its notes are its own.

        Where it `can_bake`, what varies may be left to be baked, else it is replaced by constants.
        """
        unbaked = {} if can_bake else None
        return self._recall(
            ("material", can_bake), material, lambda _: export_material(material, self.textures, unbaked)
        )

    def baked(self, material, pictures):
        """`ExportedMaterial` with baked pictures, see `export_material`; not kept."""
        return export_material(material, self.textures, pictures)

    def world(self, world, frame, export):
        """What ``export(world, frame, textures, notes)`` gives."""

        def read(notes):
            try:
                return export(world, frame, self.textures, notes)
            except RecursionError:
                notes.add(world.name, "Nodes linked in a circle", "black")
                return None

        return self._recall("world", world, read)

    def profile(self, light, name, frame, read):
        """What ``read(light, name, frame, notes)`` gives."""
        return self._recall(("profile", name), light, lambda notes: read(light, name, frame, notes))

    def emitter(self, look, share):
        """A new `mitsuba.Emitter` of an area with an `ExportedMaterial`'s emission and share of the light samples."""
        radiance = self.textures.build(look.emission)
        return made({"type": "area", "radiance": radiance, "sampling_weight": share})

    def forget(self, uids):
        """Drop what was read from any of these datablocks."""
        self._drop([key for key, kept in self._kept.items() if kept.sources & uids])

    def drop_unused(self):
        """Drop what was not asked for since `begin`."""
        self._drop([key for key in self._kept if key not in self._current])

    def _recall(self, kind, owner, export):
        key = (kind, None if owner is None else owner.original.session_uid)
        if key not in self._current:
            sources, images = _node_sources(owner)
            signatures = {image.session_uid: _signature(image) for image in images}
            kept = self._kept.get(key)
            if kept and (kept.sources != sources or kept.images != signatures or None in signatures.values()):
                self._drop([key])
                kept = None
            if kept is None:
                notes = Notes()
                with self.textures.reading(MaterialReading(None), notes):
                    kept = self._kept[key] = _Kept(export(notes), notes, sources, signatures)
            for note in kept.notes:
                self._notes.add(note.object, note.feature, note.effect)
            self._current[key] = kept.result
        return self._current[key]

    def _drop(self, keys):
        dropped = [self._kept.pop(key) for key in keys]
        if any(kept.images for kept in dropped):
            self._renew_textures()

    def _renew_textures(self):
        """Read images anew from now on; no image is known to be the same."""
        self.textures = Textures(Notes())
        self.textures.frame = self._frame


def _node_sources(owner):
    """`session_uid` of all datablocks that a material's or world's nodes reach, and the images."""
    uids, images = set(), []
    reached = [] if owner is None else [owner.original]
    while reached:
        block = reached.pop()
        if block.session_uid in uids:
            continue
        uids.add(block.session_uid)
        if block.id_type == "IMAGE":
            images.append(block)
        tree = block if block.id_type == "NODETREE" else getattr(block, "node_tree", None)
        if tree is None:
            continue
        uids.add(tree.session_uid)
        for node in tree.nodes:
            for name in ("image", "node_tree", "object", "script", "ies"):
                block = getattr(node, name, None)
                if block is not None:
                    reached.append(block)
    return uids, images


def _signature(image):
    """What tells that an image is still the one that was read; None if that cannot be told."""
    if image.is_dirty or image.source not in ("FILE", "GENERATED"):
        return None
    packed = image.packed_file
    path = bpy.path.abspath(image.filepath, library=image.library)
    try:
        stat = os.stat(path)
        file = (stat.st_mtime_ns, stat.st_size)
    except (OSError, ValueError):
        file = None
    return (
        path,
        file,
        image.source,
        image.alpha_mode,
        image.colorspace_settings.name,
        packed and zlib.crc32(packed.data),
    )


def _context(depsgraph):
    return (depsgraph.as_pointer(), depsgraph.scene.original.session_uid, depsgraph.view_layer.name)


def _handlers():
    handlers = bpy.app.handlers
    return {
        _updated: (handlers.depsgraph_update_post, handlers.frame_change_post),
        _forget: (handlers.undo_post, handlers.redo_post, handlers.load_post),
    }


def _listen(cache):
    """Make sure that Blender's changes reach the cache; whether they did all the time."""
    complete = cache in _listening
    _listening.add(cache)
    for handler, lists in _handlers().items():
        for callbacks in lists:
            if handler not in callbacks:
                callbacks.append(handler)
                complete = False
    return complete


def _detach():
    for handler, lists in _handlers().items():
        for callbacks in lists:
            if handler in callbacks:
                callbacks.remove(handler)


@bpy.app.handlers.persistent
def _updated(scene, depsgraph):
    if baking.busy():
        return
    for update in depsgraph.updates:
        block = update.id.original
        moved_only = not update.is_updated_geometry and isinstance(block, (bpy.types.Object, bpy.types.Mesh))
        for cache in _listening:
            cache.changed(block.session_uid, moved_only)


@bpy.app.handlers.persistent
def _forget(*_):
    for cache in _listening:
        cache.clear()
