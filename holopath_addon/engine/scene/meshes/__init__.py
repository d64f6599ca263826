"""Scenes whose small meshes are joined."""
