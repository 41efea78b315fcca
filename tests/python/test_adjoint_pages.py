"""Pages of an adjoint record: the time axis of a gradient, and the arrows of contacts."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import browser
import numpy as np
import pytest

import novaphy

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


def test_the_length_of_arrows_is_checked(run: Any) -> None:
    with pytest.raises(ValueError, match="log_adjoint_record, length: expected > 0, got 0"):
        novaphy.ViewerHTML(None).log_adjoint_record(run.record, length=0.0)
