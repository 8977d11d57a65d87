"""Finds calls of libtai after which the extension module may go on without Python's lock.

A call of libtai may give the lock (GIL) up; `afterCall` of python/src/Safepoint.h takes it
back. A call without it ends the process, but only if the call has waited, so that tests seldom see
it. A call is right

- as an argument of one of `TAKERS`, which end in `afterCall`;
- where `Teardown` stands before it in its block, for destructors;
- where one of the next lines of its block is an `afterCall`.

`NEVER_WAIT` are the functions that only read data of the caller.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TAKERS = {"check", "settled", "checkSweep"}
NEVER_WAIT = {
    "taiContextCreate", "taiContextGetMlirContext", "taiContextIsOnDevice", "taiContextIsOnGpu",
    "taiContextLastError", "taiContextSetWarningHandler", "taiListOptions",
    "taiSetSafepointHandler",
}  # fmt: skip
CALL = re.compile(r"\b(tai[A-Z]\w*)\(")
# Statements between a call and its `afterCall`.
NEAR = 2


def takers_of(text: str, place: int) -> set[str]:
    """The functions that the value at a place is an argument of, in its statement."""
    found, depth = set(), 0
    for at in range(place - 1, -1, -1):
        one = text[at]
        if one in ")]":
            depth += 1
        elif one in "([":
            if depth:
                depth -= 1
            elif one == "(" and (name := re.search(r"(\w+)\s*$", text[:at])):
                found.add(name[1])
        elif one in ";{}" and not depth:
            break
    return found


def is_in_teardown(text: str, place: int) -> bool:
    """Whether a `Teardown` stands before, in a block that holds the place."""
    depth = 0
    for at in range(place - 1, -1, -1):
        if text[at] == "}":
            depth += 1
        elif text[at] == "{":
            depth = max(depth - 1, 0)
        elif not depth and text.startswith("Teardown teardown;", at):
            return True
    return False


def problems(name: str, text: str) -> list[str]:
    """`name:line: function` of each call that is not followed by `afterCall`."""
    text = re.sub(r"//[^\n]*", lambda found: " " * len(found[0]), text)
    found = []
    for call in CALL.finditer(text):
        place = call.start()
        if call[1] in NEVER_WAIT or takers_of(text, place) & TAKERS:
            continue
        if is_in_teardown(text, place):
            continue
        following = ";".join(text[place:].split(";")[: NEAR + 1])
        if re.search(r"\b(afterCall|settle)\(\)", following.split("\n}")[0]):
            continue
        line = text.count("\n", 0, place) + 1
        found.append(f"{name}:{line}: {call[1]} is not followed by afterCall()")
    return found


def check() -> list[str]:
    found = []
    for path in sorted((ROOT / "python/src").iterdir()):
        found += problems(str(path.relative_to(ROOT)), path.read_text())
    return found


if __name__ == "__main__":
    lines = check()
    print("\n".join(lines))
    sys.exit(1 if lines else 0)
