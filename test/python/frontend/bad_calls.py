"""Programs with wrong calls, arguments and objects, each in one way; see bad_expressions.py."""

# ruff: noqa: B018, F821, F841, E712, SIM102, RET503, B007, B011, E711, A001, F632, E713, E714

import numpy as np
import tai as ti

from bad_register import bad, fields

# Calls of functions of the package


@bad(
    ti.TaiTypeError,
    "sin() takes 1 positional argument but 2 were given",
    "help(sin) says what it takes",
)
def too_many_arguments_of_sin():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return ti.sin(a, 2.0)  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "sqrt() missing 1 required positional argument: 'x'",
    "help(sqrt) says what it takes",
)
def no_argument_of_sqrt():
    @ti.kernel
    def kernel() -> ti.f32:
        return ti.sqrt()  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "sin() got an unexpected keyword argument 'angle'",
    "help(sin) says what it takes",
)
def keyword_of_sin():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return ti.sin(angle=a)  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "ti.max takes at least two numbers",
    "ti.max(a, b), or v.max() over the components of a vector",
)
def one_argument_of_max():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return ti.max(a)  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "ti.sin takes numbers, but got 'a'", "pass a number, a vector or a matrix")
def sine_of_a_string():
    @ti.kernel
    def kernel() -> ti.f32:
        return ti.sin("a")  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "select() missing 1 required positional argument: 'y'",
    "help(select) says what it takes",
)
def select_of_two():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return ti.select(a > 0, a)  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "'f32' is not a type of numbers", "use ti.f32, ti.i32, …")
def random_of_no_type():
    @ti.kernel
    def kernel() -> ti.f32:
        return ti.random("f32")  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "cast() missing 1 required positional argument: 'dtype'",
    "help(cast) says what it takes",
)
def cast_of_one():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.i32:
        return ti.cast(a)  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "bit_cast from f32 to i64: the widths differ",
    "choose a type of as many bits, or convert the value: ti.cast(x, …)",
)
def bit_cast_of_another_width():
    @ti.kernel
    def kernel(a: ti.f32) -> ti.i64:
        return ti.bit_cast(a, ti.i64)  # BAD

    kernel(1.0)


@bad(
    ti.TaiSyntaxError,
    "this range is known only when the kernel runs",
    "write it after 'in' of a for loop, without ti.static",
)
def sum_of_a_generator():
    @ti.kernel
    def kernel(n: ti.i32) -> ti.i32:
        return sum(i for i in range(n))  # BAD

    kernel(3)


@bad(
    ti.TaiSyntaxError,
    "open(…) would run once, while the kernel is compiled, and not when it runs",
    "call it in Python, and pass what the kernel needs as an argument",
)
def open_of_a_file():
    @ti.kernel
    def kernel():
        f = open("file")  # BAD

    kernel()


@bad(ti.TaiTypeError, "function 'twice' has no parameter 'b'", "help(twice) shows its parameters")
def unknown_keyword_of_a_function():
    @ti.func
    def twice(a):
        return a * 2

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return twice(b=a)  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "function 'twice' gets two values for parameter 'a'",
    "help(twice) shows its parameters",
)
def argument_given_twice():
    @ti.func
    def twice(a):
        return a * 2

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return twice(a, a=a)  # BAD

    kernel(1.0)


@bad(ti.TaiTypeError, "a f32 cannot be taken apart", "lists, tuples, vectors and ranges can")
def arguments_from_a_number():
    @ti.func
    def twice(a):
        return a * 2

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return twice(*a)  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "None stands where a number is needed",
    "a function without 'return' gives None",
)
def function_without_a_result():
    @ti.func
    def nothing(a):
        b = a

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return nothing(a) + 1.0  # BAD

    kernel(1.0)


