"""Differentiable operators of torch that launch kernels; `tai.torch` is the interface."""

from __future__ import annotations

import contextlib
import functools
import itertools
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import torch
from torch.autograd import forward_ad

from ...errors import (
    TaiAutodiffError,
    TaiCompilationError,
    TaiRuntimeError,
    TaiRuntimeTypeError,
)
from ..ad.tape import Tape, clear_all_gradients
from ..base import native, state
from ..interop.device_arrays import find_form
from ..launch.kernels import Kernel
from ..launch.stacked import StackedKernel
from .parameters import as_shape, asks_for_tape, check_outputs, copy_shared, in_order, kinds_of
from .stacked import Stacks
from .torch_watch import ComputationWatch
from .writers import ForwardRuns, kind_of

# Functions of torch that are looked up once, because each look-up costs a notable share of a
# launch.
_is_grad_enabled = torch.is_grad_enabled
_operator_calls = native.operator_calls
# `Function.apply` without its check for transforms, which the caller has made already.
_apply = torch._C._FunctionBase.__dict__["apply"]
_unwrap = torch._C._functorch.unwrap_if_dead
_is_transformed = torch._C._are_functorch_transforms_active
_is_compiling = torch.compiler.is_compiling
_count_dispatchers = torch._C._len_torch_dispatch_stack
_is_any_autocast = torch._C._is_any_autocast_enabled
_is_tracing = torch._C._is_tracing

_numbers = itertools.count()
# Operators by name. Torch keeps them for as long as the process, too.
_known: dict[str, Operator] = {}
# Classes of tensors that have no behaviour of their own, unlike subclasses.
_PLAIN = (torch.Tensor, torch.nn.Parameter)
# The types of parameters as they are called in schemas of torch.
_SCHEMA = {"array": "Tensor", "float": "float", "int": "SymInt", "bool": "bool"}


