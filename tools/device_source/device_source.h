// The text of hand-written kernels that compilers of devices get, made from a header for the host.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace novaphy::device_source {

// A text with each header once, in place of its first include and after the headers it includes.
struct Source {
  std::string text;
  std::vector<std::filesystem::path> files;
};

// Reads `header` and its includes "novaphy/...", from the first folder that has the file. Leaves
// other includes out, except "<code>.inc", code that the build makes. Throws std::runtime_error,
// which names file and line, for an include that no folder has.
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

// Returns the text as string literals, of lengths that every compiler accepts. Code that the build
// makes comes from `<code>_source.inc`.
std::string as_literals(std::string_view text);

}  // namespace novaphy::device_source
