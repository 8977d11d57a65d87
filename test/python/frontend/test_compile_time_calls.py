"""Expressions that a kernel evaluates once, while it is compiled, and values that it takes for
true."""

import collections
import dataclasses
import datetime
import os
import random
import time

import numpy as np
import pytest
import tai as ti


def refuse(kernel, *args, match, kind=ti.TaiCompilationError):
    with pytest.raises(kind, match=match) as caught:
        kernel(*args)
    error = caught.value
    assert error.lineno is not None and error.column is not None and error.hint


# Changes of Python objects


@pytest.mark.parametrize(
    ("box", "change"),
    [
        ([], lambda box, i: box.append),
        ({}, lambda box, i: box.setdefault),
        (set(), lambda box, i: box.add),
        (collections.deque(), lambda box, i: box.appendleft),
        (np.zeros(3), lambda box, i: box.fill),
    ],
    ids=["list", "dict", "set", "deque", "array"],
)
def test_objects_of_python_are_not_changed(box, change):
    method = change(box, 0)

    @ti.kernel
    def in_a_loop():
        for i in range(10):
            method(i)

    @ti.kernel
    def at_the_top(n: ti.i32):
        method(1)

    before = repr(box)
    refuse(in_a_loop, match="while the kernel is compiled")
    refuse(at_the_top, 1, match="while the kernel is compiled")
    assert repr(box) == before


def test_lists_of_the_kernel_are_made_where_it_is_compiled():
    x = ti.field(ti.f32, 4)

    @ti.kernel
    def good() -> ti.f32:
        found, names = [], {}
        for i in ti.static(range(4)):
            found.append(x[i] + 1.0)
            names.update({i: x[i]})
        found.pop()
        return found[0] + found[2] + names[3] + len(found)

    @ti.kernel
    def in_a_loop() -> ti.i32:
        found = []
        for _ in range(10):
            found.append(1)
        return len(found)

    @ti.kernel
    def in_a_branch(n: ti.i32) -> ti.i32:
        found = [1]
        if n > 0:
            found.append(2)
        return len(found)

    @ti.kernel
    def inside():
        for i in x:
            found = []
            for k in ti.static(range(3)):
                found.append(k * 1.0)
            x[i] = sum(found)

    for i in range(4):
        x[i] = i
    assert good() == 1 + 3 + 3 + 3
    refuse(in_a_loop, match="the branch or loop around it is run when the kernel is")
    refuse(in_a_branch, 1, match="the branch or loop around it")
    inside()
    assert x.to_numpy().tolist() == [3.0] * 4


def test_once_may_be_meant():
    seen = []

    @ti.kernel
    def f(n: ti.i32) -> ti.f32:
        ti.static(seen.append("compiled"))
        return ti.static(random.Random(1).random())

    assert f(1) == f(2) == np.float32(random.Random(1).random())
    assert seen == ["compiled"]


# Calls whose answer would be frozen


@pytest.mark.parametrize(
    "call",
    [
        random.random, lambda: None, time.time, time.perf_counter, np.random.rand,
        np.random.default_rng(0).random, datetime.datetime.now, os.getcwdb, input,
        random.Random(3).random, os.urandom,
    ],
    ids=lambda call: getattr(call, "__qualname__", "call"),
)  # fmt: skip
def test_answers_that_change_are_refused(call):
    name = call.__name__

    @ti.kernel
    def f() -> ti.f32:
        for _ in range(3):
            call()
        return 0.0

    if name == "<lambda>":
        assert f() == 0  # Python functions of the program are for it to answer for
    else:
        refuse(f, match=f"{name}.*once, while the kernel is compiled")


def test_files_are_not_opened(tmp_path):
    path = str(tmp_path / "x")

    @ti.kernel
    def f():
        open(path, "w")

    refuse(f, match="open.*once, while the kernel is compiled")
    assert not os.path.exists(path)


