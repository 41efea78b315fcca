// A step of rigid bodies in VBD as kernels (row_kernel.h). The laws are in vbd/bodies/.
//
// An iteration solves all bodies of a tree together (vbd_body_tree). The edges of the trees are
// joints and contacts. A row between two bodies that is not an edge counts twice in the stiffness
// of both bodies. The doubled stiffness is an upper bound of the coupling that the tree leaves out.
//
// vbd_body_take shortens a step that goes far beyond the minimum of the energy along the step. If
// the rows of a tree close cycles, the iteration first visits the bodies color by color:
// vbd_body_move solves the 6x6 system of each body. At the end of an iteration the rows update
// their multipliers.
#pragma once

#include "novaphy/core/row_kernel.h"
#include "novaphy/math/spatial.h"
#include "novaphy/vbd/bodies/contact_law.h"
#include "novaphy/vbd/bodies/joint_law.h"
#include "novaphy/vbd/bodies/touch_law.h"
#include "novaphy/vbd/sweep_kernels.h"

namespace novaphy {

struct VbdBodyPredictArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<Transformf> q; ReadsRow<SpatialVectorf> qd, f; ReadsRow<Vec3f> com;
                    ReadsRow<float> mass, inv_mass; ReadsRow<Mat33f> inertia;
                    ReadsRow<int32_t> is_kinematic, world; Reads<Vec3f> gravity;
                    Number<int64_t> last_world; Number<float> h;
                    Number<int64_t> guess;  // VbdInitialGuess
                    // The velocity at the start of the previous step, and the number 1 (0: no
                    // previous step). Null: the adaptive guess is not used.
                    Optional<ReadsRow<Vec4f>> last_velocity; WritesRow<VbdBody> body;
                    WritesRow<VbdBodyMotion> motion;)
};

// Computes the inertial target and the initial guess of each body. Kinematic bodies move with their
// velocity.
NOVAPHY_ROW_KERNEL(vbd_body_predict, VbdBodyPredictArguments) {
  using namespace math;
  const float h = a.h.value;
  const SpatialVectorf qd = a.qd[row], f = a.f[row];
  VbdBody body;
  VbdBodyMotion motion;
  if (a.is_kinematic[row] != 0) {
    body.target = motion.moved = qd.linear * h;
    body.target_turned = motion.turned = vbd::exp_rotation(qd.angular * h);
    motion.turn = qd.angular * h;
    a.body[row] = body;
    a.motion[row] = motion;
    return;
  }
  const int32_t w = a.world[row];
  const Vec3f g = a.gravity[w < 0 ? a.last_world.value : w];
  body = vbd::inertial_target(
      vbd::BodyStart<float>{a.q[row].q, qd, f, g, a.mass[row], a.inv_mass[row], a.inertia[row]}, h);
  motion.moved = body.target;
  motion.turned = body.target_turned;
  if (a.guess.value == 1) motion = {};
  if (a.last_velocity != nullptr) {
    const Vec4f last = a.last_velocity[row];
    const Vec3f change = (qd.linear - Vec3f{last.x, last.y, last.z}) * (1.0f / h);
    const float square = dot(g, g);
    if (last.w != 0.0f && square > 0.0f) {
      const float part = max(0.0f, min(dot(change, g) / square, 1.0f));
      motion.moved = body.target - g * ((1.0f - part) * (h * h));
    }
  }
  motion.turn = vbd::log_rotation(motion.turned);
  a.body[row] = body;
  a.motion[row] = motion;
}

// The contacts of particles with bodies (touch_law.h).
struct VbdTouches {
  NOVAPHY_ARGUMENTS(Updates<VbdTouch> touch;
                    Reads<int32_t> begin, items;  // the contacts of each body
                    Updates<float> numbers;       // of all contacts, see put_contact_numbers
                    Reads<VbdRow> x, start;       // of particles
                    Number<float> slip, inside;)  // see ParticleContact
};

// The inputs of all kernels of an iteration. An item of a body is 8 times the index of a row, plus
// 2 times its kind, plus the side of the body (0 or 1). The row kTouchRow stands for all contacts
// of the body with particles.
constexpr int32_t kJointRow = 0, kContactRow = 1, kTouchRow = 2;
struct VbdBodyRows {
  NOVAPHY_ARGUMENTS(Reads<VbdBody> body; Updates<VbdBodyMotion> motion;
                    Reads<VbdBodyContact> contact; Reads<VbdBodyJoint> joint;
                    Part<VbdTouches> touches; Reads<int32_t> begin, items;  // of each body
                    Number<float> slip;)  // m: slip bound of contact_force
};

