"""`tai.export`: the launches of a function and their gradient, for hosts without Python."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

from ...errors import TaiRuntimeTypeError
from ..base.keywords import check_keywords
from ..base.program import get_program
from ..fields.field import Field
from ..fields.root import materialize
from .snapshot import Snapshot, storage
from .tape import Tape


def _parts(fields: Any, name: str) -> list[Any]:
    listed = list(fields) if isinstance(fields, (list, tuple)) else [fields]
    for f in listed:
        if not isinstance(f, Field):
            raise TaiRuntimeTypeError(f"'{name}' holds {f!r}, which is no field", f"{name}=[x, v]")
    return [part for f in listed for part in storage(f)]


def export(
    run: Callable[[], Any], loss: Field, wrt: Field | Sequence[Field], path: str | os.PathLike[str]
) -> None:
    """Writes the kernels that a function launches, and their gradient, to a file.

    ```python
    tai.export(simulate, loss, [x, stiffness], "robot.tai")
    ```

    The file has the kernels, the fields that they use with their contents before the call, the
    sequence of launches with its arguments, and the names of the loss and of `wrt`. Programs in C,
    C++ and other languages load it with `taiProgramLoadFile` of the C API: its function `run`
    launches the kernels, and `gradient` does so under a tape. Python is not needed there; the
    kernels are compiled by `libtai`, and kept in its cache.

    The arguments of launches are those of this call, also where the function has read them from a
    field. Fields are as before afterwards.

    Args:
        run: a function that launches kernels of fields without sparse levels. Arrays as arguments,
            functions with a gradient of their own, and writes to single elements are refused.
        loss: a field of one number that has a gradient.
        wrt: the fields whose gradients the host asks for.
        path: the file; it is whole, or not there.
    """
    materialize(get_program())
    losses = _parts([loss], "loss")
    fields = _parts(wrt, "wrt")
    if len(losses) != 1 or losses[0].shape + losses[0].element_shape:
        raise TaiRuntimeTypeError("the loss is a field of one number, of shape ()")
    with Snapshot() as before:
        with Tape(None, clear_gradients=False) as tape:
            run()
        tape._note_reading()
        before.restore()
        losses[0].core.fill(0.0)
        tape._core.save(os.fspath(path), losses[0].core, [f.core for f in fields])


check_keywords(globals(), ["export"])
