"""HoloPath in Blender, and the stage of the exporter's tests."""

from tests.addon import addon, lit, scene  # noqa: F401 (fixtures)
from tests.export.conftest import stage  # noqa: F401 (a fixture)
