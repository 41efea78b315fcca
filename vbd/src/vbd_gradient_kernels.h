// The backward pass of a step of VBD besides its sweeps, as kernels (row_kernel.h): its begin and
// end, and the parts of slots for other particles. Other kernels turn derivatives by slots,
// contacts and targets into derivatives by arrays of the model and the state. Null: not wanted.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/math/matrix.h"
#include "novaphy/vbd/particle_step_law.h"
#include "novaphy/vbd/rows_kernels.h"
#include "novaphy/vbd/slot_layout_law.h"

namespace novaphy {

struct VbdClearArguments {
  NOVAPHY_ARGUMENTS(Writes<float> values;)
};
NOVAPHY_ROW_KERNEL(vbd_clear, VbdClearArguments) { a.values[row] = 0.0f; }

struct VbdKeepArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<VbdRow> x; WritesRow<VbdRow> iterate;)
};
NOVAPHY_ROW_KERNEL(vbd_keep, VbdKeepArguments) { a.iterate[row] = a.x[row]; }

// The bars of the positions, of those of the results. v = (x - xn)/h.
struct VbdAdjointBeginArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<Vec3f>> q_bar;   // null: 0
                    Optional<Reads<Vec3f>> qd_bar;  // null: 0
                    Number<float> inverse_h; WritesRow<VbdRow> x_bar;)
};
NOVAPHY_ROW_KERNEL(vbd_adjoint_begin, VbdAdjointBeginArguments) {
  const Vec3f by_v = a.qd_bar != nullptr ? a.qd_bar[row] * a.inverse_h.value : Vec3f{};
  a.x_bar[row] = to_row((a.q_bar != nullptr ? a.q_bar[row] : Vec3f{}) + by_v);
}

struct VbdAdjointEndArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> is_held; ReadsRow<VbdRow> x_bar; Optional<UpdatesRow<VbdRow>>
                        guess;  // the bars of what iterations began with; null: of nothing
                    Optional<Reads<Vec3f>> qd_bar; Number<float> inverse_h;
                    UpdatesRow<VbdRow> start_bar;)
};
NOVAPHY_ROW_KERNEL(vbd_adjoint_end, VbdAdjointEndArguments) {
  if (a.guess != nullptr && a.is_held[row] == 0)
    a.guess[row] = to_row(to_vec3(a.guess[row]) + to_vec3(a.x_bar[row]));
  if (a.qd_bar != nullptr)
    a.start_bar[row] = to_row(to_vec3(a.start_bar[row]) - a.qd_bar[row] * a.inverse_h.value);
}

// What a particle gets: of its own slots, of those of others.
constexpr int64_t kVbdReceiveOwn = 1, kVbdReceiveOthers = 2,
                  kVbdReceiveAll = kVbdReceiveOwn | kVbdReceiveOthers;

