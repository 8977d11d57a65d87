"""The frame that the simulators share: options, interrupts, output files."""

import argparse
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import tai as ti
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "examples"))

import studio  # noqa: E402
from simulators import table  # noqa: E402


def parse(folder, *words, **options):
    parser = studio.options("What it is.", "toy", **({"iterations": 20, "rate": 0.1} | options))
    parser.add_argument("--n", type=studio.at_least(1), default=3)
    return parser.parse_args(["--out", str(folder), *map(str, words)])


class Toy:
    """Descent on a parabola; `at` names an iteration in which something happens."""

    def __init__(self, args, at=None, event=lambda: None):
        self.args, self.at, self.event = args, at, event
        self.x = ti.field(float, shape=args.n)

    def iteration(self, number):
        x = self.x.to_numpy()
        # The state is half of a step ahead when something happens.
        self.x.from_numpy(x - 0.5 * self.args.rate * 2 * (x - 1))
        if number == self.at:
            result = self.event()
            if result is not None:
                return result
        self.x.from_numpy(x - self.args.rate * 2 * (x - 1))
        return {"loss": float(((x - 1) ** 2).sum()), "first": x[0]}

    def optimise(self):
        return studio.optimise(self.args, self.iteration, x=self.x)


@pytest.fixture(autouse=True)
def program(monkeypatch):
    monkeypatch.setattr(sys, "argv", ["toy.py"])
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    ti.init()


def ends(capsys, code=2):
    """Collects the only line of a program that ends here."""

    class Ends:
        def __enter__(self):
            self.context = pytest.raises(SystemExit)
            self.info = self.context.__enter__()
            return self

        def __exit__(self, *error):
            handled = self.context.__exit__(*error)
            self.text = capsys.readouterr().err
            assert self.info.value.code == code
            return handled

    return Ends()


def signalled(number):
    return lambda: os.kill(os.getpid(), number)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, capsys, number):
    whole = Toy(parse(tmp_path / "whole")).optimise()
    handler = signal.getsignal(signal.SIGTERM)
    with ends(capsys, code=130) as end:
        Toy(parse(tmp_path / "parts"), 7, signalled(number)).optimise()
    assert signal.getsignal(signal.SIGTERM) is handler
    path = tmp_path / "parts" / "toy.npz"
    assert f"7 of 20 iterations are kept in {path}; --resume goes on" in end.text
    assert table(tmp_path / "parts" / "toy.losses.csv")["loss"].tolist() == whole[:7]
    toy = Toy(parse(tmp_path / "parts", "--resume"))
    assert toy.optimise() == whole
    found, expected = (table(tmp_path / f / "toy.losses.csv") for f in ("parts", "whole"))
    assert found["first"].tolist() == expected["first"].tolist()
    assert found["iteration"].tolist() == list(range(20))


def test_the_best_is_kept(tmp_path):
    # The fourth iteration has the least loss, with the parameters of the third one.
    args = parse(tmp_path, "--iterations", 4)
    Toy(args).optimise()
    toy = Toy(args)
    studio.take_best(x=toy.x)
    best = toy.x.to_numpy()
    assert best[0] == table(tmp_path / "toy.losses.csv")["first"][3] > 0
    # A resumed run with larger losses keeps the former best.
    toy = Toy(parse(tmp_path, "--resume", "--iterations", 6))
    toy.iteration = lambda number: {"loss": 9.0, "first": 0.0}
    toy.optimise()
    studio.take_best(x=toy.x)
    assert toy.x.to_numpy().tolist() == best.tolist()


def test_the_best_is_that_of_this_run(tmp_path):
    # Another run, of another size, may write its checkpoint into the same folder.
    toy = Toy(parse(tmp_path, "--iterations", 4))
    toy.optimise()
    np.savez(tmp_path / "toy.npz", **{"best.x": np.zeros(7)})
    studio.take_best(x=toy.x)
    assert toy.x.to_numpy()[0] == table(tmp_path / "toy.losses.csv")["first"][3] > 0


def test_an_interrupt_before_anything_is_learned(tmp_path, capsys):
    with ends(capsys, code=130) as end:
        Toy(parse(tmp_path), 0, signalled(signal.SIGINT)).optimise()
    assert end.text == "toy: interrupted in its first iteration: nothing to keep\n"
    assert not list(tmp_path.iterdir())