@bad(
    ti.TaiTypeError,
    "expects a number of type f32, but got a vector of 2 f32",
    "take one component, such as v[0] or v.x",
)
def function_of_a_vector_for_numbers():
    @ti.func
    def twice(a: ti.f32):
        return a * 2

    @ti.kernel
    def kernel() -> ti.f32:
        return twice(ti.Vector([1.0, 2.0]))  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "copy_from(…) would run once, while the kernel is compiled, and not when it runs",
    "assign to the elements in a loop",
)
def host_call_of_a_field():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        x.copy_from(x)  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "to_numpy(…) would run once, while the kernel is compiled, and not when it runs",
    "call it in Python, before or after the launch",
)
def copy_to_the_host_in_a_kernel():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel():
        a = x.to_numpy()  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "field(…) would run once, while the kernel is compiled, and not when it runs",
    "make fields outside",
)
def field_made_in_a_kernel():
    @ti.kernel
    def kernel():
        a = ti.field(ti.f32, shape=3)  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "init(…) would run once, while the kernel is compiled, and not when it runs",
    "call it in Python, before or after the launch",
)
def init_in_a_kernel():
    @ti.kernel
    def kernel():
        ti.init(arch=ti.cpu)  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "sync(…) would run once, while the kernel is compiled, and not when it runs",
    "call it in Python, before or after the launch",
)
def sync_in_a_kernel():
    @ti.kernel
    def kernel():
        ti.sync()  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "kernel 'inner' is called while another kernel is compiled",
    "make it a @ti.func",
)
def gradient_of_a_kernel_in_a_kernel():
    @ti.kernel
    def inner():
        pass

    @ti.kernel
    def kernel():
        inner.grad()  # BAD

    kernel()


# Arguments


@bad(
    ti.TaiSyntaxError,
    "kernel 'kernel' cannot have *args or **kwargs",
    "name each parameter, or pass a tuple as a ti.template()",
)
def keyword_parameters():
    @ti.kernel
    def kernel(**options):  # BAD
        pass


@bad(
    ti.TaiSyntaxError,
    "function 'total' cannot have *args or **kwargs",
    "name each parameter, or pass a tuple as a ti.template()",
)
def any_number_of_arguments_of_a_function():
    @ti.func
    def total(*parts):  # BAD
        return parts[0]

    @ti.kernel
    def kernel() -> ti.i32:
        return total(1, 2)

    kernel()


@bad(
    ti.TaiSyntaxError,
    "parameter 'b' of kernel 'kernel' has no type",
    "annotate it: b: ti.f32, b: ti.template(), …",
)
def two_parameters_of_which_one_has_no_type():
    @ti.kernel
    def kernel(a: ti.f32, b) -> ti.f32:  # BAD
        return a


@bad(
    ti.TaiSyntaxError,
    "parameter 'a' of 'kernel' has a type that kernels do not know: 3",
    "use a number type, ti.template(), ti.types.ndarray(), ti.types.vector(…) or "
    "ti.types.struct(…)",
)
def parameter_with_a_number_as_type():
    @ti.kernel
    def kernel(a: 3):  # BAD
        pass

    kernel(3)


@bad(
    ti.TaiSyntaxError,
    "the result of 'kernel' has a type that kernels do not know: str",
    "use a number type, ti.template(), ti.types.ndarray(), ti.types.vector(…) or "
    "ti.types.struct(…)",
)
def return_of_an_unknown_type():
    @ti.kernel
    def kernel() -> str:  # BAD
        return 1

    kernel()


@bad(
    ti.TaiTypeError,
    "expects a number of type f32, but got a vector of 2 f32",
    "take one component, such as v[0] or v.x",
)
def vector_where_a_number_is_returned():
    @ti.kernel
    def kernel() -> ti.f32:
        return ti.Vector([1.0, 2.0])  # BAD

    kernel()


@bad(ti.TaiTypeError, "expects vector(2, f32), but got a f32", "make a vector of that shape")
def number_where_a_vector_is_returned():
    @ti.kernel
    def kernel() -> ti.types.vector(2, ti.f32):
        return 1.0  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "expects a number of type f32, but got a vector of 2 f32",
    "take one component, such as v[0] or v.x",
)
def two_values_where_one_is_returned():
    @ti.kernel
    def kernel() -> ti.f32:
        return 1.0, 2.0  # BAD

    kernel()


