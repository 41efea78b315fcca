"""``python -m novaphy.backend_check dlan``: what it says without a device, and with one."""

from __future__ import annotations

import subprocess
import sys

import pytest

import novaphy
from novaphy._command import demos
from novaphy.backend_check import DEMOS


def run_check(folder, *options: str) -> tuple[int, str]:
    """The exit code, and the report."""
    report = folder / "report.txt"
    command = [sys.executable, "-m", "novaphy.backend_check", "dlan", "--report", str(report)]
    done = subprocess.run([*command, *options], capture_output=True, text=True, check=False)
    assert report.exists(), done.stderr
    text = report.read_text("utf-8")
    assert text in done.stdout
    return done.returncode, text


def test_without_a_device_the_report_says_why(tmp_path):
    if novaphy.is_device_available("dlan:0"):
        pytest.skip("there is a dlan device")
    code, text = run_check(tmp_path, "--kernels", str(tmp_path / "kernels.so"))
    assert code == 1
    if novaphy.build_info()["NOVAPHY_WITH_DLAN"]:
        assert "[FAILED] kernels compile" in text and "no compiler dlcc" in text
    else:
        assert "[FAILED] the backend is there: configure the build with NOVAPHY_WITH_DLAN" in text
    assert text.splitlines()[-1].startswith("1 failed; ")


@pytest.mark.parametrize("demo", DEMOS)
def test_as_many_iterations_as_it_asks_for_pass_on_the_cpu(demo):
    """Else the device is not reached."""
    pytest.importorskip("novaphy.diff")
    if demo == "vbd" and not novaphy.has_vbd():
        pytest.skip("built with NOVAPHY_BUILD_VBD=OFF")
    command = [sys.executable, str(demos()[demo]), "--headless", str(DEMOS[demo])]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.skipif(
    not novaphy.is_device_available("dlan:0"),
    reason="; ".join(f"{b.path}: {b.error}" for b in novaphy.backends() if b.name == "dlan")
    or "this build has no Denglin backend",
)
@pytest.mark.parametrize("demo", DEMOS)
def test_demos_have_the_bits_of_the_cpu(demo, tmp_path):
    options = ["--conformance", "/nowhere", "--demos", demo, "--iterations", "1"]
    code, text = run_check(tmp_path, *options)
    assert code == 0, text
    if demo == "vbd" and not novaphy.build_info()["NOVAPHY_WITH_VBD_DLAN"]:
        assert "[not run] demo vbd" in text
    else:
        assert f"[passed] demo {demo} has the bits of the CPU" in text
    assert text.splitlines()[-1] == "0 failed"
