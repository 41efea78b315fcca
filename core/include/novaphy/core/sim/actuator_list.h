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
    int32_t dof;  // -1: acts on `body`, where -1 is the world
    int32_t body;
    BodyActuatorArgs args;
  };

  int32_t count() const { return static_cast<int32_t>(all_.size()); }
  int32_t state_count() const;
  // Adds an actuator and returns its index. Error messages begin with `function`.
  int32_t add(std::string_view function, const Actuator &actuator);
  // Adds the actuators of another builder. Their dof and body indices grow by `first_dof` and
  // `first_body`. `xform` moves the frames that are fixed to the world.
  void append(const ActuatorList &other, int32_t first_dof, int32_t first_body,
              const Transformf &xform);
  // Calls move(body, frame) for the frames of each actuator that acts on bodies: its own frame and
  // the reference frame.
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
