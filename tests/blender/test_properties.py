"""Conversion of a scene's settings to the engine's objects."""

import math
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest

from holopath_addon import engine
from holopath_addon.blender import properties


@pytest.fixture
def settings(addon):
    """Settings of a new file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene.holopath


def test_defaults(settings):
    hologram = properties.hologram_of(settings)
    assert hologram == engine.Hologram(512, 512, 8e-6)
    assert properties.settings_of(settings) == engine.Settings()
    assert properties.focus_of(settings) == 1.0 and properties.pupil_or_none(settings) is None


@pytest.mark.parametrize("name", engine.DISPLAYS)
def test_displays(settings, name):
    settings.display = name
    display, hologram = engine.DISPLAYS[name], properties.hologram_of(settings)
    assert (hologram.width, hologram.height) == (display.width, display.height)
    assert hologram.pitch == pytest.approx(display.pitch, rel=1e-5)
    assert (hologram.depth_far, hologram.depth_near) == (80e-3, 85e-3)
    assert settings.bits == display.bits


def test_pixels_that_are_not_square(settings):
    settings.pitch_um, settings.pitch_y_um = 6.4, 8.0
    assert properties.hologram_of(settings).pitch == 6.4e-6
    settings.square_pixels = False
    assert properties.hologram_of(settings).pitch == (6.4e-6, 8e-6)
    settings.display = "pluto-2"  # of which all are square
    assert settings.square_pixels and properties.hologram_of(settings).pitch == 8e-6


def test_all_settings(settings):
    settings.colors, settings.wavelength_nm = "MONO", 532.0
    settings.depth_mapping = "eyepiece"
    settings.near_auto, settings.near = False, 0.3
    settings.wrp_auto, settings.wrp_mm = False, 11.5
    settings.limit_rays, settings.spp = True, 99
    settings.estimator, settings.radiance, settings.quality = "paper", "ray", "high"
    settings.frames, settings.seed, settings.max_depth = 3, 7, 2
    settings.virtual_image, settings.max_specular_depth = "opl", 3
    settings.planes_auto, settings.planes, settings.paths = False, 4, 5
    settings.phase_field, settings.despeckle, settings.method = "random", 40, "fast"
    hologram = properties.hologram_of(settings, (20, 10))
    assert hologram == engine.Hologram(20, 10, 8e-6, (532e-9,), depth_mapping="eyepiece", near=0.3)
    assert properties.settings_of(settings) == engine.Settings(
        frames=3,
        method="fast",
        estimator="paper",
        radiance="ray",
        quality="high",
        spp=99,
        wrp=11.5e-3,
        max_depth=2,
        virtual_image="opl",
        max_specular_depth=3,
        planes=4,
        paths=5,
        phase_field="random",
        despeckle=40,
        seed=7,
    )


def test_randomness_is_of_phases_that_may_be_smooth(settings):
    """Settings of other kinds are kept, and have no effect."""
    settings.set_randomness, settings.randomness = True, 0.25
    for kind, randomness in (("auto", 0.25), ("smooth", 0.25), ("designed", None), ("random", None)):
        settings.phase_field = kind
        assert properties.settings_of(settings).randomness == randomness


def test_depth_range(settings):
    """Near the SLM until somebody sets it, by hand, by script or by a display."""
    settings.resolution_x = 256
    assert properties.hologram_of(settings) == engine.Hologram(256, 512, 8e-6)
    settings.depth_auto = False  # begins with what it was
    assert (settings.depth_far_mm, settings.depth_near_mm) == pytest.approx((-2.0, 0.5))
    settings.depth_auto = True
    settings.depth_near_mm = 7.0
    assert not settings.depth_auto and properties.hologram_of(settings).depth_near == 7e-3
    settings.depth_auto = True
    settings.display = "pluto-2"
    assert not settings.depth_auto and properties.hologram_of(settings).depth_far == 80e-3


@pytest.mark.parametrize("old", [False, True])
def test_files_of_versions_before_depth_ranges_were_automatic(old, settings, tmp_path, monkeypatch):
    """Earlier files do not store their default of 10 to 15 mm; files of this version store that it is automatic."""
    settings.frames = 3
    if old:
        monkeypatch.setattr(properties, "_anything_set", lambda props: False)
    file = str(tmp_path / "a.blend")
    bpy.ops.wm.save_as_mainfile(filepath=file)
    monkeypatch.undo()
    bpy.ops.wm.open_mainfile(filepath=file)
    settings = bpy.context.scene.holopath
    hologram = properties.hologram_of(settings)
    assert hologram == engine.Hologram(
        512, 512, 8e-6, **({"depth_far": 10e-3, "depth_near": 15e-3} if old else {})
    )
    assert settings.depth_auto is not old and settings.frames == 3


def test_materials_hold_an_abbe_number(addon):
    material = bpy.data.materials.new("glass")
    assert material.holopath.abbe_number == 0
    material.holopath.abbe_number = 59.0
    assert material.copy().holopath.abbe_number == 59.0


def test_focus(settings):
    assert settings.focus_auto
    settings.focus_diopters = 4.0
    assert settings.focus == pytest.approx(0.25) and not settings.focus_auto
    settings.focus_infinity = True
    assert properties.focus_of(settings) == math.inf and settings.focus_diopters == 0
    settings.focus_infinity = False
    assert properties.focus_of(settings) == 1.0
    settings.focus_diopters = 0.0
    assert settings.focus_infinity
    properties.set_focus(settings, 2.0)
    assert settings.focus_diopters == pytest.approx(0.5)


def test_pupil(settings):
    settings.use_pupil = True
    settings.pupil_offset_mm, settings.pupil_diameter_mm = (1.5, -2.0), 3.0
    assert properties.pupil_or_none(settings) == engine.Pupil(1.5e-3, -2e-3, 3e-3)


def test_every_setting_says_what_it_is(settings):
    item = properties.HoloPathFocus.bl_rna.properties
    groups = settings, settings.device, settings.optics
    for prop in (*(prop for group in groups for prop in group.bl_rna.properties), *item):
        if prop.identifier in ("rna_type", "name", "device", "optics"):
            continue
        assert prop.description, prop.identifier
        assert not prop.description.endswith("."), prop.identifier
        unit = prop.name.partition("(")[2].rstrip(")")
        word = {
            "µs": "microsecond",
            "µm": "micrometer",
            "mm": "millimeter",
            "nm": "nanometer",
            "m": "meter",
            "D": "diopter",
            "px": "pixels",
            "°": "degrees",
            "": "",
        }
        assert word[unit] in prop.description, prop.identifier


# What .blend files hold: none of these may ever change; new ones come at the end.
NUMBERS = {
    "display": "CUSTOM pluto-2 leto-3 gaea-2 meadowlark-1920 santec-slm-210 ti-plm-067",
    "colors": "RGB MONO",
    "depth_mapping": "fit eyepiece",
    "phase_field": "designed random auto smooth",
    "quality": "preview balanced high draft",
    "method": "auto full fast direct point polygon rgbd rgbd-sgd focal-stack light-field stereogram gaussian network",
    "estimator": "lattice paper",
    "radiance": "grain ray",
    "virtual_image": "curvature opl",
    "encoding": "dpac auto sgd joint refine",
    "refocused": "FIELD PHASE",
}
DEVICE_NUMBERS = {
    "driver": "display serial slmsuite files virtual",
    "model": "holoeye meadowlark santec hamamatsu ti-plm mirrored remote simulated",
    "packing": "time color bits plm-067 plm-047 slm-200 slm-200-120hz layout",
    "order": "RGB GRB BRG RBG GBR BGR",
}
OPTICS_NUMBERS = {
    "beam": "flat tilt point gaussian measured",
    "beam_holds": "amplitude intensity field",
    "carrier": "stop auto given",
    "stop": "circle half rectangle measured",
}


@pytest.mark.parametrize(
    ("inner", "numbers"), [("", NUMBERS), ("device", DEVICE_NUMBERS), ("optics", OPTICS_NUMBERS)]
)
def test_numbers_in_files_stay(settings, inner, numbers):
    group = getattr(settings, inner) if inner else settings
    enums = {p.identifier: p for p in group.bl_rna.properties if p.type == "ENUM"}
    for name, words in numbers.items():
        held = {item.identifier: item.value for item in enums.pop(name).enum_items}
        assert held == {word: number for number, word in enumerate(words.split())}, name
    assert not enums, "a new enum: pin its numbers here"


INNER = ("device", "optics")
GROUPS = ("rna_type", "name", "focus_list", *INNER)


def other(settings, prop):
    """A value that is not the property's default."""
    if prop.type == "ENUM":
        names = [item.identifier for item in prop.enum_items]
        return next((name for name in names if name != prop.default), prop.default)
    if prop.type == "BOOLEAN":
        return not prop.default
    value = getattr(settings, prop.identifier)
    if prop.type == "STRING":
        return value + "x"
    if prop.is_array:
        return tuple(v * 1.5 + 1 for v in value)
    return type(value)(value * 1.5 + 1 if value < prop.hard_max else value / 2)


