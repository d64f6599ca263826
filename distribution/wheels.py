"""The wheels in HoloPath's zips: which they are, and how they come from the package index, by their hashes."""

import base64
import csv
import hashlib
import io
import os
import platform as system
import shutil
import subprocess
import sys
import zipfile
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "wheels.lock"
KEPT = ROOT / "build" / "wheels"

# macOS 12 is the oldest with wheels of SciPy, 13 that of LLVM's; those for macOS 14 need it, and Blender takes any.
PIP_PLATFORMS = {
    "linux-x64": [f"manylinux_2_{n}_x86_64" for n in (28, 27, 17)] + ["manylinux2014_x86_64"],
    "windows-x64": ["win_amd64"],
    "macos-arm64": [f"macosx_{n}_0_arm64" for n in (13, 12, 11)],
}

SYSTEMS = {  # as the module platform calls them
    ("Linux", "x86_64"): "linux-x64",
    ("Windows", "AMD64"): "windows-x64",
    ("Darwin", "arm64"): "macos-arm64",
}

# Blender brings NumPy: 1.24 (Blender 4.2) or later with Python 3.11, 2.x with 3.13 and 3.14. SciPy 1.15 is
# the last that takes NumPy 1.24. xatlas has no wheel for Python 3.14: it is built for Linux, from `XATLAS`.
COMMON = ("array_api_compat==1.16.0", "pyserial==3.5", "PySDL2==0.9.17", "pysdl2_dll==2.32.10")
PYTHONS = {
    "3.11": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.15.3", "xatlas==0.0.11", *COMMON],
    "3.13": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.17.1", "xatlas==0.0.11", *COMMON],
    "3.14": ["mitsuba==3.9.1", "drjit==1.5.0", "scipy==1.17.1", *COMMON],
}
# What computes waves on an NVIDIA card, in a zip of its own: CuPy, and of CUDA what it loads for elementwise functions,
# sums, sorting and FFTs: the compiler with its headers, FFTs, and the linker that these ask for. cuBLAS, cuSOLVER,
# cuSPARSE and cuRAND, which HoloPath calls nothing of, would be another gigabyte. CuPy 14 takes NumPy 2 alone.
CUDA = (
    "nvidia_cuda_nvrtc_cu12==12.9.86",
    "nvidia_cuda_runtime_cu12==12.9.79",
    "nvidia_cufft_cu12==11.4.1.4",
    "nvidia_nvjitlink_cu12==12.9.86",
)
CARD = "card-"  # before the Python
CARDS = {
    CARD + "3.11": ["cupy_cuda12x==13.6.0", "fastrlock==0.8.4", *CUDA],
    CARD + "3.13": ["cupy_cuda12x==14.2.0", "cuda_pathfinder==1.9.1", *CUDA],
    CARD + "3.14": ["cupy_cuda12x==14.2.0", "cuda_pathfinder==1.9.1", *CUDA],
}
# Not installed as they are. `llvm`: its package asks for a Python of 3.12 or newer, and its library for none.
# `cpp_library`: Microsoft's package installs a library where Blender would not find it.
# `xatlas`: the source, the library that binds it to Python, and the compiler.
LLVM, CPP, XATLAS = "llvm", "cpp", "xatlas"
WHEELS = {
    **PYTHONS,
    **CARDS,
    LLVM: ["llvm_nanobind==21.1.6.3"],
    CPP: ["msvc_runtime==14.44.35112"],
    XATLAS: ["xatlas==0.0.11", "pybind11==3.1.0", "ziglang==0.16.0"],
}
ONLY_FOR = {CPP: ["windows-x64"], XATLAS: ["linux-x64"]} | dict.fromkeys(CARDS, ["linux-x64", "windows-x64"])

RENEW = "python -m distribution lock"
LOCK_HEADER = f"""\
# The wheels in HoloPath's zips, their SHA-256 first; written by `{RENEW}`.
# Check those on disk with: cd build/wheels && sha256sum --check ../../wheels.lock
"""


def names_of(platform):
    """Keys of `WHEELS` whose wheels a platform's zips are made of."""
    return [name for name in WHEELS if platform in ONLY_FOR.get(name, [platform])]


def renew_lock(folder=KEPT):
    """Fetch the wheels for all platforms anew into `folder`, and write what they are to the lock."""
    lines = []
    for platform in PIP_PLATFORMS:
        for name in names_of(platform):
            target = folder / platform / name
            shutil.rmtree(target, ignore_errors=True)
            fetch(platform, name, target, WHEELS[name])
            fetched = [path for path in sorted(target.iterdir()) if path.suffix in (".whl", ".gz")]
            lines += [f"{sha256(path)}  {platform}/{name}/{path.name}\n" for path in fetched]
    unfinished = LOCK.with_name(f".unfinished-{LOCK.name}")
    unfinished.write_text(LOCK_HEADER + "".join(lines), encoding="utf-8", newline="\n")
    os.replace(unfinished, LOCK)


