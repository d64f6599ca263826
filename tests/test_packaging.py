"""Rooms that need no Blender know none, and what is installed is complete and valid."""

import ast
import base64
import hashlib
import importlib.util
import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from functools import cache
from pathlib import Path
from types import ModuleType

import pytest

from distribution import cpp_library, extension, llvm, repository, wheels
from holopath_addon.engine.waves import libraries
from holopath_addon.workflow import output
from tests.patience import NEVER

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "holopath_addon"
SOURCES = sorted(PACKAGE.rglob("*.py"))
WITHOUT_BLENDER = ("engine", "slm", "exchange", "workflow", "farm")
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
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=NEVER, check=False
    )


def module_name(path):
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def imports(path):
    """(module, level) of every import in a file, at any depth."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"), str(path))):
        if isinstance(node, ast.Import):
            found += [(alias.name, 0) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            found.append((node.module or "", node.level))
    return found


def test_the_import_blocker_blocks():
    result = run_python(BLOCK_BPY + "import bpy")
    assert result.returncode != 0 and "bpy was imported" in result.stderr


def test_every_module_imports_without_blender():
    names = [
        module_name(path)
        for house in WITHOUT_BLENDER
        for path in SOURCES
        if path.is_relative_to(PACKAGE / house)
    ]
    assert len(names) > 100
    # classes of Mitsuba's plugins need a variant
    code = (
        BLOCK_BPY
        + "import importlib\nfrom holopath_addon.engine.scene import variants\nvariants.activate()\n"
    )
    code += "".join(f"importlib.import_module({n!r})\n" for n in names)
    result = run_python(code)
    assert result.returncode == 0, result.stderr


HEAVY = ("mitsuba", "drjit", "torch", "scipy.stats", "scipy.interpolate")


def test_import_is_light():
    names = ["holopath_addon", "holopath_addon.cli", "holopath_addon.engine", "holopath_addon.slm"]
    code = BLOCK_BPY + "".join(
        f"import {name}\nprint(*({name!r} + ' brings ' + m for m in {HEAVY} if m in sys.modules))\n"
        for name in names
    )
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert result.stdout.strip() == ""


@pytest.mark.parametrize("house", WITHOUT_BLENDER)
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
    assert manifest["version"] == project["version"] == output.VERSION
    assert f"## [{project['version']}] - " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert manifest["license"] == [f"SPDX:{project['license']}"]


def test_without_xatlas_meshes_are_unwrapped_triangle_by_triangle():
    """Whose wheel is missing for some Pythons; pyserial's, which everything imports without."""
    code = """
import sys
sys.modules["xatlas"] = sys.modules["serial"] = None
import numpy as np
from holopath_addon import cli
from holopath_addon.workflow import pipeline
from holopath_addon.engine.light.unwrapping import unwrap
uv, _ = unwrap(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]]), 64)
a, b, c = uv[0]
assert abs(np.cross(b - a, c - a)) > 0.1
print(*pipeline.bake_notes({"note": "", "coarser": 1.0, "traced": ()}))
"""
    result = run_python(code)
    assert result.returncode == 0, result.stderr
    assert "xatlas" in result.stdout and "\n" not in result.stdout.strip()


