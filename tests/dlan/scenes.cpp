// Runs a scene on the CPU and on a device, and prints whether the bits are the same. Errors are
// printed as "error: ...".
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "diff/ball_scene.h"
#include "dynamics/all_joints_scene.h"
#include "fake_driver/articulation_contact_scenes.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/diff_featherstone_solver.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/rigid_losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "novaphy/dynamics/joint_coordinates.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"
#include "support/convex_shapes.h"
#include "support/soft_body_scene.h"

#ifdef DLAN_HAS_VBD
#include "vbd/gradients_scene.h"
void step_vbd(const std::string& options, novaphy::Device device);  // fake_driver/probe_vbd.cpp
#endif

namespace {

using nova::Tensor;
using novaphy::Device;

// The loss and the gradient of the first velocities, twice: of a captured iteration that is
// replayed.
std::vector<float> trained(const std::shared_ptr<novaphy::Model>& model,
                           novaphy::diff::DiffSolverConfig config, bool contacts, int steps,
                           float dt, novaphy::Vec3f target) {
  namespace diff = novaphy::diff;
  novaphy::set_default_device(model->device());
  diff::DiffSemiImplicitSolver solver(model, config);
  diff::Trajectory trajectory(model, steps);
  std::optional<novaphy::Contacts> found;
  if (contacts) found = novaphy::testing::make_ball_contacts(model, trajectory.state(0));
  const Tensor v0 = diff::state_particle_qd_tensor(trajectory.state(0), true);
  Tensor loss;
  nova::ScopedCapture capture;
  {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, contacts ? &*found : nullptr, dt);
    const Tensor last = diff::state_particle_q_tensor(trajectory.state(steps));
    loss = diff::vec3_point_loss_generated(diff::particle_centroid_generated(last), target.x,
                                           target.y, target.z);
    tape.backward(loss);
  }
  capture.end();
  std::vector<float> results;
  for (int k = 0; k < 2; ++k) {
    capture.graph()->launch();
    results.push_back(loss.item());
  }
  for (const float g : v0.grad().to_host()) results.push_back(g);
  return results;
}

std::vector<float> ball(Device device) {
  using namespace novaphy::testing;
  return trained(make_ball_model(5, device), {}, true, kBallSteps, kBallDt, kBallTarget);
}
std::vector<float> soft_body(Device device) {
  using namespace novaphy::testing;
  return trained(make_soft_body_model(2, device),
                 {.enable_tetrahedra = true,
                  .enable_triangles = true,
                  .enable_static_contacts = true,
                  .static_contact_margin = kSoftBodyGap},
                 false, 100, kSoftBodyDt, kSoftBodyTarget);
}
std::vector<float> cloth(Device device) {
  novaphy::ModelBuilder builder;
  builder.add_cloth_grid({.placement = {.vel = {0.0f, 0.4f, -1.5f}},
                          .dim_x = 5,
                          .dim_y = 4,
                          .cell_x = 0.07f,
                          .cell_y = 0.08f,
                          .mass = 1.0f,
                          .fix_left = true,
                          .tri = {1e3f, 1e3f, 10.0f, 10.0f, 5.0f},
                          .edge = {10.0f, 0.1f},
                          .add_springs = true,
                          .spring_ke = 30.0f,
                          .spring_kd = 0.05f});
  return trained(builder.finalize(device, {.requires_grad = true}),
                 {.enable_triangles = true, .enable_springs = true, .enable_bending = true}, false,
                 30, 5e-4f, {0.1f, 0.2f, 0.3f});
}

// The settings of the scenes with rigid bodies.
constexpr float kRigidDt = 1.0f / 960.0f;
constexpr novaphy::ShapeConfig kSurface{.ke = 1e4f, .kd = 100.0f, .kf = 200.0f, .mu = 0.5f};
novaphy::CollisionOptions rigid_options(novaphy::BroadPhase phase) {
  return {.broad_phase = phase, .rigid_contact_max = 400};
}

// Overlapping bodies of all types, on the ground and beside a box.
novaphy::ModelBuilder rigid_bodies() {
  novaphy::ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  for (int k = 0; k < 14; ++k) {
    const auto t = static_cast<float>(k);
    const int32_t body =
        b.add_body({.xform = {{0.15f * static_cast<float>(k % 4),
                               0.14f * static_cast<float>(k / 4 % 2), 0.09f + 0.05f * t},
                              {0.0f, 0.6f, 0.0f, 0.8f}}});
    b.body_qd[static_cast<size_t>(body)] = {{0.1f * t, -0.2f, -1.0f}, {0.3f, 0.1f * t, 0.5f}};
    novaphy::testing::add_convex_shape(b, body, k, kSurface);
  }
  b.add_shape_box(-1, {.xform = {{0.3f, 0.4f, 0.2f}, novaphy::Quatf::identity()},
                       .hx = 0.5f,
                       .hy = 0.1f,
                       .hz = 0.2f,
                       .cfg = kSurface});
  return b;
}

