"""The operators, run as scripts run them."""

import bpy
import numpy as np
import pytest

from holopath_addon import engine, slm
from holopath_addon.blender import preferences, properties
from holopath_addon.engine import rendering
from holopath_addon.engine.waves import libraries
from holopath_addon.operators import session
from holopath_addon.operators.jobs import Job
from holopath_addon.workflow import pipeline
from tests.patience import NEVER, SOON


def picture():
    """Pixels of the reconstruction, row 0 at the top."""
    image = bpy.data.images[session.IMAGE]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1]


def test_render_and_refocus(scene):
    assert bpy.ops.holopath.render_hologram() == {"FINISHED"}
    field = session.current.field
    assert field.data.shape == (4, 3, 64, 64)
    assert scene.holopath.focus == pytest.approx(0.5, rel=0.02) and scene.holopath.focus_auto
    near = picture()
    expected = engine.reconstruct(field, [properties.focus_of(scene.holopath)])[0]
    np.testing.assert_allclose(near[..., :3], expected, rtol=1e-5)
    assert (near[..., 3] == 1).all()
    assert near[36, 32, 0] > 0.2 > near[2, 2, 0]  # the triangle, the wall

    scene.holopath.focus = 2.0
    assert session.current.field is field
    far = picture()
    np.testing.assert_allclose(far[..., :3], engine.reconstruct(field, [2.0])[0], rtol=1e-5)
    assert not np.allclose(near, far)
    scene.holopath.use_pupil = True
    scene.holopath.pupil_diameter_mm = 1.0
    assert picture()[..., :3].mean() < far[..., :3].mean()
    assert bpy.ops.holopath.refocus() == {"FINISHED"}


def test_a_pupil_beside_the_light(scene):
    bpy.ops.holopath.render_hologram()
    before = picture()
    scene.holopath.pupil_offset_mm = (900.0, 0.0)
    scene.holopath.use_pupil = True
    assert "outside the light" in session.current.error
    with pytest.raises(RuntimeError, match="outside the light"):
        bpy.ops.holopath.refocus()
    np.testing.assert_array_equal(picture(), before)
    scene.holopath.use_pupil = False
    assert session.current.error == ""


def test_another_resolution_takes_the_same_image(scene):
    bpy.ops.holopath.render_hologram()
    image = bpy.data.images[session.IMAGE]
    scene.holopath.resolution_x = 48
    bpy.ops.holopath.render_hologram()
    assert bpy.data.images[session.IMAGE] == image and tuple(image.size) == (48, 64)
    assert sum(i.name.startswith("HoloPath") for i in bpy.data.images) == 1


def test_plan(scene):
    assert bpy.ops.holopath.plan() == {"FINISHED"}
    plan = session.current.plan
    assert plan.seconds > 0 and plan.decisions and session.current.field is None
    assert session.current.notes == []


def test_notes(scene):
    material = scene.objects["Near"].active_material
    material.node_tree.nodes["Principled BSDF"].inputs["Subsurface Weight"].default_value = 0.5
    bpy.ops.holopath.plan()
    assert any("Subsurface" in note for note in session.current.notes)


def test_focus_from_selected(scene):
    bpy.context.view_layer.objects.active = scene.objects["Wall"]
    assert bpy.ops.holopath.focus_from_selected() == {"FINISHED"}
    assert scene.holopath.focus == pytest.approx(2.0) and not scene.holopath.focus_auto
    scene.objects["Wall"].location.z = 1.0
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="'Wall' is behind the camera"):
        bpy.ops.holopath.focus_from_selected()


def test_save_field(scene, tmp_path):
    with pytest.raises(RuntimeError):
        bpy.ops.holopath.save_field(directory=str(tmp_path))
    bpy.ops.holopath.render_hologram()
    assert bpy.ops.holopath.save_field(directory=str(tmp_path)) == {"FINISHED"}
    stored = engine.WaveField.load(tmp_path / "wavefield")
    np.testing.assert_array_equal(stored.data, session.current.field.data)
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError, match="cannot be made"):
        bpy.ops.holopath.save_field(directory=str(tmp_path / "file"))


def no_camera(scene):
    scene.camera = None
    return "no active camera"


