// Support for pickle, copy and deepcopy: the content of an object as Python values. Arrays are
// copied through the host, and unpickled to the device that they were on. Gradients and tapes are
// left out.
#pragma once

#include <utility>

#include "exchange.h"
#include "fields.h"

namespace novaphy::python {

inline const py::handle unpickled(const py::dict& kept, const char* name) {
  require(kept.contains(name), ErrorKind::Value, "unpickle: expected ", name,
          ", which this version has; got the object of another version");
  return kept[name];
}

// ---------------------------------------------------------------- arrays

inline void add_array_pickle(py::class_<Array>& c) {
  c.def(py::pickle(
      [](const Array& array) {
        std::string bytes(array.bytes(), '\0');
        if (!bytes.empty()) array.copy_to_host(bytes.data(), bytes.size());
        return py::make_tuple(dtype_info(array.dtype()).name, array.rows(), array.width(),
                              array.device().str(), py::bytes(bytes));
      },
      [](const py::tuple& kept) {
        Array array(to_dtype(kept[0]), kept[1].cast<size_t>(), to_device(kept[3]),
                    kept[2].cast<size_t>());
        const auto bytes = kept[4].cast<std::string_view>();
        require(bytes.size() == array.bytes(), ErrorKind::Value, "unpickle: expected ",
                array.bytes(), " bytes of an array, got ", bytes.size());
        if (!bytes.empty()) array.copy_from_host(bytes.data(), bytes.size());
        return array;
      }));
}

// ---------------------------------------------------------------- model, state, control

// Returns the content of an object of a model: sizes, device and arrays.
template <class Object>
py::dict keep_fields(const Object& object) {
  py::dict counts, arrays;
#define NOVAPHY_KEEP_COUNT(name, doc) counts[#name] = object.name();
  NOVAPHY_MODEL_COUNTS(NOVAPHY_KEEP_COUNT)
#undef NOVAPHY_KEEP_COUNT
  for_each_field(object, [&](const FieldInfo& info, const Array& array) {
    arrays[py::str(info.name)] = py::cast(array);
  });
  return py::dict("counts"_a = counts, "arrays"_a = arrays, "device"_a = object.device().str(),
                  "requires_grad"_a = object.requires_grad);
}

inline ModelCounts unpickled_counts(const py::dict& kept) {
  const auto from = unpickled(kept, "counts").cast<py::dict>();
  ModelCounts counts;
#define NOVAPHY_UNPICKLED_COUNT(name, doc) counts.name = unpickled(from, #name).cast<int32_t>();
  NOVAPHY_MODEL_COUNTS(NOVAPHY_UNPICKLED_COUNT)
#undef NOVAPHY_UNPICKLED_COUNT
  return counts;
}

template <class Object>
void take_fields(Object& object, const py::dict& kept) {
  const auto arrays = unpickled(kept, "arrays").cast<py::dict>();
  for_each_field(object, [&](const FieldInfo& info, Array& array) {
    array.assign(unpickled(arrays, std::string(info.name).c_str()).cast<const Array&>());
  });
  object.requires_grad = unpickled(kept, "requires_grad").cast<bool>();
}

// Adds pickle support to SimState and Control, which have the id of their model.
template <class Object>
void add_field_pickle(py::class_<Object>& c) {
  c.def(py::pickle(
      [](const Object& object) {
        py::dict kept = keep_fields(object);
        kept["model_id"] = object.model_id();
        return kept;
      },
      [](const py::dict& kept) {
        Object object(unpickled_counts(kept), to_device(unpickled(kept, "device")),
                      unpickled(kept, "model_id").cast<uint64_t>());
        take_fields(object, kept);
        return object;
      }));
}

// ---------------------------------------------------------------- settings

// Adds pickle support and a repr to a class whose content is its writable properties.
template <class Settings>
void add_settings_pickle(py::class_<Settings>& c) {
  const py::object writable = [](const py::object& type) {
    py::list names;
    for (const auto& [name, member] : py::dict(type.attr("__dict__").attr("copy")()))
      if (!py::getattr(member, "fset", py::none()).is_none()) names.append(name);
    return py::object(std::move(names));
  }(c);
  c.def(py::pickle(
      [writable](const py::object& self) {
        py::dict kept;
        for (const py::handle name : writable) kept[name] = self.attr(name);
        return kept;
      },
      [](const py::dict& kept) {
        Settings settings;
        const py::object self = py::cast(&settings, py::return_value_policy::reference);
        for (const auto& [name, value] : kept) self.attr(name) = value;
        return settings;
      }));
  c.def("__repr__", [writable](const py::object& self) {
    std::string text = py::str(py::type::of(self).attr("__name__"));
    const char* between = "(";
    for (const py::handle name : writable) {
      const py::object value = self.attr(name);
      text += between + std::string(py::str(name)) + "=";
      text += py::isinstance<py::float_>(value) ? number_text(value.cast<float>())
                                                : std::string(py::repr(value));
      between = ", ";
    }
    return text + ")";
  });
}

}  // namespace novaphy::python
