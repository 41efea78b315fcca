#!/usr/bin/env bash
# Installs what the tests need on a bare Debian 12 or Ubuntu 24.04 machine, and runs them. Without arguments:
# the lints, one build with the Python module, its tests, and the ball demo.
#
#   tools/run_tests.sh --all                        every slice, the wheel, sanitizers, the fake GPU: what CI runs
#   tools/run_tests.sh [STEP]...                    for example: tools/run_tests.sh cpu-diff python
#   tools/run_tests.sh --library vbd                the C++ tests of one library
#   tools/run_tests.sh --times [...]                with the time of each step, and the slowest cases
#   tools/run_tests.sh --list                       the steps
#
# The last line is `tests: N passed, M failed, K skipped`, over CTest and pytest together. A failure that is
# not a test counts as one failed: a build, a lint, a size, or a step whose tests did not run. The exit code
# is 0 only if nothing failed. Logs are in build/log. The variable PYTHON chooses another Python.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. tools/setup.sh

packages=("${BUILD_PACKAGES[@]}" binutils libassimp-dev liburdfdom-dev libtinyxml2-dev libgtest-dev googletest zlib1g-dev)
for step in "${@:-tests}"; do
  case $step in
    --all | python) packages+=("${OPENGL_PACKAGES[@]}" "${DISPLAY_PACKAGES[@]}") ;;
    tests | --times) packages+=("${OPENGL_PACKAGES[@]}") ;;
  esac
  case $step in --all | dev) packages+=(clang-14) ;; esac # a CUDA front end in place of a vendor's
  case $step in --all | distributed) packages+=(python3-torch) ;; esac
  case $step in --all | fcl) packages+=(libfcl-dev) ;; esac
done
install_packages "${packages[@]}"
find_python
# The versions are fixed, because newer lints may ask for more.
make_venv build/venv/tools "${WHEEL_REQUIREMENTS[@]}" "ruff==0.17.6" "codespell==2.4.3"
exec build/venv/tools/bin/python tools/run_tests.py "$@" </dev/null
