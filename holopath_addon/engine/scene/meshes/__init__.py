"""Meshes of a scene: those that nothing tells apart are joined."""
