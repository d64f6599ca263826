"""The job of a folder, in a file there: processes with another job are refused."""

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
_FILE_CLAIM = ".job"  # of the process that reads and writes the file
_PHASES = "phases "  # prefix of tags of jobs that encode phases


@dataclass(frozen=True)
class SharedJob:
    """A job: every input that affects the results in a folder.

    Attributes
    ----------
    scene : str
        Name of a .blend among the files, or ``demo:NAME``.
    words : dict
        Options of the command that affect the results, as JSON.
    files : dict of str to str
        SHA-256 of each file of the scene, by its name there; empty for a missing file.
    versions : dict of str to str
        Versions of programs.
    unfinished : frozenset of str
        Names of units that were started and may not be done. They do not affect results.
    """

    scene: str
    words: dict
    files: dict[str, str]
    versions: dict[str, str]
    unfinished: frozenset[str] = field(default=frozenset(), compare=False)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of every input that affects the results."""
        inputs = [self.scene, self.words, self.files, self.versions]
        return hashlib.sha256(json.dumps(inputs, sort_keys=True).encode()).hexdigest()

    @property
    def tag(self) -> str:
        """Tag of the job's claims, see `claims.Claims`."""
        return self.digest

    @contextmanager
    def join(self, folder: Path | str, names: Iterable[str] = ()) -> Iterator[None]:
        """Work on this job in a folder within the block, and prevent work on other jobs there.

        Parameters
        ----------
        folder : path
            Created if it does not exist; removed if the block fails while it is empty.
        names : iterable of str
            Units that are done when the block ends without an error.

        Raises
        ------
        InvalidInput
            If others work there on another job, or unfinished work there needs other versions or files.
        OSError
        """
        folder, names = Path(folder), frozenset(names)
        with _enter(folder) as door, ExitStack() as inside:
            with door.wait(_FILE_CLAIM):
                files.sweep(folder / NAME)
                earlier = job_of(folder)
                if earlier is None or earlier != self:  # otherwise all processes here have this job
                    self._check(folder, earlier, self._others(door))
                    self._write(folder, names)
                elif not names <= earlier.unfinished:
                    self._write(folder, names | earlier.unfinished)
                inside.enter_context(Claims(folder, self.tag))
            try:
                yield
            except BaseException:
                with suppress(OSError):
                    if set(os.listdir(folder)) <= {NAME, FOLDER}:
                        (folder / NAME).unlink()
                raise
            # of processes that end at once, the first one removes them
            if (job_of(folder) or self).unfinished & names:
                with door.wait(_FILE_CLAIM):
                    self._write(folder, (job_of(folder) or self).unfinished - names)

    def _others(self, door):
        """Claims of processes with other jobs."""
        return {name: claim for name, claim in door.holders().items() if claim.tag not in ("", self.tag)}

    def _check(self, folder, earlier, others):
        if earlier is not None:
            self._check_programs_and_files(folder, earlier, bool(others or earlier.unfinished))
        if others:
            if all(claim.tag.startswith(_PHASES) for claim in others.values()):
                activity = f"is being encoded by {_describe(others)}"
            else:
                difference = "other settings" if earlier and self._same_scene(earlier) else "another scene"
                activity = f"is being rendered by {_describe(others, difference)}"
            raise InvalidInput(f"{folder} {activity}. Wait, or choose another folder.")

    def _check_programs_and_files(self, folder, earlier, unfinished):
        """Refuse to mix results of the same words from different programs or files."""
        goes_on = unfinished and earlier.words == self.words and earlier.scene == self.scene
        for name in sorted(earlier.versions.keys() | self.versions.keys()) if goes_on else ():
            there, here = earlier.versions.get(name), self.versions.get(name)
            if there != here:
                raise InvalidInput(
                    f"{folder} was started with {name} {there}, but {processes.host()} has {here}. Use the same "
                    "version, or choose another folder."
                )
        if not self._same_scene(earlier):
            return  # the scene was saved again: stale results are replaced
        for name in sorted(earlier.files.keys() | self.files.keys()):
            there, here = earlier.files.get(name), self.files.get(name)
            if there and not here and earlier.words == self.words:
                raise InvalidInput(
                    f"{folder} was started with the file {name}, which is missing on {processes.host()}. Copy it "
                    "there, or choose another folder."
                )
            if goes_on and there != here:
                raise InvalidInput(
                    f"{folder} was started with another file {name} than that of {processes.host()}. Use the same "
                    "file, or choose another folder."
                )

    def _same_scene(self, other):
        return other.scene == self.scene and other.files.get(self.scene) == self.files.get(self.scene)

    def _write(self, folder, unfinished):
        data = {"format": FORMAT, "format_version": FORMAT_VERSION, "digest": self.digest, **asdict(self)}
        data["unfinished"] = sorted(unfinished)
        with files.whole_file(folder / NAME) as part:
            part.write_text(json.dumps(data, indent=1) + "\n")


