// Rigid contacts of convex hulls and triangle meshes: the rows, their order, and edits of the
// arrays.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <set>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"
#include "support/bits.h"
#include "support/threads.h"
#include "support/triangles.h"

namespace novaphy {
namespace {

using testing::Triangles;

std::vector<RigidContact> rows(const std::shared_ptr<Model>& model,
                               const CollisionOptions& options = {}) {
  CollisionPipeline pipeline(model, options);
  Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts);
  EXPECT_FALSE(contacts.overflowed() && !options.rigid_contact_max);
  return contacts.rigid_contacts();
}

enum class As { Primitive, Hull, Mesh };

int32_t add_box(ModelBuilder& builder, int32_t body, As as, float hx, float hy, float hz,
                const Transformf& xform = Transformf::identity()) {
  const Triangles t = testing::box(hx, hy, hz);
  if (as == As::Hull)
    return builder.add_shape_convex_hull(body, {.xform = xform, .vertices = t.vertices});
  if (as == As::Mesh)
    return builder.add_shape_mesh(body,
                                  {.xform = xform, .vertices = t.vertices, .indices = t.indices});
  return builder.add_shape_box(body, {.xform = xform, .hx = hx, .hy = hy, .hz = hz});
}

Quatf turn(float x, float y, float z, float w) {
  const float l = std::sqrt(x * x + y * y + z * z + w * w);
  return {x / l, y / l, z / l, w / l};
}

double depth(const RigidContact& c, const std::vector<Transformf>& q,
             const std::vector<int32_t>& body) {
  const auto world = [&](int32_t shape, const Vec3f& p) {
    const int32_t b = body[size_t(shape)];
    return b < 0 ? p : math::transform_point(q[size_t(b)], p);
  };
  return double(c.margin0) + double(c.margin1) -
         double(math::dot(world(c.shape1, c.point1) - world(c.shape0, c.point0), c.normal));
}
double deepest(const std::shared_ptr<Model>& model) {
  double most = -1.0;
  for (const RigidContact& c : rows(model))
    most = std::max(most, depth(c, model->body_q.to_host(), model->shape_body.to_host()));
  return most;
}

TEST(MeshContacts, ABoxOfAnyKindRestsOnABoxAsTheBoxDoes) {
  const float tilts[] = {0.0f, 1e-4f, 0.03f, 0.3f};
  for (const float tilt : tilts) {
    std::vector<std::vector<RigidContact>> found;
    std::vector<double> depths;
    for (const As lower : {As::Primitive, As::Hull, As::Mesh})
      for (const As upper : {As::Primitive, As::Hull, As::Mesh}) {
        ModelBuilder builder;
        add_box(builder, -1, lower, 0.5f, 0.5f, 0.1f);
        builder.add_body({.xform = {{0.03f, 0.02f, 0.198f}, turn(tilt, 0.5f * tilt, 0.2f, 1.0f)}});
        add_box(builder, 0, upper, 0.1f, 0.15f, 0.1f);
        const auto model = builder.finalize(Device::cpu());
        int touching = 0;
        for (const RigidContact& c : rows(model)) {
          const double d = depth(c, model->body_q.to_host(), model->shape_body.to_host());
          touching += d > 0.0;
          const bool upper_is_first = c.shape0 == 1;
          if (d > 0.0) {
            EXPECT_GT(upper_is_first ? -c.normal.z : c.normal.z, 0.9f);
          }
        }
        EXPECT_LE(touching, 8);
        EXPECT_GE(touching, tilt > 0.1f ? 1 : 2) << int(lower) << int(upper) << tilt;
        depths.push_back(deepest(model));
      }
    for (const double d : depths) EXPECT_NEAR(d, depths[0], 1e-4) << tilt;
  }
}

TEST(MeshContacts, OnAPlaneHullsAndMeshesHaveTheCornersOfABox) {
  for (const float tilt : {0.0f, 0.02f, 0.4f}) {
    const auto build = [&](As as) {
      ModelBuilder builder;
      builder.add_ground_plane();
      builder.add_body({.xform = {{0.0f, 0.0f, 0.095f}, turn(tilt, 0.3f * tilt, 0.0f, 1.0f)}});
      add_box(builder, 0, as, 0.1f, 0.1f, 0.1f);
      return builder.finalize(Device::cpu());
    };
    const auto box = build(As::Primitive);
    for (const As as : {As::Hull, As::Mesh}) {
      const auto model = build(as);
      EXPECT_NEAR(deepest(model), deepest(box), 1e-6);
      const auto found = rows(model);
      EXPECT_LE(found.size(), 4u);
      if (tilt < 0.1f) {
        std::set<int32_t> corners;
        for (const RigidContact& c : found) corners.insert(c.point_id);
        EXPECT_EQ(corners, (std::set<int32_t>{0, 1, 2, 3})) << "the lower corners";
      }
      for (const RigidContact& c : found) EXPECT_EQ(c.normal, (Vec3f{0.0f, 0.0f, 1.0f}));
    }
  }
}

// Rows push the lower corners up by their depth, whether or not the floor is lower elsewhere.
TEST(MeshContacts, AMeshInAnOpenFloorHasItsDepth) {
  for (const float pit : {0.0f, 0.5f})
    for (const float down : {1e-5f, 1e-3f, 0.01f, 0.03f, 0.08f}) {
      const Triangles floor = testing::terrain(
          6, 1.0f, [pit](float x, float y) { return x < -2.5f && y < -2.5f ? -pit : 0.0f; });
      ModelBuilder builder;
      builder.add_shape_mesh(-1, {.vertices = floor.vertices, .indices = floor.indices});
      builder.add_body({.xform = {{0.33f, 0.21f, 0.1f - down}, turn(0.0f, 0.0f, 0.2f, 1.0f)}});
      add_box(builder, 0, As::Mesh, 0.1f, 0.1f, 0.1f);
      const auto model = builder.finalize(Device::cpu());
      int touching = 0;
      for (const RigidContact& c : rows(model)) {
        EXPECT_NEAR(c.normal.z, 1.0f, 1e-5f);
        const double d = depth(c, model->body_q.to_host(), model->shape_body.to_host());
        if (d <= 0.0) continue;
        ++touching;
        EXPECT_NEAR(d, down, 1e-6);
      }
      EXPECT_EQ(touching, 4) << pit << " " << down;
    }
}

TEST(MeshContacts, AMeshOffItsOriginIsFoundWhereItIs) {
  Triangles t = testing::cube(0.1f);
  for (Vec3f& v : t.vertices) v = v + Vec3f{5.0f, 0.0f, 0.0f};
  ModelBuilder builder;
  builder.add_body({.xform = {{-5.0f, 0.0f, 0.0f}, Quatf::identity()}});
  builder.add_shape_convex_hull(0, {.vertices = t.vertices});
  builder.add_body({.xform = {{0.0f, -5.0f, 0.19f}, turn(0.0f, 0.0f, 1.0f, 1.0f)}});
  builder.add_shape_mesh(1, {.vertices = t.vertices, .indices = t.indices});
  for (const BroadPhase phase : {BroadPhase::Explicit, BroadPhase::NxN, BroadPhase::Sap}) {
    const auto found = rows(builder.finalize(Device::cpu()), {.broad_phase = phase});
    ASSERT_GE(found.size(), 4u);
    EXPECT_EQ(found[0].shape0, 1) << "the mesh, of the smaller type";
    EXPECT_NEAR(found[0].normal.z, -1.0f, 1e-5f) << "from the mesh to the hull";
  }
}

// Every convex type, hulls and a mesh over a terrain.
std::shared_ptr<Model> pile(int count, int worlds = 1) {
  ModelBuilder part;
  const Triangles ground = testing::terrain(
      22, 0.4f, [](float x, float y) { return 0.2f * std::sin(2.0f * x) * std::cos(3.0f * y); });
  part.add_shape_mesh(-1, {.vertices = ground.vertices, .indices = ground.indices});
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  const GeoType types[] = {GeoType::SPHERE,   GeoType::CAPSULE, GeoType::ELLIPSOID,
                           GeoType::CYLINDER, GeoType::BOX,     GeoType::CONE};
  for (int k = 0; k < count; ++k) {
    const Vec3f p = {3.0f * uniform(random), 2.0f * uniform(random), 0.2f + 0.2f * uniform(random)};
    const Quatf q = turn(uniform(random), uniform(random), uniform(random), uniform(random));
    const int32_t body = part.add_body({.xform = {p, q}});
    if (k % 7 < 6) {
      part.add_shape({.body = body, .type = types[k % 7], .scale = {0.3f, 0.2f, 0.25f}});
      continue;
    }
    std::vector<Vec3f> points;
    for (int i = 0; i < 20; ++i)
      points.push_back(Vec3f{uniform(random), uniform(random), uniform(random)} * 0.3f);
    part.add_shape_convex_hull(body, {.vertices = points});
  }
  if (worlds == 1) return part.finalize(Device::cpu());
  ModelBuilder scene;
  scene.replicate(part, worlds);
  return scene.finalize(Device::cpu());
}

TEST(MeshContacts, AreTheSameForEveryBroadPhaseAndAnyNumberOfThreads) {
  const auto model = pile(70);
  const auto found = rows(model, {.rigid_contact_max = 20000});
  EXPECT_GT(found.size(), 400u);
  EXPECT_GT(std::count_if(found.begin(), found.end(),
                          [](const auto& c) { return c.shape0 == 0 || c.shape1 == 0; }),
            200);
  EXPECT_TRUE(std::is_sorted(found.begin(), found.end(), [](const auto& x, const auto& y) {
    return std::pair(x.shape0, x.shape1) < std::pair(y.shape0, y.shape1);
  }));
  for (const BroadPhase phase : {BroadPhase::NxN, BroadPhase::Sap})
    EXPECT_EQ(found, rows(model, {.broad_phase = phase, .rigid_contact_max = 20000}));
  for (const int threads : {1, 2, 7}) {
    const testing::Threads set(threads);
    EXPECT_EQ(found, rows(model, {.rigid_contact_max = 20000})) << threads;
  }
}

TEST(MeshContacts, DoNotDependOnTheCapacity) {
  const auto model = pile(30);
  const auto all = rows(model, {.rigid_contact_max = 20000});
  CollisionPipeline few(model, {.rigid_contact_max = 100});
  Contacts contacts = few.contacts();
  few.collide(model->state(), contacts);
  EXPECT_TRUE(contacts.overflowed());
  EXPECT_EQ(contacts.rigid_contact_count.to_host()[0], int32_t(all.size()));
  const std::vector<RigidContact> kept = contacts.rigid_contacts();
  EXPECT_EQ(kept.size(), 100u);
  auto from = all.begin();  // the rows are a part of all rows, in the same order
  for (const RigidContact& row : kept) {
    from = std::find(from, all.end(), row);
    ASSERT_NE(from, all.end());
    ++from;
  }
}

TEST(MeshContacts, OfWorldsInOnePlaceAreThoseOfOne) {
  const auto one = rows(pile(14), {.rigid_contact_max = 20000});
  const auto three = rows(pile(14, 3), {.rigid_contact_max = 60000});
  ASSERT_EQ(three.size(), 3 * one.size());
  for (size_t k = 0; k < three.size(); ++k) {
    EXPECT_EQ(three[k].normal, one[k % one.size()].normal);
    EXPECT_EQ(three[k].point0, one[k % one.size()].point0);
    EXPECT_EQ(three[k].point_id, one[k % one.size()].point_id);
  }
}

TEST(MeshContacts, NamesOfAPairAreDifferent) {
  std::set<std::vector<int32_t>> seen;
  for (const RigidContact& c : rows(pile(70), {.rigid_contact_max = 20000}))
    EXPECT_TRUE(seen.insert({c.shape0, c.shape1, c.point_id}).second);
}

// 95 % of the names stay from step to step while a box slides over a terrain.
TEST(MeshContacts, NamesStayWhileABoxSlides) {
  for (const As as : {As::Primitive, As::Hull}) {
    const Triangles ground = testing::terrain(22, 0.1f, testing::flat);
    ModelBuilder builder;
    builder.add_shape_mesh(-1, {.vertices = ground.vertices, .indices = ground.indices});
    builder.add_body({.xform = {{-0.8f, 0.013f, 0.099f}, turn(0.0f, 0.0f, 0.05f, 1.0f)}});
    add_box(builder, 0, as, 0.1f, 0.1f, 0.1f);
    const auto model = builder.finalize(Device::cpu());
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    SimState state = model->state();
    std::set<int32_t> before;
    int kept = 0, all = 0;
    for (int t = 0; t < 960; ++t) {
      std::vector<Transformf> q = state.body_q.to_host();
      q[0].p.x += 1.0f / 960.0f;  // 1 m/s
      state.body_q.copy_from_host(std::span<const Transformf>(q));
      pipeline.collide(state, contacts);
      std::set<int32_t> now;
      for (const RigidContact& c : contacts.rigid_contacts())
        if (depth(c, q, model->shape_body.to_host()) > 0.0) now.insert(c.point_id);
      if (t > 0)
        for (const int32_t id : now) {
          ++all;
          kept += before.contains(id);
        }
      before = now;
    }
    EXPECT_GT(all, 3 * 960);
    EXPECT_GE(kept, 0.95 * all) << kept << " of " << all;
  }
}

TEST(MeshContacts, ABigBoxOnAFineTerrainKeepsItsCorners) {
  const Triangles ground = testing::terrain(60, 0.02f, testing::flat);  // 7200 triangles
  ModelBuilder builder;
  builder.add_shape_mesh(-1, {.vertices = ground.vertices, .indices = ground.indices});
  builder.add_body({.xform = {{0.0f, 0.0f, 0.099f}, turn(0.0f, 0.0f, 0.1f, 1.0f)}});
  add_box(builder, 0, As::Primitive, 0.5f, 0.4f, 0.1f);
  const auto model = builder.finalize(Device::cpu());
  const auto found = rows(model);
  ASSERT_GE(found.size(), 4u);
  ASSERT_LE(found.size(), 32u);
  const Transformf q = model->body_q.to_host()[0];
  for (const float x : {-0.5f, 0.5f})
    for (const float y : {-0.4f, 0.4f}) {
      const Vec3f corner = math::transform_point(q, Vec3f{x, y, -0.1f});
      float nearest = 1e9f;
      for (const RigidContact& c : found) {
        const Vec3f on_ground = c.shape0 == 0 ? c.point0 : c.point1;
        nearest = std::min(nearest, std::hypot(on_ground.x - corner.x, on_ground.y - corner.y));
      }
      EXPECT_LT(nearest, 0.03f) << x << " " << y;
    }
  for (const RigidContact& c : found) EXPECT_GT(std::abs(c.normal.z), 0.999f);
}

TEST(MeshContacts, FollowWhatIsWrittenToTheModel) {
  const Triangles cube = testing::cube(0.1f);
  ModelBuilder builder;
  builder.add_ground_plane();
  builder.add_body({.xform = {{0.0f, 0.0f, 0.4f}, Quatf::identity()}});
  builder.add_shape_convex_hull(0, {.vertices = cube.vertices});
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  const SimState state = model->state();
  const auto count = [&] {
    pipeline.collide(state, contacts);
    return contacts.rigid_contact_count.to_host()[0];
  };
  EXPECT_EQ(count(), 0);
  const Vec3f scales[] = {{}, {1.0f, 1.0f, 4.0f}};
  model->shape_scale.copy_from_host(std::span<const Vec3f>(scales));
  EXPECT_EQ(count(), 4);
  std::vector<Vec3f> vertices = model->mesh_vertices.to_host();
  for (Vec3f& v : vertices) v.z *= 0.25f;
  model->mesh_vertices.copy_from_host(std::span<const Vec3f>(vertices));
  EXPECT_EQ(count(), 0);
  for (Vec3f& v : vertices) v.z = 0.0f;
  model->mesh_vertices.copy_from_host(std::span<const Vec3f>(vertices));
  EXPECT_ERROR(count(), ErrorKind::Value, "CollisionPipeline: shape 1: convex_hull");
  const int32_t outside[] = {0, 0, 0, 0, 4, 8, 0, 12};
  model->shape_mesh_range.copy_from_host(std::span<const int32_t>(outside));
  EXPECT_ERROR(count(), ErrorKind::Value, "model.shape_mesh_range[1]");
}

TEST(MeshContacts, APoseThatIsNoNumberHasNone) {
  const Triangles cube = testing::cube(0.1f);
  ModelBuilder builder;
  builder.add_shape_mesh(-1, {.vertices = cube.vertices, .indices = cube.indices});
  builder.add_ground_plane();
  builder.add_body();
  builder.add_shape_convex_hull(0, {.vertices = cube.vertices});
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  SimState state = model->state();
  const float nan = std::numeric_limits<float>::quiet_NaN();
  const Transformf bad[] = {{{nan, 0.0f, 0.0f}, Quatf::identity()}};
  state.body_q.copy_from_host(std::span<const Transformf>(bad));
  pipeline.collide(state, contacts);
  EXPECT_EQ(contacts.rigid_contact_count.to_host()[0], 0);
}

}  // namespace
}  // namespace novaphy
