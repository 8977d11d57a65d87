"""Iterations of a parallel loop that read what other iterations write.

Each form of such a read is refused when it is compiled, refused at launch, or reported as it runs
with `debug=True` and `validation=True`; or its iterations are apart, and its result is that of the
serial order, which NumPy computes.
"""

import numpy as np
import pytest
import tai as ti

pytestmark = pytest.mark.filterwarnings("ignore::tai.ad.TaiGradientWarning")

MODES = {"plain": {}, "tape": {}, "debug": {"debug": True}, "validation": {"validation": True}}
SIZES = [1, 7, 65_537]
TYPES = {"f32": ti.f32, "f64": ti.f64, "i32": ti.i32}
CERTAIN, LAUNCH, RUN, APART = "compile error", "refused launch", "reported run", "right"


class Data:
    """The storages of one case, as fields or as arrays of the caller."""

    def __init__(self, n, dtype, grad=False):
        self.n = n
        rng = np.random.default_rng(5)
        self.values = rng.integers(-8, 8, (3, n))
        self.order = np.roll(np.arange(n), 1).astype(np.int32)
        self.x, self.y = (ti.field(dtype, n, needs_grad=grad, name=k) for k in "xy")
        self.p, self.k = ti.field(ti.i32, n), ti.field(ti.i32, ())
        self.z = ti.field(dtype, (2, n), needs_grad=grad, name="z")
        self.v = ti.Vector.field(2, dtype, n, needs_grad=grad)
        self.pair = ti.types.struct(a=dtype, b=dtype).field(shape=n, needs_grad=grad)
        self.s = ti.field(dtype, (), needs_grad=grad, name="s")
        self.loss = ti.field(dtype, (), needs_grad=grad) if grad else None
        self.fill()

    def fill(self):
        kind = self.x.to_numpy().dtype
        self.x.from_numpy(self.values[0].astype(kind))
        self.y.from_numpy(self.values[1].astype(kind))
        self.z.from_numpy(self.values[:2].astype(kind))
        self.v.from_numpy(self.values[:2].T.astype(kind))
        self.pair.from_numpy({"a": self.values[0].astype(kind), "b": self.values[1].astype(kind)})
        self.p.from_numpy(self.order)
        self.k[None] = 1


def shift_left(d):
    @ti.kernel
    def run():
        for i in range(1, d.n):
            d.x[i] = d.x[i] + d.x[i - 1] // 2

    return run


def shift_under_a_condition(d):
    @ti.kernel
    def run():
        for i in d.x:
            if i + 1 < d.n and i >= 0:
                d.x[i] = -d.x[i + 1]

    return run


def sum_of_the_last(d):
    @ti.kernel
    def run():
        for i in range(1, d.n):
            d.x[i] -= d.x[i - 1]

    return run


def mirror(d):
    @ti.kernel
    def run():
        for i in d.x:
            d.x[i] = d.x[d.n - 1 - i]

    return run


def periodic(d):
    @ti.kernel
    def run():
        for i in d.x:
            d.x[i] = d.x[(i + 1) % d.n]

    return run


def through_a_function(d):
    @ti.func
    def last(i):
        return d.x[ti.max(i - 1, 0)]

    @ti.kernel
    def run():
        for i in d.x:
            d.x[i] = -last(i)

    return run


def in_a_serial_loop(d):
    @ti.kernel
    def run():
        for i in range(d.n):
            for j in range(2):
                if i + j < d.n:
                    d.x[i] = d.x[i + j]

    return run


def member(d):
    @ti.kernel
    def run():
        for i in range(1, d.n):
            d.pair[i].a = -d.pair[i - 1].a

    return run


def component(d):
    @ti.kernel
    def run():
        for i in range(1, d.n):
            d.v[i][1] = d.v[i - 1][1]

    return run


def vector(d):
    @ti.kernel
    def run():
        for i in range(1, d.n):
            d.v[i] = -d.v[i - 1]

    return run


def element_of_all(d):
    @ti.kernel
    def run():
        for i in d.x:
            d.s[None] = d.x[i]
            d.y[i] = -d.s[None]

    return run


def one_field_for_two(d):
    @ti.kernel
    def add(out: ti.template(), a: ti.template(), k: ti.i32):
        for i in range(k, d.n):
            out[i] = a[i] + a[i - k]

    return lambda: add(d.x, d.x, 1)


