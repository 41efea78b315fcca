// Gradients of DiffSolverVBD on a CUDA device have the bits of the CPU. The device is a GPU or the
// fake driver (CMakeLists.txt).
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <limits>
#include <string>

#include "novaphy/core/error.h"
#include "novaphy/nova/optim.h"
#include "support/cuda_device.h"
#include "vbd/gradients_scene.h"

namespace novaphy {
namespace {

using testing::expect_thrown;
using testing::NamedValues;
using testing::VbdGradientRun;

class VbdDevices : public testing::OnCuda {};

NamedValues gradients(Device device, const VbdGradientRun& how) {
  NamedValues all = testing::vbd_gradients(device, how);
  for (const auto& [name, values] : all) {
    bool any = false;
    for (const float x : values) any = any || x != 0.0f;
    EXPECT_TRUE(any) << name;
  }
  return all;
}
void expect_same(const NamedValues& actual, const NamedValues& expected, const char* what = "") {
  ASSERT_EQ(actual.size(), expected.size());
  for (size_t k = 0; k < actual.size(); ++k) {
    const auto& [name, values] = actual[k];
    const std::vector<float>& others = expected[k].second;
    EXPECT_EQ(name, expected[k].first);
    ASSERT_EQ(values.size(), others.size());
    for (size_t i = 0; i < values.size(); ++i)
      if (std::memcmp(&values[i], &others[i], sizeof(float)) != 0) {
        ADD_FAILURE() << name << "[" << i << "]" << what << ": " << values[i] << ", expected "
                      << others[i];
        break;
      }
  }
}
void expect_bits_of_the_cpu(const VbdGradientRun& how) {
  expect_same(gradients(Device::cuda(), how), gradients(Device::cpu(), how));
}

TEST_F(VbdDevices, GradientsByEverythingHaveTheBitsOfTheCpu) {
  expect_bits_of_the_cpu({.steps = 1});
  expect_bits_of_the_cpu({});
}
TEST_F(VbdDevices, SomeGradientsHaveTheBitsOfTheCpu) {
  expect_bits_of_the_cpu({.contacts = false, .targets = false, .only = {"particle_q"}});
  expect_bits_of_the_cpu({.kd = 0.0f, .only = {"particle_tri_material", "shape_material_mu"}});
}
TEST_F(VbdDevices, OptionsHaveTheBitsOfTheCpu) {
  expect_bits_of_the_cpu(
      {.options = {.iterations = 3, .initial_guess = VbdInitialGuess::Previous}});
  expect_bits_of_the_cpu({.conflicts = true});
  const VbdGradientRun coarse = {.options = {.iterations = 3, .coarse = true}, .steps = 2};
  const NamedValues expected = gradients(Device::cpu(), coarse);
  expect_same(gradients(Device::cuda(), coarse), expected);
  VbdGradientRun replayed = coarse;
  replayed.replays = 2;
  expect_same(gradients(Device::cuda(), replayed), gradients(Device::cpu(), replayed),
              ", replayed");
}
TEST_F(VbdDevices, TheAdaptiveGuessHasTheBitsOfTheCpu) {
  const diff::DiffVbdOptions adaptive = {.iterations = 3,
                                         .initial_guess = VbdInitialGuess::Adaptive};
  const NamedValues expected = gradients(Device::cpu(), {.options = adaptive, .steps = 5});
  expect_same(gradients(Device::cuda(), {.options = adaptive, .steps = 5}), expected);
  for (const Device device : {Device::cpu(), Device::cuda()}) {
    expect_same(gradients(device, {.options = adaptive, .steps = 5, .checkpoint = 2}), expected,
                ", checkpoints");
    // By value: in a replay a sum begins with 0, which is -0 in a direct run.
    for (const int32_t checkpoint : {1, 2})
      EXPECT_EQ(
          gradients(device,
                    {.options = adaptive, .steps = 5, .checkpoint = checkpoint, .replays = 1}),
          expected);
  }
  expect_same(gradients(Device::cuda(), {.options = adaptive, .steps = 5, .replays = 2}),
              gradients(Device::cpu(), {.options = adaptive, .steps = 5, .replays = 2}),
              ", replayed");
  EXPECT_NE(gradients(Device::cpu(), {.options = {.iterations = 3}, .steps = 5}), expected);
}
TEST_F(VbdDevices, CheckpointsAndReplaysHaveTheBitsOfTheCpu) {
  const NamedValues expected = gradients(Device::cpu(), {.steps = 5});
  expect_same(gradients(Device::cuda(), {.steps = 5, .checkpoint = 2}), expected, ", checkpoints");
  expect_same(gradients(Device::cuda(), {.steps = 5, .replays = 2}),
              gradients(Device::cpu(), {.steps = 5, .replays = 2}), ", replayed");
  expect_same(gradients(Device::cuda(), {.steps = 5, .checkpoint = 2, .replays = 2}),
              gradients(Device::cpu(), {.steps = 5, .checkpoint = 2, .replays = 2}),
              ", checkpoints replayed");
}

TEST_F(VbdDevices, ImplicitGradientsHaveTheBitsOfTheCpu) {
  const diff::DiffVbdOptions solved = {.iterations = 20, .gradient = {.implicit = true}};
  expect_bits_of_the_cpu({.options = solved, .steps = 2, .kd = 0.0f});
  expect_bits_of_the_cpu({.options = solved,
                          .steps = 4,
                          .checkpoint = 2,
                          .kd = 0.0f,
                          .contacts = false,
                          .only = {"particle_q", "particle_tri_material"}});
  // Far from the solution, with few steps of each method and colors that hold conflicts.
  expect_bits_of_the_cpu({.options = {.iterations = 2,
                                      .gradient = {.implicit = true,
                                                   .newton_iterations = 3,
                                                   .krylov_sweeps = 4,
                                                   .allow_unconverged = true}},
                          .steps = 2,
                          .conflicts = true});
}

// The derivatives of the results of a step along a direction.
NamedValues tangents(Device device, const diff::DiffVbdOptions& options) {
  const auto model = testing::EverythingScene::make(1.0f, device);
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  pipeline.collide(a, contacts);
  diff::DiffSolverVBD solver(model, options);
  std::vector<nova::Tensor> leaves = {diff::state_particle_q_tensor(a, true)}, along;
  for (const Array* array : std::initializer_list<const Array*>{
           &model->gravity, &model->particle_mass, &model->particle_spring_rest_length,
           &model->particle_tri_pose, &model->particle_tri_material,
           &model->particle_edge_rest_angle, &model->particle_tet_material,
           &model->shape_material_mu})
    leaves.push_back(nova::Tensor::view(*array, true));
  for (const nova::Tensor& leaf : leaves) {
    std::vector<float> values = leaf.to_host();
    for (size_t k = 0; k < values.size(); ++k)
      values[k] = (0.01f + 0.1f * values[k]) * std::sin(static_cast<float>(k + 1));
    along.push_back(nova::Tensor::from_host(values, leaf.shape(), device));
  }
  nova::Tape tape;
  {
    const nova::TapeScope on_tape(tape);
    solver.step(a, b, nullptr, &contacts, 1.0f / 120.0f);
  }
  const std::vector<nova::Tensor> found = tape.jvp(
      {diff::state_particle_q_tensor(b), diff::state_particle_qd_tensor(b)}, leaves, along);
  return {{"q", found[0].to_host()}, {"qd", found[1].to_host()}};
}
TEST_F(VbdDevices, TangentsHaveTheBitsOfTheCpu) {
  for (const diff::DiffVbdOptions& options :
       {diff::DiffVbdOptions{.iterations = 3},
        diff::DiffVbdOptions{.iterations = 3, .coarse = true},
        diff::DiffVbdOptions{.iterations = 3,
        .gradient = {.implicit = true, .tolerance = 1e-3f}}}) {
    const NamedValues expected = tangents(Device::cpu(), options);
    EXPECT_NE(expected[0].second[60], 0.0f);
    expect_same(tangents(Device::cuda(), options), expected);
  }
}

// Three iterations of a training of materials and rest shapes, or three replays of one.
NamedValues trained(Device device, bool replayed) {
  const auto model = testing::EverythingScene::make(1.0f, device);
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
  diff::DiffSolverVBD solver(model, {.iterations = 3});
  Trajectory trajectory(model, 2, true, 1);
  NamedValues all;
  std::vector<std::pair<const char*, nova::Tensor>> leaves;
  for (const auto& [name, array] : std::initializer_list<std::pair<const char*, const Array*>>{
           {"particle_spring_stiffness", &model->particle_spring_stiffness},
           {"particle_spring_damping", &model->particle_spring_damping},
           {"particle_spring_rest_length", &model->particle_spring_rest_length},
           {"particle_tri_pose", &model->particle_tri_pose},
           {"particle_tri_area", &model->particle_tri_area},
           {"particle_tri_material", &model->particle_tri_material},
           {"particle_edge_material", &model->particle_edge_material},
           {"particle_edge_rest_angle", &model->particle_edge_rest_angle},
           {"particle_edge_rest_length", &model->particle_edge_rest_length},
           {"particle_tet_pose", &model->particle_tet_pose},
           {"particle_tet_material", &model->particle_tet_material}}) {
    leaves.emplace_back(name, nova::Tensor::view(*array, true));
    all.emplace_back(std::string("old ") + name, leaves.back().second.to_host());
  }
  const auto iterate = [&] {
    for (const auto& [name, leaf] : leaves) nova::Tensor(leaf).zero_grad();
    nova::Tape tape;
    {
      const nova::TapeScope on_tape(tape);
      solver.rollout(trajectory, nullptr, nullptr, 1.0f / 120.0f, {.pipeline = &pipeline});
      const nova::Tensor q = diff::state_particle_q_tensor(trajectory.state(2));
      tape.backward(nova::sum(nova::mul(q, q)));
    }
    for (const auto& [name, leaf] : leaves)
      nova::sgd_update_f32(leaf, name == std::string("particle_spring_stiffness") ? 10.0f : 1e-2f);
  };
  nova::ScopedCapture scope;
  if (!replayed) scope.end();
  for (int k = 0; k < (replayed ? 1 : 3); ++k) iterate();
  scope.end();
  for (int k = 0; k < (replayed ? 3 : 0); ++k) scope.graph()->launch();
  solver.gradient_info();
  for (const auto& [name, leaf] : leaves) all.emplace_back(name, leaf.to_host());
  for (size_t k = 0; k < leaves.size(); ++k)
    EXPECT_NE(all[k].second, all[leaves.size() + k].second) << all[k].first;
  return all;
}
// By value: in a replay a sum begins with 0, which is -0 in a direct run.
TEST_F(VbdDevices, MaterialsAreTrainedInACaptureWithTheBitsOfTheCpu) {
  const NamedValues expected = trained(Device::cpu(), false);
  EXPECT_EQ(trained(Device::cpu(), true), expected);
  EXPECT_EQ(trained(Device::cuda(), false), expected);
  EXPECT_EQ(trained(Device::cuda(), true), expected);
}
TEST_F(VbdDevices, ATrainedMaterialThatTheTablesHaveNoPlaceForIsNamed) {
  const auto model = testing::EverythingScene::make(0.0f, Device::cuda());
  diff::DiffSolverVBD solver(model);
  SimState a = model->state(), b = model->state();
  const nova::Tensor leaf = nova::Tensor::view(model->particle_tri_material, true);
  nova::ScopedCapture scope;
  {
    nova::Tape tape;
    const nova::TapeScope on_tape(tape);
    solver.step(a, b, nullptr, nullptr, 1.0f / 120.0f);
    tape.backward(nova::sum(diff::state_particle_q_tensor(b)));
  }
  scope.end();
  scope.graph()->launch();
  solver.gradient_info();
  const std::vector<float> good = model->particle_tri_material.to_host();
  for (const auto& [column, value] : {std::pair(3, 1.0f), std::pair(0, -1.0f)}) {
    std::vector<float> bad = good;
    bad[static_cast<size_t>(5 * 7 + column)] = value;
    model->particle_tri_material.copy_from_host(std::span<const float>(bad));
    scope.graph()->launch();
    expect_thrown(ErrorKind::Runtime, "model.particle_tri_material[7]: expected",
                  [&] { solver.gradient_info(); });
    model->particle_tri_material.copy_from_host(std::span<const float>(good));
    scope.graph()->launch();
    solver.gradient_info();
  }
}

// Returns the gradients of a step: of cloths in three worlds and a particle in all worlds, or of
// particles without elements.
NamedValues gradients_of_worlds(Device device, bool with_cloths) {
  ModelBuilder cloth, all;
  cloth.add_cloth_grid({.dim_x = 3,
                        .dim_y = 2,
                        .cell_x = 0.1,
                        .cell_y = 0.1,
                        .mass = 0.1f,
                        .fix_left = true,
                        .tri = {.ke = 100.0f, .ka = 100.0f, .kd = 0.1f}});
  if (with_cloths) all.replicate(cloth, 3);
  for (const float x : {0.0f, 1.0f}) all.add_particle({x, 0.0f, 2.0f}, {0.0f, x, 0.0f}, 1.0f);
  all.color();
  const auto model = all.finalize(device);
  diff::DiffSolverVBD solver(model, {.iterations = 3});
  SimState a = model->state(), b = model->state();
  const nova::Tensor q = diff::state_particle_q_tensor(a, true),
                     gravity = nova::Tensor::view(model->gravity, true);
  nova::Tape tape;
  nova::Tensor loss;
  {
    const nova::TapeScope on_tape(tape);
    solver.step(a, b, nullptr, nullptr, 1.0f / 120.0f);
    const nova::Tensor end = diff::state_particle_q_tensor(b);
    loss = nova::sum(nova::mul(end, end));
    tape.backward(loss);
  }
  return {{"particle_q", q.grad().to_host()}, {"gravity", gravity.grad().to_host()}};
}
TEST_F(VbdDevices, WorldsAndParticlesWithoutElementsHaveTheBitsOfTheCpu) {
  for (const bool with_cloths : {true, false})
    expect_same(gradients_of_worlds(Device::cuda(), with_cloths),
                gradients_of_worlds(Device::cpu(), with_cloths));
}

TEST_F(VbdDevices, AStepThatWasNotSolvedIsAnError) {
  const auto model = testing::EverythingScene::make(0.0f, Device::cuda());
  diff::DiffSolverVBD solver(
      model, {.iterations = 1, .gradient = {.implicit = true, .newton_iterations = 0}});
  SimState a = model->state(), b = model->state();
  expect_thrown(ErrorKind::Runtime, "the step was not solved",
                [&] { solver.step(a, b, nullptr, nullptr, 1.0f / 60.0f); });
}

// A solver that cannot throw reports the fault later, once.
TEST_F(VbdDevices, WhatIsNotFiniteIsNamedWhereTheHostAsks) {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  for (const bool replayed : {false, true})
    for (const Device device : {Device::cpu(), Device::cuda()}) {
      if (device.is_cpu() && !replayed) continue;  // throws at once
      const auto model = testing::EverythingScene::make(0.0f, device);
      SolverVBD solver(model);
      SimState a = model->state(), b = model->state();
      const auto step = [&] {
        nova::ScopedCapture scope;
        if (!replayed) scope.end();
        solver.step(a, b, nullptr, nullptr, 1.0f / 120.0f);
        scope.end();
        if (replayed) scope.graph()->launch();
      };
      step();
      solver.residual();
      const auto set = [](DeviceArray<Vec3f>& array, size_t row, float value) {
        std::vector<Vec3f> rows = array.to_host();
        rows[row].y = value;
        array.copy_from_host(std::span<const Vec3f>(rows));
      };
      for (const auto& [name, array] :
           {std::pair("particle_q", &a.particle_q), std::pair("particle_qd", &a.particle_qd),
            std::pair("particle_f", &a.particle_f)}) {
        const std::vector<Vec3f> good = array->to_host();
        set(*array, 31, nan);
        step();
        expect_thrown(ErrorKind::Runtime, "particle 31: state_in." + std::string(name),
                      [&] { solver.residual(); });
        array->copy_from_host(std::span<const Vec3f>(good));
        step();
        EXPECT_GE(solver.residual().relative, 0.0);
      }
      set(a.particle_qd, 33, 3e38f);
      SimState c = model->state();
      nova::ScopedCapture scope;
      if (!replayed) scope.end();
      solver.step(a, c, nullptr, nullptr, 1e3f);
      scope.end();
      if (replayed) scope.graph()->launch();
      expect_thrown(ErrorKind::Runtime, "particle 33: state_in: the inertial target overflows",
                    [&] { solver.residual(); });
    }
}
TEST_F(VbdDevices, APositionThatDoesNotStayFiniteIsNamed) {
  const auto model = testing::EverythingScene::make(0.0f, Device::cuda());
  SolverVBD solver(model);
  SimState a = model->state(), b = model->state();
  const std::vector<Vec3f> goals(static_cast<size_t>(solver.kinematic_count()),
                                 {0.0f, std::numeric_limits<float>::infinity(), 0.0f});
  const auto targets = DeviceArray<Vec3f>::from_host(goals, Device::cuda());
  solver.step(a, b, nullptr, nullptr, 1.0f / 120.0f, &targets);
  expect_thrown(ErrorKind::Runtime, "particle 0: its position did not stay finite",
                [&] { solver.residual(); });
}
TEST_F(VbdDevices, ContactsThatOverflowAreNamedWhereTheHostAsks) {
  const auto model = testing::EverythingScene::make(0.0f, Device::cuda());
  CollisionPipeline pipeline(model, {.soft_contact_max = 2, .soft_contact_margin = 0.05f});
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  pipeline.collide(a, contacts);
  const int32_t found = contacts.soft_contact_count.to_host()[0];
  ASSERT_GT(found, 2);
  SolverVBD solver(model);
  solver.step(a, b, nullptr, &contacts, 1.0f / 120.0f);
  expect_thrown(ErrorKind::Runtime,
                "contacts: " + std::to_string(found) + " were found, but there are slots for 2",
                [&] { solver.residual(); });
  diff::DiffSolverVBD differentiable(model);
  differentiable.step(a, b, nullptr, &contacts, 1.0f / 120.0f);
  expect_thrown(ErrorKind::Runtime, "but there are slots for 2",
                [&] { differentiable.gradient_info(); });
  expect_thrown(ErrorKind::Runtime, "expected a backward before",
                [&] { differentiable.gradient_info(); });
  diff::DiffSolverVBD implicit(model, {.gradient = {.implicit = true}});
  expect_thrown(ErrorKind::Runtime, "but there are slots for 2",
                [&] { implicit.step(a, b, nullptr, &contacts, 1.0f / 120.0f); });
}

TEST_F(VbdDevices, WhatIsNotThereIsRefusedByName) {
  const auto model = testing::EverythingScene::make(0.0f, Device::cuda());
  diff::DiffSolverVBD solver(model);
  expect_thrown(ErrorKind::Runtime, "expected a backward before", [&] { solver.gradient_info(); });
  SimState a = model->state(), b = model->state();
  const nova::Tensor q = diff::state_particle_q_tensor(a, true);
  nova::Tape tape;
  {
    const nova::TapeScope on_tape(tape);
    solver.step(a, b, nullptr, nullptr, 1.0f / 120.0f);
  }
  nova::ScopedCapture scope;
  expect_thrown(ErrorKind::NotImplemented, "expected jvp outside a ScopedCapture on cuda:0",
                [&] { tape.jvp({diff::state_particle_q_tensor(b)}, {q}, {q}); });
  diff::DiffSolverVBD implicit(model, {.gradient = {.implicit = true}});
  expect_thrown(ErrorKind::NotImplemented,
                "gradient: expected \"unrolled\" inside a ScopedCapture on cuda:0",
                [&] { implicit.step(a, b, nullptr, nullptr, 1.0f / 120.0f); });
  solver.step(a, b, nullptr, nullptr, 1.0f / 120.0f);
  scope.end();
  scope.graph()->launch();
  model->particle_tet_material.copy_from_host(std::span<const float>(
      std::vector<float>(model->particle_tet_material.to_host().size(), 30.0f)));
  EXPECT_THROW(scope.graph()->launch(), Error);
}

}  // namespace
}  // namespace novaphy
