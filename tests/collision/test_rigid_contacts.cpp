// Rigid contacts of CollisionPipeline: which pairs, which rows, their order, overflow.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/model_builder.h"
#include "support/bits.h"
#include "support/pair_scenes.h"
#include "support/threads.h"

namespace novaphy {
namespace {

Transformf at(float x, float y, float z) { return {{x, y, z}, Quatf::identity()}; }

std::vector<RigidContact> rows(const std::shared_ptr<Model>& model,
                               const CollisionOptions& options = {}) {
  CollisionPipeline pipeline(model, options);
  Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts);
  return contacts.rigid_contacts();
}

TEST(RigidContacts, ASphereOnAPlaneIsOneRowOfCorePoints) {
  ModelBuilder builder;
  builder.add_body({.xform = at(1.0f, 2.0f, 0.45f)});
  builder.add_shape_sphere(0, {.radius = 0.5f, .cfg = ShapeConfig{.margin = 0.01f}});
  builder.add_shape_plane({.width = 0.0f, .length = 0.0f, .cfg = ShapeConfig{.margin = 0.02f}});
  const auto contacts = rows(builder.finalize(Device::cpu()));
  ASSERT_EQ(contacts.size(), 1u);
  const RigidContact& c = contacts[0];
  EXPECT_EQ(c.shape0, 1) << "the plane, of the smaller type";
  EXPECT_EQ(c.shape1, 0);
  EXPECT_EQ(c.normal, (Vec3f{0.0f, 0.0f, 1.0f}));
  EXPECT_NEAR(c.point0.z, 0.0f, 1e-6f);
  EXPECT_NEAR(c.point0.x, 1.0f, 1e-6f);
  EXPECT_NEAR(math::length(c.point1), 0.0f, 1e-6f) << "the center, in the frame of the body";
  EXPECT_FLOAT_EQ(c.margin0, 0.02f);
  EXPECT_FLOAT_EQ(c.margin1, 0.51f);
  EXPECT_FLOAT_EQ(c.offset0.z, 0.02f);
  EXPECT_FLOAT_EQ(c.offset1.z, -0.51f);
  EXPECT_EQ(c.force, Vec3f{});
}

TEST(RigidContacts, RowsAreThoseWithinBothGaps) {
  const auto found = [](float height) {
    ModelBuilder builder;
    builder.add_ground_plane({.cfg = ShapeConfig{.gap = 0.1f}});
    builder.add_body({.xform = at(0.0f, 0.0f, height)});
    builder.add_shape_sphere(0, {.radius = 0.5f, .cfg = ShapeConfig{.margin = 0.05f, .gap = 0.2f}});
    return rows(builder.finalize(Device::cpu())).size();
  };
  EXPECT_EQ(found(0.849f), 1u);
  EXPECT_EQ(found(0.851f), 0u);
}

TEST(RigidContacts, RowsAreOrderedByShape0AndShape1) {
  ModelBuilder builder;
  for (int b = 0; b < 4; ++b)
    builder.add_body({.xform = at(2.0f * static_cast<float>(b), 0.0f, 0.1f)});
  builder.add_shape_box(0, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f});
  builder.add_ground_plane();
  builder.add_shape_capsule(1, {.radius = 0.1f, .half_height = 0.3f});
  builder.add_ground_plane({.height = -0.05f});
  builder.add_shape_cylinder(2, {.radius = 0.1f, .half_height = 0.15f});
  builder.add_shape_ellipsoid(3, {.rx = 0.1f, .ry = 0.1f, .rz = 0.1f});
  for (const int32_t a : {0, 2, 4, 5})
    for (const int32_t b : {0, 2, 4, 5})
      if (a < b) builder.add_shape_collision_filter_pair(a, b);
  const auto model = builder.finalize(Device::cpu());
  const auto contacts = rows(model);
  ASSERT_EQ(contacts.size(), 2u * (4 + 1 + 3 + 1));
  EXPECT_TRUE(std::is_sorted(contacts.begin(), contacts.end(), [](const auto& x, const auto& y) {
    return std::pair(x.shape0, x.shape1) < std::pair(y.shape0, y.shape1);
  }));
  EXPECT_EQ(contacts, rows(model, {.broad_phase = BroadPhase::NxN}));
  for (const int threads : {2, 7}) {
    const testing::Threads set(threads);
    EXPECT_EQ(contacts, rows(model)) << threads;
  }
}

