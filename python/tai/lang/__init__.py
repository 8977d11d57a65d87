"""Names of Taichi's inner modules that programs reach for."""

from . import exception, impl, matrix, misc, util

__all__ = ["exception", "impl", "matrix", "misc", "util"]
