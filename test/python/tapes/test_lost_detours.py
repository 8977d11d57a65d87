"""Detours between two kernels of one tape that lose a gradient: each is said, once."""

import warnings

import numpy as np
import pytest
import tai as ti

N = 5
FLAGS = {"needs_grad": True, "needs_dual": True}


class Scene:
    """x -> somewhere else -> y -> loss"""

    def __init__(self):
        ti.init(default_fp=ti.f64, offline_cache=False)
        x = self.x = ti.field(ti.f64, shape=N, name="x", **FLAGS)
        y = self.y = ti.field(ti.f64, shape=N, name="y", **FLAGS)
        v = self.v = ti.Vector.field(2, ti.f64, shape=N, name="v", **FLAGS)
        loss = self.loss = ti.field(ti.f64, shape=(), name="loss", **FLAGS)
        self.plain = ti.field(ti.f64, shape=N, name="plain")
        self.state = {}
        x.from_numpy(np.arange(1, N + 1).astype(np.float64))

        @ti.kernel
        def keep(a: ti.types.ndarray()):
            for i in x:
                a[i] = 2 * x[i]

        @ti.kernel
        def count(a: ti.types.ndarray()):
            for i in range(a.shape[0]):
                a[i] = i

        @ti.kernel
        def go_on(a: ti.types.ndarray()):
            for i in y:
                y[i] += 3 * a[i]

        @ti.kernel
        def fill(A: ti.types.sparse_matrix_builder()):
            for i in x:
                A[i, i] += x[i]

        @ti.kernel
        def constant(A: ti.types.sparse_matrix_builder()):
            for i in range(N):
                A[i, i] += 2.0

        @ti.kernel
        def total():
            for i in y:
                loss[None] += y[i] ** 2 + v[i].norm_sqr()

        self.keep, self.count, self.go_on, self.total = keep, count, go_on, total
        self.fill, self.constant = fill, constant
        self.K = self.matrix(constant)

    def matrix(self, kernel):
        builder = ti.linalg.SparseMatrixBuilder(N, N, 2 * N, dtype=ti.f64)
        kernel(builder)
        return builder.build()

    def solver(self, matrix):
        solver = ti.linalg.SparseSolver(dtype=ti.f64)
        solver.factorize(matrix)
        return solver


