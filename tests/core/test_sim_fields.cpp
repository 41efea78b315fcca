#include <gtest/gtest.h>

#include <set>
#include <string>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model_builder.h"
#include "support/bits.h"

namespace novaphy {
namespace {

std::shared_ptr<Model> two_particles() {
  ModelBuilder builder;
  builder.add_particle({1.0f, 2.0f, 3.0f}, {4.0f, 5.0f, 6.0f}, 2.0f);
  builder.add_particle({-1.0f, 0.5f, 0.25f}, {0.0f, -0.0f, 1.0f}, 0.0f, 0.25f, 0);
  builder.add_ground_plane();
  return builder.finalize(Device::cpu());
}

template <class Object>
void expect_documented_unique_fields() {
  std::set<std::string_view> names;
  for (const FieldInfo& info : field_infos<Object>()) {
    EXPECT_TRUE(names.insert(info.name).second) << info.name;
    EXPECT_FALSE(info.doc.empty()) << info.name;
    EXPECT_FALSE(info.count_name.empty()) << info.name;
    const bool is_float = dtype_info(info.dtype).scalar == Scalar::F32;
    EXPECT_EQ(!info.unit.empty(), is_float) << info.name << " has unit " << info.unit;
  }
  EXPECT_FALSE(names.empty());
}

TEST(SimFields, EveryFieldHasAUniqueNameAndADocumentation) {
  expect_documented_unique_fields<Model>();
  expect_documented_unique_fields<SimState>();
  expect_documented_unique_fields<Control>();
  expect_documented_unique_fields<Contacts>();
}

TEST(SimFields, TheWalkGivesTheMembersInOrder) {
  const auto model = two_particles();
  SimState state = model->state();
  std::vector<std::string> names;
  for_each_field(state, [&](const FieldInfo& info, auto& array) {
    names.emplace_back(info.name);
    EXPECT_EQ(info.dtype, array.dtype());
    if (info.name == "particle_q") {
      EXPECT_EQ(static_cast<const Array*>(&array), static_cast<const Array*>(&state.particle_q));
    }
  });
  const std::vector<std::string> expected = {"particle_q", "particle_qd", "particle_f", "body_q",
                                             "body_qd",    "body_f",      "body_sleep", "joint_q",
                                             "joint_qd",   "act"};
  EXPECT_EQ(names, expected);
}

TEST(SimFields, ArraysOfNothingExistWithNoRows) {
  const auto model = two_particles();
  const SimState state = model->state();
  const Control control = model->control();
  for_each_field(state, [](const FieldInfo& info, const Array& array) {
    EXPECT_EQ(array.rows(), info.count_name == "particle_count" ? 2u : 0u) << info.name;
    EXPECT_TRUE(array.device().is_cpu());
  });
  for_each_field(control, [](const FieldInfo& info, const Array& array) {
    EXPECT_EQ(array.rows(), 0u) << info.name;
  });
  EXPECT_EQ(state.particle_count(), 2);
  EXPECT_EQ(state.body_count(), 0);
  EXPECT_EQ(state.joint_coord_count(), 0);
}

TEST(SimState, StartsFromTheModelAndIsACopy) {
  const auto model = two_particles();
  SimState state = model->state();
  EXPECT_EQ(state.particle_q.to_host(), model->particle_q.to_host());
  EXPECT_EQ(state.particle_qd.to_host(), model->particle_qd.to_host());
  EXPECT_EQ(state.particle_f.to_host(), std::vector<Vec3f>(2));
  state.particle_q.fill({9.0f, 9.0f, 9.0f});
  EXPECT_EQ(model->particle_q.to_host()[0], (Vec3f{1.0f, 2.0f, 3.0f}));
  EXPECT_FALSE(state.requires_grad);
  EXPECT_TRUE(model->state(true).requires_grad);
}

TEST(SimState, CloneAndAssignCopyValues) {
  const auto model = two_particles();
  SimState a = model->state();
  a.particle_f.fill({1.0f, 2.0f, 3.0f});
  SimState b = a.clone();
  EXPECT_EQ(b.particle_f.to_host(), a.particle_f.to_host());
  EXPECT_EQ(b.model_id(), model->id());
  b.particle_q.fill({});
  EXPECT_NE(b.particle_q.to_host(), a.particle_q.to_host());
  a.assign(b);
  EXPECT_EQ(b.particle_q.to_host(), a.particle_q.to_host());
  a.clear_forces();
  EXPECT_EQ(a.particle_f.to_host(), std::vector<Vec3f>(2));
  EXPECT_EQ(b.particle_f.to_host()[1], (Vec3f{1.0f, 2.0f, 3.0f}));
}

TEST(SimState, AssignRefusesOtherSizesAndCopiesNothing) {
  const auto model = two_particles();
  ModelBuilder other;
  other.add_particle({}, {}, 1.0f);
  const auto one = other.finalize(Device::cpu());
  SimState a = model->state();
  const SimState b = one->state();
  const auto before = a.particle_q.to_host();
  EXPECT_ERROR(a.assign(b), ErrorKind::Value, "particle_q: expected 2 rows, got 1");
  EXPECT_EQ(a.particle_q.to_host(), before);
}

TEST(SimState, AModelThatIsRestoredFitsTheStatesOfTheOneThatWasKept) {
  const auto kept = two_particles();
  const auto restored = Model::restore(kept->counts(), kept->device(), kept->up_axis(), kept->id());
  EXPECT_EQ(restored->id(), kept->id());
  EXPECT_EQ(restored->counts(), kept->counts());
  for_each_field(*restored, [](const FieldInfo& info, const Array& array) {
    EXPECT_TRUE(array.range() != nullptr || array.rows() == 0) << info.name;
  });
  EXPECT_EQ(restored->particle_q.rows(), 2u);
  EXPECT_TRUE(restored->particle_q.to_host()[0] == Vec3f{});
  const SimState state(kept->counts(), kept->device(), kept->id());
  EXPECT_EQ(state.model_id(), restored->id());
  EXPECT_EQ(state.particle_qd.rows(), 2u);
  EXPECT_NE(two_particles()->id(), kept->id());
  EXPECT_NE(kept->clone()->id(), kept->id());
}

TEST(SimState, CanLieInALongerAllocation) {
  const auto model = two_particles();
  constexpr size_t kStates = 3, kBytes = 2 * sizeof(Vec3f);
  const auto storage = Storage::allocate(kStates * kBytes, Device::cpu());
  StateFields fields;
  fields.allocate(model->counts(), Device::cpu());
  fields.particle_q = DeviceArray<Vec3f>(Array(DType::vec3, 2, 1, storage->range(kBytes, kBytes)));
  SimState state(*model, fields);
  state.particle_q.fill({1.0f, 2.0f, 3.0f});
  const DeviceArray<Vec3f> all(Array(DType::vec3, 2 * kStates, 1, storage->range()));
  const auto values = all.to_host();
  EXPECT_EQ(values[1], (Vec3f{}));
  EXPECT_EQ(values[2], (Vec3f{1.0f, 2.0f, 3.0f}));
  EXPECT_EQ(values[3], (Vec3f{1.0f, 2.0f, 3.0f}));
  EXPECT_EQ(values[4], (Vec3f{}));

  fields.particle_qd = DeviceArray<Vec3f>(3, Device::cpu());
  EXPECT_ERROR(SimState(*model, fields), ErrorKind::Value,
               "particle_qd: expected 2 rows (particle_count)");
}

TEST(Contacts, StartEmptyAndClearRaisesTheGeneration) {
  Contacts contacts({.soft_contact_max = 3, .soft_contact_pair_count = 4}, Device::cpu());
  EXPECT_EQ(contacts.soft_contact_particle.to_host(), std::vector<int32_t>(3, -1));
  EXPECT_EQ(contacts.soft_contact_tids.to_host(), std::vector<int32_t>(4, -1));
  EXPECT_TRUE(contacts.soft_contacts().empty());
  EXPECT_FALSE(contacts.overflowed());
  contacts.soft_contact_count.fill(5);
  EXPECT_TRUE(contacts.overflowed());
  EXPECT_EQ(contacts.active_soft_contact_count(), 3);
  EXPECT_EQ(contacts.soft_contacts().size(), 3u);
  contacts.clear();
  EXPECT_FALSE(contacts.overflowed());
  EXPECT_EQ(contacts.contact_generation.to_host()[0], 1);
}

TEST(Contacts, RefuseNegativeCounts) {
  EXPECT_ERROR(Contacts({.soft_contact_max = -1}), ErrorKind::Value,
               "soft_contact_max: expected >= 0, got -1");
  EXPECT_ERROR(Contacts({.soft_contact_pair_count = -2}), ErrorKind::Value,
               "pair_count: expected >= 0, got -2");
}

TEST(Contacts, CloneAndAssignCopyValues) {
  Contacts a({.soft_contact_max = 2}, Device::cpu());
  a.soft_contact_count.fill(1);
  a.soft_contact_particle.fill(7);
  const Contacts b = a.clone();
  EXPECT_EQ(b.soft_contacts(), a.soft_contacts());
  a.clear();
  EXPECT_EQ(b.soft_contacts()[0].particle, 7);
  a.assign(b);
  EXPECT_EQ(a.soft_contacts(), b.soft_contacts());
  Contacts small({.soft_contact_max = 1}, Device::cpu());
  EXPECT_ERROR(small.assign(a), ErrorKind::Value, "soft_contact_particle: expected 1 rows, got 2");
}

}  // namespace
}  // namespace novaphy