def one_field_under_a_condition(d):
    @ti.kernel
    def add(out: ti.template(), a: ti.template(), k: ti.i32):
        for i in out:
            if i >= k:
                out[i] = a[i] + a[i - k]

    return lambda: add(d.x, d.x, 1)


def bound_of_the_launch(d):
    @ti.kernel
    def shift(n: ti.i32):
        for i in range(1, n):
            d.x[i] = d.x[i - 1]

    return lambda: shift(d.n)


def slots_of_the_launch(d):
    @ti.kernel
    def shift(to: ti.i32, of: ti.i32):
        for i in range(1, d.n):
            d.z[to, i] = d.z[of, i - 1]

    return lambda: shift(1, 1)


def permuted(d):
    @ti.kernel
    def run():
        for i in d.x:
            d.x[i] = -d.x[d.p[i]]

    return run


def where_data_say(d):
    @ti.kernel
    def run():
        for i in range(1, d.n):
            if d.p[i] >= 0:
                d.x[i] = -d.x[i - 1]

    return run


def by_a_field(d):
    @ti.kernel
    def add(out: ti.template(), a: ti.template()):
        for i in range(1, d.n):
            out[i] = a[i] + a[i - d.k[None]]

    return lambda: add(d.x, d.x)


def permuted_store(d):
    @ti.kernel
    def run():
        for i in d.x:
            d.y[i] = -d.x[i]
            d.x[d.p[i]] = d.y[i]

    return run


def two_colours(d):
    @ti.kernel
    def run():
        for i in range(1, d.n - 1):
            if i % 2 == 0:
                d.x[i] = d.x[i - 1] - d.x[i + 1]

    return run


