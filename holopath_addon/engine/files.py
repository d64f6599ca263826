"""Files and folders that appear only when they are complete."""

from __future__ import annotations

import errno
import os
import re
import shutil
import signal
import tempfile
import threading
from contextlib import contextmanager, suppress
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

from .errors import InvalidInput

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

LEFT = re.compile(
    r"\.(.+)\.(part|old)-[^.]+"
)  # names of folders and files that are unfinished, or moved away
TAKEN = (errno.EEXIST, errno.ENOTEMPTY)  # of a rename to where a folder is; Windows says that it is denied
BROWSED = (".DS_Store", "Thumbs.db", "desktop.ini")  # what file browsers leave in folders that they show
BEGUN = ".begun"  # file in an unfinished folder: a folder that was swept away and made again has none


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
        begun = part / BEGUN
        begun.touch()
        yield part
        begun.unlink()  # not there if another process took this one for gone, see `sweep`
        os.chmod(part, 0o755)
        check(folder)
        _put_in_place(part, folder)
    except BaseException:
        with _uninterrupted():
            shutil.rmtree(part, ignore_errors=True)
        raise


def earlier(kind: str, *files, others: Sequence[str] = ()) -> Callable[[Path], None]:
    """Check for `whole_folder`: an empty folder is replaced, and one with such files and no others.

    Parameters
    ----------
    kind : str
        What such a folder holds, for the message.
    *files : str
        Names.
    others : sequence of str
        Patterns of names that may be there, too.
    """
    known = [*files, *BROWSED, *others]

    def check(folder):
        if not os.path.lexists(folder):
            return
        names = {entry.name for entry in folder.iterdir()} if folder.is_dir() else {""}
        if names and not names.issuperset(files):
            raise InvalidInput(f"{folder} holds something other than {kind}: choose another folder.")
        strange = sorted(name for name in names if not any(fnmatchcase(name, each) for each in known))
        if strange:
            raise InvalidInput(
                f"{folder} holds {strange[0]} beside {kind}, which would be lost: move it, or choose "
                "another folder."
            )

    return check


@contextmanager
def whole_file(file: Path, owner: Path | None = None) -> Iterator[Path]:
    """File to write; it takes the place of `file` when the block ends well, and vanishes otherwise.

    Parameters
    ----------
    file : path
    owner : path, optional
        Of what the unfinished file is taken to be a part, and lies beside, see `sweep`. Default: the file.

    Yields
    ------
    pathlib.Path
        An empty hidden file beside the owner.

    Raises
    ------
    InvalidInput
        At once if there can be no file.
    OSError
        If it cannot be written.
    """
    owner = owner or file
    try:
        owner.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{owner.name}.part-", dir=owner.parent)
    except OSError as error:
        raise InvalidInput(f"{file} cannot be made ({error.strerror}): choose another place.") from error
    os.close(handle)
    part = Path(name)
    try:
        yield part
        os.chmod(part, 0o644)
        os.replace(part, file)
    except BaseException:
        with _uninterrupted(), suppress(OSError):
            part.unlink()
        raise


@contextmanager
def _uninterrupted():
    """Ignore Ctrl-C in the main thread while the block runs: a second one would leave half of what is cleared away."""
    handler = signal.getsignal(signal.SIGINT)
    if handler is None or threading.current_thread() is not threading.main_thread():  # None: not of Python
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def unfinished(folder: Path) -> set[str]:
    """Names in a folder beside which a killed process left something, unless one is at work on them."""
    found = (LEFT.fullmatch(path.name) for path in folder.iterdir())
    return {match[1] for match in found if match}


def sweep(path: Path) -> None:
    """Clear away what a killed process left beside a path; what it had moved away is put back where nothing is.

    Parameters
    ----------
    path : path
        Which no other process works on.
    """
    for left in list(path.parent.iterdir()):
        match = LEFT.fullmatch(left.name)
        if match is None or match[1] != path.name:
            continue
        if match[2] == "old" and not os.path.lexists(path):
            with suppress(OSError):
                os.replace(left / path.name, path)
        apart = Path(tempfile.mkdtemp(prefix=f".{path.name}.part-", dir=path.parent))
        with suppress(
            OSError
        ):  # a slow process put it in its place just now, or this one moves it away from there
            os.replace(left, apart / left.name)
        _remove(apart)


def _put_in_place(part, folder):
    """Replace a folder. Of several processes that do so at once each has its turn, and the last one's stays."""
    while True:
        beside = _moved_away(folder)  # Windows puts no folder in the place of another
        try:
            os.replace(part, folder)
        except BaseException as error:
            if isinstance(error, OSError) and (
                error.errno in TAKEN or folder.exists()
            ):  # another one was quicker
                _remove(beside)
                continue
            if beside is not None:
                with suppress(OSError):  # what cannot be put back stays beside
                    os.replace(beside / folder.name, folder)
                    beside.rmdir()
            raise
        _remove(beside)
        return


def _moved_away(folder):
    """Hidden folder that a folder has been moved into; None if there was none."""
    if not folder.exists():
        return None
    beside = Path(tempfile.mkdtemp(prefix=f".{folder.name}.old-", dir=folder.parent))
    try:
        os.replace(folder, beside / folder.name)
    except BaseException as error:
        beside.rmdir()
        if isinstance(error, FileNotFoundError):  # another process moved it away
            return None
        raise
    return beside


def _remove(folder):
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
