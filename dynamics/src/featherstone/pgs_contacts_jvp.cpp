// Forward derivatives of contacts and dry friction (articulation/contact_jvp.h) of a step on the
// host.
#include <algorithm>

#include "novaphy/dynamics/articulation/contact_jvp.h"
#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;
using art::DualFloat;

struct Trees {
  const std::vector<art::Tree<DualFloat>>& all;
  const std::vector<art::Workspace<DualFloat>>& workspaces;
  const art::Tree<DualFloat>& tree(int32_t i) const { return all[static_cast<size_t>(i)]; }
  const art::Workspace<DualFloat>& workspace(int32_t i) const {
    return workspaces[static_cast<size_t>(i)];
  }
};
struct Held {
  int32_t tree = 0, dof = 0;
  bool holds = false;
  std::vector<DualFloat> response;
};
struct Island {
  std::span<const int32_t> rows, friction;
  std::vector<art::DualContact>& contacts;
  const std::vector<Held>& held;
  std::vector<double>& memory;
  template <class F>
  void for_rows(const F& f) const {
    for (const int32_t i : rows) f(contacts[static_cast<size_t>(i)]);
  }
  template <class F>
  void for_contacts(const F& f) const {
    for_rows([&](art::DualContact& row) {
      if (row.solver.impulse[0] > 0.0f) f(row);
    });
  }
  template <class F>
  void for_shifted(const F& f) const {
    for_rows([&](art::DualContact& row) {
      if (row.solver.shifted > 0.0f) f(row);
    });
  }
  template <class F>
  void for_held(const F& f) const {
    for (const int32_t i : friction) {
      const Held& dry = held[static_cast<size_t>(i)];
      if (dry.holds) f(dry.tree, dry.dof, dry.response.data());
    }
  }
  double* system(int64_t numbers) const {
    memory.resize(std::max(memory.size(), static_cast<size_t>(numbers)));
    return memory.data();
  }
};

}  // namespace

void PgsContacts::jvp(const std::vector<art::Tree<DualFloat>>& trees, const DualFloat* qd,
                      std::vector<art::Workspace<DualFloat>>& ws, const ContactRows& c,
                      const Vec3f* impulses, const float* friction,
                      const FeatherstoneOptions& options, const ContactDuals& of, float dt) {
  const art::ContactLaw<float> law = contact_law(options, dt);
  const art::ContactLaw<DualFloat> duals = art::dual_law(law);
  const Trees all = {trees, ws};
  int32_t dofs = 0;
  for (const art::Tree<DualFloat>& tree : trees) dofs = std::max(dofs, tree.dof_count);
  const auto numbers = static_cast<size_t>(art::dual_contact_numbers(dofs));
  std::vector<art::DualContact> rows(rows_.size());
  std::vector<DualFloat> memory(rows.size() * numbers);
  for (size_t i = 0; i < rows.size(); ++i) {
    static_cast<art::IslandContact&>(rows[i]) = rows_[i];
    art::build_dual_contact(c, all, qd, duals, {of.mu, of.restitution, of.ke, of.kd},
                            impulses[rows[i].contact], memory.data() + i * numbers, rows[i]);
  }
  for (const art::DualContact& row : rows)
    for (int r = 0; r < 3; ++r) art::dual_push(row, r, DualFloat(row.solver.impulse[r]), all);
  std::vector<Held> held;
  for (const Friction& dry : friction_) {
    const auto i = static_cast<size_t>(dry.tree);
    const int32_t row = trees[i].first_dof + dry.dof;
    Held& to = held.emplace_back(Held{dry.tree, dry.dof, false, {}});
    to.response.resize(static_cast<size_t>(trees[i].dof_count));
    to.holds =
        art::push_dual_friction(trees[i], ws[i], dry.dof, of.joint_friction[row] * DualFloat(dt),
                                friction[row], to.response.data());
  }
  for (size_t i = 0; i < trees.size(); ++i)
    art::push_absent_friction(trees[i], ws[i], of.joint_friction, dt);
  const auto for_islands = [&](const auto& f) {
    for (int64_t i = 0; i < static_cast<int64_t>(island_results_.size()); ++i)
      f(Island{island_rows_.items(i), island_friction_.items(i), rows, held, system_});
  };
  for_islands([&](const Island& island) { art::solve_dual_island(all, island, law.cone); });
  for (size_t i = 0; i < trees.size(); ++i) {
    std::fill_n(ws[i].bias, trees[i].dof_count, DualFloat());
    ws[i].shift = ws[i].bias;
  }
  for_islands([&](const Island& island) { art::add_dual_shifts(all, island); });
}

}  // namespace novaphy
