"""A program for a random forest: its fields, and kernels that act on them.

One kernel runs a table of commands, so that a tree costs few compilations; a few more have
loops over active cells. The text says all: it can be saved and read.
"""

from __future__ import annotations

import random

from sparse_trees import FieldSpec, Forest, Level

WIDTH = 8  # numbers of a command: what, up to four indices, a component, a value


def axes_text(axes: tuple[int, ...]) -> str:
    return f"ti.axes({', '.join(map(str, axes))})"


def indices(rank: int, first: int = 1) -> str:
    return ", ".join(f"code[n, {first + d}]" for d in range(rank))


def own(spec: FieldSpec, at: str = "I") -> str:
    """Indices of an element, from a vector."""
    return ", ".join(f"{at}[{d}]" for d in range(spec.level.rank))


def element_value(spec: FieldSpec, value: str) -> str:
    """An element whose components are value, value + 1, …"""
    if not spec.element:
        return value
    parts = [f"{value} + {c}" for c in range(spec.components)]
    if len(spec.element) == 1:
        return f"ti.Vector([{', '.join(parts)}])"
    columns = spec.element[1]
    rows = [", ".join(parts[r : r + columns]) for r in range(0, len(parts), columns)]
    return f"ti.Matrix([{', '.join(f'[{row}]' for row in rows)}])"


def component(spec: FieldSpec, number: int | str) -> str:
    """The subscript of one component of an element; none for a scalar."""
    if not spec.element:
        return ""
    if len(spec.element) == 1:
        return f"[{number}]"
    return f"[{number // spec.element[1]}, {number % spec.element[1]}]"


def weighed(spec: FieldSpec, at: str) -> str:
    """Sum of the components of an element, each times its number and one."""
    element = f"{spec.name}[{at}]"
    terms = [f"{element}{component(spec, c)} * {c + 1}" for c in range(spec.components)]
    return f"ti.cast({' + '.join(terms)}, ti.i32)"


def commands(forest: Forest) -> list[tuple[str, str]]:
    """The commands of the kernel `run`; a command is its position here."""
    table = []
    for spec in forest.fields:
        table += [("write", spec.name), ("add", spec.name), ("read", spec.name)]
        if spec.element:
            table.append(("component", spec.name))
    for level in forest.levels:
        if not any(below.places for below in level.below()):
            continue
        table += [("activate", level.name), ("is_active", level.name)]
        if level.is_sparse:
            table.append(("deactivate", level.name))
        if level.takes_appends():
            table += [("append", level.name), ("length", level.name)]
            if not level.places[0].of.is_split:
                table += [("grow", level.name), ("extent", level.name), ("empty", level.name)]
    return table


def command_body(forest: Forest, verb: str, name: str) -> list[str]:
    spec = next((f for f in forest.fields if f.name == name), None)
    if spec is not None:
        element = f"{name}[{indices(spec.level.rank)}]"
        if verb == "write":
            return [f"{element} = {element_value(spec, 'code[n, 7]')}"]
        if verb == "add":
            return [f"{element} += {element_value(spec, 'code[n, 7]')}"]
        if verb == "read":
            return [f"out[n] = {weighed(spec, indices(spec.level.rank))}"]
        choices = []
        for c in range(spec.components):
            choices += [f"if code[n, 6] == {c}:", f"    {element}{component(spec, c)} = code[n, 7]"]
        return choices
    level = next(level for level in forest.levels if level.name == name)
    cell = f"{name}, [{indices(level.rank)}]"
    some = f"[{indices(level.rank - 1)}]"
    if verb == "activate":
        return [f"ti.activate({cell})"]
    if verb == "deactivate":
        return [f"ti.deactivate({cell})"]
    if verb == "is_active":
        return [f"out[n] = ti.cast(ti.is_active({cell}), ti.i32)"]
    spec = level.places[0].of
    value = "code[n, 7]" if spec.is_split else element_value(spec, "code[n, 7]")
    if verb == "append":
        return [f"out[n] = ti.append({name}, {some}, {value})"]
    if verb == "length":
        return [f"out[n] = ti.length({name}, {some})"]
    # The list as an element with one index less, in indices of the field.
    shown = f"{spec.name}[{indices(level.rank - 1)}]" if level.rank > 1 else f"{spec.name}[None]"
    if verb == "grow":
        return [f"out[n] = {shown}.append({value})"]
    if verb == "extent":
        return [f"out[n] = {shown}.length()"]
    return [f"{shown}.deactivate()"]