def test_nobody_reads_the_output(tmp_path):
    program = tmp_path / "toy.py"
    program.write_text(
        f"import sys; sys.path.insert(0, {str(Path(studio.__file__).parents[1])!r})\n"
        "import studio\n"
        "studio.start(studio.options('', 'toy').parse_args())\n"
        "for k in range(100_000): print('line', k)\n"
    )
    command = f"'{sys.executable}' '{program}' --out '{tmp_path}' | head -1"
    done = subprocess.run(command, shell=True, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("line 0\n", "")


def test_two_runs_in_one_folder(tmp_path, monkeypatch):
    # While one writes its checkpoint, the other one does, too.
    one, other = Toy(parse(tmp_path, "--iterations", 4)), Toy(parse(tmp_path, "--iterations", 4))
    write, parts = np.savez, []

    def savez(path, **arrays):
        write(path, **arrays)
        parts.append(path)
        if len(parts) == 1:
            with monkeypatch.context() as patch:
                patch.setattr(os, "getpid", lambda: 4711)
                other.optimise()

    monkeypatch.setattr(np, "savez", savez)
    one.optimise()
    assert len(set(parts)) == 2 and not any(map(os.path.exists, parts))
    assert len(Toy(parse(tmp_path, "--resume")).optimise()) == 20


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_impatient_second_interrupt_loses_nothing(tmp_path, capsys, monkeypatch, number):
    write = np.savez

    def savez(path, **arrays):
        os.kill(os.getpid(), number)
        write(path, **arrays)

    monkeypatch.setattr(np, "savez", savez)
    handler = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with ends(capsys, code=130) as end:
            Toy(parse(tmp_path), 7, signalled(signal.SIGINT)).optimise()
        assert "7 of 20 iterations are kept" in end.text
        # The first one may come when all is done and the result is written.
        with pytest.raises(KeyboardInterrupt):
            Toy(parse(tmp_path, "--resume")).optimise()
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, handler)
    monkeypatch.setattr(np, "savez", write)
    assert len(Toy(parse(tmp_path, "--resume", "--iterations", 8)).optimise()) == 20


def test_an_error_loses_nothing(tmp_path, capsys):
    def wrong():
        raise ValueError("wrong")

    with pytest.raises(ValueError, match="wrong"):
        Toy(parse(tmp_path), 5, wrong).optimise()
    assert "5 of 20 iterations are kept" in capsys.readouterr().err
    # Nothing was learned: the file of the run before stays.
    before = (tmp_path / "toy.npz").read_bytes()
    with pytest.raises(ValueError, match="wrong"):
        Toy(parse(tmp_path), 0, wrong).optimise()
    assert (tmp_path / "toy.npz").read_bytes() == before
    assert "kept" not in capsys.readouterr().err


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_loss_that_is_no_number(tmp_path, capsys, value):
    with ends(capsys) as end:
        Toy(parse(tmp_path), 9, lambda: value).optimise()
    assert "the loss of iteration 9 is not finite" in end.text
    assert len(Toy(parse(tmp_path, "--resume")).optimise()) == 20
    with ends(capsys) as end:
        Toy(parse(tmp_path / "new"), 0, lambda: value).optimise()
    assert end.text.endswith("toy: the loss of iteration 0 is not finite; nothing to keep\n")


def test_a_full_disk_in_the_middle(tmp_path, monkeypatch):
    # If a run is interrupted while a checkpoint is written, the checkpoint before it stays.
    Toy(parse(tmp_path, "--iterations", 4)).optimise()
    before = (tmp_path / "toy.npz").read_bytes()

    def half(path, **arrays):
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(np, "savez", half)
    with pytest.raises(OSError, match="No space left"):
        Toy(parse(tmp_path, "--resume")).optimise()
    assert (tmp_path / "toy.npz").read_bytes() == before


def test_checkpoints_of_other_programs(tmp_path, capsys):
    with ends(capsys) as end:
        parse(tmp_path, "--resume")
    assert end.text == f"toy: --resume: there is no {tmp_path / 'toy.npz'} to go on from\n"
    Toy(parse(tmp_path, "--iterations", 4)).optimise()
    capsys.readouterr()
    with ends(capsys) as end:
        Toy(parse(tmp_path, "--resume", "--n", 4)).optimise()
    assert "toy.npz was made with --n 3, not 4" in end.text
    path = tmp_path / "toy.npz"
    for content in (b"", b"x" * 100, path.read_bytes()[:200]):
        path.write_bytes(content)
        with ends(capsys) as end:
            Toy(parse(tmp_path, "--resume")).optimise()
        assert "toy.npz is not a checkpoint of this program" in end.text
        assert end.text.count("\n") == 1


