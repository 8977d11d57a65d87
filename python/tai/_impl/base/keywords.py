"""Wrong keywords and attributes of public names: the error names the nearest one."""

from __future__ import annotations

import functools
import inspect
import sys
from collections.abc import Iterable
from types import FunctionType
from typing import Any

from ...errors import did_you_mean


def check_keywords(
    namespace: dict[str, Any], names: Iterable[str] = (), attributes: bool = True
) -> None:
    """Decorates public functions and classes so that they refuse wrong keywords with a suggestion.

    The same for attributes that the classes have not, and for names that a public module has not.
    Call it at the end of a module, with `globals()`.

    Args:
        namespace: of the module, in which checked functions take the place of plain ones. Classes
            are changed in place: their construction and their public methods.
        names: of the functions and classes. If left out: those in `__all__`, or if there is none,
            the public ones that the module defines.
        attributes: false for classes whose attributes launches read: a class with `__getattr__` is
            read more slowly (a launch with two arrays: 0.40 µs in place of 0.32). Python suggests
            names for them where it prints the error; IPython does not.
    """
    if not names:
        here = namespace["__name__"]
        suggest_names(namespace)
        names = namespace.get("__all__") or [
            name for name, value in namespace.items()
            if not name.startswith("_") and getattr(value, "__module__", None) == here
        ]  # fmt: skip
    for name in list(names):
        value = namespace[name]
        if isinstance(value, type):
            for cls in value.__mro__:
                if cls.__module__.split(".")[0] == "tai":
                    _check_class(cls, attributes)
        elif isinstance(value, FunctionType):
            namespace[name] = checked(value)


# Hints for methods of other libraries' objects, by their names.
_OTHERS = {
    "backward": "hint: a tape computes gradients: with ti.ad.Tape(loss): … where the loss is a "
    "field; with ti.ad.Tape() as tape: … and then tape.backward(loss) where a kernel returns it",
}


def missing_attribute(text: str, name: str, known: Iterable[str]) -> AttributeError:
    """The error for an attribute that an object has not, with the nearest of the known names."""
    near = _OTHERS.get(name)
    if near is None and not name.startswith("_"):  # Other libraries ask for these.
        near = did_you_mean(name, [one for one in known if not one.startswith("_")])
    # With the attribute `name`, Python adds no suggestion of its own to the error.
    return AttributeError(text if near is None else f"{text}\n  {near}", name=name)


class MissingMethod:
    """A method that a class has not, as a class attribute.

    The error says what to write instead. In contrast to `__getattr__`, it costs nothing where
    other attributes are looked up.

    Args:
        hint: what to write; left out for methods of other libraries' objects, whose hints are
            known.
    """

    def __init__(self, hint: str | None = None):
        self._hint = hint

    def __set_name__(self, cls: type, name: str) -> None:
        self._name = name

    def __get__(self, value: Any, cls: type) -> Any:
        text = f"'{cls.__name__}' object has no attribute '{self._name}'"
        if self._hint is None:
            raise missing_attribute(text, self._name, ())
        raise AttributeError(f"{text}\n  hint: {self._hint}", name=self._name)


def present_names(value: Any) -> list[str]:
    """Implements `__dir__` of classes with a `MissingMethod`, which is no attribute of them."""
    cls = type(value)
    return [
        name for name in object.__dir__(value)
        if not isinstance(inspect.getattr_static(cls, name, None), MissingMethod)
    ]  # fmt: skip


_ACTIVE = (
    "in Python, writing to an element makes its cell active, and level.deactivate_all() empties a "
    "level"
)
# Operations on sparse cells, which kernels have, with the hints for a call from Python.
CELL_OPERATIONS = {
    "append": "lists grow in kernels, by x[i].append(value) or ti.append(level, i, value); in "
    "Python, writing to x[i, 9] makes a list at least 10 long",
    "length": "kernels have x[i].length() and ti.length(level, i); in Python, level.num_active "
    "counts the elements of all lists",
    "activate": f"kernels have ti.activate(level, i); {_ACTIVE}",
    "deactivate": f"kernels have ti.deactivate(level, i); {_ACTIVE}",
    "is_active": "kernels have ti.is_active(level, i); in Python, level.active_cells() lists the "
    "active cells",
}


