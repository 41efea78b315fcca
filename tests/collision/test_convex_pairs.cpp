// All pairs of convex shapes in random poses, against exact distances (geometry_reference.h) and
// against properties that need no reference.
#include <gtest/gtest.h>

#include <cstdio>

#include "collision/geometry_reference.h"

namespace geometry_test {
namespace {

constexpr int kPosesPerPair = 36, kManyPosesPerPair = 360;  // 28 pairs: 10^3 and 10^4 poses
constexpr int kFuzzedPairs = 80000;
constexpr float kFar = 10.0f;  // m: more than any distance here

double deepest(const geometry::Manifold& m) {
  double d = 1e300;
  for (int32_t i = 0; i < m.count; ++i) d = std::min(d, double(m.points[i].distance));
  return d;
}
geometry::Manifold collide(const Solid& a, const Solid& b, float gap = kFar) {
  return geometry::collide(a.shape, a.pose, b.shape, b.pose, gap);
}
double degrees_between(const Vec3d& a, const Vec3d& b) {
  return std::atan2(norm(math::cross(a, b)), math::dot(a, b)) * 57.29577951308232;
}
std::string name(GeoType a, GeoType b) {
  return std::string(geo_type_name(a)) + "-" + geo_type_name(b);
}

template <class Check>
void for_all_pairs(int poses, double scale, Check check) {
  for (const GeoType ta : kConvexTypes)
    for (const GeoType tb : kConvexTypes) {
      if (tb < ta) continue;
      Scenes scenes(1000 * uint32_t(ta) + uint32_t(tb));
      for (int i = 0; i < poses; ++i) {
        Solid a = scenes.solid(ta, scale), b = scenes.solid(tb, scale);
        scenes.place(a, b, scenes.uniform(-0.25, 0.1) * scale);
        SCOPED_TRACE(name(ta, tb) + " pose " + std::to_string(i));
        check(a, b);
      }
    }
}

// The separation along any direction is a lower bound of the signed distance, in double precision.
// So the exact distance is the larger of two values: the result of the search, and the separation
// along the answer's own normal. An answer is right if it equals that distance. Where two
// directions separate a pair equally well (to 1e-5 m), either normal is right. Each exception is
// printed.
void check_exact(int poses_per_pair) {
  int poses = 0, overlapping = 0, wrong_distance = 0, wrong_normal = 0, wrong_sign = 0;
  for_all_pairs(poses_per_pair, 1.0, [&](const Solid& a, const Solid& b) {
    const geometry::Manifold m = collide(a, b);
    ASSERT_GT(m.count, 0);
    const Vec3d n = unit(widen(m.normal));
    const double along_normal = ExactPair(a, b).separation(n);
    const Exact searched = exact_distance(a, b);
    const double exact = std::max(searched.distance, along_normal), found = deepest(m);
    ++poses;
    overlapping += exact < 0 ? 1 : 0;
    const bool off = std::abs(found - exact) > 1e-5;
    const bool turned = degrees_between(n, searched.normal) > 1.0 && exact - along_normal > 1e-5;
    wrong_distance += off;
    wrong_normal += turned;
    wrong_sign += std::abs(exact) > 1e-5 && (found < 0) != (exact < 0) ? 1 : 0;
    if (off || turned)
      std::printf("%s: exact %.6f m, off by %.2e m, normal off by %.1f degrees\n",
                  name(a.shape.type, b.shape.type).c_str(), exact, found - exact,
                  degrees_between(n, searched.normal));
  });
  std::printf("%d poses, %d overlapping: %d wrong distances, %d wrong normals\n", poses,
              overlapping, wrong_distance, wrong_normal);
  EXPECT_GT(overlapping, 0.3 * poses);
  EXPECT_LT(overlapping, 0.7 * poses);
  EXPECT_LE(wrong_distance, 1 + poses / 1000);
  EXPECT_LE(wrong_normal, 1 + poses / 1000);
  EXPECT_EQ(wrong_sign, 0);
}
TEST(ConvexPairs, HaveTheExactDistanceAndNormal) { check_exact(kPosesPerPair); }
// For --gtest_also_run_disabled_tests.
TEST(ConvexPairs, DISABLED_HaveTheExactDistanceAndNormalInTenThousandPoses) {
  check_exact(kManyPosesPerPair);
}

TEST(ConvexPairs, PartAlongTheBestOfAllAxesOfPolytopes) {
  Scenes scenes(12);
  const GeoType types[] = {GeoType::BOX, GeoType::CONVEX_MESH};
  int overlapping = 0;
  for (int i = 0; i < 240; ++i) {
    Solid a = scenes.solid(types[i % 2], 1.0, 12), b = scenes.solid(types[i / 2 % 2], 1.0, 12);
    scenes.place(a, b, scenes.uniform(-0.3, 0.0));
    const Exact exact = exact_overlap(a, b);
    if (exact.distance > 0) continue;
    ++overlapping;
    const geometry::Manifold m = collide(a, b);
    const Vec3d n = unit(widen(m.normal));
    // Boxes may take a face that is worse than an edge by the bias (box_box.h).
    EXPECT_NEAR(deepest(m), exact.distance, 1e-5) << i;
    EXPECT_NEAR(ExactPair(a, b).separation(n), exact.distance, 1e-5) << i;
  }
  EXPECT_GT(overlapping, 100);
}

TEST(ConvexPairs, GiveTheSameNormalAndDepthWhenExchanged) {
  int poses = 0, different = 0;
  for_all_pairs(40, 1.0, [&](const Solid& a, const Solid& b) {
    const geometry::Manifold ab = collide(a, b), ba = collide(b, a);
    ASSERT_GT(ba.count, 0);
    EXPECT_NEAR(deepest(ab), deepest(ba), 1e-5);
    if (a.shape.type != b.shape.type) {
      EXPECT_EQ(ab.count, ba.count);
      EXPECT_EQ(ab.normal, -ba.normal);
      for (int32_t i = 0; i < ab.count; ++i)
        EXPECT_EQ(ab.points[i].position, ba.points[i].position);
    }
    ++poses;
    different += norm(widen(ab.normal + ba.normal)) > 0.02 ? 1 : 0;  // two equally good directions
  });
  EXPECT_LE(different, poses / 100);
}

TEST(ConvexPairs, MoveWithTheirFrame) {
  int poses = 0, different = 0;
  Scenes scenes(7);
  for_all_pairs(20, 1.0, [&](Solid a, Solid b) {
    const geometry::Manifold before = collide(a, b);
    const Transformf motion = {narrow(scenes.direction() * 3.0), scenes.rotation()};
    a.pose = math::multiply(motion, a.pose);
    b.pose = math::multiply(motion, b.pose);
    const geometry::Manifold after = collide(a, b);
    EXPECT_NEAR(deepest(before), deepest(after), 1e-5);
    ++poses;
    different += norm(widen(math::rotate(motion.q, before.normal) - after.normal)) > 0.02 ? 1 : 0;
  });
  EXPECT_LE(different, poses / 50);
}

// Shapes that are their own mirror image: the contacts are mirrored with the poses.
TEST(ConvexPairs, AreMirroredWithTheirPoses) {
  int poses = 0, different = 0;
  const auto mirrored = [](Transformf t) {  // in the plane x = 0
    return Transformf{{-t.p.x, t.p.y, t.p.z}, {t.q.x, -t.q.y, -t.q.z, t.q.w}};
  };
  for_all_pairs(20, 1.0, [&](Solid a, Solid b) {
    if (a.shape.type == GeoType::CONVEX_MESH || b.shape.type == GeoType::CONVEX_MESH) return;
    const geometry::Manifold before = collide(a, b);
    a.pose = mirrored(a.pose);
    b.pose = mirrored(b.pose);
    const geometry::Manifold after = collide(a, b);
    EXPECT_NEAR(deepest(before), deepest(after), 1e-5);
    ++poses;
    const Vec3f n = {-before.normal.x, before.normal.y, before.normal.z};
    different += norm(widen(n - after.normal)) > 0.02 ? 1 : 0;  // two equally good directions
  });
  EXPECT_GT(poses, 300);
  EXPECT_LE(different, poses / 50);
}

// Depth and position scale with the shapes, from millimeters to kilometers.
TEST(ConvexPairs, AreAsExactAtEveryScale) {
  for (const double scale : {1e-3, 1e3}) {
    int poses = 0, wrong = 0;
    for_all_pairs(10, scale, [&](const Solid& a, const Solid& b) {
      const geometry::Manifold m = collide(a, b, float(kFar * scale));
      ASSERT_GT(m.count, 0);
      const double along = ExactPair(a, b).separation(unit(widen(m.normal)));
      const double exact = std::max(exact_distance(a, b, 300).distance, along);
      ++poses;
      wrong += std::abs(deepest(m) - exact) > 2e-5 * scale ? 1 : 0;
    });
    // The coarse search misses no better direction. But shapes of any size lie up to 2 m apart from
    // the origin, so a millimeter loses digits.
    EXPECT_LE(wrong, poses / 50) << "scale " << scale;
  }
}

// No point of a manifold is deeper than the pair, and none is farther than the gap. Features are
// unique and ascending. The surface points lie on both shapes, or in them down to the depth.
TEST(ConvexPairs, KeepTheirPointsWithinTheShapes) {
  for_all_pairs(40, 1.0, [&](const Solid& a, const Solid& b) {
    const float gap = 0.02f;
    const geometry::Manifold m = collide(a, b, gap);
    const ExactPair pair(a, b);
    if (m.count == 0) return;
    const Vec3d n = unit(widen(m.normal));
    EXPECT_NEAR(math::length(m.normal), 1.0f, 1e-6f);
    const Vec3d on_a = pair.ra.point(support(a.shape, pair.ra.in(n)));
    const Vec3d on_b = pair.rb.point(support(b.shape, pair.rb.in(n * -1.0)));
    for (int32_t i = 0; i < m.count; ++i) {
      const geometry::ContactPoint& p = m.points[i];
      EXPECT_LE(p.distance, gap);
      EXPECT_GE(p.distance, pair.separation(n) - 1e-5);
      if (i > 0) {
        EXPECT_LT(m.points[i - 1].feature, p.feature);
      }
      const double reach = std::abs(double(p.distance)) + 1e-4;
      EXPECT_LE(math::dot(n, widen(p.position) - on_a), reach);
      EXPECT_GE(math::dot(n, widen(p.position) - on_b), -reach);
    }
  });
}

bool is_sound(const geometry::Manifold& m) {
  if (m.count < 0 || m.count > geometry::kManifoldCapacity) return false;
  if (m.count > 0 && !(std::abs(math::length(m.normal) - 1.0f) < 1e-3f)) return false;
  for (int32_t i = 0; i < m.count; ++i) {
    const geometry::ContactPoint& p = m.points[i];
    if (!std::isfinite(p.distance) || !std::isfinite(p.position.x) ||
        !std::isfinite(p.position.y) || !std::isfinite(p.position.z))
      return false;
  }
  return true;
}

// Needles, plates, dust and boulders, apart, touching, coincident and deep in each other.
void fuzz_pairs(int pairs) {
  Scenes scenes(99);
  int hits = 0;
  std::vector<Solid> hulls;
  for (int i = 0; i < 50; ++i)
    hulls.push_back(scenes.solid(GeoType::CONVEX_MESH, std::pow(10.0, scenes.uniform(-3, 3))));
  for (int i = 0; i < pairs; ++i) {
    Solid s[2];
    for (Solid& solid : s) {
      const int kind = int(scenes.uniform(0, 7));
      if (kind == 6) {
        solid = hulls[size_t(scenes.uniform(0, 50))];
        solid.pose.q = scenes.rotation();
      } else {
        solid = scenes.solid(kConvexTypes[kind], std::pow(10.0, scenes.uniform(-3, 3)));
        const double thin = scenes.uniform(0, 4);
        if (thin < 1) solid.shape.scale.x *= 1e-4f;
        if (thin > 1 && thin < 2) solid.shape.scale.y *= 1e-4f;
        if (thin > 2 && thin < 2.1) solid.shape.scale = {};
      }
      if (scenes.uniform(0, 1) < 0.3) solid.pose.q = Quatf::identity();
    }
    const double kind = scenes.uniform(0, 4);
    if (kind < 1) s[1] = s[0];
    if (kind < 3) scenes.place(s[0], s[1], kind < 2 ? 0.0 : scenes.uniform(-1, 0.1));
    if (kind > 3.5) s[0].pose.p = s[1].pose.p = {};
    const geometry::Manifold m = collide(s[0], s[1], 0.1f);
    hits += m.count > 0 ? 1 : 0;
    ASSERT_TRUE(is_sound(m)) << "pair " << i << " " << name(s[0].shape.type, s[1].shape.type);
  }
  EXPECT_GT(hits, pairs / 2);
}
TEST(ConvexPairs, StaySoundForAllKindsOfShapes) { fuzz_pairs(kFuzzedPairs); }
// For --gtest_also_run_disabled_tests.
TEST(ConvexPairs, DISABLED_StaySoundForAMillionPairs) { fuzz_pairs(1000000); }

TEST(ConvexPairs, HaveNoContactsWhereANumberIsNotFinite) {
  Scenes scenes(3);
  for (const GeoType type : kConvexTypes)
    for (const float bad : {NAN, INFINITY}) {
      Solid a = scenes.solid(type), b = scenes.solid(GeoType::BOX);
      scenes.place(a, b, -0.05);
      ASSERT_GT(collide(a, b).count, 0);
      Solid moved = a;
      moved.pose.p.y = bad;
      EXPECT_EQ(collide(moved, b).count, 0);
      moved = a;
      moved.pose.q.w = bad;
      EXPECT_EQ(collide(b, moved).count, 0);
    }
}

}  // namespace
}  // namespace geometry_test
