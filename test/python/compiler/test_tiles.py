"""Chains of stencils that a program runs in tiles, compared with single launches bit for bit.

The emulated device has four blocks, each with an overlay of its own; they run one after another in
an order that changes, and write where the launches of a chain write in the end.
"""

import os
import re

import numpy as np
import pytest
import tai as ti

RUNS = 6  # the first is single launches, then every way is run three times


@pytest.fixture(autouse=True)
def device(monkeypatch):
    monkeypatch.setenv("TI_ARCH", "cuda")
    if not os.environ.get("TAI_CUDA_EMULATION"):
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")


def chains_of(tape):
    """The launches of each kind of chain, with how often it comes."""
    return [
        (int(times), names)
        for times, names in re.findall(
            r", (\d+) times in \d+ tiles of [0-9 x]+ with up to \d+ cells: ([^:,]+(?:, [a-z]\w+"
            r"(?: x \d+)?)*)",
            tape.explain(),
        )
    ]


def play(runs, loss, prepare, forward, outcome):
    """Records once, then replays; the results of every time, and the tape."""
    results = []
    for run in range(runs):
        prepare()
        if run == 0:
            with ti.ad.Tape(loss) as tape:
                forward()
        else:
            loss[None] = 0
            tape.replay()
        results.append(outcome())
    return results, tape


def run_both_ways(scene, runs=RUNS, **options):
    """The results of every run, which must be the same, and the last tape."""
    tapes, results = [], []
    for fuse in (True, False):
        ti.init(
            offline_cache=False, deterministic=True, fuse_launches=fuse, bounds="off", **options
        )
        outcomes, tape = scene(runs)
        results.append(outcomes)
        tapes.append(tape)
    for fused, plain in zip(*results, strict=True):
        for one, other in zip(fused, plain, strict=True):
            np.testing.assert_array_equal(one, other)
    assert not chains_of(tapes[1])
    return results[0], tapes[0]


def relaxation(n, m, sweeps, inner=False, conditional=False):
    """Jacobi sweeps over every row of one field, around the borders or inside of them."""

    def scene(runs):
        u = ti.field(ti.f32, shape=(sweeps + 1, n, m), needs_grad=True)
        b = ti.field(ti.f32, shape=(n, m), needs_grad=True)
        loss = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def around(s: ti.i32):
            for i, j in ti.ndrange(n, m):
                near = u[s, (i + 1) % n, j] + u[s, (i + n - 1) % n, j]
                near += u[s, i, (j + 1) % m] + u[s, i, (j + m - 2) % m]
                u[s + 1, i, j] = 0.23 * near + b[i, j]

        @ti.kernel
        def inside(s: ti.i32):
            for i, j in ti.ndrange((1, n - 1), (2, m - 1)):
                near = u[s, i + 1, j] + u[s, i - 1, j] + u[s, i, j + 1] + u[s, i, j - 2]
                u[s + 1, i, j] = 0.23 * near + b[i, j]

        @ti.kernel
        def sometimes(s: ti.i32):
            for i, j in ti.ndrange(n, m):
                if b[i, j] > 0.5:
                    u[s + 1, i, j] = 0.5 * (u[s, (i + 1) % n, j] + u[s, i, (j + 1) % m])

        sweep = inside if inner else sometimes if conditional else around

        @ti.kernel
        def total():
            for i, j in ti.ndrange(n, m):
                loss[None] += u[sweeps, i, j] ** 2

        values = np.random.default_rng(7)
        b.from_numpy(values.random((n, m), np.float32))
        start = values.random((sweeps + 1, n, m), np.float32)

        def forward():
            for s in range(sweeps):
                sweep(s)
            total()

        def outcome():
            return loss[None], u.to_numpy(), u.grad.to_numpy(), b.grad.to_numpy()

        return play(runs, loss, lambda: u.from_numpy(start), forward, outcome)

    return scene


