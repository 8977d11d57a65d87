"""Arguments, results and losses in forms that programs for Taichi use."""

import sys
import textwrap
from subprocess import PIPE, run

import numpy as np
import pytest
import tai as ti

Vec = ti.types.vector(3, ti.f32)


@pytest.fixture(autouse=True)
def program(fresh_program):
    ti.init(offline_cache=False)


def test_fields_of_structs_by_ti_field():
    Particle = ti.types.struct(pos=Vec, mass=ti.f32)
    particles = ti.field(Particle, shape=(4, 3), needs_grad=True)
    loss = ti.field(ti.f32, shape=(), needs_grad=True)
    particles.mass.fill(2)

    @ti.kernel
    def energy():
        for i, j in particles:
            p = particles[i, j]
            loss[None] += p.mass**2 + 3 * p.pos.x

    with ti.ad.Tape(loss):
        energy()
    assert np.all(particles.mass.grad.to_numpy() == 4)
    assert particles.pos.grad[2, 1].to_list() == [3, 0, 0]

    @ti.dataclass
    class Cell:
        a: ti.f32
        b: ti.i32

    placed = ti.field(dtype=Cell, name="cells")
    ti.root.dense(ti.i, 3).place(placed)
    placed[1].b = 2
    assert placed[1].b == 2 and placed.shape == (3,)


@pytest.mark.parametrize("shape", [(1,), 1, (1, 1)])
def test_losses_of_one_element(shape):
    x = ti.field(ti.f32, 5, needs_grad=True)
    loss = ti.field(ti.f32, shape=shape, needs_grad=True)
    x.fill(3)

    @ti.kernel
    def run():
        for i in x:
            for I in ti.static(ti.grouped(ti.ndrange(*loss.shape))):
                loss[I] += x[i] ** 2

    for _ in range(2):  # the loss is set to zero
        with ti.ad.Tape(loss) as tape:
            run()
        assert np.all(x.grad.to_numpy() == 6)
        assert loss.to_numpy().item() == 45
    tape.replay()
    assert np.all(x.grad.to_numpy() == 6)
    tape.grad(seed=2.0)
    assert np.all(x.grad.to_numpy() == 12)
    with ti.ad.Tape(loss, health=True) as tape:
        run()
    assert not tape.health().findings


def test_losses_of_one_element_in_arrays():
    x = ti.ndarray(ti.f32, 5, needs_grad=True)
    loss = ti.ndarray(ti.f32, shape=(1,), needs_grad=True)
    x.fill(3)

    @ti.kernel
    def run(x: ti.types.ndarray(), loss: ti.types.ndarray()):
        for i in x:
            loss[0] += x[i] ** 2

    for _ in range(2):
        with ti.ad.Tape(loss):
            run(x, loss)
        assert np.all(x.grad.to_numpy() == 6)
        assert loss[0] == 45
    pair = ti.ndarray(ti.f32, shape=(2,), needs_grad=True)
    with pytest.raises(ti.TaichiRuntimeTypeError, match="must be one number"):
        ti.ad.Tape(pair)


def test_forward_seeds_of_one_element():
    x = ti.field(ti.f32, (1,), needs_dual=True)
    loss = ti.field(ti.f32, (1,), needs_dual=True)
    x.fill(3)

    @ti.kernel
    def run():
        loss[0] += x[0] ** 2

    for seed, slope in ((None, 6), ([2.0], 12), (3.0, 18)):
        with ti.ad.FwdMode(loss=loss, param=x, seed=seed):
            run()
        assert loss.dual[0] == slope


def test_tuples_of_functions():
    @ti.func
    def halves(a, b) -> tuple[ti.f32, ti.i32]:
        return a * 0.5, b / 2 + 0.25

    @ti.real_func
    def early(a: ti.f32) -> tuple[ti.f32, Vec]:
        if a > 1:
            return a, ti.Vector([a, a, a])
        return 0, ti.Vector([1, 2, 3])

    x = ti.field(ti.f32, (), needs_grad=True)
    loss = ti.field(ti.f32, (), needs_grad=True)
    x[None] = 3

    @ti.kernel
    def compute():
        h, n = halves(x[None], 7)
        a, v = early(x[None])
        loss[None] += h + n * x[None] + a * v.sum()

    with ti.ad.Tape(loss):
        compute()
    assert loss[None] == 1.5 + 9 + 27
    assert x.grad[None] == 0.5 + 3 + 18

    @ti.func
    def wrong(a) -> tuple[ti.f32, ti.f32]:
        return a

    @ti.kernel
    def call() -> ti.f32:
        a, b = wrong(1.0)
        return a + b

    with pytest.raises(ti.TaiTypeError, match="returns 2 values, but got one value"):
        call()


