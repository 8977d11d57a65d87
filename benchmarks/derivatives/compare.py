"""Runs small programs with known gradients on tai and its peers, and writes their results.

    benchmarks/setup_peers.py                          # once: peers into build/peers-venv
    .venv/bin/python benchmarks/derivatives/compare.py --write

Each snippet runs in a process of its own, since some of them end in a crash. The numbers are
compared with closed forms, at 1e-9. Results of a version of a peer are cached in
build/derivatives. `--write` puts the table into docs/reports/gradients-compared.md;
the exit status is 1 if tai is wrong anywhere.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs/reports/gradients-compared.md"
TOLERANCE = 1e-9
TIMEOUT = 120

PEERS = {
    "tai": ["snippets_taichi.py", "tai"],
    "taichi": ["snippets_taichi.py", "taichi"],
    "warp": ["snippets_warp.py"],
    "jax": ["snippets_jax.py"],
}
PACKAGES = {"taichi": "taichi", "warp": "warp-lang", "jax": "jax"}


def power(n: int, *points: float) -> list[float]:
    return [n * x ** (n - 1) for x in points]


def rotated() -> list[float]:
    """v' = (1 + 0.1 i x) v as complex numbers, 40 times."""
    z = 1 + 0.03j
    return [(40 * 0.1j * z**39 * (1 + 0.5j)).real]


def rolled_out() -> list[float]:
    """Tangents of the rollout, along each of its two starts."""
    slopes = []
    for dx, dv in ((1.0, 0.0), (0.0, 1.0)):
        x, v = 1.0, 0.5
        for _ in range(20):
            v, dv = v - 0.1 * x**3, dv - 0.3 * x**2 * dx
            x, dx = x + 0.1 * v, dx + 0.1 * dv
        slopes.append(dx)
    return slopes


def gathered() -> list[float]:
    x, p, slopes = (1.0, 2.0, 3.0, 4.0), (3, 1, 3, 0), [0.0] * 4
    for i in range(4):
        other, factor = (i + p[i]) % 4, (2 * p[i] + 1) * (i % 2 + 1)
        slopes[i] += factor * x[other]
        slopes[other] += factor * x[i]
    return slopes


@dataclass
class Snippet:
    """A function of the snippet files, its title, and its gradient."""

    name: str
    title: str
    expected: list[float]


SNIPPETS = [
    Snippet("loop_30", "loop of 30 trips with a carried value", power(30, 1.01, 0.99)),
    Snippet("loop_31", "31 trips", power(31, 1.01, 0.99)),
    Snippet("loop_100", "100 trips", power(100, 1.01, 0.99)),
    Snippet("loop_5000", "5000 trips", power(5000, 1.01, 0.99)),
    Snippet("loop_of_field_length", "trips read from a field", power(40, 1.01) + power(7, 0.99)),
    Snippet("loop_carrying_a_vector", "loop that carries a vector", rotated()),
    Snippet("statement_before_an_inner_loop", "values made between inner loops", [117.0]),
    Snippet("while_loop", "`while` that the data ends", [1024.0]),
    Snippet("break_in_a_loop", "`break`", [5120.0]),
    Snippet("continue_in_a_loop", "`continue`", [12.0]),
    Snippet("early_return", "early `return`", [16.0]),
    Snippet("stored_twice", "element stored twice in a kernel", [27.0]),
    Snippet("scaled_in_place", "`y[i] *= x[i]`", [12.0]),
    Snippet("square_added_in_place", "`x[i] += x[i] * x[i]`", [7.0]),
    Snippet("swap", "swap of two elements", [60.0, 1.0]),
    Snippet("recurrence_along_an_axis", "`a[j + 1] = a[j] * x[j]`", [15.0, 10.0, 6.0]),
    Snippet("rollout_in_place", "20 steps in place, no time axis", rolled_out()),
    Snippet("masked_root", "`select(x > 0, sqrt(x), 0)` at -1", [0.0, 0.25]),
    Snippet("untaken_branch", "`if x > 0: y = sqrt(x)` at -1", [0.0, 0.25]),
    Snippet("saturated_sigmoid", "`1 / (1 + exp(-x))` at -800", [0.0]),
    Snippet("atomic_product", "`atomic_mul`", [15.0, 10.0, 6.0]),
    Snippet("atomic_maximum", "`atomic_max`", [0.0, 14.0, 0.0]),
    Snippet("old_value_of_an_atomic", "old value of an `atomic_add`", [2.0]),
    Snippet("gather_and_scatter", "scatter to `y[p[i] * 2, i % 2]`", gathered()),
    Snippet("index_into_a_local_vector", "index of a local vector from a field", [12.0, 14.0]),
    Snippet("norm_of_zero", "norm at 0", [0.0] * 3),
    Snippet("norm_of_a_tiny_vector", "norm of (1e-200, 0, 0)", [1.0, 0.0, 0.0]),
    Snippet("tangent", "`tan`", [1 + math.tan(0.3) ** 2]),
    Snippet("polar_3d", "3-D rotation of F = I", [0, 0.5, 0, -0.5, 0, 0, 0, 0, 0]),
    Snippet("svd_product", "U S Vᵀ at equal singular values", [1.0, 2.0, 3.0, 4.0]),
    Snippet("random_numbers", "random numbers, drawn again", [1.0]),
    Snippet("returned_value", "gradient of a kernel's result", [6.0]),
    Snippet("second_order", "second derivative, forward over reverse", [48.0]),
]


