// The cheap test of mesh_foreseen.h. Skipped triangles have no contacts. Triangles that B faces get
// the same contacts without GJK. The test decides most triangles.
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "collision/geometry_reference.h"
#include "novaphy/collision/geometry/mesh_pair.h"
#include "novaphy/collision/mesh_tree.h"
#include "support/triangles.h"

namespace geometry_test {
namespace {

using novaphy::testing::terrain;
using novaphy::testing::Triangles;

// Counts of the triangles without a contact that are left out. A second count has only triangles
// that face B from below.
struct LeftOut {
  int count = 0, of = 0, facing = 0, of_facing = 0;

  void look(const MeshTree& tree, const Solid& b, float gap) {
    const geometry::MeshView mesh = mesh_view(tree);
    const geometry::Shape none;
    const geometry::ShapePair pair = geometry::shape_pair(none, b.shape, b.pose);
    Vec3f half;
    ASSERT_TRUE(geometry::core_box(b.shape, half));
    geometry::for_triangles_in(mesh, geometry::box_in_mesh(pair, gap), [&](int32_t triangle) {
      const auto contacts_of = [&](float along) {
        std::vector<geometry::MeshContact> all;
        geometry::collide_triangle(
            mesh, triangle, b.shape, b.pose, gap, along,
            [&](const geometry::MeshContact& contact) { all.push_back(contact); });
        return all;
      };
      const std::vector<geometry::MeshContact> asked = contacts_of(0.0f);
      const geometry::Foreseen known = geometry::foresee(mesh, triangle, pair, half, gap);
      SCOPED_TRACE("triangle " + std::to_string(triangle) + ", gap " + std::to_string(gap));
      ASSERT_FALSE(known.no_contact && !asked.empty());
      if (asked.empty()) ++of;
      if (known.no_contact) ++count;
      if (!asked.empty() && asked[0].rank == geometry::MeshRank::Counts &&
          asked[0].normal == mesh.normals[triangle] && asked[0].point.distance > 0.01f)
        ++of_facing;
      if (!(known.facing > 0.0f)) return;
      ++facing;
      const std::vector<geometry::MeshContact> told = contacts_of(known.facing);
      ASSERT_EQ(told.size(), asked.size());
      for (size_t i = 0; i < told.size(); ++i) {
        const geometry::MeshContact &x = told[i], &y = asked[i];
        ASSERT_TRUE(x.point.position == y.point.position && x.normal == y.normal);
        ASSERT_TRUE(x.point.distance == y.point.distance && x.point.feature == y.point.feature);
        ASSERT_TRUE(x.rank == y.rank && x.way_out == y.way_out && x.clears == y.clears);
      }
    });
  }
};

Triangles bumps(int n, float cell, float sigma, uint32_t seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal;
  return terrain(n, cell, [&](float x, float y) {
    return 0.1f * std::sin(1.3f * x) * std::cos(1.1f * y) + sigma * normal(random);
  });
}
// Shapes whose core is a box, of half size r.
Solid solid(Scenes& scenes, int kind, float r, Vec3d p) {
  const geometry::Shape shapes[] = {{GeoType::SPHERE, {r, 0, 0}, {}},
                                    {GeoType::BOX, {r, 1.3f * r, 0.8f * r}, {}},
                                    {GeoType::CAPSULE, {r, 2.0f * r, 0}, {}},
                                    {GeoType::BOX, {10.0f * r, 0.1f * r, 0.5f * r}, {}}};
  Solid s = scenes.solid(GeoType::BOX);
  s.shape = shapes[kind % 4];
  if (kind % 3 == 0) s.pose.q = {0, 0, 0, 1};
  s.pose.p = narrow(p);
  return s;
}

TEST(MeshForeseen, TrianglesThatAreLeftOutHaveNone) {
  Scenes scenes(11);
  LeftOut all;
  int kind = 0;
  for (const float sigma : {0.0f, 1e-5f, 1e-3f, 0.01f}) {
    const Triangles t = bumps(32, 0.05f, sigma, 5);
    const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
    for (const float gap : {0.005f, 0.05f, 0.2f})
      for (int i = 0; i < 40; ++i, ++kind)
        all.look(tree,
                 solid(scenes, kind, 0.1f,
                       {scenes.uniform(-0.9, 0.9), scenes.uniform(-0.9, 0.9),
                        scenes.uniform(-0.05, 0.35)}),
                 gap);
  }
  EXPECT_GT(all.of, 50000);
  EXPECT_GT(all.count, all.of / 2);
}

TEST(MeshForeseen, ASoupOfTrianglesAndABoxLoseNone) {
  Scenes scenes(12);
  Triangles soup;
  for (int i = 0; i < 300; ++i)
    for (int k = 0; k < 3; ++k) {
      const double size = i % 3 == 0 ? 1e-4 : i % 3 == 1 ? 1 : 0.1;
      soup.vertices.push_back(narrow(scenes.direction() * size));
      soup.indices.push_back(3 * i + k);
    }
  LeftOut all;
  for (const Triangles& t : {soup, novaphy::testing::box(0.5f, 0.2f, 0.1f)}) {
    const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
    for (int i = 0; i < 200; ++i)
      all.look(tree, solid(scenes, i, 0.05f, scenes.direction() * scenes.uniform(0, 0.8)),
               i % 2 == 0 ? 0.2f : 0.02f);
  }
  EXPECT_GT(all.count, 0);
}

// A box of 0.5 m above hills with cells of 2.5 cm, with the gaps of shapes that have none.
TEST(MeshForeseen, MostTrianglesAroundABoxOnHillsAreLeftOut) {
  Scenes scenes(13);
  const Triangles t = bumps(64, 0.025f, 0.0f, 1);
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  LeftOut all;
  for (int i = 0; i < 4; ++i) {
    Solid b = solid(scenes, 3, 0.25f, {0.2 * i - 0.4, 0.1, 0.36});
    b.shape = {GeoType::BOX, {0.25f, 0.25f, 0.25f}, {}};
    all.look(tree, b, 0.2f);
  }
  EXPECT_GT(all.of, 4000);
  EXPECT_GT(all.count, all.of * 9 / 10);
}

TEST(MeshForeseen, NearlyAllTrianglesBelowABoxOnLevelGroundNeedNoGjk) {
  Scenes scenes(14);
  const Triangles t = terrain(64, 0.025f, novaphy::testing::flat);
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  Solid b = solid(scenes, 3, 0.25f, {0.01, 0.02, 0.3});
  b.shape = {GeoType::BOX, {0.25f, 0.25f, 0.25f}, {}};
  LeftOut all;
  all.look(tree, b, 0.2f);
  EXPECT_GT(all.of_facing, 700);
  EXPECT_GT(all.facing, all.of_facing * 8 / 10);
  // Near the largest angle at which the triangles still face B.
  for (int i = 0; i < 30; ++i) {
    const double x = scenes.uniform(-0.04, 0.04), y = scenes.uniform(-0.04, 0.04);
    b.pose.q = {float(x), float(y), 0.0f, float(std::sqrt(1 - x * x - y * y))};
    b.pose.p.z = float(scenes.uniform(0.26, 0.4));
    all.look(tree, b, 0.2f);
  }
}

}  // namespace
}  // namespace geometry_test