// Shapes of all types, some far, some in one place, some in worlds.
std::shared_ptr<Model> pile(int count) {
  ModelBuilder builder;
  builder.add_ground_plane();
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(-1.0f, 1.0f);
  const GeoType types[] = {GeoType::SPHERE,   GeoType::CAPSULE, GeoType::ELLIPSOID,
                           GeoType::CYLINDER, GeoType::BOX,     GeoType::CONE};
  for (int k = 0; k < count; ++k) {
    if (k % 40 == 20) builder.begin_world();
    const Vec3f p = {4.0f * uniform(random), 2.0f * uniform(random), 1.0f + uniform(random)};
    Quatf q = {uniform(random), uniform(random), uniform(random), uniform(random)};
    const float l = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    q = {q.x / l, q.y / l, q.z / l, q.w / l};
    const int32_t body = builder.add_body({.xform = {p, q}});
    builder.add_shape({.body = body,
                       .type = types[k % 6],
                       .scale = {0.3f, 0.2f, 0.25f},
                       .cfg = ShapeConfig{.collision_group = k % 7 == 0 ? -1 - k : 1}});
    if (k % 40 == 39) builder.end_world();
  }
  return builder.finalize(Device::cpu());
}

TEST(RigidContacts, EveryBroadPhaseFindsTheSameRows) {
  const auto model = pile(200);
  const auto contacts = rows(model, {.rigid_contact_max = 20000});
  EXPECT_GT(contacts.size(), 500u);
  EXPECT_EQ(contacts, rows(model, {.broad_phase = BroadPhase::NxN, .rigid_contact_max = 20000}));
  // Again and again, as the sweep starts from its last order.
  CollisionPipeline pipeline(model, {.broad_phase = BroadPhase::Sap, .rigid_contact_max = 20000});
  CollisionPipeline other(model, {.rigid_contact_max = 20000});
  Contacts swept = pipeline.contacts(), expected = other.contacts();
  SimState state = model->state();
  for (int t = 0; t < 5; ++t) {
    std::vector<Transformf> poses = state.body_q.to_host();
    for (size_t b = 0; b < poses.size(); ++b)
      poses[b].p.x += 0.3f * std::sin(static_cast<float>(b + 3 * static_cast<size_t>(t)));
    state.body_q.copy_from_host(std::span<const Transformf>(poses));
    pipeline.collide(state, swept);
    other.collide(state, expected);
    EXPECT_EQ(swept.rigid_contacts(), expected.rigid_contacts()) << t;
    EXPECT_EQ(swept.rigid_contact_count.to_host(), expected.rigid_contact_count.to_host());
  }
}

// Runs recorded launches at once, so that the search uses the kernels of devices. `used` keeps the
// objects that the recordings use, as if all were one recording.
using Used = std::vector<std::shared_ptr<ExclusiveUse>>;
class RunsAtOnce : public LaunchRecorder {
 public:
  explicit RunsAtOnce(Used& used) : used_(used), before_(set_launch_recorder(this)) {}
  ~RunsAtOnce() override { set_launch_recorder(before_); }
  void launch(const Launch& l) override { launch_now(l.context, l.kernel, l.name, l.n, l.words); }
  bool has_tape() const override { return false; }
  void depends_on(const std::shared_ptr<Range>&) override {}
  void depends_on(const std::shared_ptr<const float>&, std::string_view) override {}
  void before_replay(const std::shared_ptr<const void>&, const std::function<void()>&) override {}
  void uses(const std::shared_ptr<ExclusiveUse>& memory) override { used_.push_back(memory); }

 private:
  Used& used_;
  LaunchRecorder* before_;
};

