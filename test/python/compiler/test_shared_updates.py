"""Updates of what all iterations of a parallel loop share: variables and elements of fields."""

import numpy as np
import pytest
import tai as ti

from shared_loops import GROUPS, Data, N, refused, same
from shared_loops import data as data
from shared_loops import mode as mode


def test_extrema_of_a_variable(data):
    x = data.x

    @ti.kernel
    def by_call() -> ti.f32:
        m = x[0]
        for i in x:
            m = ti.min(m, x[i])
        return m

    @ti.kernel
    def by_select() -> ti.f32:
        m = x[0]
        for i in x:
            m = ti.select(x[i] < m, x[i], m)
        return m

    @ti.kernel
    def by_expression() -> ti.f32:
        m = x[0]
        for i in x:
            m = m if m <= x[i] else x[i]
        return m

    @ti.kernel
    def by_branch() -> ti.f32:
        m = x[0]
        for i in x:
            v = x[i]
            if v < m:
                m = v
        return m

    @ti.kernel
    def by_other_branch() -> ti.f32:
        m = x[0]
        for i in x:
            if m > x[i] and x[i] > -100:
                m = x[i]
        return m

    @ti.kernel
    def by_later_comparison() -> ti.f32:
        m = x[0]
        for i in x:
            if data.n[i] < 2000 and x[i] > -100 and x[i] <= m:
                m = x[i]
        return m

    @ti.kernel
    def by_nested_branches() -> ti.f32:
        m = x[0]
        for i in x:
            if not x[i] >= m:
                v = x[i]
                if data.n[i] < 2000 and v > -100:
                    m = v
        return m

    kernels = (by_call, by_select, by_expression, by_branch, by_other_branch)
    for kernel in (*kernels, by_later_comparison, by_nested_branches):
        same(kernel, data.numbers.min())


def test_whole_numbers(data):
    n, g = data.n, data.g
    h = ti.field(ti.i32, GROUPS)
    small = ti.field(ti.i16, GROUPS)

    @ti.kernel
    def sums():
        for i in n:
            h[g[i]] = h[g[i]] + n[i]

    @ti.kernel
    def differences():
        for i in n:
            h[g[i]] = h[g[i]] - n[i]

    @ti.kernel
    def products():
        for i in n:
            h[g[i]] *= n[i] | 1

    @ti.kernel
    def ands():
        for i in n:
            h[g[i]] = n[i] & h[g[i]]

    @ti.kernel
    def ors():
        for i in n:
            h[g[i]] = h[g[i]] | n[i]

    @ti.kernel
    def xors():
        for i in n:
            h[g[i]] = h[g[i]] ^ n[i]

    @ti.kernel
    def greatest():
        for i in n:
            if n[i] > h[g[i]]:
                h[g[i]] = n[i]

    @ti.kernel
    def small_sums():
        for i in n:
            small[g[i]] = small[g[i]] + n[i]

    def of(kernel, initial, field=h):
        def run():
            field.fill(initial)
            kernel()
            return field.to_numpy()

        return run

    whole = data.whole
    cases = [
        (sums, 0, np.add, whole), (differences, 3, np.subtract, whole),
        (products, 1, np.multiply, whole | 1), (ands, -1, np.bitwise_and, whole),
        (ors, 0, np.bitwise_or, whole), (xors, 0, np.bitwise_xor, whole),
        (greatest, -5000, np.maximum, whole),
    ]  # fmt: skip
    for kernel, initial, ufunc, values in cases:
        expected = data.by_group(ufunc, initial, values, np.int32)
        same(of(kernel, initial), expected)
    same(of(small_sums, 0, small), data.by_group(np.add, 0, whole, np.int16))