def orthographic(scene):
    scene.camera.data.type = "ORTHO"
    return "(?i)perspective"


def upside_down_depths(scene):
    scene.holopath.depth_near_mm = 0.5
    return "depth range"


def empty(scene):
    for name in ("Near", "Wall"):
        bpy.data.objects.remove(scene.objects[name])
    return "nothing visible"


def broken_mesh(scene):
    scene.objects["Near"].data.vertices[0].co.x = float("nan")
    return "Near"


@pytest.mark.parametrize("spoil", [no_camera, orthographic, upside_down_depths, empty, broken_mesh])
@pytest.mark.parametrize("operator", ["render_hologram", "plan"])
def test_errors(scene, spoil, operator):
    says = spoil(scene)
    with pytest.raises(RuntimeError, match=says):
        getattr(bpy.ops.holopath, operator)()
    assert session.current.error and "\n" not in session.current.error
    assert session.current.field is None


def test_a_bug_is_a_sentence_too(scene, monkeypatch):
    def fail(*_, **__):
        raise KeyError("surprise")

    monkeypatch.setattr(engine, "render", fail)
    with pytest.raises(RuntimeError, match="Unexpected KeyError"):
        bpy.ops.holopath.render_hologram()
    assert not session.running()


def test_another_file_forgets(scene):
    bpy.ops.holopath.render_hologram()
    assert session.current.field is not None
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert session.current.field is None and session.current.plan is None


def test_a_file_that_cannot_be_opened_loses_nothing(scene, tmp_path):
    bpy.ops.holopath.render_hologram()
    field, broken = session.current.field, tmp_path / "broken.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(broken), copy=True, compress=False)
    broken.write_bytes(broken.read_bytes()[:4000])
    with pytest.raises(RuntimeError):
        bpy.ops.wm.open_mainfile(filepath=str(broken))
    assert session.current.field is field and session.current.task is not None


def test_a_render_that_fails_leaves_what_was_there(scene):
    """The field before, and its scene, which the best phases want."""
    bpy.ops.holopath.render_hologram()
    field, task = session.current.field, session.current.task
    scene.camera = None
    with pytest.raises(RuntimeError, match="no active camera"):
        bpy.ops.holopath.render_hologram()
    assert session.current.field is field and session.current.task is task
    scene.holopath.encoding, scene.holopath.limit_encoding = "refine", True
    scene.holopath.encode_seconds = 1.0
    assert bpy.ops.holopath.encode() == {"FINISHED"} and session.current.phase.method == "refine"


def test_what_encoding_will_do_is_told_of_the_field(scene):
    """Whatever is planned since: Encode works on what was rendered."""
    bpy.ops.holopath.render_hologram()
    made = session.encoding_of(scene)
    assert made.method == "refine"
    scene.holopath.frames = 1
    bpy.ops.holopath.plan()
    assert session.encoding_of(scene) == made


def test_baked_light_is_that_of_its_scene(lit):
    bpy.ops.holopath.bake()
    other = bpy.data.scenes.new("Other")
    assert session.bake_of(lit) and session.texture_of(lit) is not None
    assert session.bake_of(other) is None and session.texture_of(other) is None
    with bpy.context.temp_override(scene=other):
        assert not bpy.ops.holopath.show_texture.poll()


def test_another_camera_than_the_scene_has(scene):
    """As F12 asks for where a 3D View has a local camera."""
    camera = bpy.data.objects.new("Local", bpy.data.cameras.new("Local"))
    camera.location.x = 0.1
    scene.collection.objects.link(camera)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    task = session.prepare(depsgraph, scene.holopath, camera=camera)
    assert task.exported.camera.position[0] == pytest.approx(0.1)
    assert task.request.origin.opened["camera"] == "Local"


def test_opening_a_file_cancels(scene):
    task = session.prepare(bpy.context.evaluated_depsgraph_get(), scene.holopath)

    def forever(progress):
        while True:
            task.compute(progress)

    job = session.current.job = Job(forever)
    job.start()
    assert session.running()
    assert not bpy.ops.holopath.render_hologram.poll()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert job.wait(NEVER) and isinstance(job.error, engine.Cancelled)
    assert session.current.job is None


