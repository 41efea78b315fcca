"""The lists of faults in the sources may only shrink."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINT = ROOT / "tools" / "lint" / "measure_house.py"

# Each line names what the lint counts in it.
SOURCE = """\
namespace novaphy {
NOVAPHY_ROW_KERNEL(scale, kScaleWords, Scale) { a.y[row] = '{'; }  // a.launch({
Launcher::Launcher(int n = {}) : launched_{n}, text_("if (launched_)") {
%s}
}  // namespace novaphy
"""
LISTS = """\
[functions over 60 lines]
%d vbd/step.cpp Launcher
[kernels with counted words]
1 vbd/step.cpp
[branches by host or device]
1 vbd/step.cpp
"""


def house(tmp_path: Path, lines: int, listed: int) -> Path:
    """A tree with one source, whose constructor has so many lines, and its lists."""
    (tmp_path / "vbd").mkdir()
    (tmp_path / "tools" / "lint").mkdir(parents=True)
    (tmp_path / "vbd" / "step.cpp").write_text(SOURCE % ("  step();\n" * (lines - 2)))
    (tmp_path / "tools" / "lint" / "house.txt").write_text(LISTS % listed)
    return tmp_path


def lint(root: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(LINT), *options, str(root)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_the_same_numbers_pass(tmp_path):
    result = lint(house(tmp_path, lines=70, listed=70), "--check")
    assert result.returncode == 0, result.stdout
    assert result.stdout == "measure_house: 1 files, 0 faults\n"


def test_a_higher_number_and_a_new_entry_fail_with_their_names(tmp_path):
    root = house(tmp_path, lines=71, listed=70)
    (root / "vbd" / "more.cpp").write_text("bool f() { return x.is_cpu(); }\n")
    result = lint(root, "--check")
    assert result.returncode == 1
    assert "worse: functions over 60 lines: vbd/step.cpp Launcher: 71, was 70\n" in result.stdout
    assert "worse: branches by host or device: vbd/more.cpp: 1, is new\n" in result.stdout
    assert result.stdout.count("worse:") == 2


@pytest.mark.parametrize(("lines", "kept"), [(65, "65 vbd/step.cpp Launcher\n"), (60, "")])
def test_a_lower_number_is_written_when_asked(tmp_path, lines, kept):
    root = house(tmp_path, lines=lines, listed=70)
    asked = lint(root, "--check")
    assert asked.returncode == 0
    assert "better: functions over 60 lines: vbd/step.cpp Launcher" in asked.stdout
    assert "measure_house.py --write" in asked.stdout
    assert lint(root, "--write").returncode == 0
    written = (root / "tools" / "lint" / "house.txt").read_text()
    assert f"[functions over 60 lines]\n{kept}\n[files over 400 lines]\n" in written
    assert "better" not in lint(root, "--check").stdout


def test_lists_begin_with_what_there_is(tmp_path):
    root = house(tmp_path, lines=80, listed=70)
    (root / "tools" / "lint" / "house.txt").unlink()
    assert lint(root, "--write").returncode == 0
    assert "80 vbd/step.cpp Launcher\n" in (root / "tools" / "lint" / "house.txt").read_text()
    assert lint(root, "--check").stdout == "measure_house: 1 files, 0 faults\n"


def test_a_higher_number_is_never_written(tmp_path):
    root = house(tmp_path, lines=80, listed=70)
    assert lint(root, "--write").returncode == 1
    assert "70 vbd/step.cpp Launcher\n" in (root / "tools" / "lint" / "house.txt").read_text()
