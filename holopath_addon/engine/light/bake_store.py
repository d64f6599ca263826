"""Baked light on disk: one file for each set of triangles, whatever their places, materials and lights."""

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

VERSION = 4  # version of the format and of the light: files of another one are baked again
SUFFIX = ".holobake.npz"
MAX_BYTES = 2 << 30  # maximum size of all files; the oldest are deleted first
# Types of single values in a file.
TYPES = {"digest": str, "coarse": str, "noise": float, "coarser": float, "dense": int, "most": int}


@dataclass(frozen=True)
class Head:
    """Part of a `Stored` that is read quickly: three of its attributes, and the texels of its texture."""

    digest: str
    noise: float
    max_samples: int
    texels: int


@dataclass(frozen=True)
class Stored:
    """A radiance cache as arrays, without the scene that it is for.

    Attributes
    ----------
    digest : str
        Digest of every input that affects the light.
    noise : float
        Target of the relative standard error.
    max_samples : int
        Maximum samples of a group; ``most`` in files.
    coarse : str
        Digest of the groups of `source`.
    texel, corners, copies, size, coarser, dense, laid
        See `atlas.AtlasLayout`.
    pool, starts, counts : numpy.ndarray
        Baked groups, see `groups.Groups`.
    fine, source : numpy.ndarray
        See `RadianceCache`.
    """

    digest: str
    noise: float
    max_samples: int
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
    def of(cls, cache: RadianceCache, digest: str, noise: float, max_samples: int) -> Stored:
        """Copy the arrays of a cache; other parameters are the attributes of their names."""
        empty = np.zeros(0, np.uint32)
        pool = np.concatenate([empty, *(groups.pool for groups in cache.groups)])
        counts = np.concatenate([empty, *(groups.counts for groups in cache.groups)])
        return cls(
            digest=digest,
            noise=noise,
            max_samples=max_samples,
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
        """Layout of the texture."""
        from .atlas import AtlasLayout

        return AtlasLayout(**{field.name: getattr(self, field.name) for field in fields(AtlasLayout)})

    def cache(self, triangles: Triangles, complete: bool, translucent: bool) -> RadianceCache | None:
        """Make a `RadianceCache`, or None if its groups would differ.

        Parameters
        ----------
        triangles : Triangles
        complete, translucent : bool
            See `RadianceCache`.
        """
        import drjit as dr
        import mitsuba as mi

        from ..scene.buffers import loaded
        from .atlas import Atlas
        from .groups import Groups
        from .radiance_cache import RadianceCache

        cache = RadianceCache(Atlas(triangles, self.layout), complete, translucent)
        if cache.coarse.digest() != self.coarse or dr.width(cache.source) != len(self.source):
            return None
        if len(self.pool):  # empty if only traced shapes are in view
            cache.add(Groups(self.pool, self.starts, self.counts), self.fine.reshape(-1, 4)[1:])
        cache.source = loaded(mi.Float, self.source)
        return cache

    def check(self, triangles: Triangles) -> None:
        """Check that the arrays fit each other and the triangles.

        Raises
        ------
        ValueError
            If they do not.
        """
        from .atlas import BLOCK, NONE

        width, height = self.size
        names = ("corners", "fine", "source", "copies", "pool", "starts", "counts")
        valid = (
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
        if not valid:
            raise ValueError("its parts do not fit")


@dataclass(frozen=True)
class Found:
    """Result of looking for a camera's light in a store.

    Attributes
    ----------
    request : BakeRequest
        Request with the accuracy of the stored light if that is higher.
    triangles : Triangles
        Triangles whose light is cached.
    wide_view, view : CameraView
        View that is baked, and the slightly narrower one of the camera.
    translucent : bool
        See `RadianceCache`.
    stored : Stored or None
        Stored light of these triangles.
    cache : RadianceCache or None
        Cache with the stored light; None if it cannot be used.
    missing : float
        Fraction of the view that has to be baked.
    digest : str
        Digest of the scene.
    note : str
        Fault of the stored file, if any.
    """

    request: BakeRequest
    triangles: Triangles
    wide_view: CameraView
    view: CameraView
    translucent: bool
    stored: Stored | None
    cache: RadianceCache | None
    missing: float
    digest: str
    note: str


class BakeStore:
    """Folder of baked light.

    Parameters
    ----------
    folder : path
        Created when something is saved.

    Attributes
    ----------
    kept : (BakeRequest, Found) or None
        Result of planning, for the bake that follows.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        self.kept: tuple[BakeRequest, Found] | None = None

    @classmethod
    def default(cls) -> BakeStore:
        """Store in the folder that HOLOPATH_CACHE names, or else in the user's own cache."""
        folder = os.environ.get("HOLOPATH_CACHE")
        if folder:
            return cls(folder)
        if os.name == "nt":
            base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        elif os.uname().sysname == "Darwin":
            base = Path.home() / "Library" / "Caches"
        else:
            base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        return cls(Path(base) / "holopath")

    @property
    def speed(self) -> Path | None:
        """Folder in which this machine's speed is stored, see `planning.machine`; None for none."""
        return self.folder

    def _file(self, triangles):
        return self.folder / (triangles.structure + SUFFIX)

    def size(self, triangles: Triangles | None = None) -> int:
        """Size in bytes of the file for these triangles, or of all files."""
        files = self.files() if triangles is None else [self._file(triangles)]
        total = 0
        for file in files:
            with suppress(OSError):
                total += file.stat().st_size
        return total

    def files(self) -> list[Path]:
        """List all files, the oldest first."""

        def age(file):
            with suppress(OSError):
                return file.stat().st_mtime
            return 0.0

        return sorted(self.folder.glob("*" + SUFFIX), key=age)

    @property
    def empty(self) -> bool:
        """Whether there is no file."""
        return not self.files()

    def load(self, triangles: Triangles) -> tuple[Stored | None, str]:
        """Read the stored light of some triangles.

        Returns
        -------
        stored : Stored or None
        fault : str
            Sentence on a file that cannot be read, and is baked again; empty if there is none.
        """
        file = self._file(triangles)
        try:
            with np.load(file, allow_pickle=False) as arrays:
                values = {name: arrays[name] for name in arrays.files}
            if int(values.pop("version")) != VERSION:
                return None, ""
            for name, kind in TYPES.items():
                values[name] = kind(values[name])
            values["max_samples"] = values.pop("most")
            values["size"] = tuple(int(n) for n in values["size"])
            stored = Stored(**values)
            stored.check(triangles)
        except FileNotFoundError:
            return None, ""
        except Exception as error:  # a damaged archive raises many kinds
            reason = " ".join(str(error).split())
            return None, f"The baked light in {file.name} cannot be read ({reason}). It is baked again."
        with suppress(OSError):
            os.utime(file)  # the oldest files are deleted first
        return stored, ""

    def head(self, triangles: Triangles) -> Head | None:
        """Read the head of the file for some triangles; None if there is none that can be read."""
        with suppress(Exception), np.load(self._file(triangles), allow_pickle=False) as arrays:
            if int(arrays["version"]) == VERSION:
                texels = math.prod(int(n) for n in arrays["size"])
                return Head(str(arrays["digest"]), float(arrays["noise"]), int(arrays["most"]), texels)
        return None

    def take(self, request: BakeRequest) -> Found | None:
        """Return the kept result for the same request, and forget it; None if there is none."""
        kept, self.kept = self.kept, None
        return kept[1] if kept and kept[0].same(request) else None

    def save(self, triangles: Triangles, stored: Stored) -> None:
        """Write baked light, whole or not at all, in place of that for the same triangles.

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
                values = vars(stored) | {"most": stored.max_samples}
                del values["max_samples"]
                np.savez(stream, version=VERSION, **values)
            os.replace(part, file)
        except OSError as error:
            raise InvalidInput(
                f"Baked light cannot be stored in {self.folder} ({error.strerror}). Free space there, or set "
                "HOLOPATH_CACHE to another folder."
            ) from error
        finally:
            if part is not None:
                with suppress(OSError):
                    os.unlink(part)
        self._shrink(file)

    def _shrink(self, newest):
        files = [file for file in self.files() if file != newest]
        excess = self.size() - MAX_BYTES
        for file in files:
            if excess <= 0:
                break
            with suppress(OSError):
                excess -= file.stat().st_size
                file.unlink()

    def clear(self) -> int:
        """Delete all files; return the number of bytes that this frees."""
        before = self.size()
        for file in [*self.files(), *self.folder.glob(".part-*")]:
            with suppress(OSError):
                file.unlink()
        return before - self.size()


class JobStore(BakeStore):
    """Store in a job's folder, of the light that all its frames share.

    Until it is sealed, it copies files from another store when they are needed, and saves to both.

    Parameters
    ----------
    folder : path
    other : BakeStore or None
        The user's own store.
    sealed : bool
        Whether it is read-only: `save` does nothing.
    """

    def __init__(self, folder: Path | str, other: BakeStore | None, sealed: bool = False) -> None:
        super().__init__(folder)
        self._other, self._sealed = other, sealed

    @property
    def speed(self) -> Path | None:
        """See `BakeStore.speed`: that of the other store."""
        return self._other and self._other.speed

    @property
    def empty(self) -> bool:
        """See `BakeStore.empty`; files of the other store count while they can be copied."""
        return super().empty and (self._sealed or self._other is None or self._other.empty)

    def head(self, triangles: Triangles) -> Head | None:
        """See `BakeStore.head`."""
        self._copy(triangles)
        return super().head(triangles)

    def load(self, triangles: Triangles) -> tuple[Stored | None, str]:
        """See `BakeStore.load`."""
        self._copy(triangles)
        return super().load(triangles)

    def save(self, triangles: Triangles, stored: Stored) -> None:
        """See `BakeStore.save`."""
        if self._sealed:
            return
        super().save(triangles, stored)
        if self._other is not None:
            with suppress(InvalidInput):  # the job has its own
                self._other.save(triangles, stored)

    def _copy(self, triangles):
        mine = self._file(triangles)
        if self._sealed or self._other is None or mine.exists():
            return
        theirs = self._other._file(triangles)
        with suppress(OSError):  # if there is none; half a copy would count as damaged, and be baked again
            shutil.copyfile(theirs, mine)
            os.utime(theirs)
