// Convex hulls with FCL's solver: the cases in which its result is accepted or rejected. Published
// failures of FCL and other libraries are also run with the engine's own solver.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"
#include "support/triangles.h"

namespace novaphy {
namespace {

#ifndef NOVAPHY_WITH_FCL

TEST(Fcl, IsRefusedByNameWhereTheBuildLacksIt) {
  const auto model = ModelBuilder().finalize(Device::cpu());
  EXPECT_ERROR(CollisionPipeline(model, {.narrow_phase = NarrowPhase::Fcl}),
               ErrorKind::NotImplemented, "NOVAPHY_WITH_FCL=ON");
  EXPECT_ERROR(parse_narrow_phase("mpr"), ErrorKind::Value, "\"auto\" or \"fcl\", got \"mpr\"");
}

#else

// Pairs of hulls, each in a world of its own.
std::shared_ptr<Model> pairs(int count, float nearest, float farthest) {
  ModelBuilder scene;
  std::mt19937 random(5);
  std::normal_distribution<float> normal;
  std::uniform_real_distribution<float> uniform(0.0f, 1.0f);
  const auto hull = [&] {
    std::vector<Vec3f> points;
    for (int i = 0; i < 12; ++i)
      points.push_back(math::normalize(Vec3f{normal(random), normal(random), normal(random)}) *
                       0.3f);
    return points;
  };
  const auto turn = [&] {
    const Quatf q = {normal(random), normal(random), normal(random), normal(random)};
    const float l = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    return Quatf{q.x / l, q.y / l, q.z / l, q.w / l};
  };
  for (int k = 0; k < count; ++k) {
    scene.begin_world();
    scene.add_body({.xform = {{}, turn()}});
    scene.add_shape_convex_hull(2 * k, {.vertices = hull()});
    const Vec3f away = math::normalize(Vec3f{normal(random), normal(random), normal(random)});
    scene.add_body({.xform = {away * (nearest + (farthest - nearest) * uniform(random)), turn()}});
    scene.add_shape_convex_hull(2 * k + 1, {.vertices = hull()});
    scene.end_world();
  }
  return scene.finalize(Device::cpu());
}

struct Deepest {
  double depth = -1e9;
  Vec3f normal{};
};
std::vector<Deepest> deepest(const std::shared_ptr<Model>& model, CollisionPipeline& pipeline) {
  Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts);
  const std::vector<Transformf> q = model->body_q.to_host();
  std::vector<Deepest> of(q.size() / 2);
  for (const RigidContact& c : contacts.rigid_contacts()) {
    const Vec3f a = math::transform_point(q[size_t(c.shape0)], c.point0);
    const Vec3f b = math::transform_point(q[size_t(c.shape1)], c.point1);
    const double depth = math::dot(a - b, c.normal);
    Deepest& d = of[size_t(c.shape0) / 2];
    if (depth > d.depth) d = {depth, c.normal};
  }
  return of;
}

TEST(Fcl, HasTheDepthsOfAutoAndCountsWhereItsOwnAreWrong) {
  const auto model = pairs(2000, 0.3f, 0.55f);
  CollisionPipeline fcl(model, {.narrow_phase = NarrowPhase::Fcl, .rigid_contact_max = 40000});
  CollisionPipeline own(model, {.rigid_contact_max = 40000});
  const auto a = deepest(model, fcl), b = deepest(model, own);
  int overlapping = 0, different = 0;
  for (size_t k = 0; k < a.size(); ++k) {
    if (b[k].depth <= 0.0) continue;
    ++overlapping;
    EXPECT_NEAR(a[k].depth, b[k].depth, 2e-4) << k;
    different += math::dot(a[k].normal, b[k].normal) < 0.9998f;
  }
  EXPECT_GT(overlapping, 1000);
  EXPECT_LT(different, overlapping / 100) << "two directions may be equally good";
  EXPECT_NEAR(double(fcl.fcl_pair_count()), overlapping, 5);
  EXPECT_GT(fcl.fcl_fallback_count(), 0);
  EXPECT_LT(fcl.fcl_fallback_count(), fcl.fcl_pair_count() / 2);
  EXPECT_EQ(own.fcl_pair_count(), 0);
  RecordProperty("pairs", int(fcl.fcl_pair_count()));
  RecordProperty("fallbacks", int(fcl.fcl_fallback_count()));
}

#endif

#ifdef NOVAPHY_WITH_FCL
constexpr NarrowPhase kPhases[] = {NarrowPhase::Auto, NarrowPhase::Fcl};
#else
constexpr NarrowPhase kPhases[] = {NarrowPhase::Auto};
#endif

// Published defects of FCL and libccd: stacked cubes that touch (libccd #25, FCL #493), the same
// shape twice in one place, a NaN. None may end the process. All results are those of Auto or of
// FCL.
void check_cubes(NarrowPhase narrow_phase) {
  const auto cube = testing::cube(0.5f);
  for (const float height : {1.0f, 0.9999999f, 0.0f, 1e-7f, 0.5f, 1.0000001f}) {
    ModelBuilder builder;
    builder.add_body();
    builder.add_shape_convex_hull(0, {.vertices = cube.vertices});
    builder.add_body({.xform = {{0.0f, 0.0f, height}, Quatf::identity()}});
    builder.add_shape_convex_hull(1, {.vertices = cube.vertices});
    const auto model = builder.finalize(Device::cpu());
    CollisionPipeline pipeline(model, {.narrow_phase = narrow_phase});
    Contacts contacts = pipeline.contacts();
    pipeline.collide(model->state(), contacts);
    const auto rows = contacts.rigid_contacts();
    EXPECT_GE(rows.size(), 4u) << height;
    for (const RigidContact& c : rows) {
      EXPECT_NEAR(math::length(c.normal), 1.0f, 1e-5f) << height;
      if (height > 0.4f) {
        EXPECT_GT(std::abs(c.normal.z), 0.999f) << height;
      }
    }
    SimState state = model->state();
    const Transformf bad[] = {{}, {{0.0f, NAN, 0.0f}, Quatf::identity()}};
    state.body_q.copy_from_host(std::span<const Transformf>(bad));
    pipeline.collide(state, contacts);
    EXPECT_EQ(contacts.rigid_contact_count.to_host()[0], 0);
  }
}
TEST(PublishedFailures, TouchingAndCoincidingCubesHaveRows) {
  for (const NarrowPhase phase : kPhases) check_cubes(phase);
}

// The deepest row of two bodies with one shape each: normal from the first to the second, depth.
struct Answer {
  Vec3f normal{};
  float depth = -1e9f;
};
template <class First, class Second>
Answer answer(First first, Second second, const Transformf& pose) {
  ModelBuilder builder;
  builder.add_body();
  first(builder, 0);
  builder.add_body({.xform = pose});
  second(builder, 1);
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts);
  const std::vector<Transformf> q = model->body_q.to_host();
  Answer deepest;
  for (const RigidContact& c : contacts.rigid_contacts()) {
    const auto of = [&](int32_t shape, const Vec3f& point) {
      return math::transform_point(q[size_t(shape)], point);
    };
    const float depth = (c.margin0 + c.margin1) -
                        math::dot(of(c.shape1, c.point1) - of(c.shape0, c.point0), c.normal);
    if (depth > deepest.depth) deepest = {c.shape0 == 0 ? c.normal : -c.normal, depth};
  }
  return deepest;
}
auto box(float hx, float hy, float hz) {
  return
      [=](ModelBuilder& b, int32_t body) { b.add_shape_box(body, {.hx = hx, .hy = hy, .hz = hz}); };
}
auto cylinder(float radius, float half) {
  return [=](ModelBuilder& b, int32_t body) {
    b.add_shape_cylinder(body, {.radius = radius, .half_height = half});
  };
}
auto capsule(float radius, float half) {
  return [=](ModelBuilder& b, int32_t body) {
    b.add_shape_capsule(body, {.radius = radius, .half_height = half});
  };
}
Transformf at(float x, float y, float z, const Quatf& q = Quatf::identity()) {
  return {{x, y, z}, q};
}

