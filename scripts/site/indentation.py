"""Lists of pages that are written for GitHub, in the form that Python-Markdown wants."""

import re


def indented(markdown: str) -> str:
    """Contents of list items four spaces from the left, as Python-Markdown wants them.

    GitHub, for which the pages are written, takes the width of the mark, which is two or three.
    """
    lines, width, fenced = [], 0, False
    for line in markdown.splitlines():
        mark = None if fenced else re.match(r"(?:[-*]|\d+\.) +", line)
        if mark:
            width = len(mark[0])
        elif line.strip() and not line.startswith(" "):
            width = 0
        inside = width and line.startswith(" " * width)
        lines.append(" " * (4 - width) + line if inside and not mark else line)
        if re.match(r" *```", line):
            fenced = not fenced
    return "\n".join(lines) + "\n"
