#!/usr/bin/env python3
"""Run the tests. tools/run_tests.sh calls this program after it has installed what is needed."""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import wheel_contents
from test_results import Results, Step, processor_seconds

ROOT = Path(__file__).resolve().parents[1]
BUILD = ROOT / "build"
LOGS = BUILD / "log"
DEMOS = ROOT / "python" / "demos" / "diff"
DEMO = DEMOS / "demo_diffsim_ball.py"
JOBS = len(os.sched_getaffinity(0))
TAIL_LINES = 120
BINDING_REQUIREMENTS = ("pybind11>=2.13",)
TEST_REQUIREMENTS = ("numpy", "pytest", "pytest-xdist", "matplotlib", "tqdm", "gymnasium>=1.1")
VIEWERS_WITHOUT_DISPLAY = ("moderngl>=5.10", "viser>=1.1", "pillow", "websockets>=13.1")
VIEWER_REQUIREMENTS = (*VIEWERS_WITHOUT_DISPLAY, "pyglet>=2.0.10", "imgui-bundle>=1.92")

# Component -> the components that are installed for its test program. (The step io has its own.)
COMPONENTS = {
    "core": ["core"],
    "nova": ["core", "nova"],
    "collision": ["core", "collision"],
    "dynamics": ["core", "nova", "collision", "dynamics"],  # the release has device code in it
    "vbd": ["core", "collision", "vbd"],
    "diff": ["core", "nova", "collision", "dynamics", "vbd", "diff"],
}


class StepError(Exception):
    """A step cannot continue."""


results = Results()


def environment(**extra: str) -> dict[str, str]:
    """Return the caller's environment without variables that change how NovaPhy runs."""
    ours = ("NOVAPHY_", "NOVA_", "CMAKE_ARGS")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
    # All build trees lie two folders below the root. The compiler cache then finds the objects of
    # one tree for another tree.
    cache = {"CCACHE_BASEDIR": str(ROOT), "CCACHE_NOHASHDIR": "1"}
    # Python calls the same compiler by another name, for which the cache has no objects.
    compilers = {"CC": "cc", "CXX": "c++"}
    return kept | {"PYTHONDONTWRITEBYTECODE": "1"} | cache | compilers | extra


def output_of(*command: str | Path) -> str:
    """Return the standard output of a command."""
    words = [str(word) for word in command]
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout


def run(
    log: str,
    *command: str | Path,
    cwd: Path = ROOT,
    env: dict[str, str] | None = None,
    may_fail: bool = False,
) -> int:
    """Run a command with its output in build/log/<log>.log. If it fails, print the log's end."""
    LOGS.mkdir(parents=True, exist_ok=True)
    path = LOGS / f"{log}.log"
    words = [str(word) for word in command]
    with path.open("a", encoding="utf-8") as out:
        out.write(f"$ {' '.join(words)}\n")
        out.flush()
        start = out.tell()
        code = subprocess.run(
            words,
            cwd=cwd,
            env=env or environment(),
            stdout=out,
            stderr=subprocess.STDOUT,
            check=False,
        ).returncode
    if code != 0:
        with path.open(encoding="utf-8", errors="replace") as written:
            written.seek(start)
            lines = written.read().splitlines()
        print(f"   $ {' '.join(words)}")
        print("\n".join(f"   | {line}" for line in lines[-TAIL_LINES:]))
        print(f"   exit code {code}; all of it in {path.relative_to(ROOT)}")
        if not may_fail:
            raise StepError(f"{log}: {Path(words[0]).name} failed with exit code {code}")
    return code


def pip(log: str, python: str | Path, *arguments: str | Path, **options: object) -> None:
    """Run pip for a Python interpreter."""
    run(log, python, "-m", "pip", "--disable-pip-version-check", *arguments, **options)


def build(preset: str, *options: str, targets: Iterable[str] = ()) -> Path:
    """Configure and build a preset, with warnings as errors. Return the build tree."""
    with results.timed("build"):
        run(preset, "cmake", "--preset", preset, "-DNOVAPHY_WERROR=ON", *options)
        chosen = [word for target in targets for word in ("--target", target)]
        run(preset, "cmake", "--build", "--preset", preset, f"-j{JOBS}", *chosen)
    return BUILD / preset