namespace vbd {

inline VbdBodyMotion motion_of(const VbdBodyMotion* motion, int32_t body) {
  return body < 0 ? VbdBodyMotion{} : motion[body];
}

inline ParticleContact<float> touch_contact(const VbdTouches& a, const VbdTouch& t,
                                            const VbdBodyMotion& motion) {
  return touch_contact(t, motion, a.numbers + static_cast<int64_t>(t.contact) * kContactFloats,
                       a.slip.value, a.inside.value);
}

// Adds the forces of all contacts with particles to the block of a body.
template <bool with_stiffness>
void add_touches(BodyBlock& b, const VbdTouches& a, int32_t body, const VbdBodyMotion& motion) {
  for (int32_t k = a.begin[body]; k < a.begin[body + 1]; ++k) {
    const VbdTouch& t = a.touch[a.items[k]];
    add_touch<with_stiffness>(b, t, a.x[t.particle], a.start[t.particle],
                              touch_contact(a, t, motion));
  }
}

// The part of a block to compute: force and stiffness, both with the factors of trees (in_trees),
// or the force alone.
enum class BlockPart { All, Trees, Force };

// Subtracts k j j'^T from the coupling matrix `edge`, where j belongs to the parent and j' to the
// node.
inline void add_edge_row(float (*edge)[6], float k, const Vec3f& linear, const Vec3f& parent,
                         const Vec3f& node) {
  const float p[6] = {linear.x, linear.y, linear.z, parent.x, parent.y, parent.z};
  const float j[6] = {linear.x, linear.y, linear.z, node.x, node.y, node.z};
  for (int r = 0; r < 6; ++r)
    for (int c = 0; c < 6; ++c) edge[r][c] = edge[r][c] - (k * p[r]) * j[c];
}

// Returns the force and stiffness of a body with all its rows. If parent >= 0, `edge` gets the
// coupling to this body by the shared rows.
template <BlockPart part>
BodyBlock block_of(const VbdBodyRows& a, int32_t body, float (*edge)[6] = nullptr,
                   int32_t parent = -1) {
  constexpr bool with_stiffness = part != BlockPart::Force;
  BodyBlock b = inertia_block(a.body[body], a.motion[body]);
  for (int32_t k = a.begin[body]; k < a.begin[body + 1]; ++k) {
    const int32_t row = a.items[k] >> 3, kind = (a.items[k] >> 1) & 3, side = a.items[k] & 1;
    if (kind == kTouchRow) {
      add_touches<with_stiffness>(b, a.touches, body, a.motion[body]);
      continue;
    }
    const bool touches = kind == kContactRow;
    const int32_t* const bodies = touches ? a.contact[row].body : a.joint[row].body;
    const float in_trees = touches ? a.contact[row].in_trees : a.joint[row].in_trees;
    const float factor = part == BlockPart::Trees ? in_trees : 1.0f;
    const bool is_edge = parent >= 0 && bodies[1 - side] == parent;
    const auto add = [&](float stiffness, const Vec3f& linear, const Vec3f& own,
                         const Vec3f& other) {
      add_row(b, stiffness * factor, linear, own);
      if (is_edge) add_edge_row(edge, stiffness, linear, other, own);
    };
    const VbdBodyMotion first = motion_of(a.motion, bodies[0]);
    const VbdBodyMotion second = motion_of(a.motion, bodies[1]);
    if (touches)
      add_contact<with_stiffness>(b, a.contact[row], side, first, second, a.slip.value, add);
    else
      add_joint<with_stiffness>(b, a.joint[row], side, first, second, add);
  }
  return b;
}

}  // namespace vbd

struct VbdTouchPlaceArguments {
  NOVAPHY_ARGUMENTS(Part<VbdTouches> touches; Reads<VbdBodyMotion> motion;)
};
// Moves the surface of a contact with its body: the numbers that the sweeps of the particles read.
NOVAPHY_ROW_KERNEL(vbd_touch_place, VbdTouchPlaceArguments) {
  VbdTouch& t = a.touches.touch[row];
  const vbd::ParticleContact<float> c = vbd::touch_contact(a.touches, t, a.motion[t.body]);
  vbd::note_touch(t, c, a.touches.x[t.particle]);
  const Vec3f &point = c.point, &travel = c.travel;
  float* const to = a.touches.numbers + static_cast<int64_t>(t.contact) * vbd::kContactFloats;
  to[0] = point.x;
  to[1] = point.y;
  to[2] = point.z;
  to[6] = travel.x;
  to[7] = travel.y;
  to[8] = travel.z;
}

