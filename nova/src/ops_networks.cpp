// Activation functions and counter-based random numbers.
#include <limits>

#include "checks.h"
#include "engine_kernels.h"
#include "novaphy/math/activations.h"
#include "novaphy/math/philox.h"
#include "novaphy/nova/functions.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/networks.h"
#include "novaphy/nova/registry.h"
#include "ops_impl.h"

namespace nova {

using detail::check_f32;
using novaphy::require;

namespace {

template <class F>
Kernel activation(const char* name, F f) {
  return with_one_gradient_set(
      make_kernel(name, {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                  [f](TraceContext& c) { return std::vector<Real>{f(c.f32(0))}; }));
}
const Kernel& relu_kernel() {
  static const Kernel kernel =
      activation("relu", [](const Real& x) { return novaphy::math::relu(x); });
  return kernel;
}
const Kernel& softplus_kernel() {
  static const Kernel kernel =
      activation("softplus", [](const Real& x) { return novaphy::math::softplus(x); });
  return kernel;
}

Tensor apply(const Kernel& kernel, const Tensor& x) {
  check_f32(x, {kernel.name().c_str(), "x"});
  const Tensor out(x.shape(), DType::F32, x.device());
  const Operand in = x.flat_operand(), to = out.flat_operand();
  kernel.launch(x.size(), in, to);
  return out;
}

// Returns the random words of a value's counter. Parameters: width, both halves of the seed,
// stream, first world.
novaphy::math::Philox<Int> words_of(TraceContext& c, const Int& column) {
  const Int world = c.index() / c.param_i32(0) + c.param_i32(4);
  return novaphy::math::philox4x32_10<Int>(
      {{shift_right_unsigned(column, Int(2)), world, c.i32(0), c.param_i32(3)}}, c.param_i32(1),
      c.param_i32(2));
}
// Returns (the upper 24 bits of a word + `more`) / 2^24.
Real fraction(const Int& word, int32_t more) {
  return to_real(shift_right_unsigned(word, Int(8)) + Int(more)) * Real(0x1p-24f);
}

template <class F>
Kernel random_kernel(const char* name, F f) {
  return make_kernel(name, {{"step", DType::I32, 1, Access::Uniform}}, {{"out", 1}},
                     [f](TraceContext& c) {
                       const Int column = c.index() % c.param_i32(0);
                       return std::vector<Real>{f(words_of(c, column), column & Int(3))};
                     });
}
const Kernel& uniform_kernel() {
  static const Kernel kernel =
      random_kernel("random_uniform", [](const novaphy::math::Philox<Int>& x, const Int& lane) {
        const Bool second = (lane & Int(1)) != Int(0);
        const Int low = select(second, x.word[1], x.word[0]);
        const Int high = select(second, x.word[3], x.word[2]);
        return fraction(select(lane < Int(2), low, high), 0);
      });
  return kernel;
}
const Kernel& normal_kernel() {
  static const Kernel kernel =
      random_kernel("random_normal", [](const novaphy::math::Philox<Int>& x, const Int& lane) {
        const Bool first = lane < Int(2);
        const Real u = fraction(select(first, x.word[0], x.word[2]), 1);  // in (0, 1]
        const Real turn = fraction(select(first, x.word[1], x.word[3]), 0);
        const Real angle = turn * Real(6.28318531f), radius = sqrt(Real(-2.0f) * log(u));
        return radius * select((lane & Int(1)) == Int(0), cos(angle), sin(angle));
      });
  return kernel;
}

Tensor draw(const Kernel& kernel, int64_t worlds, int64_t width, const RandomKey& key,
            const Tensor& step) {
  const char* call = kernel.name().c_str();
  require(worlds >= 0 && width > 0, ErrorKind::Value, call,
          ", shape: expected {worlds, width} with "
          "width > 0, got ",
          shape_str({worlds, width}));
  require(step.defined() && step.dtype() == DType::I32, ErrorKind::Type, call,
          ", step: expected an int32 tensor");
  require(step.size() == 1, ErrorKind::Value, call, ", step: expected {1}, got ",
          shape_str(step.shape()));
  const int64_t last = int64_t{key.first_world} + worlds;
  require(key.first_world >= 0 && last <= std::numeric_limits<int32_t>::max(), ErrorKind::Value,
          call, ", first_world: expected worlds from 0 to 2^31 - 1, got ", key.first_world);
  const Tensor out({worlds, width}, DType::F32, step.device());
  detail::int_param(call, out.size());
  const Param params[] = {detail::int_param(call, width), static_cast<int32_t>(key.seed),
                          static_cast<int32_t>(key.seed >> 32), key.stream, key.first_world};
  const Operand in = step.flat_operand(), to = out.flat_operand();
  kernel.launch(out.size(), in, to, {.params = params});
  return out;
}

}  // namespace

void detail::add_network_kernels(EngineKernels& list) {
  for (const Kernel& k : {relu_kernel(), softplus_kernel()}) list.push_back({k, k.gradients()});
  for (const Kernel& k : {uniform_kernel(), normal_kernel()}) list.push_back({k, {}});
}

Tensor relu(const Tensor& x) { return apply(relu_kernel(), x); }
Tensor softplus(const Tensor& x) { return apply(softplus_kernel(), x); }

Tensor random_uniform(int64_t worlds, int64_t width, const RandomKey& key, const Tensor& step) {
  return draw(uniform_kernel(), worlds, width, key, step);
}
Tensor random_normal(int64_t worlds, int64_t width, const RandomKey& key, const Tensor& step) {
  return draw(normal_kernel(), worlds, width, key, step);
}

std::array<uint32_t, 4> philox4x32(const std::array<uint32_t, 4>& counter,
                                   const std::array<uint32_t, 2>& key) {
  using novaphy::math::philox_word;
  const auto x = novaphy::math::philox4x32_10<novaphy::math::PhiloxWord>(
      {{philox_word(counter[0]), philox_word(counter[1]), philox_word(counter[2]),
        philox_word(counter[3])}},
      philox_word(key[0]), philox_word(key[1]));
  return {x.word[0].bits, x.word[1].bits, x.word[2].bits, x.word[3].bits};
}

}  // namespace nova
