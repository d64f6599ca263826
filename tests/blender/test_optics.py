"""The bench in the window: the panel shows what counts, and all that is computed is for the bench that it says."""

import math
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from holopath_addon import engine, exchange, slm
from holopath_addon.blender import properties
from holopath_addon.cli.sources import BlenderSource
from holopath_addon.engine.mapping import DepthMapping
from holopath_addon.engine.optics import BEAMS, STOPS
from holopath_addon.operators import devices, session
from holopath_addon.slm.calibration import colors_of
from holopath_addon.ui import bench_overlay, panels
from tests.ui.layout import Context, Layout

# Settings, and the words of the command line for the same.
SAME = [
    ({}, "flat", None, "circle"),
    ({"beam": "tilt", "tilt_deg": (1.0, -0.5)}, "tilt:1,-0.5", None, "circle"),
    ({"beam": "point", "point_mm": -120.0}, "point:-120", None, "circle"),
    ({"beam": "gaussian", "waist_mm": 1.5}, "gaussian:1.5,0,0", None, "circle"),
    ({"beam": "gaussian", "middle_mm": (0.2, -0.1)}, "gaussian:2,0.2,-0.1", None, "circle"),
    ({"carrier": "auto"}, "flat", "auto", "circle"),
    ({"use_radius": True, "radius": 0.25, "carrier": "auto"}, "flat", "auto", "circle:0.25"),
    ({"carrier": "given", "carrier_at": (0.1, -0.6)}, "flat", "0.1,-0.6", "circle"),
    ({"stop": "half"}, "flat", None, "half"),
    ({"stop": "half", "half_deg": 90.0}, "flat", None, "half:90"),
    ({"stop": "rectangle", "rectangle": (0.4, 1.2)}, "flat", None, "rectangle:0.4,1.2"),
]


def drawn(scene):
    """Names of the properties that the section shows, and its words."""
    context = Context(scene)
    layout = Layout(context)
    panels.optics(layout, context)
    return layout.all("prop", "property"), layout.words


def set_all(scene, settings):
    for name, value in settings.items():
        setattr(scene.holopath.optics, name, value)


@pytest.mark.parametrize(("settings", "beam", "carrier", "stop"), SAME)
def test_settings_mean_what_words_mean(scene, settings, beam, carrier, stop):
    scene.holopath.resolution_x = scene.holopath.resolution_y = 256
    set_all(scene, settings)
    carrier = carrier and exchange.parse_carrier(carrier)
    expected = engine.Optics(exchange.parse_beam(beam), carrier, exchange.parse_stop(stop))
    assert properties.hologram_of(scene.holopath).optics == expected
    assert BlenderSource().hologram_from().optics == expected  # of the .blend on the command line


def test_lens_and_colors_mean_what_words_mean(scene):
    props = scene.holopath
    set_all(scene, {"use_lens": True, "focal_mm": 100.0})
    assert properties.hologram_of(props).optics.lens == exchange.parse_lens("100")
    set_all(scene, {"use_lens_distance": True, "lens_distance_mm": 50.0})
    set_all(scene, {"use_picture_distance": True, "picture_mm": 150.0})
    assert properties.hologram_of(props).optics.lens == exchange.parse_lens("100@50@150")
    set_all(scene, {"use_share": True, "share": 0.85})
    assert properties.hologram_of(props).optics.lens == exchange.parse_lens("100@50@150@0.85")
    set_all(scene, {"focal_mm": -100.0})
    assert properties.hologram_of(props).optics.lens == exchange.parse_lens("-100@50@150@0.85")
    set_all(scene, {"focal_mm": 100.0})
    props.depth_mapping, props.depth_auto = "eyepiece", True  # in which no picture stands behind it
    assert not {"use_picture_distance", "use_share"} & set(drawn(scene)[0])
    assert properties.optics_of(props).lens == exchange.parse_lens("100@50")
    set_all(scene, {"use_lens": False, "colors_apart": True, "color_scale": (1.02, 1.0, 0.98)})
    set_all(scene, {"color_distance_mm": (0.3, 0.0, -0.1), "color_right_mm": (0.0, 0.0, 0.02)})
    words = {"color_scale": "1.02,1,0.98", "color_distance": "0.3,0,-0.1", "color_shift": "0,0,0,0,0.02,0"}
    colors = {name: exchange.optics.parse_colors(name, text) for name, text in words.items()}
    assert properties.optics_of(props) == engine.Optics(**colors)
    props.colours = "MONO"
    assert len(properties.optics_of(props).color_scale) == 1


