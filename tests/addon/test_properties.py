"""What the scene's settings mean to the engine."""

import math

import bpy
import pytest

from holopath_addon import engine, properties


@pytest.fixture
def settings(addon):
    """Settings of a new file."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene.holopath


def test_defaults(settings):
    hologram = properties.hologram_of(settings)
    assert hologram == engine.Hologram(512, 512, 8e-6, depth_far=10e-3, depth_near=15e-3)
    assert properties.settings_of(settings) == engine.Settings()
    assert properties.focus_of(settings) == 1.0 and properties.pupil_or_none(settings) is None


@pytest.mark.parametrize("name", engine.DISPLAYS)
def test_displays(settings, name):
    settings.display = name
    display, hologram = engine.DISPLAYS[name], properties.hologram_of(settings)
    assert (hologram.width, hologram.height) == (display.width, display.height)
    assert hologram.pitch == pytest.approx(display.pitch, rel=1e-5)
    assert (hologram.depth_far, hologram.depth_near) == (80e-3, 85e-3)


def test_all_settings(settings):
    settings.colours, settings.wavelength_nm = "MONO", 532.0
    settings.depth_mapping = "eyepiece"
    settings.near_auto, settings.near = False, 0.3
    settings.wrp_auto, settings.wrp_mm = False, 11.5
    settings.limit_rays, settings.spp = True, 99
    settings.estimator, settings.radiance, settings.quality = "paper", "ray", "full"
    settings.frames, settings.seed, settings.max_depth = 3, 7, 2
    settings.virtual_image, settings.most_hits = "opl", 3
    settings.planes, settings.paths = 4, 5
    settings.phase_field, settings.despeckle, settings.method = "random", 40, "fast"
    hologram = properties.hologram_of(settings, (20, 10))
    assert hologram == engine.Hologram(
        20, 10, 8e-6, (532e-9,), depth_far=10e-3, depth_near=15e-3, depth_mapping="eyepiece", near=0.3
    )
    assert properties.settings_of(settings) == engine.Settings(
        3,
        method="fast",
        estimator="paper",
        radiance="ray",
        quality="full",
        spp=99,
        wrp=11.5e-3,
        max_depth=2,
        virtual_image="opl",
        most_hits=3,
        planes=4,
        paths=5,
        phase_field="random",
        despeckle=40,
        seed=7,
    )


def test_materials_hold_an_abbe_number(addon):
    material = bpy.data.materials.new("glass")
    assert material.holopath.abbe_number == 0
    material.holopath.abbe_number = 59.0
    assert material.copy().holopath.abbe_number == 59.0


def test_focus(settings):
    assert settings.focus_auto
    settings.focus_dioptres = 4.0
    assert settings.focus == pytest.approx(0.25) and not settings.focus_auto
    settings.focus_infinity = True
    assert properties.focus_of(settings) == math.inf and settings.focus_dioptres == 0
    settings.focus_infinity = False
    assert properties.focus_of(settings) == 1.0
    settings.focus_dioptres = 0.0
    assert settings.focus_infinity
    properties.set_focus(settings, 2.0)
    assert settings.focus_dioptres == pytest.approx(0.5)


def test_pupil(settings):
    settings.use_pupil = True
    settings.pupil_offset_mm, settings.pupil_diameter_mm = (1.5, -2.0), 3.0
    assert properties.pupil_or_none(settings) == engine.Pupil(1.5e-3, -2e-3, 3e-3)


def test_every_setting_says_what_it_is(settings):
    for prop in settings.bl_rna.properties:
        if prop.identifier in ("rna_type", "name"):
            continue
        assert prop.description, prop.identifier
        assert not prop.description.endswith("."), prop.identifier
        unit = prop.name.partition("(")[2].rstrip(")")
        word = {
            "µm": "micrometre",
            "mm": "millimetre",
            "nm": "nanometre",
            "m": "metre",
            "dioptres": "dioptre",
            "": "",
        }
        assert word[unit] in prop.description, prop.identifier