def hash_lines(rank: int, indent: str) -> list[str]:
    """Computes `h` from the vector `I`, as `sparse_model.hashed`."""
    lines = [f"{indent}h = ti.i64(0)"]
    lines += [f"{indent}h = h * 1009 + I[{d}] + 50" for d in range(rank)]
    return [*lines, f"{indent}h = h * 2654435761 % 1000003"]


KERNEL = "@ti.kernel"
OUT = "out: ti.types.ndarray(ti.i64, 1)"


def visit_kernel(forest: Forest, choice: random.Random) -> list[str]:
    """Counts what loops over each field and each level visit."""
    lines = [KERNEL, f"def visit({OUT}):"]
    for number, (name, rank) in enumerate(loops(forest)):
        if choice.random() < 0.5:
            lines.append(f"    for I in ti.grouped({name}):")
        else:
            names = [f"i{d}" for d in range(rank)]
            lines += [f"    for {', '.join(names)} in {name}:"]
            lines += [f"        I = ti.Vector([{', '.join(names)}])"]
        lines += hash_lines(rank, "        ")
        lines += [f"        out[{2 * number}] += 1", f"        out[{2 * number + 1}] += h"]
    return lines


def loops(forest: Forest) -> list[tuple[str, int]]:
    """The fields and levels that `visit` loops over, with the number of indices."""
    found = [(spec.name, spec.level.rank) for spec in forest.fields]
    for level in forest.levels:
        if any(below.places for below in level.below()):
            found.append((level.name, level.rank))
    return found


def shifted(spec: FieldSpec, factor: int) -> str:
    """Indices of an element away from that of the iteration."""
    parts = []
    for d, (first, extent) in enumerate(zip(spec.first, spec.shape, strict=True)):
        zero = f"I[{d}]" if first == 0 else f"(I[{d}] - {first})"
        parts.append(f"({zero} * {factor} + a) % {extent} + {first}")
    return ", ".join(parts)


def spread_kernel(spec: FieldSpec) -> list[str]:
    """Writes to other cells of the field that is looped over."""
    return [
        KERNEL,
        f"def spread({OUT}, a: ti.i32, v: ti.i32):",
        f"    for I in ti.grouped({spec.name}):",
        "        out[0] += 1",
        f"        {spec.name}[{shifted(spec, 2)}] = {element_value(spec, 'v')}",
    ]


def copy_kernel(source: FieldSpec, target: FieldSpec, add: bool) -> list[str]:
    """Writes to another field at the indices of the loop, where it has them."""
    inside = " and ".join(
        f"I[{d}] >= {first} and I[{d}] < {first + extent}"
        for d, (first, extent) in enumerate(zip(target.first, target.shape, strict=True))
    )
    value = element_value(target, "v + ti.cast(h % 5, ti.i32)")
    return [
        KERNEL,
        "def copy(v: ti.i32):",
        f"    for I in ti.grouped({source.name}):",
        *hash_lines(source.level.rank, "        "),
        f"        if {inside}:",
        f"            {target.name}[{own(source)}] {'+=' if add else '='} {value}",
    ]


def clear_kernel(level: Level, above: Level) -> list[str]:
    """Deactivates cells above the visited ones, while the loop runs."""
    parts = []
    for axis, extent in above.cells.items():
        d = list(level.cells).index(axis)
        parts.append(f"I[{d}] // {level.cells[axis] // extent}")
    total = " + ".join(f"I[{d}]" for d in range(level.rank))
    return [
        KERNEL,
        f"def clear({OUT}, a: ti.i32):",
        f"    for I in ti.grouped({level.name}):",
        "        out[0] += 1",
        f"        if ({total} + a) % 2 == 0:",
        f"            ti.deactivate({above.name}, [{', '.join(parts)}])",
    ]


def collect_kernel(spec: FieldSpec, level: Level) -> list[str]:
    """Appends to lists from a parallel loop."""
    place = level.places[0]
    sizes = list(level.shape)
    del sizes[level.list_dimension]
    at = [f"ti.cast((h + {d}) % {size}, ti.i32)" for d, size in enumerate(sizes)]
    value = "ti.cast(h % 7, ti.i32)"
    if not place.of.is_split:
        value = element_value(place.of, value)
    return [
        KERNEL,
        f"def collect({OUT}, a: ti.i32):",
        f"    for I in ti.grouped({spec.name}):",
        "        out[0] += 1",
        *hash_lines(spec.level.rank, "        "),
        "        if h % 3 == a:",
        f"            ti.append({level.name}, [{', '.join(at)}], {value})",
    ]


