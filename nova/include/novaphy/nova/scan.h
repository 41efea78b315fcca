// scan: a loop over steps as one operation of a tape. The body is recorded once and launched n
// times, so the work of recording does not depend on n.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "novaphy/nova/tensor.h"

namespace nova {

struct ScanResult {
  std::vector<Tensor> carry;  // after the last step
  std::vector<Tensor> ys;     // row k is the result of step k
};

// Maps the carry before a step, and row k of each of `xs`, to the carry after the step and results
// of the step. The function is called once. The tensors that it gets are memory that every step
// writes anew.
using ScanFn =
    std::function<ScanResult(const std::vector<Tensor>& carry, const std::vector<Tensor>& x)>;

// Runs carry, y_k = body(carry, row k of xs) for k = 0, 1, ..., n - 1, where n is `length` or the
// leading dimension of xs. An active tape records one operation. The backward pass computes each
// step once more, and keeps the carry before each step. The bits are those of the loop without a
// scan. The body may contain a scan.
//
// Row k of a tensor {n, a, b} is {a, b}, and row k of a tensor {n} is {1}. Results ys have one
// leading dimension more than those of a step.
//
// carry: float32. xs: any type. All memory is on one device.
// ErrorKind::Value: n < 0 or not given, xs of different lengths, a carry that changes its shape, a
// body that writes to its arguments, or, on a tape, to a value that it has read. ErrorKind::Type: a
// carry that is not float32. ErrorKind::Runtime: the body reads values on the host, or an index
// table changes from step to step. ErrorKind::NotImplemented: on a tape, a body with a rollout that
// reports on its gradients, or with a custom operation without `forward`.
NOVAPHY_NOVA_API ScanResult scan(const ScanFn& body, const std::vector<Tensor>& carry,
                                 const std::vector<Tensor>& xs = {},
                                 std::optional<int64_t> length = {});

}  // namespace nova
