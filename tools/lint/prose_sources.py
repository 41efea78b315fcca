"""Read the prose of the repository as blocks of plain words, for check_prose.py."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

LIBRARIES = ("backends", "core", "nova", "io", "collision", "dynamics", "vbd", "diff")
# Group -> glob patterns of its files, relative to the root.
GROUPS = {
    "README": ("README.md",),
    "guides": ("docs/guide/*.md",),
    "pages": ("docs/*.md", "CONTRIBUTING.md"),
    "design notes": ("docs/design/**/*.md",),
    "docstrings": ("python/novaphy/**/*.py", "python/src/*.cpp", "python/src/doc_*.h"),
    "header comments": tuple(f"{library}/**/*.h" for library in LIBRARIES),
}

FENCE = re.compile(r"^(```|~~~).*?^\1[^\n]*$", re.MULTILINE | re.DOTALL)
SKIPPED = re.compile(r"^(#|<|!\[|\|[-| :]+\|$|\[[^\]]+\]: )")  # headings, HTML, pictures, rules
ITEM = re.compile(r"^\s*([-*]|\d+\.)\s+")
CELLS = re.compile(r"(?<!\\)\|")
CODE = re.compile(r"``.+?``|`[^`]+`")
LINKED = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
# One or more neighboring string literals of C++, raw or not.
LITERAL = re.compile(r'R"\((.*?)\)"|"((?:\\.|[^"\\\n])*)"', re.DOTALL)
LITERALS = re.compile(r'(?:R"\(.*?\)"|"(?:\\.|[^"\\\n])*"|\s)+', re.DOTALL)


@dataclass
class Text:
    """A file and its blocks of prose: paragraphs, list items and cells of tables."""

    name: str
    group: str
    blocks: list[str]


def plain(text: str) -> str:
    """Return prose on one line. Code becomes the word "code", and a link becomes its text."""
    text = CODE.sub("code", " ".join(text.split()))
    return LINKED.sub(r"\1", text).replace("**", "").replace("\\", "")


def markdown_blocks(text: str) -> Iterator[str]:
    """Yield paragraphs, list items and cells of tables, without code and headings."""
    lines: list[str] = []
    for line in [*FENCE.sub("", text).splitlines(), ""]:
        starts = not line.strip() or SKIPPED.match(line) or line.startswith("|") or ITEM.match(line)
        if starts and lines:
            yield plain(" ".join(lines))
            lines = []
        if line.startswith("|") and not SKIPPED.match(line):
            covered = CODE.sub("`code`", line)
            yield from (plain(cell) for cell in CELLS.split(covered) if cell.strip())
        elif line.strip() and not SKIPPED.match(line):
            lines.append(ITEM.sub("", line))


def docstring_blocks(text: str) -> Iterator[str]:
    """Yield paragraphs and descriptions of arguments, without code (lines with a larger indent)."""
    for paragraph in re.split(r"\n\s*\n", text):
        kept = [line for line in paragraph.splitlines() if not re.match(r"\s*(>>>|\.\.\. )", line)]
        for part in re.split(r"\n(?=\s*[\w, /*]+: )", "\n".join(kept)):
            yield plain(part)


def python_blocks(text: str) -> Iterator[str]:
    """Yield the blocks of all docstrings of a Python file."""
    kinds = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, kinds) and (docstring := ast.get_docstring(node)):
            yield from docstring_blocks(docstring)


def binding_blocks(text: str) -> Iterator[str]:
    """Yield the blocks of docstrings in a file of bindings: string literals that end a sentence."""
    for found in LITERALS.finditer(re.sub(r"^\s*(//|#).*$", "", text, flags=re.MULTILINE)):
        parts = [raw or quoted for raw, quoted in LITERAL.findall(found.group())]
        docstring = "".join(parts).replace("\\n", "\n").replace('\\"', '"')
        if re.match(r"[A-Z]\S*( \S+){3}", docstring) and docstring.rstrip().endswith((".", ")")):
            yield from docstring_blocks(docstring)


def head_blocks(text: str) -> Iterator[str]:
    """Yield paragraphs and list items of the comment at the head of a header, without formulas."""
    head = re.match(r"(?:#pragma once\s*)?((?://[^\n]*\n)*)", text)
    lines = [line[2:] for line in head[1].splitlines()]
    prose = "\n".join("" if line.startswith("   ") else line for line in lines)
    yield from (plain(ITEM.sub("", part)) for part in re.split(r"\n\s*\n|\n(?=\s*- )", prose))


def read_texts(root: Path) -> list[Text]:
    """Return the texts of all groups, without build trees."""
    readers = {".md": markdown_blocks, ".py": python_blocks, ".cpp": binding_blocks}
    texts = []
    for group, patterns in GROUPS.items():
        for path in sorted({p for pattern in patterns for p in root.glob(pattern)}):
            name = path.relative_to(root).as_posix()
            others = binding_blocks if group == "docstrings" else head_blocks
            reader = readers.get(path.suffix, others)
            blocks = [block for block in reader(path.read_text(encoding="utf-8")) if block]
            texts.append(Text(name, group, blocks))
    return texts
