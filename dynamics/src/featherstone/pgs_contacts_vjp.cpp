// The adjoint of a step with contacts, by the set of rows that are active (articulation/pgs.h).
//
// With the converged impulses lambda, v' solves M (v' - v) = J^T lambda together with one row per
// active direction:
//   breaking (lambda_n = 0)             no row
//   normal                              J_n v' + beta + cfm lambda_n = 0
//   sticking                            J_t v' = 0
//   sliding                             lambda_t + mu lambda_n t = 0, t = w_t / |w_t|, w_t = J_t v'
//   sliding of a pyramid's tangent      lambda_t -+ mu lambda_n = 0
//   dry friction that holds its dof     v'_k = 0; else a constant: lambda -+ friction dt = 0
// Rows move velocities by B J (B 3 x 3 per contact: 1; a sliding cone mu lambda_n (1 - t
// t^T)/|w_t|) and impulses by R. With the gradient g of v':
//   (J M^-1 J^T B^T + R^T) z = J M^-1 g,   gradient of M v:  p = M^-1 (g - J^T B^T z)
// so B^T z, as pushes at the contacts, leaves g, and the adjoint without contacts does the rest.
// A material p gives -z . d(rows)/dp, dry friction +-dt p_k. What is left is the geometry: J's own
// change with q in  -lambda . (J of p) + (B^T z) . (J of v'). Turning by S_k all that hangs on link
// i changes a motion T of link b by S_k x (T_b - T_i). Source: Featherstone (2008), section 3.3,
// for motions; the implicit function theorem.
#include <algorithm>
#include <cmath>

#include "novaphy/core/sim/for_chunks.h"
#include "pgs_branches.h"
#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr int64_t kTreeChunk = 8;
constexpr float kSameFriction = 1e-4f;  // 1
constexpr double kDependent = 1e-5;     // of a normal that others make up, relative
constexpr float kConverged = 1e-5f;     // m/s
constexpr float kNearNormal = 1e-5f;    // m/s
constexpr float kNearGap = 1e-6f;       // m
constexpr float kNearCone = 1e-3f;      // 1

float length(float x, float y) { return math::sqrt(x * x + y * y); }

// The slip along the tangents, where one of them slides.
struct Slip {
  Slip(const art::PgsContact<float>& c, const ContactBranch& branch) {
    if (!branch.slides[0] && !branch.slides[1]) return;
    for (int i = 0; i < 2; ++i) along[i] = art::slip(c, i + 1);
  }
  double along[2] = {};
};

// What the rows of two contacts share: J_i of a times Y_j of b.
double coupling(const art::PgsContact<float>& a, int i, const art::PgsContact<float>& b, int j) {
  double sum = 0.0;
  for (const art::RowSide<float>& s : a.sides)
    for (const art::RowSide<float>& t : b.sides)
      if (t.response != nullptr && s.rates == t.rates)
        sum += art::row_dot(s.jacobian + i * s.width, t.response + j * t.width, s.width);
  return sum;
}

}  // namespace

void PgsContacts::write_impulses(Vec3f* impulses, float* friction) const {
  for (size_t i = 0; i < friction_.size(); ++i)
    friction[trees_[friction_[i].tree].first_dof + friction_[i].dof] = friction_rows_[i].impulse;
  for (const Row& row : rows_)
    impulses[row.contact] = {row.solver.impulse[0], row.solver.impulse[1], row.solver.impulse[2]};
}

