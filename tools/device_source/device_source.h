// The text of hand-written kernels that compilers of devices get, made from a header for the host.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace novaphy::device_source {

// Headers in the place of their includes, each once, behind those that they include.
struct Source {
  std::string text;
  std::vector<std::filesystem::path> files;
};

// Reads `header` and what it includes as "novaphy/...", from the first of the folders that has it.
// Other includes are left out, but for "<code>.inc", code that the build makes. Throws
// std::runtime_error, which names file and line, for an include that no folder has.
Source read_source(const std::filesystem::path& header,
                   const std::vector<std::filesystem::path>& folders);

// The text of one header in the C++17 of devices: no includes, no defaulted comparison (devices
// compare Vec3 only), no concept (they call formulas with floats only).
std::string device_code(std::string_view text);

// A line `// kernel NAME WORDS NOVAPHY_ROW` (or NOVAPHY_BLOCK) for each declaration of a kernel.
// WORDS is 0 where the launch gives the words.
std::string kernel_lines(std::string_view text);

// The text with `#include "<code>.inc"`, for compilers of files.
std::string with_includes(std::string_view text);

// The text as string literals of lengths that every compiler takes; the code that the build makes
// comes from `<code>_source.inc`.
std::string as_literals(std::string_view text);

}  // namespace novaphy::device_source
