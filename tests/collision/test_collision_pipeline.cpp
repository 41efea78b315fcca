#include <gtest/gtest.h>

#include <limits>
#include <random>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/parallel.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/model_builder.h"
#include "support/bits.h"

namespace novaphy {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

std::shared_ptr<Model> random_scene(int particles) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> uniform(-2.0f, 2.0f);
  ModelBuilder builder;
  for (int i = 0; i < particles; ++i) {
    builder.add_particle({uniform(random), uniform(random), uniform(random)}, {}, 1.0f, {},
                         i % 7 == 3 ? 0 : 1);
  }
  builder.add_ground_plane();
  builder.add_shape_box(-1, {.xform = {{1.0f, 0.0f, 0.5f}, Quatf::identity()}});
  builder.add_shape_sphere(-1, {.cfg = ShapeConfig{.has_particle_collision = false}});
  builder.add_shape_capsule(
      -1, {.xform = {{-1.0f, 0.5f, 0.0f}, {0.5f, 0.5f, 0.5f, 0.5f}}, .radius = 0.5f});
  builder.add_shape_plane({.plane = {0.2f, 0.9f, 0.1f, 0.5f}, .width = 2.0f, .length = 3.0f});
  return builder.finalize(Device::cpu());
}

std::vector<SoftContact> collide(CollisionPipeline& pipeline, const SimState& state) {
  Contacts contacts = pipeline.contacts();
  pipeline.collide(state, contacts);
  return contacts.soft_contacts();
}

TEST(CollisionPipeline, OrdersContactsByShapeThenParticle) {
  const auto model = random_scene(1000);
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.3f});
  EXPECT_EQ(pipeline.soft_contact_pair_count(),
            4000);  // one of the five shapes lets particles through
  EXPECT_EQ(pipeline.soft_contact_max(), 4000);
  Contacts contacts = pipeline.contacts();
  const SimState state = model->state();
  pipeline.collide(state, contacts);
  const auto found = contacts.soft_contacts();
  ASSERT_GT(found.size(), 500u);
  ASSERT_LT(found.size(), 3500u);
  EXPECT_EQ(contacts.soft_contact_count.to_host()[0], static_cast<int32_t>(found.size()));
  for (size_t i = 0; i < found.size(); ++i) {
    EXPECT_NE(found[i].shape, 2);
    EXPECT_NE(found[i].particle % 7, 3);  // not active
    if (i == 0) continue;
    EXPECT_LT(std::pair(found[i - 1].shape, found[i - 1].particle),
              std::pair(found[i].shape, found[i].particle));
  }
  // tids has the slot of every candidate. The candidate shapes are 0, 1, 3, 4.
  const auto tids = contacts.soft_contact_tids.to_host();
  const std::vector<int32_t> shapes = {0, 1, 3, 4};
  size_t used = 0;
  for (size_t pair = 0; pair < tids.size(); ++pair) {
    if (tids[pair] < 0) continue;
    ++used;
    const SoftContact& contact = found[static_cast<size_t>(tids[pair])];
    EXPECT_EQ(contact.shape, shapes[pair / 1000]);
    EXPECT_EQ(contact.particle, static_cast<int32_t>(pair % 1000));
  }
  EXPECT_EQ(used, found.size());
}

TEST(CollisionPipeline, GivesTheSameContactsForAnyNumberOfThreads) {
  const auto model = random_scene(5000);
  const SimState state = model->state();
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.2f});
  const int before = num_threads();
  set_num_threads(1);
  const auto expected = collide(pipeline, state);
  for (const int threads : {2, 7}) {
    set_num_threads(threads);
    EXPECT_EQ(collide(pipeline, state), expected) << threads;
  }
  set_num_threads(before);
}

TEST(CollisionPipeline, BothBroadPhasesGiveTheSameSoftContacts) {
  const auto model = random_scene(500);
  const SimState state = model->state();
  CollisionPipeline a(model), b(model, {.broad_phase = BroadPhase::NxN});
  EXPECT_EQ(collide(a, state), collide(b, state));
}

TEST(CollisionPipeline, NeverOverflowsSilently) {
  const auto model = random_scene(1000);
  const SimState state = model->state();
  CollisionPipeline all(model, {.soft_contact_margin = 0.3f});
  const auto expected = collide(all, state);
  CollisionPipeline few(model, {.soft_contact_max = 10, .soft_contact_margin = 0.3f});
  Contacts contacts = few.contacts();
  few.collide(state, contacts);
  EXPECT_TRUE(contacts.overflowed());
  EXPECT_EQ(contacts.soft_contact_count.to_host()[0], static_cast<int32_t>(expected.size()));
  const auto kept = contacts.soft_contacts();
  ASSERT_EQ(kept.size(), 10u);
  for (size_t i = 0; i < kept.size(); ++i) EXPECT_EQ(kept[i], expected[i]);
  for (const int32_t slot : contacts.soft_contact_tids.to_host()) EXPECT_LT(slot, 10);

  CollisionPipeline none(model, {.soft_contact_max = 0});
  Contacts empty = none.contacts();
  none.collide(state, empty);
  EXPECT_TRUE(empty.overflowed());
  EXPECT_TRUE(empty.soft_contacts().empty());
}

