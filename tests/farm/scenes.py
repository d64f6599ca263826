"""A scene for farms' tests: quick to render, with light to bake."""


def room(bpy, frames):
    """A lit wall that never changes before a camera that moves, over some frames."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.camera = camera
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.data.energy = 40
    lamp.location = (0.5, 0.5, 0)
    mesh = bpy.data.meshes.new("Wall")
    mesh.from_pydata([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [], [(0, 1, 2, 3)])
    wall = bpy.data.objects.new("Wall", mesh)
    wall.location = (0, 0, -1)
    for thing in (camera, lamp, wall):
        scene.collection.objects.link(thing)
    for frame, x in ((1, -0.02), (frames, 0.02)):
        camera.location.x = x
        camera.keyframe_insert("location", frame=frame)
    scene.frame_start, scene.frame_end = 1, frames