def test_blocks_without_gradients():
    x = ti.field(ti.f32, 5, needs_grad=True)
    loss = ti.field(ti.f32, (), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            loss[None] += x[i]

    with ti.ad.Tape(loss) as tape:
        run()
        with ti.ad.no_grad():
            run()
        run()
    assert np.all(x.grad.to_numpy() == 2)
    with pytest.raises(ti.TaiAutodiffError, match="cannot run the block"):
        tape.replay()

    @ti.ad.no_grad()
    def quiet():
        run()

    with ti.ad.Tape(loss) as tape:
        run()
        quiet()
    tape.replay()
    assert np.all(x.grad.to_numpy() == 1)
    with ti.ad.no_grad():  # without a tape it does nothing
        run()
    with pytest.raises(ti.TaichiRuntimeTypeError, match="takes a function"):
        ti.ad.no_grad(5)


def test_arrays_that_the_annotation_takes_for_constants():
    x, y = (ti.ndarray(ti.f32, 5, needs_grad=True) for _ in range(2))
    loss = ti.ndarray(ti.f32, (), needs_grad=True)
    x.fill(3)
    y.fill(4)

    @ti.kernel
    def product(
        x: ti.types.ndarray(needs_grad=False), y: ti.types.ndarray(), loss: ti.types.ndarray()
    ):
        for i in x:
            loss[None] += x[i] * y[i]

    plain = ti.ndarray(ti.f32, 5)
    for array, slope in ((plain, 0), (x, 3), (np.full(5, 2, np.float32), 2), (plain, 0), (x, 3)):
        product(array, y, loss)
        with ti.ad.Tape(loss):
            product(array, y, loss)
        assert np.all(y.grad.to_numpy() == slope)
        assert not x.grad.to_numpy().any()

    @ti.kernel
    def overwrite(x: ti.types.ndarray(needs_grad=False)):
        for i in x:
            x[i] = 1

    overwrite(x)
    with pytest.raises(ti.TaiAutodiffError, match="writes array 'x', whose annotation"):
        with ti.ad.Tape(loss):
            overwrite(x)


def test_gradients_of_arrays_are_read_in_kernels():
    x = ti.ndarray(ti.f32, 5, needs_grad=True)
    loss = ti.ndarray(ti.f32, (), needs_grad=True)
    x.fill(3)

    @ti.kernel
    def energy(x: ti.types.ndarray(), loss: ti.types.ndarray()):
        for i in x:
            loss[None] += x[i] ** 2

    @ti.kernel
    def descend(x: ti.types.ndarray()):
        for i in x:
            x[i] -= 0.25 * x.grad[i]

    with ti.ad.Tape(loss):
        energy(x, loss)
    descend(x)
    assert np.all(x.to_numpy() == 1.5)


def test_structs_of_numpy_numbers():
    Body = ti.types.struct(pos=Vec, mass=ti.f32, count=ti.i32)

    @ti.kernel
    def total(body: Body) -> ti.f32:
        return body.pos.sum() * body.mass + body.count

    assert total(Body(pos=np.ones(3), mass=np.float64(2), count=np.int64(3))) == 9
    body = Body(pos=np.array([1, 2, 3], np.int8), mass=np.array(2.0), count=np.array(3))
    assert total(body) == 15
    body.mass, body.pos = np.float32(3), np.array([1.0, 1.0, 1.0])
    assert total(body) == 12
    assert total({"pos": np.ones(3), "mass": np.float32(2), "count": np.uint8(3)}) == 9
    with pytest.raises(ti.TaiTypeError, match="takes 3 numbers"):
        Body(pos=np.ones(4))


def test_packs_of_arguments():
    Numbers = ti.types.argpack(a=ti.f32, v=Vec, n=ti.i32)

    @ti.kernel
    def total(pack: Numbers) -> ti.f32:
        return pack.a + pack.v.sum() + pack.n

    pack = Numbers(a=1.5, v=[1, 2, 3], n=4)
    assert total(pack) == 11.5
    pack.a = 2.5
    assert total(pack) == 12.5

    Data = ti.types.argpack(x=ti.types.ndarray(), s=ti.f32, w=ti.types.ndarray(ti.f32, ndim=1))

    @ti.kernel
    def weigh(d: Data, loss: ti.types.ndarray()):
        for i in d.x:
            loss[None] += d.s * d.x[i] ** 2 * d.w[i]

    x = ti.ndarray(ti.f32, 5, needs_grad=True)
    loss = ti.ndarray(ti.f32, (), needs_grad=True)
    x.fill(3)
    with ti.ad.Tape(loss):
        weigh(Data(x=x, s=2, w=np.arange(5, dtype=np.float32)), loss)
    assert x.grad.to_numpy().tolist() == [0, 12, 24, 36, 48]
    with pytest.raises(ti.TaiTypeError, match="needs an array for its member 'w'"):
        Data(x=x, s=1)


PROGRAM = """
import tai as ti
ti.init(offline_cache=False)
@ti.func
def inner(a):
    return a + 1
@ti.kernel
def kernel(a: ti.i32) -> ti.i32:
    return inner(a) * 2
print(kernel(3))
"""


def test_programs_that_python_reads_by_itself(tmp_path):
    answer = run([sys.executable, "-c", PROGRAM], stdout=PIPE, text=True, check=True)
    assert answer.stdout == "8\n"
    file = tmp_path / "program.py"
    file.write_text(PROGRAM)
    with file.open() as stream:
        answer = run([sys.executable], stdin=stream, stdout=PIPE, text=True, check=True)
    assert answer.stdout == "8\n"
    answer = run([sys.executable, "-"], input=PROGRAM, capture_output=True, text=True)
    assert "save it in a file" in answer.stderr


def test_functions_typed_at_the_prompt():
    """Readline keeps the lines that were typed at Python's own prompt."""
    pty = pytest.importorskip("pty")
    os = pytest.importorskip("os")
    child, terminal = pty.fork()
    if child == 0:
        os.environ["TERM"] = "dumb"
        os.environ["PYTHON_BASIC_REPL"] = "1"
        os.execv(sys.executable, [sys.executable, "-q"])
    typed = textwrap.dedent("""
        import tai as ti
        ti.init(offline_cache=False)
        @ti.kernel
        def kernel(a: ti.i32) -> ti.i32:
            return a * 2

        print("first", kernel(4))
        @ti.kernel
        def kernel(a: ti.i32) -> ti.i32:
            return a * 3

        print("second", kernel(4))
        exit()
    """).lstrip()
    shown = b""
    for line in typed.splitlines(keepends=True):
        while not shown.rstrip(b" ").endswith((b">>>", b"...")):
            shown += os.read(terminal, 4096)
        shown = shown.rstrip(b" ") + b"\n"
        os.write(terminal, line.encode())
    try:
        while more := os.read(terminal, 4096):
            shown += more
    except OSError:  # the other side is closed
        pass
    os.waitpid(child, 0)
    assert b"first 8" in shown and b"second 12" in shown


# The same forms for several types and shapes, each against its formula.
FLOATS = pytest.mark.parametrize("dtype", [ti.f32, ti.f64], ids=str)
SHAPES = pytest.mark.parametrize("shape", [(1,), (7,), (3, 5), (2, 3, 4)], ids=str)
NUMPY = {ti.f32: np.float32, ti.f64: np.float64}


def values(shape, dtype=ti.f64):
    count = int(np.prod(shape))
    return np.linspace(0.5, 2.0, count).reshape(shape).astype(NUMPY[dtype])


@FLOATS
@SHAPES
def test_fields_of_structs(dtype, shape):
    Body = ti.types.struct(pos=ti.types.vector(2, dtype), mass=dtype, kind=ti.i16)
    bodies = ti.field(Body, shape=shape, needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)
    bodies.mass.from_numpy(values(shape, dtype))
    bodies.pos.fill(0.5)
    bodies.kind.fill(3)

    @ti.kernel
    def energy():
        for I in ti.grouped(bodies):
            body = bodies[I]
            loss[None] += body.kind * body.mass**2 * body.pos[1]

    with ti.ad.Tape(loss):
        energy()
    mass = values(shape, dtype)
    assert np.allclose(bodies.mass.grad.to_numpy(), 3 * mass, rtol=1e-6)
    slopes = bodies.pos.grad.to_numpy()
    assert np.allclose(slopes[..., 1], 3 * mass**2, rtol=1e-6) and not slopes[..., 0].any()


@FLOATS
@SHAPES
def test_packs_of_arrays_and_numbers(dtype, shape):
    Pack = ti.types.argpack(
        x=ti.types.ndarray(dtype, ndim=len(shape)), scale=dtype, rest=ti.types.vector(3, dtype),
        count=ti.i64,
    )  # fmt: skip

    @ti.kernel
    def weigh(pack: Pack, loss: ti.types.ndarray(dtype, ndim=0)):
        for I in ti.grouped(pack.x):
            loss[None] += pack.scale * pack.x[I] ** 2 + pack.rest[2] * pack.x[I] * pack.count

    x = ti.ndarray(dtype, shape, needs_grad=True)
    loss = ti.ndarray(dtype, (), needs_grad=True)
    x.from_numpy(values(shape, dtype))
    pack = Pack(x=x, scale=2, rest=[1, 2, 3], count=4)
    for scale in (2, 0.5):
        pack.scale = scale
        with ti.ad.Tape(loss):
            weigh(pack, loss)
        assert np.allclose(x.grad.to_numpy(), 2 * scale * values(shape, dtype) + 12, rtol=1e-6)


@FLOATS
@SHAPES
def test_gradients_that_kernels_read(dtype, shape):
    x = ti.ndarray(dtype, shape, needs_grad=True)
    loss = ti.ndarray(dtype, (1,), needs_grad=True)
    x.from_numpy(values(shape, dtype))

    @ti.kernel
    def energy(x: ti.types.ndarray(), loss: ti.types.ndarray()):
        for I in ti.grouped(x):
            loss[0] += x[I] ** 3

    @ti.kernel
    def descend(x: ti.types.ndarray(), rate: dtype):
        for I in ti.grouped(x):
            x[I] -= rate * x.grad[I]

    with ti.ad.Tape(loss):
        energy(x, loss)
    descend(x, 0.125)
    wanted = values(shape) - 0.375 * values(shape) ** 2
    assert np.allclose(x.to_numpy(), wanted, rtol=1e-5)


@FLOATS
@SHAPES
def test_arrays_that_are_constants(dtype, shape):
    x, y = (ti.ndarray(dtype, shape, needs_grad=True) for _ in range(2))
    loss = ti.ndarray(dtype, (), needs_grad=True)
    x.from_numpy(values(shape, dtype))
    y.fill(2)

    @ti.kernel
    def product(
        x: ti.types.ndarray(needs_grad=False), y: ti.types.ndarray(), loss: ti.types.ndarray()
    ):
        for I in ti.grouped(x):
            loss[None] += x[I] * y[I] ** 2

    with ti.ad.Tape(loss):
        product(x, y, loss)
    assert np.allclose(y.grad.to_numpy(), 4 * values(shape), rtol=1e-6)
    assert not x.grad.to_numpy().any()


@FLOATS
@pytest.mark.parametrize("shape", [(1,), (1, 1), ()], ids=str)
def test_forward_seeds_of_one_number(dtype, shape):
    x = ti.field(dtype, shape, needs_dual=True)
    loss = ti.field(dtype, shape, needs_dual=True)
    x.fill(3)

    @ti.kernel
    def cube():
        for I in ti.grouped(x):
            loss[I] += x[I] ** 3

    for seed, slope in ((None, 27), ([2.0], 54)):
        with ti.ad.FwdMode(loss=loss, param=x, seed=seed):
            cube()
        assert loss.dual.to_numpy().item() == slope


@FLOATS
@SHAPES
def test_blocks_that_no_gradient_passes(dtype, shape):
    x = ti.field(dtype, shape, needs_grad=True)
    loss = ti.field(dtype, (), needs_grad=True)
    x.from_numpy(values(shape, dtype))

    @ti.kernel
    def add(power: ti.template()):
        for I in ti.grouped(x):
            loss[None] += x[I] ** power

    with ti.ad.Tape(loss):
        add(2)
        with ti.ad.no_grad():
            add(3)
    assert np.allclose(x.grad.to_numpy(), 2 * values(shape), rtol=1e-6)
    powers = values(shape) ** 2 + values(shape) ** 3
    assert loss[None] == pytest.approx(powers.sum(), rel=1e-5)


KINDS = [np.int8, np.uint16, np.int64, np.float16, np.float32, np.float64]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_structs_of_numpy_numbers_of_each_type(kind):
    Body = ti.types.struct(pos=ti.types.vector(3, ti.f64), mass=ti.f32, count=ti.i64)

    @ti.kernel
    def total(body: Body) -> ti.f64:
        return body.pos.sum() * body.mass + body.count

    body = Body(pos=np.array([1, 2, 4], kind), mass=kind(2), count=np.int16(5))
    assert total(body) == 19
    body.pos, body.mass = np.array([1, 1, 1], kind), kind(3)
    assert total(body) == 14
    assert total({"pos": np.ones(3, kind), "mass": kind(1), "count": np.uint8(1)}) == 4


@pytest.mark.filterwarnings("ignore:.*drops its fraction")
@pytest.mark.parametrize("dtype", [ti.i8, ti.u16, ti.i32, ti.i64, ti.f32, ti.f64], ids=str)
def test_tuples_of_functions_convert(dtype):
    @ti.func
    def both(a) -> tuple[dtype, ti.types.vector(2, dtype)]:
        return a * 2 + 0.5, ti.Vector([a, a + 1])

    @ti.real_func
    def real(a: dtype) -> tuple[dtype, ti.f64]:
        if a > 3:
            return a - 1, 0.25
        return a + 1, 0.75

    @ti.kernel
    def run(a: dtype) -> ti.types.vector(5, ti.f64):
        x, v = both(a)
        y, z = real(a)
        return ti.Vector([x, v[0], v[1], y, z], ti.f64)

    half = 0.5 if dtype in (ti.f32, ti.f64) else 0
    assert list(run(3)) == [6 + half, 3, 4, 4, 0.75]
    assert list(run(5)) == [10 + half, 5, 6, 4, 0.25]


@pytest.mark.parametrize("dtype", [ti.u8, ti.i16, ti.i32, ti.i64, ti.u64], ids=str)
def test_statements_of_python_on_whole_numbers(dtype):
    @ti.kernel
    def run(n: dtype) -> ti.i64:
        total = ti.i64(0)
        for _ in range(1):
            k = dtype(0)
            while (left := n - k) > 0:
                match left:
                    case 1 | 2:
                        total += 100
                    case 5:
                        total += 1000
                    case m if m > 6:
                        total += 10000
                    case _:
                        total += 1
                k += dtype(1)
            else:
                total += 7
            for i in range(n):
                if i == 4:
                    break
            else:
                total -= 7
        return total

    assert run(3) == 201
    assert run(8) == 100 * 2 + 1000 + 20000 + 3 + 7


@FLOATS
@pytest.mark.parametrize("levels", [1, 2, 3])
def test_classes_of_data_that_derive(dtype, levels):
    @ti.dataclass
    class Body:
        mass: dtype
        speed: ti.types.vector(2, dtype)

        @ti.func
        def energy(self):
            return 0.5 * self.mass * self.speed.norm_sqr()

    @ti.dataclass
    class Charged(Body):
        charge: dtype

    @ti.dataclass
    class Counted(Charged):
        count: ti.i32

    @ti.dataclass
    class Spinning(Counted):
        spin: ti.types.matrix(2, 2, dtype)

    made = (Charged, Counted, Spinning)[levels - 1]
    assert list(made.members) == ["mass", "speed", "charge", "count", "spin"][: 2 + levels]
    bodies = made.field(shape=(2, 3), needs_grad=True)
    loss = ti.field(dtype, shape=(), needs_grad=True)
    bodies.mass.fill(2)
    bodies.speed.fill(3)

    @ti.kernel
    def run():
        for i, j in bodies:
            loss[None] += bodies[i, j].energy() + bodies[i, j].charge

    with ti.ad.Tape(loss):
        run()
    assert loss[None] == 6 * 18
    assert np.all(bodies.mass.grad.to_numpy() == 9)
    assert np.all(bodies.speed.grad.to_numpy() == 6)
    assert np.all(bodies.charge.grad.to_numpy() == 1)
