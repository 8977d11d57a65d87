"""Arrays that are not contiguous, and arrays of one launch that share memory."""

import numpy as np
import pytest
import tai as ti
from tai._impl.tracking import tape_arrays


@pytest.fixture(autouse=True)
def start():
    ti.init(default_fp=ti.f64, offline_cache=False)


@ti.kernel
def add_transposed(a: ti.types.ndarray(), b: ti.types.ndarray()):
    for i, j in ti.ndrange(a.shape[0], a.shape[1]):
        a[i, j] += 10 * b[i, j]


@ti.kernel
def double(source: ti.types.ndarray(), target: ti.types.ndarray()):
    for i in range(source.shape[0]):
        target[i] = 2 * source[i]


@ti.kernel
def total(a: ti.types.ndarray(), b: ti.types.ndarray()) -> ti.f64:
    s = 0.0
    for i in range(a.shape[0]):
        s += a[i] * b[i]
    return s


def test_an_array_that_is_only_read_is_not_written_back():
    """The array may be passed to functions, which read it as well."""

    @ti.func
    def third(a, i):
        return a[i] / 3

    @ti.kernel
    def nested(a: ti.types.ndarray(), b: ti.types.ndarray()):
        for i in range(a.shape[0]):
            b[i] = third(a, i)

    source, target = np.arange(10.0)[::2], np.zeros(10)[::2]
    # A copy back to it would fail.
    source.flags.writeable = False
    nested(source, target)
    assert target.tolist() == [0, 2 / 3, 4 / 3, 2, 8 / 3]
    assert total(source, source) == 120


@pytest.mark.parametrize("n", [1, 5, 65_537])
def test_interleaved_arrays_do_not_overlap(n):
    z = np.arange(2.0 * n)
    for _ in range(2):
        double(z[::2], z[1::2])
    assert (z[1::2] == 4 * np.arange(n)).all() and (z[::2] == 2 * np.arange(n)).all()
    # Columns of one matrix, and halves of one array.
    m = np.arange(3.0 * n).reshape(n, 3)
    double(m[:, 0], m[:, 2])
    assert (m[:, 2] == 2 * m[:, 0]).all() and (m[:, 1] == 3 * np.arange(n) + 1).all()
    double(z[:n], z[n:])
    assert (z[n:] == 2 * z[:n]).all()


@pytest.mark.parametrize("n", [2, 300])
def test_a_matrix_and_its_transpose(n):
    a = np.arange(1.0 * n * n).reshape(n, n)
    before = a.copy()
    with pytest.raises(ti.TaiRuntimeTypeError, match="arrays 'a' and 'b' .* overlap") as caught:
        add_transposed(a, a.T)
    assert "writes to 'a'" in str(caught.value) and "a.copy()" in caught.value.hint
    assert (a == before).all()
    add_transposed(a, before.T)
    assert (a == before + 10 * before.T).all()
    add_transposed(a.T, np.zeros((n, n)).T)


def test_parts_that_overlap():
    z = np.arange(8.0)
    for one, other in ((z[:-1], z[1:]), (z[1:], z[:-1]), (z, z[:4]), (z[::2], z[:4])):
        with pytest.raises(ti.TaiRuntimeTypeError, match="'source' and 'target' .* overlap"):
            double(one, other)
    assert z.tolist() == list(range(8))
    double(z[:0], z[2:2])
    # Arrays that are only read may overlap.
    assert total(z[:-1], z[1:]) == sum(i * (i + 1) for i in range(7))
    assert total(z[::2], z[:4]) == 0 * 0 + 2 * 1 + 4 * 2 + 6 * 3
    a = ti.ndarray(ti.f64, shape=8)
    with pytest.raises(ti.TaiRuntimeTypeError, match="overlap"):
        double(a, a.array[:4])


def test_arrays_too_hard_to_tell_apart_are_taken_to_overlap(monkeypatch):
    """Whether two sums of strides are equal is a hard question; a wrong "no" loses stores."""
    generator = np.random.default_rng(0)
    memory = np.zeros(80_000_000, np.int8)

    def view(start):
        strides = tuple(int(n) for n in generator.integers(1, 2_000_000, 14))
        return np.lib.stride_tricks.as_strided(memory[start:], (2,) * 14, strides)

    for _ in range(5):
        one, other = view(0), view(int(generator.integers(1, 3_000_000)))
        assert tape_arrays.overlap(one, other) and tape_arrays.overlap(other, one)
        with pytest.raises(RuntimeError, match="max_work"):
            np.shares_memory(one, other, max_work=tape_arrays._MOST_WORK)

    @ti.kernel
    def copy(a: ti.types.ndarray(ndim=3), b: ti.types.ndarray(ndim=3)):
        for i, j, k in ti.ndrange(2, 2, 2):
            b[i, j, k] = a[i, j, k] + 1

    x = np.zeros((4, 7, 7))
    one, other = x[:2, 0:3:2, 0:5:3], x[2:, 0:5:3, 0:3:2]
    copy(one, other)  # these are apart
    assert other.sum() == 8
    monkeypatch.setattr(tape_arrays, "_MOST_WORK", 1)
    with pytest.raises(ti.TaiRuntimeTypeError, match="'a' and 'b' .* overlap"):
        copy(x[:2, ::2, ::3], x[:2, 1::3, 1::2])
    assert x.sum() == 8


