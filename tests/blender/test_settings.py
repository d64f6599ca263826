"""Settings are declared once: the command line, Blender's properties and panels, and the pages have them all."""

import math
from pathlib import Path

import bpy
import pytest

from holopath_addon import cli, engine
from holopath_addon.blender import properties
from holopath_addon.cli import options
from holopath_addon.engine.settings import DECLARED, Settings, default_of
from tests.ui.layout import Context, Layout

PAGE = Path(__file__).parents[2] / "docs" / "settings.md"


def parse(*words):
    """Words of `holopath plan`."""
    return cli._parser(engine.BakeStore.default()).parse_args(["plan", *words])


def test_the_documentation_has_the_settings_as_they_are_declared():
    text = PAGE.read_text("utf-8")
    assert options.guide_table() in text, "run `make guide`"
    assert all(f"| {declared.label} | `{options.flag(name)}" in text for name, declared in DECLARED.items())


def test_the_command_line_has_them(capsys):
    with pytest.raises(SystemExit):
        parse("--help")
    text = capsys.readouterr().out
    assert [name for name in DECLARED if f"{options.flag(name)} " not in text] == []


def words(name, declared):
    """Words that set a setting, and the value that they mean."""
    if name == "fixed":
        return "chain=4", {"chain": 4}
    if declared.chosen:
        value = list(declared.chosen)[-1]
        return value, value
    value = declared.initial or declared.bounds[0] + 1
    return str(value), value * 1e-3 if declared.unit else value


@pytest.mark.parametrize("name", DECLARED)
def test_words_set_them(name):
    word, value = words(name, DECLARED[name])
    args = parse("scene.xml", options.flag(name), word)
    assert options.settings_of(args, Settings()) == Settings(**{name: value})


def test_one_takes_the_place_of_another():
    def settings(*words):
        return options.settings_of(parse("scene.xml", *words), Settings(speckle=0.3, spp=9))

    assert settings("--frames", "4") == Settings(frames=4, spp=9)
    assert settings("--quality", "preview") == Settings(quality="preview", speckle=0.3)
    assert settings("--spp", "5", "--speckle", "0.2") == Settings(spp=5, speckle=0.2)


@pytest.mark.parametrize("name", DECLARED)
def test_blender_has_them_within_the_same_bounds(addon, name):
    declared, rna = DECLARED[name], properties.HoloPathSettings.bl_rna.properties
    prop = rna[properties.property_of(name)]
    assert prop.name.startswith(declared.label) and prop.description.startswith(declared.help)
    if declared.chosen:
        assert {item.identifier: item.value for item in prop.enum_items} == {
            each.name: each.number for each in declared.chosen.values()
        }
    elif name != "fixed":
        for end, limit in zip(declared.bounds, (prop.hard_min, prop.hard_max), strict=True):
            assert math.isinf(end) or limit == pytest.approx(end)
    if declared.switch:
        assert rna[declared.switch.name].default == (not declared.switch.by_hand)


@pytest.mark.parametrize("name", DECLARED)
def test_a_panel_shows_them(addon, name):
    from holopath_addon.ui import sections

    bpy.ops.wm.read_factory_settings(use_empty=True)
    props = bpy.context.scene.holopath
    declared = DECLARED[name]
    if declared.switch:
        setattr(props, declared.switch.name, declared.switch.by_hand)
    if name == "paths":
        props.radiance = "ray"
    context = Context(bpy.context.scene)
    layout = Layout(context)
    getattr(sections, declared.section)(layout, context)
    assert properties.property_of(name) in [
        given["property"] for what, given in layout.drawn if what == "prop"
    ]


@pytest.mark.parametrize("name", [name for name in DECLARED if name != "fixed"])
def test_values_out_of_bounds_are_refused(name):
    declared = DECLARED[name]
    bad = "nonsense" if declared.chosen or declared.unit else declared.bounds[0] - 1
    with pytest.raises(
        engine.InvalidInput, match=declared.label if not declared.chosen else declared.label.lower()
    ):
        Settings(**{name: bad})
    if math.isfinite(declared.bounds[1]):
        with pytest.raises(engine.InvalidInput, match=f"to {declared.bounds[1]}, got"):
            Settings(**{name: declared.bounds[1] + 1})
    if not declared.chosen and declared.kind is int:
        with pytest.raises(engine.InvalidInput, match=declared.label):
            Settings(**{name: declared.bounds[0] + 0.5})
    assert Settings(**{name: default_of(name)}) == Settings()


def test_what_the_version_before_called_otherwise(capsys):
    """Old names work for a version, with a word."""
    with pytest.warns(DeprecationWarning, match="quality full is called high now"):
        assert Settings(quality="full") == Settings(quality="high")
    args = parse("scene.xml", "--quality", "full")
    assert options.settings_of(args, Settings()).quality == "high"
    assert "The quality full is called high now" in capsys.readouterr().err
    parser = cli._parser(engine.BakeStore.default())
    assert parser.parse_args(["encode", "out", "--planes", "3"]).compared_planes == 3
    assert parser.parse_args(["stream", "out", "--planes", "p.json"]).focus_planes == "p.json"
    assert parser.parse_args(["focus", "--planes", "p.json", "--plane", "1"]).focus_planes == "p.json"
    assert capsys.readouterr().err.count("--planes is called --") == 3
    assert parse("scene.xml", "--planes", "3").planes == 3 and capsys.readouterr().err == ""
