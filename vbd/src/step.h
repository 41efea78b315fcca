// A step of VBD on any device: its tables, its memory, and the list of its launches (step_list.h).
// On the CPU, if no recorder takes the launches, the host checks the step between parts of the
// list. Otherwise kernels note faults (vbd::note_fault), and check() reports them.
#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "coarse.h"
#include "color_slots.h"
#include "novaphy/core/sim/derived_fields.h"
#include "novaphy/core/sim/edited_values.h"
#include "novaphy/core/sim/unsupported_materials.h"
#include "rows.h"
#include "self_contact.h"
#include "step_inputs.h"
#include "step_list.h"

namespace novaphy::vbd {

struct StepResults {
  WritesRow<Vec3f> q, qd;
  bool keeps_iterates = false;
  bool updates_last = false;  // write the velocity before the step to last_velocity of the inputs
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

class Bodies;

class Step {
 public:
  using Rows4 = DeviceArray<Vec4f>;  // a row of four floats for each particle

  // ErrorKind::NotImplemented: a device for which the build has no code, or `tolerance` on a
  // device. `damps_inside`: the value of `inside` in particle_contact_law.h.
  Step(const Model& m, const VbdOptions& o, bool damps_inside = false);

  // Rebuilds the slots from the current model.
  void build();
  // Rebuilds the tables if dt or the arrays of the model have changed. `damps`: the step has
  // damping terms even if all coefficients are 0. Errors: as for SolverVBD::step.
  void update(float dt, bool damps = false);
  // Runs a step. `in_use` marks the memory of the solver as used, and a recording keeps this mark.
  // `bodies`: the rigid bodies, after Bodies::begin, for a step that runs at once. Null: none.
  void run(const StepInputs& in, const StepResults& out,
           const std::shared_ptr<ExclusiveUse>& in_use, Bodies* bodies = nullptr);
  // For use after a run that stored no iterates: iterate_again runs one more iteration, and
  // finish_again writes the results from the current x.
  void iterate_again();
  void finish_again() const;
  // Waits for all launches. ErrorKind::Runtime: since the last check a step had values that are not
  // finite, or contacts that had overflowed. Each error is reported once.
  void check();
  void find_residuals();
  VbdResidual last_residual() const;  // of the last find_residuals
  VbdResidual residual();
  // Returns for each component whether its residual is at most the tolerance or twice its floor.
  Flags solved(double tolerance);

  const Model& model() const { return model_; }
  // Returns the model on the host from which the slots were made. This is a copy if the model is on
  // a device.
  const Model& host_model() const { return *copy_; }
  const VbdOptions& options() const { return options_; }
  Device device() const { return model_.device(); }
  bool on_cpu() const { return on_cpu_; }
  const ColorSlots& slots() const { return slots_; }
  // Returns the coarse correction. Null: the option is off, or no two moving particles share an
  // element.
  const Coarse* coarse() const { return coarse_ && coarse_->systems() > 0 ? &*coarse_ : nullptr; }
  Components components() const {
    return {slots_.components(), static_cast<size_t>(slots_.component_count())};
  }
  // Returns the self-contact. Null: the option is off.
  const SelfContact* self_contact() const { return self_contact_ ? &*self_contact_ : nullptr; }
  const std::vector<int64_t>& colors() const { return slots_.color_begin(); }
  uint64_t builds() const { return builds_; }    // count of builds of the slots
  uint64_t version() const { return version_; }  // changes when the memory of launches changes
  float dt() const { return tables_->dt; }
  bool damps() const { return damps_; }
  int64_t block_groups() const {
    return block_groups_;
  }  // of the last run; 0: one thread for each particle
  bool is_kinematic(size_t p) const { return slots_.is_kinematic(static_cast<int32_t>(p)); }
  int32_t kinematic_count() const { return static_cast<int32_t>(kinematic_.rows()); }
  // Returns whether the initial guess of a step uses the previous velocity.
  bool looks_back(const StepInputs& in) const {
    return options_.initial_guess == VbdInitialGuess::Adaptive && in.last_velocity.rows() != 0;
  }

  // State after the last run.
  bool has_contacts() const { return has_contacts_; }
  VbdSweepArguments sweep(int64_t first_group, int64_t end_group) const;
  VbdAccelerateArguments acceleration(int32_t iteration) const;
  // Returns the arguments of the launch that moves the particles of some groups to the rows of
  // `from`.
  VbdCommitArguments commit(int64_t first_group, const Rows4& from) const;
  // Return the positions before and after the sweep of an iteration. Without a coarse correction,
  // the positions after a sweep are the positions before the next sweep, and the last ones are not
  // stored.
  const Rows4& before(size_t iteration) const { return iterates_[stride() * iteration]; }
  const Rows4& after_sweep(size_t iteration) const { return iterates_[2 * iteration + 1]; }
  // With a coarse correction: the line searches of an iteration, and the positions after the last
  // iteration.
  const Rows4& search(size_t iteration) const { return searches_[iteration]; }
  const Rows4& end() const { return iterates_.back(); }
  int32_t halvings() const;  // number of stored line searches with a shortened step
  const Rows4& start() const { return start_; }
  const Rows4& moved() const { return moved_; }
  const Rows4& x() const { return x_; }
  void place(const Rows& x, const Rows& moved) {
    upload_rows(x_, x);
    upload_rows(moved_, moved);
  }
  const DeviceArray<int32_t>& is_kinematic() const { return is_kinematic_; }
  const DeviceArray<int32_t>& kinematic() const { return kinematic_; }
  const DeviceArray<int32_t>& particles() const { return tables_->particle; }  // of all lanes
  const DeviceArray<int32_t>& filled() const { return tables_->filled; }       // of all groups
  // Contacts, sorted by particle. The arrays are large enough for all slots of the contacts.
  const DeviceArray<int32_t>& contact_begin() const { return contact_begin_; }
  const DeviceArray<int32_t>& contact_items() const { return contact_items_; }
  // kContactFloats for each contact, in the same order.
  const DeviceArray<float>& contact_numbers() const { return contact_numbers_; }