def test_colors_of_a_calibration(scene, tmp_path):
    """The button fills in what the command line takes from the same file; a file without colors is refused."""
    props, focus = scene.holopath, {1e-3: (1, 0, 0, 0, 1, 0, 0, 0)}
    props.resolution_x = props.resolution_y = 256
    wavelengths = properties.hologram_of(props).wavelengths
    models = tuple(
        engine.DisplayModel(w, aberrations=(0.3 * n, *7 * (0.0,))) for n, w in enumerate(wavelengths)
    )
    sensors = (slm.Sensor((8, 8), homographies={1e-3: (0.98, 0, 0.01, 0, 0.98, 0, 0, 0)}),)
    sensors += 2 * (slm.Sensor((8, 8), homographies=focus),)
    slm.Calibration(models=models, sensors=sensors).save(tmp_path / "slm.json")
    props.optics.colors_apart = True
    context = Context(scene)
    layout = Layout(context)
    panels.optics(layout, context)
    assert "holopath.colors_from" in layout.all("operator", "operator")
    assert bpy.ops.holopath.colors_from(filepath=str(tmp_path / "slm.json")) == {"FINISHED"}
    found, given = (
        properties.optics_of(props),
        colors_of(tmp_path / "slm.json", properties.hologram_of(props)),
    )
    for name, values in given.items():
        np.testing.assert_allclose(getattr(found, name), values, rtol=1e-5, atol=1e-8)
    assert found.color_scale[0] == pytest.approx(1 / 0.98, rel=1e-5) and found.color_distance[2] > 0
    with pytest.raises(RuntimeError, match="cannot be read"):
        bpy.ops.holopath.colors_from(filepath=str(tmp_path / "no.json"))


def test_a_field_of_another_lens(scene):
    """It has to be rendered for it: the panel says so, and so do the picture and Encode."""
    props = scene.holopath
    props.frames, props.colours, props.method, props.encoding = 1, "MONO", "fast", "dpac"
    bpy.ops.holopath.render_hologram()
    kept = shown()
    props.depth_auto, props.optics.use_lens = True, True
    assert "Wave Field Is for Another Lens: Render Again" in drawn(scene)[1]
    assert "rendered for another lens" in session.current.error and (shown() == kept).all()
    with pytest.raises(RuntimeError, match="rendered for another lens"):
        bpy.ops.holopath.encode()


def test_each_kind_has_a_setting(scene):
    kinds = scene.holopath.optics.bl_rna.properties
    assert set(kinds["beam"].enum_items.keys()) == set(BEAMS)
    assert set(kinds["stop"].enum_items.keys()) == set(STOPS)


@pytest.mark.parametrize(
    ("settings", "shown"),
    [
        ({}, []),
        ({"beam": "tilt"}, ["tilt_deg", "tilt_deg"]),
        ({"beam": "point"}, ["point_mm"]),
        ({"beam": "gaussian"}, ["waist_mm", "middle_mm", "middle_mm"]),
        ({"beam": "measured"}, ["beam_holds", "beam_file", "beam_phase"]),
        ({"beam": "measured", "beam_holds": "field"}, ["beam_holds", "beam_file"]),
        ({"carrier": "given"}, ["carrier_at", "carrier_at"]),
        ({"stop": "half"}, ["half_deg"]),
        ({"stop": "rectangle"}, ["rectangle", "rectangle"]),
        ({"stop": "measured"}, ["stop_file"]),
        ({"use_radius": True}, ["radius"]),
        ({"use_lens": True}, ["focal_mm", "use_lens_distance", "use_picture_distance", "use_share"]),
        (
            {"use_lens": True, "use_share": True},
            ["focal_mm", "use_lens_distance", "use_picture_distance", "use_share", "share"],
        ),
        (
            {"use_lens": True, "use_lens_distance": True},
            ["focal_mm", "use_lens_distance", "lens_distance_mm", "use_picture_distance", "use_share"],
        ),
        (
            {"colors_apart": True},
            [*3 * ["color_scale"], *3 * ["color_distance_mm"], *3 * ["color_right_mm"], *3 * ["color_up_mm"]],
        ),
    ],
)
def test_a_kind_shows_its_own_numbers_alone(scene, settings, shown):
    set_all(scene, settings)
    kinds = ("beam", "carrier", "stop", "use_radius", "use_lens", "colors_apart", "show_bench")
    assert [name for name in drawn(scene)[0] if name not in kinds] == shown


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"beam": "measured"}, "A file of the measured beam is missing: choose one"),
        ({"beam": "measured", "beam_file": "//no.npy"}, "does not exist"),
        ({"beam": "tilt", "tilt_deg": (45.0, 0.0)}, "meets the panel at 45 degrees"),
        ({"beam": "point", "point_mm": 0.0}, "one distance, which is not 0"),
        ({"beam": "gaussian", "middle_mm": (80.0, 0.0)}, "Move its center onto the panel"),
        ({"carrier": "given", "carrier_at": (1.0, 0.0)}, "Expected a carrier within the band"),
        ({"carrier": "given", "use_radius": True, "radius": 0.9}, "Choose a smaller stop"),
        ({"stop": "measured"}, "A file of the measured stop is missing"),
        ({"use_lens": True, "focal_mm": 0.0}, "finite and not 0"),
        ({"use_lens": True, "focal_mm": -100.0}, "diverges, and its focal plane is before it"),
    ],
)
def test_what_cannot_be_is_said_in_the_panel(scene, settings, says):
    set_all(scene, settings)
    assert says in drawn(scene)[1]
    with pytest.raises(engine.InvalidInput, match=says):
        properties.hologram_of(scene.holopath)


