#include "mesh_topology.h"

#include <algorithm>
#include <array>
#include <unordered_map>
#include <unordered_set>

#include "novaphy/core/error.h"

namespace novaphy::detail {
namespace {

uint64_t mixed(uint64_t x) {  // splitmix64's finalizer
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
  return x ^ (x >> 31);
}
struct Hash {
  template <size_t N>
  size_t operator()(const std::array<int32_t, N>& key) const {
    uint64_t h = 0;
    for (const int32_t k : key) h = mixed(h + 0x9E3779B97F4A7C15u + static_cast<uint32_t>(k));
    return static_cast<size_t>(h);
  }
};
template <size_t N>
std::array<int32_t, N> sorted(std::array<int32_t, N> key) {
  std::sort(key.begin(), key.end());
  return key;
}

}  // namespace

std::vector<Vec3i> surface_of(std::span<const Vec4i> tetrahedra, std::string_view function) {
  std::unordered_map<std::array<int32_t, 3>, int32_t, Hash> uses;
  uses.reserve(tetrahedra.size() * 3);
  const auto for_each_face = [&](auto&& visit) {
    for (const auto& [i, j, k, l] : tetrahedra)
      for (const Vec3i& face : {Vec3i{i, k, j}, Vec3i{j, k, l}, Vec3i{i, j, l}, Vec3i{i, l, k}})
        visit(face, uses[sorted<3>({face.x, face.y, face.z})]);
  };
  for_each_face([&](const Vec3i& face, int32_t& count) {
    require(++count <= 2, ErrorKind::Value, function, ": the face (", face.x, ", ", face.y, ", ",
            face.z, ") belongs to more than two tetrahedra: expected a manifold mesh");
  });
  std::vector<Vec3i> surface;
  for_each_face([&](const Vec3i& face, const int32_t& count) {
    if (count == 1) surface.push_back(face);
  });
  return surface;
}

std::vector<Vec4i> edges_of(std::span<const Vec3i> triangles, std::string_view function,
                            std::string_view advice) {
  struct Known {
    size_t row;
    int32_t uses;
  };
  std::unordered_map<std::array<int32_t, 2>, Known, Hash> known;
  known.reserve(triangles.size() * 2);
  std::vector<Vec4i> edges;
  for (const auto& [a, b, c] : triangles) {
    for (const Vec3i& corner : {Vec3i{a, b, c}, Vec3i{b, c, a}, Vec3i{c, a, b}}) {
      const auto [from, to, opposite] = corner;
      const auto [at, is_new] = known.try_emplace(sorted<2>({from, to}), Known{edges.size(), 0});
      if (is_new) {
        edges.push_back({opposite, -1, from, to});
      } else {
        edges[at->second.row].y = opposite;
      }
      require(++at->second.uses <= 2, ErrorKind::Value, function, ": the edge (", from, ", ", to,
              ") belongs to more than two triangles", advice);
    }
  }
  return edges;
}

std::vector<Vec2i> spring_pairs(std::span<const Vec4i> edges) {
  std::unordered_set<std::array<int32_t, 2>, Hash> known;
  std::vector<Vec2i> pairs;
  const auto add = [&](int32_t a, int32_t b) {
    if (a < 0 || b < 0) return;
    const auto key = sorted<2>({a, b});
    if (known.insert(key).second) pairs.push_back({key[0], key[1]});
  };
  for (const auto& [i, j, k, l] : edges) {
    add(k, l);
    add(i, k);
    add(i, l);
    add(j, k);
    add(j, l);
    add(i, j);
  }
  return pairs;
}

}  // namespace novaphy::detail
