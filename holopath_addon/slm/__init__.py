"""Spatial light modulators: drivers, calibration, streaming and focus control. Imports no bpy."""
