// novaphy_device_source FOLDER HEADER INCLUDE_FOLDER...
//
// Writes three files from the kernels of a header. FOLDER/<name>.cuh has the code for compilers of
// devices. FOLDER/<name>_source.cpp has the function novaphy::detail::<name>_source(), which
// returns this code as text. FOLDER/<name>.d has the dependencies of both files.
#include <cstdio>
#include <exception>
#include <fstream>
#include <stdexcept>

#include "device_source.h"

namespace {

namespace fs = std::filesystem;
using namespace novaphy::device_source;

void write(const fs::path& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  file.close();
  if (!file) throw std::runtime_error("device_source: cannot write " + path.string());
}

// Returns a path in the syntax of a dependency file (makefile).
std::string escaped(const fs::path& path) {
  std::string result;
  for (const char c : path.string()) {
    if (c == ' ' || c == '#') result += '\\';
    if (c == '$') result += '$';
    result += c;
  }
  return result;
}

void write_all(const fs::path& folder, const fs::path& header,
               const std::vector<fs::path>& folders) {
  const Source source = read_source(header, folders);
  const std::string kernels = kernel_lines(source.text);
  if (kernels.empty())
    throw std::runtime_error(header.string() +
                             ": expected a NOVAPHY_ROW_KERNEL(name, ...), got none");
  const std::string name = header.stem().string();
  const fs::path cuh = folder / (name + ".cuh");
  const fs::path text = folder / (name + "_source.cpp");
  write(cuh, kernels + with_includes(source.text));
  const std::string function = "const char* " + name + "_source()";
  write(text, "// Written by tools/device_source.\nnamespace novaphy::detail {\n" + function +
                  ";\n" + function + " {\n  return " + as_literals(kernels + source.text) +
                  ";\n}\n}  // namespace novaphy::detail\n");
  std::string rule = escaped(cuh) + " " + escaped(text) + ":";
  for (const fs::path& path : source.files) rule += " \\\n  " + escaped(path);
  write(folder / (name + ".d"), rule + "\n");
}

}  // namespace

int main(int count, char** arguments) {
  if (count < 4) {
    std::fprintf(stderr, "usage: novaphy_device_source FOLDER HEADER INCLUDE_FOLDER...\n");
    return 2;
  }
  try {
    write_all(arguments[1], arguments[2], {arguments + 3, arguments + count});
  } catch (const std::exception& error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 1;
  }
  return 0;
}
