"""The census of Mitsuba's plugins and parameters, against the Mitsuba that is installed."""

import platform
import re
import sys
from pathlib import Path

import pytest

from documentation import mitsuba_census
from documentation.mitsuba_census import COMMON, PLUGINS, REASONS
from tests import mitsuba_plugins

DOCS = Path(__file__).parents[1] / "docs"
# Words in plugins that no scene file says: choices of parameters, names in files, of nested parts and of functions.
OTHER_WORDS = set(
    """
    abort acetone alpha amber ascii beckmann benzene bilinear binary_big_endian binary_little_endian brdf_0 brdf_1
    bromine bsdf_0 bsdf_1 clamp color comment constvolume control_point_count control_points default depth
    deregister_tm_clones description diamond double element ellipsoid end_header ethanol ext_iot faces false float
    float16 float32 float64 format frame_dummy geo_normal glycerol green helium hydrogen ico_sphere init_plugin
    integrator irregular jacobian luminance luminance_alpha memcmp memcpy memmove memset mirror nearest nested_bsdf
    nested_texture opacities openexr phase_0 phase_1 phi_d phi_i polypropylene prim_index pthread_mutex_lock
    pthread_mutex_unlock pyrex quaterion regular repeat rot_0 rot_1 rot_2 rot_3 sampler scale_0 scale_1 scale_2
    segment_indices sensor sh_coeffs sh_normal shape_index shell sigma sky_irradiance sky_params sky_rad smooth snprintf
    sobol_2 spectra stoul stoull strcmp strlen strtod strtof strtoul strtoull sun_irradiance sun_ld_spec sun_rad
    texture_u texture_v theta_d theta_h theta_i tolower trilinear uchar uint16 uint32 uint8 ulong unbounded uniform
    ushort uv_sphere vacuum value variant vertex vertex_index vertex_indices vertex_positions water wavelengths weights
    albedo backward_from dp_du dp_dv duv_dx duv_dy shutter_open_time x_fov
    """.split()
)
INLINED = 8  # characters of words that a compiler may keep as numbers


@pytest.fixture(scope="module")
def folder(backend):
    import mitsuba as mi

    return Path(mi.__file__).parent


def unknown_words(name, code):
    """Words in a plugin's machine code that could be parameters, and that the census lacks."""
    words = {word.decode() for word in re.findall(rb"\0([a-z][a-z0-9]*(?:_[a-z0-9]+)*)(?=\0)", code)}
    words = {
        word for word in words if len(word) > 4 and not re.match("jit_|(cuda|llvm|scalar)_|binary_", word)
    }
    row = PLUGINS[name]
    common = COMMON[row.kind].parameters if row.kind in COMMON else {"to_world"}
    return words - row.parameters - common - OTHER_WORDS


def test_every_installed_plugin_has_a_row(folder):
    import mitsuba as mi

    manager = mi.PluginManager.instance()
    installed = {path.stem for path in (folder / "plugins").iterdir()} - {"__pycache__"}
    assert installed - set(PLUGINS) == set()
    assert set(PLUGINS) - installed == set()
    assert {name: row.kind for name, row in PLUGINS.items()} == {
        name: manager.plugin_type(name).name for name in installed
    }


@pytest.mark.skipif(
    sys.platform != "linux" or platform.machine() != "x86_64",
    reason="compilers keep words elsewhere otherwise",
)
def test_every_word_of_a_plugin_is_known(folder):
    """Parameters are words in its code: new ones are not in the table, and misspelt ones not in the code."""
    library = (folder / "libmitsuba.so").read_bytes()
    for name, row in PLUGINS.items():
        code = (folder / "plugins" / f"{name}.so").read_bytes()
        assert unknown_words(name, code) == set(), name
        absent = {
            word for word in row.parameters if all(word.encode() not in each for each in (code, library))
        }
        assert all(len(word) < INLINED for word in absent), (name, absent)
    for row in COMMON.values():
        assert all(word.encode() + b"\0" in library for word in row.parameters)


def test_a_new_parameter_is_found():
    assert unknown_words("spot", b"\0intensity\0to_world\0sampling_weight\0memcpy\0") == set()
    assert unknown_words("spot", b"\0intensity\0squared_falloff\0") == {"squared_falloff"}


def test_what_is_without_effect_has_a_reason():
    reasons = " ".join(REASONS.values()).split()
    without = {word for row in [*PLUGINS.values(), *COMMON.values()] for word in row.without_effect}
    assert without == set(reasons) and len(reasons) == len(set(reasons))


def test_outcomes_are_those_of_the_plugins_cases():
    refused = {name for name, case in mitsuba_plugins.PLUGINS.items() if case.refused}
    told = {name for name, row in PLUGINS.items() if row.outcome == mitsuba_census.REFUSED}
    assert refused == told


def test_the_page_names_every_plugin():
    page = (DOCS / "mitsuba.md").read_text("utf-8")
    assert [name for name in PLUGINS if f"`{name}`" not in page] == []
