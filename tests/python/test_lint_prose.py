"""The lint of prose counts what docs/style.md forbids, and its numbers may only shrink."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
LINT = ROOT / "tools" / "lint" / "check_prose.py"

LONG = "The solver " + "adds one more word and " * 6 + "ends here."  # 34 words
PAGE = f"""\
# Of headings nothing is said

{LONG} Of the bodies: their mass. What is a body?

```python
# Of code nothing is said
```

- It stands in a list. `solver.step(a, b, c)` is one word.

| That of a cell | a joint moves |
|---|---|
"""
HEADER = """\
// Of the force: a law.
//     What stands deeper is a formula, and is left out of the count of the words
#pragma once
// Of comments behind the head nothing is said.
"""
BINDING = """\
module.def("f", &f, "Of a body. "
           "Returns its mass.");  // Of a comment
fail("Of that");
"""
DOCSTRING = 'def f():\n    """Return the mass.\n\n    They add up.\n    """\n'


def tree(tmp_path: Path) -> Path:
    """A tree with a page, a header, a binding and a Python file."""
    files = {
        "README.md": PAGE,
        "vbd/include/law.h": HEADER,
        "python/src/bind.cpp": BINDING,
        "python/novaphy/mass.py": DOCSTRING,
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "tools" / "lint").mkdir(parents=True)
    return tmp_path


def lint(root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(LINT), *options, str(root)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_sentences_of_every_kind_of_text_are_counted(tmp_path):
    root = tree(tmp_path)
    assert lint(root, "--write").stdout == "check_prose: 0 entries written\n" + (
        "check_prose: 4 files, 0 faults\n"
    )
    assert (root / "tools/lint/prose.txt").read_text().split("\n\n")[1:] == [
        "[sentences over 30 words]\n1 README.md",
        "[forbidden openings]\n3 README.md\n1 python/novaphy/mass.py\n1 python/src/bind.cpp\n"
        "1 vbd/include/law.h",
        "[paragraphs over 90 words]\n",
    ]


def test_the_figures_have_a_line_for_each_group(tmp_path):
    figures = lint(tree(tmp_path)).stdout.splitlines()
    readme = next(line for line in figures if line.startswith("README")).split()
    # files, sentences of at least four words, their mean, long ones, share, openings, paragraphs
    mean = (34 + 5 + 4 + 5 + 4 + 4) / 6
    assert readme == ["README", "1", "6", f"{mean:.1f}", "1", "16.7%", "3", "0"]


def test_a_new_fault_fails_and_a_mended_one_is_written(tmp_path):
    root = tree(tmp_path)
    lint(root, "--write")
    page = root / "README.md"
    page.write_text(PAGE + "\nOf the joints: none.\n")
    result = lint(root, "--check")
    assert result.returncode == 1
    assert "worse: forbidden openings: README.md: 4, was 3\n" in result.stdout
    page.write_text(PAGE.replace("Of the bodies: their mass.", "A body has a mass."))
    result = lint(root, "--check")
    assert result.returncode == 0
    assert "better: forbidden openings: README.md: 2, was 3\n" in result.stdout
    lint(root, "--write")
    assert "2 README.md\n" in (root / "tools/lint/prose.txt").read_text()
