// Checks of a plugin file that dlopen does not make before it maps the file. A truncated file ends
// the process with SIGBUS when a page beyond its end is touched. A FIFO would block.
#include <fcntl.h>
#include <link.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <utility>

#include "registry.h"

namespace novaphy {
namespace {

using Header = ElfW(Ehdr);
using Segment = ElfW(Phdr);

class File {
 public:
  // O_NONBLOCK: opening a FIFO does not wait for a writer.
  explicit File(const std::filesystem::path& path)
      : fd_(open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK)) {}
  ~File() {
    if (fd_ >= 0) close(fd_);
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  bool status(struct stat& to) const { return fd_ >= 0 && fstat(fd_, &to) == 0; }
  template <class T>
  bool read(T& to, uint64_t offset) const {
    return std::in_range<off_t>(offset) &&
           pread(fd_, &to, sizeof(T), static_cast<off_t>(offset)) == ssize_t{sizeof(T)};
  }

 private:
  int fd_;
};

bool is_native(const Header& header) {
  constexpr unsigned char kClass = sizeof(void*) == 8 ? ELFCLASS64 : ELFCLASS32;
  return std::memcmp(header.e_ident, ELFMAG, SELFMAG) == 0 && header.e_ident[EI_CLASS] == kClass &&
         header.e_phentsize == sizeof(Segment);
}

// Returns the end of the last segment or table that the ELF headers describe, which is the length
// of a complete file.
uint64_t described_end(const File& file, const Header& header, uint64_t length) {
  uint64_t end = 0;
  const auto include = [&](uint64_t offset, uint64_t bytes) {
    uint64_t past = 0;
    if (__builtin_add_overflow(offset, bytes, &past)) past = UINT64_MAX;
    if (bytes != 0 && past > end) end = past;
  };
  include(header.e_phoff, uint64_t{header.e_phnum} * header.e_phentsize);
  include(header.e_shoff, uint64_t{header.e_shnum} * header.e_shentsize);
  if (end > length) return end;
  for (size_t k = 0; k < header.e_phnum; ++k) {
    Segment segment;
    if (!file.read(segment, header.e_phoff + k * sizeof(segment))) return UINT64_MAX;
    include(segment.p_offset, segment.p_filesz);
  }
  return end;
}

}  // namespace

std::string plugin_file_problem(const std::filesystem::path& path) {
  const File file(path);
  struct stat status {};
  if (!file.status(status)) return std::strerror(errno);
  if (!S_ISREG(status.st_mode)) return "not a regular file";
  Header header;
  if (!file.read(header, 0) || !is_native(header)) return {};  // dlopen reports such a file
  const auto length = static_cast<uint64_t>(status.st_size);
  const uint64_t end = described_end(file, header, length);
  if (end <= length) return {};
  return "truncated: the file has " + std::to_string(length) + " bytes, its headers describe " +
         std::to_string(end);
}

}  // namespace novaphy
