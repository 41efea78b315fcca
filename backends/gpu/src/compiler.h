// Compilers at run time: a library of the vendor (NVRTC), opened like the driver, a command, or
// none.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace novaphy::gpu {

struct Compiler {
  int major = 0, minor = 0;
  std::string name;  // with the version: what decides about the code besides its text and options
  std::string path;  // of the library, or how it was found
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
// What a vendor has; the functions that follow call it.
struct CompilerHook {
  void (*find)(Compiler& found, int driver_version);
  std::string (*options)(Dialect dialect);
  CompiledCode (*compile)(const std::string& source, int arch, Dialect dialect, bool as_text);
};
extern const CompilerHook kNvrtc;
// Of a vendor with a compiler that is a program: runs `command CODE SOURCE` on files.
CompiledCode compile_by_command(const std::string& command, const std::string& source);
// For `arch` (90), or as assembler text: for the nearest older one when the compiler does not know
// `arch`, or when `as_text` asks for it.
CompiledCode compile(const std::string& source, int arch, Dialect dialect, bool as_text = false);

}  // namespace novaphy::gpu
