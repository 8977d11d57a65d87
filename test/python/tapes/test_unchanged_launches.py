"""Incremental tapes record launches whose results are there already, and do not run them."""

import os

import numpy as np
import pytest
import tai as ti

N = 64
OFF = "all,-unchanged-launches"
# A device runs all launches; results are the same there.
ON_CPU = os.environ.get("TI_ARCH", "cpu") == "cpu"


def counts():
    found = ti.profiler.skips()["unchanged-launches"]
    ti.profiler.clear_skips()
    return found["launches_run"], found["launches_skipped"]


class Scene:
    """A feature of `x`, of which the loss is a weighted sum."""

    def __init__(self, skip="all"):
        ti.init(skip=skip, offline_cache=False, deterministic=True)
        self.x, self.h, self.w = (
            ti.field(ti.f32, shape=N, needs_grad=True, needs_dual=True) for _ in range(3)
        )
        self.loss = ti.field(ti.f32, shape=(), needs_grad=True, needs_dual=True)
        x, h, w, loss = self.x, self.h, self.w, self.loss

        @ti.kernel
        def feature(a: ti.f32):
            for i in x:
                h[i] = ti.sin(x[i]) * a + ti.exp(-x[i])

        @ti.kernel
        def weigh():
            for i in w:
                loss[None] += w[i] * h[i]

        @ti.kernel
        def descend(rate: ti.f32):
            for i in w:
                w[i] -= rate * w.grad[i]

        @ti.kernel
        def move():
            for i in x:
                x[i] += 0.5

        @ti.kernel
        def spoil():
            for i in h:
                h[i] = 0.0

        self.feature, self.weigh, self.descend, self.move = feature, weigh, descend, move
        self.spoil = spoil
        x.from_numpy(np.linspace(-1, 1, N).astype("float32"))
        w.from_numpy(np.linspace(2, 3, N).astype("float32"))
        ti.profiler.clear_skips()

    def sweep(self, a=1.5):
        with ti.ad.Tape(self.loss, incremental=True) as tape:
            self.feature(a)
            self.weigh()
        return tape

    def state(self):
        return [f.to_numpy().tobytes() for f in (self.x, self.h, self.w, self.x.grad, self.w.grad)]


def test_incremental_tapes_have_the_same_bits():
    found = []
    for skip in ("all", OFF):
        scene, states = Scene(skip), []
        for step in range(6):
            tape = scene.sweep(1.5 if step < 4 else 2.5)
            states.append((scene.loss[None], *scene.state()))
            scene.descend(0.1)
            if step == 2:
                scene.move()
        found.append(states)
        # The first, the fourth (x has moved) and the fifth (another argument) run.
        assert counts() == ((9, 3) if ON_CPU and skip == "all" else (12, 0))
        assert tape.explain().count("did not run") == (ON_CPU and skip == "all")
    assert found[0] == found[1]


WRITES = {
    "element": lambda s: s.x.__setitem__(3, 9.0),
    "array": lambda s: s.x.from_numpy(np.zeros(N, "float32")),
    "fill": lambda s: s.x.fill(0.25),
    "launch": lambda s: s.move(),
    "output": lambda s: s.spoil(),
    "output element": lambda s: s.h.__setitem__(3, 9.0),
    "other tape": lambda s: under_a_tape(s),
    "replay": lambda s: s.sweep().replay(),
    "forward mode": lambda s: forwards(s),
}


def under_a_tape(scene):
    with ti.ad.Tape(scene.loss):
        scene.move()
        scene.weigh()


def forwards(scene):
    with ti.ad.FwdMode(loss=scene.loss, param=scene.w, seed=[1.0] * N):
        scene.move()
        scene.weigh()


@pytest.mark.parametrize("write", WRITES)
def test_every_write_counts(write):
    scene = Scene()
    scene.sweep()
    scene.sweep()
    assert counts() == ((3, 1) if ON_CPU else (4, 0))
    WRITES[write](scene)
    counts()
    scene.sweep()
    assert counts() == (2, 0)
    expected = np.sin(scene.x.to_numpy()) * 1.5 + np.exp(-scene.x.to_numpy())
    np.testing.assert_allclose(scene.h.to_numpy(), expected, rtol=1e-5)


def test_tangents_that_a_kernel_reads_as_values():
    """Forward mode changes the tangents that a launch has read."""
    scene = Scene()
    x, h, w, loss = scene.x, scene.h, scene.w, scene.loss

    @ti.kernel
    def square():
        for i in x:
            h[i] = x[i] * x[i]

    @ti.kernel
    def use():
        for i in w:
            w[i] = 2.0 * h.dual[i]

    for seed in (1.0, 3.0):
        with ti.ad.FwdMode(loss=h, param=x, seed=[seed] * N, clear_gradients=seed == 1.0):
            square()
        for _ in range(2):
            with ti.ad.Tape(loss, incremental=True):
                use()
                scene.weigh()
        expected = 2.0 * h.dual.to_numpy()
        assert expected[0] == -4.0 * seed
        np.testing.assert_array_equal(w.to_numpy(), expected)


