"""HoloPath renders phase holograms of Blender scenes by wave path tracing.

`holopath_addon.engine` works without Blender on any Mitsuba scene.
"""

from . import llvm_package

llvm_package.set_library_variable()  # before anybody imports Mitsuba


def register():
    """Register everything with Blender; if one part fails, the others are unregistered."""
    from .blender import registration

    registration.register()


def unregister():
    """Undo `register`."""
    from .blender import registration

    registration.unregister()