template <class T>
void append(std::vector<float>& to, const std::vector<T>& values) {
  static_assert(sizeof(T) % sizeof(float) == 0);
  const auto* const words = reinterpret_cast<const float*>(values.data());
  to.insert(to.end(), words, words + values.size() * sizeof(T) / sizeof(float));
}

// The rows of contacts and the bodies of some steps, by every broad phase, direct and captured.
std::vector<float> rigid_steps(Device device, novaphy::BroadPhase phase, bool capture) {
  using namespace novaphy;
  const auto model = rigid_bodies().finalize(device);
  CollisionPipeline pipeline(model, rigid_options(phase));
  SolverSemiImplicit solver(model);
  Contacts contacts = pipeline.contacts();
  SimState now = model->state(), next = model->state();
  nova::ScopedCapture scope;
  if (!capture) scope.end();
  pipeline.collide(now, contacts);
  scope.end();
  for (int k = 0; k < 6; ++k) {
    if (capture) {
      scope.graph()->launch();
    } else {
      pipeline.collide(now, contacts);
    }
    solver.step(now, next, nullptr, &contacts, kRigidDt);
    now.assign(next);
  }
  std::vector<float> all;
  append(all, contacts.rigid_contact_count.to_host());
  append(all, contacts.rigid_contact_shape0.to_host());
  append(all, contacts.rigid_contact_shape1.to_host());
  append(all, contacts.rigid_contact_point0.to_host());
  append(all, contacts.rigid_contact_point1.to_host());
  append(all, contacts.rigid_contact_normal.to_host());
  append(all, contacts.rigid_contact_force.to_host());
  append(all, now.body_q.to_host());
  append(all, now.body_qd.to_host());
  return all;
}
bool same_bits(const std::vector<float>& a, const std::vector<float>& b) {
  return a.size() == b.size() && std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0;
}
void rigid_contacts(Device device) {
  using novaphy::BroadPhase;
  const std::vector<float> cpu = rigid_steps(Device::cpu(), BroadPhase::Explicit, false);
  int32_t count = 0;
  std::memcpy(&count, cpu.data(), sizeof(count));
  std::printf("%s", count > 20 && count < 400 ? "rows of contacts" : "too few or too many rows");
  for (const BroadPhase phase : {BroadPhase::Explicit, BroadPhase::NxN, BroadPhase::Sap})
    for (const bool capture : {false, true})
      std::printf(", %s", same_bits(rigid_steps(device, phase, capture), cpu) ? "same" : "other");
  std::printf("\n");
}

// Articulations that start at the poses of forward kinematics.
std::vector<float> articulation_steps(Device device, bool capture) {
  using namespace novaphy;
  ModelBuilder all;
  all.replicate(testing::AllJointsScene::make(), 50);
  const auto model = all.finalize(device);
  SolverFeatherstone solver(model);
  SimState now = model->state(), next = model->state();
  std::vector<float> results;
  const auto add = [&](const SimState& s) {
    append(results, s.joint_q.to_host());
    append(results, s.joint_qd.to_host());
    append(results, s.body_q.to_host());
    append(results, s.body_qd.to_host());
  };
  eval_fk(*model, now.joint_q, now.joint_qd, now);
  add(now);
  nova::ScopedCapture scope;
  if (!capture) scope.end();
  if (capture) solver.step(now, next, nullptr, nullptr, kRigidDt);
  scope.end();
  for (int k = 0; k < 20; ++k) {
    if (capture) {
      scope.graph()->launch();
    } else {
      solver.step(now, next, nullptr, nullptr, kRigidDt);
    }
    now.assign(next);
  }
  add(now);
  return results;
}
void articulations(Device device) {
  const std::vector<float> cpu = articulation_steps(Device::cpu(), false);
  std::printf("%zu numbers", cpu.size());
  for (const bool capture : {false, true})
    std::printf(", %s", same_bits(articulation_steps(device, capture), cpu) ? "same" : "other");
  std::printf("\n");
}

#ifdef DLAN_HAS_VBD
// A rollout of DiffSolverVBD and its gradients by everything: direct, replayed, implicit.
std::vector<float> numbers_of(Device device, const novaphy::testing::VbdGradientRun& how) {
  std::vector<float> all;
  for (const auto& [name, values] : novaphy::testing::vbd_gradients(device, how))
    append(all, values);
  return all;
}
void vbd_gradients(Device device) {
  const novaphy::testing::VbdGradientRun runs[] = {
      {.steps = 2},
      {.steps = 2, .replays = 1},
      {.options = {.iterations = 20, .gradient = {.implicit = true}}, .steps = 2, .kd = 0.0f}};
  for (const auto& how : runs) {
    const std::vector<float> cpu = numbers_of(Device::cpu(), how);
    if (&how == runs) std::printf("%zu numbers", cpu.size());
    std::printf(", %s", same_bits(numbers_of(device, how), cpu) ? "same" : "other");
  }
  std::printf("\n");
}
#endif

