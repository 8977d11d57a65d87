"""The messages of `ti.ad.Tape(loss, validation=True)` on violated access rules."""

from __future__ import annotations

from typing import Any, NamedTuple

from ...errors import TaiAssertionError, shorten, show_line

# The most violations that a tape keeps. The error message shows fewer.
LIMIT = 100
_SHOWN = 10

# For each number of TaiViolation.kind: the violation, and the effect of the earlier access.
_KINDS = [
    ("is overwritten after it was read", "read here"),
    ("is accumulated after it was read", "read here"),
    ("is written a second time, not by an accumulation", "written here"),
    ("is written by two iterations of one loop", "the other writes here"),
    ("is read while other iterations of the loop still write it", "written here"),
]
_RACES = (3, 4)


class Place(NamedTuple):
    """Describes one access to an element: kernel, launch and source location.

    Attributes:
        kernel: the name of the kernel.
        launch: which launch under the tape, from 0.
        filename, lineno, column: where the access stands, 1-based.
    """

    kernel: str
    launch: int
    filename: str
    lineno: int
    column: int


class Violation(NamedTuple):
    """Describes a violation of the data access rules at one element.

    Attributes:
        message: the violation, such as "x[3] is overwritten after it was read".
        field: the name of the field.
        index: the indices of the element.
        component: the component of a vector or matrix (row-major), or None.
        access: the access that broke the rule.
        earlier: the one that it is in conflict with, or None where it was lost in a race.
    """

    message: str
    field: str
    index: tuple[int, ...]  # type: ignore[assignment]  # of a NamedTuple, no method of tuples
    component: int | None
    access: Place
    earlier: Place | None


def take_violations(tape: Any) -> tuple[int, list[Violation]]:
    """The number of broken rules in the launches of a tape, and the first of them."""
    total, rows = tape.violations()
    found = []
    for kind, field, index, component, access, earlier in rows:
        element = f"'{field}'" + (f"[{', '.join(map(str, index))}]" if index else "[None]")
        if component >= 0:
            element += f" (component {component})"
        found.append(
            Violation(
                f"{element} {_KINDS[kind][0]}",
                field,
                index,
                component if component >= 0 else None,
                _place(access),
                _place(earlier) if earlier[1] >= 0 else None,
            )
        )
    return total, found


def _place(row: tuple) -> Place:
    kernel, launch, _, file, line, column = row
    # A kernel may be launched in parts, "k.0", "k.1", which are reported as "k".
    return Place(kernel.partition(".")[0], launch, file, line, column)


def _where(place: Place) -> str:
    return f"in kernel '{place.kernel}', launch {place.launch} of the tape"


def _describe(place: Place) -> list[str]:
    if not place.filename:
        return [f"  {_where(place)}"]
    lines = [f"  --> {shorten(place.filename)}:{place.lineno}:{place.column} {_where(place)}"]
    return lines + show_line(place.filename, place.lineno, place.column)


def raise_violations(tape: Any) -> None:
    """Raises `TaiAssertionError` if a data access rule was broken; its `violations` list them."""
    total, found = take_violations(tape)
    if not total:
        return
    _, rows = tape.violations()
    times = "once" if total == 1 else f"{total} times"
    if rows[0][0] in _RACES:
        hint = "accumulate by +=, or run the loop on one thread: ti.loop_config(serialize=True)"
    else:
        hint = (
            "store to another element, such as one more time step of the field, and accumulate "
            "by += what is written more than once; or leave validation out: the tape then saves "
            "what is overwritten"
        )
    error = TaiAssertionError(
        f"the global data access rules are broken {times}: {found[0].message}", hint
    )
    first = found[0].access
    if first.filename:
        error.locate(first.filename, first.lineno, first.column)
    error.trail.append(_where(first))
    shown: list[str] = []
    seen = set()
    for number, (violation, row) in enumerate(zip(found, rows, strict=True)):
        # Violations at elements of one field that differ in the index alone are reported together.
        key = (row[0], violation.access[2:], violation.earlier and violation.earlier[2:])
        if key in seen:
            continue
        seen.add(key)
        if len(seen) > _SHOWN:
            shown.append("...")
            break
        if number:
            shown.append(violation.message)
            shown += _describe(violation.access)
        if violation.earlier is not None:
            shown.append(_KINDS[row[0]][1])
            shown += _describe(violation.earlier)
    error.details = "\n".join(shown)
    error.violations = found  # type: ignore[attr-defined]
    raise error
