"""Mistakes of people who come from NumPy, Taichi, torch or JAX: each is an error with a hint, in
the words of the program. A hint is followed: its names exist, and its expressions compile."""

import ast
import math
import re
import warnings

import numpy as np
import pytest
import tai as ti
from tai._impl.base import state

HEAD = """import math
import numpy as np
import tai as ti

ti.init(arch=ti.cpu)
N = 8
x = ti.field(ti.f32, N)
y = ti.field(ti.f32, (4, 4))
k = ti.field(ti.i32, N)
v = ti.Vector.field(3, ti.f32, N)
m = ti.Matrix.field(3, 3, ti.f32, N)
loss = ti.field(ti.f32, (), needs_grad=True)
z = ti.field(ti.f32, N, needs_grad=True)
S = ti.types.struct(pos=ti.math.vec3, mass=ti.f32)
s = S.field(shape=N)
a = ti.ndarray(ti.f32, N)
table = [1.0, 2.0, 3.0]

@ti.func
def twice(q):
    return 2 * q

@ti.kernel
def empty():
    pass

@ti.kernel
def scale(f: ti.f32, n: ti.i32) -> ti.f32:
    return f * n

@ti.kernel
def fill(q: ti.types.ndarray(dtype=ti.f32, ndim=1)):
    for i in q:
        q[i] = 1.0
"""

