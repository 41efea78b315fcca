// Joints and articulations of a ModelBuilder.
#include <algorithm>
#include <cmath>
#include <limits>

#include "ball_joint.h"
#include "builder_checks.h"
#include "joint_axes.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

using detail::Where;

void check_axis_counts(std::string_view name, JointType type, const JointArgs& args) {
  const std::string_view of = joint_type_name(type);
  require(of != "unknown", ErrorKind::Value, name, ": joint_type: expected a JointType, got ",
          static_cast<int32_t>(type));
  const JointTraits traits = joint_traits(type);
  const JointAxisCount l = traits.linear_axes, a = traits.angular_axes;
  const auto linear = static_cast<int32_t>(args.linear_axes.size());
  const auto angular = static_cast<int32_t>(args.angular_axes.size());
  const std::string exactly = std::to_string(l.most) + " and " + std::to_string(a.most);
  require(l.least <= linear && linear <= l.most && a.least <= angular && angular <= a.most,
          ErrorKind::Value, name, ": linear_axes, angular_axes: expected ",
          !has_axes(type)     ? "none"
          : l.least == l.most ? exactly
                              : "up to " + std::to_string(l.most) + " each",
          " of a ", of, " joint, got ", linear, " and ", angular);
}

void check_target_mode(const Where& where, int32_t mode) {
  require(mode >= 0 && mode <= static_cast<int32_t>(JointTargetMode::EFFORT), ErrorKind::Value,
          where, ": expected a JointTargetMode, got ", mode);
}

void check_dof(std::string_view name, const JointDofConfig& dof) {
  detail::check_finite({name, "limit_lower"}, dof.limit_lower);
  detail::check_finite({name, "limit_upper"}, dof.limit_upper);
  require(dof.limit_lower <= dof.limit_upper, ErrorKind::Value, name,
          ": limit_lower, limit_upper: expected the lower one first, got ", dof.limit_lower,
          " and ", dof.limit_upper);
  detail::check_not_negative({name, "limit_ke"}, dof.limit_ke);
  detail::check_not_negative({name, "limit_kd"}, dof.limit_kd);
  detail::check_finite({name, "target_q"}, dof.target_q);
  detail::check_finite({name, "target_qd"}, dof.target_qd);
  detail::check_not_negative({name, "target_ke"}, dof.target_ke);
  detail::check_not_negative({name, "target_kd"}, dof.target_kd);
  detail::check_not_negative({name, "damping"}, dof.damping);
  detail::check_not_negative({name, "armature"}, dof.armature);
  detail::check_not_negative({name, "effort_limit"}, dof.effort_limit);
  detail::check_not_negative({name, "velocity_limit"}, dof.velocity_limit);
  detail::check_not_negative({name, "friction"}, dof.friction);
  check_target_mode({name, "actuator_mode"}, static_cast<int32_t>(dof.actuator_mode));
}

void check_quaternion(const Where& where, const float* q) {
  const double norm =
      std::sqrt(static_cast<double>(q[0]) * q[0] + static_cast<double>(q[1]) * q[1] +
                static_cast<double>(q[2]) * q[2] + static_cast<double>(q[3]) * q[3]);
  require(std::abs(norm - 1.0) <= 1e-3, ErrorKind::Value, where,
          ": expected the first of four numbers of length 1 (to 1e-3), a quaternion, got (", q[0],
          ", ", q[1], ", ", q[2], ", ", q[3], ") of length ", norm);
}

}  // namespace

int32_t ModelBuilder::next_coord() const {
  if (joints_.empty()) return 0;
  const Joint& last = joints_.back();
  const int32_t dofs = last.linear + last.angular;
  return last.q_start + dofs + (quaternion_at(last.type) >= 0 ? 1 : 0);
}

int32_t ModelBuilder::next_dof() const {
  return joints_.empty() ? 0
                         : joints_.back().qd_start + joints_.back().linear + joints_.back().angular;
}

// Returns the pose of the child's joint frame in the parent's joint frame, from the bodies' poses.
Transformf ModelBuilder::relative_pose(const Joint& joint) const {
  Transformf anchor = joint.parent_xform;
  if (joint.parent >= 0) anchor = math::multiply(body_q[static_cast<size_t>(joint.parent)], anchor);
  const Transformf child =
      math::multiply(body_q[static_cast<size_t>(joint.child)], joint.child_xform);
  const Transformf identity = Transformf::identity();
  return anchor == identity ? child : math::multiply(math::inverse(anchor), child);
}

