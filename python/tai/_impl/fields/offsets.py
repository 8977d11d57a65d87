"""The layout of a cell: sizes and offsets of levels and fields, in bytes.

The rules are those of the compiler: fields are contiguous, each aligned to its scalar type;
children of the root are aligned to cache lines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from .snode import Place, SNode

_CACHE_LINE = 64


def _align(offset: int, alignment: int) -> int:
    return -(-offset // alignment) * alignment


def _number_size(field: Any) -> int:
    return field.dtype.numpy.itemsize


def _field_size(field: Any) -> int:
    count = 1
    for extent in field.element_shape:
        count *= extent
    return _number_size(field) * count


def _alignment(part: Any) -> int:
    if isinstance(part, tuple):
        child, role = part
        return max(map(_alignment, child.contents()[role]))
    return max(map(_number_size, part))


def _place_offset(record: list, field: Any = None) -> int:
    """Returns the offset of a field in a record; without a field, the end of the record."""
    offset = 0
    for other in record:
        offset = _align(offset, _number_size(other))
        if other is field:
            return offset
        offset += _field_size(other)
    return offset


def _size(part: Any) -> int:
    if not isinstance(part, tuple):
        return _align(_place_offset(part), _alignment(part))
    child, role = part
    cells = 1
    for extent in child.extents:
        cells *= extent
    return cells * _body_size(child.contents()[role])


def _body_size(body: list, wanted: Any = None, line: int = 1) -> int:
    """The number of bytes of a cell; if a part of the cell is given as `wanted`, the offset of that
    part.
    """
    offset = 0
    for part in body:
        offset = _align(offset, max(line, _alignment(part)))
        if part is wanted:
            return offset
        offset += _size(part)
    return _align(offset, max(map(_alignment, body)) if body and line == 1 else 1)


def cell_size(node: SNode) -> int:
    """Bytes of one cell of the primal values; of a place, 0, as it has no cells."""
    if node.kind == "place":
        return 0
    return _body_size(node.contents()["primal"], line=_CACHE_LINE if node.kind == "root" else 1)


def offset_in_parent(node: SNode) -> int:
    """Returns the offset of the first cell of a level, or of a field, in the cell above."""
    if node.kind == "root":
        return 0
    above = node._parent
    assert above is not None
    line = _CACHE_LINE if above.kind == "root" else 1
    for body in above.contents().values():
        for part in body:
            if node.kind != "place" and isinstance(part, tuple) and part[0] is node:
                return _body_size(body, part, line)
            if node.kind == "place" and isinstance(part, list):
                field, component = cast("Place", node).field.storage()
                if field in part:
                    begin = _body_size(body, part, line) + _place_offset(part, field)
                    return begin + component * _number_size(field)
    return 0