// Whether the result depends on how the sweeps shared the force among normals that depend on each
// other, as those of a box's face do: where contacts slide, and the friction for a unit of normal
// force is not the same for all of them. The adjoint shares in its own way.
bool PgsContacts::sharing_matters(int64_t island, bool cone) {
  active_.clear();
  bool slides = false, same = true;
  Vec3f first{};
  for (const int32_t i : island_rows_.items(island)) {
    const Row& row = rows_[static_cast<size_t>(i)];
    const art::PgsContact<float>& c = row.solver;
    if (c.impulse[0] <= 0.0f || c.cfm > 0.0f) continue;
    const ContactBranch branch = branch_of(c, cone);
    slides = slides || (c.friction > 0.0f && (branch.slides[0] || branch.slides[1]));
    const Vec3f friction = (row.frame.axes[1] * c.impulse[1] + row.frame.axes[2] * c.impulse[2]) *
                           (1.0f / c.impulse[0]);
    if (active_.empty()) first = friction;
    const Vec3f other = friction - first;
    same = same && math::dot(other, other) <= kSameFriction * kSameFriction;
    active_.push_back(i);
  }
  if (!slides || same) return false;
  // A factor L L^T of the normals' part of the system loses a pivot where they depend.
  const size_t n = active_.size();
  const auto normals = [&](size_t a, size_t b) {
    return coupling(rows_[static_cast<size_t>(active_[a])].solver, 0,
                    rows_[static_cast<size_t>(active_[b])].solver, 0);
  };
  system_.assign(n * n, 0.0);
  for (size_t i = 0; i < n; ++i)
    for (size_t j = 0; j <= i; ++j) {
      double left = normals(i, j);
      const double whole = left;
      for (size_t k = 0; k < j; ++k) left -= system_[i * n + k] * system_[j * n + k];
      if (i == j && left <= kDependent * whole) return true;
      system_[i * n + j] = i == j ? std::sqrt(left) : left / system_[j * n + j];
    }
  return false;
}

void PgsContacts::add_branches(ContactBranches& to, const FeatherstoneOptions& options,
                               bool by_restitution) {
  if (rows_.empty() && friction_.empty()) return;
  const bool cone = options.friction_cone == FrictionCone::Cone;
  // Where beta has another slope on the other side.
  const bool at_contact =
      options.compliant_contacts || options.pgs_slop > 0.0f || options.pgs_erp < 1.0f;
  const bool at_slop =
      !options.compliant_contacts && options.pgs_slop > 0.0f && options.pgs_erp > 0.0f;
  bool exact = residual_ < kConverged;
  int64_t held = 0;
  for (const Row& row : rows_) {
    const art::PgsContact<float>& c = row.solver;
    const ContactBranch branch = branch_of(c, cone);
    const bool jumps = !row.elastic && row.before < -options.restitution_threshold;
    exact = exact && !(by_restitution && jumps);
    const float normal =
        branch.active ? c.impulse[0] * c.normal : std::fabs(art::slip(c, 0) + c.bias);
    to.normal_margin = std::min(to.normal_margin, normal);
    exact = exact && normal >= kNearNormal;
    if (!branch.active) {
      ++to.breaking;
      continue;
    }
    ++(branch.slides[0] || branch.slides[1] ? to.sliding : to.sticking);
    if (!row.follows) ++held;
    float gap = ContactBranches::kNone;
    if (at_contact) gap = std::fabs(row.place.gap);
    if (at_slop) gap = std::min(gap, std::fabs(row.place.gap + options.pgs_slop));
    to.gap_margin = std::min(to.gap_margin, gap);
    exact = exact && gap >= kNearGap;
    const float limit = c.friction * c.impulse[0];
    const float most = cone ? length(c.impulse[1], c.impulse[2])
                            : std::max(std::fabs(c.impulse[1]), std::fabs(c.impulse[2]));
    if (!(limit > 0.0f)) continue;  // without friction there is no cone
    if (branch.slides[0] || branch.slides[1]) {
      const float slip = length(art::slip(c, 1), art::slip(c, 2));
      to.slip_margin = std::min(to.slip_margin, slip);
      exact = exact && slip >= kNearNormal;
    } else {
      to.cone_margin = std::min(to.cone_margin, 1.0f - most / limit);
      exact = exact && 1.0f - most / limit >= kNearCone;
    }
  }
  for (size_t i = 0; i < friction_.size(); ++i) {
    const art::PgsJointFriction<float>& f = friction_rows_[i];
    if (sticks(static_cast<int32_t>(i))) {
      const float margin = 1.0f - std::fabs(f.impulse) / f.limit;
      to.cone_margin = std::min(to.cone_margin, margin);
      exact = exact && margin >= kNearCone;
    } else {
      const float rate = std::fabs(f.rates[f.dof]);
      to.slip_margin = std::min(to.slip_margin, rate);
      exact = exact && rate >= kNearNormal;
    }
  }
  for (size_t island = 0; exact && island < island_sweeps_.size(); ++island)
    exact = !sharing_matters(static_cast<int64_t>(island), cone);
  ++to.steps;
  to.held += held;
  if (exact) ++(held == 0 ? to.exact : to.frozen);
  to.residual = std::max(to.residual, residual_);
}

