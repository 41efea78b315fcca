// Pairs with known results: poses in which other libraries fail, and the contact points that
// support a stack.
#include <gtest/gtest.h>

#include "collision/geometry_reference.h"

namespace geometry_test {
namespace {

constexpr Quatf kUpright = {0.0f, 0.0f, 0.0f, 1.0f};
constexpr Quatf kLying = {0.0f, 0.70710678f, 0.0f, 0.70710678f};  // z becomes x

Solid solid(GeoType type, Vec3f scale, Vec3f p = {}, Quatf q = kUpright) {
  return {{type, scale, {}}, {p, q}, nullptr};
}
Quatf turn(Vec3f axis, double degrees) {
  const double half = degrees * 0.008726646259971648;
  const float s = float(std::sin(half));
  return {axis.x * s, axis.y * s, axis.z * s, float(std::cos(half))};
}
geometry::Manifold collide(const Solid& a, const Solid& b, float gap = 0.05f) {
  return geometry::collide(a.shape, a.pose, b.shape, b.pose, gap);
}
void expect_normal(const geometry::Manifold& m, const Vec3f& n, float tolerance = 1e-5f) {
  EXPECT_NEAR(m.normal.x, n.x, tolerance);
  EXPECT_NEAR(m.normal.y, n.y, tolerance);
  EXPECT_NEAR(m.normal.z, n.z, tolerance);
}
void expect_distances(const geometry::Manifold& m, float distance, float tolerance = 1e-6f) {
  for (int32_t i = 0; i < m.count; ++i)
    EXPECT_NEAR(m.points[i].distance, distance, tolerance) << "point " << i;
}
Solid hull_cube(float h, Vec3f p = {}, Quatf q = kUpright) {
  Solid s = solid(GeoType::CONVEX_MESH, {}, p, q);
  std::vector<Vec3f> corners;
  for (int i = 0; i < 8; ++i) corners.push_back({i & 1 ? h : -h, i & 2 ? h : -h, i & 4 ? h : -h});
  Scenes::set_hull(s, corners);
  return s;
}

// libccd#25: one cube upon another gave NaN.
TEST(PairCases, ACubeThatTouchesAnotherRestsOnFourCorners) {
  for (const float depth : {0.0f, 0.001f, -0.001f}) {
    const Vec3f above = {0.0f, 0.0f, 2.0f - depth};
    for (const auto& [a, b] :
         {std::pair{solid(GeoType::BOX, {1, 1, 1}), solid(GeoType::BOX, {1, 1, 1}, above)},
          std::pair{hull_cube(1.0f), hull_cube(1.0f, above)},
          std::pair{solid(GeoType::BOX, {1, 1, 1}), hull_cube(1.0f, above)}}) {
      const geometry::Manifold m = collide(a, b);
      ASSERT_EQ(m.count, 4) << depth;
      expect_normal(m, {0, 0, 1});
      expect_distances(m, -depth);
      for (int i = 0; i < 4; ++i) EXPECT_NEAR(m.points[i].position.z, 1 - 0.5f * depth, 1e-6f);
    }
  }
}

// Small tilts are rounding for the axes across two edges: the faces must keep the contact.
TEST(PairCases, ANearlyAlignedBoxKeepsFourPointsAndItsTilt) {
  for (const double degrees : {1e-6, 1e-5, 1e-4, 1e-3, 0.01, 0.1, 0.5})
    for (const Vec3f axis : {Vec3f{1, 0, 0}, Vec3f{0.6f, 0.8f, 0}, Vec3f{0, 0.28f, 0.96f}}) {
      const Solid a = solid(GeoType::BOX, {1, 1, 1});
      const Solid b =
          solid(GeoType::BOX, {0.5f, 0.5f, 0.5f}, {0.1f, 0.2f, 1.495f}, turn(axis, degrees));
      const geometry::Manifold m = collide(a, b);
      ASSERT_EQ(m.count, 4) << degrees;
      const Rigid r = rigid(b.pose);
      for (int i = 0; i < 4; ++i) {
        double nearest = 1e9;  // each is a corner of b, at its own height above the face
        for (int k = 0; k < 4; ++k) {
          const Vec3d c = r.point({k & 1 ? 0.5 : -0.5, k & 2 ? 0.5 : -0.5, -0.5});
          if (std::hypot(c.x - m.points[i].position.x, c.y - m.points[i].position.y) < 0.05)
            nearest = std::min(nearest, std::abs(c.z - 1.0 - m.points[i].distance));
        }
        EXPECT_LT(nearest, 2e-5) << degrees;
      }
    }
}

TEST(PairCases, BoxesTurnedAgainstEachOtherHaveEightPoints) {
  const geometry::Manifold m =
      collide(solid(GeoType::BOX, {1, 1, 1}),
              solid(GeoType::BOX, {1, 1, 1}, {0, 0, 1.99f}, turn({0, 0, 1}, 45)));
  EXPECT_EQ(m.count, 8);
  expect_normal(m, {0, 0, 1});
  expect_distances(m, -0.01f);
}

TEST(PairCases, CrossedBoxesMeetInTheirCommonSquare) {
  const geometry::Manifold m = collide(solid(GeoType::BOX, {1, 0.1f, 0.1f}),
                                       solid(GeoType::BOX, {0.1f, 1, 0.1f}, {0, 0, 0.195f}));
  ASSERT_EQ(m.count, 4);
  expect_distances(m, -0.005f);
  for (int i = 0; i < 4; ++i) {
    EXPECT_NEAR(std::abs(m.points[i].position.x), 0.1f, 1e-5f);
    EXPECT_NEAR(std::abs(m.points[i].position.y), 0.1f, 1e-5f);
  }
}

TEST(PairCases, EdgesThatCrossTouchInOnePoint) {
  const Solid a = solid(GeoType::BOX, {1, 1, 1}, {}, turn({1, 0, 0}, 45));
  const Solid b = solid(GeoType::BOX, {1, 1, 1}, {0.3f, 0.2f, 2.8f}, turn({0, 1, 0}, 45));
  const geometry::Manifold m = collide(a, b);
  ASSERT_EQ(m.count, 1);
  expect_normal(m, {0, 0, 1});
  EXPECT_NEAR(m.points[0].distance, 2.8f - 2 * std::sqrt(2.0f), 1e-6f);
  EXPECT_NEAR(m.points[0].position.x, 0.3f, 1e-5f);
  EXPECT_NEAR(m.points[0].position.y, 0.0f, 1e-5f);
}

// FCL threw here: "origin is outside of the polytope".
TEST(PairCases, ParallelCapsulesHaveTwoContactsAtTheEndsOfTheirOverlap) {
  const Solid a = solid(GeoType::CAPSULE, {0.1f, 0.5f, 0}, {}, kLying);
  for (const double degrees : {0.0, 1e-5, 1e-3, 0.1, 0.5}) {
    const Solid b = solid(GeoType::CAPSULE, {0.1f, 0.5f, 0}, {0.4f, 0, 0.19f},
                          math::multiply(turn({0, 0, 1}, degrees), kLying));
    const geometry::Manifold m = collide(a, b);
    ASSERT_EQ(m.count, 2) << degrees;
    expect_normal(m, {0, 0, 1}, 0.01f);
    expect_distances(m, -0.01f, 1e-4f);
    const float lo = std::min(m.points[0].position.x, m.points[1].position.x);
    const float hi = std::max(m.points[0].position.x, m.points[1].position.x);
    EXPECT_NEAR(lo, -0.1f, 1e-3f);
    EXPECT_NEAR(hi, 0.5f, 1e-3f);
  }
}

TEST(PairCases, CapsulesInOneLineTouchAtTheirEnds) {
  const geometry::Manifold m = collide(solid(GeoType::CAPSULE, {0.1f, 0.5f, 0}),
                                       solid(GeoType::CAPSULE, {0.1f, 0.5f, 0}, {0, 0, 1.19f}));
  ASSERT_EQ(m.count, 1);
  expect_normal(m, {0, 0, 1});
  EXPECT_NEAR(m.points[0].distance, -0.01f, 1e-6f);
}

TEST(PairCases, SegmentsThatCrossPartAcrossTheirPlane) {
  const geometry::Manifold m = collide(solid(GeoType::CAPSULE, {0.1f, 0.5f, 0}),
                                       solid(GeoType::CAPSULE, {0.2f, 0.5f, 0}, {}, kLying));
  ASSERT_EQ(m.count, 1);
  EXPECT_NEAR(std::abs(m.normal.y), 1.0f, 1e-5f);
  EXPECT_NEAR(m.points[0].distance, -0.3f, 1e-6f);
}

// MuJoCo 4.0 errs where the segment passes through the box.
TEST(PairCases, ACapsuleThroughABoxLeavesByTheShortestWay) {
  const Solid box = solid(GeoType::BOX, {0.5f, 0.4f, 0.3f});
  const geometry::Manifold m =
      collide(solid(GeoType::CAPSULE, {0.1f, 1.0f, 0}, {0, 0, 0.25f}, kLying), box);
  expect_normal(m, {0, 0, -1});
  ASSERT_EQ(m.count, 2);
  expect_distances(m, -0.15f);
  for (int i = 0; i < 2; ++i) EXPECT_NEAR(std::abs(m.points[i].position.x), 0.5f, 1e-5f);
}

TEST(PairCases, ACapsuleLyingOnABoxHasTwoContacts) {
  for (const double degrees : {0.0, 1e-4, 0.5, 2.0}) {
    const Solid capsule = solid(GeoType::CAPSULE, {0.1f, 0.3f, 0}, {0, 0, 0.595f},
                                math::multiply(turn({0, 1, 0}, degrees), kLying));
    const geometry::Manifold m = collide(capsule, solid(GeoType::BOX, {0.5f, 0.5f, 0.5f}));
    ASSERT_EQ(m.count, 2) << degrees;
    expect_normal(m, {0, 0, -1}, 1e-3f);
  }
}

TEST(PairCases, ACylinderStandsOnACylinderWithEightPointsAndLiesWithTwo) {
  const Solid below = solid(GeoType::CYLINDER, {0.5f, 0.5f, 0});
  const geometry::Manifold stands =
      collide(below, solid(GeoType::CYLINDER, {0.3f, 0.5f, 0}, {0, 0, 0.99f}));
  EXPECT_EQ(stands.count, 8);
  expect_normal(stands, {0, 0, 1}, 1e-4f);
  expect_distances(stands, -0.01f, 1e-4f);
  const geometry::Manifold lies =
      collide(below, solid(GeoType::CYLINDER, {0.3f, 0.4f, 0}, {0, 0, 0.79f}, kLying));
  EXPECT_EQ(lies.count, 2);
  expect_normal(lies, {0, 0, 1}, 1e-3f);
  expect_distances(lies, -0.01f, 1e-4f);
}

TEST(PairCases, ShapesInOnePlaceHaveAFixedNormal) {
  const Solid spheres = solid(GeoType::SPHERE, {0.5f, 0, 0});
  expect_normal(collide(spheres, spheres), {1, 0, 0});
  expect_normal(collide(spheres, solid(GeoType::BOX, {1, 1, 1})), {-1, 0, 0});
  for (const GeoType type : kConvexTypes) {
    Scenes scenes(5);
    const Solid s = scenes.solid(type);
    const geometry::Manifold m = collide(s, s), again = collide(s, s);
    ASSERT_GT(m.count, 0) << geo_type_name(type);
    EXPECT_EQ(m.normal, again.normal);
    EXPECT_LT(m.points[0].distance, 0.0f);
  }
}

// fcl#319 and others: GJK and EPA disagree about a kiss.
TEST(PairCases, AKissingContactHasDistanceZero) {
  for (const GeoType ta : kConvexTypes)
    for (const GeoType tb : kConvexTypes) {
      Scenes scenes(100 * uint32_t(ta) + uint32_t(tb));
      for (int i = 0; i < 20; ++i) {
        Solid a = scenes.solid(ta), b = scenes.solid(tb);
        // the separation along a direction is 0, so the shapes touch or are apart
        scenes.place(a, b, 0.0);
        const geometry::Manifold m = collide(a, b, 10.0f);
        ASSERT_GT(m.count, 0);
        EXPECT_GT(m.points[0].distance, -2e-6f);
        EXPECT_NEAR(math::length(m.normal), 1.0f, 1e-5f);
      }
    }
}

TEST(PairCases, FlatBoxesMeetAsExactlyAsThickOnes) {
  const Solid ground = solid(GeoType::BOX, {10, 10, 1e-4f});
  const geometry::Manifold m =
      collide(ground, solid(GeoType::BOX, {0.5f, 0.5f, 0.1f}, {2, 3, 0.1f}));
  ASSERT_EQ(m.count, 4);
  expect_normal(m, {0, 0, 1});
  expect_distances(m, -1e-4f, 1e-6f);
  const geometry::Manifold sheets =
      collide(ground, solid(GeoType::BOX, {1, 1, 1e-4f}, {0, 0, 1.5e-4f}));
  ASSERT_EQ(sheets.count, 4);
  expect_distances(sheets, -0.5e-4f, 1e-6f);
}

TEST(PairCases, FarFromTheOriginOnlyThePosesLoseDigits) {
  const Vec3f far = {10000.0f, -10000.0f, 0.0f};
  const geometry::Manifold m = collide(solid(GeoType::BOX, {1, 1, 1}, far),
                                       solid(GeoType::BOX, {1, 1, 1}, far + Vec3f{0, 0, 1.99f}));
  ASSERT_EQ(m.count, 4);
  expect_distances(m, -0.01f);
}

TEST(PairCases, APointOfAConeIsNearestToItsFaces) {
  const Solid cone = solid(GeoType::CONE, {0.5f, 0.5f, 0});
  auto ball = [](Vec3f p) { return solid(GeoType::SPHERE, {0.01f, 0, 0}, p); };
  const float k = std::sqrt(1.25f);
  struct Case {
    Vec3f p, n;
    float distance;
  };
  for (const Case& c :
       {Case{{0, 0, 0.7f}, {0, 0, 1}, 0.2f}, Case{{0, 0, -0.7f}, {0, 0, -1}, 0.2f},
        Case{{0.7f, 0, -0.5f}, {1, 0, 0}, 0.2f}, Case{{0.1f, 0, -0.45f}, {0, 0, -1}, -0.05f},
        Case{{0, 0, 0.3f}, {1 / k, 0, 0.5f / k}, -0.1f / k}}) {
    const geometry::Manifold m = collide(cone, ball(c.p), 1.0f);
    ASSERT_EQ(m.count, 1);
    expect_normal(m, c.n);
    EXPECT_NEAR(m.points[0].distance, c.distance - 0.01f, 1e-6f);
  }
}

}  // namespace
}  // namespace geometry_test
