#!/usr/bin/env bash
# Sets up NovaPhy on a bare Debian 12 or Ubuntu 24.04 machine and runs the ball demo. The demo optimizes the
# velocity of a ball by gradient descent through 288 substeps, and draws ball.png.
#
#   tools/run_ball.sh [OPTION OF THE DEMO]...       for example: tools/run_ball.sh --headless 30 --check-grad
#
# Installs missing system packages (with sudo if not root) and makes the virtual environment .venv in this
# repository. Builds and installs the Python package, and runs python/demos/diff/demo_diffsim_ball.py. A
# second run only runs the demo, and needs no network. The variable PYTHON chooses another Python.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
. tools/setup.sh

install_packages "${BUILD_PACKAGES[@]}"
find_python
make_venv .venv "${WHEEL_REQUIREMENTS[@]}"

# Builds again only after an edit. The modification time of a folder shows that files were removed.
sources=(CMakeLists.txt pyproject.toml backends cmake collision core diff dynamics io nova python/src python/novaphy)
installed=.venv/novaphy.stamp
if [ ! -e "$installed" ] || [ -n "$(find "${sources[@]}" -newer "$installed" -not -name __pycache__ -not -name '*.pyc' -print -quit)" ]; then
  echo "building the Python package (the first time takes a few minutes)"
  started=$(mktemp)
  # A build for this machine, without the reader of meshes and without VBD, takes half the time. The build
  # tree is kept, so that a build after an edit is short.
  .venv/bin/python -m pip install --disable-pip-version-check -q --no-build-isolation '.[demos]' \
    --config-settings=build-dir="$PWD/build/ball" \
    --config-settings=cmake.define.NOVAPHY_CPU_LEVELS=host --config-settings=cmake.define.NOVAPHY_WITH_IO=OFF \
    --config-settings=cmake.define.NOVAPHY_BUILD_VBD=OFF \
    --config-settings=cmake.define.NOVAPHY_QUICK_BUILD=ON </dev/null ||
    die "the build failed: see above"
  mv "$started" "$installed"
fi

.venv/bin/python python/demos/diff/demo_diffsim_ball.py --headless 150 --plot "$PWD/ball.png" "$@"
case " $*" in
  *" --plot"*) ;;
  *) echo "picture: $PWD/ball.png" ;;
esac