def test_conditional_sums(data):
    x = data.x

    @ti.kernel
    def count() -> ti.i32:
        c = 0
        for i in x:
            if x[i] > 0:
                c = c + 2
        return c

    @ti.kernel
    def squares() -> ti.f32:
        c = 0.0
        for i in x:
            if x[i] > 0:
                c = c + x[i] * x[i]
        return c

    @ti.kernel
    def either() -> ti.f32:
        c = 0.0
        for i in x:
            c = c + x[i] if x[i] > 1 else c - 0.5
        return c

    @ti.kernel
    def product() -> ti.f32:
        f = 1.0
        for _ in x:
            f *= 1.0 + 1e-6
        return f

    wide = data.numbers.astype(np.float64)
    same(count, 2 * (wide > 0).sum())
    same(squares, (wide[wide > 0] ** 2).sum(), 1e-4)
    same(either, np.where(wide > 1, wide, -0.5).sum(), 1e-3)
    same(product, float(np.float32(1 + 1e-6)) ** N, 1e-2)


def test_parts_of_variables_and_elements(data):
    x, n = data.x, data.n
    pair = ti.types.struct(most=ti.f32, count=ti.i32)
    total = ti.Vector.field(2, ti.f32, ())
    matrix = ti.Matrix.field(2, 2, ti.f32, ())
    records = pair.field(shape=())

    @ti.kernel
    def vector() -> ti.types.vector(2, ti.f32):
        m = ti.Vector([x[0], x[0]])
        for i in x:
            m[0] = ti.max(m[0], x[i])
            if x[i] < m[1]:
                m[1] = x[i]
        return m

    @ti.kernel
    def members() -> ti.types.vector(2, ti.f32):
        s = pair(most=x[0], count=0)
        for i in x:
            s.most = ti.max(s.most, x[i])
            if x[i] > 1:
                s.count = s.count + 1
        return ti.Vector([s.most, ti.cast(s.count, ti.f32)])

    @ti.kernel
    def elements():
        total[None] = [x[0], x[0]]
        matrix[None] = ti.Matrix([[1.0, 1.0], [1.0, 1.0]])
        records[None].most = x[0]
        records[None].count = 0
        for i in x:
            total[None] = ti.max(total[None], ti.Vector([x[i], 2 * x[i]]))
            matrix[None][0, 1] = ti.min(matrix[None][0, 1], x[i])
            matrix[None][1, 0] = matrix[None][1, 0] + 1
            records[None].most = ti.max(records[None].most, x[i])
            records[None].count = records[None].count + (n[i] & 1)

    high, low = data.numbers.max(), data.numbers.min()
    same(vector, [high, low])
    same(members, [high, (data.numbers > 1).sum()])
    elements()
    np.testing.assert_array_equal(total.to_numpy(), [high, 2 * high])
    np.testing.assert_array_equal(matrix.to_numpy(), [[1, low], [N + 1, 1]])
    assert records[None].most == high
    assert records[None].count == (data.whole & 1).sum()


def test_elements_that_data_choose(data):
    x, g = data.x, data.g
    h = ti.field(ti.f32, GROUPS)

    @ti.kernel
    def sums():
        for i in x:
            h[g[i]] = h[g[i]] + x[i]

    @ti.kernel
    def products():
        for i in x:
            h[g[i]] *= 1 + x[i] * 1e-3

    @ti.kernel
    def greatest():
        for i in x:
            c = g[i]
            h[c] = ti.max(h[c], x[i])

    def of(kernel, initial):
        def run():
            h.fill(initial)
            kernel()
            return h.to_numpy()

        return run

    factors = 1 + data.numbers * np.float64(1e-3)
    same(of(sums, 0), data.by_group(np.add, 0, data.numbers), 1e-3)
    same(of(products, 1), data.by_group(np.multiply, 1, factors), 1e-3)
    same(of(greatest, 0), data.by_group(np.maximum, 0, data.numbers))


