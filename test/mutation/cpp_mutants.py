"""Mutants of C++ sources, all in one build: an environment variable says which one is on.

libclang finds the expressions, and text is inserted around them. A mutant costs no build of its
own, and the build can say which mutants a test reaches.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

LIBCLANG = os.environ.get("TAI_LIBCLANG", "/usr/lib/llvm-22/lib/libclang-22.so.1")

HEADER = """\
// Which mutant is on: the number in TAI_MUTANT. Each one that is reached sets its byte in the file
// TAI_MUTANT_SEEN, which has to be as long as there are mutants.
#pragma once
#pragma clang diagnostic ignored "-Weverything"
namespace tai_mutation {
extern const int active;
extern unsigned char *const seen;
inline bool on(int number) {
  if (seen)
    seen[number] = 1;
  return number == active;
}
template <typename A, typename B> bool less(int n, const A &a, const B &b) {
  return on(n) ? a <= b : a < b;
}
template <typename A, typename B> bool lessEqual(int n, const A &a, const B &b) {
  return on(n) ? a < b : a <= b;
}
template <typename A, typename B> bool greater(int n, const A &a, const B &b) {
  return on(n) ? a >= b : a > b;
}
template <typename A, typename B> bool greaterEqual(int n, const A &a, const B &b) {
  return on(n) ? a > b : a >= b;
}
template <typename A, typename B> auto add(int n, const A &a, const B &b) -> decltype(a + b) {
  return on(n) ? a - b : a + b;
}
template <typename A, typename B> auto subtract(int n, const A &a, const B &b) -> decltype(a - b) {
  return on(n) ? a + b : a - b;
}
} // namespace tai_mutation
"""

SOURCE = """\
#include "{header}"
#include <cstdlib>
#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

