"""Fixtures of the Blender side."""

import pytest

bpy = pytest.importorskip("bpy")


@pytest.fixture
def addon():
    """HoloPath registered with Blender, with nothing left of earlier tests."""
    import holopath_addon

    attached = hasattr(bpy.types.Scene, "holopath")
    if attached:  # by the command line, which needs the settings alone
        from holopath_addon.blender import properties

        properties.detach()
        for cls in properties.CLASSES:
            bpy.utils.unregister_class(cls)
    holopath_addon.register()
    yield holopath_addon
    holopath_addon.unregister()


@pytest.fixture
def lit(scene):
    """The same scene with a white wall and a lamp, to be baked."""
    wall = scene.objects["Wall"].active_material.node_tree.nodes["Principled BSDF"]
    wall.inputs["Base Color"].default_value = (0.8, 0.8, 0.8, 1)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    scene.collection.objects.link(lamp)
    scene.holopath.resolution_x = scene.holopath.resolution_y = 32
    scene.holopath.frames = 1
    return scene


@pytest.fixture
def scene(addon):
    """A shining triangle in front of a dim wall, and settings that take a second."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    scene.camera = camera
    corners = [(-0.1, -0.1, 0), (0.1, -0.1, 0), (0, 0.1, 0)]
    for name, size, depth, radiance in (
        ("Near", 1.0, 0.5, (1.0, 0.5, 0.2)),
        ("Wall", 90.0, 2.0, (0.1, 0.2, 0.3)),
    ):
        mesh = bpy.data.meshes.new(name)
        mesh.from_pydata([(x * size, y * size, 0) for x, y, _ in corners], [], [(0, 1, 2)])
        material = bpy.data.materials.new(name)
        if bpy.app.version < (5, 0, 0):
            material.use_nodes = True
        principled = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
        principled.inputs["Base Color"].default_value = (0, 0, 0, 1)
        principled.inputs["Specular IOR Level"].default_value = 0
        principled.inputs["Emission Color"].default_value = (*radiance, 1)
        principled.inputs["Emission Strength"].default_value = 1
        mesh.materials.append(material)
        thing = bpy.data.objects.new(name, mesh)
        thing.location = (0, 0, -depth)
        scene.collection.objects.link(thing)
    settings = scene.holopath
    settings.resolution_x = settings.resolution_y = 64
    settings.depth_far_mm, settings.depth_near_mm = 1.25, 1.875
    settings.frames = 4
    settings.quality = "preview"
    return scene
