// What a step of VBD on the host works with: the tables, the positions, and the list of its
// launches (step_list.h).
#pragma once

#include <deque>
#include <optional>
#include <vector>

#include "color_slots.h"
#include "novaphy/core/sim/edited_values.h"
#include "novaphy/core/sim/unread_materials.h"
#include "novaphy/vbd/rows_kernels.h"
#include "novaphy/vbd/solver_vbd.h"
#include "step_contacts.h"
#include "step_list.h"
#include "sweep.h"

namespace novaphy::vbd {

using Row = VbdRow;

// What a step reads and writes.
struct StepArrays {
  const Vec3f *q = nullptr, *qd = nullptr, *f = nullptr;
  Vec3f *q_out = nullptr, *qd_out = nullptr;
  const Vec4f* last = nullptr;  // see VbdStepInputs
};

class StepWork {
 public:
  // `keep_iterates`: the positions after every iteration stay.
  StepWork(const Model& m, const VbdOptions& o, bool keep_iterates = false);

  // The tables anew, from the model as it is now.
  void build();
  // What changed since the last step. Null activations: the model's. Errors as SolverVBD::step.
  void update(const DeviceArray<float>* tri_activation, const DeviceArray<float>* tet_activation,
              const Contacts* contact_rows, float step_dt);
  // `targets`: of the held particles; null: they stay.
  void run(const StepArrays& step_arrays, const Vec3f* targets);
  VbdResidual residual();
  // After a run that kept no iterates: one more iteration, and the results of x as it is now.
  void iterate_again();
  void finish_again();
  // Whether the last run began where the velocity before says.
  bool looked_back() const {
    return options.initial_guess == VbdInitialGuess::Adaptive && arrays_.last != nullptr;
  }

  const Model& model;
  const VbdOptions options;
  const SweepLevel& level = sweep_level();
  ColorSlots slots;
  ColorSlots::Constants constants;
  StepContacts contacts;
  Sweep sweep;

  std::vector<Row> start, target, moved, x;
  std::vector<std::vector<Row>> iterates;  // x after 0, 1, ... iterations
  bool has_stepped = false;
  bool damps = false;   // from the next update on: terms of damping although all coefficients are 0
  uint64_t builds = 0;  // how often the tables were made

 private:
  // Friction is of friction_epsilon, and contacts do not attract.
  UnreadMaterials materials_{"SolverVBD", {.kf = false, .ka = false}};
  EditedValues edited_{"SolverVBD"};
  struct Stamped {
    const char* name;
    const Array* array;
    DerivedStamp stamp;
  };

  VbdSweepArguments sweep_arguments();
  StepArguments arguments();
  void make_list();
  void iterate();
  void check_inputs();
  void check_positions() const;

  std::deque<Stamped> mesh_, values_;
  DerivedStamp activation_[2], world_;
  std::optional<StepList> list_;
  std::optional<VbdSweepArguments> listed_;  // what the list was made of
  std::vector<float> chebyshev_;             // per iteration
  std::vector<Row> next_, newer_, older_;
  std::vector<ParticleResidual> of_particles_;
  int32_t iterations_run_ = 0;
  std::vector<int32_t> faults_;  // of each particle, see vbd::note_fault
  StepArrays arrays_;
};

}  // namespace novaphy::vbd
