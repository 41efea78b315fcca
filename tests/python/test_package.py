"""The package: its names, what it imports, its stubs, and a build without the tensor runtime."""

from __future__ import annotations

import ast
import importlib
import importlib.util
import inspect
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import novaphy
from novaphy import _core
from novaphy._planned import PLANNED
from novaphy.testing import assert_allclose, assert_same_bits, assert_same_state

PACKAGE = Path(novaphy.__file__).parent
NEED_IO = ("ModelBuilder.add_urdf", "ModelBuilder.add_mjcf")  # without io they take anything
SUBPACKAGES = ("assets", "diff", "io", "nova", "solvers", "testing", "viewer")


def run(code: str) -> str:
    """The output of Python code in a process of its own."""
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.strip()


def test_differentiable_solvers_are_reached_through_solvers_only():
    for name in ("DiffSemiImplicitSolver", "DiffSolverConfig", "SolverSemiImplicit"):
        assert name not in dir(novaphy)
        with pytest.raises(NotImplementedError, match=rf"use novaphy\.solvers\.{name}"):
            getattr(novaphy, name)
        assert not hasattr(_core, name) and hasattr(novaphy.solvers, name)


@pytest.mark.parametrize("name", ["", *SUBPACKAGES])
def test_every_public_name_is_there_and_documented(name):
    module = importlib.import_module(f"novaphy.{name}".rstrip("."))
    assert module.__doc__ and sorted(set(module.__all__)) == sorted(module.__all__)
    for public in module.__all__:
        value = getattr(module, public)
        if inspect.isclass(value) or callable(value):
            assert value.__doc__, f"{module.__name__}.{public}"
    assert set(module.__all__) <= set(dir(module))


def test_every_native_function_is_documented():
    for module in (_core, _core.solvers, _core.nova, _core.diff, _core.io):
        for name, value in vars(module).items():
            if name.startswith("__") or inspect.ismodule(value):
                continue
            assert value.__doc__, f"{module.__name__}.{name}"
            if inspect.isclass(value):
                for member in vars(value):
                    if not member.startswith("_"):
                        assert getattr(value, member).__doc__, f"{name}.{member}"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="'novaphy' has no attribute 'nothing'"):
        _ = novaphy.nothing
    with pytest.raises(ImportError):
        from novaphy import nothing  # noqa: F401


@pytest.mark.parametrize("owner", PLANNED)
def test_a_planned_name_says_that_it_is_not_built(owner):
    asked = novaphy.ModelBuilder() if owner == "ModelBuilder" else importlib.import_module(owner)
    for name in (name for names in PLANNED[owner].values() for name in names):
        with pytest.raises(NotImplementedError, match=rf"{owner}\.{name} is not supported yet"):
            getattr(asked, name)
        assert name not in dir(asked), f"{name} is built: take it out of PLANNED"


def test_what_is_planned_can_be_asked_about():
    builder = novaphy.ModelBuilder()
    assert not hasattr(builder, "add_usd") and getattr(builder, "add_usd", None) is None
    with pytest.raises(AttributeError, match="'ModelBuilder' object has no attribute 'add_bodi'"):
        builder.add_bodi()
    with pytest.raises(NotImplementedError, match="SolverXPBD is not supported yet"):
        from novaphy.solvers import SolverXPBD  # noqa: F401


def test_import_is_lean():
    out = run(
        "import sys; before = set(sys.modules); import novaphy; novaphy.ModelBuilder().finalize(); "
        "print(*sorted(m.split('.')[0] for m in set(sys.modules) - before))"
    )
    loaded = set(out.split())
    assert "numpy" not in loaded and not loaded & {
        "matplotlib",
        "tqdm",
        "torch",
        "typing_extensions",
    }


def test_subpackages_come_when_they_are_used():
    assert run("import novaphy; print(novaphy.nova.tensor([1.0]).item())") == "1.0"
    assert run("import novaphy.diff; print(novaphy.diff.Trajectory.__name__)") == "Trajectory"
    assert run("from novaphy import ViewerNull; print(ViewerNull().num_frames)") == "1000"
    run("from novaphy import *; ModelBuilder, nova.Tape, create_viewer")


def test_a_build_without_the_tensor_runtime_says_so(tmp_path):
    for name in ("nova", "diff"):
        out = run(
            f"""
import novaphy
from novaphy import _core
_core.has_diff = lambda: False
try:
    import novaphy.{name}
except ImportError as error:
    print(error)
try:
    novaphy.solvers.DiffSemiImplicitSolver
except ImportError as error:
    print(error)
print(hasattr(novaphy.solvers, "SolverSemiImplicit"))
"""
        )
        lines = out.splitlines()
        assert "NOVAPHY_WITH_DIFF=ON" in lines[0] and "NOVAPHY_WITH_DIFF=ON" in lines[1]
        assert lines[2] == "True"