def ctest(what: str, *arguments: str | Path) -> None:
    """Run CTest and add its results."""
    log = what.replace(" ", "-")
    junit = LOGS / f"{log}.ctest.xml"
    junit.unlink(missing_ok=True)
    options = ["--output-junit", junit, f"-j{JOBS}"]
    with results.timed("tests"):
        code = run(log, "ctest", *arguments, *options, may_fail=True)
    if not junit.exists():
        raise StepError(f"{what}: ctest wrote no results")
    if results.add_junit(junit, what) == 0 and code != 0:
        raise StepError(f"{what}: ctest failed with exit code {code}")


def pytest(
    what: str, python: Path, *arguments: str | Path, env: dict[str, str] | None = None
) -> None:
    """Run pytest on all cores and add its results."""
    junit = LOGS / f"{what}.pytest.xml"
    junit.unlink(missing_ok=True)
    options = ["-q", "-ra", "-p", "no:cacheprovider", f"--junitxml={junit}"]
    options += [f"--numprocesses={JOBS}", "--dist=worksteal"]
    with results.timed("tests"):
        code = run(what, python, "-m", "pytest", *options, *arguments, env=env, may_fail=True)
    if not junit.exists():
        raise StepError(f"{what}: pytest wrote no results")
    if results.add_junit(junit, what) == 0 and code != 0:
        raise StepError(f"{what}: pytest failed with exit code {code}")


def make_venv(name: str, *requirements: str, options: tuple[str, ...] = ()) -> Path:
    """Make a virtual environment with these packages, once. Return its Python interpreter."""
    folder = BUILD / "venv" / name
    python, stamp = folder / "bin" / "python", folder / "requirements.stamp"
    wanted = f"{sys.version} {requirements}"
    if not python.exists() or not stamp.exists() or stamp.read_text() != wanted:
        run(f"venv-{name}", sys.executable, "-m", "venv", "--clear", *options, folder)
        pip(f"venv-{name}", python, "install", *requirements)
        stamp.write_text(wanted)
    return python


# The steps, in order. The name of a step is the name of its function, with - in place of _.

STEPS: dict[str, Callable[[], None]] = {}
DEFAULT = ("lint", "tests")  # steps without --all
LIBRARIES = ("core", "io", "nova", "collision", "dynamics", "vbd", "diff")
# Steps that have no tests of their own, and only build and check.
WITHOUT_TESTS = ("lint", "symbols", "demos", "hashes")
# The tests of a partial build, which check its libraries from outside.
FROM_OUTSIDE = r"^exports\.|^install_consumer\."


def step(function: Callable[[], None]) -> Callable[[], None]:
    """Register a function as a step."""
    STEPS[function.__name__.replace("_", "-")] = function
    return function


@step
def lint() -> None:
    """Includes keep the layers; counted faults shrink; spelling; ruff; shell scripts parse."""
    for program in ("check_layers.py", "measure_house.py --check", "check_prose.py --check"):
        run("lint", sys.executable, *f"tools/lint/{program}".split())
    for line in (LOGS / "lint.log").read_text(encoding="utf-8").splitlines():
        if line.startswith("better:") or ": write the lower" in line:
            print(f"   {line}")
    for command in ("codespell README.md docs python", "ruff check -n", "ruff format -n --check"):
        program, *options = command.split()
        run("lint", Path(sys.executable).with_name(program), *options)
    for script in ("tools/setup.sh", "tools/run_ball.sh", "tools/run_tests.sh", ".ci/run"):
        run("lint", "bash", "-n", script)


def tests_options() -> tuple[Path, list[str]]:
    """Return the Python interpreter of the tree `tests`, and the options of its build."""
    packages = (*BINDING_REQUIREMENTS, *TEST_REQUIREMENTS, *VIEWERS_WITHOUT_DISPLAY)
    python = make_venv("tests", *packages)
    pybind11 = output_of(python, "-m", "pybind11", "--cmakedir").strip()
    return python, [
        "-DNOVAPHY_QUICK_BUILD=ON",
        f"-DPython_EXECUTABLE={python}",
        f"-Dpybind11_DIR={pybind11}",
    ]