def test_ending_takes_back_what_an_operator_changed(scene):
    undone = []

    def undo():
        undone.append(True)

    session.current.restore_window = undo
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert undone == [True] and session.current.restore_window is None
    session.current.restore_window = undo
    session.detach()
    assert bpy.app.timers.is_registered(undo) and session.current.restore_window is None
    bpy.app.timers.unregister(undo)


def test_job_in_a_thread_is_the_same_as_without(scene):
    task = session.prepare(bpy.context.evaluated_depsgraph_get(), scene.holopath)
    here, there = Job(task.compute), Job(task.compute)
    here.run()
    there.start()
    assert there.wait(NEVER)
    np.testing.assert_array_equal(here.result.field.data, there.result.field.data)
    assert there.done == pytest.approx(1.0)


@pytest.mark.parametrize("settings", [{}, {"method": "fast"}, {"despeckle": 1}])
def test_progress_never_goes_back(lit, settings):
    for name, value in settings.items():
        setattr(lit.holopath, name, value)
    task, reports = session.prepare(bpy.context.evaluated_depsgraph_get(), lit.holopath), []
    task.compute(lambda done, message: reports.append(done))
    assert reports[0] == 0 and reports[-1] == 1 and reports == sorted(reports)


def test_work_for_the_main_thread(monkeypatch):
    """At once on it; from another thread, where nobody answers, there after a while. Errors come through."""
    import threading

    from holopath_addon.operators import jobs

    monkeypatch.setattr(jobs, "MAIN_THREAD_TIMEOUT", 0.05)
    assert jobs.run_on_main_thread(threading.current_thread) is threading.main_thread()
    found = []
    thread = threading.Thread(target=lambda: found.append(jobs.run_on_main_thread(threading.current_thread)))
    thread.start()
    thread.join(NEVER)
    assert found == [thread]

    def fail():
        found.append(None)
        raise ValueError("no")

    def expect():
        with pytest.raises(ValueError, match="no"):
            jobs.run_on_main_thread(fail)

    thread = threading.Thread(target=expect)
    thread.start()
    thread.join(NEVER)
    assert found[1:] == [None]


@pytest.fixture
def store(tmp_path, monkeypatch):
    """An empty folder of baked light."""
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path))
    return preferences.store()


def test_bake(lit, store):
    assert not bpy.ops.holopath.show_texture.poll() and not bpy.ops.holopath.clear_baked.poll()
    assert bpy.ops.holopath.bake() == {"FINISHED"}
    assert session.current.bake["reused"] == "nothing" and store.size() == session.current.bake["bytes"] > 0
    assert session.TEXTURE not in bpy.data.images
    assert bpy.ops.holopath.show_texture() == {"FINISHED"}
    image = bpy.data.images[session.TEXTURE]
    assert max(image.pixels) > 0 and image.is_float

    lit.holopath.method = "fast"
    lit.holopath.focus = 2.0
    bpy.ops.holopath.render_hologram()
    assert session.current.bake["reused"] == "all"
    assert not bpy.ops.holopath.show_texture.poll()  # but the panel has another button in its place
    assert bpy.ops.holopath.bake(show=True) == {"FINISHED"}
    assert session.current.bake["reused"] == "all" and session.current.texture is not None
    assert bpy.ops.holopath.bake(anew=True) == {"FINISHED"}
    assert session.current.bake["reused"] == "nothing"

    assert bpy.ops.holopath.clear_baked() == {"FINISHED"}
    assert store.size() == 0 and session.current.bake is None
    assert bpy.data.images[session.TEXTURE] == image  # the user's own now


def test_a_bake_computes_with_what_the_main_thread_has_read(lit, store):
    """Also where the main thread began with Mitsuba after the job's own, as at a session's first press of Bake."""
    import drjit

    from holopath_addon.operators.modal_operator import export

    area = bpy.data.lights.new("Panel", "AREA")  # whose place is a transform that nobody has evaluated
    lit.collection.objects.link(bpy.data.objects.new("Panel", area))
    bpy.context.view_layer.update()

    def work(progress):
        return export(job, progress, lit.name).bake(progress)

    job = session.current.job = Job(work)
    job.start()
    while not job.wait(0.01):
        if job.message == "Reading the scene":
            drjit.detail.new_scope(drjit.JitBackend.LLVM)
        job.answer_query()
    assert job.error is None
    session.current.job = None


