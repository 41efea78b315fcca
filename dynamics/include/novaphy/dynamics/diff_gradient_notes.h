// GradientNotes: what the steps of a solver say of their gradients. Compiled into novaphy::dynamics
// where nova is built.
#pragma once

#include <memory>
#include <vector>

#include "novaphy/core/sim/contacts.h"
#include "novaphy/core/sim/model.h"
#include "novaphy/core/sim/sim_state.h"
#include "novaphy/dynamics/export.h"
#include "novaphy/dynamics/gradient_info.h"
#include "novaphy/nova/incidence.h"
#include "novaphy/nova/tape.h"

namespace novaphy {

// What a step has, and where its contacts were. Handles: nothing is copied.
struct NotedStep {
  // Memory of the state that it starts from, and of that it ends in.
  const void *start = nullptr, *end = nullptr;
  // Of particles and bodies, where the law of contacts counts.
  DeviceArray<Vec3f> q, qd;
  DeviceArray<Transformf> body_q;
  DeviceArray<SpatialVectorf> body_qd;
  std::shared_ptr<const ContactFields> contacts;   // null: none
  bool soft = false, rigid = false;                // which of them act
  bool soft_follow = false, rigid_follow = false;  // found from the state
  float kf_rate = 0.0f;    // 1/s: of particles in the semi-implicit law (soft_contact_force_term)
  float slip = 0.0f;       // m/s: of VBD, whose law has the margins of shapes; 0: the other law
  float smoothing = 0.0f;  // m/s: of friction between bodies
  // Contacts that the step finds by itself.
  bool static_particles = false;
  float static_reach = 0.0f;  // m
  nova::Incidence shapes_of;  // the shapes of each particle; null: all
  nova::Operand shape;        // of each pair
  nova::Operand plane_pairs;  // {n, 2}: plane and shape of a body; without a range: none
};

// Steps are remembered, and looked at when somebody asks, by kernels on their device: a rollout
// costs nothing, and a capture tells of its last replay. Those of states that are not kept are
// looked at at once.
class NOVAPHY_DYNAMICS_API GradientNotes {
 public:
  // A step on a tape. `keeps`: its arrays stay as they are. One that does not start where the last
  // one ended begins a new chain, and the last one is forgotten.
  void add(const Model& model, NotedStep step, bool keeps);
  // The same, but the last chain is kept.
  void add_to_all(const Model& model, NotedStep step, bool keeps);
  // Of the chain, or of all steps that were looked at since the last clear. Waits for a device.
  GradientCounts counts(const Model& model) const;
  void clear();
  // The contacts of the last step, if they are these.
  std::shared_ptr<const ContactFields> handles(const Contacts* contacts);

 private:
  struct List {
    DeviceArray<int32_t> now, before;
    int64_t rows = 0;  // of the step
    void reserve(int64_t contacts, Device device);
  };
  // Launches about steps that follow each other.
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
  const void* ended_ = nullptr;  // where the last step did
};

// What a solver says of its steps on one tape.
struct NOVAPHY_DYNAMICS_API GradientWitness : nova::Tape::Witness {
  virtual GradientInfo info() const = 0;
  // The events of its steps whose time moves with the state.
  virtual MotionEvents events() const { return {}; }
  // Whether the solver looks for such events.
  virtual bool has_events() const { return false; }
};
// The witness of a solver on the active tape, made by `make` where that tape has none.
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
// Of all solvers with steps on the tape: the worst label, with its reason, and the sums of counts.
// ErrorKind::Runtime: there are none, or no backward has run.
NOVAPHY_DYNAMICS_API GradientInfo gradient_info(const nova::Tape& tape);

}  // namespace novaphy
