"""Branches, loops, functions and compile-time evaluation in kernels."""

import gc
import weakref

import numpy as np
import pytest
import tai as ti
from tai._impl.base.program import get_program


def test_if_changes_variables():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        a = 1
        b = 10
        if n > 5:
            a = 2
            b += n
        elif n > 2:
            a = 3
        else:
            b = 0
        return a * 1000 + b

    assert [kernel(n) for n in (7, 4, 1)] == [2017, 3010, 1000]


def test_nested_ifs_in_parallel_loop():
    y = ti.field(ti.i32, shape=16)

    @ti.kernel
    def kernel():
        for i in y:
            v = 0
            if i % 2 == 0:
                v = 1
                if i % 4 == 0:
                    v = v + 10
                else:
                    v = v + 100
            y[i] = v

    kernel()
    expected = [(0 if i % 2 else 11 if i % 4 == 0 else 101) for i in range(16)]
    assert y.to_numpy().tolist() == expected


def test_serial_loop_carries_variables():
    @ti.kernel
    def fibonacci(n: ti.i32) -> ti.i32:
        a, b = 0, 1
        ti.loop_config(serialize=True)
        for _ in range(n):
            a, b = b, a + b
        return a

    assert [fibonacci(n) for n in range(10)] == [0, 1, 1, 2, 3, 5, 8, 13, 21, 34]


def test_inner_loops_are_serial():
    y = ti.field(ti.i32, shape=5)

    @ti.kernel
    def kernel():
        for i in y:
            total = 0
            for j in range(i):
                for k in range(j, 2 * j):
                    total += k
            y[i] = total

    kernel()
    expected = [sum(k for j in range(i) for k in range(j, 2 * j)) for i in range(5)]
    assert y.to_numpy().tolist() == expected


@pytest.mark.parametrize("step", [1, 2, 3, -1, -2])
def test_range_with_step(step):
    y = ti.field(ti.i32, shape=20)

    @ti.kernel
    def parallel(a: ti.i32, b: ti.i32):
        for i in range(a, b, step):
            y[i] += i + 1

    @ti.kernel
    def serial(a: ti.i32, b: ti.i32) -> ti.i32:
        digest = 0
        ti.loop_config(serialize=True)
        for i in range(a, b, step):
            digest = digest * 3 + i
        return digest

    for a, b in [(2, 17), (17, 2), (5, 5)]:
        y.fill(0)
        parallel(a, b)
        expected = np.zeros(20, int)
        digest = 0
        for i in range(a, b, step):
            expected[i] += i + 1
            digest = (digest * 3 + i + 2**31) % 2**32 - 2**31
        assert y.to_numpy().tolist() == expected.tolist()
        assert serial(a, b) == digest


def test_while_break_continue():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        i = 0
        total = 0
        while i < n:
            i += 1
            if i % 3 == 0:
                continue
            if i > 20:
                break
            total += i
        return total * 100 + i

    def reference(n):
        i = total = 0
        while i < n:
            i += 1
            if i % 3 == 0:
                continue
            if i > 20:
                break
            total += i
        return total * 100 + i

    for n in (0, 1, 10, 50):
        assert kernel(n) == reference(n)


def test_while_true():
    @ti.kernel
    def collatz(n: ti.i32) -> ti.i32:
        value = n
        count = 0
        while True:
            if value == 1:
                break
            if value % 2 == 0:
                value = value // 2
            else:
                value = 3 * value + 1
            count += 1
        return count

    assert [collatz(n) for n in (1, 6, 27)] == [0, 8, 111]


def test_break_and_continue_in_for():
    y = ti.field(ti.i32, shape=12)

    @ti.kernel
    def kernel():
        for i in y:
            total = 0
            for j in range(100):
                if j == i:
                    continue
                if j > 8:
                    total += 1000
                    break
                total += j
            y[i] = total

    kernel()
    expected = []
    for i in range(12):
        total = 0
        for j in range(100):
            if j == i:
                continue
            if j > 8:
                total += 1000
                break
            total += j
        expected.append(total)
    assert y.to_numpy().tolist() == expected


