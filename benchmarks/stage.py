"""A Blender scene to fill by shortcuts, rendered by Cycles and, through the exporter, by Mitsuba."""

import os
import tempfile
from typing import Any

import bpy
import numpy as np

from holopath_addon.export.shading.node_graph import tree_of


def added() -> Any:
    """The object that an operator has just added, with data of any kind."""
    return bpy.context.object


class Stage:
    """Builds small scenes and renders them both ways."""

    def __init__(self):
        scene = bpy.context.scene
        assert scene is not None  # every file has one
        self.scene: Any = scene  # with what add-ons keep in it, as Cycles
        data = bpy.data.cameras.new("camera")
        self.camera = self.link(bpy.data.objects.new("camera", data))
        self.camera.location = (0, 0, 4)
        self.scene.camera = self.camera

    def link(self, obj):
        self.scene.collection.objects.link(obj)
        return obj

    def mesh(self, name, vertices, faces, material=None, uv=None):
        data = bpy.data.meshes.new(name)
        data.from_pydata(vertices, [], faces)
        if uv is not None:
            data.uv_layers.new(name="UVMap").uv.foreach_set("vector", np.asarray(uv, np.float32).ravel())
        if material is not None:
            data.materials.append(material)
        return self.link(bpy.data.objects.new(name, data))

    def plane(self, size=2.0, material=None, name="plane", location=(0, 0, 0)):
        half = size / 2
        corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
        obj = self.mesh(name, corners, [(0, 1, 2, 3)], material, uv=[(0, 0), (1, 0), (1, 1), (0, 1)])
        obj.location = location
        return obj

    def sphere(self, radius=0.5, material=None, location=(0, 0, 0), name="sphere"):
        bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=location, segments=48, ring_count=24)
        obj = added()
        obj.name = name
        obj.data.shade_smooth()
        if material is not None:
            obj.data.materials.append(material)
        return obj

    def material(self, node=None, name="material", **values):
        """A material of one shader node, its inputs set by name (underscores for spaces)."""
        material = bpy.data.materials.new(name)
        tree = tree_of(material)
        nodes = tree.nodes
        nodes.clear()
        output = nodes.new("ShaderNodeOutputMaterial")
        if node is not None:
            shader = nodes.new(node)
            for key, value in values.items():
                shader.inputs[key.replace("_", " ")].default_value = value
            tree.links.new(shader.outputs[0], output.inputs["Surface"])
        return material

    def texture(self, material, image, socket, shader=None):
        nodes = material.node_tree.nodes
        shader = shader or next(n for n in nodes if socket in n.inputs)
        texture = nodes.new("ShaderNodeTexImage")
        texture.image = image
        material.node_tree.links.new(texture.outputs["Color"], shader.inputs[socket])
        return texture

    def image(self, pixels, name="image", float_buffer=False, space=None):
        """An image from pixels [y, x, 3], top row first, as Blender stores them."""
        pixels = np.asarray(pixels, np.float32)
        height, width = pixels.shape[:2]
        image: Any = bpy.data.images.new(name, width, height, float_buffer=float_buffer)
        if space:
            image.colorspace_settings.name = space
        full = np.ones((height, width, 4), np.float32)
        full[..., :3] = pixels[::-1]
        image.pixels.foreach_set(full.ravel())
        image.update()
        image.pack()
        return image

    def float_image(self, pixels):
        """An image of linear numbers, [y, x], top row first."""
        pixels = np.repeat(np.asarray(pixels, np.float32)[..., None], 3, axis=2)
        return self.image(pixels, float_buffer=True, space="Non-Color")

    def mix(self, material, node, factor=0.5, first=False):
        """Mix a material's shader with another node, which becomes the second or the first input."""
        tree = material.node_tree
        output = next(n for n in tree.nodes if n.bl_idname == "ShaderNodeOutputMaterial")
        before = output.inputs["Surface"].links[0].from_socket
        mix, other = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new(node)
        mix.inputs[0].default_value = factor
        tree.links.new(before, mix.inputs[2 if first else 1])
        tree.links.new(other.outputs[0], mix.inputs[1 if first else 2])
        tree.links.new(mix.outputs[0], output.inputs["Surface"])
        return mix, other

    def lamp(self, kind, energy=10.0, location=(0, 0, 2), rotation=(0, 0, 0), **values):
        data: Any = bpy.data.lights.new(kind.lower(), kind)
        data.energy = energy
        for key, value in values.items():
            setattr(data, key, value)
        obj = self.link(bpy.data.objects.new(kind.lower(), data))
        obj.location, obj.rotation_euler = location, rotation
        return obj

    def world(self, color=(1, 1, 1), strength=1.0):
        world = bpy.data.worlds.new("world")
        self.scene.world = world
        # where Cycles looks for light, not how much there is; at the size of its choice it takes seconds
        cycles: Any = world.cycles
        cycles.sampling_method, cycles.sample_map_resolution = "MANUAL", 256
        background = next(n for n in tree_of(world).nodes if n.bl_idname == "ShaderNodeBackground")
        background.inputs["Color"].default_value = (*color, 1)
        background.inputs["Strength"].default_value = strength
        return world

    def export(self, resolution=(32, 32), camera=None):
        from holopath_addon.export import export_scene

        return export_scene(bpy.context.evaluated_depsgraph_get(), resolution, camera)

    def mitsuba(self, resolution=(32, 32), spp=256, depth=6, exported=None, seed=0):
        """Linear RGB [y, x, 3] of the exported scene, by Mitsuba's path tracer."""
        exported = exported or self.export(resolution)  # chooses an LLVM, before Mitsuba is imported
        import mitsuba as mi

        camera = exported.camera
        to_world = camera.to_world @ np.diag([-1.0, 1.0, -1.0, 1.0])
        width, height = resolution
        sensor = {
            "type": "perspective",
            "fov": float(np.degrees(camera.fov_x)),
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f(to_world),
            "principal_point_offset_x": camera.shift_x,
            "principal_point_offset_y": -camera.shift_y * width / height,
            "near_clip": camera.clip_start,
            "far_clip": min(camera.clip_end, 1e6 * camera.clip_start),
            "film": {
                "type": "hdrfilm",
                "width": width,
                "height": height,
                "pixel_format": "rgb",
                "rfilter": {"type": "box"},
            },
        }
        # Mitsuba 3.9's `path` squares the opacity of masks
        masked = any(mi.has_flag(s.bsdf().flags(), mi.BSDFFlags.Null) for s in exported.scene.shapes())
        kind = "volpath" if masked else "path"
        # of scenes without emitting meshes, it hides what a transparent film does
        hidden = not camera.sees_sky
        integrator = mi.load_dict(
            {"type": kind, "max_depth": depth, "rr_depth": depth, "hide_emitters": hidden}
        )
        image = mi.render(
            exported.scene, sensor=mi.load_dict(sensor), integrator=integrator, spp=spp, seed=seed
        )
        return np.array(image)

    def cycles(self, resolution=(32, 32), spp=256, depth=6):
        """Linear RGB [y, x, 3] of the same scene, by Cycles."""
        scene = self.scene
        scene.render.engine = "CYCLES"
        settings = scene.cycles
        settings.device, settings.samples = "CPU", spp
        settings.use_adaptive_sampling = settings.use_denoising = False
        limits = [f"{kind}_bounces" for kind in ("max", "diffuse", "glossy", "transmission")]
        before = {name: getattr(settings, name) for name in limits}
        for name in limits:
            setattr(settings, name, depth - 2)
        settings.sample_clamp_indirect = 0
        settings.pixel_filter_type = "BOX"
        scene.render.resolution_x, scene.render.resolution_y = resolution
        scene.render.resolution_percentage = 100
        scene.render.image_settings.file_format = "OPEN_EXR"
        scene.render.image_settings.color_depth = "32"
        with tempfile.TemporaryDirectory() as folder:
            scene.render.filepath = os.path.join(folder, "cycles.exr")
            bpy.ops.render.render(write_still=True)
            image: Any = bpy.data.images.load(scene.render.filepath)
            image.colorspace_settings.name = "Non-Color"
            pixels = np.empty(resolution[0] * resolution[1] * 4, np.float32)
            image.pixels.foreach_get(pixels)
            bpy.data.images.remove(image)
        for name, value in before.items():  # an export notes what is not at its default
            setattr(settings, name, value)
        return pixels.reshape(resolution[1], resolution[0], 4)[::-1, :, :3]

    def ratio(self, region=slice(None), **options):
        """Brightness of Mitsuba's picture over Cycles', by channel, in a region of rows and columns."""
        ours, theirs = self.mitsuba(**options), self.cycles(**options)
        return ours[region].mean((0, 1)) / theirs[region].mean((0, 1))
