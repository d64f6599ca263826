"""Folders that appear only when they are complete."""

import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

from .errors import InvalidInput


@contextmanager
def whole_folder(folder, kind, marker="meta.json"):
    """Folder to fill; it takes the place of `folder` when the block ends well, and vanishes otherwise.

    Parameters
    ----------
    folder : path
    kind : str
        What it will hold, for the message.
    marker : str
        File by which an earlier one is recognised, which is replaced.

    Yields
    ------
    pathlib.Path
        A hidden folder beside it.

    Raises
    ------
    InvalidInput
        If the folder holds something else.
    OSError
        If it cannot be written.
    """
    folder = Path(folder)
    if folder.exists() and any(folder.iterdir()) and not (folder / marker).exists():
        raise InvalidInput(f"The folder {folder} holds something other than {kind}: choose another one.")
    folder.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    try:
        yield part
        os.chmod(part, 0o755)
        if folder.exists():
            shutil.rmtree(folder)
        os.replace(part, folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