def weigh_kernel(spec: FieldSpec) -> list[str]:
    """A loss of products of neighbours, active or not."""
    lines = [KERNEL, "def weigh(a: ti.i32):", f"    for I in ti.grouped({spec.name}):"]
    lines += hash_lines(spec.level.rank, "        ")
    lines.append("        w = ti.cast(h % 3, ti.f64)")
    here, there = f"{spec.name}[{own(spec)}]", f"{spec.name}[{shifted(spec, 1)}]"
    for c in range(spec.components):
        part = component(spec, c)
        lines.append(f"        loss[None] += w * {here}{part} * {there}{part}")
    return lines


def choose_kernels(forest: Forest, choice: random.Random) -> dict[str, tuple]:
    """The fields and levels that the kernels with loops use, by kernel."""
    fields, chosen = forest.fields, {}
    chosen["spread"] = (choice.choice(fields),)
    source = choice.choice(fields)
    same = [f for f in fields if f.level.rank == source.level.rank]
    chosen["copy"] = (source, choice.choice(same), choice.random() < 0.5)
    with_fields = [lv for lv in forest.levels if any(b.places for b in lv.below())]
    pairs = [(lv, above) for lv in with_fields for above in lv.sparse_above()]
    chosen["clear"] = choice.choice(pairs)
    lists = [level for level in forest.levels if level.takes_appends()]
    if lists:
        chosen["collect"] = (choice.choice(fields), choice.choice(lists))
    smooth = [f for f in fields if f.needs_grad]
    if smooth:
        chosen["weigh"] = (choice.choice(smooth),)
    return chosen


WRITERS = {
    "spread": spread_kernel,
    "copy": copy_kernel,
    "clear": clear_kernel,
    "collect": collect_kernel,
    "weigh": weigh_kernel,
}


def program(forest: Forest, choice: random.Random, chosen: dict[str, tuple]) -> str:
    """The text of the program."""
    lines = ["import tai as ti", "", f"ti.init(arch=ti.cpu, debug={forest.debug}, **OPTIONS)"]
    for spec in forest.fields:
        shape = "".join(f"{n}, " for n in spec.element)
        kind = ("", "Vector.", "Matrix.")[len(spec.element)]
        options = ", needs_grad=True" if spec.needs_grad else ""
        lines.append(f"{spec.name} = ti.{kind}field({shape}ti.{spec.dtype}{options})")
    trees = sorted({top.tree for top in forest.tops})
    lines += [f"tree{t} = {'ti.FieldsBuilder()' if t else 'ti.root'}" for t in trees]
    for level in forest.levels:
        parent = level.parent.name if level.parent else f"tree{level.tree}"
        extents = level.extents[0] if level.is_list else level.extents
        lines.append(f"{level.name} = {parent}.{level.kind}({axes_text(level.axes)}, {extents})")
        for place in level.places:
            spec = place.of
            what = spec.name
            if spec.is_split:
                what += f".get_scalar_field({place.components[0]})"
            offset = f", offset={spec.offset}" if spec.offset else ""
            lines.append(f"{level.name}.place({what}{offset})")
    lines.append("loss = ti.field(ti.f64, shape=(), needs_grad=True)")
    lines += [f"done{t} = tree{t}.finalize()" for t in trees if t]

    lines += ["", "", KERNEL, "def run("]
    lines += ["    code: ti.types.ndarray(ti.i32, 2), out: ti.types.ndarray(ti.i32, 1)"]
    lines += ["):", "    ti.loop_config(serialize=True)", "    for n in range(out.shape[0]):"]
    for number, (verb, name) in enumerate(commands(forest)):
        lines.append(f"        if code[n, 0] == {number}:  # {verb} {name}")
        lines += [f"            {line}" for line in command_body(forest, verb, name)]
    lines += ["", "", *visit_kernel(forest, choice)]
    for name, what in chosen.items():
        lines += ["", "", *WRITERS[name](*what)]
    return "\n".join(lines) + "\n"
