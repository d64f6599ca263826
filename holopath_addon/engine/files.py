"""Files and folders that appear only when they are complete, and a check of pictures."""

from __future__ import annotations

import errno
import os
import re
import secrets
import shutil
import signal
import struct
import tempfile
import threading
import time
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import FolderInUse, InvalidInput

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

TEMPORARY = re.compile(r"\.(.+)\.(part|old)-[^.]+")  # names of unfinished and of replaced folders and files
FOLDER_EXISTS = (
    errno.EEXIST,
    errno.ENOTEMPTY,
)  # of a rename to an existing folder; Windows denies access instead
# Left by file browsers in folders that they show, and by macOS beside files on disks of other systems.
BROWSER_FILES = (".DS_Store", "Thumbs.db", "desktop.ini", "._*")
IN_USE = (
    5,
    32,
    33,
)  # Windows' errors of renames while another program has the file, or one in the folder, open
RENAME_TIMEOUT = 10.0  # seconds in which such a program, a virus scanner for one, may finish
MARKER = (
    ".begun"  # file in an unfinished folder; a folder that `sweep` removed and that was made again lacks it
)


@contextmanager
def whole_folder(folder: Path | str, check: Callable[[Path], None]) -> Iterator[Path]:
    """Temporary folder to fill, which replaces `folder` when the block succeeds and is removed otherwise.

    Parameters
    ----------
    folder : path
        Final place; an existing folder stays there until it is replaced.
    check : callable
        ``check(folder)`` raises `InvalidInput` if the existing folder must not be replaced. It is called at once and
        again at the end.

    Yields
    ------
    pathlib.Path
        A hidden folder beside the final place.

    Raises
    ------
    InvalidInput
        At once, if the folder must not be replaced or cannot be created.
    FolderInUse
        At the end, if another program has something in the folder open; the new one stays beside it.
    OSError
        If it cannot be written.
    """
    folder = Path(folder).absolute()
    check(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = new_folder(folder.parent, f".{folder.name}.part-")
    except OSError as error:
        raise InvalidInput(
            f"The output folder {folder} cannot be made ({error.strerror}). Choose another one."
        ) from error
    try:
        marker = part / MARKER
        marker.touch()
        yield part
        marker.unlink()  # fails if another process took this one for dead, see `sweep`
        os.chmod(part, 0o755)
        check(folder)
        try:
            _put_in_place(part, folder)
        except PermissionError as error:
            if not _is_in_use(error):
                raise
            made, part = part, None
            kept = _kept_beside(made, folder)
            raise FolderInUse(
                f"{folder} cannot be replaced ({error.strerror}). What was made is in {kept}: close programs that use "
                "either, and rename it."
            ) from error
    except BaseException:
        with _uninterrupted():
            _remove(part)
        raise


def _kept_beside(part, folder):
    """Give a finished folder that cannot take its place a visible name, if it can be renamed; its path."""
    names = (f"{folder.name}-new{number or ''}" for number in count())
    kept = next(path for path in map(folder.with_name, names) if not os.path.lexists(path))
    try:
        rename(part, kept)
    except OSError:
        return part
    return kept


def overwrite_check(kind: str, *files, others: Sequence[str] = ()) -> Callable[[Path], None]:
    """Check for `whole_folder` that allows to replace an empty folder, or one with certain files and no others.

    Parameters
    ----------
    kind : str
        Contents of such a folder, for the message.
    *files : str
        Names of the files.
    others : sequence of str
        Patterns of names of files that may also be there.
    """
    known = [*files, *BROWSER_FILES, *others]

    def check(folder):
        if not os.path.lexists(folder):
            return
        names = {entry.name for entry in folder.iterdir()} if folder.is_dir() else {""}
        if names and not names.issuperset(files):
            raise InvalidInput(f"{folder} holds something other than {kind}. Choose another folder.")
        unknown = sorted(name for name in names if not _matches(name, known))
        if unknown:
            raise InvalidInput(
                f"{folder} holds {unknown[0]} beside {kind}, which would be lost. Move it, or choose "
                "another folder."
            )

    return check


def is_of_browser(name: str) -> bool:
    """Whether a file of that name is a file browser's."""
    return _matches(name, BROWSER_FILES)


def _matches(name, patterns):
    return any(fnmatchcase(name, pattern) for pattern in patterns)


def new_folder(parent: Path, prefix: str) -> Path:
    """Create a folder of a random name, which others may read as they may its parent.

    On Windows they may not read one of `tempfile.mkdtemp`, nor what is moved out of it.

    Parameters
    ----------
    parent : path
    prefix : str
        Beginning of the name.
    """
    while True:
        path = Path(parent) / f"{prefix}{secrets.token_hex(4)}"
        with suppress(FileExistsError):
            path.mkdir()
            return path


def _is_in_use(error):
    return getattr(error, "winerror", None) in IN_USE


def rename(source: Path, target: Path) -> None:
    """Rename as `os.replace`; where Windows refuses it as long as another program uses something in it, wait a while.

    Raises
    ------
    OSError
    """
    end = time.monotonic() + RENAME_TIMEOUT
    while True:
        try:
            return os.replace(source, target)
        except PermissionError as error:
            if not _is_in_use(error) or target.is_dir() or time.monotonic() > end:
                raise
            time.sleep(0.1)


@contextmanager
def whole_file(file: Path, owner: Path | None = None) -> Iterator[Path]:
    """Temporary file to write, which replaces `file` when the block succeeds and is removed otherwise.

    Parameters
    ----------
    file : path
        Final place.
    owner : path, optional
        Path that the temporary file lies beside and whose `sweep` removes it. Default: the file.

    Yields
    ------
    pathlib.Path
        An empty hidden file beside the owner.

    Raises
    ------
    InvalidInput
        At once, if the file cannot be created.
    OSError
        If it cannot be written.
    """
    owner = owner or file
    try:
        owner.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{owner.name}.part-", dir=owner.parent)
    except OSError as error:
        raise InvalidInput(f"{file} cannot be made ({error.strerror}). Choose another place.") from error
    os.close(handle)
    part = Path(name)
    try:
        yield part
        os.chmod(part, 0o644)
        rename(part, file)
    except BaseException:
        with _uninterrupted(), suppress(OSError):
            part.unlink()
        raise


@contextmanager
def _uninterrupted():
    """Ignore Ctrl-C in the main thread while the block runs: a second one would leave the removal half done."""
    handler = signal.getsignal(signal.SIGINT)
    if (
        handler is None or threading.current_thread() is not threading.main_thread()
    ):  # None: not set by Python
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def unfinished(folder: Path) -> set[str]:
    """Names in a folder that have temporary files beside them, left by a killed process or in use by a running one."""
    matches = (TEMPORARY.fullmatch(path.name) for path in folder.iterdir())
    return {match[1] for match in matches if match}


def sweep(path: Path) -> None:
    """Remove temporary files of a killed process beside a path; a replaced folder returns if its place is empty.

    Parameters
    ----------
    path : path
        No other process may be at work on it.
    """
    for remnant in list(path.parent.iterdir()):
        match = TEMPORARY.fullmatch(remnant.name)
        if match is None or match[1] != path.name:
            continue
        if match[2] == "old" and not os.path.lexists(path):
            with suppress(OSError):
                os.replace(remnant / path.name, path)
        trash = new_folder(path.parent, f".{path.name}.part-")
        with suppress(OSError):  # another process has just put it in its place, or removed it
            os.replace(remnant, trash / remnant.name)
        _remove(trash)


def _put_in_place(part, folder):
    """Replace a folder. When several processes do so at once, each has its turn and the last one's stays."""
    while True:
        backup = _move_away(folder)  # Windows cannot rename to an existing folder
        try:
            rename(part, folder)
        except BaseException as error:
            # another process was faster
            if isinstance(error, OSError) and (error.errno in FOLDER_EXISTS or folder.exists()):
                _remove(backup)
                continue
            if backup is not None:
                with suppress(OSError):  # a backup that cannot be restored stays beside
                    os.replace(backup / folder.name, folder)
                    backup.rmdir()
            raise
        _remove(backup)
        return


def _move_away(folder):
    """Move a folder into a new hidden one beside it, and return that; None if there was no folder."""
    if not folder.exists():
        return None
    backup = new_folder(folder.parent, f".{folder.name}.old-")
    try:
        rename(folder, backup / folder.name)
    except BaseException as error:
        backup.rmdir()
        if isinstance(error, FileNotFoundError):  # another process moved it away
            return None
        raise
    return backup


def _remove(folder):
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)


def check_palette(path: Path, pixels: np.ndarray) -> None:
    """Refuse a BMP file whose `pixels` are not levels of gray, but indices of a palette, as Mitsuba reads them.

    Raises
    ------
    InvalidInput
    """
    with open(path, "rb") as file:
        head = file.read(54)
        _, size = struct.unpack_from("<II", head, 10)
        (bits,) = struct.unpack_from("<H", head, 28)
        file.seek(14 + size)
        palette = np.frombuffer(file.read(1024), np.uint8)
    if bits <= 8:
        colors = palette[: len(palette) // 4 * 4].reshape(-1, 4)[:, :3]
        if pixels.max() >= len(colors) or (colors != np.arange(len(colors))[:, None]).any():
            raise InvalidInput(f"{path} has a palette of colors. Write it as a gray or RGB picture.")
