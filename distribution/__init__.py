"""What users install: the extension's zips, the LLVM in them, and the repository that Blender updates from."""