def test_calls_that_only_compute_are_made():
    @ti.kernel
    def f() -> ti.f32:
        a = int(np.prod((2, 3))) + len([1, 2]) + max(1, 2) + sum((1, 2))
        return a + np.sqrt(4.0) + os.path.join("a", "b").count("/") + sorted([3, 1])[0]

    assert f() == 6 + 2 + 2 + 3 + 2 + 1 + 1


# Text


def test_values_in_text(capfd):
    S = ti.types.struct(a=ti.f32, v=ti.types.vector(2, ti.i32))

    @ti.kernel
    def f(n: ti.i32, x: ti.f32):
        m = ti.Matrix([[n, 2], [3, 4]])
        s = S(a=x, v=ti.Vector([n, 1]))
        print(f"{n} and {x}")
        print(f"{x} {n} {m}")
        print(f"{1.5:.2f} {n}")
        print(f"{n!s} {s}", [n, x], (n,), {"k": n}, str(x))
        print(s, "{a}", {1: 2})
        assert n == 5, f"n is {n}"

    f(5, 0.5)
    ti.sync()
    assert capfd.readouterr().out.splitlines() == [
        "5 and 0.5",
        "0.5 5 [[5, 2], [3, 4]]",
        "1.50 5",
        "5 {a: 0.5, v: [5, 1]} [5, 0.5] (5,) {'k': 5} 0.5",
        "{a: 0.5, v: [5, 1]} {a} {1: 2}",
    ]


def test_values_are_no_text_of_python():
    x = ti.field(ti.f32, 3)

    @ti.kernel
    def joined(n: ti.i32):
        print(",".join([n]))

    @ti.kernel
    def number(n: ti.i32):
        x[0] = float(str(n))

    @ti.kernel
    def field(n: ti.i32):
        print(x)

    @ti.kernel
    def beside(n: ti.i32):
        print("n = {}", n)

    @ti.kernel
    def spec(n: ti.i32):
        print(f"{n:s}")

    for kernel in (joined, field, beside, spec):
        refuse(kernel, 1, match=".")
    with pytest.raises(ti.TaiCompilationError):
        number(1)


# Conditions


def test_conditions_that_say_nothing():
    S = ti.types.struct(a=ti.f32)
    x = ti.field(ti.f32, 3)

    @ti.kernel
    def if_struct() -> ti.i32:
        s, r = S(a=0.0), 0
        if s:
            r = 1
        return r

    @ti.kernel
    def while_field():
        while x:
            break

    @ti.kernel
    def either_field() -> ti.i32:
        return 1 if x else 2

    @ti.kernel
    def not_struct() -> ti.i32:
        s = S(a=0.0)
        return not s

    @ti.kernel
    def and_struct(n: ti.i32) -> ti.i32:
        s = S(a=0.0)
        return s and n

    @ti.kernel
    def if_list(n: ti.i32) -> ti.i32:
        r = 0
        if [n]:
            r = 1
        return r

    @ti.kernel
    def assert_struct():
        s = S(a=0.0)
        assert s

    @ti.kernel
    def equal_structs() -> ti.i32:
        return S(a=0.0) == S(a=0.0)

    @ti.kernel
    def if_vector(n: ti.i32) -> ti.i32:
        r = 0
        if ti.Vector([n, 0]) == ti.Vector([n, 1]):
            r = 1
        return r

    for kernel in (if_struct, while_field, either_field, not_struct, assert_struct, equal_structs):
        refuse(kernel, match="struct|field 'x'")
    for kernel in (and_struct, if_list, if_vector):
        refuse(kernel, 1, match="struct|list is no condition|one answer")


def test_containers_of_python_are_conditions():
    @ti.kernel
    def f(box: ti.template()) -> ti.i32:
        r = 1 if box else 2
        if box:
            r += 10
        return r

    assert [f(()), f((0,)), f(None), f({"a": 0})] == [2, 11, 2, 11]


# Levels and gradients