int32_t ModelBuilder::append_joint(std::string_view name, JointType type, int32_t parent,
                                   int32_t child, const JointArgs& args) {
  check_axis_counts(name, type, args);
  const detail::JointSize size = detail::joint_size(type, args);
  require(parent >= -1 && parent < body_count(), ErrorKind::Index, name,
          ": parent: expected -1 (the world) to ", body_count() - 1, ", got ", parent);
  require(child >= 0 && child < body_count(), ErrorKind::Index, name, ": child: expected 0 to ",
          body_count() - 1, ", got ", child);
  require(parent != child, ErrorKind::Value, name,
          ": parent, child: expected two different bodies, got ", child, " twice");
  if (parent >= 0) {
    const int32_t of_parent = bodies_[static_cast<size_t>(parent)].world;
    const int32_t of_child = bodies_[static_cast<size_t>(child)].world;
    require(of_parent == of_child, ErrorKind::Value, name,
            ": parent, child: expected two bodies of one world, got worlds ", of_parent, " and ",
            of_child);
  }
  for (const auto* configs : {&args.linear_axes, &args.angular_axes})
    for (const JointDofConfig& dof : *configs) check_dof(name, dof);
  Joint joint{.type = type,
              .parent = parent,
              .child = child,
              .parent_xform = detail::checked_pose({name, "parent_xform"}, args.parent_xform),
              .child_xform = detail::checked_pose({name, "child_xform"}, args.child_xform),
              .linear = size.linear,
              .angular = size.angular,
              .q_start = next_coord(),
              .qd_start = next_dof(),
              .axes = detail::joint_axes(name, type, args, size),
              .filter_parent = args.collision_filter_parent,
              .enabled = args.enabled};
  constexpr int32_t kMax = std::numeric_limits<int32_t>::max();
  require(joint.q_start <= kMax - 8, ErrorKind::Value, name, ": expected at most ", kMax,
          " joint coordinates");
  const int32_t index = joint_count();
  joint.label = args.label.empty() ? "joint_" + std::to_string(index) : args.label;
  check_sizes();

  std::vector<float> q(static_cast<size_t>(size.coords));
  const int32_t quaternion = quaternion_at(type);
  if (quaternion >= 0) q[static_cast<size_t>(quaternion) + 3] = 1.0f;
  std::vector<JointDofConfig> dofs = args.linear_axes;
  dofs.insert(dofs.end(), args.angular_axes.begin(), args.angular_axes.end());
  dofs.resize(static_cast<size_t>(size.dofs()));
  for (size_t k = 0; k < dofs.size() && quaternion < 0; ++k) q[k] = dofs[k].target_q;
  joint_target_q.insert(joint_target_q.end(), q.begin(), q.end());
  if (quaternion < 0) std::fill(q.begin(), q.end(), 0.0f);
  if (quaternion == 3) {
    const Transformf x = relative_pose(joint);
    q = {x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w};
  }
  joint_q.insert(joint_q.end(), q.begin(), q.end());
  for (const JointDofConfig& dof : dofs) {
    joint_qd.push_back(0.0f);
    joint_f.push_back(0.0f);
    joint_act.push_back(0.0f);
    joint_target_qd.push_back(dof.target_qd);
    joint_armature.push_back(dof.armature);
    joint_target_ke.push_back(dof.target_ke);
    joint_target_kd.push_back(dof.target_kd);
    joint_damping.push_back(dof.damping);
    joint_friction.push_back(dof.friction);
    joint_limit_lower.push_back(dof.limit_lower);
    joint_limit_upper.push_back(dof.limit_upper);
    joint_limit_ke.push_back(dof.limit_ke);
    joint_limit_kd.push_back(dof.limit_kd);
    joint_effort_limit.push_back(dof.effort_limit);
    joint_velocity_limit.push_back(dof.velocity_limit);
    joint_target_mode.push_back(static_cast<int32_t>(dof.actuator_mode));
  }
  joints_.push_back(std::move(joint));
  return index;
}

