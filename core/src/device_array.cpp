#include "novaphy/core/device_array.h"

#include <cstring>
#include <limits>

#include "novaphy/core/backend.h"

namespace novaphy {
namespace {

constexpr DTypeInfo kDTypes[] = {
    {"float32", Scalar::F32, 0, {1, 1}, 1, 4},         {"int32", Scalar::I32, 0, {1, 1}, 1, 4},
    {"uint32", Scalar::U32, 0, {1, 1}, 1, 4},          {"uint8", Scalar::U8, 0, {1, 1}, 1, 1},
    {"uint64", Scalar::U64, 0, {1, 1}, 1, 8},          {"vec2", Scalar::F32, 1, {2, 1}, 2, 8},
    {"vec3", Scalar::F32, 1, {3, 1}, 3, 12},           {"vec4", Scalar::F32, 1, {4, 1}, 4, 16},
    {"quat", Scalar::F32, 1, {4, 1}, 4, 16},           {"transform", Scalar::F32, 1, {7, 1}, 7, 28},
    {"spatial_vector", Scalar::F32, 1, {6, 1}, 6, 24}, {"mat22", Scalar::F32, 2, {2, 2}, 4, 16},
    {"mat33", Scalar::F32, 2, {3, 3}, 9, 36},          {"vec2i", Scalar::I32, 1, {2, 1}, 2, 8},
    {"vec3i", Scalar::I32, 1, {3, 1}, 3, 12},          {"vec4i", Scalar::I32, 1, {4, 1}, 4, 16},
};
static_assert(sizeof(kDTypes) / sizeof(kDTypes[0]) == static_cast<size_t>(DType::vec4i) + 1);
static_assert(sizeof(Vec3f) == 12 && sizeof(Quatf) == 16 && sizeof(Transformf) == 28 &&
              sizeof(SpatialVectorf) == 24 && sizeof(Mat33f) == 36);

size_t checked_bytes(DType dtype, size_t rows, size_t width) {
  const size_t element = dtype_info(dtype).bytes;
  require(width >= 1, ErrorKind::Value, "array: width: expected at least 1, got 0");
  require(width == 1 || dtype == DType::float32 || dtype == DType::int32, ErrorKind::Value,
          "array: width: expected 1 for dtype ", dtype_info(dtype).name,
          " (only float32 and int32 have rows), got ", width);
  const size_t limit = std::numeric_limits<size_t>::max() / 4;
  require(width <= limit / element && rows <= limit / (element * width), ErrorKind::Value,
          "array: ", rows, " rows of ", width, " ", dtype_info(dtype).name, " are too large");
  return rows * width * element;
}

std::string describe(const Array& array) {
  return std::string(dtype_info(array.dtype()).name) + "[" + std::to_string(array.rows()) +
         (array.width() != 1 ? ", " + std::to_string(array.width()) : "") + "]";
}

void require_bytes(const Array& array, const char* what, size_t bytes) {
  require(bytes == array.bytes(), ErrorKind::Value, what, ": expected ", array.bytes(),
          " bytes for ", describe(array), ", got ", bytes);
}

void notify_write(Range& range, const char* what) {
  if (ArrayObserver* observer = array_observer()) observer->untracked_write(range, what);
}

void copy_bytes(const DeviceContext& context, novaphy_copy_kind kind, void* target,
                const void* source, size_t bytes, const char* what) {
  novaphy_error error = make_error();
  check(context.api->memory_copy(context.stream, kind, target, source, bytes, &error), error, what);
}

}  // namespace

const DTypeInfo& dtype_info(DType dtype) {
  const auto index = static_cast<size_t>(dtype);
  require(index < sizeof(kDTypes) / sizeof(kDTypes[0]), ErrorKind::Type, "dtype: unknown value ",
          index);
  return kDTypes[index];
}

size_t scalar_bytes(Scalar scalar) {
  switch (scalar) {
    case Scalar::U8:
      return 1;
    case Scalar::U64:
      return 8;
    case Scalar::F32:
    case Scalar::I32:
    case Scalar::U32:
      break;
  }
  return 4;
}

Array::Array(DType dtype, size_t rows, Device device, size_t width)
    : dtype_(dtype), rows_(rows), width_(width) {
  const size_t bytes = checked_bytes(dtype, rows, width);
  range_ = Storage::allocate(bytes, device)->range();
}

Array::Array(DType dtype, size_t rows, size_t width, std::shared_ptr<Range> range)
    : dtype_(dtype), rows_(rows), width_(width), range_(std::move(range)) {
  require(range_ != nullptr, ErrorKind::Value, "array: range: expected a range, got null");
  const size_t bytes = checked_bytes(dtype, rows, width);
  require(range_->bytes() == bytes, ErrorKind::Value, "array: range: expected ", bytes,
          " bytes for ", describe(*this), ", got ", range_->bytes());
}

Device Array::device() const { return range_ ? range_->storage().device() : Device::cpu(); }

std::vector<int64_t> Array::shape() const {
  std::vector<int64_t> result = {static_cast<int64_t>(rows_)};
  if (width_ != 1) result.push_back(static_cast<int64_t>(width_));
  const DTypeInfo& info = dtype_info(dtype_);
  for (int d = 0; d < info.ndim; ++d) result.push_back(info.shape[d]);
  return result;
}

void* Array::raw_mutable() {
  if (!range_) return nullptr;
  require_writable("mutable data");
  notify_write(*range_, "mutable data");
  range_->mark_written();
  return range_->data();
}

void Array::copy_from_host(const void* source, size_t bytes) {
  require_bytes(*this, "copy_from_host", bytes);
  if (bytes == 0) return;
  require_writable("copy_from_host");
  notify_write(*range_, "copy_from_host");
  copy_bytes(device_context(device()), NOVAPHY_COPY_HOST_TO_DEVICE, range_->data(), source, bytes,
             "copy_from_host");
  range_->mark_written();
}

void Array::copy_to_host(void* target, size_t bytes) const {
  require_bytes(*this, "copy_to_host", bytes);
  if (bytes == 0) return;
  if (ArrayObserver* observer = array_observer()) observer->host_read("copy_to_host");
  copy_bytes(device_context(device()), NOVAPHY_COPY_DEVICE_TO_HOST, target, range_->data(), bytes,
             "copy_to_host");
}

void Array::zero() {
  if (bytes() == 0) return;
  require_writable("zero");
  notify_write(*range_, "zero");
  const DeviceContext& context = device_context(device());
  novaphy_error error = make_error();
  check(context.api->memory_fill(context.stream, range_->data(), 0, 1, bytes(), &error), error,
        "zero");
  range_->mark_written();
}

void Array::fill_bytes(const void* element, size_t element_bytes) {
  const size_t expected = dtype_info(dtype_).bytes;
  require(element_bytes == expected, ErrorKind::Value, "fill: expected an element of ", expected,
          " bytes, got ", element_bytes);
  if (bytes() == 0) return;
  require_writable("fill");
  notify_write(*range_, "fill");
  const DeviceContext& context = device_context(device());
  if (element_bytes <= 8 && (element_bytes & (element_bytes - 1)) == 0) {
    uint64_t pattern = 0;
    std::memcpy(&pattern, element, element_bytes);
    novaphy_error error = make_error();
    check(context.api->memory_fill(context.stream, range_->data(), pattern,
                                   static_cast<uint32_t>(element_bytes), bytes(), &error),
          error, "fill");
  } else {
    std::vector<unsigned char> host(bytes());
    for (size_t at = 0; at < host.size(); at += element_bytes)
      std::memcpy(&host[at], element, element_bytes);
    copy_bytes(context, NOVAPHY_COPY_HOST_TO_DEVICE, range_->data(), host.data(), host.size(),
               "fill");
  }
  range_->mark_written();
}

void Array::assign(const Array& source) {
  require(source.dtype_ == dtype_ && source.rows_ == rows_ && source.width_ == width_,
          ErrorKind::Value, "assign: expected ", describe(*this), ", got ", describe(source));
  if (bytes() == 0 || source.range_ == range_) return;
  require_writable("assign");
  require(!range_->overlaps(*source.range_), ErrorKind::Value,
          "assign: source overlaps the target");
  if (source.device() != device()) {
    std::vector<unsigned char> host(bytes());
    source.copy_to_host(host.data(), host.size());
    copy_from_host(host.data(), host.size());
    return;
  }
  ArrayObserver* observer = array_observer();
  const bool is_float = dtype_info(dtype_).scalar == Scalar::F32;
  if (observer != nullptr && observer->copy(range_, source.range_, is_float)) return;
  copy_bytes(device_context(device()), NOVAPHY_COPY_DEVICE_TO_DEVICE, range_->data(),
             source.range_->data(), bytes(), "assign");
  range_->mark_written();
}

Array Array::read_only(const char* reason) const {
  Array handle = *this;
  handle.read_only_ = reason;
  return handle;
}

void Array::require_writable(const char* what) const {
  if (read_only_ != nullptr && bytes() != 0) [[unlikely]]
    fail(ErrorKind::Runtime, what, ": ", read_only_);
}

Array Array::clone() const { return to(device()); }

Array Array::to(Device device) const {
  if (!range_ && rows_ == 0) {
    Array empty;
    empty.dtype_ = dtype_;
    if (device.is_cpu()) return empty;
  }
  Array result(dtype_, rows_, device, width_);
  result.assign(*this);
  return result;
}

}  // namespace novaphy
