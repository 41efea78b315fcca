// Pairs of features of moving surfaces: those of a test of every pair, with distances sampled over
// the features.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <random>
#include <tuple>
#include <vector>

#include "novaphy/collision/geometry/nearest_weights.h"
#include "novaphy/collision/surface_pairs.h"

namespace novaphy {
namespace {

using geometry::Vec3d;

struct Soup {
  std::vector<Vec3i> triangles;
  std::vector<Vec3f> rest;
  std::vector<Vec4f> x;
  std::vector<int32_t> world;
  std::vector<float> reach;

  Vec3d at(int32_t p) const {
    const Vec4f& v = x[static_cast<size_t>(p)];
    return {static_cast<double>(v.x), static_cast<double>(v.y), static_cast<double>(v.z)};
  }
};

// Strips of two triangles in a box, in `worlds` worlds and in all worlds.
Soup random_soup(uint32_t seed, int strips, int worlds) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> place(-0.5f, 0.5f), side(-0.1f, 0.1f);
  Soup s;
  for (int k = 0; k < strips; ++k) {
    const auto first = static_cast<int32_t>(s.x.size());
    const Vec3f center = {place(random), place(random), place(random)};
    for (int c = 0; c < 4; ++c) {
      const Vec3f v = center + Vec3f{side(random), side(random), side(random)};
      s.x.push_back({v.x, v.y, v.z, 0.0f});
      s.rest.push_back(Vec3f{place(random), place(random), place(random)} * 1e4f);
      s.world.push_back(worlds == 1 ? 0 : k % (worlds + 1) - 1);
      s.reach.push_back(0.01f * (1.0f + place(random)));
    }
    s.triangles.push_back({first, first + 1, first + 2});
    s.triangles.push_back({first + 1, first + 3, first + 2});
  }
  return s;
}

using Key = std::tuple<bool, std::array<int32_t, 4>>;

std::vector<std::array<int32_t, 2>> edges_of(const Soup& s) {
  std::vector<std::array<int32_t, 2>> edges;
  for (const Vec3i& t : s.triangles)
    for (const auto& [p, q] : {std::minmax(t.x, t.y), std::minmax(t.y, t.z), std::minmax(t.x, t.z)})
      edges.push_back({p, q});
  std::sort(edges.begin(), edges.end());
  edges.erase(std::unique(edges.begin(), edges.end()), edges.end());
  return edges;
}

bool may_meet(const Soup& s, int32_t p, int32_t q) {
  const int32_t a = s.world[static_cast<size_t>(p)], b = s.world[static_cast<size_t>(q)];
  return a < 0 || b < 0 || a == b;
}

std::vector<Key> every_pair(const Soup& s, float radius) {
  std::vector<Key> pairs;
  const auto try_pair = [&](std::array<int32_t, 4> p, size_t first) {
    for (size_t a = 0; a < first; ++a)
      for (size_t b = first; b < 4; ++b)
        if (p[a] == p[b] || !may_meet(s, p[a], p[b])) return;
    const Vec3d x[4] = {s.at(p[0]), s.at(p[1]), s.at(p[2]), s.at(p[3])};
    float reach[2] = {0.0f, 0.0f};
    for (size_t k = 0; k < 4; ++k)
      reach[k >= first] = std::max(reach[k >= first], s.reach[static_cast<size_t>(p[k])]);
    const double most = static_cast<double>(radius + (reach[0] + reach[1])) * 1.00001;
    const auto n = first == 2 ? geometry::nearest_of_edges(x) : geometry::nearest_to_triangle(x);
    if (n.distance < most) pairs.push_back({first == 2, p});
  };
  for (int32_t p = 0; p < static_cast<int32_t>(s.x.size()); ++p)
    for (const Vec3i& t : s.triangles) try_pair({p, t.x, t.y, t.z}, 1);
  const auto edges = edges_of(s);
  for (size_t i = 0; i < edges.size(); ++i)
    for (size_t j = i + 1; j < edges.size(); ++j)
      try_pair({edges[i][0], edges[i][1], edges[j][0], edges[j][1]}, 2);
  return pairs;
}

TEST(SurfacePairs, AreThoseOfATestOfEveryPair) {
  for (const int worlds : {1, 3}) {
    const Soup s = random_soup(7, 60, worlds);
    SurfacePairs surface(s.triangles, s.world, s.rest, 0.02f);
    std::vector<Key> found;
    for (const SurfacePair& pair : surface.find(s.x, s.reach)) {
      found.push_back({pair.has_edges, pair.particle});
      EXPECT_EQ(pair.radius, 0.02f);
    }
    std::vector<Key> wanted = every_pair(s, 0.02f);
    std::sort(found.begin(), found.end());
    std::sort(wanted.begin(), wanted.end());
    EXPECT_GT(wanted.size(), 100u);
    EXPECT_EQ(found, wanted);
  }
}

// Returns the least distance between points of both sides, over a grid of weights.
double sampled_distance(const Vec3d (&x)[4], bool has_edges) {
  double least = 1e9;
  constexpr int kSteps = 60;
  for (int i = 0; i <= kSteps; ++i)
    for (int j = 0; j <= (has_edges ? kSteps : kSteps - i); ++j) {
      const double s = static_cast<double>(i) / kSteps, t = static_cast<double>(j) / kSteps;
      const Vec3d d = has_edges ? (x[0] + (x[1] - x[0]) * s) - (x[2] + (x[3] - x[2]) * t)
                                : x[0] - (x[1] + ((x[2] - x[1]) * s + (x[3] - x[1]) * t));
      least = std::min(least, std::sqrt(math::dot(d, d)));
    }
  return least;
}

TEST(NearestWeights, AreNearerThanAllSamples) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> place(-1.0, 1.0);
  for (int k = 0; k < 800; ++k) {
    Vec3d x[4];
    for (Vec3d& v : x) v = {place(random), place(random), place(random)};
    const bool has_edges = k % 2 == 0;
    // Triangles without area: two equal corners, or three on a line.
    if (k % 16 == 1) x[2] = x[1];
    if (k % 16 == 3) x[3] = x[2];
    if (k % 16 == 5) x[3] = x[1];
    if (k % 16 == 7) x[3] = x[1] + (x[2] - x[1]) * place(random);
    const auto n = has_edges ? geometry::nearest_of_edges(x) : geometry::nearest_to_triangle(x);
    const double sampled = sampled_distance(x, has_edges);
    EXPECT_LE(n.distance, sampled + 1e-12);
    EXPECT_GT(n.distance, sampled - 0.08);
    double first = 0.0, second = 0.0;
    for (int c = 0; c < 4; ++c) {
      const bool is_first = c < (has_edges ? 2 : 1);
      (is_first ? first : second) += n.weight[c];
      EXPECT_GE(is_first ? n.weight[c] : -n.weight[c], 0.0);
    }
    EXPECT_NEAR(first, 1.0, 1e-12);
    EXPECT_NEAR(second, -1.0, 1e-12);
  }
}