// See Receivers. `row`: from `first` on.
struct VbdReceiveArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> particle;
                    Reads<int64_t> begin,
                    others;  // from where on terms are of slots of other particles
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
  NOVAPHY_ARGUMENTS(
      ReadsRow<int32_t> is_held; ReadsRow<float> inv_mass; ReadsRow<Vec3f> f;
      ReadsRow<VbdRow> x_bar, start_bar, target_bar; ReadsRow<float> mass_bar; Number<float> h;
      Number<int64_t> have_targets;  // kinematic particles go to targets
      Optional<Writes<Vec3f>> by_q, by_qd, by_f; Optional<Writes<float>> by_mass;
      Optional<WritesRow<VbdRow>> by_gravity;  // of the particle's world, from this particle
      Optional<Writes<float>> by_last;         // rows of 4
      // Of the adaptive guess, whose bars are then x_bar; null: those of the guess are in another
      // bar.
      Optional<ReadsRow<VbdRow>> last; ReadsRow<Vec3f> qd; ReadsRow<int32_t> world;
      Reads<Vec3f> gravity; Number<int64_t> last_world;)
};
NOVAPHY_ROW_KERNEL(vbd_particle_gradient, VbdParticleGradientArguments) {
  const float h = a.h.value, w = a.inv_mass[row];
  const bool is_held = a.is_held[row] != 0;
  Vec3f by_target = to_vec3(a.target_bar[row]);
  Vec3f by_start = to_vec3(a.start_bar[row]);
  vbd::GuessBars guess;
  if (a.last != nullptr && !is_held) {
    const Vec3f bar = to_vec3(a.x_bar[row]);
    const VbdRow last = a.last[row];
    if (last.w == 0.0f) {
      by_target = by_target + bar;
    } else {
      const int32_t of = a.world[row];
      by_start = by_start + bar;
      guess = vbd::adaptive_guess_bars(bar, a.qd[row], a.gravity[of < 0 ? a.last_world.value : of],
                                       h, to_vec3(last));
    }
  }
  by_start = by_start + by_target;
  if (is_held && a.have_targets == 0) by_start = by_start + to_vec3(a.x_bar[row]);
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
  // m/h^2, and 1/m in the target.
  const float by_inverse = math::dot(by_target, a.f[row]) * (h * h);
  if (a.by_mass != nullptr)
    a.by_mass[row] = is_held ? 0.0f : a.mass_bar[row] / (h * h) - (w * w) * by_inverse;
}

struct VbdTargetGradientArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<int32_t> held; Reads<VbdRow> x_bar; Number<int64_t> has_targets;
                    Writes<Vec3f> by_targets;)
};
NOVAPHY_ROW_KERNEL(vbd_target_gradient, VbdTargetGradientArguments) {
  a.by_targets[row] = a.has_targets != 0 ? to_vec3(a.x_bar[a.held[row]]) : Vec3f{};
}

struct VbdGravityGradientArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> begin;  // of each world, and behind the last
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

// Where the derivatives by the numbers of the slots of a role are.
struct VbdLawBars {
  const int64_t* places;  // of each corner of each element, among the lanes of the slots; -1: none
  const float* numbers;
  int64_t lanes;
};
struct VbdLawArguments {
  NOVAPHY_ARGUMENTS(Reads<int64_t> places; Reads<float> numbers;  // of all roles
                    Number<int64_t> first, lanes;                 // where those of the role begin
  )
};

namespace vbd {

inline VbdLawBars to_bars(const VbdLawArguments& a) {
  return {a.places, a.numbers + a.first, a.lanes};
}

// By a number of the slot of a corner.
template <Role role>
float weight_bar(const VbdLawBars& bars, int64_t element, int corner, int number) {
  const int64_t place = bars.places[element * kCorners[role] + corner];
  if (place < 0) return 0.0f;
  const int64_t slot = place / bars.lanes, lane = place - slot * bars.lanes;
  return bars.numbers[(slot * kFloats[role] + number) * bars.lanes + lane];
}
// By number k of the law of an element, over the corners that have it.
template <Role role>
float law_bar(const VbdLawBars& bars, int64_t element, int k) {
  constexpr int kFirst = law_begin(role);
  float sum = 0.0f;
  for (int c = 0; c < kCorners[role]; ++c) sum += weight_bar<role>(bars, element, c, kFirst + k);
  return sum;
}

inline void put(float* to, int64_t row, float value) {
  if (to != nullptr) to[row] = value;
}

// Of a Neo-Hookean law whose numbers are size times mu, size times ln, alpha, size times kd/h: by
// its material (3 columns) and activation. Returns that by the size.
template <Role role>
float put_elastic(const VbdLawBars& bars, int64_t e, float size, const float* material, float h,
                  float* to, float* activation) {
  const float mu = material[0], ln = material[0] + material[1];
  const float by_mu = law_bar<role>(bars, e, 0), by_ln = law_bar<role>(bars, e, 1),
              by_alpha = law_bar<role>(bars, e, 2), by_kd = law_bar<role>(bars, e, 3);
  const float inverse = 1.0f / math::max(ln, 1e-6f);
  const float by_lambda = ln > 1e-6f ? -(mu * inverse) * inverse : 0.0f;
  if (to != nullptr) {
    to[0] = (size * by_mu + size * by_ln) + by_alpha * (inverse + by_lambda);
    to[1] = size * by_ln + by_alpha * by_lambda;
    to[2] = (size / h) * by_kd;
  }
  if (activation != nullptr) *activation = -by_alpha;
  return (mu * by_mu + ln * by_ln) + (material[2] / h) * by_kd;
}

// By the inverse rest matrix, {n, n}: its row r is the weight of corner r + 1; that of corner 0 is
// minus their sum. A slot of corner c has the weights of the corners c + 1, c + 2, ...
template <Role role, int n>
void put_pose(const VbdLawBars& bars, int64_t e, float* to) {
  float by_corner[n + 1][n] = {};
  for (int c = 0; c <= n; ++c)
    for (int k = 0; k < n; ++k)
      for (int column = 0; column < n; ++column)
        by_corner[(c + 1 + k) % (n + 1)][column] += weight_bar<role>(bars, e, c, n * k + column);
  for (int row = 0; row < n; ++row)
    for (int column = 0; column < n; ++column)
      to[n * row + column] = by_corner[row + 1][column] - by_corner[0][column];
}

}  // namespace vbd