TEST(RigidContacts, TheKernelsLoseNoRowOfHardScenes) {
  for (const testing::PairScene& scene : testing::hard_pair_scenes()) {
    const auto model = scene.builder.finalize(Device::cpu());
    CollisionPipeline exhaustive(model,
                                 {.broad_phase = BroadPhase::NxN, .rigid_contact_max = 9000});
    CollisionPipeline kernels(model, {.broad_phase = BroadPhase::Sap, .rigid_contact_max = 9000});
    Contacts expected = exhaustive.contacts(), found = kernels.contacts();
    SimState state = model->state();
    Used used;  // the second search keeps the order of the first one
    for (const std::vector<Transformf>& poses : poses_of(scene, state)) {
      state.body_q.copy_from_host(std::span<const Transformf>(poses));
      exhaustive.collide(state, expected, {}, 0.01f);
      {
        const RunsAtOnce recorder(used);
        kernels.collide(state, found, {}, 0.01f);
      }
      EXPECT_GT(expected.rigid_contact_count.to_host()[0], 90) << scene.name;
      EXPECT_FALSE(expected.overflowed()) << scene.name;
      EXPECT_EQ(found.rigid_contact_count.to_host(), expected.rigid_contact_count.to_host())
          << scene.name;
      EXPECT_TRUE(found.rigid_contacts() == expected.rigid_contacts()) << scene.name;
    }
  }
}

TEST(RigidContacts, OverflowKeepsTheFirstRowsAndTheTrueCount) {
  ModelBuilder builder;
  builder.add_ground_plane();
  builder.add_body({.xform = at(0.0f, 0.0f, 0.1f)});
  builder.add_shape_box(0, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f});
  const auto model = builder.finalize(Device::cpu());
  const auto all = rows(model);
  ASSERT_EQ(all.size(), 4u);
  CollisionPipeline pipeline(model, {.rigid_contact_max = 3});
  EXPECT_EQ(pipeline.rigid_contact_max(), 3);
  EXPECT_EQ(CollisionPipeline(model).rigid_contact_max(), 4);
  Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts);
  EXPECT_EQ(contacts.rigid_contact_count.to_host()[0], 4);
  EXPECT_EQ(contacts.active_rigid_contact_count(), 3);
  EXPECT_TRUE(contacts.overflowed());
  EXPECT_EQ(contacts.rigid_contacts(), std::vector<RigidContact>(all.begin(), all.begin() + 3));
}

// The gap of a row, with bodies that are not turned.
float separation(const RigidContact& row, const Model& model, const std::vector<Transformf>& q) {
  const std::vector<int32_t> body = model.shape_body.to_host();
  const auto world = [&](int32_t shape, const Vec3f& p) {
    const int32_t b = body[static_cast<size_t>(shape)];
    return b < 0 ? p : p + q[static_cast<size_t>(b)].p;
  };
  return math::dot(world(row.shape1, row.point1) - world(row.shape0, row.point0), row.normal) -
         row.margin0 - row.margin1;
}

// A block of cubes of 2 cm, of which each is within the gap of all others.
std::shared_ptr<Model> block_of_cubes(int32_t side) {
  ModelBuilder builder;
  builder.add_ground_plane();
  for (int32_t k = 0; k < side * side * side; ++k) {
    const float edge = 0.02f, apart = 1.05f * edge;
    builder.add_body({.xform = at(apart * static_cast<float>(k % side),
                                  apart * static_cast<float>(k / side % side),
                                  edge * (static_cast<float>(k / (side * side)) + 0.5f))});
    builder.add_shape_box(k, {.hx = 0.01f, .hy = 0.01f, .hz = 0.01f});
  }
  return builder.finalize(Device::cpu());
}