def test_extension_is_valid_complete_and_reproducible(tmp_path):
    pytest.importorskip("bpy")
    for platform in wheels.PIP_PLATFORMS:
        first = extension.build(platform, "3.13", [], tmp_path / platform / "a")
        second = extension.build(platform, "3.13", [], tmp_path / platform / "b")
        assert first.name.endswith(f"-{platform}-python3.13.zip")
        assert first.read_bytes() == second.read_bytes()
        assert list(first.parent.iterdir()) == [first]
    names = set(zipfile.ZipFile(first).namelist())
    data = {path for path in PACKAGE.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert names == {path.relative_to(PACKAGE).as_posix() for path in data} | {
        "blender_manifest.toml",
        "LICENSE",
    }


def test_the_extension_for_cards(tmp_path):
    """Of its own name and version, with one module; for systems that have such cards."""
    pytest.importorskip("bpy")
    own = extension.CARD_MANIFEST, {"__init__.py": extension.CARD_MODULE}
    wheel(tmp_path, "thing-1.0-py3-none-any.whl", "good = True")
    built = extension.build("linux-x64", "3.13", [tmp_path / "thing-1.0-py3-none-any.whl"], tmp_path, *own)
    assert built.name == "holopath_nvidia-1.0.0-linux-x64-python3.13.zip"
    with zipfile.ZipFile(built) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        assert archive.read("__init__.py") == extension.CARD_MODULE.read_bytes()
        assert len(archive.namelist()) == 4
    assert manifest["name"] == libraries.EXTENSION and manifest["platforms"] == ["linux-x64"]
    assert manifest["wheels"] == ["./wheels/thing-1.0-py3-none-any.whl"]
    assert all(wheels.CARD + python not in wheels.names_of("macos-arm64") for python in wheels.PYTHONS)
    assert not list(extension.build_for_cards(["macos-arm64"], out=tmp_path / "none"))


@pytest.fixture
def for_cards():
    """The module of the extension for cards."""
    spec = importlib.util.spec_from_file_location("holopath_nvidia", extension.CARD_MODULE)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_libraries_for_cards_are_loaded_in_order(tmp_path, monkeypatch, for_cards):
    """Those that are there, by their paths, none of another name; without any nothing happens."""
    loaded = []
    monkeypatch.setattr(for_cards.ctypes, "CDLL", lambda path: loaded.append(path))
    monkeypatch.setattr(sys, "path", ["", str(tmp_path)])
    for_cards.register()
    assert loaded == []
    files = [
        "cuda_nvrtc/lib/libnvrtc-builtins.so.12.9",
        "cuda_nvrtc/lib/libnvrtc.so.12",
        "cufft/lib/libcufft.so.11",
    ]
    files += ["cuda_nvrtc/bin/nvrtc-builtins64_129.dll", "cuda_nvrtc/bin/nvrtc64_120_0.dll"]
    for name in [*files, "cuda_nvrtc/bin/nvrtc64_120_0.alt.dll", "cufft/lib/libcufftw.so.11"]:
        (tmp_path / "nvidia" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "nvidia" / name).write_bytes(b"")
    for_cards.register()
    windows, linux = files[3:], files[:3]
    assert loaded == [str(tmp_path / "nvidia" / name) for name in windows + linux]
    for_cards.unregister()


def test_headers_for_cards_are_shown_once(tmp_path, monkeypatch, for_cards):
    """To the finder of CuPy 14, and the environment is as before."""
    seen = []
    finder = ModuleType("cuda.pathfinder")
    vars(finder)["find_nvidia_header_directory"] = lambda name: seen.append((name, os.environ["CUDA_PATH"]))
    monkeypatch.setitem(sys.modules, "cuda", ModuleType("cuda"))
    monkeypatch.setitem(sys.modules, "cuda.pathfinder", finder)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    (tmp_path / "nvidia/cuda_runtime/include").mkdir(parents=True)
    monkeypatch.delenv("CUDA_HOME", raising=False)
    for before in ("another", None):
        monkeypatch.setenv("CUDA_PATH", before) if before else monkeypatch.delenv("CUDA_PATH")
        for_cards.show_headers()
        assert os.environ.get("CUDA_PATH") == before and "CUDA_HOME" not in os.environ
    assert seen == [("cudart", str(tmp_path / "nvidia/cuda_runtime"))] * 2


def test_zip_is_the_same_wherever_it_is_built(tmp_path, monkeypatch):
    """Nothing of it depends on a compressor, a clock or the system."""
    pytest.importorskip("bpy")
    monkeypatch.setattr(sys, "platform", "win32")
    archive = zipfile.ZipFile(extension.build("linux-x64", "3.11", [], tmp_path))
    for entry in archive.infolist():
        assert entry.compress_type == zipfile.ZIP_STORED
        assert (entry.create_system, entry.date_time) == (3, (1980, 1, 1, 0, 0, 0))
        assert entry.external_attr == 0o644 << 16


def test_validator_refuses_a_bad_manifest(tmp_path, monkeypatch):
    pytest.importorskip("bpy")
    bad = tmp_path / "blender_manifest.toml"
    text = extension.MANIFEST.read_text(encoding="utf-8")
    bad.write_text(text.replace('tagline = "', 'tagline = "' + "x" * 60), encoding="utf-8")
    monkeypatch.setattr(extension, "MANIFEST", bad)
    with pytest.raises(SystemExit, match="tagline"):
        extension.build("linux-x64", "3.11", [], tmp_path / "bad")
    assert not list((tmp_path / "bad").iterdir())


def test_manifest_names_wheels_platform_and_oldest_blender():
    text = extension.manifest_text("linux-x64", "3.11", ["drjit-1.5.0-cp311-cp311-any.whl"])
    manifest = tomllib.loads(text)
    assert manifest["blender_version_min"] == "4.2.0"
    assert manifest["platforms"] == ["linux-x64"]
    assert manifest["wheels"] == ["./wheels/drjit-1.5.0-cp311-cp311-any.whl"]
    assert manifest["permissions"]


def test_wheels_agree_with_the_project():
    from packaging.requirements import Requirement
    from packaging.utils import canonicalize_name

    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    ranges = {r.name: r.specifier for r in map(Requirement, project["dependencies"])}
    for python, pins in wheels.PYTHONS.items():
        for name, version in (pin.split("==") for pin in pins):
            assert ranges[canonicalize_name(name)].contains(version), (python, name)
    ranges = {r.name: r.specifier for r in map(Requirement, project["optional-dependencies"]["cuda"])}
    newer = {
        f"{wheels.CARD}3.13",
        f"{wheels.CARD}3.14",
    }  # pip has no CuPy for NumPy 1 that finds CUDA in wheels
    for name, version in (pin.split("==") for python in newer for pin in wheels.CARDS[python]):
        assert canonicalize_name(name) not in ranges or ranges[canonicalize_name(name)].contains(version), (
            name
        )
    assert ranges.keys() <= {canonicalize_name(pin.split("==")[0]) for pin in wheels.CARDS["card-3.14"]}


def test_the_lock_has_every_wheel():
    """And no other: of its Python, for its platform."""
    systems = {
        "linux-x64": "manylinux.*_x86_64",
        "windows-x64": "win_amd64",
        "macos-arm64": "macosx_1[123]_0_(arm64|universal2)",
    }
    for platform, system in systems.items():
        for python in wheels.names_of(platform):
            pins = wheels.WHEELS[python]
            found = wheels.locked(platform, python)
            assert len(found) == len(pins)
            of_python = python.removeprefix(wheels.CARD)
            tag = of_python.replace(".", "") if of_python in wheels.PYTHONS else "313"
            for name, digest in found.items():
                assert re.fullmatch("[0-9a-f]{64}", digest)
                of_system = rf"-(cp{tag}-cp{tag}|py2[.]py3-none|cp312-abi3|py3-none)-{system}\.whl$"
                compiler = r"^ziglang-.*-py3-none-manylinux_.*_x86_64\.whl$|^xatlas-[\d.]*\.tar\.gz$"
                kinds = [of_system, r"-none-any\.whl$", *([compiler] if python == wheels.XATLAS else [])]
                assert re.search("|".join(kinds), name), name


def wheel(folder, name, content):
    """A wheel with one module."""
    folder.mkdir(parents=True, exist_ok=True)
    project, version = name.split("-")[:2]
    with zipfile.ZipFile(folder / name, "w") as archive:
        archive.writestr(f"{project}.py", content)
        about = f"{project}-{version}.dist-info"
        archive.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {project}\nVersion: {version}\n")
        archive.writestr(
            f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: cp311-cp311-win_amd64\n"
        )
        archive.writestr(f"{about}/RECORD", "")


@pytest.fixture
def small(tmp_path, monkeypatch):
    """The builder with one wheel, for one platform, and a package index that is a folder."""
    monkeypatch.setattr(wheels, "PIP_PLATFORMS", {"windows-x64": ["win_amd64"]})
    monkeypatch.setattr(wheels, "PYTHONS", {"3.11": ["thing==1.0"]})
    monkeypatch.setattr(wheels, "WHEELS", {"3.11": ["thing==1.0"]})
    monkeypatch.setattr(wheels, "LOCK", tmp_path / "wheels.lock")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path / "index"))
    monkeypatch.setenv("PIP_NO_CACHE_DIR", "1")
    wheel(tmp_path / "index", "thing-1.0-cp311-cp311-win_amd64.whl", "good = True")
    wheels.renew_lock(tmp_path / "renewed")
    return wheels


