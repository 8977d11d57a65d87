"""Checkpoints of sharded fields: a main file, and a file with the rows of each rank.

The main file has the numbers of fields that are not sharded, and the names of the other files. It
is replaced last, so that it always stands for whole files.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from ...errors import TaiRuntimeError
from ..base.program import get_program
from .shard_rows import own_rows, sharding_of, stored_rows

# The name, in the main file, of the description of the other files.
KEY = "__shards__"

Write = Callable[[Any, Mapping[str, np.ndarray]], None]
Read = Callable[[Any], Any]


class StoredField:
    """A sharded field in the files of the ranks that wrote it."""

    def __init__(self, name: str, told: Mapping[str, Any], files: list[Any]):
        self.name, self.dimension, self._files = name, int(told["dimension"]), files
        self.shape, self.dtype = tuple(told["shape"]), np.dtype(told["dtype"])

    def rows(self, low: int, high: int) -> np.ndarray:
        """Rows along the dimension that was sharded."""
        count = self.shape[self.dimension] // len(self._files)
        parts = [(count, lambda file=file: file()[self.name]) for file in self._files]
        return stored_rows(parts, self.dimension, low, high)

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        array = self.rows(0, self.shape[self.dimension])
        return array if dtype is None else array.astype(dtype)


def rows_for(field: Any, array: Any) -> np.ndarray:
    """The part of an array, or of a stored field, that this rank has of a field."""
    sharding = sharding_of(field)
    if sharding is None:
        return np.asarray(array)
    mesh, dimension = sharding
    block = array.shape[dimension] // mesh.ranks
    low, high = mesh.rank * block, (mesh.rank + 1) * block
    if isinstance(array, StoredField) and array.dimension == dimension:
        return array.rows(low, high)
    return stored_rows([(array.shape[dimension], lambda: np.asarray(array))], dimension, low, high)


def mesh_of_program() -> Any:
    """The mesh of the program if it has several ranks, or None."""
    mesh = get_program().options.mesh
    return mesh if mesh is not None and mesh.ranks > 1 else None


def save_shards(mesh: Any, path: Any, fields: Mapping[str, Any], write: Write, read: Read) -> None:
    """Saves fields of all ranks, which call this together, to files beside `path`."""
    token = mesh.texts("saving a checkpoint", secrets.token_hex(8))[0]
    own, rest, told = {}, {}, {}
    for name, field in fields.items():
        sharding = sharding_of(field)
        if sharding is None:
            rest[name] = field.to_numpy()
            continue
        own[name] = own_rows(field)
        shape = tuple(field.shape) + tuple(field.element_shape)
        told[name] = {"dimension": sharding[1], "shape": shape, "dtype": own[name].dtype.str}

    def save() -> None:
        if own:
            write(_file(path, token, mesh.rank), own)

    def finish() -> None:
        if mesh.rank == 0:
            former = _described(path, read)
            text = json.dumps({"token": token, "ranks": mesh.ranks, "fields": told})
            if told:
                rest[KEY] = np.frombuffer(text.encode(), np.uint8)
            write(path, rest)
            _remove(path, former)

    try:
        _on_all(mesh, save)
        _on_all(mesh, finish)
    except BaseException:
        with contextlib.suppress(OSError):
            if _described(path, read).get("token") != token:
                os.unlink(_file(path, token, mesh.rank))
        raise


def load_shards(path: Any, arrays: dict[str, Any], read: Read) -> dict[str, Any]:
    """The arrays of a main file, with those of the other files, which are read when needed."""
    if KEY not in arrays:
        return arrays
    told = json.loads(bytes(np.asarray(arrays.pop(KEY), np.uint8)))
    names = [_file(path, told["token"], rank) for rank in range(told["ranks"])]
    for name in names:
        if not os.path.exists(name):
            raise TaiRuntimeError(
                f"the checkpoint '{os.fspath(path)}' has no file '{name}' beside it",
                "copy all files of a checkpoint together",
            )
    files = [_Once(name, read) for name in names]
    stored = {name: StoredField(name, each, files) for name, each in told["fields"].items()}
    return {**arrays, **stored}


class _Once:
    """The arrays of a file, opened by the first call."""

    def __init__(self, name: str, read: Read):
        self._name, self._read, self._arrays = name, read, None

    def __call__(self) -> Any:
        if self._arrays is None:
            self._arrays = self._read(self._name)
        return self._arrays


def on_all(mesh: Any, action: str, run: Callable[[], Any]) -> Any:
    """Runs `run` on all ranks; an exception of one of them becomes an error of all."""
    failure: BaseException | None = None
    result = None
    try:
        result = run()
    except Exception as error:
        failure = error
    try:
        mesh.agree(action, "" if failure is None else str(getattr(failure, "message", failure)))
    except TaiRuntimeError as error:
        raise failure or error from None
    return result


def _on_all(mesh: Any, run: Callable[[], Any]) -> None:
    on_all(mesh, "saving a checkpoint", run)


def _file(path: Any, token: str, rank: int) -> str:
    root, suffix = os.path.splitext(os.fspath(path))
    return f"{root}.{token}.{rank}{suffix}"


def _described(path: Any, read: Read) -> dict[str, Any]:
    """The description in the main file at a path, if there is one."""
    try:
        arrays = read(path)
        return dict(json.loads(bytes(np.asarray(arrays[KEY], np.uint8))))
    except Exception:
        return {}


def _remove(path: Any, told: Mapping[str, Any]) -> None:
    """Removes the files of a former checkpoint."""
    for rank in range(told.get("ranks", 0)):
        with contextlib.suppress(OSError):
            os.unlink(_file(path, told["token"], rank))