# One statement of a kernel each.
IN_KERNELS = """\
x += 1
x = x + 1
for e in x: e = 1.0
for e in x: print(e + x)
for i, e in enumerate(x): x[i] = e
for p in s: p.mass = 1.0
x[:] = 1.0
x[0:3] = x[3:6]
x[...] = 0.0
x[-1] = 1.0
y[0] = 1.0
y[0][1] = 1.0
x[0, 0] = 1.0
x[0.5] = 1.0
x[x[0]] = 1.0
x[None] = 1.0
loss[0] = 1.0
b = x.sum()
b = x.max()
b = x.mean()
b = x.T
b = x.dtype.name + 1
b = len(x) + x
b = sum(x)
b = max(x)
b = sorted(table)[x[0]]
b = [e * 2 for e in x]
b = list(x)
b = table[k[0]]
table.append(1.0)
table[0] = x[0]
b = np.zeros(N); b[0] = x[0]
b = np.maximum(x[0], 0.0)
b = np.sum(x)
b = np.exp(x[0])
b = np.linalg.norm(v[0])
b = np.random.rand()
b = np.array(x)
b = math.gamma(x[0])
b = ti.zeros(3)
b = ti.exp2(x[0])
b = ti.absolute(x[0])
b = ti.arctan2(x[0], x[1])
b = ti.maximum(x[0], x[1])
b = ti.norm(v[0])
b = ti.dot(v[0], v[1])
b = ti.length(x)
b = ti.mean(x[0])
b = ti.field(ti.f32, 3)
b = ti.Vector(3)
b = ti.Vector([x, x])
b = ti.Vector.zero(ti.f32, k[0])
b = v[0] @ v[1]
b = v[0] * m[0]
b = m[0] * v[0] + 1.0 * x
b = v[0].dot(1.0)
b = v[0].cross(ti.Vector([1.0, 2.0]))
b = v[0].length()
b = v[0].magnitude
b = v[0].w
b = v[0][3]
b = v[0].xyzw
b = v[0].normalised()
b = m[0].T
b = m[0].inv()
b = m[0][0]; c = b[3]
b = m[0].det()
b = v[0] and x[0] > 0
b = ti.Matrix([[1, 2], [3]])
v[0] = [1.0, 2.0]
x[0] = v[0]
m[0] = v[0]
b = s[0].velocity
s[0].mas = 1.0
s[0] = 1.0
b = S(pos=1.0, speed=2.0)
b = s[0] + s[1]
b = x[0].item()
b = x[0].grad
z.grad = 0.0
b = int('3' + str(x[0]))
b = str(x[0]) + 1
b = f'{x[0]}' + 1
b = 'abc' * x[0]
x[0] = f'{x[0]}'
b = k[0] / 'a'
b = x[0] & 1
b = ~x[0]
b = x[0] << 1
b = k[0] ^ x[0]
b = not v[0]
b = -'a'
b = x[0] and table
b = x[0] is None
b = undefined + 1
b = xx[0]
b = rnage(3)
b = supper(3)
b = numpy.sin(x[0])
b = torch.sin(x[0])
b = jnp.sin(x[0])
b = math.Pi
b = ti.pi
b = math.pi()
b = twice()
b = twice(1, 2)
b = twice(r=1)
b = empty()
b = scale(1.0, 2)
b = lambda q: q
b = {e: 1 for e in x}
yield 1
return 1
return x
raise ValueError('a')
def inner(): return 1
class A: pass
global N; N = 3
del x
b: ti.f33 = 1.0
b, c = x[0]
b, c = 1, 2, 3
b, c = v[0]
b = c = d
for i in range(x): pass
for i in range(2.0): pass
for i in range(0, 1, 0.1): pass
for i in range(k[0], 5, x[1]): x[i] = 1
for i in range(3, step=2): pass
for i in 10: pass
for i in N: x[i] = 1
for i in v[0].x: pass
for i, j in x: x[i] = 1
for i in y: x[i] = 1
for i, j in range(3): pass
for i in ti.ndrange(2, 3): x[i] = 1
for i, j, l in ti.ndrange(2, 3): pass
for i in ti.grouped(range(3)): pass
for i in ti.static(x): x[i] = 1
for i in ti.static(range(k[0])): pass
while x: pass
while v[0]: pass
if v[0]: pass
if x == None: pass
for i in x: break
for i in range(3): return 1
for i in range(3): yield i
if ti.static(x[0] > 1): pass
assert x[0] > 0, x[0]
assert v[0] == v[1]
print('%q' % x[0])
print(x[0], file=3)
print(f'{x[0]:>d}')
ti.sync()
ti.init()
ti.atomic_add(x[0])
ti.atomic_add(1.0, x[0])
ti.atomic_min(N, x[0])
ti.loop_config(threads=3)
ti.loop_config(block_dim=k[0])
ti.select(x[0] > 0, 1.0)
ti.cast(x[0])
ti.cast(x[0], 'f32')
ti.cast(v, ti.f32)
b = ti.f33(x[0])
b = ti.random('f32')
b = ti.random(0, 1)
ti.append(x, 0, 1)
b = ti.svd(v[0])
b = ti.sqrt('a')
b = ti.sqrt(x)
b = ti.sin(v)
b = ti.max()
b = ti.max(x)
b = ti.pow(x[0])
b = abs()
b = abs(x)
b = round(v)
b = min(x[0], 'a')
b = zip(x, y)
b = open('a.txt').read()
b = input()
b = isinstance(x[0], ti.f32) + s
a[0] = 1.0
b = x[0] ** v
b = None + 1
b = (1, 2)[k[0]]
b = {'a': 1}[k[0]]
b = {'a': 1}['b']
x[i] = 1.0
b = x(0)
b = v(0)
b = x[0](1)
b = x.y
x.foo = 1
b = x.grad[0] + y.grad[0, 0]
b = x.shape + 1
b = x.shape[1]
b = y.shape[2]
x.parent().append(1)
ti.root.dense(ti.i, 3)
b = ti.ad.Tape(loss)
loss.backward()
b = ti.f32 + 1
b = range(3)[k[0]]
"""

