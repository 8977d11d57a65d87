"""Floating-point modes: the keywords of `ti.init` and `@ti.kernel`, and conflicts between them.

See docs/guides/precision.md.
"""

from __future__ import annotations

from typing import Any

from ...errors import TaiRuntimeError, TaiSyntaxError, did_you_mean
from . import dtypes

# For each numeric mode, its words; the first word is the default.
MODES: dict[str, tuple[Any, ...]] = {
    "precision": ("default", "f64", "f32", "f16", "bf16"),
    "sums": ("default", "compensated", "deterministic"),
    "math": ("default", "fast", "strict", "accurate"),
    "ftz": (False, True),
    "adjoints": ("default", "f64"),
}

# The options that set the modes of a kernel. The type in which gradients are kept is an option of
# fields.
OF_KERNELS = ("precision", "sums", "math", "ftz")

# Types that are not allowed as the precision of a kernel, since a kernel stores nothing by itself.
_STORAGE = ("f16", "bf16")

# The options that are short forms of a mode and a word.
_SHORT = {
    "fast_math": ("math", "fast"),
    "strict": ("math", "strict"),
    "deterministic": ("sums", "deterministic"),
}

# Words that contradict each other, with the effect of the first and that of the second.
_CONTRADICTIONS = (
    (("math", "strict"), ("math", "fast"),
     "rounds every operation by itself", "reorders them"),
    (("shadow", "on"), ("math", "fast"),
     "rounds every operation by itself", "reorders them"),
    (("math", "accurate"), ("math", "fast"),
     "wants every function right to one unit in the last place", "approximates them"),
    (("sums", "compensated"), ("math", "fast"),
     "keeps what a sum rounds away", "may cancel it by reordering"),
)  # fmt: skip


def _words(chosen: dict[str, Any]) -> dict[tuple[str, str], str]:
    """Returns the modes that the chosen options set, each with the spelling of the option."""
    found = {}
    for name in ("math", "sums"):
        word = chosen.get(name, "default")
        if word != "default":
            found[name, word] = f'{name}="{word}"'
    for option, word in _SHORT.items():
        if chosen.get(option):
            found[word] = option
    if chosen.get("shadow"):
        found["shadow", "on"] = "shadow"
    return found


def check_together(chosen: dict[str, Any], where: str = "options") -> None:
    """Raises an error if two of the chosen options contradict each other.

    Args:
        chosen: keywords of `ti.init`.
        where: the name of the options in the error.

    Raises:
        TaiRuntimeError: it names both.
    """
    words = _words(chosen)
    for first, second, does_first, does_second in _CONTRADICTIONS:
        if first in words and second in words:
            raise TaiRuntimeError(
                f"{where} '{words[first]}' and '{words[second]}' contradict one another: the "
                f"first {does_first}, the second {does_second}; choose one"
            )


def check_target(chosen: dict[str, Any], target: str) -> None:
    """Fails if the program runs without code generation and a mode needs generated code.

    Raises:
        TaiRuntimeError: it names the mode.
    """
    if target != "python":
        return
    for name in ("sums", "math", "ftz"):
        word = chosen.get(name, MODES[name][0])
        if word not in ("default", "deterministic", "strict", False):
            raise TaiRuntimeError(
                f"{name}={word!r} cannot be had on arch=ti.python: no code is made",
                "choose arch=ti.cpu",
            )


def choose(chosen: dict[str, Any]) -> None:
    """Sets the options that words stand for: the short forms, and the default type of floats.

    Raises:
        TaiRuntimeError: the program chose another default type as well.
    """
    for option, (name, word) in _SHORT.items():
        if chosen.get(name) != word:
            continue
        if chosen.get(option) is False:
            raise TaiRuntimeError(
                f"options '{name}=\"{word}\"' and '{option}=False' contradict one another: the "
                "second is short for what the first is not; choose one"
            )
        chosen[option] = True
    precision = chosen.get("precision", "default")
    if precision == "default":
        return
    wanted = dtypes.f64 if precision == "f64" else dtypes.f32
    if chosen.setdefault("default_fp", wanted) is not wanted:
        raise TaiRuntimeError(
            f"options 'precision=\"{precision}\"' and 'default_fp=ti.{chosen['default_fp']}' "
            f"contradict one another: with the first, kernels compute in {wanted}; choose one"
        )


def check_kernel(name: str, given: dict[str, Any]) -> dict[str, Any]:
    """Checks and returns the numeric modes that a kernel was given.

    Raises:
        TaiSyntaxError: a name or a word that there is not.
    """
    for mode, word in given.items():
        if mode not in OF_KERNELS:
            hint = did_you_mean(mode, OF_KERNELS)
            if mode in MODES:
                hint = f"ti.init({mode}={word!r}) says it for all fields"
            raise TaiSyntaxError(
                f"kernel '{name}' has no mode '{mode}'; there are {', '.join(OF_KERNELS)}", hint
            )
        words = MODES[mode]
        if mode == "precision" and word in _STORAGE:
            raise TaiSyntaxError(
                f"precision={word!r} is of fields, which a kernel only uses; it computes in f32",
                f"give the fields the type ti.{word}",
            )
        if not any(word is known or (isinstance(known, str) and word == known) for known in words):
            shown = " or ".join(repr(w) for w in words if w not in _STORAGE)
            raise TaiSyntaxError(f"the mode '{mode}' of kernel '{name}' is {shown}, not {word!r}")
    return given


def modes_of(own: dict[str, Any], options: Any) -> dict[str, Any]:
    """The modes of a kernel as attributes of the IR: its own words first, then the options of its
    context.

    Raises:
        TaiRuntimeError: these contradict one another.
    """
    context = {name: getattr(options, name) for name in OF_KERNELS}
    together = {**context, **own, "shadow": options.shadow}
    for option, (name, _) in _SHORT.items():
        # The kernel's own choice goes before the program's options, but compensated sums may be
        # deterministic as well.
        keeps = name not in own or (option == "deterministic" and own[name] == "compensated")
        together[option] = keeps and getattr(options, option)
    check_together(together, "modes")
    if together["strict"] or options.shadow:  # which implies it
        together["math"] = together["math"] if together["math"] == "accurate" else "strict"
    return {
        name: word
        for name in OF_KERNELS
        if (word := together[name]) not in ("default", False) or name in own
    }


def attribute_of(modes: dict[str, Any]) -> str:
    """Returns the numeric modes as an attribute of IR."""
    texts = []
    for name, word in modes.items():
        shown = "f32" if word in _STORAGE else word
        texts.append(
            f"{name} = {str(word).lower() if name == 'ftz' else chr(34) + shown + chr(34)}"
        )
    return "{" + ", ".join(texts) + "}"


def float_of(modes: dict[str, Any]) -> Any:
    """The type of `float` in a kernel with these modes, or None if they do not name one."""
    return {"f64": dtypes.f64, "f32": dtypes.f32}.get(modes.get("precision", "default"))
