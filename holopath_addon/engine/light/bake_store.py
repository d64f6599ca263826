"""Baked light on disk: one file for each set of triangles, whatever their place, materials and lamps."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InvalidInput

if TYPE_CHECKING:
    from .atlas import AtlasLayout, Triangles
    from .camera_view import BakeRequest, CameraView
    from .radiance_cache import RadianceCache

VERSION = 4  # of the format, and of the light: another one is baked again
SUFFIX = ".holobake.npz"
MOST_BYTES = 2 << 30  # of all files; the oldest go first
KINDS = {
    "digest": str,
    "coarse": str,
    "noise": float,
    "coarser": float,
    "dense": int,
    "most": int,
}  # of numbers


@dataclass(frozen=True)
class Head:
    """What is quickly read of a `Stored`: three of its attributes, and the texels of its texture."""

    digest: str
    noise: float
    most: int
    texels: int


@dataclass(frozen=True)
class Stored:
    """A radiance cache as arrays, without the scene that it is for.

    Attributes
    ----------
    digest : str
        Of all that decides the light.
    noise : float
        Relative standard error that was aimed at.
    most : int
        Samples that each group had at most for that.
    coarse : str
        Digest of the groups that `source` is for.
    texel, corners, copies, size, coarser, dense, laid
        As in `atlas.Layout`.
    pool, starts, counts : numpy.ndarray
        Of the groups that are baked, see `groups.Groups`.
    fine, source : numpy.ndarray
        As in `RadianceCache`.
    """

    digest: str
    noise: float
    most: int
    coarse: str
    texel: np.ndarray
    corners: np.ndarray
    copies: np.ndarray
    size: tuple
    coarser: float
    dense: int
    laid: np.ndarray
    pool: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    fine: np.ndarray
    source: np.ndarray

    @classmethod
    def of(cls, cache: RadianceCache, digest: str, noise: float, most: int) -> Stored:
        """What a cache holds."""
        nothing = np.zeros(0, np.uint32)
        pool = np.concatenate([nothing, *(groups.pool for groups in cache.groups)])
        counts = np.concatenate([nothing, *(groups.counts for groups in cache.groups)])
        return cls(
            digest=digest,
            noise=noise,
            most=most,
            coarse=cache.coarse.digest(),
            **vars(cache.atlas.layout),
            pool=pool,
            starts=(np.cumsum(counts) - counts).astype(np.uint32),
            counts=counts,
            fine=np.array(cache.fine),
            source=np.array(cache.source),
        )

    @property
    def layout(self) -> AtlasLayout:
        """The `AtlasLayout`."""
        from .atlas import AtlasLayout

        return AtlasLayout(**{field.name: getattr(self, field.name) for field in fields(AtlasLayout)})

    def cache(self, triangles: Triangles, complete: bool, translucent: bool) -> RadianceCache | None:
        """The `RadianceCache` of these triangles, None where it groups texels otherwise."""
        import drjit as dr
        import mitsuba as mi

        from ..scene.buffers import loaded
        from .atlas import Atlas
        from .groups import Groups
        from .radiance_cache import RadianceCache

        cache = RadianceCache(Atlas(triangles, self.layout), complete, translucent)
        if cache.coarse.digest() != self.coarse or dr.width(cache.source) != len(self.source):
            return None
        if len(self.pool):  # none of a view that only traced shapes are in
            cache.add(Groups(self.pool, self.starts, self.counts), self.fine.reshape(-1, 4)[1:])
        cache.source = loaded(mi.Float, self.source)
        return cache

    def check(self, triangles: Triangles) -> None:
        """Whether the arrays fit each other and the triangles.

        Raises
        ------
        ValueError
        """
        from .atlas import BLOCK, NONE

        width, height = self.size
        names = ("corners", "fine", "source", "copies", "pool", "starts", "counts")
        right = (
            [getattr(self, name).dtype for name in names] == [np.float32] * 3 + [np.int64] + [np.uint32] * 3
            and self.corners.shape == (max(1, triangles.count), 6)
            and self.texel.shape == (max(1, triangles.parts),)
            and width % BLOCK == height % BLOCK == 0 < width * height < NONE
            and (np.abs(self.corners) <= max(self.size)).all()
            and (self.texel > 0).all()
            and self.laid.dtype == np.int64
            and self.laid.ndim == 1
            and self.copies.shape[1:] == (8,)
            and (self.copies >= 0).all()
            and (self.copies[:, :2] < [len(triangles.owners), 2]).all()
            and (self.copies[:, 2:4] + self.copies[:, 4:6] <= self.size).all()
            and (self.copies[:, 6:] + self.copies[:, 4:6] <= self.size).all()
            and len(self.fine) == 4 * len(self.counts) + 4
            and np.array_equal(self.starts, np.cumsum(self.counts) - self.counts)
            and self.counts.sum() == len(self.pool)
            and self.pool.max(initial=0) < width * height
            and np.isfinite(self.fine).all()
            and np.isfinite(self.source).all()
        )
        if not right:
            raise ValueError("its parts do not fit")


@dataclass(frozen=True)
class Found:
    """What a store has of the light that a camera sees.

    Attributes
    ----------
    request : BakeRequest
        With the noise and samples that are asked for or that the stored light has.
    triangles : Triangles
        Those whose light is cached.
    view, seen : CameraView
        What is baked, a little beyond what is seen, and what is seen.
    translucent : bool
        As of `RadianceCache`.
    stored : Stored or None
        What there is of these triangles.
    cache : RadianceCache or None
        With the stored light; None where it does not serve.
    missing : float
        Share of the view that has to be baked.
    digest : str
        Of the scene.
    note : str
        What was wrong with what is stored, if something was.
    """

    request: BakeRequest
    triangles: Triangles
    view: CameraView
    seen: CameraView
    translucent: bool
    stored: Stored | None
    cache: RadianceCache | None
    missing: float
    digest: str
    note: str


class BakeStore:
    """A folder of baked light.

    Parameters
    ----------
    folder : path
        Made when something is saved.

    Attributes
    ----------
    kept : (BakeRequest, Found) or None
        What planning found, for the baking that follows.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self.kept: tuple[BakeRequest, Found] | None = None

    @classmethod
    def default(cls) -> BakeStore:
        """The user's own cache folder, or what HOLOPATH_CACHE names."""
        named = os.environ.get("HOLOPATH_CACHE")
        if named:
            return cls(named)
        if os.name == "nt":
            base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        elif os.uname().sysname == "Darwin":
            base = Path.home() / "Library" / "Caches"
        else:
            base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        return cls(Path(base) / "holopath")

    @property
    def speed(self) -> Path | None:
        """Folder in which this machine's speed is kept, see `planning.machine`; None for none."""
        return self.folder

    def _file(self, triangles):
        return self.folder / (triangles.structure + SUFFIX)

    def size(self, triangles: Triangles | None = None) -> int:
        """Bytes of the light baked for these triangles, or of all."""
        files = self.files() if triangles is None else [self._file(triangles)]
        total = 0
        for file in files:
            with suppress(OSError):
                total += file.stat().st_size
        return total

    def files(self) -> list[Path]:
        """All files, the oldest first."""

        def age(file):
            with suppress(OSError):
                return file.stat().st_mtime
            return 0.0

        return sorted(self.folder.glob("*" + SUFFIX), key=age)

    @property
    def empty(self) -> bool:
        """Whether nothing can be found in it."""
        return not self.files()

    def load(self, triangles: Triangles) -> tuple[Stored | None, str]:
        """What is stored for these triangles.

        Returns
        -------
        Stored or None
        str
            What is wrong with the file, if something is; it is baked again then.
        """
        file = self._file(triangles)
        try:
            with np.load(file, allow_pickle=False) as arrays:
                values = {name: arrays[name] for name in arrays.files}
            if int(values.pop("version")) != VERSION:
                return None, ""
            for name, kind in KINDS.items():
                values[name] = kind(values[name])
            values["size"] = tuple(int(n) for n in values["size"])
            stored = Stored(**values)
            stored.check(triangles)
        except FileNotFoundError:
            return None, ""
        except Exception as error:  # a damaged archive raises many kinds
            reason = " ".join(str(error).split())
            return None, f"The baked light in {file.name} cannot be read ({reason}): it is baked again."
        with suppress(OSError):
            os.utime(file)  # the oldest files are the first to go
        return stored, ""

    def head(self, triangles: Triangles) -> Head | None:
        """The `Head` of what is stored for these triangles, None where nothing can be read."""
        with suppress(Exception), np.load(self._file(triangles), allow_pickle=False) as arrays:
            if int(arrays["version"]) == VERSION:
                texels = math.prod(int(n) for n in arrays["size"])
                return Head(str(arrays["digest"]), float(arrays["noise"]), int(arrays["most"]), texels)
        return None

    def take(self, request: BakeRequest) -> Found | None:
        """What was kept for the same request; only once."""
        kept, self.kept = self.kept, None
        return kept[1] if kept and kept[0].same(request) else None

    def save(self, triangles: Triangles, stored: Stored) -> None:
        """Keep baked light, whole or not at all; what was stored for the same triangles goes.

        Raises
        ------
        InvalidInput
            If the folder cannot be written to.
        """
        file = self._file(triangles)
        part = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, part = tempfile.mkstemp(prefix=".part-", dir=self.folder)
            with os.fdopen(handle, "wb") as stream:
                np.savez(stream, version=VERSION, **vars(stored))
            os.replace(part, file)
        except OSError as error:
            raise InvalidInput(
                f"Baked light cannot be kept in {self.folder} ({error.strerror}): free space there, or name another "
                f"folder in HOLOPATH_CACHE."
            ) from error
        finally:
            if part is not None:
                with suppress(OSError):
                    os.unlink(part)
        self._shrink(file)

    def _shrink(self, newest):
        files = [file for file in self.files() if file != newest]
        excess = self.size() - MOST_BYTES
        for file in files:
            if excess <= 0:
                break
            with suppress(OSError):
                excess -= file.stat().st_size
                file.unlink()

    def clear(self) -> int:
        """Delete all that is stored; bytes that were freed."""
        before = self.size()
        for file in [*self.files(), *self.folder.glob(".part-*")]:
            with suppress(OSError):
                file.unlink()
        return before - self.size()


