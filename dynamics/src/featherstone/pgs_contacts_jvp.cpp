// Forward derivatives of contacts and dry friction, by the set of rows that are active: the
// transpose of articulation/contact_adjoint.h. Dual numbers carry the step with the impulses as they are; the
// rows then have the derivatives r, and the impulses answer by (B J M^-1 J^T + R) lambda' = -r.
#include <algorithm>
#include <cmath>

#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;
using D = art::Dual<float>;

Vec3<D> constant(const Vec3f& v) { return {D(v.x), D(v.y), D(v.z)}; }
Vec3f tangent(const Vec3<D>& v) { return {v.x.tangent, v.y.tangent, v.z.tangent}; }

// What a tree has of a row.
struct Moved {
  int32_t tree = -1, dofs = 0;
  std::vector<D> jacobian, response;  // {3, dofs}
};
struct DualRow {
  Moved sides[2];  // an absent one has no tree
  art::NormalTarget<D> target;
  D friction;
};

D slip(const DualRow& row, int r, const std::vector<art::Workspace<D>>& ws, const D* qd,
       const std::vector<art::Tree<D>>& trees) {
  D sum(0.0f);
  for (const Moved& m : row.sides)
    for (int32_t k = 0; k < m.dofs; ++k) {
      const auto tree = static_cast<size_t>(m.tree);
      const D rate = qd != nullptr ? qd[trees[tree].first_dof + k] : ws[tree].qd_next[k];
      sum = sum + m.jacobian[static_cast<size_t>(r * m.dofs + k)] * rate;
    }
  return sum;
}
double coupling(const DualRow& a, int i, const DualRow& b, int j) {
  double sum = 0.0;
  for (const Moved& s : a.sides)
    for (const Moved& t : b.sides)
      for (int32_t k = 0; s.tree >= 0 && s.tree == t.tree && k < s.dofs; ++k)
        sum += double{s.jacobian[static_cast<size_t>(i * s.dofs + k)].value} *
               t.response[static_cast<size_t>(j * t.dofs + k)].value;
  return sum;
}
// What an impulse along row j does to the rate of a dof.
double response_of(const DualRow& row, int j, int32_t tree, int32_t dof) {
  double sum = 0.0;
  for (const Moved& m : row.sides)
    if (m.tree == tree) sum += m.response[static_cast<size_t>(j * m.dofs + dof)].value;
  return sum;
}
void push(const DualRow& row, int r, const D& impulse, std::vector<art::Workspace<D>>& ws) {
  for (const Moved& m : row.sides)
    for (int32_t k = 0; k < m.dofs; ++k) {
      D& rate = ws[static_cast<size_t>(m.tree)].qd_next[k];
      rate = rate + m.response[static_cast<size_t>(r * m.dofs + k)] * impulse;
    }
}

}  // namespace

