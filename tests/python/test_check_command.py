"""`novaphy check FILE.py:FUNCTION`: exit codes, the table, the picture, and errors in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

import novaphy
from novaphy import _command

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

FILE = """
from novaphy import nova

theta0, sigma = [1.0, -2.0], 0.1


def bowl(theta):
    return nova.sum(theta * theta, axis=-1)


def half(theta):
    return nova.sum(theta * theta.detach(), axis=-1)


def one(theta):
    return nova.sum(theta * theta)


def broken(theta):
    return nothing
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "throw.py"
    path.write_text(FILE, "utf-8")
    return path


def test_the_exit_code_is_the_verdict(file, tmp_path, capsys) -> None:
    page = tmp_path / "bowl.html"
    assert _command.main(["check", f"{file}:bowl", "--worlds", "32", "--record", str(page)]) == 0
    said = capsys.readouterr()
    assert said.out.startswith("of the motion: ") and "32 at a quarter" in said.out
    assert page.read_text("utf-8").startswith("<!DOCTYPE html>") and said.err == ""
    assert _command.main(["check", f"{file}:half", "--seed", "3"]) == 1
    assert capsys.readouterr().out.startswith("biased: ")


@pytest.mark.parametrize(
    ("word", "options", "message"),
    [
        (":one", [], "certify, f: expected losses {16}"),
        (":none", [], "check: expected 'none' in "),
        ("", [], "check: expected FILE.py:FUNCTION, got "),
        (":bowl", ["--worlds", "5"], "certify, worlds: expected an even number"),
        (":bowl", ["--record", "x.pdf"], "path: expected .html or .png"),
    ],
)
def test_an_error_is_one_line_and_the_code_2(file, word, options, message, capsys) -> None:
    assert _command.main(["check", f"{file}{word}", *options]) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: ") and message in said and said.count("\n") == 1


def test_files_that_are_missing_or_broken_have_the_code_2(file, tmp_path, capsys) -> None:
    assert _command.main(["check", f"{tmp_path}/none.py:f"]) == 2
    assert "check: expected a file" in capsys.readouterr().err
    assert _command.main(["check", f"{file}:broken"]) == 2
    assert "NameError" in capsys.readouterr().err
    other = tmp_path / "other.py"
    other.write_text("def f(theta):\n    return theta\n", "utf-8")
    assert _command.main(["check", f"{other}:f"]) == 2
    assert "expected 'theta0' in " in capsys.readouterr().err
