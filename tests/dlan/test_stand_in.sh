#!/bin/sh
# test_stand_in.sh OUTPUT SOURCE.cu...
# Compiles the sources with compile.sh and the stand-in for Denglin's compiler, and persistent kernels in their generic
# form besides. Ends with 77, and says why, where there is no clang.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
root=$here/../..
clang=${DLCC_CLANG:-clang++-14}
if ! command -v "$clang" >/dev/null; then
  echo "skipped: no $clang, which compiles CUDA without an SDK (Debian: clang-14)"
  exit 77
fi
export NOVAPHY_DLAN_DLCC="$here/dlcc" NOVAPHY_DLAN_ROOT=/nowhere
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
# Sources that the compiler must refuse.
echo '__global__ void f() {}' >"$work/f.cu"
good="-c -x cuda $work/f.cu -o $work/f.o --cuda-path=/nowhere --cuda-gpu-arch=dlgput64 -O2 -std=c++17 -fPIC"
"$here/dlcc" $good
for bad in "$good -w" "$good -I." "$good -ffp-contract=off" "$good -std=c++20" "$good --cuda-gpu-arch=sm_80" "-c -x cuda $work/f.cu -o $work/f.o"; do
  if "$here/dlcc" $bad 2>/dev/null; then
    echo "the stand-in takes: $bad"
    exit 1
  fi
done
# A persistent kernel whose one chain does nothing, on one block, and on several that wait for each other.
gpu=$root/backends/gpu/src
program=$root/backends/program/include/novaphy/program
for form in 0 2; do
  for tasks in 0 1; do
    {
      printf '#define %s\n' NOVAPHY_PERSISTENT "PERSISTENT_FORM $form" "PERSISTENT_TASKS $((form == 0 ? tasks : 0))" \
        'PERSISTENT_WORDS 64' 'PERSISTENT_THREADS 128' 'PERSISTENT_KEPT 0' 'PERSISTENT_LAYOUTS 0' 'PERSISTENT_HALO 0' 'PERSISTENT_EARLY 0'
      echo "namespace persistent_${form}_$tasks {"
      cat "$gpu/vendors/dlan.cuh" "$gpu/vendors/generic.cuh" "$gpu/device_prelude.cuh" "$gpu/persistent.cuh" |
        sed -e "/#include \"novaphy\/program\/scalars.h\"/{r $program/scalars.h
d}" -e "/#include \"novaphy\/program\/one_lane.h\"/{r $program/one_lane.h
d}"
      echo 'LANE_FN void run_chain(uint32_t, const uint64_t*, const int64_t, const bool, const bool, const block_memory, const device_sink) {}'
      echo '}'
    } >"$work/persistent_${form}_$tasks.cu"
  done
done
"$root/backends/dlan/compile.sh" "$@" "$work"/persistent_*.cu
# Two architectures, as newer SDKs have them.
NOVAPHY_DLAN_ARCH=dlgput64,dlgpux64 "$root/backends/dlan/compile.sh" "$work/two.so" "$work/f.cu"
nm -D "$1" | grep -q novaphy_dlan_modules