def said(scene, run):
    """The warnings of three tapes, but for those about the loss."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(3):
            with ti.ad.Tape(scene.loss):
                run(scene)
                scene.total()
    assert all(issubclass(w.category, ti.ad.TaiGradientWarning) for w in caught)
    found = [w for w in caught if "does not depend on any field" not in str(w.message)]
    assert all(w.filename == __file__ for w in found)
    return [(str(w.message), w.lineno) for w in found]


def torch():
    return pytest.importorskip("torch", reason="torch is not installed")


# Each loses a gradient in its last line.


def lost_numpy_array(s):
    a = np.zeros(N)
    s.keep(a)
    s.y.from_numpy(a)


def lost_part_of_a_numpy_array(s):
    s.state["a"] = np.zeros((N, 2))
    s.keep(s.state["a"][:, 1])
    s.y.from_numpy(np.ascontiguousarray(s.state["a"][:, 1]))


def lost_view_that_the_text_does_not_show(s):
    s.state["a"] = np.zeros(N)
    s.keep(s.state["a"])
    s.y.from_numpy(s.state["a"])


def lost_numpy_function(s):
    a = np.zeros(N)
    s.keep(a)
    b = np.sin(a) + 1
    s.y.from_numpy(b)


def lost_element(s):
    a = np.zeros(N)
    s.keep(a)
    s.y[2] = a[2]


def lost_vectors(s):
    a = np.zeros(N)
    s.keep(a)
    s.v.from_numpy(np.stack([a, a], 1))


def lost_ndarray(s):
    a = ti.ndarray(ti.f64, N)
    s.keep(a)
    s.y.from_numpy(a.to_numpy())


def lost_numpy_between_kernels(s):
    a = np.zeros(N)
    s.keep(a)
    s.go_on(2 * a)


def lost_field_to_a_kernel(s):
    s.go_on(s.x.to_numpy())


def lost_torch_operation(s):
    a = torch().zeros(N, dtype=torch().float64)
    s.keep(a)
    b = a.sin()
    s.go_on(b)


def lost_torch_tensor(s):
    a = torch().zeros(N, dtype=torch().float64)
    s.keep(a)
    s.y.from_torch(a)


def lost_to_torch(s):
    t = s.x.to_torch()
    t = 2 * t
    s.y.from_torch(t)


def lost_to_torch_in_one_line(s):
    s.y.from_torch(2 * s.x.to_torch())


def lost_to_torch_and_a_kernel(s):
    t = s.x.to_torch()
    s.go_on(t * 2)


def lost_view_by_numpy(s):
    t = np.from_dlpack(s.x)
    s.y.from_numpy(t)


def lost_view_by_torch(s):
    t = torch().from_dlpack(s.x)
    s.y.from_torch(3 * t)


def lost_view_in_one_line(s):
    s.y.from_numpy(np.from_dlpack(s.x) * 2)


def lost_view_to_a_kernel(s):
    t = np.from_dlpack(s.x).copy()
    s.go_on(t)


def lost_view_as_an_argument(s):
    t = torch().from_dlpack(s.x)
    s.go_on(t)


def lost_view_of_vectors(s):
    t = np.from_dlpack(s.v)
    s.y.from_numpy(t[:, 0])


def lost_matrix(s):
    A = s.matrix(s.fill)
    s.y.from_numpy(A @ np.ones(N))


def lost_matrix_arithmetic(s):
    A = 2.0 * (s.matrix(s.fill) + s.K).transpose() @ s.K
    A.spmv(np.ones(N), s.y)


def lost_product_with_a_field(s):
    s.y.from_numpy(s.K @ s.x)


def lost_function_of_a_product_with_a_field(s):
    s.y.from_numpy(np.sqrt(s.K @ s.x))


def lost_product_of_a_function(s):
    s.go_on(s.K @ np.sqrt(s.x.to_numpy()))


def lost_product_of_fields(s):
    s.K.spmv(s.x, s.y)


def lost_solver(s):
    x = s.solver(s.matrix(s.fill)).solve(np.ones(N))
    s.y.from_numpy(x)


def lost_right_hand_side(s):
    s.go_on(s.solver(s.K).solve(s.x))


def lost_right_hand_side_of_cg(s):
    x, _ = ti.linalg.SparseCG(s.K, s.x).solve()
    s.y.from_numpy(x)


LOST = {name[5:]: f for name, f in list(globals().items()) if name.startswith("lost_")}


@pytest.mark.parametrize("name", LOST)
def test_it_is_said_once_with_the_line(name):
    if "to_torch" in name:
        torch()
    scene, code = Scene(), LOST[name].__code__
    found = said(scene, LOST[name])
    assert len(found) == 1, found
    ((message, line),) = found
    last = max(number for _, _, number in code.co_lines() if number is not None)
    assert line == last
    assert "gradient" in message and "constant" in message


# These programs lose no gradient.


def right_printed(s):
    a = np.zeros(N)
    s.keep(a)
    assert a.sum() == 30
    s.go_on(np.ones(N))
    s.y.from_numpy(np.ones(N))


def right_to_a_field_without_gradient(s):
    a = np.zeros(N)
    s.keep(a)
    s.plain.from_numpy(a)
    s.plain.from_numpy(np.from_dlpack(s.x))


def right_constant_array(s):
    a = np.zeros(N)
    s.count(a)
    s.y.from_numpy(a)
    s.go_on(2 * a)


def right_constant_matrix(s):
    s.y.from_numpy(s.matrix(s.constant) @ np.ones(N))
    s.go_on(s.solver(s.K).solve(np.ones(N)))
    s.K.spmv(s.plain, s.y)


def right_view_of_a_field_without_gradient(s):
    t = np.from_dlpack(s.plain)
    s.y.from_numpy(t * 2)
    s.go_on(t)


def right_column_beside_it(s):
    a = np.zeros((N, 2))
    s.keep(a[:, 1])
    s.go_on(a[:, 0])
    s.y.from_numpy(a[:, 0])


def right_view_beside_one_of_a_field_with_a_gradient(s):
    seen = np.from_dlpack(s.x)
    t = np.from_dlpack(s.plain)
    assert len(seen) == N
    s.y.from_numpy(t * 2)
    s.go_on(t)


def right_function_of_a_product_with_a_constant(s):
    s.y.from_numpy(np.sqrt(s.K @ s.plain))


def right_kernel_that_writes(s):
    a, b = np.zeros(N), np.zeros(N)
    s.keep(a)
    s.count(b)
    s.count(a)


RIGHT = {name[6:]: f for name, f in list(globals().items()) if name.startswith("right_")}


@pytest.mark.parametrize("name", RIGHT)
def test_nothing_is_said_where_nothing_is_lost(name):
    assert said(Scene(), RIGHT[name]) == []


def test_marks_end_with_the_tape():
    scene, a = Scene(), np.zeros(N)
    with ti.ad.Tape(scene.loss):
        scene.keep(a)
        scene.total()

    def run(s):
        s.y.from_numpy(a)
        s.go_on(2 * a)

    assert said(scene, run) == []


def test_views_that_are_older_than_the_tape():
    scene = Scene()
    view = np.from_dlpack(scene.x)
    ((message, _),) = said(scene, lambda s: s.go_on(view))
    assert "view of field 'x'" in message
    ((message, _),) = said(scene, lambda s: s.y.from_numpy(view + 1))
    assert "field 'y'" in message


def test_a_view_of_an_earlier_program():
    scene = Scene()
    view = np.from_dlpack(scene.x)
    scene = Scene()
    assert said(scene, lambda s: s.go_on(view)) == []


def test_a_mark_goes_with_its_array():
    """Another array may come to lie where the first one was."""
    scene = Scene()

    def run(s):
        for _ in range(20):
            s.keep(np.zeros(N))
        a = np.ones(N)
        s.y.from_numpy(a)

    assert said(scene, run) == []


def test_forward_mode():
    scene = Scene()

    def run():
        with ti.ad.FwdMode(loss=scene.loss, param=scene.x, seed=[1.0] * N):
            scene.y.from_numpy(np.from_dlpack(scene.x) * 2)
            scene.total()

    with pytest.warns(ti.ad.TaiGradientWarning, match="forward mode"):
        run()
