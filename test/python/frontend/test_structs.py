"""Structs in kernels: variables, arguments of functions, nested members, layouts."""

import numpy as np
import pytest
import tai as ti


def pair():
    return ti.types.struct(a=ti.i32, b=ti.types.vector(2, ti.f32))


def test_variables_change_in_branches_and_loops():
    made = pair()
    f = made.field(shape=3)

    @ti.func
    def bump(p: ti.template(), k):
        p.a += k

    @ti.func
    def make(k):
        return made(a=k, b=[k, k])

    @ti.func
    def keep(p):
        p.a = 1000
        return p.b[1]

    @ti.kernel
    def run(n: ti.i32) -> ti.f32:
        p = made(a=1, b=[2.0, 3.0])
        i = 0
        while i < n:
            p.a += i
            if i % 2 == 0:
                p.b[0] += 1.0
            i += 1
        bump(p, 100)
        q = make(7)
        f[0], f[1] = p, q
        for _ in range(2):
            q.a += 1
        q = made(q.a + 1, q.b)
        f[2] = q
        return keep(p)

    assert run(5) == 3.0
    assert [f[k].a for k in range(3)] == [111, 7, 10]
    assert f[0].b.to_list() == [5, 3] and f[2].b.to_list() == [7, 7]


def test_variables_are_shared_by_parallel_iterations():
    made = pair()

    @ti.kernel
    def run() -> ti.i32:
        p = made(a=1, b=[0.0, 0.0])
        for i in range(10):
            p.a += i
        return p.a

    assert run() == 46


def test_nested_structs_and_defaults():
    inner = ti.types.struct(u=ti.f32, w=ti.i32)
    outer = ti.types.struct(p=inner, q=ti.f32)
    f = outer.field()
    ti.root.pointer(ti.i, 4).dense(ti.i, 2).place(f)

    @ti.kernel
    def run():
        f[3].p.u = 2.0
        f[3].q = f[3].p.u + 1
        o = outer(p=inner(u=5.0, w=3), q=1.0)
        o.p.w += 4
        f[6] = o
        f[7] = outer(q=2.0)

    run()
    assert (f[3].q, f[6].p.w, f[6].p.u, f.p.w[6], f[7].q, f[7].p.u) == (3, 7, 5, 7, 2, 0)
    assert outer(q=2.5).to_dict() == {"p": {"u": 0.0, "w": 0}, "q": 2.5}


def test_layouts_and_whole_fields():
    soa = ti.Struct.field({"a": ti.f32, "b": ti.i32}, shape=4, layout=ti.Layout.SOA)
    aos = ti.Struct.field({"a": ti.f32, "b": ti.i32}, shape=4)
    soa[2].a, soa[2].b = 3, 4
    assert soa.a.parent()._cell_size_bytes == 4 and aos.a.parent()._cell_size_bytes == 8
    aos.copy_from(soa)
    assert (aos[2].a, aos[2].b, aos[1].b) == (3, 4, 0)
    aos.fill(2)
    aos.from_numpy({"a": np.arange(4, dtype=np.float32)})
    assert aos.to_numpy()["a"].tolist() == [0, 1, 2, 3] and aos[3].b == 2
    aos[0] = {"a": 9, "b": 8}
    aos[1] = ti.Struct(a=7, b=6)
    assert (aos[0].a, aos[0].b, aos[1].a, aos[1].b) == (9, 8, 7, 6)
    assert aos.keys == ["a", "b"] and aos.get_member_field("a") is aos.a


def test_gradients_and_duals_are_there_at_once():
    f = ti.Struct.field(
        {"a": ti.f32, "v": ti.types.vector(3, ti.f32), "n": ti.i32},
        shape=(2, 3), offset=(1, 0), needs_grad=True, needs_dual=True,
    )  # fmt: skip
    assert f.a.grad[1, 2] == 0 and f.v.dual.shape == (2, 3) and f.dual.a[2, 0] == 0
    assert f.grad.keys == ["a", "v"] and f.grad.v.element_shape == (3,)