class Operator:
    """A kernel, or a function that launches kernels, as an operator of torch.

    Attributes:
        name: by which torch knows the operator.
        inputs: the names of the parameters that a call gives, in order.
        outputs: the names of those that are its results.
    """

    def __init__(self, function: Any, outputs: dict[str, Any], name: str | None):
        kinds = kinds_of(function, "tai.torch.wrap")
        self._function: Any = function
        self.__name__ = self.__qualname__ = function.__name__
        self.__doc__ = function.__doc__
        self._order = list(kinds)
        check_outputs(self.__name__, outputs, kinds, "torch.empty(…)")
        self._shapes = outputs
        self.inputs = [n for n in kinds if n not in outputs]
        self.outputs = [n for n in kinds if n in outputs]
        self._is_tensor = [kinds[n] == "array" for n in self.inputs]
        self._takes_numbers = not all(self._is_tensor)
        self._whole = {n for n in self.inputs if kinds[n] == "int"}
        # The launcher of a kernel takes tensors as they are.
        self._is_kernel = isinstance(function, Kernel)
        # For each parameter of the operator in order: whether it is an input, and its number among
        # the inputs or among the outputs.
        self._places = [
            (n in self.inputs, (self.inputs if n in self.inputs else self.outputs).index(n))
            for n in self._order
        ]
        # For each output of the operator: the number of the input with the same shape and type, or
        # None.
        self._models = [
            self.inputs.index(s) if isinstance(s, str) else None
            for s in (outputs[n] for n in self.outputs)
        ]
        # The same list as `_models`, if all outputs are like an input.
        numbers = [m for m in self._models if m is not None]
        self._likes = numbers if len(numbers) == len(self._models) else None
        # Kinds of operands for which it was checked that launches do not write to inputs.
        self._known: set[tuple] = set()
        self._forward_runs = ForwardRuns(self.__name__, _as_variable, _apart)
        self._stacks = Stacks(function, self.outputs, functools.partial(_OfBatch, self))
        # A subclass for each operator, so that torch need not pass the operator as an argument.
        self._eager: Any = type("_EagerCall", (_Eager,), {"operator": self})
        self._apply = _apply.__get__(None, self._eager)
        self._make_calls()
        # A gradient needs a tape if the function is no kernel, since later launches of the function
        # may overwrite outputs that its gradient reads.
        self._needs_tape = not self._is_kernel
        plain = re.sub(r"\W", "_", self.__name__)
        self.name = name or f"{plain}_{next(_numbers)}"
        parameters = ", ".join(f"{_SCHEMA[kinds[n]]} {n}" for n in self.inputs)
        self._define(parameters)
        _known[self.name] = self

    def _make_calls(self) -> None:
        """Calls for plain tensors that do without Python: see python/src/OperatorCalls.cpp. Each
        returns None, or 0, where it leaves a call to Python."""
        kernel = self._function if self._is_kernel else None
        likes = self._likes if self._is_kernel else None
        calls = _operator_calls(
            kernel, kernel and kernel.grad, self._places, self._is_tensor, likes or [], _PLAIN,
            torch.empty_like,
        )  # fmt: skip
        self._launch_at_once, self._differentiate_at_once, self._classify, self._note = calls

    def __deepcopy__(self, memo: Any) -> Operator:
        return self  # Copies of a network share it, as they share torch's functions.

    def __reduce__(self) -> Any:
        return _find_operator, (self.name, self._identity())

    def _identity(self) -> tuple:
        function = getattr(self._function, "_function", self._function)
        return function.__module__, function.__qualname__, tuple(self._order), tuple(self.outputs)

    def __repr__(self) -> str:
        return f"<tai.torch operator '{self.name}'>"

    @property
    def one_by_one(self) -> dict[frozenset[str], str]:
        """Why `vmap` launches once for each element: the reason, by the names of the arrays that
        have a batch. Elsewhere one launch runs for the whole batch."""
        return dict(self._stacks.reasons)

    # What torch calls

    def _define(self, parameters: str) -> None:
        """Registers the operator and its gradient with torch."""
        results = ", ".join(["Tensor"] * len(self.outputs))
        results = results if len(self.outputs) == 1 else f"({results})"
        self._op = torch.library.custom_op(
            f"tai::{self.name}", self._forward, mutates_args=(),
            schema=f"({parameters}) -> {results}",
        )  # fmt: skip
        bars = "".join(f", Tensor grad_of_{name}" for name in self.outputs)
        self._gradient_op = torch.library.custom_op(
            f"tai::{self.name}_gradient", self._gradient, mutates_args=(),
            schema=f"({parameters}{bars}, bool[] wanted) -> Tensor[]",
        )  # fmt: skip
        self._op.register_fake(self._fake)
        self._gradient_op.register_fake(self._fake_gradient)
        self._op.register_autograd(self._backward, setup_context=self._set_up)
        self._gradient_op.register_autograd(self._refuse, setup_context=lambda ctx, **given: None)
        self._op.register_vmap(self._batch)
        self._gradient_op.register_vmap(self._batch_gradient)

    def _fake(self, *inputs: Any) -> Any:
        made = self._allocate(inputs, torch.empty)
        return made[0] if len(made) == 1 else tuple(made)

    def _fake_gradient(self, *args: Any) -> list[torch.Tensor]:
        tensors = [a for a, t in zip(args, self._is_tensor, strict=False) if t]
        return [self._zeros_like(t) for t, w in zip(tensors, args[-1], strict=True) if w]

    @staticmethod
    def _zeros_like(tensor: torch.Tensor) -> torch.Tensor:
        # The gradient does not get the strides of the tensor, which may be expanded.
        return torch.zeros_like(tensor, memory_format=torch.contiguous_format)

    def _set_up(self, ctx: Any, inputs: tuple, output: Any) -> None:
        # Torch itself knows that tensors of integers have no gradient.
        if self._takes_numbers:
            pairs = list(zip(inputs, self._is_tensor, strict=True))
            ctx.save_for_backward(*[i for i, t in pairs if t])
            ctx.numbers = [i for i, t in pairs if not t]
        else:
            ctx.save_for_backward(*inputs)

    def _given(self, ctx: Any) -> Sequence[Any]:
        """Returns the inputs of the call that a context of torch has saved."""
        if not self._takes_numbers:
            return ctx.saved_tensors
        tensors, numbers = iter(ctx.saved_tensors), iter(ctx.numbers)
        return [next(tensors if t else numbers) for t in self._is_tensor]

    def _wanted(self, needs: Sequence[bool]) -> list[bool]:
        """Returns flags for the tensors, selected from the flags for all inputs."""
        return [bool(n) for n, t in zip(needs, self._is_tensor, strict=True) if t]

    @staticmethod
    def _spread(gradients: Iterable[Any], needs: Sequence[bool]) -> tuple:
        """Returns one gradient, or None, for each input."""
        found = iter(gradients)
        return tuple([next(found) if n else None for n in needs])

    def _backward(self, ctx: Any, *bars: Any) -> Any:
        needs = ctx.needs_input_grad
        gradients = self._gradient_op(*self._given(ctx), *bars, self._wanted(needs))
        return self._spread(gradients, needs)

    def _refuse(self, ctx: Any, *bars: Any) -> Any:
        raise TaiAutodiffError(
            f"the gradient of operator '{self.__name__}' has no gradient: kernels with arrays are "
            "differentiated once",
            "call the gradient without create_graph; ti.ad.hvp differentiates kernels of fields "
            "twice",
        )

    def _batch(self, info: Any, in_dims: tuple, *args: Any) -> Any:
        return self._in_batch(lambda op, given: op._op(*given), info, in_dims, args)

    def _batch_gradient(self, info: Any, in_dims: tuple, *args: Any) -> Any:
        call: Any = lambda op, given: tuple(op._gradient_op(*given, args[-1]))  # noqa: E731
        found, _ = self._in_batch(call, info, in_dims[:-1], args[:-1], args[-1])
        return list(found), [0] * len(found)

    def _in_batch(
        self, call: Callable[[Operator, list], Any], info: Any, in_dims: Sequence,
        args: Sequence[Any], wanted: Sequence[bool] | None = None,
    ) -> Any:  # fmt: skip
        """Calls the operator or its gradient for each element of a batch, if possible at once.

        Args:
            call: calls an operator.
            info, in_dims, args: as torch gives them; the inputs, and the adjoints of outputs.
            wanted: for a gradient, the tensors with respect to which it is computed.
        """
        moved = [a if d is None else a.movedim(d, 0) for a, d in zip(args, in_dims, strict=True)]
        if info.batch_size == 0:
            return self._in_empty_batch(in_dims, moved, wanted)
        flags = iter(() if wanted is None else wanted)
        names = []
        for number, is_tensor in enumerate([*self._is_tensor, *[True] * len(args)][: len(args)]):
            is_input = number < len(self.inputs)
            is_wanted = is_tensor and wanted is not None and (not is_input or next(flags))
            if is_wanted and in_dims[number] is None:
                one = moved[number]
                moved[number] = one.unsqueeze(0).expand(info.batch_size, *one.shape)
            if is_input and (is_wanted or in_dims[number] is not None):
                names.append(self.inputs[number])
        found = self._stacks.find(names)
        if found is not None:
            try:
                answer = call(found, moved)
                return answer, (0,) * len(answer) if isinstance(answer, tuple) else 0
            except (TaiCompilationError, TaiAutodiffError) as error:
                self._stacks.refuse(names, error)
        slices = _slices(info.batch_size, in_dims, args)
        return _stacked([call(self, one) for one in slices])

    def _in_empty_batch(
        self, in_dims: Sequence, moved: list[Any], wanted: Sequence[bool] | None
    ) -> Any:
        """The results of a batch without elements, for which nothing is launched."""
        ones = [
            a if d is None else a.new_zeros(a.shape[1:])
            for a, d in zip(moved, in_dims, strict=True)
        ]  # fmt: skip
        if wanted is None:
            made = self._allocate(ones, torch.empty)
        else:
            made = self._fake_gradient(*ones, wanted)
        found = [one.new_zeros((0, *one.shape)) for one in made]
        if wanted is None and torch.is_grad_enabled():
            # The results require a gradient as those of other batches do; it has no elements.
            for number, one in enumerate(found):
                for a in moved if one.is_floating_point() else ():
                    if isinstance(a, torch.Tensor) and a.requires_grad:
                        found[number] = found[number] + a.sum().to(one.dtype)
        if wanted is None and len(found) == 1:
            return found[0], 0
        return tuple(found), (0,) * len(found)

    # Launches

    def _allocate(self, inputs: Sequence[Any], make: Callable[..., Any]) -> list[torch.Tensor]:
        """Tensors for the results."""
        made = []
        if make is torch.zeros and self._likes is not None:
            for number in self._likes:
                given = inputs[number]
                is_dense = given.is_contiguous()
                made.append(torch.zeros_like(given) if is_dense else self._zeros_like(given))
            return made
        for name, model in zip(self.outputs, self._models, strict=True):
            if model is not None:
                # An output does not get the strides of its input, which may be expanded.
                like_it = torch.zeros_like if make is torch.zeros else torch.empty_like
                made.append(like_it(inputs[model], memory_format=torch.contiguous_format))
                continue
            answer = self._shapes[name](*inputs)
            like: torch.Tensor | None
            if isinstance(answer, torch.Tensor):
                like, answer = answer, answer.shape
            else:
                like = next((i for i in inputs if isinstance(i, torch.Tensor)), None)
            options = {} if like is None else {"dtype": like.dtype, "device": like.device}
            made.append(make(as_shape(self.__name__, name, answer), **options))
        return made

    def _refuse_forms(self, inputs: Sequence[Any]) -> None:
        """Raises an error if a tensor is sparse, quantized or nested.

        Raises:
            TaiRuntimeTypeError: there is such a tensor.
        """
        for name, value, is_tensor in zip(self.inputs, inputs, self._is_tensor, strict=True):
            if is_tensor and (problem := find_form(value)) is not None:
                what, hint = problem
                raise TaiRuntimeTypeError(
                    f"input '{name}' of operator '{self.__name__}' {what}: kernels take dense "
                    "memory",
                    hint.replace("pass x.", f"pass {name}."),
                )

    def _launch(self, inputs: Sequence[Any], outputs: Sequence[Any], call: Any = None) -> Any:
        call = self._function if call is None else call
        return call(*[inputs[n] if given else outputs[n] for given, n in self._places])

    def _forward(self, *inputs: Any) -> Any:
        if state.of_thread.tape is not None:
            raise TaiRuntimeError(
                f"operator '{self.__name__}' of torch is called while a tape records",
                "call the kernel itself in the tape, or leave the tape first",
            )
        found = self._launch_at_once(*inputs)
        if found is not None:
            return found
        self._refuse_forms(inputs)
        outputs = self._allocate(inputs, torch.zeros)
        plain = []
        for value, is_tensor in zip(inputs, self._is_tensor, strict=True):
            if is_tensor:
                if value.requires_grad:
                    value = value.detach()  # Torch records nothing of it.
                if not value.is_contiguous():
                    value = value.contiguous()
            plain.append(value)
        kind = self._kind_of(plain)
        if kind not in self._known:
            self._launch_first(plain, outputs, kind)
            self._known.add(kind)
            if not self._forward_runs.need_tape(kind):
                self._note(kind)
        else:
            self._run_forward(plain, outputs, kind)
        return outputs[0] if len(outputs) == 1 else tuple(outputs)

    def _kind_of(self, inputs: Sequence[Any]) -> tuple:
        return kind_of(itertools.compress(inputs, self._is_tensor))

    def _run_forward(
        self, inputs: Sequence[Any], outputs: Sequence[Any], kind: tuple, watch: Any = None
    ) -> Any:
        """Launches, under a tape where the gradient is of another form of the kernel, and within
        the context `watch`."""

        def launch(inputs: Sequence[Any], outputs: Sequence[Any]) -> Any:
            with watch or contextlib.nullcontext():
                return self._launch(inputs, outputs)

        call = self._launch if watch is None else launch
        with torch.no_grad():
            return self._forward_runs.run(kind, call, inputs, outputs, torch.Tensor.zero_)

    def _launch_first(
        self, inputs: Sequence[Any], outputs: Sequence[Any], kind: tuple = ()
    ) -> None:
        """Launches with new types of tensors, and checks that no input is written.

        Args:
            inputs, outputs: of the launch.
            kind: the types and numbers of dimensions of the inputs.

        Raises:
            TaiRuntimeTypeError: an input is written, or a result comes back in another way.
        """
        named = zip(self.inputs, inputs, strict=True)
        tensors = {n: t for n, t in named if isinstance(t, torch.Tensor)}
        before = {n: t.clone() for n, t in tensors.items()}
        watch = None
        if not self._is_kernel:
            watch = ComputationWatch(self.__name__, [*tensors.values(), *outputs])
        answer = self._run_forward(inputs, outputs, kind, watch)
        self._needs_tape |= self._forward_runs.need_tape(kind)
        for name, tensor in tensors.items():
            same = torch.equal(_bytes_of(tensor), _bytes_of(before[name]))
            if not same or self._writes(name):
                tensor.copy_(before[name])
                raise TaiRuntimeTypeError(
                    f"operator '{self.__name__}' writes to its input '{name}'",
                    f"name it in outputs, or let a kernel copy {name} to an output first",
                )
        if answer is not None:
            raise TaiRuntimeTypeError(
                f"'{self.__name__}' returns a value, which as an operator of torch it cannot",
                "store it to an array of shape (1,), and name that in outputs",
            )
        self._needs_tape |= any(spec.is_loaded for spec in self._specs(self.outputs))

    def _specs(self, names: Sequence[str]) -> list[Any]:
        """Returns the array parameters of a kernel, as it was compiled last."""
        if not isinstance(self._function, Kernel):
            return []
        last = self._function._specializations.last
        pairs = zip(self._order, last.specs if last is not None else (), strict=False)
        return [spec for name, spec in pairs if name in names]

    def _writes(self, name: str) -> bool:
        return any(spec.is_written for spec in self._specs([name]))

    def _gradient(self, *args: Any) -> list[torch.Tensor]:
        count = len(self.inputs)
        flags = iter(args[-1])
        needs = [t and next(flags) for t in self._is_tensor]
        return self._differentiate(args[:count], args[count:-1], needs)

    def _differentiate(
        self, inputs: Sequence[Any], bars: Sequence[Any], needs: Sequence[bool]
    ) -> list[torch.Tensor]:
        """Returns the gradients with respect to those inputs for which `needs` has a flag.

        Args:
            inputs: the inputs of the call.
            bars: the adjoints of its outputs.
            needs: for each input.
        """
        if not self._needs_tape:
            found = self._differentiate_at_once(tuple(inputs), tuple(bars), tuple(map(bool, needs)))
            if found is not None:
                found = found if isinstance(found, tuple) else (found,)
                return [gradient for gradient in found if gradient is not None]
        given, leaves = [], []
        for value, is_tensor, is_needed in zip(_apart(inputs), self._is_tensor, needs, strict=True):
            if is_tensor:
                value = value.detach()
                if not value.is_contiguous():
                    value = value.contiguous()
                if is_needed:
                    # The array shares the memory of the tensor, and has a gradient of its own.
                    gradient = torch.zeros_like(value)
                    value.requires_grad_()
                    value.grad = gradient
                    leaves.append(value)
            given.append(value)
        if not leaves:
            return []
        # The seeds are copies, because the sweep overwrites adjoints of outputs.
        seeds = [bar.clone(memory_format=torch.contiguous_format) for bar in bars]
        # A reverse sweep that does not read the values of the outputs accepts any memory as
        # outputs.
        outputs = (
            self._allocate(inputs, torch.zeros)
            if self._needs_tape
            else [seed.detach() for seed in seeds]
        )
        for output, seed in zip(outputs, seeds, strict=True):
            if output.is_floating_point():
                output.requires_grad_()
                output.grad = seed
        if self._needs_tape:
            clear_all_gradients()
            with Tape() as tape:
                self._launch(given, outputs)
            self._forward_runs.check(self._kind_of(inputs), tape)
            tape.grad()
        else:
            try:
                self._launch(given, outputs, self._function.grad)
            except TaiRuntimeError as error:
                if not asks_for_tape(error):
                    raise
                self._needs_tape = True
                return self._differentiate(inputs, bars, needs)
        return [leaf.grad for leaf in leaves]

    # Calls

    def __call__(self, *inputs: Any, **named: Any) -> Any:
        """Computes the outputs of tensors and numbers, as torch's own functions do.

        Args:
            inputs: a tensor or number for each parameter that is no output, in order.
            named: inputs given by name.

        Returns:
            The output, or a tuple of them in the order of the parameters.

        Raises:
            TaiRuntimeTypeError: the number of arguments is wrong, or a kernel cannot take one.
        """
        if named or len(inputs) != len(self.inputs):
            inputs = in_order(f"operator '{self.__name__}'", self.inputs, inputs, named)
        if not _is_compiling():
            kind = self._classify(*inputs)
            # For plain tensors, if no transform, dispatcher, autocast or tracing of torch is
            # active, the operator is called without torch's dispatcher.
            if kind and not (
                _is_transformed() or _count_dispatchers() or _is_any_autocast() or _is_tracing()
            ):
                # Transforms that have ended leave behind tensors that wrap other tensors.
                if self._takes_numbers:
                    pairs = zip(inputs, self._is_tensor, strict=True)
                    inputs = tuple([_unwrap(i) if t else i for i, t in pairs])
                else:
                    inputs = tuple(map(_unwrap, inputs))
                if kind == 2 and _is_grad_enabled() or forward_ad._current_level >= 0:
                    return self._apply(*inputs)
                return self._forward(*inputs)
        return self._call_by_torch(inputs)

    def _call_by_torch(self, inputs: tuple) -> Any:
        """Calls the operator through torch's dispatcher: some mechanism of torch, such as a
        transform, takes part, or an input is wrong.
        """
        pairs = zip(inputs, self._is_tensor, strict=True)
        if any(is_tensor is not isinstance(value, torch.Tensor) for value, is_tensor in pairs):
            inputs = self._checked(inputs)
        inputs = _without_autocast(inputs)
        if not _is_compiling() and _is_transformed():
            return _Functional.apply(self, *inputs)
        return self._op(*inputs)

    def _checked(self, inputs: tuple) -> tuple:
        """Checks the inputs; a tensor of one number becomes a number where the operator takes a
        number.

        Raises:
            TaiRuntimeTypeError: an input is of the wrong kind.
        """
        found: list[Any] = []
        for name, value, is_tensor in zip(self.inputs, inputs, self._is_tensor, strict=True):
            what = f"input '{name}' of operator '{self.__name__}'"
            if is_tensor and not isinstance(value, torch.Tensor):
                is_array = type(value).__module__ == "numpy" and hasattr(value, "shape")
                raise TaiRuntimeTypeError(
                    f"{what} is a tensor, but got {type(value).__name__}",
                    f"torch.from_numpy({name})" if is_array else f"torch.tensor({value!r})"
                    if isinstance(value, (int, float, list, tuple)) else "pass a torch.Tensor",
                )  # fmt: skip
            if not is_tensor and isinstance(value, torch.Tensor):
                if value.requires_grad and torch.is_grad_enabled():
                    raise TaiRuntimeTypeError(
                        f"{what} is a number, which has no gradient, but got a tensor that "
                        "requires one",
                        f"declare {name} as an array, and give a tensor of shape (1,); or pass "
                        f"{name}.item()",
                    )
                if value.numel() != 1:
                    raise TaiRuntimeTypeError(
                        f"{what} is a number, but got a tensor of shape {tuple(value.shape)}",
                        f"pass {name}.item(), or declare {name} as an array",
                    )
                if not torch.compiler.is_compiling():
                    value = value.item()
                    if isinstance(value, float) and name in self._whole:
                        raise TaiRuntimeTypeError(
                            f"{what} is a whole number, but got a tensor with {value!r}",
                            f"pass int({name})",
                        )
            found.append(value)
        return tuple(found)


