"""The cache of exports, so that a scene update costs only its changes.

Blender reports changes: `depsgraph_update_post` and `frame_change_post` list datablocks that were evaluated again, by
their `session_uid`, which survives renames and is never reused. Cheap data (transforms, material slots, visibility,
lights) is read at every export and compared instead. Undo, redo and opening a file clear the cache.
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

    A render's own depsgraph (F12) is never cached: Blender creates it for every render, and the window's updates do
    not cover it. Data whose changes Blender does not report is never cached, either: metaballs, objects in another
    mode than Object Mode, painted images that are not saved, image sequences.

    Memory: the Mitsuba meshes (44 bytes per face corner with normals and UVs, 12 per triangle) and bitmaps of the last
    exported scene, which that scene holds anyway; the arrays of meshes that may be joined, half as much again; and the
    pixels of its images, 4 bytes each, 16 for floats. `clear` frees them, `close` also stops listening.
    """

    def __init__(self):
        self._transforms, self._changes = set(), set()
        self.clear()

    def begin(self, depsgraph):
        """Drop what changed since the last export; call it before reading anything.

        Parameters
        ----------
        depsgraph : bpy.types.Depsgraph
        """
        context = _context(depsgraph)
        if not _listen(self) or context != self._context:
            self.clear()
        self._context = context
        transforms, changed = self._transforms, self._changes
        self._transforms, self._changes = set(), set()
        self.appearances.forget(transforms | changed)
        self._meshes = {key: mesh for key, mesh in self._meshes.items() if not mesh.sources & changed}

    def mesh(self, key, sources):
        """The cached mesh of an evaluated mesh, or an empty one.

        Parameters
        ----------
        key : hashable
            Identity of the evaluated mesh. Blender may reuse the address of a freed mesh, so it only counts for
            objects that used it before and were not evaluated since.
        sources : frozenset of int
            `session_uid` of its source datablocks.

        Returns
        -------
        CachedMesh
        """
        entry = self._meshes.get(key)
        return entry if entry is not None and sources <= entry.sources else CachedMesh()

    def end(self, meshes, joined_meshes):
        """Store the meshes of an export, and drop all others.

        Parameters
        ----------
        meshes : dict of CachedMesh
        joined : dict
            Joined meshes by their pieces.
        """
        self.joined_meshes = joined_meshes
        self._meshes = {key: mesh for key, mesh in meshes.items() if mesh.is_tracked}
        self.appearances.drop_unused()

    @property
    def bakes(self):
        """Whether the last export has baked a mesh's materials, which takes long."""
        return any(mesh.bake for mesh in self._meshes.values())

    def changed(self, uid, moved_only):
        """Record that Blender has evaluated a datablock again."""
        (self._transforms if moved_only else self._changes).add(uid)

    def clear(self):
        """Clear the cache."""
        self._meshes, self.joined_meshes, self._context = {}, {}, None
        self.appearances = Appearances()

    def close(self):
        """Clear the cache and stop listening to Blender."""
        self.clear()
        _listening.discard(self)
        if not _listening:
            _detach()


@dataclass
class MeshBake:
    """Baked materials of a mesh.

    Attributes
    ----------
    sources : list of ExportedMaterial
        Materials of its slots before baking.
    read : tuple
        Object to world, color and index of the object: some nodes read them.
    pixel : float
        Size of a hologram's pixel at the nearest point of the mesh, Blender units.
    looks : list of ExportedMaterial
        The finished materials.
    data : MeshData
        The mesh with the atlas.
    """

    sources: list
    read: tuple
    pixel: float
    looks: list | None = None
    data: object = None


@dataclass
class CachedMesh:
    """An evaluated mesh and its Mitsuba shapes.

    Attributes
    ----------
    sources : set of int
        `session_uid` of its source datablocks.
    is_tracked : bool
        Whether Blender reports all of its changes.
    triangles : int or None
        Number of triangles; None before the mesh was read.
    slots : list of int
        Material slots in use.
    lacking : set of str
        Names of missing UV maps.
    shapes : dict
        Finished Mitsuba shapes, or pieces of some, by everything that affects them.
    bake : MeshBake or None
        Its baked materials, if any.
    """

    sources: set = field(default_factory=set)
    is_tracked: bool = True
    triangles: int | None = None
    slots: list = field(default_factory=list)
    lacking: set = field(default_factory=set)
    shapes: dict = field(default_factory=dict)
    bake: MeshBake | None = None


@dataclass
class _Entry:
    result: object
    notes: Notes
    sources: set
    images: dict


