// The formulas of diff_soft_contact_trace.h against closed forms, and at their discontinuities.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

#include "novaphy/collision/diff_soft_contact_trace.h"
#include "support/bits.h"

namespace novaphy {
namespace {

using testing::same_bits;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

::testing::AssertionResult same(const Vec3f& a, const Vec3f& b) {
  return same_bits(std::span(&a, 1), std::span(&b, 1));
}

// Edge values of every input.
const std::vector<float> kGrid = {0.0f,   -0.0f,   1.0f,  -1.0f, 0.5f, -0.25f,
                                  1e-45f, -1e-38f, 1e-8f, 3.0f,  1e20f};

Vec3f force_term(const Vec3f& x, const Vec3f& v, const SoftContactMaterial<float>& material) {
  return soft_contact_force_term(x, v, 0.1f, Vec3f{}, Vec3f{}, Vec3f{0.0f, 0.0f, 1.0f}, material,
                                 0.0f);
}

TEST(SoftContactForce, IsTheSpringInPenetration) {
  const Vec3f f = force_term({3.0f, -2.0f, 0.09f}, {}, {1e4f, 10.0f, 0.0f, 0.2f});
  EXPECT_NEAR(f.z, 100.0f, 1e-3);
  EXPECT_EQ(f.x, 0.0f);
  EXPECT_EQ(f.y, 0.0f);
}

TEST(SoftContactForce, DampsApproachOnly) {
  const SoftContactMaterial<float> material = {0.0f, 10.0f, 0.0f, 0.0f};
  EXPECT_FLOAT_EQ(force_term({0.0f, 0.0f, 0.05f}, {0.0f, 0.0f, -2.0f}, material).z, 20.0f);
  EXPECT_EQ(force_term({0.0f, 0.0f, 0.05f}, {0.0f, 0.0f, 2.0f}, material).z, 0.0f);
}

TEST(SoftContactForce, FrictionIsViscousUpToTheCoulombLimit) {
  const SoftContactMaterial<float> material = {1e4f, 0.0f, 100.0f, 0.5f};
  // Depth 0.01: normal force 100, Coulomb limit 50, reached at 0.5 m/s.
  const Vec3f slow = force_term({0.0f, 0.0f, 0.09f}, {0.1f, 0.0f, 0.0f}, material);
  EXPECT_NEAR(slow.x, -10.0f, 1e-3);
  const Vec3f fast = force_term({0.0f, 0.0f, 0.09f}, {3.0f, 4.0f, 0.0f}, material);
  EXPECT_NEAR(fast.x, -30.0f, 1e-3);
  EXPECT_NEAR(fast.y, -40.0f, 1e-3);
}

TEST(SoftContactForce, ActsAtZeroDistanceAndNotAbove) {
  const SoftContactMaterial<float> material = {1e4f, 10.0f, 0.0f, 0.0f};
  const auto at = [&](float c, float adhesion) {
    return soft_contact_force_term(Vec3f{0.0f, 0.0f, c}, Vec3f{0.0f, 0.0f, -1.0f}, 0.0f, Vec3f{},
                                   Vec3f{}, Vec3f{0.0f, 0.0f, 1.0f}, material, adhesion);
  };
  EXPECT_EQ(at(0.0f, 0.0f).z, 10.0f);
  EXPECT_EQ(at(1e-45f, 0.0f).z, 0.0f);
  // Within the adhesion distance the spring pulls.
  EXPECT_FLOAT_EQ(at(0.01f, 0.02f).z, -90.0f);
  EXPECT_EQ(at(0.03f, 0.02f).z, 0.0f);
}

TEST(SoftContactForce, AddingTheTermKeepsEveryBitWithoutContactAndSubtractsWithIt) {
  const SoftContactMaterial<float> material = {1e4f, 10.0f, 7.0f, 0.3f};
  for (const float acc : kGrid) {
    const Vec3f a = {acc, -acc, acc};
    const Vec3f off = force_term({0.0f, 0.0f, 5.0f}, {1.0f, 2.0f, 3.0f}, material);
    EXPECT_TRUE(same(a + off, a)) << acc;
    EXPECT_TRUE(std::signbit(off.x) && std::signbit(off.y) && std::signbit(off.z));
    for (const float v : kGrid) {
      const Vec3f on = force_term({0.0f, 0.0f, 0.05f}, {v, v, -v}, material);
      EXPECT_TRUE(same(a + on, a - (-on))) << acc << ' ' << v;
    }
  }
}

TEST(SoftContactForce, DoesNotSwallowNaN) {
  const Vec3f f = force_term({0.0f, 0.0f, kNan}, {}, {1e4f, 10.0f, 0.0f, 0.0f});
  EXPECT_TRUE(std::isnan(f.z));
}

TEST(SoftContactForce, DependsOnTheRelativeVelocity) {
  const SoftContactMaterial<float> material = {1e4f, 10.0f, 50.0f, 0.5f};
  const Vec3f v = {1.0f, -0.5f, -2.0f}, n = {0.0f, 0.0f, 1.0f};
  const Vec3f a = soft_contact_force_term(Vec3f{}, v, 0.1f, Vec3f{}, v, n, material, 0.0f);
  const Vec3f b =
      soft_contact_force_term(Vec3f{}, Vec3f{}, 0.1f, Vec3f{}, Vec3f{}, n, material, 0.0f);
  EXPECT_TRUE(same(a, b));
}

TEST(SoftContactMaterial, IsTheMean) {
  const auto m =
      mean_soft_contact_material<float>({1.0f, 2.0f, 3.0f, 4.0f}, {3.0f, 4.0f, 5.0f, 0.0f});
  EXPECT_EQ(m.ke, 2.0f);
  EXPECT_EQ(m.kd, 3.0f);
  EXPECT_EQ(m.kf, 4.0f);
  EXPECT_EQ(m.mu, 2.0f);
}

TEST(SphereDistance, IsTheDistanceToTheCenterMinusTheRadius) {
  const auto s = sphere_distance(Vec3f{0.0f, -2.0f, 0.0f}, 0.5f);
  EXPECT_EQ(s.distance, 1.5f);
  EXPECT_EQ(s.normal, (Vec3f{0.0f, -1.0f, 0.0f}));
  const auto center = sphere_distance(Vec3f{0.0f, 0.0f, -1e-9f}, 0.5f);
  EXPECT_EQ(center.normal, (Vec3f{0.0f, 0.0f, 1.0f}));
}

TEST(CapsuleDistance, HasCapsAndACylinder) {
  const auto side = capsule_distance(Vec3f{0.0f, 2.0f, 0.5f}, 0.25f, 0.5f);
  EXPECT_EQ(side.distance, 1.75f);
  EXPECT_EQ(side.normal, (Vec3f{0.0f, 1.0f, 0.0f}));
  const auto top = capsule_distance(Vec3f{0.0f, 0.0f, 1.5f}, 0.25f, 0.5f);
  EXPECT_EQ(top.distance, 0.75f);
  EXPECT_EQ(top.normal, (Vec3f{0.0f, 0.0f, 1.0f}));
  EXPECT_EQ(capsule_distance(Vec3f{0.0f, 0.0f, -0.5f}, 0.25f, 0.5f).normal,
            (Vec3f{0.0f, 0.0f, 1.0f}));
  EXPECT_EQ(capsule_distance(Vec3f{0.0f, 0.0f, std::nextafter(-0.5f, -1.0f)}, 0.25f, 0.5f).normal.z,
            -1.0f);
}

TEST(BoxDistance, ChoosesTheFaceOnTiesAsNewton) {
  const Vec3f h = {0.5f, 0.375f, 0.25f};
  const auto normal = [&](float x, float y, float z) {
    return box_distance(Vec3f{x, y, z}, h).normal;
  };
  EXPECT_EQ(normal(0.0f, 0.0f, 0.0f), (Vec3f{0.0f, 0.0f, 1.0f}));
  EXPECT_EQ(normal(0.0f, 0.0f, -0.0f), (Vec3f{0.0f, 0.0f, 1.0f}));
  EXPECT_EQ(normal(0.5f, 0.375f, 0.25f), (Vec3f{1.0f, 0.0f, 0.0f}));      // corner
  EXPECT_EQ(normal(0.125f, -0.375f, -0.25f), (Vec3f{1.0f, 0.0f, 0.0f}));  // edge along x
  EXPECT_EQ(normal(-0.5f, 0.125f, 0.25f), (Vec3f{0.0f, 1.0f, 0.0f}));     // edge along y
  EXPECT_EQ(normal(0.5f, 0.375f, 0.125f), (Vec3f{0.0f, 0.0f, 1.0f}));     // edge along z
  EXPECT_EQ(normal(-0.4f, 0.0f, 0.0f), (Vec3f{-1.0f, 0.0f, 0.0f}));
  // The tie qx = qy > qz: the normal is z, though the distance is qx.
  EXPECT_EQ(normal(0.4375f, 0.3125f, 0.0f), (Vec3f{0.0f, 0.0f, 1.0f}));
  EXPECT_EQ(box_distance(Vec3f{0.4375f, 0.3125f, 0.0f}, h).distance, -0.0625f);
}

// Away from the surfaces where the normal jumps, every signed distance has slope 1 along its
// normal, and the point x - n*d lies on the surface.
TEST(SurfaceDistances, AreDistances) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-2.0f, 2.0f);
  const Vec3f h = {0.7f, 0.9f, 0.4f};
  int checked = 0;
  for (int i = 0; i < 20000; ++i) {
    const Vec3f x = {uniform(random), uniform(random), uniform(random)};
    const auto check = [&](const char* name, auto&& distance_of) {
      const SurfaceDistance<float> at = distance_of(x);
      EXPECT_NEAR(math::length(at.normal), 1.0f, 1e-5) << name;
      const SurfaceDistance<float> on = distance_of(x - at.normal * at.distance);
      if (std::abs(at.distance) < 0.05f)
        return;  // the rounding of a point on an edge may choose another face
      EXPECT_NEAR(on.distance, 0.0f, 2e-6) << name << ' ' << x.x << ' ' << x.y << ' ' << x.z;
      ++checked;
    };
    check("sphere", [](const Vec3f& p) { return sphere_distance(p, 0.8f); });
    check("capsule", [](const Vec3f& p) { return capsule_distance(p, 0.5f, 0.6f); });
    check("box", [&](const Vec3f& p) { return box_distance(p, h); });
    check("infinite plane", [](const Vec3f& p) { return plane_distance(p, 0.0f, 0.0f); });
    check("finite plane", [](const Vec3f& p) { return plane_distance(p, 1.5f, 2.0f); });
  }
  EXPECT_GT(checked, 50000);
}

