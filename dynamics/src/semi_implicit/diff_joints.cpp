#include "novaphy/dynamics/semi_implicit/diff_joints.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <mutex>
#include <string>

#include "../step_sources.h"
#include "diff_trace_columns.h"
#include "joint_forces.h"
#include "novaphy/core/error.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/joint_types.h"
#include "novaphy/dynamics/semi_implicit/diff_body_contacts.h"
#include "novaphy/dynamics/semi_implicit/penalty_joint_trace.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace novaphy::diff {

using detail::Columns;
using nova::Access;
using nova::Bool;
using nova::DType;
using nova::Int;
using nova::Operand;
using nova::Real;
using nova::TraceContext;

namespace {

constexpr int32_t kDofs = 6;                               // largest number of any joint
constexpr int32_t kFree = 16, kDistance = 17, kBall = 18;  // other layouts: 4 linear + angular

int32_t layout_of(JointType type, const Vec2i& dims) {
  const JointTraits traits = joint_traits(type);
  if (traits.constraint == JointConstraint::NONE) return kFree;
  if (traits.constraint == JointConstraint::DISTANCE) return kDistance;
  return traits.quaternion >= 0 ? kBall : 4 * dims.x + dims.y;
}

JointBody<Real> load_body(TraceContext& c, const Int& body) {
  JointBody<Real> b = {Columns(c, "body_q", &body).transform(),
                       Columns(c, "body_qd", &body).spatial(),
                       Columns(c, "body_com", &body).vec3()};
  // The world has no row and reads as zeros, so its quaternion is set to the identity.
  b.q.q.w = select(body < Int(0), Real(1.0f), b.q.q.w);
  return b;
}

JointDof<Real> load_dof(TraceContext& c, int32_t k) {
  const Int dof = c.i32(c.source("dofs"), k), at = c.i32(c.source("coordinates"), k);
  const Int mode = c.i32(c.source("joint_target_mode"), dof, 0);
  const auto is = [&](JointTargetMode wanted) { return mode == Int(static_cast<int32_t>(wanted)); };
  const Bool both_targets = is(JointTargetMode::POSITION_VELOCITY);
  const Bool position = both(at >= Int(0), either(both_targets, is(JointTargetMode::POSITION)));
  const Bool velocity = either(both_targets, is(JointTargetMode::VELOCITY));
  JointDof<Real> d{.axis = Columns(c, "joint_axis", &dof).vec3()};
  for_each_dof_number(
      [&](Real& to, const auto& source, int32_t place) {
        to = Columns(c, source.name, place == kAt.target_q ? &at : &dof)[0];
      },
      d, kStepSources, kAt);
  select_drive(position, velocity, d);
  return d;
}

std::vector<Real> list(const JointWrench<Real>& w) {
  return {w.parent.linear.x,  w.parent.linear.y,  w.parent.linear.z, w.parent.angular.x,
          w.parent.angular.y, w.parent.angular.z, w.child.linear.x,  w.child.linear.y,
          w.child.linear.z,   w.child.angular.x,  w.child.angular.y, w.child.angular.z};
}

// Returns the wrench of a joint of one layout (numbers of linear and angular dofs, or a type).
std::vector<Real> layout_wrench(TraceContext& c, int32_t layout, const JointFrames<Real>& frames,
                                const JointAttach<Real>& attach) {
  const Vec3<Real> none = joint_detail::no_vector<Real>();
  JointWrench<Real> wrench = {{none, none}, {none, none}};
  const bool six = layout == kFree || layout == kDistance;
  const int32_t linear = six || layout == kBall ? 0 : layout / 4;
  const int32_t angular = layout == kBall ? 3 : six ? 0 : layout % 4;
  const int32_t count = six ? kDofs : linear + angular;
  JointDof<Real> dofs[kDofs];
  for (int32_t k = 0; k < count; ++k) dofs[k] = load_dof(c, k);
  if (layout == kDistance) {
    wrench = distance_joint_wrench(frames, dofs[0].limit);
  } else if (!six) {
    wrench = penalty_joint_wrench(frames, dofs, linear, angular, layout == kBall, attach);
  }
  if (six)
    wrench.child =
        wrench.child + SpatialVector<Real>{{dofs[0].force, dofs[1].force, dofs[2].force},
                                           {dofs[3].force, dofs[4].force, dofs[5].force}};
  return list(wrench);
}

std::vector<Real> joint_wrenches(TraceContext& c, const std::vector<int32_t>& layouts) {
  const JointFrames<Real> frames = joint_frames(
      load_body(c, c.i32(c.source("sides"), 0)), load_body(c, c.i32(c.source("sides"), 1)),
      Columns(c, "joint_X_p").transform(), Columns(c, "joint_X_c").transform());
  const Int layout = c.i32(c.source("layout"));
  const JointAttach<Real> attach = {c.param(0), c.param(1)};
  std::vector<Real> out;
  for (const int32_t l : layouts) {
    const std::vector<Real> one = layout_wrench(c, l, frames, attach);
    if (out.empty()) {
      out = one;
      continue;
    }
    for (size_t k = 0; k < out.size(); ++k) out[k] = select(layout == Int(l), one[k], out[k]);
  }
  return out;
}

// Returns the kernel for models with joints of these layouts. Each set of layouts has its own
// kernel.
const nova::Kernel& joint_kernel(const std::vector<int32_t>& layouts) {
  static std::mutex mutex;
  static auto& kernels = *new std::map<std::vector<int32_t>, nova::Kernel>;
  const std::lock_guard lock(mutex);
  if (const auto at = kernels.find(layouts); at != kernels.end()) return at->second;
  std::string name = "penalty_joint_wrenches";
  for (const int32_t l : layouts) name += "_" + std::to_string(l);
  std::vector<nova::SourceSpec> sources = {{"sides", DType::I32, 2, Access::Direct},
                                           {"layout", DType::I32, 1, Access::Direct},
                                           {"dofs", DType::I32, kDofs, Access::Direct},
                                           {"coordinates", DType::I32, kDofs, Access::Direct},
                                           {"joint_X_p", DType::F32, 7, Access::Direct},
                                           {"joint_X_c", DType::F32, 7, Access::Direct},
                                           {"body_q", DType::F32, 7, Access::Indexed},
                                           {"body_qd", DType::F32, 6, Access::Indexed},
                                           {"body_com", DType::F32, 3, Access::Indexed},
                                           {"joint_axis", DType::F32, 3, Access::Indexed},
                                           {"joint_target_mode", DType::I32, 1, Access::Indexed}};
  JointDof<float> d;
  for_each_dof_number(
      [&](float, const auto& source) {
        sources.push_back({source.name, DType::F32, 1, Access::Indexed});
      },
      d, kStepSources);
  return kernels
      .emplace(layouts,
               nova::make_kernel(name, sources, {{"wrench", 12}},
                                 [layouts](TraceContext& c) { return joint_wrenches(c, layouts); }))
      .first->second;
}

bool any(const Array& force) {
  if (force.rows() == 0) return false;
  const nova::GradInfo* info = nova::find_grad_info(*force.range());
  if (info != nullptr && (info->requires_grad || nova::Tape::active() != nullptr)) return true;
  const std::vector<float> values = DeviceArray<float>(force).to_host();
  return std::any_of(values.begin(), values.end(), [](float f) { return f != 0.0f; });
}

}  // namespace

