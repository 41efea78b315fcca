#!/usr/bin/env python3
"""Write the stubs of the native module, with its docstrings, from the built module.
    make_stubs.py MODULE.so OUTPUT

OUTPUT becomes a folder with __init__.pyi and one file for each submodule. types.toml has the types
that the module itself does not report.
"""

from __future__ import annotations

import argparse
import fnmatch
import keyword
import re
import textwrap
import tomllib
from pathlib import Path
from typing import Any

from native_module import Attribute, Class, Module, Property, load, read_modules
from signatures import ANYTHING, Function, Parameter, Signature, join_types, merge_overloads

WIDTH = 100
MOST = 120  # longest line of documentation
HEAD = {
    "collections.abc": ("Callable", "Iterable", "Iterator", "Sequence"),
    "numpy.typing": ("NDArray",),
    "types": ("EllipsisType",),
    "typing": (
        "Any",
        "Final",
        "Literal",
        "Never",
        "NoReturn",
        "SupportsFloat",
        "SupportsIndex",
        "TypeAlias",
        "overload",
    ),
}
OTHERS = {name for names in HEAD.values() for name in names} | {"None", "True", "False", "Mesh"}
OTHERS |= {"Selection", "Three"}
# Type that an attribute returns -> type of the values that may be assigned.
SAME = {"float": "SupportsFloat", "int": "SupportsIndex"}


class Types:
    """The rules of types.toml."""

    def __init__(self, path: Path) -> None:
        rules = tomllib.loads(path.read_text(encoding="utf-8"))
        self.preamble: dict[str, str] = rules["preamble"]
        self.passed: dict[str, str] = rules["passed"]
        self.arguments: dict[str, str] = rules["arguments"]
        self.assigned: dict[str, str] = rules["assigned"]
        self.properties: dict[str, Any] = rules["properties"]
        self.functions: dict[str, dict[str, str]] = rules["functions"]
        self.signatures: dict[str, list[str]] = rules["signatures"]
        self.additions: dict[str, dict[str, str]] = rules["additions"]

    @staticmethod
    def found(table: dict[str, Any], key: str) -> Any:
        """Return the entry of a name, or of the first pattern that matches the name, or None."""
        if key in table:
            return table[key]
        return next((v for k, v in table.items() if "*" in k and fnmatch.fnmatch(key, k)), None)

    def argument(self, key: str, parameter: Parameter, returns: str) -> str:
        """Return the type of an argument of the function `key`."""
        rule = (self.found(self.functions, key) or {}).get(parameter.name)
        if rule is None and ANYTHING in re.findall(r"\w+", parameter.type):
            rule = self.arguments.get(parameter.name)
        text = rule or parameter.type
        if rule is None and key.endswith((".__eq__", ".__ne__")) and returns == "bool":
            text = "object"  # as for the method of `object`
        if rule is None:
            for native, passed in self.passed.items():
                text = re.sub(rf"\b{native}\b", passed, text)
        if parameter.default == "None" and text not in (ANYTHING, "object", "_DeviceLike"):
            text = join_types([text, "None"])
        return text

    def returned(self, key: str, signature: Signature) -> str:
        """Return the type that a function returns."""
        return (self.found(self.functions, key) or {}).get("return", signature.returns)


def doc_lines(doc: str, indent: str) -> list[str]:
    """Return a docstring as indented lines of at most MOST columns; [] for no docstring."""
    if not doc:
        return []
    doc = doc.replace("\\", "\\\\").replace('"""', '\\"\\"\\"')
    lines: list[str] = []
    room = WIDTH - len(indent)
    for line in doc.splitlines():
        if len(line) + len(indent) <= MOST:  # keeps the author's line breaks
            lines.append(line)
            continue
        hang = re.match(r"\s*", line).group()
        wrapped = textwrap.wrap(
            line, room, subsequent_indent=hang, break_long_words=False, break_on_hyphens=False
        )
        lines += wrapped or [""]
    if len(lines) == 1 and len(lines[0]) + 6 <= room and not lines[0].endswith(('"', "\\")):
        return [f'{indent}"""{lines[0]}"""']
    rest = [f"{indent}{line}".rstrip() for line in lines[1:]]
    return [f'{indent}"""{lines[0]}', *rest, f'{indent}"""']


