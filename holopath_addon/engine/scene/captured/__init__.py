"""Scenes that were captured, not modeled: a picture with depth, and points with colors."""
