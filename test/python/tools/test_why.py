"""The figures of the page that compares tai with peers are those of the kept results."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PAGE = (ROOT / "docs" / "start" / "why.md").read_text()
RESULTS = ROOT / "benchmarks" / "results"


def cells(text: str, first: str) -> list[str]:
    row = next(line for line in text.splitlines() if line.startswith(f"| {first} |"))
    return [cell.strip(" *") for cell in row.strip("|").split("|")]


def test_times():
    for title, name in (("CPU", "programs-epyc-2-cores.md"), ("H200", "programs-h200.md")):
        kept = (RESULTS / name).read_text()
        table = PAGE.split(f"| program, {title} |", 1)[1].split("\n\n", 1)[0]
        rows = [line for line in table.splitlines()[2:] if line]
        assert len(rows) == 4
        for row in rows:
            shown = [cell.strip(" *") for cell in row.strip("|").split("|")]
            there = cells(kept, shown[0])
            assert set(filter(None, shown[1:])) <= set(there), shown


def test_gradients():
    sums = cells((ROOT / "docs/reports/gradients-compared.md").read_text(), "**sum**")[1:]
    right = [int(re.search(r"(\d+) right", text)[1]) for text in sums]
    wrong = [int(m[1]) if (m := re.search(r"(\d+) wrong", text)) else 0 for text in sums]
    title = "gradients of 33 programs that are right"
    row = next(line for line in PAGE.splitlines() if line.startswith(f"| {title}"))
    assert list(map(int, re.findall(r"\| (\d+)\b", row))) == right
    assert list(map(int, cells(PAGE, "of these, wrong without a word")[1:])) == wrong


def test_floors():
    kept = (RESULTS / "gpu-h200.md").read_text()
    for scene, times in (("mass_spring", "1.871"), ("smoke", "1.803")):
        assert f"| {scene} | ours / that floor | {times} times |" in kept
        assert f"{times} times" in PAGE
