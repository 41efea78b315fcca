// Derived arrays of a model follow their source arrays. The derived values are checked.
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <thread>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"

namespace novaphy {
namespace {

std::shared_ptr<Model> make_model() {
  ModelBuilder builder;
  for (const float mass : {2.0f, 0.0f, 0.5f}) builder.add_particle({}, {}, mass);
  return builder.finalize(Device::cpu());
}
using Values = std::vector<float>;
const Values kMasses = {4.0f, 0.25f, 0.0f}, kInverses = {0.25f, 4.0f, 0.0f};

TEST(DerivedFields, AreThereFromTheStart) {
  EXPECT_EQ(make_model()->particle_inv_mass.to_host(), (Values{0.5f, 0.0f, 2.0f}));
}

TEST(DerivedFields, FollowTheirSource) {
  const auto model = make_model();
  model->particle_mass.copy_from_host(std::span<const float>(kMasses));
  model->update_derived();
  EXPECT_EQ(model->particle_inv_mass.to_host(), kInverses);
  // A write through a view of a part counts too.
  DeviceArray<float> last(
      Array(DType::float32, 1, 1, model->particle_mass.range()->storage().range(8, 4)));
  last.fill(8.0f);
  model->update_derived();
  EXPECT_EQ(model->particle_inv_mass.to_host()[2], 0.125f);
}

TEST(DerivedFields, WhatIsAssignedToThemStaysUntilTheSourceIsWritten) {
  const auto model = make_model();
  model->particle_inv_mass.fill(7.0f);
  model->update_derived();
  EXPECT_EQ(model->particle_inv_mass.to_host(), (Values{7.0f, 7.0f, 7.0f}));
  model->particle_mass.copy_from_host(std::span<const float>(kMasses));
  model->update_derived();
  EXPECT_EQ(model->particle_inv_mass.to_host(), kInverses);
}

TEST(DerivedFields, FollowASourceThatSomebodyOutsideWrites) {
  const auto model = make_model();
  auto* const seen = static_cast<float*>(model->particle_mass.range()->data());
  model->particle_mass.range()->mark_writable_export();
  model->particle_inv_mass.fill(7.0f);
  model->update_derived();
  EXPECT_EQ(model->particle_inv_mass.to_host()[0], 7.0f) << "nothing was written";
  seen[0] = 4.0f;
  model->update_derived();
  EXPECT_EQ(model->particle_inv_mass.to_host()[0], 0.25f);
}

TEST(DerivedFields, ACopyOfAModelKeepsWhatIsUpToDateAndWhatIsNot) {
  const auto model = make_model();
  model->particle_inv_mass.fill(7.0f);
  const auto copy = model->clone();
  copy->update_derived();
  EXPECT_EQ(copy->particle_inv_mass.to_host()[0], 7.0f);
  model->particle_mass.copy_from_host(std::span<const float>(kMasses));
  const auto later = model->clone();
  later->update_derived();
  EXPECT_EQ(later->particle_inv_mass.to_host(), kInverses);
}

TEST(DerivedFields, SeveralThreadsMayAskAtOnce) {
  const auto model = make_model();
  for (int round = 1; round < 200; ++round) {
    model->particle_mass.fill(static_cast<float>(round));
    std::vector<Values> seen(4);
    std::vector<std::thread> threads;
    for (Values& values : seen)
      threads.emplace_back([&] {
        model->update_derived();
        values = model->particle_inv_mass.to_host();
      });
    for (std::thread& thread : threads) thread.join();
    for (const Values& values : seen)
      ASSERT_EQ(values, Values(3, 1.0f / static_cast<float>(round)));
  }
}

TEST(ModelNumbers, AreCheckedByName) {
  const float nan = std::numeric_limits<float>::quiet_NaN(),
              infinity = std::numeric_limits<float>::infinity();
  const auto refused = [](const auto& edit) {
    const auto model = make_model();
    edit(*model);
    try {
      model->check_numbers("step");
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Value);
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  EXPECT_EQ(refused([](Model&) {}), "accepted");
  EXPECT_EQ(refused([&](Model& m) { m.particle_max_velocity = infinity; }), "accepted");
  EXPECT_EQ(refused([&](Model& m) { m.soft_contact_ke = nan; }),
            "step: model.soft_contact_ke: expected a finite number >= 0, got nan");
  EXPECT_EQ(refused([&](Model& m) { m.soft_contact_mu = -3.0f; }),
            "step: model.soft_contact_mu: expected a finite number >= 0, got -3");
  EXPECT_EQ(refused([&](Model& m) { m.particle_adhesion = infinity; }),
            "step: model.particle_adhesion: expected a finite number >= 0, got inf");
  EXPECT_EQ(refused([&](Model& m) { m.particle_max_velocity = -1.0f; }),
            "step: model.particle_max_velocity: expected a number >= 0, got -1");
}

}  // namespace
}  // namespace novaphy
