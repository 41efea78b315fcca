// The adjoint of a step with contacts on the host (articulation/contact_adjoint.h).
#include <algorithm>

#include "novaphy/core/sim/for_chunks.h"
#include "pgs_contacts_step.h"

namespace novaphy {
namespace {

namespace art = articulation;
constexpr int64_t kTreeChunk = 8;

}  // namespace

void PgsContacts::write_impulses(Vec3f* impulses, float* friction) const {
  for (size_t i = 0; i < friction_.size(); ++i)
    friction[trees_[friction_[i].tree].first_dof + friction_[i].dof] = friction_rows_[i].impulse;
  for (const Row& row : rows_)
    impulses[row.contact] = {row.solver.impulse[0], row.solver.impulse[1], row.solver.impulse[2]};
}

void PgsContacts::add_branches(ContactBranches& to, const ContactRows& contacts,
                               const FeatherstoneOptions& options, bool by_restitution,
                               bool continues) {
  const art::ContactLaw<float> law = contact_law(options, 0.0f);
  art::BranchNotes notes;
  seen_now_.clear();
  for (const Row& row : rows_) {
    art::note_contact(contacts, law, by_restitution, row, notes);
    seen_now_.push_back(art::seen_contact(contacts, row, law.cone));
  }
  for (size_t i = 0; i < friction_.size(); ++i) art::note_friction(friction_rows_[i], notes);
  for (const art::IslandResult& of : island_results_)
    art::raise(notes.all.residual,
               art::relative_residual(of.residual, of.largest, options.pgs_tolerance));
  notes.far = far_.sweeps > 0 ? 1 : 0;
  const auto count = [](const std::vector<SeenContact>& list) {
    return static_cast<int32_t>(list.size());
  };
  if (continues)
    note_events(seen_.data(), count(seen_), seen_now_.data(), count(seen_now_), notes.all);
  std::swap(seen_, seen_now_);
  art::note_step(notes, to);
}

art::AdjointMemory<float> PgsContacts::adjoint(int64_t tree) {
  const ArticulationRows& rows = trees_[tree];
  return art::make_adjoint_memory<float>(
      adjoint_.data() + adjoint_begin_[static_cast<size_t>(tree)], rows.link_count, rows.dof_count);
}

struct PgsContacts::AdjointIsland {
  PgsContacts& all;
  int64_t island;
  template <class F>
  void for_contacts(const F& f) const {
    for (const int32_t i : all.island_rows_.items(island))
      if (Row& row = all.rows_[static_cast<size_t>(i)]; row.solver.impulse[0] > 0.0f) f(row);
  }
  template <class F>
  void for_shifted(const F& f) const {
    for (const int32_t i : all.island_rows_.items(island))
      if (Row& row = all.rows_[static_cast<size_t>(i)]; row.solver.shifted > 0.0f) f(row);
  }
  template <class F>
  void for_held(const F& f) const {
    for (const int32_t i : all.island_friction_.items(island)) {
      const auto& row = all.friction_rows_[static_cast<size_t>(i)];
      if (art::holds(row.impulse, row.limit)) f(row, all.friction_[static_cast<size_t>(i)].tree);
    }
  }
  double* system(int64_t count) const {
    const auto size = static_cast<size_t>(count);
    if (all.system_.size() <= size) all.system_.resize(size + 1);
    return all.system_.data();
  }
  float* rate_gradient(int32_t tree) const { return all.adjoint(tree).rate; }
  float* move_gradient(int32_t tree) const { return all.adjoint(tree).scratch + dofs(tree); }
  int32_t dofs(int32_t tree) const { return all.trees_[tree].dof_count; }
};

void PgsContacts::solve_adjoint(int64_t island, bool cone) {
  art::solve_adjoint(AdjointIsland{*this, island}, cone);
}

void PgsContacts::add_material_gradients(const Step& s, const Row& row,
                                         const ContactGradient& to) const {
  if (to.mu == nullptr && to.restitution == nullptr && to.ke == nullptr && to.kd == nullptr) return;
  const art::MaterialGradient of = art::material_gradient(s.law, s.material(row), row);
  const auto give = [&](float* gradient, float value) {
    if (gradient == nullptr) return;
    for (const int32_t* shapes : {s.contacts.shape0, s.contacts.shape1})
      gradient[shapes[row.contact]] += value;
  };
  give(to.mu, of.mu);
  give(to.restitution, of.restitution);
  give(to.ke, of.ke);
  give(to.kd, of.kd);
}

void PgsContacts::add_friction_gradients(float* to) {
  std::vector<float>& push = friction_push_;
  size_t dofs = 0;
  for (int64_t i = 0; i < count_; ++i) dofs += static_cast<size_t>(trees_[i].dof_count);
  push.resize(dofs);
  for (int64_t i = 0; i < count_; ++i)
    for (int32_t k = 0; k < trees_[i].dof_count; ++k) {
      const float rate = rates_[static_cast<size_t>(rates_begin_[static_cast<size_t>(i)] + k)];
      push[static_cast<size_t>(trees_[i].first_dof + k)] =
          art::friction_push(false, 0.0f, 0.0f, rate);
    }
  for (size_t i = 0; i < friction_.size(); ++i) {
    const art::PgsJointFriction<float>& row = friction_rows_[i];
    push[static_cast<size_t>(trees_[friction_[i].tree].first_dof + friction_[i].dof)] =
        art::friction_push(true, row.impulse, row.limit, 0.0f);
  }
  for (int64_t i = 0; i < count_; ++i)
    for (int32_t k = 0; k < trees_[i].dof_count; ++k) {
      const int32_t row = trees_[i].first_dof + k;
      to[row] += push[static_cast<size_t>(row)] * adjoint(i).scratch[k];
    }
}

void PgsContacts::push_impulses(float sign) {
  for (Row& row : rows_)
    for (int32_t r = 0; r < 3; ++r) art::push(row.solver, r, sign * row.solver.impulse[r]);
  for (const art::PgsJointFriction<float>& f : friction_rows_)
    for (int32_t k = 0; k < f.width; ++k) f.rates[k] += sign * f.impulse * f.response[k];
}

void PgsContacts::vjp(const ArticulationStepVjpArguments& a, const Model& m,
                      const ContactRows& contacts, const Vec3f* impulses, const float* friction,
                      const FeatherstoneOptions& options, const ContactGradient& more) {
  const art::StepInputs<float> in = articulation_inputs(a.in);
  const art::StepOptions<float> how = articulation_options(a.in);
  const auto start = [&](const art::Tree<float>& tree, art::Workspace<float>& ws,
                         art::AdjointMemory<float>& memory) {
    step_vjp_rates(a, tree, in, how, ws, memory);
    art::step_vjp_dynamics(tree, in, how, ws);
  };
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
    start(tree, ws, memory);
    for (int32_t k = 0; k < rows.dof_count; ++k)
      rates[k] = in.qd[rows.first_dof + k] + how.dt * ws.qdd[k];
    const int32_t padded = art::padded_dofs(rows.dof_count);
    std::fill_n(rates + padded, padded, 0.0f);
  });

  const Step s = make_step(a.in, m, contacts, options, 1.0f);
  for (Row& row : rows_) build_row(s, row);
  place_friction();
  for (size_t i = 0; i < friction_.size(); ++i) {
    build_friction(s, static_cast<int32_t>(i));
    friction_rows_[i].impulse = friction[trees_[friction_[i].tree].first_dof + friction_[i].dof];
  }
  for (Row& row : rows_) {
    std::copy_n(&impulses[row.contact].x, 3, row.solver.impulse);
  }
  push_impulses(-1.0f);
  for (Row& row : rows_) set_target(s, row);
  push_impulses(1.0f);
  const auto islands = static_cast<int64_t>(island_results_.size());
  bool shifts = false;
  for (int64_t i = 0; i < islands; ++i) {
    const std::span<const int32_t> of = island_rows_.items(i);
    art::sweep_shifts([&](const auto& f) {
      for (const int32_t k : of) f(rows_[static_cast<size_t>(k)].solver);
    });
    for (const int32_t k : of)
      shifts = shifts || rows_[static_cast<size_t>(k)].solver.shifted > 0.0f;
  }
  const auto tree_of = [&](int32_t tree) { return island_tree(a.in, tree); };
  const auto memory_of = [&](int32_t tree) { return adjoint(tree); };
  if (shifts) {
    for_trees([&](const ArticulationRows& rows, const art::Tree<float>& tree,
                  art::Workspace<float>& ws, art::AdjointMemory<float>& memory, float* rates) {
      ws.shift = rates + art::padded_dofs(rows.dof_count);
      start(tree, ws, memory);
    });
    for (int64_t i = 0; i < islands; ++i) art::solve_shift_adjoint(AdjointIsland{*this, i});
    for (const Row& row : rows_)
      if (row.solver.shifted > 0.0f) art::add_softness_gradient(row, how.dt, tree_of, memory_of);
    for_trees([&](const ArticulationRows&, const art::Tree<float>& tree, art::Workspace<float>& ws,
                  art::AdjointMemory<float>& memory, const float* rates) {
      art::set_shift_motions(tree, in, how, rates, ws, memory);
    });
    for (const Row& row : rows_)
      if (row.solver.shifted > 0.0f) art::add_shift_geometry(row, how.dt, tree_of, memory_of);
  }
  for (int64_t i = 0; i < islands; ++i) solve_adjoint(i, s.law.cone);

  for_trees([&](const ArticulationRows&, const art::Tree<float>& tree, art::Workspace<float>& ws,
                art::AdjointMemory<float>& memory, const float* rates) {
    art::step_vjp_solve(tree, how, ws, memory);
    art::set_contact_motions(tree, rates, ws, memory);
  });
  for (const Row& row : rows_) {
    if (!art::has_geometry(row)) continue;
    art::add_contact_geometry(row, how.dt, tree_of, memory_of);
    add_material_gradients(s, row, more);
  }
  if (more.joint_friction != nullptr) add_friction_gradients(more.joint_friction);
  for_trees([&](const ArticulationRows&, const art::Tree<float>& tree, art::Workspace<float>& ws,
                art::AdjointMemory<float>& memory, const float*) {
    art::step_vjp_inputs(tree, in, how, step_gradient(a), ws, memory);
  });
}

}  // namespace novaphy