TEST(RigidContacts, OfMoreRowsThanThereIsRoomForTheNearestStay) {
  const auto model = block_of_cubes(5);
  const std::vector<Transformf> q = model->state().body_q.to_host();
  for (const BroadPhase phase : {BroadPhase::Explicit, BroadPhase::NxN, BroadPhase::Sap}) {
    const auto all = rows(model, {.broad_phase = phase, .rigid_contact_max = 100000});
    CollisionPipeline pipeline(model, {.broad_phase = phase});
    Contacts contacts = pipeline.contacts();
    pipeline.collide(model->state(), contacts);
    EXPECT_EQ(contacts.rigid_contact_count.to_host()[0], static_cast<int32_t>(all.size()));
    ASSERT_LT(contacts.rigid_contact_max(), static_cast<int32_t>(all.size()));
    const std::vector<RigidContact> kept = contacts.rigid_contacts();
    EXPECT_EQ(static_cast<int32_t>(kept.size()), contacts.rigid_contact_max());
    auto from = all.begin();
    float farthest = 0.0f;
    for (const RigidContact& row : kept) {
      farthest = std::max(farthest, separation(row, *model, q));
      from = std::find(from, all.end(), row);
      ASSERT_NE(from, all.end()) << "in their order";
      ++from;
    }
    // All rows within half of the farthest distance are kept.
    size_t near = 0, kept_near = 0;
    const auto is_near = [&](const RigidContact& row) {
      return separation(row, *model, q) <= 0.49f * farthest;
    };
    for (const RigidContact& row : all) near += is_near(row);
    for (const RigidContact& row : kept) kept_near += is_near(row);
    EXPECT_GT(near, 1000u);
    EXPECT_EQ(kept_near, near);
  }
}

TEST(RigidContacts, ForAStepThereAreOnlyRowsThatMayTouchInIt) {
  const auto model = block_of_cubes(3);
  CollisionPipeline pipeline(model, {.rigid_contact_max = 100000});
  Contacts contacts = pipeline.contacts();
  SimState state = model->state();
  const std::vector<Transformf> q = state.body_q.to_host();
  const auto all = rows(model, {.rigid_contact_max = 100000});
  const float dt = 1.0f / 240.0f, far = 4.2f * dt;
  const auto found = [&] {
    pipeline.collide(state, contacts, {}, dt);
    return contacts.rigid_contacts();
  };
  std::vector<RigidContact> expected;
  for (const RigidContact& row : all)
    if (separation(row, *model, q) <= far) expected.push_back(row);
  EXPECT_EQ(found(), expected);
  EXPECT_LT(expected.size(), all.size());
  // A cube that would come 0.2 m far has all of its rows.
  std::vector<SpatialVectorf> qd(27);
  qd[0].linear.x = 48.0f;
  state.body_qd.copy_from_host(std::span<const SpatialVectorf>(qd));
  const auto of_first = [](const std::vector<RigidContact>& some) {
    return std::count_if(some.begin(), some.end(),
                         [](const RigidContact& r) { return r.shape0 == 1 || r.shape1 == 1; });
  };
  const std::vector<RigidContact> of_fast = found();
  EXPECT_GT(of_first(of_fast), of_first(expected));
  EXPECT_ERROR(pipeline.collide(state, contacts, {}, -1.0f), ErrorKind::Value, "dt: expected");
}

TEST(RigidContacts, UnusedRowsAreEmptyAgainWhenTheBodyHasLeft) {
  ModelBuilder builder;
  builder.add_ground_plane();
  builder.add_body({.xform = at(0.0f, 0.0f, 0.1f)});
  builder.add_shape_box(0, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f});
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  SimState state = model->state();
  pipeline.collide(state, contacts);
  EXPECT_EQ(contacts.active_rigid_contact_count(), 4);
  contacts.rigid_contact_force.fill({1.0f, 2.0f, 3.0f});
  for (const float height : {10.0f, NAN}) {
    state.body_q.fill(at(0.0f, 0.0f, height));
    pipeline.collide(state, contacts);
    EXPECT_EQ(contacts.active_rigid_contact_count(), 0) << height;
    EXPECT_EQ(contacts.rigid_contact_shape1.to_host(), std::vector<int32_t>(4, -1));
    EXPECT_EQ(contacts.rigid_contact_point_id.to_host(), std::vector<int32_t>(4, -1));
    EXPECT_EQ(contacts.rigid_contact_force.to_host(), std::vector<Vec3f>(4));
  }
}

