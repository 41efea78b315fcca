"""Parse the signatures that pybind11 writes into docstrings, with the types of a stub."""

from __future__ import annotations

import ast
import re
import struct
from dataclasses import dataclass, field

ANYTHING = "Any"
# Types of pure numbers: in pybind11 3, and for arguments in pybind11 2.
FLOATS = {"typing.SupportsFloat", "float"}
INTEGERS = {"typing.SupportsInt", "typing.SupportsIndex", "int"}
PLAIN = {
    "object": ANYTHING,
    "typing.Any": ANYTHING,
    "dict": "dict[str, Any]",
    "list": "list[Any]",
    "set": "set[Any]",
    "tuple": "tuple[Any, ...]",
    "collections.abc.Iterable": "Iterable[Any]",
    "collections.abc.Iterator": "Iterator[Any]",
    "typing.Iterator": "Iterator[Any]",
    "typing.Iterable": "Iterable[Any]",
    "collections.abc.Sequence": "Sequence[Any]",
    "numpy.ndarray": "NDArray[Any]",
    "Buffer": "NDArray[Any]",
    "buffer": "NDArray[Any]",
    "collections.abc.Callable": "Callable[..., Any]",
    "typing.Callable": "Callable[..., Any]",
}


@dataclass
class Parameter:
    """An argument. Its kind is `only` (positional only), `any`, `key`, `args` or `kwargs`."""

    name: str
    kind: str
    type: str
    default: str | None = None


@dataclass
class Signature:
    """The arguments of a function, without `self`, and the type of its result."""

    parameters: list[Parameter]
    returns: str
    has_self: bool = False


@dataclass
class Function:
    """A function with all of its overloads and their documentation."""

    name: str
    overloads: list[Signature] = field(default_factory=list)
    doc: str = ""


def shortest(value: float) -> str:
    """Return the shortest text that gives the same float32 value."""
    try:
        bits = struct.pack("<f", value)
    except OverflowError:  # outside of the range of float32
        return repr(value)
    if struct.unpack("<f", bits)[0] != value:  # not a float32 value
        return repr(value)
    for digits in range(1, 10):
        text = f"{value:.{digits}g}"
        if struct.pack("<f", float(text)) == bits:
            return repr(float(text))
    return repr(value)


def default_text(node: ast.expr) -> str:
    """Return a default value as a stub writes it, or `...` for a value that is not a literal."""
    if isinstance(node, ast.Tuple | ast.List):
        parts = [default_text(item) for item in node.elts]
        if any(part == "..." for part in parts):
            return "..."
        # All calls would share a list. The types also accept a tuple.
        return f"({', '.join(parts)}{',' if len(parts) == 1 else ''})"
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        inner = default_text(node.operand)
        return inner if inner == "..." else f"-{inner}"
    if not isinstance(node, ast.Constant) or node.value is ...:
        return "..."
    if isinstance(node.value, float):
        text = shortest(node.value)
        return "..." if text in ("inf", "nan") else text
    if isinstance(node.value, str):
        return '"' + node.value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    return repr(node.value)