int32_t ModelBuilder::add_joint(JointType type, int32_t parent, int32_t child,
                                const JointArgs& args) {
  return append_joint("add_joint", type, parent, child, args);
}

int32_t ModelBuilder::append_axis_joint(std::string_view name, JointType type, int32_t parent,
                                        int32_t child, const AxisJointArgs& args) {
  JointArgs general{.parent_xform = args.parent_xform,
                    .child_xform = args.child_xform,
                    .collision_filter_parent = args.collision_filter_parent,
                    .enabled = args.enabled,
                    .label = args.label};
  auto& axes = type == JointType::REVOLUTE ? general.angular_axes : general.linear_axes;
  axes.push_back(args.dof.value_or(default_joint_cfg));
  return append_joint(name, type, parent, child, general);
}

int32_t ModelBuilder::add_joint_revolute(int32_t parent, int32_t child, const AxisJointArgs& args) {
  return append_axis_joint("add_joint_revolute", JointType::REVOLUTE, parent, child, args);
}

int32_t ModelBuilder::add_joint_prismatic(int32_t parent, int32_t child,
                                          const AxisJointArgs& args) {
  return append_axis_joint("add_joint_prismatic", JointType::PRISMATIC, parent, child, args);
}

int32_t ModelBuilder::add_joint_ball(int32_t parent, int32_t child, const BallJointArgs& args) {
  constexpr std::string_view name = "add_joint_ball";
  detail::check_ball(name, args);
  const int32_t joint = append_joint(name, JointType::BALL, parent, child,
                                     {.parent_xform = args.parent_xform,
                                      .child_xform = args.child_xform,
                                      .collision_filter_parent = args.collision_filter_parent,
                                      .enabled = args.enabled,
                                      .label = args.label});
  detail::set_ball(*this, args);
  return joint;
}

int32_t ModelBuilder::add_joint_fixed(int32_t parent, int32_t child, const JointArgs& args) {
  return append_joint("add_joint_fixed", JointType::FIXED, parent, child, args);
}

int32_t ModelBuilder::add_joint_free(int32_t child, const FreeJointArgs& args) {
  return append_joint("add_joint_free", JointType::FREE, args.parent, child,
                      {.parent_xform = args.parent_xform,
                       .child_xform = args.child_xform,
                       .collision_filter_parent = args.collision_filter_parent,
                       .enabled = args.enabled,
                       .label = args.label});
}

int32_t ModelBuilder::add_joint_distance(int32_t parent, int32_t child,
                                         const DistanceJointArgs& args) {
  constexpr std::string_view name = "add_joint_distance";
  detail::check_finite({name, "min_distance"}, args.min_distance);
  detail::check_finite({name, "max_distance"}, args.max_distance);
  detail::check_not_negative({name, "limit_ke"}, args.limit_ke);
  detail::check_not_negative({name, "limit_kd"}, args.limit_kd);
  const float lower = args.min_distance < 0.0f ? -kJointUnlimited : args.min_distance;
  const float upper = args.max_distance < 0.0f ? kJointUnlimited : args.max_distance;
  require(lower <= upper, ErrorKind::Value, name,
          ": min_distance, max_distance: expected the shorter one first, got ", args.min_distance,
          " and ", args.max_distance);
  const int32_t joint = append_joint(name, JointType::DISTANCE, parent, child,
                                     {.parent_xform = args.parent_xform,
                                      .child_xform = args.child_xform,
                                      .collision_filter_parent = args.collision_filter_parent,
                                      .enabled = args.enabled,
                                      .label = args.label});
  const auto first = static_cast<size_t>(joints_.back().qd_start);
  joint_limit_lower[first] = lower;
  joint_limit_upper[first] = upper;
  joint_limit_ke[first] = args.limit_ke;
  joint_limit_kd[first] = args.limit_kd;
  return joint;
}

int32_t ModelBuilder::add_joint_d6(int32_t parent, int32_t child, const JointArgs& args) {
  return append_joint("add_joint_d6", JointType::D6, parent, child, args);
}

