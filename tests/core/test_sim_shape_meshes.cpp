// Meshes and convex hulls as shapes of a ModelBuilder: mass, storage, bad input.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/warning.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"
#include "support/triangles.h"

namespace novaphy {
namespace {

using testing::Triangles;

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

template <class Add>
std::shared_ptr<Model> one_body(Add&& add) {
  ModelBuilder builder;
  builder.add_body();
  add(builder);
  return builder.finalize(Device::cpu());
}

void expect_same_mass(const Model& model, const Model& expected) {
  EXPECT_FLOAT_EQ(model.body_mass.to_host()[0], expected.body_mass.to_host()[0]);
  const Vec3f com = model.body_com.to_host()[0] - expected.body_com.to_host()[0];
  EXPECT_LT(math::length(com), 1e-6f);
  const Mat33f a = model.body_inertia.to_host()[0], b = expected.body_inertia.to_host()[0];
  const float largest = std::max({b.m[0][0], b.m[1][1], b.m[2][2]});
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) EXPECT_NEAR(a.m[i][j], b.m[i][j], 1e-6f * largest) << i << j;
}

const Transformf kSomewhere = {{0.3f, -0.1f, 0.2f}, {0.5f, 0.5f, -0.5f, 0.5f}};

TEST(ShapeMeshes, OfABoxWeighAsTheBox) {
  const Triangles unit = testing::cube(0.5f);
  const Vec3f scale = {0.2f, 0.4f, 0.6f};
  for (const bool is_solid : {true, false}) {
    const ShapeConfig cfg = {.density = 700.0f, .margin = 0.01f, .is_solid = is_solid};
    const auto box = one_body([&](ModelBuilder& b) {
      b.add_shape_box(0, {.xform = kSomewhere, .hx = 0.1f, .hy = 0.2f, .hz = 0.3f, .cfg = cfg});
    });
    const auto mesh = one_body([&](ModelBuilder& b) {
      b.add_shape_mesh(0, {.xform = kSomewhere,
                           .vertices = unit.vertices,
                           .indices = unit.indices,
                           .scale = scale,
                           .cfg = cfg});
    });
    const auto hull = one_body([&](ModelBuilder& b) {
      b.add_shape_convex_hull(
          0, {.xform = kSomewhere, .vertices = unit.vertices, .scale = scale, .cfg = cfg});
    });
    expect_same_mass(*mesh, *box);
    expect_same_mass(*hull, *box);
    for (const auto& model : {mesh, hull}) {
      EXPECT_EQ(model->shape_aabb_upper.to_host()[0], box->shape_aabb_upper.to_host()[0]);
      EXPECT_EQ(model->shape_aabb_lower.to_host()[0], box->shape_aabb_lower.to_host()[0]);
      EXPECT_FLOAT_EQ(model->shape_collision_radius.to_host()[0],
                      box->shape_collision_radius.to_host()[0]);
    }
  }
}

TEST(ShapeMeshes, ABallOfManyTrianglesWeighsAsItsShell) {
  // An octahedron, each triangle cut in four five times.
  Triangles ball;
  ball.vertices = {{1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  ball.indices = {0, 1, 4, 1, 2, 4, 2, 3, 4, 3, 0, 4, 1, 0, 5, 2, 1, 5, 3, 2, 5, 0, 3, 5};
  for (int level = 0; level < 5; ++level) {
    Triangles finer;
    for (size_t t = 0; t < ball.indices.size(); t += 3) {
      Vec3f p[6];
      for (size_t k = 0; k < 3; ++k) p[k] = ball.vertices[size_t(ball.indices[t + k])];
      for (size_t k = 0; k < 3; ++k) p[3 + k] = math::normalize(p[k] + p[(k + 1) % 3]);
      const int32_t first = int32_t(finer.vertices.size());
      finer.vertices.insert(finer.vertices.end(), p, p + 6);
      for (const int32_t i : {0, 3, 5, 3, 1, 4, 5, 4, 2, 3, 4, 5})
        finer.indices.push_back(first + i);
    }
    ball = finer;
  }
  const auto weigh = [&](auto add) {
    return one_body([&](ModelBuilder& b) {
             const ShapeConfig cfg = {.margin = 0.1f, .is_solid = false};
             add(b, cfg);
           })
        ->body_mass.to_host()[0];
  };
  const float mesh = weigh([&](ModelBuilder& b, const ShapeConfig& cfg) {
    b.add_shape_mesh(0, {.vertices = ball.vertices, .indices = ball.indices, .cfg = cfg});
  });
  const float sphere = weigh([&](ModelBuilder& b, const ShapeConfig& cfg) {
    b.add_shape_sphere(0, {.radius = 1.0f, .cfg = cfg});
  });
  EXPECT_NEAR(mesh / sphere, 1.0f, 2e-3f);
}

TEST(ShapeMeshes, OneMeshIsStoredOnceForAllItsShapesAndWorlds) {
  const Triangles cube = testing::cube(0.5f);
  ModelBuilder part;
  part.add_body();
  part.add_shape_mesh(0, {.vertices = cube.vertices, .indices = cube.indices, .scale = {1, 2, 1}});
  part.add_shape_sphere(0);
  part.add_shape_mesh(0, {.vertices = cube.vertices, .indices = cube.indices});
  part.add_shape_convex_hull(0, {.vertices = cube.vertices});
  ModelBuilder scene;
  scene.replicate(part, 3);
  const auto model = scene.finalize(Device::cpu());
  EXPECT_EQ(model->mesh_vertex_count(), 16) << "of the mesh and of the hull";
  EXPECT_EQ(model->mesh_triangle_count(), 24);
  const std::vector<int32_t> of_one = {0, 8, 0, 12, 0, 0, 0, 0, 0, 8, 0, 12, 8, 8, 12, 12};
  std::vector<int32_t> of_all;
  for (int world = 0; world < 3; ++world) of_all.insert(of_all.end(), of_one.begin(), of_one.end());
  EXPECT_EQ(model->shape_mesh_range.to_host(), of_all);
  EXPECT_EQ(model->shape_scale.to_host()[4], (Vec3f{1.0f, 2.0f, 1.0f}));
  const auto copy = model->clone();
  EXPECT_EQ(copy->mesh_vertices.to_host(), model->mesh_vertices.to_host());
  EXPECT_EQ(copy->mesh_indices.to_host(), model->mesh_indices.to_host());
}

TEST(ShapeMeshes, VerticesInOnePlaceAreJoinedAndLooseOnesLeftOut) {
  const Triangles cube = testing::cube(0.5f);
  std::vector<Vec3f> corners;
  std::vector<int32_t> indices;
  for (const int32_t i : cube.indices) {
    corners.push_back({9.0f, 9.0f, 9.0f});  // loose
    indices.push_back(int32_t(corners.size()));
    corners.push_back(cube.vertices[size_t(i)]);
  }
  ModelBuilder builder;
  builder.add_body();
  builder.add_shape_mesh(0, {.vertices = corners, .indices = indices});
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(model->mesh_vertex_count(), 8);
  EXPECT_FLOAT_EQ(model->body_mass.to_host()[0], 1000.0f) << "closed, once it is joined";
}

TEST(ShapeMeshes, AHullOfManyPointsHasAtMost64Vertices) {
  std::mt19937 random(1);
  std::normal_distribution<float> normal;
  std::vector<Vec3f> points;
  for (int i = 0; i < 100000; ++i)
    points.push_back(math::normalize(Vec3f{normal(random), normal(random), normal(random)}));
  const auto model =
      one_body([&](ModelBuilder& b) { b.add_shape_convex_hull(0, {.vertices = points}); });
  EXPECT_EQ(model->mesh_vertex_count(), 64);
  EXPECT_NEAR(model->body_mass.to_host()[0] / 1000.0f, 4.18879f, 1e-3f) << "that of all points";
  EXPECT_NEAR(model->body_inertia.to_host()[0].m[0][0] / 1000.0f, 0.4f * 4.18879f, 1e-3f);
}

// A tetrahedron that is 0.7 mm thin: two faces on each side lie within 0.1 degrees.
TEST(ShapeMeshes, AThinHullHasTheMassOfItsCorners) {
  const std::vector<Vec3f> corners = {
      {-0.4f, 2e-4f, 0.2f}, {0.1f, 3e-4f, 0.1f}, {0.06f, 1.5e-4f, -0.07f}, {0.2f, -1e-4f, -0.36f}};
  const Vec3f a = corners[1] - corners[0], b = corners[2] - corners[0], c = corners[3] - corners[0];
  const auto model = one_body(
      [&](ModelBuilder& builder) { builder.add_shape_convex_hull(0, {.vertices = corners}); });
  EXPECT_EQ(model->mesh_vertex_count(), 4);
  EXPECT_NEAR(model->body_mass.to_host()[0],
              std::abs(math::dot(a, math::cross(b, c))) / 6 * 1000.0f, 1e-6f);
}

TEST(ShapeMeshes, OfTheWorldOrWithoutDensityMayBeOpen) {
  const Triangles ground = testing::terrain(4, 0.5f, testing::flat);
  ModelBuilder builder;
  builder.add_shape_mesh(-1, {.vertices = ground.vertices, .indices = ground.indices});
  builder.add_body({.mass = 1.0f});
  builder.add_shape_mesh(0, {.vertices = ground.vertices,
                             .indices = ground.indices,
                             .cfg = ShapeConfig{.density = 0.0f}});
  EXPECT_EQ(builder.shape_count(), 2);
  EXPECT_ERROR(builder.add_shape_mesh(0, {.vertices = ground.vertices, .indices = ground.indices}),
               ErrorKind::Value, "closed mesh");
}

TEST(ShapeMeshes, BadInputIsRefusedAndLeavesNothingBehind) {
  const Triangles cube = testing::cube(0.5f);
  ModelBuilder builder;
  builder.add_body({.mass = 1.0f});
  const auto mesh = [&](const Triangles& t, Vec3f scale = {1, 1, 1}, ShapeConfig cfg = {}) {
    return builder.add_shape_mesh(
        0, {.vertices = t.vertices, .indices = t.indices, .scale = scale, .cfg = cfg});
  };
  const auto changed = [&](auto change) {
    Triangles t = cube;
    change(t);
    return t;
  };
  EXPECT_ERROR(mesh({}), ErrorKind::Value, "add_shape_mesh: vertices: expected some");
  EXPECT_ERROR(mesh(changed([](Triangles& t) { t.indices.clear(); })), ErrorKind::Value,
               "add_shape_mesh: indices: expected 3 for each triangle");
  EXPECT_ERROR(mesh(changed([](Triangles& t) { t.indices.pop_back(); })), ErrorKind::Value,
               "got 35");
  EXPECT_ERROR(mesh(changed([](Triangles& t) { t.indices[4] = 8; })), ErrorKind::Index,
               "add_shape_mesh: indices[4]: expected 0 to 7, got 8");
  EXPECT_ERROR(mesh(changed([](Triangles& t) { t.indices[4] = -1; })), ErrorKind::Index, "got -1");
  EXPECT_ERROR(mesh(changed([](Triangles& t) { t.vertices[3].y = kNan; })), ErrorKind::Value,
               "add_shape_mesh: vertices[3]");
  EXPECT_ERROR(mesh(changed([](Triangles& t) { t.indices[1] = t.indices[0]; })), ErrorKind::Value,
               "triangle 0 has two corners in one place");
  EXPECT_ERROR(mesh(changed([](Triangles& t) { t.indices.resize(33); })), ErrorKind::Value,
               "triangle on one side only");
  EXPECT_ERROR(mesh(changed([](Triangles& t) {
                 for (size_t i = 0; i < t.indices.size(); i += 3)
                   std::swap(t.indices[i], t.indices[i + 1]);
               })),
               ErrorKind::Value, "inside out");
  EXPECT_ERROR(mesh(cube, {1.0f, 0.0f, 1.0f}), ErrorKind::Value, "add_shape_mesh: scale.y");
  EXPECT_ERROR(mesh(cube, {1.0f, 1.0f, -1.0f}), ErrorKind::Value, "add_shape_mesh: scale.z");
  EXPECT_ERROR(mesh(cube, {kNan, 1.0f, 1.0f}), ErrorKind::Value, "add_shape_mesh: scale");
  EXPECT_ERROR(mesh(cube, {1e-38f, 1e38f, 1e38f}), ErrorKind::Value, "encloses a volume");
  EXPECT_ERROR(mesh(cube, {1, 1, 1}, {.is_solid = false}), ErrorKind::Value,
               "thickness: expected a wall");
  for (const float wall : {0.5f, 0.6f, 2.0f})
    EXPECT_ERROR(mesh(cube, {1, 1, 1}, {.margin = wall, .is_solid = false}), ErrorKind::Value,
                 "thinner than the shape");
  EXPECT_ERROR(builder.add_shape({.body = 0, .type = GeoType::MESH, .scale = {1, 1, 1}}),
               ErrorKind::Value, "use add_shape_mesh");

  const auto hull = [&](std::vector<Vec3f> points, int32_t most = 64) {
    return builder.add_shape_convex_hull(0, {.vertices = points, .max_vertices = most});
  };
  EXPECT_ERROR(hull({}), ErrorKind::Value, "add_shape_convex_hull: vertices: expected some");
  EXPECT_ERROR(hull({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}), ErrorKind::Value, "at least 4, got 3");
  EXPECT_ERROR(hull({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}, {2, 1, 0}}), ErrorKind::Value,
               "add_shape_convex_hull: vertices");
  EXPECT_ERROR(hull(std::vector<Vec3f>(9, {1, 2, 3})), ErrorKind::Value, "in one place");
  EXPECT_ERROR(hull({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, kNan, 1}}), ErrorKind::Value,
               "add_shape_convex_hull: vertices[3]");
  EXPECT_ERROR(hull(cube.vertices, 3), ErrorKind::Value, "expected 4 to 64, got 3");
  EXPECT_ERROR(builder.add_shape_convex_hull(0, {.vertices = cube.vertices, .scale = {0, 1, 1}}),
               ErrorKind::Value, "add_shape_convex_hull: scale.x");
  EXPECT_ERROR(
      builder.add_shape_convex_hull(0, {.vertices = cube.vertices, .scale = {1, 1e-8f, 1}}),
      ErrorKind::Value, "add_shape_convex_hull: scale: convex_hull: points: expected 4 that span");
  EXPECT_ERROR(builder.add_shape_convex_hull(1, {.vertices = cube.vertices}), ErrorKind::Index,
               "add_shape_convex_hull: body");
  EXPECT_EQ(builder.shape_count(), 0);
}

TEST(ShapeMeshes, AreAsGoodAtEveryScale) {
  for (const float scale : {1e-6f, 1e-3f, 1e3f, 1e6f}) {
    const Triangles cube = testing::cube(0.5f);
    const auto model = one_body([&](ModelBuilder& b) {
      b.add_shape_mesh(0, {.vertices = cube.vertices,
                           .indices = cube.indices,
                           .scale = {scale, scale, scale},
                           .cfg = ShapeConfig{.density = 1.0f / (scale * scale * scale)}});
    });
    EXPECT_NEAR(model->body_mass.to_host()[0], 1.0f, 1e-5f) << scale;
  }
}

// Points on a grid and on spheres: hulls with many points in one plane and on one edge.
TEST(ShapeMeshes, HullsOfAllKindsOfPointsAreClosed) {
  std::mt19937 random(7);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  for (int trial = 0; trial < 300; ++trial) {
    std::vector<Vec3f> points;
    const int kind = trial % 3;
    for (int i = 0; i < 8 + trial / 3; ++i) {
      Vec3f p = {uniform(random), uniform(random), uniform(random)};
      if (kind == 1) p = math::normalize(p);
      if (kind == 2) p = {std::round(2 * p.x), std::round(2 * p.y), std::round(2 * p.z)};
      points.push_back(p);
    }
    ModelBuilder builder;
    builder.add_body();
    EXPECT_NO_THROW(builder.add_shape_convex_hull(0, {.vertices = points})) << trial;
  }
}

std::vector<std::string>& warnings() {
  static std::vector<std::string> said;
  return said;
}

TEST(ShapeMeshes, AnInsideOutMeshOfTheWorldWarns) {
  set_warning_handler([](const std::string& text) { warnings().push_back(text); });
  const auto said = [](const Triangles& t, const ShapeConfig& cfg = {}) {
    warnings().clear();
    ModelBuilder().add_shape_mesh(-1, {.vertices = t.vertices, .indices = t.indices, .cfg = cfg});
    return warnings().size();
  };
  Triangles room = testing::cube(0.5f);
  EXPECT_EQ(said(room), 0u);
  for (size_t i = 0; i < room.indices.size(); i += 3)
    std::swap(room.indices[i], room.indices[i + 1]);
  ASSERT_EQ(said(room), 1u);
  EXPECT_NE(warnings()[0].find("add_shape_mesh: indices"), std::string::npos);
  EXPECT_NE(warnings()[0].find("-1"), std::string::npos) << warnings()[0];
  EXPECT_EQ(said(room, {.has_shape_collision = false, .has_particle_collision = false}), 0u);
  room.indices.resize(room.indices.size() - 6);
  EXPECT_EQ(said(room), 0u) << "an open one is a floor with walls";
  set_warning_handler(nullptr);
}

}  // namespace
}  // namespace novaphy
