#include "articulation_sleep.h"

#include <algorithm>

#include "novaphy/core/error.h"

namespace novaphy {

ArticulationSleep::ArticulationSleep(const Model& model, const Articulations& articulations,
                                     const SleepConfig& config)
    : sleep_(config, true), all_(static_cast<size_t>(articulations.count())) {
  std::vector<uint8_t> is_free(static_cast<size_t>(model.body_count()), 0);
  for (size_t i = 0; i < all_.size(); ++i) {
    const articulation::Tree<float> tree = articulations.tree(model, static_cast<int64_t>(i));
    if (tree.link_count != 1 || tree.dof_count != 6 || tree.links[0].body < 0) continue;
    all_[i] = {tree.links[0].body, tree.first_dof};
    is_free[static_cast<size_t>(tree.links[0].body)] = 1;
  }
  for (int32_t b = 0; b < model.body_count(); ++b)
    if (is_free[static_cast<size_t>(b)] == 0) bound_.push_back(b);
}

const SleepingTrees* ArticulationSleep::begin(const Model& model, const SimState& in,
                                              const Contacts* contacts, const Control* control,
                                              const ArticulationArguments& step, float dt) {
  sleep_.begin(model, in);
  if (contacts != nullptr) {
    const articulation::ContactRows rows = contact_rows(contacts);
    const int32_t* const body = model.shape_body.data();
    sides_.resize(2 * static_cast<size_t>(rows.count));
    for (int32_t row = 0; row < rows.count; ++row) {
      const int32_t shapes[2] = {rows.shape0[row], rows.shape1[row]};
      for (int side = 0; side < 2; ++side) {
        const int32_t shape = shapes[side];
        require(shape >= 0 && shape < model.shape_count() && body[shape] < model.body_count(),
                ErrorKind::Index, "SolverFeatherstone.step: contacts: rigid_contact_shape", side,
                "[", row, "]: expected 0 to ", model.shape_count() - 1, ", got ", shape);
        sides_[2 * static_cast<size_t>(row) + static_cast<size_t>(side)] = body[shape];
      }
    }
    sleep_.wake_touched(model, in, *contacts, sides_, dt);
  }
  const float* const joint_f = (control != nullptr ? control->joint_f : model.joint_f).data();
  const SpatialVectorf* const body_f = step.arrays.body_f;
  forced_ = bound_;
  for (const Tree& tree : all_) {
    if (tree.body < 0) continue;
    const float* const f = joint_f + tree.first_dof;
    if (std::any_of(f, f + 6, [](float x) { return x != 0.0f; }) ||
        !(body_f[tree.body] == SpatialVectorf{}))
      forced_.push_back(tree.body);
  }
  sleep_.wake_forced(forced_);
  asleep_.assign(all_.size(), 0);
  awake_.clear();
  for (size_t i = 0; i < all_.size(); ++i) {
    asleep_[i] = sleep_.is_asleep(all_[i].body) ? 1 : 0;
    if (asleep_[i] == 0) awake_.push_back(static_cast<int32_t>(i));
  }
  any_ = awake_.size() < all_.size();
  trees_ = {asleep_, awake_, contacts != nullptr ? static_cast<int32_t>(sides_.size() / 2) : 0};
  return any_ ? &trees_ : nullptr;
}

void ArticulationSleep::keep(const Model& model, const SimState& in, SimState& out,
                             const DeviceArray<int32_t>& status) const {
  if (!any_) return;
  const float *const q = in.joint_q.data(), *const qd = in.joint_qd.data();
  const Transformf* const body_q = in.body_q.data();
  const SpatialVectorf* const body_qd = in.body_qd.data();
  float *const q_out = out.joint_q.mutable_data(), *const qd_out = out.joint_qd.mutable_data();
  Transformf* const body_q_out = out.body_q.mutable_data();
  SpatialVectorf* const body_qd_out = out.body_qd.mutable_data();
  DeviceArray<int32_t> statuses = status;
  int32_t* const of_tree = statuses.mutable_data();
  const int32_t* const q_start = model.joint_q_start.data();
  for (size_t i = 0; i < all_.size(); ++i) {
    if (asleep_[i] == 0) continue;
    of_tree[i] = 0;
    const Tree& tree = all_[i];
    const int32_t joint = sleep_.free_joint(tree.body);
    std::copy_n(q + q_start[joint], 7, q_out + q_start[joint]);
    std::copy_n(qd + tree.first_dof, 6, qd_out + tree.first_dof);
    body_q_out[tree.body] = body_q[tree.body];
    body_qd_out[tree.body] = body_qd[tree.body];
  }
}

}  // namespace novaphy
