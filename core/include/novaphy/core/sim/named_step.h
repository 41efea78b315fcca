// Errors of the steps of a rollout.
#pragma once

#include <cstdint>

#include "novaphy/core/error.h"

namespace novaphy {

// Runs step `t` of a rollout. The message of an Error of the step gets the number of the step.
template <class F>
void named_step(int32_t t, F&& run) {
  try {
    run();
  } catch (const Error& error) {
    fail(error.kind(), error.what(), "; in step ", t, " of the rollout");
  }
}

}  // namespace novaphy