def test_wheels_with_other_hashes_are_refused(tmp_path, small, monkeypatch):
    """By pip where it downloads them, by us where they lie already; and a lock of other versions."""
    (path,) = small.locked_wheels("windows-x64", "3.11", tmp_path / "wheels")
    assert path.read_bytes() == (tmp_path / "index" / path.name).read_bytes()
    path.write_bytes(path.read_bytes() + b"!")
    with pytest.raises(SystemExit, match=r"thing-1\.0.*another SHA-256.*delete it") as refused:
        small.locked_wheels("windows-x64", "3.11", tmp_path / "wheels")
    assert "\n" not in str(refused.value)
    wheel(tmp_path / "index", path.name, "good = False")
    with pytest.raises(SystemExit, match="pip cannot bring.*HASHES.*distribution lock") as refused:
        small.locked_wheels("windows-x64", "3.11", tmp_path / "empty")
    assert "\n" not in str(refused.value)
    assert not list((tmp_path / "empty").rglob("*.whl"))
    monkeypatch.setattr(small, "WHEELS", {"3.11": ["thing==1.1"]})
    with pytest.raises(SystemExit, match=r"wheels\.lock.*distribution lock"):
        small.locked("windows-x64", "3.11")


def test_the_wheel_of_llvm_takes_the_library_as_it_is(tmp_path, monkeypatch):
    """Under a name by which LLVM is known, with what lies beside it and the texts of their licenses, and no code."""
    files = {
        "llvm/__init__.abi3.so": b"not for every Python",
        "llvm_nanobind.libs/libLLVM-a6b1.so.21.1": b"LLVM" * 999,
        "llvm_nanobind.libs/libzstd-76b7.so.1.4.4": b"zstd",
    }
    theirs = tmp_path / "llvm_nanobind-21.1.6.3-cp312-abi3-manylinux_2_28_x86_64.whl"
    with zipfile.ZipFile(theirs, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    monkeypatch.setattr(wheels, "locked_wheels", lambda *_: [theirs])
    packed, stored = (llvm.wheel("linux-x64", tmp_path / str(p), packed=p) for p in (True, False))
    assert packed.name == "holopath_llvm-21.1.6.3-py3-none-manylinux_2_28_x86_64.whl"
    assert packed.stat().st_size < stored.stat().st_size
    for path in (packed, stored):
        archive = zipfile.ZipFile(path)
        assert {n: archive.read(n) for n in archive.namelist() if n.startswith("holopath_llvm/")} == {
            "holopath_llvm/__init__.py": b"",
            "holopath_llvm/libLLVM.so.21.1": b"LLVM" * 999,
            "holopath_llvm/libzstd-76b7.so.1.4.4": b"zstd",
        }
        texts = [n for n in archive.namelist() if "/licenses/" in n]
        assert len(texts) == 4 and all(len(archive.read(n)) > 100 for n in texts)
    target = tmp_path / "site"
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-index",
        "--no-deps",
        "--target",
        target,
        packed,
    ]
    subprocess.run(command, check=True)  # which checks it by its RECORD
    assert (target / "holopath_llvm" / "libLLVM.so.21.1").read_bytes() == b"LLVM" * 999
    with zipfile.ZipFile(theirs, "w") as archive:
        archive.writestr("llvm/__init__.abi3.so", b"")
    with pytest.raises(SystemExit, match=r"linux-x64 has no llvm_nanobind\.libs/libLLVM"):
        llvm.wheel("linux-x64", tmp_path / "none")
    assert not list((tmp_path / "none").iterdir())


