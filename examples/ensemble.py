"""Can one controller balance any pole, on as many GPUs as there are?

An ensemble of carts with poles, each of another length, mass and start. A small network pushes
the carts; all share it. Every process simulates its part of the ensemble and differentiates it
with tai; to PyTorch the part is a `torch.autograd.Function`, and `torch.distributed` adds up the
gradients, by NCCL between GPUs and by gloo on CPUs. Between GPU and GPU, nothing goes through the
host: weights, loss and gradients are handed over where they are.

    python examples/ensemble.py
    torchrun --standalone --nproc-per-node 4 examples/ensemble.py --arch cuda

At the end it prints how much more the processes get done together than one of them alone with
the same number of scenes.
"""

import os
import statistics
import time
from typing import Any

import studio

parser = studio.plain(__doc__)
add, least = parser.add_argument, studio.at_least
add("--arch", default="cpu", choices=["cpu", "cuda"], help="what computes (cpu)")
add("--scenes", type=least(1), default=4096, help="scenes per process (4096)")
add("--steps", type=least(1), default=100, help="time steps of 0.02 s (100)")
add("--iterations", type=least(1), default=60, help="steps of Adam (60)")
add("--rate", type=least(0, float), default=0.03, help="learning rate (0.03)")
args = parser.parse_args()

RANK, WORLD = int(os.environ.get("RANK", 0)), int(os.environ.get("WORLD_SIZE", 1))
if args.arch == "cuda":
    # One process, one GPU: the others are not there for it. Before anything opens CUDA.
    devices = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    local = int(os.environ.get("LOCAL_RANK", 0))
    os.environ["CUDA_VISIBLE_DEVICES"] = devices.split(",")[local] if devices else str(local)

import numpy as np  # noqa: E402
import tai as ti  # noqa: E402

torch = studio.need("torch", "the ensemble")
dist = studio.need("torch.distributed", "the ensemble")

ti.init(arch=getattr(ti, args.arch))

SCENES, STEPS, HIDDEN = args.scenes, args.steps, 16
DT, GRAVITY, CART, PUSH = 0.02, 9.8, 1.0, 10.0
# w1 (HIDDEN, 4), b1 (HIDDEN), w2 (HIDDEN), one after another.
COUNT = HIDDEN * 6

# Position and speed of the cart, angle and turning of the pole.
state = ti.Vector.field(4, ti.f32, shape=(STEPS + 1, SCENES), needs_grad=True)
length = ti.field(ti.f32, shape=SCENES)
mass = ti.field(ti.f32, shape=SCENES)
weights = ti.field(ti.f32, shape=COUNT, needs_grad=True)
# Each scene has a copy: gradients of all steps add up in it, and over the scenes just once.
own = ti.field(ti.f32, shape=(COUNT, SCENES), needs_grad=True)
loss = ti.field(ti.f32, shape=(), needs_grad=True)


@ti.kernel
def share():
    for k, s in own:
        own[k, s] = weights[k]


@ti.kernel
def step(t: ti.i32):
    for s in range(SCENES):
        now = state[t, s]
        push = 0.0
        for i in ti.static(range(HIDDEN)):
            total = own[4 * HIDDEN + i, s]
            for j in ti.static(range(4)):
                total += own[4 * i + j, s] * now[j]
            push += own[5 * HIDDEN + i, s] * ti.tanh(total)
        whole = CART + mass[s]
        sine, cosine = ti.sin(now[2]), ti.cos(now[2])
        drive = (PUSH * ti.tanh(push) + mass[s] * length[s] * now[3] ** 2 * sine) / whole
        inertia = length[s] * (4.0 / 3.0 - mass[s] * cosine**2 / whole)
        turning = now[3] + DT * (GRAVITY * sine - cosine * drive) / inertia
        swing = (GRAVITY * sine - cosine * drive) / inertia
        speed = now[1] + DT * (drive - mass[s] * length[s] * swing * cosine / whole)
        state[t + 1, s] = ti.Vector([now[0] + DT * speed, speed, now[2] + DT * turning, turning])


@ti.kernel
def judge():
    for t, s in ti.ndrange(STEPS, SCENES):
        after = state[t + 1, s]
        off = after[2] ** 2 + 0.1 * after[0] ** 2 + 0.01 * after[1] ** 2
        loss[None] += off / (STEPS * SCENES)