art::AdjointMemory<float> PgsContacts::adjoint(int64_t tree) {
  const ArticulationRows& rows = trees_[tree];
  return art::make_adjoint_memory<float>(
      adjoint_.data() + adjoint_begin_[static_cast<size_t>(tree)], rows.link_count, rows.dof_count);
}

bool PgsContacts::sticks(int32_t friction) const {
  const art::PgsJointFriction<float>& row = friction_rows_[static_cast<size_t>(friction)];
  return std::fabs(row.impulse) < row.limit * (1.0f - kSlides);
}

// z of an island: multipliers_, and pulls_, B^T z, which leave the gradients of the rates, as does
// z of dry friction.
void PgsContacts::solve_adjoint(int64_t island, bool cone) {
  active_.clear();
  for (const int32_t i : island_rows_.items(island))
    if (rows_[static_cast<size_t>(i)].solver.impulse[0] > 0.0f) active_.push_back(i);
  sticking_.clear();
  for (const int32_t i : island_friction_.items(island))
    if (sticks(i)) sticking_.push_back(i);
  const size_t contacts = 3 * active_.size();
  const size_t n = contacts + sticking_.size(), width = n + 1;
  system_.assign(n * width, 0.0);
  for (size_t f = 0; f < sticking_.size(); ++f) {
    const art::PgsJointFriction<float>& row = friction_rows_[static_cast<size_t>(sticking_[f])];
    const int32_t tree = friction_[static_cast<size_t>(sticking_[f])].tree;
    double* const to = system_.data() + (contacts + f) * width;
    for (size_t e = 0; e < sticking_.size(); ++e) {
      const Friction& other = friction_[static_cast<size_t>(sticking_[e])];
      if (other.tree == tree) to[contacts + e] = row.response[other.dof];
    }
    to[contacts + f] += kRegularity * to[contacts + f];
    const float* const g = adjoint(tree).rate;
    for (int32_t x = 0; x < trees_[tree].dof_count; ++x) to[n] += double{row.response[x]} * g[x];
  }
  for (size_t d = 0; d < active_.size(); ++d) {
    const art::PgsContact<float>& other = rows_[static_cast<size_t>(active_[d])].solver;
    const ContactBranch branch = branch_of(other, cone);
    const ContactBlocks k = blocks_of(other, branch, cone, Slip(other, branch).along);
    for (size_t c = 0; c < active_.size(); ++c) {
      const art::PgsContact<float>& one = rows_[static_cast<size_t>(active_[c])].solver;
      for (int i = 0; i < 3; ++i) {
        double a[3];
        for (int j = 0; j < 3; ++j) a[j] = coupling(one, i, other, j);
        double* const row = system_.data() + (3 * c + static_cast<size_t>(i)) * width + 3 * d;
        for (int e = 0; e < 3; ++e) {
          row[e] = (a[0] * k.b[e][0] + a[1] * k.b[e][1]) + a[2] * k.b[e][2];
          if (c != d) continue;
          row[e] += k.r[e][i];
          const bool slides = i > 0 && branch.slides[i - 1];
          if (e == i && !slides) row[e] += kRegularity * a[i];
        }
      }
    }
    // J M^-1 g: Y times the gradient of the rates.
    for (int i = 0; i < 3; ++i) {
      for (size_t f = 0; f < sticking_.size(); ++f) {
        const auto at = static_cast<size_t>(sticking_[f]);
        const Friction& dry = friction_[at];
        double y[3] = {};  // of the contact's rows, for the dof
        for (size_t side = 0; side < 2; ++side) {
          const art::RowSide<float>& s = other.sides[side];
          if (s.width == 0 || s.rates != friction_rows_[at].rates) continue;
          for (int j = 0; j < 3; ++j) y[j] += s.response[j * s.width + dry.dof];
        }
        system_[(3 * d + static_cast<size_t>(i)) * width + 3 * active_.size() + f] = y[i];
        double& back = system_[(3 * active_.size() + f) * width + 3 * d + static_cast<size_t>(i)];
        back = (y[0] * k.b[i][0] + y[1] * k.b[i][1]) + y[2] * k.b[i][2];
      }
      double sum = 0.0;
      for (size_t side = 0; side < 2; ++side) {
        const art::RowSide<float>& s = other.sides[side];
        if (s.response == nullptr) continue;
        const int32_t tree = rows_[static_cast<size_t>(active_[d])].sides[side].tree;
        const float* const g = adjoint(tree).rate;
        for (int32_t x = 0; x < trees_[tree].dof_count; ++x)
          sum += double{s.response[i * s.width + x]} * g[x];
      }
      system_[(3 * d + static_cast<size_t>(i)) * width + n] = sum;
    }
  }
  solve_dense(system_, n);
  for (size_t d = 0; d < active_.size(); ++d) {
    const auto at = static_cast<size_t>(active_[d]);
    const Row& row = rows_[at];
    const ContactBranch branch = branch_of(row.solver, cone);
    const ContactBlocks k = blocks_of(row.solver, branch, cone, Slip(row.solver, branch).along);
    double z[3], pull[3];
    for (size_t e = 0; e < 3; ++e) z[e] = system_[(3 * d + e) * width + n];
    for (int j = 0; j < 3; ++j) pull[j] = (z[0] * k.b[0][j] + z[1] * k.b[1][j]) + z[2] * k.b[2][j];
    pulls_[at] = {static_cast<float>(pull[0]), static_cast<float>(pull[1]),
                  static_cast<float>(pull[2])};
    multipliers_[at] = {static_cast<float>(z[0]), static_cast<float>(z[1]),
                        static_cast<float>(z[2])};
  }
  for (size_t f = 0; f < sticking_.size(); ++f) {
    const Friction& dry = friction_[static_cast<size_t>(sticking_[f])];
    float& g = adjoint(dry.tree).rate[dry.dof];
    g -= static_cast<float>(system_[(contacts + f) * width + n]);
  }
  for (const int32_t i : active_) {
    const Row& row = rows_[static_cast<size_t>(i)];
    const Vec3f& p = pulls_[static_cast<size_t>(i)];
    const float pull[3] = {p.x, p.y, p.z};
    for (size_t side = 0; side < 2; ++side) {
      const art::RowSide<float>& s = row.solver.sides[side];
      if (s.width == 0) continue;
      const int32_t tree = row.sides[side].tree;
      float* const g = adjoint(tree).rate;
      for (int r = 0; r < 3; ++r)
        for (int32_t x = 0; x < trees_[tree].dof_count; ++x)
          g[x] -= s.jacobian[r * s.width + x] * pull[r];
    }
  }
}