@step
def tests() -> None:
    """Build one tree with all but devices; run CTest, fast pytest cases, and the ball."""
    python, options = tests_options()
    tree = build("tests", *options)
    ctest("tests", "--preset", "tests")
    package = environment(PYTHONPATH=str(tree / "python"))
    pytest("tests", python, "tests/python", "-m", "not slow", env=package)
    with tempfile.TemporaryDirectory() as folder:
        picture = Path(folder) / "ball.png"
        run("ball", python, DEMO, "--headless", "5", "--plot", picture, env=package)
        if not picture.exists():
            raise StepError("tests: the ball drew no picture")


def library(name: str) -> None:
    """Run the C++ tests of one library, in the tree of the step `tests`."""
    _, options = tests_options()
    tree = build("tests", *options, targets=[f"tests/{name}/all"])
    ctest(name, "--test-dir", tree / "tests" / name, "--no-tests=error", "--output-on-failure")


@step
def dev() -> None:
    """Everything that builds here, its tests, and backends of devices on stand-ins for a GPU."""
    build("dev", "-DNOVAPHY_WITH_IO=ON")
    ctest("dev", "--preset", "dev", "-C", "many")


def make_wheel() -> Path:
    """Build the wheel, once per run of this program. Return its path."""
    folder = BUILD / "wheel"
    if not make_wheel.made:
        shutil.rmtree(folder, ignore_errors=True)
        tree = BUILD / "wheel-tree"
        settings = {"build-dir": tree, "cmake.define.NOVAPHY_WERROR": "ON"}
        options = ["--no-build-isolation", "--no-deps", "-w", folder]
        options += [f"--config-settings={name}={value}" for name, value in settings.items()]
        with results.timed("build"):
            pip("wheel", sys.executable, "wheel", *options, ROOT)
        make_wheel.made = True
    wheels = list(folder.glob("novaphy-*.whl"))
    if len(wheels) != 1:
        raise StepError(f"wheel: expected one in {folder}, found {len(wheels)}")
    return wheels[0]


make_wheel.made = False


def check_wheel(wheel: Path) -> None:
    """Check that the wheel is small, and needs only NumPy and a Linux system."""
    print(f"   {wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB")
    if fault := wheel_contents.fault(wheel):
        raise StepError(f"wheel: {fault}")


def wheel_python() -> Path:
    """Return the Python interpreter of an environment with the wheel of this run."""
    wheel = make_wheel()
    python = make_venv("wheel", *TEST_REQUIREMENTS, *VIEWER_REQUIREMENTS, "mypy")
    if not wheel_python.installed:
        pip("wheel", python, "install", "--no-deps", "--force-reinstall", wheel)
        wheel_python.installed = True
    return python


wheel_python.installed = False


@step
def python() -> None:
    """Check the wheel: size, dependencies and stubs. Run pytest against the wheel."""
    check_wheel(make_wheel())
    interpreter = wheel_python()
    # Runs outside of the repository, whose python/ folder would shadow the installed package.
    with tempfile.TemporaryDirectory() as folder:
        settings = f"--mypy-config-file={ROOT / 'pyproject.toml'}"
        stubtest = [interpreter, "-m", "mypy.stubtest", "novaphy", "--concise", settings]
        run("stubs", *stubtest, cwd=Path(folder))
    pytest("python", interpreter, "tests/python")
    viewer_tests_ran(LOGS / "python.pytest.xml")


def skipped_cases(junit: Path) -> Iterator[tuple[str, str, str]]:
    """Yield the module, the name and the reason of each skipped test."""
    for case in ElementTree.parse(junit).iter("testcase"):
        if (skipped := case.find("skipped")) is not None:
            yield case.get("classname", ""), case.get("name", ""), skipped.get("message", "")


def viewer_tests_ran(junit: Path) -> None:
    """Check that all tests of viewers ran, except page tests on Ubuntu without a browser."""
    for module, name, reason in skipped_cases(junit):
        if "test_viewer" in module and not reason.startswith("no Chromium"):
            results.fail(f"python: {name} was skipped: {reason}")


