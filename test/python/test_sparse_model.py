"""Random trees and random sequences of operations against a model in plain Python.

The model keeps a dictionary of values and a set of active cells for each level. Run this file
with a number to try that many sequences: `python test_sparse_model.py 10000`.
"""

import itertools
import random
import sys

import numpy as np
import pytest
import tai as ti

KINDS = ["dense", "pointer", "bitmasked", "hash"]


class Scene:
    """A tree of one field over one or two axes, and kernels that act on it."""

    def __init__(self, choice):
        rank = choice.choice([1, 2])
        self.axes = ti.i if rank == 1 else ti.ij
        self.rank = rank
        self.levels = []
        for _ in range(choice.randint(1, 3)):
            extents = tuple(choice.choice([1, 2, 3, 4]) for _ in range(rank))
            self.levels.append((choice.choice(KINDS), extents))
        if all(kind == "dense" for kind, _ in self.levels):
            self.levels[0] = ("pointer", self.levels[0][1])
        self.field = ti.field(ti.i32)
        node, self.nodes = ti.root, []
        for kind, extents in self.levels:
            node = getattr(node, kind)(self.axes, extents)
            self.nodes.append(node)
        node.place(self.field)
        self.shape = tuple(
            int(np.prod([extents[d] for _, extents in self.levels])) for d in range(rank)
        )
        self.make_kernels()

    def make_kernels(self):
        x, rank = self.field, self.rank
        count = ti.field(ti.i32, shape=())
        total = ti.field(ti.i64, shape=())
        self.count, self.total = count, total

        @ti.kernel
        def write(i: ti.i32, j: ti.i32, value: ti.i32):
            if ti.static(rank == 1):
                x[i] = value
            else:
                x[i, j] = value

        @ti.kernel
        def add(i: ti.i32, j: ti.i32, value: ti.i32):
            if ti.static(rank == 1):
                x[i] += value
            else:
                x[i, j] += value

        @ti.kernel
        def read(i: ti.i32, j: ti.i32) -> ti.i32:
            result = 0
            if ti.static(rank == 1):
                result = x[i]
            else:
                result = x[i, j]
            return result

        @ti.kernel
        def visit():
            for index in ti.grouped(x):
                code = ti.i64(index[0])
                if ti.static(rank == 2):
                    code = code * 1000 + index[1]
                count[None] += 1
                total[None] += (code + 1) * (code + 7)

        self.write, self.add, self.read, self.visit = write, add, read, visit
        self.level_kernels = [self.make_level(node) for node in self.nodes]

    def make_level(self, node):
        rank = self.rank

        @ti.kernel
        def activate(i: ti.i32, j: ti.i32):
            if ti.static(rank == 1):
                ti.activate(node, i)
            else:
                ti.activate(node, [i, j])

        @ti.kernel
        def deactivate(i: ti.i32, j: ti.i32):
            if ti.static(rank == 1):
                ti.deactivate(node, i)
            else:
                ti.deactivate(node, [i, j])

        @ti.kernel
        def is_active(i: ti.i32, j: ti.i32) -> ti.i32:
            result = 0
            if ti.static(rank == 1):
                result = ti.is_active(node, i)
            else:
                result = ti.is_active(node, [i, j])
            return result

        return activate, deactivate, is_active


class Model:
    """What the scene should do."""

    def __init__(self, scene):
        self.scene = scene
        # Elements along each dimension in one cell of each level.
        self.span = []
        for level in range(len(scene.levels)):
            below = scene.levels[level + 1 :]
            self.span.append(
                tuple(int(np.prod([e[d] for _, e in below])) for d in range(scene.rank))
            )
        self.sparse = [k for k, (kind, _) in enumerate(scene.levels) if kind != "dense"]
        self.values, self.active = {}, {k: set() for k in self.sparse}

    def cell(self, level, element):
        return tuple(e // s for e, s in zip(element, self.span[level], strict=True))

    def first(self, level, cell):
        return tuple(c * s for c, s in zip(cell, self.span[level], strict=True))

    def activate(self, level, cell):
        for above in self.sparse:
            if above <= level:
                self.active[above].add(self.cell(above, self.first(level, cell)))

    def deactivate(self, level, cell):
        for below in self.sparse:
            if below >= level:
                self.active[below] = {
                    c for c in self.active[below] if self.cell(level, self.first(below, c)) != cell
                }
        self.values = {e: v for e, v in self.values.items() if self.cell(level, e) != cell}

    def put(self, element, value):
        self.activate(len(self.span) - 1, element)
        self.values[element] = value

    def elements(self):
        innermost = self.sparse[-1]
        for cell in self.active[innermost]:
            first = self.first(innermost, cell)
            ranges = [range(f, f + s) for f, s in zip(first, self.span[innermost], strict=True)]
            yield from itertools.product(*ranges)


def run_sequence(scene, choice):
    for node in scene.nodes:
        if node.kind != "dense":
            node.deactivate_all()
    model = Model(scene)

    def pick(shape):
        return tuple(choice.randrange(n) for n in shape)

    def pad(index):
        return (*index, 0)[:2]

    for _ in range(choice.randint(1, 12)):
        action = choice.choice(["write", "add", "host", "activate", "deactivate", "read", "ask"])
        element = pick(scene.shape)
        level = choice.randrange(len(scene.levels))
        cell = model.cell(level, element)
        activate, deactivate, is_active = scene.level_kernels[level]
        if action == "write":
            value = choice.randint(-9, 9)
            scene.write(*pad(element), value)
            model.put(element, value)
        elif action == "add":
            scene.add(*pad(element), 3)
            model.put(element, model.values.get(element, 0) + 3)
        elif action == "host":
            scene.field[element] = 5
            model.put(element, 5)
        elif action == "activate":
            activate(*pad(cell))
            model.activate(level, cell)
        elif action == "deactivate" and level in model.sparse:
            deactivate(*pad(cell))
            model.deactivate(level, cell)
        elif action == "read":
            assert scene.read(*pad(element)) == model.values.get(element, 0)
        elif action == "ask":
            above = [k for k in model.sparse if k <= level]
            expected = not above or model.cell(above[-1], element) in model.active[above[-1]]
            assert bool(is_active(*pad(cell))) == expected

    expected = list(model.elements())
    codes = [e[0] if scene.rank == 1 else e[0] * 1000 + e[1] for e in expected]
    scene.count[None], scene.total[None] = 0, 0
    scene.visit()
    assert scene.count[None] == len(expected)
    assert scene.total[None] == sum((c + 1) * (c + 7) for c in codes)
    dense = np.zeros(scene.shape, np.int32)
    for element, value in model.values.items():
        dense[element] = value
    np.testing.assert_array_equal(scene.field.to_numpy(), dense)
    for level in model.sparse:
        cells = {tuple(c) for c in scene.nodes[level].active_cells().tolist()}
        assert cells == model.active[level]


def run_scene(seed, sequences):
    choice = random.Random(seed)
    ti.init(arch=ti.cpu)
    scene = Scene(choice)
    for number in range(sequences):
        try:
            run_sequence(scene, choice)
        except AssertionError as error:
            raise AssertionError(f"seed {seed}, sequence {number}, {scene.levels}") from error


@pytest.mark.parametrize("seed", range(12))
def test_trees_behave_as_the_model(seed):
    run_scene(seed, 40)


if __name__ == "__main__":
    wanted = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    for number in range((wanted + 99) // 100):
        run_scene(1000 + number, 100)
    print(f"{(wanted + 99) // 100 * 100} sequences, 0 mismatches")
