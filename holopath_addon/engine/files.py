"""Folders that appear only when they are complete."""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


@contextmanager
def whole_folder(folder: Path | str, check: Callable[[Path], None]) -> Iterator[Path]:
    """Folder to fill; it takes the place of `folder` when the block ends well, and vanishes otherwise.

    Parameters
    ----------
    folder : path
        What is there stays until it is replaced.
    check : callable
        ``check(folder)`` raises `InvalidInput` where what is there must not be replaced; called at once and
        again at the end.

    Yields
    ------
    pathlib.Path
        A hidden folder beside it.

    Raises
    ------
    InvalidInput
        At once if the folder must not be replaced or cannot be made.
    OSError
        If it cannot be written.
    """
    folder = Path(folder).absolute()
    check(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{folder.name}.part-", dir=folder.parent))
    except OSError as error:
        raise InvalidInput(
            f"The output folder {folder} cannot be made ({error.strerror}): choose another one."
        ) from error
    try:
        yield part
        os.chmod(part, 0o755)
        check(folder)
        _put_in_place(part, folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def earlier(kind: str, *files) -> Callable[[Path], None]:
    """Check for `whole_folder`: nothing is replaced but an empty folder, or one that has such files.

    Parameters
    ----------
    kind : str
        What such a folder holds, for the message.
    *files : str
        Names.
    """

    def check(folder):
        if not os.path.lexists(folder):
            return
        names = {entry.name for entry in folder.iterdir()} if folder.is_dir() else {""}
        if names and not names.issuperset(files):
            raise InvalidInput(f"{folder} holds something other than {kind}: choose another folder.")

    return check


def _put_in_place(part, folder):
    if not folder.exists():
        os.replace(part, folder)
        return
    beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old-", dir=folder.parent))
    old = beside / folder.name  # Windows puts no folder in the place of another
    try:
        os.replace(folder, old)
        try:
            os.replace(part, folder)
        except BaseException:
            os.replace(old, folder)
            raise
    except BaseException:
        with suppress(OSError):
            beside.rmdir()  # unless it holds what could not be put back
        raise
    shutil.rmtree(beside, ignore_errors=True)
