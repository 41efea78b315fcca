// Broad phases: all give the same pairs, in the same order, as a test of every pair.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "novaphy/collision/box_pairs.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/enums.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {
namespace {

using geometry::Box3;

struct Scene {
  std::vector<Box3> boxes;
  std::vector<int32_t> body, flags, group, world;
  std::set<std::pair<int32_t, int32_t>> filter;

  void add(const Vec3f& center, const Vec3f& half, int32_t b, int32_t w = 0, int32_t g = 1) {
    boxes.push_back({center - half, center + half});
    body.push_back(b);
    flags.push_back(static_cast<int32_t>(ShapeFlags::COLLIDE_SHAPES));
    group.push_back(g);
    world.push_back(w);
  }
  ShapePairRules rules() const { return {body, flags, group, world, &filter}; }
  std::vector<Vec2i> explicit_pairs() const {
    return explicit_box_pairs(boxes, make_shape_contact_pairs(body, flags, group, world, filter));
  }
};

// Boxes of all sizes in `worlds` worlds and in all worlds, some infinite, some with a NaN.
Scene random_scene(uint32_t seed, int count, int worlds) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> u(0, 1);
  Scene s;
  for (int i = 0; i < count; ++i) {
    const float size = u(random) < 0.1f ? 0.5f : 0.05f;
    const Vec3f c = {4 * u(random), u(random), u(random)};
    const float kind = u(random);
    s.add(c, Vec3f{u(random), u(random), u(random)} * size,
          kind < 0.1f ? -1 : int32_t(u(random) * float(count) / 2),
          int32_t(u(random) * float(worlds + 1)) - 1, int32_t(u(random) * 5) - 2);
    if (kind > 0.98f) s.boxes.back().hi.y = NAN;
    if (kind > 0.96f && kind < 0.98f) s.boxes.back() = {{-1e6f, -1e6f, -1e6f}, {1e6f, 1e6f, 0.1f}};
    if (kind > 0.94f && kind < 0.96f)
      s.boxes.back() = {{-INFINITY, -INFINITY, -INFINITY}, {INFINITY, INFINITY, 0.0f}};
    if (kind > 0.92f && kind < 0.94f) s.flags.back() = 0;
    if (i > 0 && u(random) < 0.2f)  // ties
      s.boxes.back().lo.x = std::min(s.boxes[size_t(i - 1)].lo.x, s.boxes.back().hi.x);
  }
  for (int k = 0; k < count; ++k) {
    const auto i = int32_t(u(random) * float(count)), j = int32_t(u(random) * float(count));
    if (i < j) s.filter.insert({i, j});
  }
  return s;
}

TEST(BoxPairs, AreTheSameInAllThreeModes) {
  size_t pairs = 0;
  for (uint32_t seed = 0; seed < 60; ++seed) {
    const Scene s = random_scene(seed, 20 + 5 * int(seed), int(seed % 5));
    const std::vector<Vec2i> nxn = nxn_box_pairs(s.boxes, s.rules());
    pairs += nxn.size();
    EXPECT_EQ(s.explicit_pairs(), nxn) << seed;
    EXPECT_EQ(SweepAndPrune().box_pairs(s.boxes, s.rules()), nxn) << seed;
  }
  EXPECT_GT(pairs, 5000u);
}

TEST(BoxPairs, DoNotDependOnTheCallBefore) {
  SweepAndPrune sweep;
  Scene s = random_scene(5, 300, 2);
  std::mt19937 random(9);
  std::normal_distribution<float> normal;
  for (int step = 0; step < 40; ++step) {
    const float far = step % 10 == 9 ? 3.0f : 0.01f;  // small moves, and now and then large ones
    for (Box3& box : s.boxes) {
      const Vec3f d = {far * normal(random), far * normal(random), far * normal(random)};
      box = {box.lo + d, box.hi + d};
    }
    ASSERT_EQ(sweep.box_pairs(s.boxes, s.rules()), nxn_box_pairs(s.boxes, s.rules())) << step;
  }
  const Scene other = random_scene(6, 100, 3);
  EXPECT_EQ(sweep.box_pairs(other.boxes, other.rules()), nxn_box_pairs(other.boxes, other.rules()));
}

TEST(BoxPairs, OfTenThousandInALineAreThoseOfNeighbors) {
  for (int axis = 0; axis < 3; ++axis) {
    Scene s;
    for (int i = 0; i < 10000; ++i)
      s.add(geometry::unit_axis(axis, float((i * 7919) % 10000)), {0.5f, 0.5f, 0.5f}, i);
    EXPECT_EQ(SweepAndPrune().box_pairs(s.boxes, s.rules()).size(), 9999u);
  }
}

TEST(BoxPairs, OfTenThousandInOnePlaceAreCountedInFull) {
  Scene s;
  for (int i = 0; i < 10000; ++i) s.add({}, {1, 1, 1}, i);
  try {
    SweepAndPrune().box_pairs(s.boxes, s.rules(), 1000000);
    FAIL();
  } catch (const Error& e) {
    EXPECT_EQ(e.kind(), ErrorKind::Value);
    EXPECT_NE(std::string(e.what()).find("at most 1000000 pairs, got 49995000"), std::string::npos)
        << e.what();
  }
}

TEST(BoxPairs, OfWorldsThatLieInOnePlaceStayApart) {
  Scene s;
  s.add({}, {100, 100, 1}, -1, -1);  // the ground of all worlds
  for (int w = 0; w < 200; ++w)
    for (int k = 0; k < 2; ++k) s.add({0.5f * float(k), 0, 1}, {0.3f, 0.3f, 0.3f}, 2 * w + k, w);
  const std::vector<Vec2i> pairs = SweepAndPrune().box_pairs(s.boxes, s.rules());
  EXPECT_EQ(pairs.size(), 200u * 3u);
  EXPECT_EQ(pairs, nxn_box_pairs(s.boxes, s.rules()));
}

TEST(BoxPairs, RefuseWhatDoesNotFit) {
  Scene s;
  s.add({}, {1, 1, 1}, 0);
  s.add({}, {1, 1, 1}, 1);
  EXPECT_TRUE(nxn_box_pairs({}, {}).empty());
  EXPECT_TRUE(SweepAndPrune().box_pairs({}, {}).empty());
  EXPECT_THROW(nxn_box_pairs(std::span(s.boxes).first(1), s.rules()), Error);
  EXPECT_THROW(explicit_box_pairs(s.boxes, std::vector<Vec2i>{{1, 0}}), Error);
  EXPECT_THROW(explicit_box_pairs(s.boxes, std::vector<Vec2i>{{0, 2}}), Error);
  EXPECT_THROW(nxn_box_pairs(s.boxes, s.rules(), 0), Error);
  s.group.pop_back();
  EXPECT_THROW(SweepAndPrune().box_pairs(s.boxes, s.rules()), Error);
}

}  // namespace
}  // namespace novaphy
