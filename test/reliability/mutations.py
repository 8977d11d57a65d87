"""Mutants of MLIR text: small random changes, some of which keep a module valid."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SPLIT = re.compile(r"^// -----.*$", re.MULTILINE)
RUN = re.compile(r"//\s*RUN:.*?tai-opt\s+(?P<options>[^|;&>\n]*)")
TOKEN = re.compile(r'"[^"\n]*"|[%@#!^]?[\w.$]+|->|::|\S')
NUMBER = re.compile(r"(?<![\w%@#!^.])-?\d+(?![\w.])")
TYPE = re.compile(
    r"\b(?:[su]?i\d+|b?f\d+|index|none)\b|(?:memref|vector|tensor)<[^<>\n]*>|![\w.]+(?:<[^<>\n]*>)?"
)
VALUE = re.compile(r"%[\w.$#]+")
SYMBOL = re.compile(r"@[\w.$]+")
OPERATION = re.compile(r"\b[a-z_]+\.[a-z_.]+\b")
TERMINATOR = re.compile(r"^\s*\"?(?:\w+\.)?(?:return|yield|condition|br|cond_br|stop)\b.*$")

NUMBERS = [
    *("0", "1", "-1", "2", "3", "7", "31", "32", "33", "64", "127", "128", "255", "256", "1024"),
    *("65536", "65537", "2147483647", "2147483648", "-2147483648", "4294967296"),
    *("9223372036854775807", "-9223372036854775808", "18446744073709551616", "1" + "0" * 40),
]
TYPES = [
    *("i1", "i8", "i16", "i32", "i64", "i128", "i0", "f16", "bf16", "f32", "f64", "f80", "index"),
    *("none", "vector<3xf32>", "vector<0xf32>", "vector<[4]xf32>", "vector<2x2xf64>"),
    *("memref<f32>", "memref<?xf32>", "memref<0xf32>", "memref<4x?xf64>", "tensor<?xf32>"),
    *("complex<f32>", "tuple<>", "!llvm.ptr", "!tai.root<{}>", "()", "i32, f32"),
]


@dataclass
class Source:
    """A piece of a test file, with what its RUN lines do to it."""

    path: Path
    text: str
    options: list[str]
    # Whether it is there to show an error: most of its mutants get no further.
    invalid: bool


def read_sources(folder: Path) -> list[Source]:
    """The pieces of all .mlir files below a folder."""
    sources = []
    for path in sorted(folder.rglob("*.mlir")):
        text = path.read_text(errors="replace")
        options = [
            " ".join(word for word in match["options"].split() if is_pass(word))
            for match in RUN.finditer(text.replace("\\\n", " "))
        ]
        options = sorted({option for option in options if option})
        for piece in SPLIT.split(text):
            lines = [line for line in piece.splitlines() if not line.lstrip().startswith("//")]
            if any(line.strip() for line in lines):
                source = "\n".join(lines) + "\n"
                sources.append(Source(path, source, options, "expected-error" in piece))
    return sources


def is_pass(word: str) -> bool:
    """Whether a word of a RUN line is a pass that can stand by itself."""
    return bool(re.fullmatch(r"-{1,2}(?:tai|canonicalize|cse|inline|sroa|mem2reg)[\w=,-]*", word))


def replace_match(
    random: random.Random, text: str, pattern: re.Pattern, choose: Callable[[str], str]
) -> str:
    """Replaces one match of a pattern, or all that are equal to it."""
    found = list(pattern.finditer(text))
    if not found:
        return text
    match = random.choice(found)
    new = choose(match.group())
    if random.random() < 0.4:
        return text.replace(match.group(), new)
    return text[: match.start()] + new + text[match.end() :]


def matching_brace(text: str, start: int) -> int:
    """The end of the braces that open at `start`, or -1."""
    depth = 0
    for at in range(start, len(text)):
        depth += {"{": 1, "}": -1}.get(text[at], 0)
        if depth == 0:
            return at + 1
    return -1


class Mutator:
    """Makes mutants of the pieces it was given."""

    def __init__(self, sources: list[Source], seed: int):
        self.sources = sources
        self.random = random.Random(seed)
        self.lines = [line for source in sources for line in source.text.splitlines() if line]
        self.operations = sorted({m for line in self.lines for m in OPERATION.findall(line)})
        self.changes = [
            (3, self.flip_byte),
            (6, self.change_lines),
            (4, self.delete_terminator),
            (4, self.change_region),
            (6, self.empty_block),
            (6, self.splice),
            (4, self.swap_tokens),
            (2, self.delete_tokens),
            (10, self.replace(NUMBER, lambda _: self.random.choice(NUMBERS))),
            (10, self.replace(TYPE, lambda _: self.random.choice(TYPES))),
            (8, self.exchange(VALUE)),
            (6, self.exchange(SYMBOL)),
            (4, self.exchange(TYPE)),
            (4, self.exchange(NUMBER)),
            (3, self.replace(OPERATION, lambda _: self.random.choice(self.operations))),
            (10, self.replace(OPERATION, self.related_operation)),
            (8, self.everywhere(TYPE, lambda _: self.random.choice(TYPES))),
            (6, self.everywhere(NUMBER, lambda _: self.random.choice(NUMBERS))),
            (2, self.replace(TOKEN, lambda _: "")),
        ]

    def mutate(self, text: str) -> str:
        """Applies one to three changes."""
        weights = [weight for weight, _ in self.changes]
        for _ in range(self.random.choice((1, 1, 1, 1, 2, 3))):
            (_, change) = self.random.choices(self.changes, weights)[0]
            text = change(text)
        return SPLIT.sub("", text)

    def replace(self, pattern: re.Pattern, choose: Callable[[str], str]) -> Callable[[str], str]:
        return lambda text: replace_match(self.random, text, pattern, choose)

    def everywhere(self, pattern: re.Pattern, choose: Callable[[str], str]) -> Callable[[str], str]:
        """Replaces something in all of the text, which keeps many modules valid."""

        def change(text: str) -> str:
            found = pattern.findall(text)
            if not found:
                return text
            old, new = self.random.choice(found), choose("")
            return pattern.sub(lambda match: new if match.group() == old else match.group(), text)

        return change

    def related_operation(self, name: str) -> str:
        """An operation of the same dialect, which often has the same form."""
        dialect = name.split(".")[0] + "."
        related = [other for other in self.operations if other.startswith(dialect)]
        return self.random.choice(related or self.operations)

    def exchange(self, pattern: re.Pattern) -> Callable[[str], str]:
        """Puts something that the text holds elsewhere in the place of another."""

        def change(text: str) -> str:
            others = pattern.findall(text)
            return replace_match(self.random, text, pattern, lambda _: self.random.choice(others))

        return change

    def flip_byte(self, text: str) -> str:
        data = bytearray(text.encode())
        at = self.random.randrange(len(data)) if data else 0
        data[at : at + 1] = bytes([self.random.randrange(1, 256)])
        return data.decode("latin-1")

    def change_lines(self, text: str) -> str:
        lines = text.splitlines()
        if not lines:
            return text
        at, to = self.random.randrange(len(lines)), self.random.randrange(len(lines))
        kind = self.random.randrange(4)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(at, lines[at])
        elif kind == 2:
            lines[at], lines[to] = lines[to], lines[at]
        else:
            lines.insert(to, lines[at])
        return "\n".join(lines) + "\n"

    def delete_terminator(self, text: str) -> str:
        lines = text.splitlines()
        found = [i for i, line in enumerate(lines) if TERMINATOR.match(line)]
        if found:
            del lines[self.random.choice(found)]
        return "\n".join(lines) + "\n"

    def change_region(self, text: str) -> str:
        """Empties or doubles a block in braces, or takes the braces away."""
        starts = [i for i, c in enumerate(text) if c == "{"]
        if not starts:
            return text
        start = self.random.choice(starts)
        end = matching_brace(text, start)
        if end < 0:
            return text
        body = text[start:end]
        new = self.random.choice(("{}", "{\n}", "", body + body, "{\n^bb0:\n}", body[1:-1]))
        return text[:start] + new + text[end:]

    def empty_block(self, text: str) -> str:
        """In the generic form: takes the operations of a region away, all or from some line on."""
        starts = [match.start() + 1 for match in re.finditer(r"\(\{", text)]
        if not starts:
            return self.change_region(text)
        start = self.random.choice(starts)
        end = matching_brace(text, start)
        lines = text[start:end].splitlines()
        if end < 0 or len(lines) < 3:
            return text
        kept = 2 if lines[1].lstrip().startswith("^") else 1
        if self.random.random() < 0.5:
            kept = self.random.randrange(kept, len(lines))
        return text[:start] + "\n".join([*lines[:kept], lines[-1]]) + text[end:]

    def splice(self, text: str) -> str:
        """Puts lines of another file in."""
        lines = text.splitlines()
        for _ in range(self.random.choice((1, 1, 2, 4))):
            lines.insert(self.random.randrange(len(lines) + 1), self.random.choice(self.lines))
        return "\n".join(lines) + "\n"

    def swap_tokens(self, text: str) -> str:
        found = list(TOKEN.finditer(text))
        if len(found) < 2:
            return text
        one, two = sorted(self.random.sample(found, 2), key=lambda match: match.start())
        return (
            text[: one.start()]
            + two.group()
            + text[one.end() : two.start()]
            + one.group()
            + text[two.end() :]
        )

    def delete_tokens(self, text: str) -> str:
        found = list(TOKEN.finditer(text))
        if not found:
            return text
        at = self.random.randrange(len(found))
        last = found[min(at + self.random.randrange(5), len(found) - 1)]
        return text[: found[at].start()] + text[last.end() :]
