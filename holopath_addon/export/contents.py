"""Conversion of instances of the depsgraph to Mitsuba shapes and emitters."""

import operator
from collections import Counter
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..engine import InvalidInput
from ..engine.light.unwrapping import LACKING, unwrap
from ..engine.scene import variants
from .cache import MeshBake
from .census import add_notes
from .geometry import read_mesh, split_by_slot
from .hair_and_points import curve_tubes, particle_tubes, point_balls
from .joining import Piece, assemble
from .lights import emission_varies, export_lamp, read_profile
from .render_state import background_layers, differences
from .shading import baking
from .shading.instances import (
    InstanceValues,
    lacks_attributes,
    layer_attributes,
    object_attributes,
    values_of,
)
from .shading.node_graph import attributes_read, reads_generated, reads_instance
from .shading.textures import RawImage

MESH_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
# Functions that make meshes of objects without faces.
MESH_MAKERS = {"CURVES": curve_tubes, "POINTCLOUD": point_balls}
UNSUPPORTED_TYPES = {
    "VOLUME": "Volume",
    "GPENCIL": "Grease Pencil",
    "GREASEPENCIL": "Grease Pencil",
}
# Repeated meshes are copied up to this number of triangles in total, then shared: at most 0.6 GB of copies. On two slow
# cores launches of rays cost 0.4 s with 100 instances, 4 s with 400, 24 s with 1000, and nothing with joined copies.
MAX_COPIED_TRIANGLES = 2_000_000
# Side of a baked texture: two texels per pixel of the hologram at the nearest point, within these limits.
MIN_TEXELS, MAX_TEXELS = 64, 2048
# Instances of a mesh with textures of their own.
MAX_BAKED_INSTANCES = 64
LEFT_OUT = "left out, though shown in renders"
AS_IN_VIEWPORT = "as in the viewport, not as in renders: use F12, or set both alike"

_BARE = ("UV maps on hair or points", "missing: textures read one point")


@dataclass
class _Instance:
    """An instance of a mesh.

    Attributes
    ----------
    key : tuple
        Identity of the mesh.
    name : str
    matrix : mathutils.Matrix
        Object to world, Blender units; frozen.
    done : dict
        Finished shapes by material slot.
    """

    key: tuple
    name: str
    matrix: object
    done: dict