def test_continue_in_parallel_loop():
    y = ti.field(ti.i32, shape=6)

    @ti.kernel
    def kernel():
        for i in y:
            if i % 2:
                continue
            y[i] = i

    kernel()
    assert y.to_numpy().tolist() == [0, 0, 2, 0, 4, 0]


def test_break_in_nested_while():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        total = 0
        i = 0
        while i < n:
            j = 0
            while True:
                j += 1
                if j > i:
                    break
                total += 1
            i += 1
        return total

    assert kernel(7) == sum(range(7))


def test_condition_is_not_evaluated_after_break():
    ti.init(debug=True, offline_cache=False)
    x = ti.field(ti.i32, shape=4)

    @ti.kernel
    def kernel() -> ti.i32:
        i = 0
        while x[i] == 0:
            i += 1
            if i == 4:
                break
        return i

    assert kernel() == 4


def test_local_sums_in_parallel_loops():
    x = ti.field(ti.f32, shape=1000)

    @ti.kernel
    def kernel() -> ti.f32:
        total = 0.0
        for i in x:
            total += x[i]
        return total * 2

    x.fill(0.5)
    assert kernel() == 1000
    assert kernel() == 1000


def test_local_max_in_parallel_loop():
    x = ti.field(ti.i32, shape=1000)

    @ti.kernel
    def kernel() -> ti.i32:
        best = -1
        for i in x:
            ti.atomic_max(best, x[i])
        return best

    x.from_numpy(np.random.default_rng(0).permutation(1000).astype(np.int32))
    assert kernel() == 999


def test_ndrange_and_grouped():
    y = ti.field(ti.i32, shape=(4, 6))

    @ti.kernel
    def plain():
        for i, j in ti.ndrange((1, 3), 5):
            y[i, j] = 10 * i + j

    @ti.kernel
    def grouped():
        for I in ti.grouped(ti.ndrange((1, 3), 5)):
            y[I] += 100 * I[0] + I[1]

    @ti.kernel
    def over_field():
        for I in ti.grouped(y):
            y[I] += I.sum()

    expected = np.zeros((4, 6), int)
    for i in range(1, 3):
        for j in range(5):
            expected[i, j] = 110 * i + 2 * j
    expected += np.add.outer(np.arange(4), np.arange(6))
    plain()
    grouped()
    over_field()
    assert y.to_numpy().tolist() == expected.tolist()


def test_inner_ndrange():
    y = ti.field(ti.i32, shape=3)

    @ti.kernel
    def kernel():
        for i in y:
            for j, k in ti.ndrange(i, (1, 4)):
                y[i] += j * k
            for J in ti.grouped(ti.ndrange(2, 2)):
                y[i] += 100 * J[0] + 10 * J[1]

    kernel()
    expected = [sum(j * k for j in range(i) for k in range(1, 4)) + 220 for i in range(3)]
    assert y.to_numpy().tolist() == expected


def test_static_loops():
    names = ["a", "b", "c"]
    numbers = [2, 3, 5]

    @ti.kernel
    def kernel() -> ti.i32:
        total = 0
        for i in ti.static(range(4)):
            total += i
        for i, n in ti.static(enumerate(numbers)):
            total += 10 * i * n
        for n, m in ti.static(zip(numbers, names, strict=True)):
            if ti.static(m == "b"):
                total += 1000 * n
        for i, j in ti.static(ti.ndrange(2, (1, 3))):
            total += 10000 * i * j
        for I in ti.static(ti.grouped(ti.ndrange(2, 2))):
            total += 100000 * I[0]
        return total

    assert kernel() == 6 + 10 * 3 + 20 * 5 + 3000 + 30000 + 200000


def test_static_break_and_continue():
    @ti.kernel
    def kernel() -> ti.i32:
        total = 0
        for i in ti.static(range(10)):
            if ti.static(i == 2):
                continue
            if ti.static(i == 5):
                break
            total += i
        return total

    assert kernel() == 0 + 1 + 3 + 4


def test_static_if_compiles_one_branch():
    @ti.kernel
    def kernel(flag: ti.template()) -> ti.i32:
        if ti.static(flag):
            result = 1
        else:
            result = undefined_name  # noqa: F821
        return result

    assert kernel(True) == 1
    with pytest.raises(ti.TaiNameError):
        kernel(False)


