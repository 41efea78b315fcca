// The rigid bodies of SolverVBD on the CPU: the constraint rows between bodies (contacts and
// joints), the order in which an iteration visits the bodies, the memory, and a step. The kernels
// are in bodies_kernels.h.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "bodies_kernels.h"
#include "color_slots.h"
#include "novaphy/core/device_array.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/control.h"
#include "novaphy/core/sim/index_rows.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/vbd/bodies/joint_start_law.h"
#include "novaphy/vbd/solver_vbd.h"

namespace novaphy {
struct VbdBodySolution;
}

namespace novaphy::vbd {

// The multipliers of a contact from the previous step. The next step finds them by the shapes and
// the feature.
struct alignas(16) ContactMemory {
  int32_t shape[2] = {-1, -1};
  int32_t point = -1;
  float lam_n = 0.0f;
  Vec3f lam_t{};
  float is_used = 0.0f;  // 0: this entry holds no contact
  Vec3f normal{};
  float ignored = 0.0f;  // m, see VbdBodyContact
};

// The multipliers of a joint from the previous step, in the axes of the parent body, and the joint
// angle (rad), which counts whole turns.
struct alignas(16) JointMemory {
  Vec3f lam{};
  float coordinate = 0.0f;
  Vec3f lam_turn{};
  float is_used = 0.0f;  // 0: no previous step
  float axis[4] = {};
};

// The data that a contact is made of.
struct ContactOrigin {
  ContactStart<float> start;
  int32_t shape[2] = {-1, -1};
  bool has_ke = false, has_kd = false, has_mu = false;  // whether the row has its own coefficient
};
// Returns whether a shape is an endless plane of the world.
bool is_world_plane(const Model& m, int32_t shape);

// Returns a joint at the start of a step. Null control: the defaults of the model.
JointStart<float> joint_start(const Model& m, const Transformf* q, const SpatialVectorf* qd,
                              const Control* control, size_t joint);

// Which parts of a drive act: the spring to the target, and the rate of the target.
struct DriveUse {
  bool spring = false, rate = false;
};
DriveUse drive_use(const Model& m, size_t dof);
// Reads the force and the drive of an axis.
void put_drive_of(const Model& m, const Control* control, size_t dof, size_t coordinate,
                  JointAxis<float>& to);

// Lists of integers, stored one after the other. The list of key k is items[begin[k]] to
// items[begin[k + 1] - 1].
struct BodyLists {
  std::vector<int32_t> begin, items;
  // Makes a list for each of `count` keys from pairs (key, item). The items keep their order.
  void build(int32_t count, std::span<const std::pair<int32_t, int32_t>> pairs);
  std::span<const int32_t> of(int32_t key) const {
    const auto k = static_cast<size_t>(key);
    return std::span(items).subspan(static_cast<size_t>(begin[k]),
                                    static_cast<size_t>(begin[k + 1] - begin[k]));
  }

 private:
  std::vector<int32_t> keys_;
  IndexRows places_;  // indices into `pairs`, for each key
};

// The order in which an iteration visits the bodies. A graph of the bodies has an edge for each
// row, which is a contact or joint between two bodies. A tree is a spanning tree of a connected
// component of this graph.
class BodyGraph {
 public:
  // `pairs`: the two bodies of each row, joints first; -1: the world, a kinematic body or
  // particles. numbers[k] identifies row k: 8 times its index, plus 2 times its kind (VbdBodyRows).
  // Only the first `acting` rows have a force at the initial guess. The remaining rows do not count
  // for cycles.
  void build(int32_t bodies, std::span<const std::array<int32_t, 2>> pairs,
             std::span<const int32_t> numbers, size_t acting);
  // Returns whether both bodies move and no edge of a tree connects them.
  bool is_outside(const std::array<int32_t, 2>& pair) const {
    return pair[0] >= 0 && pair[1] >= 0 && parent_[index(pair[0])] != pair[1] &&
           parent_[index(pair[1])] != pair[0];
  }

  // Returns whether the tree of these bodies has rows that close cycles.
  bool has_cycles(const std::array<int32_t, 2>& pair) {
    return has_cycles_[index(root_of(std::max(pair[0], pair[1])))] != 0;
  }

  BodyLists rows;    // items (see VbdBodyRows) of each body
  BodyLists colors;  // the bodies of each color
  // The bodies of the trees, for all bodies with rows: each node's body and parent node, and the
  // first node of each tree.
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
  std::vector<char> has_cycles_;  // of each tree, at the index of its root
};

// The particles of a step, as the bodies see them, and their contacts with shapes, which are sorted
// by particle.
struct StepParticles {
  const ColorSlots* slots = nullptr;
  std::span<const Vec4f> start, target;    // m
  std::span<Vec4f> moved, x;               // m
  std::span<const int32_t> contact_slots;  // slot in Contacts of each contact
  float* contact_numbers = nullptr;        // see put_contact_numbers
  const float* blocks = nullptr;           // see write_block; of the touched particles
  float inside = 0.0f;                     // see ParticleContact
};

// Groups of particles and bodies that touched in a step, see Bodies::balance.
struct BodyGroups {
  struct Group {
    bool is_balanced = false;
    double mass = 0.0;                   // kg
    Vec3<double> center{};               // center of mass at the start of the step (m)
    Vec3<double> lacks{}, lacks_turn{};  // missing mass times displacement, and its moment
    double inertia[3][3] = {};           // lower triangle
    Vec3<double> shift{}, turn{};        // the rigid motion that the group gets
    Vec3<double> at_point(const Vec3<double>& x) const {
      return shift + math::cross(turn, x - center);
    }
  };
  static size_t at(int32_t k) { return static_cast<size_t>(k); }
  int32_t root(int32_t member);
  void join(int32_t a, int32_t b);

