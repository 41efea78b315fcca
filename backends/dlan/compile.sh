#!/bin/sh
# compile.sh OUTPUT SOURCE.cu...
# Compiles device sources with Denglin's compiler and links them into a shared library. (As NOVAPHY_DLAN_COMPILER it
# compiles at run time, too.) The flags are those of Denglin's public build files; -ffp-contract=off besides, if the
# compiler takes it.
#   NOVAPHY_DLAN_ROOT   the folder of the SDK
#   NOVAPHY_DLAN_DLCC   the compiler; unset: $DLICC_PATH/dlcc, $NOVAPHY_DLAN_ROOT/bin/dlcc, or the dlcc of PATH
#   NOVAPHY_DLAN_ARCH   dlgput64 unless set; several, as dlgput64,dlgpux64, are for newer SDKs
#   NOVAPHY_DLAN_FLAGS  further flags
#   NOVAPHY_DLAN_JOBS   how many sources at a time; all processors unless set
#   CXX                 what links; c++ unless set
set -eu
output=$1
shift
dlcc=${NOVAPHY_DLAN_DLCC:-}
for found in "${DLICC_PATH:-/nowhere}/dlcc" "${NOVAPHY_DLAN_ROOT:-/nowhere}/bin/dlcc"; do
  if [ -z "$dlcc" ] && [ -x "$found" ]; then dlcc=$found; fi
done
dlcc=${dlcc:-dlcc}
if ! command -v "$dlcc" >/dev/null; then
  echo "compile.sh: no compiler $dlcc: set NOVAPHY_DLAN_ROOT to the SDK, or NOVAPHY_DLAN_DLCC to its dlcc" >&2
  exit 1
fi
arch=${NOVAPHY_DLAN_ARCH:-dlgput64}
case $arch in
  *,*) arch=--offload-arch=$arch ;;
  *) arch=--cuda-gpu-arch=$arch ;;
esac
flags="--cuda-path=${NOVAPHY_DLAN_ROOT:-} $arch -O2 -std=c++17 -fPIC ${NOVAPHY_DLAN_FLAGS:-}"
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
echo '__global__ void probe(float* p) { *p = 0.0f; }' >"$work/probe.cu"
if "$dlcc" -c -x cuda "$work/probe.cu" -o "$work/probe.o" $flags -ffp-contract=off >/dev/null 2>&1; then
  flags="$flags -ffp-contract=off"
else
  echo "compile.sh: $dlcc takes no -ffp-contract=off: results may have other bits than the CPU's" >&2
fi
export dlcc flags work
printf '%s\0' "$@" | xargs -0 -n 1 -P "${NOVAPHY_DLAN_JOBS:-$(nproc)}" sh -c \
  '"$dlcc" -c -x cuda "$1" -o "$work/$(basename "$1").o" $flags' compile
# The objects take symbols of the run-time library from the plugin, which opens them.
"${CXX:-c++}" -shared -o "$output" "$work"/*.cu.o
