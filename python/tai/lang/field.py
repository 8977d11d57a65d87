"""`ti.lang.field`: fields of numbers and matrices."""

from ..fields import Field, MatrixField, ScalarField

__all__ = ["Field", "MatrixField", "ScalarField"]