@bad(ti.TaiTypeError, "field 'x' stands where a number is needed", "read an element: x[i]")
def field_that_is_returned():
    x, _, _, _ = fields()

    @ti.kernel
    def kernel() -> ti.f32:
        return x  # BAD

    kernel()


@bad(ti.TaiIndexError, "array 'a' takes 1 index, but got 2", "write a[i]")
def array_with_too_many_indices():
    @ti.kernel
    def kernel(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        a[0, 1] = 1.0  # BAD

    kernel(np.zeros(3, np.float32))


@bad(
    ti.TaiTypeError,
    "an index must be a whole number, but got f32",
    "convert it: int(…) or ti.cast(…, ti.i32)",
)
def array_with_a_float_index():
    @ti.kernel
    def kernel(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        a[0.5] = 1.0  # BAD

    kernel(np.zeros(3, np.float32))


@bad(
    ti.TaiTypeError,
    "a vector of 2 f32 cannot be stored where one number of type f32 is",
    "take one component, such as v[0] or v.x",
)
def vector_into_an_array_of_numbers():
    @ti.kernel
    def kernel(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        a[0] = ti.Vector([1.0, 2.0])  # BAD

    kernel(np.zeros(3, np.float32))


@bad(ti.TaiNameError, "'array' has no attribute 'length'", "did you mean 'element'?")
def unknown_attribute_of_an_array():
    @ti.kernel
    def kernel(a: ti.types.ndarray(dtype=ti.f32, ndim=1)) -> ti.i32:
        return a.length  # BAD

    kernel(np.zeros(3, np.float32))


@bad(
    ti.TaiAutodiffError,
    "array 'a' has no gradient",
    "pass a ti.ndarray that was made with needs_grad=True",
)
def gradient_of_an_array_without_one():
    @ti.kernel
    def kernel(a: ti.types.ndarray(dtype=ti.f32, ndim=1)):
        a.grad[0] = 1.0  # BAD

    kernel(np.zeros(3, np.float32))


# Objects


@bad(
    ti.TaiNameError,
    "the struct has no member 'wight'",
    "members are named where the struct type is made",
)
def unknown_member_of_a_struct():
    body = ti.types.struct(mass=ti.f32, speed=ti.f32)
    bodies = body.field(shape=4)

    @ti.kernel
    def kernel():
        bodies[0].wight = 1.0  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "structs have no arithmetic",
    "compute with their members",
)
def struct_as_a_number():
    body = ti.types.struct(mass=ti.f32, speed=ti.f32)
    bodies = body.field(shape=4)

    @ti.kernel
    def kernel() -> ti.f32:
        return bodies[0] + 1.0  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "struct(mass=f32, speed=f32) has 2 members, but got 3",
    "members are named where the struct type is made",
)
def struct_with_too_many_values():
    body = ti.types.struct(mass=ti.f32, speed=ti.f32)

    @ti.kernel
    def kernel() -> ti.f32:
        b = body(1.0, 2.0, 3.0)  # BAD
        return b.mass

    kernel()


@bad(
    ti.TaiTypeError,
    "struct(mass=f32, speed=f32) cannot take a member 'wight' of that name",
    "its members are mass, speed",
)
def struct_with_an_unknown_value():
    body = ti.types.struct(mass=ti.f32, speed=ti.f32)

    @ti.kernel
    def kernel() -> ti.f32:
        b = body(wight=1.0)  # BAD
        return b.mass

    kernel()


@bad(
    ti.TaiNameError,
    "'Scene' has no attribute 'gravity'",
    "dir(Scene) lists what it has while the kernel is compiled",
)
def attribute_of_an_object_that_is_missing():
    class Scene:
        pass

    scene = Scene()

    @ti.kernel
    def kernel() -> ti.f32:
        return scene.gravity  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a kernel cannot change the Python object 'self.gravity'",
    "use a field for what a kernel writes",
)
def attribute_of_an_object_that_is_set():
    @ti.data_oriented
    class Scene:
        def __init__(self):
            self.gravity = 9.81

        @ti.kernel
        def kernel(self):
            self.gravity = 3.0  # BAD

    Scene().kernel()


