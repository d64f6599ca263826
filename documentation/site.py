"""The site, by Sphinx."""

import shutil
from pathlib import Path

from sphinx.cmd.build import build_main

ROOT = Path(__file__).parents[1]


def build(folder: Path) -> int:
    """Make the site of docs/ and of the pages beside it.

    Parameters
    ----------
    folder : Path
        Where its files go, in place of those of the last time; what Sphinx reads of the pages lies beside it.

    Returns
    -------
    int
        0 if nothing was to be warned of.
    """
    shutil.rmtree(folder, ignore_errors=True)  # else pages that are gone would stay
    kept = folder.with_name(f"{folder.name}-kept")
    strict = ["--quiet", "--fail-on-warning", "--keep-going", "--fresh-env"]
    return build_main([*strict, "-c", str(Path(__file__).parent), "-d", str(kept), str(ROOT), str(folder)])
