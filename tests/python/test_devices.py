"""Devices, backends and what the build says about itself."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

import novaphy


def run(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python code in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        timeout=120,
    )


def test_devices_are_named_compared_and_hashed():
    cpu = novaphy.Device("cpu")
    assert cpu == novaphy.Device(cpu) == "cpu" and cpu != novaphy.Device("cuda:0")
    assert str(novaphy.Device("cuda")) == "cuda:0" and repr(cpu) == "Device('cpu')"
    assert len({cpu, novaphy.Device("cpu"), novaphy.Device("dlan:1")}) == 2
    assert cpu.type is novaphy.DeviceType.CPU and cpu.ordinal == 0
    assert cpu.is_cpu and not cpu.is_cuda and novaphy.Device("cuda:1").is_cuda
    assert cpu.name and cpu.arch == 0 and cpu.total_memory >= cpu.free_memory >= 0
    assert isinstance(cpu.supports_graph_capture, bool)
    assert cpu in novaphy.get_devices() and novaphy.get_device() == novaphy.get_default_device()
    novaphy.synchronize()
    novaphy.synchronize("cpu")


def test_events_measure_the_work_between_them():
    start, stop = novaphy.Event(), novaphy.Event("cpu")
    with pytest.raises(novaphy.Error, match="event was not recorded"):
        novaphy.Event.elapsed(start, stop)
    start.record()
    time.sleep(0.02)
    stop.record()
    stop.synchronize()
    assert str(start.device) == "cpu"
    assert 0.02 <= novaphy.Event.elapsed(start, stop) < 10


def test_an_unknown_device_is_a_value_error_and_a_missing_one_an_error():
    for spec in ("gpu", "cpu:1", "cuda:", "cuda:-1", "", "CPU"):
        with pytest.raises(ValueError, match="device"):
            novaphy.Device(spec)
    with pytest.raises(TypeError, match="device"):
        novaphy.Device(3)
    assert novaphy.is_device_available("cpu")
    with pytest.raises(ValueError):
        novaphy.is_device_available("tpu")
    assert issubclass(novaphy.Error, RuntimeError) and novaphy.Error.__module__ == "novaphy"
    if novaphy.is_device_available("dlan"):
        pytest.skip("there is a dlan device")
    builder = novaphy.ModelBuilder()
    for call in (
        lambda: novaphy.get_device("dlan"),
        lambda: novaphy.set_default_device("dlan:0"),
        lambda: novaphy.synchronize("dlan"),
        lambda: novaphy.DeviceArray([1.0], device="dlan"),
        lambda: builder.finalize("dlan"),
    ):
        with pytest.raises(novaphy.Error, match="dlan"):
            call()


def test_the_default_device_can_be_set_for_a_block():
    with novaphy.ScopedDevice("cpu") as device:
        assert device == "cpu" and novaphy.get_default_device() == "cpu"
    novaphy.set_default_device("cpu")
    wrong = run("import novaphy; novaphy.get_default_device()", NOVAPHY_DEVICE="abacus")
    assert wrong.returncode != 0 and "ValueError: NOVAPHY_DEVICE" in wrong.stderr


def test_backends_are_listed_and_a_bad_plugin_is_refused(tmp_path):
    names = [backend.name for backend in novaphy.backends()]
    assert "cpu" in names
    active = [backend for backend in novaphy.backends() if backend.active]
    assert len(active) >= 1 and all(b.loaded and not b.error for b in active)
    assert active[0].abi_version[0] >= 0 and active[0].device_count >= 1
    assert "BackendInfo(name='cpu'" in repr(active[0])
    with pytest.raises(novaphy.Error):
        novaphy.load_backend(tmp_path / "libnovaphy_backend_none.so")
    plugin = tmp_path / "libnovaphy_backend_bad.so"
    plugin.write_text("not a library")
    with pytest.raises(novaphy.Error, match="bad"):
        novaphy.load_backend(str(plugin))
    with pytest.raises(TypeError):
        novaphy.load_backend(3)


def test_the_built_in_backend_is_enough():
    result = run(
        "import novaphy; print([b.path for b in novaphy.backends() if b.active])",
        NOVAPHY_DISABLE_BACKENDS="cpu,cuda",
    )
    assert result.stdout.strip() == "['']", result.stderr


def test_the_build_says_what_it_is():
    info = novaphy.build_info()
    assert info["NOVAPHY_WITH_DIFF"] is novaphy.has_diff()
    assert info["NOVAPHY_BUILD_VBD"] is novaphy.has_vbd()
    assert isinstance(novaphy.has_cuda(), bool) and isinstance(novaphy.has_nvrtc(), bool)
    assert novaphy.__version__ == novaphy.version() and novaphy.version().count(".") == 2


def test_the_number_of_threads_is_checked():
    before = novaphy.num_threads()
    novaphy.set_num_threads(3)
    assert novaphy.num_threads() == 3
    novaphy.set_num_threads(before)
    for bad in (0, -1, 100000):
        with pytest.raises(ValueError, match="set_num_threads"):
            novaphy.set_num_threads(bad)
