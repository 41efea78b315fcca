// The backward pass of a step of VBD without its sweeps, as kernels (row_kernel.h): the begin, the
// end, and the sums of terms from slots. Further kernels turn the adjoints of slots, contacts and
// inertial positions into derivatives with respect to arrays of the model and the state. A null
// output is not computed.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/math/matrix.h"
#include "novaphy/vbd/elements/list.h"
#include "novaphy/vbd/particle_step_law.h"
#include "novaphy/vbd/rows_kernels.h"

namespace novaphy {

struct VbdClearArguments {
  NOVAPHY_ARGUMENTS(Writes<float> values;)
};
NOVAPHY_ROW_KERNEL(vbd_clear, VbdClearArguments) { a.values[row] = 0.0f; }

struct VbdKeepArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<VbdRow> x; WritesRow<VbdRow> iterate;)
};
NOVAPHY_ROW_KERNEL(vbd_keep, VbdKeepArguments) { a.iterate[row] = a.x[row]; }

// Computes the adjoints of the positions x from the adjoints of the results, with v = (x - xn)/h.
struct VbdAdjointBeginArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<Vec3f>> q_adjoint;   // null: 0
                    Optional<Reads<Vec3f>> qd_adjoint;  // null: 0
                    Number<float> inverse_h; WritesRow<VbdRow> x_adjoint;)
};
NOVAPHY_ROW_KERNEL(vbd_adjoint_begin, VbdAdjointBeginArguments) {
  const Vec3f by_v = a.qd_adjoint != nullptr ? a.qd_adjoint[row] * a.inverse_h.value : Vec3f{};
  a.x_adjoint[row] = to_row((a.q_adjoint != nullptr ? a.q_adjoint[row] : Vec3f{}) + by_v);
}

struct VbdAdjointEndArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> is_kinematic; ReadsRow<VbdRow> x_adjoint;
                    Optional<UpdatesRow<VbdRow>>
                        guess;  // gets the adjoint of the initial guess; null: not stored
                    Optional<Reads<Vec3f>> qd_adjoint; Number<float> inverse_h;
                    UpdatesRow<VbdRow> start_adjoint;)
};
NOVAPHY_ROW_KERNEL(vbd_adjoint_end, VbdAdjointEndArguments) {
  if (a.guess != nullptr && a.is_kinematic[row] == 0)
    a.guess[row] = to_row(to_vec3(a.guess[row]) + to_vec3(a.x_adjoint[row]));
  if (a.qd_adjoint != nullptr)
    a.start_adjoint[row] =
        to_row(to_vec3(a.start_adjoint[row]) - a.qd_adjoint[row] * a.inverse_h.value);
}

// The parts that vbd_receive adds: terms from the particle's own slots, and terms from slots of
// other particles.
constexpr int64_t kVbdReceiveOwn = 1, kVbdReceiveOthers = 2,
                  kVbdReceiveAll = kVbdReceiveOwn | kVbdReceiveOthers;

// Sums terms for particles (see Receivers). A row is a row of receivers, from `first` on.
struct VbdReceiveArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle;
                    Reads<int64_t> begin,
                    others;  // index of the first term from slots of other particles
                    Reads<int64_t> entries; Number<int64_t> first, lanes; Reads<float> terms;
                    Reads<int32_t> is_own; Optional<Reads<VbdRow>> own;  // null: 0
                    Updates<VbdRow> rows; Number<int64_t> parts;)
};
NOVAPHY_ROW_KERNEL(vbd_receive, VbdReceiveArguments) {
  const int64_t r = a.first + row;
  const int32_t p = a.particle[r];
  const auto term = [&a](int64_t k) {
    const float* const v = a.terms + a.entries[k];
    return Vec3f{v[0], v[a.lanes], v[2 * a.lanes]};
  };
  Vec3f sum = to_vec3(a.rows[p]);
  if (a.is_own[r] != 0 && (a.parts & kVbdReceiveOwn) != 0) {
    Vec3f own = a.own != nullptr ? to_vec3(a.own[p]) : Vec3f{};
    for (int64_t k = a.begin[r]; k < a.others[r]; ++k) own = own + term(k);
    sum = sum + own;
  }
  if ((a.parts & kVbdReceiveOthers) != 0)
    for (int64_t k = a.others[r]; k < a.begin[r + 1]; ++k) sum = sum + term(k);
  a.rows[p] = to_row(sum);
}

