// EdgeOwners: a map from each directed edge of a surface to its face.
#pragma once

#include <cstdint>
#include <unordered_map>
#include <utility>

namespace novaphy::detail {

using Edge = std::pair<int32_t, int32_t>;
struct EdgeHash {
  size_t operator()(const Edge& e) const {
    const uint64_t both =
        uint64_t{static_cast<uint32_t>(e.first)} << 32 | uint64_t{static_cast<uint32_t>(e.second)};
    return static_cast<size_t>((both * 0x9E3779B97F4A7C15u) >> 16);
  }
};
using EdgeOwners = std::unordered_map<Edge, size_t, EdgeHash>;

}  // namespace novaphy::detail
