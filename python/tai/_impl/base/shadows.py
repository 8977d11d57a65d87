"""The report of shadow execution: `ti.tools.shadow_report()`."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

from ...errors import TaiRuntimeError, shorten, source_line, spelled
from .program import get_program
from .rewrites import Rewrite, propose


@dataclass
class ShadowRow:
    """Loss of precision at one operation of one line, over all launches.

    Attributes:
        filename, lineno, column: its place; None, 0 and 0 where it has none.
        kernel: the kernel, or its adjoint.
        operation: `+`, `sin`, `comparison`, `conversion to an integer`, …
        lost: results of which less than half of the bits are right, though those of the operands
            were.
        cancellations: how many of these are sums or differences of much larger numbers.
        flips: comparisons and conversions whose results differ in higher precision.
        non_finite: results that are infinite or NaN, and finite in higher precision.
        error: relative error of the result that lost most digits, 1 at the most.
        error_in: that of its operands; of a comparison, the greatest.
        digits_lost: decimal digits that the operands had and the result has not.
        rewrite: another form of the expression that has been found to lose fewer, or None.
    """

    filename: str | None
    lineno: int
    column: int
    kernel: str
    operation: str
    lost: int
    cancellations: int
    flips: int
    non_finite: int
    error: float
    error_in: float
    digits_lost: float
    rewrite: Rewrite | None = None

    def summary(self) -> str:
        """The events, in words."""
        parts = []
        if self.lost:
            text = f"{self.digits_lost:.1f} digits lost ({self.lost} times"
            if self.cancellations:
                text += f", {self.cancellations} by cancellation"
            parts.append(f"{text}), error {self.error:.1e} from {self.error_in:.1e}")
        if self.flips:
            parts.append(f"{self.flips} come out otherwise")
        if self.non_finite:
            parts.append(f"{self.non_finite} not finite")
        if self.rewrite is not None:
            parts.append(f"write {self.rewrite.after}")
        return f"{self.operation}: {'; '.join(parts)}"


class ShadowReport(list):
    """Rows (`ShadowRow`), those that lose most digits first; `str` makes a table of them."""

    def __str__(self) -> str:
        if not self:
            return "no digits lost: no result has less than half of its bits right"
        head = (f"{'digits':>6} {'error':>8} {'error in':>8} {'times':>9} {'cancel':>9} "
                f"{'flips':>9} {'not fin.':>8}  where")  # fmt: skip
        lines = [head]
        for row in self:
            place = f"{shorten(row.filename)}:{row.lineno}" if row.filename else "?"
            if row.lost:
                digits, error = f"{row.digits_lost:.1f}", f"{row.error:.1e}"
            else:
                digits, error = "", ""
            source = f"{row.error_in:.1e}" if row.lost or row.flips else ""
            lines.append(
                f"{digits:>6} {error:>8} {source:>8} {row.lost:>9} {row.cancellations:>9} "
                f"{row.flips:>9} {row.non_finite:>8}  {place} {row.operation} in {row.kernel}"
            )
        for row in self:
            if row.rewrite is not None:
                lines.append(f"{shorten(row.filename)}:{row.lineno} rewrite: {row.rewrite}")
        return "\n".join(lines)

    def on_source(self) -> str:
        """The source lines with findings, each followed by its finding, under the column."""
        by_file: dict[str, dict[int, list[ShadowRow]]] = defaultdict(lambda: defaultdict(list))
        for row in self:
            if row.filename:
                by_file[row.filename][row.lineno].append(row)
        lines = []
        for filename, rows in by_file.items():
            lines.append(f"{shorten(filename)}:")
            for lineno in sorted(rows):
                lines.append(f"{lineno:>6} | {source_line(filename, lineno).rstrip()}")
                for row in rows[lineno]:
                    indent = " " * max(row.column - 1, 0)
                    lines.append(f"{'':>6} | {indent}^ {row.summary()}")
        return "\n".join(lines)


def _place(text: str) -> tuple[str | None, int, int]:
    parts = text.rsplit(":", 2)
    if len(parts) != 3 or not parts[1].isdigit():
        return None, 0, 0
    return parts[0], int(parts[1]), int(parts[2])


def context() -> Any:
    """Returns the context of the program, which must have shadow values."""
    program = get_program()
    if not program.has_shadows:
        raise TaiRuntimeError(
            "kernels have no shadows",
            "ask for them in front of the program, ti.init(shadow=True), or for a part of it, "
            "with ti.tools.shadows():",
        )
    return program.context


def shadow_report() -> ShadowReport:
    """Reports the lines that lost digits since `ti.init(shadow=True)` or `clear_shadow_report`.

    In a program without that option, in blocks of `ti.tools.shadows`.

    See docs/guides/shadow.md.
    """
    report = ShadowReport()
    for row in context().shadow_rows():
        operation, kernel, place, precision, *counts, error, error_in, bits = row
        lost, cancellations, flips, non_finite = counts
        digits = bits * math.log10(2)
        where = _place(place)
        rewrite = None
        if lost or non_finite:
            rewrite = propose(*where, precision, error, overflows=not lost)
        report.append(
            ShadowRow(*where, spelled(kernel), operation, lost, cancellations, flips,
                      non_finite, error, error_in, digits, rewrite)
        )  # fmt: skip
    return report


def clear_shadow_report() -> None:
    """Resets the report."""
    context().clear_shadows()
