// A kernel of one's own, and its gradient: the energy of springs of different stiffness.
#include <cmath>
#include <iostream>
#include <string>

#include "novaphy/nova/kernel.h"
#include "novaphy/nova/ops.h"
#include "novaphy/nova/tape.h"

int main() {
  using nova::Access, nova::DType, nova::Real, nova::Tensor;
  const nova::Kernel energy = nova::make_indexed_expr_kernel_typed_access_n(
      "spring_energy",
      {{"x", DType::F32, 1, Access::Direct}, {"stiffness", DType::F32, 1, Access::Direct}}, 1,
      [](nova::TraceContext& c) {
        const Real x = c.f32(0), k = c.f32(1);
        return std::vector<Real>{Real(0.5f) * k * x * x};
      });

  const float x[] = {0.1f, -0.2f, 0.3f}, stiffness[] = {100.0f, 200.0f, 300.0f};
  const Tensor position = Tensor::from_host(x, {3}), k = Tensor::from_host(stiffness, {3});
  position.set_requires_grad(true);

  nova::Tape tape;
  const nova::TapeScope scope(tape);
  const Tensor total = nova::sum(energy(3, {position, k})[0]);
  tape.backward(total);

  bool ok = true;
  const std::vector<float> gradient = position.grad().to_host();
  for (int i = 0; i < 3; ++i) {
    std::cout << "dE/dx[" << i << "] = " << gradient[i] << "\n";
    ok = ok && std::fabs(gradient[i] - stiffness[i] * x[i]) < 1e-4f;
  }
  // The Program of a kernel is for users to read, too.
  ok = ok && nova::ir::to_string(energy.program()).find("spring_energy") != std::string::npos &&
       nova::ir::hash(energy.program()) == energy.hash();
  return ok ? 0 : 1;
}
