"""ViewerHTML: the page in a real browser."""

from __future__ import annotations

import io
import json
import re

import browser
import numpy as np
import pytest
from scenes import DT, Ball

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


def test_a_notebook_shows_the_page(page_file, tmp_path):
    viewer = novaphy.ViewerHTML(tmp_path / "run.html")
    viewer.begin_frame(0.0)
    viewer.end_frame()
    inline = viewer._repr_html_()
    assert (
        inline.startswith("<iframe srcdoc=") and "&lt;canvas" in inline and "<canvas" not in inline
    )
