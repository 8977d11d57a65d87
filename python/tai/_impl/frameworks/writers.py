"""Launches of an operator's forward run, whose gradient another launch computes later.

Where several iterations of a loop store to one element, a tape runs another form of the kernel, in
which the last iteration wins. A gradient is of that form, so the value has to be, too.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ...errors import TaiAutodiffError, TaiCompilationError
from ..ad.tape import Tape

# The name of a kernel that a tape runs in place of another one: see docs/decisions/0052.
_PART = re.compile(r"\.\d+$")


class ForwardRuns:
    """The forward runs of one operator, by the types of their operands.

    Args:
        operator: the name of the operator, for messages.
        as_variable: returns an operand in the form in which kernels are differentiated by it, or
            the operand itself.
        apart: returns the inputs, with copies of those that share memory with an earlier one.
    """

    def __init__(
        self,
        operator: str,
        as_variable: Callable[[Any], Any],
        apart: Callable[[Sequence[Any]], list[Any]],
    ):
        self._operator, self._as_variable, self._apart = operator, as_variable, apart
        # Whether the runs of a kind of operands need a tape.
        self._needs_tape: dict[tuple, bool] = {}

    def need_tape(self, kind: tuple) -> bool:
        """Whether runs of a kind are known to need a tape: other forms of kernels run under it."""
        return self._needs_tape.get(kind, False)

    def run(
        self,
        kind: tuple,
        launch: Callable[[Sequence[Any], Sequence[Any]], Any],
        inputs: Sequence[Any],
        outputs: Sequence[Any],
        clear: Callable[[Any], Any],
    ) -> Any:
        """Launches, under a tape of its own if the kind needs one or is new.

        Args:
            kind: see `kind_of`.
            launch: is called with inputs and outputs.
            inputs, outputs: of the launch; the outputs are zeros.
            clear: sets one output to zeros.

        Returns:
            What `launch` returns.
        """
        needs_tape = self._needs_tape.get(kind)
        if needs_tape is False:
            return launch(inputs, outputs)
        given = (
            list(map(self._as_variable, self._apart(inputs))),
            list(map(self._as_variable, outputs)),
        )
        try:
            with Tape(clear_gradients=False) as tape:
                answer = launch(*given)
        except (TaiAutodiffError, TaiCompilationError):
            if needs_tape:
                raise
            # The call itself is no error where only the gradient is one.
            self._needs_tape[kind] = False
            for output in outputs:
                clear(output)
            return launch(inputs, outputs)
        self._needs_tape.setdefault(kind, _runs_other_forms(tape))
        return answer

    def check(self, kind: tuple, tape: Tape) -> None:
        """Refuses the gradient of a forward run that had no tape, and needed one.

        Args:
            kind: of the operands of the run.
            tape: has recorded the run again, for its gradient.

        Raises:
            TaiAutodiffError: the tape has run other forms of kernels. Later forward runs of the
                kind have a tape.
        """
        # XLA may run a gradient before its forward run, which then decides for itself.
        if self._needs_tape.get(kind) is not False or not _runs_other_forms(tape):
            return
        self._needs_tape[kind] = True
        raise TaiAutodiffError(
            f"'{self._operator}' launches kernels whose iterations may store to one element, which "
            "its first call did not: the value of this call may be of another iteration than the "
            "gradient",
            "call it again: from now on both are of the last iteration",
        )


def kind_of(arrays: Iterable[Any]) -> tuple:
    """Returns the types and numbers of dimensions of arrays, one after another."""
    return tuple([part for array in arrays for part in (array.dtype, array.ndim)])


def _runs_other_forms(tape: Tape) -> bool:
    """Whether a tape has run other forms of kernels than launches outside of it run."""
    tape._note_use()
    core = tape._core
    names = (core.kernel_of(record) for record in range(core.records))
    return any(name is not None and _PART.search(name) for name in names)
