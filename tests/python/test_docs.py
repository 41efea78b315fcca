"""The documentation is true: its Python runs, its C++ is built, links and lists are complete."""

from __future__ import annotations

import re
from pathlib import Path

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


def test_every_changelog_fragment_has_a_kind() -> None:
    kinds = {"added", "changed", "removed", "fixed"}
    for path in (ROOT / "changelog").glob("*.md"):
        assert path.name == "README.md" or path.name.split(".")[-2] in kinds, path.name
