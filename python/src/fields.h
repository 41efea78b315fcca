// Binds the array fields of Model, SimState, Control and Contacts as Python properties, from the
// lists of fields.
#pragma once

#include <string>

#include "exchange.h"
#include "novaphy/core/sim/fields.h"

namespace novaphy::python {

void assign_array(Array& array, py::handle source);  // DeviceArray.assign

// Returns the docstring of a field, such as "vec3 {particle_count}, m, world frame: ...".
inline std::string field_doc(const FieldInfo& info) {
  std::string doc = std::string(dtype_info(info.dtype).name) + " {" + std::string(info.count_name) +
                    (info.width != 1 ? ", " + std::to_string(info.width) : "") + "}";
  if (!info.unit.empty()) doc += ", " + std::string(info.unit);
  if (!info.frame.empty()) doc += ", " + std::string(info.frame) + " frame";
  return doc + ": " + std::string(info.doc) +
         ". A read returns the array itself. An assignment copies values into the array.";
}

// Binds a field. A read returns a DeviceArray over the same memory. An assignment copies values
// into the array.
template <class Class, class Owner, class T>
void bind_field(Class& c, const FieldInfo& info, DeviceArray<T> Owner::*member,
                const char* name = nullptr) {
  using Object = typename Class::type;
  const std::string label(name != nullptr ? name : info.name);
  c.def_property(
      label.c_str(), [member](const Object& self) { return static_cast<Array>(self.*member); },
      [member](Object& self, py::handle source) { assign_array(self.*member, source); },
      field_doc(info).c_str());
}

#define NOVAPHY_BIND_FIELD(name, ...) \
  bind_field(c, NOVAPHY_FIELD_INFO(name, __VA_ARGS__), &Fields::name);

// Returns the counts that are not 0: "body_count=2, shape_count=2, ".
inline std::string counts_text(const ModelCounts& counts) {
  std::string text;
#define NOVAPHY_COUNT_TEXT(count, doc) \
  if (counts.count != 0) text += #count "=" + std::to_string(counts.count) + ", ";
  NOVAPHY_MODEL_COUNTS(NOVAPHY_COUNT_TEXT)
#undef NOVAPHY_COUNT_TEXT
  return text;
}

// Binds the common members of the objects of a model: counts, device, requires_grad, repr.
#define NOVAPHY_BIND_COUNT(name, doc) \
  c.def_property_readonly(#name, &Object::name, "The number of " doc ".");
template <class Object, class... Options>
void bind_counts(py::class_<Object, Options...>& c) {
  NOVAPHY_MODEL_COUNTS(NOVAPHY_BIND_COUNT)
  const std::string name = py::str(c.attr("__name__"));
  c.def("__repr__", [name](const Object& self) {
    return name + "(" + counts_text(self.counts()) + "device='" + self.device().str() + "'" +
           (self.requires_grad ? ", requires_grad=True)" : ")");
  });
  c.def_property_readonly("device", &Object::device, "The device of the arrays.");
  c.def_property(
      "requires_grad", [](const Object& self) { return self.requires_grad; },
      [](Object& self, bool on) { self.requires_grad = on; }, "Whether gradients are requested.");
}

}  // namespace novaphy::python
