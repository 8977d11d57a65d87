"""Checks the prose of comments, docstrings and pages: sentences begin with a noun or a verb.

Two densities are counted per room, each per 1,000 sentences: `opening` counts sentences that
begin with a pronoun or a question word ("Those", "Of", "What"), `clause` counts clauses with "what"
that stand for a noun. A room passes if it is below both of `BARS`.

    prose.py                  print the rooms and their densities
    prose.py --list ROOM      print the offending sentences of a room (or of a file)
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# Highest density of openings and of clauses that a room may have.
BARS = (8.0, 6.0)

OPENERS = "What Who Whose Whoever Those Of None Nobody Which".split()
AS_OPENERS = "many much long far often soon".split()
AFTER_WHAT = (
    "is are was were has have had do does did can may must would needs? goes comes? lies? stands? "
    "remains? it they he she one a an the this that these those each"
).split()
OPENING = re.compile(rf"(?:{'|'.join(OPENERS)}|As (?:{'|'.join(AS_OPENERS)})|Where there)\b")
CLAUSE = re.compile(rf"\bwhat (?:{'|'.join(AFTER_WHAT)})\b", re.IGNORECASE)

QUOTES = '"' * 3
COMMENT_MARKS = dict.fromkeys((".cpp", ".h", ".td", ".cu", ".c", ".def", ".inc"), "//")
COMMENT_MARKS[".py"] = "#"
# Comments that are read by tools, which end a paragraph.
DIRECTIVES = ("RUN:", "CHECK", "clang-format", "===", "---", "-*-", "expected-")
# Folders of results and of copies, which hold no prose of the project.
NOT_READ = {"build", "out", "dist", "node_modules", "results"}
# Rooms with fewer sentences than this are counted together.
FEWEST = 40
SMALL_ROOMS = "other"
# Shorter fragments are headings and labels.
FEWEST_WORDS = 4


@dataclass
class Room:
    """Sentences of a room: their number, and the offenders as (file, sentence)."""

    sentences: int = 0
    openings: list[tuple[str, str]] = field(default_factory=list)
    clauses: list[tuple[str, str]] = field(default_factory=list)

    def add(self, other: Room) -> None:
        self.sentences += other.sentences
        self.openings += other.openings
        self.clauses += other.clauses

    def counts(self) -> tuple[int, int]:
        return len(self.openings), len(self.clauses)

    def densities(self) -> tuple[float, float]:
        openings, clauses = self.counts()
        per = 1000 / max(self.sentences, 1)
        return openings * per, clauses * per

    def passes(self) -> bool:
        return all(density <= bar for density, bar in zip(self.densities(), BARS))


def comment_text(line: str) -> str:
    """The words of a comment line; "" for rulers and for lines that tools read."""
    words = line.lstrip("/!#<").strip()
    is_ruler = not words.strip("=-*/ ")
    return "" if is_ruler or words.startswith(DIRECTIVES) else words


def comments(text: str, mark: str) -> Iterator[str]:
    """Paragraphs of the comments: adjacent whole-line comments, and comments behind code."""
    paragraph: list[str] = []
    for line in map(str.strip, text.splitlines()):
        if line.startswith(mark) and (words := comment_text(line)):
            paragraph.append(words)
            continue
        if paragraph:
            yield " ".join(paragraph)
            paragraph = []
        code, found, behind = line.partition(mark)
        # A mark in front of a quotation mark may be part of a string.
        if found and code and '"' not in behind:
            yield behind.lstrip("/!#<").strip()
    if paragraph:
        yield " ".join(paragraph)


def docstrings(text: str) -> Iterator[str]:
    """Paragraphs of the strings in three quotation marks, without examples and lists of options."""
    for string in text.split(QUOTES)[1::2]:
        for paragraph in re.split(r"\n\s*\n", string):
            if not re.search(r"^\s*(?:>>>|\$|--)", paragraph, re.M):
                yield " ".join(paragraph.split())


def page(text: str) -> Iterator[str]:
    """Paragraphs and list items of a page in Markdown, without code, tables and headings."""
    text = re.sub(r"```.*?```", "", text, flags=re.S)
    for paragraph in re.split(r"\n\s*\n|\n(?=[-*] )", text):
        if paragraph.lstrip().startswith(("|", "#", "<", "!")):
            continue
        paragraph = re.sub(r"^[-*] ", "", paragraph)
        yield " ".join(re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", paragraph).split())


def paragraphs(name: str, text: str) -> Iterator[str]:
    suffix = Path(name).suffix
    if suffix == ".md":
        yield from page(text)
    if mark := COMMENT_MARKS.get(suffix):
        yield from comments(text, mark)
    if suffix == ".py":
        yield from docstrings(text)


def sentences(paragraph: str) -> Iterator[str]:
    for sentence in re.split(r'(?<=[.!?])\s+(?=[A-Z`"(])', paragraph):
        if len(sentence.split()) >= FEWEST_WORDS:
            yield sentence


def room_of(name: str) -> str:
    """The folder that a file is counted with; all pages are one room."""
    if name.endswith(".md"):
        return "pages"
    folders = name.split("/")[:-1]
    depth = 2
    if len(folders) > 1 and folders[0] in ("lib", "include"):
        depth = 4 if folders[:2] == ["include", "tai"] else 3
    elif len(folders) > 2 and folders[0] == "python":
        depth = 4
    return "/".join(folders[:depth]) or "."


def read_room(name: str, text: str) -> Room:
    """The sentences of one file."""
    room = Room()
    for paragraph in paragraphs(name, text):
        for sentence in sentences(paragraph):
            room.sentences += 1
            if OPENING.match(sentence):
                room.openings.append((name, sentence))
            if CLAUSE.search(sentence):
                room.clauses.append((name, sentence))
    return room


def read_tree(texts: dict[str, str]) -> dict[str, Room]:
    """Rooms by name; those with few sentences are gathered in one."""
    found: dict[str, Room] = defaultdict(Room)
    for name, text in texts.items():
        found[room_of(name)].add(read_room(name, text))
    rooms: dict[str, Room] = defaultdict(Room)
    for name, room in found.items():
        if room.sentences:
            rooms[name if room.sentences >= FEWEST else SMALL_ROOMS].add(room)
    return dict(rooms)


def has_header(name: str, text: str) -> bool:
    """Whether a source begins with a comment (or a docstring) on its contents."""
    if not text.strip():
        return True
    if name.endswith(".py"):
        text = text.removeprefix("#!/usr/bin/env python3").lstrip()
        return text.startswith((QUOTES, "r" + QUOTES, "# "))
    ruler = re.match(r"//===-+ \S+ -+ (.*?)-*(?:\*- C\+\+ -\*-)?-*===//", text)
    if ruler and ruler[1].strip():
        return True
    comment = re.match(r"/\*.*?\*/|(?://.*\n)+", text, re.S if text.startswith("/*") else 0)
    return bool(comment) and any(map(comment_text, comment[0].splitlines()))


def tracked() -> dict[str, str]:
    """Texts of the sources and pages of the checkout, by name."""
    suffixes = [*COMMENT_MARKS, ".md"]
    command = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "--"]
    command += [f"*{suffix}" for suffix in suffixes]
    output = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return {
        name: (ROOT / name).read_text(errors="replace")
        for name in sorted(set(output.splitlines()))
        if not NOT_READ.intersection(name.split("/")[:-1]) and (ROOT / name).is_file()
    }


def problems(rooms: dict[str, Room]) -> list[str]:
    """Rooms above the bars."""
    bars = f"at most {BARS[0]:g} and {BARS[1]:g}"
    found = []
    for name, room in sorted(rooms.items()):
        if not room.passes():
            opening, clause = room.densities()
            found.append(
                f"{name}: {opening:.1f} openings and {clause:.1f} clauses per 1,000 sentences, "
                f"{bars}: rewrite some that `scripts/prose.py --list {name}` prints"
            )
    return found


def check() -> list[str]:
    texts = tracked()
    without = [
        f"{name}: begins without a comment on its contents (one to five lines)"
        for name, text in texts.items()
        if not name.endswith(".md") and not has_header(name, text)
    ]
    return problems(read_tree(texts)) + without


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--list", metavar="ROOM", help="print the offending sentences")
    asked = parser.parse_args()
    texts = tracked()
    rooms = read_tree(texts)
    if asked.list:
        if asked.list in texts:
            rooms[asked.list] = read_room(asked.list, texts[asked.list])
        if asked.list not in rooms:
            print(f"prose: no room or file {asked.list!r}; the rooms are printed without --list")
            return 1
        room = rooms[asked.list]
        for name, sentence in dict.fromkeys(room.openings + room.clauses):
            print(f"{name}: {sentence}")
    else:
        for name, room in sorted(rooms.items(), key=lambda item: -sum(item[1].densities())):
            opening, clause = room.densities()
            verdict = "" if room.passes() else "  above"
            print(f"{name:36} {room.sentences:6} {opening:6.1f} {clause:6.1f}{verdict}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
