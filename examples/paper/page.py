"""The page of results, in Markdown and in HTML."""

from __future__ import annotations

import base64
import html
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from .lab import Result

STYLE = """body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;
color:#2b3a55;background:#f4f1ea}table{border-collapse:collapse;margin:1em 0}
td,th{border-bottom:1px solid #9a9484;padding:.2em .7em;text-align:left}img{max-width:100%}
figure{display:inline-block;width:48%;margin:0 0 1em}code{font-size:90%}"""

Row = tuple[str, str, str, Result]  # name, where in the paper, title, result


def verdict(result: Result) -> str:
    """Formats the outcome of an experiment for a cell of a table."""
    if result.status == "ok":
        return "as expected"
    word = "FAILED" if result.status == "failed" else "left out"
    return f"{word}: {result.reason}".replace("|", "/")


def _summary(rows: Iterable[Row]) -> tuple[list[str], list[list[str]]]:
    header = ["experiment", "in the paper", "name", "result", "seconds"]
    return header, [
        [title, where, f"`{name}`", verdict(result), f"{result.seconds:.0f}"]
        for name, where, title, result in rows
    ]


def _markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)


def _pieces(rows: Sequence[Row]) -> Iterator[Sequence[Any]]:
    """The blocks of the report page after its head, in order: the kind of each block, and its
    contents.
    """
    yield ("table", *_summary(rows))
    for _, where, title, result in rows:
        yield ("experiment", title, where)
        if result.status != "ok":
            yield ("failure", verdict(result))
        yield from result.blocks


def _markdown(kind: str, *content: Any) -> str:
    if kind == "table":
        return _markdown_table(*content)
    if kind == "experiment":
        return f"## {content[0]}\n\n*In the paper: {content[1]}.*"
    if kind == "failure":
        return f"**{content[0]}**"
    return f"![{content[1]}]({content[0]})" if kind == "picture" else content[0]


def markdown(head: Sequence[str], rows: Sequence[Row]) -> str:
    """Makes the page of results for a reader of the repository."""
    parts = ["# The paper's experiments", *head, *(_markdown(*piece) for piece in _pieces(rows))]
    return "\n\n".join(parts) + "\n"


def _inline(text: str) -> str:
    """Code and emphasis of Markdown; of a link its text, since the page may lie anywhere."""
    text = html.escape(text, quote=False)
    for pattern, tag in ((r"`([^`]*)`", "code"), (r"\*\*([^*]+)\*\*", "b"), (r"\*([^*]+)\*", "i")):
        text = re.sub(pattern, rf"<{tag}>\1</{tag}>", text)
    return re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text)


def _html_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{_inline(cell)}</{tag}>" for cell in cells) + "</tr>"

    return f"<table>{line(header, 'th')}{''.join(line(row, 'td') for row in rows)}</table>"


def _html(folder: Path, kind: str, *content: Any) -> str:
    if kind == "table":
        return _html_table(*content)
    if kind == "experiment":
        title, where = map(_inline, content)
        return f"<h2>{title}</h2><p><i>In the paper: {where}.</i></p>"
    if kind == "failure":
        return f"<p><b>{_inline(content[0])}</b></p>"
    if kind == "picture":
        data = base64.b64encode((folder / content[0]).read_bytes()).decode()
        caption = f"<figcaption>{_inline(content[1])}</figcaption>"
        return f'<figure><img src="data:image/png;base64,{data}">{caption}</figure>'
    return f"<p>{_inline(content[0])}</p>"


def hypertext(head: Sequence[str], rows: Sequence[Row], folder: Path) -> str:
    """Makes the page of results as one HTML file, with its pictures in it."""
    parts = ["<h1>The paper's experiments</h1>", *(f"<p>{_inline(text)}</p>" for text in head)]
    parts += [_html(folder, *piece) for piece in _pieces(rows)]
    title = "<title>The paper's experiments</title>"
    return f'<!doctype html><meta charset="utf-8">{title}<style>{STYLE}</style>' + "\n".join(parts)