struct VbdSpringGradientArguments {
  NOVAPHY_ARGUMENTS(Part<VbdLawArguments> bars; Number<float> h;
                    Optional<Writes<float>> by_stiffness, by_damping, by_rest_length;)
};
NOVAPHY_ROW_KERNEL(vbd_spring_gradient, VbdSpringGradientArguments) {
  using namespace vbd;
  const VbdLawBars bars = to_bars(a.bars);
  put(a.by_stiffness, row, law_bar<kSpring>(bars, row, 0));
  put(a.by_damping, row, law_bar<kSpring>(bars, row, 1) / a.h.value);
  put(a.by_rest_length, row, law_bar<kSpring>(bars, row, 2));
}

struct VbdEdgeGradientArguments {
  NOVAPHY_ARGUMENTS(Part<VbdLawArguments> opposite, end; Reads<float> material, rest_length;
                    Number<float> h;
                    Optional<Writes<float>> by_material, by_rest_angle, by_rest_length;)
};
NOVAPHY_ROW_KERNEL(vbd_edge_gradient, VbdEdgeGradientArguments) {
  using namespace vbd;
  const VbdLawBars opposite = to_bars(a.opposite), end = to_bars(a.end);
  const auto bar = [&](int k) {
    return law_bar<kHingeOpposite>(opposite, row, k) + law_bar<kHingeEnd>(end, row, k);
  };
  const float* const c = a.material + 2 * row;
  const float length = a.rest_length[row], h = a.h.value;
  put(a.by_material, 2 * row, length * bar(0));
  put(a.by_material, 2 * row + 1, (length / h) * bar(1));
  put(a.by_rest_angle, row, bar(2));
  put(a.by_rest_length, row, c[0] * bar(0) + (c[1] / h) * bar(1));
}

struct VbdTriangleGradientArguments {
  NOVAPHY_ARGUMENTS(Part<VbdLawArguments> bars; Reads<float> area, material; Number<float> h;
                    Optional<Writes<float>> by_material, by_activation, by_area, by_pose;)
};
NOVAPHY_ROW_KERNEL(vbd_triangle_gradient, VbdTriangleGradientArguments) {
  using namespace vbd;
  const VbdLawBars bars = to_bars(a.bars);
  float* const to = a.by_material != nullptr ? a.by_material + 5 * row : nullptr;
  const float by_area =
      put_elastic<kTriangle>(bars, row, a.area[row], a.material + 5 * row, a.h.value, to,
                             a.by_activation != nullptr ? a.by_activation + row : nullptr);
  if (to != nullptr) to[3] = to[4] = 0.0f;
  put(a.by_area, row, by_area);
  if (a.by_pose != nullptr) put_pose<kTriangle, 2>(bars, row, a.by_pose + 4 * row);
}

