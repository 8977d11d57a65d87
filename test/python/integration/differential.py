"""Examples and scenes of the benchmark, in f64, as functions of where and how they run.

Each scene gives its losses and gradients as named arrays. The source is that of the example or the
benchmark, with f64 in the place of f32: rounding then hides nothing. The way in which a scene runs
adds further arguments of `ti.init` and `ti.ad.Tape`.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import io
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tai as ti

ROOT = Path(__file__).resolve().parents[3]
for folder in (ROOT / "benchmarks", ROOT / "examples", ROOT / "test" / "fuzz"):
    sys.path.insert(0, str(folder))

from configurations import Configuration  # noqa: E402

import problems  # noqa: E402


@dataclass(frozen=True)
class Way:
    """How a scene runs: `elements` of the configuration plays no part."""

    at: Configuration = Configuration(level=0)
    checkpoint: object = None
    fused: bool = False

    def __str__(self) -> str:
        word = str(self.at).replace(f"-{self.at.elements}n", "")
        if self.checkpoint:
            word += f"-checkpoint={self.checkpoint}"
        return word + ("-fused" if self.fused else "")


REFERENCE = Way()

# The examples, each in short and in long form: arguments of the program.
EXAMPLES = {
    "active_blocks": ("--n 64 --steps 40", "--n 512 --steps 400"),
    "billiards": (
        "--steps 640 --iterations 1 --out {out}",
        "--steps 640 --iterations 2 --out {out}",
    ),
    "diffmpm": ("--steps 6 --iterations 1", "--steps 64 --iterations 2"),
    "electric": ("--steps 20 --iterations 1 --out {out}", "--steps 100 --iterations 2 --out {out}"),
    "in_place_springs": ("--steps 100", "--steps 1000"),
    "mass_spring": (
        "--robot 0 --steps 24 --iterations 1 --no-picture --out {out}",
        "--robot 2 --steps 100 --iterations 2 --no-picture --out {out}",
    ),
    "mass_spring_simple": ("--iterations 1 --out {out}", "--iterations 5 --out {out}"),
    "neighbours": ("--points 80 --iterations 1", "--points 2000 --iterations 4"),
    "rigid_body": (
        "--robot 1 --steps 30 --iterations 1 --no-picture --out {out}",
        "--robot 2 --steps 120 --iterations 2 --no-picture --out {out}",
    ),
    "rigid_body_discontinuity": (
        "--steps 1024 --samples 2 --out {out}",
        "--steps 1100 --samples 20 --out {out}",
    ),
    "rigid_body_toi": ("--steps 204 --out {out}", "--steps 408 --out {out}"),
    "smoke": ("--n 12 --steps 4 --sweeps 3 --iterations 1", "--n 65 --steps 12 --iterations 2"),
    "sparse_mpm": (
        "--double --steps 12 --room 64 --large 256 --iterations 1",
        "--double --steps 60 --iterations 2",
    ),
    "svd_gradient": ("--matrices 3 --iterations 1", "--matrices 300 --iterations 3"),
    "wave": ("--n 17 --steps 10 --iterations 1", "--n 130 --steps 40 --iterations 2"),
}
# Not here: ensemble.py, which needs torch and has a test of its own.
BENCHMARK = ("smoke", "diffmpm", "wave", "mass_spring", "first_kernel")
SCENES = [*EXAMPLES, *(f"benchmark_{name}" for name in BENCHMARK)]

# The time between the slots is what makes these long; the sizes are those of `--small`.
SHORT_PROBLEMS = {
    "smoke": lambda: _shorter(problems.smoke_problem(True), slots=4),
    "diffmpm": lambda: _shorter(problems.mpm_problem(True), slots=5),
    "wave": lambda: _shorter(problems.wave_problem(True), slots=10),
    "mass_spring": lambda: problems.RobotProblem(
        problems.scenes.robot(3),
        problems.scenes.robot_weights(problems.scenes.robot(3)),
        problems.springs.Walk(slots=24),
    ),
    "first_kernel": lambda: problems.first_kernel_problem(True),
}


def _shorter(problem, slots: int):
    from dataclasses import replace

    return replace(problem, slots=slots)


def run(scene: str, way: Way, folder: Path, long: bool = False) -> dict[str, np.ndarray]:
    """The losses and gradients of a scene that runs in this way."""
    with way.at.chosen(), _given(way, folder):
        if scene in EXAMPLES:
            return _run_example(scene, EXAMPLES[scene][long], folder)
        return _run_benchmark(scene.removeprefix("benchmark_"), folder, long)


@contextlib.contextmanager
def _given(way: Way, folder: Path):
    """`ti.init` and `ti.ad.Tape` with the options of the way, whatever the program says."""
    init, tape = ti.init, ti.ad.Tape

    def init_so(**options):
        options |= {
            "default_fp": ti.f64, "opt_level": way.at.level, "fuse_launches": way.fused,
            "cpu_max_num_threads": way.at.threads if way.at.arch == "cpu" else 1,
            "deterministic": way.at.deterministic,
            # Ways run different code, and share compiled code.
            "offline_cache": True, "offline_cache_file_path": str(folder / "cache"),
        }  # fmt: skip
        init(**options)

    def tape_so(loss, **options):
        if way.checkpoint:
            options.pop("memory_budget", None)
            options["checkpoint"] = way.checkpoint
        return tape(loss, **options)

    ti.init, ti.ad.Tape = init_so, functools.wraps(tape)(tape_so)
    try:
        yield
    finally:
        ti.init, ti.ad.Tape = init, tape
        ti.reset()


def _load(path: Path, folder: Path, name: str):
    """A module of the text of a file, in f64."""
    copy = folder / f"{name}.py"
    copy.write_text(path.read_text().replace("ti.f32", "ti.f64"))
    spec = importlib.util.spec_from_file_location(name, copy)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _gradients(owner: object) -> dict[str, np.ndarray]:
    """The gradients of the fields in a module or an object; if there are none, the fields."""
    fields = {
        name: value for name, value in vars(owner).items()
        if hasattr(value, "to_numpy") and hasattr(value, "snode")
    }  # fmt: skip
    found = {}
    for name, value in fields.items():
        # Fields of integers have none, others none that stands anywhere.
        with contextlib.suppress(ti.TaiAutodiffError, AttributeError):
            found[f"{name}.grad"] = value.grad.to_numpy()
    return found or {name: value.to_numpy() for name, value in fields.items()}


def _run_example(name: str, arguments: str, folder: Path) -> dict[str, np.ndarray]:
    before, printed = sys.argv, io.StringIO()
    sys.argv = [name, *arguments.format(out=folder).split()]
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            module = _load(ROOT / "examples" / f"{name}.py", folder, f"example_{name}")
            return STARTS.get(name, _optimise)(module)
    finally:
        sys.argv = before


def _optimise(module) -> dict[str, np.ndarray]:
    """The course of most examples: a few steps of descent."""
    return {"losses": np.array(module.optimise())} | _gradients(module)


def _descend(module) -> dict[str, np.ndarray]:
    """The same for a main program that calls the loop itself, with the learned parameters in
    `start`."""
    losses = module.studio.optimise(module.args, module.iteration, start=module.start)
    return {"losses": np.array(losses)} | _gradients(module)


def _wave(module) -> dict[str, np.ndarray]:
    sign = module.signs.yin_yang(module.N)
    module.target.from_numpy(sign - sign.mean())
    return _descend(module)


def _diffmpm(module) -> dict[str, np.ndarray]:
    # On the floor: in the air the parts of the gradient cancel, and rounding is left.
    module.start[:, 1] -= 0.012
    module.set_up()
    return _optimise(module)


def _smoke(module) -> dict[str, np.ndarray]:
    generator = np.random.default_rng(0)
    module.target.from_numpy(generator.random((module.N, module.N)))
    module.start.from_numpy(0.1 * generator.standard_normal((module.N, module.N, 2)))
    module.smoke_at_start.from_numpy(generator.random((module.N, module.N)))
    return _descend(module)


def _mass_spring_simple(module) -> dict[str, np.ndarray]:
    module.set_up(0.1)
    return _optimise(module)


def _set_up(module) -> dict[str, np.ndarray]:
    module.set_up()
    return _optimise(module)


def _bounce(module) -> dict[str, np.ndarray]:
    module.set_up()
    return dict(zip(("loss", "by y", "by vy"), module.bounce("toi")))


def _throw(module) -> dict[str, np.ndarray]:
    module.set_up()
    return dict(zip(("loss", "by spin", "by x"), module.throw(1.0)))


def _in_place_springs(module) -> dict[str, np.ndarray]:
    return {"loss": np.array(module.loss[None])} | _gradients(module)


def _neighbours(module) -> dict[str, np.ndarray]:
    module.x.from_numpy(np.random.default_rng(0).random((module.N, 2)))
    energies = []
    for _ in range(module.args.iterations):
        energies.append(module.gradient())
        module.descend(module.args.rate * module.RADIUS**2)
    return {"losses": np.array(energies)} | _gradients(module)


def _sparse_mpm(module) -> dict[str, np.ndarray]:
    # At the floor; see _diffmpm.
    module.CENTRE = np.array([0.3, 0.15])
    ball = module.Ball(module.args.room)
    losses, push = [], np.array([1.5, -1.0])
    found = {}
    for number in range(module.args.iterations):
        value, slope = ball.gradient(push)
        losses.append(value)
        found[f"slope {number}"] = slope
        push = push - module.args.rate * slope
    return {"losses": np.array(losses)} | found | _gradients(ball)


def _svd_gradient(module) -> dict[str, np.ndarray]:
    module.main()
    return {"loss": np.array(module.loss[None])} | _gradients(module)


def _active_blocks(module) -> dict[str, np.ndarray]:
    module.spark()
    for number in range(module.args.steps // 2):
        if number % 4 == 0:
            module.wake()
        if number % 40 == 39:
            module.rest()
        module.step(module.now, module.then)
        module.step(module.then, module.now)
    return module.now.to_numpy()


STARTS: dict[str, Callable] = {
    "active_blocks": _active_blocks, "billiards": _set_up, "diffmpm": _diffmpm,
    "electric": _set_up, "mass_spring": _set_up, "rigid_body": _set_up,
    "in_place_springs": _in_place_springs, "rigid_body_discontinuity": _throw,
    "rigid_body_toi": _bounce,
    "mass_spring_simple": _mass_spring_simple, "neighbours": _neighbours, "smoke": _smoke,
    "sparse_mpm": _sparse_mpm, "svd_gradient": _svd_gradient, "wave": _wave,
}  # fmt: skip


def _run_benchmark(name: str, folder: Path, long: bool) -> dict[str, np.ndarray]:
    """The scene twice, and its tape played again: a program of launches may be made by then."""
    ti.init(default_fp=ti.f64)
    module = _load(ROOT / "benchmarks" / "tai_scenes.py", folder, "differential_scenes")
    problem = problems.PROBLEMS[name](True) if long else SHORT_PROBLEMS[name]()
    program = module.SCENES[name](problem)
    found = {}
    for number in range(2):
        program.run()
        found[f"loss {number}"] = np.array(program.loss())
        found[f"gradient {number}"] = program.gradient()
    for number in range(3):
        if program.replay() is None:
            break
        found[f"replay {number}"] = program.gradient()
    return found
