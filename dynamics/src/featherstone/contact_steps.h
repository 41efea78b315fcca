// Steps of articulations with contacts and dry friction (articulation/pgs.h), their adjoints and
// tangents, as launches (articulation_contact_kernels.h): island after island, the contacts of each
// in their order. So nothing depends on the number of threads and on the device.
#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "articulation_contact_kernels.h"
#include "contact_events.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/dynamics/articulation/jvp_arguments.h"
#include "novaphy/dynamics/articulation/vjp_arguments.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/contact_branches.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"
#include "tree_steps.h"

namespace novaphy {

// Of contacts on the cpu; null: none.
articulation::ContactRows contact_rows(const Contacts* contacts);

// The island of a step that is the farthest from converged (pgs.h); without sweeps none is far.
// `at` is its contact that pushes most, or -1 - that dof whose dry friction does.
struct FarIsland {
  int32_t sweeps = 0;
  float residual = 0.0f, largest = 0.0f;
  int32_t at = 0;
};
// `shape0`, `shape1`: of the contacts.
std::string describe(const FarIsland& of, const Model& model, const Articulations& articulations,
                     const int32_t* shape0, const int32_t* shape1);

// The arrays of contacts, as arguments of launches.
struct ContactArguments {
  ContactPlaces at;
  Given<int32_t> count;
  int64_t most;  // rows
  Optional<Given<int32_t>> point_id = nullptr;
  Optional<Writes<Vec3f>> force = nullptr;  // null: nobody wants it
};
ContactArguments contact_arguments(const Contacts& contacts);
// Of memory on the cpu.
ContactArguments contact_arguments(const articulation::ContactRows& contacts);

// Adds up branches of steps.
void add_branches(const ContactBranches& of, ContactBranches& to);

// What a step does for its adjoint; null: nothing.
struct ContactRecord {
  Optional<Changed<Vec3f>> impulses = nullptr;  // along n, t1, t2
  Optional<Changed<float>> friction = nullptr;  // of dofs with dry friction
  bool found = false;                           // ContactRows::found
  bool by_restitution = false;
  bool continues = false;  // it starts where the last one that noted ended
  bool dry = false;        // joints have dry friction, or may have some in a replay
  bool notes = false;      // for events, and note_branches
  bool records = false;
};

// Where the gradients go of what only contacts and dry friction read; they are added to. Null:
// nobody wants it.
struct ContactGradientArguments {
  Optional<Changed<float>> joint_friction, mu, restitution, ke, kd;
  bool of_materials() const {
    return (mu.word() | restitution.word() | ke.word() | kd.word()) != 0;
  }
};
// Their dual numbers; null: of a model without shapes.
struct ContactDualArguments {
  Given<articulation::DualFloat> joint_friction, mu, restitution, ke, kd;
};

// Articulations in a step, on the CPU.
struct SleepingTrees {
  std::span<const uint8_t> asleep;  // of each: nonzero for those that impulses do not move
  std::span<const int32_t> awake;   // the others, ascending
  int32_t contacts = 0;             // the first rows
};

class ContactSteps {
 public:
  // A group is a world. Where an articulation belongs to all worlds, all are one group.
  ContactSteps(const Model& model, const Articulations& articulations);