def test_memory_that_was_lent_is_never_known():
    scene = Scene()
    np.from_dlpack(scene.x)
    for _ in range(3):
        scene.sweep()
    assert counts() == (6, 0)


def test_kernels_with_other_effects_run():
    ti.init(offline_cache=False)
    x, y, z = (ti.field(ti.f32, shape=N, needs_grad=True) for _ in range(3))
    loss = ti.field(ti.f32, shape=(), needs_grad=True)

    @ti.kernel
    def noise():
        for i in x:
            y[i] = x[i] * ti.random()

    @ti.kernel
    def gather():
        for i in x:
            y[i // 2] += x[i]

    @ti.kernel
    def in_place():
        for i in x:
            z[i] = 0.5 * z[i] + x[i]

    @ti.kernel
    def total() -> ti.f32:
        s = 0.0
        for i in range(N):
            s += x[i]
        return s

    @ti.kernel
    def array(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in x:
            y[i] = x[i] * a[i]

    ones = np.ones(N, "float32")
    ti.profiler.clear_skips()
    for _ in range(3):
        with ti.ad.Tape(loss, incremental=True):
            noise()
            gather()
            in_place()
            total()
            array(ones)
    assert counts()[1] == 0


def test_recorded_values_of_launches_that_did_not_run():
    """The sweep of a tape restores what a skipped launch would have overwritten."""
    found = []
    for skip in ("all", OFF):
        scene = Scene(skip)
        states = []
        for _ in range(3):
            with ti.ad.Tape(scene.loss, incremental=True):
                scene.feature(1.0)
                scene.weigh()
                scene.feature(2.0)
                scene.weigh()
            states.append((scene.loss[None], *scene.state()))
        found.append(states)
    assert found[0] == found[1]
    for skip in ("all", OFF):
        scene = Scene(skip)
        for _ in range(2):
            with ti.ad.Tape(scene.loss, incremental=True):
                scene.weigh()
                scene.feature(2.0)
                scene.weigh()
        found.append((scene.loss[None], *scene.state()))
    assert found[2] == found[3]


def test_it_is_decided_before_the_tape_records():
    scene = Scene()
    with pytest.raises(Exception, match="before it records"), ti.ad.Tape(scene.loss) as tape:
        scene.weigh()
        tape._core.skip_unchanged()


def reasons(tape):
    lines = tape.explain().splitlines()
    return [line.partition("; ran: ")[2] for line in lines if line[0].isdigit()]


@pytest.mark.skipif(not ON_CPU, reason="a device runs all launches")
def test_explain_says_why_a_launch_ran():
    scene = Scene()
    n = ti.Vector.field(2, ti.f32, shape=N, needs_grad=True)
    n.fill(0)
    cells = ti.field(ti.f32, needs_grad=True)
    ti.root.pointer(ti.i, 8).dense(ti.i, 8).place(cells, cells.grad)
    x, loss = scene.x, scene.loss

    @ti.kernel
    def draw():
        for i in n:
            n[i].x = ti.random()

    @ti.kernel
    def step():
        for i in x:
            n[i].y += x[i]

    @ti.kernel
    def shift():
        for i in range(N - 1):
            n[i].y = n[i].x * x[i]

    @ti.kernel
    def touch():
        for i in x:
            cells[i] = x[i]

    @ti.kernel
    def take(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        for i in x:
            n[i].x = a[i] * x[i]

    @ti.kernel
    def give() -> ti.f32:
        return x[0]

    a = np.ones(N, np.float32)

    def sweep(**options):
        with ti.ad.Tape(loss, incremental=True, **options) as tape:
            scene.feature(1.5)
            scene.weigh()
            draw()
            step()
            touch()
            take(a)
            give()
        return reasons(tape)

    first = sweep()
    assert first[0] == "no launch with these arguments is known to incremental tapes"
    second = sweep()
    assert second[0] == ""
    assert second[1] == "the kernel accumulates into @field_3"
    assert second[2].startswith("the kernel draws random numbers, prints")
    assert second[3].startswith("the kernel accumulates into @")
    assert second[4:] == [
        "a tree of the kernel's fields has sparse levels",
        "the kernel uses arrays",
        "the kernel returns values",
    ]
    scene.move()
    assert sweep()[0] == "@field has been written since"
    assert sweep(checkpoint=1)[0].startswith("skip=-unchanged-launches")
    sweep()
    view = np.from_dlpack(x)
    assert view.shape == (N,) and sweep()[0].startswith(
        "an address in the memory of @field was given away"
    )