class _OfBatch(Operator):
    """An operator whose kernel runs for all elements of a batch at once."""

    def __init__(self, one: Operator, kernel: StackedKernel, names: Iterable[str]):
        """Makes the operator of a batch.

        Args:
            one: the operator for one element.
            kernel: the kernel that runs for all elements of the batch.
            names: the names of the inputs whose first dimension is that of the batch.
        """
        self._one, self._has_batch = one, [name in names for name in one.inputs]
        super().__init__(kernel, one._shapes, "_".join([one.name, "for", *names]))
        self._likes = None  # Outputs have a batch where an input that they are like may have none.
        self._make_calls()

    def _allocate(self, inputs: Sequence[Any], make: Callable[..., Any]) -> list[torch.Tensor]:
        pairs = list(zip(inputs, self._has_batch, strict=True))
        size = next(i.shape[0] for i, has_batch in pairs if has_batch)
        ones = super()._allocate([i[0] if b else i for i, b in pairs], torch.empty)
        return [make((size, *o.shape), dtype=o.dtype, device=o.device) for o in ones]

    @property
    def _needs_tape(self) -> bool:
        return self._one._needs_tape

    @_needs_tape.setter
    def _needs_tape(self, value: bool) -> None:
        # The gradients of a batch run without a launch that could have found this out.
        self._one._needs_tape |= value