def shorten(number: float | None) -> str:
    return "nan" if number is None else f"{number:.6g}"


def judge(snippet: Snippet, done: subprocess.CompletedProcess) -> tuple[str, str]:
    """The outcome of a run, and a remark."""
    for line in done.stdout.splitlines():
        if line == "NOTHING":
            return "—", ""
        if line.startswith("GRADIENT "):
            found = json.loads(line.removeprefix("GRADIENT "))
            good = len(found) == len(snippet.expected) and all(
                f is not None and math.isclose(f, e, rel_tol=TOLERANCE, abs_tol=1e-12)
                for f, e in zip(found, snippet.expected, strict=True)
            )
            if good:
                return "right", ""
            shown = ", ".join(map(shorten, found))
            return "wrong", f"{shown} instead of {', '.join(map(shorten, snippet.expected))}"
    if done.returncode < 0 or done.returncode >= 128:
        return "crash", f"signal {-done.returncode if done.returncode < 0 else done.returncode}"
    errors = re.findall(r"^[\w.]*(?:Error|Exception)\b[^\n]*", done.stderr, re.M)
    lines = [line for line in done.stderr.splitlines() if line.strip()]
    return "refused", (errors or lines or [""])[-1].strip()[:160]


def run(python: Path, peer: str, snippet: Snippet) -> tuple[str, str]:
    script, *arguments = PEERS[peer]
    command = [str(python), str(HERE / script), *arguments, snippet.name]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=TIMEOUT, cwd=HERE, errors="replace"
        )
    except subprocess.TimeoutExpired:
        return "crash", f"not done after {TIMEOUT} s"
    return judge(snippet, done)


def version(python: Path, peer: str) -> str | None:
    """The version of a peer, or None where it is not installed."""
    if peer == "tai":
        return "this tree"
    code = f"from importlib.metadata import version; print(version({PACKAGES[peer]!r}))"
    done = subprocess.run([str(python), "-c", code], capture_output=True, text=True)
    return done.stdout.strip() if done.returncode == 0 else None