def test_our_binaries_of_windows_take_a_cpp_library_of_their_own(tmp_path, monkeypatch):
    """Microsoft's file as it is beside them, with its license; nothing else of them changes; SciPy has one already."""
    library, name = b"MZ of 2024", cpp_library.name_of(b"MZ of 2024")
    assert len(name) == len(cpp_library.LIBRARY) and re.fullmatch(r"cpp[0-9a-f]{5}\.dll", name)
    theirs = tmp_path / "msvc_runtime-14.44.35112-cp313-cp313-win_amd64.whl"
    with zipfile.ZipFile(theirs, "w") as archive:
        archive.writestr("msvc_runtime-14.44.35112.data/data/msvcp140.dll", library)
        archive.writestr("msvc_runtime-14.44.35112.data/data/Scripts/msvcp140.dll", library)
        archive.writestr("msvc_runtime-14.44.35112.dist-info/licenses/LICENSE", "may be distributed")
    monkeypatch.setattr(wheels, "locked_wheels", lambda *_: [theirs])
    binary = b"MZ\0MSVCP140.dll\0msvcp140_1.dll\0MSVCP140.dll as text"
    changed = b"MZ\0" + name.encode() + b"\0msvcp140_1.dll\0MSVCP140.dll as text"
    out = {}
    for package in ("drjit", "mitsuba", "xatlas", "scipy"):
        file = f"{package}/a.dll"
        path = tmp_path / f"{package}-1.0-cp311-cp311-win_amd64.whl"
        about = f"{package}-1.0.dist-info"
        with zipfile.ZipFile(path, "w") as archive:
            for member, data in {file: binary, f"{package}/a.txt": b"\0MSVCP140.dll\0"}.items():
                archive.writestr(member, data)
            archive.writestr(
                f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: false\nTag: py3-none-any\n"
            )
            archive.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
            archive.writestr(f"{about}/RECORD", "")
        out[package] = cpp_library.own(path, tmp_path / "own", packed=True)
        files = {n: zipfile.ZipFile(out[package]).read(n) for n in zipfile.ZipFile(out[package]).namelist()}
        assert files[file] == (binary if package == "scipy" else changed)
        assert files[f"{package}/a.txt"] == b"\0MSVCP140.dll\0"
        beside = {"drjit": f"drjit/{name}", "xatlas": name}.get(package)
        assert [n for n in files if n.endswith(name)] == ([beside] if beside else [])
        if beside:
            assert (
                files[beside] == library
                and files[f"{about}/licenses/msvcp140.dll.txt"] == b"may be distributed"
            )
    assert out["scipy"].parent == tmp_path
    recorded = zipfile.ZipFile(out["drjit"]).read("drjit-1.0.dist-info/RECORD").decode()
    digest = base64.urlsafe_b64encode(hashlib.sha256(changed).digest()).rstrip(b"=").decode()
    assert f"drjit/a.dll,sha256={digest},{len(changed)}\n" in recorded
    (tmp_path / "again").mkdir()
    again = out["drjit"].rename(tmp_path / "again" / out["drjit"].name)
    with pytest.raises(SystemExit, match=r"no binary of drjit-1\.0.* imports msvcp140\.dll"):
        cpp_library.own(again, tmp_path / "none")
    assert not list((tmp_path / "none").iterdir())