class _Eager(torch.autograd.Function):
    """The operator for plain calls, with less between torch and the kernel."""

    operator: Operator

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> Any:
        raise _no_forward_mode()

    @classmethod
    def forward(cls, ctx: Any, *inputs: Any) -> Any:
        operator = cls.operator
        if operator._takes_numbers:
            operator._set_up(ctx, inputs, None)
        else:
            ctx.save_for_backward(*inputs)
        return operator._forward(*inputs)

    @classmethod
    def backward(cls, ctx: Any, *bars: Any) -> Any:
        operator = cls.operator
        if _is_grad_enabled():  # of a gradient that is to be differentiated
            return operator._backward(ctx, *bars)
        needs = ctx.needs_input_grad
        inputs = operator._given(ctx) if operator._takes_numbers else ctx.saved_tensors
        if not operator._needs_tape:
            found = operator._differentiate_at_once(inputs, bars, needs)
            if found is not None:
                return found
        return operator._spread(operator._differentiate(inputs, bars, needs), needs)


class _Functional(torch.autograd.Function):
    """The operator for the transforms of `torch.func`, which refuse gradients of custom
    operators."""

    @staticmethod
    def forward(operator: Operator, *inputs: Any) -> Any:
        return operator._forward(*inputs)

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple, output: Any) -> None:
        ctx.operator = inputs[0]
        ctx.operator._set_up(ctx, inputs[1:], output)

    @staticmethod
    def backward(ctx: Any, *bars: Any) -> Any:
        operator, needs = ctx.operator, ctx.needs_input_grad[1:]
        given, wanted = operator._given(ctx), tuple(operator._wanted(needs))
        gradients = _FunctionalGradient.apply(operator, wanted, *given, *bars)
        return None, *operator._spread(gradients, needs)

    @staticmethod
    def jvp(ctx: Any, *tangents: Any) -> Any:
        raise _no_forward_mode()

    @staticmethod
    def vmap(info: Any, in_dims: tuple, operator: Operator, *inputs: Any) -> Any:
        call: Any = lambda op, given: _Functional.apply(op, *given)  # noqa: E731
        return operator._in_batch(call, info, in_dims[1:], inputs)


