"""The base class of fields and arrays, for modules that only distinguish them from numbers."""

from __future__ import annotations


class Elements:
    """Storage that kernels and Python read and write element by element: a field or an array."""

    def suggest_name(self, name: str) -> None:
        """Takes the name of the variable that holds it, if it keeps one and has none yet."""

    def _described(self) -> str:
        """Its description in messages."""
        return f"a {type(self).__name__}"

    def _example(self) -> str | None:
        """An access to one of its elements, to show in a hint."""
        return None
