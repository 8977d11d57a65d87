"""Keeps the table in docs/derivatives.md equal to the one in lib/AD/Rules/ScalarRules.cpp.

python scripts/derivatives.py          checks; exits with 1 and a diff if they differ
python scripts/derivatives.py --fix    rewrites the table in the page
"""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
RULES = ROOT / "lib/AD/Rules/ScalarRules.cpp"
PAGE = ROOT / "docs/derivatives.md"
BEGIN, END = "<!-- table: begin -->\n", "<!-- table: end -->\n"

# {"math.sin", {{0, "g cos x", never, ...}}, "at a kink"},
ROW = re.compile(
    r'^    \{"(?P<op>[\w.]+)", \{(?P<rest>.*?)\},?\n(?=    \{"|\n|  \};|    //)', re.S | re.M
)
PARTIAL = re.compile(r'\{(?P<operand>\d), "(?P<formula>[^"]*)", (?P<guard>\w+),')
KINKS = re.compile(r'\},\s*"(?P<kinks>[^"]*)"$', re.S)
NAMES = "xyz"
GUARDS = {
    "never": "",
    "always": "yes",
    "unlessXPositive": "unless x > 0",
    "unlessXNonNegative": "unless x ≥ 0",
    "unlessXNonPositive": "unless x ≤ 0",
    "unlessYNonZero": "unless y ≠ 0",
    "unlessYAtLeastOne": "unless y ≥ 1",
}


def table(source: str) -> str:
    """The rows of ScalarRules.cpp as a table in Markdown."""
    lines = [
        "| op | contribution | guard | kinks and singular points |",
        "|---|---|---|---|",
    ]
    for row in ROW.finditer(source):
        rest = row["rest"]
        partials = list(PARTIAL.finditer(rest))
        kinks = KINKS.search(rest)
        formulas = "; ".join(
            f"{NAMES[int(p['operand'])]}: {p['formula'].replace('|', chr(92) + '|')}"
            for p in partials
        )
        guards = [GUARDS[p["guard"]] for p in partials]
        if len(set(guards) - {""}) > 1:
            guards = [f"{NAMES[int(p['operand'])]}: {GUARDS[p['guard']]}" for p in partials]
        guards = sorted(set(guards) - {""})
        lines.append(
            f"| `{row['op']}` | {formulas or 'none'} | {'; '.join(guards)} "
            f"| {kinks['kinks'] if kinks else ''} |"
        )
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fix", action="store_true", help="rewrite the table in the page")
    fix = parser.parse_args().fix

    source = RULES.read_text()
    rows = table(source)
    expected_rows = source.count('\n    {"')
    if rows.count("\n") - 2 != expected_rows:
        print(f"{RULES.name} has {expected_rows} rows, of which {rows.count(chr(10)) - 2} parse")
        return 1
    page = PAGE.read_text()
    before, begin, rest = page.partition(BEGIN)
    old, end, after = rest.partition(END)
    if not begin or not end:
        print(f"{PAGE.name} has no marks for the table")
        return 1
    if old == rows:
        return 0
    if fix:
        PAGE.write_text(before + begin + rows + end + after)
        return 0
    sys.stdout.writelines(
        difflib.unified_diff(
            old.splitlines(keepends=True), rows.splitlines(keepends=True), str(PAGE), str(RULES)
        )
    )
    print("run scripts/derivatives.py --fix")
    return 1


if __name__ == "__main__":
    sys.exit(main())
