"""A folder of static files that Blender takes as a repository: the zips, and its own index of them."""

from .extension import blenders_own


def publish(folder, version):
    """Write ``index.json`` and ``index.html`` of the zips in a folder by Blender's own program.

    Each Blender takes the zip for its platform and its Python. Of several versions it would take any, so HoloPath's
    zips of others are deleted first.

    Parameters
    ----------
    folder : Path
    version : str
        Of the zips to keep.
    """
    for path in folder.glob("holopath-*.zip"):
        if not path.name.startswith(f"holopath-{version}-"):
            path.unlink()
    blenders_own("server-generate", "--repo-dir", folder, "--html")
