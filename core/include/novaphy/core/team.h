// Teams: the threads of a device that share the work of one item. A warp has several teams.
//
//   NOVAPHY_ROW_KERNEL(solve, SolveArguments) {
//     const Team team(row);
//     if (team.works()) solve_item(team, a, row / kTeamThreads);
//   }
//
// A launch over n items has n * kTeamThreads rows. On the CPU, and on devices without warps, a team
// is one thread, and the other rows do nothing. Code for teams is a template over Team or Alone:
//
//   for (int32_t k = team.rank; k < count; k += team.size) ...   // shared work
//   team.wait();                                                 // before others read its results
#pragma once

#include <cstdint>

namespace novaphy {

constexpr int64_t kTeamThreads = 8;

// A thread that works alone.
struct Alone {
  static constexpr int32_t rank = 0, size = 1;
  // Waits until all threads of the team have come here.
  void wait() const {}
  // Returns the thread's own copy of a value. A thread that works alone has the value itself.
  template <class V>
  V& own(V& value) const {
    return value;
  }
  // Writes an own copy back, for all threads of the team.
  template <class V>
  void put(const V&, V&) const {}
};

// The team of a row.
#if defined(VENDOR_WARP) && VENDOR_WARP > 1  // in the text for a device with warps
struct Team {
  static constexpr int32_t size = static_cast<int32_t>(kTeamThreads);
  const int32_t rank;
  const uint32_t members;  // a bit for each thread of the warp
  explicit Team(int64_t row)
      : rank(static_cast<int32_t>(row % size)),
        members(((1u << size) - 1u) << (row % VENDOR_WARP - row % size)) {}
  // Returns whether the row's thread is part of the team.
  bool works() const { return true; }
  void wait() const { vendor_warp_barrier(members); }
  template <class V>
  V own(const V& value) const {
    return value;
  }
  template <class V>
  void put(const V& value, V& to) const {
    if (rank == 0) to = value;
  }
};
#else
struct Team : Alone {
  explicit Team(int64_t row) : works_(row % kTeamThreads == 0) {}
  bool works() const { return works_; }

 private:
  bool works_;
};
#endif

}  // namespace novaphy
