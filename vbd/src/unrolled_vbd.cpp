#include "novaphy/vbd/unrolled_vbd.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "novaphy/core/error.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/math/matrix.h"
#include "receivers.h"
#include "step_work.h"

namespace novaphy {
namespace {

using vbd::Row;

constexpr int64_t kGroupsPerChunk = 4;
constexpr int64_t kParticlesPerChunk = 256;

void check_covered(const VbdOptions& o) {
  const auto refuse = [](bool given, const char* option) {
    require(!given, ErrorKind::NotImplemented, "DiffSolverVBD: ", option,
            ": its gradient is not there yet");
  };
  refuse(o.acceleration.has_value(), "acceleration");
  refuse(o.tolerance.has_value(), "tolerance");
  refuse(o.safeguard, "safeguard");
  refuse(o.initial_guess == VbdInitialGuess::Adaptive, "initial_guess \"adaptive\"");
}

float* floats(std::vector<Row>& rows) { return reinterpret_cast<float*>(rows.data()); }

}  // namespace

struct UnrolledVbd::Work {
  Work(const Model& model, const VbdOptions& options) : step(model, options, true) {}

  void prepare(const VbdStepInputs& in) {
    step.update(in.tri_activation, in.tet_activation, in.contacts, in.dt);
    const size_t n = step.x.size();
    for (std::vector<Row>* rows : {&x_bar, &own_bar, &start_bar, &target_bar}) rows->assign(n, {});
    if (builds != step.builds) {
      receivers.build(step.slots, step.model.particle_count());
      builds = step.builds;
    }
    for (int role = 0; role < vbd::kRoles; ++role) {
      const size_t lanes = step.slots.table(static_cast<vbd::Role>(role)).sources.size();
      others[role].resize(lanes * 3 * static_cast<size_t>(vbd::kOthers[role]));
      laws[role].assign(lanes * law_count(role), 0.0f);
      bars.others[role] = others[role].data();
      bars.laws[role] = laws[role].data();
    }
    bars.x = floats(x_bar);
    bars.own = floats(own_bar);
    bars.start = floats(start_bar);
    bars.target = floats(target_bar);
  }

  static size_t law_count(int role) {
    return static_cast<size_t>(vbd::kLawFloats[role] + vbd::kStartFloats[role]);
  }

  // Back through the step of one colour, whose particles stood at `before`.
  void reverse_color(size_t color, const std::vector<Row>& before) {
    const std::vector<int64_t>& colors = step.slots.color_begin();
    const auto lanes = static_cast<int64_t>(step.level.lanes);
    std::fill(own_bar.begin(), own_bar.end(), Row());
    for (int64_t k = colors[color] * lanes; k < colors[color + 1] * lanes; ++k) {
      const auto p = static_cast<size_t>(step.sweep.particle[k]);
      step.x[p] = before[p];
    }
    for_groups(colors[color], colors[color + 1], step.level.adjoint);
    receive(color, color + 1, x_bar);
  }

  template <class Function>
  void for_groups(int64_t begin, int64_t end, Function&& function) {
    for_chunks(end - begin, kGroupsPerChunk, [&](int64_t first, int64_t last, int64_t) {
      for (int64_t g = begin + first; g < begin + last; ++g) function(step.sweep, bars, g);
    });
  }

  // Adds what slots of some colours computed for every particle.
  void receive(size_t first_color, size_t last_color, std::vector<Row>& rows) {
    const auto lanes = static_cast<size_t>(step.level.lanes);
    for_chunks(static_cast<int64_t>(rows.size()), kParticlesPerChunk,
               [&](int64_t begin, int64_t end, int64_t) {
                 for (int64_t p = begin; p < end; ++p) {
                   Vec3f sum =
                       Vec3f(rows[static_cast<size_t>(p)]) + Vec3f(own_bar[static_cast<size_t>(p)]);
                   for (size_t color = first_color; color < last_color; ++color)
                     for (const auto& [role, offset] : receivers.of(color, p)) {
                       const float* const v = others[role].data() + offset;
                       sum = sum + Vec3f{v[0], v[lanes], v[2 * lanes]};
                     }
                   rows[static_cast<size_t>(p)] = sum;
                 }
               });
  }

