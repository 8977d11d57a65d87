"""`ti._lib`: names of Taichi's core module that programs use."""

from ._impl.fields.snode import AXIS_NAMES
from .errors import TaiRuntimeError


class core:  # noqa: N801
    """Names of the core."""

    TaichiRuntimeError = TaiRuntimeError

    @staticmethod
    def get_max_num_indices() -> int:
        """Returns the most dimensions that a field can have."""
        return len(AXIS_NAMES)
