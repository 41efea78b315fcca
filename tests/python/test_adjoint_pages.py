"""Pages of an adjoint record: the time axis of a gradient, and the arrows of contacts."""

from __future__ import annotations

import copy
import json
import re
from pathlib import Path
from typing import Any

import browser
import numpy as np
import pytest

import novaphy
from novaphy.viewer._adjoint import log_arrows_between

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")


@pytest.fixture(scope="module")
def run() -> Any:
    from test_adjoint_record import Hit, balls

    return Hit(balls(offset=0.05))


@pytest.fixture(scope="module")
def page_file(run: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A replay of every fifth state, with the record."""
    path = tmp_path_factory.mktemp("adjoint") / "hit.html"
    with novaphy.ViewerHTML(path, title="hit") as viewer:
        viewer.set_model(run.model)
        viewer.log_adjoint_record(run.record, length=0.2)
        for k in range(0, run.steps + 1, 5):
            viewer.begin_frame(run.record.boundaries[k]["time"])
            viewer.log_state(run.path[k])
            viewer.end_frame()
    return path


def test_the_page_has_the_record_and_arrows_in_the_frame_of_the_hit(
    page_file: Path, run: Any
) -> None:
    text = page_file.read_text("utf-8")
    assert len(text) < 120_000 and "https://" not in text and "src=" not in text
    found = re.search(r"const record = (\{.*?\});\n", text)
    assert found is not None
    content = json.loads(found.group(1))
    assert len(content["boundaries"]) == run.steps + 1 and len(content["contacts"]) == 1
    assert content["suspects"][0]["step"] == run.record.contacts[0]["step"]


def test_a_click_shows_the_step_the_pair_and_what_it_carried(page_file: Path, run: Any) -> None:
    if reason := browser.why_not():
        pytest.skip(reason)
    with browser.Browser(800, 600) as chromium:
        page = chromium.page(page_file.as_uri())
        page.wait_for("typeof adjoint !== 'undefined' && typeof floats !== 'undefined' && floats")
        contact = run.record.contacts[0]
        step, last = contact["step"], run.steps
        page.evaluate(
            """(part => {
          const svg = document.querySelector('#adjoint svg'), box = svg.getBoundingClientRect();
          svg.dispatchEvent(new MouseEvent('click', { clientX: box.left + part * box.width }));
        })"""
            + f"({step / last})"
        )
        shown = page.evaluate("document.querySelector('#adjoint pre').textContent")
        assert f"step {step} " in shown and "suspect: missed event" in shown
        pair = f"shapes {contact['shape0']} and {contact['shape1']}"
        carried = re.search(pair + r" at .* carried ([-0-9.e]+)", shown)
        assert carried is not None and abs(float(carried.group(1)) - contact["carried"]) < 1e-3
        assert page.evaluate("playing") is False
        # Arrows are in the first frame that is not before the start of the step.
        frame = -(-step // 5)
        assert page.evaluate("frame") == frame
        lines = page.evaluate("[...state.lines['adjoint/impulse'].fields.starts.values]")
        assert np.allclose(lines[:3], contact["point"], atol=1e-3)
        page.evaluate(f"show_frame({frame + 3})")
        assert page.evaluate("state.lines['adjoint/impulse'].fields.starts.values.length") == 0
        assert len(page.picture()) > 5_000


@pytest.mark.parametrize("length", [0.0, float("inf"), float("nan")])
def test_the_record_and_the_length_of_arrows_are_checked(run: Any, length: float) -> None:
    expected = "log_adjoint_record, length: expected > 0 and finite, got"
    with pytest.raises(ValueError, match=expected):
        novaphy.ViewerHTML(None).log_adjoint_record(run.record, length=length)
    with pytest.raises(TypeError, match="record: expected an AdjointRecord .*, got int"):
        novaphy.ViewerHTML(None).log_adjoint_record(3)


def test_a_gradient_that_is_not_finite_has_no_arrow_and_the_others_keep_theirs(run: Any) -> None:
    record, good = copy.copy(run.record), run.record.contacts[0]
    record.contacts = [dict(good, adjoint=[np.nan, 0.0, 0.0]), good]
    viewer = novaphy.ViewerHTML(None)
    viewer.set_model(run.model)
    log_arrows_between(viewer, record, -np.inf, np.inf, 0.2)
    lines = viewer.scene.lines["adjoint/adjoint"]
    along = np.asarray(lines.ends.values)[:2] - np.asarray(lines.starts.values)[:2]
    np.testing.assert_allclose(np.linalg.norm(along, axis=1), [0.0, 0.2], atol=1e-6)


@pytest.fixture
def window(run: Any) -> Any:
    """A ViewerGL without a display, with the record and the frames until the hit."""
    try:
        viewer = novaphy.ViewerGL(640, 480, headless=True)
    except ImportError as error:
        pytest.skip(str(error))
    with viewer:
        viewer.set_model(run.model)
        viewer.look_at((0.3, -1.5, 0.5), (0.1, 0.0, 0.0))
        viewer.log_adjoint_record(run.record, length=0.2)
        yield viewer


def show(viewer: Any, run: Any, step: int) -> np.ndarray:
    """The picture of a step."""
    viewer.begin_frame(run.record.boundaries[step]["time"])
    viewer.log_state(run.path[step])
    viewer.end_frame()
    return viewer.get_frame()


def test_the_axis_over_a_picture_marks_the_suspect_and_follows_a_click(
    window: Any, run: Any
) -> None:
    contact = run.record.contacts[0]
    step, last = contact["step"], run.steps
    column = round(18 + 503 * step / last)  # of the suspect: the axis begins at 18 pixels
    picture = show(window, run, 0).astype(int)[18:122]
    red = (picture[..., 0] - picture[..., 2]).max(axis=0)
    assert red[column] > 120 and np.all(np.delete(red[18:520], column - 18) < 60)

    starts = lambda: window.scene.lines["adjoint/impulse"].starts.values  # noqa: E731
    assert len(starts()) == 0
    assert not window.select_step_at(column, 5) and window.selected_step is None
    assert window.select_step_at(column + 3, 60)  # a mark is easy to hit
    assert window.selected_step == step and window.is_paused()
    selected = show(window, run, step)
    np.testing.assert_allclose(starts()[0], contact["point"], atol=1e-6)
    assert np.array_equal(show(window, run, step), selected)  # while paused, too
    lines = window._axis.lines(step)
    assert lines[0].startswith(f"step {step} ") and "suspect: missed event" in lines[1]
    assert f"carried {contact['carried']:.4g}" in lines[3]
    window.pause(False)
    assert window.selected_step is None


def test_arrows_of_a_picture_are_those_of_the_steps_since_the_last_one(
    window: Any, run: Any
) -> None:
    step = run.record.contacts[0]["step"]
    counts = []
    for k in (0, step - 1, step + 2, step + 2, step + 4):
        show(window, run, k)
        counts.append(len(window.scene.lines["adjoint/impulse"].starts.values))
    assert counts == [0, 0, 1, 1, 0]
