"""ViewerGL: pictures through a real EGL context, and a real window where there is an X server."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import time
import zlib
from pathlib import Path

import numpy as np
import pytest
import x_server

import novaphy
from novaphy import viewer as viewers

SIZE = {"width": 320, "height": 240}
BLUE = np.float32([0.16, 0.44, 0.72])


@pytest.fixture(scope="module")
def egl():
    """ViewerGL without a display, where there is one."""
    try:
        novaphy.ViewerGL(headless=True, **SIZE).close()
    except ImportError as error:
        pytest.skip(str(error))


def bodies(count: int, ground: bool = True) -> novaphy.Model:
    """Boxes of 0.2 m in rows of 100 over the ground."""
    builder = novaphy.ModelBuilder()
    if ground:
        builder.add_ground_plane()
    for k in range(count):
        place = (0.3 * (k % 100), 0.3 * (k // 100), 0.5)
        body = builder.add_body(xform=(place, (0.0, 0.0, 0.0, 1.0)), mass=1.0)
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    return builder.finalize()


def show(viewer: novaphy.ViewerGL, state: novaphy.SimState, t: float = 0.0) -> np.ndarray:
    """The picture of a state."""
    viewer.begin_frame(t)
    viewer.log_state(state)
    viewer.end_frame()
    return viewer.get_frame()


def like(picture: np.ndarray, color) -> np.ndarray:
    """Which pixels have the hue of a color, in light or shade."""
    rgb = picture.astype(np.float32) + 1.0
    direction = np.float32(color) / np.linalg.norm(color)
    return (rgb @ direction) / np.linalg.norm(rgb, axis=2) > 0.985


def test_a_picture_shows_something_and_the_text_over_it(egl):
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        model = bodies(1)
        viewer.set_model(model)
        picture = show(viewer, model.state())
        assert picture.shape == (240, 320, 3) and picture.dtype == np.uint8
        background = picture[0, -1].astype(int)
        assert np.mean(np.abs(picture - background).max(axis=2) > 8) > 0.05
        assert np.count_nonzero(like(picture, BLUE)) > 100
        viewer.show_text = False
        without = show(viewer, model.state())
        assert np.any(picture[:60, :120] != without[:60, :120])
        assert np.array_equal(picture[120:], without[120:])


def test_a_body_moves_in_the_picture_as_projected(egl):
    model = bodies(1, ground=False)
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        viewer.show_text = False
        viewer.set_model(model)
        viewer.look_at((1.0, -3.0, 1.5), (0.0, 0.0, 0.5))
        state = model.state()
        centers, projected = [], []
        for x in (0.0, 0.4):
            pose = np.float32([[x, 0.2 * x, 0.5 + x, 0.0, 0.0, 0.0, 1.0]])
            state.body_q.assign(pose)
            rows, columns = np.nonzero(like(show(viewer, state), BLUE))
            centers.append((columns.mean() + 0.5, rows.mean() + 0.5))
            projected.append(viewer.camera.project(pose[:, :3], 320, 240)[0])
        moved = np.subtract(centers[1], centers[0])
        expected = np.subtract(projected[1], projected[0])
        assert np.linalg.norm(expected) > 40
        np.testing.assert_allclose(moved, expected, atol=2.0)
        np.testing.assert_allclose(centers, projected, atol=3.0)


def test_a_thousand_bodies_are_three_draw_calls(egl):
    model = bodies(1000)
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        viewer.show_text = False
        viewer.set_model(model)
        show(viewer, model.state())
        assert viewer.draw_calls == 3  # the shadow of the boxes, the boxes, the ground


def test_ten_thousand_bodies_take_less_than_two_milliseconds_of_python(egl):
    model = bodies(10_000)
    state = model.state()
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        viewer.set_model(model)
        show(viewer, state)
        before = [id(item.poses.values) for item in viewer.scene.instances.values()]
        seconds = []
        for k in range(20):
            start = time.thread_time()
            viewer.begin_frame(0.1 * k)
            viewer.log_state(state)
            viewer.end_frame()
            viewer._renderer._follow(viewer.scene)  # the upload, without the rasteriser
            seconds.append(time.thread_time() - start)
        assert min(seconds) < 2e-3
        assert before == [id(item.poses.values) for item in viewer.scene.instances.values()]


def test_every_shape_is_drawn(egl):
    builder = novaphy.ModelBuilder()
    shapes = {
        "sphere": {"radius": 0.2},
        "box": {"hx": 0.2, "hy": 0.1, "hz": 0.2},
        "capsule": {"radius": 0.1, "half_height": 0.2},
        "cylinder": {"radius": 0.1, "half_height": 0.2},
        "cone": {"radius": 0.2, "half_height": 0.2},
        "ellipsoid": {"rx": 0.3, "ry": 0.2, "rz": 0.1},
    }
    for k, (kind, sizes) in enumerate(shapes.items()):
        body = builder.add_body(xform=((k - 2.5, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)), mass=1.0)
        getattr(builder, f"add_shape_{kind}")(body, **sizes)
    model = builder.finalize()
    with novaphy.ViewerGL(headless=True, width=900, height=300) as viewer:
        viewer.show_text = False
        viewer.set_model(model)
        viewer.look_at((0.0, -8.5, 0.0), (0.0, 0.0, 0.0))
        picture = show(viewer, model.state())
        drawn = np.abs(picture - picture[0, 0].astype(int)).max(axis=2) > 20
        poses = model.state().body_q.numpy()
        for pose, (kind, sizes) in zip(poses, shapes.items(), strict=True):
            half = {
                "sphere": (0.2, 0.2), "box": (0.2, 0.2), "capsule": (0.1, 0.3),
                "cylinder": (0.1, 0.2), "cone": (0.2, 0.2), "ellipsoid": (0.3, 0.1),
            }[kind]  # fmt: skip
            corner = pose[:3] + np.float32([half[0], 0.0, half[1]])
            (x, y), (right, top) = viewer.camera.project(np.stack([pose[:3], corner]), 900, 300)
            around = drawn[:, round(x) - 22 : round(x) + 22]
            width, height = np.count_nonzero(around.any(axis=0)), np.count_nonzero(around.any(1))
            assert width == pytest.approx(2 * (right - x), abs=3), (kind, sizes)
            assert height == pytest.approx(2 * (y - top), abs=3), (kind, sizes)


@pytest.mark.parametrize("between", [0, 3])  # as the hips of an Ant, and the stumps of its torso
def test_surfaces_in_one_place_do_not_fight(egl, between):
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        viewer.show_text = False
        viewer.look_at((1.0, -3.0, 1.5), (0.0, 0.0, 0.0))
        colors = np.float32([(0.9, 0.1, 0.1), *[(0.5, 0.5, 0.5)] * between, (0.1, 0.1, 0.9)])
        turn = np.float32([0.0, 0.0, np.sin(0.03), np.cos(0.03)])
        away = [(0, 50, 0, 0, 0, 0, 1)] * between  # not to be seen
        poses = np.float32([(0, 0, 0, 0, 0, 0, 1), *away, (0, 0, 0, *turn)])
        viewer.log_shapes("rods", novaphy.GeoType.CYLINDER, (0.5, 0.7, 0), poses, colors)
        viewer.begin_frame(0.0)
        viewer.end_frame()
        rgb = viewer.get_frame().astype(int)
        red = np.count_nonzero(rgb[..., 0] > 1.5 * rgb[..., 2])
        blue = np.count_nonzero(rgb[..., 2] > 1.5 * rgb[..., 0])
        assert blue > 3000 and red < 0.002 * blue, (red, blue)


def test_drawings_appear_and_disappear(egl):
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        viewer.show_text = False
        viewer.look_at((0.0, -4.0, 0.0), (0.0, 0.0, 0.0))
        red, green, gold = (0.9, 0.1, 0.1), (0.1, 0.8, 0.1), (0.9, 0.7, 0.1)

        def pixels(color):
            viewer.begin_frame(0.0)
            viewer.end_frame()
            return np.count_nonzero(like(viewer.get_frame(), color))

        assert pixels(red) == pixels(green) == 0
        viewer.log_lines("a", [[-1, 0, 0.5]], [[1, 0, 0.5]], red, 0.1)
        viewer.log_lines("b", [[-1, 0, -0.5]], [[1, 0, -0.5]], green, 0.1)
        viewer.log_arrows("c", [[0, 0, -0.3]], [[0, 0, 0.3]], gold, 0.03)
        length, thick = 2.0 / (8.0 * np.tan(np.radians(20.0))) * 240, 0.1 / 2.912 * 240
        assert pixels(red) == pytest.approx(length * thick, rel=0.25)
        assert pixels(green) == pytest.approx(length * thick, rel=0.25)
        assert pixels(gold) > 100
        viewer.log_lines("a", None, None, None)
        viewer.log_lines("b", [[-1, 0, -0.5]], [[1, 0, -0.5]], green, 0.05, hidden=True)
        viewer.log_arrows("c", None, None, None)
        assert pixels(red) == pixels(green) == pixels(gold) == 0
        viewer.log_mesh("m", [[-1, 0, -1], [1, 0, -1], [0, 0, 1]], [[0, 1, 2]], color=green)
        viewer.log_points("p", [[0, -0.5, 0]], 0.2, red)
        assert pixels(green) > 3000 and pixels(red) > 300
        for call, error in (
            (lambda: viewer.log_lines("a", [[0, 0, 0]], [[0, 0]], red), ValueError),
            (lambda: viewer.log_mesh("m", [[0, 0, 0]], [[0, 1, 2]]), ValueError),
            (lambda: viewer.log_instances("i", "none", np.zeros((1, 7))), ValueError),
            (lambda: viewer.log_shapes("s", novaphy.GeoType.HFIELD, (1, 1, 1), np.zeros((1, 7))),
             NotImplementedError),
            (lambda: viewer.log_state(bodies(1).state()), ValueError),
        ):  # fmt: skip
            with pytest.raises(error):
                call()


def test_opening_and_closing_leaves_nothing_behind(egl):
    model = bodies(100)

    def growth() -> tuple[int, float]:
        seen = []
        for k in range(48):
            with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
                viewer.set_model(model)
                show(viewer, model.state())
            if k % 4 == 3:
                pages = int(Path("/proc/self/statm").read_text().split()[1])
                seen.append((len(os.listdir("/proc/self/fd")), pages * os.sysconf("SC_PAGE_SIZE")))
        descriptors, memory = zip(*seen, strict=True)
        # The driver allocates and frees pieces of 16 MiB, so only the total of 20 openings shows
        # a leak.
        return descriptors[-1] - descriptors[0], min(memory[8:]) - max(memory[:4])

    descriptors, memory = growth()
    if memory >= 20e6:  # a leak grows again, the memory of another thread does not
        memory = growth()[1]
    assert descriptors <= 0
    assert memory < 20e6
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        viewer.set_model(model)
    with pytest.raises(RuntimeError, match="closed"):
        viewer.get_frame()


def test_pictures_and_videos_are_written(egl, tmp_path):
    model = bodies(1)
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        viewer.set_model(model)
        picture = show(viewer, model.state())
        viewer.save_picture(tmp_path / "a.png")
        data = (tmp_path / "a.png").read_bytes()
        assert struct.unpack(">II", data[16:24]) == (320, 240)
        length = struct.unpack(">I", data[33:37])[0]
        rows = np.frombuffer(zlib.decompress(data[41 : 41 + length]), np.uint8)
        assert np.array_equal(rows.reshape(240, 961)[:, 1:].reshape(240, 320, 3), picture)
        with pytest.raises(ValueError, match=r"\.mp4"):
            viewer.start_video(tmp_path / "a.avi")
        if shutil.which("ffmpeg") is None:
            with pytest.raises(RuntimeError, match="apt-get install ffmpeg"):
                viewer.start_video(tmp_path / "a.gif")
            return
        viewer.start_video(tmp_path / "a.gif", fps=25.0)
        for k in range(5):
            show(viewer, model.state(), 0.1 * k)
        viewer.stop_video()
    assert (tmp_path / "a.gif").read_bytes()[:6] == b"GIF89a"


@pytest.mark.parametrize(
    ("blocked", "options", "variables", "expected"),
    [
        ("moderngl", "headless=True", {}, "pip install 'novaphy[gl]'"),
        ("pyglet", "", {}, "pip install 'novaphy[gl]'"),
        ("none", "", {}, "DISPLAY is not set"),
        ("none", "", {"DISPLAY": ":4711"}, "the display :4711 opens no window"),
        ("pyglet.gl", "", {"DISPLAY": ":4711"}, "apt-get install libgl1 libgl1-mesa"),
        ("none", "headless=True", {"__EGL_VENDOR_LIBRARY_DIRS": "/nowhere"},
         "apt-get install libegl1 libgl1-mesa-dri"),
    ],
)  # fmt: skip
def test_what_is_missing_is_named(egl, blocked, options, variables, expected):
    if not options and blocked != "pyglet":
        pytest.importorskip("pyglet", reason="windows need pyglet")
    code = (
        f"import sys; sys.modules[{blocked!r}] = None; import novaphy\n"
        f"try: novaphy.ViewerGL({options})\nexcept ImportError as error: print(error)"
    )
    environ = {k: v for k, v in os.environ.items() if k != "DISPLAY"} | variables
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environ)
    assert expected in done.stdout, done.stdout + done.stderr
    assert done.stdout.count("\n") == 1, done.stdout


def test_a_video_without_ffmpeg_says_what_to_install(egl, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with novaphy.ViewerGL(headless=True, **SIZE) as viewer:
        with pytest.raises(RuntimeError, match="apt-get install ffmpeg"):
            viewer.start_video(tmp_path / "a.gif")


def test_nothing_is_imported_before_it_is_needed():
    code = (
        "import sys, novaphy, novaphy.viewer; novaphy.ViewerNull(); "
        "names = ('moderngl', 'pyglet', 'imgui_bundle', 'viser', 'PIL'); "
        "print([m for m in names if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.strip() == "[]", done.stderr


WINDOW = """
import sys, numpy as np, novaphy
sys.modules["imgui_bundle"] = None  # keys and text without a panel
from test_viewer_gl import bodies, show
model = bodies(1)
viewer = novaphy.ViewerGL(width=320, height=240)
viewer.waits = True
viewer.set_model(model)
state = model.state()
frame = show(viewer, state)
assert frame.shape == (240, 320, 3) and len(np.unique(frame.reshape(-1, 3), axis=0)) > 50
window, key = viewer._window, viewer._window.key
screens, flip = [], window.window.flip
window.window.flip = lambda: (screens.append(viewer._context.screen.read(alignment=1)), flip())
frame = show(viewer, state)
assert np.array_equal(np.frombuffer(screens[0], np.uint8).reshape(240, 320, 3)[::-1], frame)
window.on_key_press(key.SPACE, 0)
assert viewer.is_paused() and not viewer.should_step() and viewer.is_key_down("space")
window.on_key_press(key.N, 0)
assert viewer.should_step() and not viewer.should_step()
window.on_key_press(key.R, 0)
assert viewer.reset_requested
window.on_key_press(key.SPACE, 0)
moved = []
value = viewer.add_slider("stiffness", 0.0, 10.0, 2.0, moved.append)
window.on_key_press(key.TAB, 0)
window.on_key_press(key.RIGHT, 0)
assert abs(value() - 2.1) < 1e-9 and moved == [value()]
window.on_key_press(key.LEFT, 0)
assert abs(value() - 2.0) < 1e-9
before = np.count_nonzero(frame != show(viewer, state))
assert before > 50  # its name and number are in the text
distance = viewer.camera.distance
window.on_mouse_scroll(10, 10, 0, 1)
assert viewer.camera.distance < distance
x, y = viewer.camera.project(state.body_q.numpy()[:, :3], 320, 240)[0]
assert window.name_under_pointer() is None
window.on_mouse_motion(int(x), 240 - int(y), 0, 0)
label = f"{model.shape_label[1]} of {model.body_label[0]}"
assert window.name_under_pointer() == label, window.name_under_pointer()
window.on_mouse_leave(0, 0)
assert window.name_under_pointer() is None
window.on_key_press(key.I, 0)
assert viewer.show_inertia
window.on_mouse_press(int(x), 240 - int(y), window.mouse.LEFT, key.MOD_CTRL)
window.on_mouse_drag(int(x) + 40, 240 - int(y), 40, 0, window.mouse.LEFT, key.MOD_CTRL)
viewer.apply_forces(state)
side, above, _ = viewer.camera.axes()
pull = state.body_f.numpy()[0, :3]
assert pull @ side > 1.0 and abs(pull @ above) < 0.05 * (pull @ side), pull
window.on_mouse_release(0, 0, window.mouse.LEFT, 0)
window.on_key_press(key.C, 0)
assert not viewer.show_contacts
poses = state.body_q.numpy()
poses[0, :3] = (0.3, 0.2, 0.7)
state.body_q.assign(poses)
window.on_key_press(key.F, 0)
show(viewer, state)
assert np.allclose(viewer.camera.target, (0.3, 0.2, 0.7), atol=1e-6)
window.on_key_press(key.ESCAPE, 0)
assert not viewer.is_running()
viewer.close()
print("done")
"""

PANEL = """
import numpy as np, novaphy
from test_viewer_gl import bodies, show
model = bodies(1)
viewer = novaphy.ViewerGL(width=640, height=400)
viewer.waits = True
viewer.set_model(model)
state = model.state()
moved = []
value = viewer.add_slider("stiffness", 0.0, 10.0, 2.0, moved.append)
window = viewer._window.window
screens, flip = [], window.flip
window.flip = lambda: (screens.append(viewer._context.screen.read(alignment=1)), flip())
frame = show(viewer, state)
show(viewer, state)
screen = np.frombuffer(screens[-1], np.uint8).reshape(400, 640, 3)[::-1]
changed = (screen != frame).any(axis=2)
changed[:, :320] = False  # where the text is, with times of its own
rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
assert 60 < np.ptp(rows) < 250 and 150 < np.ptp(columns) < 300