@pytest.mark.parametrize(("n", "m"), [(16, 12), (7, 5), (13, 30), (1, 9), (3, 64)])
def test_sweeps_around_the_borders(n, m):
    results, tape = run_both_ways(relaxation(n, m, 5))
    names = [names for _, names in chains_of(tape)]
    assert any("around_0 x 5" in name for name in names) or n == 1
    assert any("around_grad_0 x 5" in name for name in names) or n == 1


def test_sweeps_that_flush_denormals():
    """Programs of kernels that flush crashed: their bodies were not in the tiles."""
    run_both_ways(relaxation(16, 12, 5), ftz=True)


def test_sweeps_are_those_of_numpy():
    n, m, sweeps = 12, 10, 4
    (loss, u, *_), *_ = run_both_ways(relaxation(n, m, sweeps))[0]
    values = np.random.default_rng(7)
    b = values.random((n, m), np.float32).astype(float)
    v = values.random((sweeps + 1, n, m), np.float32)[0].astype(float)
    for _ in range(sweeps):
        near = np.roll(v, -1, 0) + np.roll(v, 1, 0) + np.roll(v, -1, 1) + np.roll(v, 2, 1)
        v = 0.23 * near + b
    np.testing.assert_allclose(u[sweeps], v, rtol=1e-5)
    np.testing.assert_allclose(loss, (v**2).sum(), rtol=1e-5)


@pytest.mark.parametrize("name", ["tai.accesses", "tai.tiles", "tai.digits"])
def test_without_notes_of_passes_nothing_runs_in_tiles(name, monkeypatch):
    """A foreign pass may drop them. That costs time, not a bit."""
    expected, tape = run_both_ways(relaxation(13, 11, 5))
    assert chains_of(tape)
    monkeypatch.setenv("TAI_STRIP_ATTRIBUTES", name)
    results, tape = run_both_ways(relaxation(13, 11, 5))
    assert not chains_of(tape)
    for one, other in zip(results, expected, strict=True):
        for kept, whole in zip(one, other, strict=True):
            np.testing.assert_array_equal(kept, whole)


def test_sweeps_inside_of_the_borders():
    _, tape = run_both_ways(relaxation(14, 17, 5, inner=True))
    assert any("inside_0 x 5" in names for _, names in chains_of(tape))


def test_stores_that_are_left_out_keep_what_was_there():
    _, tape = run_both_ways(relaxation(11, 9, 4, conditional=True))
    assert any("sometimes_0 x 4" in names for _, names in chains_of(tape))


def test_lines_and_boxes():
    def scene(runs):
        n = 40
        x = ti.field(ti.f32, shape=(6, n), needs_grad=True)
        c = ti.field(ti.f64, shape=(4, 6, 5, 7), needs_grad=True)
        loss = ti.field(ti.f64, shape=(), needs_grad=True)

        @ti.kernel
        def line(t: ti.i32):
            for i in range(n):
                x[t + 1, i] = 0.4 * x[t, i] + 0.3 * x[t, (i + 3) % n] + 0.2 * x[t, (i + n - 1) % n]

        @ti.kernel
        def box(t: ti.i32):
            for i, j, k in ti.ndrange(6, 5, 7):
                c[t + 1, i, j, k] = c[t, (i + 1) % 6, j, k] * c[t, i, j, (k + 6) % 7]

        @ti.kernel
        def total():
            for i in range(n):
                loss[None] += x[5, i]
            for i, j, k in ti.ndrange(6, 5, 7):
                loss[None] += c[3, i, j, k]

        values = np.random.default_rng(2)
        x.from_numpy(values.random((6, n), np.float32))
        c.from_numpy(values.random((4, 6, 5, 7)))

        def forward():
            for t in range(5):
                line(t)
            for t in range(3):
                box(t)
            total()

        def outcome():
            return loss[None], x.grad.to_numpy(), c.grad.to_numpy()

        return play(runs, loss, lambda: None, forward, outcome)

    _, tape = run_both_ways(scene)
    names = [names for _, names in chains_of(tape)]
    assert any("line_0 x 5" in name for name in names)
    assert any("box_0 x 3" in name for name in names)


