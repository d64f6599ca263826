"""Linked libraries that are missing, or no longer hold what is linked, are noted."""

import pytest

bpy = pytest.importorskip("bpy")

from holopath_addon import engine  # noqa: E402


def linked(folder, *, plane):
    """Save a .blend that links an object, a collection and a material of another one; its path and the library's."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    bpy.ops.mesh.primitive_cube_add()
    chair = bpy.context.object
    chair.name, chair.data.name = "Chair", "Chair's Mesh"
    chair.data.materials.append(bpy.data.materials.new("Wood"))
    room = bpy.data.collections.new("Room")
    room.objects.link(chair)
    room.use_fake_user = True
    library, main = folder / "library.blend", folder / "main.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(library))
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    with bpy.data.libraries.load(str(library), link=True) as (_, target):
        target.objects, target.collections, target.materials = ["Chair"], ["Room"], ["Wood"]
    scene = bpy.context.scene
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", bpy.data.collections["Room"]
    for thing in (scene.camera, bpy.data.objects["Chair"], instance):
        scene.collection.objects.link(thing)
    if plane:
        bpy.ops.mesh.primitive_plane_add(location=(0, 0, -3))
        bpy.context.object.data.materials.append(bpy.data.materials["Wood"])
    bpy.ops.wm.save_as_mainfile(filepath=str(main), relative_remap=True)
    return main, library


def notes_of(main):
    from holopath_addon.cli import sources

    notes = sources.open_source(str(main)).load(16, 16).notes
    return [
        (note["object"], note["feature"], note["effect"]) for note in notes if "library" in note["feature"]
    ]


def test_a_missing_library_is_noted(backend, tmp_path):
    main, library = linked(tmp_path, plane=True)
    assert notes_of(main) == []
    bpy.ops.wm.open_mainfile(filepath=str(library))
    bpy.data.objects["Chair"].name = "Stool"
    bpy.ops.wm.save_as_mainfile(filepath=str(library))
    [(name, feature, effect)] = notes_of(main)
    assert (name, feature) == ("//library.blend", "Linked library without what is linked")
    assert effect.startswith("object Chair left out: ")
    library.unlink()
    [(name, feature, effect)] = notes_of(main)
    assert (name, feature) == ("//library.blend", "Missing linked library")
    assert effect.startswith("collection Room, object Chair left out, nothing in material Wood: ")


def test_a_scene_of_a_missing_library_alone(backend, tmp_path):
    main, library = linked(tmp_path, plane=False)
    library.unlink()
    with pytest.raises(engine.InvalidInput, match="its linked library //library.blend is missing"):
        notes_of(main)
