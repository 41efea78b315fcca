// Compilers at run time: a library of the vendor (NVRTC) that is opened like the driver, a command,
// or no compiler.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace novaphy::gpu {

struct Compiler {
  int major = 0, minor = 0;
  std::string name;  // name with version: code depends on them besides text and options
  std::string path;  // path of the library, or how it was found
  std::string problem;  // reason why there is no compiler, or empty
  bool available() const { return problem.empty(); }
};
// Finds the compiler at the first call. `driver_version` 12080 skips a compiler with a later major
// version than 12, because the driver could not load its code. 0 accepts any compiler.
const Compiler& compiler(int driver_version);

struct CompiledCode {
  std::vector<char> bytes;  // an image for the driver, or assembler text with a final zero
  std::string problem;      // messages of the compiler after an error, or empty
};
// The kind of text: a Program or a SOURCE module, with or without contraction.
enum class Dialect { Program, Contracted, Source, ContractedSource };
// Returns the options that affect the result.
std::string compile_options(Dialect dialect);
// The compiler of a vendor, which the functions below call.
struct CompilerHook {
  void (*find)(Compiler& found, int driver_version);
  std::string (*options)(Dialect dialect);
  CompiledCode (*compile)(const std::string& source, int arch, Dialect dialect, bool as_text);
};
extern const CompilerHook kNvrtc;
// Runs `command CODE SOURCE` on files, for a vendor whose compiler is a program.
CompiledCode compile_by_command(const std::string& command, const std::string& source);
// Compiles for `arch` (90). The result is assembler text for the nearest older architecture if the
// compiler does not know `arch`, or if `as_text` is set.
CompiledCode compile(const std::string& source, int arch, Dialect dialect, bool as_text = false);

}  // namespace novaphy::gpu
