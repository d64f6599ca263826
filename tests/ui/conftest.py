"""HoloPath in Blender."""

from tests.addon import addon, lit, scene  # noqa: F401 (fixtures)
