// Convex shapes on triangle meshes.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <set>
#include <string>

#include "collision/geometry_reference.h"
#include "novaphy/collision/geometry/mesh_pair.h"
#include "novaphy/collision/mesh_tree.h"
#include "novaphy/core/error.h"
#include "support/triangles.h"

namespace geometry_test {
namespace {

using geometry::MeshContact;

using novaphy::testing::cube;
using novaphy::testing::flat;
using novaphy::testing::terrain;
using novaphy::testing::Triangles;

std::vector<MeshContact> all_contacts(const MeshTree& tree, const Solid& b, float gap) {
  std::vector<MeshContact> c;
  geometry::collide_mesh(mesh_view(tree), b.shape, b.pose, gap,
                         [&](const MeshContact& contact) { c.push_back(contact); });
  return c;
}
void reduce(const MeshTree& tree, std::vector<MeshContact>& c) {
  c.resize(size_t(geometry::reduce_mesh_contacts(mesh_view(tree), c.data(), int32_t(c.size()))));
}
std::vector<MeshContact> contacts(const MeshTree& tree, const Solid& b, float gap = 0.02f) {
  std::vector<MeshContact> c = all_contacts(tree, b, gap);
  reduce(tree, c);
  return c;
}
Solid solid(GeoType type, Vec3f scale, Vec3f p, Quatf q = {0, 0, 0, 1}) {
  return {{type, scale, {}}, {p, q}, nullptr};
}
Quatf about_z(double degrees) {
  const double half = degrees * 0.008726646259971648;
  return {0, 0, float(std::sin(half)), float(std::cos(half))};
}

TEST(MeshTree, FindsTheTrianglesThatAScanOfAllFinds) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> u(-1, 1);
  Triangles t;
  for (int i = 0; i < 900; ++i) {
    const Vec3f c = {u(random), u(random), u(random)};
    for (int k = 0; k < 3; ++k) {
      t.vertices.push_back(c + Vec3f{u(random), u(random), u(random)} * 0.1f);
      t.indices.push_back(3 * i + k);
    }
  }
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  for (int run = 0; run < 100; ++run) {
    const Vec3f c = {u(random), u(random), u(random)};
    const geometry::Box3 box{c - Vec3f{0.1f, 0.2f, 0.05f}, c + Vec3f{0.1f, 0.2f, 0.05f}};
    std::set<int32_t> found, expected;
    for_triangles_in(mesh_view(tree), box, [&](int32_t i) { EXPECT_TRUE(found.insert(i).second); });
    for (size_t i = 0; i < 900; ++i) {
      geometry::Box3 b{t.vertices[3 * i], t.vertices[3 * i]};
      for (size_t k = 1; k < 3; ++k) {
        const Vec3f& v = t.vertices[3 * i + k];
        b.lo = {std::min(b.lo.x, v.x), std::min(b.lo.y, v.y), std::min(b.lo.z, v.z)};
        b.hi = {std::max(b.hi.x, v.x), std::max(b.hi.y, v.y), std::max(b.hi.z, v.z)};
      }
      if (boxes_meet(b, box)) expected.insert(int32_t(i));
    }
    EXPECT_TRUE(std::includes(found.begin(), found.end(), expected.begin(), expected.end()));
    EXPECT_LT(found.size(), 450u);
  }
}

TEST(MeshTree, JoinsCornersInOnePlace) {
  const Triangles t = terrain(3, 1.0f, flat);
  const MeshTree joined = build_mesh_tree(t.vertices, t.indices);
  std::vector<Vec3f> corners;
  std::vector<int32_t> own;
  for (const int32_t i : t.indices) {
    own.push_back(int32_t(corners.size()));
    corners.push_back(t.vertices[size_t(i)]);
  }
  const MeshTree apart = build_mesh_tree(corners, own);
  EXPECT_EQ(joined.ring.size(), 2 * 33u);  // 33 edges
  EXPECT_EQ(apart.ring.size(), joined.ring.size());
  EXPECT_EQ(apart.normals, joined.normals);
}

TEST(MeshTree, RefusesBadMeshes) {
  auto error_of = [](const Triangles& t) -> std::string {
    try {
      build_mesh_tree(t.vertices, t.indices);
    } catch (const Error& e) {
      return e.what();
    }
    return "no error";
  };
  Triangles t = cube(1.0f);
  t.indices[4] = 8;
  EXPECT_NE(error_of(t).find("indices[4]"), std::string::npos);
  t = cube(1.0f);
  t.vertices[2].x = NAN;
  EXPECT_NE(error_of(t).find("vertices[2]"), std::string::npos);
  t.indices.resize(4);
  EXPECT_NE(error_of(t).find("3 per triangle, got 4"), std::string::npos);
}

// FCL gave depths from 0.1 to 0.9 and two normals here.
TEST(MeshPairs, ABoxOnAMeshOfABoxRestsAsOnTheBox) {
  const Triangles t = cube(0.5f);
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  const Solid ground = solid(GeoType::BOX, {0.5f, 0.5f, 0.5f}, {});
  for (const double degrees : {0.0, 20.0, 45.0})
    for (const float depth : {0.1f, 0.01f, 0.0f, -0.01f})
      for (const Vec3f at : {Vec3f{0, 0, 0}, Vec3f{0.1f, 0.2f, 0}, Vec3f{0.45f, 0, 0}}) {
        const Solid box = solid(GeoType::BOX, {0.5f, 0.5f, 0.5f}, at + Vec3f{0, 0, 1.0f - depth},
                                about_z(degrees));
        const auto c = contacts(tree, box);
        const geometry::Manifold m =
            geometry::collide(ground.shape, ground.pose, box.shape, box.pose, 0.02f);
        SCOPED_TRACE(std::to_string(degrees) + " " + std::to_string(depth) + " " +
                     std::to_string(at.x));
        ASSERT_GE(c.size(), 3u);
        EXPECT_LE(c.size(), 8u);
        for (const MeshContact& p : c) {
          EXPECT_NEAR(p.normal.z, 1.0f, 1e-4f);
          EXPECT_NEAR(p.point.distance, -depth, 1e-4f);
        }
        for (int32_t i = 0; i < m.count && degrees == 0.0; ++i) {  // the same corners
          float nearest = 1.0f;
          for (const MeshContact& p : c)
            nearest = std::min(nearest, math::length(p.point.position - m.points[i].position));
          EXPECT_LT(nearest, 1e-3f);
        }
      }
}

TEST(MeshPairs, ABallOnAMeshIsAsFarAsFromItsFaces) {
  const Triangles t = terrain(8, 0.25f, flat);
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  Scenes scenes(4);
  for (int i = 0; i < 500; ++i) {
    const float depth = float(scenes.uniform(-0.01, 0.15));  // the center may be below
    const Vec3f p = {float(scenes.uniform(-0.9, 0.9)), float(scenes.uniform(-0.9, 0.9)),
                     0.1f - depth};
    const auto c = contacts(tree, solid(GeoType::SPHERE, {0.1f, 0, 0}, p));
    ASSERT_EQ(c.size(), 1u) << depth;
    EXPECT_NEAR(c[0].normal.z, 1.0f, 1e-6f);
    EXPECT_NEAR(c[0].point.distance, -depth, 1e-6f);
    EXPECT_NEAR(c[0].point.position.x, p.x, 1e-5f);
  }
}

// A sliding shape feels no inner edge: the normals stay vertical, and the depth is that of the
// plane.
TEST(MeshPairs, ShapesSlideOverATerrainWithoutBumping) {
  const Triangles t = terrain(22, 0.1f, flat);  // 968 triangles
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  Scenes scenes(8);
  for (const GeoType type : kConvexTypes) {
    Solid s = scenes.solid(type, 0.6);
    s.pose.p = {};
    const Rigid r = rigid(s.pose);
    const double bottom = math::dot(r.point(support(s.shape, r.in({0, 0, -1}))), Vec3d{0, 0, 1});
    const double depth = 0.003;
    for (int i = 0; i < 120; ++i) {
      s.pose.p = {float(-0.6 + 0.01 * i), float(0.3 - 0.004 * i), float(-bottom - depth)};
      const auto c = contacts(tree, s);
      ASSERT_GE(c.size(), 1u) << geo_type_name(type) << " " << i;
      float deepest = 1.0f;
      for (const MeshContact& p : c) {
        EXPECT_NEAR(p.normal.z, 1.0f, 1e-6f) << geo_type_name(type) << " " << i;
        deepest = std::min(deepest, p.point.distance);
      }
      EXPECT_NEAR(deepest, -depth, 2e-6) << geo_type_name(type) << " " << i;
    }
  }
}

TEST(MeshPairs, AValleyKeepsTheNormalsOfItsSides) {
  const Triangles t = terrain(4, 0.5f, [](float x, float) { return std::abs(x); });
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  const float k = std::sqrt(0.5f);
  const auto c = contacts(tree, solid(GeoType::SPHERE, {0.2f, 0, 0}, {0, 0.1f, 0.2f / k - 0.01f}));
  ASSERT_EQ(c.size(), 2u);
  for (const MeshContact& p : c) {
    EXPECT_NEAR(std::abs(p.normal.x), k, 1e-5f);
    EXPECT_NEAR(p.normal.z, k, 1e-5f);
    EXPECT_NEAR(p.point.distance, -0.01f * k, 1e-5f);
  }
}

TEST(MeshPairs, ARidgeCarriesABoxOnItsEdge) {
  const Triangles t = terrain(4, 0.5f, [](float x, float) { return -std::abs(x); });
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  const auto c = contacts(tree, solid(GeoType::BOX, {0.2f, 0.2f, 0.1f}, {0, 0.1f, 0.095f}));
  ASSERT_GE(c.size(), 2u);
  for (const MeshContact& p : c) {
    EXPECT_NEAR(p.normal.z, 1.0f, 1e-4f);
    EXPECT_NEAR(p.point.distance, -0.005f, 1e-5f);
    EXPECT_NEAR(p.point.position.x, 0.0f, 0.01f);
  }
}

// The sides of the ridge y = 0 fall by `slope`. The ridge rises by `rise` where |x| > 0.1.
MeshTree ridge(float slope, float rise) {
  std::vector<Vec3f> points;
  std::vector<int32_t> faces;
  for (const float x : {-0.15f, -0.05f, 0.05f, 0.15f})
    for (const float y : {-0.1f, 0.0f, 0.1f})
      points.push_back({x, y, (std::abs(x) > 0.1f ? rise : 0.0f) - slope * std::abs(y)});
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 2; ++j) {
      const int a = 3 * i + j, b = a + 3, c = b + 1, d = a + 1;
      faces.insert(faces.end(), {a, b, c, a, c, d});
    }
  return build_mesh_tree(points, faces);
}