// A row's own change with q, and of a bounce with qd, into the gradients of its trees. The midpoint
// moves with half of each core, and below a point that is followed with all of its movement along
// the plane. Of the links, w is the motion of lambda = dt p, a_adjoint that of v' and v that of qd.
// `push` is lambda of the row over dt, `pull` B^T z, in the world; `normal` the z of the normal.
void PgsContacts::add_geometry(const Row& row, const Vec3f& push, const Vec3f& pull, float normal,
                               const ArticulationArguments& in) {
  const Vec3f bounce = row.frame.axes[0] * (normal * row.target.bounce);
  const Vec3f forces[3] = {-push, pull, bounce};
  const Vec3f points[2] = {row.place.a, row.place.b};
  SpatialVectorf motions[2][3] = {};
  Vec3f by_point{};  // how the sum changes with the midpoint
  for (size_t side = 0; side < 2; ++side) {
    const Side& at = row.sides[side];
    if (at.tree < 0) continue;
    const art::LinkState<float>& s = workspace(trees_[at.tree], at.tree).links[at.link];
    const SpatialVectorf of[3] = {s.w, s.a_adjoint, s.v};
    for (size_t f = 0; f < 3; ++f) {
      motions[side][f] = of[f];
      by_point = by_point + math::cross(forces[f], of[f].angular) * (side == 0 ? -0.5f : 0.5f);
    }
  }
  if (row.follows) {
    const Vec3f& n = row.frame.axes[0];
    by_point = by_point * 2.0f - n * math::dot(n, by_point);
  }
  for (size_t side = 0; side < 2; ++side) {
    const Side& at = row.sides[side];
    if (at.tree < 0) continue;
    const float sign = side == 0 ? -1.0f : 1.0f;
    const Vec3f by_core = by_point + row.frame.axes[0] * (sign * normal * row.target.slope);
    const ArticulationRows& rows = trees_[at.tree];
    const art::Tree<float> tree = articulation_tree(in, rows);
    const art::Workspace<float> ws = workspace(rows, at.tree);
    art::AdjointMemory<float> memory = adjoint(at.tree);
    for (int32_t i = at.link; i >= 0; i = tree.links[i].parent) {
      const art::Link& link = tree.links[i];
      const art::LinkState<float>& s = ws.links[i];
      const SpatialVectorf own[3] = {s.w, s.a_adjoint, s.v};
      // The rates of a FREE joint are about its centre of mass, which moves with its translation
      // and with body_com: how they turn, without what carries the joint.
      Vec3f turning[3] = {};
      if (art::is_free(link)) {
        const art::LinkState<float> world{},
            &parent = link.parent < 0 ? world : ws.links[link.parent];
        const SpatialVectorf carried[3] = {parent.w, parent.a_adjoint, parent.v};
        Vec3f by_com{};
        for (size_t f = 0; f < 3; ++f) {
          turning[f] = own[f].angular - carried[f].angular;
          by_com = by_com + math::cross(turning[f], forces[f]);
        }
        memory.moved_com[i] = memory.moved_com[i] - math::rotate_inverse(s.q, by_com * sign);
      }
      for (int32_t j = 0; j < link.dofs; ++j) {
        const int32_t k = art::local_dof(tree, link) + j;
        const SpatialVectorf& axis = ws.axes[k];
        float sum = math::dot(by_core, math::motion_at(axis, row.cores[side]).linear);
        for (size_t f = 0; f < 3; ++f) {
          SpatialVectorf d = math::cross_motion(axis, motions[side][f] - own[f]);
          if (art::is_free(link) && j < 3)
            d.linear = d.linear + math::cross(axis.linear, turning[f]);
          sum += sign * math::dot(forces[f], math::motion_at(d, points[side]).linear);
        }
        memory.tangent[k] -= sum;
        if (row.target.bounce > 0.0f)
          memory.rate[k] -= sign * math::dot(bounce, math::motion_at(axis, points[side]).linear);
      }
    }
  }
}

