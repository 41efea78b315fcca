// Bindings of the mesh readers. A mesh is a pair of NumPy arrays (vertices, indices).
#include <pybind11/stl/filesystem.h>

#include <cstring>

#include "convert.h"
#include "novaphy/core/io/tet_mesh.h"
#ifdef NOVAPHY_PYTHON_IO
#include "novaphy/io/mesh.h"
#endif

namespace novaphy::python {
namespace {

// Returns values as a NumPy array {n, columns}.
template <class T>
py::object to_array(const std::vector<T>& values, Scalar scalar, size_t columns) {
  const size_t rows = values.size() * (sizeof(T) / 4) / columns;
  py::object array = numpy().empty(py::make_tuple(rows, columns), numpy_dtype(scalar));
  const BufferView view(array, true);
  std::memcpy(view.data(), values.data(), view.bytes());
  return array;
}

template <class AnyMesh>
py::tuple to_arrays(const AnyMesh& mesh, size_t corners) {
  return py::make_tuple(to_array(mesh.vertices, Scalar::F32, 3),
                        to_array(mesh.indices, Scalar::I32, corners));
}

py::tuple load_mesh_arrays(const std::filesystem::path& path, bool join, bool drop) {
#ifdef NOVAPHY_PYTHON_IO
  Mesh mesh;
  {
    const ReleasedGil release;
    mesh = load_mesh(path, {.join_vertices = join, .drop_degenerate = drop});
  }
  return to_arrays(mesh, 3);
#else
  static_cast<void>(path), static_cast<void>(join), static_cast<void>(drop);
  throw py::import_error(
      "novaphy.io.load_mesh is not part of this build of NovaPhy: it was configured with "
      "NOVAPHY_WITH_IO=OFF. Build with -DNOVAPHY_WITH_IO=ON -DNOVAPHY_ASSIMP=source "
      "-DNOVAPHY_URDFDOM=source, as the wheels are.");
#endif
}

py::tuple load_tet_mesh_arrays(const std::filesystem::path& path, bool drop) {
  TetMesh mesh;
  {
    const ReleasedGil release;
    mesh = load_tet_mesh(path, {.drop_loose_vertices = drop});
  }
  return to_arrays(mesh, 4);
}

}  // namespace

void bind_io(py::module_& io) {
  io.def("load_mesh", &load_mesh_arrays, "path"_a, py::kw_only(), "join_vertices"_a = true,
         "drop_degenerate"_a = false, "See novaphy.io.load_mesh.");
  io.def("load_tet_mesh", &load_tet_mesh_arrays, "path"_a, py::kw_only(),
         "drop_loose_vertices"_a = false, "See novaphy.io.load_tet_mesh.");
}

}  // namespace novaphy::python
