"""The demos as a user starts them: what they say when something is wrong."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import x_server

import novaphy
from novaphy import viewer
from novaphy._command import start_demo
from novaphy.viewer._scene_viewer import SceneViewer

DEMOS = Path(__file__).parents[2] / "python" / "demos" / "diff"
GAIT = DEMOS.parent / "data" / "ant" / "rl_policies" / "periodic_ant_natural_gait.npz"
needs_robots = pytest.mark.skipif(not novaphy.has_io(), reason="needs NOVAPHY_WITH_IO")


def demo(name: str, *flags: str) -> subprocess.CompletedProcess[str]:
    """A demo in a process of its own."""
    return subprocess.run(
        [sys.executable, str(DEMOS / f"demo_diffsim_{name}.py"), *flags],
        capture_output=True,
        text=True,
        timeout=300,
    )


@pytest.fixture
def common(monkeypatch):
    pytest.importorskip("novaphy.diff")
    monkeypatch.syspath_prepend(str(DEMOS))
    import demo_common

    return demo_common


def test_a_picture_that_cannot_be_written_is_refused_before_the_training(tmp_path):
    pytest.importorskip("novaphy.diff")
    pytest.importorskip("matplotlib")
    done = demo("cloth", "--headless", "1000000", "--plot", str(tmp_path / "x.txt"))
    assert done.returncode == 2 and "--plot: expected a name that ends in" in done.stderr


def test_the_verdict_names_the_checks_that_failed(common):
    assert common.verdict({}) == "ok" and common.verdict({"a": True}) == "ok"
    checks = {"a gradient within the tolerance": True, "a loss that falls": False, "b": False}
    assert common.verdict(checks) == "CHECK FAILED: expected a loss that falls; b"
    assert common.mostly_falls([1.0]) and common.mostly_falls([5.0, 4.0, 3.0, 2.0, 1.0, 1.5])
    assert not common.mostly_falls([5.0, 4.0, 4.5])


def test_a_demo_trains_and_says_ok():
    pytest.importorskip("novaphy.diff")
    done = demo("spring_cage", "--headless", "5", "--check-grad")
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


def test_the_dropped_dice_come_to_rest(tmp_path):
    flags = ["--headless", "180"]
    try:
        import matplotlib  # noqa: F401

        flags += ["--plot", str(tmp_path / "drop.png")]
    except ImportError:
        pass
    script = DEMOS.parent / "demo_rigid_drop.py"
    done = subprocess.run(
        [sys.executable, str(script), *flags], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    assert len(flags) == 2 or (tmp_path / "drop.png").stat().st_size > 10_000


def run_robot(*flags: str) -> subprocess.CompletedProcess[str]:
    script = DEMOS.parent / "demo_robot.py"
    return subprocess.run(
        [sys.executable, str(script), *flags], capture_output=True, text=True, timeout=300
    )


@pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it")
@pytest.mark.parametrize(
    "flags",
    [
        ["fr3.urdf"],
        ["two_link_arm.urdf"],
        ["ant.xml"],
        ["humanoid.xml"],
        ["quadruped.urdf", "--floating"],
    ],
)
def test_a_robot_from_a_file_gains_no_energy(flags):
    done = run_robot(*flags, "--headless", "60")
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


@pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF; the wheel has it")
@pytest.mark.parametrize("flags", [["--floating"], ["--height", "1"]])
def test_flags_of_urdf_files_are_refused_with_others(flags):
    done = run_robot("ant.xml", *flags, "--headless", "1")
    assert done.returncode == 2 and f"{flags[0]}: expected with URDF files only" in done.stderr


def check_scene(demo: str, scene: str, frames: int):
    """Run a scene of a demo, whose checks must pass."""
    done = subprocess.run(
        [sys.executable, str(DEMOS.parent / f"demo_{demo}.py"), scene, "--headless", str(frames)],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


@pytest.mark.parametrize("scene", ["stack", "dominoes", "cloth", "wall", "pendulum"])
def test_the_scenes_of_rigid_bodies_end_as_they_should(scene):
    check_scene("rigid_scenes", scene, 150)


@pytest.mark.skipif(not novaphy.has_vbd(), reason="built with NOVAPHY_BUILD_VBD=OFF")
@pytest.mark.parametrize("scene", ["bridge", "seesaw", "motor", "dominoes", "ragdoll"])
def test_the_scenes_of_bodies_in_vbd_end_as_they_should(scene):
    check_scene("vbd_bodies", scene, 240)


@pytest.mark.parametrize(
    ("scene", "frames"),
    [("stack", 600), ("quadruped", 600), ("chain", 600), ("ant", 600), ("ants", 120)],
)
def test_the_scenes_of_articulations_end_as_they_should(scene, frames):
    check_scene("articulated_scenes", scene, frames)


def test_a_box_is_pushed_to_its_mark_and_a_drone_flown_to_its_waypoint():
    pytest.importorskip("novaphy.diff")
    for name in ("push", "drone"):
        done = demo(name, "--headless", "100", "--check-grad")
        assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout


def test_a_double_pendulum_is_thrown_through_its_mark():
    pytest.importorskip("novaphy.diff")
    done = demo("pendulum", "--headless", "60", "--check-grad")
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


def test_the_pile_of_hulls_stays_in_the_bowl():
    script = DEMOS.parent / "demo_rigid_meshes.py"
    done = subprocess.run(
        [sys.executable, str(script), "--headless", "60"],
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


def test_the_die_is_trained_to_land_on_its_face():
    pytest.importorskip("novaphy.diff")
    done = demo("dice", "--headless", "4", "--starts", "1", "--check-grad")
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    assert "of 1 random spins" in done.stdout


@pytest.mark.parametrize(
    ("name", "iterations"),
    [
        ("featherstone", "10"),
        ("cart_pole", "2"),
        pytest.param("fr3_reach", "150", marks=needs_robots),
    ],
)
def test_articulations_are_trained_with_the_right_gradient(name, iterations):
    pytest.importorskip("novaphy.diff")
    done = demo(name, "--headless", iterations, "--check-grad")
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


def test_demos_write_a_page_of_the_run(tmp_path):
    pytest.importorskip("novaphy.diff")
    page = tmp_path / "run.html"
    done = demo("ball", "--headless", "32", "--record", str(page))
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    text = page.read_text("utf-8")
    assert '"takes":[0,37,74]' in text and '"path/earlier"' in text
    done = demo("ball", "--headless", "1", "--record", str(tmp_path / "run.txt"))
    assert done.returncode == 2 and "--record: expected an ending of .html" in done.stderr


@pytest.mark.parametrize(
    ("blocked", "options", "display", "expected"),
    [
        ("", [], None, "DISPLAY is not set"),
        ("", [], ":4711", "the display :4711 opens no window"),
        ("moderngl", [], ":4711", "the package 'moderngl': pip install 'novaphy[gl]'"),
        ("pyglet", [], ":4711", "the package 'pyglet': pip install 'novaphy[gl]'"),
        ("viser", ["--viewer", "viser"], None, "the package 'viser': pip install 'novaphy[web]'"),
        ("moderngl pyglet imgui_bundle viser matplotlib tqdm", ["--headless", "3"], None, None),
    ],
)
def test_a_demo_says_what_is_missing_and_goes_on(tmp_path, blocked, options, display, expected):
    pytest.importorskip("novaphy.diff")
    for package in {"": ("moderngl", "pyglet"), "pyglet": ("moderngl",)}.get(blocked, ()):
        pytest.importorskip(package)
    program = (
        f"import sys; sys.modules.update(dict.fromkeys({blocked.split()}))\n"
        "from novaphy._command import main\n"
        f"sys.exit(main(['run', 'spring_cage', *{options}]))"
    )
    environ = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | {"PATH": str(tmp_path)}
    if display:
        environ["DISPLAY"] = display
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=300, env=environ
    )
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    if expected is None:
        assert done.stderr == ""
        return
    assert expected in done.stderr and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.endswith("; going on without a window\n")


@pytest.mark.parametrize("name", ["rigid_drop", "diff/demo_diffsim_spring_cage"])
@pytest.mark.parametrize(
    ("options", "blocked", "expected"),
    [
        (["--record", "x.mp4"], "none", "apt-get install ffmpeg"),
        (["--record", "x.png"], "moderngl", "pip install 'novaphy[gl]'"),
        (["--plot", "x.png"], "matplotlib", "pip install 'novaphy[demos]'"),
    ],
)
def test_what_cannot_be_written_is_said_before_the_work(tmp_path, name, options, blocked, expected):
    pytest.importorskip("novaphy.diff")
    if blocked == "none":
        pytest.importorskip("moderngl")
    script = DEMOS.parent / (f"{name}.py" if "/" in name else f"demo_{name}.py")
    program = (
        "import runpy, sys\n"
        f"sys.modules[{blocked!r}] = None\n"
        f"sys.path.insert(0, {str(script.parent)!r})\n"
        f"sys.argv = ['demo', '--headless', '0', *{options}]\n"
        f"runpy.run_path({str(script)!r}, run_name='__main__')"
    )
    environ = os.environ | {"PATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=100,
        env=environ, cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 2 and done.stdout == "", done.stdout + done.stderr
    assert f"error: {options[0]}" in done.stderr.splitlines()[-1]
    assert expected in done.stderr and "Traceback" not in done.stderr


class Recorder(SceneViewer):
    """Keeps the calls of a demo, and the scene that they make."""

    def __init__(self):
        """Start without any."""
        super().__init__()
        self.states: list[float] = []
        self.lines: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
        self.marks: list[str] = []
        self.losses: list[float] = []
        self.body_q: list[np.ndarray] = []
        self.frames = 0

    def log_state(self, state):
        """Keep the time and the bodies."""
        super().log_state(state)
        self.states.append(self.time)
        self.body_q.append(state.body_q.numpy())

    def log_points(self, name, points, radii=None, colors=None, hidden=False):
        """Keep the name."""
        super().log_points(name, points, radii, colors, hidden)
        self.marks.append(name)

    def log_scalar(self, name, value):
        """Keep a loss."""
        super().log_scalar(name, value)
        if name == "loss":
            self.losses.append(value)

    def log_lines(self, name, starts, ends, colors, width=0.01, hidden=False):
        """Keep the way and its colors."""
        super().log_lines(name, starts, ends, colors, width, hidden)
        drawn = (np.array(starts), np.broadcast_to(np.float32(colors), np.shape(starts)))
        self.lines.setdefault(name, []).append(drawn)

    def end_frame(self):
        """Count the frame."""
        self.frames += 1


def recorded(monkeypatch, script: Path, options: list[str]) -> Recorder:
    """What a demo shows."""
    recorder = Recorder()

    class Recorded(viewer.Stage):
        """Shows everything to the recorder."""

        def __init__(self, args, model, **options):
            super().__init__(args, model, viewers=[recorder], **options)

    monkeypatch.setattr(viewer, "Stage", Recorded)
    assert start_demo(script, options) == 0
    return recorder


def check_ways(recorder: Recorder, name: str, shown: int, points: int) -> None:
    """A way in the present color for every iteration shown, and before it the earlier ones."""
    present, earlier = recorder.lines[name], recorder.lines.get(f"{name}/earlier", [])
    assert len(present) == shown and len(earlier) == shown - 1
    for k, (way, colors) in enumerate(present):
        assert way.shape == (points, 3)
        np.testing.assert_allclose(colors, np.tile(viewer._stage.PRESENT, (points, 1)))
        if k:
            former, shades = earlier[k - 1]
            kept = min(k, viewer._stage.EARLIER)
            assert len(former) == kept * points
            for age in range(1, kept + 1):
                start = (kept - age) * points
                expected = present[k - age][0]
                np.testing.assert_array_equal(former[start : start + points], expected)
            np.testing.assert_allclose(shades[-1], viewer._stage.RECENT, atol=1e-6)
            assert np.all(np.diff(shades.sum(axis=1)) <= 1e-6)  # the older, the paler
            assert len(np.unique(shades, axis=0)) == kept


@pytest.mark.parametrize(
    ("name", "iterations", "shown", "frames", "points"),
    [
        ("ball", 33, 4, 37, 240),
        ("soft_body", 11, 3, 61, 240),
        ("cloth", 6, 3, 121, 240),
        ("spring_cage", 7, 3, 31, 30),
        ("dice", 2, 3, 49, 240),
        ("featherstone", 2, 3, 37, 240),
        ("pendulum", 7, 3, None, None),
        ("push", 7, 3, None, None),
        ("drone", 11, 3, None, None),
        ("cart_pole", 21, 3, None, None),
        pytest.param("fr3_reach", 11, 3, None, None, marks=needs_robots),
    ],
)
def test_a_demo_shows_its_iterations(monkeypatch, name, iterations, shown, frames, points):
    pytest.importorskip("novaphy.diff")
    options = ["--starts", "0"] if name == "dice" else []
    script = DEMOS / f"demo_diffsim_{name}.py"
    recorder = recorded(monkeypatch, script, ["--headless", str(iterations), *options])
    frames = frames or len(recorder.states) // shown
    points = points or len(recorder.lines["path"][0][0])
    assert frames > 20 and points > 20
    assert recorder.frames == len(recorder.states) == shown * frames
    starts = [k for k, t in enumerate(recorder.states) if not k or t <= recorder.states[k - 1]]
    assert starts == [k * frames for k in range(shown)]
    assert recorder.marks == ([] if name in ("dice", "cart_pole") else ["target"])
    assert len(recorder.losses) == iterations + 1
    check_ways(recorder, "path", shown, points)
    if name == "dice":
        check_ways(recorder, "corner", shown, points)
        assert recorder.scene.instances["model/box"].count == 1
        heights = np.array([q[0, 2] for q in recorder.body_q])
        # the die falls, frame by frame
        assert heights[0] == pytest.approx(0.6) and heights.min() < 0.18
    if name == "ball":
        way = recorder.lines["path"][-1][0]  # the ball moves along the path
        places = recorder.scene.instances["model/particles"].poses.values
        end = recorder.scene.lines["path"].ends.values[-1]
        np.testing.assert_allclose(places[0, :3], end, atol=1e-6)
        assert np.ptp(way[:, 1]) > 1.0


def test_the_arm_is_blue_and_orange_over_a_black_and_white_ground(monkeypatch):
    pytest.importorskip("novaphy.diff")
    script = DEMOS / "demo_diffsim_featherstone.py"
    recorder = recorded(monkeypatch, script, ["--headless", "1"])
    scene, camera = recorder.scene, recorder.camera
    (link1, link2), ground = scene.instances["model/box"].colors.values, "model/plane"
    red, green, blue, checker = link1
    assert blue > 0.6 > green > red and checker == 0.0
    red, green, blue, checker = link2
    assert red > 0.9 > green > 0.3 > blue and checker == 0.0
    *white, contrast = scene.instances[ground].colors.values[0]
    assert min(white) > 0.9 and max(white) * (1.0 - contrast) < 0.1
    # The camera looks at the XZ plane from the front, and all bodies move in this plane.
    assert abs(camera.forward[1]) > 0.999
    assert np.abs(np.array(recorder.body_q)[:, :, 1]).max() < 1e-6
    red, green, blue = viewer._stage.PRESENT
    assert red > 0.8 and max(green, blue) < 0.2
    tip = recorder.lines["path"][-1][0]
    assert np.abs(tip[:, 1]).max() == 0.0 and np.ptp(tip[:, 2]) > 0.1


def test_the_last_32_earlier_ways_stay(monkeypatch):
    pytest.importorskip("novaphy.diff")
    script = DEMOS / "demo_diffsim_spring_cage.py"
    recorder = recorded(monkeypatch, script, ["--headless", "40", "--refresh", "1"])
    check_ways(recorder, "path", 41, 30)


SIMULATIONS = [
    ("rigid_drop", [], "box"),
    ("rigid_meshes", [], "convex_mesh"),
    ("rigid_scenes", ["stack"], "box"),
    ("articulated_scenes", ["quadruped"], "capsule"),
]


@pytest.mark.parametrize(("name", "options", "shape"), SIMULATIONS)
def test_a_simulation_shows_every_frame(monkeypatch, name, options, shape):
    script = DEMOS.parent / f"demo_{name}.py"
    recorder = recorded(monkeypatch, script, ["--headless", "3", *options])
    assert recorder.frames == len(recorder.states) >= 3 and recorder.states[-1] > 0.0
    assert any(key.startswith(f"model/{shape}") for key in recorder.scene.instances)
    moved = recorder.body_q[-1][:, :3] - recorder.body_q[0][:, :3]
    assert np.linalg.norm(moved, axis=1).max() > 1e-4


class Resetting(Recorder):
    """Somebody presses reset when seven frames are shown: the Ant has got torques then."""

    def __init__(self):
        """Start without any."""
        super().__init__()
        self.reset_requested = False
        self.particle_q: list[np.ndarray] = []

    def log_state(self, state):
        """Keep the particles too."""
        super().log_state(state)
        self.particle_q.append(state.particle_q.numpy())

    def end_frame(self):
        """Press it."""
        super().end_frame()
        self.reset_requested = self.frames == 7


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *((name, options) for name, options, _ in SIMULATIONS),
        ("rigid_scenes", ["cloth"]),
        ("articulated_scenes", ["ant"]),
        ("vbd", ["twisted"]),
        ("robot", []),
        ("diffsim_ant_walk", []),
        ("diffsim_ant_from_scratch", ["--load", str(GAIT)]),
    ],
)
def test_a_reset_begins_a_simulation_again_to_the_bit(monkeypatch, name, options):
    if name == "vbd" and not novaphy.has_vbd():
        pytest.skip("built with NOVAPHY_BUILD_VBD=OFF")
    if name == "robot" and not novaphy.has_io():
        pytest.skip("built with NOVAPHY_WITH_IO=OFF")
    screen = Resetting()

    class Watched(viewer.Stage):
        """Shows everything to the screen, and heeds its reset."""

        def __init__(self, args, model, **options):
            super().__init__(args, model, viewers=[screen], **options)
            self._screen = screen

    monkeypatch.setattr(viewer, "Stage", Watched)
    ants = name.startswith("diffsim_ant")
    if ants and not (novaphy.has_io() and novaphy.has_diff()):
        pytest.skip("built with NOVAPHY_WITH_IO=OFF or NOVAPHY_WITH_DIFF=OFF")
    script = (DEMOS if ants else DEMOS.parent) / f"demo_{name}.py"
    count, fps = 8, 20.0 if ants else 60.0
    assert start_demo(script, ["--headless", str(count), *options]) == 0
    assert screen.states[7:] == pytest.approx([k / fps for k in range(count + 1)])
    for kept in (screen.body_q, screen.particle_q):
        for k in range(7):
            np.testing.assert_array_equal(kept[k], kept[7 + k])
    moved = [
        np.abs(kept[-1] - kept[0]).max(initial=0.0) for kept in (screen.body_q, screen.particle_q)
    ]
    assert max(moved) > 1e-4


WINDOW = """
import sys
from novaphy._command import start_demo
from novaphy.viewer import _gl, _stage
_gl.ViewerGL.__init__.__defaults__ = (160, 120, False, False, False, "NovaPhy")
starts, log, waits = [], _gl.ViewerGL.log_state, []
def log_state(self, state):
    log(self, state)
    waits.append(self.waits)
    if self.time == 0.0:
        starts.append(len(self.scene.scalars["loss"]))
        if len(starts) == 5:
            self._window.window.dispatch_event("on_close")