def test_list_comprehension():
    @ti.kernel
    def kernel(p: ti.f64) -> ti.f64:
        w = [p * k for k in range(4) if k != 2]
        return sum(w) + len(w)

    assert kernel(2.0) == 2.0 * (0 + 1 + 3) + 3


def test_functions_are_inlined_by_value():
    @ti.func
    def bump(a, by=1):
        a = a + by
        return a, a * a

    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        m = n
        a, b = bump(m)
        c, _ = bump(m, by=10)
        return m * 10000 + a * 1000 + b * 10 + c

    assert kernel(2) == 2 * 10000 + 3 * 1000 + 9 * 10 + 12


def test_template_parameters_are_references():
    @ti.func
    def double(a: ti.template()):
        a *= 2

    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        m = n
        for _ in ti.static(range(2)):
            double(m)
        if n > 1:
            double(m)
        return m

    assert kernel(1) == 4
    assert kernel(3) == 24


def test_typed_parameters_of_functions():
    @ti.func
    def half(a: ti.f32) -> ti.f32:
        return a / 2

    @ti.kernel
    def kernel(n: ti.i32) -> ti.f32:
        return half(n)

    assert kernel(3) == 1.5


def test_compile_time_recursion():
    @ti.func
    def power(x, n: ti.template()):
        result = x
        if ti.static(n == 0):
            result = x * 0 + 1
        else:
            result = x * power(x, n - 1)
        return result

    @ti.kernel
    def kernel(x: ti.f64) -> ti.f64:
        return power(x, 5)

    assert kernel(1.5) == pytest.approx(1.5**5)


def test_data_oriented():
    @ti.data_oriented
    class Solver:
        def __init__(self, n, scale):
            self.x = ti.field(ti.f32, shape=n)
            self.scale = scale

        @ti.func
        def scaled(self, v):
            return v * self.scale

        @ti.kernel
        def run(self, offset: ti.f32):
            for i in self.x:
                self.x[i] = self.scaled(i) + offset

        @staticmethod
        @ti.func
        def twice(v):
            return 2 * v

        @ti.kernel
        def total(self) -> ti.f32:
            s = 0.0
            for i in self.x:
                s += self.twice(self.x[i])
            return s

    a, b = Solver(3, 2.0), Solver(4, 10.0)
    a.run(1.0)
    b.run(0.0)
    assert a.x.to_numpy().tolist() == [1, 3, 5]
    assert b.x.to_numpy().tolist() == [0, 10, 20, 30]
    assert a.total() == 18 and b.total() == 120


def test_template_fields_and_functions():
    x = ti.field(ti.f32, shape=3)
    y = ti.Vector.field(2, ti.f32, shape=4)

    @ti.func
    def square(v):
        return v * v

    @ti.kernel
    def fill(f: ti.template(), value: ti.template(), function: ti.template()):
        for i in f:
            f[i] = function(value) + i

    fill(x, 3.0, square)
    fill(y, 1.0, square)
    assert x.to_numpy().tolist() == [9, 10, 11]
    assert y.to_numpy().tolist() == [[1 + i] * 2 for i in range(4)]


def test_globals_are_captured_when_compiled():
    values = {"n": 3}

    @ti.kernel
    def kernel() -> ti.i32:
        return values["n"]

    assert kernel() == 3
    values["n"] = 4
    assert kernel() == 3


def test_kernels_compile_again_after_init():
    @ti.kernel
    def kernel() -> ti.f64:
        third = 1 / 3
        return third

    assert kernel() == float(np.float32(1 / 3))
    ti.init(default_fp=ti.f64, offline_cache=False)
    assert kernel() == 1 / 3


def test_old_programs_are_let_go():
    """The memory of a program is freed by the next ti.init, although its kernels live on."""
    x = ti.field(ti.f32, shape=4)

    @ti.kernel
    def kernel():
        for i in x:
            x[i] = 1.0

    kernel()
    context = weakref.ref(get_program().context)
    ti.init(offline_cache=False)
    gc.collect()
    assert context() is None
    with pytest.raises(ti.TaiRuntimeError, match="before the last ti.init"):
        _ = x[0]
    with pytest.raises(ti.TaiRuntimeError, match="before the last ti.init"):
        kernel()