def held(settings):
    """Every setting's value."""
    names = [p.identifier for p in settings.bl_rna.properties if p.identifier not in GROUPS]
    values = {name: getattr(settings, name) for name in names}
    for group in INNER:
        inner = getattr(settings, group)
        values |= {
            f"{group}.{n}": getattr(inner, n) for n in inner.bl_rna.properties.keys() if n not in GROUPS
        }
    values["focus_list"] = [item.focus for item in settings.focus_list]
    return {name: tuple(v) if hasattr(v, "foreach_get") else v for name, v in values.items()}


def test_settings_survive_a_file(settings, tmp_path):
    before = held(settings)
    for prop in settings.bl_rna.properties:
        if prop.identifier not in (*GROUPS, "focus_infinity", "focus_diopters"):
            setattr(settings, prop.identifier, other(settings, prop))
    for inner in (settings.device, settings.optics):
        for prop in inner.bl_rna.properties:
            if prop.identifier not in GROUPS:
                setattr(inner, prop.identifier, other(inner, prop))
    for meters in (0.5, properties.MAX_FOCUS):
        settings.focus_list.add().focus = meters
    values = held(settings)
    same = {name for name in values if values[name] == before[name]}
    assert same <= {"focus_infinity"}, "not tried"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "settings.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert held(bpy.context.scene.holopath) == before
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "settings.blend"))
    assert held(bpy.context.scene.holopath) == values


