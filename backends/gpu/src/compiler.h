// The vendor's run-time compiler (NVRTC), opened at run time like the driver.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace novaphy::gpu {

struct Compiler {
  int major = 0, minor = 0;
  std::string path;     // of the library, or how it was found
  std::string problem;  // not empty: there is none, and why
  bool available() const { return problem.empty(); }
};
// Found at the first call and kept. `driver_version` 12080: a compiler of a later major version
// than the driver's makes code that the driver cannot load, so it is passed over; 0 takes any.
const Compiler& compiler(int driver_version);

struct CompiledCode {
  std::vector<char> bytes;  // an image for the driver, or text of its assembler with a final zero
  std::string problem;      // not empty: the compiler's own messages
};
// What the text is: a Program or a SOURCE module, without or with contraction.
enum class Dialect { Program, Contracted, Source, ContractedSource };
// The options that decide about the result.
std::string compile_options(Dialect dialect);
// For `arch` (90), or as assembler text: for the nearest older one when the compiler does not know
// `arch`, or when `as_text` asks for it.
CompiledCode compile(const std::string& source, int arch, Dialect dialect, bool as_text = false);

}  // namespace novaphy::gpu
