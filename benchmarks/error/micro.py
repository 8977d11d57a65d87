"""Small kernels in the Taichi API, their data, and their exact results.

The same source runs on tai, taichi and quadrants. All data are representable in f32, so that only
errors of the computation are measured. Annotations must be objects, not strings, for taichi.
"""

import copy
import math

import numpy as np

CELLS = 64
# The type in which results are computed that are not rounded once.
real = np.longdouble


def normal_numbers(n: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(n).astype(np.float32).astype(np.float64)


def uniform_numbers(n: int, seed: int, low: float, high: float) -> np.ndarray:
    numbers = np.random.default_rng(seed).uniform(low, high, n)
    return numbers.astype(np.float32).astype(np.float64)


def ill_numbers(n: int, seed: int, condition: float = 1e6) -> np.ndarray:
    """Numbers whose sum is a part in `condition` of the sum of their magnitudes."""
    x = normal_numbers(n, seed)
    rest = math.fsum(np.abs(x)) / condition - math.fsum(x[:-4])
    for k in range(4, 0, -1):
        x[-k] = np.float32(rest)
        rest -= x[-k]
    np.random.default_rng(seed + 1000).shuffle(x)
    return x


def wide(x: np.ndarray) -> np.ndarray:
    return np.asarray(x, real)


def exact_sums(x: np.ndarray, cell: np.ndarray, count: int) -> np.ndarray:
    """The sum of each cell, rounded once."""
    order = np.argsort(cell, kind="stable")
    bounds = np.searchsorted(cell[order], np.arange(count + 1))
    parts = x[order]
    return np.array([math.fsum(parts[a:b]) for a, b in zip(bounds[:-1], bounds[1:], strict=True)])


class Data:
    """The numbers of a kernel.

    Attributes:
        inputs: by name; the first are the unknowns.
    """

    inputs: dict[str, np.ndarray]

    def at(self, flat: np.ndarray) -> "Data":
        """The same kernel with other unknowns."""
        name = next(iter(self.inputs))
        made = copy.copy(self)
        made.inputs = self.inputs | {name: flat.reshape(self.inputs[name].shape)}
        return made

    def exact(self) -> dict:
        """Loss and gradient, in a form that `expand` makes whole."""
        raise NotImplementedError

    def expand(self, gradient: np.ndarray) -> np.ndarray:
        return gradient


class Sum(Data):
    """The sum of n numbers."""

    def __init__(self, x: np.ndarray):
        self.inputs = {"x": x}

    def exact(self) -> dict:
        return {"loss": math.fsum(self.inputs["x"]), "gradient": np.ones(1)}

    def expand(self, gradient: np.ndarray) -> np.ndarray:
        return np.broadcast_to(gradient, len(self.inputs["x"]))


class Scatter(Data):
    """Numbers added to the cells that an index field names; the loss is the sum of squares."""

    def __init__(self, x: np.ndarray, cell: np.ndarray, cells: int):
        self.inputs, self.cell, self.cells = {"x": x}, cell.astype(np.int32), cells

    def exact(self) -> dict:
        out = wide(exact_sums(self.inputs["x"], self.cell, self.cells))
        scale = real(len(self.cell))
        return {"loss": (out * out).sum() / scale, "gradient": 2 * out / scale}

    def expand(self, gradient: np.ndarray) -> np.ndarray:
        return gradient[self.cell]


class Stencil(Data):
    """Seven points on n³ cells, around the edges; the loss is a weighted sum of squares."""

    def __init__(self, n: int):
        self.n = n
        self.inputs = {
            "u": normal_numbers(n**3, 5).reshape(n, n, n),
            "w": uniform_numbers(n**3, 6, 0.5, 1.5).reshape(n, n, n),
        }

    @staticmethod
    def apply(u: np.ndarray) -> np.ndarray:
        around = sum(np.roll(u, s, axis) for axis in range(3) for s in (1, -1))
        return around - 6 * u

    def exact(self) -> dict:
        u, w = wide(self.inputs["u"]), wide(self.inputs["w"])
        out = self.apply(u)
        return {"loss": (w * out**2).sum(), "gradient": self.apply(2 * w * out).ravel()}


class Map(Data):
    """f of each number; the loss is a weighted sum."""

    FUNCTIONS = {"exp": np.exp, "sin": np.sin, "pow": lambda x: x ** wide(2.75)}
    SLOPES = {"exp": np.exp, "sin": np.cos, "pow": lambda x: wide(2.75) * x ** (wide(2.75) - 1)}
    RANGES = {"exp": (-20.0, 20.0), "sin": (-100.0, 100.0), "pow": (0.1, 10.0)}

    def __init__(self, name: str, n: int):
        self.name = name
        x = uniform_numbers(n, 7, *self.RANGES[name])
        self.inputs = {"x": x, "w": uniform_numbers(n, 8, 0.5, 1.5)}

    def exact(self) -> dict:
        x, w = wide(self.inputs["x"]), wide(self.inputs["w"])
        values = self.FUNCTIONS[self.name](x)
        return {
            "loss": (w * values).sum(), "gradient": w * self.SLOPES[self.name](x), "values": values,
        }  # fmt: skip


class Polar(Data):
    """The rotations of matrices near one; the loss is a weighted sum of their elements."""

    def __init__(self, n: int):
        near = np.eye(3) + 0.1 * normal_numbers(9 * n, 9).reshape(n, 3, 3)
        self.inputs = {
            "F": near.astype(np.float32).astype(np.float64),
            "W": normal_numbers(9 * n, 10).reshape(n, 3, 3),
        }

    def exact(self) -> dict:
        """By Newton's iteration; the adjoint from (tr S · 1 - S) z = the skew part of Rᵀ W."""
        matrices, weights = wide(self.inputs["F"]), wide(self.inputs["W"])
        rotations = matrices
        for _ in range(12):
            rotations = (rotations + _inverse(rotations).swapaxes(1, 2)) / 2
        stretch = rotations.swapaxes(1, 2) @ matrices
        skew = rotations.swapaxes(1, 2) @ weights
        skew = skew - skew.swapaxes(1, 2)
        vector = np.stack([skew[:, 2, 1], skew[:, 0, 2], skew[:, 1, 0]], 1)[..., None]
        trace = np.trace(stretch, axis1=1, axis2=2)[:, None, None]
        z = (_inverse(trace * np.eye(3) - stretch) @ vector)[..., 0]
        cross = np.zeros_like(skew)
        cross[:, 2, 1], cross[:, 0, 2], cross[:, 1, 0] = z.T
        cross -= cross.swapaxes(1, 2)
        gradient = rotations @ cross
        return {"loss": (weights * rotations).sum(), "gradient": gradient.ravel()}


def _inverse(m: np.ndarray) -> np.ndarray:
    """The inverses of 3×3 matrices in their own precision."""
    rows = [np.cross(m[:, (k + 1) % 3], m[:, (k + 2) % 3]) for k in range(3)]
    return np.stack(rows, 2) / (m[:, 0] * rows[0]).sum(1)[:, None, None]


def data_of(name: str, size: str):
    """The data of a kernel."""
    n = {"tiny": 300, "quick": 100_000, "full": 1_000_000}[size]
    if name == "sum":
        return Sum(uniform_numbers(n, 1, 0, 1))
    if name == "sum_ill":
        return Sum(ill_numbers(n, 3))
    if name == "scatter":
        cell = np.random.default_rng(2).integers(0, CELLS * CELLS, n)
        return Scatter(uniform_numbers(n, 1, 0, 1), cell, CELLS * CELLS)
    if name == "one_cell":
        n = {"tiny": 300, "quick": 1_000_000, "full": 10_000_000}[size]
        return Scatter(uniform_numbers(n, 1, 0, 1), np.zeros(n), 1)
    if name == "stencil":
        return Stencil({"tiny": 6, "quick": 40, "full": 128}[size])
    if name == "polar":
        return Polar(n // 10)
    return Map(name, n)


NAMES = ["sum", "sum_ill", "scatter", "one_cell", "stencil", "exp", "sin", "pow", "polar"]


def make(name: str, data):
    """The program of a kernel; to be called when `tai` has started."""
    import tai as ti

    from tai_scenes import TapeProgram, whole

    loss = ti.field(float, shape=(), needs_grad=True)

    def field(array, learned=True):
        array = np.asarray(array)
        found = ti.field(float, shape=array.shape, needs_grad=learned)
        found.from_numpy(array.astype(np.float32))
        return found

    if isinstance(data, Sum):
        x = field(data.inputs["x"])

        @ti.kernel
        def add():
            for i in x:
                loss[None] += x[i]

        return TapeProgram(loss, [(x, whole)], add)

    if isinstance(data, Scatter):
        count, cells = len(data.cell), data.cells
        x = field(data.inputs["x"])
        cell = ti.field(ti.i32, shape=count)
        cell.from_numpy(data.cell)
        out = ti.field(float, shape=cells, needs_grad=True)

        @ti.kernel
        def clear():
            for c in out:
                out[c] = 0.0

        @ti.kernel
        def scatter():
            for i in x:
                out[cell[i]] += x[i]

        @ti.kernel
        def measure():
            for c in out:
                loss[None] += out[c] ** 2 / count

        def forward():
            clear()
            scatter()
            measure()

        return TapeProgram(loss, [(x, whole)], forward)

    if isinstance(data, Stencil):
        n = data.n
        u, w = field(data.inputs["u"]), field(data.inputs["w"], False)
        out = ti.field(float, shape=(n, n, n), needs_grad=True)

        @ti.kernel
        def apply():
            for i, j, k in u:
                around = u[(i + 1) % n, j, k] + u[(i + n - 1) % n, j, k]
                around += u[i, (j + 1) % n, k] + u[i, (j + n - 1) % n, k]
                around += u[i, j, (k + 1) % n] + u[i, j, (k + n - 1) % n]
                out[i, j, k] = around - 6 * u[i, j, k]

        @ti.kernel
        def weigh():
            for i, j, k in u:
                loss[None] += w[i, j, k] * out[i, j, k] ** 2

        def both():
            apply()
            weigh()

        return TapeProgram(loss, [(u, whole)], both)

    if isinstance(data, Map):
        x, w = field(data.inputs["x"]), field(data.inputs["w"], False)
        out = ti.field(float, shape=x.shape, needs_grad=True)
        kind = data.name

        @ti.kernel
        def evaluate():
            for i in x:
                if ti.static(kind == "exp"):
                    out[i] = ti.exp(x[i])
                elif ti.static(kind == "sin"):
                    out[i] = ti.sin(x[i])
                else:
                    out[i] = x[i] ** 2.75

        @ti.kernel
        def total():
            for i in x:
                loss[None] += w[i] * out[i]

        def run():
            evaluate()
            total()

        program = TapeProgram(loss, [(x, whole)], run)
        program.values = lambda: out.to_numpy()
        return program

    n = len(data.inputs["F"])
    matrices = ti.Matrix.field(3, 3, float, shape=n, needs_grad=True)
    weights = ti.Matrix.field(3, 3, float, shape=n)
    matrices.from_numpy(data.inputs["F"].astype(np.float32))
    weights.from_numpy(data.inputs["W"].astype(np.float32))

    @ti.kernel
    def decompose():
        for p in matrices:
            rotation, _ = ti.polar_decompose(matrices[p])
            total = 0.0
            for i in ti.static(range(3)):
                for j in ti.static(range(3)):
                    total += weights[p][i, j] * rotation[i, j]
            loss[None] += total

    return TapeProgram(loss, [(matrices, whole)], decompose)