def raw(scene):
    """The settings as the file holds them, by name."""
    group = scene.bl_system_properties_get() if hasattr(scene, "bl_system_properties_get") else scene
    return group["holopath"]


def test_files_of_other_versions(settings, tmp_path):
    """Choices that this version does not know are at their defaults, and so is what a file lacks."""
    enums = [p.identifier for p in settings.bl_rna.properties if p.type == "ENUM"]
    for name in enums:
        setattr(settings, name, other(settings, settings.bl_rna.properties[name]))
        raw(bpy.context.scene)[name] = 99
    settings.resolution_x, settings.resolution_y = 100, 50
    settings.frames, settings.bits = 3, 10
    del raw(bpy.context.scene)["bits"]
    raw(bpy.context.scene)["of_a_later_version"] = 1.0
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other.blend"))
    settings = bpy.context.scene.holopath
    assert settings.frames == 3 and settings.bits == 8
    for name in enums:
        assert getattr(settings, name) == settings.bl_rna.properties[name].default
    assert properties.settings_of(settings) == engine.Settings(frames=3)
    hologram = properties.hologram_of(settings)
    assert (hologram.width, hologram.height, hologram.depth_mapping) == (100, 50, "fit")


def test_focus_list(settings):
    assert properties.focus_list_of(settings) == [1.0]
    for meters in (2.0, math.inf, 0.5, 2.0):
        properties.set_focus(settings.focus_list.add(), meters)
    assert properties.focus_list_of(settings) == [2.0, math.inf, 0.5]
    item = settings.focus_list[0]
    item.focus_diopters = 4.0
    assert item.focus == pytest.approx(0.25) and not item.focus_infinity
    item.focus_infinity = True
    assert properties.focus_list_of(settings) == [math.inf, 0.5, 2.0]
    settings.focus_index = 2  # clicked
    assert settings.focus == 0.5 and not settings.focus_auto