def test_memory_of_another_type():
    @ti.kernel
    def bits(a: ti.types.ndarray(dtype=ti.f64), b: ti.types.ndarray(dtype=ti.i64)):
        for i in range(a.shape[0]):
            b[i] = i
            a[i] = 1.0

    z = np.zeros(4)
    for _ in range(2):
        with pytest.raises(ti.TaiRuntimeTypeError, match="overlap"):
            bits(z, z.view(np.int64))
        bits(z, np.zeros(4, np.int64))


@pytest.mark.parametrize("step", [1, 2, -1])
def test_the_same_array_for_two_parameters_changes_in_place(step):
    @ti.kernel
    def both(a: ti.types.ndarray(), b: ti.types.ndarray()):
        ti.loop_config(serialize=True)
        for i in range(1, a.shape[0]):
            b[i] = a[i] + 1
            b[i] = a[i] + b[i - 1]

    n = 1000
    z = np.zeros(abs(step) * n)[::step]
    for _ in range(2):
        z[:] = np.arange(n)
        both(z, z)
        assert z.tolist() == np.cumsum([0, *range(2, n + 1)]).tolist()


def test_more_than_two_arrays():
    @ti.kernel
    def add(a: ti.types.ndarray(), b: ti.types.ndarray(), c: ti.types.ndarray()):
        for i in range(a.shape[0]):
            c[i] = a[i] + b[i]

    z = np.arange(12.0)
    add(z[:4], z[:4], z[4:8])
    add(z[:4], z[1:5], z[8:])
    assert z.tolist() == [*range(4), 0, 2, 4, 6, 1, 3, 5, 3]
    for arrays in ((z[:4], z[4:8], z[7:11]), (z[4:8], z[:4], z[7:11])):
        with pytest.raises(ti.TaiRuntimeTypeError, match="and 'c' of kernel 'add' overlap"):
            add(*arrays)


# Tapes


@ti.kernel
def weigh(x: ti.template(), w: ti.types.ndarray(), loss: ti.template()):
    for i in x:
        loss[None] += x[i] ** 2 * w[i]


