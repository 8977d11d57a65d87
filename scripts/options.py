"""Keeps docs/options.md equal to include/tai/Support/Options.def.

python scripts/options.py          checks; exits with 1 and a diff if they differ
python scripts/options.py --fix    rewrites the table in the page
"""

from __future__ import annotations

import argparse
import ast
import difflib
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TABLE = ROOT / "include/tai/Support/Options.def"
PAGE = ROOT / "docs/options.md"
BEGIN, END = "<!-- table: begin (scripts/options.py --fix) -->\n", "<!-- table: end -->\n"

STRINGS = r'((?:"(?:[^"\\]|\\.)*"\s*)+)'
ROW = re.compile(
    rf"^TAI_OPTION\((\w+),\s*{STRINGS},\s*(\w+),\s*{STRINGS},\s*{STRINGS},\s*{STRINGS}\)",
    re.M,
)


def rows(source: str) -> list[tuple[str, str, str, str]]:
    """Name, initial text, what is expected and what it is for, of each option."""
    text = [
        ast.literal_eval(f"({part})")
        for row in ROW.findall(source)
        for part in row[1:]
        if part.startswith('"')
    ]
    found = [tuple(text[i : i + 4]) for i in range(0, len(text), 4)]
    if len(found) != len(re.findall(r"^TAI_OPTION\(", source, re.M)):
        raise SystemExit(f"{TABLE.name}: not every row could be read")
    return found


def table(source: str) -> str:
    lines = ["| option | unless set | expects | what it is for |", "|---|---|---|---|"]
    for name, initial, expects, about in rows(source):
        lines.append(f"| `{name}` | {f'`{initial}`' if initial else ''} | {expects} | {about} |")
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fix", action="store_true", help="rewrite the table")
    fix = parser.parse_args().fix
    page = PAGE.read_text()
    head, rest = page.split(BEGIN)
    wanted = head + BEGIN + table(TABLE.read_text()) + END + rest.split(END)[1]
    if wanted == page:
        return 0
    if fix:
        PAGE.write_text(wanted)
        return 0
    difference = difflib.unified_diff(page.splitlines(), wanted.splitlines(), "page", "table")
    print("\n".join(difference))
    print("run scripts/options.py --fix")
    return 1


if __name__ == "__main__":
    sys.exit(main())
