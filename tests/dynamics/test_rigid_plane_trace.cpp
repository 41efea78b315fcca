// The traced kernel selects the same corners as the contact search, and gives the wrench of the
// solver.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "novaphy/collision/geometry/shapes/box.h"
#include "novaphy/dynamics/semi_implicit/rigid_plane_trace.h"
#include "support/bits.h"

namespace novaphy {
namespace {

struct Poses {
  std::mt19937 random{5};
  std::normal_distribution<float> normal;
  Transformf next() {
    Quatf q = {normal(random), normal(random), normal(random), normal(random)};
    const float l = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    return {{normal(random), normal(random), 0.3f * normal(random)},
            {q.x / l, q.y / l, q.z / l, q.w / l}};
  }
};

TEST(RigidPlaneTrace, KeepsTheCornersOfTheContactSearchInTheSameSlots) {
  Poses poses;
  const Vec3f half = {0.2f, 0.3f, 0.5f};
  std::vector<int> counts(5);
  for (int k = 0; k < 3000; ++k) {
    const Transformf plane_pose = k % 2 ? poses.next() : Transformf::identity();
    Transformf box = poses.next();
    if (k % 5 == 0) box.q = Quatf::identity();  // ties
    const geometry::Plane plane = geometry::plane_of(plane_pose);
    const float reach = k % 3 ? 0.2f : 1e3f;
    const geometry::Manifold expected = geometry::Box(half).on_plane(plane, box, reach);
    const CornerSlots<float> kept =
        deepest_corners(WorldPlane<float>{plane.point, plane.normal, 0.0f}, box, half, reach);
    ASSERT_EQ(static_cast<int>(kept.count), expected.count);
    ++counts[static_cast<size_t>(expected.count)];
    for (int j = 0; j < expected.count; ++j) {
      const geometry::ContactPoint& point = expected.points[j];
      ASSERT_EQ(kept.distance[j], point.distance) << k;
      ASSERT_EQ(kept.corner[j],
                (Vec3f{point.feature & 1 ? half.x : -half.x, point.feature & 2 ? half.y : -half.y,
                       point.feature & 4 ? half.z : -half.z}));
    }
  }
  EXPECT_GT(counts[0], 100);
  EXPECT_GT(counts[2], 50);
  EXPECT_GT(counts[4], 500);
}

TEST(RigidPlaneTrace, ACapsuleHasTwoPointsAndASphereOne) {
  const WorldPlane<float> ground = {{}, {0.0f, 0.0f, 1.0f}, 0.01f};
  const RigidContactMaterial<float> material = {1e4f, 0.0f, 0.0f, 0.0f, 0.0f};
  const float s = std::sqrt(0.5f);
  BodyMotion<float> body;
  body.pose.p = {0.0f, 0.0f, 0.1f};
  const auto lift = [&](bool is_capsule) {
    const BodyShape<bool, float> shape = {
        false, is_capsule, {{}, {0.0f, s, 0.0f, s}}, {0.1f, 0.2f, 0.0f}, 0.02f};
    return plane_contact_wrench(FrictionLaw::Huber, ground, shape, body, 0.2f, material, 0.1f);
  };
  // Both margins deep, 3 cm.
  EXPECT_NEAR(lift(false).linear.z, 300.0f, 0.1f);
  EXPECT_NEAR(lift(true).linear.z, 600.0f, 0.2f);
  EXPECT_NEAR(lift(true).angular.y, 0.0f, 1e-3f);
}

}  // namespace
}  // namespace novaphy