// Gradients through the contacts and the dry friction of a walker that lands, and its labels.
std::vector<float> articulation_contact_gradients(Device device, bool capture) {
  using namespace novaphy;
  ModelBuilder b;
  b.add_ground_plane({.cfg = testing::contact_scenes::kSurface});
  for (const float x : {0.0f, 2.0f})
    testing::contact_scenes::add_walker(b, x, 0.318f, -1, 0.5f * x);
  const auto model = b.finalize(device, {.requires_grad = true});
  diff::DiffFeatherstoneSolver solver(model, {}, false, diff::DerivativeOf::Code);
  CollisionPipeline pipeline(model, {.rigid_contact_max = 100});
  constexpr int32_t kSteps = 12;
  Trajectory trajectory(model, kSteps);
  const Tensor leaves[] = {diff::state_joint_q_tensor(trajectory.state(0), true),
                           diff::state_joint_qd_tensor(trajectory.state(0), true),
                           diff::model_joint_friction_tensor(*model, true),
                           diff::model_shape_material_mu_tensor(*model, true)};
  nova::ScopedCapture scope;
  if (!capture) scope.end();
  {
    nova::Tape tape;
    const nova::TapeScope on_tape(tape);
    RolloutOptions options;
    options.pipeline = &pipeline;
    solver.rollout(trajectory, nullptr, nullptr, kRigidDt, options);
    const Tensor last = diff::state_body_q_tensor(trajectory.state(kSteps));
    tape.backward(nova::sum(nova::mul(last, last)));
  }
  scope.end();
  if (capture) scope.graph()->launch();
  std::vector<float> results;
  for (const Tensor& leaf : leaves) append(results, leaf.grad().to_host());
  const ContactBranches said = solver.branches();
  for (const int64_t count : {said.all.exact, said.sticking, said.sliding})
    results.push_back(static_cast<float>(count));
  return results;
}
void contact_gradients(Device device) {
  std::vector<float> cpu = articulation_contact_gradients(Device::cpu(), false);
  std::printf("%s", cpu[cpu.size() - 2] + cpu.back() > 0.0f ? "contacts" : "no contacts");
  for (const bool capture : {false, true})
    std::printf(", %s", same_bits(articulation_contact_gradients(device, capture),
                                  articulation_contact_gradients(Device::cpu(), capture))
                            ? "same"
                            : "other");
  std::printf("\n");
}

// The loss and the gradients of the first state of an articulation: of a captured iteration.
std::vector<float> articulation(Device device) {
  using namespace novaphy;
  const auto model = testing::AllJointsScene::make().finalize(device, {.requires_grad = true});
  diff::DiffFeatherstoneSolver solver(model);
  constexpr int32_t kSteps = 8;
  Trajectory trajectory(model, kSteps);
  const Tensor q = diff::state_joint_q_tensor(trajectory.state(0), true),
               qd = diff::state_joint_qd_tensor(trajectory.state(0), true);
  Tensor loss;
  nova::ScopedCapture capture;
  {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    solver.rollout(trajectory, nullptr, nullptr, kRigidDt);
    const Tensor last = diff::state_body_q_tensor(trajectory.state(kSteps));
    loss = nova::sum(nova::mul(last, last));
    tape.backward(loss);
  }
  capture.end();
  std::vector<float> results;
  for (int k = 0; k < 2; ++k) {
    for (const Tensor& leaf : {q, qd}) leaf.zero_grad();
    capture.graph()->launch();
    results.push_back(loss.item());
  }
  append(results, q.grad().to_host());
  append(results, qd.grad().to_host());
  return results;
}

