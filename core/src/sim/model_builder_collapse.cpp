// ModelBuilder::collapse_fixed_joints: merges bodies that a FIXED joint connects.
#include <algorithm>

#include "mass_properties.h"
#include "novaphy/core/error.h"
#include "novaphy/core/sim/model_builder.h"
#include "novaphy/math/functions.h"

namespace novaphy {
namespace {

template <class T>
void keep_rows(std::vector<T>& values, const std::vector<char>& keep) {
  size_t to = 0;
  for (size_t k = 0; k < values.size(); ++k) {
    if (!keep[k]) continue;
    if (to != k) values[to] = std::move(values[k]);
    ++to;
  }
  values.resize(to);
}

// Returns the new index of each old index; -1 for a removed item.
std::vector<int32_t> remap_of(const std::vector<char>& keep) {
  std::vector<int32_t> remap(keep.size(), -1);
  int32_t next = 0;
  for (size_t k = 0; k < keep.size(); ++k)
    if (keep[k]) remap[k] = next++;
  return remap;
}

}  // namespace

// Returns for each joint 1 if collapse_fixed_joints keeps the joint, else 0.
std::vector<char> ModelBuilder::joints_that_stay(std::span<const std::string> keep) const {
  std::vector<int32_t> held(bodies_.size()), children(bodies_.size());
  for (const Joint& joint : joints_) {
    ++held[static_cast<size_t>(joint.child)];
    if (joint.parent >= 0) ++children[static_cast<size_t>(joint.parent)];
  }
  std::vector<char> stays(joints_.size(), 1);
  for (size_t j = 0; j < joints_.size(); ++j) {
    const Joint& joint = joints_[j];
    const auto child = static_cast<size_t>(joint.child);
    const bool kept = std::find(keep.begin(), keep.end(), joint.label) != keep.end();
    const bool is_lifted =
        joint.parent >= 0 &&
        bodies_[child].gravcomp != bodies_[static_cast<size_t>(joint.parent)].gravcomp;
    const bool root_of_many = joint.articulation >= 0 && joint.parent < 0 && children[child] > 1;
    if (!can_move(joint.type) && joint.enabled && !kept && held[child] == 1 &&
        !(bodies_[child].is_kinematic && joint.parent >= 0) && !root_of_many && !is_lifted)
      stays[j] = 0;
  }
  return stays;
}

CollapsedJoints ModelBuilder::collapse_fixed_joints(std::span<const std::string> keep) {
  check_sizes();
  const std::vector<char> stays = joints_that_stay(keep);
  const size_t bodies = bodies_.size();
  // For each body, the body that it is merged into and its pose in that body. A body that stays is
  // merged into itself.
  std::vector<int32_t> into(bodies);
  std::vector<Transformf> pose(bodies, Transformf::identity());
  for (size_t b = 0; b < bodies; ++b) into[b] = static_cast<int32_t>(b);
  for (size_t j = 0; j < joints_.size(); ++j) {
    if (stays[j]) continue;
    const auto child = static_cast<size_t>(joints_[j].child);
    into[child] = joints_[j].parent;
    pose[child] = math::multiply(joints_[j].parent_xform, math::inverse(joints_[j].child_xform));
  }
  // Follows the chain of merged bodies to a body that stays, or to the world. A cycle of FIXED
  // joints is an error: each child has a single parent joint, so a cycle is connected to nothing
  // else.
  for (size_t b = 0; b < bodies; ++b) {
    for (size_t steps = 0; into[b] >= 0 && into[static_cast<size_t>(into[b])] != into[b]; ++steps) {
      const auto next = static_cast<size_t>(into[b]);
      require(steps < bodies, ErrorKind::Value, "collapse_fixed_joints: body ", b, " (\"",
              bodies_[b].label, "\"): expected no cycle of FIXED joints");
      pose[b] = math::multiply(pose[next], pose[b]);
      into[b] = into[next];
    }
  }
  merge_bodies(into, pose);
  return drop_merged(into, pose, stays);
}

// Moves mass and shapes of each body to the body that it is merged into. Velocities refer to the
// center of mass, which moves, so they are recomputed to keep the motion.
void ModelBuilder::merge_bodies(const std::vector<int32_t>& into,
                                const std::vector<Transformf>& pose) {
  const std::vector<detail::MassProperties> masses = exact_body_masses();
  std::vector<detail::MassProperties> base(bodies_.size());
  const auto goes = [&](size_t b) { return into[b] != static_cast<int32_t>(b); };
  for (size_t b = 0; b < bodies_.size(); ++b)
    if (!goes(b)) base[b] = base_mass(bodies_[b]);
  for (size_t b = 0; b < bodies_.size(); ++b) {
    if (!goes(b) || into[b] < 0) continue;
    detail::MassProperties& target = base[static_cast<size_t>(into[b])];
    target = detail::combined(target, detail::moved(masses[b], pose[b]));
  }
  for (size_t b = 0; b < bodies_.size(); ++b) {
    if (goes(b)) continue;
    Body& body = bodies_[b];
    body.mass = static_cast<float>(base[b].mass);
    body.com = {static_cast<float>(base[b].com.x), static_cast<float>(base[b].com.y),
                static_cast<float>(base[b].com.z)};
    for (int i = 0; i < 3; ++i)
      for (int k = 0; k < 3; ++k)
        body.inertia.m[i][k] = static_cast<float>(base[b].inertia.m[i][k]);
  }
  for (Shape& shape : shapes_) {
    if (shape.body < 0 || !goes(static_cast<size_t>(shape.body))) continue;
    const auto body = static_cast<size_t>(shape.body);
    shape.xform = math::multiply(pose[body], shape.xform);
    shape.body = into[body];
    shape.cfg.density = 0.0f;  // the mass is now part of the base mass
  }
  const std::vector<detail::MassProperties> after = exact_body_masses();
  const auto way_of_com = [&](size_t b) {  // displacement of the center of mass, body frame
    const auto way = after[b].com - masses[b].com;
    return Vec3f{static_cast<float>(way.x), static_cast<float>(way.y), static_cast<float>(way.z)};
  };
  for (size_t b = 0; b < bodies_.size(); ++b) {
    if (goes(b)) continue;
    SpatialVectorf& twist = body_qd[b];
    twist.linear =
        twist.linear + math::cross(twist.angular, math::rotate(body_q[b].q, way_of_com(b)));
  }
  for (const Joint& joint : joints_) {
    const auto child = static_cast<size_t>(joint.child);
    if (joint.type != JointType::FREE || goes(child)) continue;
    const float* const q = &joint_q[static_cast<size_t>(joint.q_start)];
    float* const qd = &joint_qd[static_cast<size_t>(joint.qd_start)];
    const Vec3f way = math::rotate(Quatf{q[3], q[4], q[5], q[6]},
                                   math::rotate_inverse(joint.child_xform.q, way_of_com(child)));
    const Vec3f more = math::cross(Vec3f{qd[3], qd[4], qd[5]}, way);
    qd[0] += more.x;
    qd[1] += more.y;
    qd[2] += more.z;
  }
}

CollapsedJoints ModelBuilder::drop_merged(const std::vector<int32_t>& into,
                                          const std::vector<Transformf>& pose,
                                          const std::vector<char>& joint_stays) {
  std::vector<char> body_stays(bodies_.size());
  for (size_t b = 0; b < bodies_.size(); ++b) body_stays[b] = into[b] == static_cast<int32_t>(b);
  CollapsedJoints result{.body_remap = remap_of(body_stays), .joint_remap = remap_of(joint_stays)};
  const auto new_body = [&](int32_t old) {
    return old < 0 ? -1 : result.body_remap[static_cast<size_t>(old)];
  };
  for (size_t b = 0; b < bodies_.size(); ++b) {
    result.body_merged_parent.push_back(body_stays[b] ? -1 : new_body(into[b]));
    result.body_merged_transform.push_back(pose[b]);
  }
  for (Shape& shape : shapes_) shape.body = new_body(shape.body);
  actuators_.move_bodies([&](int32_t& body, Transformf& frame) {
    if (body < 0) return;
    const auto b = static_cast<size_t>(body);
    if (!body_stays[b]) frame = math::multiply(pose[b], frame);
    body = new_body(into[b]);
  });
  for (Joint& joint : joints_) {
    if (joint.parent >= 0) {
      const auto parent = static_cast<size_t>(joint.parent);
      if (!body_stays[parent])
        joint.parent_xform = math::multiply(pose[parent], joint.parent_xform);
      joint.parent = new_body(into[parent]);
    }
    joint.child = new_body(joint.child);
    if (joint.mimic >= 0) joint.mimic = result.joint_remap[static_cast<size_t>(joint.mimic)];
  }
  // A FIXED joint has no coordinates, so the coordinates of other joints stay.
  keep_rows(joints_, joint_stays);
  keep_rows(body_q, body_stays);
  keep_rows(body_qd, body_stays);
  keep_rows(bodies_, body_stays);
  // number of kept joints before each joint
  std::vector<int32_t> before(joint_stays.size() + 1, 0);
  for (size_t j = 0; j < joint_stays.size(); ++j) before[j + 1] = before[j] + joint_stays[j];
  std::vector<Articulation> articulations;
  for (Articulation& a : articulations_) {
    a.start = before[static_cast<size_t>(a.start)];
    a.end = before[static_cast<size_t>(a.end)];
    const auto index = static_cast<int32_t>(articulations.size());
    for (int32_t j = a.start; j < a.end; ++j) {
      Joint& joint = joints_[static_cast<size_t>(j)];
      joint.articulation = index;
      bodies_[static_cast<size_t>(joint.child)].mover = j;
    }
    if (a.start < a.end) articulations.push_back(std::move(a));
  }
  articulations_ = std::move(articulations);
  return result;
}

}  // namespace novaphy
