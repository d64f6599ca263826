"""Every plugin that a Mitsuba scene may hold renders, or is refused with a sentence; what is left out is said."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import cli, engine
from holopath_addon.cli import sources
from tests import mitsuba_plugins as table

GREEN = 516.5e-9
SIZE = 24
FOCUS = 1.2
# Paths enough that little noise is left, and that rare ones through masks need not be cut; and frames enough that
# speckle leaves a quarter's brightness alone: of glass in a blend it deviates by 15 % with three.
SETTINGS = engine.Settings(frames=24, quality="preview", method="full", fixed={"passes": 256})
HOLOGRAM = engine.Hologram(SIZE, SIZE, 8e-6, (GREEN,), depth_far=0.05e-3, depth_near=0.25e-3)
CASES = table.PLUGINS | table.NESTS
REFUSED = [name for name, case in CASES.items() if case.refused]
NOTED = [name for name, case in CASES.items() if case.noted]
RENDERED = [name for name, case in CASES.items() if not case.refused]


@pytest.fixture(scope="module")
def folder(backend, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugins")
    table.write_files(folder)
    return folder


def write(case, folder):
    path = folder / "scene.xml"
    path.write_text(case.xml(folder))
    return path


def opened(case, folder):
    """The case's scene and camera."""
    loaded = sources.open_source(str(write(case, folder))).load(SIZE, SIZE)
    return loaded.scene, loaded.camera


def quarters(picture):
    """Mean of each quarter of a picture, less its rim, whose light the aperture cuts off."""
    half = SIZE // 2
    rows = slice(3, half), slice(half, SIZE - 3)
    return np.array([picture[down, across].mean() for down in rows for across in rows])


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name, folder):
    case = CASES[name]
    with pytest.raises(engine.InvalidInput, match=case.refused):
        engine.plan(*opened(case, folder), HOLOGRAM, SETTINGS)


@pytest.mark.parametrize("name", NOTED)
def test_noted(name, folder):
    from holopath_addon.engine.planning.unmodeled import unmodeled_warnings

    scene, _ = opened(CASES[name], folder)
    assert any(re.search(CASES[name].noted, warning) for warning in unmodeled_warnings(scene))


@pytest.mark.slow
@pytest.mark.parametrize("name", RENDERED)
def test_renders(name, folder):
    """As bright as Mitsuba's path tracer through a thin lens, quarter by quarter; nothing is said that need not be."""
    case = CASES[name]
    scene, camera = opened(case, folder)
    plan = engine.plan(scene, camera, HOLOGRAM, SETTINGS)
    assert bool(plan.warnings) == bool(case.noted), plan.warnings
    field = engine.render(scene, camera, HOLOGRAM, SETTINGS, plan)
    assert np.isfinite(field.data).all()
    found = quarters(engine.reconstruct(field, [FOCUS])[0, ..., 0])
    assert found.min() > 0
    if case.bright is not None:
        lens = field.mapping.pupil_radius(HOLOGRAM.max_slope(GREEN))
        truth = quarters(engine.Preview(scene, camera, SIZE, SIZE, FOCUS, lens).refine(256)[..., 1])
        assert np.all(np.abs(found - truth) <= 0.01 + np.array(case.bright) * truth), (found, truth)


def test_every_installed_plugin_has_a_row(backend):
    import mitsuba as mi

    manager = mi.PluginManager.instance()
    kinds = {getattr(mi.ObjectType, kind) for kind in table.KINDS}
    names = {path.stem for path in (Path(mi.__file__).parent / "plugins").iterdir()}
    installed = {name for name in names if manager.plugin_type(name) in kinds}
    assert len(installed) > 70
    assert installed - set(table.PLUGINS) == set()


def test_hidden_emitters(folder):
    """An integrator that hides the environment hides it; shapes that shine stay in view, and that is said."""
    hides = '<integrator type="path"><boolean name="hide_emitters" value="true"/></integrator>'
    for name, noted in (("constant", False), ("area", True)):
        path = folder / "scene.xml"
        path.write_text(table.PLUGINS[name].xml(folder).replace("</scene>", hides + "</scene>"))
        loaded = sources.open_source(str(path)).load(SIZE, SIZE)
        assert not loaded.camera.sees_sky
        assert [note["feature"] for note in loaded.notes] == ["hide_emitters"] * noted


@pytest.mark.parametrize("name", ["blackbody", "batch"])
def test_refused_by_the_command_line(name, folder, capfd):
    """In one line, with status 2 and nothing left behind."""
    out = folder / f"out {name}"
    path = write(CASES[name], folder)
    assert cli.main(["render", str(path), "--out", str(out), "--resolution", "24x24"]) == 2
    said = [line for line in capfd.readouterr().err.splitlines() if line.startswith("holopath: ")]
    assert len(said) == 1 and re.search(CASES[name].refused, said[0]) and not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["homogeneous", "envmap"])
def test_by_the_command_line(name, folder):
    """The report says what is left out."""
    case, out = CASES[name], folder / f"out {name}"
    words = [
        write(case, folder),
        "--out",
        out,
        "--resolution",
        "24x24",
        "--frames",
        "2",
        "--quality",
        "preview",
    ]
    assert cli.main(["render", *map(str, words)]) == 0
    warnings = json.loads((out / "report.json").read_text())["warnings"]
    assert bool(re.search(case.noted or "^$", " ".join(warnings)))


@pytest.mark.parametrize(
    ("variant", "radius", "told"),
    [("cuda_ad_rgb", 0.01, 1), ("cuda_ad_rgb", 0.1, 0), ("llvm_ad_rgb", 0.01, 0)],
)
def test_small_spheres_light_too_little_on_graphics_cards(backend, monkeypatch, variant, radius, told):
    from benchmarks.scenes import Scenes
    from holopath_addon.engine.planning import unmodeled

    build = Scenes()
    monkeypatch.setattr(unmodeled.variants, "activate", lambda: variant)
    lamp = {"type": "sphere", "center": [1, 2, 0.2], "radius": radius, **build.emissive(build.gray(1))}
    scene = build.scene(wall=build.plane(2.0, build.diffuse(build.gray(0.5))), lamp=lamp)
    assert sum("lamp may light too little" in note for note in unmodeled.unmodeled_warnings(scene)) == told
