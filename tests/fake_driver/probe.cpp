// Uses a device (cuda, or the one that a second argument names) and prints what happens. Errors are
// printed as "error: ...".
#include <array>
#include <cstdio>
#include <cstring>
#include <string>
#include <vector>

#include "diff/elements_scene.h"
#include "novaphy/collision/collision_pipeline.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/core/stream.h"
#include "novaphy/dynamics/semi_implicit/solver_semi_implicit.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/ops.h"

#ifdef FAKE_DRIVER_HAS_VBD
void step_vbd(const std::string& options, novaphy::Device device);  // probe_vbd.cpp
#endif

namespace {

using novaphy::Device;
using novaphy::DeviceArray;

Device g_device = Device::cuda();

void print_device() {
  const novaphy::DeviceInfo info = novaphy::device_info(g_device);
  std::printf("%s sm_%d %d units, graphs %d\n", info.name.c_str(), info.arch, info.units,
              info.supports_graph_capture);
}

void round_trip() {
  DeviceArray<float> array(1000, g_device);
  array.fill(2.5f);
  float sum = 0.0f;
  for (const float v :
       array.clone().to(Device::cpu()).size() == 1000 ? array.to_host() : std::vector<float>())
    sum += v;
  std::printf("sum %g\n", static_cast<double>(sum));
}

// Allocates more memory than exists, then an amount that fits.
void run_out_of_memory() {
  try {
    const DeviceArray<float> array(size_t{1} << 24, g_device);
    std::printf("allocated\n");
  } catch (const novaphy::Error& error) {
    std::printf("error: %s\n", error.what());
  }
  round_trip();
}

void lose_the_device() {
  for (int k = 0; k < 3; ++k) {
    try {
      DeviceArray<float> array(10, g_device);
      array.fill(1.0f);
      array.to_host();
      std::printf("worked\n");
    } catch (const novaphy::Error& error) {
      std::printf("error: %s\n", error.what());
    }
  }
  DeviceArray<float> array(10, Device::cpu());
  array.fill(3.0f);
  std::printf("the cpu gives %g\n", static_cast<double>(array.to_host()[9]));
}

// Runs two kernels. The test checks the remaining output.
void run_kernels() {
  const std::array<float, 3> values = {1.0f, 2.0f, 3.0f};
  const nova::Tensor x = nova::Tensor::from_host(values, {3}, g_device);
  for (const float v : nova::add(nova::mul(x, x), x).to_host())
    std::printf("%g ", static_cast<double>(v));
  std::printf("\n");
}

void mix_devices() {
  const nova::Kernel copy =
      nova::make_kernel("copy_row", {{"x", nova::DType::F32, 1, nova::Access::Direct}}, {{"y", 1}},
                        [](nova::TraceContext& c) { return std::vector{c.f32(0)}; });
  const nova::Tensor cpu({3}, nova::DType::F32, Device::cpu()),
      cuda({3}, nova::DType::F32, g_device);
  const nova::Operand in = cpu.operand(), out = cuda.operand();
  copy.launch(3, in, out);
}

// The forward solver, on elements of all kinds.
std::vector<novaphy::Vec3f> stepped(Device device) {
  const auto model = novaphy::testing::make_elements_model(device);
  novaphy::SolverSemiImplicit solver(model);
  novaphy::SimState states[2] = {model->state(), model->state()};
  for (int k = 0; k < 4; ++k) {
    novaphy::SimState &now = states[k % 2], &next = states[1 - k % 2];
    now.clear_forces();
    solver.step(now, next, nullptr, nullptr, 0.01f);
  }
  return states[0].particle_q.to_host();
}

void step_a_model() {
  const auto cpu = stepped(Device::cpu()), cuda = stepped(g_device);
  const bool equal = std::memcmp(cpu.data(), cuda.data(), cpu.size() * sizeof(cpu[0])) == 0;
  std::printf("%zu particles, %s bits\n", cpu.size(), equal ? "the same" : "other");
}

// The search for contacts, direct and as a replay after the particles moved.
std::vector<novaphy::SoftContact> contacts_of(Device device, bool capture) {
  novaphy::ModelBuilder builder;
  for (int k = 0; k < 1000; ++k)
    builder.add_particle({0.01f * static_cast<float>(k % 37), 0.3f * static_cast<float>(k % 11),
                          0.002f * static_cast<float>(k)},
                         {}, 1.0f, {}, k % 7 == 3 ? 0 : 1);
  builder.add_ground_plane();
  builder.add_shape_box(-1, {.xform = {{0.1f, 1.0f, 0.5f}, {0.5f, 0.5f, 0.5f, 0.5f}}});
  builder.add_shape_capsule(-1, {.radius = 0.2f});
  builder.add_shape_sphere(-1, {.radius = 0.4f});
  const auto model = builder.finalize(device);
  novaphy::CollisionPipeline pipeline(model,
                                      {.soft_contact_max = 500, .soft_contact_margin = 0.2f});
  novaphy::SimState state = model->state();
  novaphy::Contacts contacts = pipeline.contacts();
  nova::ScopedCapture scope;
  if (!capture) scope.end();
  pipeline.collide(state, contacts);
  scope.end();
  if (capture) scope.graph()->launch();
  std::vector<novaphy::Vec3f> q = state.particle_q.to_host();
  for (novaphy::Vec3f& x : q) x.z -= 0.1f;
  state.particle_q.copy_from_host(q);
  if (capture) {
    scope.graph()->launch();
  } else {
    pipeline.collide(state, contacts);
  }
  return contacts.soft_contacts();
}

void collide() {
  const auto expected = contacts_of(Device::cpu(), false);
  const bool direct = contacts_of(g_device, false) == expected,
             replayed = contacts_of(g_device, true) == expected;
  std::printf("%zu contacts, %s direct, %s replayed\n", expected.size(),
              direct ? "the same" : "others", replayed ? "the same" : "others");
}

int run(const std::string& command) {
  if (command == "device") {
    print_device();
  } else if (command == "round_trip") {
    round_trip();
  } else if (command == "memory") {
    run_out_of_memory();
  } else if (command == "lose") {
    lose_the_device();
  } else if (command == "kernels") {
    run_kernels();
  } else if (command == "mix") {
    mix_devices();
  } else if (command == "step") {
    step_a_model();
  } else if (command == "collide") {
    collide();
#ifdef FAKE_DRIVER_HAS_VBD
  } else if (command.rfind("vbd", 0) == 0) {
    step_vbd(command, g_device);
#endif
  } else {
    return 2;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc == 3) g_device = Device::parse(argv[2]);
    return argc == 2 || argc == 3 ? run(argv[1]) : 2;
  } catch (const novaphy::Error& error) {
    std::printf("error: %s\n", error.what());
    return 1;
  }
}