DiffJoints::DiffJoints(const Model& model, const Attach& attach)
    : attach_(attach), checks_(std::make_unique<JointForces>()) {
  const auto check = [](const char* name, float value) {
    require(std::isfinite(value) && value >= 0.0f, ErrorKind::Value,
            "DiffSemiImplicitSolver: ", name, ": expected a finite number >= 0, got ", value);
  };
  check("joint_attach_ke", attach.ke);
  check("joint_attach_kd", attach.kd);
  JointForces::check_covered(model, "DiffSemiImplicitSolver");
  hold_ = std::ranges::any_of(model.joint_type.to_host(), [](int32_t type) {
    return type != static_cast<int32_t>(JointType::FREE);
  });
}
DiffJoints::~DiffJoints() = default;
DiffJoints::DiffJoints(DiffJoints&&) noexcept = default;
DiffJoints& DiffJoints::operator=(DiffJoints&&) noexcept = default;

void DiffJoints::find_tables(const Model& m) {
  const std::vector<int32_t> type = m.joint_type.to_host(), parent = m.joint_parent.to_host(),
                             child = m.joint_child.to_host(), q_start = m.joint_q_start.to_host(),
                             qd_start = m.joint_qd_start.to_host();
  const std::vector<uint8_t> enabled = m.joint_enabled.to_host();
  const std::vector<Vec2i> dims = m.joint_dof_dim.to_host();
  const size_t joints = type.size();
  std::vector<int32_t> sides(2 * joints, -1), layout(joints), dofs(kDofs * joints, -1),
      coordinates(kDofs * joints, -1), layouts;
  for (size_t j = 0; j < joints; ++j) {
    layout[j] = layout_of(static_cast<JointType>(type[j]), dims[j]);
    if (enabled[j] == 0) continue;
    sides[2 * j] = layout[j] == kFree ? -1 : parent[j];
    sides[2 * j + 1] = child[j];
    const bool has_targets = layout[j] < kFree;
    for (int32_t k = 0; k < dims[j].x + dims[j].y; ++k) {
      const size_t at = kDofs * j + static_cast<size_t>(k);
      dofs[at] = qd_start[j] + k;
      if (has_targets) coordinates[at] = q_start[j] + k;
    }
    layouts.push_back(layout[j]);
  }
  std::ranges::sort(layouts);
  layouts.erase(std::unique(layouts.begin(), layouts.end()), layouts.end());
  kernel_ = layouts.empty() ? nullptr : &joint_kernel(layouts);
  const auto upload = [&](const std::vector<int32_t>& values, size_t width) {
    DeviceArray<int32_t> table(joints, m.device(), width);
    table.copy_from_host(std::span<const int32_t>(values));
    return table;
  };
  sides_ = upload(sides, 2);
  layout_ = upload(layout, 1);
  dofs_ = upload(dofs, kDofs);
  coordinates_ = upload(coordinates, kDofs);
  sides_of_bodies_ = nova::make_incidence(nova::operand_of(sides_), m.body_count());
}

