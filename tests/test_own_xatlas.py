"""xatlas for a Python without a wheel of it: built from its source, it lays meshes out as PyPI's does."""

import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest

from distribution import extension, wheels, xatlas

LAID_OUT = """
import sys, hashlib
sys.path.insert(0, sys.argv[1])
import numpy as np, xatlas
side = 24
y, x = np.mgrid[:side, :side].astype(np.float32) / side
corners = np.stack([x, y, (x - 0.5) ** 2 * 3 - (y - 0.4) ** 3], -1).reshape(-1, 3)
at = np.arange(side * side, dtype=np.uint32).reshape(side, side)
a, b, c, d = (part.ravel() for part in (at[:-1, :-1], at[1:, :-1], at[:-1, 1:], at[1:, 1:]))
atlas, packing = xatlas.Atlas(), xatlas.PackOptions()
packing.resolution = 256
atlas.add_mesh(corners, np.concatenate([np.stack([a, b, c], -1), np.stack([b, d, c], -1)]))
atlas.generate(pack_options=packing)
print(xatlas.__file__, atlas.width, *[hashlib.sha256(array.tobytes()).hexdigest() for array in atlas.get_mesh(0)])
"""


@pytest.mark.skipif(not xatlas.here(), reason="it is built on Linux, for Linux")
def test_a_python_tells_where_its_headers_are(tmp_path, monkeypatch):
    program = tmp_path / "python3.14"
    program.write_text(f"#!/bin/sh\necho {tmp_path}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert xatlas.headers("3.14") is None  # Debian's Python comes without them
    (tmp_path / "Python.h").touch()
    assert xatlas.headers("3.14") == tmp_path
    monkeypatch.setattr(xatlas, "here", lambda: False)
    assert xatlas.headers("3.14") is None


def test_without_headers_the_zip_goes_without_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(xatlas, "headers", lambda python: None)
    for platform in wheels.PIP_PLATFORMS:
        assert extension._own_xatlas(platform, "3.14", tmp_path) == []
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith(f"{platform}: There is no xatlas ") and "apt install python3.14-dev" in line
    assert extension._own_xatlas("linux-x64", "3.13", tmp_path) == [] and not capsys.readouterr().err


@pytest.mark.slow
def test_it_lays_meshes_out_as_that_of_the_index_does(tmp_path):
    """Bit by bit: built for the Python that runs this, which has both."""
    pytest.importorskip("xatlas")
    include = Path(sysconfig.get_path("include"))
    if not xatlas.here() or not (include / "Python.h").exists():
        pytest.skip("there are no headers of this Python")
    wheel = xatlas.wheel("{}.{}".format(*sys.version_info), include, tmp_path, tmp_path)
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps"]
    subprocess.run([*command, "--target", tmp_path / "site", wheel], check=True)  # which checks its RECORD
    found = []
    for folder in ("none", "site"):
        words = [sys.executable, "-c", LAID_OUT, str(tmp_path / folder)]
        result = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)
        found.append(result.stdout.split())
    assert found[0][0] != found[1][0] and found[1][0].startswith(str(tmp_path))
    assert found[0][1:] == found[1][1:]
