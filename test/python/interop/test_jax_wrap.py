"""Kernels as differentiable functions of JAX."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti

jax = pytest.importorskip("jax", reason="JAX is not installed: pip install jax")
jnp = pytest.importorskip("jax.numpy", reason="JAX is not installed: pip install jax")
from jax.test_util import check_grads  # noqa: E402
from tai._impl.frameworks import jax_operators  # noqa: E402
from tai._impl.frameworks.xla_buffers import DeviceBuffer  # noqa: E402


@pytest.fixture(autouse=True)
def wide():
    """f64, for the checks of gradients."""
    before = jax.config.jax_enable_x64
    jax.config.update("jax_enable_x64", True)
    ti.init()
    yield
    jax.config.update("jax_enable_x64", before)


@ti.kernel
def scale_squares(x: ti.types.ndarray(), s: ti.f64, y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = s * x[i] * x[i]


@ti.kernel
def two(x: ti.types.ndarray(), w: ti.types.ndarray(), y: ti.types.ndarray(), z: ti.types.ndarray()):
    for i in range(w.shape[0]):
        for j in range(x.shape[0]):
            y[i] += ti.sin(w[i, j]) * x[j]
    for j in range(x.shape[0]):
        z[j] = ti.exp(x[j])


@ti.kernel
def reads_output(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[i] = x[i] * x[i]
        y[i] = y[i] * y[i] * x[i]


@ti.kernel
def step(a: ti.types.ndarray(), b: ti.types.ndarray()):
    for i in range(a.shape[0]):
        b[i] = a[i] + 0.1 * ti.sin(a[i])


def chain(x, y):
    middle = ti.ndarray(ti.f64, x.shape, needs_grad=True)
    step(x, middle)
    step(middle, y)


SQUARES = ti.jax.wrap(scale_squares, outputs={"y": "x"})
TWO = ti.jax.wrap(two, outputs={"y": lambda x, w: w.shape[0], "z": "x"})
READS = ti.jax.wrap(reads_output, outputs={"y": "x"})
CHAIN = ti.jax.wrap(chain, outputs={"y": "x"})


def sample(*shape, seed=0):
    return jnp.asarray(np.random.default_rng(seed).uniform(0.5, 1.5, shape))


@pytest.mark.parametrize("n", [0, 1, 7, 65537])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_values(n, dtype):
    x = jnp.asarray(np.linspace(-1, 2, n), dtype)
    for f in (SQUARES, jax.jit(SQUARES)):
        y = f(x, 3.0)
        assert y.dtype == dtype
        np.testing.assert_allclose(y, 3 * np.asarray(x) ** 2, rtol=1e-6)


def test_inputs_are_not_changed():
    x = sample(5)
    before = np.array(x)
    for _ in range(3):
        jax.grad(lambda x: SQUARES(x, 2.0).sum())(x)
    np.testing.assert_array_equal(x, before)


def test_several_outputs():
    x, w = sample(3), sample(2, 3, seed=1)
    y, z = jax.jit(TWO)(x, w)
    np.testing.assert_allclose(y, np.sin(w) @ np.asarray(x))
    np.testing.assert_allclose(z, np.exp(x))


CHECKED = {
    "squares": lambda: (SQUARES, (sample(4), 1.3)),
    "two": lambda: (TWO, (sample(3), sample(2, 3, seed=1))),
    "reads": lambda: (READS, (sample(4),)),
    "chain": lambda: (CHAIN, (sample(4),)),
    "one of two": lambda: (lambda *a: TWO(*a)[1], (sample(3), sample(2, 3, seed=1))),
    "jit": lambda: (jax.jit(SQUARES), (sample(4), 1.3)),
    "vmap": lambda: (jax.vmap(SQUARES), (sample(3, 4), sample(3, seed=2))),
    "vmap of one": lambda: (jax.vmap(TWO, in_axes=(0, None)), (sample(5, 3), sample(2, 3, seed=1))),
    "vmap of last": lambda: (jax.vmap(READS, in_axes=1, out_axes=1), (sample(3, 4),)),
    "vmap twice": lambda: (jax.vmap(jax.vmap(READS)), (sample(2, 3, 4),)),
    "scan": lambda: (
        lambda x: jax.lax.scan(lambda c, _: (CHAIN(c), c.sum()), x, None, length=3),
        (sample(4),),
    ),
    "checkpoint": lambda: (jax.checkpoint(lambda x: READS(READS(x)).sum()), (sample(3),)),
}


@pytest.mark.parametrize("name", CHECKED)
def test_gradients(name):
    f, args = CHECKED[name]()
    check_grads(f, args, order=1, modes=["rev"])


@pytest.mark.parametrize("f", [SQUARES, lambda x, s: READS(s * x)], ids=["kernel", "tape"])
@pytest.mark.parametrize("jit", [False, True])
def test_seeds_keep_their_values(f, jit):
    x, seed = sample(65_537), sample(65_537, seed=1)
    before = np.array(seed)

    def pull(x, seed):
        (gradient,) = jax.vjp(lambda x: f(x, 2.0), x)[1](seed)
        return gradient, seed + 0

    for _ in range(2):
        gradient, after = (jax.jit(pull) if jit else pull)(x, seed)
        np.testing.assert_array_equal(seed, before)
        np.testing.assert_array_equal(after, before)
    whole = jax.grad(lambda x: (f(x, 2.0) * before).sum())(x)
    np.testing.assert_array_equal(gradient, whole)


def test_batches_of_seeds_alone_and_of_inputs_alone():
    x, w = sample(3), sample(2, 3, seed=1)
    np.testing.assert_allclose(jax.jacrev(SQUARES)(x, 2.0), np.diag(4 * np.asarray(x)))
    by_x, by_w = jax.jit(jax.jacrev(lambda x, w: TWO(x, w)[0], argnums=(0, 1)))(x, w)
    np.testing.assert_allclose(by_x, np.sin(w))
    np.testing.assert_allclose(by_w[1, 1], np.cos(w[1]) * np.asarray(x))
    # The seed of a sum is the same in the whole batch; a weight is, too.
    slope = jax.grad(lambda x, w: TWO(x, w)[0].sum())
    xs = sample(2, 4, 3, seed=3)
    each = jax.vmap(jax.vmap(slope, in_axes=(0, None)), in_axes=(0, None))(xs, w)
    np.testing.assert_allclose(each, np.broadcast_to(np.sin(w).sum(0), xs.shape))


def test_batches_give_the_values_of_single_calls():
    x, w = sample(5, 3), sample(2, 3, seed=1)
    y, z = jax.jit(jax.vmap(TWO, in_axes=(0, None)))(x, w)
    for i in range(5):
        single = TWO(x[i], w)
        np.testing.assert_array_equal(y[i], single[0])
        np.testing.assert_array_equal(z[i], single[1])


def test_gradients_by_what_is_wanted():
    f = jax.jit(jax.grad(lambda x, s: SQUARES(x, s).sum(), argnums=1))
    assert f(jnp.arange(3.0), 2.0) == 5
    x = jnp.arange(3.0)
    np.testing.assert_array_equal(
        jax.grad(lambda x: (SQUARES(x, 2.0) * x).sum())(x), 6 * np.arange(3.0) ** 2
    )


def test_whole_numbers_and_bools():
    @ti.kernel
    def pick(x: ti.types.ndarray(), at: ti.types.ndarray(), k: ti.i32, b: ti.u1,
             y: ti.types.ndarray(), n: ti.types.ndarray()):  # fmt: skip
        for i in range(at.shape[0]):
            y[i] = x[at[i]] * k
            if b:
                n[i] = at[i] + 1

    f = ti.jax.wrap(pick, outputs={"y": lambda x, at, k, b: at.shape, "n": "at"})
    x, at = sample(4), jnp.array([3, 0])
    y, n = f(x, at, 2, True)
    np.testing.assert_array_equal(y, 2 * x[at])
    assert n.dtype == at.dtype and n.tolist() == [4, 1]
    gradient = jax.jit(jax.grad(lambda x: f(x, at, 2, True)[0].sum()))(x)
    assert gradient.tolist() == [2, 0, 0, 2]


def test_output_that_is_described():
    @ti.kernel
    def count(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            if x[i] > 0:
                y[0] += 1

    f = ti.jax.wrap(count, outputs={"y": lambda x: jax.ShapeDtypeStruct((1,), jnp.int32)})
    assert f(jnp.array([1.0, -1.0, 2.0])).tolist() == [2]


def test_second_derivatives_are_refused():
    def once(x):
        return SQUARES(x, 2.0).sum()

    with pytest.raises(ti.TaiAutodiffError, match="the gradient of 'scale_squares' has no grad"):
        jax.grad(lambda x: jax.grad(once)(x).sum())(sample(3))
    with pytest.raises(TypeError, match="forward-mode"):
        jax.jvp(once, (sample(3),), (sample(3),))


def test_kernels_that_write_to_inputs():
    @ti.kernel
    def spoil(x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(x.shape[0]):
            y[i] = x[i]
            x[i] = 0

    f = ti.jax.wrap(spoil, outputs={"y": "x"})
    x = sample(3)
    before = np.array(x)
    for _ in range(2):
        with pytest.raises(Exception, match="'spoil' writes to an input"):
            jax.block_until_ready(f(x))
    np.testing.assert_array_equal(x, before)


def test_arrays_of_a_gpu_have_the_attributes_of_arrays():
    given = [DeviceBuffer(4096 * n, (3, 2), np.float64, 0) for n in (1, 2)]
    array = jax_operators._with_gradient(*given)
    assert (array.shape, array.ndim, array.dtype) == ((3, 2), 2, np.float64)
    assert array.grad.shape == (3, 2) and array.grad.grad is None


def test_mistakes():
    @ti.kernel
    def field(x: ti.template(), y: ti.types.ndarray()):
        for i in range(y.shape[0]):
            y[i] = 1

    kind = ti.TaiRuntimeTypeError
    cases = [
        (lambda: ti.jax.wrap(field, outputs={"y": "x"}), "neither an array nor a number"),
        (lambda: ti.jax.wrap(3, outputs={"y": "x"}), "takes a kernel or a function"),
        (lambda: ti.jax.wrap(scale_squares, outputs={}), "must be a dict"),
        (lambda: ti.jax.wrap(scale_squares, outputs={"q": "x"}), "name 'q'"),
        (lambda: ti.jax.wrap(scale_squares, outputs={"y": "s"}), "say 's' of 'y'"),
        (lambda: SQUARES(sample(3)), "takes 2 inputs, but got 1"),
        (lambda: SQUARES(sample(3), sample(3)), "input 's' of 'scale_squares' is a number"),
    ]
    for call, message in cases:
        with pytest.raises(kind, match=message):
            call()
    loss = ti.field(ti.f64, shape=(), needs_grad=True)
    with pytest.raises(Exception, match="while a tape records"), ti.ad.Tape(loss):
        jax.block_until_ready(SQUARES(sample(3), 1.0))


def test_a_new_program_between_calls():
    f = jax.jit(SQUARES)
    x = jnp.arange(3.0)
    assert f(x, 1.0).tolist() == [0, 1, 4]
    ti.init(cpu_max_num_threads=2)
    assert f(x, 1.0).tolist() == [0, 1, 4]


PAGE = Path(__file__).resolve().parents[3] / "docs" / "guides" / "jax.md"
PROGRAMS = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)


@pytest.mark.parametrize("number", range(2))
def test_programs_of_the_page(number, tmp_path):
    assert len(PROGRAMS) == 2
    file = tmp_path / "program.py"
    file.write_text(PROGRAMS[number])
    subprocess.run([sys.executable, str(file)], check=True)


def test_tai_does_not_import_jax():
    code = "import sys, tai; tai.ad; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@ti.kernel
def parts(x: ti.types.ndarray(dtype=ti.f64, ndim=1), w: ti.types.ndarray(), a: ti.f64,
          y: ti.types.ndarray(), z: ti.types.ndarray(dtype=ti.f64)):  # fmt: skip
    n = x.shape[0]
    for i in range(n):
        y[i] = a * x[i] * x[i]
    z[0] = x[n - 1] * w[0]
    for i in x:
        z[i] += y[i] * y[i] * w[i]


def same_parts(x, w, a):
    y = a * x * x
    return y, (y * y * w).at[0].add(x[-1] * w[0])


@pytest.mark.parametrize("axes", [(0, None), (None, 0), (0, 0), (1, None), (0, 1)])
@pytest.mark.parametrize("size", [1, 2, 65])
def test_a_batch_is_one_launch(axes, size):
    function = ti.jax.wrap(parts, outputs={"y": "x", "z": "x"})
    shapes = {0: (size, 3), 1: (3, size), None: (3,)}
    x, w = (sample(*shapes[axis], seed=n) for n, axis in enumerate(axes))

    def results(of):
        one = jax.grad(lambda x, w, a: (of(x, w, a)[1] ** 2).sum(), argnums=(0, 1))
        shared = jax.grad(lambda x, w: jax.vmap(of, (*axes, None))(x, w, 0.5)[1].sum(), (0, 1))
        jacobian = jax.jacrev(lambda x, w, a: of(x, w, a)[1])
        return jax.jit(lambda x, w: (
            [jax.vmap(f, (*axes, None))(x, w, 0.5) for f in (of, one, jacobian)], shared(x, w)
        ))(x, w)  # fmt: skip

    for found, wanted in zip(jax.tree.leaves(results(function)),
                             jax.tree.leaves(results(same_parts)), strict=True):  # fmt: skip
        np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12)
    assert function.one_by_one == {} and (function._stacks.operators or size == 1)


def test_batches_that_launch_for_each_element():
    function = ti.jax.wrap(parts, outputs={"y": "x", "z": "x"})
    x, w, a = sample(4, 3), sample(3, seed=1), sample(4, seed=2)
    found = jax.vmap(function, (0, None, 0))(x, w, a)[1]  # a number for each
    np.testing.assert_allclose(found, jax.vmap(same_parts, (0, None, 0))(x, w, a)[1], rtol=1e-12)
    assert not function._stacks.operators

    @ti.kernel
    def bounded(n: ti.types.ndarray(), x: ti.types.ndarray(), y: ti.types.ndarray()):
        for i in range(n[0]):
            y[i] = 2 * x[i]

    function = ti.jax.wrap(bounded, outputs={"y": "x"})
    n = jnp.array([[0], [1], [3], [2]])
    np.testing.assert_allclose(jax.vmap(function)(n, x), 2 * x * (jnp.arange(3) < n))
    assert "array 'n' has a part for each element" in str(function.one_by_one)


def test_inputs_that_are_no_arrays():
    x = sample(3)
    for inputs, message in (
        ((None, 1.0), "input 'x' of 'scale_squares' is an array, but got NoneType"),
        ((x, "a"), "input 's' of 'scale_squares' is a number of type float, but got str"),
        ((x, x), "is a number of type float, but got float64[3]"),
    ):
        with pytest.raises(ti.TaiRuntimeTypeError, match=re.escape(message)):
            SQUARES(*inputs)


def test_inputs_by_name():
    x = sample(3)
    assert (SQUARES(s=2.0, x=x) == SQUARES(x, 2.0)).all()
    assert (jax.jit(lambda x: SQUARES(x, s=2.0))(x) == SQUARES(x, 2.0)).all()
    with pytest.raises(ti.TaiRuntimeTypeError, match="has no input 't'"):
        SQUARES(x, t=2.0)
    with pytest.raises(ti.TaiRuntimeTypeError, match="takes 2 inputs, but got 1"):
        SQUARES(x)


def test_a_shape_from_too_few_inputs():
    with pytest.raises(ti.TaiRuntimeTypeError, match="does not take the 2 inputs"):
        ti.jax.wrap(scale_squares, outputs={"y": lambda x: x.shape})


@ti.kernel
def last(x: ti.types.ndarray(), y: ti.types.ndarray()):
    for i in range(x.shape[0]):
        y[0] = x[i] * x[i]


def test_stores_to_one_element():
    function = ti.jax.wrap(last, outputs={"y": lambda x: 1})
    x = sample(3)
    for _ in range(2):
        y, gradient = jax.value_and_grad(lambda x: function(x)[0])(x)
        # The gradient belongs to the iteration whose number remained.
        wanted = [2 * v if v * v == y else 0.0 for v in x.tolist()]
        assert gradient.tolist() == wanted and sum(g != 0 for g in wanted) == 1


@pytest.mark.parametrize("n", [0, 3])
@pytest.mark.parametrize(
    ("dtype", "hint"),
    [("bfloat16", "x.astype(jnp.float32)"), ("float8_e5m2", "x.astype"), ("complex64", "x.real")],
)
def test_types_that_kernels_have_not(n, dtype, hint):
    x = jnp.ones(n, dtype)
    calls = [lambda: SQUARES(x, 2.0), lambda: jax.jit(SQUARES)(x, 2.0)]
    if dtype == "bfloat16":
        calls.append(lambda: jax.grad(lambda x: SQUARES(x, 2.0).sum().astype("float32"))(x))
    for call in calls:
        with pytest.raises(ti.TaiRuntimeTypeError, match=f"'x' .* of type {dtype}") as caught:
            call()
        assert hint in caught.value.hint
    assert SQUARES(x.real.astype(jnp.float32), 2.0).shape == (n,)


def test_a_result_of_a_type_that_kernels_have_not():
    def like(x, s):
        return jax.ShapeDtypeStruct(x.shape, jnp.bfloat16)

    with pytest.raises(ti.TaiRuntimeTypeError, match="bfloat16 as the type of 'y'"):
        ti.jax.wrap(scale_squares, outputs={"y": like})(jnp.ones(3), 2.0)


@pytest.mark.parametrize("answer", ["a", -1, (2, -1), None, 1.5])
def test_an_answer_that_is_no_shape(answer):
    with pytest.raises(ti.TaiRuntimeTypeError, match="as the shape of 'y'"):
        ti.jax.wrap(scale_squares, outputs={"y": lambda x, s: answer})(jnp.ones(3), 2.0)


@pytest.mark.parametrize("answer", [3, np.int64(3), [3]])
def test_answers_that_are_shapes(answer):
    f = ti.jax.wrap(scale_squares, outputs={"y": lambda x, s: answer})
    assert f(jnp.full(3, 2.0), 2.0).tolist() == [8, 8, 8]