# ---------------------------------------------------------------------------- stubs


def stub_names(path: Path) -> dict[str, set[str]]:
    """The names of a stub file: "" for the module, class names for their members."""
    names: dict[str, set[str]] = {"": set()}

    def bound(node: ast.stmt) -> list[str]:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            return [node.name]
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            return [node.target.id]
        if isinstance(node, ast.Assign):
            return [t.id for t in node.targets if isinstance(t, ast.Name)]
        if isinstance(node, ast.ImportFrom):
            return [a.asname for a in node.names if a.asname == a.name]
        return []

    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        names[""].update(bound(node))
        if isinstance(node, ast.ClassDef):
            names[node.name] = {name for member in node.body for name in bound(member)}
            for base in node.bases:
                if isinstance(base, ast.Name) and base.id.startswith("_"):
                    names[node.name] |= names.get(base.id, set())
    return names


@pytest.mark.parametrize("name", ["", "nova", "diff", "solvers", "io"])
def test_the_stubs_name_what_is_there(name):
    module = getattr(_core, name) if name else _core
    stub = stub_names(PACKAGE / "_core" / f"{name or '__init__'}.pyi")
    public = {n for n in vars(module) if not n.startswith("_")}
    if name == "io" and not novaphy.has_io():  # classes that the readers of robots return
        stub[""] -= {n for n in stub[""] if n.startswith("Robot")}
    assert {n for n in stub[""] if not n.startswith("_")} == public
    for class_name in public:
        value = getattr(module, class_name)
        if not inspect.isclass(value) or class_name == "Error":
            continue
        members = {m for m in vars(value) if not m.startswith("_")}
        assert {m for m in stub[class_name] if not m.startswith("_")} == members, class_name


# A parameter: its name, its kind, and its default as the stub writes it (None: it has none).
Parameter = tuple[str, str, str | None]


def parameters_of(node: ast.FunctionDef) -> tuple[Parameter, ...]:
    """The parameters of one signature, without `self`."""
    args = node.args
    found: list[Parameter] = []
    positional = [(a, "only") for a in args.posonlyargs] + [(a, "any") for a in args.args]
    defaults = [None] * (len(positional) - len(args.defaults)) + list(args.defaults)
    for (arg, kind), default in zip(positional, defaults, strict=True):
        # An argument without a name can be given by position only.
        unnamed = arg.arg.startswith(("arg", "_")) and arg.arg.strip("_").removeprefix("arg") in (
            "",
            *"0123456789",
        )
        kind = "only" if unnamed or arg.arg.startswith("__") else kind
        name = "" if kind == "only" else arg.arg
        found.append((name, kind, None if default is None else ast.unparse(default)))
    if args.vararg:
        found.append(("*" + args.vararg.arg, "var", None))
    for arg, default in zip(args.kwonlyargs, args.kw_defaults, strict=True):
        found.append((arg.arg, "key", None if default is None else ast.unparse(default)))
    return tuple(p for p in found if p[0] != "self")


def binding_signatures(function: object) -> set[tuple[Parameter, ...]] | None:
    """Those that pybind11 wrote into a docstring; None where it wrote none."""
    function = getattr(function, "__func__", function)  # the function of a static method
    doc = getattr(function, "__doc__", None) or ""
    name = getattr(function, "__name__", "")
    lines = doc.splitlines()
    numbered = [re.sub(r"^\d+\. ", "", x) for x in lines if re.match(r"\d+\. " + name + r"\(", x)]
    texts = numbered or lines[:1]
    found = set()
    for text in texts:
        # Defaults that are objects are written as <...>.
        text = re.sub(r"= <[^>]*>+", "= ...", text)
        try:
            node = ast.parse(f"def {text}: ...").body[0]
        except SyntaxError:
            return None
        assert isinstance(node, ast.FunctionDef)
        found.add(parameters_of(node))
    return found


def stub_signatures(body: list[ast.stmt]) -> dict[str, set[tuple[Parameter, ...]]]:
    """The functions of a stub's module or class, with all their overloads."""
    found: dict[str, set[tuple[Parameter, ...]]] = {}
    for node in body:
        if isinstance(node, ast.FunctionDef) and not any(
            "property" in ast.unparse(d) or "setter" in ast.unparse(d) for d in node.decorator_list
        ):
            found.setdefault(node.name, set()).add(parameters_of(node))
    return found