  void reverse(const Vec3f* q_bar, const Vec3f* qd_bar) {
    const float inverse_h = 1.0f / step.constants.dt;
    for (size_t p = 0; p < x_bar.size(); ++p) {
      const Vec3f by_v = qd_bar != nullptr ? qd_bar[p] * inverse_h : Vec3f{};
      x_bar[p] = (q_bar != nullptr ? q_bar[p] : Vec3f{}) + by_v;
      start_bar[p] = -by_v;
    }
    const size_t colors = step.slots.color_begin().size() - 1;
    for (size_t k = step.iterates.size() - 1; k-- > 0;)
      for (size_t color = colors; color-- > 0;) reverse_color(color, step.iterates[k]);

    const bool from_target = step.options.initial_guess == VbdInitialGuess::Inertia;
    for (size_t p = 0; p < x_bar.size(); ++p) {
      const bool held = step.slots.is_held(static_cast<int32_t>(p));
      std::vector<Row>& guess = from_target && !held ? target_bar : start_bar;
      guess[p] = Vec3f(guess[p]) + Vec3f(x_bar[p]);
    }
    std::fill(own_bar.begin(), own_bar.end(), Row());
    for_groups(0, step.slots.color_begin().back(), step.level.adjoint_start);
    receive(0, colors, start_bar);
  }

  void put_state(const VbdStepGradients& g) const {
    const float h = step.constants.dt;
    const float* const inv_mass = step.model.particle_inv_mass.data();
    for (size_t p = 0; p < x_bar.size(); ++p) {
      const Vec3f by_target = target_bar[p];
      if (g.particle_q != nullptr) g.particle_q[p] = Vec3f(start_bar[p]) + by_target;
      if (g.particle_qd != nullptr) g.particle_qd[p] = by_target * h;
      if (g.particle_f != nullptr) g.particle_f[p] = by_target * ((h * h) * inv_mass[p]);
    }
  }

  // The derivative by number k of the law of an element, over the corners that have it.
  float law_bar(vbd::Role role, size_t element, size_t k) const {
    const vbd::ColorSlots::Table& table = step.slots.table(role);
    const auto lanes = static_cast<size_t>(step.level.lanes);
    float sum = 0.0f;
    for (size_t c = 0; c < table.corners; ++c) {
      const int64_t place = table.places[element * table.corners + c];
      if (place < 0) continue;
      const size_t slot = static_cast<size_t>(place) / lanes,
                   lane = static_cast<size_t>(place) % lanes;
      sum += laws[role][(slot * law_count(role) + k) * lanes + lane];
    }
    return sum;
  }

  // Of a Neo-Hookean law whose numbers are size times mu, size times ln, alpha, size times kd/h: by
  // its material (3 columns) and activation.
  void put_elastic(vbd::Role role, size_t e, float size, const float* material, float* to,
                   float* activation) const {
    const float mu = material[0], ln = material[0] + material[1];
    const float by_alpha = law_bar(role, e, 2), by_ln = size * law_bar(role, e, 1);
    const float inverse = 1.0f / std::max(ln, 1e-6f);
    const float by_lambda = ln > 1e-6f ? -(mu * inverse) * inverse : 0.0f;
    if (to != nullptr) {
      to[0] = (size * law_bar(role, e, 0) + by_ln) + by_alpha * (inverse + by_lambda);
      to[1] = by_ln + by_alpha * by_lambda;
      to[2] = (size / step.constants.dt) * law_bar(role, e, 3);
    }
    if (activation != nullptr) *activation = -by_alpha;
  }