def click(x, y, to=None):
    window.dispatch_event("on_mouse_motion", x, 399 - y, 0, 0)
    show(viewer, state)
    window.dispatch_event("on_mouse_press", x, 399 - y, 1, 0)
    show(viewer, state)
    if to is not None:
        window.dispatch_event("on_mouse_drag", to, 399 - y, to - x, 0, 1, 0)
        show(viewer, state)
    window.dispatch_event("on_mouse_release", x if to is None else to, 399 - y, 1, 0)
    show(viewer, state)

camera = (viewer.camera.yaw, viewer.camera.pitch, tuple(viewer.camera.target))
left = int(columns.min()) + 16
for y in range(int(rows.min()) + 24, int(rows.max()), 6):
    click(left, y)
    if viewer.is_paused():
        break
assert viewer.is_paused()
click(left, y)
assert not viewer.is_paused()
for y in range(y + 24, int(rows.max()), 6):
    click(left + 30, y, left + 60)
    if moved:
        break
assert moved and moved[-1] == value() > 2.5, moved
assert camera == (viewer.camera.yaw, viewer.camera.pitch, tuple(viewer.camera.target))
window.dispatch_event("on_mouse_motion", 100, 100, 0, 0)
for _ in range(3):  # imgui takes one event of a kind a frame
    show(viewer, state)