@step
def distributed() -> None:
    """Ranks by torch.distributed, Ray and MPI, with the libraries of all three."""
    # torch is Debian's package, which was built for NumPy 1.
    libraries = (*TEST_REQUIREMENTS, "numpy<2", "ray>=2.9", "mpi4py>=4", "mpich")
    interpreter = make_venv("distributed", *libraries, options=("--system-site-packages",))
    pip("distributed", interpreter, "install", "--no-deps", "--force-reinstall", make_wheel())
    pytest("distributed", interpreter, "tests/python/test_distributed.py")
    for _, name, reason in skipped_cases(LOGS / "distributed.pytest.xml"):
        results.fail(f"distributed: {name} was skipped: {reason}")


@step
def editable() -> None:
    """Make the documented editable install, here without io, and run the ball from it."""
    interpreter = make_venv(
        "editable", "scikit-build-core>=0.10", "numpy", "pytest", "pytest-xdist"
    )
    # The same pybind11 as for the wheel, so that the compiler cache finds the objects.
    pybind11 = output_of(sys.executable, "-m", "pybind11", "--cmakedir").strip()
    options = (
        "-DNOVAPHY_BUILD_TESTS=OFF -DNOVAPHY_BUILD_VBD=OFF -DNOVAPHY_WITH_IO=OFF "
        f"-DNOVAPHY_WERROR=ON -DCMAKE_PREFIX_PATH=/usr -Dpybind11_DIR={pybind11}"
    )
    environ = environment(CMAKE_ARGS=options)
    tree = f"--config-settings=build-dir={BUILD / 'editable'}"
    words = ("install", "-e", ".", "--no-build-isolation", "--no-deps", tree)
    pip("editable", interpreter, *words, env=environ)
    code = (
        "import novaphy, pathlib; p = pathlib.Path(novaphy.__file__).resolve(); print(p); "
        f"assert p.is_relative_to({str(ROOT / 'python')!r}), p; "
        "assert novaphy.has_diff() and not novaphy.has_vbd() and not novaphy.has_io(); "
        "assert 'Adds a spring' in (p.parent / '_core' / '__init__.pyi').read_text()"
    )
    with tempfile.TemporaryDirectory() as folder:
        run("editable", interpreter, "-c", code, cwd=Path(folder))
        run("editable", interpreter, DEMO, "--headless", "1", cwd=Path(folder))
    pytest("editable", interpreter, "tests/python/test_io.py", "-k", "without_the_mesh_reader")


@step
def demos() -> None:
    """Run the demos: training, gradient check, states and picture."""
    interpreter = wheel_python()
    iterations = {"ball": 5, "soft_body": 10, "cloth": 5, "spring_cage": 20, "dice": 3}
    iterations |= {
        "push": 3,
        "drone": 3,
        "featherstone": 3,
        "cart_pole": 3,
        "fr3_reach": 3,
        "franka_push_box": 2,
    }
    iterations |= {"vbd_cloth": 2, "vbd_gripper": 2}

    def run_demo(item: tuple[str, int]) -> None:
        demo, count = item
        with tempfile.TemporaryDirectory() as folder:
            outputs = [Path(folder) / "states.npz", Path(folder) / "picture.png"]
            run(
                demo, interpreter, DEMOS / f"demo_diffsim_{demo}.py",
                "--headless", str(count), "--check-grad",
                "--dump-states", outputs[0], "--plot", outputs[1],
            )  # fmt: skip
            for path in outputs:
                if not path.exists() or path.stat().st_size == 0:
                    raise StepError(f"{demo}: the demo wrote no {path.name}")

    with ThreadPoolExecutor(JOBS) as pool:
        for demo in [pool.submit(run_demo, item) for item in iterations.items()]:
            try:
                demo.result()
            except StepError as error:
                results.fail(str(error))