// The loss and gradients of a captured iteration: a die with a ball on it is thrown.
std::vector<float> rigid(Device device) {
  using namespace novaphy;
  ModelBuilder b;
  b.add_ground_plane({.cfg = kSurface});
  b.add_body({.xform = {{0.0f, 0.0f, 0.105f}, Quatf::identity()}, .mass = 4.0f});
  b.add_shape_box(0, {.hx = 0.1f, .hy = 0.1f, .hz = 0.1f, .cfg = kSurface});
  b.body_qd[0] = {{1.0f, 0.0f, -2.0f}, {1.0f, 5.0f, 2.0f}};
  b.add_body({.xform = {{0.02f, 0.0f, 0.295f}, Quatf::identity()}});
  b.add_shape_sphere(1, {.radius = 0.1f, .cfg = kSurface});
  const auto model = b.finalize(device, {.requires_grad = true});
  diff::DiffSemiImplicitSolver solver(
      model, {.friction_law = FrictionLaw::Huber, .friction_smoothing = 0.1f});
  CollisionPipeline pipeline(model, rigid_options(BroadPhase::Sap));
  constexpr int32_t kSteps = 8;
  Trajectory trajectory(model, kSteps);
  const Tensor qd = diff::state_body_qd_tensor(trajectory.state(0), true),
               ke = diff::model_shape_material_ke_tensor(*model, true);
  Tensor loss;
  nova::ScopedCapture capture;
  {
    nova::Tape tape;
    const nova::TapeScope scope(tape);
    RolloutOptions options;
    options.pipeline = &pipeline;
    solver.rollout(trajectory, nullptr, nullptr, kRigidDt, options);
    const SimState& end = trajectory.state(kSteps);
    loss = diff::rigid_orientation_velocity_loss_generated(
        diff::state_body_q_tensor(end), diff::state_body_qd_tensor(end), 0, {1.0f, 0.0f, 0.0f},
        {0.0f, 0.0f, 1.0f}, {0.0f, 1.0f, 0.0f}, {0.0f, 1.0f, 0.0f},
        {.height_weight = 1.0f,
         .linear_velocity_weight = 0.01f,
         .angular_velocity_weight = 0.001f});
    tape.backward(loss);
  }
  capture.end();
  std::vector<float> results;
  for (int k = 0; k < 2; ++k) {
    for (const Tensor& leaf : {qd, ke}) leaf.zero_grad();
    capture.graph()->launch();
    results.push_back(loss.item());
  }
  append(results, qd.grad().to_host());
  const std::vector<float> of_ke = ke.grad().to_host();
  for (const float g : of_ke)
    if (g == 0.0f) std::printf("a shape without contact, ");
  append(results, of_ke);
  return results;
}

void compare(std::vector<float> (*scene)(Device), Device device) {
  const std::vector<float> cpu = scene(Device::cpu()), other = scene(device);
  const bool equal = same_bits(cpu, other);
  bool moves = false;
  for (const float g : std::span(cpu).subspan(2)) moves = moves || g != 0.0f;
  std::printf("loss %.6g and %zu gradients%s have %s bits\n", static_cast<double>(cpu[0]),
              cpu.size() - 2, moves ? "" : ", all zero,", equal ? "the same" : "other");
}

// One that the engine does not have.
void own_kernel(Device device) {
  novaphy::set_default_device(device);
  const nova::Kernel kernel = nova::make_kernel(
      "own", {{"x", nova::DType::F32, 1, nova::Access::Direct}}, {{"y", 1}},
      [](nova::TraceContext& c) { return std::vector{c.f32(0) * 4.0f + nova::Real(1.0f)}; });
  const std::vector<float> values = {1.0f, 2.0f, 3.0f};
  const Tensor x = Tensor::from_host(std::span<const float>(values), {3}, device);
  const Tensor y({3}, nova::DType::F32, device);
  const nova::Operand in = x.operand(), out = y.operand();
  kernel.launch(3, in, out);
  const std::vector<float> results = y.to_host();
  for (const nova::KernelInfo& info : nova::kernel_info())
    if (info.name == "own") std::printf("%s ", info.how == "native" ? "compiled" : "interpreted");
  for (const float v : results) std::printf("%g ", static_cast<double>(v));
  std::printf("\n");
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc != 3) return 2;
    const std::string scene = argv[1];
    const Device device = Device::parse(argv[2]);
    if (scene == "ball") {
      compare(ball, device);
    } else if (scene == "soft_body") {
      compare(soft_body, device);
    } else if (scene == "cloth") {
      compare(cloth, device);
    } else if (scene == "rigid") {
      compare(rigid, device);
    } else if (scene == "rigid_contacts") {
      rigid_contacts(device);
    } else if (scene == "articulation") {
      compare(articulation, device);
    } else if (scene == "contact_gradients") {
      contact_gradients(device);
    } else if (scene == "articulations") {
      articulations(device);
#ifdef DLAN_HAS_VBD
    } else if (scene == "vbd_gradients") {
      vbd_gradients(device);
    } else if (scene.rfind("vbd", 0) == 0) {
      step_vbd(scene, device);
#endif
    } else if (scene == "own_kernel") {
      own_kernel(device);
    } else {
      return 2;
    }
    return 0;
  } catch (const novaphy::Error& error) {
    std::printf("error: %s\n", error.what());
    return 1;
  }
}
