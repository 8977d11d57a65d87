"""Contiguous storage of whole elements of matrix fields."""

from __future__ import annotations

from typing import Any

from .scalar import ScalarField


class WholeElements(ScalarField):
    """The storage of a matrix field whose elements are stored whole, one after another."""

    def __init__(self, field: Any):
        super().__init__(field.dtype, field._name, field.role, field.element_shape)
        self.field = field

    @property
    def name(self) -> str:
        return self.field.name

    @property
    def needs_grad(self) -> bool:
        return self.field.needs_grad

    @needs_grad.setter
    def needs_grad(self, value: bool) -> None:
        pass

    @property
    def needs_dual(self) -> bool:
        return self.field.needs_dual

    @needs_dual.setter
    def needs_dual(self, value: bool) -> None:
        pass

    def _companion(self, which: str) -> Any:
        return self.field._companion(which)

    @property
    def _companions(self) -> dict[str, Any]:
        found = {}
        for which, companion in self.field._companions.items():
            if companion._single is not None:
                found[which] = companion._single
        return found

    @_companions.setter
    def _companions(self, value: Any) -> None:
        pass

    def choose_symbol(self, program: Any) -> None:
        if self.symbol is None:
            self._name = self.field._name
            self.symbol = program.unique_symbol(self.field._base_symbol(program))
