// Replaces <novaphy/core/team.h> in device code. A team has kTeamThreads neighboring threads of a
// warp. A device without warps has teams of one thread.
#pragma once

namespace novaphy {

constexpr int64_t kTeamThreads = 8;

struct Alone {
  static constexpr int32_t rank = 0, size = 1;
  void wait() const {}
  template <class V>
  V& own(V& value) const {
    return value;
  }
  template <class V>
  void put(const V&, V&) const {}
};

#if VENDOR_WARP > 1
struct Team {
  static constexpr int32_t size = (int32_t)kTeamThreads;
  const int32_t rank;
  const uint32_t members;  // a bit for each thread of the warp
  explicit Team(const int64_t row)
      : rank((int32_t)(row % size)), members(0xffu << (row % VENDOR_WARP - row % size)) {}
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
  const bool first;
  explicit Team(const int64_t row) : first(row % kTeamThreads == 0) {}
  bool works() const { return first; }
};
#endif

}  // namespace novaphy