TEST(PlaneDistance, IsInfiniteUnlessBothExtentsArePositive) {
  for (const auto& [w, l] : {std::pair{0.0f, 0.0f}, {1.0f, 0.0f}, {0.0f, 2.0f}}) {
    const auto s = plane_distance(Vec3f{100.0f, -100.0f, -3.0f}, w, l);
    EXPECT_EQ(s.distance, -3.0f);
    EXPECT_EQ(s.normal, (Vec3f{0.0f, 0.0f, 1.0f}));
  }
}

// Newton's finite plane has the unsigned distance |z| below the sheet. NovaPhy's distance is
// signed, so a particle that went through the plane is pushed back.
TEST(PlaneDistance, IsSignedUnderAFinitePlane) {
  const auto under = plane_distance(Vec3f{0.25f, 0.0f, -0.125f}, 2.0f, 2.0f);
  EXPECT_EQ(under.distance, -0.125f);
  EXPECT_EQ(under.normal, (Vec3f{0.0f, 0.0f, 1.0f}));
  const auto wall = plane_distance(Vec3f{-0.9375f, 0.0f, -0.5f}, 2.0f, 2.0f);
  EXPECT_EQ(wall.distance, -0.0625f);
  EXPECT_EQ(wall.normal, (Vec3f{-1.0f, 0.0f, 0.0f}));
  const auto beside = plane_distance(Vec3f{1.5f, 0.0f, -7.0f}, 2.0f, 2.0f);
  EXPECT_EQ(beside.distance, 0.5f);
  EXPECT_EQ(beside.normal, (Vec3f{1.0f, 0.0f, 0.0f}));
  const auto rim = plane_distance(Vec3f{0.0f, 4.0f, 4.0f}, 2.0f, 2.0f);
  EXPECT_EQ(rim.distance, 5.0f);
  EXPECT_FLOAT_EQ(rim.normal.y, 0.6f);
  EXPECT_FLOAT_EQ(rim.normal.z, 0.8f);
}

