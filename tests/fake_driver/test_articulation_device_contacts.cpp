// Articulations with contacts and dry friction on a CUDA device: collide and step have the bits of
// the CPU, direct and replayed. On a GPU, or on the fake driver (CMakeLists.txt).
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <vector>

#include "articulation_contact_scenes.h"
#include "articulation_devices.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/nova/op_list.h"

namespace novaphy {
namespace {

using testing::add;
using testing::bytes;
using testing::expect_same;
using testing::expect_thrown;
using testing::Result;

using namespace testing::contact_scenes;

struct Steps {
  FeatherstoneOptions options = {};
  CollisionOptions search = {};
  int pairs = 20;
  bool captured = false, contacts = true;
};
// Returns states, forces and counts of the sweeps after pairs of collide and step. `found`: the
// most contacts.
Result stepped(const ModelBuilder& builder, Device device, const Steps& how,
               int32_t* found = nullptr) {
  const auto model = builder.finalize(device);
  SolverFeatherstone solver(model, how.options);
  CollisionPipeline pipeline(model, how.search);
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  eval_fk(*model, a.joint_q, a.joint_qd, a);
  const auto one = [&](SimState& from, SimState& to) {
    if (how.contacts) pipeline.collide(from, contacts);
    solver.step(from, to, nullptr, how.contacts ? &contacts : nullptr, kDt);
  };
  const auto pair = [&] {
    one(a, b);
    one(b, a);
  };
  const std::function<void()> run = testing::replayed_if(how.captured, pair);
  Result result;
  for (int k = 0; k < how.pairs; ++k) {
    run();
    const int32_t count = contacts.rigid_contact_count.to_host()[0];
    if (found != nullptr) *found = std::max(*found, count);
    if (k % 4 != 3 && k + 1 != how.pairs) continue;
    const std::string when = "pair " + std::to_string(k);
    add(result, a, when);
    add(result, b, when + ", first");
    result.emplace_back(when + " count", bytes(std::vector<int32_t>{count}));
    result.emplace_back(when + " force", bytes(contacts.rigid_contact_force.to_host()));
    result.emplace_back(when + " sweeps", bytes(std::vector<int32_t>{solver.pgs_sweeps()}));
    result.emplace_back(when + " residual", bytes(std::vector<float>{solver.pgs_residual()}));
  }
  solver.check_last_step();
  return result;
}

void expect_bits_of_the_cpu(const ModelBuilder& builder, Steps how, int32_t fewest) {
  int32_t found = 0;
  const Result expected = stepped(builder, Device::cpu(), how, &found);
  EXPECT_GE(found, fewest);
  expect_same(stepped(builder, Device::cuda(), how), expected, ", direct");
  how.captured = true;
  expect_same(stepped(builder, Device::cuda(), how), expected, ", replayed");
}

class ArticulationContactDevices : public ArticulationDevices {};

TEST_F(ArticulationContactDevices, BoxesOnAPlaneHaveTheBitsOfTheCpu) {
  expect_bits_of_the_cpu(boxes(), {.pairs = 8}, 16);
}
TEST_F(ArticulationContactDevices, AStackHasTheBitsOfTheCpu) {
  expect_bits_of_the_cpu(stack(), {.pairs = 8}, 18);
}
TEST_F(ArticulationContactDevices, AWalkerHasTheBitsOfTheCpu) {
  expect_bits_of_the_cpu(walker(), {.pairs = 12}, 4);
}
TEST_F(ArticulationContactDevices, TreesAndFreeBodiesInOneIslandHaveTheBitsOfTheCpu) {
  expect_bits_of_the_cpu(crowd(), {.pairs = 8}, 20);
}

TEST_F(ArticulationContactDevices, WhatAKinematicBodyCarriesHasTheBitsOfTheCpu) {
  expect_bits_of_the_cpu(turntable(), {.pairs = 12}, 8);
}

TEST_F(ArticulationContactDevices, SnakesOfManyHingesTouchNothingOnDevices) {
  try {
    stepped(snakes(), Device::cuda(), {.pairs = 3});
    FAIL() << "expected an error";
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::NotImplemented);
    EXPECT_NE(std::string(error.what()).find("of more than 9 joints in a row"), std::string::npos)
        << error.what();
  }
}

TEST_F(ArticulationContactDevices, EveryOptionActsAsOnTheCpu) {
  const FeatherstoneOptions all[] = {{.friction_cone = FrictionCone::Pyramid},
                                     {.pgs_iterations = 3},
                                     {.pgs_tolerance = 1e-3f},
                                     {.pgs_erp = 0.8f},
                                     {.pgs_slop = 0.0f},
                                     {.pgs_cfm = 1e-3f},
                                     {.max_depenetration_velocity = 0.01f},
                                     {.restitution_threshold = 0.0f},
                                     {.warm_start = false},
                                     {.compliant_contacts = true}};
  ModelBuilder scene = crowd();
  add_box(scene, {3.0f, 0.0f, 0.1185f}, 0.1f, {.restitution = 0.6f}, {{0.0f, 0.0f, -0.1f}, {}});
  add_box(scene, {4.0f, 0.0f, 0.05f}, 0.1f, kSurface);
  const Result plain = stepped(scene, Device::cpu(), {.pairs = 4});
  for (size_t k = 0; k < std::size(all); ++k) {
    const Steps how = {.options = all[k], .pairs = 4};
    const Result expected = stepped(scene, Device::cpu(), how);
    EXPECT_TRUE(expected != plain) << k;
    expect_same(stepped(scene, Device::cuda(), how), expected, ", option " + std::to_string(k));
  }
}

TEST_F(ArticulationContactDevices, StopsBesideContactsHaveTheBitsOfTheCpu) {
  Steps how = {.options = {.joint_limits = JointLimits::Row, .joint_limit_restitution = 0.5f},
               .pairs = 6};
  EXPECT_TRUE(stepped(kicking(), Device::cpu(), how) !=
              stepped(kicking(), Device::cpu(), {.pairs = 6}));
  expect_bits_of_the_cpu(kicking(), how, 4);
}

// A second model has a body that belongs to all worlds, which makes the worlds one group.
TEST_F(ArticulationContactDevices, SixtyFourWorldsHaveTheBitsOfTheCpu) {
  for (const bool shared : {false, true}) {
    ModelBuilder all, one;
    all.add_ground_plane({.cfg = kSurface});
    add_walker(one, 0.0f, 0.33f, -1, 0.0f);
    add_box(one, {0.5f, 0.0f, 0.12f}, 0.1f, kSurface, {{-0.5f, 0.0f, 0.0f}, {}});
    add_box(one, {0.5f, 0.0f, 0.34f}, 0.1f, kSurface);
    for (int w = 0; w < 64; ++w) {
      all.add_world(one);
      for (size_t k = all.joint_qd.size() - 12; k < all.joint_qd.size(); ++k)
        all.joint_qd[k] += 0.01f * static_cast<float>(w);
    }
    if (shared) add_box(all, {0.5f, 0.1f, 0.6f}, 0.1f, kSurface);
    expect_bits_of_the_cpu(all, {.pairs = 3}, 64 * 8);
  }
}

// A team of threads steps a tree. The threads share the contacts of its sweeps.
TEST_F(ArticulationContactDevices, TreesWithManyContactsHaveTheBitsOfTheCpu) {
  expect_bits_of_the_cpu(slabs(), {.pairs = 20}, 3 * 12);
}

TEST_F(ArticulationContactDevices, DryFrictionActsWithoutContactsToo) {
  Steps how = {.pairs = 20, .contacts = false};
  const ModelBuilder scene = crowd();
  const Result expected = stepped(scene, Device::cpu(), how);
  expect_same(stepped(scene, Device::cuda(), how), expected, ", direct");
  how.captured = true;
  expect_same(stepped(scene, Device::cuda(), how), expected, ", replayed");
}

// Captured steps forget their impulses too.
TEST_F(ArticulationContactDevices, ANotifiedChangeForgetsImpulses) {
  testing::expect_same_bits([](Device device) {
    const auto model = stack().finalize(device);
    SolverFeatherstone solver(model);
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    SimState a = model->state(), b = model->state();
    eval_fk(*model, a.joint_q, a.joint_qd, a);
    const auto pair = [&] {
      for (auto [in, out] : {std::pair(&a, &b), std::pair(&b, &a)}) {
        pipeline.collide(*in, contacts);
        solver.step(*in, *out, nullptr, &contacts, kDt);
      }
    };
    const std::function<void()> run = testing::replayed_if(!device.is_cpu(), pair);
    Result result;
    for (int k = 0; k < 8; ++k) {
      if (k == 5) solver.notify_model_changed(ModelFlags::ALL);
      run();
      add(result, a, "pair " + std::to_string(k));
    }
    return result;
  });
}

// The impulses of the step before are forgotten where one had no contacts, and scale with dt.
TEST_F(ArticulationContactDevices, WarmStartsAreThoseOfTheCpu) {
  testing::expect_same_bits([](Device device) {
    const auto model = stack().finalize(device);
    SolverFeatherstone solver(model);
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    SimState a = model->state(), b = model->state();
    eval_fk(*model, a.joint_q, a.joint_qd, a);
    Result result;
    for (int k = 0; k < 16; ++k) {
      pipeline.collide(a, contacts);
      solver.step(a, b, nullptr, k % 6 == 5 ? nullptr : &contacts, k % 3 == 0 ? kDt : 0.5f * kDt);
      if (k == 9) solver.notify_model_changed(ModelFlags::ALL);
      std::swap(a, b);
      add(result, a, "step " + std::to_string(k));
      result.emplace_back("sweeps", bytes(std::vector<int32_t>{solver.pgs_sweeps()}));
    }
    return result;
  });
}

TEST_F(ArticulationContactDevices, RowsBeyondTheCapacityAreLeftOutAsOnTheCpu) {
  const Steps how = {.search = {.rigid_contact_max = 9}, .pairs = 4};
  expect_bits_of_the_cpu(stack(), how, 10);
}

// A failing articulation fails its island, and nothing else.
TEST_F(ArticulationContactDevices, AnIslandThatFailsIsNaNAndNamedAndTheOthersMove) {
  const ModelBuilder builder = stack();
  const auto run = [&](Device device, bool bad) {
    const auto model = builder.finalize(device);
    SolverFeatherstone solver(model);
    CollisionPipeline pipeline(model);
    Contacts contacts = pipeline.contacts();
    SimState a = model->state(), b = model->state();
    eval_fk(*model, a.joint_q, a.joint_qd, a);
    pipeline.collide(a, contacts);
    if (bad) {
      std::vector<float> qd = a.joint_qd.to_host();
      qd[8] = std::numeric_limits<float>::infinity();  // the second cube
      a.joint_qd.copy_from_host(std::span<const float>(qd));
    }
    solver.step(a, b, nullptr, &contacts, kDt);
    if (bad)
      expect_thrown(ErrorKind::Runtime, "SolverFeatherstone.step: dof ",
                    [&] { solver.check_last_step(); });
    return b.joint_qd.to_host();
  };
  const std::vector<float> good = run(Device::cpu(), false), failed = run(Device::cuda(), true);
  ASSERT_EQ(good.size(), 30u);
  for (size_t k = 0; k < good.size(); ++k)
    EXPECT_TRUE(k < 24 ? std::isnan(failed[k]) : failed[k] == good[k]) << k;
}

TEST_F(ArticulationContactDevices, RowsOfShapesThatAreNotThereAndOfTwoWorldsAreNamed) {
  ModelBuilder all;
  all.add_ground_plane({.cfg = kSurface});
  for (int w = 0; w < 2; ++w) all.add_world(boxes());
  const auto model = all.finalize(Device::cuda());
  SolverFeatherstone solver(model);
  CollisionPipeline pipeline(model);
  SimState a = model->state(), b = model->state();
  eval_fk(*model, a.joint_q, a.joint_qd, a);
  for (const int32_t other : {-1, 1000, model->shape_count() - 1}) {
    Contacts contacts = pipeline.contacts();
    pipeline.collide(a, contacts);
    std::vector<int32_t> shape0 = contacts.rigid_contact_shape0.to_host();
    shape0[3] = other;
    contacts.rigid_contact_shape0.copy_from_host(std::span<const int32_t>(shape0));
    solver.step(a, b, nullptr, &contacts, kDt);
    expect_thrown(ErrorKind::Index, "SolverFeatherstone.step: contacts: row 3: expected two shapes",
                  [&] { solver.check_last_step(); });
  }
  Contacts contacts = pipeline.contacts();
  pipeline.collide(a, contacts);
  solver.step(a, b, nullptr, &contacts, kDt);
  solver.check_last_step();
}

}  // namespace
}  // namespace novaphy
