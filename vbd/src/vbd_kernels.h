// A step of VBD as kernels (row_kernel.h). The sweep is in sweep_kernels.h.
//
// Two kernels move the particles of a color, with the same bits. The kernel vbd_move uses one
// thread for each particle. In vbd_move_by_blocks, for devices only, the threads of a block share
// the slots of some groups of particles. One thread for each component of a particle's force and
// stiffness then adds the slots in slot order.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/vbd/contact_numbers_law.h"
#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/particle_step_law.h"
#include "novaphy/vbd/slot_blocks_kernels.h"
#include "novaphy/vbd/sweep_kernels.h"

namespace novaphy {

// The arrays from which the tables of a sweep are made. The kernel does not read these arrays. They
// are arguments so that a tape notices inputs that carry a gradient.
#define NOVAPHY_VBD_TABLE_ARGUMENT(array, columns, width, use) Optional<Reads<float>> array;
#define NOVAPHY_VBD_ARGUMENTS(...) NOVAPHY_ARGUMENTS(__VA_ARGS__)  // expands the names of the lists
struct VbdTableArguments {
  NOVAPHY_VBD_ARGUMENTS(
      NOVAPHY_VBD_PARAMETERS(NOVAPHY_VBD_TABLE_ARGUMENT) Reads<float> particle_mass;
      Reads<int32_t> particle_flags; Reads<float> particle_spring_control;)
};

struct VbdPredictArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<Vec3f> particle_q, particle_qd, particle_f;  // a row for each particle
                    ReadsRow<float> particle_inv_mass; ReadsRow<int32_t> world;
                    Reads<Vec3f> gravity; Number<int64_t> last_world;
                    ReadsRow<int32_t> is_kinematic; Number<float> h;
                    Number<int64_t> guess;  // VbdInitialGuess
                    // The velocity at the start of the previous step, and the number 1 (0: no
                    // previous step). Null: the adaptive guess is not used.
                    Optional<ReadsRow<VbdRow>> last_velocity;
                    WritesRow<VbdRow> start, target, moved, x;
                    Optional<WritesRow<VbdRow>> newer;  // for Chebyshev acceleration, else null
                    UpdatesRow<int32_t> faults;         // see vbd::note_fault
                    Part<VbdTableArguments> tables;)
};

namespace vbd {

// Stores the fault of a particle, unless the particle already has a fault since the last
// Step::check.
inline void note_fault(int32_t* faults, int64_t particle, int32_t fault) {
  if (fault != kNoFault && faults[particle] == kNoFault) faults[particle] = fault;
}

}  // namespace vbd

NOVAPHY_ROW_KERNEL(vbd_predict, VbdPredictArguments) {
  const Vec3f q = a.particle_q[row], qd = a.particle_qd[row];
  a.start[row] = to_row(q);
  VbdRow last;
  if (a.last_velocity != nullptr) last = a.last_velocity[row];
  if (a.is_kinematic[row] != 0) {
    vbd::note_fault(a.faults, row, vbd::input_fault(q, {}, {}, {}));
    a.x[row] = a.target[row] = to_row(q);
    a.moved[row] = to_row({});
    return;
  }
  const int32_t w = a.world[row];
  const vbd::Prediction p = vbd::predict_particle(
      q, qd, a.particle_f[row], a.particle_inv_mass[row], a.gravity[w < 0 ? a.last_world.value : w],
      a.h.value, static_cast<int32_t>(a.guess), last.w != 0.0f, to_vec3(last));
  vbd::note_fault(a.faults, row, vbd::input_fault(q, qd, a.particle_f[row], p.target));
  a.target[row] = to_row(p.target);
  a.moved[row] = to_row(p.moved);
  a.x[row] = to_row(q + p.moved);
  if (a.newer != nullptr) a.newer[row] = to_row(p.moved);
}

struct VbdTargetArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> kinematic; ReadsRow<Vec3f> targets; Updates<VbdRow> x;)
};
// Moves kinematic particles to their targets.
NOVAPHY_ROW_KERNEL(vbd_target, VbdTargetArguments) {
  a.x[a.kinematic[row]] = to_row(a.targets[row]);
}

