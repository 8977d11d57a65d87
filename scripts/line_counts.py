"""Counts the lines of the simulators in examples/, as the tables of the paper do.

    python scripts/line_counts.py
    python scripts/line_counts.py --show smoke

`examples/paper/lines.py` defines which lines are essential.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "python"), str(ROOT / "examples")]

from paper.lines import PAPER, code_lines, counts, essential  # noqa: E402

__all__ = ["code_lines", "essential"]
EXAMPLES = ROOT / "examples"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--show", metavar="NAME", help="the essential lines of one example")
    args = parser.parse_args()
    if args.show:
        path = EXAMPLES / f"{args.show}.py"
        if not path.is_file():
            parser.error(f"there is no {path}")
        source = path.read_text()
        lines = source.splitlines()
        print("\n".join(lines[number - 1] for number in sorted(essential(source))))
        return
    print("| example | essential | in the paper | code |\n|---|---|---|---|")
    for name, count, code in counts(EXAMPLES):
        print(f"| {name} | {count} | {PAPER.get(name, '')} | {code} |")


if __name__ == "__main__":
    main()