struct VbdParticleGradientArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> is_kinematic; ReadsRow<float> inv_mass; ReadsRow<Vec3f> f;
                    ReadsRow<VbdRow> x_adjoint, start_adjoint, target_adjoint;
                    ReadsRow<float> mass_adjoint; Number<float> h;
                    Number<int64_t> have_targets;  // 1: kinematic particles have targets
                    Optional<Writes<Vec3f>> by_q, by_qd, by_f; Optional<Writes<float>> by_mass;
                    // the part of each particle in the gradient with respect to its world's gravity
                    Optional<WritesRow<VbdRow>> by_gravity;
                    Optional<Writes<float>> by_last;  // {particles, 4}
                    // For the adaptive guess: the previous velocity. x_adjoint is then the adjoint
                    // of the guess. Null: vbd_adjoint_end has already added the adjoint of the
                    // guess to another adjoint.
                    Optional<ReadsRow<VbdRow>> last; ReadsRow<Vec3f> qd; ReadsRow<int32_t> world;
                    Reads<Vec3f> gravity; Number<int64_t> last_world;)
};
NOVAPHY_ROW_KERNEL(vbd_particle_gradient, VbdParticleGradientArguments) {
  const float h = a.h.value, w = a.inv_mass[row];
  const bool is_kinematic = a.is_kinematic[row] != 0;
  Vec3f by_target = to_vec3(a.target_adjoint[row]);
  Vec3f by_start = to_vec3(a.start_adjoint[row]);
  vbd::GuessAdjoints guess;
  if (a.last != nullptr && !is_kinematic) {
    const Vec3f adjoint = to_vec3(a.x_adjoint[row]);
    const VbdRow last = a.last[row];
    if (last.w == 0.0f) {
      by_target = by_target + adjoint;
    } else {
      const int32_t of = a.world[row];
      by_start = by_start + adjoint;
      guess = vbd::adaptive_guess_adjoints(
          adjoint, a.qd[row], a.gravity[of < 0 ? a.last_world.value : of], h, to_vec3(last));
    }
  }
  by_start = by_start + by_target;
  if (is_kinematic && a.have_targets == 0) by_start = by_start + to_vec3(a.x_adjoint[row]);
  if (a.by_q != nullptr) a.by_q[row] = by_start;
  if (a.by_qd != nullptr) a.by_qd[row] = by_target * h + guess.by_velocity;
  if (a.by_gravity != nullptr) a.by_gravity[row] = to_row(by_target * (h * h) + guess.by_gravity);
  if (a.by_last != nullptr) {
    a.by_last[4 * row] = guess.by_last.x;
    a.by_last[4 * row + 1] = guess.by_last.y;
    a.by_last[4 * row + 2] = guess.by_last.z;
    a.by_last[4 * row + 3] = 0.0f;
  }
  if (a.by_f != nullptr) a.by_f[row] = by_target * ((h * h) * w);
  // The mass enters through m/h^2, and through 1/m in the inertial position.
  const float by_inverse = math::dot(by_target, a.f[row]) * (h * h);
  if (a.by_mass != nullptr)
    a.by_mass[row] = is_kinematic ? 0.0f : a.mass_adjoint[row] / (h * h) - (w * w) * by_inverse;
}

struct VbdTargetGradientArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> kinematic; Reads<VbdRow> x_adjoint;
                    Number<int64_t> has_targets; Writes<Vec3f> by_targets;)
};
NOVAPHY_ROW_KERNEL(vbd_target_gradient, VbdTargetGradientArguments) {
  a.by_targets[row] = a.has_targets != 0 ? to_vec3(a.x_adjoint[a.kinematic[row]]) : Vec3f{};
}

struct VbdGravityGradientArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> begin;  // of each world; then the end
                    Reads<int32_t> particles;
                    Reads<VbdRow> of_particles;  // see VbdParticleGradientArguments
                    Writes<Vec3f> by_gravity;)
};
NOVAPHY_ROW_KERNEL(vbd_gravity_gradient, VbdGravityGradientArguments) {
  Vec3f sum{};
  for (int32_t k = a.begin[row]; k < a.begin[row + 1]; ++k)
    sum = sum + to_vec3(a.of_particles[a.particles[k]]);
  a.by_gravity[row] = sum;
}

// Derivatives with respect to the parameters of one kind of element. A null output is not computed.
struct VbdElementGradientArguments {
  NOVAPHY_ARGUMENTS(
      // For each slot type. places: for each corner of each element, its index in the table of
      // slots, or -1. first: the index in `numbers` at which the adjoints of the type begin.
      Each<Optional<Reads<int64_t>>, vbd::kMostSlots> places;
      Each<Number<int64_t>, vbd::kMostSlots> first; Reads<float> numbers;  // of all roles
      Number<int64_t> role, lanes; Number<float> h;
      Each<Optional<Reads<float>>, vbd::kMostArrays> parameters;  // see for_parameters
      Each<Optional<Writes<float>>, vbd::kMostArrays> to;)
};

