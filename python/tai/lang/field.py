"""`ti.lang.field`: fields of numbers and matrices."""

from .._impl.fields.fields import Field, MatrixField, ScalarField

__all__ = ["Field", "MatrixField", "ScalarField"]