@step
def hashes() -> None:
    """Scenes of the benchmarks have their bits, on a stand-in for a GPU too."""
    compare = [wheel_python(), "-W", "ignore", "tools/bench/hash_scenes.py"]
    with results.timed("tests"):
        run("hashes", *compare)
    # The wheel's native module, with libraries that have code for devices.
    targets = ("novaphy_io", "novaphy_diff", "plugin_fake_ahead", "fake_driver")
    tree = build("dev", "-DNOVAPHY_WITH_IO=ON", targets=targets)
    fake = tree / "tests" / "fake_driver"
    device = environment(
        LD_LIBRARY_PATH=str(tree / "lib"),
        NOVAPHY_BACKEND_PATH=str(fake / "fake_ahead"),
        NOVAPHY_CUDA_DRIVER=str(fake / "libfake_driver.so"),
        NOVAPHY_CACHE_DIR="off",
    )
    with results.timed("tests"):
        run("hashes", *compare, "--device", "cuda:0", env=device)


def build_slice(preset: str, *options: str, cases: str = "", folders: str = "none") -> Path:
    """Build some libraries and check them. The options change only some of the test cases."""
    tree = build(preset, f"-DNOVAPHY_TESTS={folders}", *options)
    ctest(preset, "--preset", preset, "-R", "|".join(filter(None, (FROM_OUTSIDE, cases))))
    return tree


@step
def core_only() -> None:
    """Build and test novaphy::core alone."""
    build_slice("core-only", folders="backends", cases=r"^core\.BackendRegistry\.")


@step
def io() -> None:
    """Build and test novaphy::core and novaphy::io, with libraries of the system and the wheel."""
    build_slice("io")
    build_slice("io-source", folders="io", cases=r"^io\.")


@step
def cpu() -> None:
    """Build and test the forward engine, without the tensor runtime."""
    build_slice("cpu")


@step
def fcl() -> None:
    """Convex hulls by FCL's solver."""
    build_slice("fcl", "-DNOVAPHY_BUILD_VBD=OFF", folders="collision", cases=r"^collision\.")


@step
def symbols() -> None:
    """Check that the forward engine neither needs nor holds symbols of the tensor runtime."""
    tree = build("cpu", "-DNOVAPHY_TESTS=none")
    if found := list(tree.rglob("libnovaphy_nova*")) + list(tree.rglob("libnovaphy_diff*")):
        raise StepError(f"symbols: the slice cpu built {found[0].name}")
    for name in ("core", "collision", "dynamics"):
        library = tree / "lib" / f"libnovaphy_{name}.so"
        dynamic = output_of("nm", "-DC", library)
        # The reader of Programs (nova::ir) belongs to the CPU backend, which is linked into core.
        pattern = re.compile(r"(?<![\w:])nova::" + (r"(?!ir::)" if name == "core" else ""))
        lines = (output_of("nm", "-C", library) + dynamic).splitlines()
        if bad := [line for line in lines if pattern.search(line)]:
            raise StepError(f"symbols: {library.name} has {bad[:3]}")
        if "libnovaphy_nova" in output_of("readelf", "-d", library):
            raise StepError(f"symbols: {library.name} links libnovaphy_nova")
        print(f"   {library.name}: {len(dynamic.splitlines())} dynamic symbols, none of nova")


@step
def cuda() -> None:
    """Test the forward engine without diff on a fake CUDA device."""
    tree = build_slice("cuda", folders="fake_driver", cases=r"^gpu\.Driver")
    if found := list(tree.rglob("libnovaphy_diff*")):
        raise StepError(f"cuda: the slice cuda built {found[0].name}")
    if "libnovaphy_nova" in output_of("readelf", "-d", tree / "lib" / "libnovaphy_collision.so"):
        raise StepError("cuda: libnovaphy_collision.so links libnovaphy_nova")


@step
def cpu_diff() -> None:
    """Build and test the differentiable engine."""
    build_slice("cpu-diff")