class ModuleWriter:
    """Writes the stub of one module."""

    def __init__(self, module: Module, types: Types, homes: dict[str, str]) -> None:
        self.module = module
        self.types = types
        self.homes = homes  # native class -> module that defines the class
        self.lines: list[str] = []
        self.aliases: set[str] = set()
        self.members: set[str] = set()  # members of the current class

    def key(self, *names: str) -> str:
        return ".".join(filter(None, (self.module.name, *names)))

    def type(self, text: str) -> str:
        """Return a type as text for the current class, whose members may hide a class name."""
        for name in sorted(self.members & self.homes.keys()):
            # A name before a colon is an argument and not a type.
            text, count = re.subn(rf"(?<![\w.\"']){name}\b(?!\s*:)", f"_{name}", text)
            if count:
                self.aliases.add(name)
        return self.known(text)

    def known(self, text: str) -> str:
        """Return a text with Any in place of classes that the build or the module does not have."""
        for name in set(re.findall(r"(?<![\w.\"'])[A-Z]\w*\b(?!\s*:)", text)):
            if name not in self.homes and name not in OTHERS:
                text = re.sub(rf"(?<![\w.\"']){name}\b(?!\s*:)", ANYTHING, text)
        return text

    def write(self) -> str:
        """Return the text of the stub file."""
        for item in self.module.content:
            if isinstance(item, Class):
                self.class_(item)
            elif isinstance(item, Function):
                self.function(item, "", None)
            elif not item.name.startswith("_"):
                name = type(item.value).__name__
                home = self.homes.get(name)
                shown = f"_{name}" if home not in (None, self.module.name) else name
                self.lines.append(f"{item.name}: Final[{shown}]")
        return self.head() + "\n".join(self.lines) + "\n"

    def head(self) -> str:
        """Return the docstring, the needed imports, and the aliases of the stub."""
        name = ".".join(filter(None, ("novaphy._core", self.module.name)))
        preamble = self.types.preamble.get(self.module.name or "core", "")
        preamble = "\n".join(
            line if line.startswith("#") else self.known(line) for line in preamble.splitlines()
        )
        body = preamble + "\n" + "\n".join(self.lines)
        code = re.sub(r'"""(?:\\.|[^\\])*?"""', "", body)
        used = set(re.findall(r"(?<![\w.])[A-Za-z_]\w*", code))
        lines = [f'"""Types of {name}, written by tools/stubs/make_stubs.py."""', ""]
        if "enum" in used:
            lines.append("import enum")
        if "os" in used:
            lines.append("import os")
        if "np" in used:
            lines.append("import numpy as np")
        if self.aliases:
            used.add("TypeAlias")
        for source, names in HEAD.items():
            if chosen := [n for n in names if n in used]:
                lines.append(f"from {source} import {', '.join(chosen)}")
        lines += self.imports(used)
        lines.append("")
        aliases = [f"_{n}: TypeAlias = {n}" for n in sorted(self.aliases)]
        return "\n".join([*lines, preamble.strip(), *aliases, "", ""])

    def imports(self, used: set[str]) -> list[str]:
        """Return the imports from the other modules."""
        own = {item.name for item in self.module.content}
        lines = []
        if self.module.name:
            shared = re.findall(r"^(?:class )?(_\w+)", self.types.preamble["core"], re.MULTILINE)
            local = self.types.preamble.get(self.module.name, "")
            names = [n for n in dict.fromkeys(shared) if n in used and f"{n}:" not in local]
            lines += [f"from . import {name}" for name in sorted(names)]
        else:
            lines += [f"from . import {name} as {name}" for name in self.module.submodules]
        for name, home in sorted(self.homes.items()):
            source = f".{home}" if home else "."
            if home == self.module.name:
                continue
            if name in used and name not in own:
                lines.append(f"from {source} import {name}")
            if f"_{name}" in used or (name in self.aliases and name in own):
                lines.append(f"from {source} import {name} as _{name}")
                self.aliases.discard(name)
        return lines

    def class_(self, item: Class) -> None:
        """Write a class to the stub."""
        self.members = {member.name for member in item.members}
        bases = ", ".join(item.bases or ["_Native"])
        self.lines += ["", f"class {item.name}({bases}):"]
        if item.doc:
            self.lines += doc_lines(item.doc, "    ")
        before = len(self.lines)
        for member in item.members:
            if isinstance(member, Function):
                self.function(member, "    ", item)
            elif isinstance(member, Property):
                self.property_(member, item)
            elif bases.startswith("enum."):
                self.lines.append(f"    {member.name} = {member.value}")
            else:
                self.attribute(member)
        for name, text in self.types.additions.get(self.key(item.name), {}).items():
            if name not in self.members:
                self.lines += textwrap.indent(text.strip(), "    ").splitlines()
        if len(self.lines) == before and not item.doc:
            self.lines.append("    ...")
        self.members = set()

    def attribute(self, member: Attribute) -> None:
        """Write an attribute of a class."""
        if member.value is None:
            hidden = "  # type: ignore[assignment]" if member.name == "__hash__" else ""
            self.lines.append(f"    {member.name}: None{hidden}")
        elif isinstance(member.value, type):
            self.lines.append(f"    {member.name}: type[{self.type(member.value.__name__)}]")
        else:
            self.lines.append(f"    {member.name}: {type(member.value).__name__}")

    def property_(self, item: Property, owner: Class) -> None:
        """Write a property, as an attribute if reads and writes have the same type."""
        rule = Types.found(self.types.properties, self.key(owner.name, item.name))
        if isinstance(rule, str):
            rule = {"read": rule}
        rule = rule or {}
        read = rule.get("read", item.read)
        written = item.written
        if written is not None:
            if read == "DeviceArray":
                read = written = "_Field"
            # An attribute that may be None may also be set to None.
            same = " | ".join(SAME.get(part, part) for part in read.split(" | "))
            if written == same:
                written = read
            if written == ANYTHING:
                written = self.types.assigned.get(read, read)
            written = rule.get("written", written)
        read, name = self.type(read), item.name
        if written is not None and self.type(written) == read:
            self.lines += [f"    {name}: {read}", *doc_lines(item.doc, "    ")]
            return
        self.lines += ["    @property", f"    def {name}(self) -> {read}:"]
        self.lines += doc_lines(item.doc, "        ") or ["        ..."]
        if written is not None:
            self.lines.append(f"    @{name}.setter")
            self.lines.append(f"    def {name}(self, value: {self.type(written)}) -> None: ...")

    def function(self, item: Function, indent: str, owner: Class | None) -> None:
        """Write a function with its overloads. The first overload has the documentation."""
        if keyword.iskeyword(item.name):
            return
        key = self.key(owner.name if owner else "", item.name)
        static = owner is not None and item.name in owner.static
        texts = Types.found(self.types.signatures, key)
        if texts is None:
            for signature in item.overloads:
                for parameter in signature.parameters:
                    parameter.type = self.types.argument(key, parameter, signature.returns)
                signature.returns = self.types.returned(key, signature)
            first = "" if owner is None or static else "self"
            merged = merge_overloads(item.overloads)
            texts = [self.signature(item.name, s, first) for s in merged]
            texts = texts or ["(*args: Any, **kwargs: Any) -> Any"]
        for place, text in enumerate(texts):
            lines = ["@overload"] * (len(texts) > 1) + ["@staticmethod"] * static
            lines += self.definition(item.name, self.type(text), len(indent))
            if place > 0 or not item.doc:
                lines[-1] += " ..."
            if item.name in ("__eq__", "__ne__") and not text.endswith("-> bool"):
                lines[-1] += "  # type: ignore[override]"
            self.lines += [indent + line for line in lines]
            if place == 0:
                self.lines += doc_lines(item.doc, indent + "    ")

    def signature(self, name: str, signature: Signature, first: str) -> str:
        """Return the signature `(self, x: T) -> R` as one line."""
        parts = [first] if first else []
        operator = name.startswith("__") and name != "__init__"
        slash, star = False, False
        for place, p in enumerate(signature.parameters):
            text = f"{p.name}: {p.type}"
            if p.kind == "only" or (operator and re.fullmatch(r"arg\d*", p.name)):
                text, slash = f"{'other' if operator else p.name}: {p.type}", True
                if operator and place > 0:
                    text = f"value: {p.type}"
            elif slash:
                parts.append("/")
                slash = False
            if p.kind == "key" and not star:
                parts.append("*")
                star = True
            if p.kind in ("args", "kwargs"):
                text = {"args": "*", "kwargs": "**"}[p.kind] + text
                star = True
            parts.append(text if p.default is None else f"{text} = {p.default}")
        if slash:
            parts.append("/")
        returns = "None" if name == "__init__" else signature.returns
        return f"({', '.join(parts)}) -> {returns}"

    @staticmethod
    def definition(name: str, text: str, indent: int) -> list[str]:
        """Return the lines of a `def`, with one argument for each line if one line is too long."""
        line = f"def {name}{text}:"
        if len(line) + indent + 4 <= WIDTH:
            return [line]
        depth, begin, parts = 0, 1, []
        for place, letter in enumerate(text):
            depth += (letter in "[(") - (letter in "])")
            if depth == 0:
                parts.append(text[begin:place])
                return [
                    f"def {name}(",
                    *[f"    {p.strip()}," for p in parts],
                    f"){text[place + 1 :]}:",
                ]
            if letter == "," and depth == 1:
                parts.append(text[begin:place])
                begin = place + 1
        raise ValueError(f"expected the arguments of {name} in brackets, got {text}")


def write_stubs(module: Path, output: Path) -> None:
    """Write the stubs of a native module into a folder."""
    types = Types(Path(__file__).with_name("types.toml"))
    modules = read_modules(load(module))
    homes = {item.name: m.name for m in modules for item in m.classes()}
    output.mkdir(parents=True, exist_ok=True)
    for old in output.glob("*.pyi"):
        old.unlink()
    for part in modules:
        text = ModuleWriter(part, types, homes).write()
        (output / f"{part.name or '__init__'}.pyi").write_text(text, encoding="utf-8")


def main() -> None:
    """Read the arguments and write the stubs."""
    parser = argparse.ArgumentParser(description="Write the stubs of the native module.")
    parser.add_argument("module", type=Path, help="the built module, _core.*.so")
    parser.add_argument("output", type=Path, help="the folder of the stubs, .../novaphy/_core")
    arguments = parser.parse_args()
    write_stubs(arguments.module, arguments.output)


if __name__ == "__main__":
    main()
