// Runs a scene on the CPU and on a device, and prints whether the bits are the same; errors as
// "error: ...".
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "diff/ball_scene.h"
#include "novaphy/core/error.h"
#include "novaphy/diff/diff_semi_implicit_solver.h"
#include "novaphy/diff/losses.h"
#include "novaphy/diff/tensor_views.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"
#include "support/soft_body_scene.h"

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

void compare(std::vector<float> (*scene)(Device), Device device) {
  const std::vector<float> cpu = scene(Device::cpu()), other = scene(device);
  const bool equal = cpu.size() == other.size() &&
                     std::memcmp(cpu.data(), other.data(), cpu.size() * sizeof(float)) == 0;
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
  kernel.launch(3, {&in, 1}, {&out, 1});
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
