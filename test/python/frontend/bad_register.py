"""The register of wrong programs that their files share."""

import tai as ti

CASES = []


def bad(kind, message, hint=None):
    """Registers a program that raises `kind`, with these words in its message and hint."""

    def decorator(function):
        CASES.append((function, kind, message, hint))
        return function

    return decorator


def fields():
    """A 1-D and a 2-D scalar field, a vector and a matrix field."""
    x = ti.field(ti.f32, shape=8, needs_grad=True, name="x")
    y = ti.field(ti.f32, shape=(4, 4), name="y")
    v = ti.Vector.field(2, ti.f32, shape=8, name="v")
    m = ti.Matrix.field(2, 2, ti.f32, shape=8, name="m")
    return x, y, v, m
