// Steps of articulations with contacts and dry friction as launches, on devices
// (articulation_contact_kernels.h): a thread for each group of articulations that may touch, in the
// order of its contacts, so with the bits of the cpu.
#pragma once

#include "novaphy/core/array_stamp.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/dynamics/articulation/contact_groups.h"
#include "novaphy/dynamics/articulation/jvp_arguments.h"
#include "novaphy/dynamics/articulation/vjp_arguments.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/contact_branches.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

// The arrays of contacts, as arguments of launches.
struct ContactArguments {
  ContactPlaces at;
  Given<int32_t> count;
  int64_t most;  // rows
  Optional<Given<int32_t>> point_id = nullptr;
  Optional<Writes<Vec3f>> force = nullptr;  // null: nobody wants it
};
ContactArguments contact_arguments(const Contacts& contacts);

// What a step does for its adjoint; null: nothing.
struct ContactRecord {
  Optional<Changed<Vec3f>> impulses = nullptr;  // along n, t1, t2
  Optional<Changed<float>> friction = nullptr;  // of dofs with dry friction
  bool found = false;                           // ContactRows::found
  bool by_restitution = false;
  bool continues = false;  // it starts where the last one that noted ended
  bool dry = false;        // joints have dry friction, or may have some in a replay
  bool notes = false;      // adds its branches to branches()
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

class LaunchedContacts {
 public:
  // A group is a world. Where an articulation belongs to all worlds, all are one group.
  LaunchedContacts(const Model& model, const Articulations& articulations);

  // Whether a step has to go through here: it has contacts or dry friction, or one before had
  // contacts, whose impulses are to be forgotten.
  bool has_rows(const Contacts* contacts);
  // Whether joints have dry friction. Looks again when the array was written.
  bool has_friction();
  // Takes memory for the contacts where that of steps before is too small, and forgets their
  // impulses then.
  void step(const ArticulationStepArguments& step, const Contacts* contacts,
            const FeatherstoneOptions& options);
  // The same of any rows; one that records starts from nothing, and solves all islands by pgs.h.
  void step(const ArticulationStepArguments& step, const ContactArguments& contacts,
            const FeatherstoneOptions& options, const ContactRecord& record);
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

  // Lets the next step, and captures that replay one, start without impulses of the step before.
  void forget_impulses() {
    kept_begin_.zero();
    kept_friction_.zero();
  }

  // Whether a step needs no memory for articulations.
  bool on_stack() const { return on_stack_; }
  // Numbers of memory for an articulation, in a step and in an adjoint.
  int64_t tree_stride() const { return tree_stride_; }
  int64_t adjoint_tree_stride() const { return adjoint_tree_stride_; }
  // Of the last step that ran; they wait for it.
  int32_t sweeps() const;
  float residual() const;

 private:
  void reserve(int64_t contacts);
  void note_branches() const;
  bool reserve_notes();  // whether what the step before saw was lost
  void reserve_adjoint(bool dry, bool materials);
  // `record`: which results it clears.
  void list_contacts(const ContactArguments& contacts, const ContactRecord& record) const;
  ContactShapes shapes(const ContactArguments& contacts) const;
  ContactGroupArguments groups(const ContactArguments& contacts, const FeatherstoneOptions& options,
                               const ContactRecord& record, const DeviceArray<float>& memory,
                               int64_t stride) const;

  const Model& model_;
  const Articulations& articulations_;
  int64_t groups_ = 0, tree_stride_, adjoint_tree_stride_, contact_stride_;
  DeviceArray<int32_t> side_of_body_, moved_by_, group_of_tree_, tree_begin_, trees_;
  ArrayStamp friction_stamp_;
  bool has_friction_ = false, on_stack_;
  bool has_long_trees_ = false;  // without a mass matrix, which the kernels need
  Contacts none_;
  int64_t capacity_ = -1;  // contacts; -1: no memory was taken
  DeviceArray<int32_t> group_, contact_begin_, contacts_, chain_, nodes_, kept_begin_, sweeps_;
  DeviceArray<float> now_, kept_, kept_dt_, kept_friction_, memory_, residual_;
  // Of steps that are recorded, and of adjoints.
  int64_t group_dofs_ = 0;  // of the largest group
  int64_t adjoint_capacity_ = -1, adjoint_dofs_ = 0, adjoint_stride_, system_of_contact_ = 0,
          system_of_group_ = 0;
  DeviceArray<float> adjoint_memory_, tangent_memory_, system_, materials_;
  DeviceArray<int32_t> notes_, some_notes_, seen_, seen_before_, seen_begin_, branches_,
      adjoint_status_, shape_of_, shape_begin_, shape_sides_;
};

}  // namespace novaphy