class Appearances:
    """Cache of exported materials, world and profiles of lights, each with its notes."""

    def __init__(self):
        self._entries = {}
        self._frame = 0.0
        self._renew_textures()
        self.begin(Notes())

    def begin(self, notes, frame=0.0):
        """Start an export at a frame; its results add their notes to `notes`."""
        self._notes = notes
        self._current = {}
        self._frame = self.textures.frame = frame

    def get(self, material, can_bake=True):
        """`ExportedMaterial` of a material or None, with its notes.

        With `can_bake`, inputs that vary may be left for baking, otherwise they become constants.
        """
        pictures = {} if can_bake else None
        return self._recall(
            ("material", can_bake), material, lambda _: export_material(material, self.textures, pictures)
        )

    def baked(self, material, pictures):
        """`ExportedMaterial` with baked pictures, see `export_material`; not cached."""
        return export_material(material, self.textures, pictures)

    def world(self, world, frame, export):
        """Result of ``export(world, frame, textures, notes)``."""

        def read(notes):
            try:
                return export(world, frame, self.textures, notes)
            except RecursionError:
                notes.add(world.name, "Nodes linked in a circle", "black")
                return None

        return self._recall("world", world, read)

    def profile(self, light, name, frame, read):
        """Result of ``read(light, name, frame, notes)``."""
        return self._recall(("profile", name), light, lambda notes: read(light, name, frame, notes))

    def emitter(self, look, fraction):
        """A new `mitsuba.Emitter` of an area with an `ExportedMaterial`'s emission and a fraction of all samples."""
        radiance = self.textures.build(look.emission)
        return made({"type": "area", "radiance": radiance, "sampling_weight": fraction})

    def forget(self, uids):
        """Drop results from any of these datablocks."""
        self._drop([key for key, entry in self._entries.items() if entry.sources & uids])

    def drop_unused(self):
        """Drop results that were not used since `begin`."""
        self._drop([key for key in self._entries if key not in self._current])

    def _recall(self, kind, owner, export):
        key = (kind, None if owner is None else owner.original.session_uid)
        if key not in self._current:
            sources, images = _node_sources(owner)
            signatures = {image.session_uid: _signature(image) for image in images}
            entry = self._entries.get(key)
            if entry and (
                entry.sources != sources or entry.images != signatures or None in signatures.values()
            ):
                self._drop([key])
                entry = None
            if entry is None:
                notes = Notes()
                with self.textures.reading(MaterialReading(None), notes):
                    entry = self._entries[key] = _Entry(export(notes), notes, sources, signatures)
            for note in entry.notes:
                self._notes.add(note.object, note.feature, note.effect)
            self._current[key] = entry.result
        return self._current[key]

    def _drop(self, keys):
        entries = [self._entries.pop(key) for key in keys]
        if any(entry.images for entry in entries):
            self._renew_textures()

    def _renew_textures(self):
        """Drop all images, which are read again."""
        self.textures = Textures(Notes())
        self.textures.frame = self._frame


def _node_sources(owner):
    """`session_uid` of all datablocks that a material's or world's nodes use, and the images."""
    uids, images = set(), []
    blocks = [] if owner is None else [owner.original]
    while blocks:
        block = blocks.pop()
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
                    blocks.append(block)
    return uids, images


def _signature(image):
    """Signature of an image's content; None if changes cannot be detected."""
    if image.is_dirty or image.source not in ("FILE", "GENERATED"):
        return None
    packed_file = image.packed_file
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
        packed_file and zlib.crc32(packed_file.data),
    )


def _context(depsgraph):
    return (depsgraph.as_pointer(), depsgraph.scene.original.session_uid, depsgraph.view_layer.name)


def _handlers():
    handlers = bpy.app.handlers
    return {
        _on_update: (handlers.depsgraph_update_post, handlers.frame_change_post),
        _on_reload: (handlers.undo_post, handlers.redo_post, handlers.load_post),
    }


def _listen(cache):
    """Subscribe the cache to Blender's changes; whether it was subscribed all the time."""
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
def _on_update(scene, depsgraph):
    if baking.busy():
        return
    for update in depsgraph.updates:
        block = update.id.original
        moved_only = not update.is_updated_geometry and isinstance(block, (bpy.types.Object, bpy.types.Mesh))
        for cache in _listening:
            cache.changed(block.session_uid, moved_only)


@bpy.app.handlers.persistent
def _on_reload(*_):
    for cache in _listening:
        cache.clear()
