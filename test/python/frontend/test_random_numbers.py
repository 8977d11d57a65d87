"""Random numbers are a function of their position: Philox 4x32-10, written once more in NumPy."""

import numpy as np
import pytest
import tai as ti

SEED = 0x123456789ABCDEF
SIZE = 1000
MASK = np.uint64(0xFFFFFFFF)


def philox(launch, iteration, stream, sequence):
    """32 bits for each element of `iteration` and `sequence`, as in tai/Support/Philox.h."""
    key = (SEED + 0x9E3779B97F4A7C15) % 2**64
    key = (key ^ key >> 30) * 0xBF58476D1CE4E5B9 % 2**64
    key = (key ^ key >> 27) * 0x94D049BB133111EB % 2**64
    key ^= key >> 31 ^ launch
    keys = [key % 2**32, key >> 32]
    iteration, sequence = np.broadcast_arrays(
        np.asarray(iteration, np.uint64), np.asarray(sequence, np.uint64)
    )
    counter = [
        iteration & MASK, iteration >> np.uint64(32),
        np.full(iteration.shape, stream, np.uint64), sequence >> np.uint64(2),
    ]  # fmt: skip
    for _ in range(10):
        a = counter[0] * np.uint64(0xD2511F53)
        b = counter[2] * np.uint64(0xCD9E8D57)
        counter = [
            (b >> np.uint64(32)) ^ counter[1] ^ np.uint64(keys[0]), b & MASK,
            (a >> np.uint64(32)) ^ counter[3] ^ np.uint64(keys[1]), a & MASK,
        ]  # fmt: skip
        keys = [(keys[0] + 0x9E3779B9) % 2**32, (keys[1] + 0xBB67AE85) % 2**32]
    return np.choose((sequence & np.uint64(3)).astype(int), counter)


def two(launch, iteration, stream, draw):
    """64 bits: the first number is the upper half."""
    high, low = (philox(launch, iteration, stream, 2 * np.asarray(draw) + k) for k in (0, 1))
    return high << np.uint64(32) | low


def as_type(dt, launch, iteration, stream, draw):
    """The number of the given draw, counted from 0, in the type."""
    if dt in (ti.f64, ti.i64, ti.u64):
        bits = two(launch, iteration, stream, draw)
    else:
        bits = philox(launch, iteration, stream, draw)
    if dt == ti.f64:
        return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53
    if dt == ti.f32:
        return (bits >> np.uint64(8)).astype(np.float32) * np.float32(2.0**-24)
    if dt == ti.f16:
        return (bits >> np.uint64(21)).astype(np.float16) * np.float16(2.0**-11)
    return bits.astype(dt.numpy)


def position(numbers, dt):
    """The launch and the place in the program of the first number, which nothing else tells."""
    for launch in range(64):
        for stream in range(16):
            if as_type(dt, launch, 0, stream, 0) == numbers.flat[0]:
                return launch, stream
    raise AssertionError(f"{numbers.flat[0]} is no number of this seed")


TYPES = [ti.f64, ti.f32, ti.f16, ti.i64, ti.u64, ti.i32, ti.u32]


@pytest.fixture(params=[0, 3], ids=["O0", "O3"])
def opt_level(request):
    ti.init(random_seed=SEED, opt_level=request.param)


@pytest.mark.parametrize("dt", TYPES, ids=str)
def test_one_number_for_each_iteration(opt_level, dt):
    x = ti.field(dt, shape=SIZE)

    @ti.kernel
    def draw():
        for i in x:
            x[i] = ti.random(dt)

    for _ in range(2):
        draw()
        numbers = x.to_numpy()
        launch, stream = position(numbers, dt)
        assert np.array_equal(numbers, as_type(dt, launch, np.arange(SIZE), stream, 0))


@pytest.mark.parametrize("dt", TYPES, ids=str)
def test_numbers_of_a_serial_loop(opt_level, dt):
    """Some iterations leave some out."""
    x = ti.field(dt, shape=(SIZE, 9))

    @ti.kernel
    def draw():
        for i in range(SIZE):
            for j in range(9):
                if (i + j) % 7 != 6:
                    x[i, j] = ti.random(dt)

    draw()
    numbers = x.to_numpy()
    launch, stream = position(numbers, dt)
    i, j = np.indices(numbers.shape)
    is_drawn = (i + j) % 7 != 6
    draw_number = np.cumsum(is_drawn, axis=1) - 1
    wanted = as_type(dt, launch, i, stream, np.maximum(draw_number, 0))
    assert np.array_equal(numbers, np.where(is_drawn, wanted, 0))


def test_numbers_of_serial_code(opt_level):
    """Before any loop they are those of iteration 0."""

    @ti.kernel
    def draw() -> ti.types.vector(2, ti.f64):
        return ti.Vector([ti.random(ti.f64), ti.random(ti.f64)])

    numbers = np.array(draw())
    launch, stream = position(numbers, ti.f64)
    assert numbers[1] == as_type(ti.f64, launch, 0, stream + 1, 0)


def test_an_iteration_has_the_number_of_its_place(opt_level):
    """In the whole box, whether or not the others draw."""
    first = ti.field(ti.u32, shape=4)

    @ti.kernel
    def draw(n: ti.i64):
        for i, j in ti.ndrange(4, n):
            if j == n - 1:
                first[i] = ti.random(ti.u32)

    draw(1000)
    numbers = first.to_numpy()
    for launch in range(64):
        for stream in range(16):
            wanted = philox(launch, np.arange(4) * 1000 + 999, stream, 0)
            if np.array_equal(numbers, wanted):
                return
    raise AssertionError("other numbers than those of the positions in the box")