// Two parallel capsules throw in FCL ("origin is outside of the polytope").
TEST(PublishedFailures, ParallelCapsulesPartAcross) {
  const Answer a = answer(capsule(0.1f, 0.3f), capsule(0.1f, 0.3f), at(0.15f, 0.0f, 0.0f));
  EXPECT_NEAR(a.depth, 0.05f, 1e-5f);
  EXPECT_NEAR(a.normal.x, 1.0f, 1e-5f);
}

// FCL #407: a box and a cylinder that touch end the process.
TEST(PublishedFailures, ABoxAndACylinderPartAlongTheShorterWay) {
  const Answer above = answer(box(0.5f, 0.5f, 0.5f), cylinder(0.3f, 0.5f), at(0.1f, 0.0f, 0.95f));
  EXPECT_NEAR(above.depth, 0.05f, 1e-5f);
  EXPECT_NEAR(above.normal.z, 1.0f, 1e-4f);
  const Answer beside = answer(box(0.5f, 0.5f, 0.5f), cylinder(0.3f, 0.5f), at(0.78f, 0.0f, 0.1f));
  EXPECT_NEAR(beside.depth, 0.02f, 1e-5f);
  EXPECT_NEAR(beside.normal.x, 1.0f, 1e-4f);
}

// FCL #578: an endless loop for boxes with almost parallel faces; #375: a normal of length 0.
TEST(PublishedFailures, BoxesWithAlmostParallelFacesEnd) {
  for (const float turn : {0.0f, 1e-7f, 1e-5f, 1e-3f}) {
    const Quatf q = {turn, -turn, turn, std::sqrt(1.0f - 3.0f * turn * turn)};
    const Answer a = answer(box(0.25f, 0.25f, 0.5f), box(0.5f, 0.5f, 0.1f), at(0, 0, 0.59f, q));
    EXPECT_NEAR(a.depth, 0.01f, 2e-3f) << turn;
    EXPECT_NEAR(a.normal.z, 1.0f, 1e-4f) << turn;
  }
}

// Coal has a wrong depth where the center of a sphere is deep in a cylinder, MuJoCo for a capsule
// that passes through a box.
TEST(PublishedFailures, DeepSpheresAndCapsulesLeaveByTheShorterWay) {
  const auto sphere = [](ModelBuilder& b, int32_t body) {
    b.add_shape_sphere(body, {.radius = 0.1f});
  };
  const Answer side = answer(cylinder(0.5f, 1.0f), sphere, at(0.4f, 0.0f, 0.2f));
  EXPECT_NEAR(side.depth, 0.2f, 1e-5f);
  EXPECT_NEAR(side.normal.x, 1.0f, 1e-4f);
  const Answer cap = answer(cylinder(0.5f, 1.0f), sphere, at(0.1f, 0.0f, 0.9f));
  EXPECT_NEAR(cap.depth, 0.2f, 1e-5f);
  EXPECT_NEAR(cap.normal.z, 1.0f, 1e-4f);
  const Answer through = answer(box(0.2f, 0.2f, 0.2f), capsule(0.05f, 1.0f), at(0.15f, 0, 0.03f));
  EXPECT_NEAR(through.depth, 0.1f, 1e-5f);
  EXPECT_NEAR(through.normal.x, 1.0f, 1e-4f);
}

}  // namespace
}  // namespace novaphy