TEST(SurfacePairs, PairsThatAreNearAtRestGetASmallerRadius) {
  // Two triangles, 0.01 m apart.
  const std::vector<Vec3f> rest = {{0, 0, 0},     {1, 0, 0},     {0, 1, 0},
                                   {0, 0, 0.01f}, {1, 0, 0.01f}, {0, 1, 0.01f}};
  const std::vector<Vec3i> triangles = {{0, 1, 2}, {3, 4, 5}};
  const std::vector<int32_t> world(6, 0);
  SurfacePairs surface(triangles, world, rest, 0.02f);
  std::vector<Vec4f> x;
  for (const Vec3f& v : rest) x.push_back({v.x, v.y, v.z, 0.0f});
  const auto& pairs = surface.find(x, std::vector<float>(6, 0.0f));
  ASSERT_EQ(pairs.size(), 6u + 9u);
  for (const SurfacePair& pair : pairs) {
    EXPECT_NEAR(pair.distance, 0.01f, 1e-7f);
    EXPECT_NEAR(pair.radius, 0.009f, 1e-7f);
  }
  EXPECT_EQ(surface.shortest_edge(), 1.0f);
}

TEST(SurfacePairs, FindAnEdgeThatPassesThroughATriangle) {
  Soup s = random_soup(5, 1, 1);
  s.x = {{0, 0, 0, 0}, {1, 0, 0, 0}, {0, 1, 0, 0}, {1, 1, 0, 0}};
  for (const Vec3f& v : {Vec3f{0.2f, 0.2f, -1}, Vec3f{0.2f, 0.2f, 1}, Vec3f{-5, -5, 1}})
    s.x.push_back({v.x, v.y, v.z, 0.0f});
  s.triangles.push_back({4, 5, 6});
  s.world.assign(7, 0);
  s.rest.resize(7);
  SurfacePairs surface(s.triangles, s.world, s.rest, 0.02f);
  // The corner 0 lies on the other triangle, and does not pass through.
  const auto crossing = surface.find_crossing(s.x);
  ASSERT_TRUE(crossing.has_value());
  EXPECT_EQ(*crossing, (std::array<int32_t, 5>{4, 5, 0, 1, 2}));
  s.x[4].z = 0.5f;
  EXPECT_FALSE(surface.find_crossing(s.x).has_value());
}

}  // namespace
}  // namespace novaphy
