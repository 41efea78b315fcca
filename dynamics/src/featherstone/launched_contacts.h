// Steps of articulations with contacts and dry friction as launches, on devices
// (articulation_contact_kernels.h): a thread for each group of articulations that may touch, in the
// order of its contacts, so with the bits of the cpu.
#pragma once

#include <vector>

#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/contacts.h"
#include "novaphy/dynamics/featherstone/articulations.h"
#include "novaphy/dynamics/featherstone/solver_featherstone.h"

namespace novaphy {

class LaunchedContacts {
 public:
  // A group is a world. Where an articulation belongs to all worlds, all are one group.
  LaunchedContacts(const Model& model, const Articulations& articulations);

  // Whether a step has to go through here: it has contacts or dry friction, or one before had
  // contacts, whose impulses are to be forgotten.
  bool has_rows(const Contacts* contacts);
  // Takes memory for the contacts where that of steps before is too small, and forgets their
  // impulses then. `step`: the arguments of ArticulationStepArguments.
  void step(std::vector<LaunchArgument> step, const Contacts* contacts,
            const FeatherstoneOptions& options, float dt);

  // Lets the next step, and captures that replay one, start without impulses of the step before.
  void forget_impulses() { kept_begin_.zero(); }

  // Whether a step needs no memory for articulations.
  bool on_stack() const { return on_stack_; }
  // Numbers of memory for an articulation.
  int64_t tree_stride() const { return tree_stride_; }
  // Of the last step that ran; they wait for it.
  int32_t sweeps() const;
  float residual() const;

 private:
  void reserve(int32_t contacts);
  std::vector<LaunchArgument> shapes(const Contacts& contacts) const;

  const Model& model_;
  const Articulations& articulations_;
  int64_t groups_ = 0, tree_stride_, contact_stride_;
  DeviceArray<int32_t> side_of_body_, moved_by_, group_of_tree_, tree_begin_, trees_;
  ArrayStamp friction_stamp_;
  bool has_friction_ = false, on_stack_;
  Contacts none_;
  int32_t capacity_ = -1;  // contacts; -1: no memory was taken
  DeviceArray<int32_t> group_, contact_begin_, contacts_, chain_, nodes_, kept_begin_, sweeps_;
  DeviceArray<float> now_, kept_, kept_dt_, memory_, residual_;
};

}  // namespace novaphy
