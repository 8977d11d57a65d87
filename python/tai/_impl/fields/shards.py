"""Rules of shards: the levels that divide fields among the processes of a mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...errors import TaiRuntimeError, TaiRuntimeTypeError
from ..base.program import get_program


def check_shard(axis: Any, above: Sequence[Any], letters: str) -> int:
    """Checks a new shard below some levels.

    Returns:
        The number of ranks that divide it.

    Raises:
        TaiRuntimeError: the program has no mesh, or a level above cannot stand there.
    """
    mesh = get_program().options.mesh
    if mesh is None:
        raise TaiRuntimeError(
            "the program has no mesh whose processes could share fields",
            'write ti.init(mesh=ti.mesh("x", 4)), and start it by torchrun --nproc-per-node 4',
        )
    if not isinstance(axis, tuple) or len(axis) != 1:
        raise TaiRuntimeTypeError(f"a shard has one axis, such as ti.i, but got {axis!r}")
    letter = letters[axis[0]]
    for level in above:
        if level.kind != "dense":
            raise TaiRuntimeError(f"a shard cannot stand below a {level.kind} level")
        if axis[0] in level.axes:
            raise TaiRuntimeError(
                f"a level above the shard divides axis {letter}",
                f"begin with the shard: ti.root.shard(ti.{letter}).dense(…)",
            )
    return int(mesh.ranks)


def check_below(parent: Any, kind: str, extents: Mapping[int, int], letters: str) -> None:
    """Checks a new level, with its extents by axis, if it is below a shard.

    Raises:
        TaiRuntimeError: it cannot stand there, or the ranks do not divide its extent.
    """
    shard = parent.above_shard()
    if shard is None:
        return
    if kind != "dense":
        raise TaiRuntimeError(
            f"a {kind} level cannot stand below a shard",
            "levels below a shard are dense: place the sparse field beside the shard, where each "
            "rank has a copy, or keep a dense field of the blocks",
        )
    extent = extents.get(shard.shard_axis)
    if extent is None:
        return
    letter = letters[shard.shard_axis]
    if any(shard.shard_axis in level.axes for level in parent.path()):
        raise TaiRuntimeError(f"two levels below a shard divide its axis {letter}")
    if extent % shard.ranks:
        raise TaiRuntimeError(
            f"the {shard.ranks} ranks of the mesh do not divide the extent {extent} of axis "
            f"{letter}",
            f"choose a multiple of {shard.ranks}",
        )
