"""Read the content of a native module from the module itself: classes, functions, constants."""

from __future__ import annotations

import enum
import importlib.util
import sys
import types
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from signatures import ANYTHING, Function, parse_docstring, stub_type

# Members that every class has, or that only pickle calls.
SKIPPED = {
    "__doc__",
    "__module__",
    "__qualname__",
    "__dict__",
    "__weakref__",
    "__repr__",
    "__str__",
    "__reduce__",
    "__reduce_ex__",
    "__getstate__",
    "__setstate__",
    "__new__",
    "__static_attributes__",
    "__firstlineno__",
    "_pybind11_conduit_v1_",
}


@dataclass
class Property:
    """A property, with the type of its reads and the type of its writes (None: read-only)."""

    name: str
    read: str
    written: str | None
    doc: str


@dataclass
class Attribute:
    """A value of a class or a module."""

    name: str
    value: Any


@dataclass
class Class:
    """A class with its members in the order of their definition."""

    name: str
    bases: list[str]
    doc: str
    members: list[Function | Property | Attribute] = field(default_factory=list)
    static: set[str] = field(default_factory=set)


@dataclass
class Module:
    """A module, with its content in the order of its definition."""

    name: str  # "" for the outermost module
    doc: str
    content: list[Class | Function | Attribute] = field(default_factory=list)
    submodules: list[str] = field(default_factory=list)

    def classes(self) -> Iterator[Class]:
        return (item for item in self.content if isinstance(item, Class))


def load(path: Path, package: str = "novaphy") -> types.ModuleType:
    """Load an extension module of a package without importing the package."""
    parent = types.ModuleType(package)
    parent.__path__ = [str(path.parent)]
    sys.modules[package] = parent
    name = f"{package}.{path.name.partition('.')[0]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"expected an extension module, got {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def read_modules(module: types.ModuleType) -> list[Module]:
    """Return a module and its submodules."""
    found = [read_module(module, "")]
    for name in found[0].submodules:
        found.append(read_module(getattr(module, name), name))
    return found


def read_module(module: types.ModuleType, name: str) -> Module:
    """Return the content of a module."""
    found = Module(name, (module.__doc__ or "").strip())
    for key, value in vars(module).items():
        if key.startswith("__"):
            continue
        if isinstance(value, types.ModuleType):
            found.submodules.append(key)
        elif isinstance(value, type):
            found.content.append(read_class(key, value))
        elif callable(value):
            found.content.append(parse_docstring(key, value.__doc__ or ""))
        else:
            found.content.append(Attribute(key, value))
    return found


def read_class(name: str, value: type) -> Class:
    """Return a class with the members that it defines itself."""
    if issubclass(value, enum.Enum):
        base = next(b for b in (enum.IntFlag, enum.IntEnum, enum.Enum) if issubclass(value, b))
        found = Class(name, [f"enum.{base.__name__}"], (value.__doc__ or "").strip())
        members = value.__members__.items()
        found.members = [Attribute(key, int(member)) for key, member in members]
        return found
    bases = [b.__name__ for b in value.__bases__ if not b.__name__.startswith("pybind11_")]
    found = Class(name, [b for b in bases if b != "object"], (value.__doc__ or "").strip())
    for key, member in vars(value).items():
        if key not in SKIPPED:
            read_member(found, key, member)
    return found


def read_member(owner: Class, key: str, member: Any) -> None:
    """Add one entry of a class's dictionary to the class."""
    if isinstance(member, property):
        owner.members.append(read_property(key, member))
        return
    if isinstance(member, staticmethod):
        owner.static.add(key)
        member = member.__func__
    if isinstance(member, type) or not callable(member):
        if not isinstance(member, types.GetSetDescriptorType):
            owner.members.append(Attribute(key, member))
        return
    if isinstance(member, types.WrapperDescriptorType):  # defined by Python itself
        if key == "__hash__":
            owner.members.append(parse_docstring(key, "__hash__(self) -> int\n\nThe hash."))
        return
    owner.members.append(parse_docstring(key, getattr(member, "__doc__", None) or ""))


def read_property(key: str, member: property) -> Property:
    """Return a property from the signatures of its getter and setter."""
    read = accessor(member.fget)
    getter = read.overloads[0].returns if read.overloads else ANYTHING
    setter = None
    if member.fset is not None:
        write = accessor(member.fset)
        setter = write.overloads[0].parameters[-1].type if write.overloads else ANYTHING
    return Property(key, getter, setter, (member.__doc__ or read.doc).strip())


def accessor(function: Any) -> Function:
    """Return the getter or setter of a property, whose signature has no name."""
    doc = (getattr(function, "__doc__", None) or "").lstrip()
    return parse_docstring("f", f"f{doc}" if doc.startswith("(") else doc)


__all__ = ["Attribute", "Class", "Module", "Property", "load", "read_modules", "stub_type"]