class EncodingJob(SharedJob):
    """A job that encodes phases of existing frames.

    It has no file in the folder, as each frame's phases name their job. Frames may be rendered at the same time: the
    claim of a frame is for both.
    """

    @property
    def tag(self) -> str:
        """Tag of the job's claims, see `SharedJob.tag`."""
        return f"{_PHASES}{self.digest}"

    @contextmanager
    def join(self, folder: Path | str, names: Iterable[str] = ()) -> Iterator[None]:
        """Work on this job within the block, and prevent work on other phases; see `SharedJob.join`."""
        with _enter(Path(folder)) as door, ExitStack() as inside:
            with door.wait(_FILE_CLAIM):
                others = {n: c for n, c in self._others(door).items() if c.tag.startswith(_PHASES)}
                if others:
                    raise InvalidInput(
                        f"{folder} is being encoded by {_describe(others)} with other options, files or versions. "
                        "Wait, or give the same."
                    )
                inside.enter_context(Claims(folder, self.tag))
            yield


def _describe(claims, difference=""):
    """Hosts of claims, the difference of their job, and their units, for messages."""
    hosts = " and ".join(sorted({claim.host for claim in claims.values()}))
    names = ", ".join(name for name in claims if name[0] != ".")
    return f"{hosts}{difference and f' with {difference}'}{names and f' ({names})'}"


@contextmanager
def _enter(folder):
    """Claims without a job in a folder, which is created, and removed if it is empty in the end."""
    try:
        with ExitStack() as inside:
            try:
                claims = inside.enter_context(Claims(folder, ""))
            except OSError as error:
                raise InvalidInput(
                    f"The output folder {folder} cannot be created ({error.strerror}). Choose another one."
                ) from error
            yield claims
    finally:
        with suppress(OSError):
            folder.rmdir()


def job_of(folder: Path) -> SharedJob | None:
    """Read the job of a folder; None without one.

    Raises
    ------
    InvalidInput
        If its file is broken.
    """
    file = folder / NAME
    try:
        data = json.loads(file.read_text())
        if data["format"] != FORMAT:
            raise ValueError
        parts = {name: dict(data[name]) for name in ("words", "files", "versions")}
        return SharedJob(str(data["scene"]), **parts, unfinished=frozenset(data["unfinished"]))
    except FileNotFoundError:
        return None
    except (ValueError, TypeError, KeyError) as error:
        raise InvalidInput(f"{file} is not HoloPath's. Choose another folder.") from error


def digests(paths: dict[str, Path]) -> dict[str, str]:
    """SHA-256 of files by name, for `SharedJob`; empty for missing files.

    Raises
    ------
    InvalidInput
        If an existing file cannot be read.
    """
    hashes = {}
    for name, path in sorted(paths.items()):
        try:
            with open(path, "rb") as stream:
                hashes[name] = hashlib.file_digest(stream, "sha256").hexdigest()
        except FileNotFoundError:
            hashes[name] = ""
        except OSError as error:
            raise InvalidInput(
                f"The file {path} of the scene cannot be read ({error.strerror}). Make it readable."
            ) from error
    return hashes
