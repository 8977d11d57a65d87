"""`ti.lang.field`: fields of numbers and matrices."""

from .._impl.fields.field import Field
from .._impl.fields.matrix_field import MatrixField
from .._impl.fields.scalar import ScalarField

__all__ = ["Field", "MatrixField", "ScalarField"]
