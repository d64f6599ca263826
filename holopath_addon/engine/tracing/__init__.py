"""Grains of light, and their waves on recording planes."""
