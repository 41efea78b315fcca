// Docstrings of devices.
#pragma once

namespace novaphy::python::doc {

inline constexpr char kDevice[] =
    R"(A compute device: "cpu", "cuda:0", "dlan:0".

The device need not exist. The properties name, arch, total_memory, free_memory and
supports_graph_capture raise novaphy.Error if it does not.)";

}  // namespace novaphy::python::doc