def test_going_on_with_nothing_to_do(tmp_path, capsys):
    losses = Toy(parse(tmp_path)).optimise()
    assert Toy(parse(tmp_path, "--resume", "--iterations", 5)).optimise() == losses
    assert "nothing was left to do" in capsys.readouterr().out


@pytest.mark.parametrize(
    "words, line",
    [
        (["--n", "0"], "argument --n: 0 is impossible; at least 1"),
        (["--n", "two"], "argument --n: 'two' is not a whole number"),
        (["--n", "2147483648"], "argument --n: 2147483648 is impossible; at most 2147483647"),
        (["--rate", "inf"], "argument --rate: inf is impossible; at least 0"),
        (["--rate", "fast"], "argument --rate: 'fast' is not a number"),
        (["--nn", "2"], "unrecognized arguments: --nn 2"),
        (["--arch", "abacus"], "argument --arch: invalid choice: 'abacus'"),
    ],
)
def test_bad_options(tmp_path, capsys, words, line):
    with ends(capsys) as end:
        parse(tmp_path, *words)
    assert end.text.startswith(f"toy: {line}") and end.text.count("\n") == 1


def test_a_folder_that_cannot_be_written(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "below", Path("/proc/none")):
        with ends(capsys) as end:
            parse(folder)
        assert end.text.startswith(f"toy: --out {folder}: cannot write there (")
        assert ("it is a file" in end.text) == (folder == tmp_path / "file")


