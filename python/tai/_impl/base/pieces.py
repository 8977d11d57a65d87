"""Work of NumPy on large arrays that Ctrl-C can end.

Python answers signals between two calls of NumPy, of which one on a large array takes long.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

Result = TypeVar("Result")

# The number of bytes that are copied at once, which takes some milliseconds.
PIECE = 16 << 20
# From this number of elements on, sorting and similar work take longer than the start of a thread.
_MANY = 1 << 18


def copy(target: Any, source: Any) -> None:
    """Copies an array, a tensor or a number to another one, as `target[...] = source` does."""
    if target.nbytes < 2 * PIECE or not target.shape:
        target[...] = source
        return
    is_number = not getattr(source, "shape", ())
    if not is_number and tuple(source.shape) != tuple(target.shape):
        source = np.broadcast_to(source, target.shape)
    rows = target.shape[0]
    step = max(PIECE * rows // target.nbytes, 1)
    for first in range(0, rows, step):
        # An array of a single row is copied by the rows of that row.
        part = slice(first, first + step) if rows > 1 else 0
        copy(target[part], source if is_number else source[part])


def copied(array: np.ndarray, dtype: Any = None) -> np.ndarray:
    """Returns a copy of an array in row-major order."""
    made = np.empty(array.shape, array.dtype if dtype is None else dtype)
    copy(made, array)
    return made


def row_major(array: np.ndarray, dtype: Any = None) -> np.ndarray:
    """Returns the array, or a copy of it if it is not in row-major order or has another type."""
    wanted = array.dtype if dtype is None else np.dtype(dtype)
    if array.flags.c_contiguous and array.dtype == wanted:
        return array
    return copied(array, wanted)


def beside(work: Callable[[], Result], elements: int) -> Result:
    """Calls a NumPy function without side effects, such as a sort, and returns its result.

    A long one runs on a thread of its own, which an interruption leaves to itself.
    """
    if elements < _MANY or threading.current_thread() is not threading.main_thread():
        return work()
    results: list[Result] = []
    errors: list[BaseException] = []

    def run() -> None:
        try:
            results.append(work())
        except BaseException as error:  # raised where the caller waits
            errors.append(error)

    thread = threading.Thread(target=run, name="tai-beside", daemon=True)
    thread.start()
    thread.join()
    if errors:
        raise errors[0]
    return results[0]
