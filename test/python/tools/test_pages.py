"""The pages of docs: links that hold, an index that lists all of them, names that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
LINK = re.compile(r"\]\(([^)\s]+)\)")
MENTION = re.compile(r"(?<![\w./-])docs/[\w/-]+\.md\b")


# Parts of the tree with text; a copy of it for a test of GPUs lacks some.
PARTS = ".ci .github benchmarks docs examples include lib python scripts test tools".split()


def sources() -> list[Path]:
    files = [path for path in ROOT.iterdir() if path.is_file()]
    for part in PARTS:
        files += [path for path in (ROOT / part).rglob("*") if path.is_file()]
    binary = (".png", ".gif", ".so", ".pyc", ".npz")
    return [path for path in files if path.suffix not in binary and "results" not in path.parts]


def without_code(text: str) -> str:
    text = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda m: re.sub(r"[\[\]()]", "", m[0]), text)


def anchor(heading: str) -> str:
    """The anchor that GitHub and the site make of a heading."""
    heading = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)
    return re.sub(r"[^\w\- ]", "", heading.strip().lower()).replace(" ", "-")


def test_links():
    wrong = []
    for page in [path for path in sources() if path.suffix == ".md"]:
        for link in LINK.findall(without_code(page.read_text())):
            if re.match(r"[a-z]+:", link):
                continue
            name, _, part = link.partition("#")
            target = (page.parent / name).resolve() if name else page
            if not target.exists():
                wrong.append(f"{page.relative_to(ROOT)}: {link}")
            elif part and target.suffix == ".md":
                heads = re.findall(r"^#+ (.*)", target.read_text(), re.M)
                if part not in map(anchor, heads):
                    wrong.append(f"{page.relative_to(ROOT)}: {link}: no such heading")
    assert not wrong, "\n".join(wrong)


def test_the_index_lists_all_pages():
    listed = {(DOCS / link).resolve() for link in LINK.findall((DOCS / "README.md").read_text())}
    pages = [path for path in DOCS.rglob("*.md") if path.parent.name != "decisions"]
    pages = [path for path in pages if path != DOCS / "README.md"]
    assert len(pages) > 30
    assert not [str(path) for path in pages if path.resolve() not in listed]


def test_pages_say_things_once():
    """No paragraph or entry of a list stands twice on a page, however its lines are broken."""
    twice, found = [], 0
    for page in [path for path in sources() if path.suffix == ".md"]:
        text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
        blocks = [" ".join(block.split()) for block in re.split(r"\n\s*\n|\n(?=\s*- )", text)]
        blocks = [block for block in blocks if len(block) > 60 and block[0] not in "|#"]
        found += len(blocks)
        twice += [f"{page.relative_to(ROOT)}: {b}" for b in set(blocks) if blocks.count(b) > 1]
    assert found > 500
    assert not twice, "\n".join(twice)


def test_pages_that_sources_name():
    """Sources, messages and scripts that name a page of docs name one that exists."""
    wrong, found = [], 0
    for path in sources():
        if path.name in ("test_pages.py", "test_prose.py"):
            continue
        for name in MENTION.findall(path.read_text(errors="replace")):
            found += 1
            if not (ROOT / name).is_file():
                wrong.append(f"{path.relative_to(ROOT)}: {name}")
    assert found > 40
    assert not wrong, "\n".join(wrong)


def test_the_list_of_decisions():
    """Each is on the list with its status, and one that is replaced says so there and itself."""
    folder = DOCS / "decisions"
    listed = re.findall(r"^\| (?:\d{4})? ?\| \[[^]]+\]\(([\w-]+\.md)\) \| (.+) \|$",
                        (folder / "README.md").read_text(), re.M)  # fmt: skip
    pages = {path.name for path in folder.glob("*.md")} - {"README.md"}
    assert {name for name, _ in listed} == pages and len(listed) == len(pages)
    for name, status in listed:
        replaced = re.search(r"^Status: replaced by", (folder / name).read_text(), re.M)
        assert bool(replaced) == status.startswith("replaced by"), name
