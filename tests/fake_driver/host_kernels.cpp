// The device's interpreter and builtins, compiled for the host from the device text. The fake
// driver runs them. The threads of a block are fibers, which take turns and wait for each other at
// the barriers of the text.
#include "host_kernels.h"

#include <ucontext.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <memory>
#include <tuple>
#include <utility>
#include <vector>

#include "interpreter.h"
#include "novaphy/cpu/float_mode.h"

namespace {

struct Index {
  unsigned x;
};
Index blockIdx, blockDim, gridDim, threadIdx;

// A block of fibers.
enum class State { Ready, AtBlockBarrier, AtWarpBarrier, Done };
struct Fiber {
  ucontext_t context;
  std::unique_ptr<char[]> stack;
  State state = State::Ready;
};
std::vector<Fiber> g_fibers;
ucontext_t g_scheduler;
const std::function<void()>* g_thread;

void wait(State state) {
  Fiber& mine = g_fibers[threadIdx.x];
  mine.state = state;
  swapcontext(&mine.context, &g_scheduler);
}
void begin() {
  (*g_thread)();
  wait(State::Done);
}

// Releases all fibers of [first, last) if the unfinished ones all wait for each other.
bool release(size_t first, size_t last, State barrier) {
  bool any = false;
  for (size_t t = first; t < last; ++t) {
    if (g_fibers[t].state == State::Done) continue;
    if (g_fibers[t].state != barrier) return false;
    any = true;
  }
  for (size_t t = first; any && t < last; ++t)
    if (g_fibers[t].state == barrier) g_fibers[t].state = State::Ready;
  return any;
}

void run_block() {
  constexpr size_t kStack = 64 << 10;
  g_fibers.resize(blockDim.x);
  for (Fiber& fiber : g_fibers) {
    if (fiber.stack == nullptr) fiber.stack = std::make_unique<char[]>(kStack);
    fiber.state = State::Ready;
    getcontext(&fiber.context);
    fiber.context.uc_stack.ss_sp = fiber.stack.get();
    fiber.context.uc_stack.ss_size = kStack;
    fiber.context.uc_link = nullptr;
    makecontext(&fiber.context, begin, 0);
  }
  for (bool more = true; more;) {
    for (unsigned t = 0; t < blockDim.x; ++t) {
      if (g_fibers[t].state != State::Ready) continue;
      threadIdx.x = t;
      swapcontext(&g_scheduler, &g_fibers[t].context);
    }
    more = false;
    for (size_t t = 0; t < g_fibers.size(); t += 32)
      more = release(t, std::min(t + 32, g_fibers.size()), State::AtWarpBarrier) || more;
    more = release(0, g_fibers.size(), State::AtBlockBarrier) || more;
  }
}

}  // namespace

