"""Symbol names of trees, fields and kernels.

An MLIR context never frees an identifier. Names of freed objects are therefore reused: a program
that allocates and frees trees for hours needs only as many names as objects alive at one time.
"""

from __future__ import annotations

import unicodedata
from collections import deque
from collections.abc import Callable

from ... import errors
from .locks import Lock

# For each name that is taken, this many returned names are examined: more than one, so that none
# are left behind.
_LOOKS = 4


class Symbols:
    """The symbols (names in IR) of one program, each used once.

    Args:
        is_used: whether a kernel of that name is still to be launched; a tape may hold one.
        forget: called with each name that is free again.
    """

    def __init__(self, is_used: Callable[[str], bool], forget: Callable[[str], None]):
        self._is_used, self._forget = is_used, forget
        # A signal handler or a finaliser may interrupt this code, so the tables are consistent
        # after each of the following steps.
        self._lock = Lock()
        self._taken: dict[str, tuple[str]] = {}  # with the wanted name
        self._next: dict[str, int] = {}
        self._free: dict[str, list[str]] = {}
        # Symbols that any thread has given back, and that are not free yet.
        self._returned: deque[str] = deque()

    def __len__(self) -> int:
        return len(self._taken)

    def take(self, wanted: str, is_hidden: bool = False) -> str:
        """Returns a symbol like `wanted` that no other object has.

        Args:
            wanted: as the program has it.
            is_hidden: messages have the wanted name instead.
        """
        base = _plain(wanted)
        with self._lock:
            self._settle(_LOOKS)
            symbol = self._reuse(base)
            if symbol is None:
                count = self._next.get(base, 0)
                symbol = f"{base}_{count}" if count else base
                while not self._claim(symbol, base):
                    count += 1
                    symbol = f"{base}_{count}"
                self._next[base] = count + 1
            if not wanted.isascii() or (is_hidden and symbol != wanted):
                errors.SPELLINGS[symbol] = wanted
            return symbol

    def _reuse(self, base: str) -> str | None:
        free = self._free.get(base)
        while free:
            try:
                symbol = free.pop()
            except IndexError:
                break
            # Another base name may have led to the same symbol meanwhile.
            if self._claim(symbol, base):
                return symbol
        return None

    def _claim(self, symbol: str, base: str) -> bool:
        wanted = (base,)
        return self._taken.setdefault(symbol, wanted) is wanted

    def give_back(self, symbol: str) -> None:
        """Notes that the owner of a name no longer exists. May be called at any time, by any
        thread.
        """
        self._returned.append(symbol)

    def settle(self) -> None:
        """Frees all symbols that were given back."""
        with self._lock:
            self._settle(len(self._returned))

    def _settle(self, most: int) -> None:
        for _ in range(min(most, len(self._returned))):
            try:
                symbol = self._returned.popleft()
            except IndexError:
                return
            if self._is_used(symbol):
                self._returned.append(symbol)
                continue
            self._forget(symbol)
            (base,) = self._taken.pop(symbol)
            errors.SPELLINGS.pop(symbol, None)
            errors.SHARED_VARIABLES.pop(symbol, None)
            self._free.setdefault(base, []).append(symbol)


def _plain(wanted: str) -> str:
    """Replaces letters that are not English, since IR allows none; `größe` becomes `grosse`."""
    plain = unicodedata.normalize("NFKD", wanted.replace("ß", "ss"))
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    base = "".join(c if c.isascii() and c.isalnum() else "_" for c in plain) or "field"
    return "_" + base if base[0].isdigit() else base