def test_arrays(data):
    x, g = data.x, data.g

    @ti.kernel
    def update(
        sums: ti.types.ndarray(ti.f64, 1), products: ti.types.ndarray(ti.f64, 1),
        most: ti.types.ndarray(ti.f32, 1), factors: ti.types.ndarray(ti.i32, 1),
    ):  # fmt: skip
        for i in x:
            sums[g[i]] = x[i] + sums[g[i]]
            products[g[i]] *= 1 + x[i] * 1e-3
            if most[g[i]] < x[i]:
                most[g[i]] = x[i]
            factors[g[i]] = factors[g[i]] * (2 * i + 1)

    sums, products = np.zeros(GROUPS), np.ones(GROUPS)
    most, odd = np.zeros(GROUPS, np.float32), np.ones(GROUPS, np.int32)
    update(sums, products, most, odd)
    factors = (np.float32(1) + data.numbers * np.float32(1e-3)).astype(np.float64)
    np.testing.assert_allclose(sums, data.by_group(np.add, 0, data.numbers), rtol=1e-6)
    np.testing.assert_allclose(products, data.by_group(np.multiply, 1, factors), rtol=1e-5)
    np.testing.assert_array_equal(most, data.by_group(np.maximum, 0, data.numbers))
    expected = data.by_group(np.multiply, 1, 2 * np.arange(N, dtype=np.int32) + 1, np.int32)
    np.testing.assert_array_equal(odd, expected)


def test_own_elements(mode):
    """Each iteration has another element, or there is one iteration."""
    x = ti.field(ti.f32, 1000)

    @ti.kernel
    def own():
        for i in x:
            x[i] = x[i] + 1
            y = 0.0
            for k in range(3):
                y = y + x[i] * k
            x[i] *= y
        for _ in range(1):
            x[0] = x[0] * 0.5 + 1

    own()
    np.testing.assert_allclose(x.to_numpy()[:2], [2.5, 3.0])


def test_what_is_no_reduction_is_refused(mode):
    x = ti.field(ti.f32, 1000)
    best = ti.field(ti.f32, (), name="best")
    seen = ti.field(ti.i32, 1000)

    @ti.kernel
    def recurrence() -> ti.f32:
        c = 0.0
        for i in x:
            c = 0.5 * c + x[i]
        return c

    @ti.kernel
    def reversed_difference() -> ti.f32:
        c = 0.0
        for i in x:
            if x[i] >= 0:
                c = x[i] - c
        return c

    @ti.kernel
    def greatest_index() -> ti.i32:
        at = 0
        for i in x:
            if x[i] > best[None]:
                best[None] = x[i]
                at = i
        return at

    @ti.kernel
    def counter():
        n = 0
        for i in x:
            seen[i] = n
            n = n + 1

    @ti.kernel
    def of_an_array(a: ti.types.ndarray(ti.f32, 1)):
        for _ in x:
            a[0] = a[0] * a[0]

    @ti.kernel
    def by_two_conditions() -> ti.f32:
        c = 0.0
        for i in x:
            if seen[i] < 5 and c < x[i]:
                c = 2 * x[i]
        return c

    @ti.kernel
    def by_nested_conditions() -> ti.f32:
        c = 0.0
        for i in x:
            if c < x[i]:
                if seen[i] < 5:
                    c = 2 * x[i]
        return c

    refused(by_two_conditions, "c = 2 * x[i]", "c")
    refused(by_nested_conditions, "c = 2 * x[i]", "c")
    refused(recurrence, "c = 0.5 * c + x[i]", "c")
    refused(reversed_difference, "c = x[i] - c", "c")
    refused(greatest_index, "best[None] = x[i]", "best")
    refused(counter, "n = n + 1", "n")
    refused(lambda: of_an_array(np.zeros(3, np.float32)), "a[0] = a[0] * a[0]")


def test_remedies_are_remedies(mode):
    """A loop on one thread; two loops."""
    x = ti.field(ti.f32, 1000)
    values = np.random.default_rng(3).standard_normal(1000).astype(np.float32)
    x.from_numpy(values)

    @ti.kernel
    def recurrence() -> ti.f32:
        c = 0.0
        ti.loop_config(serialize=True)
        for i in range(1000):
            c = 0.5 * c + x[i]
        return c

    @ti.kernel
    def greatest_index() -> ti.i32:
        most = x[0]
        for i in x:
            most = ti.max(most, x[i])
        at = 1000
        for i in x:
            if x[i] == most:
                at = ti.min(at, i)
        return at

    expected = 0.0
    for value in values:
        expected = 0.5 * expected + value
    assert recurrence() == pytest.approx(expected, rel=1e-5)
    assert greatest_index() == values.argmax()


