// Docstrings of devices.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDevice[] =
    R"(A compute device: "cpu", "cuda:0", "dlan:0".

The device need not exist. The properties name, arch, total_memory, free_memory and
supports_graph_capture raise novaphy.Error if it does not.)";

inline constexpr char kDeviceInit[] =
    R"(Makes a device from a name or another Device. None: the default device. ValueError: an
unknown name.)";

inline constexpr char kGetDevice[] =
    R"(Returns the device of a name. None: the default device. novaphy.Error, with the reasons: the
device is not available.)";

}  // namespace novaphy::python::doc
