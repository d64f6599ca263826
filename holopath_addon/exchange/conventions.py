"""How programs lay out complex fields: the order of axes and rows, and the sign of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..engine import InvalidInput

AXES = ("frame", "wavelength", "y", "x")  # ours
SIGNS = {"-": "exp(-i omega t)", "+": "exp(+i omega t)"}  # of time
ROWS = ("top", "bottom")


@dataclass(frozen=True)
class Convention:
    """Of an array.

    Parameters
    ----------
    axes : tuple of str, optional
        Names of its axes, `AXES` in any order, of which frame and wavelength may lack. Default: the last of `AXES`, as
        many as it has.
    time : str
        Of `SIGNS`. With exp(-i omega t) propagation by z multiplies the spectrum by exp(+i kz z); a field of the other
        sign is the complex conjugate.
    rows : str
        Of `ROWS`: where row 0 is.

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
                f"The sign of time is + or -, not '{self.time}': - stands for {SIGNS['-']}, as here."
            )
        if self.rows not in ROWS:
            raise InvalidInput(f"Row 0 is at the {' or the '.join(ROWS)}, not at '{self.rows}'.")
        if self.axes is not None and not (
            {"y", "x"} <= set(self.axes) <= set(AXES) and len(set(self.axes)) == len(self.axes)
        ):
            raise InvalidInput(
                f"Axes are {','.join(AXES)} in any order, each once, not '{','.join(self.axes)}': frame and "
                "wavelength may lack."
            )

    def ours(self, array: np.ndarray) -> np.ndarray:
        """A field or phases of this convention as we lay them out, shape (frame, wavelength, y, x).

        Raises
        ------
        InvalidInput
            If the array has another number of axes.
        """
        return self.signed(self.laid_out(array))

    def laid_out(self, array: np.ndarray) -> np.ndarray:
        """The array in our order of axes and rows, as a view; the sign of time is still its own.

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

    def signed(self, array: np.ndarray) -> np.ndarray:
        """A field, or phases with a fraction, from this sign of time to ours, and back."""
        if self.time == "+":  # phases are the arguments of such fields
            array = np.conj(array) if np.iscomplexobj(array) else -array
        return array

    def theirs(self, array: np.ndarray) -> np.ndarray:
        """The reverse of `ours`.

        Raises
        ------
        InvalidInput
            If there are several frames or wavelengths, and the convention has no axis for them.
        """
        axes = self.axes or AXES
        array = self.signed(array[..., ::-1, :] if self.rows == "bottom" else array)
        for place, name in enumerate(AXES):
            if name not in axes and array.shape[place] > 1:
                raise InvalidInput(f"There are {array.shape[place]} {name}s: name an axis for them.")
        array = array.transpose(
            [*(AXES.index(n) for n in AXES if n not in axes), *(AXES.index(n) for n in axes)]
        )
        return array[(0,) * (len(AXES) - len(axes))]

    def _axes(self, count):
        axes = self.axes or AXES[max(0, len(AXES) - count) :]
        if len(axes) != count:
            raise InvalidInput(
                f"The array has {count} axes, not {len(axes)} as {','.join(axes)}: name them by --axes, of "
                f"{','.join(AXES)}."
            )
        return axes


# Read in their source, and tested against them where the tests name them (docs/files.md).
CONVENTIONS = {
    "holopath": Convention(),
    # Field.data[x, y], both axes rising; transfer function exp(+i kz z).
    "torchoptics": Convention(axes=("x", "y"), rows="bottom"),
    # Hologram phases [y, x] as they are shown; its driver turns the sign, not the array.
    "slmsuite": Convention(axes=("y", "x")),
    # Tensors [wavelength, y, x]; transfer function exp(+i kz z).
    "odak": Convention(axes=("wavelength", "y", "x")),
    # As pictures are indexed there.
    "matlab": Convention(axes=("y", "x", "wavelength", "frame")),
}