def locked(platform, name):
    """SHA-256 of each wheel that the lock has for a platform and a key of `WHEELS`, by its file name."""
    hashes = {}
    for line in LOCK.read_text(encoding="utf-8").splitlines():
        if line and not line.startswith("#"):
            digest, path = line.split()
            if path.startswith(f"{platform}/{name}/"):
                hashes[path.rsplit("/", 1)[1]] = digest
    if {pin_of(wheel) for wheel in hashes} != set(WHEELS[name]):
        raise SystemExit(
            f"distribution: {LOCK.name} has other wheels for {platform}/{name} than WHEELS asks for: "
            f"renew it with `{RENEW}`."
        )
    return hashes


def pin_of(wheel):
    """``name==version`` of the file name of a wheel, or of a source distribution."""
    return "==".join(wheel.removesuffix(".tar.gz").split("-")[:2])


def locked_wheels(platform, name, folder=KEPT):
    """Paths of the wheels in the lock, fetched into `folder` where they are missing."""
    hashes = locked(platform, name)
    target = folder / platform / name
    if not all((target / wheel).exists() for wheel in hashes):
        fetch(platform, name, target, [f"{pin_of(n)} --hash=sha256:{h}" for n, h in hashes.items()])
    for wheel, digest in hashes.items():
        if sha256(target / wheel) != digest:
            raise SystemExit(
                f"distribution: {target / wheel} has another SHA-256 than in {LOCK.name}: delete it and build again."
            )
    return [target / wheel for wheel in sorted(hashes)]


def fetch(platform, name, target, requirements):
    """Have pip download wheels into `target`; `requirements` are lines as in a requirements file."""
    target.mkdir(parents=True, exist_ok=True)
    listed = target / "requirements.txt"
    listed.write_text("\n".join(requirements), encoding="utf-8")
    python = name.removeprefix(CARD)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    command += [
        "--no-deps",
        "--only-binary",
        ":all:",
        *(["--no-binary", "xatlas"] if name == XATLAS else []),
        "--python-version",
        python if python in PYTHONS else "3.13",
    ]
    for tag in PIP_PLATFORMS[platform]:
        command += ["--platform", tag]
    command += ["--requirement", listed, "--dest", target]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        errors = [line for line in result.stderr.splitlines() if line.startswith("ERROR: ")]
        said = (errors or [f"ERROR: status {result.returncode}"])[-1].removeprefix("ERROR: ")
        raise SystemExit(
            f"distribution: pip cannot bring the wheels of {LOCK.name} for {platform}/{name} ({said}): "
            f"check the connection and the package index, or renew the lock with `{RENEW}`."
        )


def install(path):
    """Have pip install a wheel into the environment that runs this."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"]
    subprocess.run([*command, "--no-deps", "--force-reinstall", path], check=True)


def this_platform():
    """The name of this computer's in `PIP_PLATFORMS`."""
    here = system.system(), system.machine()
    if here not in SYSTEMS:
        raise SystemExit(
            f"distribution: no LLVM for {' '.join(here)} is among the wheels: install LLVM 19 or newer by the "
            "system's own means."
        )
    return SYSTEMS[here]


def sha256(path):
    """Of a file, in hexadecimal."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def entry(name, method=zipfile.ZIP_STORED):
    """A file in an archive that depends on no clock and no system."""
    info = zipfile.ZipInfo(name, date_time=(1980, 1, 1, 0, 0, 0))
    info.create_system = 3  # Unix, wherever it is built
    info.external_attr = 0o644 << 16
    info.compress_type = method
    return info


@contextmanager
def writing(target, packed):
    """Write a wheel, by a function that takes the name and the content of each file; its RECORD comes last.

    It stands under its name only when it is complete. Packed is by LZMA, which takes a minute and a third less than
    Deflate does for LLVM; else not at all.
    """
    method = zipfile.ZIP_LZMA if packed else zipfile.ZIP_STORED
    target.parent.mkdir(parents=True, exist_ok=True)
    unfinished = target.with_name(f".unfinished-{target.name}")
    record = []
    try:
        with zipfile.ZipFile(unfinished, "w", method) as archive:

            def add(name, data):
                archive.writestr(entry(name, method), data)
                digest = base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
                record.append((name, f"sha256={digest}", len(data)))

            yield add
            (about,) = {name.split("/")[0] for name, *_ in record if ".dist-info/" in name}
            rows = io.StringIO()
            csv.writer(rows, lineterminator="\n").writerows([*record, (f"{about}/RECORD", "", "")])
            archive.writestr(entry(f"{about}/RECORD", method), rows.getvalue())
        os.replace(unfinished, target)
    finally:
        unfinished.unlink(missing_ok=True)