// `axis` is the normal of the plane. The axis vectors in `args` are ignored.
int32_t ModelBuilder::add_joint_planar(int32_t parent, int32_t child, const Vec3f& axis,
                                       JointArgs args) {
  constexpr std::string_view name = "add_joint_planar";
  if (args.linear_axes.empty()) args.linear_axes.assign(2, default_joint_cfg);
  if (args.angular_axes.empty()) args.angular_axes.assign(1, default_joint_cfg);
  check_axis_counts(name, JointType::PLANAR, args);
  const Vec3f normal = detail::unit_axis(name, axis);
  const auto [x, y] = detail::plane_axes(normal);
  args.linear_axes[0].axis = x;
  args.linear_axes[1].axis = y;
  args.angular_axes[0].axis = normal;
  return append_joint(name, JointType::PLANAR, parent, child, args);
}

int32_t ModelBuilder::add_articulation(std::span<const int32_t> joints, std::string label) {
  constexpr std::string_view name = "add_articulation";
  require(!joints.empty(), ErrorKind::Value, name, ": joints: expected at least one, got none");
  std::set<int32_t> children;
  for (size_t k = 0; k < joints.size(); ++k) {
    require(joints[k] >= 0 && joints[k] < joint_count(), ErrorKind::Index, Where{name, "joints", k},
            ": expected 0 to ", joint_count() - 1, ", got ", joints[k]);
    require(k == 0 || joints[k] == joints[k - 1] + 1, ErrorKind::Value, Where{name, "joints", k},
            ": expected ", joints[0] + static_cast<int32_t>(k),
            ": the joints of an articulation are contiguous and increasing, got ", joints[k]);
    const Joint& joint = joints_[static_cast<size_t>(joints[k])];
    const auto refuse = [&](bool good, auto&&... why) {
      require(good, ErrorKind::Value, name, ": joint ", joints[k], " (\"", joint.label,
              "\"): ", why...);
    };
    refuse(joint.articulation < 0, "expected one of no articulation, got one of ",
           joint.articulation);
    refuse(k != 0 || joint.parent < 0,
           "expected the root, with the parent -1 (the world), got the parent ", joint.parent);
    refuse(k == 0 || joint.parent >= 0,
           "expected one root, got a second joint with the parent -1 (the world)");
    refuse(k == 0 || children.contains(joint.parent),
           "expected a parent that an earlier joint of the articulation moves, got body ",
           joint.parent, ": parents come first, and a cycle has no such order");
    refuse(
        bodies_[static_cast<size_t>(joint.child)].mover < 0 && children.insert(joint.child).second,
        "expected a child that no other joint of an articulation has, got body ", joint.child);
    refuse(k == 0 || !bodies_[static_cast<size_t>(joint.child)].is_kinematic,
           "expected a dynamic child, got the kinematic body ", joint.child,
           ": only the root's may be one");
    const int32_t world = bodies_[static_cast<size_t>(joint.child)].world;
    const auto root = static_cast<size_t>(joints_[static_cast<size_t>(joints[0])].child);
    refuse(world == bodies_[root].world, "expected a child of world ", bodies_[root].world,
           ", got one of world ", world);
  }
  const int32_t index = articulation_count();
  for (const int32_t j : joints) {
    Joint& joint = joints_[static_cast<size_t>(j)];
    joint.articulation = index;
    bodies_[static_cast<size_t>(joint.child)].mover = j;
  }
  if (label.empty()) label = "articulation_" + std::to_string(index);
  articulations_.push_back({joints.front(), joints.back() + 1, std::move(label)});
  return index;
}

