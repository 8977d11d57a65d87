"""Draws comments of the C++ and TableGen sources at random, for a reader without the code at hand.

sample_comments.py [--seed N] [--count N]
"""

from __future__ import annotations

import argparse
import random
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COMMENT = re.compile(r"\s*//+ ?(.*)")
# Fragments beside a member say nothing by themselves, and are not drawn.
FEWEST_WORDS = 5


def comments(name: str) -> list[tuple[str, int, str]]:
    """The comments of a source below its header: file, line and text."""
    found = []
    words: list[str] = []
    start = 0
    for number, line in enumerate([*(ROOT / name).read_text().split("\n"), ""], 1):
        match = COMMENT.match(line)
        if match and "===" not in line:
            start = start if words else number
            words.append(match[1])
            continue
        text = " ".join(words).strip()
        if len(text.split()) >= FEWEST_WORDS and "SPDX" not in text:
            found.append((name, start, text))
        words = []
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=34)
    parser.add_argument("--count", type=int, default=40)
    asked = parser.parse_args()
    command = ["git", "ls-files", "lib", "include", "tools"]
    names = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    everything = [
        comment
        for name in sorted(names.split())
        if name.endswith((".cpp", ".h", ".td"))
        for comment in comments(name)
    ]
    for name, line, text in sorted(random.Random(asked.seed).sample(everything, asked.count)):
        print(f"{name}:{line}\n    {text}")


if __name__ == "__main__":
    main()