 private:
  // A material of elements that replays may change. `allowed`: which of its values may differ from
  // 0, see vbd_material.
  struct Trained {
    const char* name;
    const Array* array;
    DeviceArray<int32_t> allowed;
  };
  // Tables that depend on the model and on the step size.
  struct Tables {
    float dt = 0.0f;
    int64_t damped = 0;        // bit r: role r has damping
    int64_t block_groups = 0;  // groups of a thread block; 0: too many slots for a block
    bool is_recorded = false;  // replays write the activations
    DeviceArray<int32_t> particle, filled;
    DeviceArray<float> mass_by_h2;
    DeviceArray<uint64_t> begin[kRoles];
    DeviceArray<int32_t> ints[kRoles];
    DeviceArray<float> floats[kRoles];
    DerivedStamp activations[kRoles];      // the activations that the slots contain
    DeviceArray<int32_t> sources[kRoles];  // see VbdNumbersArguments
    std::vector<Trained> trained;          // the materials that replays may change
  };
  struct Stamped {
    const char* name = "";
    const Array* array = nullptr;
    DerivedStamp stamp;
  };

  // Returns whether launches run at once, so that the host can read their results.
  bool is_immediate() const { return runs_at_once(device()); }
  // step_tables.cpp
  void build_tables(float dt);
  void find_block_groups();
  void reserve_iterates();
  // step_checks.cpp
  void check_contacts(const Contacts& contacts, bool has_bodies) const;
  void check_inputs(const StepInputs& in);
  void check_positions() const;
  // step_residual.cpp
  void find_motion() const;
  void sum_residuals() const;
  void iterate_to(double tolerance, const StepList& list);
  void forget_lists();
  void reserve_contacts(int32_t slots);
  void find_contacts(const Contacts& contacts) const;
  void activate(const StepInputs& in);
  template <Role role>
  void put_numbers(const StepInputs& in, const Kernel<VbdNumbersArguments>& numbers) const;
  // step_training.cpp
  void reserve_training();
  void watch_materials();
  void check_trained() const;
  size_t stride() const { return coarse() != nullptr ? 2 : 1; }  // stored positions per iteration
  StepList& list_for(const StepInputs& in, const StepResults& out);
  int64_t find_mover() const;
  // step_self_contact.cpp
  void iterate_in_contact(Bodies* bodies);
  // step_bodies.cpp
  void couple(Bodies& bodies, const Contacts* contacts);
  void find_touched_groups(const Bodies& bodies);
  void iterate_bodies(Bodies& bodies);
  void iterate_with(Bodies& bodies);
  void end_with(Bodies& bodies) const;

  const Model& model_;
  const VbdOptions options_;
  const bool damps_inside_, on_cpu_;
  UnsupportedMaterials materials_;
  EditedValues edited_{"SolverVBD"};
  std::shared_ptr<const Model> copy_;  // see host_model
  std::deque<Stamped> mesh_, values_;
  std::vector<const Array*> read_;  // the arrays of mesh_ and values_
  size_t of_elements_ = 0;          // count of values_ that belong to elements
  ColorSlots slots_;
  std::optional<Coarse> coarse_;
  std::optional<SelfContact> self_contact_;
  uint64_t builds_ = 0, version_ = 0;
  std::optional<Tables> tables_;
  std::optional<StepList> lists_[2][2][2];  // [with contacts][with damping][keeps iterates]
  StepList* list_ = nullptr;                // the list of the last run
  int64_t block_groups_ = 0;
  std::vector<Trained> trained_;  // of all tables that graphs may still use
  DeviceArray<int32_t> is_kinematic_, kinematic_;
  Rows4 start_, target_, moved_, x_, next_, newer_, older_;
  std::vector<Rows4> iterates_, searches_;  // see before() and search()
  DeviceArray<int32_t> contact_begin_, contact_items_;
  DeviceArray<float> contact_numbers_, of_particles_;
  DeviceArray<float> blocks_;            // of particles that bodies touch, see write_block
  DeviceArray<int32_t> touched_filled_;  // of groups: `filled` if bodies touch one, else 0
  DeviceArray<int32_t> faults_;          // of each particle, see vbd::note_fault
  DeviceArray<int32_t> overflow_;        // see VbdContactArguments
  mutable std::vector<ParticleResidual> residuals_;
  struct Motion {
    Rows start, target;
    std::vector<Vec3f> gravities;
    std::vector<Vec3<double>> moments;
    Numbers masses, squares;
  };
  struct Sums {  // squares of VbdResidual::force, of scale, and of floor times scale
    double force, scale, rounding;
  };
  std::vector<char> is_touched_;  // of particles, in find_touched_groups
  // Memory of find_motion, sum_residuals and iterate_to, on the host.
  mutable Motion motion_;
  mutable std::vector<Sums> sums_;
  Flags ended_;
  std::vector<Vec4f> ended_x_, ended_moved_;
  std::vector<float> chebyshev_;
  int32_t iterations_run_ = 0;
  bool has_contacts_ = false, damps_ = false, was_recorded_ = false;
};

}  // namespace novaphy::vbd
