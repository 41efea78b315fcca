#include "optim_impl.h"

#include <algorithm>
#include <cmath>

#include "novaphy/nova/incidence.h"

namespace nova::detail {

using novaphy::fail;
using novaphy::require;

void check_rate(const Argument& argument, float value) {
  require(std::isfinite(value) && value >= 0.0f, ErrorKind::Value, argument,
          "expected a finite number >= 0, got ", value);
}

void check_has_grad(const Tensor& param, const Argument& argument) {
  require(param.has_grad(), ErrorKind::Value, argument, "it has no gradient; run backward first");
}

void check_params(std::span<const Tensor> params, const char* call) {
  require(!params.empty(), ErrorKind::Value, call, ", params: expected at least one tensor, got 0");
  for (size_t k = 0; k < params.size(); ++k) {
    const Argument argument{call, "params", static_cast<int64_t>(k)};
    check_f32(params[k], argument);
    if (params[k].device() != params[0].device())
      fail(ErrorKind::Value, argument, "expected device ", params[0].device().str(), ", got ",
           params[k].device().str());
    for (size_t j = 0; j < k; ++j)
      require(!params[k].range()->overlaps(*params[j].range()), ErrorKind::Value, argument,
              "expected memory of its own, got that of params[", j, "]");
  }
}

void check_grads(std::span<const Tensor> params, const char* call) {
  for (size_t k = 0; k < params.size(); ++k)
    check_has_grad(params[k], {call, "params", static_cast<int64_t>(k)});
}

void check_finite_grads(std::span<const Tensor> params, const char* call) {
  for (size_t k = 0; k < params.size(); ++k) {
    const Operand grad = grad_operand(params[k]);
    const std::span values(static_cast<const float*>(grad.range->data()),
                           static_cast<size_t>(grad.rows));
    if (const int64_t first = first_not_finite(values); first >= 0)
      fail(ErrorKind::Runtime, Argument{call, "params", static_cast<int64_t>(k)},
           "expected a finite gradient, got ", count_not_finite(values), " of ", values.size(),
           " values that are not finite, the first ", values[static_cast<size_t>(first)], " at ",
           first, "; nothing was written");
  }
}

void sum_over_grads(std::span<const Tensor> params, const Kernel& f, const Operand& total) {
  int64_t most = 0;
  for (const Tensor& p : params) most = std::max(most, p.size());
  const auto terms = novaphy::Storage::allocate(static_cast<size_t>(most) * sizeof(float),
                                                params[0].device(), /*zeroed=*/false)
                         ->range();
  for (size_t k = 0; k < params.size(); ++k) {
    const int64_t n = params[k].size();
    const Operand in = grad_operand(params[k]), out{terms, n, 1};
    f.launch(n, in, out);
    row_sum(out, 1, n, k == 0 ? nullptr : &total, total);
  }
}

Operand grad_operand(const Tensor& param) {
  const GradInfo& info = grad_info(*param.range());
  if (info.state != GradState::Held) param.grad();  // fills the gradient with zeros
  Operand o = param.flat_operand();
  o.range = info.grad;
  return o;
}

Int next_count(const Real& t) {
  return min(max(to_int(t), Int(0)), Int((1 << kCountBits) - 2)) + Int(1);
}

}  // namespace nova::detail
