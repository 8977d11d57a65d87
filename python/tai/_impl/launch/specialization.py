"""Specialisations: the code of a kernel for given kinds of arguments, and their lookup."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from typing import Any

from ...errors import TaiCompilationError, TaiRuntimeError, TaiTypeError
from ..base import native, state
from ..base.modes import float_of, modes_of
from ..fields.root import materialize, name_fields
from ..frontend import templates
from ..frontend.compiler import Compiler
from ..frontend.source import closure_of
from ..tracking import tangents, tracked
from ..tracking.arguments import find_alias
from .signature import Signature, located
from .specs import ArgumentSpec, ResultSpec, spec_of


class Specialization:
    """A kernel compiled for certain kinds of arguments.

    Attributes:
        has_gradients: whether something that it uses has a gradient.
        reads: attributes that the code depends on besides the arguments; see `templates.Reads`.
        fields, stored, accumulated: the places that it uses, stores to, and changes by atomics.
    """

    def __init__(
        self, core: Any, specs: list[ArgumentSpec], result: ResultSpec | None, reads: list[tuple]
    ):
        self.core, self.specs, self.reads = core, specs, reads
        # A function that removes this specialisation from its kernel; set when the kernel has
        # stored the specialisation.
        self.drop: Callable[[], None] = lambda: None
        self.has_gradients = True
        self.fields: weakref.WeakSet = weakref.WeakSet()
        self.stored: weakref.WeakSet = weakref.WeakSet()
        # The `FunctionInfo` of each `ti.func` that is compiled into this specialisation.
        self.functions: list[Any] = []
        self.accumulated: weakref.WeakSet = weakref.WeakSet()
        # The values of `grad` for which the launcher in C++ knows this specialisation.
        self.registered: set[bool] = set()
        # The directions whose compilation was announced by name; see `base.compiling`.
        self.announced: set[bool] = set()
        self.result = () if result is None else result.description()
        self.result_spec = result
        # In forward mode: the numbers of the parameters whose tangents are followed, and the pool
        # that keeps the tangent of the result, or None.
        self.followed: list[int] = []
        self.result_pool: Any = None
        arrays = any(spec.kind == "array" for spec in specs)
        # The work of a launch under a tape, as a number of `tracking` in Launcher.cpp: 1 if arrays
        # are followed, 2 if Python says where the adjoint of the result is.
        self.tracking = 2 if result is not None and result.has_gradient else int(arrays)

    def fits(self, specs: list[ArgumentSpec]) -> bool:
        """Whether the code was compiled for these template arguments with their present
        attributes.
        """
        return self.is_for(specs) and templates.still_hold(self.reads)

    def is_for(self, specs: list[ArgumentSpec]) -> bool:
        """Whether the code was compiled for these template arguments, whatever it read of them."""
        pairs = zip(self.specs, specs, strict=True)
        return all(
            own.taken.matches(given.constant) for own, given in pairs if own.taken is not None
        )

    def uses_of(self, spec: ArgumentSpec) -> tuple[bool, bool]:
        """Whether the array is read, and whether it is written, by any parameter for which it is
        passed.
        """
        number = self.specs.index(spec)
        same = [other for other in self.specs if other is spec or other.alias == number]
        return any(s.is_read for s in same), any(s.is_written for s in same)


def in_version(modes: dict[str, Any]) -> dict[str, Any]:
    """The modes of a kernel; for modes that it does not name, those of a temporary program version
    (a run in other types).
    """
    return modes if state.version is None else {**state.version.modes, **modes}


class Specializations:
    """The specialisations of one kernel for the current program.

    Attributes:
        last: the one that was asked for last, or None.
        find_constants: gives, for the arguments of a call, the places whose loads are constants
            to gradients. For the same arguments it gives the same.
    """

    def __init__(self, kernel: Any, function: Callable[..., Any], modes: dict[str, Any]):
        self._kernel, self._function = weakref.ref(kernel), function
        # The modes that the kernel itself names.
        self._modes = modes
        self.find_constants: Callable[[list[Any]], set[Any]] = lambda values: set()
        self._variants: dict[tuple, list[Specialization]] = {}
        self.last: Specialization | None = None

    def __len__(self) -> int:
        return sum(map(len, self._variants.values()))

    def get(
        self, program: Any, signature: Signature, values: list[Any], tracks: bool = False
    ) -> Specialization:
        """Returns the specialisation for these arguments, compiled if there is none yet.

        Args:
            program: for which it is compiled.
            signature: of the kernel.
            values: one for each parameter.
            tracks: whether numbers that have a gradient are to be differentiated by.
        """
        specs: list[ArgumentSpec] = []
        key: list[Any] = []
        followed: list[int] = []
        for parameter, value in zip(signature.parameters, values, strict=True):
            spec = spec_of(signature.kernel, parameter, value, tracks)
            specs.append(spec)
            if spec.kind == "template":
                key.append(templates.hint(spec.constant))
            elif spec.kind == "array":
                spec.alias = find_alias(spec, value, values, specs)
                key.append((spec.dt.name, spec.ndim, spec.element_shape, spec.has_gradient,
                            spec.alias))  # fmt: skip
            elif spec.dt.is_float and tangents.cell_of(value) is not None:
                followed.append(len(specs) - 1)
                key.append(("followed", len(specs), tangents.cell_of(value).pool.number))
            elif tracks and spec.dt.is_float and tracked.gradient_of(value) is not None:
                spec.has_gradient = True
                key.append(len(specs))
        pool, result = None, signature.result
        if state.forward and result is not None and result.dtype.is_float:
            pool = tangents.pool_besides([tangents.cell_of(values[n]) for n in followed])
            key.append(("result", pool.number))
        if state.rounding is not None:
            key.append("rounding")
        if state.version is not None:
            key.extend(state.version.key)
        if state.shadows:
            key.append("shadows")
        variants = self._variants.setdefault(tuple(key), [])
        found = next((one for one in reversed(variants) if one.fits(specs)), None)
        if found is None:
            inputs = [tangents.cell_of(values[n]).pool for n in followed]
            found = self._compile(
                program, signature, specs, list(zip(followed, inputs, strict=True)), pool,
                self.find_constants(values),
            )  # fmt: skip
            # The functions that drop the specialisation are noted first, since Ctrl-C may come in
            # between.
            self._note_users(program, found, tuple(key))
            variants.append(found)
            if found.reads:
                same = [one for one in variants if one.is_for(specs)]
                templates.warn_of_many(signature.kernel, same)
            for spec in specs:
                if spec.alive is not None:
                    spec.constant = None
        self.last = found
        if state.rounding is not None:
            state.rounding.note(found)
        if state.version is not None:
            state.version.note(found, signature.kernel)
        return found

    def _note_users(self, program: Any, found: Specialization, key: tuple) -> None:
        """Registers a function with the trees that a specialisation uses, so that it is dropped
        when a tree is freed.
        """
        store, one = weakref.ref(self), weakref.ref(found)

        def drop(_: Any = None) -> None:
            owner, gone = store(), one()
            if owner is not None and gone is not None:
                owner._drop(gone, key)

        found.drop = drop
        for function in found.functions:
            function.users.add(found)
        for spec in found.specs:
            if spec.kind == "template" and templates.is_weak(spec.constant):
                # The code is dropped with the object for which it was compiled.
                spec.alive = weakref.ref(spec.constant, drop)
        for tree in found.core.trees:
            program.trees[tree].users.add(found)

    def _drop(self, gone: Specialization, key: tuple) -> None:
        variants = self._variants.get(key, [])
        if gone not in variants:
            return
        variants.remove(gone)
        if not variants:
            del self._variants[key]
        if self.last is gone:
            self.last = None
        for launcher in self._launchers():
            native.drop_specialization(launcher, gone.core)

    def _launchers(self) -> list[Any]:
        kernel = self._kernel()
        return [] if kernel is None else [kernel, kernel.grad]

    def forget_launches(self) -> None:
        """Makes each launch ask `get` for its code again."""
        for variants in self._variants.values():
            for one in variants:
                one.registered.clear()
        for launcher in self._launchers():
            native.clear_specializations(launcher)

    def clear(self) -> None:
        """Forgets all of them."""
        self.last = None
        self._variants.clear()
        for launcher in self._launchers():
            native.clear_specializations(launcher)

    def _compile(
        self, program: Any, signature: Signature, specs: list[ArgumentSpec],
        followed: list[tuple[int, Any]], pool: Any, constants: set[Any],
    ) -> Specialization:  # fmt: skip
        for parameter, spec in zip(signature.parameters, specs, strict=True):
            if spec.dt is not None and spec.dt.name in ("f16", "bf16") and spec.kind != "array":
                raise TaiTypeError(
                    f"argument '{parameter.name}' cannot be {spec.dt}: it is a type of fields",
                    "use ti.f32",
                )
            if spec.kind == "template":
                spec.taken = templates.take(spec.constant, parameter.name, signature.kernel)
                if hasattr(spec.constant, "__dict__"):
                    name_fields(vars(spec.constant))
        name_fields(closure_of(self._function))
        materialize(program, self._function.__globals__)
        try:
            modes = modes_of(in_version(self._modes), program.options)
        except TaiRuntimeError as error:
            raise located(TaiCompilationError(error.message, error.hint), self._function) from None
        is_fast = modes.get("math") == "fast" or ("math" not in modes and program.options.fast_math)
        if state.rounding is not None and is_fast:
            # Rounding errors are computed as differences that fast math could reorder to zero, so
            # fast math is off here.
            modes["math"] = "default"
        symbol = program.unique_symbol(signature.kernel, is_hidden=True)
        program.kernel_functions[symbol] = self._function
        names = signature.names
        parameters = list(zip(names, specs, strict=True))
        cells = ([(names[number], inputs.field) for number, inputs in followed],
                 None if pool is None else pool.field)  # fmt: skip
        result = None if signature.result is None else ResultSpec(signature.result)
        kernel = self._kernel()
        assert kernel is not None
        compiler = Compiler(
            program,
            self._function,
            symbol,
            parameters,
            result,
            cells,
            signature.structs,
            modes,
            kernel.batch,
        )
        compiler.context.emitter.stopped = {id(place) for place in constants}
        outer, state.of_thread.fp = state.fp, float_of(modes)
        try:
            try:
                core = compiler.compile()
            except BaseException:
                program.symbols.give_back(symbol)
                raise
            finally:
                state.of_thread.fp = outer
            return self._finish(program, compiler, core, specs, result, symbol, followed, pool)
        finally:
            compiler.close()

    def _finish(
        self, program: Any, compiler: Compiler, core: Any, specs: list[ArgumentSpec],
        result: ResultSpec | None, symbol: str, followed: list[tuple[int, Any]], pool: Any,
    ) -> Specialization:  # fmt: skip
        found = Specialization(core, specs, result, compiler.reads.all())
        weakref.finalize(found, program.symbols.give_back, symbol).atexit = False
        found.followed, found.result_pool = [number for number, _ in followed], pool
        found.has_gradients = compiler.has_gradients
        emitter = compiler.context.emitter
        found.functions = list(compiler.context.functions)
        found.fields.update(emitter.fields)
        found.stored.update(emitter.stored)
        found.accumulated.update(emitter.accumulated)
        return found
