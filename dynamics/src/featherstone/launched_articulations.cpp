#include "launched_articulations.h"

#include "articulation_kernels.h"
#include "articulation_step.h"
#include "contact_launches.h"
#include "novaphy/core/device_kernel.h"

namespace novaphy {
namespace detail {
const char* articulation_kernels_text();
}
namespace {

constexpr const char* kName = "SolverFeatherstone.step";

const Kernel<ArticulationStepArguments>& step_kernel() {
  static const auto& kernel =
      *new Kernel<ArticulationStepArguments>(articulation_step, detail::articulation_kernels_text);
  return kernel;
}

}  // namespace

LaunchedArticulations::LaunchedArticulations(const Model& m)
    : model_(m),
      articulations_(m, "SolverFeatherstone", Articulations::For::Steps),
      contacts_(m, articulations_),
      actuated_(m),
      materials_(unread_materials(ArticulationContact::Pgs, kName)) {
  const Device device = m.device();
  const auto count = static_cast<size_t>(articulations_.count());
  const auto dofs = static_cast<size_t>(m.joint_dof_count());
  status_ = DeviceArray<int32_t>(count, device);
  qdd_ = DeviceArray<float>(dofs, device);
  branch_ = DeviceArray<float>(dofs, device);
  workspace_ = DeviceArray<float>(count * static_cast<size_t>(contacts_.tree_stride()), device);
}

void LaunchedArticulations::step(const SimState& in, const SimState& out, const Control* control,
                                 const Contacts* contacts, const FeatherstoneOptions& options,
                                 float dt, const std::shared_ptr<ExclusiveUse>& in_use) {
  const Model& m = model_;
  articulations_.check_values(m, control, true, kName);
  if (contacts != nullptr) materials_.check(m);
  if (LaunchRecorder* recorder = launch_recorder()) recorder->uses(in_use);
  depend_on_values(m, control);
  if (contacts != nullptr)
    depend_on({&m.shape_material_ka, &m.shape_material_mu_torsional, &m.shape_material_mu_rolling});
  const auto [drives, body_f] = actuated_.begin(m, in, out, control, dt, kName);
  // Launches of contacts share the memory of a tree.
  const bool has_rows = contacts_.has_rows(contacts);
  const int64_t bytes = contacts_.tree_stride() * static_cast<int64_t>(sizeof(float));
  const bool on_stack = has_rows ? contacts_.on_stack() : bytes <= kDeviceRowStack;
  const ArticulationStepArguments step = {
      .in = articulation_arguments(m, articulations_, in, drives, body_f, options, dt),
      .q_next = out.joint_q,
      .qd_next = out.joint_qd,
      .body_q = out.body_q,
      .body_qd = out.body_qd,
      .qdd = qdd_,
      .branch = branch_,
      .status = status_,
      .workspace = workspace_,
      .stride = on_stack ? 0 : contacts_.tree_stride()};
  if (has_rows)
    contacts_.step(step, contacts, options);
  else
    run(step_kernel(), articulations_.count(), step);
}

void LaunchedArticulations::check() const {
  const std::vector<int32_t> status = status_.to_host();
  for (const int32_t s : status) check_contact_status(s, kName);
  check_status(model_, articulations_, status, kName);
}

}  // namespace novaphy
