"""What callers give, as the arrays that the native part takes: nothing is copied that has its layout already."""

from __future__ import annotations

import operator
from typing import Any, Union

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._errors import invalid

Positions = Union[NDArray[np.float64], NDArray[np.int64]]


def ids_of(given: ArrayLike | range, name: str = "ids") -> NDArray[np.uint64]:
    """Ids as an array of u64; one id alone is an array of one."""
    if isinstance(given, range):
        ids: NDArray[Any] = np.arange(given.start, given.stop, given.step, dtype=_range_type(given))
    else:
        ids = np.atleast_1d(np.asarray(given))
        if ids.dtype.kind == "f" and not _is_typed(given):
            # NumPy makes floats of integers that no type of its own holds together.
            ids = np.atleast_1d(np.asarray(given, dtype=object))
    if ids.ndim != 1:
        raise invalid(name, f"has {ids.ndim} dimensions, not 1")
    if ids.size == 0:
        return np.empty(0, dtype=np.uint64)
    if ids.dtype.kind == "u":
        return ids.astype(np.uint64, copy=False)
    if ids.dtype.kind == "i":
        if int(ids.min()) < 0:
            index = int(np.argmax(ids < 0))
            raise invalid(f"{name}[{index}]", NO_ID, int(ids[index]))
        return ids.astype(np.int64, copy=False).view(np.uint64)
    if ids.dtype.kind == "O":
        return _checked_ids(ids, name)
    raise invalid(name, f"is an array of {ids.dtype}, not of whole numbers")


def _is_typed(given: object) -> bool:
    """Whether it says of itself what its numbers are."""
    return isinstance(given, np.ndarray) or hasattr(given, "__array__")


NO_ID = "is not a whole number from 0 to 18446744073709551615"


def _range_type(given: range) -> type[np.int64] | type[np.uint64]:
    return np.uint64 if given and max(given[0], given[-1]) > np.iinfo(np.int64).max else np.int64


def _checked_ids(ids: NDArray[Any], name: str) -> NDArray[np.uint64]:
    """Python integers one by one: NumPy keeps them as objects where signs and sizes have no type in common."""
    for index, value in enumerate(ids):
        if not isinstance(value, int) or not 0 <= value < 1 << 64:
            raise invalid(f"{name}[{index}]", NO_ID, value)
    return ids.astype(np.uint64)


def positions_of(given: ArrayLike, name: str = "corners") -> Positions:
    """Positions, a row each; one alone is an array of one row. Floats are in user units; arrays of integers are in lattice steps."""
    # A list of numbers has no type of its own: [0, 6, 0] says six units, as [0, 6, 0.5] does.
    try:
        rows: NDArray[Any] = np.asarray(given) if _is_typed(given) else np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise invalid(name, f"is not an array of positions: {error}") from None
    if rows.ndim == 1 and rows.shape[0] == 3:
        rows = rows.reshape(1, 3)
    if rows.size == 0:
        rows = rows.reshape(0, 3)
    if rows.ndim != 2 or rows.shape[1] != 3:
        raise invalid(name, f"has the shape {rows.shape}, not (count, 3)")
    if rows.dtype.kind == "f":
        return rows.astype(np.float64, copy=False)
    if rows.dtype.kind == "i":
        return rows.astype(np.int64, copy=False)
    if rows.dtype.kind == "u":
        # What does not fit stays out of every scene's range.
        steps: NDArray[np.int64] = np.minimum(rows, np.uint64(np.iinfo(np.int64).max)).astype(np.int64)
        return steps
    raise invalid(name, f"is an array of {rows.dtype}, not of floats (user units) or integers (lattice steps)")


def same_count(ids: NDArray[np.uint64] | None, positions: Positions, name: str = "corners") -> None:
    """Refuses ids and positions that are not as many."""
    if ids is not None and len(ids) != len(positions):
        raise invalid("ids", f"has {len(ids):,} entries, and {name} has {len(positions):,}")


def whole_of(name: str, value: Any) -> int:
    """A whole number that fits the messages, of Python's own type."""
    try:
        number = operator.index(value)
    except TypeError:
        number = -1
    if not 0 <= number < 1 << 64:
        raise invalid(name, NO_ID, value)
    return number