def test_fields_that_share_cells():
    def scene(runs):
        n = 10
        p, q = (ti.Vector.field(2, ti.f32) for _ in range(2))
        s = ti.field(ti.f32)
        ti.root.dense(ti.i, 5).dense(ti.jk, (n, n)).place(p, s)
        ti.root.dense(ti.i, 5).dense(ti.jk, (n, n)).place(q)
        loss = ti.field(ti.f32, shape=())
        ti.root.lazy_grad()

        @ti.kernel
        def forth(t: ti.i32):
            for i, j in ti.ndrange(n, n):
                q[t, i, j] = p[t, (i + 1) % n, j] + ti.Vector([s[t, i, j], p[t, i, j][1]])

        @ti.kernel
        def back(t: ti.i32):
            for i, j in ti.ndrange(n, n):
                p[t + 1, i, j] = 0.5 * (q[t, i, (j + 1) % n] + q[t, (i + n - 1) % n, j])
                s[t + 1, i, j] = q[t, i, j][0] * 0.1

        @ti.kernel
        def total():
            for i, j in ti.ndrange(n, n):
                loss[None] += p[4, i, j].dot(p[4, i, j]) + s[4, i, j]

        values = np.random.default_rng(4)

        def prepare():
            p.from_numpy(values.random((5, n, n, 2), np.float32))
            s.from_numpy(values.random((5, n, n), np.float32))

        def forward():
            for t in range(4):
                forth(t)
                back(t)
            total()

        def outcome():
            return loss[None], p.grad.to_numpy(), s.grad.to_numpy()

        return play(runs, loss, prepare, forward, outcome)

    _, tape = run_both_ways(scene)
    assert any("forth_0, back_0" in names for _, names in chains_of(tape))


def test_other_parameters_make_other_chains():
    # From some run on, the rows have another order: the former chain is none any more, and the
    # other way round.
    def scene(runs):
        n, rows = 9, 9
        u = ti.field(ti.f32, shape=(rows, n, n), needs_grad=True)
        loss = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def sweep(a: ti.i32, b: ti.i32):
            for i, j in ti.ndrange(n, n):
                u[b, i, j] = 0.5 * (u[a, (i + 1) % n, j] + u[a, i, (j + n - 1) % n]) + 0.01

        @ti.kernel
        def total():
            for i, j in ti.ndrange(n, n):
                loss[None] += u[rows - 1, i, j] ** 2

        start = np.random.default_rng(8).random((rows, n, n), np.float32)
        results = []
        for run in range(runs + 5):
            u.from_numpy(start)
            order = list(range(rows))
            if run >= runs:
                order[1:-1] = np.random.default_rng(run).permutation(order[1:-1])
            with ti.ad.Tape(loss) as tape:
                for a, b in zip(order, order[1:], strict=False):
                    sweep(int(a), int(b))
                total()
            results.append((u.to_numpy(), u.grad.to_numpy()))
        return results, tape

    run_both_ways(scene)


def test_what_is_read_from_anywhere_is_in_no_chain():
    def scene(runs):
        n = 12
        u = ti.field(ti.f32, shape=(5, n, n), needs_grad=True)
        at = ti.field(ti.i32, shape=(n, n))
        loss = ti.field(ti.f32, shape=(), needs_grad=True)

        @ti.kernel
        def jump(t: ti.i32):
            for i, j in ti.ndrange(n, n):
                u[t + 1, i, j] = 0.5 * u[t, at[i, j], j] + 0.25

        @ti.kernel
        def total():
            for i, j in ti.ndrange(n, n):
                loss[None] += u[4, i, j]

        values = np.random.default_rng(9)
        u.from_numpy(values.random((5, n, n), np.float32))
        at.from_numpy(values.integers(0, n, (n, n)).astype(np.int32))

        def forward():
            for t in range(4):
                jump(t)
            total()

        return play(runs, loss, lambda: None, forward, lambda: (u.to_numpy(), u.grad.to_numpy()))

    _, tape = run_both_ways(scene)
    assert not chains_of(tape)
