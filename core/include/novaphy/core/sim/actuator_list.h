// The actuators of a ModelBuilder.
#pragma once

#include <string_view>
#include <vector>

#include "novaphy/core/sim/joint_args.h"

namespace novaphy {

class Model;

class ActuatorList {
 public:
  struct Actuator {
    int32_t dof;  // -1: it pushes `body`, or the world (-1)
    int32_t body;
    BodyActuatorArgs args;
  };

  int32_t count() const { return static_cast<int32_t>(all_.size()); }
  int32_t state_count() const;
  // Returns the index. `function` starts the messages about args.law.
  int32_t add(std::string_view function, const Actuator &actuator);
  // Those of another builder; `xform` moves what is fixed to the world.
  void append(const ActuatorList &other, int32_t first_dof, int32_t first_body,
              const Transformf &xform);
  // Calls move(body, frame) for both ends of each that pushes bodies.
  template <class Move>
  void move_bodies(const Move &move) {
    for (Actuator &a : all_) {
      if (a.dof >= 0) continue;
      move(a.body, a.args.frame);
      move(a.args.reference_body, a.args.reference);
    }
  }
  void upload(Model &model) const;

 private:
  std::vector<Actuator> all_;
};

}  // namespace novaphy
