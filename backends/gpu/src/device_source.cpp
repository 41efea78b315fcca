#include "device_source.h"

#include "interpreter.h"
#include "novaphy/program/emit.h"
#include "vendor.h"

namespace novaphy::gpu {

nova::ir::Program without_names(nova::ir::Program program) {
  program.name = "kernel";
  for (nova::ir::Source& source : program.sources) source.name.clear();
  for (nova::ir::Output& output : program.outputs) output.name.clear();
  return program;
}

std::string prelude_text() {
  return std::string(vendor().device_text()) + generic_text() + device_prelude_text();
}

std::string kernel_source(const nova::ir::Program& program) {
  const std::string words = std::to_string(program.argument_count());
  std::string text = prelude_text();
  text += nova::ir::emit_device(without_names(program), "row");
  text += "struct kernel_arguments {\n  uint64_t word[" + words + "];\n};\n";
  text +=
      "VENDOR_ENTRY __launch_bounds__(128) novaphy_main(\n"
      "    const __grid_constant__ kernel_arguments args, const int64_t n, const device_sink sink) "
      "{\n"
      "  const int64_t i = (int64_t)blockIdx.x * blockDim.x + threadIdx.x;\n"
      "  if (i >= active_rows(sink, n)) return;\n"
      "  const uint64_t* const w = args.word;\n"
      "  row_failure failure = begin_row(sink);\n"
      "  row(w";
  for (size_t s = 0; s < program.sources.size(); ++s) {
    const uint32_t k = program.source_argument(s);
    text += ",\n      source_rows{(const char*)w[" + std::to_string(k) + "], (int64_t)w[" +
            std::to_string(k + 1) + "]}";
  }
  for (size_t o = 0; o < program.outputs.size(); ++o)
    text += ",\n      output_rows{(char*)w[" + std::to_string(program.output_argument(o)) + "]}";
  text += ",\n      i, failure);\n  end_row(failure, sink, i);\n}\n";
  return text;
}

std::string module_source(const std::string& text) {
  return prelude_text() +
         "#define NOVAPHY_KERNEL VENDOR_ENTRY __launch_bounds__(128)\n"
         "#define NOVAPHY_ROW ((int64_t)blockIdx.x * blockDim.x + threadIdx.x)\n"
         "template <int words>\nstruct novaphy_arguments {\n  uint64_t word[words];\n};\n" +
         "VENDOR_SOURCE_BEGIN\n" + text + "\nVENDOR_SOURCE_END\n";
}

std::string builtins_source() { return prelude_text() + builtins_text(); }

std::string interpreter_source() {
  std::string names = "enum {";
  for (const char* name : nova::ir::kOpNames) names += std::string(" OP_") + name + ",";
#define NOVAPHY_INTERPRETER_NAME(name) " OP_" #name ","
  names += NOVAPHY_INTERPRETER_OPS(NOVAPHY_INTERPRETER_NAME) " };\n";
#undef NOVAPHY_INTERPRETER_NAME
  return prelude_text() + names + interpreter_text();
}

}  // namespace novaphy::gpu