class _FunctionalGradient(torch.autograd.Function):
    """The gradient of `_Functional`, which itself has no gradient."""

    @staticmethod
    def forward(operator: Operator, wanted: tuple, *args: Any) -> Any:
        return tuple(operator._gradient(*args, wanted))

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple, output: Any) -> None:
        ctx.operator = inputs[0]

    @staticmethod
    def backward(ctx: Any, *bars: Any) -> Any:
        return ctx.operator._refuse(ctx, *bars)

    @staticmethod
    def vmap(info: Any, in_dims: tuple, operator: Operator, wanted: tuple, *args: Any) -> Any:
        call: Any = lambda op, given: _FunctionalGradient.apply(op, wanted, *given)  # noqa: E731
        return operator._in_batch(call, info, in_dims[2:], args, wanted)


def _no_forward_mode() -> TaiAutodiffError:
    return TaiAutodiffError(
        "kernels with arrays have no tangents, so that torch's forward mode (jvp, jacfwd, hessian) "
        "does not pass an operator",
        "use torch.func.vjp or jacrev; ti.ad.jvp is forward mode for kernels of fields",
    )


def _find_operator(name: str, identity: tuple) -> Operator:
    """Returns the operator that was pickled under a name.

    Raises:
        TaiRuntimeError: this process has none of that name, or another one.
    """
    found = _known.get(name)
    if found is None or found._identity() != identity:
        raise TaiRuntimeError(
            f"the operator '{name}' of '{identity[0]}.{identity[1]}' is not known here",
            "import the module that makes it by tai.torch.wrap before the network is loaded, and "
            "give it a name: wrap(…, name=…)",
        )
    return found


