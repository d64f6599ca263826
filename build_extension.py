"""Builds the zips that Blender installs: the package, its manifest and the wheels that it needs.

    python build_extension.py [--platform linux-x64 ...] [--python 3.11 ...] [--out dist]
    python build_extension.py --renew-lock     # after a change of WHEELS: fetch them all, write wheels.lock

The same sources give the same bytes on any machine: every wheel must have the SHA-256 that wheels.lock has for
it, and nothing depends on a compressor or a clock. Blender's own validator, from the bpy package, has the last
word. Prints the zips' paths; their sizes go to standard error.
"""

import argparse
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent
PACKAGE = ROOT / "holopath_addon"
LICENSE = ROOT / "LICENSE"
MANIFEST = ROOT / "blender_manifest.toml"
PROJECT = ROOT / "pyproject.toml"
LOCK = ROOT / "wheels.lock"

# macOS 12 is the oldest with wheels of SciPy; those for macOS 14 need it, and Blender takes any.
PIP_PLATFORMS = {
    "linux-x64": [f"manylinux_2_{n}_x86_64" for n in (28, 27, 17)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": ["macosx_12_0_arm64", "macosx_11_0_arm64"],
}

# Blender brings NumPy: 1.24 (Blender 4.2) or later with Python 3.11, 2.x with 3.13 and 3.14. SciPy 1.15 is
# the last that takes NumPy 1.24. xatlas has no wheel for Python 3.14; without it light is baked in cells.
SDL = ("PySDL2==0.9.17", "pysdl2_dll==2.32.10")
WHEELS = {
    "3.11": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.15.3", "xatlas==0.0.11", "pyserial==3.5", *SDL],
    "3.13": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.17.1", "xatlas==0.0.11", "pyserial==3.5", *SDL],
    "3.14": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.17.1", "pyserial==3.5", *SDL],
}

RENEW = "python build_extension.py --renew-lock"
LOCK_HEADER = f"""\
# The wheels in HoloPath's zips, their SHA-256 first; written by `{RENEW}`.
# Check those on disk with: cd build/wheels && sha256sum --check ../../wheels.lock
"""


def main(argv=None):
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    choices = {"nargs": "+", "metavar": "NAME"}
    parser.add_argument("--platform", **choices, choices=PIP_PLATFORMS, default=list(PIP_PLATFORMS))
    parser.add_argument("--python", **choices, choices=WHEELS, default=list(WHEELS))
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the zips (default: dist)")
    parser.add_argument(
        "--wheels", type=Path, default=ROOT / "build" / "wheels", help="where wheels are kept"
    )
    parser.add_argument("--renew-lock", action="store_true", help="write wheels.lock and build nothing")
    options = parser.parse_args(argv)
    if options.renew_lock:
        renew_lock(options.wheels)
        return
    for platform in options.platform:
        wheels = {python: locked_wheels(platform, python, options.wheels) for python in options.python}
        target = build(platform, wheels, options.out)
        print(target, flush=True)
        print(sizes(target, wheels), file=sys.stderr)


def renew_lock(folder):
    """Fetch the wheels for all platforms and Pythons anew into `folder`, and write what they are to the lock."""
    lines = []
    for platform in PIP_PLATFORMS:
        for python, pins in WHEELS.items():
            target = folder / platform / python
            shutil.rmtree(target, ignore_errors=True)
            fetch(platform, python, target, pins)
            lines += [
                f"{sha256(path)}  {platform}/{python}/{path.name}\n" for path in sorted(target.glob("*.whl"))
            ]
    unfinished = LOCK.with_name(f".unfinished-{LOCK.name}")
    unfinished.write_text(LOCK_HEADER + "".join(lines), encoding="utf-8", newline="\n")
    os.replace(unfinished, LOCK)


def locked(platform, python):
    """SHA-256 of each wheel that the lock has for a platform and a Python, by its file name."""
    hashes = {}
    for line in LOCK.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            digest, path = line.split()
            if path.startswith(f"{platform}/{python}/"):
                hashes[path.rsplit("/", 1)[1]] = digest
    if {pin_of(name) for name in hashes} != set(WHEELS[python]):
        raise SystemExit(
            f"build_extension.py: {LOCK.name} has other wheels for {platform} and Python {python} than WHEELS "
            f"asks for: renew it with `{RENEW}`."
        )
    return hashes


def pin_of(wheel):
    """``name==version`` of a wheel's file name."""
    return "==".join(wheel.split("-")[:2])


def locked_wheels(platform, python, folder):
    """Paths of the wheels in the lock, fetched into `folder` where they are missing."""
    hashes = locked(platform, python)
    target = folder / platform / python
    if not all((target / name).exists() for name in hashes):
        fetch(platform, python, target, [f"{pin_of(n)} --hash=sha256:{h}" for n, h in hashes.items()])
    for name, digest in hashes.items():
        if sha256(target / name) != digest:
            raise SystemExit(
                f"build_extension.py: {target / name} has another SHA-256 than in {LOCK.name}: "
                "delete it and build again."
            )
    return [target / name for name in sorted(hashes)]


def fetch(platform, python, target, requirements):
    """Have pip download wheels into `target`; `requirements` are lines as in a requirements file."""
    target.mkdir(parents=True, exist_ok=True)
    listed = target / "requirements.txt"
    listed.write_text("\n".join(requirements), encoding="utf-8")
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    command += ["--no-deps", "--only-binary", ":all:", "--python-version", python]
    for tag in PIP_PLATFORMS[platform]:
        command += ["--platform", tag]
    command += ["--requirement", listed, "--dest", target]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        errors = [line for line in result.stderr.splitlines() if line.startswith("ERROR: ")]
        said = (errors or [f"ERROR: status {result.returncode}"])[-1].removeprefix("ERROR: ")
        raise SystemExit(
            f"build_extension.py: pip cannot bring the wheels of {LOCK.name} for {platform} and Python {python} "
            f"({said}): check the connection and the package index, or renew the lock with `{RENEW}`."
        )


def sha256(path):
    """Of a file, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def manifest_text(platform, wheels):
    """The manifest with the platform and the wheels' names written in, before its first table."""
    lines = [f'platforms = ["{platform}"]', "wheels = ["]
    lines += [f'  "./wheels/{name}",' for name in wheels]
    lines += ["]", "", ""]
    head, bracket, tables = MANIFEST.read_text(encoding="utf-8").partition("[permissions]")
    return head + "\n".join(lines) + bracket + tables


def sources():
    """Files of the package, by their names in the zip: the same that pip installs."""
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))
    patterns = ["*.py", *project["tool"]["setuptools"]["package-data"]["*"]]
    return {
        path.relative_to(PACKAGE).as_posix(): path for pattern in patterns for path in PACKAGE.rglob(pattern)
    }


