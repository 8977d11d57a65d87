"""Kernels for `vmap`: one launch for all elements of a batch."""

from __future__ import annotations

import copy
from collections.abc import Iterable
from typing import Any

from ...errors import TaiSyntaxError
from ..frontend.worlds import Stack
from ..values.types import NdarrayType
from .kernels import Kernel
from .signature import Signature


class StackedKernel(Kernel):
    """A kernel whose arrays have one dimension more, in front: that of the elements of a batch.

    Its loops run in parallel over the elements and their own range, as those of `ti.batch` do.
    """

    def __init__(self, kernel: Kernel, names: Iterable[str]):
        """Makes the kernel for a batch.

        Args:
            kernel: the kernel for one element.
            names: the arrays that have the dimension; others are the same for all elements.
        """
        super().__init__(kernel._function, kernel._is_method, kernel._modes)
        self.batch = Stack(names)

    def _get_signature(self) -> Signature:
        is_new = self._signature is None
        signature = super()._get_signature()
        for parameter in signature.parameters if is_new else ():
            if parameter.name in self.batch.names and isinstance(parameter.type, NdarrayType):
                parameter.type = copy.copy(parameter.type)
                if parameter.type.ndim is not None:
                    parameter.type.ndim += 1
        return signature

    def _specialize(self, values: list[Any], tracks: bool = False) -> Any:
        found = super()._specialize(values, tracks)
        written = [field.name for field in (*found.stored, *found.accumulated)]
        if written:
            raise TaiSyntaxError(
                f"kernel '{self.__name__}' writes to field '{written[0]}', which all elements of "
                "the batch share",
                "make it an array among the outputs",
            )
        return found