def dotted(node: ast.expr) -> str:
    """Return `a.b.c` for a dotted name, else an empty text."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        left = dotted(node.value)
        return f"{left}.{node.attr}" if left else ""
    return ""


def union_members(node: ast.expr) -> list[ast.expr]:
    """Return the types that a union joins."""
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        return union_members(node.left) + union_members(node.right)
    if isinstance(node, ast.Subscript) and dotted(node.value) in ("typing.Union", "Union"):
        items = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return [member for item in items for member in union_members(item)]
    if isinstance(node, ast.Subscript) and dotted(node.value) in ("typing.Optional", "Optional"):
        return [*union_members(node.slice), ast.Constant(None)]
    return [node]


def join_types(types: list[str]) -> str:
    """Return the union of types without duplicates, with None last."""
    found = list(dict.fromkeys(part for text in types for part in split_union(text)))
    if ANYTHING in found:
        return ANYTHING
    if "SupportsFloat" in found:  # every integer is also a SupportsFloat
        found = [text for text in found if text != "SupportsIndex"]
    if "None" in found and len(found) > 1:
        found = [text for text in found if text != "None"] + ["None"]
    return " | ".join(found)


def split_union(text: str) -> list[str]:
    """Return the members of a union outside of brackets."""
    parts, depth, begin = [], 0, 0
    for place, letter in enumerate(text):
        depth += (letter in "[(") - (letter in "])")
        if letter == "|" and depth == 0:
            parts.append(text[begin:place].strip())
            begin = place + 1
    return [*parts, text[begin:].strip()]


def stub_type(node: ast.expr | None, argument: bool) -> str:
    """Return the type in a stub for a type that pybind11 wrote."""
    if node is None:
        return ANYTHING
    return join_types([_one_type(member, argument) for member in union_members(node)])


def _one_type(node: ast.expr, argument: bool) -> str:
    if isinstance(node, ast.Constant):
        return "None" if node.value is None else repr(node.value)
    if isinstance(node, ast.List):
        return f"[{', '.join(stub_type(item, argument) for item in node.elts)}]"
    if isinstance(node, ast.Subscript):
        return _subscript(node, argument)
    name = dotted(node)
    if name in FLOATS:
        return "SupportsFloat" if argument else "float"
    if name in INTEGERS:
        return "SupportsIndex" if argument else "int"
    if name in PLAIN:
        return PLAIN[name]
    if name.startswith("numpy."):
        return "np." + name.removeprefix("numpy.")
    if name.startswith("os."):
        return name
    return name.rpartition(".")[2] or ANYTHING


def _subscript(node: ast.Subscript, argument: bool) -> str:
    name = dotted(node.value)
    items = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if name in ("numpy.ndarray", "numpy.typing.NDArray"):
        scalar = dotted(items[-1])
        return f"NDArray[np.{scalar.removeprefix('numpy.')}]" if scalar else "NDArray[Any]"
    if name == "typing.Annotated":
        if dotted(items[0]).endswith("ArrayLike"):
            return "_Values"
        return stub_type(items[0], argument)
    if name.endswith("Literal"):
        return f"Literal[{', '.join(default_text(item) for item in items)}]"
    inner = [
        "..." if isinstance(i, ast.Constant) and i.value is ... else stub_type(i, argument)
        for i in items
    ]
    base = "os.PathLike" if name == "os.PathLike" else name.rpartition(".")[2]
    return f"{base}[{', '.join(inner)}]"


def parse_signature(text: str) -> Signature | None:
    """Parse a line `name(self: T, x: T = 0) -> T` of pybind11. Return None for another text."""
    text = re.sub(r"= <[^>]*>+", "= ...", text).replace("::", ".")
    try:
        node = ast.parse(f"def {text}: ...").body[0]
    except SyntaxError:
        return None
    if not isinstance(node, ast.FunctionDef):
        return None
    args = node.args
    found = []
    positional = [*args.posonlyargs, *args.args]
    defaults = [None] * (len(positional) - len(args.defaults)) + list(args.defaults)
    for arg, default in zip(positional, defaults, strict=True):
        unnamed = arg in args.posonlyargs or re.fullmatch(r"arg\d+", arg.arg)
        found.append(_parameter(arg, "only" if unnamed else "any", default))
    if args.vararg:
        found.append(_parameter(args.vararg, "args", None))
    for arg, default in zip(args.kwonlyargs, args.kw_defaults, strict=True):
        found.append(_parameter(arg, "key", default))
    if args.kwarg:
        found.append(_parameter(args.kwarg, "kwargs", None))
    has_self = bool(found) and found[0].name == "self"
    return Signature(found[has_self:], stub_type(node.returns, False), has_self)


def _parameter(arg: ast.arg, kind: str, default: ast.expr | None) -> Parameter:
    text = None if default is None else default_text(default)
    kind_type = stub_type(arg.annotation, True)
    if kind in ("args", "kwargs"):
        kind_type = "object"
    if text == "None" and kind_type != ANYTHING:
        kind_type = join_types([kind_type, "None"])
    return Parameter(arg.arg, kind, kind_type, text)


def parse_docstring(name: str, doc: str) -> Function:
    """Return the signatures and the documentation that pybind11 wrote for a function."""
    head, _, rest = doc.partition("\n")
    if rest.startswith("Overloaded function."):
        pieces = re.split(rf"^\d+\. (?={re.escape(name)}\()", rest, flags=re.MULTILINE)[1:]
    elif head.startswith(f"{name}("):
        pieces = [doc]
    else:
        return Function(name, [], doc.strip())
    found = Function(name)
    texts = []
    for piece in pieces:
        line, _, text = piece.partition("\n")
        if (signature := parse_signature(line.strip())) is not None:
            found.overloads.append(signature)
        texts.append(text.strip())
    found.doc = "\n\n".join(dict.fromkeys(text for text in texts if text))
    return found


def merge_overloads(overloads: list[Signature]) -> list[Signature]:
    """Merge overloads that differ only in the type of one argument."""
    found: list[Signature] = []
    for new in overloads:
        for old in found:
            if old.returns != new.returns or len(old.parameters) != len(new.parameters):
                continue
            pairs = list(zip(old.parameters, new.parameters, strict=True))
            if any((a.name, a.kind, a.default) != (b.name, b.kind, b.default) for a, b in pairs):
                continue
            unlike = [(a, b) for a, b in pairs if a.type != b.type]
            if len(unlike) <= 1:
                for a, b in unlike:
                    a.type = join_types([a.type, b.type])
                break
        else:
            found.append(new)
    return found
