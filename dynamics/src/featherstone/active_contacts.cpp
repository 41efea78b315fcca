#include "active_contacts.h"

#include <algorithm>
#include <cmath>

#include "novaphy/core/error.h"
#include "novaphy/dynamics/articulation/active_rows.h"
#include "contact_steps.h"

namespace novaphy {

namespace art = articulation;

ActiveContacts::ActiveContacts(const Model& m, const Articulations& articulations,
                               int32_t articulation)
    : of_body_(static_cast<size_t>(m.body_count())) {
  for (int64_t i = 0; i < articulations.count(); ++i) {
    const art::Tree<float> tree = articulations.tree(m, i);
    const bool ours = i == articulation;
    if (ours) dofs_ = tree.dof_count;
    for (int32_t k = 0; k < tree.link_count; ++k) {
      if (tree.links[k].body < 0) continue;
      Place& place = of_body_[static_cast<size_t>(tree.links[k].body)];
      if (ours)
        place.link = k;
      else
        place.moves = art::last_dof(tree, k) >= 0;
    }
  }
  rates_.resize(static_cast<size_t>(art::padded_dofs(dofs_)));
}

void ActiveContacts::find(const Model& m, const Contacts* contacts, const SimState& after,
                          const art::Tree<float>& tree, art::Workspace<float>& ws,
                          const char* user) {
  rows_.clear();
  force_.clear();
  for (std::vector<Vec3f>* values : {&point0_, &point1_, &normal_}) values->clear();
  for (std::vector<float>* values : {&margin0_, &margin1_}) values->clear();
  if (contacts == nullptr) return;
  const art::ContactRows c = contact_rows(contacts);
  const Vec3f* const force = contacts->rigid_contact_force.data();
  const int32_t width = art::padded_dofs(dofs_);
  for (int32_t i = 0; i < c.count; ++i) {
    if (!(math::dot(force[i], c.normal[i]) > 0.0f)) continue;
    const int32_t shapes[2] = {c.shape0[i], c.shape1[i]};
    Vec3f points[2] = {c.point0[i], c.point1[i]};
    art::IslandContact row;
    bool others_move = false;
    for (int side = 0; side < 2; ++side) {
      require(shapes[side] >= 0 && shapes[side] < m.shape_count(), ErrorKind::Index, user,
              ", contacts: rigid_contact_shape", side, "[", i, "]: expected 0 to ",
              m.shape_count() - 1, ", got ", shapes[side]);
      const int32_t body = m.shape_body.data()[shapes[side]];
      if (body < 0) continue;
      const Place& place = of_body_[static_cast<size_t>(body)];
      if (place.link >= 0)
        row.sides[side] = {0, place.link};
      else
        points[side] = math::transform_point(after.body_q.data()[body], points[side]);
      others_move = others_move || place.moves;
    }
    if (row.sides[0].tree < 0 && row.sides[1].tree < 0) continue;
    require(!others_move, ErrorKind::NotImplemented, user, ", contacts: row ", i, ", shapes ",
            shapes[0], " and ", shapes[1],
            ": contact_projection covers contacts of the articulation with itself and with what "
            "does not move; DiffFeatherstoneSolver differentiates those with others");
    row.contact = static_cast<int32_t>(rows_.size());
    row.solver.sides[row.sides[0].tree < 0 ? 1 : 0].width = width;
    rows_.push_back(row);
    force_.push_back(force[i]);
    point0_.push_back(points[0]);
    point1_.push_back(points[1]);
    normal_.push_back(c.normal[i]);
    margin0_.push_back(c.margin0[i]);
    margin1_.push_back(c.margin1[i]);
  }
  const size_t numbers = 6 * static_cast<size_t>(width);
  numbers_.resize(std::max(numbers_.size(), rows_.size() * numbers));
  art::ContactRows kept;
  kept.point0 = point0_.data();
  kept.point1 = point1_.data();
  kept.normal = normal_.data();
  kept.margin0 = margin0_.data();
  kept.margin1 = margin1_.data();
  const art::IslandTree of = {tree, ws, rates_.data(), ws.qd_next, true};
  for (size_t i = 0; i < rows_.size(); ++i)
    art::build_contact(
        kept, [&](int32_t) { return of; }, numbers_.data() + i * numbers, rows_[i]);
}

float ActiveContacts::push(float dt, art::Workspace<float>& ws) {
  const auto n = static_cast<size_t>(dofs_);
  std::copy_n(ws.qd_next, n, rates_.begin());
  std::fill_n(ws.given, n, 0.0f);
  float size = 0.0f;
  for (size_t k = 0; k < n; ++k) size = std::max(size, std::abs(rates_[k]));
  for (size_t i = 0; i < rows_.size(); ++i) {
    art::IslandContact& row = rows_[i];
    for (int r = 0; r < 3; ++r) {
      row.solver.impulse[r] = math::dot(row.frame.axes[r], force_[i]) * dt;
      art::push(row.solver, r, row.solver.impulse[r]);
    }
    art::add_impulses(row.solver, rates_.data(), dofs_, ws.given);
    for (size_t k = 0; k < n; ++k) size = std::max(size, std::abs(rates_[k]));
  }
  std::copy_n(rates_.begin(), n, ws.qd_next);
  return size;
}

void ActiveContacts::project(float* v) {
  const size_t n = rows_.size(), width = n + 1;
  std::copy_n(v, dofs_, rates_.begin());
  system_.resize(n * width);
  for (size_t i = 0; i < n; ++i) {
    double* const to = system_.data() + i * width;
    for (size_t j = 0; j < n; ++j) to[j] = art::coupling(rows_[i].solver, 0, rows_[j].solver, 0);
    to[i] *= 1.0 + art::kRegularity;
    to[n] = art::slip(rows_[i].solver, 0);
  }
  art::solve_dense(system_.data(), static_cast<int64_t>(n));
  for (size_t i = 0; i < n; ++i)
    art::push(rows_[i].solver, 0, static_cast<float>(-system_[i * width + n]));
  std::copy_n(rates_.begin(), dofs_, v);
}

}  // namespace novaphy