class Contents:
    """The contents of a depsgraph: reads every instance once, and then makes shapes of the meshes.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
    scale : float
        Meters per Blender unit.
    pixel : callable
        Function from a box to the size of a pixel, see `scene.footprint`.
    cache : ExportCache
    notes : Notes
    origin : array, shape (3,)
        Origin of Mitsuba's scene in Blender's world, meters.

    Attributes
    ----------
    emitters : list of dict
        Lights, for `mitsuba.load_dict`.
    emits : bool
        Whether a mesh emits; known after `shapes`, as are all below.
    smooth : dict
        Keys are (object, material) names of surfaces that would mirror lights.
    meshes : dict of CachedMesh
        Meshes for the cache.
    joined : dict
        Joined meshes by their pieces.
    """

    def __init__(self, depsgraph, scale, pixel, cache, notes, origin):
        self.emitters = []
        self.emits = False
        self.smooth = {}
        self.meshes = {}
        self.joined_meshes = {}
        self._depsgraph = depsgraph
        self._scale = scale
        self._origin = tuple(map(float, origin))
        self._pixel = pixel
        self._can_bake = baking.possible()
        self._looks_of = {}
        self._cache = cache
        self._notes = notes
        self._slots = {}
        self._flats = {}
        self._objects_noted = set()
        self._placements = []
        self._is_copied, self._copies_left = {}, MAX_COPIED_TRIANGLES
        self._own_bakes = Counter()
        self._instance_readers = {}
        self._evaluated_metaballs = set()
        self._hair = []
        self._hidden = {}
        self._override = depsgraph.view_layer.material_override
        self._visible_uids = _render_visible(depsgraph)
        self._faces, self._strands = depsgraph.view_layer.use_solid, depsgraph.view_layer.use_strand
        self._render = depsgraph.scene.render
        try:
            for instance, object, owner in self._instances():
                self._note_instancer(instance)
                if instance.show_particles and self._strands:
                    self._add_hair(instance, object)
                if instance.show_self:
                    self._add(instance, object, owner)
            bpy.data.window_managers[0].progress_begin(0, len(self._flats))
            for number, (key, (flat, materials, name)) in enumerate(self._flats.items()):
                bpy.data.window_managers[0].progress_update(number)
                self._bake(key, flat, materials, name)
        finally:
            bpy.data.window_managers[0].progress_end()
            for flat, *_ in self._flats.values():
                flat.remove()
        self._note_collections()
        self._note_viewport()

    def _instances(self):
        """Instances that renders show, with their object and its original owner."""
        for instance in self._depsgraph.object_instances:
            if not (instance.show_self or instance.show_particles):
                continue
            object = instance.object
            original = object.original
            owner = instance.parent.original if instance.is_instance else original
            hidden = owner.hide_render or (original.hide_render and not _is_scattered(instance, owner))
            if owner.instance_type == "COLLECTION" and instance.is_instance:
                hidden |= original.session_uid in self._hidden_within(owner.instance_collection)
            if owner.session_uid in self._visible_uids and not hidden:
                yield instance, object, owner

    def _hidden_within(self, collection):
        """`session_uid` of the objects of an instanced collection that a viewport shows, but renders do not."""
        if self._depsgraph.mode == "RENDER" or collection is None:
            return frozenset()
        if collection.session_uid not in self._hidden:
            all_uids, shown = (_within(collection, everything) for everything in (True, False))
            self._hidden[collection.session_uid] = (
                all_uids - shown if not _scatters(collection) else frozenset()
            )
        return self._hidden[collection.session_uid]

    def _add(self, instance, object, owner):
        if object.type == "LIGHT":
            self._add_lamp(object, np.array(instance.matrix_world, dtype=np.float64))
        elif self._has_faces(object):
            name, original = object.name, object.original
            if name not in self._objects_noted:
                self._objects_noted.add(name)
                self._note_object(object)
            if object.type != "META" and original.type == "META":
                self._evaluated_metaballs.add(original.session_uid)
            materials = [slot.material for slot in object.material_slots]
            matrix = instance.matrix_world.copy().freeze()
            key, values = self._key(instance, object, owner, materials)
            entry = self._recall(key, object, owner, materials, matrix, values)
            looks, done = entry.shapes.get((name, matrix, self._scale, self._origin), (None, {}))
            self._placements.append(
                _Instance(key, name, matrix, done if _same(looks, self._slots[key]) else {})
            )
        elif object.type in UNSUPPORTED_TYPES:
            self._notes.add(object.name, UNSUPPORTED_TYPES[object.type], "not supported: left out")

    def _has_faces(self, object):
        """Whether an object has faces, or a maker of them, that its view layer renders."""
        if object.type in MESH_MAKERS:
            return object.type != "CURVES" or self._strands
        return self._faces and _is_mesh(object)

    def _add_lamp(self, object, matrix):
        if object.visible_camera:
            self._notes.add(object.name, "Ray visibility: lamp shown to the camera", "ignored: not seen")
        if not (object.visible_diffuse and object.visible_glossy and object.visible_transmission):
            self._notes.add(object.name, "Ray visibility: lamp hidden from some rays", "ignored: lights all")
        self._note_linking(object)
        add_notes(getattr(object.data, "cycles", None), object.name, self._notes)
        profile = None
        if emission_varies(object.data):
            frame = self._depsgraph.scene.frame_current_final
            profile = self._cache.appearances.profile(object.data, object.name, frame, read_profile)
        matrix[:3, 3] -= np.array(self._origin) / self._scale
        emitter = export_lamp(object.data, matrix, object.name, self._scale, self._notes, profile)
        if emitter is not None:
            self.emitters.append(emitter)

    def _add_hair(self, instance, object):
        """Add particle hair, which is always read: Blender does not report when it is combed or simulated."""
        for system in object.particle_systems:
            settings = system.settings
            if settings.type != "HAIR" or settings.render_type != "PATH":
                continue
            if instance.is_instance:
                self._notes.add(object.name, f"Hair '{system.name}' of instances", "left out")
                continue
            surface = particle_tubes(object, system, self._depsgraph.mode == "RENDER")
            if surface is None:
                continue
            slots = object.material_slots
            number = min(settings.material, len(slots)) - 1
            material = self._override or (slots[number].material if number >= 0 else None)
            look = self._cache.appearances.get(material, can_bake=False)
            self._notes.add_material(object.name, look.notes)
            if _reads_maps(look):
                self._notes.add(object.name, *_BARE)
            meters = np.diag([self._scale, self._scale, self._scale, 1.0])
            meters[:3, 3] = np.negative(self._origin)
            self._hair.append((_with_bare_maps(surface, look).transform(meters), look, object.name))

    def _key(self, instance, object, owner, materials):
        """Key of an instance's mesh, and the values of the instance that its materials read.

        Instances with different baked materials have separate meshes, up to `MAX_BAKED_INSTANCES`.
        """
        key = _mesh_key(object, object.original, materials)
        readers = [self._override] if self._override is not None else materials
        readers = [material for material in readers if material is not None]
        if not self._can_bake:
            return key, InstanceValues()
        names = set().union(*(attributes_read(material, "VIEW_LAYER") for material in readers))
        values = InstanceValues(layer_attributes=tuple(layer_attributes(self._depsgraph, names)))
        if not any(map(self._reads_instance, readers)):
            return key, values
        if self._own_bakes[key] >= MAX_BAKED_INSTANCES:
            self._notes.add(
                object.name,
                f"More than {MAX_BAKED_INSTANCES} instances with materials that read the instance",
                "the others look like one another",
            )
            return key, values
        self._own_bakes[key] += 1
        names = set().union(*(attributes_read(material, "INSTANCER") for material in readers))
        own = set().union(*(attributes_read(material, "OBJECT") for material in readers))
        values = replace(
            values_of(instance, object, names),
            object_attributes=tuple(object_attributes(object, own)),
            layer_attributes=values.layer_attributes,
        )
        if names and lacks_attributes(instance):
            self._notes.add(
                object.name,
                "Attributes of an instancer",
                "black where geometry nodes make them: needs Blender 5.0",
            )
        who = (owner.session_uid, *instance.persistent_id) if instance.is_instance else (owner.session_uid,)
        return (*key[:-1], who, key[-1]), values

    def _reads_instance(self, material):
        """Whether a material must be baked and reads values that differ between instances of a mesh."""
        uid = material.original.session_uid
        if uid not in self._instance_readers:
            outputs = self._cache.appearances.get(material, True).outputs
            self._instance_readers[uid] = bool(outputs) and reads_instance(material)
        return self._instance_readers[uid]

    def _recall(self, key, object, owner, materials, matrix, values):
        """The cached mesh of a key; also finds the looks of its slots."""
        original = object.original
        data = original.data
        sources = {original.session_uid, owner.session_uid}
        if data is not None:
            sources.add(data.session_uid)
        entry = self.meshes.get(key)
        if entry is None:
            entry = self.meshes[key] = self._cache.mesh(key, sources)
            if self._override is not None:
                materials = [self._override] * max(len(materials), 1)
            self._slots[key] = self._looks(key, entry, object, materials or [None], matrix, values)
        entry.sources |= sources
        if original.type == "META" or original.mode != "OBJECT" or owner.mode != "OBJECT":
            entry.is_tracked = False
        return entry

    def _looks(self, key, entry, object, materials, matrix, values):
        """Looks of a mesh's slots: baked ones if they are cached, otherwise those to be baked later."""
        get = self._cache.appearances.get
        uids = key[-1]  # of the materials: many meshes use the same
        if uids not in self._looks_of:
            looks = [get(material, self._can_bake) for material in materials]
            self._looks_of[uids] = looks, any(look.outputs for look in looks)
        looks, must_bake = self._looks_of[uids]
        bake, entry.bake = entry.bake, None
        if not must_bake:
            return looks
        if object.type in MESH_MAKERS or not (_held_elsewhere(object) or len(object.data.polygons) > 0):
            return [get(material, False) for material in materials]
        to_world = self._finite(matrix, object.name)
        corners = np.array(object.bound_box) @ to_world[:3, :3].T + to_world[:3, 3]
        pixel = self._pixel(corners.min(0), corners.max(0))
        read = matrix, replace(values, color=tuple(object.color), index=object.pass_index)
        if bake and _same(bake.sources, looks) and bake.read == read and bake.pixel <= 1.5 * pixel:
            entry.bake = bake
            return bake.looks
        try:
            generated = any(material is not None and reads_generated(material) for material in materials)
            flat = baking.Flat(object, self._layout(object, to_world, pixel), *read, generated)
            if flat.stretched:
                self._notes.add(
                    object.name,
                    "Generated coordinates",
                    "stretched over the result of modifiers: apply these",
                )
        except baking.BakingFailed as error:
            self._notes.add(object.name, "Baking", f"failed: {error}")
            return [get(material, False) for material in materials]
        entry.bake = MeshBake(looks, read, pixel)
        self._flats[key] = flat, materials, object.name
        return looks

    def _layout(self, object, matrix, pixel):
        """Make the function that lays out an object's mesh for baking, see `baking.Flat`."""

        def lay_out(vertices, triangles):
            if not np.isfinite(vertices).all():
                raise InvalidInput(
                    f"The mesh of object '{object.name}' has vertices that are not finite numbers. "
                    "Repair or hide it."
                )
            points = vertices @ matrix[:3, :3].T
            a, b, c = (points[triangles[:, k]] for k in range(3))
            area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
            size = np.nan_to_num(2 * np.sqrt(area) / max(pixel, 1e-30), posinf=MAX_TEXELS)
            if size > 4 * MAX_TEXELS:
                self._notes.add(
                    object.name, "Baked textures", "coarser than the picture where they are nearest"
                )
            if LACKING:
                self._notes.add(
                    object.name,
                    "Baked textures",
                    "as fine on all triangles, for want of xatlas in this Python",
                )
            return unwrap(vertices, triangles, int(np.clip(size, MIN_TEXELS, MAX_TEXELS)))

        return lay_out

    def _bake(self, key, flat, materials, name):
        """Bake the outputs of a mesh's materials, and finish them."""
        entry, looks = self.meshes[key], self._cache.appearances
        to_bake = [look.outputs for look in entry.bake.sources]
        slots = [
            (material, list(outputs.values())) for material, outputs in zip(materials, to_bake, strict=True)
        ]
        try:
            baked = baking.bake_surface(flat, slots, self._depsgraph.scene.frame_current_final)
        except baking.BakingFailed as error:
            self._notes.add(name, "Baking", f"failed: {error}")
            entry.bake = None
            self._slots[key] = [looks.get(material, False) for material in materials]
            return
        done = []
        for material, outputs, source, arrays in zip(
            materials, to_bake, entry.bake.sources, baked, strict=True
        ):
            pictures = {
                socket: RawImage(f"{name} {socket}", pixels)
                for socket, pixels in zip(outputs, arrays, strict=True)
            }
            done.append(looks.baked(material, pictures) if outputs else source)
        data = read_mesh(flat.mesh, name, _maps(done) | {baking.ATLAS})
        if data is not None and data.corner_normals is not None:
            data.corner_normals = flat.normals
        entry.bake.looks, entry.bake.data = done, data
        self._slots[key] = done

    def shapes(self):
        """Make the Mitsuba shapes of all instances.

        A mesh is read only if the cache lacks some of its shapes, which are then made at once, while its arrays are in
        the processor's cache.
        """
        remaining = Counter(placement.key for placement in self._placements)
        counts = dict(remaining)
        objects = enumerate(
            object
            for instance, object, _ in self._instances()
            if instance.show_self and self._has_faces(object)
        )
        made: dict = {key: {} for key in self.meshes}
        surfaces, groups, shapes = {}, {}, []
        for number, placement in enumerate(self._placements):
            key, looks = placement.key, self._slots[placement.key]
            entry = self.meshes[key]
            if key[1] == "META" and key[0] in self._evaluated_metaballs:
                continue  # since Blender 5 it is listed again as its evaluated mesh

            def surface(slot, number=number, key=key, name=placement.name):
                if key not in surfaces:
                    object = next(object for position, object in objects if position == number)
                    surfaces[key] = self._read(key, object)
                return surfaces[key].get(slot)

            if entry.triangles is None:
                surface(0)
            if counts[key] == remaining[key]:
                self._note_mesh(entry, looks, placement.name)
            copied = self._copied_slots(key, counts[key])
            if len(copied) < len(entry.slots):
                if key not in groups:
                    groups[key] = self._cached_group(key)
                    if groups[key] is None:
                        slots = [slot for slot in entry.slots if slot not in copied]
                        groups[key] = _group({slot: surface(slot) for slot in slots}, looks, placement.name)
                    made[key]["group"] = looks, groups[key]
                    shapes.append(groups[key])
                shapes.append(self._instance(groups[key], placement))
            done = {}
            for slot in copied:
                done[slot] = placement.done.get(slot)
                if done[slot] is None:
                    surface_in_scene = surface(slot).transform(self._to_meters(placement))
                    done[slot] = self._shapes_of(surface_in_scene, looks[slot], placement.name)
                shapes += done[slot]
                if looks[slot].emission is not None:
                    self.emits = self.emits or not isinstance(done[slot][0], Piece)
            made[key][placement.name, placement.matrix, self._scale, self._origin] = looks, done
            remaining[key] -= 1
            if not remaining[key]:
                surfaces.pop(key, None)
        for key, entry in self.meshes.items():
            entry.shapes = made[key]
        for surface, look, name in self._hair:
            shapes += self._shapes_of(surface, look, name)
            self.emits = self.emits or look.emission is not None
        shapes, self.joined_meshes = assemble(shapes, self._cache.joined_meshes)
        return shapes

    def _read(self, key, object):
        """Read the surfaces of a mesh, of hair curves or of points by material slot."""
        entry, looks = self.meshes[key], self._slots[key]
        entry.triangles, entry.slots, entry.lacking = 0, [], set()
        if object.type in MESH_MAKERS:
            surface = MESH_MAKERS[object.type](object.data)
            if surface is None:
                return {}
            entry.triangles, entry.slots = len(surface.faces), [0]
            if _reads_maps(looks[0]):
                entry.lacking.add(_BARE)
            return {0: _with_bare_maps(surface, looks[0])}
        if entry.bake:
            data = entry.bake.data
        elif _held_elsewhere(object):
            try:
                mesh = object.to_mesh()
                data = mesh and read_mesh(mesh, object.name, _maps(looks))
            finally:
                object.to_mesh_clear()
        else:
            data = read_mesh(object.data, object.name, _maps(looks))
        if not data:
            return {}
        entry.triangles, entry.slots = len(data.triangles), data.used_slots(len(looks))
        for look in (looks[slot] for slot in entry.slots):
            uv_name = data.active_uv if look.uv_name is None else look.uv_name
            if look.uv_name != "" and uv_name not in data.uvs:
                entry.lacking.add((f"UV map '{uv_name or 'active'}'", "missing: textures read one point"))
        return dict(split_by_slot(data, len(looks), lambda slot: looks[slot].uv_name))

    def _copied_slots(self, key, count):
        """Slots that are copied for every instance; the others are shared."""
        entry, looks = self.meshes[key], self._slots[key]
        if key not in self._is_copied:
            triangles = count * entry.triangles if count > 1 else 0
            self._is_copied[key] = triangles <= self._copies_left
            self._copies_left -= triangles if self._is_copied[key] else 0
        if self._is_copied[key]:
            return entry.slots
        return [slot for slot in entry.slots if looks[slot].emission is not None]

    def _cached_group(self, key):
        """The cached shape group of a mesh with the same looks, or None.

        On graphics cards Mitsuba 3.9 crashes with groups of another scene.
        """
        if variants.activate() == variants.CUDA:
            return None
        looks, group = self.meshes[key].shapes.get("group", (None, None))
        return group if _same(looks, self._slots[key]) else None

    def _shapes_of(self, surface, look, name):
        if look.emission is None or surface.area() < 1e-16:
            return [Piece.of(surface, look, name)]
        return [
            side.to_mitsuba(name, look.bsdf, self._cache.appearances.emitter(look, 0.5))
            for side in surface.sides()
        ]

    def _instance(self, group, placement):
        import mitsuba as mi

        return {
            "type": "instance",
            "to_world": mi.ScalarTransform4f(self._to_meters(placement)),
            "group": group,
        }

    def _to_meters(self, placement):
        """Matrix from object to Mitsuba's scene, meters."""
        matrix = self._finite(placement.matrix, placement.name)
        matrix[:3] *= self._scale
        matrix[:3, 3] -= self._origin
        return matrix

    @staticmethod
    def _finite(matrix, name):
        """A frozen matrix as an array; before Blender 5.0 NumPy cannot convert frozen ones."""
        matrix = np.array(matrix.copy(), dtype=np.float64)
        if not np.isfinite(matrix).all():
            raise InvalidInput(
                f"The transform of object '{name}' is not finite. Clear it (Alt G, Alt R, Alt S)."
            )
        return matrix

    def _note_mesh(self, entry, looks, name):
        for feature, effect in sorted(entry.lacking):
            self._notes.add(name, feature, effect)
        for look in (looks[slot] for slot in entry.slots):
            self._notes.add_material(name, look.notes)
            if look.smooth:
                self.smooth[name, look.name] = None

    def _note_instancer(self, instance):
        """Note what Cycles has instances take from their instancer."""
        key = instance.is_instance and ("instancer", instance.parent.name)
        if key and key not in self._objects_noted:
            self._objects_noted.add(key)
            self._note_visibility(instance.parent)

    def _note_visibility(self, object):
        for feature, hidden in (
            ("camera", not object.visible_camera),
            ("diffuse rays", not object.visible_diffuse),
            ("glossy rays", not object.visible_glossy),
            ("transmission rays", not object.visible_transmission),
            ("shadow rays", not object.visible_shadow),
        ):
            if hidden:
                self._notes.add(object.name, f"Ray visibility: hidden from {feature}", "ignored: visible")
        if object.is_holdout or object.is_shadow_catcher:
            self._notes.add(object.name, "Holdout or shadow catcher", "rendered as a normal object")
        self._note_linking(object)

    def _note_object(self, object):
        self._note_visibility(object)
        cycles = getattr(object.original, "cycles", None)  # Blender does not free that of a copy
        for block in (object, cycles, object.original.data, *object.modifiers):
            add_notes(block, object.name, self._notes)
        if cycles and self._render.use_simplify:
            scene = self._depsgraph.scene
            culls = [kind for kind in ("camera", "distance") if getattr(scene.cycles, f"use_{kind}_cull")]
            if any(getattr(cycles, f"use_{kind}_cull") for kind in culls):
                self._notes.add(object.name, "Culling of Simplify", "ignored: rendered wherever it is")

    def _note_linking(self, object):
        linking = getattr(object, "light_linking", None)  # since Blender 4.0
        if linking and (linking.receiver_collection or linking.blocker_collection):
            self._notes.add(object.name, "Light Linking", "ignored: lights all, and all cast shadows")

    def _note_collections(self):
        """Note collections of the view layer that Cycles treats specially."""
        layers = [self._depsgraph.view_layer.layer_collection]
        while layers:
            layer = layers.pop()
            if layer.exclude or layer.collection.hide_render:
                continue
            layers.extend(layer.children)
            if not layer.collection.all_objects:
                continue
            if layer.holdout:
                self._notes.add(
                    layer.name, "Collection > Holdout", "ignored: its objects are rendered as others"
                )
            elif layer.indirect_only:
                self._notes.add(
                    layer.name,
                    "Collection > Indirect Only",
                    "ignored: its objects are seen, exclude the collection if their light does not matter",
                )

    def _note_viewport(self):
        """Note differences between renders and the depsgraph of a viewport."""
        if self._depsgraph.mode == "RENDER":
            return
        scene, layer = self._depsgraph.scene.original, self._depsgraph.view_layer
        layer = scene.view_layers[layer.name]
        for thing in layer.objects:
            if thing.session_uid in self._visible_uids and not thing.hide_render:
                if (
                    thing.type in MESH_TYPES | {"LIGHT"}
                    and not thing.hide_viewport
                    and thing.hide_get(view_layer=layer)
                ):
                    self._notes.add(thing.name, "Hidden in the viewport", LEFT_OUT)
        for each in differences(scene, layer):
            if not each.minor:
                self._notes.add(each.owner, each.feature, LEFT_OUT if each.hidden else AS_IN_VIEWPORT)
        if any(_reads_viewport(group) for group in bpy.data.node_groups):
            self._notes.add(scene.name, "Is Viewport node", "true, as in the viewport: renders have it false")