def make_fields(n):
    x = ti.field(ti.f64, shape=n, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    x.from_numpy(np.arange(n) + 1.0)
    return x, loss


def test_a_replay_reads_what_a_strided_array_holds_now():
    x, loss = make_fields(4)
    w = np.ones(8)
    with ti.ad.Tape(loss) as tape:
        weigh(x, w[::2], loss)
        weigh(x, w[::-2], loss)
    assert loss[None] == 60
    w[:] = np.arange(8)
    tape.replay()
    weights = w[::2] + w[::-2]
    squares = (np.arange(4) + 1.0) ** 2
    assert loss[None] == (squares * weights).sum()
    assert (x.grad.to_numpy() == 2 * (np.arange(4) + 1.0) * weights).all()
    w[:] = 2
    tape.replay(backward=False)
    assert loss[None] == 120


def test_a_strided_array_that_kernels_write_under_a_tape():
    x, loss = make_fields(4)
    w = np.ones((4, 2))

    @ti.kernel
    def scale(w: ti.types.ndarray()):
        for i in range(w.shape[0]):
            w[i] *= 3

    with ti.ad.Tape(loss) as tape:
        scale(w[:, 1])
        weigh(x, w[:, 1], loss)
        scale(w[:, 1])
        weigh(x, w[:, 1], loss)
    numbers = np.arange(4) + 1.0
    assert w.tolist() == [[1, 9]] * 4
    assert (x.grad.to_numpy() == 2 * numbers * 12).all()
    w[:] = 2
    tape.replay()
    assert w.tolist() == [[2, 18]] * 4
    assert (x.grad.to_numpy() == 2 * numbers * 24).all()


def test_the_gradient_of_a_kernel_by_hand():
    x, loss = make_fields(4)
    w = np.arange(8.0)
    loss.grad[None] = 1
    weigh.grad(x, w[::2], loss)
    assert (x.grad.to_numpy() == 2 * (np.arange(4) + 1.0) * w[::2]).all()
    assert w.tolist() == list(range(8))
    weigh(x, w[:4], loss)


def test_one_array_twice_under_a_tape():
    """A tape cannot tell which value the gradient has to read."""
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    p = ti.field(ti.f64, shape=(), needs_grad=True)
    p[None] = 3

    @ti.kernel
    def step(a: ti.types.ndarray(), b: ti.types.ndarray()):
        for i in range(a.shape[0]):
            factor = b[i]
            a[i] = 0
            loss[None] += p[None] * factor

    a = np.ones(3)
    with pytest.raises(ti.TaiRuntimeTypeError, match="overlap"), ti.ad.Tape(loss):
        step(a, a)
    step(a, a)
    assert a.tolist() == [0, 0, 0]


# Views whose elements share memory


@ti.kernel
def count_up(a: ti.types.ndarray()):
    for i in range(a.shape[0]):
        a[i] += 1


@ti.kernel
def count_up_rows(a: ti.types.ndarray()):
    for i, j in ti.ndrange(a.shape[0], a.shape[1]):
        a[i, j] += 1


@ti.kernel
def sum_rows(a: ti.types.ndarray()) -> ti.f64:
    s = 0.0
    for i, j in ti.ndrange(a.shape[0], a.shape[1]):
        s += a[i, j]
    return s


def strided(array, shape, steps):
    return np.lib.stride_tricks.as_strided(array, shape, tuple(8 * step for step in steps))


def brute_force(array):
    """Whether two elements have one address."""
    grids = np.meshgrid(*(np.arange(n) for n in array.shape), indexing="ij")
    places = sum(g * step for g, step in zip(grids, array.strides, strict=True))
    return len(np.unique(places)) < array.size


@pytest.mark.parametrize("n", [2, 5, 65_537])
def test_views_that_overlap_themselves_are_not_written(n):
    z = np.arange(2.0 * n)
    for view, kernel in [
        (strided(z, (n,), (0,)), count_up),
        (strided(z, (n, 2), (0, 1)), count_up_rows),
        (strided(z, (n, 2), (1, 1)), count_up_rows),
        (np.lib.stride_tricks.sliding_window_view(z, n, writeable=True), count_up_rows),
        (strided(z[::-1], (n, 2), (-1, -1)), count_up_rows),
    ]:
        for _ in range(2):
            with pytest.raises(
                ti.TaiRuntimeTypeError, match="elements of array 'a' of kernel 'count_up.*' share"
            ) as caught:
                kernel(view)
            assert "a.copy()" in caught.value.hint
    assert (z == np.arange(2 * n)).all()


def test_views_that_overlap_themselves_are_read():
    z = np.arange(8.0)
    assert sum_rows(strided(z, (4, 2), (0, 1))) == 4
    assert sum_rows(np.lib.stride_tricks.sliding_window_view(z, 3)) == 63
    # A view of which each element has its own memory is written.
    for view in (z[::2], z[::-1], z.reshape(4, 2).T[0], strided(z, (3, 2), (2, 3))[:, 0]):
        before = view.copy()
        count_up(view)
        assert (view == before + 1).all()
    one = strided(np.zeros(1), (1, 1), (0, 0))
    count_up_rows(one)
    assert one[0, 0] == 1
    count_up_rows(strided(z, (0, 5), (0, 0)))


def test_which_views_overlap_themselves():
    """Against all addresses, for small views of any steps."""
    generator = np.random.default_rng(0)
    seen = {False: 0, True: 0}
    for _ in range(400):
        shape = tuple(generator.integers(1, 4, size=generator.integers(1, 4)))
        steps = tuple(generator.integers(-7, 8, size=len(shape)))
        z = np.zeros(200)
        view = strided(z[100:], shape, steps)
        before = tape_arrays.overlaps_itself(view)
        assert before == (brute_force(view) and not view.flags.c_contiguous), (shape, steps)
        seen[before] += 1
    assert min(seen.values()) > 50


def test_an_expanded_tensor():
    torch = pytest.importorskip("torch", reason="torch is not installed")
    t = torch.zeros(1, dtype=torch.float64)
    with pytest.raises(ti.TaiRuntimeTypeError, match="share memory") as caught:
        count_up(t.expand(4))
    assert "a.clone()" in caught.value.hint
    assert t.tolist() == [0]
    with pytest.raises(ti.TaiRuntimeTypeError, match="share memory"):
        count_up_rows(torch.zeros(6, dtype=torch.float64).unfold(0, 3, 1))
    whole = torch.zeros(6, dtype=torch.float64)
    count_up(whole[::2])
    assert whole.tolist() == [1, 0] * 3


def test_an_overlapping_view_under_a_tape():
    x, loss = make_fields(4)
    with pytest.raises(ti.TaiRuntimeTypeError, match="share memory"), ti.ad.Tape(loss):
        count_up(strided(np.zeros(4), (4,), (0,)))
        weigh(x, np.ones(4), loss)
    with ti.ad.Tape(loss):
        weigh(x, strided(np.array([3.0]), (4,), (0,)), loss)
    assert (x.grad.to_numpy() == 6 * (np.arange(4) + 1.0)).all()