window.dispatch_event("on_mouse_press", 100, 100, 1, 0)
window.dispatch_event("on_mouse_drag", 140, 100, 40, 0, 1, 0)
show(viewer, state)
assert viewer.camera.yaw != camera[0]
viewer.close()
print("done")
"""

CYCLES = """
import os, numpy as np, novaphy
from pathlib import Path
from test_viewer_gl import bodies, show
model = bodies(10)
seen = []
for k in range(24):
    with novaphy.ViewerGL(width=160, height=120) as viewer:
        viewer.waits = True
        viewer.set_model(model)
        show(viewer, model.state())
    if k % 4 == 3:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        seen.append((len(os.listdir("/proc/self/fd")), pages * os.sysconf("SC_PAGE_SIZE")))
descriptors, memory = zip(*seen)
assert descriptors[-1] <= descriptors[0], seen
assert memory[-1] - memory[1] < 16e6, seen  # the map of shadows alone has as much
print("done")
"""

SLOW = """
import types, novaphy
from novaphy.viewer import _gl
from test_viewer_gl import bodies
model = bodies(10)
viewer = novaphy.ViewerGL(width=160, height=120)
viewer.set_model(model)
state = model.state()
clock = types.SimpleNamespace(now=1.0, slept=0.0)
def sleep(seconds):
    clock.now += seconds
    clock.slept += seconds
