#include "programs.h"

#include <cstring>
#include <fstream>
#include <map>
#include <sstream>
#include <stdexcept>

#include "novaphy/diff/engine_kernels.h"
#include "novaphy/nova/registry.h"

namespace generator {

namespace ir = nova::ir;

std::vector<ir::Program> engine_programs() {
  std::vector<nova::EngineKernel> kernels = nova::engine_kernels();
  for (nova::EngineKernel& k : novaphy::diff::engine_kernels()) kernels.push_back(std::move(k));
  return nova::programs_of(kernels);
}

// Reads the Programs of a file. Each Program begins with a header that has its length.
std::vector<ir::Program> read_programs(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error("cannot read " + path);
  std::stringstream bytes;
  bytes << file.rdbuf();
  const std::string text = bytes.str();
  std::vector<uint32_t> words(text.size() / sizeof(uint32_t));
  std::memcpy(words.data(), text.data(), words.size() * sizeof(uint32_t));
  std::map<uint64_t, ir::Program> programs;
  for (size_t at = 0; at < words.size();) {
    const size_t count = at + NOVAPHY_PROGRAM_HEADER_WORD_COUNT < words.size()
                             ? words[at + NOVAPHY_PROGRAM_HEADER_WORD_COUNT]
                             : 0;
    ir::Program program;
    std::string reason = "its length is wrong";
    if (count == 0 || count > words.size() - at ||
        !ir::deserialize({words.data() + at, count}, program, reason))
      throw std::runtime_error(path + ": " + reason);
    programs.emplace(ir::hash(program), std::move(program));
    at += count;
  }
  std::vector<ir::Program> list;
  for (auto& [hash, program] : programs) list.push_back(std::move(program));
  return list;
}

}  // namespace generator
