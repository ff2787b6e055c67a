"""Checked float arrays from array-likes or nested TOML lists, for the public interface."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from undeadzone.errors import InputError, ShapeError

Floats = npt.NDArray[np.floating[Any]]
Integers = npt.NDArray[np.integer[Any]]
Flags = npt.NDArray[np.bool_]

LARGEST_SEED = 2**63 - 1
LARGEST = 1e50  # beyond this no unit makes sense, and squares and products overflow

if TYPE_CHECKING:
    Array = npt.ArrayLike
else:
    Array = np.ndarray  # what `decode` makes of the numbers in a scenario file


def decode_array(kind: type, value: Any) -> Floats:
    """Return a float array from the TOML value of a field of type `Array`.

    Raises:
        ValueError: not numbers (msgspec adds the place).
        NotImplementedError: a field of another type.
    """
    if kind is not np.ndarray:
        raise NotImplementedError(kind)
    return to_float_array(value, infinite=True)


def to_float_array(value: Any, infinite: bool = False) -> Floats:
    """Return a float array from numbers, nested lists, or MATLAB's text `"[0 1; -1 -2]"`.

    Args:
        value: the numbers.
        infinite: whether they may be infinite.

    Raises:
        ValueError: other text, booleans, ragged lists, non-finite or huge entries.
    """
    if isinstance(value, str):
        value = parse_matlab_matrix(value)
    try:
        array = np.asarray(fill_masked(value))
    except ValueError:
        raise ValueError(
            "expected numbers in a rectangular list, found rows of different lengths"
        ) from None
    if array.dtype == bool:
        raise ValueError("expected numbers, found a boolean")
    if array.dtype.kind not in "iuf":
        raise ValueError(f"expected numbers, found {value!r:.60}")
    array = array.astype(np.float64)
    finite = np.isfinite(array)
    if not (finite | (infinite & np.isinf(array))).all():
        raise ValueError("every number must be finite, found nan or inf")
    largest = np.abs(array[finite]).max(initial=0.0)
    if largest > LARGEST:
        raise ValueError(f"every number must be below {LARGEST:g} in size, found {largest:g}")
    return array


def fill_masked(value: Any) -> Any:
    """Return the value with NaN in place of masked entries. Data under a mask are not numbers."""
    if not isinstance(value, np.ma.MaskedArray):
        return value
    return np.ma.filled(value.astype(float), np.nan)


def parse_matlab_matrix(text: str) -> list[list[float]]:
    """Return the rows of a matrix in MATLAB's notation: `"[0 1; -1 -2]"`.

    Raises:
        ValueError: another text.
    """
    body = text.strip()
    rows = body[1:-1].strip().strip(";").split(";")
    try:
        if not (body.startswith("[") and body.endswith("]")):
            raise ValueError  # no brackets
        return [list(map(float, row.replace(",", " ").split())) for row in rows]
    except ValueError:
        raise ValueError(f"expected numbers, found {text!r:.60}") from None


def require_array(key: str, value: Any, infinite: bool = False) -> Floats:
    """Return the value as a float array. An error contains the key.

    Infinite numbers are refused unless they are allowed.

    Raises:
        InputError: not numbers.
    """
    try:
        return to_float_array(value, infinite)
    except ValueError as error:
        raise InputError(f"{key}: {error}") from None


def require_matrix(
    key: str, value: Any, rows: int | None = None, columns: int | None = None, why: str = ""
) -> Floats:
    """Return a 2-D float array of a given shape (a single number is a 1 x 1 matrix).

    Args:
        key: named in errors.
        value: numbers or nested lists.
        rows, columns: expected (None: any).
        why: meaning of the rows and columns, for the error.

    Raises:
        InputError: not numbers.
        ShapeError: another shape.
    """
    entries = require_array(key, value)
    if entries.ndim == 0:
        entries = entries.reshape(1, 1)
    shape = entries.shape
    is_expected = rows in (None, shape[0]) and columns in (None, shape[-1])
    if entries.ndim == 2 and 0 not in shape and is_expected:
        return entries
    expected = _matrix_text(rows, columns)
    present = f"a list of {_count_text(shape[0])}" if entries.ndim == 1 else describe_shape(shape)
    raise ShapeError(f"{key}: expected {expected}{_in_brackets(why)}, found {present}")


def require_vector(key: str, value: Any, size: int, why: str = "") -> Floats:
    """Return a 1-D float array. A single number is repeated, an n x 1 or 1 x n matrix
    flattened.

    Args:
        key: named in errors.
        value: numbers or nested lists.
        size: expected.
        why: meaning of the entries, for the error.

    Raises:
        InputError: not numbers.
        ShapeError: another size.
    """
    entries = require_array(key, value)
    if entries.ndim == 2 and 1 in entries.shape:
        entries = entries.ravel()
    if entries.ndim == 0:
        entries = np.full(size, float(entries))
    if entries.shape != (size,):
        expected = _count_text(size)
        present = describe_shape(entries.shape)
        raise ShapeError(f"{key}: expected {expected}{_in_brackets(why)}, found {present}")
    return entries


def require_series(key: str, value: Any) -> Floats:
    """Return a 1-D float array with at least one entry.

    Raises:
        InputError: not numbers.
        ShapeError: no number, or a table of them.
    """
    entries = require_array(key, value)
    if entries.size == 0:
        raise ShapeError(f"{key}: expected at least one number, found none")
    if entries.ndim > 2 or (entries.ndim == 2 and 1 not in entries.shape):
        raise ShapeError(
            f"{key}: expected a list of numbers, found {describe_shape(entries.shape)}"
        )
    return entries.ravel()


def describe_shape(shape: Iterable[int]) -> str:
    """Return the shape of an array as text: 2 x 3, or one number."""
    return " x ".join(map(str, shape)) or "one number"


def list_numbers(numbers: Iterable[complex]) -> str:
    """Return real or complex numbers as text: -1, -2+3j."""
    return ", ".join(map(_format_complex, numbers))


def require_number(
    key: str, value: Any, *, above: float | None = None, least: float | None = None
) -> float:
    """Return a finite number within bounds.

    Args:
        key: named in errors.
        value: the number.
        above: it must be greater.
        least: it must not be less.

    Raises:
        InputError: not a number, or out of bounds.
        ShapeError: several numbers.
    """
    entries = require_array(key, value)
    if entries.size != 1:
        raise ShapeError(f"{key}: expected one number, found {entries.size}")
    number = float(entries.reshape(()))
    if above is not None and not number > above + 1 / LARGEST:
        raise InputError(f"{key}: must be greater than {above:g}, found {number:g}")
    if least is not None and not number >= least:
        raise InputError(f"{key}: must be at least {least:g}, found {number:g}")
    return number


def require_seed(key: str, value: Any) -> int:
    """Return a seed of random numbers: a whole number from 0 to 2^63 - 2.

    Raises:
        InputError: another value.
    """
    whole = isinstance(value, int | np.integer) and not isinstance(value, bool)
    if not (whole and 0 <= value < LARGEST_SEED):
        raise InputError(f"{key}: expected a whole number from 0 to 2^63 - 2, found {value!r:.40}")
    return int(value)


def require_nonnegative(key: str, value: Any, size: int, why: str = "") -> Floats:
    """Return a 1-D float array with entries >= 0.

    Raises:
        InputError: not numbers, or a negative one.
        ShapeError: another size.
    """
    entries = require_vector(key, value, size, why)
    if (entries < 0).any():
        raise InputError(f"{key}: must not be negative, found {entries.min():g}")
    return entries


def require_positive(key: str, value: Any, size: int, why: str = "") -> Floats:
    """Return a 1-D float array with entries > 0.

    Raises:
        InputError: not numbers, or one that is not positive.
        ShapeError: another size.
    """
    entries = require_vector(key, value, size, why)
    if (entries <= 0).any():
        raise InputError(f"{key}: must be positive, found {entries.min():g}")
    return entries


def bounds_of_runs(flags: Flags) -> tuple[Integers, Integers]:
    """Return the first and the last index of each run of True.

    Args:
        flags: in a row (N).
    """
    ends = np.diff(flags.astype(int), prepend=0, append=0)
    return np.flatnonzero(ends > 0), np.flatnonzero(ends < 0) - 1


def turns(u: Floats, more: float) -> Integers:
    """Return the indices at which a signal turns round, each by more than a distance.

    Args:
        u: signal (N).
        more: distance that a turn exceeds [u].
    """
    found, way, top = [], 0, 0
    kept = np.flatnonzero(np.diff(np.sign(np.diff(u, prepend=u[:1])), append=0))
    for k in [*kept.tolist(), u.size - 1]:
        ahead = u[k] - u[top]
        if way * ahead >= 0:
            way, top = way or int(np.sign(ahead)), k
        elif abs(ahead) > more:
            found.append(top)
            way, top = int(np.sign(ahead)), k
    return np.array(found, int)


def to_json_value(value: Any) -> Any:
    """Return a value for JSON, which has no nan or inf: None in their place.

    Dictionaries, lists and tuples are searched for them, and named tuples become dictionaries.
    """
    if hasattr(value, "_asdict"):
        value = value._asdict()
    if isinstance(value, dict):
        return {key: to_json_value(child) for key, child in value.items()}
    if isinstance(value, list | tuple):
        return list(map(to_json_value, value))
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _format_complex(number: complex) -> str:
    """Return a number as text, with the imaginary part if not 0."""
    if number.imag:
        return f"{number.real:.4g}{number.imag:+.4g}j"
    return f"{number.real:.4g}"


def rows_since_start(start: Integers, size: int) -> Integers:
    """Return the number of earlier rows of the same record, for each row (N).

    Args:
        start: first row of each record (R).
        size: rows of all records.
    """
    at = np.arange(size)
    return at - start[np.searchsorted(start, at, side="right") - 1]


def hold_last(rows: Floats) -> Floats:
    """Return rows (N x m) whose missing values are the last ones before them, NaN at first."""
    last = np.maximum.accumulate(np.isfinite(rows) * np.c_[: len(rows)])
    return np.take_along_axis(rows, last, axis=0)


def shift_rows(rows: Floats, samples: int, start: Integers) -> Floats:
    """Return rows of records shifted by a number of samples. The end values of a record are
    held.

    Args:
        rows: of all records, one after another (N or N x m).
        samples: by how many (negative: earlier).
        start: first row of each record (R).
    """
    record = np.searchsorted(start, np.arange(len(rows)), side="right") - 1
    last = np.append(start[1:], len(rows)) - 1
    return rows[np.clip(np.arange(len(rows)) - samples, start[record], last[record])]


def split_past(x: Floats, least: int) -> list[Floats]:
    """Return samples, and means over the one before each, the two before that, the next four, ...

    All have the rows of the samples that follow the longest past. It is at most the part 1 / least
    of the rows. A shorter signal has no past.

    Args:
        x: signals (N x K).
        least: such pasts in the signal, at least.
    """
    size = x.shape[0]
    sums = np.cumsum(np.pad(x, ((1, 0), (0, 0))), axis=0)
    spans = int(np.log2(max(size / least, 1)))
    ends = np.append(0, 2 ** np.arange(spans + 1))
    now = np.arange(ends[-1], size) + 1
    return [(sums[now - a] - sums[now - b]) / (b - a) for a, b in itertools.pairwise(ends)]


def to_scalar_or_list(values: Sequence[Any] | Floats) -> Any:
    """Return the values per output, input or joint as a list, or a single value as itself.

    Args:
        values: one each.
    """
    plain = values.tolist() if isinstance(values, np.ndarray) else list(values)
    return plain[0] if len(plain) == 1 else plain


def _count_text(count: int) -> str:
    """Return a count of numbers as text."""
    return "1 number" if count == 1 else f"{count} numbers"


def _matrix_text(rows: int | None, columns: int | None) -> str:
    """Return the expected shape of a matrix as text."""
    if rows and columns:
        return f"a {rows} x {columns} matrix"
    if rows:
        return f"a matrix with {rows} rows"
    if columns:
        return f"a matrix with {columns} columns"
    return "a matrix (a list of rows)"


def _in_brackets(why: str) -> str:
    """Return the explanation of an expected shape in brackets, "" if it is empty."""
    return f" ({why})" if why else ""


def require_ranges(key: str, ranges: Floats, value: object) -> None:
    """Raise InputError unless 0 <= lo < hi in every range.

    Args:
        key: name of the value, for messages.
        ranges: pairs [lo, hi] (N x 2).
        value: as the user gave it.
    """
    if (ranges[:, 0] < 0).any() or (ranges[:, 0] >= ranges[:, 1]).any():
        raise InputError(f"{key}: a range [lo, hi] must have 0 <= lo < hi, found {value}")