_gl.time = types.SimpleNamespace(perf_counter=lambda: clock.now, sleep=sleep)
pictures, draw, window = [], viewer.draw, viewer._window
def slow_draw():
    pictures.append(clock.now)
    clock.now += 0.05
    draw()
viewer.draw = slow_draw
finish = window.show_finished
window.show_finished = lambda renderer, wait=False, grace=0.0: finish(renderer, True)
steps = 0
while clock.now < 3.0:
    viewer.begin_frame(steps)
    viewer.log_state(state)
    viewer.end_frame()
    clock.now += 1e-3
    steps += 1
assert len(pictures) == 10 and 1480 < steps < 1520 and clock.slept == 0.0, (len(pictures), steps)
viewer.waits = True
before = len(pictures)
for _ in range(8):
    viewer.end_frame()
assert len(pictures) == before + 8, (before, len(pictures))
viewer.close()
print("done")
"""


@pytest.mark.parametrize(
    ("program", "package"),
    [(WINDOW, "pyglet"), (PANEL, "imgui_bundle"), (CYCLES, "pyglet"), (SLOW, "pyglet")],
    ids=["keys and the pointer", "panel", "opened and closed", "slow"],
)
def test_a_real_window(egl, program, package):
    pytest.importorskip("pyglet")
    pytest.importorskip(package)
    if reason := x_server.why_not():
        pytest.skip(reason)
    with x_server.x_server("800x600") as environ:
        environ["MALLOC_MMAP_THRESHOLD_"] = str(1 << 20)  # freed memory leaves the process
        done = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=300,
            env=environ, cwd=Path(__file__).parent,
        )  # fmt: skip
    assert done.stdout.strip() == "done", done.stdout + done.stderr


def test_a_replay_draws_what_the_run_drew(egl, tmp_path):
    model = bodies(3)
    state = model.state()

    def frames(viewer):
        """Three frames, all drawn to the bit."""
        for k in range(3):
            poses = state.body_q.numpy()
            poses[:, 2] += 0.1
            state.body_q.assign(poses)
            viewer.begin_frame(0.1 * k)
            viewer.log_state(state)
            viewer.log_lines("way", [[0, 0, 0]], [[0, 0, 1 + k]], (0.9, 0.1, 0.1), 0.02)
            viewer.log_scalar("loss", 1.0 / (1 + k))
            viewer.end_frame()

    path = tmp_path / "run.nprec"
    pictures = []
    with novaphy.ViewerFile(path) as record, novaphy.ViewerGL(headless=True, **SIZE) as viewer:

        class Both(viewers.Viewer):
            """Tells both viewers."""

            def __getattribute__(self, name):
                def call(*args, **kwargs):
                    getattr(record, name)(*args, **kwargs)
                    getattr(viewer, name)(*args, **kwargs)
                    if name == "end_frame":
                        pictures.append(viewer.get_frame())

                return call

        both = Both()
        both.set_model(model)
        both.look_at((3.0, -3.0, 2.0), (0.3, 0.0, 0.5))
        frames(both)
    recording = novaphy.ViewerFile(tmp_path / "other.nprec", auto_save=False)
    recording.load_recording(path)
    with novaphy.ViewerGL(headless=True, **SIZE) as again:
        recording.show_start(again)
        for k, picture in enumerate(pictures):
            recording.show_frame(again, k)
            assert np.array_equal(again.get_frame(), picture)
        recording.show_start(again)
        recording.show_frame(again, 1, from_start=True)
        assert np.array_equal(again.get_frame(), pictures[1])
        again.show_text = False
        assert not np.array_equal(again.get_frame(), pictures[1])
