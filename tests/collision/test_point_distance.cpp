// The signed distance of points to hulls and meshes, and the soft contacts that follow from it.
#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "collision/geometry_reference.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/collision/geometry/point_distance.h"
#include "novaphy/collision/mesh_tree.h"
#include "novaphy/core/sim/model_builder.h"
#include "support/triangles.h"

namespace geometry_test {
namespace {

using geometry::SolidPoint;
using novaphy::testing::Triangles;

constexpr float kReach = 100.0f;

void expect_near(const SolidPoint& found, const SolidPoint& expected, const Vec3f& x) {
  EXPECT_NEAR(found.distance, expected.distance, 2e-6f) << x.x << " " << x.y << " " << x.z;
  EXPECT_NEAR(math::length(found.normal), 1.0f, 1e-5f);
}

// Points within, on and around a box, also on the planes through its faces, edges and corners.
template <class F>
void for_points(const Vec3f& half, F f) {
  Scenes scenes(5);
  for (int i = 0; i < 3000; ++i) {
    Vec3f x = narrow(scenes.direction() * scenes.uniform(0, 1.5));
    if (i % 4 == 0) x.x = i % 8 == 0 ? half.x : 0.0f;
    if (i % 5 == 0) x.y = i % 10 == 0 ? -half.y : 0.0f;
    if (i % 7 == 0) x.z = half.z;
    f(x);
  }
}

TEST(PointDistance, OfHullAndMeshOfABoxIsThatOfTheBox) {
  const Vec3f half = {0.5f, 0.3f, 0.4f};
  const Triangles t = novaphy::testing::box(half.x, half.y, half.z);
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  const geometry::MeshView mesh = mesh_view(tree);
  Solid hull;
  hull.hull = std::make_shared<ConvexHull>(convex_hull(t.vertices));
  geometry::HullView view;
  view.vertices = hull.hull->vertices.data();
  view.face_normals = hull.hull->face_normals.data();
  view.face_starts = hull.hull->face_starts.data();
  view.face_vertices = hull.hull->face_vertices.data();
  view.vertex_count = 8;
  view.face_count = 6;
  for_points(half, [&](const Vec3f& x) {
    const SolidPoint expected = geometry::Box(half).core_distance(x);
    expect_near(geometry::point_to_hull(x, view), expected, x);
    expect_near(geometry::point_to_mesh(x, mesh, kReach), expected, x);
    // The nearest points are on the surface.
    for (const SolidPoint& p :
         {geometry::point_to_hull(x, view), geometry::point_to_mesh(x, mesh, kReach)})
      EXPECT_NEAR(geometry::Box(half).core_distance(x - p.normal * p.distance).distance, 0.0f,
                  3e-6f);
  });
}

// A valley and a ridge: inner corners and edges, from above and below.
TEST(PointDistance, OfATerrainHasItsSideAsSign) {
  const auto height = [](float x, float y) {
    return std::abs(x) < 0.3f ? 0.2f * y : std::abs(x) - 0.3f;
  };
  const Triangles t = novaphy::testing::terrain(20, 0.1f, height);
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  const geometry::MeshView mesh = mesh_view(tree);
  Scenes scenes(6);
  for (int i = 0; i < 3000; ++i) {
    // A point over a vertex, an edge or a face of the triangles, on either side.
    const int32_t k = int32_t(scenes.uniform(0, double(t.indices.size() / 3)));
    Vec3f v[3];
    for (int c = 0; c < 3; ++c) v[c] = t.vertices[size_t(t.indices[size_t(3 * k + c)])];
    float w[3] = {float(scenes.uniform(0, 1)), float(scenes.uniform(0, 1)), 0.3f};
    if (i % 3 == 0) w[1] = w[2] = 0.0f;
    if (i % 3 == 1) w[2] = 0.0f;
    const float sum = w[0] + w[1] + w[2];
    Vec3f x = (v[0] * w[0] + v[1] * w[1] + v[2] * w[2]) * (1.0f / sum);
    if (std::abs(x.x) > 0.85f || std::abs(x.y) > 0.85f) continue;  // not beside the border
    const float up = float(scenes.uniform(-0.1, 0.1));
    if (std::abs(up) < 1e-4f) continue;
    x.z += up;
    const SolidPoint p = geometry::point_to_mesh(x, mesh, kReach);
    EXPECT_EQ(p.distance > 0.0f, up > 0.0f) << i << ": " << x.x << " " << x.y << " " << x.z;
    EXPECT_LE(std::abs(p.distance), std::abs(up) + 1e-6f);
    EXPECT_GT(p.normal.z, 0.0f) << i;
  }
}

// A pit elsewhere makes its box deeper.
TEST(PointDistance, BehindAnOpenMeshIsInsideWhateverItsBox) {
  for (const float pit : {0.0f, 0.5f}) {
    const Triangles t = novaphy::testing::terrain(
        4, 0.5f, [pit](float x, float y) { return x < -0.9f && y < -0.9f ? -pit : 0.0f; });
    const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
    const auto at = [&](float z) {
      return geometry::point_to_mesh({0.6f, 0.7f, z}, mesh_view(tree), 1e-3f).distance;
    };
    for (const float depth : {1e-4f, 0.01f, 0.2f, 2.0f}) EXPECT_FLOAT_EQ(at(-depth), -depth) << pit;
    EXPECT_EQ(at(0.01f), geometry::kFarAway);
    EXPECT_EQ(at(-4.0f), geometry::kFarAway) << "farther behind than it is large";
  }
}

TEST(PointDistance, BesideTheBorderOfAnOpenMeshIsOutside) {
  const Triangles t = novaphy::testing::terrain(4, 0.5f, novaphy::testing::flat);
  const MeshTree tree = build_mesh_tree(t.vertices, t.indices);
  for (const Vec3f& x :
       {Vec3f{1.2f, 0.1f, -0.3f}, Vec3f{1.1f, 1.1f, -0.3f}, Vec3f{-2.0f, 0.0f, 0.0f}}) {
    const SolidPoint p = geometry::point_to_mesh(x, mesh_view(tree), kReach);
    EXPECT_GT(p.distance, 0.0f);
  }
  EXPECT_FLOAT_EQ(geometry::point_to_mesh({0.3f, 0.2f, -0.3f}, mesh_view(tree), kReach).distance,
                  -0.3f);
  EXPECT_EQ(geometry::point_to_mesh({0.0f, 0.0f, 3.0f}, mesh_view(tree), 1.0f).distance,
            geometry::kFarAway);
  EXPECT_EQ(geometry::point_to_mesh({NAN, 0.0f, 0.0f}, mesh_view(tree), 1.0f).distance,
            geometry::kFarAway);
}

TEST(PointDistance, ParticlesMeetMeshesAndHullsAsTheBox) {
  const Triangles t = novaphy::testing::box(0.5f, 0.3f, 0.4f);
  const Transformf pose = {{0.1f, 0.2f, 0.3f}, {0.5f, 0.5f, -0.5f, 0.5f}};
  std::vector<SoftContact> found[3];
  for (int as = 0; as < 3; ++as) {
    ModelBuilder builder;
    if (as == 0) builder.add_shape_box(-1, {.xform = pose, .hx = 0.5f, .hy = 0.3f, .hz = 0.4f});
    if (as == 1) builder.add_shape_convex_hull(-1, {.xform = pose, .vertices = t.vertices});
    if (as == 2)
      builder.add_shape_mesh(-1, {.xform = pose, .vertices = t.vertices, .indices = t.indices});
    Scenes scenes(8);
    for (int i = 0; i < 500; ++i)
      builder.add_particle(narrow(scenes.direction() * scenes.uniform(0, 1.2)), {}, 1.0f, 0.05f);
    const auto model = builder.finalize(Device::cpu());
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    pipeline.collide(model->state(), contacts);
    found[as] = contacts.soft_contacts();
  }
  EXPECT_GT(found[0].size(), 100u);
  for (int as = 1; as < 3; ++as) {
    ASSERT_EQ(found[as].size(), found[0].size());
    for (size_t k = 0; k < found[0].size(); ++k) {
      EXPECT_EQ(found[as][k].particle, found[0][k].particle);
      EXPECT_LT(math::length(found[as][k].body_pos - found[0][k].body_pos), 1e-5f);
      EXPECT_GT(math::dot(found[as][k].normal, found[0][k].normal), 0.99999f);
    }
  }
}

}  // namespace
}  // namespace geometry_test
