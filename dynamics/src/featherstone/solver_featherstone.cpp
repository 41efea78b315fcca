#include "novaphy/dynamics/featherstone/solver_featherstone.h"

#include <cmath>
#include <utility>

#include "articulation_kernels.h"
#include "articulation_step.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/for_chunks.h"
#include "novaphy/core/storage.h"
#include "unrecorded_step.h"

namespace novaphy {
namespace {

constexpr const char* kName = "SolverFeatherstone.step";
constexpr int64_t kChunk = 8;  // articulations

}  // namespace

struct SolverFeatherstone::Cache {
  explicit Cache(const Model& m) : articulations(m, "SolverFeatherstone") {
    const auto dofs = static_cast<size_t>(m.joint_dof_count());
    const auto count = static_cast<size_t>(articulations.count());
    qdd.resize(dofs);
    branch.resize(dofs);
    status.resize(count);
    stride = step_workspace(articulations);
    workspace.resize(count * static_cast<size_t>(stride));
  }
  Articulations articulations;
  std::vector<float> qdd, branch;
  std::vector<int32_t> status;
  int64_t stride;
  std::vector<float> workspace;
};

SolverFeatherstone::SolverFeatherstone(std::shared_ptr<const Model> model,
                                       const FeatherstoneOptions& options)
    : SolverBase(std::move(model)), options_(options) {
  check_featherstone_model(*this->model(), options, "SolverFeatherstone");
  make_cache();
}
SolverFeatherstone::~SolverFeatherstone() = default;

void SolverFeatherstone::make_cache() { cache_ = std::make_unique<Cache>(*model()); }

void SolverFeatherstone::notify_model_changed(ModelFlags) {
  const ExclusiveUse::Scope scope = use("SolverFeatherstone.notify_model_changed");
  make_cache();
}

void SolverFeatherstone::step(SimState& state_in, SimState& state_out, const Control* control,
                              const Contacts* contacts, float dt) {
  if (ArrayObserver* observer = array_observer()) observer->host_read(kName);
  const ExclusiveUse::Scope scope = use(kName);
  const Model& m = *model();
  check_step(kName, state_in, state_out, control, contacts, dt);
  check_no_contacts(contacts, kName);
  m.check_numbers(kName);
  m.update_derived();
  Cache& c = *cache_;
  c.articulations.check_values(m, control, kName);
  const ArticulationStepArguments a = {
      articulation_arguments(m, c.articulations, state_in, control, options_, dt),
      state_out.joint_q.mutable_data(),
      state_out.joint_qd.mutable_data(),
      state_out.body_q.mutable_data(),
      state_out.body_qd.mutable_data(),
      c.qdd.data(),
      c.branch.data(),
      c.status.data(),
      c.workspace.data(),
      c.stride};
  const int64_t n = c.articulations.count();
  for_chunks(n, kChunk, [&](int64_t begin, int64_t end, int64_t) {
    for (int64_t i = begin; i < end; ++i) articulation_step_row(a, i, n);
  });
  mark_unrecorded_step(m, state_in, state_out, control);
  check_status(m, c.articulations, c.status, kName);
}

}  // namespace novaphy
