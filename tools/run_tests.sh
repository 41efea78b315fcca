#!/usr/bin/env bash
# Set up what the tests need on a bare Debian 12 or Ubuntu 24.04 machine and run them: one build with the Python
# module, its tests, and the ball.
#
#   tools/run_tests.sh --all                        every slice, the wheel, sanitizers, the fake GPU: what CI runs
#   tools/run_tests.sh [STEP]...                    for example: tools/run_tests.sh cpu-diff python
#   tools/run_tests.sh --library vbd                the C++ tests of one library
#   tools/run_tests.sh --times [...]                with the time of each step, and the slowest cases
#   tools/run_tests.sh --list                       the steps
#
# The last line is `tests: N passed, M failed, K skipped`, over CTest and pytest together; what fails without being
# a test (a build, a lint, a size, a step whose tests did not run) counts as one failed. The exit code is 0 only when
# nothing failed. Logs are in build/log. PYTHON chooses another Python.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. tools/setup.sh

packages=("${BUILD_PACKAGES[@]}" binutils libassimp-dev liburdfdom-dev libtinyxml2-dev libgtest-dev googletest zlib1g-dev)
for step in "${@:-tests}"; do
  case $step in
    --all | python) packages+=("${OPENGL_PACKAGES[@]}" "${DISPLAY_PACKAGES[@]}") ;;
    tests | --times) packages+=("${OPENGL_PACKAGES[@]}") ;;
  esac
  case $step in --all | dev) packages+=(clang-14) ;; esac # a front end for CUDA, which stands in for a vendor's
  case $step in --all | distributed) packages+=(python3-torch) ;; esac
  case $step in --all | fcl) packages+=(libfcl-dev) ;; esac
done
install_packages "${packages[@]}"
find_python
# Newer versions of the lints may ask for more.
make_venv build/venv/tools "${WHEEL_REQUIREMENTS[@]}" "ruff==0.17.6" "codespell==2.4.3"
exec build/venv/tools/bin/python tools/run_tests.py "$@" </dev/null
