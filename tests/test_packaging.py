"""The two houses stay apart, and what is installed is complete and valid."""

import ast
import importlib.util
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "holopath_addon"
SOURCES = sorted(PACKAGE.rglob("*.py"))
SHAPELESS = {"utils", "util", "helpers", "helper", "common", "misc"}

BLOCK_BPY = """
import sys
class NoBlender:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("bpy", "bmesh", "mathutils", "bpy_extras", "gpu", "bl_ui"):
            raise ImportError(f"{name} was imported")
sys.meta_path.insert(0, NoBlender())
"""


def run_python(code):
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=120, check=False
    )


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def imports(path):
    """(module, level) of every import in a file, at any depth."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, 0) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module or "", node.level


def test_the_import_blocker_blocks():
    result = run_python(BLOCK_BPY + "import bpy")
    assert result.returncode != 0 and "bpy was imported" in result.stderr


@pytest.mark.parametrize("house", ["engine", "slm"])
def test_every_module_imports_without_blender(house):
    names = [module_name(path) for path in SOURCES if path.is_relative_to(PACKAGE / house)]
    assert names
    code = BLOCK_BPY + "import importlib\n" + "".join(f"importlib.import_module({n!r})\n" for n in names)
    result = run_python(code)
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    "name", ["holopath_addon", "holopath_addon.cli", "holopath_addon.engine", "holopath_addon.slm"]
)
def test_import_is_light(name):
    code = (
        BLOCK_BPY + f"import {name}\nprint(*(m for m in ('mitsuba', 'drjit', 'torch') if m in sys.modules))"
    )
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""


@pytest.mark.parametrize("house", ["engine", "slm"])
def test_no_blender_in_the_source_of(house):
    blender = {"bpy", "bmesh", "mathutils", "bpy_extras", "gpu", "bl_ui"}
    found = [
        f"{path.relative_to(ROOT)}: {module}"
        for path in SOURCES
        if path.is_relative_to(PACKAGE / house)
        for module, level in imports(path)
        if level == 0 and module.split(".")[0] in blender
    ]
    assert not found


def test_imports_inside_the_package_are_relative():
    found = [
        f"{path.relative_to(ROOT)}: {module}"
        for path in SOURCES
        for module, level in imports(path)
        if level == 0 and module.split(".")[0] == PACKAGE.name
    ]
    assert not found, "Blender installs the package under another name"


def test_no_shapeless_module_names():
    assert not [path for path in PACKAGE.rglob("*") if path.stem.lower() in SHAPELESS]


def test_no_pickle():
    found = [p for p in SOURCES if {"pickle", "shelve", "marshal"} & {m.split(".")[0] for m, _ in imports(p)}]
    assert not found
    assert not [p for p in SOURCES if re.search(r"allow_pickle\s*=\s*True", p.read_text(encoding="utf-8"))]


def test_sources_parse_on_the_oldest_python():
    for path in SOURCES:
        ast.parse(path.read_text(encoding="utf-8"), str(path), feature_version=(3, 11))


def test_versions_agree():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == project["version"]
    assert f"## {project['version']}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert manifest["license"] == [f"SPDX:{project['license']}"]


@pytest.fixture
def build_extension():
    specification = importlib.util.spec_from_file_location("build_extension", ROOT / "build_extension.py")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


def test_extension_is_valid_complete_and_reproducible(tmp_path, build_extension):
    pytest.importorskip("bpy")
    first = build_extension.build("linux-x64", [], tmp_path / "a")
    second = build_extension.build("linux-x64", [], tmp_path / "b")
    assert first.read_bytes() == second.read_bytes()
    names = set(zipfile.ZipFile(first).namelist())
    assert {"__init__.py", "blender_manifest.toml", "LICENSE"} <= names
    assert {path.relative_to(PACKAGE).as_posix() for path in SOURCES} <= names
    assert not [name for name in names if "__pycache__" in name or name.startswith(("tests", "/"))]
    assert list((tmp_path / "a").iterdir()) == [first]


def test_validator_refuses_a_bad_manifest(tmp_path, build_extension, monkeypatch):
    pytest.importorskip("bpy")
    bad = tmp_path / "blender_manifest.toml"
    text = build_extension.MANIFEST.read_text(encoding="utf-8")
    bad.write_text(text.replace('tagline = "', 'tagline = "' + "x" * 60), encoding="utf-8")
    monkeypatch.setattr(build_extension, "MANIFEST", bad)
    with pytest.raises(SystemExit, match="tagline"):
        build_extension.build("linux-x64", [], tmp_path / "bad")
    assert not list((tmp_path / "bad").iterdir())


def test_manifest_names_wheels_and_platform(build_extension):
    text = build_extension.manifest_text("linux-x64", [Path("drjit-1.5.0-cp311-cp311-any.whl")])
    manifest = tomllib.loads(text)
    assert manifest["platforms"] == ["linux-x64"]
    assert manifest["wheels"] == ["./wheels/drjit-1.5.0-cp311-cp311-any.whl"]
    assert manifest["permissions"]


def test_wheels_agree_with_the_project(build_extension):
    from packaging.requirements import Requirement

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ranges = {r.name: r.specifier for r in map(Requirement, project["dependencies"])}
    for python, pins in build_extension.WHEELS.items():
        for name, version in (pin.split("==") for pin in pins):
            assert ranges[name].contains(version), (python, name)