@step
def install() -> None:
    """Build and run a program for each component against only the components that it needs."""
    tree = build("cpu-diff", "-DNOVAPHY_TESTS=none")
    consumers, work = ROOT / "tests" / "install_consumer", BUILD / "install"
    shutil.rmtree(work, ignore_errors=True)
    missing = [name for name in COMPONENTS if not (consumers / name / "CMakeLists.txt").exists()]
    if missing:
        raise StepError(f"install: tests/install_consumer has none for {', '.join(missing)}")
    for name, components in COMPONENTS.items():
        for component in components:
            to = ("--component", component, "--prefix", work / name / "prefix")
            run("install", "cmake", "--install", tree, *to)

    def build_consumer(name: str) -> None:
        prefix, binary = work / name / "prefix", work / name / "build"
        run(
            f"install-{name}", "cmake", "-G", "Ninja", "-S", consumers / name, "-B", binary,
            f"-DCMAKE_PREFIX_PATH={prefix}", "-DCMAKE_BUILD_TYPE=Release",
        )  # fmt: skip
        run(f"install-{name}", "cmake", "--build", binary, "-j1")

    with ThreadPoolExecutor(JOBS) as pool:
        list(pool.map(build_consumer, COMPONENTS))
    for name in COMPONENTS:
        options = ("--test-dir", work / name / "build", "--no-tests=error", "--output-on-failure")
        ctest(f"install {name}", *options)
    run("install", sys.executable, "tools/check_headers.py", work / "diff" / "prefix" / "include")


@step
def asan() -> None:
    """Test the preset debug under AddressSanitizer and UndefinedBehaviorSanitizer."""
    build("asan", "-DNOVAPHY_QUICK_BUILD=ON")
    ctest("asan", "--preset", "asan")


@step
def tsan() -> None:
    """Test the cases that start threads under ThreadSanitizer."""
    build("tsan", "-DNOVAPHY_QUICK_BUILD=ON")
    ctest("tsan", "--preset", "tsan")


def run_step(name: str, function: Callable[[], None]) -> None:
    """Run one step, and print its name before."""
    print(f"== {name}: {function.__doc__.splitlines()[0]}", flush=True)
    results.steps.append(Step(name))
    start, cpu, before = time.monotonic(), processor_seconds(), results.passed + results.failed
    try:
        function()
        if name not in WITHOUT_TESTS and results.passed + results.failed == before:
            raise StepError(f"{name}: no test was run")
    except (StepError, OSError, subprocess.CalledProcessError) as error:
        print(f"   FAILED: {error}")
        results.fail(str(error))
    results.steps[-1].total = time.monotonic() - start
    results.steps[-1].cpu = processor_seconds() - cpu
    print(f"   {results.steps[-1].total:.0f} s", flush=True)


def main() -> int:
    """Run the steps of the command line, the default steps, or all steps."""
    parser = argparse.ArgumentParser(prog="tools/run_tests.sh", description="Run the tests.")
    parser.add_argument("steps", nargs="*", metavar="STEP", help="only these steps, in this order")
    parser.add_argument("--all", action="store_true", help="all steps, as CI runs them")
    parser.add_argument(
        "--library", choices=LIBRARIES, help="the C++ tests of one library, in the tree of `tests`"
    )
    parser.add_argument("--times", action="store_true", help="print times and the slowest cases")
    parser.add_argument("--list", action="store_true", help="list the steps")
    arguments = parser.parse_args()
    if arguments.list:
        for name, function in STEPS.items():
            print(f"{name:10} {function.__doc__.splitlines()[0]}")
        return 0
    if (arguments.all or arguments.library) and arguments.steps:
        parser.error(
            "--all and --library choose what runs: expected no step besides, "
            f"got {arguments.steps[0]!r}"
        )
    if unknown := [name for name in arguments.steps if name not in STEPS]:
        parser.error(f"unknown step {unknown[0]!r}; there are: {', '.join(STEPS)}")

    shutil.rmtree(LOGS, ignore_errors=True)
    start = time.monotonic()
    # The steps dev and wheel include the step tests, with the kernels of every instruction set.
    every = [name for name in STEPS if name != "tests"]
    if arguments.library:
        run_step(arguments.library, partial(library, arguments.library))
    else:
        for name in every if arguments.all else arguments.steps or DEFAULT:
            run_step(name, STEPS[name])
    if arguments.all:
        results.check_slow(ROOT / "tests" / "slow.txt")
    if arguments.times:
        results.print_times()
    for problem in results.problems:
        print(f"failed: {problem}")
    print(f"{'all ' if arguments.all else ''}steps: {time.monotonic() - start:.0f} s")
    print(f"tests: {results.passed} passed, {results.failed} failed, {results.skipped} skipped")
    return 1 if results.failed else 0


if __name__ == "__main__":
    sys.exit(main())
