"""Parallel loops whose iterations share memory: modes, data, and how such a loop is refused."""

import numpy as np
import pytest
import tai as ti

# Above every threshold below which a loop runs on one thread.
N = 200_000
GROUPS = 37
MODES = {
    "default": {},
    "deterministic": {"deterministic": True},
    "strict": {"strict": True},
    "device": {"arch": ti.cuda},
}


def init(name: str, monkeypatch) -> None:
    """Begins a context of two threads in one of the modes."""
    options = {"arch": ti.cpu, "cpu_max_num_threads": 2, **MODES[name]}
    if name == "device":
        monkeypatch.setenv("TAI_CUDA_EMULATION", "1")
    try:
        ti.init(offline_cache=False, **options)
    finally:
        monkeypatch.undo()


class Data:
    """Numbers, whole numbers, and a group for each."""

    def __init__(self):
        rng = np.random.default_rng(7)
        self.numbers = rng.standard_normal(N).astype(np.float32)
        self.whole = rng.integers(-1000, 1000, N).astype(np.int32)
        self.groups = rng.integers(0, GROUPS, N).astype(np.int32)
        self.x, self.n, self.g = ti.field(ti.f32, N), ti.field(ti.i32, N), ti.field(ti.i32, N)
        self.x.from_numpy(self.numbers)
        self.n.from_numpy(self.whole)
        self.g.from_numpy(self.groups)

    def by_group(self, ufunc, initial, values, dtype=np.float64):
        result = np.full(GROUPS, initial, dtype)
        ufunc.at(result, self.groups, values.astype(dtype))
        return result


@pytest.fixture(params=MODES)
def mode(request, monkeypatch):
    """The name of the mode of a context."""
    init(request.param, monkeypatch)
    return request.param


@pytest.fixture
def data(mode):
    """Fields of a context in each of the modes."""
    return Data()


def same(run, expected, tolerance=0.0):
    for _ in range(3):
        np.testing.assert_allclose(run(), expected, rtol=tolerance, atol=tolerance)


def refused(kernel, line, *names, remedy="min, max"):
    with pytest.raises(ti.TaiTypeError) as info:
        kernel()
    message = str(info.value)
    assert line in message.partition("note:")[0]
    assert "depend on which of them comes first" in message
    assert "ti.loop_config(serialize=True)" in message
    assert remedy in message
    for name in names:
        assert f"'{name}'" in message