void ModelBuilder::append_joints(const ModelBuilder& b, int32_t first_body,
                                 const Transformf& xform) {
  const Transformf identity = Transformf::identity();
  const bool moves = xform != identity;
  const int32_t first_coord = joint_coord_count(), first_dof = joint_dof_count();
  const int32_t first_articulation = articulation_count(), first_joint = joint_count();
  for (auto body = bodies_.begin() + first_body; body != bodies_.end(); ++body)
    if (body->mover >= 0) body->mover += first_joint;
  const auto append = [](auto& to, const auto& from) {
    to.insert(to.end(), from.begin(), from.end());
  };
  append(joint_q, b.joint_q);
  append(joint_target_q, b.joint_target_q);
  append(joint_target_mode, b.joint_target_mode);
#define NOVAPHY_APPEND(name, ...) append(name, b.name);
  NOVAPHY_MODEL_JOINT_DOF_FIELDS(NOVAPHY_APPEND)
#undef NOVAPHY_APPEND
  for (Joint joint : b.joints_) {
    joint.q_start += first_coord;
    joint.qd_start += first_dof;
    joint.child += first_body;
    if (joint.articulation >= 0) joint.articulation += first_articulation;
    if (joint.mimic >= 0) joint.mimic += first_joint;
    if (joint.parent >= 0) {
      joint.parent += first_body;
    } else if (moves && joint.type == JointType::FREE && joint.parent_xform == identity) {
      // A FREE joint to the world without a frame of its own there has a world pose as coordinates.
      float* const q = &joint_q[static_cast<size_t>(joint.q_start)];
      float* const qd = &joint_qd[static_cast<size_t>(joint.qd_start)];
      const Transformf x = math::multiply(xform, {{q[0], q[1], q[2]}, {q[3], q[4], q[5], q[6]}});
      const float moved[] = {x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w};
      std::copy_n(moved, 7, q);
      for (int part = 0; part < 6 && xform.q != identity.q; part += 3) {
        const Vec3f v = math::rotate(xform.q, Vec3f{qd[part], qd[part + 1], qd[part + 2]});
        const float turned[] = {v.x, v.y, v.z};
        std::copy_n(turned, 3, qd + part);
      }
    } else if (moves) {
      joint.parent_xform = math::multiply(xform, joint.parent_xform);
    }
    joints_.push_back(std::move(joint));
  }
  for (Articulation articulation : b.articulations_) {
    articulation.start += first_joint;
    articulation.end += first_joint;
    articulations_.push_back(std::move(articulation));
  }
}

// Returns the filtered pairs: those of the user, and those of bodies that a joint connects.
std::set<std::pair<int32_t, int32_t>> ModelBuilder::all_filter_pairs() const {
  std::set<std::pair<int32_t, int32_t>> pairs = filter_pairs_;
  std::vector<std::vector<int32_t>> shapes(bodies_.size());
  for (int32_t s = 0; s < shape_count(); ++s) {
    const int32_t body = shapes_[static_cast<size_t>(s)].body;
    if (body >= 0) shapes[static_cast<size_t>(body)].push_back(s);
  }
  for (const Joint& joint : joints_) {
    if (joint.parent < 0 || !joint.filter_parent) continue;
    for (const int32_t child : shapes[static_cast<size_t>(joint.child)]) {
      if (!shapes_[static_cast<size_t>(child)].cfg.collision_filter_parent) continue;
      for (const int32_t parent : shapes[static_cast<size_t>(joint.parent)])
        pairs.insert(std::minmax(child, parent));
    }
  }
  return pairs;
}

void ModelBuilder::add_constraint_mimic(int32_t joint0, int32_t joint1, float coef0, float coef1) {
  constexpr std::string_view name = "add_constraint_mimic";
  detail::check_finite({name, "coef0"}, coef0);
  detail::check_finite({name, "coef1"}, coef1);
  const auto one_dof = [&](const char* argument, int32_t index) {
    require(index >= 0 && index < joint_count(), ErrorKind::Index, name, ": ", argument,
            ": expected 0 to ", joint_count() - 1, ", got ", index);
    const Joint& joint = joints_[static_cast<size_t>(index)];
    require(has_axes(joint.type) && !joint_traits(joint.type).is_chain, ErrorKind::Value, name,
            ": ", argument, ": joint ", index, " (\"", joint.label,
            "\"): expected a REVOLUTE or PRISMATIC joint, got ", joint_type_name(joint.type));
  };
  one_dof("joint0", joint0);
  one_dof("joint1", joint1);
  Joint& joint = joints_[static_cast<size_t>(joint0)];
  require(joint.mimic < 0, ErrorKind::Value, name, ": joint0: joint ", joint0, " (\"", joint.label,
          "\"): expected one that mimics no other, it mimics joint ", joint.mimic);
  for (int32_t j = joint1; j >= 0; j = joints_[static_cast<size_t>(j)].mimic)
    require(j != joint0, ErrorKind::Value, name,
            ": joint1: expected a joint that does not follow joint ", joint0, " (\"", joint.label,
            "\"), got ", joint1);
  joint.mimic = joint1;
  joint.mimic_coef = {coef0, coef1};
}

