"""What pip installs: its metadata, the LLVM beside it, and a first picture without the source tree."""

import importlib.metadata
import importlib.util
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from markdown_it import MarkdownIt
from packaging.requirements import Requirement

from distribution import wheels
from holopath_addon import cli, llvm_package
from holopath_addon.engine.scene import variants

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PAGE = ROOT / PROJECT["readme"]
# On Python 3.11, and on those that the package asks for.
PYTHONS = ("3.11", "3.13", "3.14")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Folder with the source distribution, and the wheel that is built from that and nothing else."""
    folder = tmp_path_factory.mktemp("pip")
    copy, out = folder / "copy", folder / "dist"
    ignored = shutil.ignore_patterns(".*", "out", "build", "dist", "*.egg-info", "__pycache__")
    shutil.copytree(ROOT, copy, ignore=ignored)
    build(copy, "sdist", out)
    with tarfile.open(next(out.glob("*.tar.gz"))) as archive:
        archive.extractall(folder, filter="data")
    build(folder / f"holopath-{PROJECT['version']}", "wheel", out)
    return out


def build(source, kind, out):
    code = f"from setuptools import build_meta; build_meta.build_{kind}({str(out)!r})"
    subprocess.run([sys.executable, "-c", code], cwd=source, check=True, capture_output=True)


def test_the_source_distribution_builds_the_same_wheel(built):
    """And holds the rest of the project."""
    (wheel,), (source,) = built.glob("*.whl"), built.glob("*.tar.gz")
    package = ROOT / "holopath_addon"
    there = {p for p in package.rglob("*") if p.is_file() and "__pycache__" not in p.parts}
    names = zipfile.ZipFile(wheel).namelist()
    packed = {name for name in names if ".dist-info/" not in name}
    assert packed == {path.relative_to(ROOT).as_posix() for path in there}
    with tarfile.open(source) as archive:
        members = {name.partition("/")[2] for name in archive.getnames()}
    assert {"Makefile", "wheels.lock", "tests/scene.xml", "docs/index.md", "distribution/pypi.md"} <= members
    assert wheel.stat().st_size < 5e6 and source.stat().st_size < 20e6


def test_what_the_index_shows(built):
    (wheel,) = built.glob("*.whl")
    archive = zipfile.ZipFile(wheel)
    about = f"holopath-{PROJECT['version']}.dist-info"
    told = importlib.metadata.PathDistribution(zipfile.Path(archive, f"{about}/"))
    assert told.metadata["Description-Content-Type"] == "text/markdown"
    assert told.metadata.get_payload().strip() == PAGE.read_text("utf-8").strip()
    assert set(told.metadata.get_all("Provides-Extra")) == set(PROJECT["optional-dependencies"])
    assert [(e.name, e.value) for e in told.entry_points] == [("holopath", "holopath_addon.cli:main")]
    pythons = {c.rsplit(" ", 1)[1] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)}
    assert set(wheels.PYTHONS) <= pythons
    assert all(Requirement(f"python{PROJECT['requires-python']}").specifier.contains(p) for p in pythons)


def test_the_page_of_the_index_leads_nowhere_beside_it():
    """There are no other pages and no pictures beside it, unlike README.md."""
    tokens = [
        t
        for token in MarkdownIt().enable("table").parse(PAGE.read_text("utf-8"))
        for t in token.children or ()
    ]
    links = [str(t.attrGet("href") or t.attrGet("src")) for t in tokens if t.type in ("link_open", "image")]
    assert links and all(link.startswith("https://") for link in links)
    extras = set(re.findall(r"(?m)^\| `(\w+)` \|", PAGE.read_text("utf-8")))
    assert extras == set(PROJECT["optional-dependencies"]) - {"test", "docs", "oracles"}


def test_one_version_of_llvm():
    (extra,) = map(Requirement, PROJECT["optional-dependencies"]["llvm"])
    assert f"{extra.name}{extra.specifier}" == llvm_package.PIN
    assert wheels.WHEELS[wheels.LLVM] == [llvm_package.PIN.replace("-", "_")]
    oldest = ".".join(map(str, llvm_package.OLDEST_PYTHON))
    assert str(extra.marker) == f'python_version >= "{oldest}"'


@pytest.fixture
def package(tmp_path, monkeypatch):
    """llvm-nanobind as it is installed on each system, its library without content; and no LLVM of our own."""
    for path in (
        "llvm/LLVM.dll",
        "llvm_nanobind.libs/libLLVM-a6b1.so.21.1",
        "llvm_nanobind.dylibs/libLLVM.dylib",
    ):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).touch()
    (tmp_path / "llvm_nanobind.libs/libzstd-76b7.so.1").touch()
    (tmp_path / "llvm/__init__.py").write_text("raise ImportError('nobody imports it')")
    monkeypatch.syspath_prepend(tmp_path)
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "holopath_llvm" else find(name)
    )
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.delitem(sys.modules, "drjit", raising=False)
    return tmp_path


@pytest.mark.parametrize(
    "system, path",
    [
        ("linux", "llvm_nanobind.libs/libLLVM-a6b1.so.21.1"),
        ("darwin", "llvm_nanobind.dylibs/libLLVM.dylib"),
        ("win32", "llvm/LLVM.dll"),
        ("aix", None),
    ],
)
def test_the_library_is_found_and_named(package, monkeypatch, system, path):
    monkeypatch.setattr(sys, "platform", system)
    assert llvm_package.library() == (package / path if path else None)
    llvm_package.set_library_variable()
    assert os.environ.get("DRJIT_LIBLLVM_PATH") == (str(package / path) if path else None)


def test_others_choice_of_llvm_stays(package, monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "chosen")
    llvm_package.set_library_variable()
    assert os.environ["DRJIT_LIBLLVM_PATH"] == "chosen"
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())  # holopath_llvm is there
    llvm_package.set_library_variable()
    assert "DRJIT_LIBLLVM_PATH" not in os.environ


def test_without_the_package_nothing_is_named(package, monkeypatch):
    shutil.rmtree(package / "llvm")
    importlib.invalidate_caches()
    llvm_package.set_library_variable()
    assert "DRJIT_LIBLLVM_PATH" not in os.environ


@pytest.mark.skipif(os.name == "nt", reason="quoted for another shell")
@pytest.mark.parametrize("version", [(3, 11), (3, 12)])
def test_devices_says_how_llvm_comes(monkeypatch, capsys, version):
    row = {"name": "llvm_ad_rgb", "available": False, "detail": "none was found"}
    monkeypatch.setattr(variants, "describe", lambda: [row])
    monkeypatch.setattr(sys, "version_info", (*version, 0))
    monkeypatch.setattr(sys, "executable", "/a folder/python")
    assert cli.main(["devices"]) == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if "pip brings" in line]
    words = shlex.split(line.partition(":")[2])
    assert words[:4] == ["/a folder/python", "-m", "pip", "install"] and words[-1] == llvm_package.PIN
    assert (f"--target={sysconfig.get_path('platlib')}" in words) == (version == (3, 11))
    row["available"] = True
    assert cli.main(["devices"]) == 0 and "pip brings" not in capsys.readouterr().out


def test_devices_says_whether_xatlas_is_there(monkeypatch, capsys):
    from holopath_addon.engine.light import unwrapping

    for lacking, said in (("", "available"), ("This Python has no xatlas: cells.", "missing")):
        monkeypatch.setattr(unwrapping, "LACKING", lacking)
        assert cli.main(["devices"]) == 0
        (line,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("  xatlas")]
        assert line.split()[1] == said and line.endswith(lacking)


@pytest.mark.slow
@pytest.mark.parametrize("python", PYTHONS)
def test_pip_alone_gives_a_picture(built, tmp_path, python):
    """In an environment of its own, from the package index, away from the source tree."""
    interpreter = shutil.which(f"python{python}")
    # a version manager has names for all versions that it could bring
    if interpreter is None or subprocess.run([interpreter, "--version"], capture_output=True).returncode:
        pytest.skip(f"there is no python{python}")
    (wheel,) = built.glob("*.whl")
    variables = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "DRJIT_LIBLLVM_PATH")}

    def run(*command, shell=False):
        words = command[0] if shell else command
        return subprocess.run(
            words, cwd=tmp_path, env=variables, shell=shell, check=True, capture_output=True, text=True
        ).stdout

    run(interpreter, "-m", "venv", "env")
    programs = tmp_path / "env" / ("Scripts" if os.name == "nt" else "bin")
    run(programs / "python", "-m", "pip", "install", f"{wheel}[llvm]")
    if python == "3.11":
        told = run(programs / "holopath", "devices")
        if "pip brings an LLVM" in told:  # unless the system has one
            run(re.search("pip brings an LLVM:  (.*)", told)[1], shell=True)
    assert re.search("llvm_ad_rgb +available", run(programs / "holopath", "devices"))
    shutil.copy(ROOT / "tests" / "scene.xml", tmp_path)
    words = ["--resolution", "64x64", "--pitch", "8", "--frames", "2", "--focus", "1m", "--out", "out"]
    run(programs / "holopath", "render", "scene.xml", *words)
    assert (tmp_path / "out" / "reconstruction" / "focus_1m.png").stat().st_size > 1000
