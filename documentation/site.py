"""The site, by Sphinx."""

from pathlib import Path

from sphinx.cmd.build import build_main

ROOT = Path(__file__).parents[1]


def build(folder: Path) -> int:
    """Make the site of docs/ and of the pages beside it.

    Parameters
    ----------
    folder : Path
        Where its files go; what Sphinx keeps for the next time lies beside it.

    Returns
    -------
    int
        0 if nothing was to be warned of.
    """
    kept = folder.with_name(f"{folder.name}-kept")
    strict = ["--quiet", "--fail-on-warning", "--keep-going", "--fresh-env"]
    return build_main([*strict, "-c", str(Path(__file__).parent), "-d", str(kept), str(ROOT), str(folder)])
