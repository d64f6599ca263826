"""A repository on a web server: a fresh Blender installs, updates and removes the extension."""

import functools
import http.server
import re
import threading

import pytest

from distribution import extension, llvm, repository
from distribution.wheels import KEPT, locked_wheels, this_platform
from tests.in_blender.conftest import BLENDER
from tests.real_blender import Blender, python_of

pytestmark = [pytest.mark.blender, pytest.mark.slow]

NAME = "bl_ext.holopath_test.holopath"
TELL = f"""
import sys, tomllib
from pathlib import Path
module = sys.modules.get("{NAME}")
version = module and tomllib.loads((Path(module.__file__).parent / "blender_manifest.toml").read_text())["version"]
print("version", version)
"""


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


@pytest.fixture
def server(tmp_path):
    """A folder and its address."""
    folder = tmp_path / "repository"
    folder.mkdir()
    handler = functools.partial(Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield folder, f"http://127.0.0.1:{server.server_port}/index.json"
        server.shutdown()
        thread.join()


def put(folder, python, version, monkeypatch, tmp_path):
    """Put the extension there as this version."""
    manifest = tmp_path / "blender_manifest.toml"
    text = (extension.ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    manifest.write_text(re.sub(r'(?m)^version = ".*"', f'version = "{version}"', text), encoding="utf-8")
    monkeypatch.setattr(extension, "MANIFEST", manifest)
    platform = this_platform()
    library = llvm.wheel(platform, tmp_path / "wheels", KEPT, packed=False)
    extension.build(platform, python, [*locked_wheels(platform, python), library], folder)
    repository.publish(folder, version)


def test_installs_updates_and_removes(tmp_path, server, monkeypatch):
    folder, address = server
    blender = Blender(tmp_path / "user", [BLENDER])

    def run(*arguments):
        status, output = blender("--online-mode", *arguments)
        assert status == 0, output
        return output

    def version():
        return re.search(r"^version (\S+)$", run("--background", "--python-expr", TELL), re.MULTILINE)[1]

    python = python_of(blender)
    put(folder, python, "0.0.1", monkeypatch, tmp_path)
    run("--command", "extension", "repo-add", "--url", address, "holopath_test")
    run("--command", "extension", "install", "--sync", "--enable", "holopath")
    assert version() == "0.0.1"
    assert "HoloPath's own" in run("--command", "holopath", "devices")

    put(folder, python, "0.0.2", monkeypatch, tmp_path)
    run("--command", "extension", "update", "--sync")
    assert version() == "0.0.2"

    run("--command", "extension", "remove", "holopath")
    assert version() == "None"
    left = [path for path in (tmp_path / "user" / "extensions").rglob("*") if path.is_file()]
    blenders_own = {".blender_ext", ".cache"}  # its copy of the index, and what it knows of each extension
    assert [path for path in left if path.parent.name not in blenders_own] == []
