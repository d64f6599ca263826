"""On Windows with a C++ library of 2021 in memory, Dr.Jit, LLVM and Mitsuba load and compute: tried in Wine."""

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import lief
import pytest

from distribution import cpp_library, llvm, proof, wheels
from tests.patience import NEVER

SOURCE = Path(__file__).with_name("old_blender.c")
COMPILER = shutil.which("x86_64-w64-mingw32-gcc")
WINE = shutil.which("wine64") or shutil.which("wine")
# Version 14.29, as Blender 4.2 to 5.0 have it.
OLD = (
    "msvc_runtime==14.29.30133 --hash=sha256:1f1be3e62b94f824a695b5091de56a4e22cc682ba398e066ab4314a5bf43a696"
)
SYSTEM = "msvcp140.dll", "vcruntime140.dll", "vcruntime140_1.dll"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        not WINE or not COMPILER,
        reason="needs Wine and mingw-w64's compiler (Debian: wine64, gcc-mingw-w64-x86-64)",
    ),
]


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The program, and beside it the C++ library and runtime of 2021."""
    folder = tmp_path_factory.mktemp("program")
    requirements = folder / "requirements.txt"
    requirements.write_text(OLD)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
    command += [
        "--python-version=3.10",
        "--platform=win_amd64",
        "--dest",
        folder,
        "--requirement",
        requirements,
    ]
    subprocess.run(command, check=True)
    with zipfile.ZipFile(next(folder.glob("*.whl"))) as archive:
        for name in SYSTEM:
            member = next(n for n in archive.namelist() if n.endswith(f"/data/Scripts/{name}"))
            (folder / name).write_bytes(archive.read(member))
    path = folder / "old_blender.exe"
    subprocess.run([COMPILER, "-O1", SOURCE, "-o", path, "-lpsapi"], check=True)
    return path


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """Dr.Jit's, Mitsuba's and LLVM's wheels for Python 3.11: as PyPI has them, and as they are in the zip."""
    folder = tmp_path_factory.mktemp("packages")
    found = wheels.locked_wheels(cpp_library.PLATFORM, "3.11")
    before = [path for path in found if path.name.startswith(("drjit-", "mitsuba-"))]
    before.append(llvm.wheel(cpp_library.PLATFORM, folder / "llvm", packed=False))
    after = [cpp_library.own(path, folder / "own", packed=False) for path in before]
    for name, paths in {"before": before, "after": after}.items():
        for path in paths:
            zipfile.ZipFile(path).extractall(folder / name)
    return folder


def run(program, packages, prefix):
    """Status and lines of the program."""
    overrides = ",".join(name.removesuffix(".dll") for name in SYSTEM) + "=n;mscoree,mshtml="
    variables = os.environ | {"WINEPREFIX": str(prefix), "WINEDLLOVERRIDES": overrides, "WINEDEBUG": "-all"}
    command = [WINE, program, "Z:" + str(packages).replace("/", "\\")]
    result = subprocess.run(
        command,
        env=variables,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        timeout=NEVER,
        check=False,
    )
    return result.returncode, result.stdout.splitlines()


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    return tmp_path_factory.mktemp("wine")


def test_with_a_cpp_library_of_their_own_they_compute(program, packages, prefix):
    status, lines = run(program, packages / "after", prefix)
    assert (status, lines[-1]) == (0, "done")
    assert f"nanothread's sum {sum(range(1000))}" in lines
    assert f"Dr.Jit's sum {sum(range(1001))}" in lines
    libraries = [line.rsplit("\\", 1)[1] for line in lines if line.startswith("C++ library: ")]
    own = next((packages / "after" / "drjit").glob("cpp*.dll")).name
    assert libraries == ["msvcp140.dll", "msvcp140.dll", own]  # one for Dr.Jit, LLVM and Mitsuba


def test_with_the_old_one_llvm_cannot_be_loaded(program, packages, prefix):
    """Its first lock is taken while it is loaded; this is what the library of their own is for."""
    status, lines = run(program, packages / "before", prefix)
    assert status != 0 and not [line for line in lines if line.startswith("LLVM ")]
    assert lines[-1].startswith("C++ library: ") or lines[-1].startswith(
        "LLVM-C.dll cannot be loaded: error 998"
    )


def test_the_runtime_of_2021_has_what_the_proof_allows(program):
    for name, functions in proof.RUNTIME.items():
        binary = lief.PE.parse(program.with_name(name))
        exported = binary.get_export()
        assert functions <= {entry.name for entry in exported.entries}
