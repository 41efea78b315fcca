// Devices and backends.
#include "convert.h"
#include "doc_core.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/stream.h"

namespace novaphy::python {
namespace {

// with novaphy.ScopedDevice("cuda:0"): ...
class ScopedDevice {
 public:
  explicit ScopedDevice(Device device) : device_(device) {}
  Device enter() {
    before_.push_back(default_device());
    set_default_device(device_);
    return device_;
  }
  void exit() {
    if (before_.empty()) return;
    set_default_device(before_.back());
    before_.pop_back();
  }

 private:
  Device device_;
  std::vector<Device> before_;
};

void bind_devices(py::module_& m) {
  py::object enums = py::module_::import("enum");
  py::dict types("CPU"_a = static_cast<int>(DeviceType::CPU),
                 "CUDA"_a = static_cast<int>(DeviceType::CUDA),
                 "DLAN"_a = static_cast<int>(DeviceType::DLAN));
  py::object device_type = enums.attr("IntEnum")("DeviceType", types, "module"_a = "novaphy");
  device_type.attr("__doc__") = "The kind of a device.";
  m.attr("DeviceType") = device_type;

  py::class_<Device>(m, "Device", doc::kDevice)
      .def(py::init([](py::handle spec) { return to_device(spec); }), "spec"_a = py::none(),
           doc::kDeviceInit)
      .def_property_readonly(
          "type", [device_type](const Device& d) { return device_type(static_cast<int>(d.type)); },
          "The DeviceType of the device.")
      .def_property_readonly(
          "ordinal", [](const Device& d) { return d.ordinal; },
          "The index among the devices of its type.")
      .def_property_readonly(
          "name", [](const Device& d) { return device_info(d).name; }, "The name of the hardware.")
      .def_property_readonly(
          "arch", [](const Device& d) { return device_info(d).arch; },
          "The compute capability of a CUDA device, such as 90 for 9.0; 0 on the CPU.")
      .def_property_readonly(
          "total_memory", [](const Device& d) { return device_info(d).total_memory; },
          "The memory of the device (bytes).")
      .def_property_readonly(
          "free_memory", [](const Device& d) { return device_info(d).free_memory; },
          "The free memory of the device (bytes).")
      .def_property_readonly("is_cpu", &Device::is_cpu, "Whether the device is the cpu.")
      .def_property_readonly(
          "is_cuda", [](const Device& d) { return d.type == DeviceType::CUDA; },
          "Whether the device is a CUDA device.")
      .def_property_readonly(
          "supports_graph_capture",
          [](const Device& d) { return device_info(d).supports_graph_capture; },
          "Whether the driver of the device can capture and replay work as a graph.")
      .def("__eq__",
           [](const Device& d, py::handle other) {
             if (PyUnicode_Check(other.ptr())) return d == Device::parse(other.cast<std::string>());
             return py::isinstance<Device>(other) && d == other.cast<Device>();
           })
      .def("__hash__", [](const Device& d) { return py::hash(py::str(d.str())); })
      .def("__str__", &Device::str)
      .def("__repr__", [](const Device& d) { return "Device('" + d.str() + "')"; });

  m.def(
      "get_device",
      [](py::handle spec) {
        const Device device = to_device(spec);
        require_device(device);
        return device;
      },
      "spec"_a = py::none(), doc::kGetDevice);
  m.def("get_devices", &devices, "All devices that the backends offer.");
  m.def("get_default_device", &default_device,
        "The device of new arrays and models without a device argument.");
  m.def(
      "set_default_device", [](py::handle spec) { set_default_device(to_device(spec)); }, "spec"_a,
      "Sets the default device. novaphy.Error: the device is not available.");
  m.def(
      "is_device_available", [](py::handle spec) { return device_available(to_device(spec)); },
      "spec"_a, "Returns whether the device is available. ValueError: an unknown name.");
  m.def(
      "synchronize",
      [](py::handle device) {
        const Device d = to_device(device);
        const ReleasedGil release;
        synchronize(d);
      },
      "device"_a = py::none(), "Waits until all work of a device is done.");
  py::class_<Event>(m, "Event", "A mark in the sequence of a device's work, to measure times.")
      .def(py::init([](py::handle device) { return std::make_unique<Event>(to_device(device)); }),
           "device"_a = py::none())
      .def_property_readonly("device", &Event::device, "The device of the event.")
      .def("record", &Event::record, "Places the mark after all work that was issued so far.")
      .def("synchronize", &Event::synchronize, release_gil(),
           "Waits until the device has reached the mark.")
      .def_static("elapsed", &Event::elapsed, "start"_a, "stop"_a, release_gil(),
                  "Waits for the second of two marks, and returns the time between them (s).");
  py::class_<ScopedDevice>(m, "ScopedDevice", "A context manager that sets the default device.")
      .def(py::init([](py::handle spec) { return ScopedDevice(to_device(spec)); }), "spec"_a)
      .def("__enter__", &ScopedDevice::enter)
      .def("__exit__", [](ScopedDevice& s, const py::args&) { s.exit(); });
}

void bind_backends(py::module_& m) {
  py::class_<BackendInfo>(m, "BackendInfo", "A backend that was found, and whether it was loaded.")
      .def_readonly("name", &BackendInfo::name,
                    "The name of the backend, such as \"cpu\", or of the file if it was not "
                    "loaded.")
      .def_readonly("version", &BackendInfo::version, "The version of the backend.")
      .def_property_readonly(
          "abi_version",
          [](const BackendInfo& b) { return py::make_tuple(b.abi_major, b.abi_minor); },
          "(major, minor) of the plugin interface.")
      .def_property_readonly(
          "path", [](const BackendInfo& b) { return b.path; },
          "The path of the plugin; empty for a built-in backend.")
      .def_readonly("loaded", &BackendInfo::loaded,
                    "Whether the backend was loaded; if not, `error` has the reason.")
      .def_readonly("active", &BackendInfo::active,
                    "Whether the backend is the one that is used for its type of device.")
      .def_readonly("device_count", &BackendInfo::device_count,
                    "The number of devices that the backend offers.")
      .def_readonly("error", &BackendInfo::error,
                    "The reason why the backend was refused; empty for a loaded backend.")
      .def("__repr__", [](const BackendInfo& b) {
        return "BackendInfo(name='" + b.name + "', version='" + b.version +
               "', loaded=" + (b.loaded ? "True" : "False") +
               ", active=" + (b.active ? "True" : "False") + ", path='" + b.path + "')";
      });
  m.def("backends", &backends, "Returns every backend that was found, in search order.");
  m.def(
      "load_backend",
      [](const py::object& path) {
        return load_backend(py::module_::import("os").attr("fspath")(path).cast<std::string>());
      },
      "path"_a,
      "Loads a backend plugin from a file. novaphy.Error: the plugin was refused; the message has "
      "the reason.");
}

}  // namespace

void bind_core(py::module_& m) {
  bind_devices(m);
  bind_backends(m);
}

}  // namespace novaphy::python
