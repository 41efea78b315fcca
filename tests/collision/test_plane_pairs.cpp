// A plane with the other primitives: depths against support functions, features, ties.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "novaphy/collision/geometry/shapes/list.h"

namespace novaphy::geometry {
namespace {

using namespace math;

Plane ground() { return plane_of(Transformf::identity()); }

float deepest(const Manifold& manifold) {
  float d = INFINITY;
  for (int k = 0; k < manifold.count; ++k) d = std::min(d, manifold.points[k].distance);
  return d;
}

struct Poses {
  std::mt19937 random{11};
  std::normal_distribution<float> normal;
  Quatf turn() {
    Quatf q = {normal(random), normal(random), normal(random), normal(random)};
    const float l = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    return {q.x / l, q.y / l, q.z / l, q.w / l};
  }
  Transformf next() { return {{normal(random), normal(random), normal(random)}, turn()}; }
};

// The lowest point of B along the normal of the plane, from its support function.
template <class Support, class Pair>
void expect_depths(Support&& support, Pair&& pair) {
  Poses poses;
  for (int k = 0; k < 1000; ++k) {
    const Plane plane = plane_of(poses.next());
    const Transformf pose = poses.next();
    const Manifold manifold = pair(plane, pose);
    const Vec3f n = rotate_inverse(pose.q, plane.normal);
    const float expected = dot(plane.normal, pose.p - plane.point) - support(-n);
    ASSERT_GE(manifold.count, 1);
    ASSERT_EQ(manifold.normal, plane.normal);
    ASSERT_NEAR(deepest(manifold), expected, 2e-5f) << k;
    for (int i = 0; i < manifold.count; ++i) {
      const ContactPoint& point = manifold.points[i];
      // The midpoint lies half of the distance above the plane.
      ASSERT_NEAR(dot(plane.normal, point.position - plane.point), 0.5f * point.distance, 2e-5f);
    }
  }
}

TEST(PlanePairs, TheDeepestPointIsThatOfTheSupportFunction) {
  expect_depths([](const Vec3f&) { return 0.3f; },
                [](const Plane& p, const Transformf& x) {
                  return Sphere({0.3f, 0.0f, 0.0f}).on_plane(p, x, 0.0f);
                });
  expect_depths([](const Vec3f& d) { return 0.3f + 0.5f * std::abs(d.z); },
                [](const Plane& p, const Transformf& x) {
                  return Capsule({0.3f, 0.5f, 0.0f}).on_plane(p, x, 0.0f);
                });
  const Vec3f half = {0.2f, 0.3f, 0.5f};
  expect_depths(
      [&](const Vec3f& d) {
        return half.x * std::abs(d.x) + half.y * std::abs(d.y) + half.z * std::abs(d.z);
      },
      [&](const Plane& p, const Transformf& x) { return Box(half).on_plane(p, x, 1e6f); });
  expect_depths([](const Vec3f& d) { return 0.3f * std::hypot(d.x, d.y) + 0.5f * std::abs(d.z); },
                [](const Plane& p, const Transformf& x) {
                  return Cylinder({0.3f, 0.5f, 0.0f}).on_plane(p, x, 0.0f);
                });
  expect_depths(
      [](const Vec3f& d) { return std::max(0.3f * std::hypot(d.x, d.y) - 0.5f * d.z, 0.5f * d.z); },
      [](const Plane& p, const Transformf& x) {
        return Cone({0.3f, 0.5f, 0.0f}).on_plane(p, x, 0.0f);
      });
  expect_depths(
      [&](const Vec3f& d) {
        return length(Vec3f{half.x * d.x, half.y * d.y, half.z * d.z});
      },
      [&](const Plane& p, const Transformf& x) { return Ellipsoid(half).on_plane(p, x, 0.0f); });
}

TEST(PlanePairs, AFlatBoxKeepsItsLowerCorners) {
  const Manifold manifold =
      Box({0.1f, 0.1f, 0.1f}).on_plane(ground(), {{0.0f, 0.0f, 0.09f}, Quatf::identity()}, 1.0f);
  ASSERT_EQ(manifold.count, 4);
  for (int k = 0; k < 4; ++k) {
    EXPECT_EQ(manifold.points[k].feature, k);
    EXPECT_NEAR(manifold.points[k].distance, -0.01f, 1e-7f);
  }
}

TEST(PlanePairs, TheFourDeepestCornersOfABoxAreKept) {
  Poses poses;
  for (int k = 0; k < 1000; ++k) {
    const Transformf pose = poses.next();
    const Vec3f half = {0.2f, 0.3f, 0.5f};
    std::vector<float> all;
    for (int c = 0; c < 8; ++c)
      all.push_back(transform_point(pose, Vec3f{c & 1 ? half.x : -half.x, c & 2 ? half.y : -half.y,
                                                c & 4 ? half.z : -half.z})
                        .z);
    std::sort(all.begin(), all.end());
    const Manifold manifold = Box(half).on_plane(ground(), pose, 1e6f);
    std::vector<float> kept;
    for (int i = 0; i < manifold.count; ++i) kept.push_back(manifold.points[i].distance);
    std::sort(kept.begin(), kept.end());
    ASSERT_EQ(kept.size(), 4u);
    for (size_t i = 0; i < 4; ++i) ASSERT_NEAR(kept[i], all[i], 1e-5f);
  }
  // Points beyond the reach are not kept.
  EXPECT_EQ(Box({0.1f, 0.1f, 0.1f})
                .on_plane(ground(), {{0.0f, 0.0f, 1.0f}, Quatf::identity()}, 0.5f)
                .count,
            0);
}

TEST(PlanePairs, AStandingCylinderHasThreePointsAndALyingOneTwo) {
  const auto near_ground = [](const Manifold& manifold) {
    return std::count_if(manifold.points, manifold.points + manifold.count,
                         [](const ContactPoint& p) { return p.distance < 0.01f; });
  };
  EXPECT_EQ(near_ground(Cylinder({0.3f, 0.5f, 0.0f})
                            .on_plane(ground(), {{0.0f, 0.0f, 0.5f}, Quatf::identity()}, 0.0f)),
            3);
  const float s = std::sqrt(0.5f);
  const Manifold lying = Cylinder({0.3f, 0.5f, 0.0f})
                             .on_plane(ground(), {{0.0f, 0.0f, 0.3f}, {0.0f, s, 0.0f, s}}, 0.0f);
  EXPECT_EQ(near_ground(lying), 2);
}

// The points of the rim rotate with the body. A fixed point below a rolling disc would brake it.
TEST(PlanePairs, ACapThatRollsTouchesAtItsDeepestPointOnly) {
  Poses poses;
  for (int k = 0; k < 2000; ++k) {
    const Transformf pose = poses.next();
    const float flatness = std::abs(rotate(pose.q, Vec3f{0.0f, 0.0f, 1.0f}).z);
    const float sine = std::sqrt(1.0f - std::min(1.0f, flatness * flatness));
    for (const bool cone : {false, true}) {
      const Manifold manifold = cone ? Cone({0.3f, 0.5f, 0.0f}).on_plane(ground(), pose, 0.0f)
                                     : Cylinder({0.3f, 0.5f, 0.0f}).on_plane(ground(), pose, 0.0f);
      ASSERT_EQ(manifold.points[0].feature, 0);
      for (int i = 1; i < manifold.count - 1; ++i) {
        ASSERT_GT(flatness, std::cos(22.5f * 3.1415927f / 180.0f));
        if (flatness < 0.998f) {  // a quarter of the height of the disc
          ASSERT_GT(manifold.points[i].distance, manifold.points[0].distance + 0.149f * sine);
        }
      }
      if (flatness < 0.92f) {
        ASSERT_EQ(manifold.count, 2);
      }
    }
  }
}

TEST(PlanePairs, APoseThatIsNoNumberGivesNoFiniteDistance) {
  const Manifold manifold =
      Box({0.1f, 0.1f, 0.1f}).on_plane(ground(), {{NAN, 0.0f, 0.0f}, Quatf::identity()}, 1.0f);
  for (int k = 0; k < manifold.count; ++k) EXPECT_FALSE(manifold.points[k].distance <= 1.0f);
}

}  // namespace
}  // namespace novaphy::geometry
