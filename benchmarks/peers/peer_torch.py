"""The peer torch: eager operations, reverse mode by autograd.

On a GPU, *replay* is forward and backward captured in one CUDA graph.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import harness


class TorchProgram(harness.Program):
    """Loss of a list of leaf tensors."""

    def __init__(self, loss, leaves):
        self.function = loss
        self.leaves = leaves
        self.last = None
        self.graph = None

    def run(self) -> tuple[float, float]:
        for leaf in self.leaves:
            leaf.grad = None
        start = harness.clock()
        self.last = self.function(*self.leaves)
        self.sync()
        middle = harness.clock()
        self.last.backward()
        self.sync()
        end = harness.clock()
        return middle - start, end - middle

    def replay(self) -> float | None:
        start = harness.clock()
        if not self.queue():
            return None
        self.sync()
        return harness.clock() - start

    def queue(self) -> bool:
        import torch

        if self.leaves[0].device.type != "cuda":
            return False
        if self.graph is None:
            self.capture(torch)
        self.graph.replay()
        return True

    def capture(self, torch) -> None:
        """Records a run as a graph; the gradients are where the captured run puts them."""
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(2):
                torch.autograd.grad(self.function(*self.leaves), self.leaves)
        torch.cuda.current_stream().wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):
            self.last = self.function(*self.leaves)
            gradients = torch.autograd.grad(self.last, self.leaves)
        for leaf, gradient in zip(self.leaves, gradients, strict=True):
            leaf.grad = gradient
        self.graph = graph

    def sync(self) -> None:
        import torch

        if self.leaves[0].device.type == "cuda":
            torch.cuda.synchronize()

    def inputs(self) -> np.ndarray:
        return np.concatenate([leaf.detach().cpu().numpy().ravel() for leaf in self.leaves])

    def assign(self, flat: np.ndarray) -> None:
        import torch

        with torch.no_grad():
            for leaf in self.leaves:
                leaf.copy_(tensor(flat[: leaf.numel()].reshape(leaf.shape)))
                flat = flat[leaf.numel() :]

    def loss(self) -> float:
        return float(self.last.detach())

    def gradient(self) -> np.ndarray:
        return np.concatenate([leaf.grad.cpu().numpy().ravel() for leaf in self.leaves])


def tensor(array, leaf: bool = False):
    """A tensor of an array, of indices or of the default type of floats."""
    import torch

    array = np.asarray(array)
    dtype = None if array.dtype.kind == "i" else torch.get_default_dtype()
    made = torch.tensor(array, dtype=dtype)
    return made.requires_grad_(leaf)


def make_smoke(problem) -> harness.Program:
    import torch

    n, slots, sweeps = problem.n, problem.slots, problem.sweeps
    dx = 1.0 / n
    density0, target = tensor(problem.density), tensor(problem.target)
    row = torch.arange(float(n))[:, None]
    column = torch.arange(float(n))

    def sampler(w0, w1):
        x, y = row - w0, column - w1
        left, low = torch.floor(x.detach()), torch.floor(y.detach())
        fx, fy = x - left, y - low
        ax, ay = left.to(torch.int64) % n, low.to(torch.int64) % n
        bx, by = (ax + 1) % n, (ay + 1) % n

        def sample(f):
            nearer = (1.0 - fy) * f[ax, ay] + fy * f[ax, by]
            farther = (1.0 - fy) * f[bx, ay] + fy * f[bx, by]
            return (1.0 - fx) * nearer + fx * farther

        return sample

    def difference(p, axis):
        return torch.roll(p, -1, axis) - torch.roll(p, 1, axis)

    def loss(velocity):
        v0, v1 = velocity[..., 0], velocity[..., 1]
        density = density0
        pressure = projected = torch.zeros(n, n)
        for _ in range(slots - 1):
            sample = sampler(v0, v1)
            star0, star1 = sample(v0), sample(v1)
            source = -0.5 * dx * (difference(star0, 0) + difference(star1, 1))
            v0 = star0 - 0.5 / dx * difference(projected, 0)
            v1 = star1 - 0.5 / dx * difference(projected, 1)
            for _ in range(sweeps):
                projected = pressure
                around = torch.roll(pressure, 1, 0) + torch.roll(pressure, -1, 0)
                around = around + torch.roll(pressure, 1, 1) + torch.roll(pressure, -1, 1)
                pressure = (source + around) * 0.25
            density = sampler(v0, v1)(density)
        return ((target - density) ** 2).mean()

    return TorchProgram(loss, [tensor(problem.velocity, leaf=True)])


def make_wave(problem) -> harness.Program:
    import torch

    n, slots = problem.n, problem.slots
    target = tensor(problem.target)

    def loss(u0):
        before, now = u0, torch.zeros(n, n)
        for _ in range(2, slots):
            framed = torch.nn.functional.pad(now, (1, 1, 1, 1))
            around = framed[:-2, 1:-1] + framed[2:, 1:-1] + framed[1:-1, :-2] + framed[1:-1, 2:]
            before, now = now, 2.0 * now + (around - 4.0 * now) / 3.0 - before
        return ((target - now) ** 2).mean()

    return TorchProgram(loss, [tensor(problem.height, leaf=True)])


def make_mpm(problem) -> harness.Program:
    import torch

    material, slots = problem.material, problem.slots
    n, dt, dx = material.n, material.dt, material.dx
    x0, goal = tensor(problem.position), tensor(problem.target)
    count = len(problem.position)
    offsets = torch.tensor([(i, j) for i in range(3) for j in range(3)])
    index = torch.arange(n)
    low, high = index < 3, index > n - 3
    identity = torch.eye(2)

    def loss(v):
        x = x0
        c = torch.zeros(count, 2, 2)
        f = identity.expand(count, 2, 2)
        for _ in range(slots - 1):
            base = (x.detach() / dx - 0.5).to(torch.int64)
            fx = x / dx - base
            w = torch.stack([0.5 * (1.5 - fx) ** 2, 0.75 - (fx - 1.0) ** 2, 0.5 * (fx - 0.5) ** 2])
            weight = w[offsets[:, 0], :, 0] * w[offsets[:, 1], :, 1]
            f = (identity + dt * c) @ f
            even, odd = f[:, 0, 0] + f[:, 1, 1], f[:, 1, 0] - f[:, 0, 1]
            scale = torch.rsqrt(even * even + odd * odd)
            cosine, sine = even * scale, odd * scale
            rotation = torch.stack(
                [torch.stack([cosine, -sine], -1), torch.stack([sine, cosine], -1)], 1
            )
            determinant = f[:, 0, 0] * f[:, 1, 1] - f[:, 0, 1] * f[:, 1, 0]
            pressure = material.lam * (determinant - 1.0) * determinant
            cauchy = 2.0 * material.mu * (f - rotation) @ f.transpose(1, 2)
            cauchy = cauchy + pressure[:, None, None] * identity
            affine = -dt * material.volume * 4.0 / dx**2 * cauchy + material.mass * c
            offset = offsets[:, None, :] - fx
            carried = material.mass * v + torch.einsum("pij,kpj->kpi", affine, offset * dx)
            node = base + offsets[:, None, :]
            flat = (node[..., 0] * n + node[..., 1]).reshape(-1)
            momentum = torch.zeros(n * n, 2).index_add(
                0, flat, (weight[..., None] * carried).reshape(-1, 2)
            )
            mass = torch.zeros(n * n).index_add(0, flat, (weight * material.mass).reshape(-1))
            grid = momentum / (mass[:, None] + 1e-10)
            gx = grid[:, 0].reshape(n, n)
            gy = grid[:, 1].reshape(n, n) - dt * material.gravity
            gx = gx.masked_fill((low[:, None] & (gx < 0)) | (high[:, None] & (gx > 0)), 0.0)
            gy = gy.masked_fill((low[None, :] & (gy < 0)) | (high[None, :] & (gy > 0)), 0.0)
            grid = torch.stack([gx.reshape(-1), gy.reshape(-1)], -1)
            picked = weight[..., None] * grid[flat].reshape(9, count, 2)
            v = picked.sum(dim=0)
            c = 4.0 / dx * torch.einsum("kpi,kpj->pij", picked, offset)
            x = x + dt * v
        return 0.5 * ((x - goal) ** 2).sum(dim=1).mean()

    return TorchProgram(loss, [tensor(problem.velocity, leaf=True)])


def make_mass_spring(problem) -> harness.Program:
    import torch

    body, walk = problem.body, problem.walk
    dt, ground = walk.dt, walk.ground
    x0 = tensor(body.points)
    first, second = tensor(body.springs[:, 0]), tensor(body.springs[:, 1])
    rest, stiffness = tensor(body.rest), tensor(body.stiffness)
    amount, goal = tensor(body.actuation), tensor(walk.goal)
    phases = tensor(2.0 * np.pi / 10.0 * np.arange(10))
    pull = tensor([0.0, dt * walk.gravity])
    damp = float(np.exp(-walk.damping * dt))

    def loss(w1, b1, w2, b2):
        x, v = x0, torch.zeros_like(x0)
        for t in range(walk.slots - 1):
            centre = x.mean(dim=0)
            seen = torch.cat([0.05 * (x - centre), 0.05 * v], dim=1).reshape(-1)
            inputs = torch.cat([torch.sin(10.0 * t * dt + phases), seen, goal - centre])
            output = torch.tanh(w2 @ torch.tanh(w1 @ inputs + b1) + b2)
            d = x[first] - x[second]
            length = torch.sqrt((d * d).sum(dim=1)) + 1e-4
            wanted = rest * (1.0 + amount * output)
            impulse = (dt * stiffness * (length - wanted) / length)[:, None] * d
            free = (damp * v + pull).index_add(0, first, -impulse).index_add(0, second, impulse)
            hit = (x[:, 1] + dt * free[:, 1] < ground) & (free[:, 1] < -1e-4)
            down = torch.where(hit, free[:, 1], 1.0)
            toi = torch.where(hit, -(x[:, 1] - ground) / down, 0.0)[:, None]
            v = free.masked_fill(hit[:, None], 0.0)
            x = x + toi * free + (dt - toi) * v
        return -x[0, 0]

    weights = [tensor(problem.weights[name], leaf=True) for name in ("w1", "b1", "w2", "b2")]
    return TorchProgram(loss, weights)


def make_first_kernel(problem) -> harness.Program:
    return TorchProgram(lambda x: (x * x).sum(), [tensor(problem.x, leaf=True)])


def make_launch():
    import torch

    value = torch.zeros(())
    on_gpu = value.device.type == "cuda"
    return lambda: value.add_(1.0), torch.cuda.synchronize if on_gpu else lambda: None


def load(_cache: Path, arch: str):
    import torch

    if arch == "cuda" and not torch.cuda.is_available():
        raise ImportError("torch sees no GPU")
    torch.set_default_device(arch)

    scenes = {
        "smoke": make_smoke,
        "wave": make_wave,
        "diffmpm": make_mpm,
        "mass_spring": make_mass_spring,
        "first_kernel": make_first_kernel,
    }
    return torch.__version__, scenes, make_launch


if __name__ == "__main__":
    sys.exit(harness.main("torch", load))
