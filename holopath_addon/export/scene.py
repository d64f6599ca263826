"""The evaluated depsgraph to a Mitsuba scene: what is in it, where, and how often."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from ..engine import Camera, InvalidInput
from ..engine.backend import activate
from . import baking
from .camera import export_camera, find_camera
from .geometry import read_mesh, split_by_slot
from .lights import emission_varies, export_lamp
from .materials import Materials
from .notes import Notes
from .textures import Picture, Textures
from .unwrapping import unwrap
from .world import export_world

MESH_TYPES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
UNSUPPORTED_TYPES = {
    "CURVES": "Hair curves",
    "POINTCLOUD": "Point cloud",
    "VOLUME": "Volume",
    "GPENCIL": "Grease Pencil",
    "GREASEPENCIL": "Grease Pencil",
}
# Repeated meshes are copied up to this many triangles in all, then shared: copies are faster to trace.
COPIED_TRIANGLES = 200_000
# Side of a baked texture: two texels a pixel of the hologram where it is nearest, within these limits.
LEAST_TEXELS, MOST_TEXELS = 64, 2048
PROFILE = 512, 256  # directions of a lamp's nodes


@dataclass
class Exported:
    """A Blender scene as the engine takes it.

    Attributes
    ----------
    scene : mitsuba.Scene
        Metres, Blender's axes.
    camera : Camera
    notes : list of Note
        Everything approximated or left out.
    """

    scene: object
    camera: Camera
    notes: list


@dataclass
class _Placed:
    """One instance of a mesh; `key` tells meshes apart."""

    key: tuple
    name: str
    matrix: np.ndarray


def export_scene(depsgraph, resolution, camera=None):
    """Export the evaluated scene.

    Parameters
    ----------
    depsgraph : bpy.types.Depsgraph
        Evaluated; its mode decides whether viewport or render settings of modifiers count.
    resolution : tuple of int
        Hologram width and height in pixels; with the camera's sensor fit they set the field of view.
    camera : bpy.types.Object or str, optional
        Camera object or its name. Default: the scene's active camera.

    Returns
    -------
    Exported

    Raises
    ------
    InvalidInput
        Where there is no usable camera, nothing to render, or a mesh with vertices that are not finite.
    BackendUnavailable
        Where Mitsuba cannot run.
    """
    activate()
    import mitsuba as mi

    scene = depsgraph.scene
    notes = Notes()
    scale = unit_scale(scene)
    exported_camera = export_camera(depsgraph, find_camera(scene, camera), resolution, scale, notes)
    textures = Textures(notes)
    materials = Materials(textures)

    contents = _Contents(depsgraph, scale, materials, notes, _texels_of(exported_camera, resolution, scale))
    parts = {"type": "scene"}
    for number, part in enumerate([*contents.shapes(), *contents.emitters]):
        parts[f"part_{number}"] = part
    world = export_world(scene.world, scene.frame_current, textures, notes)
    if len(parts) - len(contents.emitters) == 1 and world is None:
        raise InvalidInput(
            f"The scene '{scene.name}' has nothing visible to render: add or unhide an object with faces."
        )
    if world is not None:
        parts["world"] = world
    if world is None and not contents.emitters and not contents.emits:
        notes.add(scene.name, "No light, emission or world colour", "the picture is black")
    if contents.emitters:
        for name in contents.smooth_materials:
            notes.add(
                name,
                "Lamps mirrored in or shining through a smooth or transparent surface",
                "missing: use an emitting mesh as lamp",
            )
    return Exported(mi.load_dict(parts), exported_camera, list(notes))


def unit_scale(scene):
    """Metres a Blender unit."""
    units = scene.unit_settings
    return 1.0 if units.system == "NONE" else float(units.scale_length)


def _texels_of(camera, resolution, scale):
    """Function that gives the texels a mesh in world coordinates (Blender units) is worth, as a side."""
    eye = camera.to_world[:3, 3] / scale
    per_pixel = 2 * np.tan(camera.fov_x / 2) / resolution[0]  # footprint at unit distance

    def texels(vertices, triangles):
        a, b, c = (vertices[triangles[:, k]] for k in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
        low, high = vertices.min(0), vertices.max(0)
        nearest = np.linalg.norm(np.clip(eye, low, high) - eye)
        return 2 * np.sqrt(area) / max(nearest * per_pixel, 1e-30)

    return texels


class _Contents:
    """Reads every instance of the depsgraph once; meshes are kept, then turned into shapes."""

    def __init__(self, depsgraph, scale, materials, notes, texels):
        self.emitters = []
        self.emits = False
        self.smooth_materials = []
        self._depsgraph = depsgraph
        self._scale = scale
        self._materials = materials
        self._notes = notes
        self._texels = texels
        self._flats = {}
        self._meshes = {}
        self._slots = {}
        self._placed = []
        self._override = depsgraph.view_layer.material_override
        shown = _render_visible(depsgraph.view_layer)
        try:
            for instance in depsgraph.object_instances:
                owner = (instance.parent if instance.is_instance else instance.object).original
                hidden = owner.hide_render or instance.object.original.hide_render
                if instance.show_self and owner.name in shown and not hidden:
                    self._add(instance)
            for key in list(self._flats):
                self._bake(key)
        finally:
            for flat, *_ in self._flats.values():
                flat.remove()
        self._note_missing(shown)

    def _add(self, instance):
        import bpy

        object = instance.object
        matrix = np.array(instance.matrix_world, dtype=np.float64)
        if object.type == "LIGHT":
            self._add_lamp(object, matrix)
        elif isinstance(object.data, bpy.types.Mesh) or object.type == "META":
            # curves, surfaces and texts appear a second time, as an instance of the mesh they evaluate to
            if not np.isfinite(matrix).all():
                raise InvalidInput(
                    f"The transform of object '{object.name}' is not finite: clear it (Alt G, S)."
                )
            self._note_object(object)
            key = self._mesh_key(object)
            if key not in self._meshes:
                self._read(object, key)
            if self._meshes[key] is not None:
                matrix[:3] *= self._scale
                self._placed.append(_Placed(key, object.name, matrix))
        elif object.type in UNSUPPORTED_TYPES:
            self._notes.add(object.name, UNSUPPORTED_TYPES[object.type], "not supported: left out")

    def _add_lamp(self, object, matrix):
        if object.visible_camera:
            self._notes.add(object.name, "Ray visibility: lamp shown to the camera", "ignored: not seen")
        if not (object.visible_diffuse and object.visible_glossy and object.visible_transmission):
            self._notes.add(object.name, "Ray visibility: lamp hidden from some rays", "ignored: lights all")
        linking = getattr(object, "light_linking", None)  # since Blender 4.0
        if linking and (linking.receiver_collection or linking.blocker_collection):
            self._notes.add(object.name, "Light Linking", "ignored: lights all, and all cast shadows")
        profile = self._profile(object) if emission_varies(object.data) else None
        emitter = export_lamp(object.data, matrix, object.name, self._scale, self._notes, profile)
        if emitter is not None:
            self.emitters.append(emitter)

    def _profile(self, lamp):
        """What a lamp's nodes emit by direction, or None if that cannot be known."""
        try:
            if not baking.possible():
                raise baking.BakingFailed(baking.ELSEWHERE)
            profile = baking.bake_lamp(lamp.data, *PROFILE, self._depsgraph.scene.frame_current)
        except baking.BakingFailed as error:
            self._notes.add(lamp.name, "Light nodes", f"not baked, {error}")
            return None
        mean = profile.mean((0, 1), float, keepdims=True)
        if np.abs(profile - mean).max() <= 2e-3 * mean.max():
            return mean
        self._notes.add(lamp.name, "Light nodes", "baked by direction, as they are one unit away")
        if lamp.data.type == "SUN":
            return profile[-1:].mean((0, 1), float, keepdims=True)  # of straight on, where alone it shines
        return profile

    def _mesh_key(self, object):
        """Instances with equal keys have the same geometry and materials."""
        materials = tuple(
            slot.material.name_full if slot.material else None for slot in object.material_slots
        )
        owner = object.original.name_full if object.type == "META" else None
        return object.data.as_pointer(), owner, materials

    def _read(self, object, key):
        slots = [slot.material for slot in object.material_slots] or [None]
        if self._override is not None:
            slots = [self._override] * len(slots)
        looks = [self._materials.get(material, baking.possible()) for material in slots]
        if any(look.wanted for look in looks):
            try:
                flat = baking.Flat(object, self._depsgraph, self._unwrap(object))
                self._flats[key] = flat, slots, looks, object.name
                mesh = flat.mesh
                data = read_mesh(mesh, object.name, {look.uv_name for look in looks} - {""} | {baking.ATLAS})
                if data is not None and data.normals is not None:
                    data.normals = flat.normals
                self._meshes[key] = data
                return
            except baking.BakingFailed as error:
                self._notes.add(object.name, "Baking", f"failed: {error}")
                looks = [self._materials.get(material, False) for material in slots]
        mesh = object.to_mesh()
        try:
            data = mesh and read_mesh(mesh, object.name, {look.uv_name for look in looks} - {""})
        finally:
            object.to_mesh_clear()
        self._meshes[key] = data or None
        self._wear(key, object.name, looks)

    def _unwrap(self, object):
        """How to lay out an object's mesh, see `baking.Flat`."""
        matrix = np.array(object.matrix_world, dtype=np.float64)

        def lay_out(vertices, triangles):
            wanted = self._texels(vertices @ matrix[:3, :3].T + matrix[:3, 3], triangles)
            if wanted > 2 * MOST_TEXELS:
                self._notes.add(
                    object.name,
                    "Baked textures",
                    f"{wanted / MOST_TEXELS:.0f} times coarser than the picture",
                )
            return unwrap(vertices, triangles, int(np.clip(wanted, LEAST_TEXELS, MOST_TEXELS)))

        return lay_out

    def _bake(self, key):
        """Bake what the materials of a mesh want, and finish them with that."""
        flat, slots, looks, name = self._flats[key]
        wanted = [(slot, list(look.wanted.items())) for slot, look in zip(slots, looks, strict=True)]
        try:
            baked = baking.bake_surface(
                flat,
                [(slot, [output for _, output in outputs]) for slot, outputs in wanted],
                self._depsgraph.scene.frame_current,
            )
        except baking.BakingFailed as error:
            self._notes.add(name, "Baking", f"failed: {error}")
            self._wear(key, name, [self._materials.get(slot, False) for slot in slots])
            return
        done = []
        for number, ((slot, outputs), look, pictures) in enumerate(zip(wanted, looks, baked, strict=True)):
            if look.wanted:
                pictures = {
                    socket: Picture(f"{key} {number} {socket}", pixels)
                    for (socket, _), pixels in zip(outputs, pictures, strict=True)
                }
                look = self._materials.baked(slot, pictures)
            done.append(look)
        self._wear(key, name, done)

    def _wear(self, key, name, looks):
        """Settle on the materials of a mesh, and note what is missing of either."""
        self._slots[key] = looks
        data = self._meshes[key]
        if data is None:
            return
        used = {looks[slot].name: looks[slot] for slot in np.unique(np.clip(data.slots, 0, len(looks) - 1))}
        for look in used.values():
            self._notes.worn(name, look.notes)
            wanted = data.active_uv if look.uv_name is None else look.uv_name
            if look.uv_name != "" and wanted not in data.uvs:
                self._notes.add(name, f"UV map '{wanted or 'active'}'", "missing: textures read one point")
            if look.smooth and look.name not in self.smooth_materials:
                self.smooth_materials.append(look.name)

    def shapes(self):
        """Mitsuba shapes of everything that was placed."""
        counts = Counter(placed.key for placed in self._placed)
        surfaces = {
            key: list(
                split_by_slot(
                    data, len(self._slots[key]), lambda slot, key=key: self._slots[key][slot].uv_name
                )
            )
            for key, data in self._meshes.items()
            if data is not None and counts[key]
        }
        groups = {}
        shapes = []
        for placed in self._placed:
            key, looks = placed.key, self._slots[placed.key]
            shared = counts[key] > 1 and counts[key] * len(self._meshes[key].triangles) > COPIED_TRIANGLES
            still = [(slot, surface) for slot, surface in surfaces[key] if looks[slot].emission is None]
            if shared and still:
                if key not in groups:
                    groups[key] = self._group(still, looks, placed.name)
                    shapes.append(groups[key])
                shapes.append(self._instance(groups[key], placed.matrix))
            for slot, surface in surfaces[key]:
                look = looks[slot]
                if look.emission is not None:
                    shapes += self._emitting(surface.transformed(placed.matrix), look, placed.name)
                elif not shared:
                    shapes.append(surface.transformed(placed.matrix).to_mitsuba(placed.name, look.bsdf))
        return shapes

    def _emitting(self, surface, look, name):
        if surface.area() < 1e-16:
            return [surface.to_mitsuba(name, look.bsdf)]
        self.emits = True
        return [
            side.to_mitsuba(name, look.bsdf, self._materials.emitter(look, 0.5)) for side in surface.sides()
        ]

    @staticmethod
    def _group(surfaces, looks, name):
        import mitsuba as mi

        parts = {f"slot_{slot}": surface.to_mitsuba(name, looks[slot].bsdf) for slot, surface in surfaces}
        return mi.load_dict({"type": "shapegroup", **parts})

    @staticmethod
    def _instance(group, matrix):
        import mitsuba as mi

        return {"type": "instance", "to_world": mi.ScalarTransform4f(matrix), "group": group}

    def _note_object(self, object):
        for feature, hidden in (
            ("camera", not object.visible_camera),
            ("diffuse rays", not object.visible_diffuse),
            ("glossy rays", not object.visible_glossy),
            ("shadow rays", not object.visible_shadow),
        ):
            if hidden:
                self._notes.add(object.name, f"Ray visibility: hidden from {feature}", "ignored: visible")
        if object.is_holdout or object.is_shadow_catcher:
            self._notes.add(object.name, "Holdout or shadow catcher", "rendered as a normal object")
        for system in object.particle_systems:
            if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
                self._notes.add(object.name, f"Hair '{system.name}'", "left out")

    def _note_missing(self, shown):
        """Objects to be rendered that this depsgraph does not hold, as it serves the viewport."""
        if self._depsgraph.mode == "RENDER":
            return
        for object in self._depsgraph.view_layer.objects:
            if object.name not in shown or object.hide_render:
                continue
            if object.type in MESH_TYPES | {"LIGHT"} and (object.hide_viewport or object.hide_get()):
                self._notes.add(object.name, "Hidden in the viewport", "left out, though shown in renders")


def _render_visible(view_layer):
    """Names of the view layer's objects that are in a collection shown in renders."""
    names = set()
    layers = [view_layer.layer_collection]
    while layers:
        layer = layers.pop()
        if layer.exclude or layer.collection.hide_render:
            continue
        names.update(object.name for object in layer.collection.objects)
        layers.extend(layer.children)
    return names