def test_a_bake_that_is_canceled(lit, store):
    task = session.prepare(bpy.context.evaluated_depsgraph_get(), lit.holopath)
    job = session.current.job = Job(task.bake)
    job.start()
    assert not bpy.ops.holopath.bake.poll() and not bpy.ops.holopath.plan.poll()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert job.wait(NEVER) and isinstance(job.error, engine.Cancelled)
    assert session.current.bake is None and store.size() == 0


def test_baking_fails_in_a_sentence(scene, monkeypatch):
    def fail(*_, **__):
        raise engine.InvalidInput("There is no room.")

    monkeypatch.setattr(rendering, "baked_picture", fail)
    with pytest.raises(RuntimeError, match="There is no room"):
        bpy.ops.holopath.bake()
    assert not session.running() and session.current.bake is None


def test_where_baked_light_is_kept(monkeypatch, tmp_path):
    from types import SimpleNamespace

    monkeypatch.setattr(preferences, "_chosen", lambda: SimpleNamespace(bake_folder=str(tmp_path / "named")))
    assert preferences.store().folder == tmp_path / "named"
    monkeypatch.setattr(preferences, "_chosen", lambda: None)
    monkeypatch.setenv("HOLOPATH_CACHE", str(tmp_path))
    assert preferences.store().folder == tmp_path


def test_a_scene_that_is_left_is_not_read(scene):
    """What is rendered is the scene whose button was pressed, or nothing."""
    from holopath_addon.operators.modal_operator import export

    job = Job(lambda progress: export(job, progress, "Another"))
    job.run()
    assert isinstance(job.error, engine.InvalidInput) and "'Another' was left or deleted" in str(job.error)


def test_canceled_render_keeps_the_last_one(scene, monkeypatch):
    bpy.ops.holopath.render_hologram()
    field, before = session.current.field, picture()

    def stop(*_, **__):
        raise engine.Cancelled

    monkeypatch.setattr(engine, "render", stop)
    assert bpy.ops.holopath.render_hologram() == {"CANCELLED"}
    assert session.current.field is field and session.current.error == ""
    session.images.show_rgb(np.ones((64, 64, 3), np.float32))  # as a window shows a preview of the next
    session.restore_picture()
    np.testing.assert_allclose(picture(), before, rtol=1e-5)


def test_a_failure_outlives_the_picture_that_comes_back(scene):
    """In a window the picture before is made in a thread, and is there after the failure was told."""
    bpy.ops.holopath.render_hologram()
    session.current.refocus_request = (2.0, None, None, engine.Optics())
    session.refocusing._start_refocus()
    session.record_error(engine.InvalidInput("No."))
    assert session.current.refocus_job.wait(NEVER)
    session.refocusing._poll_refocus()
    assert session.current.error == "No."
    scene.holopath.focus = 1.0
    assert session.current.error == ""


def test_encode_and_save(scene, tmp_path):
    assert not bpy.ops.holopath.encode.poll() and not bpy.ops.holopath.save_hologram.poll()
    scene.holopath.encoding = "sgd"
    bpy.ops.holopath.render_hologram()
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    phase = session.current.phase
    assert phase.data.shape == session.current.field.data.shape
    image = bpy.data.images[session.PHASE]
    shown = np.array(image.pixels[:]).reshape(64, 64, 4)[::-1, :, :3]
    np.testing.assert_allclose(shown, np.moveaxis(phase.data[0], 0, -1) / (2 * np.pi), atol=1e-6)
    scene.holopath.phase_frame = 3
    shown = np.array(image.pixels[:]).reshape(64, 64, 4)[::-1, :, :3]
    np.testing.assert_allclose(shown, np.moveaxis(phase.data[3], 0, -1) / (2 * np.pi), atol=1e-6)
    scene.holopath.phase_frame = 200  # there are four: the last is shown

    assert bpy.ops.holopath.save_hologram(directory=str(tmp_path)) == {"FINISHED"}
    np.testing.assert_array_equal(engine.PhaseHologram.load(tmp_path / "hologram").data, phase.data)
    with pytest.raises(RuntimeError, match="No folder"):
        bpy.ops.holopath.save_hologram()
    bpy.ops.holopath.render_hologram()
    assert session.current.phase is None  # of the field before


