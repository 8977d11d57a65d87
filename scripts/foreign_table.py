"""Writes the table of docs/reference/differentiable-dialects.md from test/AD/Foreign.

Each function is differentiated in reverse and forward mode, lowered by stock passes, run, and
compared with central differences. `--write` puts the outcomes into the page; without it the page is
compared with them. A wrong derivative is an error either way.
"""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs/reference/differentiable-dialects.md"
CASES = ROOT / "test/AD/Foreign/Inputs"
BEGIN = "<!-- Made by scripts/foreign_table.py --write -->"
END = "<!-- End of the table -->"

sys.path.insert(0, str(CASES))
import check_foreign  # noqa: E402


def describe(outcome: str) -> str:
    """The cell of an outcome: yes, or the reason of a refusal."""
    if outcome == "right":
        return "yes"
    if not outcome.startswith("refused: "):
        raise SystemExit(outcome)
    parts = [
        re.sub(r"^.*?: (?:error|note): ", "", part)
        for part in outcome[len("refused: ") :].split(" | ")
    ]
    helpful = [part for part in parts if part.startswith("run '--")]
    return f"refused; {helpful[0]}" if helpful else "refused"


def make_rows(outcomes: dict[str, dict[str, str]]) -> dict[str, str]:
    """The row of each function, by its name."""
    rows = {}
    for name, modes in outcomes.items():
        first = (CASES / f"{name}.mlir").read_text().splitlines()[0]
        dialect, construct = re.match(r"// Row: (.*?) \| (.*)", first).groups()
        cells = [describe(modes[mode]) for mode in ("reverse", "forward")]
        rows[name] = "| " + " | ".join([dialect, construct, *cells, f"`{name}`"]) + " |"
    return rows


def make_table(rows: dict[str, str]) -> str:
    columns = [row.split(" | ")[2:4] for row in rows.values()]
    reverse, forward = (sum(cell[i] == "yes" for cell in columns) for i in (0, 1))
    said = f"{reverse} of {len(rows)} functions are differentiated in reverse, {forward} forwards."
    order = sorted(rows, key=lambda name: f"{name}.mlir")
    head = ["| dialect | construct | reverse | forward | test |", "|---|---|---|---|---|"]
    return "\n".join([said, "", *head, *(rows[name] for name in order)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--part", default="1/1", help="K/N: run each Nth function only")
    parser.add_argument("--tai-opt", default=str(ROOT / "build/bin/tai-opt"))
    parser.add_argument("--llvm-bin", default="/usr/lib/llvm-22/bin")
    given = parser.parse_args()
    part, parts = map(int, given.part.split("/"))
    files = sorted(CASES.glob("*.mlir"))
    outcomes = check_foreign.run(
        ["--tai-opt", given.tai_opt, "--llvm-bin", given.llvm_bin]
        + [str(path) for path in files[part - 1 :: parts]]
    )
    wrong = [
        f"{name} {mode}: {outcome}"
        for name, modes in outcomes.items()
        for mode, outcome in modes.items()
        if not outcome.startswith(("right", "refused"))
    ]
    if wrong:
        sys.exit("\n".join(wrong))
    text = PAGE.read_text()
    before, rest = text.split(BEGIN)
    old, after = rest.split(END)
    # Rows of functions that did not run are taken from the page.
    rows = {match[1]: match[0] for match in re.finditer(r"^\| .*\| `([\w-]+)` \|$", old, re.M)}
    names = {path.stem for path in files}
    rows = {name: row for name, row in rows.items() if name in names} | make_rows(outcomes)
    made = before + BEGIN + "\n\n" + make_table(rows) + "\n\n" + END + after
    if given.write:
        PAGE.write_text(made)
    elif made != text:
        sys.exit(
            "".join(
                difflib.unified_diff(text.splitlines(True), made.splitlines(True), "page", "tests")
            )
        )
    print("the table is current")


if __name__ == "__main__":
    main()