def test_cells_of_dense_levels_stay():
    x = ti.field(ti.f32)
    outer = ti.root.pointer(ti.i, 4)
    inner = outer.dense(ti.i, 2)
    inner.place(x)

    @ti.kernel
    def dense():
        ti.deactivate(inner, 1)

    @ti.kernel
    def pointer():
        ti.deactivate(outer, 1)

    x[2] = 5.0
    refuse(dense, match="always active")
    pointer()
    assert x[2] == 0


def test_gradients_of_kernels_that_have_none():
    x, n = ti.field(ti.f32, 3), ti.field(ti.i32, 3)
    y = ti.field(ti.f32, 3, needs_grad=True)

    @ti.kernel
    def none():
        x[0] = 2.0 * x[1]

    @ti.kernel
    def whole():
        n[0] = n[1]

    @ti.kernel
    def one():
        x[0] = 2.0 * y[1]

    @ti.kernel
    def array(a: ti.types.ndarray()):
        a[0] = 2.0 * a[1]

    for kernel in (none, whole):
        with pytest.raises(ti.TaiAutodiffError, match="nothing that it uses has one") as caught:
            kernel.grad()
        assert "needs_grad" in caught.value.hint
    one.grad()
    with pytest.raises(ti.TaiAutodiffError, match="nothing that it uses has one"):
        array.grad(np.ones(2, np.float32))
    array.grad(ti.ndarray(ti.f32, 2, needs_grad=True))


@dataclasses.dataclass
class Scale:
    """Compared by its contents, so that it has no hash."""

    factor: float

    def __call__(self, value):
        return value * self.factor


def test_an_object_without_a_hash_is_called_in_a_branch():
    x = ti.field(ti.f32, 3)
    double = Scale(2)

    @ti.kernel
    def scale():
        for i in x:
            if i > 0:
                x[i] = double(i + 1)

    scale()
    assert list(x.to_numpy()) == [0, 4, 6]


def test_an_object_without_a_hash_is_called_with_a_field():
    x = ti.field(ti.f32, 3)
    x.fill(3)

    class First(Scale):
        __hash__ = None

        def __call__(self, field):
            return self.factor

    two = First(2)

    @ti.kernel
    def scale() -> ti.f32:
        return two(x)

    assert scale() == 2


def test_static_of_a_container_says_what_is_wrong():
    forms = [ti.static]

    @ti.kernel
    def run():
        for _ in range(3):
            print(forms[0](3))

    with pytest.raises(ti.TaiSyntaxError, match=r"'forms\[0\]' is ti.static") as info:
        run()
    assert "write ti.static(…)" in str(info.value) and "print(forms[0](3))" in str(info.value)


@ti.func
def _add(a: ti.template(), k):
    a += k


@ti.func
def _take(a: ti.template(), k):
    a -= k


def test_functions_out_of_containers_change_what_they_are_given():
    """This holds, too, if only code inside of a loop or branch tells which function it is."""
    functions = [_add, _take]
    named = {"add": _add}

    @ti.data_oriented
    class Weigh:
        def __init__(self, weight):
            self.weight = weight

        @ti.func
        def into(self, a: ti.template(), k):
            if k > 0:
                a += self.weight * k

    weights = [Weigh(10), Weigh(100)]

    @ti.kernel
    def run(n: ti.i32) -> ti.types.vector(6, ti.i32):
        item = name = later = loop = method = number = 0
        for j in range(n):
            if j != 2:
                functions[0](item, 1)
                named["add"](name, j)
            else:
                ti.static(functions[1])(item, 5)
            for function in ti.static(functions):
                if j > 0:
                    function(loop, j)
                    loop += 1
            for weight in ti.static(weights):
                if j > 1:
                    weight.into(method, j)
            for k in ti.static(range(2)):
                if j > 1:
                    weights[k].into(number, 1)
            then = ti.static(_add)
            if j > 2:
                then(later, j)
        return [item, name, later, loop, method, number]

    assert run(4).to_list() == [-2, 4, 3, 6, 550, 220]