namespace vbd {

#include "number_adjoints.inc"

// The adjoints of an element's numbers: the weights of each corner, and the coefficients of the
// law, summed over all corners.
template <Role role>
struct ElementAdjoints {
  using Element = SlotOf<role>;
  float weights[Element::kCorners][law_begin(role) + 1] = {}, laws[kLawFloats[role]] = {};
  ElementAdjoints(const VbdElementGradientArguments& a, int64_t element) {
    for (int c = 0; c < Element::kCorners; ++c)
      for (int k = 0; k < Element::kSlots; ++k) {
        const int64_t place = a.places[k][element * Element::kCorners + c];
        if (place < 0) continue;
        const int64_t slot = place / a.lanes, lane = place - slot * a.lanes;
        const float* const from = a.numbers + (a.first[k] + slot * kFloats[role] * a.lanes + lane);
        for (int n = 0; n < law_begin(role); ++n) weights[c][n] = from[n * a.lanes];
        for (int n = 0; n < kLawFloats[role]; ++n)
          laws[n] = laws[n] + from[(law_begin(role) + n) * a.lanes];
      }
  }
  float weight(int corner, int k) const { return weights[corner][k]; }
  float law(int k) const { return laws[k]; }
};
template <Role role>
inline void put_parameters(const VbdElementGradientArguments& a, int64_t e) {
  using Element = SlotOf<role>;
  float p[Element::kParameters], to[Element::kParameters];
  for_parameters<Element>(e, [&](int k, int array, int64_t at) { p[k] = a.parameters[array][at]; });
  numbers_adjoint(RoleIs<role>(), p, a.h.value, ElementAdjoints<role>(a, e), to);
  for_parameters<Element>(e, [&](int k, int array, int64_t at) {
    if (a.to[array] != nullptr) a.to[array][at] = to[k];
  });
  int array = 0;
  Element::for_columns([&](int columns, int width, ArrayUse) {  // columns that no force reads get 0
    for (int c = columns; c < width && a.to[array] != nullptr; ++c)
      a.to[array][e * width + c] = 0.0f;
    ++array;
  });
}

inline void put(float* to, int64_t row, float value) {
  if (to != nullptr) to[row] = value;
}

}  // namespace vbd

NOVAPHY_ROW_KERNEL(vbd_element_gradient, VbdElementGradientArguments) {
  using namespace vbd;
  for_each_kind([&](auto is) {
    if (a.role == is.role) put_parameters<decltype(is)::role>(a, row);
  });
}

struct VbdRadiusGradientArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<int32_t>> contact_begin;  // null: no contacts
                    Optional<Reads<float>> contact_adjoints; WritesRow<float> by_radius;)
};
NOVAPHY_ROW_KERNEL(vbd_radius_gradient, VbdRadiusGradientArguments) {
  float sum = 0.0f;
  if (a.contact_begin != nullptr)
    for (int32_t k = a.contact_begin[row]; k < a.contact_begin[row + 1]; ++k)
      sum += a.contact_adjoints[static_cast<int64_t>(k) * vbd::kContactLawFloats];
  a.by_radius[row] = sum;
}

// Writes the shape of each contact, sorted by particle. Entries after the last contact get -1.
struct VbdContactShapeArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> begin, items; Number<int64_t> particles; Reads<int32_t> shape;
                    WritesRow<int32_t> shape_of_contact;)
};
NOVAPHY_ROW_KERNEL(vbd_contact_shape, VbdContactShapeArguments) {
  a.shape_of_contact[row] = row < a.begin[a.particles] ? a.shape[a.items[row]] : -1;
}

struct VbdShapeGradientArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<int32_t>>
                        // the first contact of each shape; then the end; null: no contacts
                        begin;
                    Optional<Reads<int32_t>> contacts;  // of each shape, sorted by particle
                    Optional<Reads<float>> contact_adjoints; ReadsRow<float> mu;
                    Number<float> model_mu, h;
                    Optional<Writes<float>> by_margin, by_ke, by_kd, by_mu;)
};
NOVAPHY_ROW_KERNEL(vbd_shape_gradient, VbdShapeGradientArguments) {
  float margin = 0.0f, ke = 0.0f, kd = 0.0f, mu = 0.0f;
  const float mean = math::sqrt(a.model_mu.value * a.mu[row]);
  if (a.begin != nullptr)
    for (int32_t k = a.begin[row]; k < a.begin[row + 1]; ++k) {
      const float* const adjoint =
          a.contact_adjoints + static_cast<int64_t>(a.contacts[k]) * vbd::kContactLawFloats;
      margin += adjoint[0];
      ke += 0.5f * adjoint[1];
      kd += (0.5f * adjoint[2]) / a.h.value;
      if (mean > 0.0f) mu += adjoint[3] * (a.model_mu.value / (2.0f * mean));
    }
  vbd::put(a.by_margin, row, margin);
  vbd::put(a.by_ke, row, ke);
  vbd::put(a.by_kd, row, kd);
  vbd::put(a.by_mu, row, mu);
}

}  // namespace novaphy