struct VbdNumbersArguments {
  NOVAPHY_ARGUMENTS(
      ReadsRow<int32_t> source;  // 4 times the element plus the corner, or -1
      Updates<float> floats; Number<int64_t> role, lanes;  // of a group
      Number<float> h;
      Each<Optional<Reads<float>>, vbd::kMostArrays> parameters;  // see for_parameters
  )
};

namespace vbd {

// Computes the numbers of slots from the current model. only_activated: computes only the number
// that an activation changes. A row is a lane of the slots of a role.
template <bool only_activated>
inline void put_numbers(const VbdNumbersArguments& a, int64_t row) {
  const int32_t e = a.source[row] >> 2;
  if (e < 0) return;
  const int64_t slot = row / a.lanes, lanes = a.lanes;
  for_roles([&](auto is) {
    using Slot = SlotOf<decltype(is)::role>;
    if (a.role != is.role) return;
    float p[Slot::kParameters];
    for_parameters<Slot>(e, [&](int k, int array, int64_t at) { p[k] = a.parameters[array][at]; });
    float* const to = a.floats + (slot * kFloats[is.role] * lanes + (row - slot * lanes));
    Slot::put_numbers(a.source[row] & 3, p, a.h.value, [&](int k, float value) {
      if (!only_activated || k == Slot::kActivated) to[k * lanes] = value;
    });
  });
}

}  // namespace vbd

NOVAPHY_ROW_KERNEL(vbd_numbers, VbdNumbersArguments) { vbd::put_numbers<false>(a, row); }
NOVAPHY_ROW_KERNEL(vbd_activation, VbdNumbersArguments) { vbd::put_numbers<true>(a, row); }

struct VbdMaterialArguments {
  NOVAPHY_ARGUMENTS(Reads<float> material; Number<int64_t> width;
                    UpdatesRow<int32_t> allowed;  // of each element
  )
};
// Checks whether changed materials still fit the slots, which were built for the materials of an
// earlier time. A value must be finite and at least 0. A value may differ from 0 only if `allowed`
// has the bit of its column. Otherwise the kernel sets the bit kVbdBadMaterial. kVbdAnyMaterial
// marks an element without slots, which may have any material.
constexpr int32_t kVbdBadMaterial = 1 << 30, kVbdAnyMaterial = 1 << 29;
NOVAPHY_ROW_KERNEL(vbd_material, VbdMaterialArguments) {
  if ((a.allowed[row] & kVbdAnyMaterial) != 0) return;
  for (int64_t k = 0; k < a.width; ++k) {
    const float value = a.material[row * a.width + k];
    const bool good = value >= 0.0f && value - value == 0.0f;
    if (!good || (value != 0.0f && ((a.allowed[row] >> k) & 1) == 0))
      a.allowed[row] |= kVbdBadMaterial;
  }
}

struct VbdContactArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> begin;  // first contact of each particle; then the end
                    Reads<int32_t> items;  // slots of contacts, sorted by particle
                    Number<int64_t> particles; Reads<int32_t> count;
                    // counts of found contacts and of slots, if the slots were too few
                    Updates<int32_t> overflow; Reads<int32_t> particle, shape;
                    Reads<Vec3f> point, velocity, normal;
                    Reads<float> particle_radius, shape_margin, shape_material_ke,
                    shape_material_kd;
                    Reads<float> shape_material_mu; Number<float> model_ke, model_kd, model_mu, h;
                    Writes<float> numbers;)
};
NOVAPHY_ROW_KERNEL(vbd_contact, VbdContactArguments) {
  if (row == 0 && *a.count > n && a.overflow[0] == 0) {
    a.overflow[0] = *a.count;
    a.overflow[1] = static_cast<int32_t>(n);
  }
  if (row >= a.begin[a.particles]) return;
  const int32_t slot = a.items[row], s = a.shape[slot];
  vbd::put_contact_numbers(
      a.numbers + row * vbd::kContactFloats, a.point[slot], a.normal[slot], a.velocity[slot],
      a.particle_radius[a.particle[slot]] + a.shape_margin[s],
      {a.model_ke.value, a.model_kd.value, a.model_mu.value},
      {a.shape_material_ke[s], a.shape_material_kd[s], a.shape_material_mu[s]}, a.h.value);
}