// The result does not depend on earlier contents of the contacts, nor on who wrote them.
TEST(RigidContacts, AreThoseOfEmptyContactsWhateverWasInThem) {
  ModelBuilder builder;
  builder.add_ground_plane();
  for (int32_t b = 0; b < 3; ++b) {
    builder.add_body({.xform = at(0.5f * float(b), 0.0f, 0.1f)});
    builder.add_shape_box(b, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f});
  }
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model, {.broad_phase = BroadPhase::Sap});
  Contacts used[2] = {pipeline.contacts(), pipeline.contacts()};
  SimState state = model->state();
  const size_t rows = size_t(used[0].rigid_contact_max());
  for (int trial = 0; trial < 40; ++trial) {
    std::vector<Transformf> q;
    for (int32_t b = 0; b < 3; ++b)
      q.push_back(at(0.5f * float(b), 0.0f, (trial * 7 + b * 3) % 5 < 2 ? 5.0f : 0.1f));
    state.body_q.copy_from_host(std::span<const Transformf>(q));
    Contacts& contacts = used[trial % 3 == 0 ? 1 : 0];
    if (trial % 5 == 0) contacts.rigid_contact_shape0.copy_from_host(std::vector<int32_t>(rows, 2));
    if (trial % 7 == 0) contacts.rigid_contact_count.fill(0);
    pipeline.collide(state, contacts);
    Contacts fresh = pipeline.contacts();
    CollisionPipeline(model).collide(state, fresh);
    EXPECT_EQ(contacts.rigid_contacts(), fresh.rigid_contacts()) << trial;
    EXPECT_EQ(contacts.rigid_contact_shape0.to_host(), fresh.rigid_contact_shape0.to_host())
        << trial;
    EXPECT_EQ(contacts.rigid_contact_shape1.to_host(), fresh.rigid_contact_shape1.to_host())
        << trial;
    EXPECT_EQ(contacts.rigid_contact_normal.to_host(), fresh.rigid_contact_normal.to_host())
        << trial;
  }
}

TEST(RigidContacts, KnowWhichPosesTheyWereFoundFrom) {
  ModelBuilder builder;
  builder.add_ground_plane();
  builder.add_body({.xform = at(0.0f, 0.0f, 0.4f)});
  builder.add_shape_sphere(0, {.radius = 0.5f});
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model);
  SimState state = model->state();
  const SimState same = model->state();
  Contacts contacts = pipeline.contacts();
  const auto known = [&](const Contacts& of) {
    return of.rigid_contacts_found_from(*model, state.body_q);
  };
  EXPECT_FALSE(known(contacts));
  const auto find = [&] {
    pipeline.collide(state, contacts);
    EXPECT_TRUE(known(contacts));
  };
  find();
  EXPECT_FALSE(contacts.rigid_contacts_found_from(*model, same.body_q));
  contacts.rigid_contact_force.zero();
  EXPECT_TRUE(known(contacts)) << "solvers write forces";
  EXPECT_TRUE(known(contacts.clone()));
  Contacts copy = pipeline.contacts();
  copy.assign(contacts);
  EXPECT_FALSE(known(copy));
  state.body_q.assign(same.body_q);
  EXPECT_FALSE(known(contacts));
  find();
  contacts.rigid_contact_normal.assign(copy.rigid_contact_normal);
  EXPECT_FALSE(known(contacts));
  EXPECT_FALSE(known(contacts.clone()));
  find();
  model->shape_transform.assign(model->shape_transform.clone());
  EXPECT_FALSE(known(contacts));
  find();
  contacts.clear();
  EXPECT_FALSE(known(contacts));
  find();
  Contacts moved = std::move(contacts);
  EXPECT_TRUE(known(moved));
  const auto writable = state.body_q.range()->writable_export_scope();
  EXPECT_FALSE(known(moved));
}