def test_what_reads_another_iteration_is_refused(mode):
    x = ti.field(ti.f32, 1000, name="x")

    @ti.kernel
    def sweep():
        for i in range(1, 1000):
            x[i] = 0.5 * x[i - 1] + x[i]

    @ti.kernel
    def sweep_inside():
        for i in x:
            if i >= 1:
                x[i] = 0.5 * x[i - 1] + x[i]

    @ti.kernel
    def halves():
        for i in range(500):
            x[i] = 0.5 * x[i + 500] + x[i]

    for kernel in (sweep, sweep_inside):
        refused(kernel, "x[i] = 0.5 * x[i - 1] + x[i]", "x", remedy="another field")
    x.fill(1)
    halves()
    np.testing.assert_array_equal(x.to_numpy(), np.repeat(np.float32([1.5, 1]), 500))


@pytest.mark.parametrize("option", ["debug", "validation"])
@pytest.mark.parametrize("arch", ["cpu", "device"])
def test_what_data_decide_is_found_when_it_runs(option, arch, monkeypatch):
    if arch == "device":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    ti.init(
        arch=ti.cuda if arch == "device" else ti.cpu, offline_cache=False, **{option: True}
    )  # fmt: skip
    monkeypatch.undo()
    count = 5000
    x, b, h = ti.field(ti.f32, count), ti.field(ti.i32, count), ti.field(ti.i32, count, name="h")

    @ti.kernel
    def update():
        for i in x:
            h[b[i]] = i - h[b[i]]

    @ti.kernel
    def of_an_array(a: ti.types.ndarray(ti.f32, 2)):
        for i in x:
            a[b[i], 1] = 1 - 0.5 * a[b[i], 1]

    order = np.random.default_rng(2).permutation(count).astype(np.int32)
    array = np.ones((count, 2), np.float32)
    for _ in range(2):
        b.from_numpy(order)
        h.fill(0)
        update()
        np.testing.assert_array_equal(h.to_numpy()[order], np.arange(count))
        of_an_array(array)
        twice = order.copy()
        twice[-1] = twice[7]
        b.from_numpy(twice)
        for kernel, element in ((update, "'h'"), (lambda: of_an_array(array), "array")):
            with pytest.raises(ti.TaiAssertionError) as caught:
                kernel()
                ti.sync()
            text = str(caught.value)
            assert "is read and written by two iterations" in text
            assert f"[{order[7]}" in text and element in text
            assert "b[i]" in text


def test_one_thread_runs_in_order():
    ti.init(arch=ti.cpu, offline_cache=False, cpu_max_num_threads=1)
    x = ti.field(ti.f32, 1000)
    seen = ti.field(ti.i32, 1000)
    values = np.random.default_rng(3).standard_normal(1000).astype(np.float32)
    x.from_numpy(values)

    @ti.kernel
    def run() -> ti.f32:
        c, n = 0.0, 0
        for i in x:
            c = 0.5 * c + x[i]
            seen[i] = n
            n = n + 1
        return c

    expected = 0.0
    for value in values:
        expected = 0.5 * expected + value
    assert run() == pytest.approx(expected, rel=1e-5)
    np.testing.assert_array_equal(seen.to_numpy(), np.arange(1000))


def test_programs_that_share_nothing(mode):
    """One iteration alone, variables of an iteration, indices that a field makes unique."""
    x, y, order = ti.field(ti.f32, 64), ti.field(ti.f32, 64), ti.field(ti.i32, 64)
    first = ti.field(ti.f32, ())
    flag = ti.field(ti.i32, ())
    order.from_numpy(np.random.default_rng(1).permutation(64).astype(np.int32))
    x.from_numpy(np.arange(64, dtype=np.float32))
    y.from_numpy(np.arange(64, dtype=np.float32))

    @ti.kernel
    def run(k: ti.i32):
        for i in x:
            if i == k:
                first[None] = first[None] * 2 + x[i]
            if x[i] > 10 and flag[None] == 0:
                flag[None] = 1
            t = 1.0
            for j in range(3):
                t = 0.5 * t + j
            y[order[i]] = t - y[order[i]]

    first[None] = 3
    run(5)
    assert first[None] == 11
    assert flag[None] == 1
    np.testing.assert_array_equal(y.to_numpy(), 2.625 - np.arange(64, dtype=np.float32))