// Over a flat edge as over any, one contact of the right depth, and up.
TEST(MeshPairs, ABallOverAConvexEdgeTouchesIt) {
  for (const float slope : {0.2f, 0.05f, 0.01f, 1e-3f, 3e-4f, 1e-5f})
    for (const float rise : {0.0f, 0.01f}) {
      const MeshTree tree = ridge(slope, rise);
      for (const float y : {0.0f, 3e-4f * slope, -0.04f * slope, 0.08f * slope}) {
        SCOPED_TRACE(std::to_string(slope) + " " + std::to_string(rise) + " " + std::to_string(y));
        const auto c = contacts(tree, solid(GeoType::SPHERE, {0.1f, 0, 0}, {0, y, 0.09f}), 1e-3f);
        ASSERT_EQ(c.size(), 1u);
        EXPECT_NEAR(c[0].point.distance, std::hypot(y, 0.09f) - 0.1f, 1e-6f);
        EXPECT_NEAR(c[0].normal.z, 1.0f, 1e-6f + slope * slope);
        EXPECT_NEAR(c[0].point.position.y, 0.0f, 0.1f * slope + 1e-5f);
      }
    }
}

// Two gentle ridges carry a capsule at both ends.
TEST(MeshPairs, ACapsuleLiesOnTwoRidges) {
  const Triangles t =
      terrain(8, 0.1f, [](float x, float) { return -0.02f * std::abs(std::abs(x) - 0.2f); });
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  const float k = std::sqrt(0.5f);
  for (const float down : {1e-5f, 1e-3f})
    for (const float y : {0.03f, 0.1f}) {
      const auto c = contacts(
          tree, solid(GeoType::CAPSULE, {0.05f, 0.3f, 0}, {0, y, 0.05f - down}, {0, k, 0, k}),
          1e-4f);
      bool left = false, right = false;
      for (const MeshContact& contact : c) {
        EXPECT_GT(contact.normal.z, 0.99f);
        EXPECT_GE(contact.point.distance, -down - 1e-6f);
        const float x = contact.point.position.x;
        const bool touches = std::abs(std::abs(x) - 0.2f) < 0.06f && contact.point.distance < 1e-6f;
        left = left || (touches && x < 0.0f);
        right = right || (touches && x > 0.0f);
      }
      EXPECT_TRUE(left && right) << down << " " << y;
    }
}

