"""The cases of the benchmark: scenes and micro-kernels by name, in three sizes.

`tiny` is for tests and for arithmetic of 50 digits, `quick` for a first impression, `full` for
published figures. Scenes of `examples` run unchanged, with their own options; those that exist for
other systems, too (`tai_scenes.py`), run from there.
"""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples"))
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import harness
import micro
import problems

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
SIZES = ["tiny", "quick", "full"]
SHARED = ["mass_spring", "wave", "smoke", "diffmpm"]
# Systems that run the source of an example; the others have programs of their own or none.
TAICHI = ("tai", "taichi", "quadrants")


@dataclasses.dataclass(frozen=True)
class Example:
    """How to run a simulator of `examples` small.

    Attributes:
        options: of the command line, for each size.
        prepare: sets it up; returns (forward, unknown fields, a step of descent).
    """

    options: dict[str, str]
    prepare: Callable
    module: str = ""


def _robot(module):
    module.set_up()
    return module.forward, list(module.WEIGHTS.values()), module.iteration


def _billiards(module):
    module.set_up()
    if module.STEPS < 500:  # near enough to hit something
        module.cue[None] = 0.42, 0.5
    return module.forward, [module.cue, module.push], module.iteration


def _electric(module):
    module.set_up()
    module.set_path(module.path_of(0))
    weights = list(module.WEIGHTS.values())
    # The path of iteration 0 has been drawn.
    return module.forward, weights, lambda number: module.iteration(number + 1)


def _volume(module):
    module.density.from_numpy(module.make_volume())
    module.render()
    module.target.copy_from(module.image)
    smooth = np.sin(np.arange(module.N**3) * 0.37).reshape((module.N,) * 3)
    module.density.from_numpy((0.004 + 0.002 * smooth).astype(np.float32))

    def forward():
        module.render()
        module.compute_loss()

    def iteration(_):
        with module.ti.ad.Tape(module.loss):
            forward()
        module.descend(module.args.rate)

    return forward, [module.density], iteration


def _solid(module, pool=None, density=None):
    """The robot of diffmpm3d, with or without a pool of liquid on its back."""
    import random

    random.seed(0)
    args = module.args
    scene = module.Scene(args.density if density is None else density)
    scene.robot(block=0.08 if pool else 0.1)
    if pool:
        scene.pool(**pool)
    simulation = module.Simulation(scene, args.steps)
    i, j = np.arange(simulation.muscles)[:, None], np.arange(4)
    start = 0.01 * np.sin(12.9898 * i + 78.233 * j)
    simulation.weights.from_numpy(start.astype(np.float32))
    module.simulation = simulation
    module.loss = simulation.loss

    def iteration(_):
        with module.ti.ad.Tape(simulation.loss):
            simulation.forward()
        simulation.descend(args.rate)

    return simulation.forward, [simulation.weights, simulation.bias], iteration


def _liquid(module):
    return _solid(module, {"corner": (0.1, 0.15, 0.1), "size": (0.2, 0.05, 0.2)})


EXAMPLES = {
    "diffmpm3d": Example(
        {
            "tiny": "--steps 4 --density 1",
            "quick": "--steps 32 --density 1",
            "full": "--steps 128 --density 2",
        },
        _solid,
    ),
    "liquid": Example(
        {
            "tiny": "--steps 4 --density 1",
            "quick": "--steps 32 --density 1",
            "full": "--steps 128 --density 2",
        },
        _liquid,
        "diffmpm3d",
    ),
    "rigid_body": Example(
        {"tiny": "--steps 12", "quick": "--steps 160", "full": "--steps 512"}, _robot
    ),
    "billiards": Example(
        {"tiny": "--steps 400", "quick": "--steps 700", "full": "--steps 1024"}, _billiards
    ),
    "electric": Example(
        {"tiny": "--steps 12", "quick": "--steps 128", "full": "--steps 512"}, _electric
    ),
    "volume_renderer": Example(
        {
            "tiny": "--n 7 --res 5 --views 2 --samples 120",
            "quick": "--n 32 --res 64 --views 3 --samples 120",
            "full": "--n 64 --res 128 --views 5 --samples 120",
        },
        _volume,
    ),
}
SCENES = [*SHARED, *EXAMPLES]
NAMES = [*SCENES, *micro.NAMES]


