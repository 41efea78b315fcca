// Steps of articulations with contacts and dry friction as launches, on devices
// (articulation_contact_kernels.h): a thread for each group of articulations that may touch, in the
// order of its contacts, so with the bits of the cpu.
#pragma once

#include <vector>

#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/contact_branches.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

// The arrays of contacts, as arguments of launches.
struct ContactRowArguments {
  explicit ContactRowArguments(const Contacts& contacts);
  ContactRowArguments() = default;
  LaunchArgument count, shape0, shape1, point_id, point0, point1, normal, margin0, margin1;
  LaunchArgument force;  // a null pointer: nobody wants it
  int64_t most = 0;      // rows
};

// What a step does for its adjoint; arguments that are null pointers: nothing.
struct ContactRecord {
  LaunchArgument impulses = {}, friction = {};  // along n, t1, t2; of dofs with dry friction
  bool found = false;                           // ContactRows::found
  bool by_restitution = false;
  bool continues = false;  // it starts where the last one that noted ended
  bool dry = false;    // joints have dry friction, or may have some in a replay
  bool notes = false;  // adds its branches to branches()
  bool records = false;
};

// Where the gradients go of what only contacts and dry friction read; they are added to. Or their
// dual numbers.
struct ContactGradientArguments {
  LaunchArgument joint_friction, mu, restitution, ke, kd;
  bool of_materials() const {
    return mu.range != nullptr || restitution.range != nullptr || ke.range != nullptr ||
           kd.range != nullptr;
  }
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
  // impulses then. `step`: the arguments of ArticulationStepArguments.
  void step(std::vector<LaunchArgument> step, const Contacts* contacts,
            const FeatherstoneOptions& options, float dt);
  // The same of any rows; one that records starts from nothing, and solves all islands by pgs.h.
  void step(std::vector<LaunchArgument> step, const ContactRowArguments& rows,
            const FeatherstoneOptions& options, float dt, const ContactRecord& record);
  // Copies rows, but for their names and forces.
  void copy(const ContactRowArguments& from, const ContactRowArguments& to) const;
  // The adjoint of a step that was recorded. `step`: the arguments of ArticulationStepVjpArguments.
  void vjp(std::vector<LaunchArgument> step, const ContactRowArguments& rows,
           const FeatherstoneOptions& options, const ContactRecord& record,
           const ContactGradientArguments& to);
  // Likewise its tangent. `step`: the arguments of ArticulationJvpArguments; `duals`: dual numbers
  // of joint_friction and of the materials.
  void jvp(std::vector<LaunchArgument> step, const ContactRowArguments& rows,
           const FeatherstoneOptions& options, const ContactRecord& record,
           const ContactGradientArguments& duals);
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
  bool reserve_notes();  // whether what the step before saw was lost
  void reserve_adjoint(bool dry, bool materials);
  void list_rows(const ContactRowArguments& rows, const ContactRecord& record) const;
  std::vector<LaunchArgument> shapes(const ContactRowArguments& rows) const;
  std::vector<LaunchArgument> group_words(const ContactRowArguments& rows,
                                          const FeatherstoneOptions& options,
                                          const ContactRecord& record,
                                          const DeviceArray<float>& memory, int64_t stride) const;

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
