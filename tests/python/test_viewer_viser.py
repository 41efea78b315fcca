"""ViewerViser: a real server, and real browsers that look at it."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import browser
import numpy as np
import pytest

import novaphy


@pytest.fixture
def served():
    """A viewer on a free port, with a body and a die of another color."""
    pytest.importorskip("viser")
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for k in range(3):
        body = builder.add_body(xform=((0.5 * k, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)), mass=1.0)
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
        builder.add_shape_capsule(body, radius=0.05, half_height=0.1 + 0.1 * (k % 2))
    model = builder.finalize()
    with novaphy.ViewerViser(port=0, history=50, verbose=False) as viewer:
        viewer.set_model(model)
        yield viewer, model.state()


def frame(viewer, state, t, x):
    """Show a state whose first body is at x."""
    poses = state.body_q.numpy()
    poses[0, 0] = x
    state.body_q.assign(poses)
    viewer.begin_frame(t)
    viewer.log_state(state)
    viewer.log_lines("way", [[0, 0, 0]], [[x, 0, 1]], (1.0, 0.0, 0.0))
    viewer._sent_at = 0.0  # tests do not wait for the rate of a display
    viewer.end_frame()


def test_poses_are_sent_and_past_frames_come_back(served):
    viewer, state = served
    for k in range(10):
        frame(viewer, state, 0.1 * k, 0.2 * k)
    boxes = viewer._page.handles["/model/box"][0].parts
    capsules = viewer._page.handles["/model/capsule"][0].parts
    assert len(boxes) == 1 and len(boxes[0][1]) == 3
    assert [list(rows) for _, rows in capsules] == [[0, 2], [1]]  # two proportions
    assert boxes[0][0].batched_positions[0][0] == pytest.approx(1.8)
    assert "time 0.900 s" in viewer._text.content
    viewer._scrubber.value = 49 - 4
    viewer._scrub()
    assert viewer.is_paused() and boxes[0][0].batched_positions[0][0] == pytest.approx(1.0)
    assert "time 0.500 s" in viewer._text.content
    viewer.pause(False)
    frame(viewer, state, 1.0, 3.0)
    assert boxes[0][0].batched_positions[0][0] == pytest.approx(3.0)
    assert viewer._scrubber.value == 49


def test_an_object_stays_when_another_with_its_name_in_front_changes(served, recwarn):
    viewer, state = served
    for k in range(3):
        viewer.log_lines("way", [[0, 0, 0]], [[1 + k, 0, 0]], (1, 0, 0))
        if k == 0:
            viewer.log_lines("way/earlier", [[0, 0, 0]], [[0, 1, 0]], (0, 0, 1))
        viewer.log_arrows("force", [[0, 0, 0]], [[0, 0, 1.0 + k]], (0, 1, 0))
        frame(viewer, state, 0.1 * k, 0.0)
    for name in ("/way", "/way/earlier", "/force", "/force/heads"):
        ((handle, _),) = viewer._page.handles[name][0].parts
        assert not handle._impl.removed, name
    assert not [w for w in recwarn if "removed" in str(w.message)]


def test_two_browsers_see_the_scene_and_move_a_slider(served):
    if reason := browser.why_not():
        pytest.skip(reason)
    viewer, state = served
    moved = []
    mass = viewer.add_slider("mass", 0.0, 10.0, 2.0, moved.append)
    assert mass() == 2.0
    frame(viewer, state, 0.0, 0.0)
    with browser.Browser(640, 480) as one, browser.Browser(640, 480) as other:
        pages = [chromium.page(viewer.url) for chromium in (one, other)]
        end = time.monotonic() + 120.0
        while viewer.client_count < 2 and time.monotonic() < end:
            time.sleep(0.2)
        assert viewer.client_count == 2
        for page in pages:
            page.wait_for("document.body.innerText.includes('mass')")
            page.wait_for("document.querySelector('canvas') !== null")
        find = (
            "[...document.querySelectorAll('[role=slider]')]"
            ".find(s => s.getAttribute('aria-valuemax') === '10')"
        )
        box = pages[0].wait_for(
            f"(() => {{ const s = {find}; if (!s) return null; s.focus(); return true; }})()", 60.0
        )
        assert box
        for kind in ("keyDown", "keyUp"):
            pages[0].call(
                "Input.dispatchKeyEvent", type=kind, key="ArrowRight", code="ArrowRight",
                windowsVirtualKeyCode=39,
            )  # fmt: skip
        end = time.monotonic() + 120.0
        while not moved and time.monotonic() < end:
            time.sleep(0.1)
        assert moved and mass() == moved[-1] == pytest.approx(2.01)
        mass.set(7.0)  # and the other way, in every browser
        for page in pages:
            page.wait_for(f"{find}.getAttribute('aria-valuenow') === '7'")
        assert mass() == 7.0
        find = "[...document.querySelectorAll('button')].find(b => b.innerText === 'reset')"
        pages[1].evaluate(f"{find}.click()")
        end = time.monotonic() + 120.0
        while not viewer.reset_requested and time.monotonic() < end:
            time.sleep(0.1)
        assert viewer.reset_requested
        viewer.follow(0)  # every camera goes along, from where it is
        frame(viewer, state, 1.0, 0.0)
        cameras = [client.camera for client in viewer._server.get_clients().values()]
        before = [(camera.position.copy(), camera.look_at.copy()) for camera in cameras]
        frame(viewer, state, 2.0, 1.5)
        for camera, (position, look_at) in zip(cameras, before, strict=True):
            np.testing.assert_allclose(camera.position - position, (1.5, 0.0, 0.0), atol=1e-3)
            np.testing.assert_allclose(camera.look_at - look_at, (1.5, 0.0, 0.0), atol=1e-3)


def test_a_body_moves_in_the_page_as_projected():
    pytest.importorskip("viser")
    image = pytest.importorskip("PIL.Image")
    if reason := browser.why_not():
        pytest.skip(reason)
    builder = novaphy.ModelBuilder()
    body = builder.add_body(mass=1.0)
    builder.add_shape_sphere(body, radius=0.15)
    model = builder.finalize()
    state = model.state()
    with (
        novaphy.ViewerViser(port=0, verbose=False) as viewer,
        browser.Browser(1000, 600) as chromium,
    ):
        viewer.set_model(model)
        viewer.set_shape_colors([0], (0.9, 0.1, 0.1))
        viewer.look_at((0.0, -5.0, 1.0), (0.0, 0.0, 0.5))
        page = chromium.page(viewer.url)
        page.wait_for("document.querySelector('canvas') !== null")
        for k, place in enumerate([(-0.6, 0.0, 0.2), (0.2, 0.3, 0.0), (-0.2, -0.4, -0.2)]):
            poses = state.body_q.numpy()
            poses[0, :3] = place
            state.body_q.assign(poses)
            viewer.begin_frame(0.1 * k)
            viewer.log_state(state)
            viewer._sent_at = 0.0
            viewer.end_frame()
            x, y = viewer.camera.project(poses[:, :3], 1000, 600)[0]
            away, end = 1e9, time.monotonic() + 120.0
            while away >= 2.0 and time.monotonic() < end:
                time.sleep(0.5)
                png = io.BytesIO(page.picture())
                rgb = np.asarray(image.open(png).convert("RGB")).astype(int)[240:]
                red = (rgb[..., 0] > 1.6 * rgb[..., 1]) & (rgb[..., 0] > 60)
                red[:, :120] = False  # where the page has axes of its own
                rows, columns = np.nonzero(red)
                if len(rows) > 100:
                    away = max(abs(columns.mean() - x), abs(rows.mean() + 240 - y))
            assert away < 2.0, (k, away)


def test_a_strong_checker_is_black_and_white_in_the_page():
    pytest.importorskip("viser")
    image = pytest.importorskip("PIL.Image")
    if reason := browser.why_not():
        pytest.skip(reason)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    with (
        novaphy.ViewerViser(port=0, verbose=False) as viewer,
        browser.Browser(640, 480) as chromium,
    ):
        viewer.set_model(builder.finalize())
        viewer.set_shape_colors([0], [(0.95, 0.95, 0.95, 0.9)])
        viewer.look_at((0.3, -5.0, 4.0), (0.3, 0.0, 0.0))
        viewer.begin_frame(0.0)
        viewer.end_frame()
        page = chromium.page(viewer.url)
        page.wait_for("document.querySelector('canvas') !== null")
        shares, end = (0.0, 0.0), time.monotonic() + 120.0
        while min(shares) < 0.35 and time.monotonic() < end:
            time.sleep(0.5)
            png = io.BytesIO(page.picture())
            gray = np.asarray(image.open(png).convert("L"))[240:, 120:400]
            shares = float(np.mean(gray < 40)), float(np.mean(abs(gray - 242.0) < 4.0))
        assert min(shares) > 0.35, shares  # the rest are edges


def test_a_pointer_in_the_page_pulls_a_body():
    pytest.importorskip("viser")
    image = pytest.importorskip("PIL.Image")
    if reason := browser.why_not():
        pytest.skip(reason)
    builder = novaphy.ModelBuilder()
    for k in range(3):
        body = builder.add_body(xform=((0.5 * k, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0)), mass=1.0)
        builder.add_shape_box(body, hx=0.15, hy=0.15, hz=0.15)
    model = builder.finalize()
    state = model.state()
    with (
        novaphy.ViewerViser(port=0, verbose=False) as viewer,
        browser.Browser(640, 480) as chromium,
    ):
        viewer.set_model(model)
        viewer.look_at((0.5, -2.5, 1.2), (0.5, 0.0, 0.5))
        frame(viewer, state, 0.0, 0.0)
        page = chromium.page(viewer.url)
        page.wait_for("document.querySelector('canvas') !== null")
        x, y = viewer.camera.project(state.body_q.numpy()[:1, :3], 640, 480)[0]

        def mouse(kind, right, **more):
            page.call(
                "Input.dispatchMouseEvent", type=kind, x=float(x + right), y=float(y),
                modifiers=2, **more,
            )  # fmt: skip

        page.call(
            "Input.dispatchKeyEvent", type="keyDown", key="Control", code="ControlLeft",
            windowsVirtualKeyCode=17, modifiers=2,
        )  # fmt: skip
        end, color = time.monotonic() + 120.0, (0, 0, 0)
        while color[2] - color[0] < 60 and time.monotonic() < end:  # until the page draws it, blue
            time.sleep(0.5)
            png = io.BytesIO(page.picture())
            color = image.open(png).convert("RGB").getpixel((round(x), round(y)))
        while viewer._drag.item is None and time.monotonic() < end:
            mouse("mouseReleased", 0.0, button="left", clickCount=1)
            mouse("mouseMoved", 0.0)
            time.sleep(0.5)
            mouse("mousePressed", 0.0, button="left", buttons=1, clickCount=1)
            for k in range(1, 7):
                time.sleep(0.3)
                mouse("mouseMoved", -10.0 * k, button="left", buttons=1)
        assert viewer._drag.item == ("body", 0)
        viewer.apply_forces(state)
        pull = state.body_f.numpy()
        side, above, _ = viewer.camera.axes()
        assert pull[0, :3] @ side < -1.0 and not pull[1:].any()
        assert abs(pull[0, :3] @ above) < 0.2 * abs(pull[0, :3] @ side)
        mouse("mouseReleased", -60.0, button="left", clickCount=1)
        end = time.monotonic() + 120.0
        while viewer._drag.item is not None and time.monotonic() < end:
            time.sleep(0.1)
        assert viewer._drag.item is None
        with pytest.raises(NotImplementedError, match="keys"):
            viewer.is_key_down("space")


def taken() -> tuple[int, int, int]:
    """Descriptors, threads and bytes of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    descriptors, threads = len(os.listdir("/proc/self/fd")), threading.active_count()
    return descriptors, threads, pages * os.sysconf("SC_PAGE_SIZE")


