"""A real Blender, named by HOLOPATH_BLENDER, with the built extension."""

import os

import pytest

from tests.real_blender import Blender, install

BLENDER = os.environ.get("HOLOPATH_BLENDER", "")


@pytest.fixture(scope="session", autouse=True)
def there_is_one():
    if not BLENDER:
        pytest.skip("HOLOPATH_BLENDER names no Blender")


@pytest.fixture(scope="session")
def blender(tmp_path_factory):
    """A Blender with the extension installed from its zip and enabled; for all tests, which leave it there."""
    folder = tmp_path_factory.mktemp("blender")
    blender = Blender(folder / "user", [BLENDER])
    install(blender, folder)
    return blender