def pairs(d):
    @ti.kernel
    def run():
        for i in range(d.n // 2):
            d.x[2 * i] = d.x[2 * i + 1]

    return run


def halves(d):
    @ti.kernel
    def run():
        for i in range(d.n // 2):
            d.x[i] = -d.x[i + d.n // 2]

    return run


def swapped_ends(d):
    @ti.kernel
    def run():
        for i in range(d.n // 2):
            t = d.x[i]
            d.x[i] = d.x[d.n - 1 - i]
            d.x[d.n - 1 - i] = t

    return run


def one_iteration(d):
    @ti.kernel
    def run():
        for i in d.x:
            if i == 0 and d.n > 1:
                d.x[0] = d.x[d.n - 1]

    return run


def other_slots(d):
    @ti.kernel
    def shift(to: ti.i32, of: ti.i32):
        for i in range(1, d.n):
            d.z[to, i] = d.z[of, i - 1]

    return lambda: shift(1, 0)


def extrema(d):
    @ti.kernel
    def run():
        for i in range(1, d.n):
            ti.atomic_max(d.x[0], d.x[i])

    return run


def in_order(d):
    @ti.kernel
    def run():
        ti.loop_config(serialize=True)
        for i in range(1, d.n):
            d.x[i] = -d.x[i - 1]

    return run


FORMS = {
    shift_left: CERTAIN, shift_under_a_condition: CERTAIN, sum_of_the_last: CERTAIN,
    mirror: CERTAIN, periodic: CERTAIN, through_a_function: CERTAIN, in_a_serial_loop: CERTAIN,
    member: CERTAIN, component: CERTAIN, vector: CERTAIN, element_of_all: CERTAIN,
    one_field_for_two: LAUNCH, one_field_under_a_condition: LAUNCH, bound_of_the_launch: LAUNCH,
    slots_of_the_launch: LAUNCH,
    permuted: RUN, where_data_say: RUN, by_a_field: RUN, permuted_store: RUN,
    two_colours: APART, pairs: APART, halves: APART, swapped_ends: APART, one_iteration: APART,
    other_slots: APART, extrema: APART, in_order: APART,
}  # fmt: skip


def serial_order(form, n, values, order):
    """The storages that a form changes, when its iterations run one after another."""
    x, y = (row.astype(np.int64) for row in values[:2])
    z, a, b, v = values[:2].astype(np.int64), x.copy(), y.copy(), values[:2].T.astype(np.int64)
    name = form.__name__
    for i in range(n):
        if name == "shift_left" and i:
            x[i] += x[i - 1] // 2
        elif name == "shift_under_a_condition" and i + 1 < n:
            x[i] = -x[i + 1]
        elif name == "sum_of_the_last" and i:
            x[i] -= x[i - 1]
        elif name == "mirror":
            x[i] = x[n - 1 - i]
        elif name == "periodic":
            x[i] = x[(i + 1) % n]
        elif name == "through_a_function":
            x[i] = -x[max(i - 1, 0)]
        elif name == "in_a_serial_loop" and i + 1 < n:
            x[i] = x[i + 1]
        elif name == "member" and i:
            a[i] = -a[i - 1]
        elif name == "component" and i:
            v[i, 1] = v[i - 1, 1]
        elif name == "vector" and i:
            v[i] = -v[i - 1]
        elif name == "element_of_all":
            y[i] = -x[i]
        elif name in ("one_field_for_two", "one_field_under_a_condition", "by_a_field") and i:
            x[i] += x[i - 1]
        elif name == "bound_of_the_launch" and i:
            x[i] = x[i - 1]
        elif name == "slots_of_the_launch" and i:
            z[1, i] = z[1, i - 1]
        elif name == "permuted":
            x[i] = -x[order[i]]
        elif name in ("where_data_say", "in_order") and i:
            x[i] = -x[i - 1]
        elif name == "permuted_store":
            y[i] = -x[i]
            x[order[i]] = y[i]
        elif name == "two_colours" and 1 <= i < n - 1 and i % 2 == 0:
            x[i] = x[i - 1] - x[i + 1]
        elif name == "pairs" and i < n // 2:
            x[2 * i] = x[2 * i + 1]
        elif name == "halves" and i < n // 2:
            x[i] = -x[i + n // 2]
        elif name == "swapped_ends" and i < n // 2:
            x[i], x[n - 1 - i] = x[n - 1 - i], x[i]
        elif name == "one_iteration" and i == 0:
            x[0] = x[n - 1]
        elif name == "other_slots" and i:
            z[1, i] = z[0, i - 1]
        elif name == "extrema" and i:
            x[0] = max(x[0], x[i])
    return x, y, z, a, b, v


def is_right(data, form):
    x, y, z, a, b, v = serial_order(form, data.n, data.values, data.order)
    members = data.pair.to_numpy()
    found = (data.x, data.y, data.z, members["a"], members["b"], data.v)
    for expected, values in zip((x, y, z, a, b, v), found, strict=True):
        values = values if isinstance(values, np.ndarray) else values.to_numpy()
        # Sums of the whole field leave the numbers that a type holds.
        with np.errstate(over="ignore"):
            np.testing.assert_array_equal(values, expected.astype(values.dtype))


def launch(data, run, mode):
    if mode != "tape":
        run()
        return ti.sync()

    @ti.kernel
    def total():
        for i in data.x:
            data.loss[None] += data.x[i] + data.y[i] + data.z[1, i] + data.v[i][1] + data.pair[i].a

    with ti.ad.Tape(data.loss):
        run()
        total()
    return ti.sync()


def check_error(error, kind, form):
    text = str(error)
    assert "which of them comes first" in text
    assert "parallel loop" in text
    assert f"{form.__name__}" not in text.splitlines()[0]
    if kind != RUN:
        assert "ti.loop_config(serialize=True)" in text
        assert "write to another field and copy it in a later loop" in text


# Under a tape, the choice of the last store meets the first one, and an extremum has no gradient by
# what else its element is.
TAPE = {permuted_store: "another iteration writes", extrema: "also accessed in another way"}
# Integers have no gradient; one float type is enough for long loops.
CASES = [
    (form, dtype, n, mode)
    for form in FORMS
    for dtype in TYPES
    for n in SIZES
    for mode in MODES
    if not (mode == "tape" and dtype == "i32") and not (n > 7 and dtype == "f64")
]


@pytest.mark.parametrize(
    "form, dtype, n, mode",
    CASES,
    ids=["-".join((f.__name__, d, str(n), m)) for f, d, n, m in CASES],
)
def test_two_threads(form, dtype, n, mode):
    kind = FORMS[form]
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, offline_cache=False, **MODES[mode])
    data = Data(n, TYPES[dtype], grad=mode == "tape")
    run = form(data)
    is_found = n > 1 and (
        kind in (CERTAIN, LAUNCH) or (kind == RUN and mode in ("debug", "validation"))
    )
    if is_found:
        with pytest.raises(ti.TaiError) as caught:
            launch(data, run, mode)
        assert isinstance(caught.value, ti.TaiTypeError) == (kind == CERTAIN)
        check_error(caught.value, kind, form)
    elif mode == "tape" and form in TAPE and n > 1:
        with pytest.raises(ti.TaiError, match=TAPE[form]):
            launch(data, run, mode)
    else:
        launch(data, run, mode)
        if n == 1 or kind == APART:
            is_right(data, form)


@pytest.mark.parametrize("mode", ["plain", "debug", "validation"])
@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.__name__)
def test_one_thread_has_an_order(form, n, mode):
    ti.init(arch=ti.cpu, cpu_max_num_threads=1, offline_cache=False, **MODES[mode])
    data = Data(n, ti.i32)
    launch(data, form(data), mode)
    is_right(data, form)


@ti.kernel
def shift_array(a: ti.types.ndarray(), k: ti.i32):
    for i in range(k, a.shape[0]):
        a[i] = -a[i - k]


@ti.kernel
def add_shifted(out: ti.types.ndarray(), a: ti.types.ndarray(), k: ti.i32):
    for i in range(k, out.shape[0]):
        out[i] = a[i] + a[i - k]


@ti.kernel
def gather_array(a: ti.types.ndarray(), p: ti.types.ndarray()):
    for i in range(a.shape[0]):
        a[i] = -a[p[i]]


@ti.kernel
def gather_from(out: ti.types.ndarray(), a: ti.types.ndarray(), p: ti.types.ndarray()):
    for i in range(out.shape[0]):
        out[i] = -a[p[i]]


@pytest.fixture(params=["cpu", "emulated"])
def arch(request, monkeypatch):
    if request.param == "emulated":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    return ti.cuda if request.param == "emulated" else ti.cpu


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int32])
@pytest.mark.parametrize("n", SIZES)
@pytest.mark.parametrize("mode", ["plain", "debug"])
def test_arrays_of_the_caller(arch, mode, n, dtype):
    """The launch knows how long arrays are, and which of them are the same."""
    ti.init(arch=arch, cpu_max_num_threads=2, offline_cache=False, **MODES[mode])
    start = np.random.default_rng(4).integers(-8, 8, n).astype(dtype)
    a = start.copy()
    if n > 2:
        for run in (lambda: shift_array(a, 1), lambda: add_shifted(a, a, 1)):
            with pytest.raises(ti.TaiRuntimeError, match="which of them comes first") as caught:
                run()
                ti.sync()
            assert "a[i - k]" in str(caught.value)
        # Nothing of the kernel has run.
        np.testing.assert_array_equal(a, start)
    # No two iterations meet.
    half = (n + 1) // 2
    shift_array(a, half)
    np.testing.assert_array_equal(a[half:], -start[: n - half])
    b = np.zeros(n, dtype)
    add_shifted(b, a, 1)
    np.testing.assert_array_equal(b[1:], a[1:] + a[:-1])
    add_shifted(a, a, 0)
    np.testing.assert_array_equal(a[: n - half], 2 * start[: n - half])
    order = np.arange(n, dtype=np.int32)
    before = a.copy()
    gather_array(a, order)
    np.testing.assert_array_equal(a, -before)
    gather_from(a, a, order)
    np.testing.assert_array_equal(a, before)
    gather_from(b, a, np.roll(order, 1))
    np.testing.assert_array_equal(b, -np.roll(a, 1))
    if mode == "debug" and n > 1:
        other = np.roll(order, 1)
        for run in (lambda: gather_array(a, other), lambda: gather_from(a, a, other)):
            with pytest.raises(ti.TaiAssertionError, match=r"of an array, at \[\d+\], is read"):
                run()
                ti.sync()


def test_a_device_looks_as_a_processor_does(monkeypatch):
    monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    for form, kind in FORMS.items():
        for mode in ("plain", "debug"):
            ti.init(arch=ti.cuda, offline_cache=False, **MODES[mode])
            data = Data(33, ti.f32)
            if kind in (CERTAIN, LAUNCH) or (kind == RUN and mode == "debug"):
                with pytest.raises(ti.TaiError) as caught:
                    launch(data, form(data), mode)
                check_error(caught.value, kind, form)
            else:
                launch(data, form(data), mode)
                if kind == APART:
                    is_right(data, form)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_tape_that_validates(threads):
    """All reads of fields with a gradient, at whatever index."""
    for form in (permuted, where_data_say, by_a_field):
        ti.init(arch=ti.cpu, cpu_max_num_threads=threads, offline_cache=False)
        data = Data(7, ti.f32, grad=True)
        run = form(data)
        with pytest.raises(ti.TaiError, match="other iterations of the loop still write it"):
            with ti.ad.Tape(data.loss, validation=True):
                run()


def test_the_message_has_an_example():
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, offline_cache=False)
    z = ti.field(ti.f32, (8, 8), name="z")

    @ti.kernel
    def relax():
        for i, j in ti.ndrange((1, 7), (1, 7)):
            z[i, j] = 0.5 * (z[i - 1, j] + z[i, j + 1])

    with pytest.raises(ti.TaiTypeError) as caught:
        relax()
    text = str(caught.value)
    assert "an element of field 'z' is read here by one iteration" in text
    assert "iteration (2, 1) reads what iteration (1, 1) writes" in text