def test_keyword_and_default_arguments():
    @ti.kernel
    def kernel(a: ti.i32, b: ti.i32 = 5) -> ti.i32:
        return a * 10 + b

    assert kernel(1) == 15
    assert kernel(1, 2) == 12
    assert kernel(b=3, a=2) == 23


def test_matrix_arguments_and_results():
    vec2 = ti.types.vector(2, ti.f32)
    mat2 = ti.types.matrix(2, 2, ti.f32)

    @ti.kernel
    def kernel(a: vec2, b: mat2) -> vec2:
        return b @ a

    result = kernel(ti.Vector([1.0, 2.0]), ti.Matrix([[1.0, 2.0], [3.0, 4.0]]))
    assert result.to_list() == [5, 11]
    assert kernel([0.0, 1.0], [[1.0, 2.0], [3.0, 4.0]]).to_list() == [2, 4]


def test_arrays():
    @ti.kernel
    def scale(a: ti.types.ndarray(), by: ti.f32):
        for i, j in ti.ndrange(a.shape[0], a.shape[1]):
            a[i, j] = a[i, j] * by + i

    @ti.kernel
    def total(a: ti.types.ndarray(dtype=ti.f32, ndim=1)) -> ti.f32:
        s = 0.0
        for i in range(a.shape[0]):
            s += a[i]
        return s

    @ti.kernel
    def count(keys: ti.types.ndarray(), bins: ti.types.ndarray()):
        for i in keys:
            bins[keys[i]] += 1

    array = np.ones((3, 4), np.float32)
    scale(array, 2.0)
    assert array.tolist() == [[2 + i] * 4 for i in range(3)]
    part = np.ones((6, 8), np.float32)[::2, ::2]  # not contiguous: copied and copied back
    scale(part, 3.0)
    assert part.tolist() == [[3 + i] * 4 for i in range(3)]
    assert total(np.arange(10, dtype=np.float32)) == 45
    bins = np.zeros(4, np.int32)
    count(np.array([0, 1, 1, 3, 3, 3], np.int32), bins)
    assert bins.tolist() == [1, 2, 0, 3]


def test_read_only_arrays():
    @ti.kernel
    def total(a: ti.types.ndarray()) -> ti.f32:
        s = 0.0
        for i in range(a.shape[0]):
            s += a[i]
        return s

    @ti.kernel
    def clear(a: ti.types.ndarray()):
        for i in range(a.shape[0]):
            a[i] = 0.0

    array = np.arange(4, dtype=np.float32)
    array.flags.writeable = False
    assert total(array) == 6
    with pytest.raises(ti.TaiRuntimeTypeError, match="'a' of kernel 'clear' is written"):
        clear(array)


def test_arrays_of_vectors():
    @ti.kernel
    def kernel(a: ti.types.ndarray(element_dim=1)):
        for i in range(a.shape[0]):
            a[i] += ti.Vector([1.0, 2.0])
            a[i][0] *= 10

    array = np.zeros((3, 2), np.float64)
    kernel(array)
    assert array.tolist() == [[10, 2]] * 3


def test_ndarray():
    array = ti.ndarray(ti.f32, shape=(2, 3))

    @ti.kernel
    def kernel(a: ti.types.ndarray()):
        for i, j in a:
            a[i, j] = i * 10 + j

    kernel(array)
    assert array[1, 2] == 12
    array.fill(3)
    assert array.to_numpy().tolist() == [[3.0] * 3] * 2


def test_print(capfd):
    @ti.kernel
    def kernel(n: ti.i32, v: ti.types.vector(2, ti.f32)):
        print("n =", n, v, sep=" ")
        print(f"twice {2 * n}")
        print(ti.Matrix([[1, 2], [3, 4]]))

    kernel(3, [0.5, 2.5])
    ti.sync()
    lines = capfd.readouterr().out.splitlines()
    assert lines == ["n = 3 [0.5, 2.5]", "twice 6", "[[1, 2], [3, 4]]"]