  // Whether a step has to go through here: it has contacts or dry friction, or one before had
  // contacts, whose impulses are to be forgotten. Where not, it forgets them.
  bool has_rows(const Contacts* contacts);
  // Whether joints have dry friction. Looks again when the array was written.
  bool has_friction();
  // Takes memory for the contacts where that of steps before is too small, and forgets their
  // impulses then. One that records starts from nothing, and solves all islands by pgs.h.
  // `lanes` (null: none; on the cpu) takes the articulations that touch nothing but the world.
  // There the results of a step that fails (`status`) are not kept for the next. `sleeping`, with
  // lanes only: articulations that keep their rows of the new state; null: none.
  void step(const ArticulationStepArguments& step, const ContactArguments& contacts,
            const FeatherstoneOptions& options, const ContactRecord& record, TreeSteps* lanes,
            const SleepingTrees* sleeping = nullptr);
  // Of the last step that noted its branches, before note_branches; on the cpu: the contacts that
  // begin in it. They approach by more than 1 mm/s, and than the forces of a step make, and did not
  // push in the step before. `qd` {dofs}: before the step; `landed`: ContactEvents::landed of the
  // step before.
  ContactEvents events(const float* qd, bool continues, std::span<const LandedRow> landed) const;
  // Behind a step that noted them: adds them to branches(), and keeps them for the next step.
  void note_branches() const;
  // The arrays of no contacts.
  ContactArguments none() const { return contact_arguments(none_); }
  // Copies rows, but for their names and forces.
  void copy(const ContactArguments& from, const ContactArguments& to) const;
  // The adjoint of a step that was recorded.
  void vjp(const ArticulationStepVjpArguments& step, const ContactArguments& contacts,
           const FeatherstoneOptions& options, const ContactRecord& record,
           const ContactGradientArguments& to);
  // Likewise its tangent.
  void jvp(const ArticulationJvpArguments& step, const ContactArguments& contacts,
           const FeatherstoneOptions& options, const ContactRecord& record,
           const ContactDualArguments& duals);
  // ErrorKind::Runtime: an adjoint or a tangent that ran had an island too large for its memory.
  void check_adjoint(const char* user) const;
  // Of the steps that noted theirs, since the last clear. Waits for them.
  ContactBranches branches() const;
  void clear_branches();
  // Whether the last step that noted its branches had contacts, as far as the host knows at once.
  bool has_seen() const;

  // Lets the next step, and captures that replay one, start without impulses of the step before.
  void forget_impulses();

  // Numbers of memory for an articulation, of an adjoint.
  int64_t adjoint_tree_stride() const { return adjoint_tree_stride_; }
  // Of the last step that ran, 0 without rows; they wait for it.
  int32_t sweeps() const;
  float residual() const;
  // The same on the cpu.
  FarIsland far_island(float tolerance) const;
  // The largest force of a contact in the last step that kept some, as text; empty: there was none.
  std::string largest_force() const;

 private:
  void reserve(int64_t contacts);
  bool reserve_notes();  // whether what the step before saw was lost
  void reserve_adjoint(bool dry, bool materials);
  // `record`: which results it clears.
  void list_contacts(const ContactArguments& contacts, const ContactRecord& record,
                     const SleepingTrees* sleeping = nullptr) const;
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
  bool take_trees(const FeatherstoneOptions& options, TreeSteps& lanes, bool keeps_rates,
                  const SleepingTrees* sleeping);
  void open_some(const SleepingTrees& sleeping, const ContactArguments& contacts);
  std::span<IslandNode> nodes_here() const;  // on the cpu
  std::vector<IslandNode> last_nodes() const;
  bool has_failed() const;                  // a tree of the last step, on the cpu
  int32_t hardest_row(int32_t root) const;  // FarIsland::at

  const Model& model_;
  const Articulations& articulations_;
  int64_t groups_ = 0, tree_stride_, adjoint_tree_stride_, contact_stride_;
  DeviceArray<int32_t> side_of_body_, moved_by_, group_of_tree_, tree_begin_, trees_;
  ArrayStamp friction_stamp_;
  bool has_friction_ = false, on_stack_;
  bool has_run_ = false;                                  // the last step had rows
  std::optional<ArticulationContactStepArguments> last_;  // in memory, on the cpu
  std::vector<int32_t> taken_;                            // trees
  std::vector<ArticulationRows> rows_;                    // where some sleep: these do not move
  std::vector<int32_t> met_;                              // trees that sleep and have a contact
  bool has_long_trees_ = false;  // without a mass matrix, which the kernels need
  Contacts none_;
  int64_t capacity_ = -1;  // contacts; -1: no memory was taken
  DeviceArray<int32_t> group_, contact_begin_, contacts_, chain_, nodes_, kept_begin_, places_;
  DeviceArray<float> now_, kept_, kept_dt_, kept_friction_, now_friction_, memory_, trees_memory_;
  // Of steps that are recorded, and of adjoints.
  int64_t group_dofs_ = 0;  // of the largest group
  int64_t adjoint_capacity_ = -1, adjoint_dofs_ = 0, adjoint_stride_, system_of_contact_ = 0,
          system_of_group_ = 0;
  DeviceArray<float> adjoint_memory_, tangent_memory_, system_, materials_;
  DeviceArray<int32_t> notes_, some_notes_, seen_, seen_before_, seen_begin_, branches_,
      adjoint_status_, shape_of_, shape_begin_, shape_sides_;
};

}  // namespace novaphy
