// GradientNotes: the steps of a solver, kept so that the labels of their gradients can be computed
// later. Compiled into novaphy::dynamics if nova is built.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/gradient_info.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/tape.h"

namespace novaphy {

struct AdjointRecord;

// The arrays of a step and of its contacts. The members are handles, so no data is copied.
struct NotedStep {
  // Addresses of the state at the start and at the end of the step.
  const void *start = nullptr, *end = nullptr;
  // The state of particles and bodies at which the contact law is evaluated.
  DeviceArray<Vec3f> q, qd;
  DeviceArray<Transformf> body_q;
  DeviceArray<SpatialVectorf> body_qd;
  std::shared_ptr<const ContactFields> contacts;   // null: none
  bool soft = false, rigid = false;                // which kinds of contacts act
  bool soft_contact_moves = false,
       rigid_contact_moves = false;  // the step's state gave the contacts
  // 1/s: bound of a particle contact's friction coefficient kf per particle mass, in the
  // semi-implicit solver (soft_contact_force_term).
  float kf_rate = 0.0f;
  // m/s: slip speed below which VBD smooths friction. A value above 0 also says that the contacts
  // include the margins of shapes. 0: another solver.
  float slip = 0.0f;
  float smoothing = 0.0f;  // m/s: slip speed below which friction between bodies is smoothed
  // Contacts between particles and static shapes, which the step finds by itself.
  bool static_particles = false;
  float static_reach = 0.0f;  // m: gap below which such a contact acts
  nova::Incidence shapes_of;  // the static shapes of each particle; null: all
  nova::Operand shape;        // shape index of each entry of shapes_of
  nova::Operand plane_pairs;  // {n, 2}: plane, shape of a body; no range: none
  // The following members are set only for steps with penalty contacts of bodies
  // (diff_noted_springs.h). Other steps have zeros and operands without a range.
  float dt = 0.0f;       // s
  nova::Operand wrench;  // {bodies, 6}: the sum of all wrenches; the tape keeps its gradient
  nova::Operand q_next, qd_next;  // {bodies, 7 and 6}: the state after the step
};

// The class keeps the last steps. counts() evaluates these steps by kernels on their device, so a
// rollout costs nothing extra, and a capture reports its last replay. A step whose state will be
// overwritten is evaluated at once.
class NOVAPHY_DYNAMICS_API GradientNotes {
 public:
  // Adds a step on a tape. `keeps`: whether the step's arrays keep their values. A step that does
  // not start where the last one ended begins a new chain, and the old chain is dropped.
  void add(const Model& model, NotedStep step, bool keeps);
  // Adds a step, and keeps the last chain even if the step does not continue it.
  void add_to_all(const Model& model, NotedStep step, bool keeps);
  // Returns the counts over the steps of the chain. If steps were evaluated at once, the counts are
  // over all steps since the last clear. Waits for the device.
  GradientCounts counts(const Model& model) const;
  void clear();
  // Returns the steps of the chain, if all of their states are kept.
  std::span<const NotedStep> chain() const { return chain_; }
  // Returns handles to the arrays of `contacts`. The same contacts as in the last step give the
  // same handles.
  std::shared_ptr<const ContactFields> handles(const Contacts* contacts);

 private:
  struct List {
    DeviceArray<int32_t> now, before;
    int64_t rows = 0;  // of the last step
    void reserve(int64_t contacts, Device device);
  };
  // Submits the kernels that evaluate consecutive steps.
  struct Looks {
    void look(const Model& model, const NotedStep& step);
    void at_soft(const Model& model, const NotedStep& step);
    void at_rigid(const Model& model, const NotedStep& step);
    void at_static_particles(const Model& model, const NotedStep& step);
    void at_planes(const Model& model, const NotedStep& step);
    GradientCounts counts() const;

    List soft, rigid;
    DeviceArray<int32_t> parts, sums;
    int64_t steps = 0;
    const void* ended = nullptr;
  };

  std::vector<NotedStep> chain_;
  Looks looks_;
  const void* ended_ = nullptr;  // address of the state at the end of the last step
};

// Reports the gradients of one solver's steps on one tape.
struct NOVAPHY_DYNAMICS_API GradientWitness : nova::Tape::Witness {
  virtual GradientInfo info() const = 0;
  // Returns the events of the steps whose times move with the state (DerivativeOf::Motion).
  virtual MotionEvents events() const { return {}; }
  // Returns whether the solver detects such events: events whose times move with the state.
  virtual bool has_events() const { return false; }
  // Returns the name of a solver whose steps fill no AdjointRecord. Null: the steps fill it.
  virtual const char* without_record() const { return nullptr; }
  // begin_record and add_to are for solvers that build an AdjointRecord from gradients that the
  // tape keeps. begin_record clears these gradients before the backward pass. add_to adds the
  // entries after the backward pass. Other solvers add entries in their adjoints.
  virtual void begin_record() const {}
  virtual void add_to(AdjointRecord& /*record*/) const {}
};
// Returns the witness of a solver on the active tape. If the tape has no witness of the solver,
// `make` makes it.
template <class T, class Make>
std::shared_ptr<T> witness_on_tape(std::weak_ptr<T>& last, const Make& make) {
  nova::Tape& tape = *nova::Tape::active();
  if (const std::shared_ptr<T> known = last.lock())
    for (const auto& witness : tape.witnesses())
      if (witness == known) return known;
  const std::shared_ptr<T> made = make();
  last = made;
  tape.add_witness(made);
  return made;
}
// Returns the worst label of all solvers with steps on the tape, its reason, and the sums of their
// counts. ErrorKind::Runtime: no solver has steps on the tape, or no backward pass has run.
NOVAPHY_DYNAMICS_API GradientInfo gradient_info(const nova::Tape& tape);

}  // namespace novaphy