void ModelBuilder::check_joints() const {
  constexpr std::string_view name = "finalize";
  std::vector<char> held(bodies_.size());
  for (const Joint& joint : joints_) {
    if (joint.mimic >= 0) {
      const Joint& leader = joints_[static_cast<size_t>(joint.mimic)];
      require(joint.articulation == leader.articulation, ErrorKind::Value, name, ": joint \"",
              joint.label, "\": expected the joint that it follows, \"", leader.label,
              "\", in the same articulation");
    }
    held[static_cast<size_t>(joint.child)] = 1;
    const int32_t at = quaternion_at(joint.type);
    if (at < 0) continue;
    const auto row = static_cast<size_t>(joint.q_start + at);
    check_quaternion({name, "joint_q", row}, &joint_q[row]);
    check_quaternion({name, "joint_target_q", row}, &joint_target_q[row]);
  }
  for (size_t b = 0; b < bodies_.size(); ++b)
    require(held[b] != 0, ErrorKind::Value, name, ": body ", b, " (\"", bodies_[b].label,
            "\"): expected a joint with this child: a link needs one, a body of add_body has one");
  for (size_t k = 0; k < joint_q.size(); ++k) {
    detail::check_finite({name, "joint_q", k}, joint_q[k]);
    detail::check_finite({name, "joint_target_q", k}, joint_target_q[k]);
  }
  for (size_t k = 0; k < joint_qd.size(); ++k) {
#define NOVAPHY_CHECK_FINITE(list, ...) detail::check_finite({name, #list, k}, list[k]);
    NOVAPHY_MODEL_JOINT_DOF_FIELDS(NOVAPHY_CHECK_FINITE)
#undef NOVAPHY_CHECK_FINITE
    check_target_mode({name, "joint_target_mode", k}, joint_target_mode[k]);
    require(joint_limit_lower[k] <= joint_limit_upper[k], ErrorKind::Value,
            Where{name, "joint_limit_lower", k}, ": expected at most joint_limit_upper, ",
            joint_limit_upper[k], ", got ", joint_limit_lower[k]);
    detail::check_not_negative({name, "joint_armature", k}, joint_armature[k]);
    detail::check_not_negative({name, "joint_target_ke", k}, joint_target_ke[k]);
    detail::check_not_negative({name, "joint_target_kd", k}, joint_target_kd[k]);
    detail::check_not_negative({name, "joint_damping", k}, joint_damping[k]);
    detail::check_not_negative({name, "joint_friction", k}, joint_friction[k]);
    detail::check_not_negative({name, "joint_limit_ke", k}, joint_limit_ke[k]);
    detail::check_not_negative({name, "joint_limit_kd", k}, joint_limit_kd[k]);
    detail::check_not_negative({name, "joint_effort_limit", k}, joint_effort_limit[k]);
    detail::check_not_negative({name, "joint_velocity_limit", k}, joint_velocity_limit[k]);
  }
}

