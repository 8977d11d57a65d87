"""Draws comments at random, to be judged by a reader who does not have the code at hand.

    sample_comments.py --seed 7               40 comments of the sources, tests and scripts
    sample_comments.py --seed 7 --count 10 lib/AD

The same seed gives the same comments as long as the texts of the named folders stay as they are.
"""

from __future__ import annotations

import argparse
import ast
import random
import sys
import textwrap
from collections.abc import Iterator

import prose

FOLDERS = ("lib", "include", "python", "test")
# Licence texts, and lines for tools.
NOT_JUDGED = (
    "Licensed under",
    "SPDX-License-Identifier",
    "NOLINT",
    "noqa",
    "fmt:",
    "type:",
    "ruff:",
)


def paragraphs(name: str, text: str) -> Iterator[str]:
    """Comments, and the first paragraphs of docstrings; other strings are no comments."""
    if not name.endswith(".py"):
        yield from prose.paragraphs(name, text)
        return
    yield from prose.comments(text, "#")
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            if string := ast.get_docstring(node):
                yield " ".join(string.split("\n\n")[0].split())


def candidates(folders: tuple[str, ...], texts: dict[str, str]) -> list[tuple[str, str]]:
    """The comments and docstrings of at least a sentence, each with its file."""
    prefixes = tuple(f"{folder.rstrip('/')}/" for folder in folders)
    return [
        (name, paragraph)
        for name, text in texts.items()
        if name.startswith(prefixes) and not name.endswith(".md")
        for paragraph in paragraphs(name, text)
        if any(prose.sentences(paragraph)) and not paragraph.startswith(NOT_JUDGED)
    ]


def draw(seed: int, count: int, found: list[tuple[str, str]]) -> list[tuple[str, str]]:
    return random.Random(seed).sample(found, min(count, len(found)))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", nargs="*", default=FOLDERS, help="lib include python test")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=40)
    asked = parser.parse_args()
    found = candidates(tuple(asked.folders), prose.tracked())
    drawn = draw(asked.seed, asked.count, found)
    print(f"{len(drawn)} of {len(found)} comments, seed {asked.seed}")
    for number, (name, paragraph) in enumerate(drawn, 1):
        print(f"\n{number}. {name}")
        print(textwrap.fill(paragraph, 100, initial_indent="   ", subsequent_indent="   "))
    return 0


if __name__ == "__main__":
    sys.exit(main())
