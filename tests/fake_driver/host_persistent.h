// The intrinsics and functions that the text of a persistent kernel expects, for the host.
// test_persistent_run.cpp includes this file before the text. The threads of all blocks are fibers
// of one thread. The fibers run in a random order until each waits for another.
#include <ucontext.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <map>
#include <memory>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

namespace {

struct Index {
  unsigned x;
};
Index blockIdx, blockDim, gridDim, threadIdx;

struct Fiber {
  ucontext_t context;
  std::unique_ptr<char[]> stack;
  bool done = false;
  // Counts of the fiber: barriers of its block, arrivals at a barrier of all blocks, and waits
  // there.
  size_t at_block = 0, arrived = 0, waited = 0, shown = 0;
};
std::vector<Fiber> g_fibers;
Fiber* g_running;
ucontext_t g_scheduler;
std::function<void()> g_thread;
std::map<std::pair<unsigned, size_t>, size_t> g_at_block;  // block, how often: threads there
std::map<size_t, size_t> g_arrived;
std::map<unsigned, size_t> g_handed_over;  // block: arrivals, of whichever threads
// The state of a block's barrier: finished turns, missing bytes, and whether the bytes are known.
struct Came {
  size_t turns = 0;
  int64_t lack = 0;
  bool expected = false;
};
std::map<std::pair<unsigned, unsigned>, Came> g_came_of;  // block, odd or even
std::vector<std::function<void()>> g_under_way;           // rows that have not come yet
// The words that the lanes of a warp exchange.
struct Shown {
  std::vector<int32_t> words;
  size_t taken = 0;
};
std::map<std::pair<unsigned, size_t>, Shown> g_shown;

void give_way() { swapcontext(&g_running->context, &g_scheduler); }
void begin() {
  g_thread();
  g_running->done = true;
  give_way();
}
void sync_block() {
  size_t& here = g_at_block[{blockIdx.x, g_running->at_block++}];
  ++here;
  while (here < blockDim.x) give_way();
}
void hand_over_block() { ++g_handed_over[blockIdx.x]; }
void take_over_block() {
  const size_t& here = g_handed_over[blockIdx.x];
  const size_t complete = (here / blockDim.x + 1) * blockDim.x;
  hand_over_block();
  while (here < complete) give_way();
}
// Other threads run first, before the next statement of this thread.
void arrive_all() {
  ++g_arrived[g_running->arrived++];
  give_way();
}
void wait_all() {
  const size_t& here = g_arrived[g_running->waited++];
  while (here < g_fibers.size()) give_way();
}

void came(unsigned block, unsigned turn, int64_t bytes, bool expected) {
  Came& here = g_came_of[{block, turn % 2}];
  here.lack += bytes;
  here.expected = here.expected || expected;
  if (!here.expected || here.lack != 0) return;
  here.expected = false;
  ++here.turns;
}
void expect_bytes(unsigned turn, int64_t bytes) { came(blockIdx.x, turn, bytes, true); }
// As with an mbarrier, `turn` is the current turn or the one before, which its parity tells.
void wait_turn(unsigned turn) {
  const Came& here = g_came_of[{blockIdx.x, turn % 2}];
  while (here.turns % 2 == turn / 2 % 2) give_way();
}
void send_later(unsigned block, unsigned turn, int64_t bytes, const std::function<void()>& write) {
  g_under_way.push_back([=] {
    write();
    came(block, turn, -bytes, false);
  });
}
int32_t show(int32_t word, uint32_t lane) {
  constexpr unsigned kWarp = 32;
  const unsigned first = threadIdx.x / kWarp * kWarp, mine = threadIdx.x - first;
  const std::pair key{blockIdx.x * blockDim.x + first, g_running->shown++};
  Shown& shown = g_shown[key];
  shown.words.resize(kWarp);
  shown.words[mine] = word;
  ++shown.taken;
  while (shown.taken < kWarp) give_way();
  return shown.words[lane];
}

void run_all(unsigned seed) {
  constexpr size_t kStack = 128 << 10;
  g_at_block.clear();
  g_arrived.clear();
  g_handed_over.clear();
  g_came_of.clear();
  g_under_way.clear();
  g_shown.clear();
  g_fibers.clear();
  g_fibers.resize(size_t{gridDim.x} * blockDim.x);
  for (Fiber& fiber : g_fibers) {
    fiber.stack = std::make_unique_for_overwrite<char[]>(kStack);
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = fiber.stack.get();
    fiber.context.uc_stack.ss_size = kStack;
    fiber.context.uc_link = nullptr;
    makecontext(&fiber.context, begin, 0);
  }
  std::vector<unsigned> order(g_fibers.size());
  std::iota(order.begin(), order.end(), 0u);
  std::mt19937 random(seed);
  for (size_t left = g_fibers.size(); left > 0;) {
    std::shuffle(order.begin(), order.end(), random);
    for (const unsigned k : order) {
      g_running = &g_fibers[k];
      if (g_running->done) continue;
      blockIdx.x = k / blockDim.x;
      threadIdx.x = k % blockDim.x;
      swapcontext(&g_scheduler, &g_running->context);
      left -= g_running->done ? 1 : 0;
    }
    // Some of the sent rows arrive, in any order.
    std::shuffle(g_under_way.begin(), g_under_way.end(), random);
    const size_t stay = g_under_way.size() / 2;
    for (size_t k = stay; k < g_under_way.size(); ++k) g_under_way[k]();
    g_under_way.resize(stay);
  }
}

}  // namespace

namespace device {
namespace {

#include "host_intrinsics.h"

void __threadfence_block() {}
void __syncthreads() { sync_block(); }

#define __cluster_dims__(...)
