"""Hints for errors of kernels that are raised without one."""

from __future__ import annotations

import re

from ...errors import TaiError

# Patterns of messages, and the hint for each. The first pattern that is found in the message
# counts; its groups fill the hint.
_HINTS = [
    (r"^a vector .* cannot be stored where one number|^expects a number of type .* got a vector",
     "take one component, such as v[0] or v.x"),
    (r"cannot be stored where one number|^expects a number of type .* matrix",
     "take one component, such as m[0, 1]"),
    (r"cannot be stored in a (vector|matrix)", "make a {0} of that shape"),
    (r"do not go together", "both must have one shape; '@' multiplies matrices"),
    (r"index -\d+ is out of range", "indices count from 0; negative ones have no meaning"),
    (r"index \S+ is out of range", "indices count from 0"),
    (r"^a number of type \S+ has no attribute", "only vectors, matrices and structs have members"),
    (r"^a (vector|\d+×\d+ matrix) .* has no attribute", "components are .x, .y, .z, .w, or v[0]"),
    (r"^field '(.*)' has no attribute", "an element is {0}[i]; dir({0}) lists its attributes"),
    (r"struct has no member|^struct\(.* members?, but got",
     "members are named where the struct type is made"),
    (r"^None stands", "a function without 'return' gives None"),
    (r"^(?:'.*'|a text) stands where a number",
     "kernels compute with numbers; text is for print and assert"),
    (r"stands where a number", "use a number, a vector or a matrix"),
    (r"no len\(\)", "x.shape[0] is the extent of a field, v.n that of a vector"),
    (r"(\w+)\(\) (takes|missing|got an unexpected)", "help({0}) says what it takes"),
    (r"^ti\.(\w+) takes at least two", "ti.{0}(a, b), or v.{0}() over the components of a vector"),
    (r"^ti\.\w+ takes numbers", "pass a number, a vector or a matrix"),
    (r"outer product takes", "a column times a row: v.outer_product(w), of two ti.Vector"),
    (r"product of", "both need the same number of components"),
    (r"needs a square matrix|^solve takes a square", "a matrix has as many rows as columns then"),
    (r"at most 4", "solve larger systems in Python, or by iterations of a kernel"),
    (r"^a (?:\d+×\d+ )?(?:matrix|vector) .* takes \d ind",
     "write m[i, j] for a matrix, v[i] for a vector"),
    (r"^a number .* has no elements", "use the number itself; fields and vectors have some"),
    (r"^the branches give", "give both branches one shape"),
    (r"^a matrix is made of", "write ti.Vector([a, b]) or ti.Matrix([[a, b], [c, d]])"),
    (r"the widths differ", "choose a type of as many bits, or convert the value: ti.cast(x, …)"),
    (r"^expects (vector|matrix)", "make a {0} of that shape"),
    (r"indices must be integers or slices, not a struct",
     "use a member of the struct that is a whole number"),
    (r"cannot be interpreted as an integer", "convert it: int(…)"),
    (r"'(?:int|float|bool)' object (?:is not subscriptable|does not support item)",
     "the name is a number of Python, which 'x = 3.0' makes of a field: write x[None] = 3.0"),
    (r"^ti\.(?:length|append|activate|deactivate|is_active) takes|^ti\.(\w+) takes \(level",
     "the level is that of a sparse field: x.parent()"),
    (r"^expects a struct", "make one by its type, or store each member: s[i].mass = 1.0"),
    (r"^ti\.grouped takes", "write for I in ti.grouped(x), or ti.grouped(ti.ndrange(4, 3))"),
    (r"^an atomic operation takes", "write ti.atomic_add(x[i], 1.0), or x[i] += 1.0"),
    (r"^range takes", "write range(end), range(begin, end) or range(begin, end, step)"),
    (r"^block_dim is", "give a whole number, such as block_dim=128"),
    (r"has a return type, but no return", "return a value at its end, or drop the '-> …'"),
    (r"is not a function$", "only functions, and what has a __call__, can be called"),
    (r"^the assertion never holds|^static assertion", "it is known when the kernel is compiled"),
    (r"^the '.*' level over .* indices?, but got", "give one index for each of its axes"),
    (r"^'(.*)' has no attribute", "dir({0}) lists what it has while the kernel is compiled"),
    (r"takes a 2×2 or 3×3 matrix", "make it by ti.Matrix([[…], […]])"),
    (r"^kernels have no 'with'", "open contexts such as ti.ad.Tape around the launch; "
     "ti.stop_grad(…) keeps a value out of gradients"),
    (r"^kernels have no 'del'", "a name ends with the block that it was assigned in"),
    (r"^kernels have no ", "do it in Python, outside of the kernel"),
    (r"loop_config has no option", "it has serialize, parallelize, block_dim and halo"),
    (r"^(?:field|array) '(.*)' takes 0 ind", "write {0}[None]"),
    (r"^(?:field|array) '(.*)' takes 1 ind", "write {0}[i]"),
    (r"^(?:field|array) '(.*)' takes 2 ind", "write {0}[i, j]"),
    (r"^(?:field|array) '(.*)' takes (\d+) ind", "write {0}[i, j, …] with {1} of them"),
    (r"^name '(.*)' is not defined", "assign it first, or define it above the kernel"),
    (r"takes whole numbers|must be a whole number", "convert it: int(…)"),
    (r"targets cannot take|variables cannot take", "give one target for each value"),
    (r"'\*' in the target", "name each target"),
    (r"message of an assertion", 'write assert condition, f"x is {{x}}"'),
    (r"^function '(.*)' (takes|needs|has no|gets two)", "help({0}) shows its parameters"),
    (r"cannot be taken apart|cannot be iterated", "lists, tuples, vectors and ranges can"),
    (r"known (at compile time|only when)|compile-time", "ti.static(…) takes what Python knows"),
]  # fmt: skip


def hint_for(error: TaiError, from_python: bool) -> str | None:
    """The advice that follows the message of an error of a kernel.

    Args:
        error: which has no hint of its own.
        from_python: whether it is an exception of Python code that ran at compile time.
    """
    for pattern, hint in _HINTS:
        found = re.search(pattern, error.message)
        if found is not None:
            return hint.format(*found.groups())
    if from_python:
        return "Python evaluates this while the kernel is compiled; try it outside of the kernel"
    return None