class JobStore(BakeStore):
    """The light that all frames of a job have alike: a store in a folder of the job's.

    Until it is sealed, it begins with what another store holds, and that gets what is saved, too.

    Parameters
    ----------
    folder : path
    other : BakeStore or None
        The user's own.
    sealed : bool
        Whether it is read alone: what is saved is not kept.
    """

    def __init__(self, folder: Path | str, other: BakeStore | None, sealed: bool = False) -> None:
        super().__init__(folder)
        self._other, self._sealed = other, sealed

    @property
    def speed(self) -> Path | None:
        """See `BakeStore.speed`: it is no matter of the job."""
        return self._other and self._other.speed

    @property
    def empty(self) -> bool:
        """See `BakeStore.empty`; what it may still begin with counts."""
        return super().empty and (self._sealed or self._other is None or self._other.empty)

    def head(self, triangles: Triangles) -> Head | None:
        """See `BakeStore.head`."""
        self._begin(triangles)
        return super().head(triangles)

    def load(self, triangles: Triangles) -> tuple[Stored | None, str]:
        """See `BakeStore.load`."""
        self._begin(triangles)
        return super().load(triangles)

    def save(self, triangles: Triangles, stored: Stored) -> None:
        """See `BakeStore.save`."""
        if self._sealed:
            return
        super().save(triangles, stored)
        if self._other is not None:
            with suppress(InvalidInput):  # the job has it
                self._other.save(triangles, stored)

    def _begin(self, triangles):
        mine = self._file(triangles)
        if self._sealed or self._other is None or mine.exists():
            return
        theirs = self._other._file(triangles)
        with suppress(OSError):  # there is none; half a copy would be found damaged, and baked again
            shutil.copyfile(theirs, mine)
            os.utime(theirs)
