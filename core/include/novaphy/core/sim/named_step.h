// Errors of the steps of a rollout.
#pragma once

#include <cstdint>

#include "novaphy/core/error.h"

namespace novaphy {

// Runs step `t` of a rollout and returns its result. The message of an Error begins with the step.
template <class F>
decltype(auto) named_step(int32_t t, F&& run) {
  try {
    return run();
  } catch (const Error& error) {
    fail(error.kind(), "step ", t, " of the rollout: ", error.what());
  }
}

}  // namespace novaphy