TEST(RigidContacts, FollowGroupsFlagsFiltersAndWorlds) {
  const auto found = [](const ShapeConfig& cfg, bool filter) {
    ModelBuilder builder;
    builder.add_ground_plane();
    builder.add_body({.xform = at(0.0f, 0.0f, 0.1f)});
    builder.add_shape_sphere(0, {.radius = 0.1f, .cfg = cfg});
    if (filter) builder.add_shape_collision_filter_pair(0, 1);
    return rows(builder.finalize(Device::cpu())).size();
  };
  EXPECT_EQ(found({}, false), 1u);
  EXPECT_EQ(found({}, true), 0u);
  EXPECT_EQ(found({.collision_group = 2}, false), 0u);
  EXPECT_EQ(found({.collision_group = -2}, false), 1u);
  EXPECT_EQ(found({.has_shape_collision = false}, false), 0u);
  ModelBuilder one, worlds;
  one.add_ground_plane();
  one.add_body({.xform = at(0.0f, 0.0f, 0.1f)});
  one.add_shape_sphere(0, {.radius = 0.1f});
  worlds.replicate(one, 3);
  const auto contacts = rows(worlds.finalize(Device::cpu()));
  ASSERT_EQ(contacts.size(), 3u);
  for (int32_t w = 0; w < 3; ++w) {
    EXPECT_EQ(contacts[static_cast<size_t>(w)].shape0, 2 * w);
    EXPECT_EQ(contacts[static_cast<size_t>(w)].shape1, 2 * w + 1);
  }
}

TEST(RigidContacts, APlaneOfAKinematicBodyMovesWithIt) {
  ModelBuilder builder;
  const float s = std::sqrt(0.5f);
  builder.add_body({.xform = {{1.0f, 0.0f, 0.0f}, {0.0f, s, 0.0f, s}}, .is_kinematic = true});
  builder.add_shape_plane({.width = 0.0f, .length = 0.0f, .body = 0});
  builder.add_body({.xform = at(1.05f, 0.0f, 3.0f)});
  builder.add_shape_sphere(1, {.radius = 0.1f});
  const auto contacts = rows(builder.finalize(Device::cpu()));
  ASSERT_EQ(contacts.size(), 1u);
  EXPECT_NEAR(contacts[0].normal.x, 1.0f, 1e-6f);
  EXPECT_NEAR(contacts[0].point0.x, -3.0f, 1e-5f) << "in the frame of the plane's body";
  EXPECT_NEAR(contacts[0].point0.z, 0.0f, 1e-5f);
}

TEST(RigidContacts, PairsThatAreNotCoveredAreNamed) {
  ModelBuilder builder;
  builder.add_body();
  builder.add_shape_cone(0);
  builder.add_shape_plane();
  EXPECT_ERROR(CollisionPipeline(builder.finalize(Device::cpu())), ErrorKind::NotImplemented,
               "shape 1: expected an infinite plane");
  builder.add_shape_collision_filter_pair(0, 1);
  builder.add_body({.is_kinematic = true});
  builder.add_shape_plane({.width = 0.0f, .length = 0.0f, .body = 1});
  EXPECT_ERROR(CollisionPipeline(builder.finalize(Device::cpu())), ErrorKind::NotImplemented,
               "shapes 1 (PLANE) and 2 (PLANE)");
}

TEST(RigidContacts, ABodyThatIsNotThereIsNamed) {
  for (const BroadPhase phase : {BroadPhase::Explicit, BroadPhase::NxN, BroadPhase::Sap}) {
    ModelBuilder builder;
    builder.add_ground_plane({});
    builder.add_body({.xform = at(0.0f, 0.0f, 0.5f)});
    builder.add_shape_sphere(0, {.radius = 0.5f});
    const auto model = builder.finalize(Device::cpu());
    CollisionPipeline pipeline(model, {.broad_phase = phase});
    Contacts contacts = pipeline.contacts();
    model->shape_body.copy_from_host(std::vector<int32_t>{-1, 2000000});
    try {
      pipeline.collide(model->state(), contacts);
      FAIL() << "expected an error";
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Index);
      EXPECT_NE(
          std::string(error.what()).find("model.shape_body[1]: expected -1 to 0, got 2000000"),
          std::string::npos)
          << error.what();
    }
  }
}

