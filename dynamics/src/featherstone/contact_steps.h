// Steps of articulations with contacts and dry friction (articulation/pgs.h), with their adjoints
// and tangents, as launches of articulation_contact_kernels.h. Each island is solved by itself,
// with its contacts in their order. The result is therefore independent of the number of threads
// and of the device.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "articulation_contact_kernels.h"
#include "contact_events.h"
#include "island_lanes.h"
#include "novaphy/collision/polytopes.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/dynamics/articulation/contact_note.h"
#include "novaphy/dynamics/articulation/jvp_arguments.h"
#include "novaphy/dynamics/articulation/vjp_arguments.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/contact_branches.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "tree_steps.h"

namespace novaphy {

// Returns the rows of contacts on the CPU. Null: no contacts.
articulation::ContactRows contact_rows(const Contacts* contacts);

// The island that is farthest from convergence, if any island is far from it (pgs.h). All zeros: no
// such island. `at`: the contact with the largest impulse, or -1 - the dof with the largest dry
// friction.
struct FarIsland {
  int32_t sweeps = 0;
  float residual = 0.0f, largest = 0.0f;
  int32_t at = 0;
};
// Returns a text about the island. `shape0`, `shape1`: the arrays of the contacts.
std::string describe(const FarIsland& of, const Model& model, const Articulations& articulations,
                     const int32_t* shape0, const int32_t* shape1);

// The arrays of contacts, as arguments of launches.
struct ContactArguments {
  ContactPlaces at;
  Given<int32_t> count;
  int64_t most;  // the number of rows
  Optional<Given<int32_t>> point_id = nullptr;
  Optional<Writes<Vec3f>> force = nullptr;  // null: not requested
};
ContactArguments contact_arguments(const Contacts& contacts);
// Returns arguments for arrays in host memory.
ContactArguments contact_arguments(const articulation::ContactRows& contacts);

// Adds the branch counts of steps to those of earlier steps.
void add_branches(const ContactBranches& of, ContactBranches& to);

// What a step stores for its adjoint. Null: not stored.
struct ContactRecord {
  Optional<Changed<Vec3f>> impulses = nullptr;  // along n, t1, t2
  Optional<Changed<float>> friction = nullptr;  // impulses of dry friction
  bool found = false;                           // ContactRows::found
  bool by_restitution = false;
  bool continues = false;  // starts at the end of the last step that stored branches
  bool dry = false;        // joints have dry friction, or may get it before a replay
  bool notes = false;      // stores notes, for events and note_branches
  bool records = false;
};

// The gradients by arrays that only contacts and dry friction read. The adjoint adds to them. Null:
// not requested.
struct ContactGradientArguments {
  Optional<Changed<float>> joint_friction, mu, restitution, ke, kd;
  Optional<Writes<articulation::ContactNote>> notes = nullptr;
  bool of_materials() const {
    return (mu.word() | restitution.word() | ke.word() | kd.word()) != 0;
  }
};
// The dual numbers of the same arrays. Null: the model has no shapes.
struct ContactDualArguments {
  Given<articulation::DualFloat> joint_friction, mu, restitution, ke, kd;
  Optional<Writes<Vec3f>> changes = nullptr;  // tangents of the impulses
};

// The articulations that sleep in a step. CPU only.
struct SleepingTrees {
  std::span<const uint8_t> asleep;  // per articulation; not 0: impulses do not move it
  std::span<const int32_t> awake;   // the other articulations, in ascending order
  int32_t contacts = 0;             // the number of contact rows to use, from the first row on
};

class ContactSteps {
 public:
  // Articulations of one world form a group. If an articulation belongs to all worlds, all worlds
  // form one group.
  ContactSteps(const Model& model, const Articulations& articulations);

  // Returns whether the step needs the contact solver: it has contacts or dry friction, or an
  // earlier step left impulses. Otherwise discards the impulses of earlier steps.
  bool has_rows(const Contacts* contacts);
  // Builds the tables of hulls and meshes that gradients read, if they are outdated.
  void read_polytopes();
  // Returns whether joints have dry friction. Checks again if the array was written.
  bool has_friction();
  // Runs a step. If the memory is too small for the contacts, allocates more and discards the
  // impulses of the last step. A step that stores data for an adjoint has no warm start, and solves
  // all islands by pgs.h. `lanes` (CPU only; null: none) solves the articulations that touch only
  // the world. With `lanes`, the results of a failed step (`status`) are not kept for the next
  // step. `sleeping` (only with `lanes`; null: none): articulations whose rows of the new state
  // stay unchanged.
  void step(const ArticulationStepArguments& step, const ContactArguments& contacts,
            const FeatherstoneOptions& options, const ContactRecord& record, TreeSteps* lanes,
            const SleepingTrees* sleeping = nullptr);
  // Returns the contacts that begin in a step. CPU only. Call this after a step that stores its
  // branches and before note_branches. A contact that begins did not push in the step before. Its
  // approach speed is above 1 mm/s, and above the speed that the forces of a step produce. `qd`
  // {dofs}: before the step. `landed`: ContactEvents::landed of the step before.
  ContactEvents events(const float* qd, bool continues, std::span<const LandedRow> landed) const;
  // Adds the branches of a step to branches(), and keeps them for the next step. Call this after a
  // step that stores its branches.
  void note_branches() const;
  // Returns the arrays of an empty list of contacts.
  ContactArguments none() const { return contact_arguments(none_); }
  // Copies contact rows, without their point ids and forces.
  void copy(const ContactArguments& from, const ContactArguments& to) const;
  // Runs the adjoint of a recorded step.
  void vjp(const ArticulationStepVjpArguments& step, const ContactArguments& contacts,
           const FeatherstoneOptions& options, const ContactRecord& record,
           const ContactGradientArguments& to);
  // Runs the tangent of a recorded step.
  void jvp(const ArticulationJvpArguments& step, const ContactArguments& contacts,
           const FeatherstoneOptions& options, const ContactRecord& record,
           const ContactDualArguments& duals);
  // Throws ErrorKind::Runtime if, in an adjoint or a tangent, an island was too large for its
  // memory.
  void check_adjoint(const char* user) const;
  // Returns the branch counts of the steps since the last clear. Waits for the steps.
  ContactBranches branches() const;
  void clear_branches();
  // Returns whether the last step that stored branches had contacts, as far as the host knows
  // without waiting.
  bool has_seen() const;