def _is_scattered(instance, owner):
    """Whether nodes or particles show an instance even of an object that is disabled in renders.

    Instances of collections, and of children at vertices and faces, respect that setting.
    """
    system = instance.particle_system if instance.is_instance else None
    of_collection = system is not None and system.settings.render_type == "COLLECTION"
    return instance.is_instance and owner.instance_type == "NONE" and not of_collection


def _scatters(collection):
    """Whether nodes or particles in a collection may show objects wherever these are hidden."""
    return any(
        len(object.particle_systems) or any(modifier.type == "NODES" for modifier in object.modifiers)
        for object in collection.all_objects
    )


def _within(collection, everything):
    """`session_uid` of the objects in a collection and in those that they instance; those that renders show, or all."""
    uids, known, waiting = set(), set(), [collection]
    while waiting:
        each = waiting.pop()
        if each.session_uid in known or not (everything or not each.hide_render):
            continue
        known.add(each.session_uid)
        waiting += each.children
        for object in each.objects:
            if everything or not object.hide_render:
                uids.add(object.session_uid)
                if object.instance_type == "COLLECTION" and object.instance_collection is not None:
                    waiting.append(object.instance_collection)
    return uids


def _render_visible(depsgraph):
    """`session_uid` of the objects in collections that renders show, including those of Background Scenes."""
    shown = [depsgraph.view_layer, *background_layers(depsgraph.scene.original)]
    uids, layers = set(), [layer.layer_collection for layer in shown]
    while layers:
        layer = layers.pop()
        if layer.exclude or layer.collection.hide_render:
            continue
        uids.update(object.session_uid for object in layer.collection.objects)
        layers.extend(layer.children)
    return uids


