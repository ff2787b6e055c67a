"""Numbers at the public surface: any array-like or nested TOML list in, checked float arrays out."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError, ShapeError

Floats = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]

LARGEST = 1e50  # beyond this no unit makes sense, and squares and products overflow

if TYPE_CHECKING:
    Array = npt.ArrayLike
else:
    Array = np.ndarray  # what `decode` makes of the numbers in a scenario file


def decode(kind: type, value: Any) -> Floats:
    """Turn what TOML gave for an `Array` field into a float array; raises ValueError for msgspec to locate."""
    if kind is not np.ndarray:
        raise NotImplementedError(kind)
    return numeric(value)


def numeric(value: Any) -> Floats:
    """A float array from numbers or nested lists; raises ValueError on text, booleans, ragged, non-finite or huge entries."""
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(
            "expected numbers in a rectangular list, found rows of different lengths"
        ) from None
    if array.dtype == bool or array.dtype.kind not in "iuf":
        found = "a boolean" if array.dtype == bool else f"{value!r:.60}"
        raise ValueError(f"expected numbers, found {found}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        raise ValueError("every number must be finite, found nan or inf")
    if np.abs(array).max(initial=0.0) > LARGEST:
        raise ValueError(
            f"every number must be below {LARGEST:g} in size, found {np.abs(array).max():g}"
        )
    return array


def array(key: str, value: Any) -> Floats:
    """`numeric` with the key named in the error. Raises InputError."""
    try:
        return numeric(value)
    except ValueError as error:
        raise InputError(f"{key}: {error}") from None


def matrix(
    key: str, value: Any, rows: int | None = None, columns: int | None = None, why: str = ""
) -> Floats:
    """A 2-D float array of the given shape (None: any). Raises ShapeError that names key, expected and found shape."""
    found = array(key, value)
    if found.ndim == 0:
        found = found.reshape(1, 1)
    shape = found.shape
    if (
        found.ndim != 2
        or rows not in (None, shape[0])
        or columns not in (None, shape[1])
        or 0 in shape
    ):
        exact = (
            f"a {rows} x {columns} matrix"
            if rows and columns
            else f"a matrix with {rows} rows"
            if rows
            else f"a matrix with {columns} columns"
        )
        want = exact if rows or columns else "a matrix (a list of rows)"
        have = (
            f"a list of {shape[0]} number{'s' * (shape[0] != 1)}"
            if found.ndim == 1
            else " x ".join(map(str, shape))
        )
        raise ShapeError(f"{key}: expected {want}{why and ' (' + why + ')'}, found {have}")
    return found


def vector(key: str, value: Any, size: int, why: str = "") -> Floats:
    """A 1-D float array of `size`; one number is repeated, an n x 1 or 1 x n matrix flattened. Raises ShapeError."""
    found = array(key, value)
    if found.ndim == 2 and 1 in found.shape:
        found = found.ravel()
    if found.ndim == 0:
        found = np.full(size, float(found))
    if found.shape != (size,):
        have = " x ".join(map(str, found.shape))
        raise ShapeError(
            f"{key}: expected {size} number{'s' * (size != 1)}{why and ' (' + why + ')'}, found {have}"
        )
    return found


def series(key: str, value: Any) -> Floats:
    """A 1-D float array of any size but 0. Raises InputError, ShapeError."""
    found = array(key, value)
    if found.size == 0:
        raise ShapeError(f"{key}: expected at least one number, found none")
    if found.ndim > 2 or (found.ndim == 2 and 1 not in found.shape):
        raise ShapeError(
            f"{key}: expected a list of numbers, found {' x '.join(map(str, found.shape))}"
        )
    return found.ravel()


def listed(numbers: Iterable[complex]) -> str:
    """Numbers, complex ones perhaps, as text: -1, -2+3j."""
    return ", ".join(f"{s.real:.4g}{s.imag:+.4g}j" if s.imag else f"{s.real:.4g}" for s in numbers)


def scalar(
    key: str, value: Any, *, above: float | None = None, least: float | None = None
) -> float:
    """One finite number within bounds. Raises InputError, ShapeError."""
    found = array(key, value)
    if found.size != 1:
        raise ShapeError(f"{key}: expected one number, found {found.size}")
    number = float(found.reshape(()))
    if above is not None and not number > above + 1 / LARGEST:
        raise InputError(f"{key}: must be greater than {above:g}, found {number:g}")
    if least is not None and not number >= least:
        raise InputError(f"{key}: must be at least {least:g}, found {number:g}")
    return number


def nonnegative(key: str, value: Any, size: int, why: str = "") -> Floats:
    """`vector` whose entries are >= 0. Raises InputError."""
    found = vector(key, value, size, why)
    if (found < 0).any():
        raise InputError(f"{key}: must not be negative, found {found.min():g}")
    return found


def positive(key: str, value: Any, size: int, why: str = "") -> Floats:
    """`vector` whose entries are > 0. Raises InputError."""
    found = vector(key, value, size, why)
    if (found <= 0).any():
        raise InputError(f"{key}: must be positive, found {found.min():g}")
    return found


def finite(value: Any) -> Any:
    """A value for JSON, which has no nan or inf: None in their place, also within dictionaries, lists and tuples."""
    if isinstance(value, dict):
        return {key: finite(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return [finite(child) for child in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value