  // Clears the impulses from which the next step starts its solve, also for replays of a capture.
  void forget_impulses();

  // Returns the size in floats of the memory per articulation in an adjoint.
  int64_t adjoint_tree_stride() const { return adjoint_tree_stride_; }
  // Return the largest number of sweeps, and the residual, of the last step. Both are 0 without
  // rows, and wait for the step.
  int32_t sweeps() const;
  float residual() const;
  // Returns the island of the last step that is farthest from convergence. CPU only.
  FarIsland far_island(float tolerance) const;
  // Returns the largest contact force in the last step that stored forces, as text. Empty: no
  // force.
  std::string largest_force() const;

 private:
  void reserve(int64_t contacts);
  void reserve_trees(int64_t stride);
  bool reserve_notes();  // returns whether the contacts of the step before were lost
  void reserve_adjoint(bool dry, bool materials);
  // `record`: which results to clear.
  void list_contacts(const ContactArguments& contacts, const ContactRecord& record,
                     bool on_host = false, const SleepingTrees* sleeping = nullptr) const;
  // Keeps the impulses of a step for the warm start of the next step.
  void keep(int64_t contacts, const Number<float>& dt);
  void take_kept(const Number<float>& dt);
  void hold_some(const SleepingTrees& sleeping);
  ContactShapes shapes(const ContactArguments& contacts) const;
  ContactGroupArguments groups(const ContactArguments& contacts, const FeatherstoneOptions& options,
                               const ContactRecord& record, const DeviceArray<float>& memory,
                               int64_t stride) const;

  ArticulationContactStepArguments step_arguments(const ArticulationStepArguments& of,
                                                  const ContactArguments& contacts,
                                                  const FeatherstoneOptions& options,
                                                  const ContactRecord& record, bool continues,
                                                  bool lanes) const;
  void open_groups();
  void find_isolated(int32_t tree, bool sleeps);
  bool take_trees(const FeatherstoneOptions& options, TreeSteps& lanes, bool keeps_rates,
                  const SleepingTrees* sleeping);
  void open_some(const SleepingTrees& sleeping, const ContactArguments& contacts);
  std::span<IslandNode> nodes_here() const;  // on the CPU
  std::vector<IslandNode> last_nodes() const;
  bool has_failed() const;                  // whether a tree of the last step failed, on the CPU
  int32_t hardest_row(int32_t root) const;  // FarIsland::at

  const Model& model_;
  const Articulations& articulations_;
  Polytopes polytopes_;
  int64_t groups_ = 0, tree_stride_, adjoint_tree_stride_, contact_stride_;
  DeviceArray<int32_t> side_of_body_, moved_by_, group_of_tree_, tree_begin_, trees_;
  ArrayStamp friction_stamp_;
  bool has_friction_ = false, fuses_;
  bool has_run_ = false;                                  // whether the last step had rows
  std::optional<ArticulationContactStepArguments> last_;  // in host memory, on the CPU
  std::vector<int32_t> taken_;                            // the trees that TreeSteps takes
  // per tree: the number of its contacts if it touches only the world, else -1
  std::vector<int32_t> isolated_;
  IslandLanes islands_;
  // the rows with sleeping trees held in place
  std::vector<ArticulationRows> rows_;
  std::vector<int32_t> met_;     // sleeping trees with a contact
  bool has_long_trees_ = false;  // some tree has no mass matrix, but the kernels need one
  Contacts none_;
  int64_t capacity_ = -1;  // the number of contacts that fit; -1: no memory yet
  DeviceArray<int32_t> group_, contact_begin_, contacts_, chain_, nodes_, kept_begin_, places_;
  DeviceArray<float> now_, kept_, kept_dt_, kept_friction_, now_friction_, memory_, trees_memory_;
  // The following members are for recorded steps and adjoints.
  int64_t group_dofs_ = 0;  // number of dofs of the largest group
  int64_t adjoint_capacity_ = -1, adjoint_dofs_ = 0, adjoint_stride_, system_of_contact_ = 0,
          system_of_group_ = 0;
  DeviceArray<float> adjoint_memory_, tangent_memory_, system_, materials_;
  DeviceArray<int32_t> notes_, some_notes_, seen_, seen_before_, seen_begin_, branches_,
      adjoint_status_, shape_of_, shape_begin_, shape_sides_;
};

}  // namespace novaphy