// -z . d(rows)/dp of a contact, half of it to each of the two shapes: of their means.
void PgsContacts::add_material_gradients(const Step& s, const Row& row, const double* z,
                                         const ContactGradient& to) const {
  const art::PgsContact<float>& c = row.solver;
  const auto give = [&](float* gradient, double value) {
    if (gradient == nullptr) return;
    for (const int32_t* shapes : {s.contacts.shape0, s.contacts.shape1})
      gradient[shapes[row.contact]] += static_cast<float>(0.5 * value);
  };
  if (to.mu == nullptr && to.restitution == nullptr && to.ke == nullptr && to.kd == nullptr) return;
  double by_friction[2];
  const ContactBranch branch = branch_of(c, s.law.cone);
  rows_by_friction(c, branch, s.law.cone, Slip(c, branch).along, by_friction);
  give(to.mu, -(z[1] * by_friction[0] + z[2] * by_friction[1]));
  if (row.target.bounce > 0.0f) give(to.restitution, -z[0] * row.before);
  if (!s.law.compliant) return;
  const art::ContactMaterial<float> of = s.material(row);
  const double dt = s.law.dt, soft = dt * of.stiffness + of.damping;
  const bool spring =
      !(row.place.gap > 0.0f) && !(row.target.bounce > 0.0f) && c.bias > -s.law.max_depenetration;
  const double gap = spring ? row.place.gap : 0.0, impulse = c.impulse[0];
  give(to.ke, -z[0] * (gap * of.damping - impulse) / (soft * soft));
  give(to.kd, -z[0] * (-gap * of.stiffness - impulse / dt) / (soft * soft));
}

