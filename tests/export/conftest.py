"""An empty Blender file for every test, and the same scene rendered by Cycles and by Mitsuba."""

import os
import tempfile

import pytest

os.environ.setdefault("BLENDER_USER_RESOURCES", tempfile.mkdtemp(prefix="holopath-test-"))
bpy = pytest.importorskip("bpy")

from benchmarks.stage import Stage  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def alone(one_thread):
    """No test here has Mitsuba read or write an OpenEXR file."""


@pytest.fixture
def stage():
    """An empty scene with a camera at the origin's +z, looking down, and shortcuts to fill it."""
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_empty=True)
    return Stage()


@pytest.fixture
def small_worlds(monkeypatch):
    """Worlds baked to pictures coarser than users have them, so further from Cycles, if anything."""
    from holopath_addon.export import world

    monkeypatch.setattr(world, "WIDTH", 512)
    monkeypatch.setattr(world, "HEIGHT", 256)
