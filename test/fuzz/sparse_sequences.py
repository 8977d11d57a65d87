"""Random sequences of actions on a random forest, against the model.

An action is a tuple; `Runner.play` performs a list of them on the program and on the model, and
compares what both say. Commands are kept until a result is needed, so that some launches run one
of them and some many.
"""

from __future__ import annotations

import importlib.util
import random
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import sparse_scene as scenes
from sparse_model import Full, Model, hashed, list_cell, list_of, project
from sparse_trees import FieldSpec, Forest, Level, random_forest
from tai.errors import TaiError


class Mismatch(AssertionError):
    """The program and the model disagree."""


def expect(what: str, got: Any, wanted: Any) -> None:
    if got != wanted:
        raise Mismatch(f"{what}: got {got}, but the model says {wanted}")


class Runner:
    """A program for the forest of a seed, and the operations on it."""

    def __init__(self, seed: int, folder: Path, **options: Any):
        choice = random.Random(seed)
        self.forest: Forest = random_forest(choice)
        self.chosen = scenes.choose_kernels(self.forest, choice)
        self.text = scenes.program(self.forest, choice, self.chosen)
        file = folder / f"sparse_{seed}.py"
        file.write_text(f"OPTIONS = {options!r}\n{self.text}")
        spec = importlib.util.spec_from_file_location(file.stem, file)
        self.module = importlib.util.module_from_spec(spec)
        sys.modules[file.stem] = self.module
        spec.loader.exec_module(self.module)
        self.numbers = {key: n for n, key in enumerate(scenes.commands(self.forest))}
        self.levels = {level.name: level for level in self.forest.levels}
        self.fields = {spec.name: spec for spec in self.forest.fields}
        self.loops = scenes.loops(self.forest)
        self.pending: list[tuple[list[int], Any, tuple]] = []

    def of(self, thing: FieldSpec | Level) -> Any:
        return getattr(self.module, thing.name)

    # Sequences

    def actions(self, choice: random.Random) -> list[tuple]:
        """A random sequence."""
        return [self._action(choice) for _ in range(choice.randint(3, 30))]

    def _action(self, choice: random.Random) -> tuple:
        if choice.random() < 0.8:
            verb, name = choice.choice(list(self.numbers))
        else:
            others = ["set", "get", "fill", "array", "deactivate_all", "flush", "check"]
            others += ["outside"] if self.forest.debug else []
            others += [*self.chosen, *self.chosen]
            if any(spec.needs_grad for spec in self.forest.fields):
                others.append("set_grad")
            verb, name = choice.choice(others), ""
        value = choice.randint(1, 9)
        if verb in self.chosen:
            return (verb, choice.randrange(7), value)
        if verb in ("flush", "check"):
            return (verb,)
        if verb == "deactivate_all":
            name = choice.choice([lv.name for lv in self.levels.values() if lv.sparse_above()] or
                                 list(self.levels))  # fmt: skip
            return (verb, name)
        if not name:
            fields = self.forest.fields
            if verb == "set_grad":
                fields = [spec for spec in fields if spec.needs_grad]
            name = choice.choice(fields).name
        thing: Any = self.fields.get(name) or self.levels[name]
        # Cells near the origin more often, so that actions meet.
        near = choice.random() < 0.6
        cell = tuple(choice.randrange(min(n, 3) if near else n) for n in thing.shape)
        return (verb, name, cell, choice.randrange(getattr(thing, "components", 1)), value)

    def play(self, actions: list[tuple]) -> None:
        """Performs actions from a state in which nothing is active.

        Raises:
            Mismatch: the program does something else than the model.
        """
        self.reset()
        for action in actions:
            getattr(self, f"_{action[0]}", self._command)(*action)
        self._check("check")

    def reset(self) -> None:
        self.model = Model(self.forest)
        self.pending = []
        for level in self.forest.tops:
            self.of(level).deactivate_all()
        for spec in self.forest.fields:
            if any(not place.level.sparse_above() for place in spec.places):
                self.of(spec).fill(0)
                if spec.needs_grad:
                    self.of(spec).grad.fill(0)

    # Commands of the kernel `run`

    def _command(self, verb: str, name: str, cell: tuple, component: int, value: int) -> None:
        model = self.model
        numbers, expected = list(cell), None
        if name in self.fields:
            spec = self.fields[name]
            numbers = [i + first for i, first in zip(cell, spec.first, strict=True)]
            if verb == "write":
                model.write(spec, cell, [value + c for c in range(spec.components)])
            elif verb == "add":
                old = model.read(spec, cell)
                model.write(spec, cell, [o + value + c for c, o in enumerate(old)])
            elif verb == "component":
                place = next(p for p in spec.places if component in p.components)
                model.put(place, component, cell, value)
            else:
                expected = sum((c + 1) * v for c, v in enumerate(model.read(spec, cell)))
        else:
            level = self.levels[name]
            if verb in ("append", "length", "grow", "extent", "empty"):
                return self._list_command(verb, level, cell, value)
            if verb == "is_active":
                expected = int(model.is_active(level, cell))
            else:
                getattr(model, verb)(level, cell)
        self._push(verb, name, numbers, component, value, expected)

    def _list_command(self, verb: str, level: Level, cell: tuple, value: int) -> None:
        model, d = self.model, level.list_dimension
        key = list_of(level, cell)[0]
        place = level.places[0]
        numbers = [*cell[:d], *cell[d + 1 :]]
        if verb in ("grow", "extent", "empty"):
            first = place.of.first
            numbers = [i + f for i, f in zip(numbers, [*first[:d], *first[d + 1 :]], strict=True)]
        expected = None
        if verb in ("length", "extent"):
            expected = model.length(level, key)
        elif verb == "empty":
            model.deactivate(level, list_cell(level, key, 0))
        else:
            values = [value + c for c in range(len(place.components))]
            try:
                expected = model.append(level, key, values)
            except Full:
                self._flush("flush")
                self._push(verb, level.name, numbers, 0, value, None)
                self._fails("append to a full list")
                return
        self._push(verb, level.name, numbers, 0, value, expected)

    def _push(self, verb: str, name: str, numbers: list, component: int, value: int, expected: Any):
        code = [self.numbers[verb, name], *numbers, *[0] * (5 - len(numbers)), component, value]
        self.pending.append((code, expected, (verb, name, *numbers)))

    def _run(self) -> tuple[list, np.ndarray]:
        pending, self.pending = self.pending, []
        out = np.full(len(pending), -77, np.int32)
        if pending:
            code = np.array([code for code, _, _ in pending], np.int32)
            self.module.run(code, out)
        return pending, out

    def _flush(self, _: str) -> None:
        """Runs the commands that wait."""
        pending, out = self._run()
        for (_, expected, what), got in zip(pending, out.tolist(), strict=True):
            if expected is not None:
                expect(f"{what}", got, expected)

    def _fails(self, message: str) -> None:
        """Runs the commands that wait, of which one must be refused."""
        try:
            self._run()
        except TaiError as error:
            if message not in str(error):
                raise Mismatch(f"expected '{message}', but got: {error}") from error
            return
        raise Mismatch(f"no error: {message}")

    def _outside(self, _: str, name: str, cell: tuple, component: int, value: int) -> None:
        """An index out of range, which is an error in debug mode and changes nothing."""
        self._flush("flush")
        spec = self.fields[name]
        numbers = [i + first for i, first in zip(cell, spec.first, strict=True)]
        d = value % len(numbers)
        numbers[d] = spec.first[d] + (-1 - value if component else spec.shape[d] + value)
        self._push("write" if value % 2 else "add", name, numbers, 0, value, None)
        self._fails("out of range")

    # From the host

    def _index(self, spec: FieldSpec, cell: tuple) -> tuple:
        return tuple(i + first for i, first in zip(cell, spec.first, strict=True))

    def _set(self, _: str, name: str, cell: tuple, component: int, value: int) -> None:
        self._flush("flush")
        spec = self.fields[name]
        values = [value + c for c in range(spec.components)]
        self.of(spec)[self._index(spec, cell)] = (
            np.array(values).reshape(spec.element) if spec.element else value
        )
        self.model.write(spec, cell, values)

    def _get(self, _: str, name: str, cell: tuple, component: int, value: int) -> None:
        self._flush("flush")
        spec = self.fields[name]
        got = np.array(self.of(spec)[self._index(spec, cell)])
        expect(f"{name}[{cell}]", got.ravel().tolist(), self.model.read(spec, cell))

    def _set_grad(self, _: str, name: str, cell: tuple, component: int, value: int) -> None:
        self._flush("flush")
        spec = self.fields[name]
        self.of(spec).grad[self._index(spec, cell)] = (
            np.full(spec.element, value) if spec.element else value
        )
        for place in spec.places:
            self.model.activate(place.level, cell)
            for c in place.components:
                self.model.grads[spec, c][cell] = value

    def _fill(self, _: str, name: str, cell: tuple, component: int, value: int) -> None:
        self._flush("flush")
        self.of(self.fields[name]).fill(value)
        self.model.fill(self.fields[name], value)

    def _array(self, _: str, name: str, cell: tuple, component: int, value: int) -> None:
        self._flush("flush")
        spec = self.fields[name]
        array = (np.arange(np.prod(spec.shape + spec.element)) + value) % 11
        self.of(spec).from_numpy(array.reshape(spec.shape + spec.element))
        flat = array.reshape(*spec.shape, spec.components)
        for cell in np.ndindex(spec.shape):
            for place in spec.places:
                values = flat[cell][list(place.components)].tolist()
                # A cell that would hold zeros alone is not made active.
                if any(values):
                    self.model.activate(place.level, cell)
                for c, number in zip(place.components, values, strict=True):
                    self.model.values[spec, c][cell] = number

    def _deactivate_all(self, _: str, name: str) -> None:
        self._flush("flush")
        self.of(self.levels[name]).deactivate_all()
        self.model.deactivate_all(self.levels[name])

    # Kernels with loops over active cells

    def _shifted(self, spec: FieldSpec, element: tuple, factor: int, a: int) -> tuple:
        return tuple((i * factor + a) % n for i, n in zip(element, spec.shape, strict=True))

    def _spread(self, _: str, a: int, v: int) -> None:
        self._flush("flush")
        (spec,) = self.chosen["spread"]
        visited = list(self.model.elements(spec.level))
        out = np.zeros(1, np.int64)
        self.module.spread(out, a, v)
        # Cells that the loop activates do not join it.
        expect(f"visits of {spec.name}", out[0], len(visited))
        values = [v + c for c in range(spec.components)]
        for element in visited:
            self.model.write(spec, self._shifted(spec, element, 2, a), values)

    def _copy(self, _: str, a: int, v: int) -> None:
        self._flush("flush")
        source, target, add = self.chosen["copy"]
        self.module.copy(v)
        for element in list(self.model.elements(source.level)):
            index = self._index(source, element)
            at = tuple(i - first for i, first in zip(index, target.first, strict=True))
            if all(0 <= i < n for i, n in zip(at, target.shape, strict=True)):
                value = v + hashed(index) % 5
                old = self.model.read(target, at) if add else [0] * target.components
                self.model.write(target, at, [o + value + c for c, o in enumerate(old)])

    def _clear(self, _: str, a: int, v: int) -> None:
        self._flush("flush")
        level, above = self.chosen["clear"]
        visited = list(self.model.elements(level))
        out = np.zeros(1, np.int64)
        self.module.clear(out, a)
        # Cells that the loop deactivates are still visited.
        expect(f"visits of {level.name}", out[0], len(visited))
        gone = [cell for cell in visited if (sum(cell) + a) % 2 == 0]
        self.model.deactivate(above, *(project(cell, level, above) for cell in gone))

    def _collect(self, _: str, a: int, v: int) -> None:
        self._flush("flush")
        spec, level = self.chosen["collect"]
        a %= 3
        sizes = list(level.shape)
        del sizes[level.list_dimension]
        visited = list(self.model.elements(spec.level))
        wanted: dict[tuple, Counter] = {}
        for element in visited:
            h = hashed(self._index(spec, element))
            if h % 3 == a:
                key = [(h + d) % size for d, size in enumerate(sizes)]
                key.insert(level.list_dimension, 0)
                wanted.setdefault(tuple(key), Counter())[h % 7] += 1
        out = np.zeros(1, np.int64)
        capacity = level.extents[0]
        lengths = {key: self.model.length(level, key) for key in wanted}
        fits = all(lengths[key] + new.total() <= capacity for key, new in wanted.items())
        if not fits:
            try:
                self.module.collect(out, a)
            except TaiError as error:
                if "append to a full list" not in str(error):
                    raise Mismatch(f"expected a full list, but got: {error}") from error
            else:
                raise Mismatch("no error where a list is full")
            # The order of appends is open.
            top = level.path()[0]
            self.of(top).deactivate_all()
            self.model.deactivate_all(top)
            return
        self.module.collect(out, a)
        expect(f"visits of {spec.name}", out[0], len(visited))
        # Appends come in any order: if the values are the expected ones, take their order.
        place = level.places[0]
        field = self.of(place.of)
        if place.of.is_split:
            field = field.get_scalar_field(place.components[0])
        array = field.to_numpy().reshape(*level.shape, -1)
        for key, new in wanted.items():
            places = range(lengths[key], lengths[key] + new.total())
            found = [int(array[list_cell(level, key, at)][0]) for at in places]
            expect(f"appended to {key} of {level.name}", Counter(found), new)
            for value in found:
                self.model.append(level, key, [value + c for c in range(len(place.components))])

    def _weigh(self, _: str, a: int, v: int) -> None:
        self._flush("flush")
        (spec,) = self.chosen["weigh"]
        self.module.loss.grad[None] = 1.0
        self.module.weigh.grad(a)
        added: dict[tuple, float] = {}
        for element in self.model.elements(spec.level):
            weight = hashed(self._index(spec, element)) % 3
            other = self._shifted(spec, element, 1, a)
            values, others = self.model.read(spec, element), self.model.read(spec, other)
            for c in range(spec.components):
                for at, factor in ((element, others[c]), (other, values[c])):
                    added[c, at] = added.get((c, at), 0) + weight * factor
        self.model.add_gradient(spec, added)

    # Everything

    def _check(self, _: str) -> None:
        """Compares all activity and all values."""
        self._flush("flush")
        model = self.model
        out = np.zeros(2 * len(self.loops), np.int64)
        self.module.visit(out)
        for number, (name, _) in enumerate(self.loops):
            thing: Any = self.fields.get(name) or self.levels[name]
            level = thing.level if isinstance(thing, FieldSpec) else thing
            first = getattr(thing, "first", (0,) * level.rank)
            elements = list(model.elements(level))
            codes = [hashed(tuple(map(sum, zip(e, first, strict=True)))) for e in elements]
            expect(f"loop over {name}: count", out[2 * number], len(elements))
            expect(f"loop over {name}: sum of codes", out[2 * number + 1], sum(codes))
        for level in self.forest.levels:
            if level.is_sparse and any(below.places for below in level.below()):
                cells = sorted(tuple(c) for c in self.of(level).active_cells().tolist())
                expect(f"active cells of {level.name}", cells, sorted(model.cells(level)))
        for spec in self.forest.fields:
            field = self.of(spec)
            self._compare(spec, spec.name, field.to_numpy(), model.values)
            if spec.needs_grad:
                self._compare(spec, f"{spec.name}.grad", field.grad.to_numpy(), model.grads)

    def _compare(self, spec: FieldSpec, name: str, array: np.ndarray, store: dict) -> None:
        got = array.reshape(*spec.shape, spec.components)
        wanted = np.zeros_like(got)
        for c in range(spec.components):
            for element, value in store[spec, c].items():
                wanted[(*element, c)] = value
        if not np.array_equal(got, wanted):
            at = tuple(np.argwhere(got != wanted)[0].tolist())
            raise Mismatch(f"{name}[{at}]: got {got[at]}, but the model says {wanted[at]}")


