"""Operations on arrays of NumPy, CuPy, PyTorch and other libraries that the Array API standard lacks.

Wave optics is computed by the library of the given arrays, on their device. Namespaces are those of array-api-compat,
and arrays must be writable. NumPy is used directly, with SciPy's FFTs, which have threads and reuse memory. Types of
numbers are named as in the standard, such as ``"complex64"``.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.fft

from ..memory import on_processor

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

Array = Any  # an array of one of the libraries
PROCESSOR = np.empty(0)  # stands for NumPy


def namespace(array: Array) -> Any:
    """Namespace with the functions of the standard for an array."""
    if isinstance(array, np.ndarray):
        return np
    import array_api_compat

    return array_api_compat.array_namespace(array)


def known(array: ArrayLike) -> Array:
    """Return an array of a library unchanged, and anything else, such as a list, as a NumPy array."""
    return array if hasattr(array, "__dlpack__") else np.asarray(array)


def as_type(array: Array, kind: Any) -> Array:
    """Convert an array to another type of numbers, a name or a type of its namespace; without a copy if it has it."""
    if isinstance(array, np.ndarray):
        return array.astype(kind, copy=False)
    return namespace(array).astype(array, _type(array, kind), copy=False)


def like(values: ArrayLike, array: Array, kind: Any = None) -> Array:
    """Convert values to an array of the library and on the device of `array`; without a copy if they are there."""
    if isinstance(array, np.ndarray):
        return np.asarray(on_processor(values), kind)
    if type(values) is type(array):
        return values
    return _make(array, "asarray", np.array(values, order="C"), kind)


def copied(array: Array) -> Array:
    """Return a contiguous copy."""
    if isinstance(array, np.ndarray):
        return np.array(array, order="C")
    return namespace(array).asarray(array, copy=True)


def mask(passes: np.ndarray, array: Array) -> Array:
    """Convert a Boolean mask so that waves of the library of `array` can be multiplied by it."""
    return passes if isinstance(array, np.ndarray) else like(passes, array, "float32")


def empty(shape: Sequence[int], kind: Any, array: Array) -> Array:
    """Allocate an array of the library and on the device of `array`, without setting its values."""
    return _make(array, "empty", tuple(shape), kind)


def zeros(shape: Sequence[int], kind: Any, array: Array) -> Array:
    """Zeros of the library and on the device of `array`."""
    return _make(array, "zeros", tuple(shape), kind)


def _make(array, maker, argument, kind):
    if isinstance(array, np.ndarray):
        return getattr(np, maker)(argument, kind)
    import array_api_compat

    make = getattr(namespace(array), maker)
    return make(argument, dtype=_type(array, kind), device=array_api_compat.device(array))


def _type(array, kind):
    return getattr(namespace(array), kind) if isinstance(kind, str) else kind


def fft(
    array: Array,
    count: int | None = None,
    axis: int = -1,
    norm: str = "backward",
    overwrite: bool = False,
    workers: int | None = None,
) -> Array:
    """FFT of one axis.

    Parameters
    ----------
    array : array, complex
    count : int, optional
        Length to which the axis is cut or padded.
    axis : int
    norm : {'backward', 'ortho', 'forward'}
    overwrite : bool
        Whether the array's memory may be used.
    workers : int, optional
        Number of threads of the processor. Default: 1.
    """
    return _transform("fft", array, count, axis, norm, overwrite, workers)


def ifft(
    array: Array,
    count: int | None = None,
    axis: int = -1,
    norm: str = "backward",
    overwrite: bool = False,
    workers: int | None = None,
) -> Array:
    """Inverse of `fft`."""
    return _transform("ifft", array, count, axis, norm, overwrite, workers)


def fft2(
    array: Array,
    shape: Sequence[int] | None = None,
    norm: str = "backward",
    overwrite: bool = False,
    workers: int | None = None,
) -> Array:
    """FFT of the last two axes, padded to `shape`; see `fft`."""
    return _transform("fftn", array, shape, (-2, -1), norm, overwrite, workers)


def ifft2(array: Array, norm: str = "backward", overwrite: bool = False, workers: int | None = None) -> Array:
    """Inverse of `fft2`."""
    return _transform("ifftn", array, None, (-2, -1), norm, overwrite, workers)


def rfft2(array: Array, workers: int | None = None) -> Array:
    """FFT of the last two axes of real numbers: one half of `fft2`."""
    return _transform("rfftn", array, None, (-2, -1), "backward", False, workers)


def irfft2(array: Array, shape: Sequence[int], overwrite: bool = False, workers: int | None = None) -> Array:
    """Inverse of `rfft2` of an array of this `shape`."""
    return _transform("irfftn", array, shape, (-2, -1), "backward", overwrite, workers)


def _transform(name, array, size, axis, norm, overwrite, workers):
    if isinstance(array, np.ndarray):
        return getattr(scipy.fft, name)(array, size, axis, norm, overwrite, workers)
    axes = {"n": size, "axis": axis} if isinstance(axis, int) else {"s": size, "axes": axis}
    return getattr(namespace(array).fft, name)(array, **axes, norm=norm)


def into(memory: Array, function: Any, *values: Any) -> Array:
    """Call an elementwise function; on the processor its result is in the given memory."""
    return function(*values, out=memory) if isinstance(memory, np.ndarray) else function(*values)


def put(memory: Array, function: Any, *values: Any) -> None:
    """Call an elementwise function, and write its result into the given memory."""
    if isinstance(memory, np.ndarray):
        function(*values, out=memory)
    else:
        memory[...] = function(*values)


def pairs(waves: Array) -> Array:
    """Real and imaginary parts along an additional last axis; in the same memory if the library supports that."""
    xp = namespace(waves)
    if hasattr(xp, "view_as_real"):
        return xp.view_as_real(waves)
    if hasattr(waves, "view"):
        return waves.view(waves.real.dtype).reshape(*waves.shape, 2)
    return xp.stack([xp.real(waves), xp.imag(waves)], axis=-1)


def of_pairs(parts: Array) -> Array:
    """Complex64 numbers from `pairs`; in the same memory if the library supports that."""
    xp = namespace(parts)
    if hasattr(xp, "view_as_complex"):
        return xp.view_as_complex(parts)
    if hasattr(parts, "view"):
        return parts.view(np.complex64)[..., 0]
    waves = empty(parts.shape[:-1], "complex64", parts)
    set_parts(waves, parts[..., 0], parts[..., 1])
    return waves


def set_parts(array: Array, real: Array, imaginary: Array) -> None:
    """Set the real and the imaginary parts of complex numbers, in their memory."""
    if hasattr(array, "real"):
        array.real[...], array.imag[...] = real, imaginary
    else:
        array[...] = as_type(real, array.dtype) + 1j * as_type(imaginary, array.dtype)


def phasors(angles: Array) -> Array:
    """exp(i angle), complex64."""
    xp, out = namespace(angles), empty(angles.shape, "complex64", angles)
    if isinstance(angles, np.ndarray):
        np.cos(angles, out=out.real)
        np.sin(angles, out=out.imag)
    else:
        set_parts(out, xp.cos(angles), xp.sin(angles))
    return out


def intensity(waves: Array) -> Array:
    """Squares of absolute values."""
    xp = namespace(waves)
    return xp.real(waves) ** 2 + xp.imag(waves) ** 2


def total_intensity(waves: Array) -> Array:
    """Sum over frames, the first axis, of squares of absolute values."""
    if isinstance(waves, np.ndarray):
        parts = waves.view(waves.real.dtype)  # real and imaginary parts side by side
        total = np.einsum("fyx,fyx->yx", parts, parts)
        return total[:, ::2] + total[:, 1::2]
    return namespace(waves).sum(intensity(waves), axis=0)


def angle(waves: Array) -> Array:
    """Phases, radians from -pi to pi."""
    if isinstance(waves, np.ndarray):
        return np.angle(waves)
    xp = namespace(waves)
    return xp.atan2(xp.imag(waves), xp.real(waves))


def arccos(values: Array) -> Array:
    """Radians from 0 to pi."""
    return np.arccos(values) if isinstance(values, np.ndarray) else namespace(values).acos(values)


def cumulative(values: Array) -> Array:
    """Sums along the last axis: of the first number, of the first two, and so on."""
    if isinstance(values, np.ndarray):
        return values.cumsum(-1)
    return namespace(values).cumulative_sum(values, axis=-1)


def smallest(values: Array, count: int) -> Array:
    """Value of rank `count` in an array of one axis, counted from the smallest, 1."""
    if isinstance(values, np.ndarray):
        return np.partition(values, count - 1)[count - 1]
    return namespace(values).sort(values)[count - 1]


def product(first: Array, second: Array) -> complex:
    """Scalar product of all numbers, with the conjugates of the first ones."""
    if isinstance(first, np.ndarray):
        return complex(np.vdot(first, second))
    xp = namespace(first)
    return complex(
        xp.sum((xp.conj(first) if xp.isdtype(first.dtype, "complex floating") else first) * second)
    )


def total(values: Array) -> float:
    """Sum of all real numbers, in double precision."""
    xp = namespace(values)
    return float(xp.sum(values, dtype=xp.float64))


def overlap(first: Array, second: Array) -> float:
    """Sum of all products of real numbers, in double precision."""
    if isinstance(first, np.ndarray):
        return float(np.einsum("yx,yx->", first, second, dtype=float))
    return total(first * second)


def histogram(
    values: Array, bins: int, top: float, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Histogram from 0 to the largest value.

    Parameters
    ----------
    values : array
        Not negative.
    bins : int
        Number of bins.
    top : float
        The largest value.
    weights : array, optional
        Weight of each value. Default: 1.

    Returns
    -------
    sums, edges : numpy.ndarray
        Counts, or sums of weights, and the bins' edges.
    """
    if isinstance(values, np.ndarray):
        return np.histogram(values, bins, (0, top), weights=weights)
    xp, edges = namespace(values), np.linspace(0, top, bins + 1)
    values = xp.reshape(values, (-1,))
    order = xp.argsort(values)
    places = xp.searchsorted(xp.take(values, order), like(edges[1:-1], values, values.dtype))
    places = np.concatenate([[0], on_processor(places), [order.shape[0]]])
    if weights is None:
        return np.diff(places), edges
    sums = xp.cumulative_sum(xp.take(xp.reshape(weights, (-1,)), order), dtype=xp.float64)
    ends = on_processor(xp.take(sums, like(np.maximum(places - 1, 0), values))) * (places > 0)
    return np.diff(ends), edges


def at(array: Array, rows: np.ndarray, columns: np.ndarray) -> Array:
    """Copy of some of the rows and columns, the last two axes."""
    if isinstance(array, np.ndarray):
        return array[..., rows[:, None], columns]
    xp = namespace(array)
    return xp.take(xp.take(array, like(rows, array), axis=-2), like(columns, array), axis=-1)
