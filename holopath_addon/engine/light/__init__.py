"""Incoherent light: paths, and what is baked of it for all views."""