struct VbdTouchArguments {
  NOVAPHY_ARGUMENTS(Part<VbdTouches> touches; Reads<VbdBodyMotion> motion;
                    Reads<float> blocks;)  // of particles, see write_block
};
NOVAPHY_ROW_KERNEL(vbd_touch, VbdTouchArguments) {
  VbdTouch& t = a.touches.touch[row];
  vbd::linearize_touch(t, a.touches.x[t.particle], a.touches.start[t.particle],
                       vbd::touch_contact(a.touches, t, a.motion[t.body]),
                       a.blocks + 9 * static_cast<int64_t>(t.particle));
}

NOVAPHY_ROW_KERNEL(vbd_write_block, VbdSweepArguments) {
  vbd::write_block(vbd::LaneGroup<float>(a, row));
}

struct VbdBodyMoveArguments {
  NOVAPHY_ARGUMENTS(Part<VbdBodyRows> rows; ReadsRow<int32_t> bodies;)
};
// Moves the bodies of a color, each by the solution of its 6x6 system.
NOVAPHY_ROW_KERNEL(vbd_body_move, VbdBodyMoveArguments) {
  const int32_t body = a.bodies[row];
  const vbd::BodyBlock b = vbd::block_of<vbd::BlockPart::All>(a.rows, body);
  float d[6];
  math::solve(math::ldlt(b.h), b.f, d);
  vbd::move_body(a.rows.motion[body], d);
}

// The data of a body of a tree. Nodes are stored tree by tree, and a parent comes before its
// children.
struct alignas(16) VbdBodyNode {
  using Element = Vec4f;
  vbd::BodyBlock block;
  float edge[6][6] = {};  // coupling: rows of the parent, columns of the node
  math::Ldlt<float, 6> factor;
  float f[6] = {}, d[6] = {};  // the force before the step, and the step
  float slope = 0.0f;          // dot product of the force after the step and the step
  float unused[3] = {};
  VbdBodyMotion before;
};

struct VbdBodyNodeArguments {
  NOVAPHY_ARGUMENTS(Part<VbdBodyRows> rows; Reads<int32_t> bodies;  // body of each node
                    ReadsRow<int32_t> parent;                       // node of each node; -1: a root
                    WritesRow<VbdBodyNode> nodes;)
};
// Computes the force and stiffness of a node, and the coupling to its parent.
NOVAPHY_ROW_KERNEL(vbd_body_node, VbdBodyNodeArguments) {
  VbdBodyNode& node = a.nodes[row];
  for (float(&of_row)[6] : node.edge)
    for (float& entry : of_row) entry = 0.0f;
  const int32_t parent = a.parent[row] < 0 ? -1 : a.bodies[a.parent[row]];
  node.block = vbd::block_of<vbd::BlockPart::Trees>(a.rows, a.bodies[row], node.edge, parent);
  for (int i = 0; i < 6; ++i) node.f[i] = node.block.f[i];
}

struct VbdBodyTreeArguments {
  NOVAPHY_ARGUMENTS(Reads<int32_t> first;   // first node of each tree, and the end of the last tree
                    Reads<int32_t> parent;  // parent node of each node; -1: a root
                    Reads<int32_t> bodies; Updates<VbdBodyNode> nodes;
                    Updates<VbdBodyMotion> motion;)
};
// Solves the linear system of a tree by block elimination from the leaves to the root, and moves
// the bodies.
NOVAPHY_ROW_KERNEL(vbd_body_tree, VbdBodyTreeArguments) {
  for (int32_t k = a.first[row + 1]; k-- > a.first[row];) {
    VbdBodyNode& node = a.nodes[k];
    node.factor = math::ldlt(node.block.h);
    if (a.parent[k] < 0) continue;
    vbd::BodyBlock& parent = a.nodes[a.parent[k]].block;
    for (int r = 0; r < 6; ++r) {
      float solved[6];
      math::solve(node.factor, node.edge[r], solved);
      for (int c = 0; c <= r; ++c)
        for (int i = 0; i < 6; ++i) parent.h[r][c] = parent.h[r][c] - solved[i] * node.edge[c][i];
      for (int i = 0; i < 6; ++i) parent.f[r] = parent.f[r] - solved[i] * node.block.f[i];
    }
  }
  for (int32_t k = a.first[row]; k < a.first[row + 1]; ++k) {
    VbdBodyNode& node = a.nodes[k];
    if (a.parent[k] >= 0) {
      const VbdBodyNode& parent = a.nodes[a.parent[k]];
      for (int r = 0; r < 6; ++r)
        for (int i = 0; i < 6; ++i)
          node.block.f[i] = node.block.f[i] - node.edge[r][i] * parent.d[r];
    }
    math::solve(node.factor, node.block.f, node.d);
    node.before = a.motion[a.bodies[k]];
    vbd::move_body(a.motion[a.bodies[k]], node.d);
  }
}

