"""Wave field: complex amplitudes at the SLM plane, and their files."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .camera import Camera
from .errors import InvalidInput
from .files import overwrite_check, whole_folder
from .hologram import Hologram
from .mapping import DepthMapping
from .memory import on_processor
from .optics import BEAM_FILE, STOP_FILE

FORMAT_VERSION = 1


@dataclass(frozen=True)
class WaveField:
    """Complex wave field at the SLM plane z = 0.

    Attributes
    ----------
    data : array, complex64, shape (frame, wavelength, y, x)
        Amplitudes, in NumPy or another library of the Array API standard. Row 0 is the top. The frame mean of the
        intensity, refocused at a surface, is the surface's radiance.
    hologram : Hologram
    camera : Camera
    near : float
        World depth at the volume's near end, meters.
    plan, report : dict
        The plan as of `Plan.to_dict`, and seconds and rays of each stage.
    modulated : bool
        Whether this is the light of a modulator, which fills aperture and band to their edges and needs a wider guard
        band.
    extra_frames : numpy.ndarray, complex64, or None
        The first of `engine.extra_frames`, targets for an encoding: the same shape with another number of frames. Not
        saved.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from holopath_addon import engine
    >>> hologram = engine.Hologram(32, 32, 8e-6, (516.5e-9,))
    >>> camera = engine.Camera(np.eye(4), 0.5)
    >>> field = engine.WaveField(np.ones((1, 1, 32, 32), np.complex64), hologram, camera, near=0.5)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     field.save(f"{folder}/wavefield")
    ...     bool((engine.WaveField.load(f"{folder}/wavefield").data == field.data).all())
    True
    """

    data: np.ndarray = field(repr=False)
    hologram: Hologram
    camera: Camera
    near: float
    plan: dict = field(default_factory=dict, repr=False)
    report: dict = field(default_factory=dict, repr=False)
    modulated: bool = False
    extra_frames: np.ndarray | None = field(default=None, repr=False, compare=False)

    @property
    def mapping(self) -> DepthMapping:
        """World to hologram space, `DepthMapping`."""
        return DepthMapping.of(self.hologram, self.camera, self.near)

    def save(self, folder: Path | str) -> None:
        """Write ``field.npy`` and ``meta.json`` into a folder that appears only when complete.

        Parameters
        ----------
        folder : path
            New or empty folder, or one of an earlier wave field, which is replaced.

        Raises
        ------
        InvalidInput
            If the folder holds other files.
        OSError
            If it cannot be written; nothing is left behind.
        """
        with whole_folder(
            folder, overwrite_check("a wave field", "field.npy", "meta.json", others=(BEAM_FILE, STOP_FILE))
        ) as part:
            np.save(part / "field.npy", on_processor(self.data))
            self.hologram.optics.save(part)
            meta = {
                "format_version": FORMAT_VERSION,
                "axes": ["frame", "wavelength", "y", "x"],
                "units": "meters; intensity in scene radiance; time dependence exp(-i omega t)",
                "resolution": [self.hologram.width, self.hologram.height],
                "pitch_m": self.hologram.to_dict()["pitch"],
                "wavelengths_m": list(self.hologram.wavelengths),
                "distance_far_m": self.hologram.depth_far,
                "distance_near_m": self.hologram.depth_near,
                "depth_mapping": self.hologram.depth_mapping,
                "near_m": self.near,
                "hologram": self.hologram.to_dict(),
                "camera": self.camera.to_dict(),
                "plan": self.plan,
                "report": self.report,
            }
            (part / "meta.json").write_text(json.dumps(meta, indent=1))

    @classmethod
    def load(cls, folder: Path | str) -> WaveField:
        """Read the folder of `save`; the field is memory-mapped.

        Parameters
        ----------
        folder : path

        Raises
        ------
        InvalidInput
            If the folder holds no readable wave field of this version.
        """
        folder = Path(folder)
        try:
            meta = json.loads((folder / "meta.json").read_text())
            if meta["format_version"] != FORMAT_VERSION:
                raise InvalidInput(
                    f"Expected format version {FORMAT_VERSION}, got {meta['format_version']} in {folder}. "
                    "Render it again."
                )
            data = np.load(folder / "field.npy", mmap_mode="r", allow_pickle=False)
            hologram = Hologram.from_dict(meta["hologram"], folder)
            camera = Camera.from_dict(meta["camera"])
            near = float(meta["near_m"])
        except FileNotFoundError as error:
            raise InvalidInput(
                f"{folder} holds no wave field ({Path(error.filename).name} is missing). Render one first."
            ) from None
        except (OSError, KeyError, TypeError, ValueError) as error:
            if isinstance(error, InvalidInput):
                raise
            raise InvalidInput(f"{folder} holds a damaged wave field ({error}). Render it again.") from None
        expected = (len(hologram.wavelengths), hologram.height, hologram.width)
        if data.ndim != 4 or data.shape[1:] != expected or data.dtype != np.complex64:
            raise InvalidInput(f"{folder}/field.npy does not fit its meta.json. Render it again.")
        return cls(data, hologram, camera, near, meta.get("plan", {}), meta.get("report", {}))