def test_libraries_that_are_missing(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with ends(capsys) as end:
        parse(tmp_path, "--movie", "mp4")
    assert "needs imageio_ffmpeg, which is not installed: pip install imageio-ffmpeg" in end.text
    parse(tmp_path, "--movie", "mp4", "--no-picture")
    # A plot is not worth the end of the program.
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    studio.plot_losses(parse(tmp_path), [3.0, 2.0])
    assert capsys.readouterr().err == "no plot of losses: pip install matplotlib\n"
    assert not list(tmp_path.glob("*.png"))


def test_a_device_that_is_missing(tmp_path, capsys, monkeypatch):
    def init(**options):
        raise ti.TaiRuntimeError("no CUDA driver", "use the CPU")

    monkeypatch.setattr(ti, "init", init)
    with ends(capsys) as end:
        studio.start(parse(tmp_path, "--arch", "cuda"))
    assert end.text.startswith("toy: --arch cuda: no CUDA driver") and end.text.count("\n") == 1


@pytest.mark.parametrize("place", ["before", "after"])
@pytest.mark.parametrize(
    "error, line, code",
    [
        ("KeyboardInterrupt", "interrupted", 130),
        (
            "ModuleNotFoundError('No module', name='PIL')",
            "PIL is not installed: pip install pillow",
            2,
        ),
        ("MemoryError('7 TiB')", "this size does not fit into memory: 7 TiB", 2),
        ("MemoryError", "this size does not fit into memory", 2),
        ("OSError(28, 'No space left', 'out/x.gif')", "cannot write out/x.gif: No space left", 2),
        ("ValueError('own mistake')", None, 1),
    ],
)
def test_errors_outside_of_the_descent(tmp_path, error, line, code, place):
    program = tmp_path / "toy.py"
    lines = ["studio.start(args)", f"raise {error}"]
    program.write_text(
        f"import sys; sys.path.insert(0, {str(Path(studio.__file__).parents[1])!r})\n"
        "import studio\nargs = studio.options('', 'toy').parse_args()\n"
        + "\n".join(lines if place == "after" else lines[::-1])
    )
    command = [sys.executable, program, "--out", tmp_path]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == code
    if line:
        assert done.stderr == f"toy: {line}\n"
    else:
        assert "Traceback" in done.stderr and "own mistake" in done.stderr


def test_quick_gives_defaults_and_no_more(tmp_path):
    options = {"steps": 500, "quick": {"iterations": 2, "steps": 30}}
    args = parse(tmp_path, "--quick", **options)
    assert (args.iterations, args.steps) == (2, 30)
    args = parse(tmp_path, "--quick", "--steps", 70, **options)
    assert (args.iterations, args.steps) == (2, 70)
    assert parse(tmp_path, "--quick").iterations == 3


def test_pictures(tmp_path, capsys):
    args = parse(tmp_path)
    studio.animate(args, lambda gui, t: gui.circle((t / 4, 0.5), radius=9), range(4), res=(60, 40))
    movie = Image.open(tmp_path / "toy.gif")
    # Four frames, of which the last one stays; equal ones are merged.
    assert movie.size == (60, 40) and movie.n_frames >= 4
    args.movie = "png"
    studio.movie(args, [np.zeros((4, 6, 3), np.uint8)], framerate=2)
    assert len(list((tmp_path / "toy").glob("*.png"))) == 2
    # Frames of a longer film are deleted, and other files stay.
    (tmp_path / "toy/0002.png").touch()
    (tmp_path / "toy/7 of mine.png").touch()
    studio.movie(args, [np.zeros((4, 6, 3), np.uint8)], framerate=2)
    names = sorted(path.name for path in (tmp_path / "toy").iterdir())
    assert names == ["0000.png", "0001.png", "7 of mine.png"]
    studio.picture(args, np.full((3, 5, 3), 1.5), what="flat")
    assert Image.open(tmp_path / "toy.flat.png").getpixel((0, 0)) == (255, 255, 255)
    studio.plot(args, "two", {"a": [1, 2], "b": ([0, 2], [3, 1])}, x="time (s)", y="way (m)")
    plot = Image.open(tmp_path / "toy.two.png")
    assert plot.mode == "P" and plot.size[0] > 500
    assert capsys.readouterr().out.count(str(tmp_path)) == 5
    args.picture = False
    for call in (studio.movie, studio.picture):
        call(args, [])


def test_a_film_that_ffmpeg_cannot_write(tmp_path, capsys, monkeypatch):
    def write_frames(path, size, **options):
        yield
        raise OSError("[Errno 32] Broken pipe\n\nFFMPEG COMMAND:\n...")

    library = argparse.Namespace(write_frames=write_frames)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", library)
    args = parse(tmp_path, "--movie", "mp4")
    with ends(capsys) as end:
        studio.movie(args, [np.zeros((4, 6, 3), np.uint8)])
    assert end.text == f"toy: cannot write {tmp_path / 'toy.mp4'}: [Errno 32] Broken pipe\n"


def test_colours():
    assert studio.signed([-1, 0, 1]).tolist() == [studio.BLUE, studio.SOFT, studio.RED]
    assert studio.signed(float("nan")) == studio.SOFT and studio.signed(-7) == studio.BLUE
    shades = studio.shades(np.array([[0.0, 5.0], [10.0, np.nan]]), 0, 10)
    assert shades.shape == (2, 2, 3)
    expected = [ti.hex_to_rgb(c) for c in (studio.PAPER, studio.BLUE, studio.INK, studio.PAPER)]
    np.testing.assert_allclose(shades.reshape(4, 3), expected)


def test_settings_are_those_of_the_scene(tmp_path):
    # Settings that differ here do not change the results, or are meant to be changed.
    Toy(parse(tmp_path, "--iterations", 2)).optimise()
    words = ("--resume", "--iterations", 3, "--rate", 0.2, "--no-picture", "--movie", "png")
    assert len(Toy(parse(tmp_path, *words)).optimise()) == 3
    assert isinstance(parse(tmp_path), argparse.Namespace)


def test_programs_with_options_of_their_own(capsys, tmp_path, monkeypatch):
    parser = studio.plain("What it is.")
    parser.add_argument("--n", type=studio.at_least(2, most=9), default=3)
    parser.add_argument("--out", type=Path, default=tmp_path)
    assert parser.parse_args([]).n == 3
    for words, line in (
        (["--n", "1"], "argument --n: 1 is impossible; at least 2"),
        (["--n", "10"], "argument --n: 10 is impossible; at most 9"),
        (["--out", str(tmp_path / "file")], f"--out {tmp_path / 'file'}: cannot write there ("),
    ):
        (tmp_path / "file").write_text("")
        with ends(capsys) as end:
            parser.parse_args(words)
        assert end.text.startswith(f"toy: {line}") and end.text.count("\n") == 1


def test_seeds_that_no_generator_takes(tmp_path, capsys):
    assert parse(tmp_path, "--seed", 2**32 - 1).seed == 2**32 - 1
    with ends(capsys) as end:
        parse(tmp_path, "--seed", 2**32)
    assert "argument --seed: 4294967296 is impossible; at most 4294967295" in end.text


def test_a_descent_that_overflows_says_one_line(tmp_path, capsys, recwarn):
    with ends(capsys) as end:
        Toy(parse(tmp_path, "--rate", 1e200)).optimise()
    assert "is not finite" in end.text and not recwarn.list


def test_zeros_have_no_logarithm(tmp_path, recwarn):
    studio.plot_losses(parse(tmp_path), [0.0, 0.0], log=True)
    assert (tmp_path / "toy.losses.png").is_file() and not recwarn.list
