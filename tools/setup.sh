# Functions for run_ball.sh and run_tests.sh, which source this file: system packages, the Python to use, and
# a virtual environment. A function does nothing if its work is already done, so that a second run needs no
# network.

die() {
  printf 'error: %s\n' "$*" >&2
  exit 1
}

# install_packages PACKAGE...: installs the Debian or Ubuntu packages that are missing.
install_packages() {
  local missing=() package
  if ! command -v apt-get >/dev/null || ! command -v dpkg-query >/dev/null; then
    printf 'This is no Debian or Ubuntu: make sure that what these packages hold is there:\n  %s\n' "$*" >&2
    return 0
  fi
  for package in "$@"; do
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing+=("$package")
  done
  [ ${#missing[@]} -eq 0 ] && return 0
  local root=()
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null ||
      die "these packages are missing, and there is no sudo; as root: apt-get install ${missing[*]}"
    root=(sudo)
  fi
  echo "installing: ${missing[*]}"
  "${root[@]}" apt-get update -qq || die "apt-get update failed: is there a network?"
  "${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "${missing[@]}" \
    </dev/null >/dev/null || die "apt-get could not install: ${missing[*]}"
}

# find_python: sets PYTHON to a Python 3.11 to 3.13 with headers. A PYTHON of the caller has priority.
find_python() {
  local candidate ok='import sys, sysconfig, os; sys.exit(not ((3, 11) <= sys.version_info[:2] <= (3, 13) and
    os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h"))))'
  if [ -n "${PYTHON:-}" ]; then
    "$PYTHON" -c "$ok" || die "PYTHON=$PYTHON: expected a Python 3.11 to 3.13 with its headers"
    return
  fi
  for candidate in /usr/bin/python3 python3 python3.13 python3.12 python3.11; do
    if command -v "$candidate" >/dev/null && "$candidate" -c "$ok" 2>/dev/null; then
      PYTHON=$candidate
      return
    fi
  done
  die "no Python 3.11 to 3.13 with its headers; set PYTHON to one"
}

# make_venv DIRECTORY REQUIREMENT...: makes or updates a virtual environment with these packages.
make_venv() {
  local venv=$1
  shift
  local wanted stamp=$venv/requirements.stamp
  wanted="$("$PYTHON" -c 'import sys; print(sys.version)') $*"
  [ -x "$venv/bin/python" ] && [ "$(cat "$stamp" 2>/dev/null)" = "$wanted" ] && return
  "$PYTHON" -m venv --clear "$venv" || die "could not make the virtual environment $venv"
  "$venv/bin/python" -m pip install -q --disable-pip-version-check "$@" </dev/null ||
    die "pip could not install: $* (is there a network?)"
  echo "$wanted" >"$stamp"
}

# System packages that compile the project.
BUILD_PACKAGES=(g++ cmake ninja-build ccache libtbb-dev python3 python3-dev python3-venv ca-certificates)
# System packages for OpenGL without a display, with which viewers draw pictures and videos.
OPENGL_PACKAGES=(libegl1 libgl1 libgl1-mesa-dri ffmpeg)
# System packages for the tests of windows and pages: an X server with its library, and a browser.
DISPLAY_PACKAGES=(libxrender1 xvfb)
# Ubuntu has Chromium only as a snap, which does not run in a container. On Ubuntu the tests of pages need
# google-chrome.
grep -qs '^ID=ubuntu' /etc/os-release || DISPLAY_PACKAGES+=(chromium)
# PyPI packages that build the wheel.
WHEEL_REQUIREMENTS=("scikit-build-core>=0.10" "pybind11>=2.13" "numpy>=1.26")
