"""Launches of an operator's forward run, whose gradient another launch computes later.

Where several iterations of a loop store to one element, a tape runs another form of the kernel, in
which the last iteration wins. A gradient is of that form, so the value has to be, too.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from ...errors import TaiAutodiffError
from ..ad.tape import Tape

# The name of a kernel that a tape runs in place of another one: see docs/decisions/0052.
_PART = re.compile(r"\.\d+$")


def run_recorded(launch: Callable[[], Any]) -> tuple[Any, bool]:
    """Runs launches under a tape of their own.

    Returns:
        What `launch` returns, and whether the tape has run other forms of kernels.
    """
    with Tape(clear_gradients=False) as tape:
        answer = launch()
    return answer, runs_other_forms(tape)


def runs_other_forms(tape: Tape) -> bool:
    """Whether a tape has run other forms of kernels than launches outside of it run."""
    core = tape._core
    names = (core.kernel_of(record) for record in range(core.records))
    return any(name is not None and _PART.search(name) for name in names)


def check_forms(tape: Tape, operator: str, note: Callable[[], Any]) -> None:
    """Refuses the gradient of a forward run that had no tape, and needed one.

    Args:
        tape: has recorded the run again, for its gradient.
        operator: its name, for messages.
        note: makes later forward runs have one.

    Raises:
        TaiAutodiffError: the tape has run other forms of kernels.
    """
    if runs_other_forms(tape):
        note()
        raise TaiAutodiffError(
            f"'{operator}' launches kernels whose iterations may store to one element, which its "
            "first call did not: the value of this call may be of another iteration than the "
            "gradient",
            "call it again: from now on both are of the last iteration",
        )
