"""The documentation is true: its Python runs, its C++ is built, links and lists are complete."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import novaphy

ROOT = Path(__file__).parents[2]
PAGES = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])
# "```python jax": a language, and a library that the block needs.
BLOCK = re.compile(r"^```(\w*)(?: (\w+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def blocks(page: Path, language: str, library: str = "") -> list[str]:
    """The code blocks of a language in a page: those that need no library, or only that one."""
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return [code for tag, needs, code in found if tag == language and needs in ("", library)]


def libraries(page: Path) -> list[str]:
    """The libraries that Python blocks of a page need."""
    found = BLOCK.findall(page.read_text(encoding="utf-8"))
    return sorted({needs for tag, needs, _ in found if tag == "python" and needs})


def name(page: Path) -> str:
    """The path of a page, for messages."""
    return page.relative_to(ROOT).as_posix()


def sources(*folders: str) -> list[Path]:
    """The C++ and Python sources under some folders."""
    suffixes = {".h", ".cpp", ".inc", ".py"}
    return [p for f in folders for p in sorted((ROOT / f).rglob("*")) if p.suffix in suffixes]


def run(page: Path, code_blocks: list[str]) -> None:
    """Run blocks one after the other, as one program."""
    namespace: dict[str, object] = {"__name__": "__page__"}
    for number, code in enumerate(code_blocks):
        exec(compile(code, f"{name(page)}, block {number}", "exec"), namespace)


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p, "python")], ids=name)
def test_the_python_of_a_page_runs_from_top_to_bottom(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("novaphy.diff")
    monkeypatch.chdir(tmp_path)
    try:
        run(page, blocks(page, "python"))
    except ImportError as error:
        if novaphy.has_io() or "NOVAPHY_WITH_IO" not in str(error):
            raise
        pytest.skip("the page reads meshes or robots, and this build has no reader of them")


@pytest.mark.parametrize(("page", "library"), [(p, lib) for p in PAGES for lib in libraries(p)])
def test_the_python_of_a_page_runs_with_a_library_that_it_speaks_of(
    page: Path, library: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("novaphy.diff")
    pytest.importorskip(library, reason=f"{library} is not installed")
    monkeypatch.chdir(tmp_path)
    run(page, blocks(page, "python", library))


@pytest.mark.parametrize(
    ("page", "consumer", "files"),
    [
        ("docs/guide/cpp-one-library.md", "collision", ["CMakeLists.txt", "main.cpp"]),
        ("docs/guide/own-kernel.md", "nova", ["main.cpp"]),
    ],
)
def test_the_cpp_of_a_guide_is_the_program_that_the_tests_build(
    page: str, consumer: str, files: list[str]
) -> None:
    text = (ROOT / page).read_text(encoding="utf-8")
    for file in files:
        code = (ROOT / "tests" / "install_consumer" / consumer / file).read_text(encoding="utf-8")
        assert code in text, f"{page} does not show {consumer}/{file} as it is"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_every_link_to_a_file_leads_somewhere(page: Path) -> None:
    for link in LINK.findall(page.read_text(encoding="utf-8")):
        if "://" in link or link.startswith("#"):
            continue
        assert (page.parent / link.split("#")[0]).exists(), f"{name(page)}: {link}"


def test_every_environment_variable_is_in_the_table() -> None:
    read = set()
    for path in sources(
        "core", "backends", "nova", "collision", "dynamics", "vbd", "diff", "python"
    ):
        text = path.read_text(encoding="utf-8")
        read |= set(re.findall(r'getenv\(\s*"(\w+)"', text))
        read |= set(re.findall(r'environ(?:\.get\(|\[)"(\w+)"', text))
    documented = set(
        re.findall(r"^\| `(NOVA\w+)`", (ROOT / "docs/environment.md").read_text(), re.MULTILINE)
    )
    assert {name for name in read if name.startswith("NOVA")} == documented


def test_every_operator_is_in_the_coverage_table() -> None:
    declared = set()
    for path in sources("collision/include", "dynamics/include", "diff/include"):
        declared |= set(re.findall(r"(\w+_generated)\(", path.read_text(encoding="utf-8")))
    covered = set(
        re.findall(r"^\| `(\w+_generated)`", (ROOT / "docs/coverage.md").read_text(), re.M)
    )
    assert declared == covered


def test_every_design_note_is_listed() -> None:
    folder = ROOT / "docs" / "design"
    notes = {p.name for p in folder.glob("0*.md")}
    assert notes == set(LINK.findall((folder / "README.md").read_text(encoding="utf-8")))


def test_every_page_is_listed_in_the_readme() -> None:
    linked = LINK.findall((ROOT / "README.md").read_text(encoding="utf-8"))
    listed = {link.split("#")[0] for link in linked}
    pages = {name(p) for f in ("docs", "docs/guide") for p in (ROOT / f).glob("*.md")}
    assert pages <= listed


def test_every_page_names_its_kind_below_its_title() -> None:
    kinds = {"*Tutorial*", "*How-to*", "*Reference*", "*Explanation*"}
    pages = [p for f in ("docs", "docs/guide") for p in sorted((ROOT / f).glob("*.md"))]
    named = [p for p in pages if not p.name.startswith(("performance", "gallery"))]
    assert len(named) > 30
    for page in named:
        assert page.read_text(encoding="utf-8").split("\n")[2] in kinds, name(page)


def test_the_terms_of_the_glossary_stand_there_once() -> None:
    text = (ROOT / "docs/glossary.md").read_text(encoding="utf-8")
    terms = [term.strip() for term in re.findall(r"^\| ([^|]+) \|", text, re.M)]
    terms = [term for row in terms if row != "Term" for term in row.split(", ")]
    assert len(terms) >= 40
    assert len(terms) == len(set(terms))


def test_the_gradient_of_the_readme_has_fifteen_lines_and_the_verdicts_that_it_names(
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("novaphy.diff")
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    (code,) = blocks(ROOT / "README.md", "python")
    assert sum(1 for line in code.splitlines() if line) == 15
    for mode, rate, verdict in (("auto", -0.88, "of the motion"), ("code", -7.78, "biased")):
        assert f"`{verdict}`" in text and str(rate) in text
        run(ROOT / "README.md", [code.replace('"auto"', f'"{mode}"')])
        printed = capsys.readouterr().out
        numbers = printed.splitlines()[0].strip("[]").split()
        np.testing.assert_allclose(np.float32(numbers), [0, -1.88, rate], rtol=0.01)
        assert printed.splitlines()[1].startswith(f"{verdict}: ")


def test_every_changelog_fragment_has_a_kind() -> None:
    kinds = {"added", "changed", "removed", "fixed"}
    for path in (ROOT / "changelog").glob("*.md"):
        assert path.name == "README.md" or path.name.split(".")[-2] in kinds, path.name


def test_the_guide_lists_the_libraries_that_are_installed() -> None:
    words = ["one", "two", "three", "four", "five", "six", "seven", "eight", "nine"]
    install = (ROOT / "cmake/NovaPhyInstall.cmake").read_text(encoding="utf-8")
    components = re.search(r"NOVAPHY_KNOWN_COMPONENTS (.*)\)", install)[1].split()
    guide = (ROOT / "docs/guide/cpp-one-library.md").read_text(encoding="utf-8")
    assert f"NovaPhy is {words[len(components) - 1]} shared libraries" in guide
    rows = dict(re.findall(r"^\| `(\w+)` \| `novaphy::\w+` \|(.*)\|$", guide, re.MULTILINE))
    assert sorted(rows) == sorted(components)
    for component in components:
        needs = re.search(rf"set\(dependencies_{component} ?(.*)\)", install)[1].split()
        assert all(need in rows[component] for need in needs), component


def test_the_guide_lists_the_options_of_the_build() -> None:
    options = (ROOT / "cmake/NovaPhyOptions.cmake").read_text(encoding="utf-8")
    guide = (ROOT / "docs/guide/cpp-one-library.md").read_text(encoding="utf-8")
    defined = re.findall(r"^option\((NOVA\w+) |^set\((NOVA\w+) .* CACHE ", options, re.M)
    missing = [one or other for one, other in defined if f"`{one or other}`" not in guide]
    assert defined and not missing


def test_the_guide_has_the_defaults_of_the_options() -> None:
    options = (ROOT / "cmake/NovaPhyOptions.cmake").read_text(encoding="utf-8")
    guide = (ROOT / "docs/guide/cpp-one-library.md").read_text(encoding="utf-8")
    defaults = dict(re.findall(r'^option\((NOVA\w+) ".*" (ON|OFF)\)', options, re.M))
    seen = 0
    for cells, default in re.findall(r"^\| (`NOVA[^|]*) \| ([^|]*) \|", guide, re.M):
        names, values = re.findall(r"NOVA\w+", cells), re.findall(r"\b(ON|OFF)\b", default)
        if " with " in default:  # depends on another option
            continue
        for option, value in zip(names, values * len(names), strict=False):
            assert defaults.get(option, value) == value, option
            seen += option in defaults
    assert seen >= 10


def test_the_presets_are_in_the_table_and_pages_name_no_other() -> None:
    presets = json.loads((ROOT / "CMakePresets.json").read_text(encoding="utf-8"))
    made = {p["name"]: p for p in presets["configurePresets"] if not p.get("hidden")}
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    table = page.split("| Preset | Build |\n|---|---|\n")[1].split("\n\n")[0]
    rows = dict(re.findall(r"^\| `([\w-]+)` \| (.*) \|$", table, re.M))
    assert rows == {name: preset["displayName"] for name, preset in made.items()}
    for path in PAGES:
        named = set(re.findall(r"--preset ([a-z][\w-]*)", path.read_text(encoding="utf-8")))
        assert named <= set(made), name(path)


def test_the_page_for_backends_names_the_version_of_the_abi() -> None:
    header = (ROOT / "backends/abi/include/novaphy/abi/backend.h").read_text(encoding="utf-8")
    major = re.search(r"NOVAPHY_ABI_MAJOR (\d+)u", header)[1]
    pages = [ROOT / "docs/backend-authors.md", ROOT / "docs/design/0004-backend-abi.md"]
    for page in pages:
        named = re.findall(r"major version is (\d+)", page.read_text(encoding="utf-8"))
        assert set(named) <= {major}, name(page)
    assert f"major version is {major}" in pages[0].read_text(encoding="utf-8")


def test_what_the_pipeline_says_of_meshes_is_so() -> None:
    square = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    builder = novaphy.ModelBuilder()
    weightless = novaphy.ShapeConfig(density=0.0)
    builder.add_shape_mesh(-1, vertices=square, indices=[0, 1, 2, 0, 2, 3], cfg=weightless)
    body = builder.add_body(xform=((0, 0, 0.05), (0, 0, 0, 1)), mass=1.0, inertia=np.eye(3))
    builder.add_shape_mesh(body, vertices=square, indices=[0, 1, 2, 0, 2, 3], cfg=weightless)
    model = builder.finalize()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    assert contacts.active_rigid_contact_count > 0
    assert "also meet meshes" in " ".join(novaphy.CollisionPipeline.__doc__.split())


def test_poses_of_joints_have_no_gradient_as_the_guide_says() -> None:
    nova = pytest.importorskip("novaphy.nova")
    builder = novaphy.ModelBuilder()
    body = builder.add_link(mass=1.0, inertia=np.eye(3))
    builder.add_articulation([builder.add_joint_revolute(-1, body, axis=(1, 0, 0))])
    model = builder.finalize()
    state = model.state()
    guide = (ROOT / "docs/guide/joints.md").read_text(encoding="utf-8")
    assert "which a capture records" in guide
    assert "on a tape they raise for values that carry one" in guide
    now, replayed = model.state(), model.state()
    with nova.ScopedCapture() as capture:
        novaphy.eval_fk(model, replayed.joint_q, replayed.joint_qd, replayed)
    for at in (now, replayed):
        at.joint_q.assign(np.float32([0.5]))
    capture.graph.launch()
    novaphy.eval_fk(model, now.joint_q, now.joint_qd, now)
    np.testing.assert_array_equal(replayed.body_q.numpy(), now.body_q.numpy())
    assert replayed.body_q.numpy()[0, 3] != 0

    diff = novaphy.diff
    _ = diff.state_joint_qd_tensor(state, requires_grad=True)
    _ = diff.state_body_qd_tensor(state, requires_grad=True)
    for function in (
        lambda: novaphy.eval_fk(model, state.joint_q, state.joint_qd, state),
        lambda: novaphy.eval_ik(model, state, state.joint_q, state.joint_qd),
    ):
        with (
            nova.Tape(),
            pytest.raises(novaphy.Error, match="carries a gradient"),
        ):
            function()
