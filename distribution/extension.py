"""The zips that Blender installs: the package, its manifest and the wheels that it needs.

One for each platform and Python, and another one with what an NVIDIA card needs, which Blender shares with it. Every
wheel has the SHA-256 that wheels.lock has for it, or is made from such files: LLVM's, on Windows those that take a C++
library of their own, and xatlas for Python 3.14 on Linux. Nothing depends on a clock or a system: the same sources give
the same bytes, as far as liblzma packs alike, and xatlas as far as Python's headers are the same. Blender's own
validator, from the bpy package, has the last word.
"""

import importlib.util
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

from . import cpp_library, llvm, proof, xatlas
from .wheels import CARD, KEPT, ONLY_FOR, PIP_PLATFORMS, PYTHONS, ROOT, entry, locked_wheels

PACKAGE = ROOT / "holopath_addon"
LICENSE = ROOT / "LICENSE"
MANIFEST = ROOT / "blender_manifest.toml"
PROJECT = ROOT / "pyproject.toml"
CARD_MODULE = Path(__file__).with_name("nvidia") / "__init__.py"
CARD_MANIFEST = CARD_MODULE.with_name(MANIFEST.name)
OUT = ROOT / "dist"

# Blender 4.2 is built with Python 3.11 only, and does not ask an index for which Python an extension is.
OLDEST_BLENDER = {"3.11": "4.2.0", "3.13": "4.3.0", "3.14": "4.3.0"}


def build_all(platforms=tuple(PIP_PLATFORMS), pythons=tuple(PYTHONS), out=OUT, kept=KEPT, packed=True):
    """Build the zips of these platforms and Pythons, whose binaries are proven to load there.

    Yields
    ------
    target : Path
        Of a zip; a line on its sizes goes to standard error.
    proof : Proof
        What its binaries need.

    Raises
    ------
    SystemExit
        Where binaries would not load.
    """
    for platform in platforms:
        windows = platform == cpp_library.PLATFORM
        library = llvm.wheel(platform, kept / platform / "own", kept, packed and not windows)
        if windows:
            library = cpp_library.own(library, kept / platform / "own-llvm", kept, packed)
        for python in [python for python in PYTHONS if python in pythons]:
            wheels = locked_wheels(platform, python, kept)
            if windows:
                folder = kept / platform / f"own-{python}"
                wheels = [cpp_library.own(wheel, folder, kept, packed) for wheel in wheels]
            wheels.append(library)
            wheels += _own_xatlas(platform, python, kept)
            found = _proven(wheels, platform, python)
            target = build(platform, python, wheels, out)
            print(sizes(target, wheels), file=sys.stderr)
            yield target, found


def build_for_cards(platforms=tuple(PIP_PLATFORMS), pythons=tuple(PYTHONS), out=OUT, kept=KEPT, packed=True):
    """Build the zips that have HoloPath's waves computed on an NVIDIA card; see `build_all`."""
    for platform in platforms:
        for name in [CARD + python for python in PYTHONS if python in pythons]:
            if platform not in ONLY_FOR[name]:
                continue
            python, wheels = name.removeprefix(CARD), locked_wheels(platform, name, kept)
            if platform == cpp_library.PLATFORM:
                folder = kept / platform / f"own-{name}"
                wheels = [cpp_library.own(wheel, folder, kept, packed) for wheel in wheels]
            found = _proven(wheels, platform, python, with_llvm=False)
            modules = {CARD_MODULE.name: CARD_MODULE}
            target = build(platform, python, wheels, out, CARD_MANIFEST, modules)
            print(sizes(target, wheels), file=sys.stderr)
            yield target, found


def _proven(wheels, platform, python, with_llvm=True):
    """What the binaries need, or a stop with what would not load."""
    try:
        return proof.prove(wheels, platform, python, with_llvm)
    except proof.Unproven as error:
        raise SystemExit(
            f"distribution: the zip for {platform} and Python {python} would not load:\n{error}"
        ) from None


def _own_xatlas(platform, python, kept):
    """A list with the wheel of xatlas that PyPI has not; empty, with a word, where it cannot be built."""
    if python not in xatlas.PYTHONS:
        return []
    include = xatlas.headers(python) if platform == xatlas.PLATFORM else None
    if include is None:
        print(f"{platform}: {xatlas.missing(python)}", file=sys.stderr)
        return []
    return [xatlas.wheel(python, include, kept / platform / f"own-{python}", kept)]


def manifest_text(platform, python, wheels, manifest=None):
    """A manifest, by default HoloPath's, with the platform, the oldest Blender and the wheels' names written in.

    They come before its first table.
    """
    lines = [f'blender_version_min = "{OLDEST_BLENDER[python]}"', f'platforms = ["{platform}"]', "wheels = ["]
    lines += [f'  "./wheels/{name}",' for name in wheels]
    lines += ["]", "", ""]
    head, bracket, tables = (manifest or MANIFEST).read_text(encoding="utf-8").partition("[permissions]")
    return head + "\n".join(lines) + bracket + tables


def version():
    """HoloPath's, as the manifest has it."""
    return declared(MANIFEST)["version"]


def declared(manifest):
    """What a manifest says."""
    return tomllib.loads(manifest.read_text(encoding="utf-8"))


def sources():
    """Files of the package, by their names in the zip: the same that pip installs."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))
    patterns = ["*.py", *project["tool"]["setuptools"]["package-data"]["*"]]
    return {
        path.relative_to(PACKAGE).as_posix(): path for pattern in patterns for path in PACKAGE.rglob(pattern)
    }


def build(platform, python, wheels, out, manifest=None, modules=None):
    """Write and validate a zip of these wheels; return its path. One that is not valid never stands under its name.

    `manifest` and `modules`, paths by their names in the zip, are HoloPath's by default.
    """
    manifest, modules = manifest or MANIFEST, modules or sources()
    files = {path.name: path for path in wheels}
    text, said = manifest_text(platform, python, sorted(files), manifest), declared(manifest)
    target = out / f"{said['id']}-{said['version']}-{platform}-python{python}.zip"
    out.mkdir(parents=True, exist_ok=True)
    unfinished = out / f".unfinished-{target.name}"
    members = {"LICENSE": LICENSE} | modules | {f"wheels/{name}": path for name, path in files.items()}
    try:
        with zipfile.ZipFile(unfinished, "w") as archive:  # stored: what compresses well is small
            archive.writestr(entry("blender_manifest.toml"), text)
            for name, path in sorted(members.items()):
                archive.writestr(entry(name), path.read_bytes())
        blenders_own("validate", unfinished)
        os.replace(unfinished, target)
    finally:
        unfinished.unlink(missing_ok=True)
    return target


def blenders_own(*arguments):
    """Run Blender's program for extensions, or stop with what it says."""
    bpy = importlib.util.find_spec("bpy")
    if bpy is None or bpy.origin is None:
        raise SystemExit(
            "distribution: Blender's validator and index are part of the bpy package: run `make env` first."
        )
    programs = Path(bpy.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    command = [sys.executable, next(programs), *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise SystemExit(
            f"distribution: Blender's {arguments[0]} says: {result.stdout}{result.stderr}".strip()
        )


def sizes(archive, wheels):
    """What a zip takes, and what Blender unpacks from its wheels besides: a line."""
    return (
        f"{archive.name}: {archive.stat().st_size / 1e6:.0f} MB; unpacked: {_unpacked(wheels) / 1e6:.0f} MB"
    )


def _unpacked(wheels):
    total = 0
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as archive:
            total += sum(entry.file_size for entry in archive.infolist())
    return total
