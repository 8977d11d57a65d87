"""The active cells of sparse fields as arrays and files, and back.

```python
coordinates, values = ti.volumes.to_numpy(x)   # (n, rank) and (n, *element shape)
ti.volumes.from_numpy(x, coordinates, values)  # exactly these cells are active then
ti.volumes.save("x.npz", density=x)
```
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from ._impl.base.dtypes import f16, f32
from ._impl.base.files import replacing, replacing_name
from ._impl.base.keywords import check_keywords
from ._impl.fields.active import write_elements
from ._impl.fields.field import Field
from ._impl.fields.matrix_field import MatrixField
from ._impl.fields.scalar import ScalarField
from ._impl.fields.snode import SNode
from .errors import TaiError, TaiRuntimeError, TaiRuntimeTypeError

_FORMAT = 1


def innermost(field: Field) -> SNode:
    """The sparse level that says which elements of a field are active.

    Raises:
        TaiRuntimeError: the field is not placed, or all of its elements exist.
    """
    for level in reversed(field._placed_node().path()):
        if level.kind != "dense":
            return level
    raise TaiRuntimeError(
        f"all elements of field '{field.name}' exist: it is below no sparse level",
        "use x.to_numpy()",
    )


def coordinates(field: Field) -> np.ndarray:
    """Returns the indices of the active elements of a field.

    Returns:
        int64 of shape (number of active elements, dimensions), cells in the order of memory.
    """
    level = innermost(field)
    cells = level.active_cells()
    shape, own = field.shape, level.axis_extents()
    axes = list(field._placed_node().axis_extents())
    # Each active cell is a box of elements.
    spans = [n // own.get(axis, 1) for axis, n in zip(axes, shape, strict=True)]
    first = np.zeros((len(cells), len(axes)), np.int64)
    for column, axis in enumerate(own):
        dimension = axes.index(axis)
        first[:, dimension] = cells[:, column] * spans[dimension]
    inside = np.stack(np.meshgrid(*map(np.arange, spans), indexing="ij"), axis=-1)
    inside = inside.reshape(-1, len(axes))
    found = (first[:, None, :] + inside[None, :, :]).reshape(-1, len(axes))
    return found + np.array(field.offset or (0,) * len(axes), np.int64)


def _check(field: Any, what: str) -> list[tuple[ScalarField, Any]]:
    """The storage places of a field, each with the components that it holds."""
    if isinstance(field, MatrixField):
        if field.single is not None:
            return [(field.single, ...)]
        return [(c, (..., *c._indices)) for c in field.components]
    if not isinstance(field, ScalarField) or field.storage()[0] is not field:
        raise TaiRuntimeTypeError(
            f"{what} takes a field of numbers, vectors or matrices, but got {field!r}",
            "take the members of a struct field, and whole vector fields, one by one",
        )
    return [(field, ...)]


def _indices(field: Field, where: Any) -> np.ndarray:
    indices = np.ascontiguousarray(where, np.int64)
    if indices.ndim == 1 and len(field.shape) == 1:
        indices = indices[:, None]
    if indices.ndim != 2 or indices.shape[1] != len(field.shape):
        raise TaiRuntimeTypeError(
            f"coordinates of field '{field.name}' have shape (n, {len(field.shape)}), "
            f"but got {indices.shape}"
        )
    return indices


def read(field: Field, where: Any) -> np.ndarray:
    """Reads the elements of a field at coordinates (n, dimensions), as an array (n, *element
    shape).
    """
    parts, indices = _check(field, "ti.volumes.read"), _indices(field, where)
    values = np.zeros((len(indices), *field.element_shape), field.dtype.numpy)
    for place, components in parts:
        part = np.empty((len(indices), *place.element_shape), field.dtype.numpy)
        place.core.read_elements(indices, part)
        values[components] = part
    return values


def write(field: Field, where: Any, values: Any) -> None:
    """Sets the elements of a field at coordinates (n, dimensions); their cells become active.

    Args:
        values: an array (n, *element shape), or one element for all.
    """
    parts, indices = _check(field, "ti.volumes.write"), _indices(field, where)
    wanted = (len(indices), *field.element_shape)
    array = np.asarray(values, field.dtype.numpy)
    try:
        array = np.broadcast_to(array, wanted)
    except ValueError:
        raise TaiRuntimeTypeError(
            f"values of field '{field.name}' have shape {wanted}, but got {array.shape}"
        ) from None
    for place, components in parts:
        write_elements(place, indices, np.ascontiguousarray(array[components]))


def to_numpy(field: Field) -> tuple[np.ndarray, np.ndarray]:
    """Returns the coordinates of the active elements of a field, and their values.

    Returns:
        Coordinates, int64 of shape (n, dimensions), and values of shape (n, *element shape).
    """
    where = coordinates(field)
    return where, read(field, where)


def from_numpy(field: Field, where: Any, values: Any) -> None:
    """Activates exactly the cells that hold these elements, and sets the elements.

    All other elements of the field, and of other fields in the same cells, are dropped. In an
    active cell, elements that are not given are zero.
    """
    innermost(field).deactivate_all()
    write(field, where, values)


def save(path: str | os.PathLike, **fields: Field) -> None:
    """Writes the active elements of fields, under the names given, to a file.

    A file that is there is replaced when the new one is complete: after a failure it is as it was.

    Args:
        path: `.npz` for a NumPy archive, which holds `name.coordinates` and `name.values` of each
            field; `.vdb` for an OpenVDB file, of fields of three dimensions that hold f16 or f32
            numbers or vectors of three.

    Raises:
        TaiRuntimeError: the suffix, or a field that such a file cannot hold, or OpenVDB is not
            installed.
    """
    _format_of(path)[0](path, fields)


def load(path: str | os.PathLike, **fields: Field) -> None:
    """Reads fields from a file: exactly the elements in it are active then.

    Fields that share cells are best named together: loading one empties the cells of all.

    Raises:
        TaiRuntimeError: the file is of another kind or damaged, has no such name, or does not
            fit a field. No field has changed then.
    """
    found = _format_of(path)[1](path, fields)
    found = {name: _check_loaded(path, name, fields[name], *found[name]) for name in found}
    for field in fields.values():
        innermost(field).deactivate_all()
    for name, (where, values) in found.items():
        write(fields[name], where, values)


def _check_loaded(path: Any, name: str, field: Field, where: Any, values: Any) -> tuple:
    """The coordinates and values in a file, as arrays that fit the field."""

    def refuse(what: str) -> TaiRuntimeError:
        return TaiRuntimeError(
            f"{path} does not fit field '{name}': {what}", "load the field that it was saved from"
        )

    dimensions, elements = len(field.shape), tuple(field.element_shape)
    if where.dtype.kind not in "iu" or where.ndim != 2 or where.shape[1] != dimensions:
        raise refuse(
            f"its coordinates are of {where.dtype} and shape {where.shape}, but must be whole "
            f"numbers of shape (n, {dimensions})"
        )
    if values.dtype.kind not in "biuf" or values.shape != (len(where), *elements):
        raise refuse(
            f"its values are of {values.dtype} and shape {values.shape}, but must be numbers of "
            f"shape {(len(where), *elements)}"
        )
    first = np.array(field.offset or (0,) * dimensions, np.int64)
    last = first + np.array(field.shape, np.int64) - 1
    if ((where < first) | (where > last)).any():
        raise refuse(f"it has elements outside of {first.tolist()} to {last.tolist()}")
    return where, values


def _format_of(path: str | os.PathLike) -> tuple[Any, Any]:
    suffix = os.path.splitext(path)[1].lower()
    if suffix not in _FORMATS:
        raise TaiRuntimeError(
            f"no format of volumes has the suffix '{suffix}'", "the suffixes are .npz and .vdb"
        )
    return _FORMATS[suffix]


def _missing(path: Any, name: str, known: Any) -> TaiRuntimeError:
    return TaiRuntimeError(f"{path} has no field '{name}', but {', '.join(sorted(known))}")


# NumPy


def _save_npz(path: Any, fields: dict[str, Field]) -> None:
    arrays: dict[str, Any] = {"tai.volumes": np.array(_FORMAT)}
    for name, field in fields.items():
        arrays[f"{name}.coordinates"], arrays[f"{name}.values"] = to_numpy(field)
    with replacing(path) as stream:
        np.savez_compressed(stream, **arrays)


def _load_npz(path: Any, fields: dict[str, Field]) -> dict[str, tuple]:
    try:
        return _read_npz(path, fields)
    except (TaiError, FileNotFoundError, IsADirectoryError, PermissionError):
        raise
    except Exception as error:  # whatever zlib, zipfile and NumPy say of damaged files
        why = str(error) or type(error).__name__
        if "pickle" in why:  # NumPy takes a file of an unknown kind for a pickle
            why = "it is no archive of arrays"
        raise TaiRuntimeError(
            f"{path} is damaged, or no file of ti.volumes.save: {why}",
            "save it again",
        ) from error


def _read_npz(path: Any, fields: dict[str, Field]) -> dict[str, tuple]:
    with np.load(path) as archive:
        if "tai.volumes" not in archive or int(archive["tai.volumes"]) != _FORMAT:
            raise TaiRuntimeError(f"{path} is not a file of ti.volumes.save")
        known = [key[: -len(".values")] for key in archive if key.endswith(".values")]
        for name in fields:
            if name not in known:
                raise _missing(path, name, known)
        return {n: (archive[f"{n}.coordinates"], archive[f"{n}.values"]) for n in fields}


# OpenVDB


def _openvdb() -> Any:
    import importlib

    for name in ("openvdb", "pyopenvdb"):
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name != name:
                raise
    raise TaiRuntimeError(
        "OpenVDB files need the Python module of OpenVDB (openvdb or pyopenvdb)",
        "install python3-openvdb of Debian, or openvdb of conda-forge; .npz files need nothing",
    )


def _grid_type(field: Field, name: str) -> str:
    if len(field.shape) != 3:
        raise TaiRuntimeError(
            f"an OpenVDB grid has three dimensions, but field '{name}' has {len(field.shape)}"
        )
    kind = {(): "FloatGrid", (3,): "Vec3SGrid"}.get(field.element_shape)
    if kind is None or field.dtype not in (f16, f32):
        raise TaiRuntimeError(
            f"OpenVDB files hold f32 numbers and vectors of three, but field '{name}' is of "
            f"{field.dtype}" + (f" and shape {field.element_shape}" if field.element_shape else ""),
            "copy it to a field of ti.f32, or write a .npz file",
        )
    return kind


def _save_vdb(path: Any, fields: dict[str, Field]) -> None:
    kinds = {name: _grid_type(field, name) for name, field in fields.items()}
    vdb, grids = _openvdb(), []
    for name, field in fields.items():
        grid = getattr(vdb, kinds[name])()
        grid.name = name
        accessor = grid.getAccessor()
        where, values = to_numpy(field)
        for at, value in zip(where.tolist(), values.tolist(), strict=True):
            accessor.setValueOn(tuple(at), tuple(value) if field.element_shape else value)
        grids.append(grid)
    with replacing_name(path) as part:
        vdb.write(part, grids=grids)


def _load_vdb(path: Any, fields: dict[str, Field]) -> dict[str, tuple]:
    kinds = {name: _grid_type(field, name) for name, field in fields.items()}
    vdb = _openvdb()
    if not os.path.exists(path):
        raise FileNotFoundError(path)
    grids = {grid.name: grid for grid in vdb.readAll(os.fspath(path))[0]}
    found = {}
    for name, field in fields.items():
        if name not in grids:
            raise _missing(path, name, grids)
        if type(grids[name]).__name__ != kinds[name]:
            raise TaiRuntimeError(
                f"grid '{name}' of {path} is a {type(grids[name]).__name__}, and field '{name}' "
                f"takes a {kinds[name]}"
            )
        where, values = [], []
        for item in grids[name].citerOnValues():
            # A tile of OpenVDB stands for a box of voxels.
            ranges = (np.arange(a, b + 1) for a, b in zip(item.min, item.max, strict=True))
            box = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 3)
            where.append(box)
            values.append(np.broadcast_to(item.value, (len(box), *field.element_shape)))
        found[name] = (
            np.concatenate([np.empty((0, 3), np.int64), *where]),
            np.concatenate([np.empty((0, *field.element_shape), np.float32), *values]),
        )
    return found


_FORMATS = {".npz": (_save_npz, _load_npz), ".vdb": (_save_vdb, _load_vdb)}


check_keywords(globals())
