"""Ways to call things in kernels that programs for Taichi use."""

import numpy as np
import pytest
import tai as ti


def test_methods_of_matrices_called_through_the_class():
    out = ti.field(ti.f32, shape=5)

    @ti.kernel
    def kernel():
        v = ti.Vector([3.0, 4.0])
        n = ti.Vector.normalized(v, 1.0)
        out[0] = n[0]
        out[1] = ti.Vector.norm(v)
        out[2] = ti.Vector.dot(v, n)
        m = ti.Matrix([[1.0, 2.0], [3.0, 4.0]])
        out[3] = ti.Matrix.transpose(m)[0, 1]
        out[4] = ti.Matrix.determinant(m)

    kernel()
    np.testing.assert_allclose(out.to_numpy(), [0.5, 5, 25 / 6, 3, -2], rtol=1e-6)


def test_targets_that_are_not_here_fall_back(capsys, monkeypatch):
    for name in ("TI_ARCH", "TAI_CUDA_EMULATION"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TAI_CUDA_DRIVER", "libno-such-driver.so.1")
    for arch, more in ((ti.gpu, {}), (ti.cuda, {"enable_fallback": True})):
        ti.init(arch=arch, default_fp=ti.f32, device_memory_GB=1.0, **more)
        x = ti.field(ti.f32, shape=2)
        x.fill(3)
        assert x[1] == 3
        assert "falling back to arch=cpu: no CUDA driver" in capsys.readouterr().err


@ti.func
def increase(place: ti.template(), by):
    place += by


@ti.func
def exchange(a: ti.template(), b: ti.template()):
    kept = a
    a = b
    b = kept


@ti.func
def increase_twice(place: ti.template()):
    increase(place, 2)
    increase(by=3, place=place)


def test_templates_stand_for_elements_and_components():
    particle = ti.types.struct(mass=ti.f32, velocity=ti.math.vec2)
    x, ones = ti.field(ti.f32, shape=4), ti.Matrix.field(2, 2, ti.f32, shape=3)
    particles = particle.field(shape=3)

    @ti.func
    def push(velocity: ti.template()):
        velocity.x = 7
        velocity[1] += 2

    @ti.kernel
    def kernel() -> ti.types.vector(6, ti.f32):
        v = ti.Vector([1.0, 2.0, 3.0])
        p = particle(1.0, [2.0, 3.0])
        for i in range(3):
            increase(x[i], i)
            increase(x[0], 1)  # a sum of all iterations
            increase_twice(ones[i][0, 1])
            push(particles[i].velocity)
            increase(particles[i].mass, 2)
        ti.loop_config(serialize=True)  # an iteration exchanges values that the last one has left
        for i in range(3):
            increase(v[1], 1)
            if i > 0:
                exchange(v[0], v[2])
            increase(by=1, place=p.mass)
            push(p.velocity)
        return ti.Vector([v[0], v[1], v[2], p.mass, p.velocity[0], p.velocity[1]])

    assert list(kernel()) == [1, 5, 3, 4, 7, 9]
    assert x.to_numpy().tolist() == [3, 1, 2, 0]
    assert ones.to_numpy().tolist() == [[[0, 5], [0, 0]]] * 3
    assert particles.mass.to_numpy().tolist() == [2] * 3
    assert particles.velocity.to_numpy().tolist() == [[7, 2]] * 3


def test_a_template_keeps_the_element_whose_index_changes():
    x = ti.field(ti.i32, shape=3)

    @ti.func
    def store(place: ti.template(), index: ti.template()):
        index += 1
        place += 5

    @ti.kernel
    def kernel() -> ti.i32:
        i = 1
        store(x[i], i)
        return i

    assert kernel() == 2
    assert x.to_numpy().tolist() == [0, 5, 0]


def test_gradients_through_templates():
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    y = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.func
    def add_square(target: ti.template(), source: ti.template()):
        target += source**2

    @ti.kernel
    def kernel():
        for i in x:
            add_square(y[i], x[i])
            add_square(loss[None], y[i])

    x.from_numpy(np.array([1.0, 2.0, 3.0]))
    with ti.ad.Tape(loss):
        kernel()
    assert x.grad.to_numpy() == pytest.approx(4 * np.array([1.0, 8.0, 27.0]))


def test_methods_may_call_their_object_otherwise():
    @ti.data_oriented
    class Grid:
        def __init__(this, n):
            this.n, this.x = n, ti.field(ti.f32, shape=n)

        @ti.func
        def scale(this, factor):
            return this.n * factor

        @ti.kernel
        def run(this, factor: ti.f32):
            for i in this.x:
                this.x[i] = this.scale(factor) + i

    grid = Grid(2)
    grid.run(3.0)
    assert grid.x.to_numpy().tolist() == [6.0, 7.0]


def test_items_of_lists_that_a_kernel_makes():
    x = ti.field(ti.i32, shape=3)

    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        a = [1, 2, n]
        a[1] = ti.cast(5.9, ti.i32)
        a[0] += n
        for i in ti.static(range(3)):
            a[i] *= 2
        for i in x:
            w = [0, 0]
            w[0] = i
            w[1] = w[0] * 2
            x[i] = w[1]
        return a[0] + a[1] * 10 + a[2] * 100

    assert kernel(3) == 708
    assert x.to_numpy().tolist() == [0, 2, 4]

    @ti.kernel
    def branch(n: ti.i32) -> ti.i32:
        a = [1, 2]
        if n > 2:
            a[1] = 5
        return a[1]

    with pytest.raises(ti.TaiTypeError, match="cannot change the Python object 'a") as caught:
        branch(3)
    assert "ti.Vector" in caught.value.hint


@ti.func
def first_is_nine(v):
    v[0] = 9
    return v[0] + v[1]


def test_lists_of_two_names_do_not_change():
    """In Python both change, in kernels of Taichi one does: neither is chosen without a word."""

    @ti.kernel
    def second_name(n: ti.i32) -> ti.i32:
        a = [0, n]
        b = a
        b[0] = 5
        return a[0]

    @ti.kernel
    def argument(n: ti.i32) -> ti.i32:
        a = [0, n]
        return first_is_nine(a) + a[0]

    @ti.kernel
    def part_of_another(n: ti.i32) -> ti.i32:
        a = [0, n]
        t = (a, 1)
        a[0] = 5
        return t[0][0]

    for kernel, names in ((second_name, "'a' and 'b'"), (argument, "'a' and 'v'"),
                          (part_of_another, "'a' and 't'")):  # fmt: skip
        with pytest.raises(ti.TaiTypeError, match=f"a list that is {names} cannot") as caught:
            kernel(2)
        assert "copy it first" in caught.value.hint

    @ti.kernel
    def copies(n: ti.i32) -> ti.i32:
        a = [0, n]
        b = list(a)
        b[0] = 5
        return a[0] * 100 + b[0] * 10 + first_is_nine(list(a))

    assert copies(2) == 61


def test_parameters_by_keyword_alone():
    @ti.func
    def digits(a=1, *, b, c=3):
        return a * 100 + b * 10 + c

    @ti.kernel
    def twice(a: ti.i32 = 1, *, b: ti.i32, c: ti.i32 = 3) -> ti.i32:
        return digits(b=b) + digits(a, c=c, b=2) * 1000

    assert twice(b=5) == 153 + 123_000
    assert twice(4, c=9, b=5) == 153 + 429_000


@pytest.mark.parametrize("name", ["u8", "u16", "u32", "u64"])
def test_least_and_greatest_of_unsigned_numbers(name):
    """The numbers are negative as signed ones, come from many threads, and go to places that the
    data chooses."""
    dtype, count = getattr(ti, name), 60_000
    top = int(dtype.max)
    place = ti.field(ti.i32, shape=count)
    place.from_numpy((np.arange(count) % 3).astype(np.int32))
    least, greatest = ti.field(dtype, shape=3), ti.Vector.field(2, dtype, shape=3)
    whole = ti.field(dtype, shape=2)
    least.fill(top)
    whole[0] = top

    @ti.kernel
    def scatter():
        for i in place:
            n = ti.cast(i % 200, dtype)
            ti.atomic_min(least[place[i]], ti.cast(top, dtype) - n)
            ti.atomic_max(greatest[place[i]][i % 2], n)
            ti.atomic_min(whole[0], ti.cast(top, dtype) - n)
            ti.atomic_max(whole[1], ti.cast(top, dtype) - n)

    scatter()
    assert least.to_numpy().tolist() == 3 * [top - 199]
    assert greatest.to_numpy().tolist() == 3 * [[198, 199]]
    assert whole.to_numpy().tolist() == [top - 199, top]


@pytest.mark.parametrize("dtype", [ti.f16, ti.f32, ti.f64], ids=str)
def test_atomic_extremes_of_special_values(dtype):
    """A NaN stays, and the zeros have an order. The old value is returned."""
    ti.init()
    nan, inf = np.nan, np.inf
    cases = [
        (there, given)
        for there in (-inf, -1.5, -0.0, 0.0, 2.0, inf, nan)
        for given in (-inf, -1.5, -0.0, 0.0, 2.0, inf, nan)
    ]
    count = len(cases)
    x, old = ti.field(dtype, shape=(2, count)), ti.field(dtype, shape=(2, count))
    given, place = ti.field(dtype, shape=count), ti.field(ti.i32, shape=count)
    there_values, given_values = np.array(cases).T.astype(dtype.numpy)
    x.from_numpy(np.stack([there_values, there_values]))
    given.from_numpy(given_values)
    place.from_numpy(np.random.default_rng(0).permutation(count).astype(np.int32))

    @ti.kernel
    def update():
        for i in place:
            at = place[i]
            old[0, at] = ti.atomic_max(x[0, at], given[at])
            old[1, at] = ti.atomic_min(x[1, at], given[at])

    def key(v):
        return (v, not np.signbit(v))

    for _ in range(2):
        before = x.to_numpy()
        update()
        after, returned = x.to_numpy(), old.to_numpy()
        np.testing.assert_array_equal(returned, before)
        for row, choose in enumerate((max, min)):
            for i in range(count):
                pair = (before[row, i], given_values[i])
                wanted = nan if np.isnan(pair).any() else choose(pair, key=key)
                np.testing.assert_array_equal(after[row, i], wanted)
                assert np.isnan(wanted) or np.signbit(after[row, i]) == np.signbit(wanted)


@ti.func
def _increase(a: ti.template()):
    a += 1
    return a


@ti.func
def _halve(y: ti.template(), x):
    y = y * 0.5 + x * 0.01
    return y


@ti.func
def _add(a: ti.template(), b):
    a += b
    return a


def test_what_is_not_evaluated_changes_no_variable():
    """On the right of `and` and `or`, and in the arms of a conditional expression."""
    table = ti.field(ti.i32, shape=4)
    table.from_numpy(np.arange(4, dtype=np.int32))

    @ti.kernel
    def run(m: ti.i32) -> ti.types.vector(8, ti.i32):
        a = b = c = d = e = found = 0
        v = ti.Vector([0, 0])
        if m > 0 and _increase(a) > 0:
            found += 1
        if m > 0 or _increase(b) > 0:
            found += 2
        x = _increase(c) if m > 0 else _increase(c) * 10
        if m > 0 and _add(v[1], table[m % 4]) > 0:
            found += 4
        if m > 1 or _add(d, table[3]) > 2 or _increase(d) > 100:
            found += 8
        y = (_increase(e) if m > 1 else _add(e, table[2])) if m > 0 else 7
        return [a, b, c + x, v[1], d, e, y, found]

    assert run(0).to_list() == [0, 1, 11, 0, 3, 0, 7, 10]
    assert run(1).to_list() == [1, 0, 2, 1, 3, 2, 2, 15]
    assert run(2).to_list() == [1, 0, 2, 2, 0, 1, 1, 15]


def test_gradients_of_variables_that_expressions_change():
    ti.init(default_fp=ti.f64)
    x = ti.field(ti.f64, shape=4, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            y, z = x[i], x[i] ** 2
            w = _halve(y, 0.0) if i > 1 else y * 3
            if i > 0 and _halve(z, 0.0) > 1.5:
                w += y * z
            loss[None] += w + z * y

    x.from_numpy(np.array([1.0, 2.0, 3.0, 4.0]))
    with ti.ad.Tape(loss):
        run()
    assert loss[None] == 67
    assert x.grad.to_numpy().tolist() == [6, 15, 14, 24.5]


def test_the_condition_of_a_while_changes_variables():
    """Each time that it is asked, and the last one is kept: the loop ended never, before."""

    @ti.kernel
    def run(m: ti.i32) -> ti.types.vector(6, ti.i32):
        a = total = asked = b = c = d = 0
        while _increase(a) < m:
            total += a
        while ti.atomic_add(b, 2) < m:
            asked += 1
        v = ti.Vector([0, 0])
        while _increase(c) < m and _increase(v[1]) > 0:
            if c == 4:
                break
            if c == 2:
                continue
            d += c
        return [a, total, b, asked, c * 10 + d, v[1]]

    assert run(5).to_list() == [5, 10, 8, 3, 44, 4]
    assert run(3).to_list() == [3, 3, 6, 2, 31, 2]
    assert run(0).to_list() == [1, 0, 2, 0, 10, 0]


@pytest.mark.parametrize("leaves", [False, True])
def test_gradients_of_a_while_whose_condition_changes_variables(leaves):
    ti.init(default_fp=ti.f64)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            y = x[i] ** 2
            total = 0.0
            while _halve(y, x[i]) > 0.7:
                if ti.static(leaves):
                    if y < 1.5:
                        break
                    if y > 20:
                        continue
                total += y * y
            loss[None] += total + y

    x.from_numpy(np.array([3.0, 5.0, 9.0]))
    with ti.ad.Tape(loss):
        run()
    gradient = x.grad.to_numpy()
    for i in range(3):
        found, at = [], x[i]
        for step in (1e-6, -1e-6):
            x[i], loss[None] = at + step, 0
            run()
            found.append(loss[None])
        x[i] = at
        assert (found[0] - found[1]) / 2e-6 == pytest.approx(gradient[i], rel=1e-6)


@ti.data_oriented
class Spring:
    factor = 2.0

    @ti.func
    def force(self, x):
        return self.factor * x * x

    @property
    def twice(self):
        return 2 * self.factor

    @ti.kernel
    def total(self, x: ti.template(), loss: ti.template()):
        for i in x:
            loss[0] += self.force(x[i])


class Damper:
    @ti.func
    def force(self, x):
        return super().force(x) + 100.0


class Stiff(Spring):
    @ti.func
    def force(self, x):
        base = super().force(x)
        return 3.0 * base + super().force(x)

    @ti.kernel
    def of_the_class_above(self, x: ti.f64) -> ti.f64:
        return super().force(x) + super().twice


class Both(Damper, Stiff):
    pass


@pytest.mark.parametrize("n", [1, 65_537])
def test_methods_of_the_class_above(n):
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=1, needs_grad=True)
    x.fill(3.0)
    for made, value, slope in ((Spring(), 18, 12), (Stiff(), 72, 48), (Both(), 172, 48)):
        with ti.ad.Tape(loss):
            made.total(x, loss)
        assert loss[0] == value * n and (x.grad.to_numpy() == slope).all()
    stiff = Stiff()
    assert stiff.of_the_class_above(3.0) == 22
    stiff.factor = 5.0  # an attribute of the object itself
    assert stiff.of_the_class_above(3.0) == 45 + stiff.twice == 55