def reduce(actions: list[tuple], make: Callable[[], Runner]) -> list[tuple]:
    """A shorter sequence that still fails, on a new program each time."""

    def fails(tried: list[tuple]) -> bool:
        try:
            make().play(tried)
        except Mismatch:
            return True
        return False

    step = max(1, len(actions) // 2)
    while True:
        at = 0
        while at < len(actions):
            tried = actions[:at] + actions[at + step :]
            if fails(tried):
                actions = tried
            else:
                at += step
        if step == 1:
            return actions
        step //= 2


def run_seed(seed: int, sequences: int, folder: Path, **options: Any) -> None:
    """Plays random sequences on the forest of a seed.

    Raises:
        Mismatch: with the shortest sequence found, the forest and the seed.
    """

    def make() -> Runner:
        return Runner(seed, folder, **options)

    runner = make()
    for number in range(sequences):
        choice = random.Random(f"{seed}/{number}")
        actions = runner.actions(choice)
        try:
            runner.play(actions)
        except Mismatch as error:
            text, short = str(error), reduce(actions, make)
            try:
                make().play(short)
            except Mismatch as again:
                text = str(again)
            raise Mismatch(
                f"seed {seed}, sequence {number}: {text}\n{runner.forest}\n"
                + "\n".join(f"    {action}" for action in short)
            ) from None
