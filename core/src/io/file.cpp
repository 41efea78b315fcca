#include "novaphy/core/io/file.h"

#include <cerrno>
#include <cstring>
#include <fstream>
#include <iterator>

#include "novaphy/core/error.h"

namespace novaphy {

std::string read_file(std::string_view function, const std::filesystem::path& path) {
  std::error_code ignored;
  // A folder can be opened like a file; only reading it fails.
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
  // What has no size, as a pipe, or grows.
  if (!file.eof()) bytes.append(std::istreambuf_iterator<char>(file), {});
  require(!file.bad(), ErrorKind::Value, function, ": ", path.string(), ": reading it failed");
  return bytes;
}

}  // namespace novaphy
