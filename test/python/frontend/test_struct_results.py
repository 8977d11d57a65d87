"""Structs that kernels return."""

import numpy as np
import pytest
import tai as ti


@pytest.fixture(autouse=True)
def program():
    ti.init()


def hit():
    return ti.types.struct(place=ti.types.vector(3, ti.f32), distance=ti.f32, cell=ti.i32)


def test_members_come_back_in_their_types():
    hit_type = hit()

    @ti.kernel
    def find(big: ti.i32) -> hit_type:
        return hit_type(ti.Vector([0.1, 0.2, 0.3]), 1.5, big)

    # f32 would round the whole number.
    found = find(2**31 - 3)
    assert isinstance(found, ti.Struct) and found.keys == ["place", "distance", "cell"]
    assert found.cell == 2**31 - 3 and isinstance(found.cell, int)
    assert found.distance == 1.5 and isinstance(found.distance, float)
    assert found.place.to_numpy().dtype == np.float32
    np.testing.assert_array_equal(found.place.to_numpy(), np.array([0.1, 0.2, 0.3], np.float32))
    # Again, by the path of launches that are known.
    assert [find(k).cell for k in range(3)] == [0, 1, 2]


@pytest.mark.parametrize(
    "kinds, values",
    [
        ({"a": ti.i64, "b": ti.u32}, (-(2**62) - 1, 2**32 - 1)),
        ({"a": ti.u64, "b": ti.u8}, (2**64 - 1, 200)),
        ({"a": ti.f64, "b": ti.i32}, (0.1, -7)),
        ({"a": ti.u1, "b": ti.i8}, (True, -8)),
        ({"a": ti.f16, "b": ti.f32}, (0.5, 0.25)),
    ],
    ids=lambda v: "-".join(k.name for k in v.values()) if isinstance(v, dict) else "",
)
def test_types_that_one_type_holds(kinds, values):
    pair = ti.types.struct(**kinds)
    field = pair.field(shape=())
    field[None] = pair(*values)

    @ti.kernel
    def read() -> pair:
        return field[None]

    found = read()
    assert (found.a, found.b) == values
    assert isinstance(found.a, bool) == (kinds["a"] is ti.u1)


def test_structs_in_structs_and_early_returns():
    inner = ti.types.struct(m=ti.types.matrix(2, 2, ti.f64), n=ti.i32)
    outer = ti.types.struct(inner=inner, x=ti.f64)

    @ti.kernel
    def choose(k: ti.i32) -> outer:
        made = outer(inner(ti.Matrix([[1.0, 2.0], [3.0, 4.0]]), 7), 0.5)
        if k > 0:
            made.inner.n = k
            return made
        made.x = -1.0
        return made

    assert choose(3).to_dict() == {
        "inner": {"m": [[1.0, 2.0], [3.0, 4.0]], "n": 3}, "x": 0.5,
    }  # fmt: skip
    assert choose(0).inner.n == 7 and choose(0).x == -1.0


def test_a_class_with_methods():
    @ti.dataclass
    class Ball:
        x: ti.f32
        r: ti.f32

        @ti.func
        def right(self):
            return self.x + self.r

    @ti.kernel
    def make(x: ti.f32) -> Ball:
        return Ball(x, 2.0 * x)

    @ti.kernel
    def right(ball: Ball) -> ti.f32:
        return ball.right()

    assert right(make(1.5)) == 4.5


def test_gradients_of_numbers_in_a_result():
    pair = ti.types.struct(square=ti.f64, cube=ti.f64, count=ti.i32)
    x = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def powers() -> pair:
        return pair(x[None] ** 2, x[None] ** 3, 4)

    x[None] = 3.0
    with ti.ad.Tape() as tape:
        found = powers()
        loss = found.square + 2.0 * found.cube
    tape.backward(loss)
    assert found.count == 4 and isinstance(found.count, int)
    assert x.grad[None] == pytest.approx(2 * 3 + 2 * 3 * 9)


def test_a_vector_whose_gradient_would_be_lost():
    hit_type = hit()

    @ti.kernel
    def find() -> hit_type:
        return hit_type(1.0, 2.0, 3)

    with pytest.raises(ti.TaiAutodiffError, match="member 'place' of a struct"), ti.ad.Tape():
        find()
    assert find().distance == 2.0


