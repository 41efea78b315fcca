"""Every command that a demo's text names, as it stands there: without a window, and in one."""

from __future__ import annotations

import ast
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import x_server

import novaphy

DEMOS = Path(__file__).parents[2] / "python" / "demos" / "diff"
ACTORS = DEMOS.parent / "data" / "ant" / "rl_policies"
# The input files of the commands, by the name in the command.
FILES = {
    "gait.npz": ACTORS / "periodic_ant_natural_gait.npz",
    "tuned.npz": ACTORS / "ant_walker.npz",
}
LIMIT = 150  # s, for each, on a machine that does much else; alone most take a few
CLOSED_AFTER = 30  # frames in a window


def commands(name: str) -> list[tuple[str, str]]:
    """The commands in the text of a demo."""
    file = f"demo_diffsim_{name}.py"
    lines = ast.get_docstring(ast.parse((DEMOS / file).read_text("utf-8"))).splitlines()
    starts = f"    python {file}"
    found = [line.removeprefix(starts) for line in lines if line.startswith(starts)]
    return [(name, line.partition("#")[0].strip()) for line in found]


def shortened(name: str, words: list[str]) -> list[str]:
    """The words, and what makes the command short: the last of two flags wins."""
    if name == "ant_from_scratch":
        fewer = ["--robustness", "3"] if "--robustness" in words else []
        fewer += ["--headless", "60"] if "--headless" in words else []
        if not {"--load", "--stages", "--random-search"} & set(words):
            fewer += ["--stages", "stand,4,24,400,polish"]
        return [*words, "--seconds", "4", *fewer]
    fewer = ["--train", "1", "--train-horizon", "20", "--starts", "8"]
    return [*words, *fewer] if "--adapt" in words else words


NAMES = ("ant_walk", "ant_from_scratch", "franka_push_box")
COMMANDS = [command for name in NAMES for command in commands(name)]
# Closes the window after CLOSED_AFTER frames, and says how many were seen in it.
WINDOW = """
import pathlib, sys
from novaphy._command import start_demo
from novaphy.viewer import _gl
_gl.ViewerGL.__init__.__defaults__ = (160, 120, False, False, False, "NovaPhy")
log, seen = _gl.ViewerGL.log_state, []
def log_state(self, state):
    log(self, state)
    seen.append(self.time)
    if len(seen) == {closed_after}:
        self._window.window.dispatch_event("on_close")
_gl.ViewerGL.log_state = log_state
code = start_demo(pathlib.Path(sys.argv[1]), sys.argv[2:])
print(len(seen), "frames in the window", file=sys.stderr)
sys.exit(code)
"""

needs_demos = [
    pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF"),
    pytest.mark.skipif(not novaphy.has_diff(), reason="built with NOVAPHY_WITH_DIFF=OFF"),
]
pytestmark = needs_demos


def start(words: list[str], folder: Path, env=None) -> subprocess.CompletedProcess[str]:
    """A demo in a folder that has the files its commands read; it says ok, or what failed."""
    for file, source in FILES.items():
        shutil.copy(source, folder / file)
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT, cwd=folder, env=env)
    said = done.stdout + done.stderr
    verdict = done.stdout.rstrip().rpartition("\n")[2]
    assert "Traceback" not in said, said
    # The Ant from zero reports which criteria of a gait it misses.
    failed = verdict.startswith("ant on cpu: ") and "CHECK FAILED: expected" in verdict
    assert done.returncode == (1 if failed else 0), said
    assert failed or verdict.endswith("ok"), said
    return done


def test_the_texts_name_every_way_to_start():
    named = {name: " ".join(line for other, line in COMMANDS if other == name) for name in NAMES}
    for name, flags in {
        "ant_walk": ("--train 10 --train-horizon 8 --save-policy", "--policy", "--check-gradient"),
        "ant_from_scratch": ("--load", "--headless 600", "--stages stride"),
        "franka_push_box": ("--train 5", "--check-gradient", "--contact full"),
    }.items():
        assert all(flag in named[name] for flag in flags), named[name]
        assert (name, "") in COMMANDS


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "line"),
    [pytest.param(*command, id=" ".join(command)) for command in COMMANDS if command[1]],
)
def test_a_command_of_the_text_without_a_window(tmp_path, name, line):
    words = shlex.split(line)
    if "--plot" in words:
        pytest.importorskip("matplotlib")
    script = DEMOS / f"demo_diffsim_{name}.py"
    trains = "--train" in words and name == "franka_push_box"  # this demo trains with --headless
    if not trains and not {"--headless", "--check-gradient"} & set(words):
        words += ["--headless", "200"]  # a window would open: those run in one below
    start([sys.executable, str(script), *shortened(name, words)], tmp_path)
    for flag in ("--save-policy", "--out", "--plot", "--record"):
        if flag in words:
            assert (tmp_path / words[words.index(flag) + 1]).stat().st_size > 1000


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "line"),
    [
        pytest.param(*command, id=" ".join(command))
        for command in (
            ("ant_walk", ""),
            ("ant_walk", "--train 2 --train-horizon 8"),
            ("ant_walk", "--policy tuned.npz"),
            ("ant_from_scratch", ""),
            ("ant_from_scratch", "--load gait.npz"),
            ("franka_push_box", ""),
        )
    ],
)
def test_a_command_in_a_window(tmp_path, name, line):
    pytest.importorskip("moderngl")
    pytest.importorskip("pyglet")
    if reason := x_server.why_not():
        pytest.skip(reason)
    script = DEMOS / f"demo_diffsim_{name}.py"
    program = WINDOW.replace("{closed_after}", str(CLOSED_AFTER))
    words = [sys.executable, "-c", program, str(script), *shortened(name, shlex.split(line))]
    with x_server.x_server("400x300") as environ:
        done = start(words, tmp_path, environ)
    assert done.stderr.rstrip().endswith(f"{CLOSED_AFTER} frames in the window"), done.stderr
