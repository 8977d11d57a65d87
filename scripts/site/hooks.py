"""Hooks of MkDocs: the site has the pages of docs, and some that are generated.

- The index, docs/README.md, is the navigation: its headings are the parts of the site.
- Python reference: a page for each subject and module, with directives of mkdocstrings (`api.py`).
- Dialects and passes: the output of mlir-tblgen, in build/docs/reference (`make docs`).
- Files of the repository that a page links to, such as examples, become pages with their text.
"""

from __future__ import annotations

import os
import posixpath
import re
from pathlib import Path
from typing import Any

import api
from indentation import indented
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
BUILD = Path(os.environ.get("TAI_BUILD_DIR", ROOT / "build"))
LINK = re.compile(r"(\]\()([^)#\s]+)((?:#[^)\s]*)?\))")
MENTION = re.compile(r"(?<![\w./\">-])docs/([\w/-]+\.md)\b")
# Dialects and passes, by the names that mlir-tblgen gives them.
DIALECTS = {"TaiDialect": "tai", "CheckDialect": "check", "TaiRTDialect": "tai-rt"}
PASSES = {
    "TaiADPasses": "Differentiation",
    "TaiTransformsPasses": "Transforms",
    "TaiConversionPasses": "Conversions",
}
LANGUAGES = {".py": "python", ".cpp": "cpp", ".h": "cpp", ".c": "c", ".cu": "cuda", ".sh": "bash",
             ".def": "cpp", ".toml": "toml", ".csv": "text", ".jsonl": "json"}  # fmt: skip
# Larger files are cut: a page is for reading.
LONGEST = 200_000

_generated: dict[str, str] = {}
_linked: set[str] = set()


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Generates the pages, and makes the navigation of the index."""
    _generated.clear()
    _generated.update(_python_pages())
    _generated.update(_dialect_pages())
    _linked.clear()
    for page in DOCS.rglob("*.md"):
        _linked.update(_outside(page.read_text(), page.relative_to(DOCS).as_posix()))
    config["nav"] = _navigation()
    return config


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    for uri, text in _generated.items():
        files.append(File.generated(config, uri, content=text))
    for name in sorted(_linked):
        files.append(File.generated(config, _source_uri(name), content=_source_page(name)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Sends links to files outside of docs to the pages of these files."""
    here = posixpath.dirname(page.file.src_uri)

    def target(match: re.Match[str]) -> str:
        name = _name_outside(match[2], here)
        if name is None:
            return match[0]
        uri = posixpath.relpath(_source_uri(name), here or ".")
        return match[1] + uri + (match[3] if name.endswith(".md") else ")")

    return indented(LINK.sub(target, markdown))