@bad(
    ti.TaiNameError,
    "'Scene' has no attribute 'gravity'",
    "dir(Scene) lists what it has while the kernel is compiled",
)
def unknown_attribute_of_self():
    @ti.data_oriented
    class Scene:
        @ti.kernel
        def kernel(self) -> ti.f32:
            return self.gravity  # BAD

    Scene().kernel()


@bad(
    ti.TaiIndexError,
    "no item 'dx'",
    "Python evaluates this while the kernel is compiled; try it outside of the kernel",
)
def key_of_a_dictionary_that_is_missing():
    options = {"dt": 0.1}

    @ti.kernel
    def kernel() -> ti.f32:
        return options["dx"]  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "unsupported operand type(s) for *: 'dict' and 'float'",
    "Python evaluates this while the kernel is compiled; try it outside of the kernel",
)
def dictionary_as_a_number():
    options = {"dt": 0.1}

    @ti.kernel
    def kernel() -> ti.f32:
        return options * 2.0  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "a kernel cannot change the Python object 'constants[0]'",
    "use a field for what a kernel writes",
)
def list_that_is_changed():
    constants = [1.0, 2.0]

    @ti.kernel
    def kernel():
        constants[0] = 3.0  # BAD

    kernel()


@bad(
    ti.TaiSyntaxError,
    "'append' would change a Python list once, while the kernel is compiled, and not when it runs",
    "use a field for what a kernel writes; for lists of cells there is ti.root.dynamic",
)
def append_to_a_list():
    constants = [1.0, 2.0]

    @ti.kernel
    def kernel(a: ti.f32):
        constants.append(a)  # BAD

    kernel(1.0)


@bad(
    ti.TaiIndexError,
    "list index out of range",
    "Python evaluates this while the kernel is compiled; try it outside of the kernel",
)
def constant_index_of_a_short_list():
    constants = [1.0, 2.0]

    @ti.kernel
    def kernel() -> ti.f32:
        return constants[2]  # BAD

    kernel()


@bad(ti.TaiNameError, "'ti.math' has no attribute 'pie'", "did you mean 'pi'?")
def unknown_name_of_a_module():
    @ti.kernel
    def kernel() -> ti.f32:
        return ti.math.pie  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "unsupported operand type(s) for +: 'module' and 'float'",
    "Python evaluates this while the kernel is compiled; try it outside of the kernel",
)
def module_as_a_number():
    @ti.kernel
    def kernel() -> ti.f32:
        return ti + 1.0  # BAD

    kernel()


@bad(
    ti.TaiTypeError,
    "the truth of a value is known only when the kernel runs",
    "in a kernel, use it in `if`, `while` or `and`; a Python function cannot branch on it",
)
def python_branch_on_a_value():
    def helper(a):
        return a if a > 0 else -a

    @ti.kernel
    def kernel(a: ti.f32) -> ti.f32:
        return helper(a)  # BAD

    kernel(1.0)


@bad(
    ti.TaiCompilationError,
    "super() does not know the class here",
    "name the class: Base.f(self, x)",
)
def a_function_of_the_class_above():
    @ti.dataclass
    class Base:
        mass: ti.f32

        @ti.func
        def twice(self):
            return self.mass * 2

    @ti.dataclass
    class Above(Base):
        size: ti.f32

        @ti.func
        def twice(self):
            return super().twice()  # BAD

    @ti.kernel
    def kernel() -> ti.f32:
        return Above(1.0, 2.0).twice()

    kernel()
