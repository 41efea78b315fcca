// Measures the time of a substep of VBD on a device: the cloth of bench_vbd.py, in C++ and
// captured.
//
//   novaphy_bench_vbd_device DEVICE CELLS_X CELLS_Y SUBSTEPS [--sphere] [--direct] [--backward]
//
// With --backward, on the CPU: measures the CPU time of a substep, and of its unrolled derivative
// with respect to the positions.
//
// Prints the wall time of a substep (the fastest of five rounds). Also prints a hash of the
// positions after 20 + 5 SUBSTEPS substeps, which is the same on every device. The environment
// variable NOVAPHY_VBD_SWEEP chooses the kernel that moves a color.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <string>
#include <vector>

#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/stream.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "novaphy/vbd/solver_vbd.h"

namespace {

using namespace novaphy;

constexpr int kWarmUp = 20, kTurns = 5, kCaptured = 10;

std::shared_ptr<Model> make_model(Device device, int32_t x, int32_t y, bool sphere) {
  ModelBuilder b;
  b.add_cloth_grid({.placement = {.pos = {-0.64f, -0.32f, 0.5f}},
                    .dim_x = x,
                    .dim_y = y,
                    .cell_x = 0.02,
                    .cell_y = 0.02,
                    .mass = 4e-4f,
                    .fix_left = !sphere,
                    .tri = {.ke = 1e3f, .ka = 1e3f, .kd = 1e-2f},
                    .edge = {.ke = 1e-2f, .kd = 1e-4f},
                    .particle_radius = 0.01f});
  if (sphere)
    b.add_shape_sphere(-1,
                       {.xform = {{0.0f, 0.0f, 0.2f}, {0.0f, 0.0f, 0.0f, 1.0f}}, .radius = 0.25f});
  b.color();
  return b.finalize(device);
}

double cpu_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

// Returns the time of the fastest of `calls` calls (s).
template <class Function>
double fastest(int calls, const Function& function) {
  double best = 1e30;
  for (int k = 0; k < calls; ++k) {
    const double start = cpu_seconds();
    function();
    best = std::min(best, cpu_seconds() - start);
  }
  return best;
}

void time_backward(const std::shared_ptr<Model>& model, const SimState& state,
                   const Contacts* contacts, int calls) {
  DifferentiableVbd step(model, {.iterations = 10});
  const size_t n = state.particle_q.rows();
  const std::vector<Vec3f> ones(n, Vec3f{1.0f, 1.0f, 1.0f});
  const DeviceArray<Vec3f> q(n, Device::cpu()), qd(n, Device::cpu()), q_bar(n, Device::cpu()),
      qd_bar(n, Device::cpu()), bar = DeviceArray<Vec3f>::from_host(ones, Device::cpu());
  const VbdStepInputs inputs = {.q = state.particle_q,
                                .qd = state.particle_qd,
                                .f = state.particle_f,
                                .contacts = contacts,
                                .dt = 1.0f / 300.0f};
  const double forward = fastest(calls, [&] { step.forward(inputs, q, qd); });
  const double backward = fastest(calls, [&] {
    step.backward(inputs, bar, Array(), {.particle_q = q_bar, .particle_qd = qd_bar});
  });
  std::printf("forward %.0f us (%.0f ns a particle and iteration), backward %.0f us: %.2f of it\n",
              1e6 * forward, 1e8 * forward / static_cast<double>(n), 1e6 * backward,
              backward / forward);
}

uint64_t hash_of(const std::vector<Vec3f>& q) {
  uint64_t hash = 14695981039346656037ull;
  const auto* bytes = reinterpret_cast<const unsigned char*>(q.data());
  for (size_t k = 0; k < q.size() * sizeof(Vec3f); ++k) hash = (hash ^ bytes[k]) * 1099511628211ull;
  return hash;
}

void run(int argc, char** argv) {
  const Device device = std::string(argv[1]) == "cpu" ? Device::cpu() : Device::cuda();
  bool sphere = false, direct = device.is_cpu(), backward = false;
  for (int k = 5; k < argc; ++k) {
    sphere = sphere || std::strcmp(argv[k], "--sphere") == 0;
    direct = direct || std::strcmp(argv[k], "--direct") == 0;
    backward = backward || std::strcmp(argv[k], "--backward") == 0;
  }
  const int substeps = std::atoi(argv[4]) / kCaptured * kCaptured;
  const auto model = make_model(device, std::atoi(argv[2]), std::atoi(argv[3]), sphere);
  SolverVBD solver(model, {.iterations = 10});
  CollisionPipeline pipeline(model);
  Contacts contacts = pipeline.contacts();
  SimState states[2] = {model->state(), model->state()};
  const auto step = [&] {
    for (int k = 0; k < kCaptured; ++k) {
      if (sphere) pipeline.collide(states[k % 2], contacts);
      solver.step(states[k % 2], states[1 - k % 2], nullptr, sphere ? &contacts : nullptr,
                  1.0f / 300.0f);
    }
  };
  nova::ScopedCapture scope;
  if (!direct) step();
  scope.end();
  if (!direct) scope.graph()->prepare();
  const auto advance = [&](int count) {
    for (int k = 0; k < count; k += kCaptured)
      if (direct) {
        step();
      } else {
        scope.graph()->launch();
      }
    synchronize(device);
  };
  advance(kWarmUp);
  double best = 1e30;
  for (int turn = 0; turn < kTurns; ++turn) {
    const auto start = std::chrono::steady_clock::now();
    advance(substeps);
    const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - start;
    best = std::min(best, taken.count() / substeps);
  }
  if (backward) time_backward(model, states[0], sphere ? &contacts : nullptr, 3 + substeps / 4);
  std::printf(
      "%s %d particles%s%s: %.1f us a substep, %.0f substeps/s, residual %.3g, hash %016llx\n",
      device.str().c_str(), model->particle_count(), sphere ? ", sphere" : "",
      direct ? ", direct" : "", 1e6 * best, 1.0 / best, solver.residual().relative,
      static_cast<unsigned long long>(hash_of(states[0].particle_q.to_host())));
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 5) return 2;
  try {
    run(argc, argv);
    return 0;
  } catch (const novaphy::Error& error) {
    std::printf("error: %s\n", error.what());
    return 1;
  }
}