// Kernels over lanes. A row is a lane of the groups of the launch.
NOVAPHY_ROW_KERNEL(vbd_prepare, VbdSweepArguments) { vbd::prepare(vbd::LaneGroup<float>(a, row)); }
NOVAPHY_ROW_KERNEL(vbd_move, VbdSweepArguments) { vbd::move<false>(vbd::LaneGroup<float>(a, row)); }
NOVAPHY_ROW_KERNEL(vbd_move_guarded, VbdSweepArguments) {
  vbd::move<true>(vbd::LaneGroup<float>(a, row));
}
NOVAPHY_ROW_KERNEL(vbd_residual, VbdSweepArguments) {
  vbd::residual(vbd::LaneGroup<float>(a, row));
}

struct VbdCommitArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle; Number<int64_t> first_lane; Reads<VbdRow> from;
                    Updates<VbdRow> x;)
};
// For colors in which an element has two particles: moves all particles of the color to their new
// positions at once. A lane without a particle repeats the first particle.
NOVAPHY_ROW_KERNEL(vbd_commit, VbdCommitArguments) {
  const int32_t p = a.particle[a.first_lane + row];
  a.x[p] = a.from[p];
}

struct VbdAccelerateArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> is_kinematic;
                    Optional<Reads<int32_t>> contact_begin;  // null: no contacts
                    Number<float> omega; Number<int64_t> iteration; ReadsRow<VbdRow> start;
                    UpdatesRow<VbdRow> moved, x, newer, older;)
};
NOVAPHY_ROW_KERNEL(vbd_accelerate, VbdAccelerateArguments) {
  const bool touches =
      a.contact_begin != nullptr && a.contact_begin[row] < a.contact_begin[row + 1];
  if (a.iteration > 1 && a.is_kinematic[row] == 0 && !touches) {
    const Vec3f before = to_vec3(a.older[row]);
    const Vec3f moved = (to_vec3(a.moved[row]) - before) * a.omega.value + before;
    a.moved[row] = to_row(moved);
    a.x[row] = to_row(to_vec3(a.start[row]) + moved);
  }
  a.older[row] = a.newer[row];
  a.newer[row] = a.moved[row];
}

struct VbdFinishArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<VbdRow> start, x; Number<float> h; WritesRow<Vec3f> q, qd;
                    UpdatesRow<int32_t> faults;
                    // For the adaptive guess: the velocity before the step, and where to store it
                    // for the next step. Null: not stored.
                    ReadsRow<Vec3f> qd_before; Optional<WritesRow<VbdRow>> last_velocity;)
};
NOVAPHY_ROW_KERNEL(vbd_finish, VbdFinishArguments) {
  const Vec3f x = to_vec3(a.x[row]);
  if (!vbd::is_finite(x)) vbd::note_fault(a.faults, row, vbd::kFaultResult);
  if (a.last_velocity != nullptr) a.last_velocity[row] = vbd::to_last_velocity(a.qd_before[row]);
  a.q[row] = x;
  a.qd[row] = (x - to_vec3(a.start[row])) / a.h.value;
}

NOVAPHY_BLOCK_KERNEL(vbd_move_by_blocks, VbdSweepArguments);

#ifdef NOVAPHY_KERNEL
namespace vbd {

// Moves the particle of a thread by one step.
struct MoveParticle {
  const VbdSweepArguments& a;
  Vec3f start, moved;
  explicit MoveParticle(const VbdSweepArguments& arguments) : a(arguments) {}
  void ask(const LaneGroup<float>& g) {
    start = g.at(a.start);
    moved = g.at(a.moved);
  }
  Vec3f place(const LaneGroup<float>& g) const { return g.at(a.x); }
  void put(const LaneGroup<float>& g, const Block<float>& b) {
    moved = moved + solve_block(factorize(b, a.regularization.value), b.f);
    g.put(a.moved, moved);
    g.put(a.to, start + moved);
  }
};

}  // namespace vbd

NOVAPHY_BLOCK_BODY(vbd_move_by_blocks, VbdSweepArguments) {
  __shared__ vbd::BlockMemory memory;
  vbd::for_blocks<vbd::MoveParticle>(a, a, a.first_group, a.end_group, block, blocks, memory);
}
#endif

}  // namespace novaphy