def build(platform, wheels, out):
    """Write and validate the zip; return its path. A zip that is not valid never stands under its name.

    `wheels` has the wheels' paths by Python.
    """
    files = {path.name: path for paths in wheels.values() for path in paths}
    text = manifest_text(platform, sorted(files))
    some = "" if set(wheels) == set(WHEELS) else "-python" + "-".join(wheels)
    target = out / f"holopath-{tomllib.loads(text)['version']}-{platform}{some}.zip"
    out.mkdir(parents=True, exist_ok=True)
    unfinished = out / f".unfinished-{target.name}"
    members = {"LICENSE": LICENSE} | sources() | {f"wheels/{name}": path for name, path in files.items()}
    try:
        with zipfile.ZipFile(unfinished, "w") as archive:
            archive.writestr(_entry("blender_manifest.toml"), text)
            for name, path in sorted(members.items()):
                archive.writestr(_entry(name), path.read_bytes())
        validate(unfinished)
        os.replace(unfinished, target)
    finally:
        unfinished.unlink(missing_ok=True)
    return target


def _entry(name):
    """A file in the zip, stored: what compresses well is small, and compressors differ."""
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    entry.create_system = 3  # Unix, wherever it is built
    entry.external_attr = 0o644 << 16
    return entry


def validate(archive):
    """Run Blender's validator on a zip, or stop with what it says."""
    bpy = importlib.util.find_spec("bpy")
    if bpy is None or bpy.origin is None:
        raise SystemExit(
            "build_extension.py: the validator is part of the bpy package: run `make env` first."
        )
    programs = Path(bpy.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    command = [sys.executable, next(programs), "validate", archive]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        raise SystemExit(
            f"build_extension.py: Blender's validator says: {result.stdout}{result.stderr}".strip()
        )


def sizes(archive, wheels):
    """What a zip takes, and what Blender unpacks from the wheels for its Python besides: a line."""
    unpacked = [f"{_unpacked(paths) / 1e6:.0f} MB with Python {python}" for python, paths in wheels.items()]
    return f"{archive.name}: {archive.stat().st_size / 1e6:.0f} MB; unpacked: {', '.join(unpacked)}"


def _unpacked(wheels):
    total = 0
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as archive:
            total += sum(entry.file_size for entry in archive.infolist())
    return total


if __name__ == "__main__":
    main()