def test_the_remedies_are_remedies():
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, offline_cache=False)
    n = 65_537
    x, new = ti.field(ti.i32, n), ti.field(ti.i32, n)

    @ti.kernel
    def with_another_field():
        for i in range(1, n):
            new[i] = 2 - x[i - 1]
        for i in range(1, n):
            x[i] = new[i]

    @ti.kernel
    def on_one_thread():
        ti.loop_config(serialize=True)
        for i in range(1, n):
            x[i] = 2 - x[i - 1]

    values = np.arange(n, dtype=np.int32)
    x.from_numpy(values)
    with_another_field()
    values[1:] = 2 - values[:-1]
    np.testing.assert_array_equal(x.to_numpy(), values)
    on_one_thread()
    for i in range(1, n):
        values[i] = 2 - values[i - 1]
    np.testing.assert_array_equal(x.to_numpy(), values)


@pytest.mark.parametrize("layout", ["SoA", "AoS", "sparse"])
def test_layouts(layout):
    ti.init(arch=ti.cpu, cpu_max_num_threads=2, offline_cache=False, debug=layout == "sparse")
    x, y = ti.field(ti.f32, name="x"), ti.field(ti.f32)
    if layout == "SoA":
        ti.root.dense(ti.i, 64).place(x)
        ti.root.dense(ti.i, 64).place(y)
    elif layout == "AoS":
        ti.root.dense(ti.i, 64).place(x, y)
    else:
        ti.root.pointer(ti.i, 8).dense(ti.i, 8).place(x, y)

    @ti.kernel
    def fill():
        for i in range(64):
            x[i] = i
            y[i] = -i

    @ti.kernel
    def shift():
        for i in x:
            if i > 0:
                x[i] = x[i - 1]

    @ti.kernel
    def copy():
        for i in x:
            if i > 0:
                y[i] = x[i - 1]

    fill()
    copy()
    np.testing.assert_array_equal(y.to_numpy()[1:], np.arange(63))
    with pytest.raises(ti.TaiError, match="which of them comes first"):
        shift()
        ti.sync()


