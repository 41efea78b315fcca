#include "novaphy/nova/tensor.h"

#include <limits>
#include <mutex>

#include "engine_kernels.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"
#include "novaphy/nova/kernel.h"
#include "novaphy/nova/op_list.h"
#include "novaphy/nova/tape.h"

namespace nova {

using novaphy::fail;
using novaphy::require;
using novaphy::Storage;

const char* dtype_name(DType dtype) {
  return dtype == DType::F32 ? "float32" : dtype == DType::I32 ? "int32" : "uint8";
}
size_t dtype_bytes(DType dtype) { return dtype == DType::U8 ? 1 : 4; }

std::string shape_str(const Shape& shape) {
  std::string s = "{";
  for (size_t k = 0; k < shape.size(); ++k) s += (k ? ", " : "") + std::to_string(shape[k]);
  return s + "}";
}

namespace {

// Dimensions of 0 do not count for the size limit, so the other dimensions of an empty tensor may
// have any size.
int64_t scalar_count(const Shape& shape) {
  // the number of bytes must fit too
  constexpr int64_t kMost = std::numeric_limits<int64_t>::max() / 8;
  int64_t n = 1;
  bool empty = false;
  for (int64_t d : shape) {
    if (d < 0) fail(ErrorKind::Value, "shape: expected dimensions >= 0, got ", shape_str(shape));
    empty = empty || d == 0;
    if (d != 0 && (__builtin_mul_overflow(n, d, &n) || n > kMost))
      fail(ErrorKind::Value, "shape: ", shape_str(shape), " is too large");
  }
  return empty ? 0 : n;
}

void host_read(const char* what) {
  if (auto* observer = novaphy::array_observer()) observer->host_read(what);
}

// Attachments are made under this lock, and read without a lock afterwards.
std::mutex& attachment_mutex() {
  static std::mutex mutex;
  return mutex;
}

}  // namespace

GradInfo& grad_info(Range& range) {
  if (!range.attachment) {
    std::lock_guard lock(attachment_mutex());
    if (!range.attachment) range.attachment = std::make_shared<GradInfo>();
  }
  return *static_cast<GradInfo*>(range.attachment.get());
}

const std::shared_ptr<Range>& grad_storage(Range& range) {
  GradInfo& info = grad_info(range);
  // A captured operation will fill the gradient. Until then the gradient is zero.
  if (!info.grad)
    info.grad =
        Storage::allocate(range.bytes(), range.storage().device(), current_capture() != nullptr)
            ->range();
  return info.grad;
}

Operand operand_of(const novaphy::Array& array) {
  const novaphy::DTypeInfo& info = novaphy::dtype_info(array.dtype());
  const bool is_float = info.scalar == novaphy::Scalar::F32;
  require(is_float || info.scalar == novaphy::Scalar::I32, ErrorKind::Type,
          "array: kernels read float32 and int32 scalars, got ", info.name);
  Operand o{array.range(), static_cast<int64_t>(array.rows()),
            static_cast<int32_t>(array.width()) * info.scalars,
            is_float ? ir::Type::F32 : ir::Type::I32};
  if (!o.range) o.range = Storage::allocate(0, array.device())->range();
  return o;
}

Tensor::Tensor(Shape shape, DType dtype, Device device) : impl_(std::make_shared<TensorImpl>()) {
  const auto bytes = static_cast<size_t>(scalar_count(shape)) * dtype_bytes(dtype);
  impl_->range = Storage::allocate(bytes, device)->range();
  impl_->shape = std::move(shape);
  impl_->dtype = dtype;
}

Tensor::Tensor(std::shared_ptr<Range> range, Shape shape, DType dtype)
    : impl_(std::make_shared<TensorImpl>()) {
  if (static_cast<size_t>(scalar_count(shape)) * dtype_bytes(dtype) != range->bytes()) [[unlikely]]
    fail(ErrorKind::Value, "shape: ", shape_str(shape), " of ", dtype_name(dtype),
         " does not fill ", range->bytes(), " bytes");
  impl_->range = std::move(range);
  impl_->shape = std::move(shape);
  impl_->dtype = dtype;
}

Tensor Tensor::from_host(std::span<const float> values, Shape shape, Device device) {
  Tensor t(std::move(shape), DType::F32, device);
  const novaphy::UntrackedScope unobserved;
  t.copy_from_host(values.data(), values.size_bytes());
  return t;
}
Tensor Tensor::from_host(std::span<const int32_t> values, Shape shape, Device device) {
  Tensor t(std::move(shape), DType::I32, device);
  const novaphy::UntrackedScope unobserved;
  t.copy_from_host(values.data(), values.size_bytes());
  return t;
}
Tensor Tensor::full(Shape shape, float value, Device device) {
  Tensor t(std::move(shape), DType::F32, device);
  t.fill_(value);
  return t;
}

Tensor Tensor::view(const novaphy::Array& array, bool requires_grad) {
  array.require_writable("tensor view");  // a tensor can be written
  const novaphy::DTypeInfo& info = novaphy::dtype_info(array.dtype());
  require(info.scalar != novaphy::Scalar::U32 && info.scalar != novaphy::Scalar::U64,
          ErrorKind::Type, "array: expected float32, int32 or uint8 scalars, got ", info.name);
  const DType dtype = info.scalar == novaphy::Scalar::F32   ? DType::F32
                      : info.scalar == novaphy::Scalar::I32 ? DType::I32
                                                            : DType::U8;
  std::shared_ptr<Range> range = array.range();
  if (!range) range = Storage::allocate(0, array.device())->range();
  GradInfo& grad = grad_info(*range);
  Shape shape = array.shape();
  auto impl = grad.view.lock();
  if (!impl || impl->shape != shape || impl->dtype != dtype) {
    impl = Tensor(range, std::move(shape), dtype).impl_;
    grad.view = impl;
  }
  Tensor tensor(impl);
  if (requires_grad) tensor.set_requires_grad(true);
  return tensor;
}

Tensor Tensor::external(void* data, Shape shape, DType dtype, Device device,
                        std::shared_ptr<void> owner) {
  const auto bytes = static_cast<size_t>(scalar_count(shape)) * dtype_bytes(dtype);
  require(data != nullptr || bytes == 0, ErrorKind::Value, "data: expected a pointer, got null");
  return {Storage::external(data, bytes, device, std::move(owner))->range(), std::move(shape),
          dtype};
}

int64_t Tensor::size() const {
  int64_t n = 1;
  for (int64_t d : impl_->shape) n *= d;
  return n;
}
int32_t Tensor::row_width() const {
  int64_t w = 1;
  for (size_t k = 1; k < impl_->shape.size(); ++k) w *= impl_->shape[k];
  if (w > std::numeric_limits<int32_t>::max()) [[unlikely]]
    fail(ErrorKind::Value, "tensor: expected rows of less than 2^31 values, got shape ",
         shape_str(impl_->shape));
  return static_cast<int32_t>(w);
}
Device Tensor::device() const { return impl_->range->storage().device(); }
bool Tensor::is_external() const { return impl_->range->storage().is_external(); }
Operand Tensor::operand() const {
  Operand o = flat_operand();
  o.rows = rows();
  o.width = row_width();
  return o;
}
Operand Tensor::flat_operand() const {
  require(dtype() != DType::U8, ErrorKind::Type,
          "tensor: kernels read float32 and int32, got uint8");
  return {impl_->range, size(), 1, dtype() == DType::F32 ? ir::Type::F32 : ir::Type::I32};
}

bool Tensor::requires_grad() const {
  const GradInfo* info = find_grad_info(*impl_->range);
  return info && info->requires_grad;
}
void Tensor::set_requires_grad(bool on) const {
  require(!on || dtype() == DType::F32, ErrorKind::Value,
          "requires_grad: only float32 tensors have gradients, this is ", dtype_name(dtype()));
  grad_info(*impl_->range).requires_grad = on;
}
bool Tensor::has_grad() const {
  const GradInfo* info = find_grad_info(*impl_->range);
  return info && (info->grad || info->state == GradState::Dropped);
}
Tensor Tensor::grad() const {
  require(dtype() == DType::F32, ErrorKind::Value,
          "grad: only float32 tensors have gradients, this is ", dtype_name(dtype()));
  GradInfo& info = grad_info(*impl_->range);
  require(info.state != GradState::Dropped, ErrorKind::Runtime,
          "grad: it was not kept; the tape that computed it keeps the gradients of leaves only");
  const std::shared_ptr<Range>& storage = grad_storage(*impl_->range);
  if (info.state == GradState::Zero) {
    submit_fill(storage, 0.0f);
    info.state = GradState::Held;
    if (OpList* graph = current_capture()) graph->gradient(impl_->range, info.state);
  }
  return {storage, impl_->shape, DType::F32};
}
void Tensor::zero_grad() const {
  GradInfo& info = grad_info(*impl_->range);
  if (info.grad) submit_fill(info.grad, 0.0f);
  info.state = GradState::Zero;
  if (OpList* graph = current_capture()) {
    info.zeroed_in_capture = graph->id();
    graph->gradient(impl_->range, info.state);
  }
}
bool Tensor::is_leaf() const {
  const GradInfo* info = find_grad_info(*impl_->range);
  return !info || info->producers == 0;
}

std::vector<float> Tensor::to_host() const {
  require(dtype() == DType::F32, ErrorKind::Type, "tensor: expected float32, got ",
          dtype_name(dtype()));
  std::vector<float> values(static_cast<size_t>(size()));
  novaphy::Array(novaphy::DType::float32, values.size(), 1, impl_->range)
      .copy_to_host(values.data(), bytes());
  return values;
}
std::vector<int32_t> Tensor::to_host_i32() const {
  require(dtype() == DType::I32, ErrorKind::Type, "tensor: expected int32, got ",
          dtype_name(dtype()));
  std::vector<int32_t> values(static_cast<size_t>(size()));
  novaphy::Array(novaphy::DType::int32, values.size(), 1, impl_->range)
      .copy_to_host(values.data(), bytes());
  return values;
}
float Tensor::item() const {
  require(size() == 1, ErrorKind::Value, "item: expected one value, got shape ",
          shape_str(shape()));
  return to_host()[0];
}
void Tensor::copy_from_host(const void* source, size_t count) const {
  const novaphy::DType as = dtype() == DType::F32   ? novaphy::DType::float32
                            : dtype() == DType::I32 ? novaphy::DType::int32
                                                    : novaphy::DType::uint8;
  novaphy::Array(as, static_cast<size_t>(size()), 1, impl_->range).copy_from_host(source, count);
}

Tensor Tensor::reshape(Shape shape) const {
  require(scalar_count(shape) == size(), ErrorKind::Value, "reshape: ", shape_str(impl_->shape),
          " has ", size(), " values, ", shape_str(shape), " asks for another number");
  return {impl_->range, std::move(shape), dtype()};
}

Tensor Tensor::clone() const {
  Tensor copy(shape(), dtype(), device());
  copy.copy_(*this);
  return copy;
}
Tensor Tensor::detach() const {
  NoGrad no_grad;
  return clone();
}

namespace {
const Kernel& copy_kernel(DType dtype) {
  static const Kernel f32 = with_one_gradient_set(
      make_kernel("copy", {{"x", DType::F32, 1, Access::Direct}}, {{"out", 1}},
                  [](TraceContext& c) { return std::vector{c.f32(0)}; }));
  require(dtype == DType::F32, ErrorKind::Type, "copy: expected float32");
  return f32;
}
}  // namespace

void detail::add_tensor_kernels(EngineKernels& list) {
  const Kernel& kernel = copy_kernel(DType::F32);
  list.push_back({kernel, kernel.gradients()});
}

void Tensor::copy_(const Tensor& source) const {
  if (source.size() != size() || source.dtype() != dtype())
    fail(ErrorKind::Value, "copy_: expected ", shape_str(shape()), " ", dtype_name(dtype()),
         ", got ", shape_str(source.shape()), " ", dtype_name(source.dtype()));
  if (source.impl_->range == impl_->range) return;
  if (dtype() == DType::F32 && source.device() == device()) {
    const Operand in = source.flat_operand(), out = flat_operand();
    copy_kernel(dtype()).launch(size(), in, out);
  } else if (source.device() == device()) {
    submit_copy(impl_->range, source.impl_->range);
  } else {
    host_read("copy between devices");
    std::vector<uint8_t> bytes_on_host(bytes());
    novaphy::Array(novaphy::DType::uint8, bytes(), 1, source.impl_->range)
        .copy_to_host(bytes_on_host.data(), bytes());
    copy_from_host(bytes_on_host.data(), bytes());
    if (Tape* tape = Tape::active(); tape != nullptr && dtype() == DType::F32)
      tape->record_custom(
          "copy between devices", {source}, {*this},
          [shape = source.shape(), from = source.device()](const std::vector<Tensor>& g) {
            return std::vector{g[0].to(from).reshape(shape)};
          });
  }
}

void Tensor::fill_(float value) const {
  require(dtype() == DType::F32, ErrorKind::Type, "fill_: expected float32, got ",
          dtype_name(dtype()));
  submit_fill(impl_->range, value);
}

Tensor Tensor::to(Device device) const {
  if (device == this->device()) return clone();
  Tensor copy(shape(), dtype(), device);
  copy.copy_(*this);
  return copy;
}

}  // namespace nova
