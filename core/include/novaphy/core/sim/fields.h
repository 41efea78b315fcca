// Field lists. Model, SimState, Control and Contacts each list their arrays once, in an X-macro:
//
//   #define NOVAPHY_..._FIELDS(X)  X(name, element type, width, count, unit, frame, doc) ...
//
// The list generates the members, their allocation, clone, assign and every loop over the arrays
// (views, dumps, the documentation table). `count` is the member of the counts structure with the
// number of rows. A new array is one line in its list. A line of SimState also has the role of the
// array.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <type_traits>
#include <vector>

#include "novaphy/core/device_array.h"
#include "novaphy/core/export.h"

namespace novaphy {

// The role of an array of SimState in a step. Carried: a step reads the array and writes the next
// value. Applied: an input of the step that starts from the state. None: the array belongs to
// another class than SimState.
enum class FieldRole : uint8_t { None, Carried, Applied };

// The properties of a field that are known without an object.
struct FieldInfo {
  std::string_view name;  // "particle_q"
  DType dtype = DType::float32;
  size_t width = 1;             // elements per row; above 1 only for row tables
  std::string_view count_name;  // name of the count of rows: "particle_count"
  std::string_view unit;        // "m/s"; "1": dimensionless; "": no unit (indices, flags)
  std::string_view frame;       // "world", "shape" and so on; "": no frame
  std::string_view doc;
  FieldRole role = FieldRole::None;
};

#define NOVAPHY_FIELD_INFO(name, type, width, count, unit, frame, doc, ...) \
  ::novaphy::FieldInfo {                                                    \
#name, ::novaphy::DTypeOf < type> ::value, width, #count, unit, frame,  \
        doc __VA_OPT__(, ::novaphy::FieldRole::) __VA_ARGS__                \
  }
#define NOVAPHY_FIELD_MEMBER(name, type, ...) DeviceArray<type> name;
#define NOVAPHY_FIELD_VISIT(name, ...) visitor(NOVAPHY_FIELD_INFO(name, __VA_ARGS__), self.name);
#define NOVAPHY_FIELD_VISIT_ROWS(name, type, width, count, ...)                 \
  visitor(NOVAPHY_FIELD_INFO(name, type, width, count, __VA_ARGS__), self.name, \
          static_cast<size_t>(counts.count));
#define NOVAPHY_FIELD_ALLOCATE(name, type, width, count, ...) \
  name = DeviceArray<type>(static_cast<size_t>(counts.count), device, width);
#define NOVAPHY_FIELD_ROWS(name, type, width, count, ...) \
  rows.push_back(static_cast<size_t>(counts.count));
#define NOVAPHY_FIELD_COUNT(name, ...) +1

// Declares the aggregate `Name` of the arrays of a list. `visit` walks over the arrays.
// `visit_rows` also gives the expected number of rows. `allocate` makes arrays filled with zeros.
// `expected_rows` returns the expected rows in order.
#define NOVAPHY_DECLARE_FIELDS(Name, LIST, Counts)                                      \
  struct Name {                                                                         \
    static constexpr size_t kFieldCount = 0 LIST(NOVAPHY_FIELD_COUNT);                  \
    LIST(NOVAPHY_FIELD_MEMBER)                                                          \
    template <class Self, class Visitor>                                                \
    static void visit(Self& self, Visitor&& visitor) {                                  \
      LIST(NOVAPHY_FIELD_VISIT)                                                         \
    }                                                                                   \
    template <class Self, class Visitor>                                                \
    static void visit_rows(Self& self, const Counts& counts, Visitor&& visitor) {       \
      LIST(NOVAPHY_FIELD_VISIT_ROWS)                                                    \
    }                                                                                   \
    void allocate(const Counts& counts, Device device) { LIST(NOVAPHY_FIELD_ALLOCATE) } \
    static std::vector<size_t> expected_rows(const Counts& counts) {                    \
      std::vector<size_t> rows;                                                         \
      LIST(NOVAPHY_FIELD_ROWS)                                                          \
      return rows;                                                                      \
    }                                                                                   \
  };

// Calls visitor(FieldInfo, array) for every field of a Model, SimState, Control or Contacts, or of
// their field aggregates, in the order of the list. The array is a DeviceArray<T>&, const for a
// const object.
template <class Object, class Visitor>
void for_each_field(Object& object, Visitor&& visitor) {
  std::remove_const_t<Object>::Fields::visit(object, visitor);
}

// Returns the field list of a class, for documentation and bindings.
template <class Object>
std::vector<FieldInfo> field_infos() {
  std::vector<FieldInfo> infos;
  const typename Object::Fields fields;
  Object::Fields::visit(fields,
                        [&](const FieldInfo& info, const Array&) { infos.push_back(info); });
  return infos;
}

namespace detail {

struct ConstField {
  FieldInfo info;
  const Array* array;
};
struct MutableField {
  FieldInfo info;
  Array* array;
};

template <class Fields>
std::vector<ConstField> const_fields(const Fields& fields) {
  std::vector<ConstField> result;
  Fields::visit(fields, [&](const FieldInfo& info, const Array& array) {
    result.push_back({info, &array});
  });
  return result;
}
template <class Fields>
std::vector<MutableField> mutable_fields(Fields& fields) {
  std::vector<MutableField> result;
  Fields::visit(fields, [&](const FieldInfo& info, Array& array) {
    result.push_back({info, &array});
  });
  return result;
}

// Throws ErrorKind::Value, with `what` and the field, unless the array has the expected rows, width
// and device.
NOVAPHY_CORE_API void check_field(const FieldInfo& info, const Array& array, size_t expected_rows,
                                  Device device, const char* what);
template <class Fields, class Counts>
void check_fields(const Fields& fields, const Counts& counts, Device device, const char* what) {
  Fields::visit_rows(fields, counts,
                     [&](const FieldInfo& info, const Array& array, size_t expected_rows) {
                       check_field(info, array, expected_rows, device, what);
                     });
}
// Checks the rows and devices of all fields (ErrorKind::Value), then copies the values. After an
// error nothing is copied.
NOVAPHY_CORE_API void assign_fields(const std::vector<MutableField>& targets,
                                    const std::vector<ConstField>& sources, const char* what);
// Returns a copy of every array on a device.
template <class Fields>
Fields copy_fields(const Fields& fields, Device device) {
  Fields copy;
  const std::vector<ConstField> sources = const_fields(fields);
  size_t i = 0;
  Fields::visit(copy, [&](const FieldInfo&, auto& array) {
    array = std::remove_reference_t<decltype(array)>(sources[i++].array->to(device));
  });
  return copy;
}

}  // namespace detail
}  // namespace novaphy
