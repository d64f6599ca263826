"""RENDERED shading without a window: which camera a view is, and pictures that become better."""

from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from holopath_addon import engine
from holopath_addon.blender import viewport
from holopath_addon.export import export_scene
from holopath_addon.export.camera import export_camera
from holopath_addon.export.notes import Notes


def test_a_free_view_is_the_camera_that_sees_the_same(scene):
    """Cameras by Blender's own matrices, with shift, and with lengths in another unit."""
    camera = scene.camera
    camera.location, camera.rotation_euler = (1, 2, 3), (0.9, 0.2, 0.4)
    camera.data.lens, camera.data.shift_x, camera.data.shift_y = 35, 0.1, -0.05
    camera.data.clip_start, camera.data.clip_end = 0.5, 20
    graph = bpy.context.evaluated_depsgraph_get()
    window = camera.calc_matrix_camera(graph, x=160, y=120)
    region_view = SimpleNamespace(view_matrix=camera.matrix_world.inverted(), window_matrix=window)
    found = viewport._free_camera(region_view, camera.data, 0.01, True).to_dict()
    expected = export_camera(graph, camera, (160, 120), 0.01, Notes()).to_dict()
    for name, value in expected.items():
        np.testing.assert_allclose(found[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


def test_refining(scene, monkeypatch):
    """Images are coarse first, then whole, then better up to the limit; canceled at once."""
    monkeypatch.setattr(viewport, "MAX_SAMPLES", 8)
    exported = export_scene(bpy.context.evaluated_depsgraph_get(), (160, 120))
    view = viewport.RegionView(exported.camera, (160, 120), (0, 0, 160, 120), 8)
    previews = []

    def start(view, shrink):
        previews.append(engine.Preview(exported.scene, view.camera, *(n // shrink for n in view.size)))
        return previews[-1]

    viewed = SimpleNamespace(start=start)
    pictures = []
    viewport.refine(viewed, view, pictures.append, lambda done, message: None)
    assert [picture.shape[:2] for picture in pictures[:3]] == [(60, 80), (120, 160), (120, 160)]
    assert previews[-1].spp == 8
    truth = engine.Preview(exported.scene, exported.camera, 160, 120).refine(64)
    assert engine.psnr(pictures[-1], truth) > engine.psnr(pictures[1], truth) > 15

    def progress(done, message):
        if done > 0:
            raise engine.Cancelled

    shown = []
    with pytest.raises(engine.Cancelled):
        viewport.refine(viewed, view, shown.append, progress)
    assert len(shown) == 1


def test_views_of_the_same_picture(scene):
    graph = bpy.context.evaluated_depsgraph_get()
    camera = export_camera(graph, scene.camera, (16, 12), 1.0, Notes())
    view = viewport.RegionView(camera, (16, 12), (0, 0, 16, 12), 8)
    assert view.same_picture(viewport.RegionView(camera, (16, 12), (5, 7, 16, 12), 8))
    assert not view.same_picture(viewport.RegionView(camera, (16, 13), (0, 0, 16, 13), 8))
    assert not view.same_picture(None)


def test_a_selection_changes_nothing(scene):
    """A selection does not count, though Blender reports it like a hidden object."""
    shown = viewport.Viewport()
    found = []

    def note(_, graph):
        shown._where = graph.scene.name, graph.view_layer.name
        shown._outdated = False
        shown.note(graph)
        found.append(shown._outdated)
        shown._facts = viewport._facts(graph)

    bpy.context.view_layer.update()
    bpy.app.handlers.depsgraph_update_post.append(note)
    try:
        near = scene.objects["Near"]
        for change in (
            lambda: near.hide_set(True),
            lambda: near.select_set(True),
            lambda: near.hide_set(False),
            lambda: setattr(scene.camera, "location", (0, 0, 0.1)),
            lambda: setattr(near, "location", (0, 0.1, -0.5)),
        ):
            change()
            bpy.context.view_layer.update()
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(note)
        if bpy.app.timers.is_registered(viewport._tick):
            bpy.app.timers.unregister(viewport._tick)
    assert found == [True, False, True, False, True]


@pytest.mark.parametrize(
    ("local", "collections", "says"),
    [(None, False, ""), (1, False, "Local View"), (None, True, "all collections")],
)
def test_what_a_view_hides_alone_is_told(local, collections, says):
    space = SimpleNamespace(local_view=local, use_local_collections=collections)
    message = viewport._ignored(space)
    assert says in message and bool(says) == bool(message)