def test_gradient_through_a_struct_variable():
    made = ti.types.struct(x=ti.f64, y=ti.f64)
    f = made.field(shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in f:
            p = f[i]
            for _ in range(3):
                p.x = p.x * p.y
            loss[None] += p.x

    for k in range(3):
        f[k] = made(k + 1.0, k + 2.0)
    with ti.ad.Tape(loss):
        run()
    for k in range(3):
        x, y = k + 1.0, k + 2.0
        assert np.isclose(f.grad[k].x, y**3) and np.isclose(f.grad[k].y, 3 * x * y**2)


def test_a_copy_has_the_type_that_is_asked_for():
    f = pair().field(shape=3)
    assert {k: a.dtype.name for k, a in f.to_numpy().items()} == {"a": "int32", "b": "float32"}
    wide = f.to_numpy(dtype=np.float64)
    assert {a.dtype.name for a in wide.values()} == {"float64"}


def test_a_gradient_that_is_not_there_is_named():
    f = ti.Struct.field({"a": ti.f32}, shape=3, name="f")
    with pytest.raises(ti.TaiAutodiffError, match="field 'f' has no gradient"):
        f.grad[0]
    with pytest.raises(ti.TaiAutodiffError, match="field 'f' has no dual"):
        f.dual[0]


def test_a_gradient_that_was_not_placed_is_said_to_be():
    x = ti.field(ti.f32, needs_grad=True)
    ti.root.dense(ti.i, 3).place(x)
    with pytest.raises(ti.TaiAutodiffError, match="place it too: level.place"):
        x.grad.fill(1.0)


def test_structs_without_a_type_of_their_own():
    particle = ti.types.struct(a=ti.f32, v=ti.math.vec2)
    outer, x = particle(2.0, [3, 4]), particle.field(shape=2)

    @ti.func
    def make(x):
        return ti.Struct(a=x, b=x * 2, v=ti.Vector([x, x]), inner=ti.Struct(q=1))

    @ti.func
    def use(s):
        s.a += 1
        return s.a + s.v.x

    @ti.kernel
    def kernel() -> ti.types.vector(6, ti.f32):
        s = make(3.0)
        s.a = 10.0
        s.v[1] += 1
        s.inner.q = 4
        ti.loop_config(serialize=True)
        for i in range(3):
            s.a += 1
            if i == 1:
                s = make(1.0)
        h = outer
        h.a = 7.0
        x[0], x[1] = h, outer
        return ti.Vector([s.a, s.b, s.v[1], s.inner.q, use(outer), outer.a])

    assert list(kernel()) == [2, 2, 1, 1, 6, 2]
    assert x.a.to_numpy().tolist() == [7, 2]
    assert x.v.to_numpy().tolist() == [[3, 4]] * 2
    assert outer.a == 2.0


def test_methods_for_python():
    @ti.dataclass
    class Ball:
        x: ti.f32

        @ti.func
        def square(self):
            return self.x**2

        def times(self, factor=2):
            return self.x * factor

    balls = Ball.field(shape=2)
    balls[1].x = 7
    assert Ball(3.0).times() == 6.0 and balls[1].times(3) == 21.0
    with pytest.raises(ti.TaiSyntaxError, match="in kernels only"):
        Ball(3.0).square()
    with pytest.raises(AttributeError, match="no member 'other'"):
        Ball(3.0).other()

    @ti.kernel
    def kernel() -> ti.f32:
        return Ball(3.0).times()

    with pytest.raises(ti.TaiTypeError, match="'times' of the struct is one for Python"):
        kernel()


def test_members_may_be_named_like_attributes_of_a_field():
    # Nodes of trees have a `parent`, a `level`, a `first` child: Taichi takes all of these names.
    names = "copy_from dual fill first grad leaves level name offset parent parts type".split()
    made = ti.types.struct(**dict.fromkeys(names, ti.i32))
    f = made.field(shape=3)

    @ti.kernel
    def run() -> ti.i32:
        for i in f:
            f[i].fill, f[i].leaves, f[i].parts, f[i].copy_from = i, i, i, i
            f[i].dual, f[i].grad, f.name[i], f.offset[i] = i, i, i, i
            f[i].first, f[i].level, f[i].parent, f[i].type = i, i, i, i
        total = 0
        for i in f.parent:
            node = f[i]
            total += node.first + node.level + node.parent + node.type + node.offset + node.name
            total += f.parent[i] * 100 + f.level[i] * 1000 + f.fill[i] + f.grad[i]
        return total

    assert run() == 3 * (6 + 100 + 1000 + 2)
    for name in names:
        member = getattr(f, name)
        assert member.to_numpy().tolist() == [0, 1, 2], name
        setattr(f[1], name, 7)
        assert member[1] == getattr(f[1], name) == 7, name
    assert f.shape == (3,) and f.to_numpy()["level"].tolist() == [0, 7, 2]


def test_members_with_names_of_a_field_that_is_placed_later():
    made = ti.types.struct(level=ti.i32, parent=ti.f32)
    f = made.field(needs_grad=True)
    with pytest.raises(ti.TaiRuntimeError, match="is not placed"):
        f.shape  # noqa: B018
    assert str(f) == "<field 'f', not placed>"
    ti.root.dense(ti.i, 3).place(f)
    assert "level" in str(f) and "not placed" not in str(f)
    assert f.shape == (3,) and f.snode.parent() is f.level.parent()
    ti.root.lazy_grad()
    f.parent.grad.fill(2.0)
    assert f.grad.parent[1] == 2.0


def test_names_and_values_of_a_struct():
    made = ti.types.struct(a=ti.i32, b=ti.f32)
    f = made.field(shape=2)
    f[1] = made(a=3, b=0.5)
    for struct in (made(a=3, b=0.5), ti.Struct(a=3, b=0.5), f[1]):
        assert struct.keys == ["a", "b"]
        assert list(struct.items) == [("a", 3), ("b", 0.5)]

    @ti.kernel
    def count(s: made) -> ti.i32:
        n = 0
        for name in ti.static(s.keys):
            n += 10 + ti.static(len(name))
        return n

    assert count(f[1]) == 22


@ti.dataclass
class Counter:
    t: ti.f64
    v: ti.types.vector(2, ti.f64)

    @ti.func
    def add(self, k):
        self.t += k

    @ti.func
    def add_large(self, k):
        if k > 1:
            self.t += k
            self.v[1] = k
        for i in range(3):
            if i > 0:
                self.v.x += i

    @ti.func
    def total(self):
        return self.t + self.v.sum()


@ti.dataclass
class Two:
    a: Counter
    b: Counter
    n: ti.i32

    @ti.func
    def run(self, k):
        if k > 0:
            self.a.add_large(k)
        else:
            self.b.add(5)
        while self.n < 4:
            self.n += 1
            if self.n == 2:
                self.b.v[self.n - 1] = 9


def test_methods_change_local_structs_in_branches_and_loops():
    ti.init(default_fp=ti.f64)
    f = Two.field(shape=2)

    @ti.kernel
    def run(q: ti.f64) -> ti.types.vector(5, ti.f64):
        one, two = Counter(t=1.0), Two()
        if q > 1:
            one.add(q)
        for i in range(3):
            one.add(i)
        one.add_large(q)
        two.a.add_large(2.0)
        if q > 1:
            two.b.add_large(q)
        two.run(q)
        f[1] = two
        if q > 1:
            f[0].run(q)
        return [one.t, one.v[0], two.a.total(), two.b.total(), two.n]

    assert run(2.0).to_list() == [8, 3, 12, 14, 4]
    assert f[0].a.t == 2.0 and f[1].a.v.to_list() == [6, 2]
    assert run(-1.0).to_list() == [4, 3, 7, 14, 4]


def test_gradients_pass_through_methods_in_branches():
    ti.init(default_fp=ti.f64)
    x = ti.field(ti.f64, shape=3, needs_grad=True)
    loss = ti.field(ti.f64, shape=(), needs_grad=True)

    @ti.kernel
    def run():
        for i in x:
            s = Counter()
            for j in range(i + 1):
                if j != 1:
                    s.add(x[i] ** 2)
            loss[None] += s.total()

    x.fill(3.0)
    with ti.ad.Tape(loss):
        run()
    assert x.grad.to_numpy().tolist() == [6, 6, 12]


def test_a_method_that_only_reads_leaves_a_struct_where_it_is():
    """A struct that a parallel loop changes is moved to memory; one that it reads is not."""
    x = ti.field(ti.f64, shape=8)

    @ti.kernel
    def run(k: ti.f64):
        s = Counter(t=k)
        for i in x:
            x[i] = s.total() + i

    run(2.0)
    assert x.to_numpy().tolist() == [2.0 + i for i in range(8)]
    assert "run_s" not in run.explain()


def test_components_that_a_function_changes_in_branches():
    @ti.func
    def swap(a: ti.template(), b: ti.template()):
        a, b = b, a

    @ti.func
    def sort(a: ti.template(), b: ti.template()):
        if a > b:
            swap(a, b)

    @ti.func
    def add(a: ti.template(), n):
        for i in range(n):
            if i % 2 == 1:
                a += i

    @ti.kernel
    def run(n: ti.i32) -> ti.types.vector(5, ti.f64):
        v = ti.Vector([3.0, 1.0, 2.0], dt=ti.f64)
        s = Counter(t=1.0, v=[5.0, 4.0])
        sort(v[0], v[1])
        sort(v[1], v[2])
        sort(s.v[0], s.v.y)
        if n > 3:
            add(v[n % 3], n)
        add(s.t, n)
        return [v[0], v[1], v[2], s.v[0] * 10 + s.v[1], s.t]

    assert run(4).to_list() == [1, 6, 3, 45, 5]


@ti.dataclass
class Jar:
    t: ti.i32
    v: ti.types.vector(2, ti.i32)

    @ti.func
    def take(self, other: ti.template()):
        self.t += other
        other = 0

    @ti.func
    def pour(self, other: ti.template(), k):
        if k > 0:
            other.t += self.t
            self.t = 0

    @ti.func
    def take_own(self, k):
        if k > 0:
            self.take(self.v[0])


def test_methods_change_what_they_are_given_by_reference():
    @ti.kernel
    def run(q: ti.i32) -> ti.types.vector(5, ti.i32):
        a, b, x = Jar(t=1), Jar(t=10, v=[3, 4]), 7
        y = ti.Vector([5, 6])
        if q > 0:
            a.take(x)
        for i in range(2):
            if i == q:
                a.take(y[i])
        if q > 0:
            a.pour(b, q)
        ti.loop_config(serialize=True)
        for i in range(3):
            b.take_own(i - q)
        return [a.t, b.t, x, y[0] * 10 + y[1], b.v[0]]

    assert run(0).to_list() == [6, 13, 7, 6, 0]
    assert run(1).to_list() == [0, 27, 0, 50, 0]
    assert run(2).to_list() == [0, 18, 0, 56, 3]


@ti.dataclass
class Leaver:
    a: ti.i32

    @ti.func
    def climb(self, k):
        self.a += 1
        if self.a > k:
            return self.a
        self.a += 10
        return -1


def test_methods_that_return_early_change_a_struct_once():
    """Their body is walked once before, to find the types of their results."""

    @ti.kernel
    def once(k: ti.i32) -> ti.i32:
        s = Leaver()
        return s.climb(k) + 100 * s.a

    @ti.kernel
    def asked(k: ti.i32) -> ti.types.vector(2, ti.i32):
        s, total = Leaver(), 0
        while s.climb(k) < 30 and total < 50:
            total += s.a
        if k > 0 or s.climb(k) > 0:
            s.a *= 2
        return [s.a, total]

    assert once(2) == 1099 and once(0) == 101
    assert asked(2).to_list() == [30, 50] and asked(0).to_list() == [24, 55]


@ti.dataclass
class Giver:
    v: ti.i32

    @ti.func
    def give(self, other: ti.template()):
        other.take_from(self.v)


@ti.dataclass
class Taker:
    w: ti.i32

    @ti.func
    def take_from(self, v: ti.template()):
        v += 2
        self.w += 1


def test_a_method_gives_a_member_to_one_of_an_argument():
    """The type of the member is known from the call alone."""

    @ti.kernel
    def run(q: ti.i32) -> ti.types.vector(2, ti.i32):
        giver, taker = Giver(v=1), Taker(w=10)
        if q > 0:
            giver.give(taker)
        for _ in range(q):
            giver.give(taker)
        return [giver.v, taker.w]

    assert run(0).to_list() == [1, 10]
    assert run(3).to_list() == [9, 14]
