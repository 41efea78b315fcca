#include "bodies.h"

#include <algorithm>

#include "novaphy/core/device_kernel.h"
#include "novaphy/core/sim/joint_types.h"

namespace novaphy::vbd {
namespace {

// Number of bodies, trees or rows that a thread takes at a time.
constexpr uint32_t kBodies = 32, kTrees = 4, kRows = 256;

// Returns the Kernel of a row kernel, without code for devices. The argument type of each row
// kernel is different, so each gets its own object.
template <class A>
const Kernel<A>& kernel_of(const RowKernel<A>& kernel) {
  static const auto& made = *new Kernel<A>(kernel, nullptr);
  return made;
}

// Returns the Kernel of vbd_body_take, which has the argument type of vbd_body_tree and needs a
// separate object.
const Kernel<VbdBodyTreeArguments>& take() {
  static const auto& made =
      *new Kernel<VbdBodyTreeArguments>(kInChunks<vbd_body_take, kTrees>, nullptr);
  return made;
}

}  // namespace

Bodies::Bodies(const Model& m, const VbdOptions& o) : model_(m), options_(o) {
  check_model(nullptr);
  const auto bodies = static_cast<size_t>(m.body_count());
  if (o.initial_guess == VbdInitialGuess::Adaptive) {
    particle_rows_ = static_cast<size_t>(m.particle_count());
    body_rows_ = bodies;
  }
  joint_count_ = static_cast<size_t>(m.joint_count());
  body_.resize(bodies);
  motion_.resize(bodies);
  is_kinematic_ = DeviceArray<int32_t>(bodies, m.device());
  has_rod_.resize(bodies);
  for (size_t k = 0; k < joint_count_; ++k)
    for (const int32_t body : {m.joint_parent.data()[k], m.joint_child.data()[k]})
      if (body >= 0 && m.joint_type.data()[k] == static_cast<int32_t>(JointType::ROD))
        has_rod_[static_cast<size_t>(body)] = 1;
  memory_ = DeviceArray<Vec4f>(contacts_at(), m.device());
  graph_.build(m.body_count(), {}, {}, 0);
}

DeviceArray<Vec4f> Bodies::of_particles() const {
  if (particle_rows_ == 0) return {};
  const Range& all = *memory_.range();
  return DeviceArray<Vec4f>(
      Array(DType::vec4, particle_rows_, 1,
            all.storage().range(all.offset(), particle_rows_ * sizeof(Vec4f))));
}

void Bodies::reserve(int32_t contacts) {
  const auto rows = static_cast<size_t>(contacts);
  if (rows <= contact_rows_) return;
  DeviceArray<Vec4f> memory(contacts_at() + 3 * rows, model_.device());
  std::copy_n(memory_.data(), memory_.rows(), memory.mutable_data());
  memory_ = memory;
  contact_rows_ = rows;
}

Untyped Bodies::last_velocity() {
  return Untyped(
      static_cast<const void*>(body_rows_ == 0 ? nullptr : memory_at<Vec4f>(particle_rows_)));
}

VbdBodyRows Bodies::rows() {
  return {.body = direct(body_),
          .motion = direct(motion_),
          .contact = direct(contact_),
          .joint = direct(joint_),
          .touches = touches(),
          .begin = direct(graph_.rows.begin),
          .items = direct(graph_.rows.items),
          .slip = options_.friction_epsilon * dt_};
}

void Bodies::iterate() {
  follow_bodies();
  for (size_t c = 0; c + 1 < graph_.colors.begin.size(); ++c) {
    const std::span<const int32_t> bodies = graph_.colors.of(static_cast<int32_t>(c));
    run(kernel_of(kInChunks<vbd_body_move, kBodies>), static_cast<int64_t>(bodies.size()),
        {.rows = rows(), .bodies = direct(bodies.data())});
  }
  const auto nodes = static_cast<int64_t>(node_.size());
  const VbdBodyTreeArguments trees = {.first = direct(graph_.tree_first),
                                      .parent = direct(graph_.node_parent),
                                      .bodies = direct(graph_.nodes),
                                      .nodes = direct(node_),
                                      .motion = direct(motion_)};
  run(kernel_of(kInChunks<vbd_body_node, kBodies>), nodes,
      {.rows = rows(),
       .bodies = direct(graph_.nodes),
       .parent = direct(graph_.node_parent),
       .nodes = direct(node_)});
  run(kernel_of(kInChunks<vbd_body_tree, kTrees>),
      static_cast<int64_t>(graph_.tree_first.size()) - 1, trees);
  run(kernel_of(kInChunks<vbd_body_slope, kBodies>), nodes,
      {.rows = rows(), .bodies = direct(graph_.nodes), .nodes = direct(node_)});
  run(take(), static_cast<int64_t>(graph_.tree_first.size()) - 1, trees);
  run(kernel_of(kInChunks<vbd_body_update, kRows>),
      static_cast<int64_t>(contact_.size() + joint_.size()),
      {.motion = direct(motion_),
       .slip = options_.friction_epsilon * dt_,
       .contacts = static_cast<int64_t>(contact_.size()),
       .contact = direct(contact_),
       .joint = direct(joint_)});
  place_touches();
}

// Sets the values of contacts and joints that depend on the graph of bodies. If the rows of a tree
// close no cycle, the tree solver is direct, and the penalty stiffness rho can be high. If rows
// close cycles, the sweeps over colors need a lower rho.
void Bodies::put_graph() {
  if (pairs_ != built_pairs_ || numbers_ != built_numbers_ || acting_ != built_acting_) {
    graph_.build(model_.body_count(), pairs_, numbers_, acting_);
    built_pairs_ = pairs_;
    built_numbers_ = numbers_;
    built_acting_ = acting_;
    node_.resize(graph_.nodes.size());
  }
  constexpr float kSofter = 0.1f;
  // For joints of bodies with a ROD joint: the rows of a rod move many bodies together. The inertia
  // of two bodies is a small part of the inertia that such a row feels. Rods in cycles have the
  // metric of trees.
  constexpr float kRodMetric = 3.0e4f;
  for (size_t k = 0; k < pairs_.size(); ++k) {
    const float factor = graph_.is_outside(pairs_[k]) ? 2.0f : 1.0f;
    const float metric = graph_.has_cycles(pairs_[k]) ? kSofter : 1.0f;
    const auto row = static_cast<size_t>(numbers_[k] >> 3);
    const int32_t kind = (numbers_[k] >> 1) & 3;
    if (kind == kTouchRow) continue;
    if (kind == kContactRow) {
      VbdBodyContact& c = contact_[row];
      c.in_trees = factor;
      c.rho *= metric;
      c.rho_t *= metric;
    } else {
      VbdBodyJoint& j = joint_[row];
      j.in_trees = factor;
      const auto has_rod = [this](int32_t b) { return b >= 0 && has_rod_[size_t(b)] != 0; };
      const bool is_rod = has_rod(j.body[0]) || has_rod(j.body[1]);
      const float scale = !is_rod ? metric : metric == 1.0f ? kRodMetric : 1.0f;
      for (auto* const hard : {&j.points, &j.turns})
        for (VbdJointRow& r : *hard)
          r.rho = scale > 1.0f ? std::max(r.rho, std::min(scale * r.rho, 10.0f * r.stiffness))
                               : scale * r.rho;
      for (VbdAxisRow& of_axis : j.rows) of_axis.rho *= metric;
    }
  }
}

// Moves the bodies without rows to their inertial targets. The iterations move the other bodies.
void Bodies::move_free_bodies() {
  for (int32_t b = 0; b < model_.body_count(); ++b) {
    if (is_kinematic_.data()[b] != 0 || !graph_.rows.of(b).empty()) continue;
    const VbdBody& body = body_[static_cast<size_t>(b)];
    motion_[static_cast<size_t>(b)] = {.moved = body.target,
                                       .turned = body.target_turned,
                                       .turn = log_rotation(body.target_turned)};
  }
}

void Bodies::begin(const SimState& in, const Control* control, const Contacts* contacts, float dt) {
  const Model& m = model_;
  dt_ = dt;
  start_ = in.body_q;
  start_qd_ = in.body_qd;
  start_f_ = in.body_f;
  check_model(control);
  check_step(in, contacts);
  int32_t* const is_kinematic = is_kinematic_.mutable_data();
  for (int32_t b = 0; b < m.body_count(); ++b)
    is_kinematic[b] = int{has_flag(m.body_flags.data()[b], BodyFlags::KINEMATIC)};
  run(kernel_of(vbd_body_predict), m.body_count(),
      {.q = in.body_q,
       .qd = in.body_qd,
       .f = in.body_f,
       .com = m.body_com,
       .mass = m.body_mass,
       .inv_mass = m.body_inv_mass,
       .inertia = m.body_inertia,
       .is_kinematic = is_kinematic_,
       .world = m.body_world,
       .gravity = m.gravity,
       .last_world = m.world_count() - 1,
       .h = dt,
       .guess = static_cast<int64_t>(options_.initial_guess),
       .last_velocity = last_velocity(),
       .body = direct(body_),
       .motion = direct(motion_)});
  pairs_.clear();
  numbers_.clear();
  put_joints(in, control);
  acting_ = pairs_.size();
  contact_.clear();
  contact_origin_.clear();
  contact_slots_.clear();
  if (contacts != nullptr) put_contacts(in, *contacts);
}

void Bodies::finish(const SimState& in, const SimState& out, const Contacts* contacts) {
  const Model& m = model_;
  keep_joints(in);
  keep_contacts(contacts);
  run(kernel_of(vbd_body_finish), m.body_count(),
      {.q = in.body_q,
       .qd = in.body_qd,
       .com = m.body_com,
       .is_kinematic = is_kinematic_,
       .motion = direct(motion_),
       .h = dt_,
       .q_out = out.body_q,
       .qd_out = out.body_qd,
       .last_velocity = last_velocity()});
}

}  // namespace novaphy::vbd
