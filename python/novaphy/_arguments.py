"""Error messages about arguments of native functions: argument name, expected and given type.

A TypeError of pybind11 lists the signatures of the function. This module parses the signatures and
compares them with the call.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from . import _core
from ._argument_names import ARGUMENTS

_INT32 = range(-(2**31), 2**31)
_OURS = "novaphy._core."
_OPENING, _CLOSING = "([{<", ")]}>"


def _is_integer(value: Any) -> bool:
    return hasattr(value, "__index__") or (hasattr(value, "__int__") and type(value) is not float)


def _is_number(value: Any) -> bool:
    return hasattr(value, "__float__") or hasattr(value, "__index__")


# Type annotation of pybind11 -> (name of the type in messages, test whether a value fits).
_KINDS: dict[str, tuple[str, Callable[[Any], bool]]] = {
    "typing.SupportsInt | typing.SupportsIndex": ("an integer", _is_integer),
    "int": ("an integer", _is_integer),
    "typing.SupportsFloat | typing.SupportsIndex": ("a number", _is_number),
    "float": ("a number", _is_number),
    "bool": ("True or False", lambda value: value is None or hasattr(value, "__bool__")),
    "str": ("a string", lambda value: isinstance(value, str | bytes)),
    "collections.abc.Callable": ("a function", callable),
}


@dataclass
class _Parameter:
    name: str
    annotation: str
    has_default: bool
    keyword_only: bool


@dataclass
class _Complaint:
    place: int  # number of parameters that fit before the fault
    text: str  # the fault of the call, or the expected type of the argument
    argument: str = ""
    value: Any = None


def explain(label: str, message: str, args: Sequence[Any], kwargs: dict[str, Any]) -> str:
    """Explain what is wrong with a call, or return pybind11's message if the reason is not found.

    Args:
        label: the function's public name without the package, as "diff.Trajectory".
        message: pybind11's message, with one signature per overload.
        args: the positional arguments, including the object of a method.
        kwargs: the keyword arguments.
    """
    if message.startswith("__init__()"):
        args = args[1:]
    complaints = []
    for signature in re.findall(r"^    \d+\. (.*)$", message, re.MULTILINE):
        complaint = _complaint(_parameters(signature), args, kwargs)
        if complaint is None:
            return message
        complaints.append(complaint)
    if not complaints:
        return message
    # The caller most likely means the overload whose fault comes last, so only it is explained.
    furthest = max(complaint.place for complaint in complaints)
    meant = [complaint for complaint in complaints if complaint.place == furthest]
    first = meant[0]
    if not first.argument:
        return f"{label}: {first.text}"
    expected = " or ".join(dict.fromkeys(c.text for c in meant if c.argument == first.argument))
    is_setter = re.fullmatch(r"arg\d+", first.argument) is not None
    place = label if is_setter else f"{label}, {first.argument}"
    return f"{place}: expected {expected}, got {_shown(first.value)}"


def _complaint(
    parameters: list[_Parameter], args: Sequence[Any], kwargs: dict[str, Any]
) -> _Complaint | None:
    """Return the first fault of a call against the parameters of one overload; None: no fault."""
    positional = [p for p in parameters if not p.keyword_only]
    if len(args) > len(positional):
        text = f"expected at most {len(positional)} positional arguments, got {len(args)}"
        return _Complaint(len(positional), text)
    given = {p.name: value for p, value in zip(positional, args, strict=False)}
    known = [p.name for p in parameters if p.name != "self"]
    for name in kwargs:
        if name not in known:
            hint = f"; use {ARGUMENTS[name]}" if name in ARGUMENTS else ""
            return _Complaint(
                0, f"no argument is called {name!r}{hint}; expected {', '.join(known)}"
            )
        if name in given:
            return _Complaint(0, f"argument {name!r} was given twice")
    given |= kwargs
    none_given: _Complaint | None = (
        None  # arguments of NovaPhy's classes accept None, although the signature does not say so
    )
    for place, parameter in enumerate(parameters):
        if parameter.name not in given:
            if not parameter.has_default:
                return _Complaint(place, f"argument {parameter.name!r} is missing")
            continue
        value = given[parameter.name]
        expected = _mismatch(parameter.annotation, value)
        if expected is None:
            continue
        complaint = _Complaint(place, expected, parameter.name, value)
        if value is not None or not parameter.annotation.startswith(_OURS):
            return complaint
        none_given = none_given or complaint
    return none_given


def _mismatch(annotation: str, value: Any) -> str | None:
    """Return the expected type if a value does not fit. None: it fits, or the type is unknown."""
    annotation, optional = re.subn(r" \| None$", "", annotation)
    if optional and value is None:
        return None
    if many := re.fullmatch(r"collections\.abc\.Sequence\[(.*)\]", annotation):
        if not isinstance(value, Sequence):
            return "a sequence"
        wrong = [_mismatch(many[1], each) for each in value]
        return next((f"a sequence with {each} in each place" for each in wrong if each), None)
    # pybind11 writes the C++ name of a class that was bound after the function.
    annotation = annotation.replace("novaphy::", _OURS)
    if annotation.startswith(_OURS):
        path = annotation.removeprefix(_OURS)
        cls: Any = _core
        for name in path.split("."):
            cls = getattr(cls, name)
        return None if isinstance(value, cls) else f"a novaphy.{path}"
    if annotation not in _KINDS:
        return None
    text, fits = _KINDS[annotation]
    if not fits(value):
        return text
    if text == "an integer" and int(value) not in _INT32:
        return "an int32"
    return None


def _parameters(signature: str) -> list[_Parameter]:
    """Parse a signature such as "(a: int, *, b: str = 'x') -> None"; brackets may nest."""
    start = signature.index("(") + 1
    parts, depth, begin, quote = [], 0, start, ""
    for k, letter in enumerate(signature[start:], start):
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "'\"":
            quote = letter
        elif depth == 0 and letter in ",)":
            parts.append(signature[begin:k].strip())
            begin = k + 1
            if letter == ")":
                break
        elif letter in _OPENING:
            depth += 1
        elif letter in _CLOSING:
            depth -= 1
    parameters, keyword_only = [], False
    for part in parts:
        if part == "*":
            keyword_only = True
        elif part not in ("", "/") and not part.startswith("*"):
            declared, _, default = part.partition(" = ")
            name, _, annotation = declared.partition(": ")
            parameters.append(_Parameter(name, annotation, bool(default), keyword_only))
    return parameters


def _shown(value: Any) -> str:
    """Return a number as text, and the type of any other value."""
    if value is None or type(value) in (int, float):
        return repr(value)
    cls = type(value)
    name = cls.__qualname__ if cls.__module__ == "builtins" else f"{cls.__module__}.{cls.__name__}"
    return name.replace("novaphy._core", "novaphy")