def _reads_viewport(group):
    """Whether geometry nodes distinguish the viewport from renders."""
    return group.users > 0 and any(node.bl_idname == "GeometryNodeIsViewport" for node in group.nodes)


def _maps(looks):
    """Names of the UV maps that looks read."""
    return {look.uv_name for look in looks} - {""}


def _reads_maps(look):
    return look.uv_name != ""


def _with_bare_maps(surface, look):
    """Hair or points with the UV map that a look reads, all zero."""
    if not _reads_maps(look):
        return surface
    return replace(surface, uv=np.zeros((len(surface.points), 2), np.float32))


def _is_mesh(object):
    # curves, surfaces and texts appear a second time, as an instance of the mesh they evaluate to
    return object.type == "META" or object.type in MESH_MAKERS or isinstance(object.data, bpy.types.Mesh)


def _group(surfaces, looks, name):
    parts = {f"slot_{slot}": surface.to_mitsuba(name, looks[slot].bsdf) for slot, surface in surfaces.items()}
    return variants.made({"type": "shapegroup", **parts})


def _same(looks, others):
    """Whether two lists have identical looks."""
    return looks is not None and len(looks) == len(others) and all(map(operator.is_, looks, others))


def _mesh_key(object, original, materials):
    """Key of an instance's geometry and materials."""
    uids = tuple(None if material is None else material.original.session_uid for material in materials)
    if object.type == "META":
        return original.session_uid, "META", uids
    return object.data.as_pointer(), uids


def _held_elsewhere(object):
    """Whether an object's evaluated mesh is available only as a copy, as Blender has it in another form."""
    return (
        object.type == "META"
        or object.data.is_editmode
        or any(modifier.type == "SUBSURF" for modifier in object.modifiers)  # maybe done by the GPU
    )