# One statement of Python each.
IN_PYTHON = """\
x[9]
x[-9]
x[0, 0]
x['a']
x[0.5]
x[0:3]
x[0] = 'a'
x[0] = [1, 2]
x[0] = None
x[0] = v[0]
v[0] = [1, 2]
v[0] = 'abc'
m[0] = [1, 2, 3]
k[0] = 1.5
k[0] = 2**40
x.fill('a')
x.fill([1, 2])
x.from_numpy(np.zeros(9))
x.from_numpy(np.zeros((8, 1)))
x.from_numpy('abc')
x.from_numpy(None)
x.from_numpy(3)
v.from_numpy(np.zeros(8))
k.from_numpy(np.full(8, 1e30))
x.copy_from(y)
x.copy_from(np.zeros(8))
x.copy_from(3)
for e in x: pass
list(x)
x + 1
x * y
s[0] = 1
s.mass[9]
S(1, 2, 3)
S(speed=1)
ti.field(ti.f32, -3)
ti.field(ti.f32, 'a')
ti.field('f32', 3)
ti.field(ti.f32, 3.0)
ti.field(ti.f32, 3, 4, 5)
ti.field(dtype=None, shape=3)
ti.field(ti.f32, shape=3, name=3)
ti.field(ti.f32, shape=3, order='ji')
ti.field(ti.f32, shape=3, offset=(1, 2))
ti.field(ti.i32, 3, needs_grad=True)
ti.Vector.field(0, ti.f32, 3)
ti.Vector.field(3, ti.f32, 'a')
ti.Vector.field(ti.f32, 3)
ti.Matrix.field(2, ti.f32, 3)
ti.Vector('abc')
ti.Vector([1, 'a'])
ti.Vector([1, 2]) + ti.Vector([1, 2, 3])
ti.Vector([1, 2]) @ ti.Matrix([[1, 2, 3]])
ti.Matrix([[1, 2], [3]])
ti.Matrix([[1, 2, 3]]).inverse()
scale()
scale(1.0)
scale(1.0, 2, 3)
scale(1.0, 2.5)
scale('a', 2)
scale(x, 2)
scale(np.zeros(3), 2)
scale(n=1)
scale(1.0, n='a')
scale(1.0, 2, q=3)
fill([1, 2, 3])
fill(x)
fill(np.zeros(3))
fill(np.zeros((3, 3), np.float32))
fill(None)
fill(3)
fill()
twice(3)
ti.init(arch='gpuu')
ti.init(debgu=True)
ti.init(arch=ti.cpu, default_fp=ti.i32)
ti.init(default_fp='f32')
ti.init(cpu_max_num_threads='a')
ti.init(random_seed='a')
ti.types.vector(3, 'f32')
ti.types.matrix(2, 2, None)
ti.types.struct()
ti.types.struct(a=3)
ti.types.struct(a='f32')
ti.types.ndarray(dtype='f32')
ti.ndarray(ti.f32, -1)
ti.ndarray('f32', 3)
a[9]
a[0, 0]
a['a']
a[0] = 'a'
a.from_numpy(np.zeros(9))
ti.root.dense(ti.i, 3).place(x)
ti.root.dense('i', 3)
ti.root.dense(ti.i, -3)
ti.root.dense(ti.ij, (3,4,5))
ti.root.place(3)
ti.ad.Tape(3).__enter__()
ti.ad.Tape(x).__enter__()
ti.ad.Tape(y).__enter__()
x.grad.fill(0)
x.grad[0]
scale.grad(1.0)
empty.grad()
ti.kernel(3)
ti.func(3)
ti.kernel(print)
ti.sqrt('a')
ti.sqrt(x)
ti.max(1)
ti.cast(1.5, 'f32')
ti.tools.imread('none.png')
ti.tools.imwrite(np.zeros(3), 'a.png')
ti.i32(1e300)
ti.u8(-1e30)
"""