void DiffJoints::begin(const Model& m, const Control* control, float dt) {
  act_ = false;
  if (m.joint_count() == 0) return;
  // A capture does not record the checks below. A replay throws if this array was written since.
  depend_on({&m.joint_enabled});
  const UntrackedScope untracked;
  checks_->check_edits(m, control, "DiffSemiImplicitSolver");
  if (!hold_ && !any(control != nullptr ? control->joint_f : m.joint_f)) return;
  checks_->prepare(m, {attach_.ke, attach_.kd}, dt);
  if (!enabled_.matches(m.joint_enabled)) {
    find_tables(m);
    enabled_.set(m.joint_enabled);
  }
  act_ = kernel_ != nullptr;
}

void DiffJoints::add(const Model& m, const Control* control, const Operand& body_q,
                     const Operand& body_qd, const Operand& body_f, const Operand& wrenches,
                     const Operand& sum) {
  std::vector<Operand> in = {nova::operand_of(sides_),
                             nova::operand_of(layout_),
                             nova::operand_of(dofs_),
                             nova::operand_of(coordinates_),
                             nova::operand_of(m.joint_X_p),
                             nova::operand_of(m.joint_X_c),
                             body_q,
                             body_qd,
                             nova::operand_of(m.body_com),
                             nova::operand_of(m.joint_axis),
                             nova::operand_of(m.joint_target_mode)};
  JointDof<float> d;
  for_each_dof_number(
      [&](float, const auto& source) {
        in.push_back(nova::operand_of(*source.find(m, nullptr, control)));
      },
      d, kStepSources);
  const nova::Param params[] = {attach_.ke, attach_.kd};
  Operand both_sides = wrenches;
  both_sides.rows /= 2;
  both_sides.width *= 2;
  kernel_->launch(both_sides.rows, in, both_sides, {.params = params});
  add_wrenches(body_f, wrenches, sides_of_bodies_, sum);
}

}  // namespace novaphy::diff
