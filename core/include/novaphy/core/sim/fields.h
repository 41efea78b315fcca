// Field lists. Model, SimState, Control and Contacts each name their arrays once, in an X-macro
//
//   #define NOVAPHY_..._FIELDS(X)  X(name, element type, width, count, unit, frame, doc) ...
//
// from which the members, their allocation, clone, assign and every walk over them (views, dumps,
// the documentation table) follow. `count` names a member of the class's counts structure: the
// number of rows. Adding an array is one line in its list. A line of SimState also says the role of
// its array.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <type_traits>
#include <vector>

#include "novaphy/core/device_array.h"
#include "novaphy/core/export.h"

namespace novaphy {

// What an array of a state is for a step: carried from state to state, or applied in the step from
// the state that holds it. Arrays of other classes have none.
enum class FieldRole : uint8_t { None, Carried, Applied };

// What is known about a field without an object.
struct FieldInfo {
  std::string_view name;  // "particle_q"
  DType dtype = DType::float32;
  size_t width = 1;             // elements per row; more than 1 only for row tables
  std::string_view count_name;  // the count that gives the rows: "particle_count"
  std::string_view unit;        // "m/s"; "1" is dimensionless, "" has no unit (indices, flags)
  std::string_view frame;       // "world", "shape", ...; "" where no frame applies
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

// Declares the aggregate `Name` of the arrays in a list: `visit` walks them, `visit_rows` with the
// rows that they should have, `allocate` makes them zero filled, `expected_rows` lists their rows
// in order.
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

// Calls visitor(FieldInfo, array) for every field of a Model, SimState, Control or Contacts (or of
// their field aggregates), in the order of the list. The array is the typed DeviceArray<T>&, const
// if the object is.
template <class Object, class Visitor>
void for_each_field(Object& object, Visitor&& visitor) {
  std::remove_const_t<Object>::Fields::visit(object, visitor);
}

// The field list of a class, for documentation and bindings.
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

// ErrorKind::Value, naming `what` and the field, unless the array has its expected rows, width and
// device.
NOVAPHY_CORE_API void check_field(const FieldInfo& info, const Array& array, size_t expected_rows,
                                  Device device, const char* what);
template <class Fields, class Counts>
void check_fields(const Fields& fields, const Counts& counts, Device device, const char* what) {
  Fields::visit_rows(fields, counts,
                     [&](const FieldInfo& info, const Array& array, size_t expected_rows) {
                       check_field(info, array, expected_rows, device, what);
                     });
}
// Checks all fields (ErrorKind::Value: rows or device differ), then copies the values. Nothing is
// copied after an error.
NOVAPHY_CORE_API void assign_fields(const std::vector<MutableField>& targets,
                                    const std::vector<ConstField>& sources, const char* what);
// A copy of every array, on a device.
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