# Set in Blender 4.3 by version 0.1.0, none as it is by default; data/settings-0.1.0.blend is the file.
OLD = {
    "focus_infinity": False,
    "focus_diopters": 0.4,
    "display": "pluto-2",
    "resolution_x": 1921,
    "resolution_y": 1081,
    "pitch_um": 10.0,
    "bits": 9,
    "colors": "MONO",
    "wavelength_nm": 645.625,
    "depth_mapping": "eyepiece",
    "depth_far_mm": 100.0,
    "depth_near_mm": 106.25,
    "near_auto": False,
    "near": 0.625,
    "frames": 9,
    "wish_speckle": True,
    "speckle": 0.1875,
    "phase_field": "random",
    "despeckle": 1,
    "quality": "high",
    "method": "full",
    "limit_rays": True,
    "spp": 257,
    "estimator": "paper",
    "radiance": "ray",
    "paths": 2,
    "planes_auto": False,
    "planes": 5,
    "max_specular_depth": 9,
    "virtual_image": "opl",
    "wrp_auto": False,
    "wrp_mm": 15.625,
    "max_depth": 9,
    "seed": 1,
    "keep_fields": True,
    "animation_folder": "//holopath",
    "focus_auto": False,
    "focus": 2.5,
    "focus_index": 1,
    "show_overlay": False,
    "use_pupil": True,
    "pupil_diameter_mm": 5.0,
    "encoding": "sgd",
    "refocused": "PHASE",
    "fill_factor": 1.0,
    "unmodulated": 0.5,
    "crosstalk": 0.5,
    "phase_frame": 1,
}


def test_a_file_of_version_0_1_0_keeps_its_settings(addon):
    file = Path(__file__).with_name("data") / "settings-0.1.0.blend"
    with bpy.data.libraries.load(str(file)) as (source, target):
        target.scenes = source.scenes
    (scene,) = target.scenes
    try:
        values = {name: getattr(scene.holopath, name) for name in OLD}
        assert properties.hologram_of(scene.holopath).depth_far == 100e-3
        assert properties.hologram_of(scene.holopath).optics == engine.Optics()
        assert {name: round(v, 5) if isinstance(v, float) else v for name, v in values.items()} == OLD
    finally:
        bpy.data.scenes.remove(scene)


def test_pixels_of_earlier_versions_keep_their_shape(addon):
    """There a fill factor below 1 had it, and 1 had none."""
    props = bpy.context.scene.holopath
    for fill_factor, shaped in ((0.9, True), (1.0, False)):
        props.property_unset("pixel_shape")
        props.fill_factor = fill_factor
        properties._settle()
        assert props.pixel_shape is shaped
        assert (properties.modulator_of(props).fill_factor is not None) is shaped
    props.property_unset("fill_factor")


def test_what_is_appended_leaves_the_file_s_own_scenes(settings):
    """One in which something is set, and which was not saved yet, is none of an earlier version."""
    settings.frames = 3
    assert not settings.is_property_set("depth_auto")
    cube = bpy.data.meshes.new("Appended")
    properties._settle_imported(SimpleNamespace(import_items=[SimpleNamespace(id=cube)]))
    assert properties.depth_is_auto(settings)
    properties._settle()
    assert not properties.depth_is_auto(settings)


def test_a_file_that_is_recovered_after_a_render_keeps_its_range(settings):
    """Auto-saves are not stamped as files are, but a render has written its focus."""
    settings.frames = 3
    properties.note_focus(settings, 0.7)
    properties._settle()
    assert properties.depth_is_auto(settings)


@pytest.mark.parametrize("mapping", ["fit", "eyepiece"])
def test_a_range_set_by_hand_begins_with_that_of_the_lens(settings, mapping):
    settings.depth_mapping, settings.optics.use_lens = mapping, True
    before = properties.hologram_of(settings)
    settings.depth_auto = False
    after = properties.hologram_of(settings)
    assert (after.depth_far, after.depth_near) == pytest.approx(
        (before.depth_far, before.depth_near), abs=1e-8
    )
    settings.display = "leto-3"  # which lies 80 mm before its picture, without a lens
    assert properties.depth_is_auto(settings) and properties.hologram_of(settings).width == 1920