def suggest_names(namespace: dict[str, Any]) -> None:
    """Lets the error for a name that a module has not suggest the nearest one."""
    namespace.setdefault("__getattr__", functools.partial(_refuse_name, namespace))


def _refuse_name(namespace: dict[str, Any], name: str) -> Any:
    text = f"module '{namespace['__name__']}' has no attribute '{name}'"
    raise missing_attribute(text, name, namespace.get("__all__") or namespace)


def _refuse_attribute(self: Any, name: str) -> Any:
    """`__getattr__` of public classes."""
    try:
        return object.__getattribute__(self, name)
    except AttributeError as error:
        if name.startswith("_") or hasattr(type(self), name):
            raise  # A property has said why it fails.
        raise missing_attribute(str(error), name, dir(self)) from None


def find_wrong_keyword(function: Any, named: dict[str, Any]) -> tuple[str, str] | None:
    """The message and the hint for a keyword argument that is spelled nearly like one that the
    function has.
    """
    inner = getattr(function, "__func__", function)
    if not named or not isinstance(inner, FunctionType):
        return None
    known = _names_of(inspect.unwrap(inner))
    for name in named:
        if known is not None and name not in known:
            if near := _near(name, [one for one in known if one not in named]):
                text = f"{inner.__name__}() got an unexpected keyword argument '{name}'"
                return text, near
    return None


def _near(wrong: str, known: Iterable[str]) -> str | None:
    near = did_you_mean(wrong, known)
    for name in known if near is None else ():
        if wrong.startswith(name) or name.startswith(wrong):
            near = f"did you mean '{name}'?"
    return near


def refuse_keywords(
    function: str, wrong: str, known: Iterable[str], given: Iterable[str] = ()
) -> TypeError:
    """The error for a keyword argument that a function does not have; keywords that the call
    already gives are not suggested.
    """
    known = [name for name in known if not name.startswith("_")]
    text = f"{function}() got an unexpected keyword argument '{wrong}'"
    near = _near(wrong, [name for name in known if name not in given])
    if near is None and known:
        near = f"hint: its keywords: {', '.join(known)}"
    return TypeError(text if near is None else f"{text}\n  {near}")


def _names_of(function: Any) -> list[str] | None:
    """The names of the keyword arguments of a function; None if it takes any keyword."""
    code = function.__code__
    if code.co_flags & inspect.CO_VARKEYWORDS:
        return None
    count = code.co_argcount + code.co_kwonlyargcount
    return list(code.co_varnames[code.co_posonlyargcount : count])


def checked(function: Any, is_method: bool = False) -> Any:
    """Wraps a function in a check of the keyword arguments of its calls."""
    if hasattr(function, "with_checked_keywords"):
        return function.with_checked_keywords
    names = _names_of(inspect.unwrap(function))
    if names is None or not names[is_method:]:
        return function
    known = frozenset(names)

    @functools.wraps(function)
    def check(*args: Any, **named: Any) -> Any:
        if named and not known.issuperset(named):
            wrong = next(name for name in named if name not in known)
            given = [*names[: len(args)], *named]
            raise refuse_keywords(function.__qualname__, wrong, names[is_method:], given)
        return function(*args, **named)

    # The checked function takes over every name of the function in its module.
    module = vars(sys.modules[function.__module__])
    module.update({name: check for name, value in module.items() if value is function})
    function.with_checked_keywords = check.with_checked_keywords = check  # type: ignore[attr-defined]
    return check


def _check_class(cls: Any, attributes: bool) -> None:
    if "_has_checked_keywords" in vars(cls):
        return
    cls._has_checked_keywords = True
    if attributes and not hasattr(cls, "__getattr__") and not issubclass(cls, BaseException):
        cls.__getattr__ = _refuse_attribute
    for name, value in list(vars(cls).items()):
        if name.startswith("_") and name != "__init__":
            continue
        if isinstance(value, FunctionType):
            setattr(cls, name, checked(value, is_method=True))
        elif isinstance(value, (classmethod, staticmethod)):
            is_method = isinstance(value, classmethod)
            inner = value.__func__
            if isinstance(inner, FunctionType):
                setattr(cls, name, type(value)(checked(inner, is_method)))