def test_more_numbers_than_a_matrix_of_4x4_has():
    numbers = np.linspace(0.0, 1.0, 9)
    x = ti.field(ti.f64, shape=9, needs_grad=True)
    x.from_numpy(numbers)
    table = ti.types.struct(
        count=ti.i64, moments=ti.types.vector(20, ti.f64), last=ti.types.matrix(5, 5, ti.f32)
    )

    @ti.kernel
    def moments() -> ti.types.vector(20, ti.f64):
        total = ti.Vector.zero(ti.f64, 20)
        for i in x:
            for k in ti.static(range(20)):
                total[k] += k * x[i] ** 2
        return total

    @ti.kernel
    def tabulate(count: ti.i64) -> table:
        made = table(count=count, last=ti.types.matrix(5, 5, ti.f32)(2))
        made.moments[19], made.last[4, 4] = 0.1, 7
        return made

    with ti.ad.Tape() as tape:
        found = moments()
    tape.backward((found, np.arange(20.0)))
    np.testing.assert_allclose(found.to_numpy(), np.arange(20) * (numbers**2).sum())
    np.testing.assert_allclose(x.grad.to_numpy(), 2 * numbers * (np.arange(20) ** 2).sum())
    # The second launch takes the path of those that are known.
    for count in (2**60 + 1, 3):
        made = tabulate(count)
        assert made.count == count and made.moments[19] == 0.1
        assert made.last.to_numpy().sum() == 24 * 2 + 7


def test_results_that_are_refused():
    long = ti.types.struct(m=ti.types.matrix(32, 32, ti.f32), n=ti.f32)
    pair, other = ti.types.struct(a=ti.f32, b=ti.f32), ti.types.struct(a=ti.f32, c=ti.f32)

    @ti.kernel
    def many() -> long:
        return long()

    with pytest.raises(ti.TaiSyntaxError, match="at most 1024 numbers"):
        many()

    @ti.kernel
    def another() -> pair:
        return other(1.0, 2.0)

    with pytest.raises(ti.TaiTypeError, match=r"returns a struct\(a=f32, b=f32\), but got") as info:
        another()
    assert "return other(1.0, 2.0)" in str(info.value)

    @ti.kernel
    def number() -> pair:
        return 1.0

    with pytest.raises(ti.TaiTypeError, match="but got something else"):
        number()


def test_wide_integers_beside_other_numbers_keep_their_bits():
    mixed = ti.types.struct(x=ti.f32, n=ti.i64, m=ti.u64, v=ti.types.vector(2, ti.i64))
    signs = ti.types.struct(a=ti.i8, b=ti.u64)

    @ti.kernel
    def floats(n: ti.i64) -> mixed:
        return mixed(1.5, n, ti.cast(n, ti.u64), [n, -1])

    @ti.kernel
    def integers(n: ti.u64) -> signs:
        return signs(-5, n)

    for n in (0, 1, -1, (1 << 53) + 1, -(1 << 63), (1 << 63) - 1):
        answer = floats(n)
        assert (answer.x, answer.n, answer.m) == (1.5, n, n % (1 << 64))
        assert answer.v.to_numpy().tolist() == [n, -1]
    for n in (0, (1 << 64) - 1, 1 << 63):
        answer = integers(n)
        assert (answer.a, answer.b) == (-5, n)


def test_tuples():
    vec2 = ti.types.vector(2, ti.f32)

    @ti.kernel
    def pair(n: ti.i32) -> (ti.i32, ti.f32):
        return n, n * 0.5

    @ti.kernel
    def early(n: ti.i32) -> tuple[ti.i32, vec2, ti.i64]:
        if n > 3:
            return 1, vec2(2.0), 1 << 40
        return n, vec2(n, 7.0), n

    assert pair(3) == (3, 1.5)
    assert type(pair(3)) is tuple
    first, vector, last = early(2)
    assert (first, list(vector), last) == (2, [2.0, 7.0], 2)
    first, vector, last = early(4)
    assert (first, list(vector), last) == (1, [2.0, 2.0], 1 << 40)

    @ti.kernel
    def three(n: ti.i32) -> (ti.i32, ti.f32):
        return n, n, n

    with pytest.raises(ti.TaiTypeError, match="returns 2 values, but got 3 values"):
        three(1)

    @ti.kernel
    def one(n: ti.i32) -> (ti.i32, ti.f32):
        return n

    with pytest.raises(ti.TaiTypeError, match="returns 2 values, but got one value"):
        one(1)


def test_tuples_have_gradients():
    x = ti.field(ti.f32, shape=(), needs_grad=True)
    x[None] = 3.0

    @ti.kernel
    def powers() -> (ti.f32, ti.f32, ti.i32):
        return x[None] ** 2, x[None] ** 3, 5

    with ti.ad.Tape() as tape:
        square, cube, number = powers()
        loss = square * 2 + cube * number
    tape.backward(loss)
    assert x.grad[None] == 4 * 3 + 15 * 9
