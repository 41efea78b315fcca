// A step of VBD as launches (core/device_kernel.h): on devices, and where a capture or tape
// records.
#pragma once

#include <array>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "color_slots.h"
#include "novaphy/core/array_stamp.h"
#include "novaphy/core/device_kernel.h"
#include "novaphy/core/recorder.h"
#include "novaphy/core/sim/edited_values.h"
#include "novaphy/core/sim/unread_materials.h"
#include "novaphy/vbd/differentiable_vbd.h"
#include "novaphy/vbd/lane_slots_kernels.h"
#include "step_list.h"
#include "sweep.h"

namespace novaphy::vbd {

struct VbdLaunchResults {
  DeviceArray<Vec3f> q, qd;
  // As many as there are iterations: the positions before each of them; none: they are not kept.
  std::span<const DeviceArray<Vec4f>> iterates = {};
  bool updates_last = false;  // the velocity of the step goes to the inputs' last_velocity
};

template <class T, class U>
DeviceArray<T> upload(const U* values, size_t count, Device device) {
  static_assert(sizeof(T) == sizeof(U));
  return DeviceArray<T>::from_host(std::span(reinterpret_cast<const T*>(values), count), device);
}
template <class T, class U>
DeviceArray<T> upload(const std::vector<U>& values, Device device) {
  return upload<T>(values.data(), values.size(), device);
}

class LaunchedStep {
 public:
  // ErrorKind::NotImplemented: a device for which the build has no code; `tolerance`, which the
  // host would have to look at.
  LaunchedStep(const Model& m, const VbdOptions& o);

  // The tables anew, from the model as it is now.
  void build() { build_slots(); }
  // What the tables are made of is as it was, or the tables are made anew. Errors as
  // SolverVBD::step.
  void update(float dt);
  // `in_use`: the use of the solver's memory, which a recording takes.
  void run(const VbdLaunchInputs& in, const VbdLaunchResults& out,
           const std::shared_ptr<ExclusiveUse>& in_use);
  // Waits for what was launched. ErrorKind::Runtime: a step since the last check read or made
  // numbers that are not finite, or contacts that had overflowed; says so once.
  void check();
  VbdResidual residual();
  VbdResidual last_residual() const;
  // From the next run on: terms of damping although all coefficients are 0.
  void set_damps(bool damps) { damps_ = damps; }
  void forget_last() { has_stepped_ = false; }
  int32_t held_count() const { return static_cast<int32_t>(held_.rows()); }
  bool has_stepped() const { return has_stepped_; }

 private:
  friend class LaunchedReverse;
  friend class LaunchedSolution;
  // A material of elements, and which of its numbers may be other than 0: see vbd_material.
  struct Trained {
    const char* name;
    const Array* array;
    DeviceArray<int32_t> allowed;
  };
  // Where the number of an activation lies, for each lane of each slot of a role.
  struct Activated {
    DeviceArray<int32_t> element;
    DeviceArray<float> alpha;
  };
  // Made of a model and a step size. Launches of captures keep them.
  struct Tables {
    float dt = 0.0f;
    std::vector<int64_t> colors;  // groups
    bool has_conflicts = false;
    int64_t damped = 0, most_groups = 0;
    int64_t team = 0;  // groups of a team; 0: one has too many slots
    DeviceArray<int32_t> particle, filled;
    DeviceArray<float> mass_by_h2;
    DeviceArray<uint64_t> begin[kRoles];
    DeviceArray<int32_t> ints[kRoles];
    DeviceArray<float> floats[kRoles];
    Activated triangle, tetrahedron;
    // Where elements are trained: of each lane of each slot, see LaneNumbers; and their materials.
    DeviceArray<int32_t> sources[kRoles];
    std::vector<Trained> trained;
  };
  enum class Mover { Thread, Team };

  const Model& on_host();
  void build_slots();
  void build_tables(float dt);
  void forget_tables();  // and the lists, which point to them
  void reserve_contacts(int32_t slots);
  // Of arrays of this; while these live.
  VbdSweepArguments sweep_arguments(bool with_contacts, int64_t first_group,
                                    int64_t end_group) const;
  void find_contacts(const Contacts& contacts) const;
  void activate(const Activated& to, Role role, const DeviceArray<float>& activation) const;
  // launched_training.cpp
  void reserve_training();
  void put_numbers(const VbdLaunchInputs& in) const;
  void check_trained() const;
  VbdFinishArguments finish_arguments(const VbdLaunchResults& out) const;
  StepArguments arguments(const VbdLaunchInputs& in, const VbdLaunchResults& out) const;
  StepList make_list(const StepArguments& arguments, Mover how,
                     std::span<const DeviceArray<Vec4f>> iterates) const;
  StepList& list_for(const StepArguments& arguments, bool with_contacts);
  void iterate_again(bool with_contacts);
  void finish(const VbdLaunchResults& out) const;
  // The particles of some groups are where rows of `from` say.
  void commit(int64_t first_group, int64_t end_group, const DeviceArray<Vec4f>& from) const;
  void find_residuals(bool with_contacts);
  Mover mover() const;

  const Model& model_;
  const VbdOptions options_;
  const SweepLevel& level_ = sweep_level();
  const bool on_cpu_;
  UnreadMaterials materials_;
  EditedValues edited_{"SolverVBD"};
  std::shared_ptr<const Model> copy_;  // of a model on a device
  std::vector<const Array*> mesh_, values_;
  std::vector<ArrayStamp> mesh_stamps_, value_stamps_;
  ColorSlots slots_;
  uint64_t builds_ = 0;  // of the slots
  std::shared_ptr<Tables> tables_;
  std::optional<StepList> lists_[2];  // of the tables: without contacts, and with them
  Mover list_mover_ = Mover::Thread;  // what the lists were made for
  bool list_damps_ = false;
  std::vector<Trained> trained_;  // of all tables that graphs may hold
  DeviceArray<int32_t> is_held_, held_;
  // Rows of four floats, one per particle.
  DeviceArray<Vec4f> start_, target_, moved_, x_, next_, newer_, older_;
  DeviceArray<int32_t> contact_begin_, contact_items_;
  DeviceArray<float> contact_numbers_, of_particles_;
  DeviceArray<int32_t> faults_;    // of each particle, see vbd::note_fault
  DeviceArray<int32_t> overflow_;  // see VbdContactArguments
  std::vector<float> chebyshev_;
  int32_t iterations_run_ = 0;
  bool has_stepped_ = false, had_contacts_ = false, damps_ = false;
};

}  // namespace novaphy::vbd
