"""A folder of static files that Blender takes as a repository: the zips, and its own index of them."""

from .extension import blenders_own


def publish(folder, zips):
    """Write ``index.json`` and ``index.html`` of the zips in a folder by Blender's own program.

    Each Blender takes the zip for its platform and its Python. Of several versions it would take any, so HoloPath's
    other zips in the folder are deleted first.

    Parameters
    ----------
    folder : Path
    zips : iterable of Path
        In the folder, of one version.
    """
    keep = set(zips)
    for path in folder.glob("holopath-*.zip"):
        if path not in keep:
            path.unlink()
    blenders_own("server-generate", "--repo-dir", folder, "--html")
