// Docstrings of devices.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDevice[] =
    R"(A compute device, named "cpu", "cuda:0", "dlan:0", ...

A Device can name hardware that this machine does not have. The properties name, arch, total_memory,
free_memory and supports_graph_capture then raise novaphy.Error.)";

inline constexpr char kDeviceInit[] =
    R"(Makes a device from a name or another Device. None: the default device. ValueError: an
unknown name.)";

inline constexpr char kGetDevice[] =
    R"(Returns the device with a name such as "cuda:0". None: the default device. novaphy.Error: the
device is not available; the message has the reasons.)";

}  // namespace novaphy::python::doc