_gl.ViewerGL.log_state = log_state
code = start_demo({script!r}, ["--refresh", "1000"])
assert all(waits) and starts == [1, 61, 61, 61, 61], starts  # first, last, replays
sys.exit(code)
"""


def test_a_demo_trains_in_a_window_and_replays_until_it_is_closed():
    pytest.importorskip("novaphy.diff")
    pytest.importorskip("moderngl")
    pytest.importorskip("pyglet")
    if reason := x_server.why_not():
        pytest.skip(reason)
    script = DEMOS / "demo_diffsim_spring_cage.py"
    program = WINDOW.replace("{script!r}", f"__import__('pathlib').Path({str(script)!r})")
    with x_server.x_server("400x300") as environ:
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=300,
            env=environ,
        )  # fmt: skip
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr


INTERRUPTED = """
import pathlib, sys
from novaphy import viewer
from novaphy._command import start_demo
iteration = viewer.Stage.iteration
def told(self, number, *args, **options):
    iteration(self, number, *args, **options)
    if number == 7:
        print("going", flush=True)
viewer.Stage.iteration = told
sys.exit(start_demo(pathlib.Path(sys.argv[1]), sys.argv[2:]))
"""


@pytest.mark.parametrize("ending", [".html", ".nprec", ".gif"])
def test_an_interrupt_leaves_a_whole_file(tmp_path, ending):
    pytest.importorskip("novaphy.diff")
    if ending == ".gif":
        pytest.importorskip("moderngl")
        if shutil.which("ffmpeg") is None:
            pytest.skip("no ffmpeg: apt-get install ffmpeg")
    file = tmp_path / f"run{ending}"
    script = DEMOS / "demo_diffsim_spring_cage.py"
    command = [sys.executable, "-c", INTERRUPTED, str(script), "--headless", "1000000"]
    command += ["--record", str(file)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        # The parent process may ignore the signal, and a child inherits that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    try:
        assert process.stdout.readline() == b"going\n"  # 8 iterations are done, however slowly
        process.send_signal(signal.SIGINT)
        said = process.communicate(timeout=60)[0].decode()
    finally:
        process.kill()
    assert process.returncode == 130 and said == "", said
    if ending == ".html":
        assert file.read_text("utf-8").rstrip().endswith("</html>")
    elif ending == ".gif":
        data = file.read_bytes()
        assert data[:6] == b"GIF89a" and data[-1:] == b";"
    else:
        recording = viewer.ViewerFile(tmp_path / "other.nprec", auto_save=False)
        recording.load_recording(file)
        assert recording.frame_count > 31


@needs_robots
def test_a_franka_pushes_its_box_to_the_mark_with_the_gradients_it_claims(tmp_path):
    pytest.importorskip("novaphy.diff")
    done = demo("franka_push_box", "--train", "5", "--dump-states", str(tmp_path / "x.npz"))
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    assert "surrogate contact, frozen dynamics, no reaction" in done.stdout
    with np.load(tmp_path / "x.npz") as states:
        assert abs(states["box_x"][-1] - 0.70) < 5e-3
        assert np.linalg.norm(states["tip"][:, 1:] - (0.0, 0.10), axis=1).max() < 0.01
        assert states["loss"][-1] < 0.01 * states["loss"][0]
    done = demo("franka_push_box", "--check-gradient")
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    assert "exact dynamics" in done.stdout
    done = demo("franka_push_box", "--headless", "1", "--device", "cuda")
    assert done.returncode == 2 and "--device: expected cpu" in done.stderr


@needs_robots
def test_a_franka_whose_box_pushes_back_has_the_slopes_of_the_differences(common):
    """Contacts that come and go roughen the loss, so differences are of some milliradians."""
    import franka_contact

    scene = franka_contact.FullPush("cpu", exact=False)
    direction = np.random.default_rng(7).normal(size=(2, *scene.keys.shape))[1]
    direction /= np.linalg.norm(direction)
    loss, gradient = scene.gradient()
    assert 0.6 < scene.box[-1] < 0.64 and loss > 1e-3
    slope = float(direction.ravel() @ gradient)
    assert slope > 5e-3
    np.testing.assert_allclose(slope, scene.difference(direction), rtol=0.15)


@needs_robots
def test_a_franka_that_does_not_reach_the_box_says_no_contact(common):
    import demo_diffsim_franka_push_box as franka

    scene = franka.FrankaPush("cpu", exact=False)
    scene.keys = np.stack([scene.inverse_kinematics(x) for x in (0.40, 0.42, 0.44, 0.46)])
    with pytest.raises(ValueError, match="no contact"):
        scene.gradient()
    scene.keys = np.stack([scene.inverse_kinematics(x) for x in franka.START])
    scene.loss(scene.keys)
    assert scene.box[-1] == pytest.approx(0.62, abs=0.01)
