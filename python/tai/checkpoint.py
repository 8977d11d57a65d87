"""`ti.checkpoint`: the numbers of fields and arrays, saved to a file and loaded from it.

```python
ti.checkpoint.save("run.npz", x=x, v=v, particles=particles)
ti.checkpoint.load("run.npz", x=x, v=v, particles=particles)
```

A file is whole at any time: it is written under another name and then renamed. The ranks of a mesh
save and load together: each writes a file with its rows of sharded fields beside the main file.
"""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from ._impl.base import pieces
from ._impl.base.files import replacing
from ._impl.base.keywords import check_keywords
from ._impl.base.program import get_program
from ._impl.fields.arrays import Ndarray
from ._impl.fields.field import Field
from ._impl.fields.root import materialize
from ._impl.fields.shard_files import load_shards, mesh_of_program, on_all, rows_for, save_shards
from ._impl.fields.shard_rows import put_rows, sharding_of
from ._impl.fields.structs import StructField
from .errors import TaiRuntimeError, TaiRuntimeTypeError


def _leaves(name: str, thing: Any) -> Iterator[tuple[str, Any]]:
    """The fields and arrays in a container or object, by name."""
    if isinstance(thing, StructField):
        for key, member in thing.members.items():
            yield from _leaves(f"{name}.{key}", member)
    elif isinstance(thing, (Field, Ndarray)):
        yield name, thing
    elif isinstance(thing, Mapping):
        for key, member in thing.items():
            yield from _leaves(f"{name}.{key}" if name else str(key), member)
    elif isinstance(thing, (list, tuple)):
        for number, member in enumerate(thing):
            yield from _leaves(f"{name}.{number}" if name else str(number), member)
    elif hasattr(thing, "__dict__") and not isinstance(thing, type):
        found = {k: m for k, m in vars(thing).items()
                 if isinstance(m, (Field, Ndarray, list, tuple, dict))}  # fmt: skip
        if not found and not name:
            raise TaiRuntimeTypeError(f"{thing!r} has no fields to save")
        for key, value in found.items():
            if _holds_fields(value):
                yield from _leaves(f"{name}.{key}" if name else key, value)
    else:
        raise TaiRuntimeTypeError(
            f"'{name}' is no field, array or object that holds some, but {thing!r}",
            "ti.checkpoint.save(path, x=x)",
        )


def _holds_fields(thing: Any) -> bool:
    if isinstance(thing, (Field, Ndarray)):
        return True
    items = thing.values() if isinstance(thing, dict) else thing
    return bool(items) and all(isinstance(item, (Field, Ndarray)) for item in items)


def _collect(fields: Any, named: Mapping[str, Any], gradients: bool) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if fields is None and not named:
        for name, field in _of_program().items():
            found[name] = field
    pairs = [*_leaves("", fields)] if fields is not None else []
    for name, thing in [*pairs, *_leaves("", dict(named))]:
        if name in found:
            raise TaiRuntimeTypeError(f"two fields have the name '{name}'")
        found[name] = thing
    if gradients:
        for name, thing in list(found.items()):
            grad = getattr(thing, "grad", None)
            if grad is not None and (isinstance(grad, Ndarray) or grad.level is not None):
                found[f"{name}.grad"] = grad
    if not found:
        raise TaiRuntimeTypeError("there are no fields to save or load")
    return found


def _of_program() -> dict[str, Any]:
    """All fields of the program that runs, by the names that they have in IR."""
    program = get_program()
    materialize(program)
    return {symbol: f for symbol, f in program.fields.items() if f.role == "primal"}


def state(fields: Any = None, /, *, gradients: bool = False, **named: Any) -> dict[str, np.ndarray]:
    """Copies the numbers of fields and arrays; returns a dictionary of arrays by name, which can be
    pickled.

    Args:
        fields: a dictionary or a list of fields, or an object that has them as attributes. Without
            any, all fields of the program, by the names that they have in IR.
        gradients: take the gradients, too.
        named: fields, arrays, and containers of them, by name.
    """
    found = _collect(fields, named, gradients)
    return {name: pieces.row_major(thing.to_numpy()) for name, thing in found.items()}


def restore(
    arrays: Mapping[str, Any], fields: Any = None, /, *, strict: bool = True, **named: Any
) -> list[str]:
    """Copies arrays, as `state` gives them, into the fields that have their names.

    Nothing is changed unless all of them fit.

    Args:
        arrays: by name.
        fields, named: as for `state`; gradients are restored where `arrays` has them.
        strict: refuse names that only one side has.

    Returns:
        The names that were restored.

    Raises:
        TaiRuntimeError: a field without an array, or an array without a field.
        TaiRuntimeTypeError: an array of another shape or kind of numbers.
    """
    mesh = mesh_of_program()

    def check() -> list[tuple[str, Any, np.ndarray]]:
        return _match(arrays, fields, strict, named)

    # On a mesh, all ranks restore, or none.
    pairs = check() if mesh is None else on_all(mesh, "restoring a checkpoint", check)
    for _, thing, array in pairs:
        if sharding_of(thing) is None:
            thing.from_numpy(array)
        else:
            put_rows(thing, array)
    return [name for name, _, _ in pairs]


