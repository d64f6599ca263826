"""Fixtures for all tests.

Blender's user folders are set before anything imports bpy: an installed copy of the extension would otherwise
shadow the working tree. Baked light stays in a folder of the tests.
"""

import atexit
import os
import shutil
import tempfile

import pytest

_user = tempfile.mkdtemp(prefix="holopath-tests-")
atexit.register(shutil.rmtree, _user, ignore_errors=True)
os.environ["BLENDER_USER_RESOURCES"] = _user
os.environ["BLENDER_USER_EXTENSIONS"] = os.path.join(_user, "extensions")
os.environ["HOLOPATH_CACHE"] = os.path.join(_user, "cache")


@pytest.fixture(scope="session")
def backend():
    """Name of the Mitsuba variant, activated for the whole session."""
    from holopath_addon.engine import backend

    return backend.activate()


@pytest.fixture
def empty_scene():
    """The scene of a new Blender file with nothing in it."""
    bpy = pytest.importorskip("bpy")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene
