"""ViewerHTML: the page in a real browser."""

from __future__ import annotations

import io
import json
import re
import time

import browser
import numpy as np
import pytest
from scenes import DT, Ball
from test_viewer_scene import WAY, walk

import novaphy


@pytest.fixture(scope="module")
def page_file(tmp_path_factory):
    """Two takes of 21 frames; returns the file and the rollout."""
    ball = Ball(steps=20)
    ball.forward()
    path = tmp_path_factory.mktemp("page") / "run.html"
    with novaphy.ViewerHTML(path, title="a </script> run") as viewer:
        viewer.set_model(ball.model)
        for take in range(2):
            viewer.log_scalar("loss", 1.0 / (1 + take))
            color = (0.1, 0.1, 0.9) if take else (0.1, 0.7, 0.1)
            viewer.log_lines(f"path/{take}", [[-1, 0, 1]], [[1, 0, 1 + take]], color, 0.05)
            for k, state in enumerate(ball.states):
                viewer.begin_frame(k * DT)
                viewer.log_state(state)
                viewer.end_frame()
    return path, ball


@pytest.fixture(scope="module")
def chromium():
    """A browser, where there is one."""
    if reason := browser.why_not():
        pytest.skip(reason)
    with browser.Browser(640, 480) as started:
        yield started


def pixels(png: bytes) -> np.ndarray:
    """The picture {h, w, 3}."""
    image = pytest.importorskip("PIL.Image")
    return np.asarray(image.open(io.BytesIO(png)).convert("RGB"))


def test_the_page_is_one_small_file(page_file):
    path, _ = page_file
    text = path.read_text("utf-8")
    assert len(text) < 300_000
    assert "http://" not in text and "https://" not in text and "src=" not in text


def test_the_page_replays_the_run(page_file, chromium):
    path, ball = page_file
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined && times.length === 42")
    page.evaluate("play(false)")
    assert page.evaluate("document.getElementById('error').textContent") == ""
    assert page.evaluate("document.title") == "a </script> run"
    assert page.evaluate("takes") == [0, 21]
    for frame in (0, 13, 20, 34):
        page.evaluate(f"show_frame({frame})")
        shown = page.evaluate("[...state.instances['model/particles'].fields.poses.values]")
        expected = ball.states[frame % 21].particle_q.numpy()[0]
        np.testing.assert_array_equal(np.float32(shown[:3]), expected)
    page.evaluate("document.getElementById('take').value = 1")
    page.evaluate("document.getElementById('take').oninput({target: {value: '1'}})")
    assert page.evaluate("frame") == 21
    assert "loss 0.5" in page.evaluate("document.getElementById('text').textContent")
    page.evaluate("document.getElementById('play').onclick()")
    page.wait_for("frame !== 21")


def test_the_page_draws_the_lines_of_both_takes(page_file, chromium):
    path, _ = page_file
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined && times.length === 42")
    page.evaluate("play(false)")

    def counts(frame):
        page.evaluate(f"show_frame({frame})")
        page.wait_for("!dirty")
        rgb = pixels(page.picture()).astype(int)
        blue = (rgb[..., 2] > 180) & (rgb[..., 1] < 80) & (rgb[..., 0] < 80)
        green = (rgb[..., 1] > 140) & (rgb[..., 0] < 80) & (rgb[..., 2] < 80)
        background = np.abs(rgb - [237, 241, 245]).max(axis=2) < 6
        return np.count_nonzero(blue), np.count_nonzero(green), np.mean(background)

    blue, green, background = counts(5)
    assert blue == 0 and green > 100 and background < 0.95
    blue, green, _ = counts(30)
    assert blue > 100 and green > 100


def wave(k: int) -> np.ndarray:
    """Points {400, 3} of a sheet at frame k."""
    x, y = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 20), indexing="ij")
    z = 0.2 * np.sin(3.0 * x + 0.1 * k) * np.cos(2.0 * y - 0.07 * k)
    return np.float32(np.stack([x + 1e-3 * k, y, z], axis=-1).reshape(-1, 3))


def test_what_moves_is_packed_and_comes_back_below_a_pixel(tmp_path, chromium):
    cells = np.arange(400).reshape(20, 20)
    a, b, c, d = (part.ravel() for part in (cells[:-1, :-1], cells[1:, :-1], cells[1:, 1:],
                                            cells[:-1, 1:]))  # fmt: skip
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    turns = np.float32([[np.sin(0.05 * k), 0, 0, np.cos(0.05 * k)] for k in range(90)])
    path = tmp_path / "run.html"
    with novaphy.ViewerHTML(path) as viewer:
        viewer.look_at((0, -3, 2), (0, 0, 0))
        for k in range(90):
            viewer.begin_frame(k % 45)  # two takes
            viewer.log_mesh("sheet", wave(k), triangles)
            pose = np.float32([[0, 0, 0.02 * k, *turns[k]]])
            viewer.log_shapes("die", novaphy.GeoType.BOX, (0.1, 0.1, 0.1), pose)
            viewer.end_frame()
    data = 90 * 400 * 3 * 4
    assert path.stat().st_size < 40_000 + data / 4
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined && times.length === 90")
    page.evaluate("play(false)")
    height = 2 * np.sqrt(13.0) * np.tan(np.radians(20))  # m, of the picture where it looks
    for frame in (0, 1, 44, 45, 60, 89):
        page.evaluate(f"show_frame({frame})")
        shown = page.evaluate("[...state.mesh.sheet.fields.points.values]")
        away = np.abs(np.reshape(shown, (-1, 3)) - wave(frame)).max()
        assert 0.0 < away <= 0.5 * height / 2**14 * 1.01
        pose = page.evaluate("[...state.instances.die.fields.poses.values]")
        assert pose[2] == pytest.approx(0.02 * frame, abs=height / 2**14)
        np.testing.assert_allclose(pose[3:], turns[frame], atol=2.0**-16 + 1e-7)


def test_a_body_moves_in_the_page_as_projected(tmp_path, chromium):
    path = tmp_path / "run.html"
    places = np.float32([(-0.8, 0.0, 0.3), (0.5, 0.4, 0.9), (0.9, -0.6, 0.2)])
    with novaphy.ViewerHTML(path) as viewer:
        viewer.look_at((0.5, -6.0, 2.0), (0.0, 0.0, 0.5))
        for k, place in enumerate(places):
            viewer.begin_frame(k)
            viewer.log_points("ball", [place], 0.15, (0.9, 0.1, 0.1))
            viewer.end_frame()
        expected = viewer.camera.project(places, 640, 480)
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined && times.length === 3")
    page.evaluate("play(false)")
    page.evaluate("for (const id of ['info', 'bar']) by_id(id).style.display = 'none'")
    for k, (x, y) in enumerate(expected):
        page.evaluate(f"show_frame({k})")
        page.wait_for("!dirty")
        rgb = pixels(page.picture()).astype(int)
        rows, columns = np.nonzero((rgb[..., 0] > 2 * rgb[..., 1]) & (rgb[..., 0] > 60))
        assert len(rows) > 200
        assert abs(columns.mean() - x) < 2.0 and abs(rows.mean() - y) < 2.0


def test_the_view_of_the_page_goes_along_with_a_body(tmp_path, chromium):
    path = tmp_path / "walk.html"
    with novaphy.ViewerHTML(path) as viewer:
        walk(viewer, WAY)
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined")
    page.evaluate("play(false)")
    for turned in (0.0, 10.0):
        page.evaluate(f"view.yaw += {turned}")  # the user's hand stays
        yaw = page.evaluate("view.yaw")
        for frame, target in ((1, (0.5, 0.2)), (2, (3.0, -1.0)), (0, (0.0, 0.0))):
            page.evaluate(f"show_frame({frame})")
            assert page.evaluate("view.target") == pytest.approx([*target, 0.5], abs=2e-3)
        assert page.evaluate("view.yaw") == yaw


def test_a_thousand_bodies_are_three_draw_calls_of_the_page(tmp_path, chromium):
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane()
    for k in range(1000):
        place = (0.4 * (k % 40), 0.4 * (k // 40), 0.5)
        body = builder.add_body(xform=(place, (0.0, 0.0, 0.0, 1.0)), mass=1.0)
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize()
    path = tmp_path / "run.html"
    with novaphy.ViewerHTML(path) as viewer:
        viewer.set_model(model)
        viewer.begin_frame(0.0)
        viewer.log_state(model.state())
        viewer.end_frame()
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined && !dirty")
    code = (
        "(() => { let n = 0; for (const f of ['drawElementsInstanced', 'drawArraysInstanced']) {"
        " const real = gl[f].bind(gl); gl[f] = (...a) => { ++n; real(...a); }; }"
        " draw(); return n; })()"
    )
    assert page.evaluate(code) == 3  # the shadow of the boxes, the boxes, the ground
    rgb = pixels(page.picture()).astype(int)
    assert np.mean(np.abs(rgb - [237, 241, 245]).max(axis=2) > 12) > 0.05


def test_numbers_that_fit_no_grid_are_kept_as_they_are(tmp_path, chromium):
    far = np.float32(np.random.default_rng(1).normal(size=(4, 100, 3)) * 1e6)
    far[2, 7, 1] = np.inf
    path = tmp_path / "run.html"
    with novaphy.ViewerHTML(path) as viewer:
        viewer.look_at((0, -3, 2), (0, 0, 0))
        for k in range(4):
            viewer.begin_frame(k)
            viewer.log_lines("far", far[k], far[k] + 1, (1, 0, 0))
            viewer.end_frame()
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined && times.length === 4")
    page.evaluate("play(false); show_frame(2)")
    shown = page.evaluate("[...state.lines.far.fields.starts.values].map(String)")
    np.testing.assert_array_equal(
        np.float32([float(v.replace("Infinity", "inf")) for v in shown]), far[2].ravel()
    )


def test_images_and_curves_of_arrays_are_beside_the_text(tmp_path, chromium):
    path = tmp_path / "run.html"
    image = np.zeros((20, 30, 3), np.uint8)
    image[:, 15:] = (250, 10, 20)
    with novaphy.ViewerHTML(path) as viewer:
        for k in range(3):
            viewer.begin_frame(k)
            viewer.log_points("point", [[0, 0, 0.1 * k]], 0.1)
            if k == 1:
                viewer.log_image("camera", image)
                viewer.log_array("angles", [1.0, -2.0, 4.0])
            if k == 2:
                viewer.log_image("camera", image[:, ::-1])
            viewer.end_frame()
    page = chromium.page(path.as_uri())
    page.wait_for("typeof floats !== 'undefined' && floats !== undefined && times.length === 3")
    page.evaluate("play(false); show_frame(0)")
    text = "[...document.querySelectorAll('figure')].map(f => f.style.display + f.innerText)"
    assert page.evaluate(text) == ["noneangles", "nonecamera"]
    page.evaluate("show_frame(1)")
    assert page.evaluate(text) == ["angles", "camera"]
    lines = "document.querySelector('figure polyline').getAttribute('points')"
    places = [tuple(map(float, p.split(","))) for p in page.evaluate(lines).split()]
    np.testing.assert_allclose(places, [(4, 35), (110, 64), (216, 6)])
    for frame, side in ((1, 20), (2, 5)):
        page.evaluate(f"show_frame({frame})")
        size = "(i => i.complete && i.naturalWidth && [i.naturalWidth, i.naturalHeight])"
        assert page.wait_for(f"{size}(document.querySelector('figure img'))") == [30, 20]
        color = (
            "(c => (c.drawImage(document.querySelector('figure img'), 0, 0), "
            f"[...c.getImageData({side}, 5, 1, 1).data]))"
            "(document.createElement('canvas').getContext('2d'))"
        )
        assert page.evaluate(color) == [250, 10, 20, 255]


def test_a_scalar_that_is_not_finite_is_a_gap_and_the_page_stays_readable(tmp_path):
    path = tmp_path / "run.html"
    with novaphy.ViewerHTML(path) as viewer:
        viewer.begin_frame(0.0)
        viewer.log_points("point", [[0, 0, 0]], 0.1)
        viewer.log_scalar("loss", float("nan"))
        viewer.end_frame()
    text = re.search(r'id="content"[^>]*>(.*?)</script>', path.read_text("utf-8"), re.DOTALL)[1]

    def refuse(constant):
        raise AssertionError(constant)

    assert json.loads(text, parse_constant=refuse)["scalars"] == {"loss": [None]}


def test_a_page_without_a_folder_is_refused(tmp_path):
    with pytest.raises(ValueError, match="folder"):
        novaphy.ViewerHTML(tmp_path / "nowhere" / "run.html")


def test_a_notebook_shows_the_page_in_a_frame(page_file, tmp_path, chromium):
    _, ball = page_file
    viewer = novaphy.ViewerFile(tmp_path / "run.nprec", auto_save=False)
    viewer.set_model(ball.model)
    for k, state in enumerate(ball.states):
        viewer.begin_frame(k * DT)
        viewer.log_state(state)
        viewer.end_frame()
    notebook = tmp_path / "notebook.html"
    notebook.write_text(f"<!DOCTYPE html><body>{viewer._repr_html_()}</body>", "utf-8")
    page = chromium.page(notebook.as_uri())
    page.wait_for("document.querySelector('iframe') !== null")

    def drawn():
        rgb = pixels(page.picture()).astype(int)[:400, 200:]
        return np.mean(np.abs(rgb - [237, 241, 245]).max(axis=2) > 12)

    end = time.monotonic() + 120.0
    while not 0.01 < drawn() < 0.9 and time.monotonic() < end:
        time.sleep(0.5)
    assert 0.01 < drawn() < 0.9


def test_a_notebook_shows_the_page(page_file, tmp_path):
    viewer = novaphy.ViewerHTML(tmp_path / "run.html")
    viewer.begin_frame(0.0)
    viewer.end_frame()
    inline = viewer._repr_html_()
    assert (
        inline.startswith("<iframe srcdoc=") and "&lt;canvas" in inline and "<canvas" not in inline
    )
