"""``python -m novaphy.backend_check dlan``: checks whether a backend works on this machine.

This program is for owners of a Denglin card. The program compiles missing kernels, and runs the
conformance suite and demos. The states of the demos must have the same bits as on the CPU. The
output is also written to a report.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import novaphy
from novaphy._command import demos
from novaphy.testing import assert_same_bits

VARIABLES = (
    "NOVAPHY_DLAN_ROOT",
    "NOVAPHY_DLAN_LIBRARY",
    "NOVAPHY_DLAN_SYMBOLS",
    "NOVAPHY_DLAN_KERNELS",
    "NOVAPHY_DLAN_DLCC",
    "NOVAPHY_DLAN_ARCH",
    "NOVAPHY_DLAN_FLAGS",
    "DLICC_PATH",
)
# The number of iterations or frames of each demo, enough for falling objects to touch something.
DEMOS = {"ball": 3, "soft_body": 3, "cloth": 5, "dice": 3, "rigid_drop": 30, "vbd": 15}
DEVICE = """
import novaphy
for b in novaphy.backends():
    if "dlan" in b.name:
        print(f"{b.path}: {b.error or 'usable'}")
d = novaphy.get_device("dlan:0")
print(f"{d}: {d.name}, {d.total_memory} bytes, {d.free_memory} free, number {d.arch}")
"""


class Report:
    """Prints lines, and keeps the lines for a file that is written at the end."""

    def __init__(self) -> None:
        """Start an empty report."""
        self.lines: list[str] = []
        self.failed: list[str] = []

    def say(self, text: str) -> None:
        """Print a text and add it to the report."""
        self.lines.append(text)
        print(text, flush=True)

    def result(self, what: str, problem: str = "") -> None:
        """Add the result of the check named `what`: passed, or the problem if there is one."""
        self.say(f"[{'FAILED' if problem else 'passed'}] {what}{': ' if problem else ''}{problem}")
        if problem:
            self.failed.append(what)

    def run(self, what: str, *command: str | Path) -> bool:
        """Run a command and add its last lines to the report. Return whether it succeeded."""
        words = [str(word) for word in command]
        self.say(f"$ {' '.join(words)}")
        start = time.perf_counter()
        done = subprocess.run(
            words,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            check=False,
        )
        for line in done.stdout.splitlines()[-30:]:
            self.say(f"  {line}")
        self.say(f"  ({time.perf_counter() - start:.1f} s)")
        code = done.returncode
        if what:
            self.result(what, f"exit code {code}" if code else "")
        return code == 0


def plugin() -> Path | None:
    """Return the path of the dlan plugin, even if the plugin is not usable. None: no plugin."""
    found = [Path(b.path) for b in novaphy.backends() if b.path and b.name == "dlan"]
    return found[0] if found else None


def find_compiler() -> str:
    """Return the path of the compiler dlcc that compile.sh uses; "": not found."""
    places = [
        os.environ.get("NOVAPHY_DLAN_DLCC", ""),
        os.path.join(os.environ.get("DLICC_PATH", "/nowhere"), "dlcc"),
        os.path.join(os.environ.get("NOVAPHY_DLAN_ROOT", "/nowhere"), "bin", "dlcc"),
        "dlcc",
    ]
    return next((found for place in places if (found := shutil.which(place))), "")


def compile_kernels(report: Report, sources: Path, kernels: Path) -> bool:
    """Compile the .cu files in `sources` into the library `kernels`. Return whether it worked."""
    files = sorted(sources.glob("*.cu"))
    if not files:
        report.result("kernels compile", f"no sources in {sources}")
        return False
    kernels.parent.mkdir(parents=True, exist_ok=True)
    return report.run("kernels compile", sources / "compile.sh", kernels, *files)


def compare_demo(report: Report, name: str, iterations: int) -> None:
    """Compare the bits of a demo's states on the device and on the CPU."""
    path = demos().get(name)
    if path is None:
        report.result(f"demo {name}", "it is not installed")
        return
    if name == "vbd" and not novaphy.build_info()["NOVAPHY_WITH_VBD_DLAN"]:
        report.say(f"[not run] demo {name}: built with NOVAPHY_WITH_VBD_DLAN=OFF")
        return
    with tempfile.TemporaryDirectory() as folder:
        states = {}
        for device in ("cpu", "dlan:0"):
            file = Path(folder) / f"{device[:4]}.npz"
            options = ("--device", device, "--headless", str(iterations), "--dump-states", file)
            if not report.run(f"demo {name} on {device}", sys.executable, path, *options):
                return
            with np.load(file) as archive:
                states[device] = {key: archive[key] for key in archive.files}
        problem = ""
        for key, expected in states["cpu"].items():
            try:
                assert_same_bits(states["dlan:0"][key], expected, key)
            except AssertionError as difference:
                problem = str(difference)
        report.result(f"demo {name} has the bits of the CPU", problem)


