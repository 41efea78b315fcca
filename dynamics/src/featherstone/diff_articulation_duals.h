// The arguments of a step of articulations with dual numbers, for its tangent.
#pragma once

#include "diff_articulation_parts.h"

namespace novaphy::diff::detail {

using articulation::DualFloat;

// Returns the arguments. take(values, tangent): the dual numbers of an array; an undefined tangent
// is 0. `t`: the tangents of the inputs. `from`: the state at which the step starts; null: the
// step's inputs. Branches and tables are those of the recorded step.
template <class Take>
ArticulationArgumentsOf<DualFloat> dual_arguments(const Step& s, const StepOutputs* from,
                                                  std::span<const Tensor> t, const Take& take) {
  return step_arguments_of<DualFloat>(s, [&](const Tensor& values, int32_t place) {
    const auto i = static_cast<size_t>(place);
    const Tensor tangent = i < kGradientArrays ? t[i] : Tensor();
    const bool starts = from != nullptr && (place == kAt.q || place == kAt.qd);
    return take(starts ? (*from)[place == kAt.q ? 0 : 1] : values, tangent);
  });
}

}  // namespace novaphy::diff::detail
