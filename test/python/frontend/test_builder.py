"""The builder: each method makes an operation that the verifier takes, with the given operands."""

import pytest
import tai as ti
from tai._impl.base.program import get_program
from tai._impl.fields.root import materialize
from tai._impl.values.builder import ORDERED, SIGNED, UNSIGNED, Builder


class Made:
    """A kernel of two numbers, `f32` and `i32`, and an array of floats, under construction."""

    def __init__(self):
        self.builder = b = Builder(get_program().context, __file__)
        self.region = b.region()
        self.arguments = ["f32", "i32", "memref<?xf32>"]
        self.entry = b.block(self.region, [b.type(t) for t in self.arguments], ["a", "n", "y"])
        b.set_block(self.entry)
        self.number, self.whole, self.array = (self.entry.argument(i) for i in range(3))
        self.f32, self.i1, self.index = (b.type(t) for t in ("f32", "i1", "index"))
        self.vector, self.matrix = b.type("vector<2xf32>"), b.type("vector<2x2xf32>")

    def at(self, number: int):
        return self.builder.constant(self.entry, self.index, number)

    def block_of(self, types=()):
        """A region, standing in its only block."""
        region = self.builder.region()
        block = self.builder.block(region, types)
        self.builder.set_block(block)
        return region, block

    def text(self, *results, result=None, **kernel) -> str:
        """The module, which the compiler has taken."""
        self.builder.return_(results)
        self.builder.enter_module()
        self.builder.kernel("k", self.arguments, result, self.region, **kernel)
        text = self.builder.text()
        assert self.builder.finish("k") is not None
        return text


@pytest.fixture
def made() -> Made:
    ti.init(offline_cache=False)
    return Made()


def test_arithmetic(made):
    b, a = made.builder, made.number
    less = b.compare_floats(ORDERED["<"], a, b.apply("arith.negf", [a], made.f32), made.i1)
    more = b.compare_integers(SIGNED[">"], made.whole, made.whole, made.i1)
    below = b.compare_integers(UNSIGNED["<="], made.whole, made.whole, made.i1)
    chosen = b.select(less, a, b.random(7, made.f32), made.f32)
    b.select(b.apply("arith.andi", [more, below], made.i1), a, a, made.f32)
    text = made.text(chosen, result="f32")
    for part in ("arith.cmpf olt", "arith.cmpi sgt", "arith.cmpi ule", "tai.random", "7"):
        assert part in text, part


def test_vectors(made):
    b, a = made.builder, made.number
    pair = b.from_elements([a, a], made.vector)
    other = b.insert(b.extract(pair, [1], made.f32), pair, [0], made.vector)
    whole = b.broadcast(a, made.matrix)
    b.insert(a, whole, [0, 1], made.matrix)
    b.norm(other, made.f32, fast=False)
    fast = b.norm(other, made.f32, fast=True)
    u, _, v = b.decompose("svd", whole, [made.matrix] * 3)
    product = b.matmul(u, b.transpose(v, made.matrix), made.matrix)
    b.stop_gradient(b.solve(b.inverse(product, made.matrix), pair, made.vector), made.vector)
    b.outer(pair, pair, made.matrix)
    numbers = [b.dot(pair, other, made.f32), b.sum(pair, made.f32)]
    numbers += [b.determinant(whole, made.f32), b.trace(whole, made.f32)]
    three = made.builder.type("vector<3xf32>")
    b.cross(b.from_elements(numbers[:3], three), b.broadcast(a, three), three)
    text = made.text(fast, result="f32")
    assert "[1]" in text and "[0, 1]" in text and text.count("fast") == 1 and "tai.svd" in text


def test_fields(made):
    x = ti.Vector.field(2, ti.f32, shape=(3, 4), name="x")
    materialize(get_program())
    b, at, a = made.builder, [made.at(2), made.at(3)], made.number
    whole = b.load("x", at, [], made.vector)
    b.store("x", whole, at, [])
    b.store("x", b.load("x", at, [made.at(1)], made.f32), at, [made.at(0)])
    b.atomic("add", "x", a, at, [made.at(1)], made.f32)
    text = made.text()
    assert "#tai<atomic_kind add>" in text and x.single.symbol == "x"


def test_a_field_with_too_few_indices_is_refused(made):
    ti.field(ti.f32, shape=(3, 4), name="x")
    materialize(get_program())
    made.builder.load("x", [made.at(2)], [], made.f32)
    made.builder.return_()
    made.builder.enter_module()
    made.builder.kernel("k", made.arguments, None, made.region)
    with pytest.raises(ti.TaiError, match="ind"):
        made.builder.finish("k")


def test_levels(made):
    x, y = ti.field(ti.f32, name="x"), ti.field(ti.f32, name="y")
    ti.root.pointer(ti.i, 4).dense(ti.i, 8).place(x)
    ti.root.dense(ti.i, 4).dynamic(ti.j, 16).place(y)
    materialize(get_program())
    b = made.builder
    b.activate("x", 1, [made.at(1)])
    b.deactivate("x", 1, [made.at(2)])
    active = b.is_active("x", 1, [made.at(1)])
    b.append("y", made.number, [made.at(0)])
    count = b.length("y", [made.at(0)])
    b.assert_(active, "cell {} is not there", [count])
    made.text()


def test_arrays(made):
    b, at = made.builder, [made.at(0)]
    b.extent(made.array, made.at(0))
    value = b.load_from_array(made.array, at, made.f32)
    b.store_to_array(value, made.array, at)
    b.atomic_in_array("maxnumf", value, made.array, at, made.f32)
    b.print("{} of them", [made.whole])
    text = made.text(gradients=[2], conventions={"ties": '"split"', "guards": "false"})
    assert "memref.atomic_rmw maxnumf" in text and "{} of them" in text
    assert "array<i64: 2>" in text and 'ties = "split"' in text and "guards = false" in text


def test_branches_and_loops(made):
    b, a = made.builder, made.number
    yes = b.compare_floats(ORDERED["<"], a, a, made.i1)
    then, _ = made.block_of()
    b.yield_([a])
    orelse, _ = made.block_of()
    b.yield_([b.apply("arith.negf", [a], made.f32)])
    b.set_block(made.entry)
    chosen = b.if_(yes, [made.f32], then, orelse)
    body, block = made.block_of([made.index, made.f32])
    b.yield_([block.argument(1)])
    b.set_block(made.entry)
    summed = b.for_(made.at(0), made.at(9), made.at(1), [chosen], [made.f32], body)
    before, block = made.block_of([made.f32])
    b.condition_of_while(yes, [block.argument(0)])
    after, block = made.block_of([made.f32])
    b.yield_([block.argument(0)])
    b.set_block(made.entry)
    last = b.while_([summed], [made.f32], before, after)
    last = last[0] if isinstance(last, (list, tuple)) else last
    body, _ = made.block_of([made.index])
    b.end_of_parallel_for()
    b.set_block(made.entry)
    b.parallel_for(body, [made.at(0)], [made.at(5)], is_serial=True, block_dim=64)
    text = made.text(last, result="f32")
    for part in ("scf.if", "scf.for", "scf.while", "tai.parallel_for", "serialize", "block_dim"):
        assert part in text, part


def test_loops_over_fields_and_levels(made):
    x = ti.field(ti.f32, name="x")
    ti.root.pointer(ti.i, 4).dense(ti.i, 8).place(x)
    materialize(get_program())
    b = made.builder
    for level in (None, 1):
        body, _ = made.block_of([made.index])
        b.end_of_parallel_for()
        b.set_block(made.entry)
        b.parallel_for(body, field="x", level=level)
    made.text()