DEFINITIONS = [
    "@ti.kernel\ndef f(q): pass",
    "@ti.kernel\ndef f(q: 3): pass\nf(1)",
    "@ti.kernel\ndef f(q: list): pass\nf([1])",
    "@ti.kernel\ndef f(q: np.ndarray): pass\nf(np.zeros(3))",
    "@ti.kernel\ndef f(q: 'foo'): pass\nf(1)",
    "@ti.kernel\ndef f(*q): pass",
    "@ti.kernel\ndef f(**q): pass",
    "@ti.kernel\ndef f(): return 1\nf()",
    "@ti.kernel\ndef f() -> ti.f32: pass\nf()",
    "@ti.kernel\ndef f() -> ti.f32:\n    return 1.0, 2.0\nf()",
    "@ti.kernel\ndef f() -> list:\n    return [1]\nf()",
    "@ti.kernel\ndef f() -> ti.f32:\n    if x[0] > 0:\n        return 1.0\nf()",
    "@ti.kernel\nasync def f(): pass\nf()",
    "f = ti.kernel(lambda q: q)",
    "f = ti.kernel(lambda: 1)\nf()",
    "@ti.kernel\nclass A: pass",
    "@ti.func\nclass A: pass",
    "@ti.kernel(fast=True)\ndef f(): pass",
    "@ti.kernel(precision='f33')\ndef f(): pass",
    "class A:\n    @ti.kernel\n    def f(self): self.n = 1\nA().f()",
    "class A:\n    @ti.kernel\n    def f(self): x[0] = self.q\nA().f()",
    "class A:\n    @ti.kernel\n    def f(): x[0] = 1\nA().f()",
    "@ti.dataclass\nclass A: pass",
    "@ti.dataclass\nclass A:\n    q: str",
    "@ti.dataclass\nclass A:\n    q: list",
    "@ti.func\ndef g(n): return g(n - 1)\n@ti.kernel\ndef f(): x[0] = g(3)\nf()",
    "@ti.kernel\ndef f(q: ti.template()): q[0] = 1\nf(3)",
    "@ti.kernel\ndef f(q: ti.template()):\n    for i in q: pass\nf(None)",
    "@ti.kernel\ndef f():\n    for i in z: loss[None] += z[i]\n"
    "with ti.ad.Tape(loss): f(); f.grad(1)",
    "@ti.kernel\ndef f(n: ti.i32):\n    v = ti.Vector([0.0 for _ in range(n)])\nf(3)",
    "@ti.kernel\ndef f(n: ti.i32):\n    b = [0.0] * n\nf(3)",
]

KERNELS = IN_KERNELS.splitlines()
STATEMENTS = IN_PYTHON.splitlines()
PROGRAMS = [
    *("@ti.kernel\ndef f():\n    " + "\n    ".join(k.split("; ")) + "\nf()" for k in KERNELS),
    *STATEMENTS,
    *DEFINITIONS,
]

# Names of our classes, addresses and places of ours mean nothing to the program.
INSIDE = re.compile(
    r"\b(?:Value|FormattedText|ArrayArgument|StructValue|MatrixValue|StructPlace|VariablePlace|"
    r"ScalarField|MatrixField|NoneType)\b|_impl|mlir|0x[0-9a-f]{6}|iterated in kernels|'super'"
)
NAMES = re.compile(r"\b(?:ti|np)(?:\.[A-Za-z_]\w*)+")


def run(text, path):
    path.write_text(text)
    names = {"__name__": "newcomer"}
    exec(compile(text, str(path), "exec"), names)
    return names


def close_what_is_open():
    if state.tape is not None:
        pytest.fail("a tape is left open")


def check_names(hint):
    """The names that a hint proposes exist."""
    for name in NAMES.findall(hint):
        found = {"ti": ti, "np": np}[name.split(".")[0]]
        for part in name.split(".")[1:]:
            assert hasattr(found, part), f"{name} in: {hint}"
            found = getattr(found, part)


def test_there_are_many():
    assert len(KERNELS) > 150 and len(STATEMENTS) > 90 and len(set(PROGRAMS)) > 300


