"""The serial order of a random loop, in plain Python: its values, a derivative, and its races.

The body of the loop is Python too, and runs once for each iteration. Its fields are those of this
file: they keep values and derivatives along one direction, and remember which iterations have
come to each element, and how.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable

MANY = -1  # more iterations than one


class Dual:
    """A number and its derivative."""

    __slots__ = ("slope", "value")

    def __init__(self, value: float, slope: float = 0.0):
        self.value = value
        self.slope = slope

    def __add__(self, other):
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    __radd__ = __add__

    def __neg__(self):
        return Dual(-self.value, -self.slope)

    def __sub__(self, other):
        return self + -other

    def __rsub__(self, other):
        return -self + other

    def __mul__(self, other):
        if isinstance(other, Dual):
            slope = self.value * other.slope + self.slope * other.value
            return Dual(self.value * other.value, slope)
        return Dual(self.value * other, self.slope * other)

    __rmul__ = __mul__

    def __lt__(self, other):
        return self.value < getattr(other, "value", other)

    def __gt__(self, other):
        return self.value > getattr(other, "value", other)

    def __le__(self, other):
        return self.value <= getattr(other, "value", other)

    def __ge__(self, other):
        return self.value >= getattr(other, "value", other)


class Functions:
    """The functions of `ti` that programs call."""

    min = staticmethod(min)
    max = staticmethod(max)

    @staticmethod
    def select(condition, yes, no):
        return yes if condition else no

    @staticmethod
    def sin(x):
        if isinstance(x, Dual):
            return Dual(math.sin(x.value), math.cos(x.value) * x.slope)
        return math.sin(x)


class Visits:
    """The iterations that have come to one element: none, the number of one, or MANY."""

    def __init__(self) -> None:
        self.readers: int | None = None
        self.writers: int | None = None
        # By operation.
        self.updaters: dict[str, int] = {}
        # The last value of each iteration.
        self.stored: dict[int, object] = {}


def _with(known: int | None, iteration: int) -> int:
    return iteration if known is None or known == iteration else MANY


def _meet(first: int | None, second: int | None) -> bool:
    """Whether two different iterations are among them, one of each."""
    if first is None or second is None:
        return False
    return first != second or first == MANY


class Log:
    """The accesses of a loop to memory."""

    def __init__(self, updates: dict[int, tuple[str, str]]):
        # By the number of a line: the memory that it updates, and the operation.
        self.updates = updates
        self.iteration = -1
        self.visits: dict[tuple, Visits] = {}

    def at(self, key: tuple) -> Visits:
        found = self.visits.get(key)
        if found is None:
            found = self.visits[key] = Visits()
        return found

    def family(self, name: str, line: int) -> str | None:
        found = self.updates.get(line)
        return found[1] if found and found[0] == name else None

    def read(self, name: str, key: tuple, line: int) -> None:
        if self.family(name, line) is None:
            visits = self.at(key)
            visits.readers = _with(visits.readers, self.iteration)

    def write(self, name: str, key: tuple, value, line: int) -> None:
        visits = self.at(key)
        family = self.family(name, line)
        if family is None:
            visits.writers = _with(visits.writers, self.iteration)
            visits.stored[self.iteration] = value
        else:
            known = visits.updaters.get(family)
            visits.updaters[family] = _with(known, self.iteration)

    def races(self) -> set[str]:
        """How iterations meet.

        `stores`: two of them store to one element; `reads`: one reads what another one stores;
        `updates`: one updates what another one stores, or updates by another operation; `sums`:
        one reads what another one adds to; `extrema`: one reads what another one makes smaller.
        """
        found = set()
        for visits in self.visits.values():
            if visits.writers == MANY:
                found.add("stores")
            if _meet(visits.writers, visits.readers):
                found.add("reads")
            families = list(visits.updaters.items())
            for number, (family, updaters) in enumerate(families):
                if _meet(updaters, visits.writers):
                    found.add("updates")
                if _meet(updaters, visits.readers):
                    found.add("extrema" if family in "<>&|" else "sums")
                if any(_meet(updaters, others) for _, others in families[number + 1 :]):
                    found.add("updates")
        return found


class Memory:
    """A field, an array or a variable; elements are numbers, or have parts."""

    def __init__(self, log: Log | None, name: str, values: dict, is_whole: bool):
        self.log = log
        self.name = name
        self.values = values
        self.is_whole = is_whole

    def get(self, key, line: int):
        if self.log:
            self.log.read(self.name, (self.name, key), line)
        return self.values[key]

    def set(self, key, value, line: int) -> None:
        if self.is_whole:
            value = (int(value) + 2**31) % 2**32 - 2**31
        if self.log:
            self.log.write(self.name, (self.name, key), value, line)
        self.values[key] = value

    def __getitem__(self, key):
        return self.get(key, sys._getframe(1).f_lineno)

    def __setitem__(self, key, value):
        self.set(key, value, sys._getframe(1).f_lineno)


class Input(Memory):
    """A field that no iteration writes."""

    def __getitem__(self, key):
        return self.values[key]


class Parts(Memory):
    """A field of vectors or structs. Parts of an element are by their number or name."""

    def __getitem__(self, key):
        return _Element(self, key)


class _Element:
    def __init__(self, memory: Parts, key):
        object.__setattr__(self, "memory", memory)
        object.__setattr__(self, "key", key)

    def __getitem__(self, part):
        return self.memory.get((self.key, part), sys._getframe(1).f_lineno)

    def __setitem__(self, part, value):
        self.memory.set((self.key, part), value, sys._getframe(1).f_lineno)

    def __getattr__(self, part):
        return self.memory.get((self.key, part), sys._getframe(1).f_lineno)

    def __setattr__(self, part, value):
        self.memory.set((self.key, part), value, sys._getframe(1).f_lineno)


def run(text: str, names: dict, iterations: Iterable[tuple], log: Log | None) -> None:
    """Runs `body`, which the text defines, once for each iteration."""
    scope = dict(names, ti=Functions)
    exec(compile(text, "body", "exec"), scope)
    body = scope["body"]
    for number, indices in enumerate(iterations):
        if log:
            log.iteration = number
        body(*indices)
