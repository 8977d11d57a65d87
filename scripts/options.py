"""Generates files from include/tai/Support/Options.def, and checks that they are up to date.

These are the table of docs/reference/options.md, and the rows that define the keywords of
`ti.init`.

python scripts/options.py          checks; exits with 1 and a diff if they differ
python scripts/options.py --fix    rewrites them
"""

from __future__ import annotations

import argparse
import ast
import difflib
import json
import re
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "include/tai/Support/Options.def"
PAGE = ROOT / "docs/reference/options.md"
PYTHON = ROOT / "python/tai/_impl/base/option_rows.py"
BEGIN, END = "<!-- table: begin (scripts/options.py --fix) -->\n", "<!-- table: end -->\n"

STRINGS = r'((?:"(?:[^"\\]|\\.)*"\s*)+)'
ROW = re.compile(
    rf"^TAI_OPTION\({STRINGS},\s*(\w+),\s*{STRINGS},\s*{STRINGS},\s*{STRINGS},\s*\w+\((?:\w+\(\)\.)?\w+\)\)",
    re.M,
)


class Row(NamedTuple):
    """An option of users: name, kind, initial text, expected values and purpose."""

    name: str
    kind: str
    initial: str
    expects: str
    about: str


def rows(source: str) -> list[Row]:
    """The options in a table."""
    found = []
    for name, kind, *texts in ROW.findall(source):
        name, *texts = (ast.literal_eval(f"({text})") for text in (name, *texts))
        found.append(Row(name, kind, *texts))
    if len(found) != len(re.findall(r"^TAI_OPTION\(", source, re.M)):
        raise SystemExit(f"{TABLE.name}: not every row could be read")
    return found


def table(source: str) -> str:
    lines = ["| option | unless set | expects | what it is for |", "|---|---|---|---|"]
    for row in rows(source):
        initial = f"`{row.initial}`" if row.initial else ""
        lines.append(f"| `{row.name}` | {initial} | {row.expects} | {row.about} |")
    return "\n".join(lines) + "\n"


def page(source: str, old: str) -> str:
    """The page with the table of the sources."""
    head, rest = old.split(BEGIN)
    return head + BEGIN + table(source) + END + rest.split(END)[1]


def module(source: str) -> str:
    """The rows as a module of the package: it needs neither the sources nor the library."""
    lines = [
        '"""The options of a context, made of Options.def by scripts/options.py --fix.',
        "",
        "A row holds the name, the kind, the initial text, the expected values and the purpose.",
        '"""',
        "",
        "# ruff: noqa: E501",
        "# fmt: off",
        "Row = tuple[str, str, str, str, str]",
        "ROWS: tuple[Row, ...] = (",
        *(f"    ({', '.join(map(quoted, row))})," for row in rows(source)),
        ")",
    ]
    return "\n".join(lines) + "\n"


def quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fix", action="store_true", help="rewrite what differs")
    fix = parser.parse_args().fix
    source = TABLE.read_text()
    wanted = {PAGE: page(source, PAGE.read_text()), PYTHON: module(source)}
    differ = False
    for path, text in wanted.items():
        old = path.read_text() if path.exists() else ""
        if old == text:
            continue
        if fix:
            path.write_text(text)
            continue
        differ = True
        names = str(path.relative_to(ROOT)), TABLE.name
        print("\n".join(difflib.unified_diff(old.splitlines(), text.splitlines(), *names)))
    if differ:
        print("run scripts/options.py --fix")
    return differ


if __name__ == "__main__":
    sys.exit(main())