def _apart(inputs: Sequence[Any]) -> list[Any]:
    """Returns the inputs, with copies of tensors that share memory with an earlier one."""
    return copy_shared(
        inputs,
        lambda v: v.untyped_storage().data_ptr() or None if isinstance(v, torch.Tensor) else None,
        lambda v: v.detach().clone(),
    )


def _as_variable(value: Any) -> Any:
    """Returns a tensor of floats as a variable of kernels, and any other value itself."""
    is_float = isinstance(value, torch.Tensor) and value.is_floating_point()
    return value.detach().requires_grad_() if is_float and not value.requires_grad else value


def _stacked(found: list) -> Any:
    """Returns the results of a batch as one tensor, and the dimension of the batch in it."""
    if isinstance(found[0], torch.Tensor):
        return torch.stack(found), 0
    return tuple(map(torch.stack, zip(*found, strict=True))), (0,) * len(found[0])


def _without_autocast(inputs: tuple) -> tuple:
    """Under autocast: 16-bit tensors as f32, which the other tensors of a network are."""
    if not (torch.is_autocast_enabled("cpu") or torch.is_autocast_enabled("cuda")):
        return inputs
    halves = (torch.float16, torch.bfloat16)
    return tuple(
        i.float() if isinstance(i, torch.Tensor) and i.dtype in halves else i for i in inputs
    )