// The definitions that the text expects from its compiler.
namespace device {
namespace {

#include "host_intrinsics.h"

void __syncthreads() { wait(State::AtBlockBarrier); }
#define VENDOR_WARP 32
void vendor_warp_barrier(unsigned = ~0u) { wait(State::AtWarpBarrier); }
unsigned vendor_shuffle_up(unsigned value, int step) {
  static unsigned values[1024];
  const unsigned t = threadIdx.x;
  values[t] = value;
  wait(State::AtWarpBarrier);
  const unsigned other = t % 32 >= static_cast<unsigned>(step) ? values[t - step] : value;
  wait(State::AtWarpBarrier);
  return other;
}

#define __shared__ static
// Each needs the ones before.
// clang-format off
#include "vendors/generic.cuh"
#include "device_prelude.cuh"
#include "builtins.cuh"
// clang-format on
enum {
#define NOVAPHY_NAME(name, signature) OP_##name,
  NOVAPHY_PROGRAM_OPS(NOVAPHY_NAME)
#undef NOVAPHY_NAME
#define NOVAPHY_NAME(name) OP_##name,
      NOVAPHY_INTERPRETER_OPS(NOVAPHY_NAME)
};
#undef __shared__
#define __shared__
extern int32_t shared_values[];
#include "interpreter.cuh"
int32_t shared_values[12 << 10];

// Hand-written kernels.
#define NOVAPHY_KERNEL static void
#define NOVAPHY_ROW (static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x)
#include "soft_contact_kernels.cuh"
// Every text has its own copy of the headers.
namespace rigid {
#include "rigid_contact_kernels.cuh"
}
namespace mesh {
#include "rigid_mesh_kernels.cuh"
}
namespace boxes {
#include "rigid_tree_kernels.cuh"
}
namespace bodies {
#include "contact_body_kernels.cuh"
}
namespace trees {
#include "articulation_kernels.cuh"
}
namespace tree_contacts {
#include "articulation_contact_kernels.cuh"
#undef NOVAPHY_MATRIX_TREES
}  // namespace tree_contacts
namespace tree_contacts_vjp {
#include "articulation_contact_vjp_kernels.cuh"
#undef NOVAPHY_MATRIX_TREES
}  // namespace tree_contacts_vjp
namespace tree_functions {
#include "articulation_functions_kernels.cuh"
}
namespace tree_contacts_jvp {
#include "articulation_contact_jvp_kernels.cuh"
#undef NOVAPHY_MATRIX_TREES
}  // namespace tree_contacts_jvp
namespace tree_tangents {
#include "articulation_jvp_kernels.cuh"
}
namespace pushed_bodies {
#include "body_actuation_kernels.cuh"
}
namespace joints {
#include "joint_coordinates_kernels.cuh"
}
namespace notes {
#include "gradient_notes_kernels.cuh"
}
#ifdef FAKE_DRIVER_HAS_VBD
#undef __shared__
#define __shared__ static
namespace vbd_source {
#include "vbd_kernels.cuh"
}
namespace vbd_adjoint_source {
#include "vbd_adjoint_kernels.cuh"
}
namespace vbd_coarse_source {
#include "vbd_coarse_kernels.cuh"
}
namespace vbd_gradient_source {
#include "vbd_gradient_kernels.cuh"
}
namespace vbd_tangent_source {
#include "vbd_tangent_kernels.cuh"
}
#endif

template <class... P>
struct Call {
  template <void (*kernel)(P...)>
  static std::function<void()> bind(void* const* arguments) {
    return [&]<size_t... k>(std::index_sequence<k...>) {
      return [copies = std::tuple<P...>(*static_cast<P*>(arguments[k])...)] {
        std::apply(kernel, copies);
      };
    }
    (std::index_sequence_for<P...>());
  }
};
template <auto kernel, class... P>
HostKernel entry(const char* name, bool waits, void (*)(P...)) {
  return {name, waits, &Call<P...>::template bind<kernel>};
}
#define ENTRY(name, waits) entry<name>(#name, waits, name)
#define HAND_WRITTEN(name) OF_TEXT(device::novaphy, name)
#define OF_TEXT(text, name) entry<text::name>(#name, false, text::name)
#define OF_VBD(name, waits) \
  entry<device::vbd_source::novaphy::name>(#name, waits, device::vbd_source::novaphy::name)

}  // namespace
}  // namespace device

const HostKernel* find_host_kernel(const char* name) {
  using namespace device;
  static const HostKernel kKernels[] = {
      ENTRY(novaphy_interpreter, false),
      ENTRY(row_sum_f32, true),
      ENTRY(row_sum_chunks, true),
      ENTRY(row_sum_last, false),
      ENTRY(exclusive_scan_i32, true),
      ENTRY(sort_count, true),
      ENTRY(sort_place, true),
      ENTRY(incidence_count, false),
      ENTRY(checksum_u64, true),
      HAND_WRITTEN(soft_contact_shape),
      HAND_WRITTEN(soft_contact_touch),
      HAND_WRITTEN(soft_contact_write),
      HAND_WRITTEN(soft_contact_none),
      HAND_WRITTEN(soft_contact_clear),
      HAND_WRITTEN(contact_generation),
      OF_TEXT(rigid::novaphy, rigid_contact_shape),
      OF_TEXT(rigid::novaphy, rigid_contact_find),
      OF_TEXT(rigid::novaphy, rigid_contact_limit_sum),
      OF_TEXT(rigid::novaphy, rigid_contact_chunk),
      OF_TEXT(rigid::novaphy, rigid_contact_limit),
      OF_TEXT(rigid::novaphy, rigid_contact_farther),
      OF_TEXT(rigid::novaphy, rigid_contact_trim),
      OF_TEXT(rigid::novaphy, rigid_contact_write),
      OF_TEXT(rigid::novaphy, rigid_contact_clear),
      OF_TEXT(mesh::novaphy, rigid_mesh_find),
      OF_TEXT(mesh::novaphy, rigid_mesh_limit_sum),
      OF_TEXT(mesh::novaphy, rigid_mesh_farther),
      OF_TEXT(mesh::novaphy, rigid_mesh_trim),
      OF_TEXT(mesh::novaphy, rigid_mesh_write),
      OF_TEXT(boxes::novaphy, rigid_tree_bounds),
      OF_TEXT(boxes::novaphy, rigid_tree_key),
      OF_TEXT(boxes::novaphy, rigid_tree_entry),
      OF_TEXT(boxes::novaphy, rigid_tree_level),
      OF_TEXT(boxes::novaphy, rigid_tree_count),
      OF_TEXT(boxes::novaphy, rigid_tree_total),
      OF_TEXT(boxes::novaphy, rigid_tree_write),
      OF_TEXT(bodies::novaphy, contact_body),
      OF_TEXT(trees::novaphy, articulation_step),
      OF_TEXT(trees::novaphy, articulation_step_vjp),
      OF_TEXT(trees::novaphy, gravity_gradient),
      OF_TEXT(trees::novaphy, actuation),
      OF_TEXT(trees::novaphy, actuation_vjp),
      OF_TEXT(trees::novaphy, actuation_jvp),
      OF_TEXT(trees::novaphy, gravity_compensation),
      OF_TEXT(trees::novaphy, gravity_compensation_vjp),
      OF_TEXT(trees::novaphy, gravity_compensation_jvp),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_group),
      entry<tree_contacts::novaphy::articulation_contact_step>(
          "articulation_contact_step", true, tree_contacts::novaphy::articulation_contact_step),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_open),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_islands),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_start),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_solve),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_finish),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_notes),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_keep),
      OF_TEXT(tree_contacts::novaphy, articulation_contact_copy),
      OF_TEXT(tree_contacts::novaphy, articulation_note_some),
      OF_TEXT(tree_contacts::novaphy, articulation_note_step),
      OF_TEXT(tree_contacts_vjp::novaphy, articulation_contact_vjp),
      OF_TEXT(tree_contacts_vjp::novaphy, articulation_material_clear),
      OF_TEXT(tree_contacts_vjp::novaphy, articulation_material_gradient),
      OF_TEXT(tree_functions::novaphy, articulation_function),
      OF_TEXT(tree_contacts_jvp::novaphy, articulation_contact_jvp),
      OF_TEXT(tree_tangents::novaphy, dual_pack),
      OF_TEXT(tree_tangents::novaphy, dual_tangent),
      OF_TEXT(tree_tangents::novaphy, articulation_step_jvp),
      OF_TEXT(pushed_bodies::novaphy, body_actuation),
      OF_TEXT(pushed_bodies::novaphy, body_actuation_vjp),
      OF_TEXT(pushed_bodies::novaphy, body_actuation_jvp),
      OF_TEXT(joints::novaphy, eval_fk_articulation),
      OF_TEXT(joints::novaphy, eval_ik_joint),
      OF_TEXT(joints::novaphy, eval_mimic_joint),
      OF_TEXT(notes::novaphy, note_soft_contacts),
      OF_TEXT(notes::novaphy, note_static_particles),
      OF_TEXT(notes::novaphy, note_rigid_contacts),
      OF_TEXT(notes::novaphy, note_plane_pairs),
      OF_TEXT(notes::novaphy, note_contact_events),
      OF_TEXT(notes::novaphy, note_gradient_step),