struct VbdBodySlopeArguments {
  NOVAPHY_ARGUMENTS(Part<VbdBodyRows> rows; ReadsRow<int32_t> bodies;
                    UpdatesRow<VbdBodyNode> nodes;)
};
NOVAPHY_ROW_KERNEL(vbd_body_slope, VbdBodySlopeArguments) {
  const vbd::BodyBlock b = vbd::block_of<vbd::BlockPart::Force>(a.rows, a.bodies[row]);
  VbdBodyNode& node = a.nodes[row];
  node.slope = 0.0f;
  for (int i = 0; i < 6; ++i) node.slope = node.slope + b.f[i] * node.d[i];
}

// Shortens the step of a tree if the force after the step pushes back by more than half of the
// force before the step (both projected on the step). The new step ends where the linear
// interpolation of the force is 0, but is at least a tenth of the old step.
NOVAPHY_ROW_KERNEL(vbd_body_take, VbdBodyTreeArguments) {
  float before = 0.0f, behind = 0.0f;
  for (int32_t k = a.first[row]; k < a.first[row + 1]; ++k) {
    const VbdBodyNode& node = a.nodes[k];
    for (int i = 0; i < 6; ++i) before = before + node.f[i] * node.d[i];
    behind = behind + node.slope;
  }
  if (!(behind < -0.5f * before)) return;
  const float t = math::max(0.1f, before / (before - behind));
  for (int32_t k = a.first[row]; k < a.first[row + 1]; ++k) {
    VbdBodyNode& node = a.nodes[k];
    float d[6];
    for (int i = 0; i < 6; ++i) d[i] = node.d[i] * t;
    a.motion[a.bodies[k]] = node.before;
    vbd::move_body(a.motion[a.bodies[k]], d);
  }
}

struct VbdBodyUpdateArguments {
  NOVAPHY_ARGUMENTS(Reads<VbdBodyMotion> motion; Number<float> slip; Number<int64_t> contacts;
                    Updates<VbdBodyContact> contact; Updates<VbdBodyJoint> joint;)
};
// Updates the multipliers. The first rows are the contacts, the remaining rows the joints.
NOVAPHY_ROW_KERNEL(vbd_body_update, VbdBodyUpdateArguments) {
  if (row < a.contacts.value) {
    VbdBodyContact& c = a.contact[row];
    vbd::update_contact(c, vbd::motion_of(a.motion, c.body[0]), vbd::motion_of(a.motion, c.body[1]),
                        a.slip.value);
  } else {
    VbdBodyJoint& j = a.joint[row - a.contacts.value];
    vbd::update_joint(j, vbd::motion_of(a.motion, j.body[0]), vbd::motion_of(a.motion, j.body[1]));
  }
}

struct VbdBodyFinishArguments {
  NOVAPHY_ARGUMENTS(ReadsRow<Transformf> q; ReadsRow<SpatialVectorf> qd; ReadsRow<Vec3f> com;
                    ReadsRow<int32_t> is_kinematic; ReadsRow<VbdBodyMotion> motion; Number<float> h;
                    WritesRow<Transformf> q_out; WritesRow<SpatialVectorf> qd_out;
                    Optional<WritesRow<Vec4f>> last_velocity;)
};
NOVAPHY_ROW_KERNEL(vbd_body_finish, VbdBodyFinishArguments) {
  using namespace math;
  const Transformf q = a.q[row];
  const VbdBodyMotion m = a.motion[row];
  const Vec3f center = q.p + rotate(q.q, a.com[row]);
  const Quatf turned = vbd::unit(multiply(m.turned, q.q));
  a.q_out[row] = {(center + m.moved) - rotate(turned, a.com[row]), turned};
  if (a.last_velocity != nullptr) {
    const Vec3f v = a.qd[row].linear;
    a.last_velocity[row] = {v.x, v.y, v.z, 1.0f};
  }
  const float by_h = 1.0f / a.h.value;
  a.qd_out[row] =
      a.is_kinematic[row] != 0 ? a.qd[row] : SpatialVectorf{m.moved * by_h, m.turn * by_h};
}

}  // namespace novaphy