def _bytes_of(tensor: torch.Tensor) -> torch.Tensor:
    """Returns the bits of a tensor, in which even NaN equals itself."""
    return tensor.reshape(-1).view(torch.uint8)


def _slices(count: int, in_dims: Sequence[Any], args: Sequence[Any]) -> Any:
    """Yields the arguments of each launch of a batch."""
    moved = [a if d is None else a.movedim(d, 0) for a, d in zip(args, in_dims, strict=True)]
    for number in range(count):
        yield [a if d is None else a[number] for a, d in zip(moved, in_dims, strict=True)]


class Module(torch.nn.Module):
    """A layer whose forward is an operator, some of whose inputs it owns."""

    def __init__(self, operator: Operator, owned: dict[str, Any]):
        super().__init__()
        for name, value in owned.items():
            if name not in operator.inputs or not isinstance(value, torch.Tensor):
                raise TaiRuntimeTypeError(
                    f"'{name}' is no tensor among the inputs of operator '{operator.__name__}'",
                    f"its inputs: {', '.join(operator.inputs)}",
                )
            if isinstance(value, torch.nn.Parameter):
                self.register_parameter(name, value)
            else:
                self.register_buffer(name, value)
        self._operator, self._owned = operator, tuple(owned)

    def forward(self, *inputs: Any) -> Any:
        given = iter(inputs)
        missing = len(self._operator.inputs) - len(self._owned)
        if len(inputs) != missing:
            raise TaiRuntimeTypeError(
                f"the layer of '{self._operator.__name__}' takes {missing} inputs, but got "
                f"{len(inputs)}"
            )
        names = self._operator.inputs
        return self._operator(
            *[getattr(self, n) if n in self._owned else next(given) for n in names]
        )