def _match(
    arrays: Mapping[str, Any], fields: Any, strict: bool, named: Mapping[str, Any]
) -> list[tuple[str, Any, np.ndarray]]:
    """The fields that are restored, by name, with their numbers, or this rank's rows of them."""
    has_gradients = any(name.endswith(".grad") for name in arrays)
    found = _collect(fields, named, has_gradients)
    if has_gradients:  # of some fields only
        found = {n: f for n, f in found.items() if n in arrays or not n.endswith(".grad")}
    missing, more = [n for n in found if n not in arrays], [n for n in arrays if n not in found]
    if strict and (missing or more):
        problem = (
            f"holds no '{missing[0]}'" if missing else f"holds '{more[0]}', which is no field here"
        )
        names = ", ".join(f"'{name}'" for name in arrays)
        raise TaiRuntimeError(
            f"the checkpoint {problem}; it holds {names}",
            "name the fields as they were saved, or pass strict=False",
        )
    pairs = [(name, thing, _as_array(arrays[name])) for name, thing in found.items()
             if name in arrays]  # fmt: skip
    for name, thing, array in pairs:
        wanted = tuple(thing.shape) + tuple(thing.element_shape)
        if array.shape != wanted:
            raise TaiRuntimeTypeError(
                f"'{name}' has shape {array.shape} in the checkpoint, but {wanted} here"
            )
        if (array.dtype.kind == "f") != thing.dtype.is_float:
            raise TaiRuntimeTypeError(
                f"'{name}' holds {array.dtype} in the checkpoint, but {thing.dtype} here"
            )
    return [(name, thing, rows_for(thing, array)) for name, thing, array in pairs]


def _as_array(given: Any) -> Any:
    return given if hasattr(given, "rows") else np.asarray(given)


def _is_safetensors(path: Any) -> bool:
    return os.fspath(path).endswith(".safetensors")


def _safetensors() -> Any:
    try:
        import safetensors.numpy
    except ImportError:
        raise TaiRuntimeError(
            "files in the safetensors format need the package of that name",
            "pip install safetensors, or save a file whose name ends in .npz",
        ) from None
    return safetensors.numpy


def save(path: Any, fields: Any = None, /, *, gradients: bool = False, **named: Any) -> list[str]:
    """Saves the numbers of fields and arrays to a file.

    Args:
        path: of the file. If its name ends in `.safetensors`, that is the format; else it is
            NumPy's `.npz`.
        fields, gradients, named: as for `state`.

    Returns:
        The names in the file.
    """
    found = _collect(fields, named, gradients)
    mesh = mesh_of_program()
    if mesh is not None:
        save_shards(mesh, path, found, _write, _read)
    else:
        _write(path, state(found))
    return list(found)


def _write(path: Any, arrays: Mapping[str, np.ndarray]) -> None:
    if _is_safetensors(path):
        content = _safetensors().save(dict(arrays), {"format": "tai"})
        with replacing(path) as stream:
            for first in range(0, len(content), pieces.PIECE):
                stream.write(memoryview(content)[first : first + pieces.PIECE])
    else:
        with replacing(path) as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]


def load(path: Any, fields: Any = None, /, *, strict: bool = True, **named: Any) -> list[str]:
    """Loads numbers from a file into fields and arrays, as `restore` does.

    Args:
        path: of a file that `save`, `np.savez` or safetensors wrote.
        fields, strict, named: as for `restore`.

    Returns:
        The names that were loaded.

    Raises:
        TaiRuntimeError: the file is none of these; see `restore` for others.
    """
    mesh = mesh_of_program()

    def read() -> dict[str, Any]:
        return load_shards(path, _read(path), _read)

    arrays = read() if mesh is None else on_all(mesh, "loading a checkpoint", read)
    return restore(arrays, fields, strict=strict, **named)


def _read(path: Any) -> dict[str, Any]:
    if _is_safetensors(path):
        with open(path, "rb") as stream:
            content = stream.read()
        try:
            return dict(_safetensors().load(content))
        except TaiRuntimeError:
            raise
        except Exception as error:
            raise TaiRuntimeError(f"'{os.fspath(path)}' is no checkpoint: {error}") from None
    try:
        with np.load(path) as file:
            return {name: file[name] for name in file.files}
    except (ValueError, zipfile.BadZipFile, EOFError, AttributeError) as error:
        raise TaiRuntimeError(f"'{os.fspath(path)}' is no checkpoint: {error}") from None


check_keywords(globals())
