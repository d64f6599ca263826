"""What a folder's work is asked to be, on disk beside it: whoever joins in finds the same, or is refused."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path

from ..engine import InvalidInput, files
from . import processes
from .claims import FOLDER, Claims

NAME = "job.json"
FORMAT = "HoloPath job"
FORMAT_VERSION = 1
_DOOR = ".job"  # claim of whoever reads and writes the file
_PHASES = "phases "  # begins the tag of who makes them


@dataclass(frozen=True)
class SharedJob:
    """All that decides the results in a folder.

    Attributes
    ----------
    scene : str
        File name of a .blend, which is among the files, or ``demo:NAME``.
    words : dict
        JSON-able: what was asked for, but for what leaves results as they are.
    files : dict of str to str
        SHA-256 of each file that the scene is made of, by its name there; empty of a file that is not there.
    versions : dict of str to str
        Of the programs.
    unfinished : frozenset of str
        Names of units that were begun and are not known to be done. They decide nothing.
    """

    scene: str
    words: dict
    files: dict[str, str]
    versions: dict[str, str]
    unfinished: frozenset[str] = field(default=frozenset(), compare=False)

    @cached_property
    def digest(self) -> str:
        """Of all that decides the results."""
        decides = [self.scene, self.words, self.files, self.versions]
        return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()

    @property
    def tag(self) -> str:
        """What its claims say that a process works for, see `claims.Claims`."""
        return self.digest

    @contextmanager
    def join(self, folder: Path | str, names: Iterable[str] = ()) -> Iterator[None]:
        """Work on this job in a folder while the block runs, and nobody on another one.

        Parameters
        ----------
        folder : path
            Made if it does not exist; gone again where the block fails before anything is in it.
        names : iterable of str
            Units that are done when the block ends well.

        Raises
        ------
        InvalidInput
            If others work there on another job, or what was begun there needs other versions or files.
        OSError
        """
        folder, names = Path(folder), frozenset(names)
        with _entered(folder) as door, ExitStack() as inside:
            with door.wait(_DOOR):
                files.sweep(folder / NAME)
                begun = job_of(folder)
                if begun is None or begun != self:  # else all who work here were let in by this very job
                    self._check(folder, begun, self._others(door))
                    self._write(folder, names)
                elif not names <= begun.unfinished:
                    self._write(folder, names | begun.unfinished)
                inside.enter_context(Claims(folder, self.tag))
            try:
                yield
            except BaseException:
                with suppress(OSError):
                    if set(os.listdir(folder)) <= {NAME, FOLDER}:
                        (folder / NAME).unlink()
                raise
            if (
                job_of(folder) or self
            ).unfinished & names:  # of all that end at once the first one strikes them out
                with door.wait(_DOOR):
                    self._write(folder, (job_of(folder) or self).unfinished - names)

    def _others(self, door):
        """Claims of who works for another job."""
        return {name: claim for name, claim in door.holders().items() if claim.tag not in ("", self.tag)}

    def _check(self, folder, begun, others):
        if begun is not None:
            self._check_programs_and_files(folder, begun, bool(others or begun.unfinished))
        if others:
            if all(claim.tag.startswith(_PHASES) for claim in others.values()):
                done = f"is being encoded by {_told(others)}"
            else:
                what = "other settings" if begun and self._same_scene(begun) else "another scene"
                done = f"is being rendered by {_told(others, what)}"
            raise InvalidInput(f"{folder} {done}: wait, or choose another folder.")

    def _check_programs_and_files(self, folder, begun, unfinished):
        """Results of the same words come from the same programs and files."""
        goes_on = unfinished and begun.words == self.words and begun.scene == self.scene
        for name in sorted(begun.versions.keys() | self.versions.keys()) if goes_on else ():
            there, here = begun.versions.get(name), self.versions.get(name)
            if there != here:
                raise InvalidInput(
                    f"{folder} was begun with {name} {there}, and {processes.host()} has {here}: go on with the same "
                    "version, or choose another folder."
                )
        if not self._same_scene(begun):
            return  # saved anew: what is stale is made anew
        for name in sorted(begun.files.keys() | self.files.keys()):
            there, here = begun.files.get(name), self.files.get(name)
            if there and not here:
                raise InvalidInput(
                    f"{folder} was begun with the file {name}, which is missing on {processes.host()}: copy it there, "
                    "or choose another folder."
                )
            if goes_on and there != here:
                raise InvalidInput(
                    f"{folder} was begun with another file {name} than {processes.host()} has: make them the same, or "
                    "choose another folder."
                )

    def _same_scene(self, other):
        return other.scene == self.scene and other.files.get(self.scene) == self.files.get(self.scene)

    def _write(self, folder, unfinished):
        told = {"format": FORMAT, "format_version": FORMAT_VERSION, "digest": self.digest, **asdict(self)}
        told["unfinished"] = sorted(unfinished)
        with files.whole_file(folder / NAME) as part:
            part.write_text(json.dumps(told, indent=1) + "\n")


class EncodingJob(SharedJob):
    """All that decides the phases of frames that are there.

    It keeps no record in the folder, as each frame's phases tell of which job they are. Frames may be rendered
    meanwhile: of each frame the one waits for the other.
    """

    @property
    def tag(self) -> str:
        return f"{_PHASES}{self.digest}"

    @contextmanager
    def join(self, folder: Path | str, names: Iterable[str] = ()) -> Iterator[None]:
        """Work on this job in a folder while the block runs, and nobody on other phases; see `SharedJob.join`."""
        with _entered(Path(folder)) as door, ExitStack() as inside:
            with door.wait(_DOOR):
                others = {n: c for n, c in self._others(door).items() if c.tag.startswith(_PHASES)}
                if others:
                    raise InvalidInput(
                        f"{folder} is being encoded by {_told(others)} with other words, files or versions: wait, or "
                        "give the same."
                    )
                inside.enter_context(Claims(folder, self.tag))
            yield


def _told(claims, what=""):
    """Who works, with what, and on which units."""
    hosts = " and ".join(sorted({claim.host for claim in claims.values()}))
    names = ", ".join(name for name in claims if name[0] != ".")
    return f"{hosts}{what and f' with {what}'}{names and f' ({names})'}"


@contextmanager
def _entered(folder):
    """Claims for no job yet, in a folder that is made; it goes again if it is empty at the end."""
    try:
        with ExitStack() as inside:
            try:
                claims = inside.enter_context(Claims(folder, ""))
            except OSError as error:
                raise InvalidInput(
                    f"The output folder {folder} cannot be made ({error.strerror}): choose another one."
                ) from error
            yield claims
    finally:
        with suppress(OSError):
            folder.rmdir()


def job_of(folder: Path) -> SharedJob | None:
    """The job that a folder's work belongs to; None where there is none.

    Raises
    ------
    InvalidInput
        If its file is broken.
    """
    file = folder / NAME
    try:
        told = json.loads(file.read_text())
        if told["format"] != FORMAT:
            raise ValueError
        parts = {name: dict(told[name]) for name in ("words", "files", "versions")}
        return SharedJob(str(told["scene"]), **parts, unfinished=frozenset(told["unfinished"]))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError) as error:
        raise InvalidInput(f"{file} is not HoloPath's: choose another folder.") from error


def digests(paths: dict[str, Path]) -> dict[str, str]:
    """SHA-256 of files by their names, as `SharedJob` takes them.

    Raises
    ------
    InvalidInput
        If one that is there cannot be read.
    """
    found = {}
    for name, path in sorted(paths.items()):
        try:
            with open(path, "rb") as stream:
                found[name] = hashlib.file_digest(stream, "sha256").hexdigest()
        except FileNotFoundError:
            found[name] = ""
        except OSError as error:
            raise InvalidInput(
                f"The file {path} cannot be read ({error.strerror}): the scene is made of it."
            ) from error
    return found
