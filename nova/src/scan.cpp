#include "novaphy/nova/scan.h"

#include <memory>

#include "novaphy/core/error.h"
#include "scan_body.h"

namespace nova {

using novaphy::fail;
using novaphy::require;

namespace {

void check_arguments(const std::vector<Tensor>& carry, const std::vector<Tensor>& xs) {
  for (size_t k = 0; k < carry.size(); ++k) {
    require(carry[k].defined(), ErrorKind::Value, "scan, carry ", k, ": the tensor is undefined");
    require(carry[k].dtype() == DType::F32, ErrorKind::Type, "scan, carry ", k,
            ": expected float32, got ", dtype_name(carry[k].dtype()));
  }
  const Tensor* first = carry.empty() ? nullptr : carry.data();
  for (size_t k = 0; k < xs.size(); ++k) {
    require(xs[k].defined() && !xs[k].shape().empty(), ErrorKind::Value, "scan, xs ", k,
            ": expected a tensor {n, ...}");
    if (!first) first = xs.data();
  }
  const auto check_device = [&](const std::vector<Tensor>& list, const char* name) {
    for (size_t k = 0; k < list.size(); ++k)
      if (list[k].device() != first->device())
        fail(ErrorKind::Value, "scan, ", name, " ", k, ": expected device ", first->device().str(),
             ", got ", list[k].device().str());
  };
  check_device(carry, "carry");
  check_device(xs, "xs");
}

int64_t steps_of(const std::vector<Tensor>& xs, std::optional<int64_t> length) {
  require(length.has_value() || !xs.empty(), ErrorKind::Value,
          "scan, length: expected the number of steps, because xs is not given");
  const int64_t n = length ? *length : xs[0].dim(0);
  require(n >= 0, ErrorKind::Value, "scan, length: expected >= 0, got ", n);
  for (size_t k = 0; k < xs.size(); ++k)
    require(xs[k].dim(0) == n, ErrorKind::Value, "scan, xs ", k, ": expected ", n,
            " rows, one per step, got shape ", shape_str(xs[k].shape()));
  return n;
}

}  // namespace

ScanResult scan(const ScanFn& body, const std::vector<Tensor>& carry, const std::vector<Tensor>& xs,
                std::optional<int64_t> length) {
  require(static_cast<bool>(body), ErrorKind::Value, "scan, body: expected a function");
  check_arguments(carry, xs);
  const int64_t n = steps_of(xs, length);
  return std::make_shared<Tape::ScanBody>(body, carry, xs, n)->run();
}

}  // namespace nova