  std::vector<int32_t> next;
  std::vector<Group> of;  // at the index of the root
};

class Bodies {
 public:
  // Errors: as for the constructor of SolverVBD.
  Bodies(const Model& m, const VbdOptions& o);

  // Allocates memory for the multipliers of `contacts` contacts.
  void reserve(int32_t contacts);
  // Begins a step of dt (s). Call reserve() before. Errors: as for SolverVBD::step.
  void begin(const SimState& in, const Control* control, const Contacts* contacts, float dt);
  // Finds the contacts with particles. Call once in a step, before the iterations.
  void couple(const Contacts* contacts, const StepParticles& particles);
  std::span<const VbdTouch> touched() const { return touch_; }
  // Runs one iteration: the colors of bodies, the trees, and the update of the multipliers. The
  // surfaces that particles touch then move with the bodies.
  void iterate();
  // Gives each free group of particles and bodies that touched the momentum and the angular
  // momentum that gravity and external forces give it.
  void balance();
  void check_result() const;
  // Writes the poses and velocities to `out`, the forces to `contacts`, and the multipliers to the
  // memory.
  void finish(const SimState& in, const SimState& out, const Contacts* contacts);
  void reset() { memory_.zero(); }
  // Runs one iteration of a step whose solution is wanted. A row along a joint axis that leaves one
  // of its two bounds, as dry friction can, gets a lower penalty stiffness. So does the friction of a
  // contact that stops to slip or turns back. Both could otherwise jump to and fro without end.
  void iterate_to_solution();
  // Halves the penalty stiffness of all rows, for a step whose residual no longer falls.
  void soften_rows();
  // Returns how far the motions are from the solution, without contacts. The values are those of
  // the worst tree. The norms weigh moments by the inverse inertia.
  VbdResidual residual() const;
  VbdBodySolution solution() const;
  // See SolverVBD::joint_forces.
  std::vector<SpatialVectorf> joint_forces() const;
  // Returns the rows of 4 floats that the solver carries to the next step: rows of the particles,
  // the previous velocities of the bodies, the joints, and the contacts.
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
  // bodies_contacts.cpp
  void put_contacts(const SimState& in, const Contacts& contacts);
  void put_contact(const SimState& in, const Contacts& contacts, size_t slot);
  void recall_contact(const Contacts& contacts, size_t slot, float approach, VbdBodyContact& to);
  void keep_contacts(const Contacts* contacts);
  // bodies_joints.cpp
  void put_joints(const SimState& in, const Control* control);
  float nearest_coordinate(size_t joint, const VbdBodyJoint& j) const;
  void keep_joints(const SimState& in);
  void put_graph();
  void move_free_bodies();
  // bodies_touches.cpp
  void put_touch(const Contacts& contacts, int32_t contact);
  void follow_bodies();
  void place_touches();
  VbdTouches touches();
  // bodies_balance.cpp
  void find_groups();
  template <class OfParticle, class OfBody>
  void for_members(const OfParticle& of_particle, const OfBody& of_body);
  template <class Visit>
  void for_masses(const Visit& visit);
  Vec3f start_center(size_t body) const;
  Vec3f lacking_spin(size_t body) const;

  const Model& model_;
  const VbdOptions options_;
  float dt_ = 0.0f;
  size_t particle_rows_ = 0, body_rows_ = 0, joint_count_ = 0, contact_rows_ = 0;
  DeviceArray<Vec4f> memory_;
  DeviceArray<int32_t> is_kinematic_;
  std::vector<char> has_rod_;  // of each body: whether it has a ROD joint
  std::vector<VbdBody> body_;
  std::vector<VbdBodyMotion> motion_;
  std::vector<VbdBodyContact> contact_;
  std::vector<ContactOrigin> contact_origin_;  // of each contact
  std::vector<VbdBodyJoint> joint_;
  std::vector<VbdBodyNode> node_;
  // Poses, velocities and forces at the start of the step.
  DeviceArray<Transformf> start_;
  DeviceArray<SpatialVectorf> start_qd_, start_f_;
  StepParticles particles_;
  std::vector<VbdTouch> touch_;
  std::vector<int32_t> touched_bodies_;  // the body of each contact with a particle
  IndexRows touches_of_;                 // the contacts of each body with particles
  std::vector<int32_t> near_world_;      // the particles of the contacts with world-owned shapes
  BodyGroups groups_;
  // Of the last iterate_to_solution: the multipliers of the rows along joint axes, and the friction
  // of contacts that slip.
  std::vector<float> last_rows_;
  std::vector<Vec3f> last_friction_;
  std::vector<int32_t> contact_slots_, joints_;  // the contact slot or joint of each row
  std::vector<int32_t> recalled_;                // rows of the memory, sorted by contact
  std::vector<std::array<int32_t, 2>> pairs_, built_pairs_;
  std::vector<int32_t> numbers_, built_numbers_;
  size_t acting_ = 0, built_acting_ = 0;
  BodyGraph graph_;
};

}  // namespace novaphy::vbd
