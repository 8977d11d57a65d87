"""Extension of griffe for two things that it cannot see in sources.

Functions that a call makes (`sin = _unary("sin", math.sin, "Sine.")`) become functions with that
docstring, and `ti.init` gets the keywords of the table of options.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
from pathlib import Path
from typing import Any

import griffe

ROOT = Path(__file__).resolve().parents[2]
INIT = "tai._impl.base.start.init"
# Run by the checkout's own Python, since the package needs NumPy.
KEYWORDS = """
import json
from tai._impl.base.options import KEYWORDS
rows = [(k.name, getattr(k.type, '__name__', str(k.type)), repr(k.default), k.about)
        for k in KEYWORDS.values()]
print(json.dumps(rows))
"""


def keywords() -> list[list[str]]:
    """Name, type, default and description of each keyword of `ti.init`."""
    command = [ROOT / ".venv" / "bin" / "python", "-c", KEYWORDS]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return json.loads(done.stdout)


def made_by_call(value: Any) -> str | None:
    """The docstring of a function that a call makes: the text among the arguments with a stop."""
    if not isinstance(value, griffe.ExprCall):
        return None
    for argument in value.arguments:
        try:
            text = ast.literal_eval(str(argument))
        except (ValueError, SyntaxError):
            continue
        if isinstance(text, str) and re.search(r"[.:]$|\. ", text):
            return text
    return None


class MadeFunctions(griffe.Extension):
    """Turns attributes that hold a function into functions."""

    def on_module_members(self, *, mod: griffe.Module, **_: Any) -> None:
        for name, member in list(mod.members.items()):
            if member.is_alias or not member.is_attribute:
                continue
            text = made_by_call(member.value)
            if text is None or not str(member.value.function).startswith("_"):
                continue
            count = 2 if "y" in re.findall(r"\b[xy]\b", text) else 1
            names = [griffe.Parameter(n, kind=griffe.ParameterKind.positional_only)
                     for n in ("x", "y")[:count]]  # fmt: skip
            if str(member.value.function) == "_place_operation":
                names = [
                    griffe.Parameter("place", kind=griffe.ParameterKind.positional_only),
                    griffe.Parameter("values", kind=griffe.ParameterKind.var_positional),
                ]
            if str(member.value.function) == "_fold":
                names = [griffe.Parameter("values", kind=griffe.ParameterKind.var_positional)]
            function = griffe.Function(
                name, lineno=member.lineno, endlineno=member.endlineno,
                parameters=griffe.Parameters(*names),
                docstring=griffe.Docstring(text, parser="google"),
            )  # fmt: skip
            mod.set_member(name, function)

    def on_function_instance(self, *, func: griffe.Function, **_: Any) -> None:
        if func.path != INIT or not func.docstring:
            return
        lines = []
        for name, kind, default, about in keywords():
            lines.append(f"    {name}: {about}")
            if name in func.parameters:
                continue
            keyword = griffe.ParameterKind.keyword_only
            new = griffe.Parameter(name, annotation=kind, kind=keyword, default=default)
            func.parameters.add(new)
        head, mark, rest = func.docstring.value.partition("Args:\n")
        func.docstring.value = f"{head}{mark}{chr(10).join(lines)}\n{rest}"