class ExampleProgram(harness.Program):
    """A simulator of `examples`: its forward pass under a tape, and its own steps of descent."""

    def __init__(self, module, prepare):
        self.module, self.ti = module, module.ti
        self.forward, self.unknowns, self.iteration = prepare(module)
        round_inputs(module)
        self.tape = None

    def run(self) -> tuple[float, float]:
        start = harness.clock()
        with self.ti.ad.Tape(self.module.loss) as tape:
            self.forward()
            self.ti.sync()
            middle = harness.clock()
        self.ti.sync()
        self.tape = tape
        return middle - start, harness.clock() - middle

    def loss(self) -> float:
        return float(self.module.loss[None])

    def gradient(self) -> np.ndarray:
        return np.concatenate([u.grad.to_numpy().ravel() for u in self.unknowns])

    def inputs(self) -> np.ndarray:
        return np.concatenate([u.to_numpy().ravel() for u in self.unknowns])

    def assign(self, flat: np.ndarray) -> None:
        import tai_scenes

        tai_scenes.assign_fields([(u, tai_scenes.whole) for u in self.unknowns], flat)

    def descend(self, steps: int) -> None:
        for number in range(steps):
            self.iteration(number)


def round_inputs(module) -> None:
    """Makes all numbers that fields hold numbers of f32: only computing may have an error."""
    owners = [module, getattr(module, "simulation", None)]
    for owner in owners:
        for value in list(vars(owner).values()) if owner is not None else ():
            if hasattr(value, "from_numpy") and hasattr(value, "grad"):
                array = value.to_numpy()
                if array.dtype == np.float64:
                    value.from_numpy(array.astype(np.float32).astype(np.float64))


def rounded(problem):
    """A problem whose arrays hold numbers of f32, as f64."""

    def part(value):
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            return value.astype(np.float32).astype(np.float64)
        if isinstance(value, dict):
            return {key: part(item) for key, item in value.items()}
        return rounded(value) if dataclasses.is_dataclass(value) else value

    fields = {f.name: part(getattr(problem, f.name)) for f in dataclasses.fields(problem)}
    return dataclasses.replace(problem, **fields)


def wide(problem):
    """A problem with the same numbers as 80-bit floats, in which its adjoint is computed then."""

    def part(name, value):
        if name == "real":
            return np.longdouble
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            return value.astype(np.longdouble)
        if isinstance(value, dict):
            return {key: part("", item) for key, item in value.items()}
        return wide(value) if dataclasses.is_dataclass(value) else value

    fields = {f.name: part(f.name, getattr(problem, f.name)) for f in dataclasses.fields(problem)}
    return dataclasses.replace(problem, **fields)


def problem_of(name: str, size: str):
    """The problem of a scene that all systems share."""
    if size != "tiny":
        found = problems.PROBLEMS[name](size == "quick")
    elif name == "smoke":
        p = problems.scenes
        found = problems.SmokeProblem(
            8, 4, 2, p.smooth_velocity(8) + 0.123, p.checkerboard(8, 2), p.yy(8)
        )
    elif name == "wave":
        found = problems.WaveProblem(
            8, 6, problems.scenes.smooth_wave(8), problems.scenes.wave_target(8)
        )
    elif name == "diffmpm":
        material = problems.diffmpm.Material(n=128)
        position = problems.scenes.mpm_block(4, 0.5, material.dx)
        velocity = problems.scenes.smooth_particle_velocity(position)
        found = problems.MpmProblem(4, position, velocity, material)
    else:
        body = problems.scenes.robot(0)
        walk = problems.springs.Walk(slots=24)
        found = problems.RobotProblem(body, problems.scenes.robot_weights(body), walk)
    return rounded(found)


def load_example(name: str, size: str):
    """The module of an example, as its command line with these options makes it."""
    example = EXAMPLES[name]
    before = sys.argv
    sys.argv = [name, *example.options[size].split(), "--no-picture", "--out", "/tmp"]
    try:
        if example.module:
            module = importlib.import_module(example.module)
        else:
            module = importlib.import_module(name)
        if not hasattr(module, "args"):  # it parses them in its main program
            module.args = module.options(name, name, iterations=1, rate=30.0).parse_args()
            module.studio.start(module.args)
        return module
    finally:
        sys.argv = before


def make(name: str, system: str, size: str) -> harness.Program | None:
    """A program, where the system has one. tai (or who plays it) has been started."""
    if name in micro.NAMES:
        data = micro.data_of(name, size)
        if system in TAICHI:
            return micro.make(name, data)
        import micro_peers

        return micro_peers.make(name, data, system)
    if name in SHARED:
        if system in TAICHI:
            import tai_scenes

            return tai_scenes.SCENES[name](problem_of(name, size))
        peer = importlib.import_module(f"peers.peer_{system}")
        return getattr(peer, PEER_MAKERS[name])(problem_of(name, size))
    if system in TAICHI:
        return ExampleProgram(load_example(name, size), EXAMPLES[name].prepare)
    return None


PEER_MAKERS = {
    "smoke": "make_smoke", "wave": "make_wave", "diffmpm": "make_mpm",
    "mass_spring": "make_mass_spring",
}  # fmt: skip
