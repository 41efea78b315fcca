// Writes the device code that a build for Denglin GPUs compiles ahead of time.
//
//   novaphy_dlan_sources FOLDER PARTS [--programs FILE]
//
// FOLDER gets the files kernels_0.cu to kernels_<PARTS - 1>.cu. They have the builtins, the
// interpreter, the hand-written kernels and the engine's kernels, and each file has a table of its
// host stubs. With --programs, the serialized Programs in FILE replace the engine's kernels. The
// file kernels.cu has the table of all tables. Files that would not change are not written.
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <stdexcept>
#include <string>
#include <vector>

#include "ahead.h"
#include "code_cache.h"
#include "device_source.h"
#include "kernels.h"
#include "novaphy/collision/device_modules.h"
#include "novaphy/dynamics/device_modules.h"
#ifdef NOVAPHY_VBD_MODULES
#include "novaphy/vbd/device_modules.h"
#endif
#include "programs.h"

namespace {

namespace gpu = novaphy::gpu;

void write_file(const std::filesystem::path& path, const std::string& text) {
  std::ifstream old(path, std::ios::binary);
  if (old && std::string(std::istreambuf_iterator<char>(old), {}) == text) return;
  if (!(std::ofstream(path, std::ios::binary) << text).flush())
    throw std::runtime_error("cannot write " + path.string());
}

std::string table_type(const std::string& name) {
  return "struct StubModule {\n  unsigned long long key[2];\n  const void* stubs;\n};\n"
         "extern \"C\" __attribute__((visibility(\"hidden\"))) const StubModule* " +
         name + "()";
}

// Returns the text of one file: the modules, which begin with the same prelude.
std::string part(const std::vector<std::pair<std::string, gpu::Dialect>>& modules, size_t number) {
  const std::string prelude = gpu::prelude_text();
  const std::string scope = "part_" + std::to_string(number);
  std::string text =
                  "// Written by novaphy_dlan_sources.\nnamespace novaphy_kernels {\nnamespace " +
                  scope + " {\n" + prelude,
              table;
  for (size_t k = 0; k < modules.size(); ++k) {
    const auto& [source, dialect] = modules[k];
    const std::string name = "module_" + std::to_string(k);
    const gpu::CodeKey key = gpu::ahead_key(source, dialect);
    text += "namespace " + name + " {\n" + source.substr(prelude.size()) + gpu::stub_table(source) +
            "}\n";
    table += "      {{" + std::to_string(key.a) + "ull, " + std::to_string(key.b) +
             "ull}, novaphy_kernels::" + scope + "::" + name + "::stubs},\n";
  }
  return text + "}\n}\n" + table_type("novaphy_part_" + std::to_string(number)) +
         " {\n  static const StubModule all[] = {\n" + table +
         "      {{0, 0}, 0}};\n  return all;\n}\n";
}

std::string last_part(size_t parts) {
  std::string text = "// Written by novaphy_dlan_sources.\n", calls;
  for (size_t k = 0; k < parts; ++k) {
    const std::string name = "novaphy_part_" + std::to_string(k);
    const std::string declared = table_type(name);
    text += (k == 0 ? declared : declared.substr(declared.find("extern"))) + ";\n";
    calls += name + ", ";
  }
  return text + R"(
#ifndef NOVAPHY_STUB
#define NOVAPHY_STUB(kernel) ((const void*)kernel)
#endif
__global__ void fill(unsigned char* target, const unsigned long long pitch, const unsigned pattern,
                     const unsigned bytes, const unsigned long long count) {
  const unsigned long long row = (unsigned long long)blockIdx.x * blockDim.x + threadIdx.x;
  if (row >= count) return;
  unsigned char* const at = target + row * pitch;
  if (bytes == 4) {
    *(unsigned*)at = pattern;
  } else {
    for (unsigned k = 0; k < bytes; ++k) at[k] = (unsigned char)(pattern >> 8 * k);
  }
}
#define ENTRY extern "C" __attribute__((visibility("default")))
ENTRY const void* novaphy_dlan_fill() { return NOVAPHY_STUB(fill); }
ENTRY const StubModule* novaphy_dlan_modules() {
  const StubModule* (*const parts[])() = {)" +
         calls + R"(0};
  static StubModule all[10000];
  unsigned count = 0;
  for (unsigned part = 0; parts[part] != 0; ++part)
    for (const StubModule* m = parts[part](); m->stubs != 0 && count < 9999; ++m) all[count++] = *m;
  all[count].stubs = 0;
  return all;
}
)";
}

int run(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  const bool listed = words.size() == 4 && words[2] == "--programs";
  const size_t parts = words.size() >= 2 ? std::strtoul(words[1].c_str(), nullptr, 10) : 0;
  if (parts < 1 || (words.size() != 2 && !listed)) {
    std::cerr << "usage: " << argv[0] << " FOLDER PARTS [--programs FILE]\n";
    return 2;
  }
  // Modules with different macros go into different files.
  std::vector<std::vector<std::pair<std::string, gpu::Dialect>>> all(parts);
  size_t next = 0;
  const auto add = [&](const std::string& source, gpu::Dialect dialect) {
    all[next++ % parts].emplace_back(source, dialect);
  };
  add(gpu::builtins_source(), gpu::Dialect::Program);
  add(gpu::interpreter_source(), gpu::Dialect::Program);
  for (const std::string& text : novaphy::collision_device_modules())
    add(gpu::module_source(text), gpu::Dialect::Source);
  for (const std::string& text : novaphy::dynamics_device_modules())
    add(gpu::module_source(text), gpu::Dialect::Source);
#ifdef NOVAPHY_VBD_MODULES
  for (const std::string& text : novaphy::vbd_device_modules())
    add(gpu::module_source(text), gpu::Dialect::Source);
#endif
  if (next > parts)
    throw std::runtime_error("PARTS: expected at least " + std::to_string(next) + ", got " +
                             words[1]);
  const auto programs = listed ? generator::read_programs(words[3]) : generator::engine_programs();
  for (const nova::ir::Program& p : programs)
    if (!p.contract) add(gpu::kernel_source(p), gpu::Dialect::Program);
  const std::filesystem::path folder = words[0];
  std::filesystem::create_directories(folder);
  for (size_t k = 0; k < parts; ++k)
    write_file(folder / ("kernels_" + std::to_string(k) + ".cu"), part(all[k], k));
  write_file(folder / "kernels.cu", last_part(parts));
  std::cout << programs.size() << " Programs in " << parts << " files\n";
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::cerr << argv[0] << ": " << error.what() << "\n";
    return 1;
  }
}
