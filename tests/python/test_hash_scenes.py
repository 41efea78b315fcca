"""What the comparison of hashes of scenes (the step `hashes` of --all) says."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools" / "bench"))


def test_a_hash_that_differs_is_named():
    import hash_scenes

    golden = {"ball | states": "0123456789abcdef", "pile | states": "1"}
    same = ["ball | states | 0123456789abcdef"]
    assert hash_scenes.differences("cpu", same, golden) == []
    other = ["ball | states | 0123456789abcdee", "dice | states | 0"]
    assert hash_scenes.differences("cpu", other, golden) == [
        "cpu: ball | states: expected 0123456789abcdef, got 0123456789abcdee",
        "cpu: dice | states: expected no line, got 0",
    ]
    assert hash_scenes.differences("cpu", ["ball | gradients | 2"], golden) == [
        "cpu: ball | states: expected 0123456789abcdef, got none",
        "cpu: ball | gradients: expected no line, got 2",
    ]


def test_a_line_without_a_scene_is_no_line():
    import hash_scenes

    lines = hash_scenes.GOLDEN.read_text(encoding="utf-8").splitlines()
    assert {line.split(" | ")[0] for line in lines} == set(hash_scenes.SCENES)
