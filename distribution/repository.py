"""A folder of static files that Blender takes as a repository: the zips, and its own index of them."""

from .extension import CARD_MANIFEST, blenders_own, declared


def publish(folder, version):
    """Write ``index.json`` and ``index.html`` of the zips in a folder by Blender's own program.

    Each Blender takes the zip for its platform and its Python. Of several versions it would take any, so HoloPath's
    zips of others are deleted first, and those for cards that are not of their manifest's version.

    Parameters
    ----------
    folder : Path
    version : str
        Of the zips to keep.
    """
    for_cards = declared(CARD_MANIFEST)
    for name, kept in (("holopath", version), (for_cards["id"], for_cards["version"])):
        for path in folder.glob(f"{name}-*.zip"):
            if not path.name.startswith(f"{name}-{kept}-"):
                path.unlink()
    blenders_own("server-generate", "--repo-dir", folder, "--html")
