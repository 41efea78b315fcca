// The interface between the fake run-time library and kernels compiled for it.
#pragma once

struct FakeStub {
  void (*run)(void* const* arguments);  // the thread that is set below
};
struct FakeIndex {
  unsigned x, y, z;
};
extern "C" {
extern FakeIndex fake_dlan_thread, fake_dlan_block, fake_dlan_block_size, fake_dlan_grid_size;
extern void* fake_dlan_shared;
void fake_dlan_wait();  // for all threads of the block that have not returned
}
