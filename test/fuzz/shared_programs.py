"""Random parallel loops whose iterations share memory: reductions, stores that collide, reads of
what other iterations write, under conditions and at indices that data choose.

A program has two texts: a kernel, and the body of its loop for `serial_order`, in which variables
are elements of a field.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field

GROUPS = 13
# Fields of floats that the loop may write, with their numbers of elements and their parts; N
# stands for the number of iterations.
FLOATS = {
    "h": (GROUPS, ()), "o": (1, ()), "v": (1, (0, 1)), "s": (5, ("a", "b")), "y": ("N", ()),
    "z": ("N", ()), "out": (4, ()),
}  # fmt: skip
WHOLES = {"w": GROUPS, "k": "N", "counts": 2}
# Variables of the kernel: their text there, their text in the body, and the first value.
VARIABLES = {
    "a": ("a", "A[0]", "0.25"), "b0": ("b[0]", "B0[0]", "0.5"), "b1": ("b[1]", "B1[0]", "-0.5"),
    "r": ("r.a", "R[0]", "0.125"), "c": ("c", "C[0]", "3"),
}  # fmt: skip
FIRST = {"h": 0.75, "o": 0.5, "v": 0.25, "s": 0.5, "w": 5, "k": 2}

KERNELS = """\
import tai as ti

F = ti.{real}
Pair = ti.types.struct(a=F, b=F)
x = ti.field(F, N, needs_grad=True)
n, g, p, q = (ti.field(ti.i32, N) for _ in range(4))
h = ti.field(F, {groups}, needs_grad=True)
o = ti.field(F, (), needs_grad=True)
v = ti.Vector.field(2, F, (), needs_grad=True)
s = Pair.field(shape=5, needs_grad=True)
{places}
out = ti.field(F, 4, needs_grad=True)
w = ti.field(ti.i32, {groups})
k = ti.field(ti.i32, N)
counts = ti.field(ti.i32, 2)
loss = ti.field(F, (), needs_grad=True)


@ti.kernel
def total({arrays}):
    for j in h:
        loss[None] += h[j] * (j + 0.5)
    for j in out:
        loss[None] += out[j] * (1.5 - j)
    for j in s:
        loss[None] += s[j].a * (0.3 + j) - 0.2 * s[j].b
    for j in x:
        loss[None] += y[j] * (0.1 * (j % 7) + 0.2) - z[j] * (0.1 * (j % 5) - 0.3)
    loss[None] += 0.7 * o[None] + v[None][0] - 0.4 * v[None][1]


@ti.kernel
def run(m: ti.i32{more_arrays}):
    a = F(0.25)
    b = ti.Vector([0.5, -0.5], F)
    r = Pair(0.125, 0.0)
    c = 3
{loop}
{body}
    out[0] = a
    out[1] = b[0]
    out[2] = b[1]
    out[3] = r.a
    counts[0] = c
