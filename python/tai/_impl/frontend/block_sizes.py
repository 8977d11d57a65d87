"""Block sizes of loops on a GPU that the program chooses."""

from __future__ import annotations

import operator
from typing import Any

from ...errors import TaiTypeError
from ..base.options import Options

# Limits of every GPU: threads of a block, threads of a warp, and the default size of a block.
_MOST, _WARP, _USUAL = 1024, 32, 256


def check_block_dim(value: Any, options: Options) -> int:
    """The `block_dim` of a loop: threads of a block, 0 for the choice that suits the kernel.

    Raises:
        TaiTypeError: no number, or one that blocks of a GPU cannot have where there is one.
    """
    try:
        threads = -1 if isinstance(value, bool) else operator.index(value or 0)
    except TypeError:
        threads = -1
    if threads < 0:
        raise TaiTypeError(f"block_dim is a number of threads, but got {value!r}")
    possible = threads <= _MOST and (threads % _WARP == 0 or threads & (threads - 1) == 0)
    if options.arch == "cuda" and not possible:
        raise TaiTypeError(
            f"a GPU has no blocks of block_dim={threads} threads",
            f"say a multiple of {_WARP} or a power of two, {_MOST} at most",
        )
    return threads


def block_dim_of(loop: dict[str, Any], options: Options) -> int:
    """The block size that the options of `ti.loop_config` request; 0 if they request none."""
    if threads := loop.get("block_dim", 0):
        return threads
    if loop.get("block_dim_adaptive", True) or options.arch != "cuda":
        return 0
    # The loop must not get an adapted block size: it gets the usual size, which is the initial size
    # of all loops.
    usual = options.default_gpu_block_dim or _USUAL
    return min(usual, options.max_block_dim) if options.max_block_dim else usual
