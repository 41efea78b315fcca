"""NOVAPHY_TRACE writes launches as a file that trace viewers read, and costs nothing else."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

RUN = """
import os
import signal
import novaphy
from novaphy import nova

novaphy.set_num_threads(2)
x = nova.tensor([1.0, 2.0, 3.0], requires_grad=True)
with nova.Tape() as tape:
    loss = nova.sum(x * x)
tape.backward(loss)
many = nova.tensor([0.5] * 60000)
with nova.ScopedCapture() as capture:
    for _ in range(20):
        many = nova.mul(many, many)
"""
END = {
    "as it should": "capture.graph.launch()",
    "by _exit": "[nova.mul(x, x) for _ in range(2000)]; os._exit(0)",
    "killed": "[nova.mul(x, x) for _ in range(2000)]; os.kill(os.getpid(), signal.SIGKILL)",
}


def run(code: str, trace: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code]
    return subprocess.run(
        command,
        env=os.environ | {"NOVAPHY_TRACE": trace},
        capture_output=True,
        text=True,
        check=False,
    )


def events(path) -> list[dict]:
    return [e for e in json.loads(path.read_text()) if e["ph"] == "X"]


def test_every_launch_is_an_event(tmp_path):
    path = tmp_path / "trace.json"
    result = run(RUN + END["as it should"], str(path))
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    found = events(path)
    first = found[0]
    assert first["name"] == "mul"
    assert first["args"] == {"rows": 3, "device": "cpu"}
    assert first["pid"] > 0 and first["tid"] > 0
    assert all(e["dur"] >= 0 for e in found)
    assert len({e["pid"] for e in found}) == 1
    names = [e["name"] for e in found]
    assert {"mul", "row_sum", "mul.adjoint"} <= set(names)
    # The replay cuts the rows among the threads: each of the twenty kernels over all rows.
    rows = sum(e["args"]["rows"] for e in found if e["args"]["rows"] > 3)
    assert rows == 20 * 60000


@pytest.mark.parametrize("end", ["by _exit", "killed"])
def test_the_file_is_valid_json_when_the_process_ends_in_the_midst(tmp_path, end):
    path = tmp_path / "trace.json"
    run(RUN + END[end], str(path))
    found = events(path)
    assert 200 < len(found) <= 2000 + 10  # but for the last 64 KiB


def test_a_child_process_leaves_the_file_alone(tmp_path):
    path = tmp_path / "trace.json"
    code = RUN + "nova.mul(x, x)\nif os.fork() == 0:\n    nova.mul(x, x)\n    exit(0)\nos.wait()"
    assert run(code, str(path)).returncode == 0
    assert len({e["pid"] for e in events(path)}) == 1


def test_a_file_that_cannot_be_written_is_an_error(tmp_path):
    path = tmp_path / "no folder" / "trace.json"
    result = run(RUN, str(path))
    assert result.returncode == 1
    message = f'NOVAPHY_TRACE: expected a file that can be written, got "{path}": No such file'
    assert message in result.stderr


def test_ranges_of_a_profiler_need_the_cuda_backend():
    import novaphy

    if novaphy.has_cuda():
        pytest.skip("this build has the CUDA backend")
    result = run(RUN, "nvtx")
    assert result.returncode == 1
    no_backend = "NOVAPHY_TRACE: expected a file, because this build has no CUDA"
    no_library = 'NOVAPHY_TRACE: expected the library of NVTX for "nvtx"'
    assert no_backend in result.stderr or no_library in result.stderr