static unsigned char *openSeen() {{
  const char *path = std::getenv("TAI_MUTANT_SEEN");
  int file = path ? open(path, O_RDWR) : -1;
  if (file < 0)
    return nullptr;
  void *bytes = mmap(nullptr, {count}, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  close(file);
  return bytes == MAP_FAILED ? nullptr : static_cast<unsigned char *>(bytes);
}}
static int readActive() {{
  const char *text = std::getenv("TAI_MUTANT");
  return text ? std::atoi(text) : -1;
}}
namespace tai_mutation {{
const int active = readActive();
unsigned char *const seen = openSeen();
}} // namespace tai_mutation
"""

ORDERS = {"<": "less", "<=": "lessEqual", ">": "greater", ">=": "greaterEqual"}
SUMS = {"+": "add", "-": "subtract"}
ON = "::tai_mutation::on"


@dataclass(frozen=True)
class Mutant:
    """A change that the build holds. `number` switches it on."""

    number: int
    file: str
    line: int
    kind: str
    text: str

    @property
    def name(self) -> str:
        return f"{self.file}:{self.line}: {self.kind}: {' '.join(self.text.split())[:160]}"


class Rewriter:
    """Finds the mutants of one source and makes its text with all of them."""

    def __init__(self, index: Any, file: str, arguments: list[str], first: int, root: Path):
        from clang import cindex

        self.kinds = cindex.CursorKind
        self.file, self.first, self.root = file, first, root
        self.text = (root / file).read_bytes()
        self.inserted: list[tuple[int, int, bytes]] = []
        self.replaced: dict[int, tuple[int, bytes]] = {}
        self.found: list[Mutant] = []
        unit = index.parse(str(root / file), args=arguments)
        errors = [d for d in unit.diagnostics if d.severity >= cindex.Diagnostic.Error]
        if errors:
            raise SystemExit(f"{file} cannot be parsed: {errors[0]}")
        for child in unit.cursor.get_children():
            location = child.location
            if location.file and location.file.name == str(root / file):
                self.visit(child, [])

    def next(self, cursor: Any, kind: str, text: bytes) -> int:
        number = self.first + len(self.found)
        line = cursor.extent.start.line
        self.found.append(Mutant(number, self.file, line, kind, text.decode(errors="replace")))
        return number

    def span(self, cursor: Any) -> tuple[int, int] | None:
        """The bytes of a cursor, unless a macro makes it."""
        begin, end = cursor.extent.start, cursor.extent.end
        if not begin.file or begin.file.name != str(self.root / self.file):
            return None
        text = self.text[begin.offset : end.offset]
        if end.offset <= begin.offset or re.match(rb"[A-Z][A-Z_]+\b", text):
            return None
        return begin.offset, end.offset

    def wrap(self, span: tuple[int, int], before: str, after: str) -> None:
        """Outer texts come first in front, and last behind."""
        length = span[1] - span[0]
        self.inserted.append((span[0], -length, before.encode()))
        self.inserted.append((span[1], length - 10**9, after.encode()))

    def visit(self, cursor: Any, parents: list[Any]) -> None:
        kind = cursor.kind
        if kind in (self.kinds.STATIC_ASSERT, self.kinds.ENUM_DECL):
            return
        if kind == self.kinds.VAR_DECL and b"constexpr" in self.source_of(cursor):
            return
        if kind in (self.kinds.VAR_DECL, self.kinds.FIELD_DECL, self.kinds.PARM_DECL) and not any(
            p.kind == self.kinds.COMPOUND_STMT for p in parents
        ):
            return
        if parents and any(p.kind == self.kinds.COMPOUND_STMT for p in parents):
            self.look_at(cursor, parents)
        for position, child in enumerate(cursor.get_children()):
            # The value of a label is a constant.
            if kind == self.kinds.CASE_STMT and position == 0:
                continue
            self.visit(child, [*parents, cursor])

    def source_of(self, cursor: Any) -> bytes:
        return self.text[cursor.extent.start.offset : cursor.extent.end.offset]

    def look_at(self, cursor: Any, parents: list[Any]) -> None:
        kinds, kind, parent = self.kinds, cursor.kind, parents[-1]
        if kind in (kinds.IF_STMT, kinds.WHILE_STMT, kinds.CONDITIONAL_OPERATOR):
            self.condition(cursor)
        elif kind == kinds.BINARY_OPERATOR:
            self.binary(cursor)
        elif kind == kinds.RETURN_STMT:
            self.returned(cursor)
        elif kind == kinds.INTEGER_LITERAL and parent.kind in (
            kinds.BINARY_OPERATOR, kinds.RETURN_STMT):  # fmt: skip
            if (span := self.span(cursor)) and self.text[span[0] : span[1]].isdigit():
                number = self.next(cursor, "constant", self.source_of(parent))
                self.wrap(span, "(", f" + {ON}({number}))")
        elif kind == kinds.CXX_BOOL_LITERAL_EXPR:
            if span := self.span(cursor):
                number = self.next(cursor, "constant", self.source_of(parent))
                self.wrap(span, f"({ON}({number}) != ", ")")
        elif kind == kinds.CALL_EXPR and cursor.spelling in ("success", "failure"):
            if (span := self.span(cursor)) and self.source_of(cursor).endswith(b"()"):
                number = self.next(cursor, "result", self.source_of(cursor))
                self.inserted.append((span[1] - 1, 0, f"!{ON}({number})".encode()))
        if kind == kinds.CONTINUE_STMT or (
            kind.is_expression() and self.is_statement(cursor, parents)
        ):
            self.statement(cursor)

    def is_statement(self, cursor: Any, parents: list[Any]) -> bool:
        parent = parents[-1]
        if parent.kind == self.kinds.COMPOUND_STMT:
            return not any(p.spelling == "__statement_expression" for p in parents)
        if parent.kind == self.kinds.IF_STMT:
            first = self.condition_of(parent)
            return first is not None and cursor.extent.start.offset > first.extent.end.offset
        return False

    def statement(self, cursor: Any) -> None:
        span = self.span(cursor)
        if not span:
            return
        rest = re.match(rb"\s*;", self.text[span[1] :])
        if not rest:
            return
        number = self.next(cursor, "statement", self.source_of(cursor))
        self.wrap((span[0], span[1] + rest.end()), f"{{ if (!{ON}({number})) ", " }")

    def condition_of(self, cursor: Any) -> Any:
        """The condition, if it is an expression alone."""
        children = list(cursor.get_children())
        if cursor.kind == self.kinds.CONDITIONAL_OPERATOR:
            return children[0] if len(children) == 3 else None
        text = self.source_of(cursor)
        if (
            re.match(rb"if\s+constexpr", text)
            or not children
            or not children[0].kind.is_expression()
        ):
            return None
        return children[0]

    def condition(self, cursor: Any) -> None:
        found = self.condition_of(cursor)
        span = self.span(found) if found is not None else None
        if span and not self.is_negation(found):
            number = self.next(found, "condition", self.source_of(found))
            self.wrap(span, f"({ON}({number}) != bool(", "))")

    def is_negation(self, cursor: Any) -> bool:
        """Whether the mutants of an operator negate the whole, too."""
        while cursor.kind == self.kinds.UNEXPOSED_EXPR:
            inner = list(cursor.get_children())
            if len(inner) != 1:
                return False
            cursor = inner[0]
        return cursor.kind == self.kinds.BINARY_OPERATOR and self.operator(cursor)[0] in (
            "==",
            "!=",
        )

    def operator(self, cursor: Any) -> tuple[str, Any, Any, int]:
        """The operator of a binary expression, its operands, and its place."""
        operands = list(cursor.get_children())
        if len(operands) != 2:
            return "", None, None, 0
        left, right = operands
        begin, end = left.extent.end.offset, right.extent.start.offset
        between = self.text[begin:end]
        found = re.fullmatch(rb"\s*(?://[^\n]*\s*)*(\S{1,3}?)\s*(?://[^\n]*\s*)*", between)
        if not found:
            return "", None, None, 0
        return found[1].decode(), left, right, begin + found.start(1)

    def binary(self, cursor: Any) -> None:
        span = self.span(cursor)
        name, left, right, place = self.operator(cursor)
        if not span or not name or not self.span(left) or not self.span(right):
            return
        text = self.source_of(cursor)
        plain = is_number(left) and is_number(right)
        if name in ("&&", "||"):
            number = self.next(cursor, "and or", text)
            on = f"{ON}({number})"
            self.wrap(span, f"({on} != (({on} != bool(", "))))")
            self.replace(place, name, f")) {name} ({on} != bool(")
        elif name in ORDERS and plain:
            number = self.next(cursor, "comparison", text)
            self.wrap(span, f"::tai_mutation::{ORDERS[name]}({number}, (", "))")
            self.replace(place, name, "), (")
        elif name in SUMS and plain:
            number = self.next(cursor, "arithmetic", text)
            self.wrap(span, f"::tai_mutation::{SUMS[name]}({number}, (", "))")
            self.replace(place, name, "), (")
        elif name in ("==", "!=") and cursor.type.spelling == "bool":
            number = self.next(cursor, "comparison", text)
            self.wrap(span, f"({ON}({number}) != (", "))")

    def replace(self, place: int, name: str, text: str) -> None:
        self.replaced[place] = (len(name), text.encode())

    def returned(self, cursor: Any) -> None:
        children = list(cursor.get_children())
        if len(children) == 1 and children[0].type.get_canonical().spelling == "bool":
            literal = self.source_of(children[0]) in (b"true", b"false")
            if (
                (span := self.span(children[0]))
                and not literal
                and not self.is_negation(children[0])
            ):
                number = self.next(cursor, "returned", self.source_of(children[0]))
                self.wrap(span, f"({ON}({number}) != bool(", "))")

    def result(self, header: str) -> bytes:
        """The text with all mutants."""
        edits = [(at, order, 0, new) for at, order, new in self.inserted]
        edits += [(at, 0, length, new) for at, (length, new) in self.replaced.items()]
        parts, last = [f'#include "{header}"\n'.encode()], 0
        for at, _, length, new in sorted(edits, key=lambda edit: (edit[0], edit[1])):
            parts += [self.text[last:at], new]
            last = at + length
        return b"".join([*parts, self.text[last:]])


def is_number(cursor: Any) -> bool:
    """Whether an operand is an integer or a float of the language."""
    name = cursor.type.get_canonical().spelling.replace("const ", "")
    return bool(re.fullmatch(r"(unsigned |signed )?(int|long|short|char|long long|unsigned)|float|"
                             r"double", name))  # fmt: skip


def compile_arguments(build: Path) -> dict[str, list[str]]:
    """The arguments for each source of a build, as libclang takes them."""
    found = {}
    for entry in json.loads((build / "compile_commands.json").read_text()):
        words = entry["command"].split(" ")
        start = next((k for k, word in enumerate(words) if re.search(r"clang\+\+", word)), None)
        if start is None:
            continue
        kept, skip = [], False
        for word in words[start + 1 :]:
            if skip or word in ("-c", entry["file"]):
                skip = False
                continue
            if word == "-o":
                skip = True
                continue
            kept.append(word.replace("\\", ""))
        found[entry["file"]] = [*kept, f"-working-directory={entry['directory']}"]
    return found


def mutate_sources(root: Path, build: Path, copy: Path, rooms: list[str]) -> list[Mutant]:
    """Writes the sources of some folders of lib into a copy of the tree, with all mutants.

    Args:
        root: the tree, whose sources are read.
        build: of the tree: the arguments, and the headers that it made.
        copy: the other tree.
        rooms: the folders.
    """
    from clang import cindex

    if not cindex.Config.loaded:
        cindex.Config.set_library_file(LIBCLANG)
        cindex.Config.set_compatibility_check(False)
    index = cindex.Index.create()
    arguments_of = compile_arguments(build)
    header = copy / "lib/TaiMutant.h"
    found: list[Mutant] = []
    results = {}
    for room in rooms:
        for path in sorted((root / "lib" / room).rglob("*.cpp")):
            file = str(path.relative_to(root))
            if str(path) not in arguments_of:
                continue
            rewriter = Rewriter(index, file, arguments_of[str(path)], len(found), root)
            found += rewriter.found
            results[file] = rewriter.result(str(header))
    for file, text in results.items():
        (copy / file).write_bytes(text)
    header.write_text(HEADER)
    source = copy / "lib" / rooms[0] / "TaiMutant.cpp"
    source.write_text(SOURCE.format(header=header, count=len(found)))
    (copy / "mutants.json").write_text(json.dumps([asdict(one) for one in found]))
    return found


def read_mutants(copy: Path) -> list[Mutant]:
    return [Mutant(**row) for row in json.loads((copy / "mutants.json").read_text())]


def numbers_in(seen: bytes) -> Iterator[int]:
    return (number for number, byte in enumerate(seen) if byte)