#ifdef FAKE_DRIVER_HAS_VBD
      OF_VBD(vbd_predict, false),
      OF_VBD(vbd_target, false),
      OF_VBD(vbd_activation, false),
      OF_VBD(vbd_numbers, false),
      OF_VBD(vbd_material, false),
      OF_VBD(vbd_contact, false),
      OF_VBD(vbd_prepare, false),
      OF_VBD(vbd_move, false),
      OF_VBD(vbd_move_guarded, false),
      OF_VBD(vbd_commit, false),
      OF_VBD(vbd_accelerate, false),
      OF_VBD(vbd_finish, false),
      OF_VBD(vbd_residual, false),
      OF_VBD(vbd_move_by_blocks, true),
      OF_TEXT(vbd_adjoint_source::novaphy, vbd_adjoint_solve),
      entry<device::vbd_adjoint_source::novaphy::vbd_adjoint_solve_by_blocks>(
          "vbd_adjoint_solve_by_blocks", true,
          device::vbd_adjoint_source::novaphy::vbd_adjoint_solve_by_blocks),
      OF_TEXT(vbd_adjoint_source::novaphy, vbd_adjoint_slots),
      OF_TEXT(vbd_adjoint_source::novaphy, vbd_adjoint_solution),
      OF_TEXT(vbd_adjoint_source::novaphy, vbd_adjoint_outer),
      OF_TEXT(vbd_adjoint_source::novaphy, vbd_adjoint_stiffness),
      OF_TEXT(vbd_adjoint_source::novaphy, vbd_tangent_stiffness),
      OF_TEXT(vbd_adjoint_source::novaphy, vbd_adjoint_start),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_rows),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_force),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_outer),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_matrix),
      entry<device::vbd_coarse_source::novaphy::vbd_coarse_factor>(
          "vbd_coarse_factor", true, device::vbd_coarse_source::novaphy::vbd_coarse_factor),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_load),
      entry<device::vbd_coarse_source::novaphy::vbd_coarse_solve>(
          "vbd_coarse_solve", true, device::vbd_coarse_source::novaphy::vbd_coarse_solve),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_test),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_try),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_take),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_fields),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_balance),
      OF_TEXT(vbd_coarse_source::novaphy, vbd_coarse_shift),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_clear),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_keep),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_adjoint_begin),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_adjoint_end),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_receive),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_particle_gradient),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_target_gradient),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_gravity_gradient),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_element_gradient),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_radius_gradient),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_contact_shape),
      OF_TEXT(vbd_gradient_source::novaphy, vbd_shape_gradient),
      OF_TEXT(vbd_tangent_source::novaphy, vbd_tangent),
      OF_TEXT(vbd_tangent_source::novaphy, vbd_tangent_start),
      OF_TEXT(vbd_tangent_source::novaphy, vbd_tangent_move),
#endif
  };
  for (const HostKernel& kernel : kKernels)
    if (std::strcmp(kernel.name, name) == 0) return &kernel;
  return nullptr;
}

void run_host_kernel(const HostKernel& kernel, unsigned blocks, unsigned threads, bool backwards,
                     const std::function<void()>& thread) {
  const novaphy::cpu::FloatMode own;  // independent of the caller's mode
  g_thread = &thread;
  gridDim.x = blocks;
  blockDim.x = threads;
  for (unsigned b = 0; b < blocks; ++b) {
    blockIdx.x = backwards ? blocks - 1 - b : b;
    if (kernel.waits) {
      run_block();
      continue;
    }
    for (unsigned t = 0; t < threads; ++t) {
      threadIdx.x = backwards ? threads - 1 - t : t;
      thread();
    }
  }
}