@pytest.mark.parametrize("number", range(len(PROGRAMS)))
def test_mistake_has_a_hint_in_words_of_the_program(number, tmp_path):
    text = HEAD + PROGRAMS[number] + "\n"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(ti.TaiError) as caught:
            run(text, tmp_path / "program.py")
    error = caught.value
    assert error.hint, error.message
    assert not INSIDE.search(f"{error.message} {error.hint}"), str(error)
    check_names(error.hint)
    close_what_is_open()


# Functions of NumPy and math, with arguments that all of them take; the hints are followed.

ONE = """absolute abs fabs cbrt square exp2 expm1 log2 log10 log1p arcsin arccos arctan sinh cosh
arcsinh arctanh rint trunc sign negative positive reciprocal isnan isinf isfinite deg2rad rad2deg
degrees radians signbit logical_not sqrt exp log sin cos tan tanh floor ceil round""".split()
TWO = """maximum minimum fmax fmin power float_power arctan2 hypot fmod mod remainder divide
floor_divide add subtract multiply logical_and logical_or logical_xor equal less greater copysign
heaviside logaddexp isclose""".split()
WHOLE = "bitwise_and bitwise_or bitwise_xor left_shift right_shift invert".split()
OF_MATH = "isnan isinf degrees radians fmod isclose".split()
CALLS = [
    *(f"np.{name}(a)" for name in ONE), *(f"np.{name}(a, b)" for name in TWO),
    *(f"np.{name}(n, k)" if name != "invert" else "np.invert(n)" for name in WHOLE),
    *(f"math.{name}(a{', b' * (name in ('fmod', 'isclose'))})"
      for name in OF_MATH),
    "np.arccosh(a + 1)", "np.clip(a, 0.2, 0.5)", "np.where(a > 0.5, a, b)",
    "np.ldexp(a, k)", "np.float32(a)", "np.int32(a)",
]  # fmt: skip


@pytest.mark.parametrize("call", CALLS)
def test_hints_for_other_libraries_are_followed(call, tmp_path):
    program = """import math
import numpy as np
import tai as ti

@ti.kernel
def f(a: ti.f64, b: ti.f64, n: ti.i32, k: ti.i32) -> ti.f64:
    return {}
"""
    arguments = {"a": 0.4, "b": -0.7, "n": 13, "k": 3}
    if "power" in call or "logical" in call:
        arguments["b"] = 0.7
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    names = run(program.format(call), tmp_path / "wrong.py")
    with pytest.raises(ti.TaiTypeError) as caught:
        names["f"](**arguments)
    hint = caught.value.hint
    assert hint.startswith("write "), hint
    expression = hint.removeprefix("write ").partition(", which ")[0]
    ast.parse(expression)
    check_names(hint)
    # A truth value is a number in the result.
    names = run(program.format(f"ti.cast({expression}, ti.f64)"), tmp_path / "right.py")
    expected = eval(call, {"np": np, "math": math, **arguments})
    assert names["f"](**arguments) == pytest.approx(float(expected), rel=1e-6)


@pytest.mark.parametrize(
    "call",
    ["np.linalg.norm(w)", "np.sum(w)", "np.max(w)", "np.min(w)", "np.linalg.det(m)"],
)
def test_hints_for_vectors_are_followed(call, tmp_path):
    program = """import numpy as np
import tai as ti

@ti.kernel
def f(a: ti.f64) -> ti.f64:
    w = ti.Vector([a, 2.0, 3.0])
    m = ti.Matrix([[a, 2.0], [3.0, 4.0]])
    return {}
"""
    ti.init(arch=ti.cpu, default_fp=ti.f64)
    names = run(program.format(call), tmp_path / "wrong.py")
    with pytest.raises(ti.TaiTypeError) as caught:
        names["f"](1.5)
    names = run(program.format(caught.value.hint.removeprefix("write ")), tmp_path / "right.py")
    values = {"np": np, "w": np.array([1.5, 2, 3]), "m": np.array([[1.5, 2], [3, 4]])}
    assert names["f"](1.5) == pytest.approx(eval(call, values))