def unlike(stub: set[tuple[Parameter, ...]], binding: set[tuple[Parameter, ...]]) -> str:
    """What differs between the overloads of a stub and of a binding; nothing: ""."""
    names = [{tuple((n, d is not None) for n, _, d in s) for s in side} for side in (stub, binding)]
    if names[0] != names[1]:
        return f"{sorted(names[0])} in the stub, {sorted(names[1])} in the module"
    values = [{n: d for s in side for n, _, d in s if d is not None} for side in (stub, binding)]
    for name, value in values[1].items():
        written = values[0][name]
        if "..." in (value, written):
            continue
        try:
            pair = [ast.literal_eval(text) for text in (value, written)]
        except ValueError:  # an enumerator
            continue
        if any(isinstance(x, float | tuple) for x in pair):  # the binding holds float32
            pair = [np.asarray(x, np.float32).tolist() for x in pair]
        if pair[0] != pair[1]:
            return f"{name} = {written} in the stub, {value} in the module"
    return ""


@pytest.mark.parametrize("name", ["", "nova", "diff", "solvers", "io"])
def test_the_stubs_have_the_signatures_of_the_bindings(name):
    module = getattr(_core, name) if name else _core
    tree = ast.parse((PACKAGE / "_core" / f"{name or '__init__'}.pyi").read_text(encoding="utf-8"))
    scopes = [("", module, tree.body)]
    scopes += [
        (node.name + ".", getattr(module, node.name), node.body)
        for node in tree.body
        if isinstance(node, ast.ClassDef) and hasattr(module, node.name)
    ]
    compared, problems = 0, []
    for prefix, owner, body in scopes:
        for function, stub in stub_signatures(body).items():
            if function.startswith("_") and function != "__init__":
                continue
            binding = binding_signatures(getattr(owner, function))
            if binding is None:
                continue
            if not novaphy.has_io() and f"{prefix}{function}" in NEED_IO:
                continue
            compared += 1
            if problem := unlike(stub, binding):
                problems.append(f"{prefix}{function}: {problem}")
    assert not problems, "\n".join(problems)
    assert compared > 0 or name == "io"


def test_the_package_says_that_it_is_typed():
    assert (PACKAGE / "py.typed").exists()


# ---------------------------------------------------------------------------- testing helpers


def test_same_bits_means_same_bits():
    nan = np.float32("nan")
    assert_same_bits(np.float32([1, nan]), np.float32([1, nan]))
    assert_same_bits(novaphy.DeviceArray([1.0]), np.float32([1.0]))
    for other in (
        np.float32([1, 0]),
        np.float32([1]),
        np.float64([1, 2]),
        np.nextafter(np.float32([1, 2]), 3, dtype=np.float32),
    ):
        with pytest.raises(AssertionError):
            assert_same_bits(np.float32([1, 2]), other)
    with pytest.raises(AssertionError, match=r"first at \(0,\)"):
        assert_same_bits(np.float32([0.0]), np.float32([-0.0]))
    assert_allclose([1.0], [1.0 + 1e-7])
    for other in ([1.1], [nan]):
        with pytest.raises(AssertionError):
            assert_allclose([1.0], other)
    builder = novaphy.ModelBuilder()
    builder.add_particle((0, 0, 0), (0, 0, 0), 1)
    model = builder.finalize()
    a, b = model.state(), model.state()
    assert_same_state(a, b)
    b.particle_qd.fill_(1.0)
    with pytest.raises(AssertionError, match="particle_qd"):
        assert_same_state(a, b)


def test_gradients_can_be_asserted():
    from novaphy import nova
    from novaphy.testing import assert_gradcheck

    x = nova.tensor([0.5, 1.0])
    assert_gradcheck(lambda t: nova.sum(nova.exp(t)), [x])
    with pytest.raises(AssertionError, match="gradcheck"):
        assert_gradcheck(lambda t: nova.sum(nova.abs(t - 0.5)), [x])


def test_a_library_of_another_build_is_refused_by_name_when_the_module_is_loaded(tmp_path):
    """It has another version of its symbols, as one that was built with other headers."""
    maps = Path("/proc/self/maps").read_text()
    library = Path(re.search(r"/\S*/libnovaphy_core\.so\S*", maps)[0]).read_bytes()
    name = re.search(rb"libnovaphy_core\.so[.\d]*", library)[0].decode()
    version = re.search(rb"NOVAPHY_\d+\.\d+\.\d+_[0-9a-f]{12}", library)[0]
    (tmp_path / name).write_bytes(library.replace(version, version[:-12] + b"0" * 12))
    loaded = subprocess.run(
        [sys.executable, "-c", "import novaphy"],
        env={**os.environ, "LD_LIBRARY_PATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=600,
    )
    assert loaded.returncode == 1
    needed = rf"{name}: version `{version.decode()}' not found \(required by /\S+\.so\S*\)"
    assert re.search(rf"ImportError: {tmp_path}/{needed}", loaded.stderr)
