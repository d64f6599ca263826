"""Incoherent light: paths, and light baked for all views."""
