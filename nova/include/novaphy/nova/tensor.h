// Tensor: a typed view of a byte range, with a gradient. Version, alias check and gradient belong
// to the range, so all views of the same bytes share them. A view of an engine array copies
// nothing.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "novaphy/core/device_array.h"
#include "novaphy/nova/export.h"
#include "novaphy/program/ir.h"

namespace nova {

using novaphy::Device;
using novaphy::ErrorKind;
using novaphy::Range;

enum class DType : uint8_t { F32, I32, U8 };
NOVAPHY_NOVA_API const char* dtype_name(DType dtype);  // "float32", "int32", "uint8"
NOVAPHY_NOVA_API size_t dtype_bytes(DType dtype);

using Shape = std::vector<int64_t>;
NOVAPHY_NOVA_API std::string shape_str(const Shape& shape);  // "{27, 3}"

// The memory that a launch reads or writes: a range viewed as packed rows.
struct Operand {
  std::shared_ptr<Range> range;
  int64_t rows = 0;
  int32_t width = 1;
  ir::Type type = ir::Type::F32;
};

struct TensorImpl {
  std::shared_ptr<Range> range;
  Shape shape;
  DType dtype = DType::F32;
};

// Views an engine array as kernels read it: float32 or int32 rows of `width` scalars.
NOVAPHY_NOVA_API Operand operand_of(const novaphy::Array& array);

class NOVAPHY_NOVA_API Tensor {
 public:
  Tensor() = default;  // undefined
  // Makes packed rows of `shape`, filled with zeros.
  explicit Tensor(Shape shape, DType dtype = DType::F32, Device device = novaphy::default_device());
  Tensor(std::shared_ptr<Range> range, Shape shape, DType dtype);
  explicit Tensor(std::shared_ptr<TensorImpl> impl)
      : impl_(std::move(impl)) {}  // the same tensor, from its impl()
  static Tensor from_host(std::span<const float> values, Shape shape,
                          Device device = novaphy::default_device());
  static Tensor from_host(std::span<const int32_t> values, Shape shape,
                          Device device = novaphy::default_device());
  static Tensor full(Shape shape, float value, Device device = novaphy::default_device());
  // Views an engine array without a copy; vec3 rows give {n, 3}. While a view of an array exists,
  // another call for the array returns the same Tensor. requires_grad = true switches the gradient
  // on; false leaves it unchanged.
  static Tensor view(const novaphy::Array& array, bool requires_grad = false);
  // Wraps external memory, which `owner` keeps alive.
  static Tensor external(void* data, Shape shape, DType dtype, Device device,
                         std::shared_ptr<void> owner);

  bool defined() const { return impl_ != nullptr; }
  const Shape& shape() const { return impl_->shape; }
  int64_t dim(size_t k) const { return impl_->shape[k]; }
  size_t ndim() const { return impl_->shape.size(); }
  int64_t size() const;  // number of scalars
  int64_t rows() const { return impl_->shape.empty() ? 1 : impl_->shape[0]; }
  int32_t row_width() const;  // scalars per row; ErrorKind::Value for 2^31 and above
  DType dtype() const { return impl_->dtype; }
  Device device() const;
  size_t bytes() const { return static_cast<size_t>(size()) * dtype_bytes(dtype()); }
  uint64_t version() const { return impl_->range->version(); }
  const std::shared_ptr<Range>& range() const { return impl_->range; }
  const std::shared_ptr<TensorImpl>& impl() const { return impl_; }
  bool is_external() const;
  Operand operand() const;       // rows x row_width
  Operand flat_operand() const;  // size x 1

  bool requires_grad() const;
  void set_requires_grad(bool on) const;  // float32 only
  bool has_grad() const;                  // whether a gradient was computed or requested
  Tensor grad() const;                    // made and filled with zeros if missing
  void zero_grad() const;
  bool is_leaf() const;  // whether no operation of a living tape writes it

  template <class T>
  const T* data() const {
    return static_cast<const T*>(impl_->range->data());
  }
  std::vector<float> to_host() const;  // float32 only
  std::vector<int32_t> to_host_i32() const;
  float item() const;  // the value of a float32 tensor of size 1
  void copy_from_host(const void* source, size_t bytes) const;

  Tensor reshape(Shape shape) const;  // a view of the same bytes
  Tensor detach() const;  // a view of the same bytes; operations that read it are not recorded
  Tensor clone() const;   // recorded on an active tape
  void copy_(const Tensor& source) const;  // recorded on an active tape
  void fill_(float value) const;
  Tensor to(Device device) const;

 private:
  std::shared_ptr<TensorImpl> impl_;
};

struct IncidenceData;

// The state of the gradient that the runtime attaches to a range.
enum class GradState : uint8_t {
  Zero,     // zero, whatever the bytes are
  Held,     // the value of the bytes
  Dropped,  // computed but not kept (KeepGradients::Leaves)
};
struct GradInfo {
  bool requires_grad = false;
  std::shared_ptr<Range> grad;  // same layout as the range; null until it is needed
  GradState state = GradState::Zero;
  uint64_t zeroed_in_capture = 0;   // id of the capture that zeroed it last
  int32_t producers = 0;            // number of recorded operations of living tapes that write it
  const void* last_tape = nullptr;  // the living tape that recorded the last of these writes
  uint64_t recorded_version = 0;    // version after that write
  std::weak_ptr<TensorImpl> view;   // the canonical view of an engine array
  std::vector<std::shared_ptr<const IncidenceData>>
      incidences;  // cache of an index table, see cached_incidence
};
NOVAPHY_NOVA_API GradInfo& grad_info(Range& range);  // made on demand
inline GradInfo* find_grad_info(const Range& range) {
  return static_cast<GradInfo*>(range.attachment.get());
}
// Returns the range of the gradient, allocated at its first use. The contents are unchanged.
NOVAPHY_NOVA_API const std::shared_ptr<Range>& grad_storage(Range& range);

}  // namespace nova