def test_encode_for_the_device_that_is_calibrated(scene, tmp_path):
    curve = ((0, 0.0), (1, 2.0), (2, 2.5), (3, 5.0))
    responses = tuple(slm.Response(nm * 1e-9, curve=curve) for nm in scene.holopath.wavelengths_nm)
    slm.Calibration(bits=2, responses=responses).save(tmp_path / "device.json")
    bpy.ops.holopath.render_hologram()
    scene.holopath.encoding = "sgd"
    scene.holopath.device.calibration = str(tmp_path / "device.json")
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    assert set(np.round(np.unique(session.current.phase.data), 4)) <= {0.0, 2.0, 2.5, 5.0}
    scene.holopath.device.calibration = str(tmp_path / "none.json")
    with pytest.raises(RuntimeError, match="none.json"):
        bpy.ops.holopath.encode()


def test_refocus_the_hologram(scene):
    """Once it is encoded, the picture is of the phases, as the display shows them, where that is chosen."""
    bpy.ops.holopath.render_hologram()
    of_the_field = picture()
    scene.holopath.refocused = "PHASE"  # nothing is encoded yet
    np.testing.assert_array_equal(picture(), of_the_field)
    scene.holopath.encoding = "sgd"
    bpy.ops.holopath.encode()
    props = session.current.phase
    assert props.method == "sgd"
    of_the_phases = picture()
    assert np.abs(of_the_phases - of_the_field).max() > 0.01 * of_the_field.max()
    scene.holopath.bits = 1
    coarse = picture()
    assert np.abs(coarse - of_the_phases).mean() > 0.01 * of_the_phases.mean()
    scene.holopath.crosstalk = 1.0
    assert np.abs(picture() - coarse).mean() > 0.01 * coarse.mean()
    scene.holopath.refocused = "FIELD"
    np.testing.assert_array_equal(picture(), of_the_field)
    bpy.ops.holopath.encode()  # bits in the loop
    levels = session.current.phase.data / np.pi
    np.testing.assert_allclose(levels, np.round(levels), atol=1e-5)


def test_encode_with_more_frames(scene):
    """Of the scene as it was rendered, whatever has become of it since."""
    scene.holopath.frames, scene.holopath.colours = 2, "MONO"
    bpy.ops.holopath.render_hologram()
    for thing in list(scene.objects):
        bpy.data.objects.remove(thing)
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    assert session.current.phase.method == "refine"


def test_stopping_an_encoding_keeps_it(scene, monkeypatch):
    bpy.ops.holopath.render_hologram()
    plain = pipeline.encode

    def encode(field, method, progress, *rest, **options):
        def stop(done, message):
            if "dB" in message:
                raise engine.Cancelled

        return plain(field, method, stop, *rest, **options)

    monkeypatch.setattr(pipeline, "encode", encode)
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    assert session.current.phase.report["stopped"]


def test_stopping_an_encoding_leaves_the_last_hologram(scene, monkeypatch):
    """A whole hologram of the same field is worth more than a part of another."""
    bpy.ops.holopath.render_hologram()
    scene.holopath.encoding = "dpac"
    bpy.ops.holopath.encode()
    before = session.current.phase
    scene.holopath.encoding = "auto"
    test = engine.encode

    def stopped(field, method, progress, **options):
        def stop(done, message):
            if "dB" in message:
                raise engine.Cancelled

        return test(field, method, stop, **options)

    monkeypatch.setattr(engine, "encode", stopped)
    assert bpy.ops.holopath.encode() == {"CANCELLED"}
    assert session.current.phase is before and not session.current.error


def test_seconds_of_encoding(scene):
    """The button makes what it can of them, and says how."""
    scene.holopath.frames = 2
    scene.holopath.colours = "MONO"
    bpy.ops.holopath.render_hologram()
    scene.holopath.limit_encoding, scene.holopath.encode_seconds = True, 1.5
    assert bpy.ops.holopath.encode() == {"FINISHED"}
    report = session.current.phase.report
    assert report["plan"]["seconds"] <= 1.5 and report["plan"]["method"] == session.current.phase.method
    assert sum(stage["seconds"] for stage in report["stages"]) < SOON