TEST(StaticShapeContact, SelectsTheTypeAndMapsToTheWorld) {
  std::mt19937 random(11);
  std::uniform_real_distribution<float> uniform(-1.5f, 1.5f);
  const Transformf xform = {{0.5f, -1.0f, 2.0f},
                            {0.18257418f, 0.36514837f, 0.5477226f, 0.73029673f}};
  const Vec3f scale = {0.6f, 0.4f, 0.8f};
  for (int i = 0; i < 1000; ++i) {
    const Vec3f x = {0.5f + uniform(random), -1.0f + uniform(random), 2.0f + uniform(random)};
    const Transformf pose = static_shape_pose(xform);
    const Vec3f local = to_shape_frame(pose, x);
    const auto expect = [&](const StaticShapeType<bool>& type,
                            const SurfaceDistance<float>& surface) {
      const auto all = static_shape_contact<true>(type, xform, scale, x);
      const auto one = static_contact_record(xform, pose, local, surface);
      EXPECT_TRUE(same(all.point, one.point) && same(all.normal, one.normal));
      EXPECT_EQ(all.distance, one.distance);
      EXPECT_NEAR(math::length(x - all.point), std::abs(all.distance), 2e-6);
    };
    expect({.is_box = true}, box_distance(local, scale));
    expect({.is_sphere = true}, sphere_distance(local, scale.x));
    expect({.is_capsule = true}, capsule_distance(local, scale.x, scale.y));
    expect({.is_cylinder = true}, cylinder_distance(local, scale.x, scale.y));
    expect({.is_cone = true}, cone_distance(local, scale.x, scale.y));
    expect({.is_ellipsoid = true}, ellipsoid_distance(local, scale));
    expect({}, plane_distance(local, scale.x, scale.y));
    const StaticShapeType<bool> box = {.is_box = true};
    EXPECT_TRUE(same(static_shape_contact<false>(box, xform, scale, x).point,
                     static_shape_contact<true>(box, xform, scale, x).point));
  }
}

