// Finds the operation where the first gradient that is not finite arises.
#include "checks.h"
#include "novaphy/core/warning.h"
#include "novaphy/nova/op_list.h"
#include "tape_impl.h"

namespace nova {

using novaphy::Storage;

namespace {

std::span<const float> values_of(const Range& gradient) {
  return {static_cast<const float*>(gradient.data()), gradient.bytes() / sizeof(float)};
}
// A gradient on another device counts as finite, because the host cannot read its values.
bool is_finite(const Range& gradient) {
  return !gradient.storage().device().is_cpu() || detail::first_not_finite(values_of(gradient)) < 0;
}

}  // namespace

// Checks only the columns that adjoints read; other columns may never have been written.
bool Tape::Impl::is_finite_where_read(const Range& gradient, const Node& n) {
  if (is_finite(gradient)) return true;
  if (n.unread == 0) return false;
  const std::span<const float> values = values_of(gradient);
  for (size_t k = 0; k < values.size(); ++k)
    if (!(n.unread >> k % static_cast<size_t>(n.unread_width) & 1) && !std::isfinite(values[k]))
      return false;
  return true;
}

void Tape::Impl::report_not_finite(const std::shared_ptr<Range>& loss_gradient, const Tensor& seed,
                                   const Copies& earlier) {
  if (!loss_gradient->storage().device().is_cpu()) return;
  std::vector<std::shared_ptr<Range>> leaves;
  for (const Node& n : nodes)
    if (n.set && !n.ever_written) leaves.push_back(grad_storage(*n.range));
  const int64_t bad = std::ranges::count_if(leaves, [](const auto& g) { return !is_finite(*g); });
  const bool known =
      std::ranges::any_of(earlier, [](const auto& b) { return !is_finite(*b.second); });
  if (bad == 0 || known) return;
  // Repeats the backward pass from the earlier gradients, up to the first value that is not finite.
  Copies results;
  for (const std::shared_ptr<Range>& gradient : leaves) {
    results.emplace_back(
        gradient,
        Storage::allocate(gradient->bytes(), gradient->storage().device(), false)->range());
    submit_copy(results.back().second, gradient);
  }
  for (const auto& [gradient, copy] : earlier) submit_copy(gradient, copy);
  std::string first = "that of the loss, which was given";
  const auto stop = [&](const Step& step) {
    for (uint32_t s = 0; step.op && s < step.op->inputs; ++s) {
      if (!(step.key.wrt >> s & 1)) continue;
      const Range& gradient = **input_gradient(step, s);
      if (is_finite_where_read(gradient, *find(*input(*step.op, s).operand.range))) continue;
      first = "that of '" + input_name(*step.op, s) + "' of op '" + op_name(*step.op) + "'";
      if (step.op->step >= 0)
        first += " in step " + std::to_string(step.op->step) + " of a rollout";
      first += ", " + std::to_string(detail::count_not_finite(values_of(gradient))) + " of " +
               std::to_string(values_of(gradient).size()) + " values";
      return true;
    }
    return false;
  };
  if (!seed.defined() || is_finite(*seed.range())) run_steps(loss_gradient, seed, stop);
  for (const auto& [gradient, copy] : results) submit_copy(gradient, copy);
  novaphy::warn_of("backward: the gradients of ", bad, " of ", leaves.size(),
                   " leaves are not finite; going back, the first gradient that is not is ", first);
}

}  // namespace nova