def fill_scenes() -> None:
    """This process's part of the ensemble, which does not depend on how it is split."""
    draw = np.random.default_rng(1)
    everything = draw.uniform(size=(WORLD * SCENES, 4)).astype(np.float32)
    part = everything[RANK * SCENES : (RANK + 1) * SCENES]
    length.from_numpy(0.3 + 0.7 * part[:, 0])
    mass.from_numpy(0.05 + 0.3 * part[:, 1])
    start = np.zeros((STEPS + 1, SCENES, 4), np.float32)
    start[0, :, 0] = part[:, 2] - 0.5
    start[0, :, 2] = 0.6 * (part[:, 3] - 0.5)
    state.from_numpy(start)


class Ensemble(torch.autograd.Function):
    """The mean cost of this process's scenes, as a function of the controller's weights."""

    tape: ti.ad.Tape | None = None

    @staticmethod
    def forward(ctx: Any, given: Any):
        weights.from_torch(given)
        if Ensemble.tape is None:
            with ti.ad.Tape(loss) as Ensemble.tape:
                share()
                for t in range(STEPS):
                    step(t)
                judge()
        else:
            # The same launches again, forward and backward, as one.
            loss[None] = 0.0
            Ensemble.tape.replay()
        ctx.gradient = weights.grad.to_torch(device=given.device)
        return loss.to_torch(device=given.device)

    @staticmethod
    def backward(ctx: Any, bar: Any):
        return bar * ctx.gradient


def iterate(controller: Any, optimiser: Any, together: bool) -> Any:
    """One step of descent on the mean over all processes, or on this one's own; the loss."""
    optimiser.zero_grad()
    cost = Ensemble.apply(controller)
    cost.backward()
    both = torch.cat([controller.grad, cost.detach().reshape(1)])
    if together and WORLD > 1:
        dist.all_reduce(both)
        both /= WORLD
        controller.grad.copy_(both[:-1])
    optimiser.step()
    return both[-1]


def timed(controller: Any, together: bool) -> float:
    """Median seconds of an iteration, on a copy of the controller."""
    trial = controller.detach().clone().requires_grad_()
    optimiser = torch.optim.Adam([trial], lr=args.rate)
    seconds: list[float] = []
    for _ in range(12):
        begin = time.perf_counter()
        cost = iterate(trial, optimiser, together)
        float(cost)  # waits
        seconds.append(time.perf_counter() - begin)
    return statistics.median(seconds[2:])


def main() -> None:
    on_gpu = args.arch == "cuda"
    device = torch.device("cuda" if on_gpu else "cpu")
    fill_scenes()
    first = 0.3 * torch.randn(COUNT, generator=torch.Generator().manual_seed(0))
    first[5 * HIDDEN :] *= 0.1
    controller = first.to(device).requires_grad_()
    optimiser = torch.optim.Adam([controller], lr=args.rate)
    # After the optimiser: with the first one, PyTorch loads modules that hold on to a process group
    # which is there already. Its threads then outlive destroy_process_group(), and one of them may
    # want the interpreter when that has gone, which ends the process.
    if WORLD > 1:
        dist.init_process_group("nccl" if on_gpu else "gloo")
    for iteration in range(args.iterations):
        cost = iterate(controller, optimiser, True)
        if RANK == 0 and (iteration % 10 == 0 or iteration == args.iterations - 1):
            print(f"iteration {iteration:3}  loss {cost.item():.6f}  |w| {controller.norm():.6f}")

    # Alone: one process after another, so that none of them disturbs it.
    alone = torch.zeros(WORLD, device=device)
    for turn in range(WORLD):
        if turn == RANK:
            alone[RANK] = timed(controller, False)
        if WORLD > 1:
            dist.barrier()
    together = torch.tensor(timed(controller, True), device=device)
    if WORLD > 1:
        dist.all_reduce(alone)
        dist.all_reduce(together, dist.ReduceOp.MAX)
    if RANK == 0:
        slowest, ms = float(alone.max()), 1e3 * float(together)
        print(
            f"{WORLD} x {SCENES} scenes: {ms:.3f} ms an iteration, alone {1e3 * slowest:.3f} ms; "
            f"scaling {WORLD * slowest / float(together):.2f} of {WORLD}"
        )
    if WORLD > 1:
        dist.destroy_process_group()


if __name__ == "__main__":
    main()