// A rod touches two triangles at one end. Two meters away a ridge is deep in the rod.
TEST(MeshPairs, ATouchTakesNoDeepContactFromElsewhere) {
  const std::vector<Vec3f> points = {
      {-3, 0, 0.169508547f},   {-2, 0, 0.148490965f}, {-5, 1, 0.120274045f},
      {-2, 1, -0.959293127f},  {-5, 2, 0.14837873f},  {-4, 2, 0.245275632f},
      {-3, 2, -0.0608771816f}, {-4, 3, -0.52310127f}, {-3, 3, 0.434732318f}};
  const Solid rod =
      solid(GeoType::BOX, {2.0f, 0.05f, 0.05f},
            {-3.2789671421051025f, 1.6933934688568115f, 0.27094924449920654f},
            {0.15046235918998718f, 0.20804177224636078f, 0.8705236315727234f, 0.4198433458805084f});
  const auto deepest = [&](const std::vector<int32_t>& faces) {
    const MeshTree tree = build_mesh_tree(points, faces);
    return contacts(tree, rod)[0].point.distance;
  };
  const float alone = deepest({5, 6, 8, 5, 8, 7});
  EXPECT_LT(alone, -0.01f);
  EXPECT_FLOAT_EQ(deepest({0, 1, 3, 2, 5, 4, 5, 6, 8, 5, 8, 7}), alone);
}

