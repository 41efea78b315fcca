// The rigid bodies of SolverVBD: their rows, colors and trees, their memory, and a step, on the
// CPU. The kernels are in bodies_kernels.h.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "bodies_kernels.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy::vbd {

// The multipliers of a contact, found again by its shapes and its feature.
struct alignas(16) ContactMemory {
  int32_t shape[2] = {-1, -1};
  int32_t point = -1;
  float lam_n = 0.0f;
  Vec3f lam_t{};
  float is_used = 0.0f;  // 0: no contact
  Vec3f normal{};
  float unused = 0.0f;
};

// The multipliers of a joint in the axes of its parent, and the angle with all turns.
struct alignas(16) JointMemory {
  Vec3f lam{};
  float coordinate = 0.0f;
  Vec3f lam_turn{};
  float is_used = 0.0f;  // 0: no step before
  float axis[4] = {};
};

// Lists of numbers, one after the other.
struct BodyLists {
  std::vector<int32_t> begin, items;
  // Makes a list for each of `count` keys from pairs (key, number), in their order.
  void build(int32_t count, std::span<const std::pair<int32_t, int32_t>> pairs);
  std::span<const int32_t> of(int32_t key) const {
    const auto k = static_cast<size_t>(key);
    return std::span(items).subspan(static_cast<size_t>(begin[k]),
                                    static_cast<size_t>(begin[k + 1] - begin[k]));
  }

 private:
  std::vector<int32_t> keys_;
  IndexRows places_;  // in `pairs`, of each key
};

// The order in which an iteration visits the bodies, from the pairs of bodies that share rows.
class BodyGraph {
 public:
  // `pairs`: the bodies of each row, joints first; -1: the world or a body that does not move. The
  // row k has the number that `numbers` says, 4 times its index plus 2 for a contact. The
  // first `acting` rows act at the first guess; the others close no cycle.
  void build(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs,
             std::span<const int32_t> numbers, size_t acting);
  // Returns whether both bodies move and the row is no edge of a tree.
  bool is_outside(const std::array<int32_t, 2>& pair) const {
    return pair[0] >= 0 && pair[1] >= 0 && parent_[index(pair[0])] != pair[1] &&
           parent_[index(pair[1])] != pair[0];
  }

  // Returns whether the rows of the bodies' tree close cycles.
  bool has_cycles(const std::array<int32_t, 2>& pair) {
    return has_cycles_[index(root_of(std::max(pair[0], pair[1])))] != 0;
  }

  BodyLists rows;    // of each body
  BodyLists colors;  // the bodies of each color
  // The nodes of the trees, over all bodies that have rows.
  std::vector<int32_t> nodes, node_parent, tree_first;

 private:
  static size_t index(int32_t k) { return static_cast<size_t>(k); }
  void find_neighbors(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs);
  void find_trees(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs);
  int32_t root_of(int32_t body);
  void find_colors(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs);

  BodyLists neighbors_, tree_neighbors_;
  std::vector<std::pair<int32_t, int32_t>> pairs_;
  std::vector<int32_t> order_, color_, root_, parent_, node_of_;
  std::vector<char> has_cycles_;  // of the root of each tree
};

class Bodies {
 public:
  // Errors as for the constructor of SolverVBD.
  Bodies(const Model& m, const VbdOptions& o);

  // Makes room for the multipliers of so many contacts.
  void reserve(int32_t contacts);
  // Solves a step, after reserve(). Errors as for SolverVBD::step.
  void solve(const SimState& in, const Control* control, const Contacts* contacts, float dt);
  // Writes the poses and velocities, the forces of the contacts and the memory of the solver.
  void finish(const SimState& in, const SimState& out, const Contacts* contacts);
  void reset() { memory_.zero(); }
  // The rows of four floats that a solver carries: `particles` rows for the particles, the last
  // velocities of the bodies, the joints, the contacts.
  const DeviceArray<Vec4f>& memory() const { return memory_; }
  DeviceArray<Vec4f> of_particles() const;

 private:
  template <class T>
  T* memory_at(size_t row) {
    return reinterpret_cast<T*>(memory_.mutable_data() + row);
  }
  size_t joints_at() const { return particle_rows_ + body_rows_; }
  size_t contacts_at() const { return joints_at() + 3 * joint_count_; }
  VbdBodyRows rows();
  Untyped last_velocity();
  // bodies_checks.cpp
  void check_model(const Control* control) const;
  void check_step(const SimState& in, const Contacts* contacts) const;
  void check_result() const;
  // bodies_contacts.cpp
  void put_contacts(const SimState& in, const Contacts& contacts);
  void put_contact(const SimState& in, const Contacts& contacts, size_t slot);
  void recall_contact(const Contacts& contacts, size_t slot, VbdBodyContact& to);
  void keep_contacts(const Contacts* contacts);
  // bodies_joints.cpp, bodies_axis.cpp, bodies_drives.cpp
  void put_joints(const SimState& in, const Control* control);
  void put_axis(size_t joint, const SimState& in, const Control* control, VbdBodyJoint& to);
  void put_distance(size_t dof, VbdBodyJoint& to) const;
  void put_drive(size_t dof, size_t coordinate, const Control* control, VbdBodyJoint& to) const;
  void put_resistance(size_t dof, float rate, VbdBodyJoint& to) const;
  float joint_rate(const SimState& in, const VbdBodyJoint& j) const;
  float joint_coordinate(size_t joint, const VbdBodyJoint& j) const;
  void keep_joints(const SimState& in);
  void put_graph();
  void iterate();

  const Model& model_;
  const VbdOptions options_;
  float dt_ = 0.0f;
  size_t particle_rows_ = 0, body_rows_ = 0, joint_count_ = 0, contact_rows_ = 0;
  DeviceArray<Vec4f> memory_;
  DeviceArray<int32_t> is_held_;
  std::vector<VbdBody> body_;
  std::vector<VbdBodyMotion> motion_;
  std::vector<VbdBodyContact> contact_;
  std::vector<VbdBodyJoint> joint_;
  std::vector<VbdBodyNode> node_;
  std::vector<int32_t> contact_slots_, joints_;  // where the rows come from
  std::vector<int32_t> recalled_;                // rows of the memory, sorted by contact
  std::vector<std::array<int32_t, 2>> pairs_, built_pairs_;
  std::vector<int32_t> numbers_, built_numbers_;
  size_t acting_ = 0, built_acting_ = 0;
  BodyGraph graph_;
};

}  // namespace novaphy::vbd
