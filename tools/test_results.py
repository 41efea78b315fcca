"""The results of the tests of a run: cases of JUnit files, time of each step, and slow cases."""

from __future__ import annotations

import os
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

# A case that takes longer (s) needs a line in tests/slow.txt.
SLOW_SECONDS = 20.0
# Seconds that reference_work() takes on the machine whose times tests/slow.txt has, a 2.6 GHz Xeon.
REFERENCE_SECONDS = 0.12


def case_name(case: ElementTree.Element) -> str:
    """Return the name of a case, with its file or suite if the name lacks them."""
    group, name = case.get("classname"), case.get("name", "")
    return name if group in (None, name) else f"{group}.{name}"


def processor_seconds() -> float:
    """Return the processor time of child processes that have ended (s)."""
    times = os.times()
    return times.children_user + times.children_system


def reference_work() -> float:
    """Return the time of a fixed Python computation on this machine, the best of three runs (s)."""
    best = float("inf")
    for _ in range(3):
        start, total = time.perf_counter(), 0
        for i in range(5_000_000):
            total += i & 7
        best = min(best, time.perf_counter() - start)
    return best


def slower_than_reference() -> float:
    """Return how many times slower this machine is than the one of tests/slow.txt, at least 1."""
    return max(1.0, reference_work() / REFERENCE_SECONDS)


@dataclass
class Step:
    """The times of one step (s): total, builds, test runs, and processor time."""

    name: str
    total: float = 0.0
    build: float = 0.0
    tests: float = 0.0
    cpu: float = 0.0


@dataclass
class Results:
    """The results of the current run so far."""

    passed: int = 0
    failed: int = 0
    skipped: int = 0
    problems: list[str] = field(default_factory=list)
    cases: list[tuple[float, str]] = field(default_factory=list)  # seconds, "step: name"
    steps: list[Step] = field(default_factory=list)

    def add_junit(self, path: Path, what: str) -> int:
        """Add the cases of a JUnit file. Return the number of failed cases."""
        cases = list(ElementTree.parse(path).iter("testcase"))
        failed = [c for c in cases if c.find("failure") is not None or c.find("error") is not None]
        skipped = [c for c in cases if c.find("skipped") is not None and c not in failed]
        self.problems += [f"{what}: {case_name(case)}" for case in failed]
        self.cases += [
            (float(case.get("time") or 0), f"{what}: {case_name(case)}") for case in cases
        ]
        self.failed += len(failed)
        self.skipped += len(skipped)
        self.passed += len(cases) - len(failed) - len(skipped)
        print(
            f"   {what}: {len(cases) - len(failed) - len(skipped)} passed, "
            f"{len(failed)} failed, {len(skipped)} skipped"
        )
        for case in skipped:
            reason = case.find("skipped").get("message", "")
            print(f"   skipped: {case.get('name')} {reason}".rstrip())
        return len(failed)

    def fail(self, problem: str) -> None:
        """Count a failure that is not a test case."""
        self.failed += 1
        self.problems.append(problem)

    @contextmanager
    def timed(self, share: str) -> Iterator[None]:
        """Add the time of a block to the "build" or the "tests" of the current step."""
        start = time.monotonic()
        try:
            yield
        finally:
            if self.steps:
                step = self.steps[-1]
                setattr(step, share, getattr(step, share) + time.monotonic() - start)

    def print_times(self) -> None:
        """Print the seconds of every step, and the 20 slowest cases."""
        print(f"{'step':<12}{'total':>8}{'build':>8}{'tests':>8}{'cpu':>8}   (seconds)")
        for step in self.steps:
            times = (step.total, step.build, step.tests, step.cpu)
            print(f"{step.name:<12}" + "".join(f"{seconds:>8.0f}" for seconds in times))
        print("slowest cases (seconds)")
        for seconds, name in sorted(self.cases, reverse=True)[:20]:
            print(f"{seconds:>8.1f} {name}")

    def check_slow(self, listed: Path) -> None:
        """Count a failure for each slow case without a line in the list, and each line without its
        case.

        Lines of steps that did not run are ignored.
        """
        reasons = read_slow(listed)
        steps = {name.partition(":")[0] for name in reasons}
        names = {name for _, name in self.cases}
        limit = SLOW_SECONDS * slower_than_reference()
        for seconds, name in sorted(self.cases, reverse=True):
            if seconds > limit and name.partition(":")[0] in steps and name not in reasons:
                self.fail(
                    f"{name} took {seconds:.0f} s, {limit:.0f} are allowed without a reason "
                    f"in {listed.name}"
                )
        for name in sorted(reasons.keys() - names):
            self.fail(f"{listed.name}: there is no case {name!r}")


def read_slow(listed: Path) -> dict[str, str]:
    """Return case -> reason from lines `step: case | reason`. Skip comments and empty lines."""
    reasons = {}
    for line in listed.read_text(encoding="utf-8").splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        name, bar, reason = line.partition(" | ")
        if not bar or not reason.strip():
            raise ValueError(f"{listed}: expected `step: case | reason`, got {line!r}")
        reasons[name.strip()] = reason.strip()
    return reasons