// +-lambda of the dofs that slide against their friction, and of those without it as if they had.
void PgsContacts::add_friction_gradients(float* to) {
  std::vector<float>& push = friction_push_;
  size_t dofs = 0;
  for (int64_t i = 0; i < count_; ++i) dofs += static_cast<size_t>(trees_[i].dof_count);
  push.resize(dofs);
  for (int64_t i = 0; i < count_; ++i)
    for (int32_t k = 0; k < trees_[i].dof_count; ++k) {
      const float rate = rates_[static_cast<size_t>(rates_begin_[static_cast<size_t>(i)] + k)];
      push[static_cast<size_t>(trees_[i].first_dof + k)] =
          rate > 0.0f ? -1.0f : (rate < 0.0f ? 1.0f : 0.0f);
    }
  for (size_t i = 0; i < friction_.size(); ++i) {
    const float impulse = friction_rows_[i].impulse;
    const int32_t row = trees_[friction_[i].tree].first_dof + friction_[i].dof;
    push[static_cast<size_t>(row)] =
        sticks(static_cast<int32_t>(i)) ? 0.0f : (impulse < 0.0f ? -1.0f : 1.0f);
  }
  for (int64_t i = 0; i < count_; ++i)
    for (int32_t k = 0; k < trees_[i].dof_count; ++k) {
      const int32_t row = trees_[i].first_dof + k;
      to[row] += push[static_cast<size_t>(row)] * adjoint(i).scratch[k];
    }
}

