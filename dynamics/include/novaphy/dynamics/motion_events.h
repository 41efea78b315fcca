// MotionEvent: the begin or end of a contact or joint limit, whose time moves with the state.
#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <utility>
#include <vector>

#include "novaphy/core/device_array.h"
#include "novaphy/dynamics/export.h"

namespace novaphy {

enum class MotionEventKind : uint8_t { Bounce, Landing, Spring, Limit };
enum class MotionFriction : uint8_t { None, Sticks, Slides, Turns };
// The array of the state or the model by whose entries the time of an event is differentiated.
enum class MotionArray : uint8_t { JointQ, BodyQ, ParticleQ, JointLimit };

struct MotionEvent {
  // A chain is a run of consecutive steps. `step` and `time` count from the chain's first step.
  int64_t chain = 0;
  int64_t step = 0;   // the step in which the event begins
  double time = 0.0;  // s
  int32_t world = 0;
  // -1: none. An event of a limit names a joint. Other events name two shapes, or a shape and a
  // particle.
  int32_t shape0 = -1, shape1 = -1, particle = -1, joint = -1;
  MotionEventKind kind = MotionEventKind::Bounce;
  MotionFriction friction = MotionFriction::None;
  float approach = 0.0f;  // approach speed: m/s, or rad/s for an angle
  float phase = 0.0f;     // fraction of the step that precedes the event, 0 to 1
  bool whole = true;      // whether the last step of the event has run
  // H = p . f (AdjointDrift) before and after the event, from the last adjoint. NaN: no adjoint has
  // run.
  double h_before = std::numeric_limits<double>::quiet_NaN();
  double h_after = std::numeric_limits<double>::quiet_NaN();

  // The derivative of the event's time by rows of the state at the start of the event's step, or by
  // `limit`, the position limits of a joint. The array must still have the version `version`.
  struct TimeDerivative {
    MotionArray of = MotionArray::JointQ;
    int64_t first = 0;
    std::vector<float> by;
    DeviceArray<float> limit = {};
  };
  const void* start = nullptr;  // memory of the first array of `derivatives`
  uint64_t version = 0;
  std::vector<TimeDerivative> derivatives;

  // Sets time (s) and phase from the gap (m or rad) at the start of the step.
  void set_time(double start_time, double dt, double gap) {
    const double delay = gap / static_cast<double>(approach);
    time = start_time + delay;
    phase = static_cast<float>(std::fmin(std::fmax(delay / dt, 0.0), 1.0));
  }
};
using MotionEvents = std::vector<std::shared_ptr<MotionEvent>>;

}  // namespace novaphy