def test_measured_files(scene, tmp_path):
    """A beam of amplitudes and phases, and a stop; another array in a file is read anew."""
    rng = np.random.default_rng(0)
    size, phase = rng.uniform(0.5, 1, (64, 64)), rng.uniform(-3, 3, (64, 64))
    opened = np.zeros((64, 64), np.uint8)
    opened[:, 40:] = 255
    for name, array in {"size": size, "phase": phase, "stop": opened}.items():
        np.save(tmp_path / f"{name}.npy", array)
    props = scene.holopath.optics
    props.beam = props.stop = "measured"
    props.carrier = "auto"
    for name, file in {"beam_file": "size", "beam_phase": "phase", "stop_file": "stop"}.items():
        setattr(props, name, str(tmp_path / f"{file}.npy"))
    scene.holopath.colours = "MONO"
    optics = properties.hologram_of(scene.holopath).optics
    np.testing.assert_allclose(optics.beam.measured, size / size.max() * np.exp(1j * phase), atol=1e-6)
    assert (optics.stop.measured == (opened > 0)).all()
    props.beam_holds = "intensity"
    beam = properties.hologram_of(scene.holopath).optics.beam.measured
    np.testing.assert_allclose(abs(beam), np.sqrt(size / size.max()), atol=1e-6)
    np.save(tmp_path / "size.npy", np.ones((64, 64)))
    assert np.allclose(abs(properties.hologram_of(scene.holopath).optics.beam.measured), 1)
    np.save(tmp_path / "size.npy", np.ones((64, 60)))
    assert "60" in drawn(scene)[1]


def test_files_of_the_bench_belong_to_the_scene(scene, tmp_path):
    """Machines that share a render compare them."""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    scene = bpy.context.scene
    props = scene.holopath.optics
    props.beam, props.beam_file, props.stop_file = "measured", "//beam.npy", "//unused.npy"
    assert BlenderSource().files["beam.npy"] == tmp_path / "beam.npy"
    assert "unused.npy" not in BlenderSource().files


def shown():
    """Rows of the reconstruction's first channel."""
    image = bpy.data.images[session.IMAGE]
    width, height = image.size
    return np.array(image.pixels).reshape(height, width, 4)[::-1, :, 0]


def on(thing, optics):
    return replace(thing, hologram=replace(thing.hologram, optics=optics))


