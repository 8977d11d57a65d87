"""Work that is left out because a scene does not need it: counters, and the same bits without
skips."""

import os

import numpy as np
import pytest
import tai as ti
from tai.errors import TaiRuntimeError

import test_loop_gradients

NAMES = list(ti.profiler.skips())


def bits(array):
    return np.ascontiguousarray(array).view(np.uint8)


def counters(name):
    return ti.profiler.skips()[name]


# A scene with something for every skip to leave out


def layout_of(kind, *fields):
    """Places fields of 64 x 64 elements, in blocks of 8 x 8 unless they are dense."""
    if kind == "dense":
        ti.root.dense(ti.ij, (64, 64)).place(*fields)
    elif kind == "bitmasked":
        ti.root.dense(ti.ij, (8, 8)).bitmasked(ti.ij, (8, 8)).place(*fields)
    else:
        getattr(ti.root, kind)(ti.ij, (8, 8)).dense(ti.ij, (8, 8)).place(*fields)


def run_scene(skip, kind, deterministic=True):
    """Grows a blob, smooths it, and differentiates its energy; returns all that is computed."""
    ti.init(skip=skip, deterministic=deterministic, offline_cache=False)
    x, y = ti.field(ti.f32), ti.field(ti.f32)
    layout_of(kind, x, x.grad, y, y.grad)
    unused = ti.field(ti.f32, shape=(256, 256), needs_grad=True)
    idle = ti.field(ti.f32)
    ti.root.pointer(ti.i, 16).dense(ti.i, 16).place(idle)
    seed = ti.field(ti.f32, shape=(), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def paint(cx: ti.i32, cy: ti.i32):
        for a, b in ti.ndrange(3, 3):
            x[cx + a, cy + b] = seed[None] * ti.cast(a + 2 * b + cx % 3, ti.f32) / 7

    @ti.kernel
    def smooth():
        for i, j in x:
            v = x[i, j]
            for k in range(3):
                v = 0.9 * v + 0.1 * ti.sin(v * (k + 1))
            y[i, j] = v + 0.25 * x[(i + 1) % 64, j]

    @ti.kernel
    def back():
        for i, j in y:
            x[i, j] += 0.1 * y[i, j] * y[i, j]

    @ti.kernel
    def rest():
        for i in idle:
            idle[i] = idle[i] + 1.0

    @ti.kernel
    def aside():
        for i, j in x:
            unused[i, j] += 2.0 * x[i, j] + 1.0

    @ti.kernel
    def energy():
        for i, j in x:
            loss[None] += x[i, j] * x[i, j]

    seed[None] = 0.7
    with ti.ad.Tape(loss):
        for c in range(6):
            paint(7 * c + 3, 5 * c + 11)
        for _ in range(4):
            smooth()
            rest()
        back()
        aside()
        energy()
    values = [loss.to_numpy(), x.to_numpy(), y.to_numpy(), unused.to_numpy(), idle.to_numpy()]
    gradients = [seed.grad.to_numpy(), x.grad.to_numpy(), y.grad.to_numpy()]
    return values + gradients


def assert_same_bits(left, right):
    for a, b in zip(left, right, strict=True):
        assert np.array_equal(bits(a), bits(b))


KINDS = ["dense", "pointer", "bitmasked", "hash"]
with_all = {}


def reference(kind):
    if kind not in with_all:
        with_all[kind] = run_scene("all", kind)
        assert with_all[kind][0] != 0
        assert np.count_nonzero(with_all[kind][5]) == 1
    return with_all[kind]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", NAMES)
def test_results_have_the_same_bits_without_one_skip(name, kind):
    expected = reference(kind)
    found = run_scene(f"all,-{name}", kind)
    assert name not in ti.profiler.skips().on
    assert_same_bits(found, expected)


@pytest.mark.parametrize("kind", KINDS)
def test_results_have_the_same_bits_without_any_skip(kind):
    expected = reference(kind)
    assert_same_bits(run_scene("none", kind), expected)
    assert ti.profiler.skips().on == set()


# Each skip, on a scene of known numbers


def sparse_field(*places):
    ti.root.pointer(ti.i, 8).dense(ti.i, 4).place(*places)


@pytest.mark.parametrize("skip, made, reused", [("all", 2, 8), ("all,-unchanged-lists", 10, 0)])
def test_lists_are_made_when_activity_changes(skip, made, reused):
    ti.init(skip=skip)
    x = ti.field(ti.i32)
    sparse_field(x)

    @ti.kernel
    def step():
        for i in x:
            x[i] += 1

    x[5] = 1
    for _ in range(5):
        step()
    x[20] = 1
    for _ in range(5):
        step()
    lists = counters("unchanged-lists")
    assert (lists["made"], lists["reused"]) == (made, reused)
    assert x.to_numpy().sum() == 10 * 4 + 5 * 4 + 2


def test_lists_are_counted_for_each_level():
    ti.init()
    x, y, total = ti.field(ti.i32), ti.field(ti.i32), ti.field(ti.i32, shape=())
    upper = ti.root.pointer(ti.i, 8)
    upper.bitmasked(ti.i, 4).place(x)
    ti.root.hash(ti.i, 4).dense(ti.i, 2).place(y)

    @ti.kernel
    def step():
        for i in x:
            x[i] += 1
        for i in upper:
            total[None] += i
        for i in y:
            y[i] += 1

    x[4] = y[2] = 1
    for _ in range(3):
        step()
    found = ti.profiler.skips()
    assert found.levels == {
        "ti.root.pointer(ti.i, (8,)).bitmasked(ti.i, (4,))": {"made": 1, "reused": 2},
        "ti.root.pointer(ti.i, (8,))": {"made": 1, "reused": 2},
        "ti.root.hash(ti.i, (4,))": {"made": 1, "reused": 2},
    }
    lists = found["unchanged-lists"]
    assert (lists["made"], lists["reused"]) == (3, 6)
    assert "ti.root.hash(ti.i, (4,)): made 1, reused 2" in str(found)
    ti.profiler.clear_skips()
    assert ti.profiler.skips().levels == {}
    step()
    assert ti.profiler.skips().levels["ti.root.hash(ti.i, (4,))"] == {"made": 0, "reused": 1}


@pytest.mark.parametrize("skip, skipped, empty", [("all", 3, 0), ("all,-empty-loops", 0, 3)])
def test_a_launch_over_nothing_is_left_out(skip, skipped, empty):
    ti.init(skip=skip)
    x, n = ti.field(ti.i32), ti.field(ti.i32, shape=())
    sparse_field(x)

    @ti.kernel
    def step():
        for i in x:
            x[i] += 1

    @ti.kernel
    def count():
        n[None] += 1
        for _i in x:
            n[None] += 1

    for _ in range(3):
        step()
    expected = {"launches_skipped": skipped, "empty_loops_run": empty}
    assert counters("empty-loops") == expected
    count()  # does something besides
    assert n[None] == 1
    assert counters("empty-loops")["launches_skipped"] == skipped
    x[3] = 5
    step()
    assert x[3] == 6
    ti.profiler.clear_skips()
    x.parent().parent().deactivate_all()
    step()
    # On a GPU the cells are gone without the host's knowing.
    on_device = os.environ.get("TI_ARCH") == "cuda"
    assert counters("empty-loops")["launches_skipped"] == (1 if skipped and not on_device else 0)


@pytest.mark.parametrize("skip, adjoints", [("all", 1), ("all,-unlaunched-kernels", 2)])
def test_only_what_is_launched_is_compiled(skip, adjoints):
    ti.init(skip=skip, offline_cache=False)
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    y = ti.field(ti.f32, shape=4, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def never():
        for i in x:
            y[i] = x[i]

    @ti.kernel
    def before():
        for i in x:
            y[i] = 2 * x[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i] * x[i]

    before()
    with ti.ad.Tape(loss):
        total()
    expected = {"kernels_defined": 3, "kernels_compiled": 2, "adjoints_compiled": adjoints}
    assert counters("unlaunched-kernels") == expected


@pytest.mark.parametrize("lazy", [True, False])
def test_what_is_not_written_takes_no_memory(lazy):
    ti.init(skip="all" if lazy else "all,-untouched-memory")
    n = 1 << 20
    x = ti.field(ti.f32, shape=n, needs_grad=True)
    x[0] = 1
    found = counters("untouched-memory")
    assert found["bytes_reserved"] >= 8 * n
    assert found["bytes_of_gradients_reserved"] == 4 * n
    if lazy:
        assert found["bytes_used"] < 4 * n
        assert found["bytes_of_gradients_used"] == 0
    else:
        assert found["bytes_used"] >= 8 * n
        assert found["bytes_of_gradients_used"] == 4 * n
    x.fill(1)
    x.grad.fill(1)
    assert counters("untouched-memory")["bytes_used"] >= 8 * n


def prunable_scene():
    """A tape of four launches, of which the loss depends on two."""
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    y = ti.field(ti.f32, shape=4, needs_grad=True)
    z = ti.field(ti.f32, shape=4, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def double():
        for i in x:
            y[i] = 2 * x[i]

    @ti.kernel
    def aside():
        for i in x:
            z[i] += 3 * x[i]

    @ti.kernel
    def total():
        for i in y:
            loss[None] += y[i] * y[i]

    x.from_numpy(np.arange(4, dtype=np.float32))
    with ti.ad.Tape(loss):
        double()
        aside()
        aside()
        total()
    return x.grad.to_numpy()


@pytest.mark.parametrize("skip, replayed", [("all", 2), ("all,-dead-launches", 4)])
def test_launches_that_the_loss_does_not_depend_on_are_not_replayed(skip, replayed):
    ti.init(skip=skip)
    assert np.array_equal(prunable_scene(), 8 * np.arange(4))
    expected = {"recorded": 4, "replayed": replayed, "skipped": 4 - replayed}
    assert counters("dead-launches") == expected


@pytest.mark.parametrize("skip", ["all", "all,-dead-launches"])
def test_what_the_loss_does_not_depend_on_need_not_be_differentiable(skip):
    ti.init(skip=skip)
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    z = ti.field(ti.f32, shape=4, needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def refused():
        for i in x:
            z[i] = ti.atomic_add(x[i], 1.0) * x[i]

    @ti.kernel
    def total():
        for i in x:
            loss[None] += x[i]

    with ti.ad.Tape(loss):
        total()
    with ti.ad.Tape(loss):
        refused()
        total()
    assert np.array_equal(x.grad.to_numpy(), np.ones(4))


@pytest.mark.parametrize("skip, cleared", [("all", 1), ("all,-clean-gradients", 3)])
def test_only_gradients_that_were_written_are_cleared(skip, cleared):
    ti.init(skip=skip)
    x, y, z = (ti.field(ti.f32, shape=100, needs_grad=True) for _ in range(3))
    x[0] = y[0] = z[0] = 1
    x.grad[1] = 5
    ti.profiler.clear_skips()
    ti.ad.clear_all_gradients()
    assert x.grad[1] == 0
    assert counters("clean-gradients") == {
        "fields_cleared": cleared,
        "fields_left": 3 - cleared,
        "bytes_cleared": 400 * cleared,
        "bytes_left": 400 * (3 - cleared),
    }


@pytest.mark.parametrize("skip, demoted", [("all", 2), ("all,-activity-tests", 0)])
def test_writes_to_the_cell_of_the_iteration_do_not_ask(skip, demoted):
    ti.init(skip=skip, offline_cache=False)
    x, y, z = ti.field(ti.i32), ti.field(ti.i32), ti.field(ti.i32)
    sparse_field(x, y, z)

    @ti.kernel
    def step():
        for i in x:
            x[i] += 1
            y[i] = x[i]
            z[i - 1] = 3

    x[8] = 1
    step()
    assert counters("activity-tests") == {
        "writes_demoted": demoted,
        "writes_kept": 3 - demoted,
    }
    assert list(x.to_numpy()[7:13]) == [0, 2, 1, 1, 1, 0]
    assert list(y.to_numpy()[7:13]) == [0, 2, 1, 1, 1, 0]
    assert list(z.to_numpy()[6:13]) == [0, 3, 3, 3, 3, 0, 0]


@pytest.mark.parametrize("skip, located", [("all", 1), ("all,-repeated-lookups", 4)])
def test_a_block_is_located_once(skip, located):
    ti.init(skip=skip, offline_cache=False)
    x = ti.field(ti.i32)
    sparse_field(x)

    @ti.kernel
    def step():
        for i in x:
            x[i] += i

    x[5] = 1
    step()
    assert counters("repeated-lookups") == {"cells": 4, "located": located}
    assert list(x.to_numpy()[3:9]) == [0, 4, 6, 6, 7, 0]


def differentiate_loop():
    """The gradient of sum((c * c * sin(...sin(x)))) and of a count, over three iterations."""
    x = ti.field(ti.f32, shape=5, needs_grad=True)
    c = ti.field(ti.f32, shape=5)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    log = ti.field(ti.f32, shape=5, needs_grad=True)

    @ti.kernel
    def iterate():
        for i in x:
            v, total, n = x[i], 0.0, 1
            for _ in range(3):
                v = ti.sin(v * ti.cast(n, ti.f32))
                total += v
                n += 2
            loss[None] += total * (c[i] * c[i])

    @ti.kernel
    def constant():
        for i in log:
            log[i] = c[i] * c[i]

    x.from_numpy(np.linspace(0.1, 0.9, 5, dtype=np.float32))
    c.from_numpy(np.linspace(1, 2, 5, dtype=np.float32))
    with ti.ad.Tape(loss):
        constant()
        iterate()
    return x.grad.to_numpy()


def gradient_of_loop():
    """The same by the chain rule."""
    x, c = np.linspace(0.1, 0.9, 5), np.linspace(1, 2, 5)
    v, slope, result = x, np.ones(5), np.zeros(5)
    for n in (1, 3, 5):
        slope = slope * np.cos(v * n) * n
        v = np.sin(v * n)
        result += slope * c * c
    return result


@pytest.mark.parametrize("skip, recorded", [("all", 1), ("all,-unneeded-records", 3)])
def test_only_what_the_gradient_needs_is_recorded(skip, recorded):
    ti.init(skip=skip, offline_cache=False, deterministic=True)
    np.testing.assert_allclose(differentiate_loop(), gradient_of_loop(), rtol=1e-4)
    assert counters("unneeded-records") == {"values_recorded": recorded, "values_carried": 3}


@pytest.mark.parametrize("skip", ["all", "all,-inactive-values"])
def test_only_what_carries_a_derivative_has_an_adjoint(skip):
    ti.init(skip=skip, offline_cache=False)
    x = ti.field(ti.f32, shape=4, needs_grad=True)
    c = ti.field(ti.f32, shape=4)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def scaled():
        for i in x:
            loss[None] += x[i] * (c[i] * c[i])

    c.from_numpy(np.arange(4, dtype=np.float32))
    with ti.ad.Tape(loss):
        scaled()
    assert np.array_equal(x.grad.to_numpy(), np.arange(4) ** 2)
    # x and the product with it; c, and c squared, which does not depend on x.
    assert counters("inactive-values") == {
        "values_active": 2 if skip == "all" else 3,
        "values": 4,
        "kernels_without_adjoint": 0,
    }


@pytest.mark.parametrize("name", NAMES)
def test_gradients_of_loops_have_the_same_bits_without_one_skip(name):
    ti.init(deterministic=True)
    expected = differentiate_loop()
    ti.init(deterministic=True, skip=f"all,-{name}")
    assert np.array_equal(bits(differentiate_loop()), bits(expected))


@pytest.mark.parametrize("name", test_loop_gradients.CASES)
def test_gradients_of_nested_loops_have_the_same_bits_without_any_skip(name):
    gradients = []
    for skip in ("all", "none"):
        ti.init(default_fp=ti.f64, deterministic=True, skip=skip)
        case = test_loop_gradients.Case(ti.f64)
        kernel = test_loop_gradients.CASES[name](case)
        with ti.ad.Tape(case.loss):
            kernel()
        gradients.append([field.grad.to_numpy() for field in case.inputs])
    assert any(np.any(gradient) for gradient in gradients[0])
    assert_same_bits(*gradients)


def test_the_cache_tells_the_same(tmp_path):
    found = []
    for skip in ["all", "none", "all", "none"]:
        ti.init(skip=skip, offline_cache=True, offline_cache_file_path=str(tmp_path))
        differentiate_loop()
        found.append([counters("unneeded-records"), counters("inactive-values")])
    assert found[0] == found[2]
    assert found[1] == found[3]
    assert found[0][0]["values_recorded"] == 1
    assert found[1][0]["values_recorded"] == 3


@pytest.mark.parametrize("kind", ["pointer", "bitmasked"])
@pytest.mark.parametrize("threads", [1, 2])
def test_large_sums_have_the_same_bits_without_any_skip(kind, threads):
    def run(skip):
        ti.init(skip=skip, deterministic=True, cpu_max_num_threads=threads)
        x, y = ti.field(ti.f32), ti.field(ti.f32)
        outer, inner = (32, 32) if kind == "pointer" else (64, 64)
        if kind == "pointer":
            ti.root.pointer(ti.ij, outer).dense(ti.ij, inner).place(x, y)
        else:
            ti.root.dense(ti.ij, outer // 8).bitmasked(ti.ij, inner).place(x, y)
        total = ti.field(ti.f32, shape=())

        @ti.kernel
        def fill():
            for i, j in ti.ndrange(200, 300):
                x[i, j] = ti.sin(0.1 * i) * ti.cos(0.3 * j)

        @ti.kernel
        def add():
            for i, j in x:
                y[i, j] = x[i, j] * 1.5 + x[i, j] ** 2
                total[None] += y[i, j]

        fill()
        add()
        return total.to_numpy(), y.to_numpy()

    assert_same_bits(run("none"), run("all"))


# The switch


def test_names_that_do_not_exist_are_refused():
    for wrong in ["lists", "all,-lists", ["unchanged-lists", "lists"]]:
        with pytest.raises(TaiRuntimeError, match="no skip 'lists'; the skips are all, none, .*"):
            ti.init(skip=wrong)
    ti.init()


@pytest.mark.parametrize(
    "skip, on",
    [
        ("all", set(NAMES)),
        ("none", set()),
        ([], set()),
        ("unchanged-lists", {"unchanged-lists"}),
        (["unchanged-lists", "dead-launches"], {"unchanged-lists", "dead-launches"}),
        ("all, -unchanged-lists", set(NAMES) - {"unchanged-lists"}),
        (["-unchanged-lists"], set(NAMES) - {"unchanged-lists"}),
        ("none,empty-loops", {"empty-loops"}),
    ],
)
def test_the_option_takes_names(skip, on):
    ti.init(skip=skip)
    assert ti.profiler.skips().on == on


def test_the_table_has_a_line_for_each_skip(capsys):
    ti.init(skip="all,-unchanged-lists")
    ti.profiler.print_skips()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == NAMES
    assert lines[0].split()[:4] == ["unchanged-lists", "off", "made", "0,"]
    assert all(line.split()[1] == "on" for line in lines[1:])


def test_counters_are_cleared():
    ti.init()
    prunable_scene()
    assert counters("dead-launches")["recorded"] == 4
    ti.profiler.clear_skips()
    assert counters("dead-launches")["recorded"] == 0
    prunable_scene()
    ti.init()
    assert counters("dead-launches")["recorded"] == 0


def test_unknown_names_are_refused():
    with pytest.raises(ti.TaiError, match="there is no skip 'list-reuse'; the skips are all, none"):
        ti.init(skip="all,-list-reuse")
    ti.init(skip="all,-unchanged-lists,-zero-adjoints")
    on = ti.profiler.skips().on
    assert "unchanged-lists" not in on and "zero-adjoints" not in on
    assert "dead-launches" in on
    with pytest.raises(KeyError, match="lists"):
        counters("lists")
