#include "novaphy/core/io/file.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>

#include "novaphy/core/error.h"

namespace novaphy {

std::string read_file(std::string_view function, const std::filesystem::path& path) {
  std::error_code ignored;
  // Opening a folder succeeds, and only reading it fails, so folders are checked here.
  require(!std::filesystem::is_directory(path, ignored), ErrorKind::Value, function, ": ",
          path.string(), ": expected a file, got a folder");
  errno = 0;
  std::ifstream file(path, std::ios::binary);
  require(file.is_open(), ErrorKind::Value, function, ": ", path.string(),
          ": expected a file that can be read, got: ", std::strerror(errno));
  std::string bytes;
  const std::uintmax_t size = std::filesystem::file_size(path, ignored);
  if (!ignored && size > 0 && size < (std::uintmax_t{1} << 32)) {
    bytes.resize(size);
    file.read(bytes.data(), static_cast<std::streamsize>(size));
    bytes.resize(static_cast<size_t>(file.gcount()));
  }
  // Reads the rest of a file without a known size, such as a pipe, or of a file that has grown.
  if (!file.eof()) bytes.append(std::istreambuf_iterator<char>(file), {});
  require(!file.bad(), ErrorKind::Value, function, ": ", path.string(), ": reading it failed");
  return bytes;
}

}  // namespace novaphy