  void put_materials(const VbdStepGradients& g) const {
    const Model& m = step.model;
    const float inverse_h = 1.0f / step.constants.dt;
    const auto put = [](float* to, size_t row, float value) {
      if (to != nullptr) to[row] = value;
    };
    for (size_t e = 0; e < m.particle_spring_indices.rows(); ++e) {
      put(g.particle_spring_stiffness, e, law_bar(vbd::kSpring, e, 0));
      put(g.particle_spring_damping, e, inverse_h * law_bar(vbd::kSpring, e, 1));
      put(g.particle_spring_rest_length, e, law_bar(vbd::kSpring, e, 2));
    }
    for (size_t e = 0; e < m.particle_tri_indices.rows(); ++e) {
      float* const to =
          g.particle_tri_material != nullptr ? g.particle_tri_material + 5 * e : nullptr;
      put_elastic(vbd::kTriangle, e, m.particle_tri_area.data()[e],
                  m.particle_tri_material.data() + 5 * e, to,
                  g.particle_tri_activation != nullptr ? g.particle_tri_activation + e : nullptr);
      if (to != nullptr) to[3] = to[4] = 0.0f;
    }
    for (size_t e = 0; e < m.particle_edge_indices.rows(); ++e) {
      const auto bar = [&](size_t k) {
        return law_bar(vbd::kHingeOpposite, e, k) + law_bar(vbd::kHingeEnd, e, k);
      };
      const float length = m.particle_edge_rest_length.data()[e];
      put(g.particle_edge_material, 2 * e, length * bar(0));
      put(g.particle_edge_material, 2 * e + 1, (length * inverse_h) * bar(1));
      put(g.particle_edge_rest_angle, e, bar(2));
    }
    for (size_t e = 0; e < m.particle_tet_indices.rows(); ++e)
      put_elastic(vbd::kTetrahedron, e,
                  1.0f / (math::determinant(m.particle_tet_pose.data()[e]) * 6.0f),
                  m.particle_tet_material.data() + 3 * e,
                  g.particle_tet_material != nullptr ? g.particle_tet_material + 3 * e : nullptr,
                  g.particle_tet_activation != nullptr ? g.particle_tet_activation + e : nullptr);
  }

  vbd::StepWork step;
  vbd::Receivers receivers;
  vbd::Adjoint bars;
  std::vector<Row> x_bar, own_bar, start_bar, target_bar;
  std::vector<float> others[vbd::kRoles], laws[vbd::kRoles];
  std::vector<Vec3f> q_out, qd_out;
  VbdResidual last_residual;  // of the last backward
  bool has_gone_back = false;
  uint64_t builds = 0;  // of the tables that the receivers were made from
  ExclusiveUse in_use;
};

UnrolledVbd::UnrolledVbd(std::shared_ptr<const Model> model, const VbdOptions& options)
    : model_(std::move(model)) {
  check_covered(options);
  SolverVBD(model_, options);  // makes its checks
  work_ = std::make_unique<Work>(*model_, options);
}

UnrolledVbd::~UnrolledVbd() = default;

VbdResidual UnrolledVbd::residual() const {
  require(work_->has_gone_back, ErrorKind::Runtime,
          "DiffSolverVBD.gradient_info: expected a backward before");
  return work_->last_residual;
}

void UnrolledVbd::forward(const VbdStepInputs& in, Vec3f* q_out, Vec3f* qd_out) {
  const ExclusiveUse::Scope scope(work_->in_use, "UnrolledVbd.forward", "the solver");
  model_->update_derived();
  work_->step.update(in.tri_activation, in.tet_activation, in.contacts, in.dt);
  work_->step.run({in.particle_q, in.particle_qd, in.particle_f, q_out, qd_out}, nullptr);
}

void UnrolledVbd::backward(const VbdStepInputs& in, const Vec3f* q_out_bar, const Vec3f* qd_out_bar,
                           const VbdStepGradients& gradients) {
  const ExclusiveUse::Scope scope(work_->in_use, "UnrolledVbd.backward", "the solver");
  Work& w = *work_;
  model_->update_derived();
  w.prepare(in);
  w.q_out.resize(w.step.x.size());
  w.qd_out.resize(w.step.x.size());
  w.step.run({in.particle_q, in.particle_qd, in.particle_f, w.q_out.data(), w.qd_out.data()},
             nullptr);
  w.last_residual = w.step.residual();
  w.has_gone_back = true;
  w.reverse(q_out_bar, qd_out_bar);
  w.put_state(gradients);
  w.put_materials(gradients);
}

}  // namespace novaphy