def on_page_content(html: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Makes links of the names of pages in docstrings and descriptions of ops."""
    here = posixpath.dirname(page.file.dest_uri)

    def link(match: re.Match[str]) -> str:
        file = files.get_file_from_path(match[1])
        if file is None:
            return match[0]
        return f'<a href="{posixpath.relpath(file.dest_uri, here or ".")}">{match[0]}</a>'

    return MENTION.sub(link, html)


def _name_outside(link: str, here: str) -> str | None:
    """The path below the repository of a link to a file outside of docs; else None."""
    if re.match(r"[a-z]+:", link) or link.startswith("/"):
        return None
    name = posixpath.normpath(posixpath.join("docs", here, link))
    if name.startswith((".", "docs/")) or name == "docs" or not (ROOT / name).exists():
        return None
    return name


def _outside(text: str, uri: str) -> set[str]:
    found = (_name_outside(match[2], posixpath.dirname(uri)) for match in LINK.finditer(text))
    return {name for name in found if name}


def _source_uri(name: str) -> str:
    return f"source/{name}" if name.endswith(".md") else f"source/{name}.md"


def _source_page(name: str) -> str:
    path = ROOT / name
    if path.is_dir():
        names = sorted(child.name + "/" * child.is_dir() for child in path.iterdir()
                       if not child.name.startswith((".", "__")))  # fmt: skip
        return f"# {name}\n\n" + "\n".join(f"- `{child}`" for child in names) + "\n"
    text = path.read_text(errors="replace")
    if len(text) > LONGEST:
        text = text[:LONGEST] + "\n… (the rest is in the repository)\n"
    if name.endswith(".md"):
        # Its own links are for readers of the repository.
        return re.sub(r"!?\[([^\]]*)\]\((?![a-z]+:)[^)]*\)", r"\1", text)
    return f"# {name}\n\n````{LANGUAGES.get(path.suffix, 'text')}\n{text}\n````\n"


def _navigation() -> list[Any]:
    """The parts of the index with its pages, and the generated pages."""
    navigation: list[Any] = [{"tai": "README.md"}]
    text = (DOCS / "README.md").read_text()
    for part in re.split(r"^## ", text, flags=re.M)[1:]:
        title, _, body = part.partition("\n")
        pages: list[Any] = []
        for link in (match[2] for match in LINK.finditer(body)):
            if (DOCS / link).is_file() and link not in pages and link.endswith(".md"):
                pages.append(link)
        if title == "Reference":
            python = [uri for uri in _generated if uri.startswith("reference/python/")]
            dialects = [uri for uri in _generated if uri.startswith("reference/ir/")]
            pages += [{"Python": python}] + (
                [{"Dialects and passes": dialects}] if dialects else []
            )
        if title == "Internals":
            decisions = sorted(p.relative_to(DOCS).as_posix() for p in DOCS.glob("decisions/*.md"))
            pages = [page for page in pages if page != "decisions/README.md"]
            decisions.sort(key=lambda uri: (not uri.endswith("README.md"), uri))
            pages.append({"Decisions": decisions})
        navigation.append({title: pages})
    return navigation


def _entry(path: str, heading: str) -> str:
    return f'::: {path}\n    options:\n      heading: "{heading}"\n'


def _python_pages() -> dict[str, str]:
    """A page for each subject of `tai` and for each module, with an overview."""
    names = api.names_of_package()
    pages, overview = {}, ["# Python reference", "", "| page | names |", "|---|---|"]
    for page in api.PAGES:
        lines = [f"# {page.title}", "", page.text, ""]
        for section, listed in page.sections.items():
            lines += [f"## {section}", ""]
            lines += [_entry(names[name], f"ti.{name}") for name in listed.split() if name in names]
        if page.file == "kernels":
            lines += ["## Constants", "", "| names | are |", "|---|---|"]
            for title, listed in api.CONSTANTS.items():
                shown = " ".join(f"`ti.{name}`" for name in listed.split())
                lines.append(f"| {shown} | {title[0].lower() + title[1:]} |")
        pages[f"reference/python/{page.file}.md"] = "\n".join(lines) + "\n"
        listed = " ".join(" ".join(page.sections.values()).split())
        shown = " ".join(f"`{name}`" for name in listed.split())
        overview.append(f"| [{page.title}]({page.file}.md) | {shown} |")
    for module in api.MODULES:
        path = api.PACKAGE / f"{module}.py"
        if not path.is_file():
            continue
        listed = api.names_of_module(module)
        tree = api.ast.parse(path.read_text())
        lines = [f"# ti.{module}", "", api.ast.get_docstring(tree) or "", ""]
        constants = [f"`{name}`" for name, full in listed.items() if not full]
        if constants:
            lines += ["Constants and types: " + ", ".join(constants) + ".", ""]
        lines += [_entry(full, f"ti.{module}.{name}") for name, full in listed.items() if full]
        pages[f"reference/python/{module}.md"] = "\n".join(lines) + "\n"
        shown = " ".join(f"`{name}`" for name in listed)
        overview.append(f"| [ti.{module}]({module}.md) | {shown} |")
    return {"reference/python/index.md": "\n".join(overview) + "\n", **pages}


def _dialect_pages() -> dict[str, str]:
    """The reference that mlir-tblgen made; none if it was not made."""
    folder = BUILD / "docs" / "reference"
    if not folder.is_dir():
        raise SystemExit(f"site: {folder} is missing: make docs")
    pages = {}
    for name, page in DIALECTS.items():
        pages[f"reference/ir/{page}.md"] = _of_tblgen((folder / f"{name}.md").read_text())
    passes = ["# Passes", "", "Each is an option of `tai-opt`, as `--tai-flatten-branches`.", ""]
    for name, title in PASSES.items():
        passes += [f"## {title}", "", _of_tblgen((folder / f"{name}.md").read_text())]
    pages["reference/ir/passes.md"] = "\n".join(passes)
    return pages


def _of_tblgen(text: str) -> str:
    """Without the table of contents (the site has one), and with links that hold here."""
    text = re.sub(r"^<!--.*?-->\n|^\[TOC\]\n", "", text, flags=re.M)
    return text.replace("](Passes.md#", "](passes.md#")
