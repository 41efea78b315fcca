// Gradients and tangents through contacts and dry friction of articulations on a CUDA device: the
// bits of the CPU, direct, replayed and from checkpoints, and the same labels. On a GPU, or on the
// fake driver (CMakeLists.txt).
#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "articulation_contact_scenes.h"
#include "articulation_devices.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/diff/trajectory.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

namespace novaphy {
namespace {

using namespace testing::contact_scenes;
using testing::add;
using testing::bytes;
using testing::expect_same;
using testing::expect_thrown;
using testing::Result;

// A walker that already stands on the ground.
ModelBuilder standing() {
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  add_walker(b, 0.0f, 0.318f, -1, 0.0f);
  return b;
}

struct Rollout {
  FeatherstoneOptions options = {};
  int32_t steps = 8, checkpoint = 1;
  bool captured = false, contacts = true, single = false;
  diff::DerivativeOf derivative = diff::DerivativeOf::Code;
};

nova::Tensor squares(const SimState& s) {
  return testing::sum_of_squares({diff::state_joint_q_tensor(s), diff::state_joint_qd_tensor(s),
                                  diff::state_body_q_tensor(s), diff::state_body_qd_tensor(s)});
}
nova::Tensor along(const nova::Tensor& leaf) { return testing::direction(leaf, 0.05f, -0.12f); }

// Returns the last state of a rollout, its tangents, the gradients of a loss, and the labels.
// `single`: steps one by one, each with its own collide.
Result trained(const ModelBuilder& builder, Device device, const Rollout& how,
               ContactBranches* said = nullptr) {
  using namespace diff;
  const auto model = builder.finalize(device, {.requires_grad = true});
  DiffFeatherstoneSolver solver(model, how.options, false, how.derivative);
  CollisionPipeline pipeline(model, {.rigid_contact_max = 300});
  Control control = model->control();
  std::vector<float> torques(static_cast<size_t>(model->joint_dof_count()));
  for (size_t k = 0; k < torques.size(); ++k)
    torques[k] = 0.4f * static_cast<float>((7 * k + 3) % 11) - 2.0f;
  control.joint_f.copy_from_host(std::span<const float>(torques));
  Trajectory trajectory(model, how.steps, true, how.checkpoint);
  std::vector<SimState> states;
  for (int k = 0; how.single && k <= how.steps; ++k) states.push_back(model->state());
  const SimState &start = how.single ? states.front() : trajectory.state(0),
                 &last = how.single ? states.back() : trajectory.any_state(how.steps);
  const std::vector<std::pair<const char*, nova::Tensor>> leaves = {
      {"joint_q", state_joint_q_tensor(start, true)},
      {"joint_qd", state_joint_qd_tensor(start, true)},
      {"joint_f", control_joint_f_tensor(control, true)},
      {"damping", model_joint_damping_tensor(*model, true)},
      {"joint_friction", model_joint_friction_tensor(*model, true)},
      {"mass", model_body_mass_tensor(*model, true)},
      {"com", model_body_com_tensor(*model, true)},
      {"inertia", model_body_inertia_tensor(*model, true)},
      {"gravity", model_gravity_tensor(*model, true)},
      {"limit_lower", nova::Tensor::view(model->joint_limit_lower, true)},
      {"limit_upper", nova::Tensor::view(model->joint_limit_upper, true)},
      {"mu", model_shape_material_mu_tensor(*model, true)},
      {"restitution", model_shape_material_restitution_tensor(*model, true)},
      {"ke", model_shape_material_ke_tensor(*model, true)},
      {"kd", model_shape_material_kd_tensor(*model, true)}};
  if (how.single) eval_fk(*model, states[0].joint_q, states[0].joint_qd, states[0]);
  nova::Tensor loss;
  std::vector<nova::Tensor> inputs, directions, tangents;
  for (const auto& [name, leaf] : leaves) {
    if (!how.contacts && inputs.size() == 11) break;  // nothing reads materials
    inputs.push_back(leaf);
    directions.push_back(along(leaf));
  }
  nova::ScopedCapture scope;
  if (!how.captured) scope.end();
  {
    nova::Tape tape;
    const nova::TapeScope on_tape(tape);
    if (how.single) {
      std::vector<Contacts> contacts;
      for (size_t k = 0; k + 1 < states.size(); ++k) {
        contacts.push_back(pipeline.contacts());
        {
          const nova::NoGrad no_grad;
          pipeline.collide(states[k], contacts.back());
        }
        solver.step(states[k], states[k + 1], &control, &contacts.back(), kDt);
      }
    } else {
      RolloutOptions options;
      if (how.contacts) options.pipeline = &pipeline;
      solver.rollout(trajectory, &control, nullptr, kDt, options);
    }
    loss = squares(last);
    tangents = tape.jvp({state_joint_q_tensor(last), state_joint_qd_tensor(last),
                         state_body_q_tensor(last), state_body_qd_tensor(last)},
                        inputs, directions);
    tape.backward(loss);
  }
  scope.end();
  if (how.captured) scope.graph()->launch();
  Result result;
  add(result, last, "last");
  result.emplace_back("loss", bytes(loss.to_host()));
  for (const auto& [name, leaf] : leaves)
    result.emplace_back(std::string("gradient of ") + name, bytes(leaf.grad().to_host()));
  for (const nova::Tensor& tangent : tangents) {
    const std::vector<float> values = tangent.to_host();
    EXPECT_TRUE(std::any_of(values.begin(), values.end(), [](float x) { return x != 0.0f; }));
    EXPECT_TRUE(
        std::all_of(values.begin(), values.end(), [](float x) { return std::isfinite(x); }));
    result.emplace_back("tangent", bytes(values));
  }
  const ContactBranches b = solver.branches();
  if (said != nullptr) *said = b;
  result.emplace_back(
      "branches",
      bytes(std::vector<int64_t>{b.steps, b.all.exact, b.all.frozen, b.held, b.breaking, b.sticking,
                                 b.sliding, b.all.began, b.all.ended, b.all.turned}));
  const std::string reason = solver.gradient_info().reason;
  result.emplace_back("reason", bytes(std::vector<char>(reason.begin(), reason.end())));
  result.emplace_back("margins",
                      bytes(std::vector<float>{b.normal_margin, b.gap_margin, b.cone_margin,
                                               b.slip_margin, b.all.residual}));
  return result;
}

class ArticulationGradientDevices : public ArticulationDevices {};

void expect_gradients_of_the_cpu(const ModelBuilder& builder, Rollout how) {
  ContactBranches said;
  const Result expected = trained(builder, Device::cpu(), how, &said);
  EXPECT_EQ(said.steps, how.steps);
  EXPECT_EQ(said.sticking + said.sliding > 0, how.contacts);
  expect_same(trained(builder, Device::cuda(), how), expected, ", direct");
  how.captured = true;
  // A replay adds to zeros, so zeros may have another sign.
  expect_same(trained(builder, Device::cuda(), how), trained(builder, Device::cpu(), how),
              ", replayed");
  how.captured = false;
  how.checkpoint = 4;
  expect_same(trained(builder, Device::cuda(), how), trained(builder, Device::cpu(), how),
              ", from checkpoints");
}

TEST_F(ArticulationGradientDevices, BoxesThatSlideAndBounceHaveTheBitsOfTheCpu) {
  expect_gradients_of_the_cpu(boxes(), {});
}
TEST_F(ArticulationGradientDevices, TheDefaultIsTheDerivativeOfTheCode) {
  const Result code = trained(boxes(), Device::cuda(), {});
  const Result of_default =
      trained(boxes(), Device::cuda(), {.derivative = diff::DerivativeOf::Auto});
  ASSERT_EQ(of_default.size(), code.size());
  for (size_t k = 0; k < code.size(); ++k) {
    if (code[k].first != "reason") {
      EXPECT_TRUE(of_default[k].second == code[k].second) << code[k].first;
      continue;
    }
    const auto* const text = reinterpret_cast<const char*>(of_default[k].second.data());
    EXPECT_NE(std::string(text, of_default[k].second.size()).find("in steps on a device"),
              std::string::npos);
  }
}
TEST_F(ArticulationGradientDevices, AWalkerWithTorquesHasTheBitsOfTheCpu) {
  expect_gradients_of_the_cpu(standing(), {.steps = 8});
}
TEST_F(ArticulationGradientDevices, TreesAndFreeBodiesInOneIslandHaveTheBitsOfTheCpu) {
  expect_gradients_of_the_cpu(crowd(), {.steps = 5});
}
TEST_F(ArticulationGradientDevices, WhatAKinematicBodyCarriesHasTheBitsOfTheCpu) {
  expect_gradients_of_the_cpu(turntable(), {.steps = 6});
}

TEST_F(ArticulationGradientDevices, PyramidsAndSoftContactsHaveTheBitsOfTheCpu) {
  for (const FeatherstoneOptions& options :
       {FeatherstoneOptions{.friction_cone = FrictionCone::Pyramid},
        FeatherstoneOptions{.compliant_contacts = true},
        FeatherstoneOptions{.pgs_cfm = 1e-3f, .restitution_threshold = 0.0f}}) {
    const Rollout how = {.options = options, .steps = 4};
    for (const ModelBuilder& scene : {boxes(), standing()})
      expect_same(trained(scene, Device::cuda(), how), trained(scene, Device::cpu(), how), "");
  }
}

TEST_F(ArticulationGradientDevices, StopsBesideContactsHaveTheBitsOfTheCpu) {
  expect_gradients_of_the_cpu(kicking(), {.options = {.joint_limits = JointLimits::Row,
                                                      .joint_limit_restitution = 0.5f},
                                          .steps = 8});
}

TEST_F(ArticulationGradientDevices, DryFrictionAloneHasTheBitsOfTheCpu) {
  expect_gradients_of_the_cpu(crowd(), {.steps = 12, .contacts = false});
}

// Each step has the contacts of its own state, as the labels show: no step is frozen.
TEST_F(ArticulationGradientDevices, SingleStepsHaveTheBitsOfTheCpu) {
  const Rollout how = {.steps = 8, .single = true};
  ContactBranches said;
  const Result expected = trained(standing(), Device::cpu(), how, &said);
  EXPECT_EQ(said.held, 0);
  EXPECT_GT(said.sticking + said.sliding, 0);
  expect_same(trained(standing(), Device::cuda(), how), expected, "");
}

// Each of the two worlds has room for 16 contacts. A stack has more.
TEST_F(ArticulationGradientDevices, AnIslandWithoutRoomHasNaNAndTheNextStepSaysSo) {
  ModelBuilder all;
  all.add_ground_plane({.cfg = kSurface});
  for (int w = 0; w < 2; ++w) all.add_world(stack());
  const auto model = all.finalize(Device::cuda(), {.requires_grad = true});
  diff::DiffFeatherstoneSolver solver(model);
  CollisionPipeline pipeline(model, {.rigid_contact_max = 120000});
  Contacts contacts = pipeline.contacts();
  SimState a = model->state(), b = model->state();
  eval_fk(*model, a.joint_q, a.joint_qd, a);
  const nova::Tensor qd = diff::state_joint_qd_tensor(a, true);
  pipeline.collide(a, contacts);
  nova::Tape tape;
  nova::Tensor tangent;
  {
    const nova::TapeScope on_tape(tape);
    solver.step(a, b, nullptr, &contacts, kDt);
    tangent = tape.jvp({diff::state_joint_qd_tensor(b)}, {qd}, {along(qd)})[0];
    tape.backward(squares(b));
  }
  EXPECT_TRUE(std::isnan(tangent.to_host()[0]));
  EXPECT_TRUE(std::isnan(qd.grad().to_host()[0]));
  expect_thrown(ErrorKind::Runtime, "backward or jvp: an island of contacts needs a system of",
                [&] { solver.step(a, b, nullptr, &contacts, kDt); });
}

// A second model has a body in all worlds. The worlds are then one group with one large system.
TEST_F(ArticulationGradientDevices, WorldsHaveTheBitsOfTheCpu) {
  for (const bool shared : {false, true}) {
    ModelBuilder all, one;
    all.add_ground_plane({.cfg = kSurface});
    add_walker(one, 0.0f, 0.33f, -1, 0.0f);
    add_box(one, {0.5f, 0.0f, 0.12f}, 0.1f, kSurface, {{-0.5f, 0.0f, 0.0f}, {}});
    for (int w = 0; w < 12; ++w) {
      all.add_world(one);
      for (size_t k = all.joint_qd.size() - 6; k < all.joint_qd.size(); ++k)
        all.joint_qd[k] += 0.01f * static_cast<float>(w);
    }
    if (shared) add_box(all, {0.5f, 0.1f, 0.6f}, 0.1f, kSurface);
    const Rollout how = {.steps = 3};
    expect_same(trained(all, Device::cuda(), how), trained(all, Device::cpu(), how), "");
  }
}

}  // namespace
}  // namespace novaphy