def test_without_a_backend(scene, monkeypatch):
    """The panel says what to install; once it is there, a press of Check Again finds it."""
    monkeypatch.setattr(engine.scene.variants, "_candidates", lambda: [])
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    with monkeypatch.context() as patch:
        patch.setattr(engine.scene.variants, "_cuda_device", lambda: (False, "no card"))
        bpy.ops.holopath.check()
        assert "install LLVM" in preferences.backend_problem()
    monkeypatch.undo()
    assert "install LLVM" in preferences.backend_problem()  # asked once, as panels are drawn often
    bpy.ops.holopath.check()
    assert preferences.backend_problem() == ""


def test_a_graphics_card_that_is_not_there(scene, monkeypatch):
    monkeypatch.setattr(engine.scene.variants, "_cuda_device", lambda: (False, "no card"))
    monkeypatch.setattr(preferences, "chosen_backend", lambda: engine.scene.variants.CUDA)
    preferences.forget_backends()
    told = preferences.backend_problem()
    preferences.forget_backends()
    assert "no card" in told and "choose Automatic" in told


def test_a_card_that_computes_no_waves(scene, monkeypatch):
    """Check Again says why; Get shows the extension that would change it."""
    monkeypatch.setattr(engine.scene.variants, "_cuda_device", lambda: (True, "NVIDIA Card"))
    told = ["it has no memory", engine.InvalidInput("HOLOPATH_ARRAYS is 'jax'."), ""]

    def chosen():
        said = told.pop(0)
        if isinstance(said, Exception):
            raise said
        return "numpy", said

    monkeypatch.setattr(libraries, "chosen", chosen)
    for said in ("it has no memory", "HOLOPATH_ARRAYS is 'jax'.", ""):
        bpy.ops.holopath.check()
        assert preferences._found["lacking"] == said
    monkeypatch.undo()
    bpy.ops.holopath.check()
    assert preferences.check_card() == ""
    bpy.ops.holopath.get_card_extension()
    assert bpy.context.window_manager.extension_search == "HoloPath for NVIDIA Cards"
    assert bpy.context.preferences.active_section == "EXTENSIONS"
    bpy.context.window_manager.extension_search = ""


def test_dioptres_in_view(scene):
    bpy.ops.holopath.render_hologram()
    near, far = session.current.diopter_range
    assert near == pytest.approx(2, rel=0.02) and far == pytest.approx(0.5, rel=0.02)
    assert session.plan_of(scene) is session.current.plan
    assert session.plan_of(bpy.data.scenes.new("Another")) is None


def test_a_picture_of_an_earlier_field_is_dropped(scene):
    bpy.ops.holopath.render_hologram()
    session.current.refocus_request = (2.0, None, None, engine.Optics())
    session.refocusing._start_refocus()
    assert session.current.refocus_job.wait(NEVER)
    scene.holopath.resolution_x = 48
    bpy.ops.holopath.render_hologram()
    before = picture()
    session.refocusing._poll_refocus()
    assert not session.is_refocusing() and tuple(bpy.data.images[session.IMAGE].size) == (48, 64)
    np.testing.assert_array_equal(picture(), before)


def test_phases_of_an_earlier_field_are_dropped(scene, monkeypatch):
    bpy.ops.holopath.render_hologram()

    def encode(field, *_, **__):
        session.current.refocuser = engine.Refocuser(field.__class__(**vars(field)))  # F12, meanwhile
        return None

    monkeypatch.setattr(pipeline, "encode", encode)
    with pytest.raises(RuntimeError, match="press Encode again"):
        bpy.ops.holopath.encode()
    assert session.current.phase is None


def test_a_saved_picture_is_the_users(scene, tmp_path):
    bpy.ops.holopath.render_hologram()
    image = bpy.data.images[session.IMAGE]
    image.filepath_raw, image.file_format = str(tmp_path / "kept.png"), "PNG"
    image.save()
    saved = (tmp_path / "kept.png").read_bytes()
    scene.holopath.focus = 2.0
    assert bpy.data.images[session.IMAGE] != image
    assert (tmp_path / "kept.png").read_bytes() == saved
