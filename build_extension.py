"""Builds the zip that Blender installs: the package, its manifest and the wheels that it needs.

    python build_extension.py [--platform linux-x64] [--python 3.11 3.13 3.14] [--out dist]

The same sources and wheels give the same bytes. Blender's own validator, from the bpy package, has the
last word.
"""

import argparse
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

PIP_PLATFORMS = {
    "linux-x64": [f"manylinux_2_{n}_x86_64" for n in (28, 27, 17)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{n}_0_arm64" for n in range(14, 10, -1)],
}

# Blender brings NumPy: 1.24 (Blender 4.2) or later with Python 3.11, 2.x with 3.13 and 3.14. SciPy 1.15 is
# the last that takes NumPy 1.24. xatlas has no wheel for Python 3.14; nothing there needs it.
WHEELS = {
    "3.11": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.15.3", "xatlas==0.0.11", "pyserial==3.5"],
    "3.13": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.17.1", "xatlas==0.0.11", "pyserial==3.5"],
    "3.14": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.17.1", "pyserial==3.5"],
}


def main(argv=None):
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    parser.add_argument("--platform", choices=PIP_PLATFORMS, default="linux-x64")
    parser.add_argument("--python", nargs="+", choices=WHEELS, default=list(WHEELS), metavar="VERSION")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the zip (default: dist)")
    parser.add_argument(
        "--wheels", type=Path, default=ROOT / "build" / "wheels", help="where wheels are kept"
    )
    options = parser.parse_args(argv)
    wheels = download(options.platform, options.python, options.wheels)
    print(build(options.platform, wheels, options.out))


def download(platform, pythons, folder):
    """Fetch the pinned wheels for a platform and several Pythons into `folder`; return their paths."""
    wheels = {}
    for python in pythons:
        target = folder / platform / python
        stamp = target / "complete.txt"
        if not stamp.exists() or stamp.read_text() != "\n".join(WHEELS[python]):
            shutil.rmtree(target, ignore_errors=True)
            target.mkdir(parents=True)
            command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
            command += ["--no-deps", "--only-binary", ":all:", "--python-version", python]
            for tag in PIP_PLATFORMS[platform]:
                command += ["--platform", tag]
            subprocess.run([*command, "--dest", target, *WHEELS[python]], check=True)
            stamp.write_text("\n".join(WHEELS[python]))
        wheels.update({path.name: path for path in target.glob("*.whl")})
    return [wheels[name] for name in sorted(wheels)]


def manifest_text(platform, wheels):
    """The manifest with the platform and the wheels written in, before its first table."""
    lines = [f'platforms = ["{platform}"]', "wheels = ["]
    lines += [f'  "./wheels/{wheel.name}",' for wheel in wheels]
    lines += ["]", "", ""]
    head, bracket, tables = MANIFEST.read_text(encoding="utf-8").partition("[permissions]")
    return head + "\n".join(lines) + bracket + tables


def build(platform, wheels, out):
    """Write and validate the zip; return its path. A zip that is not valid never stands under its name."""
    text = manifest_text(platform, wheels)
    version = tomllib.loads(text)["version"]
    target = out / f"holopath-{version}-{platform}.zip"
    out.mkdir(parents=True, exist_ok=True)
    unfinished = out / f".unfinished-{target.name}"
    members = {"blender_manifest.toml": text.encode(), "LICENSE": LICENSE.read_bytes()}
    for path in sorted(PACKAGE.rglob("*")):
        if path.is_file() and "__pycache__" not in path.parts:
            members[path.relative_to(PACKAGE).as_posix()] = path.read_bytes()
    try:
        with zipfile.ZipFile(unfinished, "w") as archive:
            for name, data in sorted(members.items()):
                archive.writestr(_entry(name, zipfile.ZIP_DEFLATED), data)
            for wheel in wheels:
                archive.writestr(_entry(f"wheels/{wheel.name}", zipfile.ZIP_STORED), wheel.read_bytes())
        validate(unfinished)
        os.replace(unfinished, target)
    finally:
        unfinished.unlink(missing_ok=True)
    return target


def _entry(name, compression):
    entry = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    entry.compress_type = compression
    entry.external_attr = 0o644 << 16
    return entry


def validate(archive):
    """Run Blender's validator on a zip, or stop with what it says."""
    bpy = importlib.util.find_spec("bpy")
    if bpy is None:
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


if __name__ == "__main__":
    main()