TEST(CollisionPipeline, ClearsWhatTheLastCollideLeft) {
  ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 0.05f}, {}, 1.0f);
  builder.add_particle({0.0f, 0.0f, 0.05f}, {}, 1.0f);
  builder.add_ground_plane();
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model);
  SimState state = model->state();
  Contacts contacts = pipeline.contacts();
  pipeline.collide(state, contacts);
  EXPECT_EQ(contacts.soft_contacts().size(), 2u);
  state.particle_q.copy_from_host(std::vector<Vec3f>{{0.0f, 0.0f, 5.0f}, {0.0f, 0.0f, 0.05f}});
  pipeline.collide(state, contacts);
  EXPECT_EQ(contacts.soft_contact_particle.to_host(), (std::vector<int32_t>{1, -1}));
  EXPECT_EQ(contacts.soft_contact_shape.to_host(), (std::vector<int32_t>{0, -1}));
  EXPECT_EQ(contacts.soft_contact_tids.to_host(), (std::vector<int32_t>{-1, 0}));
  EXPECT_EQ(contacts.soft_contact_normal.to_host()[1], (Vec3f{}));
  EXPECT_EQ(contacts.contact_generation.to_host()[0], 2);
  EXPECT_FALSE(contacts.overflowed());
}

TEST(CollisionPipeline, DetectsUpToGapMarginAndRadiusStrictly) {
  ModelBuilder builder;
  for (const float z : {0.9375f, 0.93749994f})
    builder.add_particle({0.0f, 0.0f, z}, {}, 1.0f, 0.125f);
  builder.add_ground_plane({.cfg = ShapeConfig{.margin = 0.3125f}});
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.5f});
  const auto found = collide(pipeline, model->state());
  ASSERT_EQ(found.size(), 1u);
  EXPECT_EQ(found[0].particle, 1);
  // The margin moves neither the point nor the normal.
  EXPECT_EQ(found[0].body_pos, (Vec3f{}));
  EXPECT_EQ(found[0].normal, (Vec3f{0.0f, 0.0f, 1.0f}));

  Contacts contacts = pipeline.contacts();
  pipeline.collide(model->state(), contacts, 0.6f);
  EXPECT_EQ(contacts.soft_contacts().size(), 2u);
}

TEST(CollisionPipeline, KeepsWorldsApart) {
  ModelBuilder builder;
  for (int i = 0; i < 3; ++i) builder.add_particle({}, {}, 1.0f);
  builder.add_ground_plane();
  for (int world = 0; world < 2; ++world) {
    builder.begin_world();
    builder.end_world();
  }
  const auto model = builder.finalize(Device::cpu());
  model->particle_world.copy_from_host(std::vector<int32_t>{0, 1, -1});
  CollisionPipeline pipeline(model);
  EXPECT_EQ(collide(pipeline, model->state()).size(), 3u);
  model->shape_world.fill(1);
  const auto found = collide(pipeline, model->state());
  ASSERT_EQ(found.size(), 2u);
  EXPECT_EQ(found[0].particle, 1);
  EXPECT_EQ(found[1].particle, 2);
}

TEST(CollisionPipeline, FollowsEditedShapeFlagsOrSaysSo) {
  const auto model = random_scene(10);
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  model->shape_flags.fill(7);
  const SimState state = model->state();
  EXPECT_ERROR(pipeline.collide(state, contacts), ErrorKind::Value,
               "expected 50 candidate pairs, got 40");
  Contacts fresh = pipeline.contacts();
  EXPECT_NO_THROW(pipeline.collide(state, fresh));
}

TEST(CollisionPipeline, HandlesNothing) {
  const auto empty = ModelBuilder().finalize(Device::cpu());
  CollisionPipeline pipeline(empty);
  EXPECT_TRUE(collide(pipeline, empty->state()).empty());
  ModelBuilder builder;
  builder.add_ground_plane();
  const auto shapes_only = builder.finalize(Device::cpu());
  CollisionPipeline other(shapes_only);
  EXPECT_TRUE(collide(other, shapes_only->state()).empty());
}

TEST(CollisionPipeline, RefusesBadOptions) {
  const auto model = random_scene(1);
  EXPECT_ERROR(CollisionPipeline(nullptr), ErrorKind::Value, "model: expected a model, got null");
  EXPECT_ERROR(CollisionPipeline(model, {.broad_phase = static_cast<BroadPhase>(7)}),
               ErrorKind::Value, "broad_phase");
  EXPECT_ERROR(CollisionPipeline(model, {.soft_contact_max = -1}), ErrorKind::Value,
               "soft_contact_max: expected >= 0");
  EXPECT_ERROR(CollisionPipeline(model, {.rigid_contact_max = -8}), ErrorKind::Value,
               "rigid_contact_max");
  for (const float margin : {kNan, std::numeric_limits<float>::infinity(), -0.1f}) {
    EXPECT_ERROR(CollisionPipeline(model, {.soft_contact_margin = margin}), ErrorKind::Value,
                 "soft_contact_margin: expected a finite number >= 0");
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    EXPECT_ERROR(pipeline.collide(model->state(), contacts, margin), ErrorKind::Value,
                 "soft_contact_margin");
  }
  EXPECT_EQ(parse_broad_phase("nxn"), BroadPhase::NxN);
  EXPECT_ERROR(parse_broad_phase("bvh"), ErrorKind::Value, "got \"bvh\"");
}

