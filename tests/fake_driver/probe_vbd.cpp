// SolverVBD on the CPU and on a device, each direct and as a replay.
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/vbd/solver_vbd.h"
#include "vbd/everything_scene.h"

void step_vbd(const std::string& options, novaphy::Device device);

namespace {

using namespace novaphy;

struct Run {
  std::vector<Vec3f> q, qd;
  double residual = 0.0;
};

// Three pairs of steps. Kinematic particles move; activations and forces act.
Run run(const VbdOptions& options, Device device, bool capture) {
  const auto model = testing::EverythingScene::make(1.0f, device);
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
  Contacts contacts = pipeline.contacts();
  SolverVBD solver(model, options);
  SimState states[2] = {model->state(), model->state()};
  Control control = model->control();
  control.particle_tri_activation.fill(0.05f);
  control.particle_tet_activation.fill(-0.03f);
  for (SimState& state : states) state.particle_f.fill({0.01f, 0.0f, -0.02f});
  std::vector<Vec3f> to = model->particle_q.to_host();
  to.resize(static_cast<size_t>(solver.kinematic_count()));
  for (size_t k = 0; k < to.size(); ++k) to[k] = {0.0f, 0.1f * static_cast<float>(k), 0.51f};
  const auto targets = DeviceArray<Vec3f>::from_host(to, device);
  const auto pair = [&] {
    for (int k = 0; k < 2; ++k) {
      pipeline.collide(states[k], contacts);
      solver.step(states[k], states[1 - k], &control, &contacts, 1.0f / 120.0f, &targets);
    }
  };
  if (capture) {
    nova::ScopedCapture scope;
    pair();
    scope.end();
    for (int k = 0; k < 3; ++k) scope.graph()->launch();
  } else {
    for (int k = 0; k < 3; ++k) pair();
  }
  return {states[0].particle_q.to_host(), states[0].particle_qd.to_host(),
          solver.residual().relative};
}

// A rollout with a row of targets for each of its steps.
Run roll(const VbdOptions& options, Device device) {
  const auto model = testing::EverythingScene::make(1.0f, device);
  CollisionPipeline pipeline(model, {.soft_contact_margin = 0.05f});
  SolverVBD solver(model, options);
  Trajectory trajectory(model, 3);
  std::vector<Vec3f> to;
  for (int k = 0; k < 3 * solver.kinematic_count(); ++k)
    to.push_back({0.002f * static_cast<float>(k), 0.1f * static_cast<float>(k % 4), 0.51f});
  const auto targets = DeviceArray<Vec3f>::from_host(to, device);
  solver.rollout(trajectory, nullptr, nullptr, 1.0f / 120.0f,
                 {.targets = &targets, .pipeline = &pipeline});
  return {trajectory.state(3).particle_q.to_host(), trajectory.state(3).particle_qd.to_host(),
          solver.residual().relative};
}

bool same(const Run& a, const Run& b) {
  return a.q.size() == b.q.size() && a.residual == b.residual &&
         std::memcmp(a.q.data(), b.q.data(), a.q.size() * sizeof(Vec3f)) == 0 &&
         std::memcmp(a.qd.data(), b.qd.data(), a.qd.size() * sizeof(Vec3f)) == 0;
}

}  // namespace

void step_vbd(const std::string& options, novaphy::Device device) {
  VbdOptions o = {.iterations = 7};
  const auto has = [&](const char* word) { return options.find(word) != std::string::npos; };
  if (has("safeguard")) o.safeguard = true;
  if (has("coarse")) o.coarse = true;
  if (has("acceleration")) o.acceleration = 0.7f;
  if (has("previous")) o.initial_guess = VbdInitialGuess::Previous;
  if (has("adaptive")) o.initial_guess = VbdInitialGuess::Adaptive;
  const Run cpu = run(o, Device::cpu(), false);
  const auto say = [&](const char* what, const Run& r) {
    std::printf(", %s %s", what, same(cpu, r) ? "same" : "other");
  };
  std::printf("%zu particles", cpu.q.size());
  say("cpu replayed", run(o, Device::cpu(), true));
  say("device", run(o, device, false));
  say("device replayed", run(o, device, true));
  std::printf(", rollout %s", same(roll(o, Device::cpu()), roll(o, device)) ? "same" : "other");
  std::printf("\n");
}