def test_print_that_goes_on_in_the_line(capfd):
    x = ti.field(ti.i32, shape=3)
    x.from_numpy(np.arange(3))

    @ti.kernel
    def kernel(n: ti.i32):
        for _ in range(1):
            for i in range(n):
                print(x[i], i, sep=":", end=", " if ti.static(True) else "")
            print("end", end="")
            print(end="!\n\n")
        for _ in range(1):
            print(ti.Vector([n, n]), end="\n")
            print("", end="")

    kernel(3)
    ti.sync()
    assert capfd.readouterr().out == "0:0, 1:1, 2:2, end!\n\n[3, 3]\n"


SPECS = [
    "8.3f",
    "+.2e",
    "<6",
    "*^9",
    "05d",
    "#x",
    "X",
    " d",
    "b",
    ".3",
    "%",
    "g",
    "08.3f",
    "<+7.1F",
]


@pytest.mark.parametrize("spec", SPECS)
def test_print_by_a_format(capfd, spec):
    """As Python writes them."""
    floats, ints = [0.0, -1.25, 1234567.5, float("inf")], [0, -7, 255]

    @ti.kernel
    def print_float(x: ti.f64):
        print(f"[{x:{spec}}]", x)

    @ti.kernel
    def print_int(n: ti.i32):
        print(f"[{n:{spec}}]", n)

    expected = []
    for kernel, values in ((print_float, floats), (print_int, ints)):
        try:
            format(values[0], spec)
        except ValueError:
            with pytest.raises(ti.TaiTypeError, match="is no format for"):
                kernel(values[0])
            continue
        for value in values:
            kernel(value)
            expected.append(f"[{value:{spec}}] {value}")
    ti.sync()
    assert capfd.readouterr().out.splitlines() == expected


def test_formats_of_vectors_and_texts(capfd):
    @ti.kernel
    def kernel(v: ti.types.vector(2, ti.f32), n: ti.u64):
        print(f"{v:.2f}", "{:.1f} and {}".format(v[0], n), f"{n:x}")  # noqa: UP032
        print(f"{ti.Matrix([[1, 2], [3, 4]]):03d}")
        print("{:.2f}", "alone")

    kernel([0.5, 2.25], 2**64 - 1)
    ti.sync()
    lines = capfd.readouterr().out.splitlines()
    assert lines == [
        "[0.50, 2.25] 0.5 and 18446744073709551615 ffffffffffffffff",
        "[[001, 002], [003, 004]]",
        "{:.2f} alone",
    ]


def test_assert_in_debug_mode():
    def make():
        @ti.kernel
        def kernel(n: ti.i32):
            assert n > 3, f"n is {n}"

        return kernel

    make()(1)  # not checked
    ti.init(debug=True, offline_cache=False)
    kernel = make()
    kernel(4)
    with pytest.raises(ti.TaiAssertionError, match="n is 1"):
        kernel(1)
    kernel(5)


def test_atomics_return_the_old_value():
    x = ti.field(ti.i32, shape=4)

    @ti.kernel
    def kernel() -> ti.types.vector(4, ti.i32):
        a = ti.atomic_add(x[0], 5)
        b = ti.atomic_sub(x[0], 2)
        c = ti.atomic_max(x[1], 7)
        d = ti.atomic_xor(x[0], 1)
        return ti.Vector([a, b, c, d])

    assert kernel().to_list() == [0, 5, 0, 3]
    assert x.to_numpy().tolist() == [2, 7, 0, 0]


def test_atomics_from_many_iterations():
    x = ti.field(ti.i32, shape=6)

    @ti.kernel
    def kernel():
        for i in range(10000):
            x[0] += 1
            x[1] -= 2
            ti.atomic_max(x[2], i)
            ti.atomic_min(x[3], -i)
            x[4] |= 1 << (i % 8)
            ti.atomic_and(x[5], i)

    kernel()
    assert x.to_numpy().tolist() == [10000, -20000, 9999, -9999, 255, 0]


def test_serialized_struct_for():
    x = ti.field(ti.i32, shape=10)
    last = ti.field(ti.i32, shape=())

    @ti.kernel
    def kernel():
        ti.loop_config(serialize=True)
        for i in x:
            x[i] = last[None]
            last[None] = last[None] + i

    kernel()
    assert x.to_numpy().tolist() == [sum(range(i)) for i in range(10)]