struct VbdTetrahedronGradientArguments {
  NOVAPHY_ARGUMENTS(Part<VbdLawArguments> bars; Reads<Mat33f> pose; Reads<float> material;
                    Number<float> h; Optional<Writes<float>> by_material, by_activation, by_pose;)
};
NOVAPHY_ROW_KERNEL(vbd_tetrahedron_gradient, VbdTetrahedronGradientArguments) {
  using namespace vbd;
  const VbdLawBars bars = to_bars(a.bars);
  const Mat33f& pose = a.pose[row];
  const float volume = 1.0f / (math::determinant(pose) * 6.0f);
  const float by_volume =
      put_elastic<kTetrahedron>(bars, row, volume, a.material + 3 * row, a.h.value,
                                a.by_material != nullptr ? a.by_material + 3 * row : nullptr,
                                a.by_activation != nullptr ? a.by_activation + row : nullptr);
  if (a.by_pose == nullptr) return;
  float* const to = a.by_pose + 9 * row;
  put_pose<kTetrahedron, 3>(bars, row, to);
  // The volume is 1/(6 det), and the derivative of det by a row is the cross product of the others.
  const float by_det = -(by_volume * volume) * (volume * 6.0f);
  for (int r = 0; r < 3; ++r) {
    const Vec3f v = math::cross(math::row(pose, (r + 1) % 3), math::row(pose, (r + 2) % 3));
    const float of_row[3] = {v.x, v.y, v.z};
    for (int c = 0; c < 3; ++c) to[3 * r + c] += by_det * of_row[c];
  }
}

struct VbdRadiusGradientArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<int32_t>> contact_begin;  // null: no contacts
                    Optional<Reads<float>> contact_bars; WritesRow<float> by_radius;)
};
NOVAPHY_ROW_KERNEL(vbd_radius_gradient, VbdRadiusGradientArguments) {
  float sum = 0.0f;
  if (a.contact_begin != nullptr)
    for (int32_t k = a.contact_begin[row]; k < a.contact_begin[row + 1]; ++k)
      sum += a.contact_bars[static_cast<int64_t>(k) * vbd::kContactLawFloats];
  a.by_radius[row] = sum;
}

// The shape of each contact, in the order of the particles; -1 behind the last.
struct VbdContactShapeArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> begin, items; Number<int64_t> particles; Reads<int32_t> shape;
                    WritesRow<int32_t> shape_of_contact;)
};
NOVAPHY_ROW_KERNEL(vbd_contact_shape, VbdContactShapeArguments) {
  a.shape_of_contact[row] = row < a.begin[a.particles] ? a.shape[a.items[row]] : -1;
}

struct VbdShapeGradientArguments {
  NOVAPHY_ARGUMENTS(Optional<Reads<int32_t>>
                        begin;  // of the contacts of each shape, and behind the last; null: none
                    Optional<Reads<int32_t>> contacts;  // in the order of the particles
                    Optional<Reads<float>> contact_bars; ReadsRow<float> mu;
                    Number<float> model_mu, h;
                    Optional<Writes<float>> by_margin, by_ke, by_kd, by_mu;)
};
NOVAPHY_ROW_KERNEL(vbd_shape_gradient, VbdShapeGradientArguments) {
  float margin = 0.0f, ke = 0.0f, kd = 0.0f, mu = 0.0f;
  const float mean = math::sqrt(a.model_mu.value * a.mu[row]);
  if (a.begin != nullptr)
    for (int32_t k = a.begin[row]; k < a.begin[row + 1]; ++k) {
      const float* const bar =
          a.contact_bars + static_cast<int64_t>(a.contacts[k]) * vbd::kContactLawFloats;
      margin += bar[0];
      ke += 0.5f * bar[1];
      kd += (0.5f * bar[2]) / a.h.value;
      if (mean > 0.0f) mu += bar[3] * (a.model_mu.value / (2.0f * mean));
    }
  vbd::put(a.by_margin, row, margin);
  vbd::put(a.by_ke, row, ke);
  vbd::put(a.by_kd, row, kd);
  vbd::put(a.by_mu, row, mu);
}

}  // namespace novaphy