def test_opening_and_closing_frees_what_it_took():
    pytest.importorskip("viser")
    seen = []
    for _ in range(22):
        with novaphy.ViewerViser(port=0, verbose=False) as viewer:
            viewer.log_points("point", [[0, 0, 0]], 0.1)
            viewer._sent_at = 0.0
            viewer.end_frame()
        time.sleep(0.1)
        seen.append(taken())
    end = time.monotonic() + 20.0  # its threads end by themselves
    while max(np.subtract(taken(), seen[1])[:2]) > 2 and time.monotonic() < end:
        time.sleep(0.1)
    assert max(np.subtract(taken(), seen[1])[:2]) <= 2, seen
    assert taken()[2] - seen[3][2] < 60e6, seen


def is_free(port: int) -> bool:
    """Whether a port can be taken, within some seconds."""
    end = time.monotonic() + 20.0
    while True:
        with socket.socket() as again:
            again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                again.bind(("127.0.0.1", port))
                return True
            except OSError:
                if time.monotonic() > end:
                    return False
        time.sleep(0.1)


def test_a_port_that_is_taken_gives_way_to_the_next():
    pytest.importorskip("viser")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with novaphy.ViewerViser(port=port, verbose=False) as viewer:
            assert port < viewer.port < port + 10
            used = viewer.port
        assert is_free(used)  # close() freed it
    with pytest.raises(OSError, match="no address of this machine"):
        novaphy.ViewerViser(host="203.0.113.1", verbose=False)
    with pytest.raises(ValueError, match="port"):
        novaphy.ViewerViser(port=70000)


def test_the_page_is_for_this_machine_unless_told_otherwise(capsys):
    pytest.importorskip("viser")
    with novaphy.ViewerViser(port=0) as viewer:
        assert viewer._server.get_host() == "127.0.0.1"
    assert "for this machine only" in capsys.readouterr().out


def test_a_missing_package_is_named():
    code = (
        "import sys; sys.modules['viser'] = None; import novaphy\n"
        "try: novaphy.ViewerViser()\nexcept ImportError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "pip install 'novaphy[web]'" in done.stdout, done.stderr