"""
PLACES = {
    "fields": "y, z = (ti.field(F, N, needs_grad=True) for _ in range(2))",
    "records": "y, z = (ti.field(F, needs_grad=True) for _ in range(2))\n"
    "ti.root.dense(ti.i, N).place(y, z, y.grad, z.grad)",
    "arrays": "y_array, z_array = (ti.ndarray(F, N, needs_grad=True) for _ in range(2))",
}
LOOPS = {
    "field": ("for i in x:", "i", ""),
    "range": ("for i in range(N):", "i", ""),
    "argument": ("for i in range(m):", "i", ""),
    "backwards": ("for i0 in range(N):", "i0", "i = N - 1 - i0"),
    "blocks": ("for i1, i2 in ti.ndrange(N // 8, 8):", "i1, i2", "i = i1 * 8 + i2"),
}
# One element for each iteration, for N that is odd; and one for several.
OWN = ("i", "i", "p[i]", "N - 1 - i", "(2 * i) % N", "(i + 1) % N")
SHARED = ("q[i]", "i // 2", "i % 4", "min(i + 1, N - 1)", "2", "min(i, 3)", "i - i % 2", "g[i]")


@dataclass
class Line:
    """A line of the body.

    Attributes:
        text: the line, with variables by their names in braces.
        updates: the memory that it updates by a reduction, and the operation.
    """

    text: str
    updates: tuple[str, str] | None = None


@dataclass
class Program:
    """A loop, with the places of its fields."""

    loop: str
    places: str
    lines: list[Line] = field(default_factory=list)

    def kernel(self, real: str, serialize: bool) -> str:
        """The module, for `real` numbers."""
        head, _, first = LOOPS[self.loop]
        if serialize and self.loop == "field":
            head = LOOPS["range"][0]
        before = "    ti.loop_config(serialize=True)\n" if serialize else ""
        names = {name: texts[0] for name, texts in VARIABLES.items()}
        body = [first] if first else []
        body += [line.text.format(**names) for line in self.lines]
        arrays = ""
        if self.places == "arrays":
            arrays = "y: ti.types.ndarray(F, 1), z: ti.types.ndarray(F, 1)"
        return KERNELS.format(
            real=real, groups=GROUPS, places=PLACES[self.places], arrays=arrays,
            more_arrays=", " + arrays if arrays else "", loop=f"{before}    {head}",
            body="\n".join("        " + line for line in body),
        )  # fmt: skip

    def body(self) -> str:
        """The function `body` of an iteration."""
        _, indices, first = LOOPS[self.loop]
        names = {name: texts[1] for name, texts in VARIABLES.items()}
        lines = [f"def body({indices}):", "    " + (first or "pass")]
        return "\n".join(lines + ["    " + line.text.format(**names) for line in self.lines])

    def updates(self) -> dict[int, tuple[str, str]]:
        """The updated memory and the operation, by the number of the line of `body`."""
        return {number + 3: line.updates for number, line in enumerate(self.lines) if line.updates}

    def iterations(self, n: int):
        if self.loop == "blocks":
            return ((i, j) for i in range(n // 8) for j in range(8))
        return ((i,) for i in range(n))


class Generator:
    """Writes one body."""

    def __init__(self, rng: random.Random, flavour: str):
        self.rng = rng
        self.flavour = flavour
        # By memory: the operation of all its updates, unless anything goes.
        self.families: dict[str, str] = {}
        # By memory: the index of all its accesses, where iterations are to be apart.
        self.own: dict[str, str] = {}
        self.temporaries = 0

    def lines(self) -> list[Line]:
        found = []
        for _ in range(self.rng.randrange(1, 6)):
            found += self.guarded(self.statement())
        return found

    def statement(self) -> list[Line]:
        kinds = {
            "updates": (self.update,), "stores": (self.update, self.store),
            "apart": (self.update, self.own_store, self.own_store),
            "any": (self.update, self.store, self.change, self.own_store),
        }[self.flavour]  # fmt: skip
        return self.rng.choice(kinds)()

    def guarded(self, lines: list[Line]) -> list[Line]:
        kind = self.rng.random()
        if kind < 0.35:
            head = f"if {self.condition()}:"
        elif kind < 0.42 and any(line.updates for line in lines):
            head = "for _ in range(2):"
        else:
            return lines
        return [Line(head), *(Line("    " + line.text, line.updates) for line in lines)]

    # Expressions

    def number(self, but: str = "") -> str:
        simple = ("x[i]", "0.5 * x[i]", "x[i] * x[i]", "ti.sin(x[i])", "0.125", "(x[i] - 0.3)")
        if self.flavour in ("any", "apart") and self.rng.random() < 0.3:
            name = self.rng.choice("yz")
            if name != but:
                return f"0.5 * {name}[{self.index(name)}]"
        return self.rng.choice(simple)

    def whole(self) -> str:
        return self.rng.choice(("n[i]", "(n[i] | 1)", "3", "n[i] * 2"))

    def condition(self) -> str:
        return self.rng.choice(
            ("x[i] > 0.1", "n[i] % 3 == 0", "x[i] < 0.5 and n[i] > -50", "i % 2 == 0", "n[i] != 4",
             "i > 2", "x[q[i]] > 0.0")
        )  # fmt: skip

    def index(self, name: str) -> str:
        """An index of a field of N elements."""
        if self.flavour == "apart":
            return self.own.setdefault(name, self.rng.choice(OWN))
        if name in self.families or self.rng.random() < 0.5:
            return self.rng.choice(SHARED + OWN)
        return self.rng.choice(OWN)

    # Statements

    def store(self) -> list[Line]:
        name = self.rng.choice("yzzk" if self.rng.random() < 0.9 else "h")
        place = "h[g[i]]" if name == "h" else f"{name}[{self.index(name)}]"
        if name in self.families and self.flavour != "any":
            return self.update()
        self.families.setdefault(name, "store")
        value = self.whole() if name == "k" else self.number(name)
        return [Line(f"{place} = {value}")]

    def own_store(self) -> list[Line]:
        """A store of a value that may come from the element."""
        name = self.rng.choice("yz")
        place = f"{name}[{self.index(name)}]"
        form = self.rng.choice(("{v}", "{v} - {p}", "0.5 * {p} + {v}", "ti.sin({p}) + {v}"))
        return [Line(f"{place} = " + form.format(v=self.number(name), p=place))]

    def change(self) -> list[Line]:
        """A read and a write that are no reduction."""
        if self.rng.random() < 0.3:
            name = self.rng.choice(("a", "r"))
            place = "{" + name + "}"
        else:
            name = self.rng.choice("yzh")
            index = "g[i]" if name == "h" else self.index(name)
            place = f"{name}[{index}]"
        return [Line(f"{place} = {self.number(name)} - {place}")]

    def update(self) -> list[Line]:
        is_whole = self.rng.random() < 0.3
        if is_whole:
            name, place = self.rng.choice(
                (("c", "{c}"), ("w", "w[g[i]]"), ("w", "w[i % 5]"), ("k", "k[INDEX]"))
            )
            family = self.rng.choice("+*&|^<>")
        else:
            name, place = self.rng.choice(
                (("a", "{a}"), ("b0", "{b0}"), ("b1", "{b1}"), ("r", "{r}"), ("h", "h[g[i]]"),
                 ("h", "h[i % 7]"), ("h", "h[(g[i] + 1) % 13]"), ("o", "o[None]"),
                 ("v", "v[None][0]"), ("v", "v[None][1]"), ("s", "s[i % 5].a"),
                 ("s", "s[g[i] % 5].b"), ("y", "y[INDEX]"), ("z", "z[INDEX]"))
            )  # fmt: skip
            family = self.rng.choice("++*<>")
        if self.flavour == "apart" and name in "yzk":
            return self.update()
        place = place.replace("INDEX", self.index(name))
        if self.flavour != "any" or self.rng.random() < 0.9:
            family = self.families.setdefault(name, family)
        if family == "store":
            return self.update()
        value = self.whole() if is_whole else self.number(name)
        lines = self.forms(place, family, value, is_whole)
        memory = VARIABLES[name][1][:-3] if name in VARIABLES else name
        return [Line(line, (memory, family)) for line in lines]

    def forms(self, place: str, family: str, value: str, is_whole: bool) -> list[str]:
        """One update in one of the forms that the operation has."""
        if family in "<>":
            return self.extremum(place, family, value)
        if family == "*" and not is_whole:
            # Products stay of moderate size.
            value = f"(1 + 1e-4 * {value})"
        new = [f"{place} {family} {value}", f"{value} {family} {place}"]
        if family == "+":
            rest = "n[i]" if is_whole else "x[i]"
            new += [f"{place} - {value}", f"{place} + {value} - {rest}"]
        one = self.rng.choice(new)
        form = self.rng.randrange(6)
        if form == 0 and family != "*":
            return [f"{place} {family}= {value}"]
        if form == 1 and family == "+":
            return [f"{place} -= {value}"]
        if form == 2:
            condition = self.rng.choice(("x[i] > 0.1", "n[i] > 7"))
            return [f"{place} = ti.select({condition}, {one}, {place})"]
        if form == 3:
            return [f"{place} = {place} if {self.condition()} else {one}"]
        if form == 4:
            return [f"{place} = {one} if {self.condition()} else {self.rng.choice(new)}"]
        return [f"{place} = {one}"]

    def extremum(self, place: str, family: str, value: str) -> list[str]:
        name = "min" if family == "<" else "max"
        self.temporaries += 1
        t = f"t{self.temporaries}"
        if self.rng.random() < 0.5:
            return self.chosen_extremum(place, family, value, t)
        return self.rng.choice(
            (
                [f"{place} = ti.{name}({place}, {value})"],
                [f"{place} = {name}({value}, {place})"],
                [f"{place} = ti.select({value} {family} {place}, {value}, {place})"],
                [f"{place} = {value} if {value} {family} {place} else {place}"],
                [f"if {value} {family} {place}:", f"    {place} = {value}"],
                [f"if x[i] > -0.8 and {place} {'>' if family == '<' else '<'} {value}:",
                 f"    {place} = {value}"],
                [f"{t} = {value}", f"if not ({place} {family}= {t}):", f"    {place} = {t}"],
            )
        )  # fmt: skip

    def chosen_extremum(self, place: str, family: str, value: str, t: str) -> list[str]:
        """An extremum where a condition holds, by which the program chooses a value or a branch."""
        other = ">" if family == "<" else "<"
        better = self.rng.choice(
            (f"{value} {family} {place}", f"{place} {other} {value}", f"{value} {family}= {place}",
             f"not ({place} {family}= {value})")
        )  # fmt: skip
        worse = self.rng.choice((f"{value} {other}= {place}", f"not ({better})"))
        # Conditions behind the comparison ask for the index alone: nothing else may be read there.
        c, d = self.condition(), self.condition()
        late = self.rng.choice(("i > 2", "i % 2 == 0"))
        test = self.rng.choice(
            (f"({c} and {better})", f"({better} and {late})", f"({c}) & ({better})",
             f"({c} and {d} and {better})", f"({c} and ({better}) and {late})",
             f"(({c} or {d}) and {better})", f"not (not ({c}) or {worse})",
             f"(({c} and {better}) or ({d} and {better}))", f"({c} and {better} and {better})")
        )  # fmt: skip
        least = f"{value} if {test} else {place}"
        return self.rng.choice(
            (
                [f"{place} = {least}"],
                [f"{place} = {place} if not {test} else {value}"],
                [f"{place} = ti.select({test}, {value}, {place})"],
                [f"{place} = ({least}) if {d} else {place}"],
                [f"{place} = {place} if {d} else ({least})"],
                [f"if {test}:", f"    {place} = {value}"],
                [f"if not {test}:", "    pass", "else:", f"    {place} = {value}"],
                [f"if {c}:", f"    {place} = {least}"],
                [f"{t} = {place}", f"if {test.replace(place, t)}:", f"    {t} = {value}",
                 f"{place} = {t}"],
            )
        )  # fmt: skip


def draw(seed: int) -> Program:
    """The program of a seed."""
    rng = random.Random(f"shared {seed}")
    flavour = rng.choice(("updates", "updates", "stores", "apart", "any"))
    loop = rng.choice(("field", "field", "range", "argument", "backwards", "blocks"))
    places = rng.choice(("fields", "fields", "records", "arrays"))
    program = Program(loop, places)
    while not program.lines:
        program.lines = Generator(rng, flavour).lines()
    return program