TEST(CollisionPipeline, RefusesStatesAndContactsOfAnotherModel) {
  const auto model = random_scene(3), other = random_scene(3);
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  Contacts foreign = CollisionPipeline(other).contacts();
  Contacts loose({.soft_contact_max = 12, .soft_contact_pair_count = 12}, Device::cpu());
  const SimState state = model->state();
  EXPECT_ERROR(pipeline.collide(other->state(), contacts), ErrorKind::Value,
               "state: expected a state of the pipeline's");
  EXPECT_ERROR(pipeline.collide(state, foreign), ErrorKind::Value,
               "contacts: expected contacts of the pipeline's");
  EXPECT_ERROR(pipeline.collide(state, loose), ErrorKind::Value,
               "contacts: expected contacts of the pipeline's");
  SimState cut = model->state();
  cut.particle_q = DeviceArray<Vec3f>(2, Device::cpu());
  EXPECT_ERROR(pipeline.collide(cut, contacts), ErrorKind::Value, "particle_q: expected 3 rows");
  contacts.soft_contact_normal = DeviceArray<Vec3f>(1, Device::cpu());
  EXPECT_ERROR(pipeline.collide(state, contacts), ErrorKind::Value,
               "soft_contact_normal: expected 12 rows");
}

TEST(CollisionPipeline, RefusesShapesThatItDoesNotCover) {
  const auto model = random_scene(3);
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  const SimState state = model->state();
  std::vector<int32_t> body(5, -1);
  body[1] = 0;
  model->shape_body.copy_from_host(body);
  EXPECT_ERROR(pipeline.collide(state, contacts), ErrorKind::Index,
               "model.shape_body[1]: expected -1 to -1, got 0");
  model->shape_body.fill(-1);
  std::vector<int32_t> type = model->shape_type.to_host();
  type[2] = static_cast<int32_t>(GeoType::HFIELD);  // lets particles through: nothing to cover
  model->shape_type.copy_from_host(type);
  EXPECT_NO_THROW(pipeline.collide(state, contacts));
  type[3] = static_cast<int32_t>(GeoType::HFIELD);
  model->shape_type.copy_from_host(type);
  EXPECT_ERROR(pipeline.collide(state, contacts), ErrorKind::NotImplemented,
               "shape 3 has type HFIELD");
}

// Starts a second search during the first one, as another thread would.
class AsksAgain : public LaunchRecorder {
 public:
  AsksAgain(CollisionPipeline& pipeline, const SimState& state, Contacts& contacts)
      : pipeline_(pipeline),
        state_(state),
        contacts_(contacts),
        before_(set_launch_recorder(this)) {}
  ~AsksAgain() override { set_launch_recorder(before_); }
  void launch(const Launch&) override { pipeline_.collide(state_, contacts_); }
  bool has_tape() const override { return false; }
  void depends_on(const std::shared_ptr<Range>&) override {}
  void depends_on(const std::shared_ptr<const float>&, std::string_view) override {}
  void before_replay(const std::shared_ptr<const void>&, const std::function<void()>&) override {}
  void uses(const std::shared_ptr<ExclusiveUse>& memory) override { memory_ = memory; }
  const std::shared_ptr<ExclusiveUse>& memory() const { return memory_; }

 private:
  CollisionPipeline& pipeline_;
  const SimState& state_;
  Contacts& contacts_;
  LaunchRecorder* before_;
  std::shared_ptr<ExclusiveUse> memory_;
};

TEST(CollisionPipeline, ASecondCallAtTheSameTimeIsRefused) {
  ModelBuilder builder;
  builder.add_particle({0.0f, 0.0f, 0.05f}, {}, 1.0f);
  builder.add_ground_plane();
  const auto model = builder.finalize(Device::cpu());
  CollisionPipeline pipeline(model);
  const SimState state = model->state();
  Contacts contacts = pipeline.contacts();
  std::shared_ptr<ExclusiveUse> memory;
  {
    const AsksAgain recorder(pipeline, state, contacts);
    try {
      pipeline.collide(state, contacts);
      FAIL();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Runtime);
      EXPECT_STREQ(error.what(),
                   "collide: the pipeline is in use by another call; give every thread one of its "
                   "own");
    }
    memory = recorder.memory();
  }
  ASSERT_NE(memory, nullptr) << "a replay must take it too";
  {
    const ExclusiveUse::Scope replay(*memory, "graph.launch()", "the pipeline");
    EXPECT_THROW(pipeline.collide(state, contacts), Error);
    EXPECT_THROW(pipeline.soft_contact_pair_count(), Error);
  }
  pipeline.collide(state, contacts);
  EXPECT_EQ(contacts.soft_contact_count.to_host()[0], 1);
}

}  // namespace
}  // namespace novaphy