def test_flags_that_only_save_work():
    """A flag that iterations set may decide whether others set it again."""
    x, found = ti.field(ti.i32, 1000), ti.field(ti.i32, ())
    x.from_numpy(np.arange(1000, dtype=np.int32))

    @ti.kernel
    def search(least: ti.i32):
        for i in x:
            if found[None] == 0:
                if x[i] > least:
                    found[None] = 1

    search(2000)
    assert found[None] == 0
    search(900)
    assert found[None] == 1


def test_a_flag_whose_value_is_added():
    """Once, 100 iterations added the old value 31 times."""
    total, rest = (ti.field(ti.i32, (), name=k) for k in ("total", "rest"))

    @ti.kernel
    def drain(n: ti.i32):
        for i in range(n):
            if i > 0:
                total[None] += rest[None]
                rest[None] = 0

    @ti.kernel
    def drain_in_order(n: ti.i32):
        ti.loop_config(serialize=True)
        for i in range(n):
            if i > 0:
                total[None] += rest[None]
                rest[None] = 0

    rest[None] = 3
    with pytest.raises(ti.TaiAssertionError, match="'rest' is read here by one iteration"):
        drain(100)
    drain_in_order(100)
    assert (total[None], rest[None]) == (3, 0)


def test_a_variable_that_methods_empty():
    @ti.kernel
    def pour(n: ti.i32) -> ti.i32:
        total, rest = 0, 3
        for i in range(n):
            if i > 0:
                total += rest
                rest = 0
        return total

    assert pour(2) == 3
    with pytest.raises(ti.TaiAssertionError, match="variable 'rest', which all iterations share"):
        pour(3)