TEST(MeshPairs, ReduceToTheSameContactsInWhateverOrderTheyCome) {
  const Triangles t =
      terrain(22, 0.1f, [](float x, float y) { return 0.05f * std::sin(9 * x) * y; });
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  std::vector<MeshContact> c =
      all_contacts(tree, solid(GeoType::BOX, {0.6f, 0.5f, 0.1f}, {0, 0, 0.09f}), 0.05f);
  ASSERT_GT(c.size(), 40u);
  std::vector<MeshContact> first;
  std::mt19937 random(1);
  for (int run = 0; run < 20; ++run) {
    std::shuffle(c.begin(), c.end(), random);
    std::vector<MeshContact> r = c;
    reduce(tree, r);
    EXPECT_LE(r.size(), size_t(geometry::kMeshContacts));
    if (run == 0) first = r;
    ASSERT_EQ(r.size(), first.size());
    for (size_t i = 0; i < r.size(); ++i) {
      EXPECT_EQ(r[i].triangle, first[i].triangle);
      EXPECT_EQ(r[i].point.feature, first[i].point.feature);
    }
  }
  float deepest = 1.0f;
  for (const MeshContact& contact : c)
    if (contact.rank == geometry::MeshRank::Counts)
      deepest = std::min(deepest, contact.point.distance);
  EXPECT_NEAR(first[0].point.distance, deepest, 2e-4f);  // 1e-4 of the box
}

TEST(MeshPairs, StaySoundForRandomTriangles) {
  Scenes scenes(6);
  Triangles t;
  for (int i = 0; i < 60; ++i)
    for (int k = 0; k < 3; ++k) {
      const double size = i % 3 == 0 ? 1e-4 : i % 3 == 1 ? 1 : 0;  // specks and points too
      t.vertices.push_back(narrow(scenes.direction() * size));
      t.indices.push_back(3 * i + k);
    }
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  for (int i = 0; i < 300; ++i) {
    Solid s = scenes.solid(kConvexTypes[i % 7]);
    s.pose.p = narrow(scenes.direction() * scenes.uniform(0, 1));
    for (const MeshContact& c : contacts(tree, s, 0.05f)) {
      EXPECT_TRUE(std::isfinite(c.point.distance));
      EXPECT_NEAR(math::length(c.normal), 1.0f, 1e-3f);
      EXPECT_LE(c.point.distance, 0.05f);
    }
  }
}

}  // namespace
}  // namespace geometry_test
