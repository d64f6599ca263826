"""Conventions of programs for complex fields: the order of axes and rows, and the sign of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine import InvalidInput

AXES = ("frame", "wavelength", "y", "x")  # ours
SIGNS = {"-": "exp(-i omega t)", "+": "exp(+i omega t)"}  # of time
ROWS = ("top", "bottom")  # positions of row 0


@dataclass(frozen=True)
class Convention:
    """A program's convention for arrays.

    Parameters
    ----------
    axes : tuple of str, optional
        Names of the axes: `AXES` in any order, where frame and wavelength are optional. Default: the last of `AXES`, as
        many as the array has.
    time : str
        One of `SIGNS`. With exp(-i omega t) propagation by z multiplies the spectrum by exp(+i kz z); a field of the
        other sign is the complex conjugate.
    rows : str
        Position of row 0, one of `ROWS`.

    Raises
    ------
    InvalidInput
    """

    axes: tuple[str, ...] | None = None
    time: str = "-"
    rows: str = "top"

    def __post_init__(self):
        if self.time not in SIGNS:
            raise InvalidInput(
                f"Expected a sign of time + or -, got '{self.time}'. HoloPath has -, for {SIGNS['-']}."
            )
        if self.rows not in ROWS:
            raise InvalidInput(f"Expected row 0 at the {' or '.join(ROWS)}, got '{self.rows}'.")
        if self.axes is not None and not (
            {"y", "x"} <= set(self.axes) <= set(AXES) and len(set(self.axes)) == len(self.axes)
        ):
            raise InvalidInput(
                f"Expected axes {','.join(AXES)} in any order, where frame and wavelength are optional, got "
                f"'{','.join(self.axes)}'."
            )

    def to_holopath(self, array: np.ndarray) -> np.ndarray:
        """Convert a field or phases to HoloPath's convention, shape (frame, wavelength, y, x).

        Raises
        ------
        InvalidInput
            If the array has another number of axes.
        """
        return self.convert_sign(self.reorder(array))

    def reorder(self, array: np.ndarray) -> np.ndarray:
        """A view of an array in HoloPath's order of axes and rows; the sign of time stays.

        Raises
        ------
        InvalidInput
            If the array has another number of axes.
        """
        axes = self._axes(array.ndim)
        missing = [name for name in AXES if name not in axes]
        array = array[(np.newaxis,) * len(missing)]
        array = array.transpose([(*missing, *axes).index(name) for name in AXES])
        return array[..., ::-1, :] if self.rows == "bottom" else array

    def convert_sign(self, array: np.ndarray) -> np.ndarray:
        """Convert a field, or phases of floating point, from this sign of time to HoloPath's, or back."""
        if self.time == "+":  # phases are the arguments of such fields
            array = np.conj(array) if np.iscomplexobj(array) else -array
        return array

    def from_holopath(self, array: np.ndarray) -> np.ndarray:
        """Convert a field or phases from HoloPath's convention: the inverse of `to_holopath`.

        Raises
        ------
        InvalidInput
            If the array has several frames or wavelengths, and the convention no axis for them.
        """
        axes = self.axes or AXES
        array = self.convert_sign(array[..., ::-1, :] if self.rows == "bottom" else array)
        for place, name in enumerate(AXES):
            if name not in axes and array.shape[place] > 1:
                raise InvalidInput(
                    f"There are {array.shape[place]} {name}s, but no axis for them. Name it by --axes."
                )
        array = array.transpose(
            [*(AXES.index(n) for n in AXES if n not in axes), *(AXES.index(n) for n in axes)]
        )
        return array[(0,) * (len(AXES) - len(axes))]

    def _axes(self, count):
        axes = self.axes or AXES[max(0, len(AXES) - count) :]
        if len(axes) != count:
            raise InvalidInput(
                f"Expected {len(axes)} axes, {','.join(axes)}, got {count}. Name the array's axes by --axes, among "
                f"{','.join(AXES)}."
            )
        return axes


# From the programs' sources, and tested against those that the tests name (docs/files.md).
CONVENTIONS = {
    "holopath": Convention(),
    # Field.data[x, y], both axes ascending; transfer function exp(+i kz z).
    "torchoptics": Convention(axes=("x", "y"), rows="bottom"),
    # Hologram phases [y, x] as shown; its driver flips the sign, not the array.
    "slmsuite": Convention(axes=("y", "x")),
    # Tensors [wavelength, y, x]; transfer function exp(+i kz z).
    "odak": Convention(axes=("wavelength", "y", "x")),
    # As MATLAB indexes pictures.
    "matlab": Convention(axes=("y", "x", "wavelength", "frame")),
}
