// Included before device code that a host compiler reads. Device threads run on the host, and a
// stub is a function that runs one thread. fake_runtime.cpp schedules the threads and their waits.
#pragma once

#include <cmath>
#include <cstdint>
#include <cstring>
#include <utility>

#include "fake_stub.h"

#define threadIdx fake_dlan_thread
#define blockIdx fake_dlan_block
#define blockDim fake_dlan_block_size
#define gridDim fake_dlan_grid_size
#define __syncthreads fake_dlan_wait

// In the namespaces of device code, whose names come before the host's.
namespace novaphy_kernels {
namespace {
#include "fake_driver/host_intrinsics.h"
}
}  // namespace novaphy_kernels
namespace novaphy_module {
namespace {
#include "fake_driver/host_intrinsics.h"
}
}  // namespace novaphy_module

// Blocks run one after the other, so one copy serves all.
#define __shared__ static
#define VENDOR_SHARED(type, name) type* const name = static_cast<type*>(fake_dlan_shared)

template <class... P>
struct FakeCall {
  template <void (*kernel)(P...)>
  static void run(void* const* arguments) {
    [&]<size_t... k>(std::index_sequence<k...>) { kernel(*static_cast<P*>(arguments[k])...); }
    (std::index_sequence_for<P...>());
  }
};
template <auto kernel, class... P>
const FakeStub* fake_stub(void (*)(P...)) {
  static constexpr FakeStub stub = {&FakeCall<P...>::template run<kernel>};
  return &stub;
}
#define NOVAPHY_STUB(kernel) (fake_stub<kernel>(kernel))
