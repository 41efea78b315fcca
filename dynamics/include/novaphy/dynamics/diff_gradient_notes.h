// GradientNotes: a record of a solver's steps, from which the labels of their gradients are
// computed. Compiled into novaphy::dynamics where nova is built.
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

// The arrays of a step and of its contacts. The members are handles, so no data are copied.
struct NotedStep {
  // Memory of the state at the start of the step, and at its end.
  const void *start = nullptr, *end = nullptr;
  // The state of particles and bodies at which the contact law is evaluated.
  DeviceArray<Vec3f> q, qd;
  DeviceArray<Transformf> body_q;
  DeviceArray<SpatialVectorf> body_qd;
  std::shared_ptr<const ContactFields> contacts;   // null: none
  bool soft = false, rigid = false;                // which kinds of contacts act
  bool soft_follow = false, rigid_follow = false;  // contacts were found from the state of the step
  // 1/s, of contacts of particles in the semi-implicit solver (soft_contact_force_term)
  float kf_rate = 0.0f;
  // m/s, slip of VBD's contact law, which includes the margins of shapes; 0: another solver
  float slip = 0.0f;
  float smoothing = 0.0f;  // m/s, of friction between bodies
  // Static contacts, which the step finds by itself.
  bool static_particles = false;
  float static_reach = 0.0f;  // m
  nova::Incidence shapes_of;  // the shapes of each particle; null: all
  nova::Operand shape;        // of each pair
  nova::Operand plane_pairs;  // {n, 2}: plane and shape of a body; without a range: none
  // The rest belongs to steps with penalty contacts of bodies (diff_noted_springs.h). Zero or
  // without a range: the step notes nothing.
  float dt = 0.0f;       // s
  nova::Operand wrench;  // {bodies, 6}: the sum of all wrenches, whose gradient a tape keeps
  nova::Operand q_next, qd_next;  // {bodies, 7 and 6}: the state after the step
};

// The class remembers steps. A call of counts() evaluates them, by kernels on their device. A
// rollout therefore costs nothing, and a capture reports its last replay. A step whose state is not
// kept is evaluated at once.
class NOVAPHY_DYNAMICS_API GradientNotes {
 public:
  // Adds a step on a tape. `keeps`: its arrays keep their values. A step that does not start where
  // the last one ended begins a new chain, and the last chain is forgotten.
  void add(const Model& model, NotedStep step, bool keeps);
  // Adds a step and always keeps the last chain.
  void add_to_all(const Model& model, NotedStep step, bool keeps);
  // Returns the counts of the chain, or of all steps since the last clear that were evaluated at
  // once. Waits for the device.
  GradientCounts counts(const Model& model) const;
  void clear();
  // The steps of the chain, if all their states are kept.
  std::span<const NotedStep> chain() const { return chain_; }
  // Returns handles to the contacts. The handles of the last step are reused if it had the same
  // contacts.
  std::shared_ptr<const ContactFields> handles(const Contacts* contacts);

 private:
  struct List {
    DeviceArray<int32_t> now, before;
    int64_t rows = 0;  // of the step
    void reserve(int64_t contacts, Device device);
  };
  // The launches that evaluate consecutive steps.
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
  const void* ended_ = nullptr;  // memory of the state at the end of the last step
};

// The report of a solver about its steps on one tape.
struct NOVAPHY_DYNAMICS_API GradientWitness : nova::Tape::Witness {
  virtual GradientInfo info() const = 0;
  // Returns the events of the steps whose time moves with the state.
  virtual MotionEvents events() const { return {}; }
  // Returns whether the solver looks for events whose time moves with the state.
  virtual bool has_events() const { return false; }
  // Returns the name of a solver whose steps fill no AdjointRecord. Null: the steps fill it.
  virtual const char* without_record() const { return nullptr; }
  // For solvers whose entries of a record come from gradients that the tape keeps: clears these
  // before the adjoint, and adds the entries after it. Other solvers add them in their adjoints.
  virtual void begin_record() const {}
  virtual void add_to(AdjointRecord& /*record*/) const {}
};
// Returns the witness of a solver on the active tape. `make` makes the witness if the tape has
// none.
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
// Returns the worst label of all solvers with steps on the tape, with its reason, and the sums of
// counts. ErrorKind::Runtime: no solver has steps on the tape, or no backward has run.
NOVAPHY_DYNAMICS_API GradientInfo gradient_info(const nova::Tape& tape);

}  // namespace novaphy