def test_all_that_is_computed_is_for_the_bench(scene):
    """Render, Encode and the reconstruction, each beside what the engine says of that bench."""
    props = scene.holopath
    props.frames, props.colours, props.method, props.encoding = 1, "MONO", "fast", "dpac"
    props.focus, props.optics.stop = 1.0, "half"
    half, circle = engine.Optics(stop=engine.Stop("half")), engine.Optics(carrier="auto")
    bpy.ops.holopath.render_hologram()
    field = session.current.field
    assert session.current.plan.z_low < session.current.plan.z_high and field.hologram.optics == half
    close = partial(np.testing.assert_allclose, rtol=1e-3, atol=1e-5)
    before = shown()
    close(before, engine.reconstruct(field, [1.0])[0, ..., 0])
    props.optics.stop, props.optics.carrier = "circle", "auto"  # refocused at once
    assert abs(shown() - before).max() > 0.01 * before.max()
    close(shown(), engine.reconstruct(on(field, circle), [1.0])[0, ..., 0])
    bpy.ops.holopath.encode()
    assert session.current.phase.hologram.optics == circle
    assert "Another Bench" not in drawn(scene)[1]
    props.refocused = "PHASE"
    close(shown(), engine.reconstruct(session.current.phase.field(engine.Modulator(8)), [1.0])[0, ..., 0])
    props.optics.beam, props.optics.tilt_deg = "tilt", (0.3, 0.0)
    assert "Another Bench: Encode Again" in drawn(scene)[1]
    tilted = replace(circle, beam=engine.Beam("tilt", (math.radians(0.3), 0.0)))
    light = on(session.current.phase, tilted).field(engine.Modulator(8))
    close(shown(), engine.reconstruct(light, [1.0])[0, ..., 0])
    kept = shown()
    props.optics.tilt_deg = (60.0, 0.0)  # no such bench: it is said, and the picture stays
    assert "60 degrees" in session.current.error and (shown() == kept).all()
    with pytest.raises(RuntimeError, match="60 degrees"):
        bpy.ops.holopath.render_hologram()
    props.optics.tilt_deg = (0.3, 0.0)
    assert not session.current.error


def test_a_failure_before_the_first_render_does_not_stay(scene):
    scene.holopath.optics.beam = "measured"
    scene.holopath.optics.beam = "flat"
    assert not session.current.error


def test_the_sketch_in_the_viewport(scene, monkeypatch):
    """The sketch's conditions and pieces; the drawing itself needs a window."""
    space = SimpleNamespace(overlay=SimpleNamespace(show_overlays=True), show_region_ui=True)
    tab = SimpleNamespace(type="UI", active_panel_category="HoloPath")
    context = SimpleNamespace(scene=scene, space_data=space, area=SimpleNamespace(regions=[tab]))
    assert bench_overlay.visible_hologram(context) is None
    scene.holopath.show_bench, scene.holopath.optics.carrier = True, "auto"
    hologram = properties.hologram_of(scene.holopath)
    assert bench_overlay.visible_hologram(context) == hologram
    for thing, name, value in (
        (tab, "active_panel_category", "View"),
        (space.overlay, "show_overlays", False),
    ):
        with monkeypatch.context() as changed:
            changed.setattr(thing, name, value)
            assert bench_overlay.visible_hologram(context) is None
    scene.holopath.optics.beam = "measured"
    assert bench_overlay.visible_hologram(context) is None

    drawing = bench_overlay.sketch(hologram, 720.0, 1.0)
    areas, lines = bench_overlay.pieces(drawing, 1.0)

    def size(points):
        (a, b, c) = points.reshape(-1, 3, 2).transpose(1, 0, 2)
        return abs(np.linalg.det(np.stack([b - a, c - a], 1))).sum() / 2

    volume = next(line.points for line in drawing.lines if line.role == "volume" and line.opacity)
    assert size(areas["volume", 0.3]) == pytest.approx(np.prod(np.ptp(volume, axis=0)))
    dashes = lines["stop", 1.5].reshape(-1, 2, 2)
    assert len(dashes) > 4 and np.hypot(*np.diff(dashes, axis=1)[:, 0].T).max() <= 5 + 1e-6


def test_undo(scene):
    bpy.ops.ed.undo_push(message="before")
    scene.holopath.optics.beam = "gaussian"
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    assert bpy.context.scene.holopath.optics.beam == "flat"
    bpy.ops.ed.redo()
    assert bpy.context.scene.holopath.optics.beam == "gaussian"


def test_the_virtual_bench_is_that_bench(scene):
    """The camera sees the streamed phases in the light of their beam, through their stop."""
    props = scene.holopath
    props.frames, props.colours, props.method, props.encoding = 1, "MONO", "fast", "dpac"
    props.optics.carrier, props.optics.beam, props.optics.waist_mm = "auto", "gaussian", 0.4
    props.device.driver = "virtual"
    bpy.ops.holopath.render_hologram()
    bpy.ops.holopath.encode()
    bpy.ops.holopath.stream()
    bench, phase = devices.current.driver, session.current.phase
    bench.focus_at(1e-3)
    depth = float(DepthMapping.of(phase.hologram, phase.camera, phase.near).z_to_depth(1e-3))
    expected = engine.reconstruct(phase.field(engine.Modulator(8)), [depth])[0]
    np.testing.assert_allclose(bench.capture(), expected, rtol=1e-3, atol=1e-3 * expected.max())