// No point of the surface is nearer than the one that is named, and that is on the surface.
TEST(EllipsoidDistance, IsThatOfTheNearestPoint) {
  std::mt19937 random(12);
  std::uniform_real_distribution<float> uniform(-1.3f, 1.3f);
  constexpr int kSteps = 180;
  for (const Vec3f& h : {Vec3f{0.6f, 0.4f, 0.8f}, Vec3f{0.5f, 0.5f, 0.5f}, Vec3f{0.2f, 0.2f, 1.0f},
                         Vec3f{1.0f, 1.0f, 0.05f}}) {
    for (int i = 0; i < 60; ++i) {
      Vec3f x = {uniform(random) * h.x, uniform(random) * h.y, uniform(random) * h.z};
      if (i % 6 == 1) x.z = 0.0f;
      if (i % 6 == 2) x.x = x.y = 0.0f;
      if (i == 0) x = {};
      const SurfaceDistance<float> found = ellipsoid_distance(x, h);
      EXPECT_NEAR(math::length(found.normal), 1.0f, 1e-6f);
      const Vec3f y = x - found.normal * found.distance;
      const double on = std::pow(y.x / h.x, 2) + std::pow(y.y / h.y, 2) + std::pow(y.z / h.z, 2);
      EXPECT_NEAR(on, 1.0, 2e-5);
      const double inside =
          std::pow(x.x / h.x, 2) + std::pow(x.y / h.y, 2) + std::pow(x.z / h.z, 2);
      EXPECT_EQ(inside < 1.0, found.distance < 0.0f);
      double nearest = 1e9;
      for (int a = 0; a <= kSteps; ++a) {
        for (int b = 0; b < 2 * kSteps; ++b) {
          const double polar = M_PI * a / kSteps, turn = M_PI * b / kSteps;
          nearest = std::min(nearest, std::hypot(h.x * std::sin(polar) * std::cos(turn) - x.x,
                                                 h.y * std::sin(polar) * std::sin(turn) - x.y,
                                                 h.z * std::cos(polar) - x.z));
        }
      }
      EXPECT_LE(std::abs(found.distance), nearest + 2e-6);
      EXPECT_NEAR(std::abs(found.distance), nearest, 9e-3);  // between the samples
    }
  }
}

}  // namespace
}  // namespace novaphy
