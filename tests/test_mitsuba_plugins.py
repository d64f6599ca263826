"""Every plugin that a Mitsuba scene may hold renders, or is refused with a sentence; what is left out is said."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from holopath_addon import cli, engine, sources
from tests import mitsuba_plugins as table

SIZE = 24
FOCUS = 1.2
SETTINGS = engine.Settings(frames=3, quality="preview", method="full")
HOLOGRAM = engine.Hologram(
    SIZE, SIZE, 8e-6, (640e-9, 516.5e-9, 455.4e-9), depth_far=0.05e-3, depth_near=0.25e-3
)
QUICK = {"diffuse", "dielectric", "homogeneous", "orthographic", "blackbody", "polarizer"}


@pytest.fixture(scope="module")
def folder(backend, tmp_path_factory):
    folder = tmp_path_factory.mktemp("plugins")
    table.write_files(folder)
    return folder


def quarters(images):
    """Mean of each quarter of a picture, less its rim, whose light the aperture cuts off."""
    half = SIZE // 2
    rows = slice(3, half), slice(half, SIZE - 3)
    return np.array([images[0][down, across].mean() for down in rows for across in rows])


def check(case, folder):
    """Render the case, or have it refused."""
    path = folder / "scene.xml"
    path.write_text(case.xml(folder))
    if case.refused:
        with pytest.raises(engine.InvalidInput, match=case.refused):
            loaded = sources.open_source(str(path)).load(SIZE, SIZE)
            engine.plan(loaded.scene, loaded.camera, HOLOGRAM, SETTINGS)
        return
    loaded = sources.open_source(str(path)).load(SIZE, SIZE)
    plan = engine.plan(loaded.scene, loaded.camera, HOLOGRAM, SETTINGS)
    told = " ".join([*plan.warnings, *(cli.note_text(note) for note in loaded.notes)])
    if case.noted:
        assert re.search(case.noted, told)
    else:
        assert told == ""
    field = engine.render(loaded.scene, loaded.camera, HOLOGRAM, SETTINGS, plan)
    assert np.isfinite(field.data).all()
    found = quarters(engine.reconstruct(field, [FOCUS]))
    assert found.min() > 0
    if case.bright is not None:
        truth = engine.reference(
            loaded.scene, loaded.camera, HOLOGRAM, [FOCUS], spp=256, near=field.near, max_depth=plan.max_depth
        )
        np.testing.assert_allclose(found, quarters(truth), rtol=case.bright)


def rows(cases):
    return [pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow) for name in cases]


@pytest.mark.parametrize("name", rows(table.PLUGINS))
def test_plugin(name, folder):
    check(table.PLUGINS[name], folder)


@pytest.mark.slow
@pytest.mark.parametrize("name", table.NESTS)
def test_nested(name, folder):
    check(table.NESTS[name], folder)


def test_every_installed_plugin_has_a_row(backend):
    import mitsuba as mi

    manager = mi.PluginManager.instance()
    kinds = {getattr(mi.ObjectType, kind) for kind in table.KINDS}
    files = [path for path in (Path(mi.__file__).parent / "plugins").iterdir() if path.suffix != ".json"]
    installed = {path.stem for path in files if manager.plugin_type(path.stem) in kinds}
    assert len(installed) > 70
    assert installed - set(table.PLUGINS) == set()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["principled", "homogeneous", "batch", "irregular", "envmap"])
def test_by_command_line(name, folder, capfd):
    """Renders say in the report what is left out; refusals are one line with status 2."""
    case, out = table.PLUGINS[name], folder / f"out {name}"
    path = folder / "scene.xml"
    path.write_text(case.xml(folder))
    words = ["render", path, "--out", out, "--resolution", "24x24", "--frames", "2", "--quality", "preview"]
    status, error = cli.main([str(word) for word in words]), capfd.readouterr().err
    said = [line for line in error.splitlines() if line.startswith("holopath: ")]
    assert (status, len(said)) == ((2, 1) if case.refused else (0, 0)), error
    if case.refused:
        assert re.search(case.refused, said[0]) and not out.exists()
        return
    warnings = json.loads((out / "report.json").read_text())["warnings"]
    assert re.search(case.noted, " ".join(warnings)) and (warnings == [] or case.noted)
