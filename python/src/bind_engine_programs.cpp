// Binding of engine_programs: the Programs whose kernels are compiled at the build.
#include <map>

#include "nova_types.h"
#include "novaphy/diff/engine_kernels.h"
#include "part_bindings.h"

namespace novaphy::python {

void bind_engine_programs(py::module_& m) {
  m.def(
      "engine_programs",
      [] {
        std::vector<nova::EngineKernel> kernels = nova::engine_kernels();
        for (nova::EngineKernel& k : diff::engine_kernels()) kernels.push_back(std::move(k));
        std::map<uint64_t, std::string> texts;
        for (const nova::ir::Program& p : nova::programs_of(kernels))
          texts[nova::ir::hash(p)] = nova::ir::to_string(p);
        return texts;
      },
      release_gil(),
      "Returns a dict of the engine's kernels and adjoints that are compiled at the build: the "
      "hash (KernelInfo.hash) -> the Program as text.");
}

}  // namespace novaphy::python
