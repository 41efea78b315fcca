#include "novaphy/nova/gradcheck.h"

#include <algorithm>
#include <cmath>
#include <deque>
#include <sstream>

#include "novaphy/core/error.h"
#include "novaphy/nova/tape.h"

namespace nova {
namespace {

// Returns pseudorandom numbers in [-1, 1), the same on every platform.
std::vector<float> direction(int64_t n, uint32_t& state) {
  std::vector<float> u(static_cast<size_t>(n));
  for (float& x : u) {
    state = state * 1664525u + 1013904223u;
    x = static_cast<float>(state >> 8) * 0x1p-23f - 1.0f;
  }
  return u;
}

void check_direction(Tape& tape, const Tensor& loss, const std::vector<Tensor>& inputs,
                     const GradcheckOptions& options, GradcheckResult& result) {
  uint32_t state = 1;
  double reverse = 0.0, size = 1e-30;
  std::vector<Tensor> moved, tangents;
  for (const Tensor& x : inputs) {
    if (!tape.has_leaf(x)) continue;  // fn does not read this input
    const std::vector<float> u = direction(x.size(), state), g = x.grad().to_host();
    for (size_t i = 0; i < u.size(); ++i) {
      const double term = static_cast<double>(u[i]) * static_cast<double>(g[i]);
      reverse += term;
      size += std::fabs(term);
    }
    moved.push_back(x);
    tangents.push_back(Tensor::from_host(u, x.shape(), x.device()));
  }
  result.has_tangent = tape.has_tangents();
  if (!result.has_tangent) return;
  const double forward = static_cast<double>(tape.jvp({loss}, moved, tangents)[0].item());
  result.dot_product_error = static_cast<float>(std::fabs(forward - reverse) / size);
  if (!(result.dot_product_error <= options.dot_product_tolerance)) result.ok = false;
}

// Restores the values, the gradient and the flag of an input at the end of the check.
class Borrowed {
 public:
  explicit Borrowed(const Tensor& x)
      : x_(x), values_(x.to_host()), requires_grad_(x.requires_grad()) {
    const GradInfo* const info = find_grad_info(*x.range());
    if (info != nullptr && info->state == GradState::Held) gradient_ = x.grad().to_host();
    x.set_requires_grad(true);
    x.zero_grad();
  }
  Borrowed(const Borrowed&) = delete;
  Borrowed& operator=(const Borrowed&) = delete;
  ~Borrowed() {
    try {
      set(values_);
      x_.set_requires_grad(requires_grad_);
      x_.zero_grad();
      if (!gradient_.empty())
        x_.grad().copy_from_host(gradient_.data(), gradient_.size() * sizeof(float));
    } catch (...) {  // the device is lost, and the check has failed already
    }
  }
  const std::vector<float>& values() const { return values_; }
  void set(const std::vector<float>& values) const {
    x_.copy_from_host(values.data(), values.size() * sizeof(float));
  }

 private:
  Tensor x_;
  std::vector<float> values_, gradient_;
  bool requires_grad_;
};

void check_arguments(const std::vector<Tensor>& inputs, const GradcheckOptions& o) {
  require(std::isfinite(o.epsilon) && o.epsilon > 0.0f, ErrorKind::Value,
          "gradcheck, epsilon: expected a finite number > 0, got ", o.epsilon);
  require(o.rtol >= 0.0f && o.atol >= 0.0f && o.dot_product_tolerance >= 0.0f, ErrorKind::Value,
          "gradcheck: expected rtol, atol and dot_product_tolerance >= 0, got ", o.rtol, ", ",
          o.atol, " and ", o.dot_product_tolerance);
  for (size_t k = 0; k < inputs.size(); ++k) {
    require(inputs[k].defined(), ErrorKind::Value, "gradcheck, inputs[", k,
            "]: the tensor is undefined");
    for (size_t other = 0; other < k; ++other)
      require(inputs[k].range() != inputs[other].range(), ErrorKind::Value, "gradcheck, inputs[", k,
              "]: expected each input once, got the memory of inputs[", other, "]");
  }
}

}  // namespace

GradcheckResult gradcheck(const std::function<Tensor(const std::vector<Tensor>&)>& fn,
                          const std::vector<Tensor>& inputs, const GradcheckOptions& options) {
  check_arguments(inputs, options);
  std::deque<Borrowed> borrowed;
  for (const Tensor& x : inputs) borrowed.emplace_back(x);
  GradcheckResult result;
  {
    Tape tape;
    TapeScope scope(tape);
    const Tensor loss = fn(inputs);
    tape.backward(loss);
    check_direction(tape, loss, inputs, options, result);
  }
  auto evaluate = [&] {
    NoGrad no_grad;
    return static_cast<double>(fn(inputs).item());
  };
  for (size_t k = 0; k < inputs.size(); ++k) {
    const std::vector<float> ad = inputs[k].grad().to_host();
    const std::vector<float>& before = borrowed[k].values();
    std::vector<float> x = before;
    std::vector<double> fd(x.size());
    for (size_t i = 0; i < x.size(); ++i) {
      const float h = options.epsilon * std::max(1.0f, std::fabs(before[i]));
      const float up = before[i] + h, down = before[i] - h;
      x[i] = up;
      borrowed[k].set(x);
      const double f_up = evaluate();
      x[i] = down;
      borrowed[k].set(x);
      const double f_down = evaluate();
      x[i] = before[i];
      fd[i] = (f_up - f_down) / (static_cast<double>(up) - static_cast<double>(down));
    }
    borrowed[k].set(before);
    double scale = 0.0;
    for (double d : fd) scale = std::max(scale, std::fabs(d));
    for (size_t i = 0; i < fd.size(); ++i) {
      const double error = std::fabs(static_cast<double>(ad[i]) - fd[i]);
      const bool ok =
          error <= static_cast<double>(options.atol) + static_cast<double>(options.rtol) * scale;
      if (!ok) result.ok = false;  // also fails for NaN
      if (!(error <= static_cast<double>(result.max_abs_error))) {
        result.max_abs_error = static_cast<float>(error);
        result.max_rel_error = static_cast<float>(error / std::max(scale, 1e-30));
        std::ostringstream s;
        s << "input " << k << ", value " << i << ": ad " << ad[i] << ", fd " << fd[i];
        result.worst = s.str();
      }
    }
  }
  return result;
}

}  // namespace nova
