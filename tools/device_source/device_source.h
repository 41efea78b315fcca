// Makes the source code of hand-written kernels for compilers of devices from a header for the
// host.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace novaphy::device_source {

// A text that has each header once, in place of its first include, and after the headers that it
// includes.
struct Source {
  std::string text;
  std::vector<std::filesystem::path> files;
};

// Reads `header` and its includes "novaphy/...", each from the first folder that has the file.
// Drops other includes, except "<code>.inc" (code that the build makes). Throws std::runtime_error
// with file and line for an include that no folder has.
Source read_source(const std::filesystem::path& header,
                   const std::vector<std::filesystem::path>& folders);

// Returns the text of one header as C++17 for devices: without includes, without defaulted
// comparisons (devices compare only Vec3), and without concepts (devices use formulas only with
// floats).
std::string device_code(std::string_view text);

// Returns a line `// kernel NAME WORDS NOVAPHY_ROW` (or NOVAPHY_BLOCK) for each declaration of a
// kernel. WORDS is the number of argument words, or 0 if the launch gives the number.
std::string kernel_lines(std::string_view text);

// Returns the text with `#include "<code>.inc"`, for compilers that read files.
std::string with_includes(std::string_view text);

// Returns the text as string literals whose lengths every compiler accepts. Code that the build
// makes becomes an include of `<code>_source.inc`.
std::string as_literals(std::string_view text);

}  // namespace novaphy::device_source