def test_an_index_tells_each_blender_its_zip(tmp_path):
    """By Blender's own program: platform, Python and the oldest Blender."""
    pytest.importorskip("bpy")
    folder = tmp_path / "repository"
    for platform in wheels.PIP_PLATFORMS:
        for python in wheels.PYTHONS:
            tag = f"cp{python.replace('.', '')}"
            name = f"thing-1.0-{tag}-{tag}-any.whl"
            wheel(tmp_path / "wheels", name, "good = True")
            built = extension.build(platform, python, [tmp_path / "wheels" / name], folder)
    older = folder / "holopath-0.0.1-linux-x64-python3.11.zip"
    older.write_bytes(built.read_bytes())  # Blender would take any
    own = extension.CARD_MANIFEST, {"__init__.py": extension.CARD_MODULE}
    for_cards = extension.build("linux-x64", "3.13", [tmp_path / "wheels" / name], folder, *own)
    (folder / for_cards.name.replace("1.0.0", "0.9.0")).write_bytes(for_cards.read_bytes())
    repository.publish(folder, extension.version())
    rows = json.loads((folder / "index.json").read_text(encoding="utf-8"))["data"]
    assert [row["name"] for row in rows if row["id"] == "holopath_nvidia"] == [libraries.EXTENSION]
    rows = [row for row in rows if row["id"] == "holopath"]
    told = {(*row["platforms"], *row["python_versions"]): row["blender_version_min"] for row in rows}
    assert len(rows) == len(told) == 9
    assert told["linux-x64", "3.11"] == "4.2.0" and told["windows-x64", "3.11"] == "4.2.0"
    assert all((folder / row["archive_url"]).is_file() for row in rows)
    assert "holopath-" in (folder / "index.html").read_text(encoding="utf-8")