def check_dlan(report: Report, args: argparse.Namespace) -> None:
    """Run all checks."""
    report.say(f"NovaPhy {novaphy.__version__}, Python {platform.python_version()}")
    report.say(platform.platform())
    for name in VARIABLES:
        report.say(f"{name}={os.environ.get(name, '')}")
    compiler = find_compiler()
    report.say(f"dlcc: {compiler or 'not found'}")
    if compiler:
        report.run("", compiler, "--version")
    own = plugin()
    if own is None:
        report.result("the backend is there", "configure the build with NOVAPHY_WITH_DLAN=ON")
        return
    named = args.kernels or os.environ.get("NOVAPHY_DLAN_KERNELS", "")
    kernels = Path(named or own.with_name("novaphy_dlan_kernels.so"))
    if args.compile or not kernels.exists():
        if not named and not os.access(kernels.parent, os.W_OK):
            kernels = Path(os.path.expanduser("~/.cache/novaphy/novaphy_dlan_kernels.so"))
        if not compile_kernels(report, own.with_name("dlan"), kernels):
            return
    report.say(f"kernels: {kernels}, {kernels.stat().st_size} bytes")
    os.environ["NOVAPHY_DLAN_KERNELS"] = str(kernels)
    if not report.run("a device is there", sys.executable, "-c", DEVICE):
        return
    suite = Path(args.conformance or own.parents[2] / "bin" / "test_conformance")
    if suite.exists():
        report.run("conformance", suite, "--backend", own, "--require", "dlan", "--gtest_brief=1")
    else:
        report.say(f"[not run] conformance: there is no {suite} (NOVAPHY_BUILD_TESTS=ON builds it)")
    for name in args.demos:
        compare_demo(report, name, args.iterations or DEMOS.get(name, 3))


def main(arguments: list[str] | None = None) -> int:
    """Run the checks; return 0 if none failed."""
    parser = argparse.ArgumentParser(
        prog="python -m novaphy.backend_check", description=(__doc__ or "").splitlines()[0]
    )
    parser.add_argument("backend", choices=["dlan"])
    parser.add_argument("--compile", action="store_true", help="compile the kernels anew")
    parser.add_argument("--kernels", metavar="FILE.so", help="the library of kernels")
    parser.add_argument("--conformance", metavar="FILE", help="the program test_conformance")
    parser.add_argument("--demos", nargs="*", default=list(DEMOS), help="which demos run")
    parser.add_argument("--iterations", type=int, help="or frames of each demo (3 to 30)")
    parser.add_argument("--report", metavar="FILE", default="novaphy_dlan_report.txt")
    args = parser.parse_args(arguments)
    report = Report()
    check_dlan(report, args)
    report.say(f"{len(report.failed)} failed" + "".join(f"; {what}" for what in report.failed))
    Path(args.report).write_text("\n".join(report.lines) + "\n", encoding="utf-8")
    print(f"report: {args.report}")
    return 1 if report.failed else 0


if __name__ == "__main__":
    sys.exit(main())
