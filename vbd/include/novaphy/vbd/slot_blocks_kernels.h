// Moves particles by thread blocks on devices. The threads of a block first compute the terms of
// all slots of some groups of particles. Then one thread for each component of a particle's force
// and stiffness adds the terms, in slot order.
#pragma once

#include "novaphy/vbd/sweep_kernels.h"

#ifdef NOVAPHY_KERNEL
namespace novaphy::vbd {

// A block has kThreads threads, and handles the particles of up to G groups. A term is the block
// (force and stiffness) of one lane of a slot. Terms are stored by role, in the order of the sums.
// The terms of a role begin at a multiple of kAlign, so that the threads of a warp work on few
// roles.
constexpr int kThreads = 128, kAlign = 32, kComponents = 9;

// The shared memory of a thread block. The struct has no constructors, because CUDA runs none for
// shared memory.
struct BlockMemory {
  float terms[kComponents][kVbdBlockTerms];
  float outer[kComponents][kVbdLanes * kVbdLargeBlock],
      inner[kComponents][kVbdLanes * kVbdLargeBlock];
  float x[kVbdLanes * kVbdLargeBlock][3];
  int64_t first[kRoles][kVbdLargeBlock];  // the first slot of each role and group
  int32_t count[kRoles][kVbdLargeBlock];
};

inline void store_block(float* to, int stride, const Block<float>& b) {
  to[0] = b.f.x;
  to[stride] = b.f.y;
  to[2 * stride] = b.f.z;
  to[3 * stride] = b.h00;
  to[4 * stride] = b.h11;
  to[5 * stride] = b.h22;
  to[6 * stride] = b.h01;
  to[7 * stride] = b.h02;
  to[8 * stride] = b.h12;
}

template <Role role, int G>
inline void put_term(const VbdSweepArguments& a, BlockMemory& m, int32_t begin, int32_t term) {
  const int32_t k = term - begin, lane = k % kVbdLanes, group = k / kVbdLanes % G,
                number = k / (kVbdLanes * G);
  if (number >= m.count[role][group]) return;
  const float* const x = m.x[group * kVbdLanes + lane];
  const Slot<role, float> slot(a, m.first[role][group] + number, lane);
  store_block(&m.terms[0][term], kVbdBlockTerms,
              block_of(inputs_of(slot, Vec3f{x[0], x[1], x[2]}, a.x), ((a.damped >> role) & 1) != 0,
                       a.turns != 0));
}

// Computes the blocks (force and stiffness) of the particles of the groups [first, end), at most G
// groups. The results have the same bits as block_at. All threads of the thread block call the
// function.
//
// The thread of a particle makes a `Finish` from the arguments. ask(lane) loads early what put
// needs, also for lanes without a particle. place(lane) returns the position of the particle.
// put(lane, block) receives the result.
template <int G, class Finish, class Arguments>
inline void for_block(const VbdSweepArguments& a, const Arguments& arguments, int64_t first,
                      int64_t end, BlockMemory& m) {
  constexpr int32_t kLanes = kVbdLanes * G;
  const auto thread = static_cast<int32_t>(threadIdx.x);
  const auto groups = static_cast<int32_t>(end - first < G ? end - first : G);
  Finish finish(arguments);
  const auto lane_of = [&](int32_t k) {
    return LaneGroup<float>(a, (first - a.first_group) * kVbdLanes + k);
  };
  const bool has_lane = thread < groups * kVbdLanes;
  const LaneGroup<float> g = lane_of(has_lane ? thread : 0);
  if (has_lane) {
    finish.ask(g);
    const Vec3f x = finish.place(g);
    m.x[thread][0] = x.x;
    m.x[thread][1] = x.y;
    m.x[thread][2] = x.z;
    store_block(&m.inner[0][thread], kLanes, inertia_block(x, g.at(a.target), g.mass_by_h2()));
  }
  if (const int32_t v = thread - (kThreads - kLanes); v >= 0 && v < groups * kVbdLanes) {
    const LaneGroup<float> of = lane_of(v);
    store_block(&m.outer[0][v], kLanes, contact_blocks(of, finish.place(of)));
  }
  for (int32_t k = thread - 2 * kAlign; k >= 0 && k < kRoles * G; k += kThreads) {
    const int32_t role = k / G, group = k % G;
    const bool any = group < groups && a.begin[role] != nullptr;
    const int64_t begin = any ? a.begin[role][first + group] : 0;
    m.first[role][group] = begin;
    m.count[role][group] = any ? static_cast<int32_t>(a.begin[role][first + group + 1] - begin) : 0;
  }
  __syncthreads();

  int32_t begin[kRoles + 1];
  begin[0] = 0;
#pragma unroll
  for (int role = 0; role < kRoles; ++role) {
    int32_t most = 0;
#pragma unroll
    for (int g = 0; g < G; ++g) most = m.count[role][g] > most ? m.count[role][g] : most;
    begin[role + 1] = begin[role] + (most * kLanes + kAlign - 1) / kAlign * kAlign;
  }
  for (int32_t term = thread; term < begin[kRoles]; term += kThreads)
    for_roles([&](auto is) {
      constexpr Role role = decltype(is)::role;
      if (term >= begin[role] && term < begin[role + 1]) put_term<role, G>(a, m, begin[role], term);
    });
  __syncthreads();

  for (int32_t k = thread; k < kComponents * kLanes; k += kThreads) {
    const int32_t v = k % kLanes, component = k / kLanes, group = v / kVbdLanes;
    float outer = (&m.outer[0][0])[component * kLanes + v];
    float inner = (&m.inner[0][0])[component * kLanes + v];
#pragma unroll
    for (int role = 0; role < kRoles; ++role) {
      const float* term = &m.terms[component][begin[role] + v];
      const int32_t count = m.count[role][group];
      float sum = is_outer(role) ? outer : inner;
#pragma unroll 8
      for (int32_t s = 0; s < count; ++s) sum = sum + term[s * kLanes];
      (is_outer(role) ? outer : inner) = sum;
    }
    (&m.inner[0][0])[component * kLanes + v] = inner + outer;
  }
  __syncthreads();

  if (has_lane && g.filled != 0) {
    const float* const of = &m.inner[0][0] + thread;
    finish.put(g, Block<float>{{of[0], of[kLanes], of[2 * kLanes]},
                               of[3 * kLanes],
                               of[4 * kLanes],
                               of[5 * kLanes],
                               of[6 * kLanes],
                               of[7 * kLanes],
                               of[8 * kLanes]});
  }
}

// Calls for_block for the chunks of G groups `block`, `block` + `blocks`, ... of the groups [first,
// end).
template <int G, class Finish, class Arguments>
inline void for_blocks_of(const VbdSweepArguments& a, const Arguments& arguments, int64_t first,
                          int64_t end, int64_t block, int64_t blocks, BlockMemory& memory) {
  for (int64_t group = first + block * G; group < end; group += blocks * G) {
    for_block<G, Finish>(a, arguments, group, end, memory);
    __syncthreads();
  }
}
template <class Finish, class Arguments>
inline void for_blocks(const VbdSweepArguments& a, const Arguments& arguments, int64_t first,
                       int64_t end, int64_t block, int64_t blocks, BlockMemory& memory) {
  if (a.block_groups == 1) {
    for_blocks_of<1, Finish>(a, arguments, first, end, block, blocks, memory);
  } else {
    for_blocks_of<kVbdLargeBlock, Finish>(a, arguments, first, end, block, blocks, memory);
  }
}

}  // namespace novaphy::vbd
#endif
