// The function adam_update_f32 and the class Adam.
#include <cmath>

#include "engine_kernels.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/tape.h"
#include "optim_impl.h"

namespace nova {

using detail::Argument;
using detail::check_f32;
using novaphy::fail;
using novaphy::require;

namespace {

void check_options(const char* call, const AdamOptions& options) {
  detail::check_rate({call, "lr"}, options.lr);
  const std::pair<const char*, float> betas[] = {{"beta1", options.beta1},
                                                 {"beta2", options.beta2}};
  for (const auto& [name, beta] : betas)
    require(beta >= 0.0f && beta < 1.0f, ErrorKind::Value, Argument{call, name},
            "expected a float32 in [0, 1), got ", beta);
  require(std::isfinite(options.eps) && options.eps > 0.0f, ErrorKind::Value, Argument{call, "eps"},
          "expected a finite float32 > 0, got ", options.eps);
}

// Returns 1 - beta^count. With c(k) = 1 - beta^k, products of powers are
//   c(j + k) = c(j) + c(k) * (1 - c(j)),   c(2 k) = c(k) * (2 - c(k)),
// so the bits of count select the factors. 1 - pow(beta, count) would cancel: for beta = 0.999 it
// loses 14 bits in the first step.
Real bias_correction(const Int& count, const Real& beta) {
  Real total(0.0f), power = Real(1.0f) - beta;
  for (int k = 0; k < detail::kCountBits; ++k) {
    const Bool taken = (shift_right_unsigned(count, Int(k)) & Int(1)) != Int(0);
    total = select(taken, total + power * (Real(1.0f) - total), total);
    power = power * (Real(2.0f) - power);
  }
  return total;
}

const Kernel& adam_advance_kernel() {
  static const Kernel kernel = make_kernel(
      "adam_advance_f32",
      {{"t", DType::F32, 1, Access::Direct}, {"unfit", DType::F32, 1, Access::Direct}},
      {{"t", 1}, {"correction", 2}}, [](TraceContext& c) {
        const Int count = detail::next_count(c.f32(0));
        return std::vector{detail::if_fit(c.f32(1), to_real(count), c.f32(0)),
                           bias_correction(count, c.param(0)), bias_correction(count, c.param(1))};
      });
  return kernel;
}

// Computes t += 1 and both bias corrections. This runs once per step, because it takes many
// operations and all parameters of the class share one t.
void advance(const Tensor& t, const Tensor& correction, const Tensor& unfit,
             const AdamOptions& options) {
  const Operand in[] = {t.flat_operand(), unfit.operand()}, out[] = {in[0], correction.operand()};
  const Param params[] = {options.beta1, options.beta2};
  adam_advance_kernel().launch(1, in, out, {.params = params});
}

const Kernel& adam_update_kernel() {
  static const Kernel kernel =
      make_kernel("adam_update_f32",
                  {{"param", DType::F32, 1, Access::Direct},
                   {"m", DType::F32, 1, Access::Direct},
                   {"v", DType::F32, 1, Access::Direct},
                   {"grad", DType::F32, 1, Access::Direct},
                   {"correction", DType::F32, 2, Access::Uniform},
                   {"unfit", DType::F32, 1, Access::Uniform}},
                  {{"param", 1}, {"m", 1}, {"v", 1}}, [](TraceContext& c) {
                    const Real one(1.0f), g = c.f32(3), unfit = c.f32(5);
                    const Real lr = c.param(0), beta1 = c.param(1), beta2 = c.param(2);
                    const Real new_m = beta1 * c.f32(1) + (one - beta1) * g;
                    const Real new_v = beta2 * c.f32(2) + (one - beta2) * g * g;
                    const Real m_hat = new_m / c.f32(4, 0), v_hat = new_v / c.f32(4, 1);
                    const Real p = c.f32(0) - lr * m_hat / (sqrt(v_hat) + c.param(3));
                    return std::vector{detail::if_fit(unfit, p, c.f32(0)),
                                       detail::if_fit(unfit, new_m, c.f32(1)),
                                       detail::if_fit(unfit, new_v, c.f32(2))};
                  });
  return kernel;
}

void update(const Tensor& param, const Tensor& m, const Tensor& v, const Tensor& correction,
            const Tensor& unfit, const AdamOptions& options) {
  const Operand in[] = {param.flat_operand(),        m.flat_operand(),     v.flat_operand(),
                        detail::grad_operand(param), correction.operand(), unfit.operand()};
  const Param params[] = {options.lr, options.beta1, options.beta2, options.eps};
  adam_update_kernel().launch(param.size(), in, {in, 3}, {.params = params});
}

// Allocates the two floats that `advance` writes.
Tensor make_correction(Device device) { return Tensor({1, 2}, DType::F32, device); }

void check_state(const Tensor& param, const Tensor& m, const Tensor& v, const Tensor& t) {
  constexpr const char* kCall = "adam_update_f32";
  const std::pair<const char*, const Tensor*> all[] = {
      {"param", &param}, {"m", &m}, {"v", &v}, {"t", &t}};
  constexpr size_t kT = 3;
  for (const auto& [name, x] : all) check_f32(*x, {kCall, name});
  for (size_t k = 0; k < std::size(all); ++k) {
    const auto& [name, x] = all[k];
    const bool shape_ok = k == kT ? x->size() == 1 : x->shape() == param.shape();
    if (!shape_ok)
      fail(ErrorKind::Value, Argument{kCall, name}, "expected shape ",
           k == kT ? "{1}" : shape_str(param.shape()), ", got ", shape_str(x->shape()));
    if (x->device() != param.device())
      fail(ErrorKind::Value, Argument{kCall, name}, "expected device ", param.device().str(),
           ", got ", x->device().str());
    for (size_t j = 0; j < k; ++j)
      require(!x->range()->overlaps(*all[j].second->range()), ErrorKind::Value,
              Argument{kCall, name}, "expected memory of its own, got that of ", all[j].first);
  }
  detail::check_has_grad(param, {kCall, "param"});
  const Range& grad = *grad_info(*param.range()).grad;
  for (const auto& [name, x] : all)
    require(!x->range()->overlaps(grad), ErrorKind::Value, Argument{kCall, name},
            "expected memory of its own, got that of param.grad");
}

}  // namespace

void detail::add_adam_kernels(EngineKernels& list) {
  for (const Kernel* k : {&adam_advance_kernel(), &adam_update_kernel()}) list.push_back({*k, {}});
}

void adam_update_f32(const Tensor& param, const Tensor& m, const Tensor& v, const Tensor& t,
                     float lr, float beta1, float beta2, float eps) {
  const AdamOptions options{lr, beta1, beta2, eps};
  check_state(param, m, v, t);
  check_options("adam_update_f32", options);
  NoGrad no_grad;
  const Tensor correction = make_correction(param.device());
  const Tensor unfit({1}, DType::F32, param.device());
  advance(t, correction, unfit, options);
  update(param, m, v, correction, unfit, options);
}

namespace optim {

Adam::Adam(std::vector<Tensor> params, const AdamOptions& options)
    : Optimizer("Adam", std::move(params), options.lr), options_(options) {
  check_options(name_, options);
  const Device device = params_[0].device();
  for (const Tensor& p : params_) {
    m_.emplace_back(p.shape(), DType::F32, device);
    v_.emplace_back(p.shape(), DType::F32, device);
  }
  t_ = Tensor({1}, DType::F32, device);
  correction_ = make_correction(device);
}

void Adam::step() const {
  NoGrad no_grad;
  begin_step();
  AdamOptions options = options_;
  options.lr = lr_;
  advance(t_, correction_, unfit_, options);
  for (size_t k = 0; k < params_.size(); ++k)
    update(params_[k], m_[k], v_[k], correction_, unfit_, options);
}

}  // namespace optim
}  // namespace nova
