"""Read sources without comments and strings, and find their functions, for measure_house.py."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PHYSICS = ("collision", "dynamics", "vbd", "diff")
ENGINE = ("backends", "core", "nova", "io", *PHYSICS)
ROOMS = (*ENGINE, "python/src", "python/novaphy", "python/demos", "tools")
CXX = (".h", ".hpp", ".cpp", ".cuh", ".inc")
SUFFIXES = {*CXX, ".py", ".pyi"}

TOKEN = re.compile(r"[A-Za-z_]\w*|\d[\w.']*|\"|::|->|<<|>>|&&|\|\||[-+*/%&|^=!<>]=|\+\+|--|[^\s\w]")
# A comment, a raw string, a string or a character of C++. The quote in the number 1'000 is none of
# these.
CXX_TEXT = re.compile(
    r"//(?:\\\n|[^\n])*|/\*.*?\*/"
    r"|\bR\"(?P<end>[^(\s]*)\(.*?\)(?P=end)\""
    r"|\"(?:\\.|[^\"\\\n])*\"|(?<!\w)(?:u8|[uUL])?'(?:\\.|[^'\\\n])+'",
    re.DOTALL,
)
PYTHON_TEXT = re.compile(
    r"#[^\n]*|(\"\"\"|''')(?:\\.|.)*?\1|\"(?:\\.|[^\"\\\n])*\"|'(?:\\.|[^'\\\n])*'", re.DOTALL
)
DIRECTIVE = re.compile(r"^[ \t]*#(?:\\\n|[^\n])*", re.MULTILINE)


@dataclass
class Source:
    """A file without its comments and with empty strings. Lines keep their numbers."""

    name: str
    room: str
    lines: int
    code: str
    tree: ast.Module | None = None  # only for a Python file

    @property
    def is_cxx(self) -> bool:
        return self.name.endswith(CXX)

    def within(self, rooms: tuple[str, ...]) -> bool:
        return self.room in rooms


def blank(found: re.Match[str]) -> str:
    """Return the replacement of a comment or a string of C++."""
    text = found.group()
    breaks = "\n" * text.count("\n")
    if text.startswith(("//", "/*", "#")):
        return breaks or " "
    return "0" if text.lstrip("u8UL").startswith("'") else '""' + breaks


def blank_python(found: re.Match[str]) -> str:
    """Return the replacement of a comment or a string of Python."""
    text = found.group()
    return ("" if text.startswith("#") else '""') + "\n" * text.count("\n")


def without_docstrings(text: str, tree: ast.Module) -> str:
    """Return the lines of a Python file, with empty lines for docstrings."""
    lines = text.split("\n")
    for node in ast.walk(tree):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        first = node.body[0] if node.body else None
        if (
            isinstance(first, ast.Expr)
            and isinstance(first.value, ast.Constant)
            and isinstance(first.value.value, str)
        ):
            for k in range(first.lineno - 1, first.end_lineno):
                lines[k] = ""
    return "\n".join(lines)


def read_sources(root: Path) -> list[Source]:
    """Return the sources of all folders that measure_house.py measures."""
    sources = []
    for path in sorted(
        p for room in ROOMS for p in (root / room).rglob("*") if p.suffix in SUFFIXES
    ):
        name = path.relative_to(root).as_posix()
        room = next(room for room in ROOMS if name.startswith(room + "/"))
        text = path.read_text(encoding="utf-8")
        tree = None
        if name.endswith(CXX):
            code = CXX_TEXT.sub(blank, text)
        else:
            tree = ast.parse(text)
            code = PYTHON_TEXT.sub(blank_python, without_docstrings(text, tree))
        if name.endswith(".pyi"):
            room += " (stubs)"
        sources.append(Source(name, room, text.count("\n"), code, tree))
    return sources


# ---- functions ----

LABEL = re.compile(r"^(?:\s*(?:public|private|protected)\s*:(?!:))+\s*")
SCOPE = re.compile(r"\bnamespace\b|\bextern\s*\"|^(?:typedef\s+)?(?:class|struct|union|enum)\b")
KERNEL_NAME = re.compile(r"\bNOVAPHY_\w+\(\s*(\w+)")
FUNCTION_NAME = re.compile(r"(operator\s*[^\s\w(]+|operator\(\)|~?\w+)\s*\(")


def without_nested(text: str, opening: str, closing: str) -> str:
    """Return the text with the content of the outermost brackets removed."""
    kept, depth = [], 0
    for c in text:
        if c == closing and depth:
            depth -= 1
        if depth == 0:
            kept.append(c)
        if c == opening:
            depth += 1
    return "".join(kept)


def without_template(head: str) -> str:
    """Return a declaration without a leading `template <...>`."""
    while found := re.match(r"\s*template\s*(?=<)", head):
        end, depth = found.end(), 0
        while end < len(head):
            depth += {"<": 1, ">": -1}.get(head[end], 0)
            end += 1
            if depth == 0:
                break
        head = head[end:]
    return head.strip()


def opens(head: str) -> str:
    """Return what the brace after `head` opens: a scope, a function, a value or another block."""
    text = without_template(head)
    if text.count("(") > text.count(")"):
        return "value"  # the initializer of an argument
    flat = without_nested(re.sub(r"operator\s*\(\)", "operator", text), "(", ")")
    if SCOPE.search(flat) and not ("(" in flat and re.search(r"\)\s*(const\b.*)?$", flat)):
        return "scope"
    if re.search(r"\)\s*(noexcept\s*)?:(?!:)", flat) and re.search(r"[\w>]$", head):
        return "value"  # the initializer of a member, in a constructor
    if "(" in flat and not re.search(r"(?<![=!<>])=(?!=)", re.sub(r"operator\S+", "", flat)):
        return "function"
    return "block"


def cxx_functions(code: str) -> Iterator[tuple[str, int]]:
    """Yield name and number of lines of each function and of each body of a kernel."""
    code = DIRECTIVE.sub(lambda found: "\n" * found.group().count("\n"), code)
    inside = depth = head_at = 0  # depth: number of open blocks within a function or another block
    name, first, is_function, is_value = "", 0, False, False
    for mark in re.finditer(r"[{};]", code):
        if inside:
            depth += {"{": 1, "}": -1, ";": 0}[mark.group()]
            if depth:
                continue
            inside = 0
            if is_function:
                yield name, code.count("\n", first, mark.start()) + 1
            if is_value:
                continue  # the declaration continues after the value
        elif mark.group() == "{":
            head = code[head_at : mark.start()]
            kind = opens(LABEL.sub("", re.sub(r"\[\[.*?\]\]", "", head).lstrip()))
            if kind != "scope":
                inside, depth, is_function, is_value = 1, 1, kind == "function", kind == "value"
                if is_function:
                    label = LABEL.match(head)
                    first = head_at + (label.end() if label else len(head) - len(head.lstrip()))
                    head = without_template(head)
                    found = KERNEL_NAME.search(head) or FUNCTION_NAME.search(head)
                    name = found.group(1) if found else "?"
                if not is_value:
                    head_at = mark.end()
                continue
        head_at = mark.end()


def python_functions(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Yield name and number of lines of each function of a Python file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node.name, node.end_lineno - node.lineno + 1
