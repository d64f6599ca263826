"""Workflow that Blender and the command line share: a hologram with its images, its folder, and messages."""
