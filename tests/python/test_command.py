"""The command `novaphy`, as a user types it."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import novaphy
from novaphy import _command
from novaphy.viewer._scene_viewer import SceneViewer

DATA = Path(__file__).parents[1] / "data"


def command(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """`python -m novaphy` with these words."""
    return subprocess.run(
        [sys.executable, "-m", "novaphy", *words],
        capture_output=True, text=True, timeout=300, cwd=cwd,
    )  # fmt: skip


@pytest.fixture(autouse=True)
def with_demos():
    """The demos, which an editable install and a wheel have."""
    pytest.importorskip("novaphy.diff")
    if not _command.demos():
        pytest.skip("this installation has no demos")


def test_demos_are_listed_and_run_from_anywhere(tmp_path):
    listed = command("demos", cwd=tmp_path)
    assert listed.returncode == 0
    lines = {line.split()[0]: line for line in listed.stdout.splitlines()}
    assert {"ball", "soft_body", "cloth", "dice", "spring_cage", "rigid_drop"} <= set(lines)
    assert "common" not in lines and all(len(line.split()) > 5 for line in lines.values())
    names = command("demos", "--names").stdout.split()
    assert names == list(lines)
    done = command("run", "spring_cage", "--headless", "3", cwd=tmp_path)
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stderr
    wrong = command("run", "nothing")
    assert wrong.returncode == 1 and "there is no demo 'nothing'" in wrong.stderr
    assert "spring_cage" in wrong.stderr and wrong.stderr.count("\n") == 1
    none = command("run")
    assert none.returncode == 2 and none.stderr.rstrip().endswith("required: demo")


def test_a_gradient_is_checked_and_an_iteration_measured():
    done = command("check", "spring_cage")
    assert done.returncode == 0 and "relative error" in done.stdout
    refused = command("check", "rigid_drop")
    assert refused.returncode == 1 and "has no gradient" in refused.stderr
    result = json.loads(command("bench", "--count", "5", "spring_cage").stdout)
    assert result["iterations"] == 6  # and the last rollout
    assert 0.0 < result["fastest_ms"] <= result["median_ms"] < 1000.0
    behind = json.loads(command("bench", "spring_cage", "--count", "7").stdout)
    assert behind["iterations"] == 8
    few = command("bench", "spring_cage", "--count", "2")
    assert few.returncode == 1 and "--count: expected a number >= 4, got 2" in few.stderr


def test_info_names_what_is_there_and_what_is_missing():
    done = command("info")
    assert done.returncode == 0
    assert novaphy.__version__ in done.stdout and "cpu" in done.stdout
    assert "cache of device code: " in done.stdout and "threads: " in done.stdout
    if all(backend.name != "cuda" for backend in novaphy.backends()):
        assert "cuda: missing: CMAKE_ARGS=-DNOVAPHY_WITH_CUDA=ON" in done.stdout
    code = (
        "import importlib.metadata as m, sys; real = m.version\n"
        "def version(name):\n"
        "    if name == 'moderngl': raise m.PackageNotFoundError(name)\n"
        "    return real(name)\n"
        "m.version = version\n"
        "from novaphy._command import main; sys.exit(main(['info']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "moderngl (ViewerGL): missing: pip install 'novaphy[gl]'" in done.stdout


def test_a_recording_is_replayed_as_a_page(tmp_path):
    done = command("run", "ball", "--headless", "4", "--record", "run.nprec", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    done = command("replay", "run.nprec", "--headless", "1", "--record", "r.html", cwd=tmp_path)
    assert done.returncode == 0 and "74 frames" in done.stdout, done.stderr
    assert '"takes":[0,37]' in (tmp_path / "r.html").read_text("utf-8")
    wrong = command("replay", str(DATA / "cube.msh"), "--headless", "1")
    assert wrong.returncode == 1 and "is no recording" in wrong.stderr
    assert "pickle" not in wrong.stderr and wrong.stderr.count("\n") == 1


def test_a_mesh_is_viewed(tmp_path):
    path = tmp_path / "cube.html"
    done = command("view", str(DATA / "cube.msh"), "--headless", "1", "--record", str(path))
    assert done.returncode == 0 and "tetrahedra" in done.stdout, done.stderr
    assert '["mesh","mesh","points"' in path.read_text("utf-8")
    robot = command("view", "robot.urdf", "--headless", "1")
    assert robot.returncode == 1 and re.search("robot.urdf|NOVAPHY_WITH_IO", robot.stderr)
    other = command("view", "run.nprec", "--headless", "1")
    assert other.returncode == 1 and "novaphy replay run.nprec" in other.stderr
    assert ".msh" in other.stderr and ".xml" in other.stderr and other.stderr.count("\n") == 1


@pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it")
@pytest.mark.parametrize(("name", "bodies"), [("fr3.urdf", 13), ("ant.xml", 9)])
def test_a_robot_is_viewed(tmp_path, name, bodies):
    path = tmp_path / "robot.html"
    file = str(novaphy.assets.path(name))
    done = command("view", file, "--headless", "1", "--record", str(path))
    assert done.returncode == 0 and f"{bodies} bodies" in done.stdout, done.stderr
    assert path.stat().st_size > 10_000


class Screen(SceneViewer):
    """A window in which somebody moves sliders, and which is closed after four frames."""

    def __init__(self):
        """Start with no frame."""
        super().__init__()
        self.reset_requested = False
        self.sliders, self.poses = {}, []

    def add_slider(self, name, low, high, value, on_change=None):
        """Keep it."""
        self.sliders[name] = super().add_slider(name, low, high, value)
        return self.sliders[name]

    def log_state(self, state):
        """Keep the poses, then move the first joint and the last."""
        super().log_state(state)
        self.poses.append(state.body_q.numpy())
        self.sliders["fr3_joint1 (rad)"].set(0.6 * len(self.poses))
        self.sliders["fr3_finger_joint2 (m)"].set(0.02 * len(self.poses))
        self.reset_requested = len(self.poses) == 3

    def end_frame(self):
        """Close in time."""
        self._running = len(self.poses) < 4


@pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it")
def test_sliders_move_the_joints_of_a_robot(monkeypatch, capsys):
    screen = Screen()
    monkeypatch.setattr(novaphy.viewer, "create_viewer", lambda kind, **options: screen)
    assert _command.main(["view", str(novaphy.assets.path("fr3.urdf"))]) == 0
    assert "9 joints to move" in capsys.readouterr().out
    turn, finger = screen.sliders["fr3_joint1 (rad)"], screen.sliders["fr3_finger_joint2 (m)"]
    assert (turn.low, turn.high) == pytest.approx((-2.7437, 2.7437))
    assert (finger.low, finger.high) == pytest.approx((0.0, 0.04))
    labels = [label.rpartition("/")[2] for label in screen.model.body_label]
    link, hand, finger = (labels.index(f"fr3_{name}") for name in ("link1", "hand", "rightfinger"))
    assert len(screen.poses) == 4
    for k, poses in zip((0, 1, 2, 0), screen.poses, strict=True):  # the reset takes all back
        half = 0.3 * k  # of the turn about z
        turn = (0.0, 0.0, math.sin(half), math.cos(half))
        assert poses[link, 3:] == pytest.approx(turn, abs=1e-6)
        away = np.linalg.norm(poses[finger, :3] - poses[hand, :3])
        assert away == pytest.approx(math.hypot(0.0584, 0.02 * k), abs=1e-5)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("novaphy re", "replay"),
        ("novaphy run spring", "spring_cage"),
        ("novaphy run ball --hea", "--headless"),
        ("novaphy run ball --viewer vi", "viser"),
    ],
)
def test_the_completion_is_bash(words, expected):
    text = command("completion").stdout
    python = f'novaphy() {{ {sys.executable} -m novaphy "$@"; }}'
    program = f"{text}\n{python}\nCOMP_WORDS=({words}) COMP_CWORD={len(words.split()) - 1}\n"
    done = subprocess.run(
        ["bash", "-c", program + "_novaphy; echo ${COMPREPLY[@]}"], capture_output=True, text=True
    )
    assert done.stdout.strip() == expected, done.stderr


# The demo of many processes draws its results and opens no viewer.
@pytest.mark.parametrize("name", sorted(_command.demos().keys() - {"distributed"}))
def test_every_demo_takes_the_flags_of_a_viewer(name):
    if name.startswith("vbd") and not novaphy.has_vbd():
        pytest.skip("built with NOVAPHY_BUILD_VBD=OFF")
    done = command("run", name, "--help")
    assert done.returncode == 0, done.stderr
    for flag in ("--viewer {gl,viser,html,file,null}", "--headless N", "--record PATH"):
        assert flag in done.stdout
