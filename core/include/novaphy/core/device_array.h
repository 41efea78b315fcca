// DeviceArray<T>: rows of T on a device. An array is a shared handle: copying the handle shares the
// memory, and clone() copies the values.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "novaphy/core/device.h"
#include "novaphy/core/error.h"
#include "novaphy/core/export.h"
#include "novaphy/core/storage.h"
#include "novaphy/math/types.h"

namespace novaphy {

enum class Scalar : uint8_t { F32, I32, U32, U8, U64 };

// The type of one element of an array. Vector and matrix elements are tightly packed scalars.
enum class DType : uint8_t {
  float32,
  int32,
  uint32,
  uint8,
  uint64,
  vec2,
  vec3,
  vec4,
  quat,
  transform,
  spatial_vector,
  mat22,
  mat33,
  vec2i,
  vec3i,
  vec4i,
};

struct DTypeInfo {
  const char* name;
  Scalar scalar;
  int ndim;      // 0 scalar, 1 vector, 2 matrix
  int shape[2];  // of one element
  int scalars;   // per element
  size_t bytes;  // per element
};
NOVAPHY_CORE_API const DTypeInfo& dtype_info(DType dtype);
NOVAPHY_CORE_API size_t scalar_bytes(Scalar scalar);

template <class T>
struct DTypeOf;
#define NOVAPHY_DTYPE_OF(T, D)               \
  template <>                                \
  struct DTypeOf<T> {                        \
    static constexpr DType value = DType::D; \
  };
NOVAPHY_DTYPE_OF(float, float32)
NOVAPHY_DTYPE_OF(int32_t, int32)
NOVAPHY_DTYPE_OF(uint32_t, uint32) NOVAPHY_DTYPE_OF(uint8_t, uint8)
    NOVAPHY_DTYPE_OF(uint64_t, uint64) NOVAPHY_DTYPE_OF(Vec2f, vec2) NOVAPHY_DTYPE_OF(Vec3f, vec3)
        NOVAPHY_DTYPE_OF(Vec4f, vec4) NOVAPHY_DTYPE_OF(Quatf, quat)
            NOVAPHY_DTYPE_OF(Transformf, transform) NOVAPHY_DTYPE_OF(SpatialVectorf, spatial_vector)
                NOVAPHY_DTYPE_OF(Mat22f, mat22) NOVAPHY_DTYPE_OF(Mat33f, mat33)
                    NOVAPHY_DTYPE_OF(Vec2i, vec2i) NOVAPHY_DTYPE_OF(Vec3i, vec3i)
                        NOVAPHY_DTYPE_OF(Vec4i, vec4i)
#undef NOVAPHY_DTYPE_OF

    // The type-erased base of DeviceArray<T>: everything that does not depend on T.
    class NOVAPHY_CORE_API Array {
 public:
  Array() = default;  // 0 rows of float32 on the CPU, no storage
  // Makes an array filled with zeros. A `width` above 1 makes a row table {rows, width}, for
  // float32 and int32 only.
  Array(DType dtype, size_t rows, Device device, size_t width = 1);
  // Makes a view of existing bytes: `range` must hold exactly rows * width elements.
  Array(DType dtype, size_t rows, size_t width, std::shared_ptr<Range> range);

  DType dtype() const { return dtype_; }
  size_t rows() const { return rows_; }
  size_t size() const { return rows_; }
  size_t width() const { return width_; }
  size_t bytes() const { return rows_ * width_ * dtype_info(dtype_).bytes; }
  Device device() const;
  uint64_t version() const { return range_ ? range_->version() : 0; }
  const std::shared_ptr<Range>& range() const { return range_; }
  std::vector<int64_t> shape() const;  // the shape in NumPy: vec3 is {rows, 3}, mat33 is {rows, 3,
                                       // 3}

  const void* raw() const { return range_ ? range_->data() : nullptr; }
  void* raw_mutable();  // counts as a write: raises the range's version

  // Copies between host and device. `bytes` must equal the size of the array (ErrorKind::Value).
  void copy_from_host(const void* source, size_t bytes);
  void copy_to_host(void* target, size_t bytes) const;
  void zero();
  void fill_bytes(const void* element, size_t element_bytes);  // fills with copies of one element
  // Copies the values of an array of the same dtype, rows and width (ErrorKind::Value otherwise). A
  // copy from another device goes through the host.
  void assign(const Array& source);
  Array clone() const;
  Array to(Device device) const;  // always a copy, even on the same device

  // Returns a read-only handle. Writing through the handle throws ErrorKind::Runtime with `reason`,
  // which must outlive the handle (for example a literal).
  Array read_only(const char* reason) const;
  // Throws ErrorKind::Runtime if the handle is read-only. Code that writes without raw_mutable()
  // calls this check first.
  void require_writable(const char* what) const;

 protected:
  DType dtype_ = DType::float32;
  size_t rows_ = 0, width_ = 1;
  std::shared_ptr<Range> range_;
  const char* read_only_ = nullptr;
};

template <class T>
class DeviceArray : public Array {
 public:
  DeviceArray() { dtype_ = DTypeOf<T>::value; }
  explicit DeviceArray(size_t rows, Device device = default_device(), size_t width = 1)
      : Array(DTypeOf<T>::value, rows, device, width) {}
  // Casts the type-erased handle. Throws ErrorKind::Type if the element type differs.
  explicit DeviceArray(Array array) : Array(std::move(array)) {
    require(dtype() == DTypeOf<T>::value, ErrorKind::Type, "array: expected ",
            dtype_info(DTypeOf<T>::value).name, ", got ", dtype_info(dtype()).name);
  }
  static DeviceArray from_host(std::span<const T> values, Device device = default_device(),
                               size_t width = 1) {
    DeviceArray array(values.size() / (width ? width : 1), device, width);
    array.copy_from_host(values);
    return array;
  }

  // Pointers to the memory of the device. mutable_data() counts as a write and raises the range's
  // version.
  const T* data() const { return static_cast<const T*>(raw()); }
  T* mutable_data() { return static_cast<T*>(raw_mutable()); }

  using Array::copy_from_host;
  using Array::copy_to_host;
  void copy_from_host(std::span<const T> values) {
    Array::copy_from_host(values.data(), values.size_bytes());
  }
  void copy_to_host(std::span<T> values) const {
    Array::copy_to_host(values.data(), values.size_bytes());
  }
  std::vector<T> to_host() const {
    std::vector<T> values(rows() * width());
    copy_to_host(std::span<T>(values));
    return values;
  }
  void fill(const T& value) { fill_bytes(&value, sizeof(T)); }
  DeviceArray clone() const { return DeviceArray(Array::clone()); }
};

}  // namespace novaphy
