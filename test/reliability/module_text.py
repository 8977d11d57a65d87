"""The parts of a random module: its fields, its text, and the values in scope."""

from __future__ import annotations

from dataclasses import dataclass, field

INTS = ("i8", "i16", "i32", "i64")
FLOATS = ("f16", "bf16", "f32", "f64")
WIDTH = {"i1": 1, "i8": 8, "i16": 16, "i32": 32, "i64": 64, "index": 64}
LARGEST = {"f16": 65504.0, "bf16": 3e38, "f32": 3e38, "f64": 1e308}
UNARY_EXACT = ("math.absf", "math.floor", "math.ceil", "math.trunc", "math.round",
               "math.roundeven", "math.sqrt", "arith.negf")  # fmt: skip
UNARY_NEAR = ("math.sin", "math.cos", "math.tan", "math.asin", "math.acos", "math.atan",
              "math.sinh", "math.cosh", "math.tanh", "math.exp", "math.log", "math.log1p",
              "math.expm1", "math.rsqrt", "math.exp2", "math.log2", "math.log10",
              "math.cbrt", "math.erf")  # fmt: skip
INT_BINARY = ("addi", "subi", "muli", "andi", "ori", "xori", "minsi", "maxsi", "minui", "maxui")
DIVISIONS = ("divsi", "divui", "remsi", "remui", "floordivsi", "ceildivsi", "ceildivui")
CMPI = ("eq", "ne", "slt", "sle", "sgt", "sge", "ult", "ule", "ugt", "uge")
CMPF = ("oeq", "ogt", "oge", "olt", "ole", "one", "ord", "ueq", "ugt", "uge", "ult", "ule", "une",
        "uno")  # fmt: skip


@dataclass
class Field:
    name: str
    type: str  # of an element
    shape: tuple[int, ...]
    tree: str
    use: str  # read, write, atomic, near, loose
    offset: tuple[int, ...] = ()
    kind: str = ""  # of atomics
    sparse: int = 0  # how many sparse levels lie above it
    levels: int = 1
    is_list: bool = False
    added: int = 0  # how much narrow floats may grow by


@dataclass
class Module:
    """A module: its text, in parts, and the arguments of a launch."""

    seed: int
    trees: dict[str, str] = field(default_factory=dict)
    fields: list[Field] = field(default_factory=list)
    arguments: list[tuple[str, float | int]] = field(default_factory=list)
    body: list[str] = field(default_factory=list)
    # Whether a product may become part of a sum, and so change.
    contracts: bool = False

    def declaration(self, f: Field) -> str:
        offset = f", offset [{', '.join(map(str, f.offset))}]" if any(f.offset) else ""
        return (
            f'tai.field @{f.name} = @{f.tree}["{f.name}"] : {f.type}, rank {len(f.shape)}{offset}'
        )

    def kernel(self) -> str:
        arguments = ", ".join(f"%arg{i}: {t}" for i, (t, _) in enumerate(self.arguments))
        return "\n".join([f"tai.kernel @k({arguments}) {{", *self.body, "  tai.return", "}"])

    def text(self) -> str:
        trees = [f"tai.tree @{n} : {t}" for n, t in self.trees.items()]
        return "\n".join([*trees, *map(self.declaration, self.fields), self.kernel()]) + "\n"


def split(type_: str) -> tuple[tuple[int, ...], str]:
    """The shape and the scalar of a type."""
    if not type_.startswith("vector<"):
        return (), type_
    *shape, scalar = type_[7:-1].split("x")
    return tuple(map(int, shape)), scalar


def joined(shape: tuple[int, ...], scalar: str) -> str:
    return f"vector<{'x'.join([*map(str, shape), scalar])}>" if shape else scalar


class Scope:
    """Values that can be used here, by type."""

    def __init__(self, outer: Scope | None = None):
        self.values = {t: list(v) for t, v in outer.values.items()} if outer else {}

    def add(self, name: str, type_: str) -> str:
        self.values.setdefault(type_, []).append(name)
        return name
