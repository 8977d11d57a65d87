"""A step of a torch training loop whose model is one kernel: tai, Warp, and torch alone.

    python benchmarks/micro/torch_training.py [--device cuda] [--sizes 64 65536] [--calls 1 10]

A step clears the gradients, calls the kernel as an operator once or more in a row, takes the mean
square of the difference from a target, runs backward, and lets SGD update the stiffness of all
springs. All systems train the same model; their losses after the last step must agree. They take
turns in one process, and the table shows the fastest and the middle of the rounds. The last column
is a loop whose operator is an empty `torch.autograd.Function`: the cost of torch itself. Needs
torch; Warp (warp-lang) is left out where it is not installed.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from typing import Any

import tai as ti
import torch

DT = 0.01


@ti.kernel
def pull(
    x: ti.types.ndarray(dtype=ti.f32, ndim=1),
    k: ti.types.ndarray(dtype=ti.f32, ndim=1),
    y: ti.types.ndarray(dtype=ti.f32, ndim=1),
):
    for i in range(x.shape[0]):
        y[i] = x[i] - DT * k[i] * ti.sin(x[i])


def of_tai() -> Callable:
    return ti.torch.wrap(pull, outputs={"y": "x"})


def of_torch() -> Callable:
    return lambda x, k: x - DT * k * torch.sin(x)


def of_nothing() -> Callable:
    """A function without any work: the cost of torch itself."""

    class Nothing(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, x: Any, k: Any) -> Any:
            return x.new_empty(x.shape)

        @staticmethod
        def backward(ctx: Any, g: Any) -> Any:
            return g, g

    return Nothing.apply


def of_warp() -> Callable:
    import warp as wp

    wp.config.quiet = True
    wp.init()

    @wp.kernel
    def pull_of_warp(
        x: wp.array(dtype=wp.float32),  # type: ignore[valid-type]
        k: wp.array(dtype=wp.float32),  # type: ignore[valid-type]
        y: wp.array(dtype=wp.float32),  # type: ignore[valid-type]
    ):
        i = wp.tid()
        y[i] = x[i] - wp.float32(0.01) * k[i] * wp.sin(x[i])

    class Pull(torch.autograd.Function):
        @staticmethod
        def forward(ctx: Any, x: Any, k: Any) -> Any:
            y = torch.empty_like(x)
            ctx.arrays = [wp.from_torch(t.detach(), requires_grad=False) for t in (x, k, y)]
            launch(pull_of_warp, x, ctx.arrays[:2], ctx.arrays[2:])
            return y

        @staticmethod
        def backward(ctx: Any, g: Any) -> Any:
            found = torch.zeros_like(g), torch.zeros_like(g)
            adjoints = [wp.from_torch(t, requires_grad=False) for t in found]
            launch(
                pull_of_warp, g, ctx.arrays[:2], ctx.arrays[2:], adjoint=True, adj_inputs=adjoints,
                adj_outputs=[wp.from_torch(g.contiguous(), requires_grad=False)],
            )  # fmt: skip
            return found

    def launch(kernel: Any, like: Any, inputs: list, outputs: list, **adjoint: Any) -> None:
        device = wp.device_from_torch(like.device)
        wp.launch(kernel, like.shape[0], inputs, outputs, device=device, **adjoint)

    return Pull.apply


SYSTEMS = {"tai": of_tai, "warp": of_warp, "torch": of_torch, "empty": of_nothing}


class Loop:
    """A model of one system, and its training."""

    def __init__(self, operator: Callable, size: int, calls: int, device: str):
        self.operator, self.calls, self.device = operator, calls, device
        self.x = torch.linspace(0.1, 3.0, size, device=device)
        self.target = 0.5 * self.x
        self.k = torch.ones(size, device=device, requires_grad=True)
        self.optimiser = torch.optim.SGD([self.k], lr=0.1)
        self.loss = torch.zeros(())

    def step(self) -> None:
        self.optimiser.zero_grad()
        y = self.x
        for _ in range(self.calls):
            y = self.operator(y, self.k)
        self.loss = ((y - self.target) ** 2).mean()
        self.loss.backward()
        self.optimiser.step()

    def time(self, steps: int) -> float:
        """Microseconds of a step."""
        if self.device == "cuda":
            torch.cuda.synchronize()
        begin = time.perf_counter()
        for _ in range(steps):
            self.step()
        if self.device == "cuda":
            torch.cuda.synchronize()
        return (time.perf_counter() - begin) / steps * 1e6


def operators(device: str) -> dict[str, Callable]:
    found = {}
    for name, make in SYSTEMS.items():
        try:
            found[name] = make()
        except ImportError as error:
            print(f"torch_training: no {name}: {error}")
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--sizes", type=int, nargs="+", default=[64, 65_536])
    parser.add_argument("--calls", type=int, nargs="+", default=[1, 10])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--steps", type=int, default=100, help="of a round")
    args = parser.parse_args()
    ti.init(arch=ti.cuda if args.device == "cuda" else ti.cpu)
    torch.set_num_threads(1)
    known = operators(args.device)
    print(f"microseconds of a step on {args.device}, fastest / median of {args.rounds} rounds")
    print(f"{'size':>8} {'calls':>5} " + " ".join(f"{name:>19}" for name in known))
    for size in args.sizes:
        for calls in args.calls:
            loops = {name: Loop(f, size, calls, args.device) for name, f in known.items()}
            times: dict[str, list[float]] = {name: [] for name in known}
            for _ in range(args.rounds + 1):  # the first one compiles
                for name, loop in loops.items():
                    times[name].append(loop.time(args.steps))
            losses = {name: loop.loss.item() for name, loop in loops.items() if name != "empty"}
            if max(losses.values()) - min(losses.values()) > 1e-4 * max(losses.values()):
                raise SystemExit(f"torch_training: the models differ: {losses}")
            cells = (
                f"{min(times[name][1:]):9.1f} /{statistics.median(times[name][1:]):8.1f}"
                for name in known
            )
            print(f"{size:>8} {calls:>5} " + " ".join(f"{cell:>19}" for cell in cells), flush=True)


if __name__ == "__main__":
    main()
