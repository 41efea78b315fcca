"""The stubs of the native module: what make_stubs.py writes, and how it reads signatures."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path

import pytest

import novaphy

ROOT = Path(__file__).parents[2]
STUBS = Path(novaphy.__file__).parent / "_core"
FILES = ["__init__", "nova", "diff", "solvers", "io"]
sys.path.insert(0, str(ROOT / "tools" / "stubs"))

from make_stubs import ModuleWriter, Types, doc_lines  # noqa: E402
from native_module import Class, Module, Property  # noqa: E402
from signatures import merge_overloads, parse_docstring, parse_signature, shortest  # noqa: E402


def text_of(name: str) -> str:
    return (STUBS / f"{name}.pyi").read_text(encoding="utf-8")


def functions(name: str) -> dict[str, list[ast.FunctionDef]]:
    """The functions of a stub with all their overloads, without setters."""
    found: dict[str, list[ast.FunctionDef]] = {}
    tree = ast.parse(text_of(name))
    for scope in [tree, *[n for n in tree.body if isinstance(n, ast.ClassDef)]]:
        for node in scope.body:
            if isinstance(node, ast.FunctionDef) and not any(
                ast.unparse(d).endswith(".setter") for d in node.decorator_list
            ):
                found.setdefault(f"{getattr(scope, 'name', '')}.{node.name}", []).append(node)
    return found


@pytest.mark.parametrize("name", FILES)
def test_every_native_function_has_its_docstring(name):
    missing = [
        key
        for key, nodes in functions(name).items()
        if not key.rpartition(".")[2].startswith("_") and not any(map(ast.get_docstring, nodes))
    ]
    assert not missing
    assert len(functions(name)) > (0 if novaphy.has_io() or name != "io" else -1)


def test_a_docstring_is_that_of_the_module():
    nodes = functions("__init__")["ModelBuilder.add_spring"]
    written = " ".join(ast.get_docstring(nodes[0]).split())
    assert written in " ".join(novaphy.ModelBuilder.add_spring.__doc__.split())


@pytest.mark.parametrize("name", FILES)
def test_lines_are_short_and_numbers_are_those_of_the_source(name):
    text = text_of(name)
    assert max(map(len, text.splitlines())) <= 200
    assert not re.findall(r"= -?\d+\.\d{8,}", text)  # 0.05000000074505806
    assert "SupportsFloat | SupportsIndex" not in text and "typing.Supports" not in text
    assert "novaphy._core." not in text.partition("\n")[2]


@pytest.mark.parametrize("name", FILES)
def test_every_signature_was_understood(name):
    unknown = [
        key
        for key, nodes in functions(name).items()
        if ast.unparse(nodes[0].args) in ("*args: Any, **kwargs: Any", "self, *args: Any")
    ]
    assert not unknown or not novaphy.has_io()


def test_a_field_is_assigned_values_and_read_as_an_array():
    text = text_of("__init__")
    assert re.search(r"^    particle_q: _Field\n    \"\"\"vec3 \{particle_count\}", text, re.M)
    assert re.search(r"^    density: float$", text, re.M)


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        (  # pybind11 3
            "f(self: novaphy._core.A, n: typing.SupportsInt | typing.SupportsIndex, "
            "x: typing.SupportsFloat | typing.SupportsIndex = 0.05000000074505806) -> float",
            [("n", "SupportsIndex", None), ("x", "SupportsFloat", "0.05")],
        ),
        (  # pybind11 2
            "f(self: novaphy._core.A, n: int, x: float = 0.05000000074505806) -> float",
            [("n", "SupportsIndex", None), ("x", "SupportsFloat", "0.05")],
        ),
        (
            "f(a: Optional[float] = None, b: numpy.ndarray[numpy.float32] = <x.Y object>) -> None",
            [("a", "SupportsFloat | None", "None"), ("b", "NDArray[np.float32]", "...")],
        ),
        (
            "f(a: novaphy._core.nova.Tensor = None, b: list[float] = [1.0]) -> nova::Bool",
            [("a", "Tensor | None", "None"), ("b", "list[SupportsFloat]", "(1.0,)")],
        ),
        ("f(e: object = <E.A: 4>, s: str = 'a\"b') -> tuple",
         [("e", "Any", "..."), ("s", "str", '"a\\"b"')]),
    ],
)  # fmt: skip
def test_a_signature_of_a_binding_is_read(line, expected):
    signature = parse_signature(line)
    assert signature is not None
    assert [(p.name, p.type, p.default) for p in signature.parameters] == expected


def test_what_is_no_signature_has_none():
    assert parse_signature("Returns a < b.") is None
    found = parse_docstring("step", "Advances the state.")
    assert found.overloads == [] and found.doc == "Advances the state."


def test_overloads_that_differ_in_one_type_become_one():
    doc = (
        "__add__(*args, **kwargs)\nOverloaded function.\n\n"
        "1. __add__(self: m.T, arg0: m.T) -> m.T\n\nThe sum.\n\n"
        "2. __add__(self: m.T, arg0: float) -> m.T\n\n"
        "3. __add__(self: m.T, arg0: m.T) -> m.U\n"
    )
    found = parse_docstring("__add__", doc)
    merged = merge_overloads(found.overloads)
    assert found.doc == "The sum."
    assert [(s.parameters[0].type, s.returns) for s in merged] == [
        ("T | SupportsFloat", "T"),
        ("T", "U"),
    ]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.05000000074505806, "0.05"),
        (9.999999974752427e-07, "1e-06"),
        (0.1, "0.1"),
        (1e300, "1e+300"),
        (16777216.0, "16777216.0"),
        (1.0000001192092896, "1.0000001"),
    ],
)
def test_a_number_is_the_shortest_of_its_float32(value, text):
    assert shortest(value) == text


def test_a_member_that_hides_a_class_does_not_change_a_type():
    types = Types(ROOT / "tools" / "stubs" / "types.toml")
    classes = [
        Class("dtype", [], ""),
        Class("A", [], "", [Property("dtype", "dtype", None, "The type.")]),
    ]
    homes = {"dtype": "", "A": ""}
    text = ModuleWriter(Module("", "", classes), types, homes).write()
    assert "    def dtype(self) -> _dtype:" in text
    assert "_dtype: TypeAlias = dtype" in text
    # A build without the tensor runtime has no Tensor.
    assert "_Values: TypeAlias = Any | Any | NDArray" in text and "Tensor" not in text
    ast.parse(text)


def test_a_docstring_with_quotes_and_long_lines_stays_a_docstring():
    doc = 'Takes "a\\b" or """c"""' + " word" * 60 + '\n\nends in a "'
    lines = doc_lines(doc, "    ")
    node = ast.parse("def f():\n" + "\n".join(lines)).body[0]
    assert ast.get_docstring(node).split() == doc.split()
    assert max(map(len, lines)) <= 120