void PgsContacts::vjp(const ArticulationStepVjpArguments& a, const Model& m,
                      const ContactRows& contacts, const Vec3f* impulses, const float* friction,
                      const FeatherstoneOptions& options, const ContactGradient& more) {
  const art::StepInputs<float> in = articulation_inputs(a.in);
  const art::StepOptions<float> how = articulation_options(a.in);
  if (adjoint_.empty()) {
    int64_t words = 0;
    for (int64_t i = 0; i < count_; ++i) {
      adjoint_begin_.push_back(words);
      words += art::adjoint_bytes<float>(trees_[i].link_count, trees_[i].dof_count) / 8 + 1;
    }
    adjoint_.resize(static_cast<size_t>(words));
  }
  const auto for_trees = [&](const auto& f) {
    for_chunks(count_, kTreeChunk, [&](int64_t begin, int64_t end, int64_t) {
      for (int64_t i = begin; i < end; ++i) {
        art::Workspace<float> ws = workspace(trees_[i], i);
        art::AdjointMemory<float> memory = adjoint(i);
        f(trees_[i], articulation_tree(a.in, trees_[i]), ws, memory,
          rates_.data() + rates_begin_[static_cast<size_t>(i)]);
      }
    });
  };
  for_trees([&](const ArticulationRows& rows, const art::Tree<float>& tree,
                art::Workspace<float>& ws, art::AdjointMemory<float>& memory, float* rates) {
    art::step_vjp_rates(tree, in, how, a.qdd, a.branch, a.q_next, a.qd_next, a.out, a.gradient, ws,
                        memory);
    art::step_vjp_dynamics(tree, in, how, ws);
    for (int32_t k = 0; k < rows.dof_count; ++k)
      rates[k] = in.qd[rows.first_dof + k] + how.dt * ws.qdd[k];
  });

  const Step s = make_step(a.in, m, contacts, options, 1.0f);
  pulls_.resize(rows_.size());
  multipliers_.resize(rows_.size());
  for (Row& row : rows_) build_row(s, row);
  place_friction();
  for (size_t i = 0; i < friction_.size(); ++i) {
    build_friction(s, static_cast<int32_t>(i));
    friction_rows_[i].impulse = friction[trees_[friction_[i].tree].first_dof + friction_[i].dof];
  }
  const auto apply = [&](float sign) {
    for (Row& row : rows_)
      for (int32_t r = 0; r < 3; ++r) art::push(row.solver, r, sign * row.solver.impulse[r]);
    for (const art::PgsJointFriction<float>& f : friction_rows_)
      for (int32_t k = 0; k < f.width; ++k) f.rates[k] += sign * f.impulse * f.response[k];
  };
  for (Row& row : rows_) {
    const Vec3f& impulse = impulses[row.contact];
    row.solver.impulse[0] = impulse.x;
    row.solver.impulse[1] = impulse.y;
    row.solver.impulse[2] = impulse.z;
  }
  apply(-1.0f);
  for (Row& row : rows_) set_target(s, row);
  apply(1.0f);
  const auto islands = static_cast<int64_t>(island_sweeps_.size());
  for (int64_t i = 0; i < islands; ++i) solve_adjoint(i, s.law.cone);

  for_trees([&](const ArticulationRows&, const art::Tree<float>& tree, art::Workspace<float>& ws,
                art::AdjointMemory<float>& memory, const float* rates) {
    art::step_vjp_solve(tree, how, ws, memory);
    for (int32_t i = 0; i < tree.link_count; ++i) {
      const art::Link& link = tree.links[i];
      art::LinkState<float>& to = ws.links[i];
      to.w = art::joint_motion(tree, link, ws.axes, memory.scratch);
      to.a_adjoint = art::joint_motion(tree, link, ws.axes, rates);
      if (link.parent < 0) continue;
      to.w = ws.links[link.parent].w + to.w;
      to.a_adjoint = ws.links[link.parent].a_adjoint + to.a_adjoint;
    }
  });
  for (size_t i = 0; i < rows_.size(); ++i) {
    const Row& row = rows_[i];
    if (!(row.solver.impulse[0] > 0.0f)) continue;
    const Vec3f* axes = row.frame.axes;
    const auto world = [&](float x, float y, float z) {
      return axes[0] * x + (axes[1] * y + axes[2] * z);
    };
    const float* impulse = row.solver.impulse;
    add_geometry(row, world(impulse[0], impulse[1], impulse[2]) * (1.0f / how.dt),
                 world(pulls_[i].x, pulls_[i].y, pulls_[i].z), multipliers_[i].x, a.in);
    const double z[3] = {multipliers_[i].x, multipliers_[i].y, multipliers_[i].z};
    add_material_gradients(s, row, z, more);
  }
  if (more.joint_friction != nullptr) add_friction_gradients(more.joint_friction);
  for_trees([&](const ArticulationRows&, const art::Tree<float>& tree, art::Workspace<float>& ws,
                art::AdjointMemory<float>& memory,
                const float*) { art::step_vjp_inputs(tree, in, how, a.gradient, ws, memory); });
}

}  // namespace novaphy
