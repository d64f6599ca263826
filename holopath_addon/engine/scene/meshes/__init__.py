"""Meshes of a scene: which of them become one."""