TEST(RigidContacts, ABoxOnABoxTouchesInTheCornersOfTheSmaller) {
  ModelBuilder builder;
  builder.add_body({.xform = at(0.0f, 0.0f, 0.5f)});
  builder.add_shape_box(0, {.cfg = ShapeConfig{.margin = 0.01f}});
  builder.add_body({.xform = at(0.1f, 0.0f, 1.19f)});
  builder.add_shape_box(1, {.hx = 0.2f, .hy = 0.2f, .hz = 0.2f});
  const auto contacts = rows(builder.finalize(Device::cpu()));
  ASSERT_EQ(contacts.size(), 4u);
  for (const RigidContact& c : contacts) {
    EXPECT_EQ(c.shape0, 0);
    EXPECT_NEAR(c.normal.z, 1.0f, 1e-6f);
    EXPECT_NEAR(c.point0.z, 0.5f, 1e-6f) << "on the upper face of the first, in its frame";
    EXPECT_NEAR(std::abs(c.point1.x), 0.2f, 1e-6f);
    EXPECT_NEAR(std::abs(c.point1.y), 0.2f, 1e-6f);
    EXPECT_NEAR(c.point1.z, -0.2f, 1e-6f);
    EXPECT_EQ(c.margin0, 0.01f);
  }
}

TEST(RigidContacts, APairHasAsManyRowsAsAskedFor) {
  ModelBuilder builder;
  const float s = std::sin(0.3f), c = std::cos(0.3f);
  builder.add_body({.xform = at(0.0f, 0.0f, 0.5f)});
  builder.add_shape_box(0);
  builder.add_body({.xform = {{0.0f, 0.0f, 1.49f}, {0.0f, 0.0f, s, c}}});
  builder.add_shape_box(1);
  const auto model = builder.finalize(Device::cpu());
  EXPECT_EQ(rows(model).size(), 8u);
  const auto four = rows(model, {.contacts_per_pair = 4});
  EXPECT_EQ(four.size(), 4u);
  EXPECT_EQ(CollisionPipeline(model, {.contacts_per_pair = 4}).rigid_contact_max(), 4);
  EXPECT_ERROR(CollisionPipeline(model, {.contacts_per_pair = 5}), ErrorKind::Value,
               "contacts_per_pair");
}

TEST(RigidContacts, EveryPairOfTypesTouchesAlongTheLineOfCenters) {
  const GeoType types[] = {GeoType::SPHERE,   GeoType::CAPSULE, GeoType::ELLIPSOID,
                           GeoType::CYLINDER, GeoType::BOX,     GeoType::CONE};
  for (const GeoType a : types)
    for (const GeoType b : types) {
      ModelBuilder builder;
      const auto add = [&](GeoType type, float x) {
        const int32_t body = builder.add_body({.xform = at(x, 0.0f, 0.0f)});
        const Vec3f scale = {0.5f, 0.5f, 0.5f};
        builder.add_shape({.body = body, .type = type, .scale = scale});
        // A cone is narrower halfway up.
        return type == GeoType::CONE ? 0.25f : 0.5f;
      };
      const float reach = add(a, 0.0f) + add(b, 0.95f);
      const auto contacts = rows(builder.finalize(Device::cpu()));
      ASSERT_GE(contacts.size(), 1u) << geo_type_name(a) << geo_type_name(b);
      float deepest = 1.0f;
      for (const RigidContact& c : contacts) {
        const float sign = c.shape0 == 0 ? 1.0f : -1.0f;
        EXPECT_GT(sign * c.normal.x, 0.5f) << geo_type_name(a) << " " << geo_type_name(b);
        const float x0 = c.shape0 == 0 ? 0.0f : 0.95f, x1 = c.shape1 == 0 ? 0.0f : 0.95f;
        const Vec3f p0 = c.point0 + Vec3f{x0, 0.0f, 0.0f}, p1 = c.point1 + Vec3f{x1, 0.0f, 0.0f};
        deepest = std::min(deepest, math::dot(p1 - p0, c.normal) - c.margin0 - c.margin1);
      }
      if (a != GeoType::CONE && b != GeoType::CONE) {
        EXPECT_NEAR(deepest, 0.95f - reach, 1e-4f) << geo_type_name(a) << geo_type_name(b);
      }
    }
}

}  // namespace
}  // namespace novaphy
