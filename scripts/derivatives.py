"""Keeps docs/reference/derivatives.md equal to the rules in lib/AD/Rules.

The table of scalar ops is made from ScalarRules.cpp, the formulas of matrix ops from the comments
in MatrixModels.cpp. Every op with a rule, and every kind of atomic, is on the page.

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
MATRICES = ROOT / "lib/AD/Rules/MatrixModels.cpp"
ATTRIBUTES = ROOT / "include/tai/Dialect/Tai/IR/TaiAttrs.td"
DIALECT = ROOT / "include/tai/Dialect/Tai/IR"
PAGE = ROOT / "docs/reference/derivatives.md"
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


# /// R = A B:  A* += G Bᵀ,  B* += Aᵀ G.
# struct MatmulModel : MatrixModel<MatmulModel, MatmulOp> {
FORMULA = re.compile(
    r"^/// (?P<value>[^\n]*?):  (?P<adjoints>[^\n]*)\.\n"
    r"struct \w+ : MatrixModel<\w+, (?P<op>\w+)Op>",
    re.M,
)
ATTACHED = re.compile(r"(?:(?P<dialect>\w+)::)?(?P<op>\w+)Op::attachInterface<")
DEFINED = re.compile(r'def Tai_(?P<op>\w+)Op : \w+<"(?P<mnemonic>\w+)"')
ATOMIC_KIND = re.compile(r"def Tai_AtomicKind .*?\]>", re.S)
UPSTREAM = {"AtomicRMW": "atomic_rmw", "For": "for", "If": "if", "While": "while"}


def snake(name: str) -> str:
    return UPSTREAM.get(name, re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())


def missing(page: str) -> list[str]:
    """Differences between the rules and the page."""
    problems = []
    mnemonics = {}
    for file in sorted(DIALECT.glob("*.td")):
        for match in DEFINED.finditer(file.read_text()):
            mnemonics[match["op"]] = match["mnemonic"]
    formulas = list(FORMULA.finditer(MATRICES.read_text()))
    if len(formulas) != MATRICES.read_text().count(" : MatrixModel<"):
        problems.append(f"a rule in {MATRICES.name} has no line '/// value:  adjoints.'")
    for match in formulas:
        row = f"| `tai.{mnemonics[match['op']]}` | {match['value']} | {match['adjoints']} |"
        if row not in page:
            problems.append(f"no row '{row}'")
    for file in sorted(RULES.parent.glob("*Models.cpp")):
        for match in ATTACHED.finditer(file.read_text()):
            if match["dialect"]:
                name = f"{match['dialect']}.{snake(match['op'])}"
            elif match["op"] in mnemonics:
                name = f"tai.{mnemonics[match['op']]}"
            else:
                continue  # a type parameter
            if f"`{name}" not in page:
                problems.append(f"no `{name}`, which has a rule in {file.name}")
    atomics = page.partition("## Accesses and control flow")[2]
    for kind in re.findall(r'"(\w+)">', ATOMIC_KIND.search(ATTRIBUTES.read_text())[0]):
        if not re.search(rf"`(tai\.atomic )?{kind}`", atomics):
            problems.append(f"no atomic `{kind}`")
    return problems


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
    problems = missing(page)
    for problem in problems:
        print(f"{PAGE.name} has {problem}")
    if old == rows:
        return 1 if problems else 0
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
