// Sets of contact points: sorting and reduction.
#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <vector>

#include "novaphy/collision/geometry/manifold.h"

namespace novaphy::geometry {
namespace {

ContactCandidates set_of(const std::vector<ContactPoint>& points) {
  ContactCandidates set;
  set.normal = {0, 0, 1};
  for (const ContactPoint& p : points) add_contact(set, p.position, p.distance, p.feature);
  return set;
}
std::vector<int32_t> features(const auto& set) {
  std::vector<int32_t> f;
  for (int32_t i = 0; i < set.count; ++i) f.push_back(set.points[i].feature);
  return f;
}

TEST(Manifold, ReducesASquareWithMiddlePointsToItsCorners) {
  std::vector<ContactPoint> points;
  for (int i = 0; i < 9; ++i)
    points.push_back({{float(i % 3) - 1, float(i / 3) - 1, 0}, i == 0 ? -0.2f : -0.1f, i});
  EXPECT_EQ(features(reduce_contacts<4>(set_of(points))), (std::vector<int32_t>{0, 2, 6, 8}));
}

TEST(Manifold, KeepsTheDeepestPointAlways) {
  std::mt19937 random(1);
  std::uniform_real_distribution<float> uniform(-1, 1);
  for (int run = 0; run < 200; ++run) {
    std::vector<ContactPoint> points;
    for (int i = 0; i < 30; ++i)
      points.push_back({{uniform(random), uniform(random), 0}, uniform(random), i});
    const auto deepest = std::min_element(points.begin(), points.end(),
                                          [](auto& a, auto& b) { return a.distance < b.distance; });
    for (const int limit : {1, 2, 3, 4, 8}) {
      const auto kept = features(reduce_contacts<8>(set_of(points), limit));
      EXPECT_EQ(int(kept.size()), limit);
      EXPECT_TRUE(std::count(kept.begin(), kept.end(), deepest->feature));
    }
  }
}

TEST(Manifold, ReducesToTheSamePointsInWhateverOrderTheyCome) {
  std::mt19937 random(2);
  std::vector<ContactPoint> points;
  for (int i = 0; i < 25; ++i)  // a grid: many ties of distance and area
    points.push_back({{float(i % 5), float(i / 5), 0}, -0.1f, 10 * i});
  const auto four = features(reduce_contacts<4>(set_of(points)));
  const auto eight = features(reduce_contacts<8>(set_of(points)));
  EXPECT_EQ(four, (std::vector<int32_t>{0, 40, 200, 240}));
  for (int run = 0; run < 50; ++run) {
    std::shuffle(points.begin(), points.end(), random);
    EXPECT_EQ(features(reduce_contacts<4>(set_of(points))), four);
    EXPECT_EQ(features(reduce_contacts<8>(set_of(points))), eight);
  }
}

TEST(Manifold, StaysAsItIsWithinTheLimit) {
  const auto set = set_of({{{1, 0, 0}, -0.1f, 7}, {{0, 0, 0}, -0.2f, 3}});
  EXPECT_EQ(features(reduce_contacts<8>(set)), (std::vector<int32_t>{3, 7}));
}

TEST(Manifold, IgnoresPointsThatFindNoRoom) {
  Manifold m;
  for (int i = 0; i < 20; ++i) add_contact(m, {}, 0.0f, i);
  EXPECT_EQ(m.count, kManifoldCapacity);
  EXPECT_EQ(m.points[7].feature, 7);
}

}  // namespace
}  // namespace novaphy::geometry
