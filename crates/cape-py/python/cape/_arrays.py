"""Arguments as arrays of floating-point numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._cape import CapeError

#: Bodies that are computed in one call of the library. Between two calls Python sees Ctrl-C.
BATCH = 64


def real(name: str, values: ArrayLike) -> NDArray[Any]:
    """Real numbers of any type; an array or a tensor on the CPU is not copied."""
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biuf":
            raise TypeError(f"numbers of type {array.dtype}, expected real ones")
        return array
    except (TypeError, ValueError, RuntimeError) as error:
        raise CapeError(f"{name}: {error}") from error


def floats(name: str, values: ArrayLike) -> NDArray[np.float32]:
    """Real numbers in single precision; those that are too large for it become infinite."""
    if type(values) is np.ndarray and values.dtype == np.float32:
        return values
    with np.errstate(over="ignore"):
        return real(name, values).astype(np.float32, copy=False)


def matrix(name: str, values: ArrayLike | None, width: int) -> NDArray[np.float32]:
    """Rows [n, width]; one row is [width] as well, zero if left out; [n, a, b] with a b = width."""
    if values is None:
        return np.zeros((1, width), dtype=np.float32)
    array = floats(name, values)
    rows = array[None] if array.ndim == 1 else array
    if rows.ndim == 3:
        rows = rows.reshape(len(rows), rows.shape[1] * rows.shape[2])
    if rows.ndim != 2 or rows.shape[1] != width or len(rows) == 0:
        raise CapeError(f"{name}: shape {list(array.shape)}, expected [n, {width}]")
    return rows


def points(name: str, values: ArrayLike, vertices: int) -> NDArray[np.float32]:
    """Points [n, vertices, 3]; those of one body are [vertices, 3] as well."""
    array = floats(name, values)
    bodies = array[None] if array.ndim == 2 else array
    if bodies.ndim != 3 or bodies.shape[1:] != (vertices, 3) or len(bodies) == 0:
        raise CapeError(f"{name}: shape {list(array.shape)}, expected [n, {vertices}, 3]")
    return bodies


def repeat(name: str, array: NDArray[np.float32], n: int) -> NDArray[np.float32]:
    """The rows of an array, or its only one n times."""
    if len(array) == n:
        return array
    if len(array) != 1:
        raise CapeError(f"{name}: {len(array)} rows, expected 1 or {n}")
    return np.broadcast_to(array, (n, *array.shape[1:]))


def batches(n: int, size: int = BATCH) -> Iterator[slice]:
    """Consecutive ranges of n rows."""
    return (slice(start, min(start + size, n)) for start in range(0, n, size))