void ModelBuilder::upload_joints(Model& m) const {
  const auto upload = [](auto& array, const auto& values) {
    array.copy_from_host(std::span(values.data(), values.size()));
  };
  const size_t joints = joints_.size();
  const auto column = [&](auto get) {
    std::vector<decltype(get(joints_[0]))> values(joints);
    std::transform(joints_.begin(), joints_.end(), values.begin(), get);
    return values;
  };
  upload(m.joint_type, column([](const Joint& j) { return static_cast<int32_t>(j.type); }));
  upload(m.joint_parent, column([](const Joint& j) { return j.parent; }));
  upload(m.joint_child, column([](const Joint& j) { return j.child; }));
  upload(m.joint_X_p, column([](const Joint& j) { return j.parent_xform; }));
  upload(m.joint_X_c, column([](const Joint& j) { return j.child_xform; }));
  upload(m.joint_dof_dim, column([](const Joint& j) { return Vec2i{j.linear, j.angular}; }));
  upload(m.joint_enabled, column([](const Joint& j) { return static_cast<uint8_t>(j.enabled); }));
  upload(m.joint_articulation, column([](const Joint& j) { return j.articulation; }));
  upload(m.joint_world,
         column([&](const Joint& j) { return bodies_[static_cast<size_t>(j.child)].world; }));
  upload(m.joint_mimic, column([](const Joint& j) { return j.mimic; }));
  upload(m.joint_mimic_coef, column([](const Joint& j) { return j.mimic_coef; }));
  m.joint_label = column([](const Joint& j) { return j.label; });

  std::vector<int32_t> q_start = column([](const Joint& j) { return j.q_start; });
  std::vector<int32_t> qd_start = column([](const Joint& j) { return j.qd_start; });
  q_start.push_back(joint_coord_count());
  qd_start.push_back(joint_dof_count());
  upload(m.joint_q_start, q_start);
  upload(m.joint_qd_start, qd_start);

  upload(m.joint_ancestor, column([&](const Joint& j) {
           return j.articulation < 0 || j.parent < 0 ? -1
                                                     : bodies_[static_cast<size_t>(j.parent)].mover;
         }));

  std::vector<Vec3f> axes;
  std::vector<float> q = joint_q, qd = joint_qd;
  for (const Joint& joint : joints_) {
    axes.insert(axes.end(), joint.axes.begin(), joint.axes.end());
    const auto body = static_cast<size_t>(joint.child);
    if (bodies_[body].is_link || joint.type != JointType::FREE) continue;
    // The free joint of add_body starts at the pose of the body unless its coordinates were edited.
    float* const at = &q[static_cast<size_t>(joint.q_start)];
    const Transformf& x = body_q[body];
    if (Transformf{{at[0], at[1], at[2]}, {at[3], at[4], at[5], at[6]}} == bodies_[body].added_at) {
      const float pose[] = {x.p.x, x.p.y, x.p.z, x.q.x, x.q.y, x.q.z, x.q.w};
      std::copy_n(pose, 7, at);
    }
    float* const rate = &qd[static_cast<size_t>(joint.qd_start)];
    if (std::all_of(rate, rate + 6, [](float v) { return v == 0.0f; })) {
      const Vec3f &v = body_qd[body].linear, &w = body_qd[body].angular;
      const float twist[] = {v.x, v.y, v.z, w.x, w.y, w.z};
      std::copy_n(twist, 6, rate);
    }
  }
  for (const Joint& joint : joints_) {
    if (joint.mimic < 0) continue;
    double offset = 0.0, ratio = 1.0;
    const Joint* leader = &joint;
    for (; leader->mimic >= 0; leader = &joints_[static_cast<size_t>(leader->mimic)]) {
      offset += ratio * static_cast<double>(leader->mimic_coef.x);
      ratio *= static_cast<double>(leader->mimic_coef.y);
    }
    const auto b = static_cast<float>(ratio);
    q[static_cast<size_t>(joint.q_start)] =
        b * q[static_cast<size_t>(leader->q_start)] + static_cast<float>(offset);
    qd[static_cast<size_t>(joint.qd_start)] = b * qd[static_cast<size_t>(leader->qd_start)];
  }
  upload(m.joint_axis, axes);
  upload(m.joint_q, q);
  upload(m.joint_target_q, joint_target_q);
  upload(m.joint_target_mode, joint_target_mode);
#define NOVAPHY_UPLOAD(name, ...) upload(m.name, name);
  NOVAPHY_MODEL_JOINT_DOF_FIELDS(NOVAPHY_UPLOAD)
#undef NOVAPHY_UPLOAD
  upload(m.joint_qd, qd);

  std::vector<int32_t> start, end;
  for (const Articulation& a : articulations_) {
    start.push_back(a.start);
    end.push_back(a.end);
    m.articulation_label.push_back(a.label);
    m.max_joints_per_articulation = std::max(m.max_joints_per_articulation, a.end - a.start);
    m.max_dofs_per_articulation =
        std::max(m.max_dofs_per_articulation,
                 qd_start[static_cast<size_t>(a.end)] - qd_start[static_cast<size_t>(a.start)]);
  }
  start.push_back(joint_count());
  upload(m.articulation_start, start);
  upload(m.articulation_end, end);
}

}  // namespace novaphy