def page(results: dict[str, dict[str, tuple[str, str]]], versions: dict[str, str]) -> str:
    """The page of the documentation."""
    peers = list(versions)
    lines = [
        "# Gradients compared",
        "",
        "The same small programs in tai and in others, each against the closed form of its",
        "gradient. Written by `benchmarks/derivatives/compare.py`; do not edit.",
        "",
        "*right*: within 1e-9. *wrong*: a number, without a word, that is not the gradient.",
        "*refused*: an error. *crash*: the process died. *—*: the peer has no such thing.",
        "jax has no fields: where others overwrite, it makes new arrays.",
        "",
        "| program | " + " | ".join(f"{p} {versions[p]}" for p in peers) + " |",
        "|---|" + "---|" * len(peers),
    ]
    for snippet in SNIPPETS:
        verdicts = [results[peer][snippet.name][0] for peer in peers]
        shown = [f"**{v}**" if v in ("wrong", "crash") else v for v in verdicts]
        lines.append(f"| {snippet.title} | " + " | ".join(shown) + " |")
    counts = []
    for peer in peers:
        verdicts = [verdict for verdict, _ in results[peer].values()]
        counts.append(
            ", ".join(
                f"{verdicts.count(kind)} {kind}"
                for kind in ("right", "refused", "wrong", "crash")
                if verdicts.count(kind)
            )
        )
    lines += ["| **sum** | " + " | ".join(counts) + " |", "", "What was wrong or refused:", ""]
    for peer in peers:
        for snippet in SNIPPETS:
            verdict, remark = results[peer][snippet.name]
            if verdict not in ("right", "—"):
                remark = remark.replace("|", "\\|").replace(str(ROOT), ".")
                lines.append(
                    f"- {peer}, {snippet.title}: {verdict}" + (f": `{remark}`" * bool(remark))
                )
    return "\n".join(lines + in_a_simulator()) + "\n"


def in_a_simulator() -> list[str]:
    """The effect of an overwritten state in a program of the DiffTaichi paper."""
    program = "examples/electric.py"
    options = ["--controller", "published", "--double", "--check"]
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(ROOT / program), *options, "--no-picture", "--out", folder]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
    return [
        "",
        "## In a whole simulator",
        "",
        "In the paper's program *electric* a network reads the slot of a time before that slot is",
        "computed: it sees the state that the run before has left there. A later kernel overwrites",
        "the slot. Taichi goes back through the network with what the slot holds at the end, tai",
        "with what the network saw. `--gradient reread` goes back as Taichi does, and gives the",
        "numbers measured on Taichi to all digits. Along one random direction of all weights, f64:",
        "",
        f"    python {program} {' '.join(options)}",
        "",
        *(f"    {line}" for line in done.stdout.splitlines()),
    ]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    parser.add_argument("--peers", nargs="*", default=list(PEERS), choices=list(PEERS))
    parser.add_argument("--only", nargs="*", help="names of snippets")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--peers-python", type=Path, default=ROOT / "build/peers-venv/bin/python")
    options = parser.parse_args()

    snippets = [s for s in SNIPPETS if not options.only or s.name in options.only]
    results, versions = {}, {}
    for peer in options.peers:
        python = Path(sys.executable) if peer == "tai" else options.peers_python
        found = version(python, peer) if python.exists() else None
        if found is None:
            print(f"{peer}: not installed")
            continue
        versions[peer] = found
        kept = ROOT / f"build/derivatives/{peer}-{found}.json"
        known = json.loads(kept.read_text()) if peer != "tai" and kept.exists() else {}

        def one(snippet: Snippet, peer=peer, python=python, known=known) -> tuple[str, str]:
            verdict = known.get(snippet.name) or run(python, peer, snippet)
            print(f"{peer:7} {snippet.name:32} {verdict[0]:8} {verdict[1]}", flush=True)
            return tuple(verdict)

        with ThreadPoolExecutor(options.jobs) as pool:
            verdicts = list(pool.map(one, snippets))
        results[peer] = {s.name: v for s, v in zip(snippets, verdicts, strict=True)}
        kept.parent.mkdir(parents=True, exist_ok=True)
        kept.write_text(json.dumps({**known, **results[peer]}))
    if options.write and not options.only:
        PAGE.write_text(page(results, versions))
    bad = [n for n, (verdict, _) in results.get("tai", {}).items() if verdict in ("wrong", "crash")]
    if bad:
        print(f"tai is wrong: {', '.join(bad)}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