X = np.random.default_rng(5).uniform(0.5, 1.5, 20_000)


@pytest.mark.parametrize("deterministic", [False, True])
def test_gradients(deterministic):
    ti.init(
        arch=ti.cpu, offline_cache=False, cpu_max_num_threads=2, deterministic=deterministic,
        default_fp=ti.f64,
    )  # fmt: skip
    x = ti.field(ti.f64, X.size, needs_grad=True)
    loss = ti.field(ti.f64, (), needs_grad=True)
    h = ti.field(ti.f64, 5, needs_grad=True)
    x.from_numpy(X)

    @ti.kernel
    def squares():
        c = 0.0
        for i in x:
            if x[i] > 1:
                c = c + x[i] * x[i]
        loss[None] += c

    @ti.kernel
    def least():
        m = 9.0
        for i in x:
            if x[i] < m:
                m = x[i]
        loss[None] += m * m

    @ti.kernel
    def product():
        f = 1.0
        for i in x:
            f *= 1 + x[i] * 1e-4
        loss[None] += f

    @ti.kernel
    def by_group():
        for i in x:
            h[i % 5] = ti.max(h[i % 5], x[i])

    @ti.kernel
    def total():
        for k in h:
            loss[None] += (k + 1) * h[k]

    def groups():
        h.fill(0)
        by_group()
        total()

    factors = 1 + X * 1e-4
    of_least, of_groups = np.zeros(X.size), np.zeros(X.size)
    of_least[X.argmin()] = 2 * X.min()
    for k in range(5):
        of_groups[5 * X[k::5].argmax() + k] = k + 1
    cases = [
        (squares, np.where(X > 1, 2 * X, 0)), (least, of_least),
        (product, factors.prod() / factors * 1e-4), (groups, of_groups),
    ]  # fmt: skip
    for run, expected in cases:
        with ti.ad.Tape(loss):
            run()
        np.testing.assert_allclose(x.grad.to_numpy(), expected, rtol=1e-9)


def test_components_through_copies_of_vectors(mode):
    """A vector is loaded, changed in some components and stored: an update of each."""
    data = Data()
    x, n, g = data.x, data.n, data.g
    v, w = ti.Vector.field(3, ti.i32, GROUPS), ti.Matrix.field(2, 2, ti.f64, GROUPS)

    @ti.kernel
    def one():
        for i in x:
            old = v[g[i]]
            v[g[i]][1] = old[1] + 1

    @ti.kernel
    def copy():
        for i in x:
            c = g[i]
            old = v[c]
            old[1] += 1
            v[c] = old

    @ti.kernel
    def whole():
        for i in x:
            c = g[i]
            old = v[c]
            v[c] = ti.Vector([ti.max(old[0], n[i]), old[1] + 1, old[2]])

    @ti.kernel
    def matrices():
        for i in x:
            c = g[i]
            old = w[c]
            old[1, 0] += 0.5
            old[0, 1] = ti.max(old[0, 1], n[i])
            w[c] = old

    counts = np.bincount(data.groups, minlength=GROUPS)
    most = data.by_group(np.maximum, 0, data.whole)
    for kernel in (one, copy, whole):
        for _ in range(3):
            v.fill(0)
            kernel()
            found = v.to_numpy()
            np.testing.assert_array_equal(found[:, 1], counts)
            np.testing.assert_array_equal(found[:, 0], most if kernel is whole else 0)
            assert (found[:, 2] == 0).all()
    w.fill(0)
    matrices()
    np.testing.assert_array_equal(w.to_numpy()[:, 1, 0], 0.5 * counts)
    np.testing.assert_array_equal(w.to_numpy()[:, 0, 1], most)