void PgsContacts::jvp(const std::vector<art::Tree<D>>& trees, const D* qd,
                      std::vector<art::Workspace<D>>& ws, const ContactRows& c,
                      const Vec3f* impulses, const float* friction,
                      const FeatherstoneOptions& options, const ContactDuals& of, float dt) {
  const art::ContactLaw<float> f = contact_law(options, dt);
  const art::ContactLaw<D> law = {D(f.dt),
                                  D(f.erp),
                                  D(f.slop),
                                  D(f.cfm),
                                  D(f.max_depenetration),
                                  D(f.restitution_threshold),
                                  f.compliant,
                                  f.cone};
  // Rows, without impulses.
  std::vector<DualRow> rows(rows_.size());
  for (size_t i = 0; i < rows.size(); ++i) {
    Row& row = rows_[i];
    DualRow& to = rows[i];
    const auto at = static_cast<size_t>(row.contact);
    const Vec3<D> normal = constant(c.normal[at]);
    const art::ContactFrame<float> axes = art::contact_frame(c.normal[at]);
    const art::ContactFrame<D> frame = {
        {constant(axes.axes[0]), constant(axes.axes[1]), constant(axes.axes[2])}};
    const Vec3f cores[2] = {c.point0[at], c.point1[at]};
    const float margins[2] = {c.margin0[at], -c.margin1[at]};
    art::SurfacePoint<D> points[2];
    for (size_t side = 0; side < 2; ++side) {
      const Side& on = row.sides[side];
      points[side] = art::surface_point<D>(
          on.tree < 0 ? nullptr : &ws[static_cast<size_t>(on.tree)].links[on.link],
          constant(cores[side]), normal * D(margins[side]));
    }
    if (row.follows) {
      const size_t side = row.sides[0].tree >= 0 ? 0 : 1;
      const Vec3f moved = tangent(points[side].at + points[side].origin);
      const Vec3f n = c.normal[at], along = moved - n * math::dot(n, moved);
      Vec3<D>& below = points[1 - side].at;
      below.x.tangent = along.x;
      below.y.tangent = along.y;
      below.z.tangent = along.z;
    }
    const art::ContactPlace<D> place = art::contact_place(points[0], points[1], normal);
    const bool itself = row.sides[0].tree == row.sides[1].tree;
    for (size_t side = 0; side < 2; ++side) {
      if (row.solver.sides[side].width == 0) continue;
      Moved& m = to.sides[side];
      m.tree = row.sides[side].tree;
      const art::Tree<D>& tree = trees[static_cast<size_t>(m.tree)];
      const art::Workspace<D>& w = ws[static_cast<size_t>(m.tree)];
      m.dofs = tree.dof_count;
      m.jacobian.assign(static_cast<size_t>(3 * m.dofs), D(0.0f));
      m.response = m.jacobian;
      art::add_point_rows(tree, w.axes, row.sides[side].link, side == 0 ? place.a : place.b, frame,
                          D(side == 0 ? -1.0f : 1.0f), m.dofs, m.jacobian.data());
      if (itself)
        art::add_point_rows(tree, w.axes, row.sides[1].link, place.b, frame, D(1.0f), m.dofs,
                            m.jacobian.data());
      art::response_rows(tree, w.matrix, itself ? -1 : art::last_dof(tree, row.sides[side].link),
                         m.dofs, m.jacobian.data(), m.response.data());
    }
    const auto mean = [&](const D* array) {
      return D(0.5f) * (array[c.shape0[at]] + array[c.shape1[at]]);
    };
    const art::ContactMaterial<D> material = {mean(of.mu), mean(of.restitution), mean(of.ke),
                                              mean(of.kd)};
    to.target = art::normal_target(law, material, place.gap, slip(to, 0, ws, qd, trees),
                                   slip(to, 0, ws, nullptr, trees));
    to.friction = material.friction;
    row.solver.cfm = to.target.cfm.value;
    row.solver.friction = to.friction.value;
    row.solver.impulse[0] = impulses[at].x;
    row.solver.impulse[1] = impulses[at].y;
    row.solver.impulse[2] = impulses[at].z;
  }
  // The impulses that there are.
  for (size_t i = 0; i < rows.size(); ++i)
    for (int r = 0; r < 3; ++r) push(rows[i], r, D(rows_[i].solver.impulse[r]), ws);
  std::vector<std::vector<D>> responses(friction_.size());
  std::vector<char> holds(friction_.size());
  std::vector<D> answer;
  for (size_t i = 0; i < friction_.size(); ++i) {
    const Friction& dry = friction_[i];
    const art::Tree<D>& tree = trees[static_cast<size_t>(dry.tree)];
    art::Workspace<D>& w = ws[static_cast<size_t>(dry.tree)];
    responses[i].assign(static_cast<size_t>(tree.dof_count), D(0.0f));
    responses[i][static_cast<size_t>(dry.dof)] = D(1.0f);
    art::solve(tree, w.matrix, responses[i].data());
    const int32_t row = tree.first_dof + dry.dof;
    const D limit = of.joint_friction[row] * D(dt);
    D impulse(friction[row]);
    holds[i] = art::holds(impulse.value, limit.value);
    if (!holds[i]) impulse.tangent = impulse.value < 0.0f ? -limit.tangent : limit.tangent;
    for (int32_t k = 0; k < tree.dof_count; ++k)
      w.qd_next[k] = w.qd_next[k] + responses[i][static_cast<size_t>(k)] * impulse;
  }
  // Dofs without dry friction, as if they had it.
  for (size_t i = 0; i < trees.size(); ++i) {
    for (int32_t k = 0; k < trees[i].dof_count; ++k) {
      const D& limit = of.joint_friction[trees[i].first_dof + k];
      const float rate = ws[i].qd_next[k].value;
      if (limit.value > 0.0f || limit.tangent == 0.0f || rate == 0.0f) continue;
      answer.assign(static_cast<size_t>(trees[i].dof_count), D(0.0f));
      answer[static_cast<size_t>(k)] = D(0.0f, (rate > 0.0f ? -dt : dt) * limit.tangent);
      art::solve(trees[i], ws[i].matrix, answer.data());
      for (int32_t x = 0; x < trees[i].dof_count; ++x)
        ws[i].qd_next[x] = ws[i].qd_next[x] + answer[static_cast<size_t>(x)];
    }
  }
  // How they change.
  const auto islands = static_cast<int64_t>(island_sweeps_.size());
  for (int64_t island = 0; island < islands; ++island) {
    std::vector<size_t> active, held;
    for (const int32_t i : island_rows_.items(island))
      if (rows_[static_cast<size_t>(i)].solver.impulse[0] > 0.0f)
        active.push_back(static_cast<size_t>(i));
    for (const int32_t i : island_friction_.items(island))
      if (holds[static_cast<size_t>(i)]) held.push_back(static_cast<size_t>(i));
    const size_t contacts = 3 * active.size(), n = contacts + held.size(), width = n + 1;
    system_.assign(n * width, 0.0);
    for (size_t d = 0; d < active.size(); ++d) {
      const DualRow& row = rows[active[d]];
      const art::PgsContact<float>& solver = rows_[active[d]].solver;
      D w[3];
      for (int r = 0; r < 3; ++r) w[r] = slip(row, r, ws, nullptr, trees);
      const float along[2] = {w[1].value, w[2].value};
      const art::ContactBranch branch = art::branch_of(solver, f.cone);
      art::ContactBlocks k;
      art::set_blocks(solver, branch, f.cone, along, k);
      double by_friction[2];
      art::rows_by_friction(solver, branch, f.cone, along, by_friction);
      for (size_t e = 0; e < 3; ++e) {
        double* const to = system_.data() + (3 * d + e) * width;
        for (size_t other = 0; other < active.size(); ++other)
          for (int i = 0; i < 3; ++i) {
            double& a = to[3 * other + static_cast<size_t>(i)];
            for (int j = 0; j < 3; ++j)
              if (k.b[e][j] != 0.0) a += k.b[e][j] * coupling(row, j, rows[active[other]], i);
            if (other != d) continue;
            a += k.r[e][i];
            if (static_cast<int>(e) == i && (i == 0 || !branch.slides[i - 1]))
              a += art::kRegularity * coupling(row, i, row, i);
          }
        for (size_t h = 0; h < held.size(); ++h) {
          const Friction& dry = friction_[held[h]];
          for (const Moved& m : row.sides)
            for (int j = 0; m.tree == dry.tree && j < 3; ++j)
              for (int32_t x = 0; x < m.dofs; ++x)
                to[contacts + h] += k.b[e][j] *
                                    m.jacobian[static_cast<size_t>(j * m.dofs + x)].value *
                                    responses[held[h]][static_cast<size_t>(x)].value;
        }
        double change = 0.0;
        for (int j = 0; j < 3; ++j) change += k.b[e][j] * w[j].tangent;
        change += e == 0 ? row.target.bias.tangent + row.target.cfm.tangent * solver.impulse[0]
                         : by_friction[e - 1] * row.friction.tangent;
        to[n] = -change;
      }
    }
    for (size_t h = 0; h < held.size(); ++h) {
      const Friction& dry = friction_[held[h]];
      double* const to = system_.data() + (contacts + h) * width;
      for (size_t other = 0; other < active.size(); ++other)
        for (int i = 0; i < 3; ++i)
          to[3 * other + static_cast<size_t>(i)] =
              response_of(rows[active[other]], i, dry.tree, dry.dof);
      for (size_t g = 0; g < held.size(); ++g)
        if (friction_[held[g]].tree == dry.tree)
          to[contacts + g] = responses[held[g]][static_cast<size_t>(dry.dof)].value;
      to[contacts + h] *= 1.0 + art::kRegularity;
      to[n] = -ws[static_cast<size_t>(dry.tree)].qd_next[dry.dof].tangent;
    }
    art::solve_dense(system_.data(), static_cast<int64_t>(n));
    for (size_t d = 0; d < active.size(); ++d)
      for (int r = 0; r < 3; ++r) {
        const double x = system_[(3 * d + static_cast<size_t>(r)) * width + n];
        push(rows[active[d]], r, {0.0f, static_cast<float>(x)}, ws);
      }
    for (size_t h = 0; h < held.size(); ++h) {
      art::Workspace<D>& w = ws[static_cast<size_t>(friction_[held[h]].tree)];
      const D change(0.0f, static_cast<float>(system_[(contacts + h) * width + n]));
      for (size_t k = 0; k < responses[held[h]].size(); ++k)
        w.qd_next[k] = w.qd_next[k] + responses[held[h]][k] * change;
    }
  }
}

}  // namespace novaphy
