"""Options that all simulators have, and the end of a program in one line."""

import argparse
import importlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import tai as ti

from .memory import compare


def checkpoint(args: argparse.Namespace) -> Path:
    """The file in which a descent keeps its fields."""
    return args.out / f"{args.name}.npz"


def fail(message: str, code: int = 2) -> NoReturn:
    """Ends the program with one line."""
    print(f"{Path(sys.argv[0]).stem}: {' '.join(str(message).split())}", file=sys.stderr)
    sys.exit(code)


def need(library: str, purpose: str, package: str | None = None) -> Any:
    """A library that not everybody has; without it the program ends and says how to get it."""
    try:
        return importlib.import_module(library)
    except ImportError as error:
        if error.name != library.partition(".")[0]:
            fail(f"{purpose} needs {library}, which cannot be loaded: {error}")
        fail(f"{purpose} needs {library}, which is not installed: pip install {package or library}")


def at_least(minimum: float, kind: type = int, most: float | None = None) -> Callable[[str], Any]:
    """The type of an option that is a number, and not too small or too large.

    A whole number fits the 32 bits of an argument or an index of a kernel, unless `most` is given.
    """
    if most is None:
        most = 2**31 - 1 if kind is int else float("inf")

    def number(text: str) -> float:
        try:
            value = kind(text)
        except ValueError:
            word = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"{text!r} is not {word}") from None
        if not minimum <= value < float("inf"):
            raise argparse.ArgumentTypeError(f"{text} is impossible; at least {minimum}")
        if value > most:
            raise argparse.ArgumentTypeError(f"{text} is impossible; at most {most}")
        return value

    return number


PACKAGES = {"PIL": "pillow"}
# The largest seed of NumPy's older generators.
LARGEST_SEED = 2**32 - 1


class Options(argparse.ArgumentParser):
    """A parser with the options that all simulators have; see `options`."""

    name: str
    quick: dict[str, Any]

    def error(self, message: str) -> NoReturn:
        fail(f"{message} (--help lists all options)")

    def parse_args(self, *given: Any, **named: Any) -> Any:
        args = super().parse_args(*given, **named)
        if args.quick:
            self.set_defaults(**self.quick)
            args = super().parse_args(*given, **named)
        args.name = self.name
        args.in_place = getattr(args, "state", "slots") != "slots"
        if getattr(args, "state", "") == "compare":
            compare(sys.argv[1:])
        if args.picture and args.movie == "mp4":
            need("imageio_ffmpeg", "--movie mp4", "imageio-ffmpeg")
        if args.out:
            _check_folder(args.out)
        if args.resume and not checkpoint(args).is_file():
            fail(f"--resume: there is no {checkpoint(args)} to go on from")
        return args


def options(
    doc: str | None, name: str, *, iterations: int = 0, steps: int = 0, rate: float = 0.0,
    least_steps: int = 2, quick: dict[str, Any] | None = None, bare: bool = False,
) -> Options:  # fmt: skip
    """The parser of an example.

    Args:
        doc: the description of the example, shown by `--help`.
        name: of the example, and of the files that it writes.
        iterations, steps, rate: defaults of these options; those that an example has no use for
            are left out. Without `iterations` there is no `--resume`.
        least_steps: fewer time slots than this make no sense.
        quick: defaults under `--quick`.
        bare: only `--arch` and `--steps`: the example prints some numbers and writes nothing.
    """
    parser = Options(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.name, parser.quick = name, quick or {"iterations": min(iterations, 3)}
    sys.excepthook = _explain
    add = parser.add_argument
    add("--arch", choices=["cpu", "cuda", "python"], default="cpu", help="what computes (cpu)")
    if steps:
        add("--steps", type=at_least(least_steps), default=steps, help=f"time slots ({steps})")
    if not iterations:
        parser.set_defaults(resume=False, seed=0)
    if bare:
        parser.set_defaults(quick=False, picture=False, out=None)
        parser.set_defaults(deterministic=False, double=False, fast_math=False)
        return parser
    if iterations:
        text = f"steps of descent ({iterations})"
        add("--iterations", type=at_least(1), default=iterations, help=text)
        add("--resume", action="store_true", help="go on where the run in --out stopped")
        add("--seed", type=at_least(0, most=LARGEST_SEED), default=0, help="of what is random (0)")
    if rate:
        text = f"learning rate ({rate:g})"
        add("--rate", type=at_least(0, float), default=rate, help=text)
    add("--deterministic", action="store_true", help="the same bits in each run")
    add("--fast-math", action="store_true", help="sums in any order, as Taichi's default has it")
    add("--double", action="store_true", help="compute in f64 instead of f32")
    add("--out", type=Path, default=Path("out"), help="folder of what is written (out)")
    add("--quick", action="store_true", help="a short run, to see that it works")
    add("--no-picture", dest="picture", action="store_false", help="numbers only")
    text = "what an animation becomes (gif); png: a folder of frames"
    add("--movie", choices=["gif", "mp4", "png"], default="gif", help=text)
    return parser


def plain(doc: str | None) -> Options:
    """The parser of a program that has its own options only; of bad ones it says one line, too."""
    parser = Options(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.name, parser.quick = Path(sys.argv[0]).stem, {}
    parser.set_defaults(quick=False, picture=False, resume=False, out=None)
    sys.excepthook = _explain
    return parser


def _check_folder(folder: Path) -> None:
    """Better now than after an hour of descent."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        why = "it is a file" if folder.is_file() else error.strerror
        fail(f"--out {folder}: cannot write there ({why})")


def start(args: argparse.Namespace, **more: Any) -> None:
    """`ti.init` with the chosen options; `float` becomes f32 or, with --double, f64."""
    given: dict[str, Any] = {
        "arch": getattr(ti, args.arch),
        "default_fp": ti.f64 if args.double else ti.f32,
        "deterministic": args.deterministic,
        "fast_math": args.fast_math,
        "random_seed": args.seed,
    }
    try:
        ti.init(**given | more)
    except ti.TaiRuntimeError as error:
        fail(f"--arch {args.arch}: {error}")


def _explain(kind: type[BaseException], error: Any, trace: Any) -> None:
    """Too little memory, a full disk or Ctrl-C are no errors of the program: no traceback."""
    if issubclass(kind, KeyboardInterrupt):
        fail("interrupted", code=130)
    if issubclass(kind, ModuleNotFoundError) and error.name:
        fail(f"{error.name} is not installed: pip install {PACKAGES.get(error.name, error.name)}")
    if issubclass(kind, BrokenPipeError):  # `| head` has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    if issubclass(kind, MemoryError):
        fail(f"this size does not fit into memory{f': {error}' if str(error) else ''}")
    if issubclass(kind, OSError) and error.filename:
        fail(f"cannot write {error.filename}: {error.strerror}")
    sys.__excepthook__(kind, error, trace)
