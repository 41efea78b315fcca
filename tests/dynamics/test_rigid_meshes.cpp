// Convex hulls and triangle meshes that rest, slide and fall in SolverSemiImplicit.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"
#include "support/threads.h"
#include "support/triangles.h"

namespace novaphy {
namespace {

using testing::Triangles;

constexpr float kDt = 1.0f / 960.0f, kGravity = 9.81f;
constexpr ShapeConfig kSurface = {.ke = 1.0e4f, .kd = 300.0f, .kf = 500.0f, .mu = 0.5f};

template <class Each>
SimState run(const std::shared_ptr<Model>& model, int steps, Each&& each) {
  CollisionPipeline pipeline(model);
  SolverSemiImplicit solver(model, {});
  Contacts contacts = pipeline.contacts();
  SimState now = model->state(), next = model->state();
  for (int t = 0; t < steps; ++t) {
    pipeline.collide(now, contacts);
    solver.step(now, next, nullptr, &contacts, kDt);
    std::swap(now, next);
    each(t, now);
  }
  return now;
}
SimState run(const std::shared_ptr<Model>& model, int steps) {
  return run(model, steps, [](int, const SimState&) {});
}

// The height at which a 12 kg box of side 0.2 rests on four rows.
const float kRest = 0.1f - 12.0f * kGravity / (4.0f * kSurface.ke);

TEST(RigidMeshes, HullsAndMeshesOfABoxRestAsTheBox) {
  const Triangles cube = testing::cube(0.1f);
  const Triangles ground = testing::terrain(8, 0.13f, testing::flat);
  for (const bool on_mesh : {false, true})
    for (const bool is_mesh : {false, true}) {
      if (on_mesh && is_mesh) continue;
      ModelBuilder builder;
      if (on_mesh)
        builder.add_shape_mesh(
            -1, {.vertices = ground.vertices, .indices = ground.indices, .cfg = kSurface});
      else
        builder.add_ground_plane({.cfg = kSurface});
      builder.add_body({.xform = {{0.0f, 0.0f, 0.11f}, Quatf::identity()}, .mass = 4.0f});
      if (is_mesh)
        builder.add_shape_mesh(
            0, {.vertices = cube.vertices, .indices = cube.indices, .cfg = kSurface});
      else
        builder.add_shape_convex_hull(0, {.vertices = cube.vertices, .cfg = kSurface});
      const SimState end = run(builder.finalize(Device::cpu()), 2000);
      const Transformf q = end.body_q.to_host()[0];
      EXPECT_NEAR(q.p.z, kRest, 2e-6f) << on_mesh << is_mesh;
      EXPECT_NEAR(q.p.x, 0.0f, 1e-5f);
      EXPECT_NEAR(std::abs(q.q.w), 1.0f, 1e-6f);
      const SpatialVectorf v = end.body_qd.to_host()[0];
      EXPECT_LT(math::length(v.linear) + math::length(v.angular), 1e-4f);
    }
}

// Inner edges are no bumps: the vertical velocity of a sliding body stays below a thousandth of its
// sliding velocity.
TEST(RigidMeshes, AHullSlidesOverAThousandTrianglesWithoutBumping) {
  const Triangles ground = testing::terrain(23, 0.1f, testing::flat);  // 1058 triangles
  ShapeConfig smooth = kSurface;
  smooth.mu = 0.0f;
  for (const float turn : {0.0f, 0.2f}) {
    ModelBuilder builder;
    builder.add_shape_mesh(-1,
                           {.vertices = ground.vertices, .indices = ground.indices, .cfg = smooth});
    builder.add_body({.xform = {{-0.7f, 0.037f, kRest},
                                {0.0f, 0.0f, std::sin(0.5f * turn), std::cos(0.5f * turn)}},
                      .mass = 4.0f});
    const Triangles cube = testing::cube(0.1f);
    builder.add_shape_convex_hull(0, {.vertices = cube.vertices, .cfg = smooth});
    builder.body_qd[0] = {{1.0f, 0.0f, 0.0f}, {}};
    float fastest = 0.0f, turning = 0.0f;
    const SimState end = run(builder.finalize(Device::cpu()), 1300, [&](int, const SimState& s) {
      const SpatialVectorf v = s.body_qd.to_host()[0];
      fastest = std::max(fastest, std::abs(v.linear.z));
      turning = std::max(turning, math::length(v.angular));
    });
    EXPECT_LT(fastest, 1e-3f) << turn;
    EXPECT_LT(turning, 1e-2f) << turn;
    EXPECT_NEAR(end.body_qd.to_host()[0].linear.x, 1.0f, 1e-3f);
    EXPECT_NEAR(end.body_q.to_host()[0].p.x, -0.7f + 1300.0f / 960.0f, 2e-3f);
  }
}

// On a slope of triangles a hull slides by g (sin - mu cos).
TEST(RigidMeshes, AHullSlidesDownASlopeByCoulombsLaw) {
  constexpr float kAngle = 0.7f;
  const Triangles ground =
      testing::terrain(30, 0.2f, [](float x, float) { return -std::tan(kAngle) * x; });
  const Triangles cube = testing::cube(0.1f);
  ModelBuilder builder;
  builder.add_shape_mesh(-1,
                         {.vertices = ground.vertices, .indices = ground.indices, .cfg = kSurface});
  const float depth = (0.1f - kRest) * std::cos(kAngle);
  const Vec3f up = {std::sin(kAngle), 0.0f, std::cos(kAngle)};
  const Vec3f start = Vec3f{-1.5f, 0.03f, 1.5f * std::tan(kAngle)} + up * (0.1f - depth);
  builder.add_body(
      {.xform = {start, {0.0f, std::sin(0.5f * kAngle), 0.0f, std::cos(0.5f * kAngle)}},
       .mass = 4.0f});
  builder.add_shape_convex_hull(0, {.vertices = cube.vertices, .cfg = kSurface});
  const auto model = builder.finalize(Device::cpu());
  std::vector<float> speed;
  run(model, 600, [&](int, const SimState& state) {
    speed.push_back(math::length(state.body_qd.to_host()[0].linear));
  });
  const float expected = kGravity * (std::sin(kAngle) - kSurface.mu * std::cos(kAngle));
  EXPECT_NEAR((speed[599] - speed[99]) / (500.0f * kDt), expected, 0.01f * expected);
}

TEST(RigidMeshes, APileOfHullsOnATerrainSettlesAndHasTheSameBitsOnAnyNumberOfThreads) {
  const Triangles ground =
      testing::terrain(16, 0.2f, [](float x, float y) { return 0.3f * (x * x + y * y); });
  const auto build = [&] {
    ModelBuilder builder;
    builder.add_shape_mesh(
        -1, {.vertices = ground.vertices, .indices = ground.indices, .cfg = kSurface});
    const std::vector<Vec3f> tetrahedron = {
        {0.1f, 0.1f, 0.1f}, {-0.1f, -0.1f, 0.1f}, {-0.1f, 0.1f, -0.1f}, {0.1f, -0.1f, -0.1f}};
    for (int k = 0; k < 12; ++k) {
      const float x = 0.25f * static_cast<float>(k % 3 - 1), y = 0.2f * static_cast<float>(k % 2);
      builder.add_body({.xform = {{x, y, 0.3f + 0.15f * static_cast<float>(k)}, Quatf::identity()},
                        .mass = 2.0f,
                        .inertia = Mat33f{{{0.01f, 0, 0}, {0, 0.01f, 0}, {0, 0, 0.01f}}}});
      const Triangles box = testing::box(0.12f, 0.1f, 0.08f);
      builder.add_shape_convex_hull(
          k, {.vertices = k % 2 == 0 ? tetrahedron : box.vertices, .cfg = kSurface});
    }
    return builder.finalize(Device::cpu());
  };
  std::vector<Transformf> poses;
  for (const int threads : {1, 2, 5}) {
    const testing::Threads set(threads);
    const SimState end = run(build(), 2000);
    const std::vector<Transformf> q = end.body_q.to_host();
    if (poses.empty()) poses = q;
    EXPECT_TRUE(
        testing::same_bits(std::span<const Transformf>(q), std::span<const Transformf>(poses)))
        << threads;
    for (const SpatialVectorf& v : end.body_qd.to_host()) EXPECT_LT(math::length(v.linear), 0.2f);
  }
  for (const Transformf& q : poses) {
    EXPECT_GT(q.p.z, 0.0f) << "nobody fell through";
    EXPECT_LT(std::hypot(q.p.x, q.p.y), 1.2f);
  }
}

}  // namespace
}  // namespace novaphy
