#include "code_cache.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <charconv>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "compiler.h"
#include "vendor.h"

namespace novaphy::gpu {
namespace {

namespace fs = std::filesystem;

struct Header {
  char magic[8];
  uint64_t key_a, key_b;
  uint64_t bytes;
  uint64_t checksum;
};
constexpr char kMagic[8] = {'N', 'V', 'P', 'H', 'C', 'O', 'D', '1'};
constexpr uint64_t kDefaultLimit = 256, kMaxEntry = uint64_t{1} << 28;

uint64_t hash_bytes(const char* data, size_t bytes, uint64_t seed) {
  uint64_t h = seed;
  for (size_t k = 0; k < bytes; ++k) {
    h = (h ^ static_cast<unsigned char>(data[k])) * 0x100000001B3ull;
    h ^= h >> 29;
  }
  return h;
}

bool write_all(int file, const void* data, size_t bytes) {
  const char* p = static_cast<const char*>(data);
  while (bytes != 0) {
    const ssize_t written = ::write(file, p, bytes);
    if (written <= 0) return false;
    p += written;
    bytes -= static_cast<size_t>(written);
  }
  return true;
}

std::string default_folder() {
  if (const char* own = std::getenv("NOVAPHY_CACHE_DIR"); own != nullptr && *own != '\0')
    return std::strcmp(own, "off") == 0 ? std::string() : std::string(own);
  if (const char* cache = std::getenv("XDG_CACHE_HOME"); cache != nullptr && cache[0] == '/')
    return std::string(cache) + "/novaphy";
  if (const char* home = std::getenv("HOME"); home != nullptr && home[0] == '/')
    return std::string(home) + "/.cache/novaphy";
  return {};
}

uint64_t default_limit() {
  if (const char* text = std::getenv("NOVAPHY_CACHE_MB"); text != nullptr && *text != '\0') {
    const char* const end = text + std::strlen(text);
    uint64_t megabytes = 0;
    const auto [stop, code] = std::from_chars(text, end, megabytes);
    if (code == std::errc() && stop == end && megabytes < (1u << 20)) return megabytes << 20;
  }
  return kDefaultLimit << 20;
}

}  // namespace

CodeKey code_key(const std::string& text) {
  return {hash_bytes(text.data(), text.size(), 0xCBF29CE484222325ull),
          hash_bytes(text.data(), text.size(), 0x9E3779B97F4A7C15ull)};
}

CodeKey ahead_key(const std::string& source, Dialect dialect) {
  return code_key(compile_options(dialect) + "\n" + source);
}
CodeKey disk_key(const std::string& source, Dialect dialect, int arch) {
  const Compiler& c = compiler(driver().version);
  return code_key(compile_options(dialect) + " " + arch_name(arch) + " " + c.name + "\n" + source);
}

CodeCache& CodeCache::get() {
  static CodeCache* const cache = new CodeCache(default_folder(), default_limit());
  return *cache;
}

CodeCache::CodeCache(std::string folder, uint64_t limit_bytes)
    : folder_(std::move(folder)), limit_(limit_bytes) {
  if (folder_.empty()) return;
  std::error_code failed;
  fs::create_directories(folder_, failed);
  if (failed) folder_.clear();
}

std::string CodeCache::path_of(const CodeKey& key) const {
  char name[48];
  std::snprintf(name, sizeof(name), "/%016llx%016llx.code", static_cast<unsigned long long>(key.a),
                static_cast<unsigned long long>(key.b));
  return folder_ + name;
}

bool CodeCache::find(const CodeKey& key, std::vector<char>& code) {
  if (folder_.empty()) return false;
  const std::string path = path_of(key);
  const int file = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (file < 0) return false;
  Header header{};
  bool good = ::read(file, &header, sizeof(header)) == static_cast<ssize_t>(sizeof(header)) &&
              std::memcmp(header.magic, kMagic, sizeof(kMagic)) == 0 && header.key_a == key.a &&
              header.key_b == key.b && header.bytes <= kMaxEntry;
  if (good) {
    code.resize(header.bytes);
    size_t have = 0;
    while (have < code.size()) {
      const ssize_t got = ::read(file, code.data() + have, code.size() - have);
      if (got <= 0) break;
      have += static_cast<size_t>(got);
    }
    good = have == code.size() && hash_bytes(code.data(), code.size(), key.a) == header.checksum;
  }
  if (good) {
    ::futimens(file, nullptr);  // marks the file as recently used
  } else {
    code.clear();
    ::unlink(path.c_str());
  }
  ::close(file);
  return good;
}

void CodeCache::store(const CodeKey& key, const std::vector<char>& code) {
  if (folder_.empty() || code.size() > std::min(kMaxEntry, limit_)) return;
  static std::atomic<uint32_t> counter{0};
  const std::string path = path_of(key);
  const std::string draft =
      path + "." + std::to_string(::getpid()) + "." + std::to_string(counter.fetch_add(1)) + ".new";
  const int file = ::open(draft.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (file < 0) return;
  Header header{};
  std::memcpy(header.magic, kMagic, sizeof(kMagic));
  header.key_a = key.a;
  header.key_b = key.b;
  header.bytes = code.size();
  header.checksum = hash_bytes(code.data(), code.size(), key.a);
  bool good = write_all(file, &header, sizeof(header)) && write_all(file, code.data(), code.size());
  good = ::close(file) == 0 && good;
  if (!good || ::rename(draft.c_str(), path.c_str()) != 0) {
    ::unlink(draft.c_str());
    return;
  }
  // The folder is cleaned only sometimes: a scan of the folder is slow, and the limit is
  // approximate.
  static std::atomic<uint32_t> stored{0};
  if (stored.fetch_add(1) % 64 == 0) make_room();
}

void CodeCache::make_room() {
  struct File {
    fs::file_time_type used;
    uint64_t bytes;
    fs::path path;
  };
  std::vector<File> files;
  uint64_t total = 0;
  std::error_code failed;
  for (const auto& entry : fs::directory_iterator(folder_, failed)) {
    std::error_code gone;  // another process may remove the file at the same time
    const std::string name = entry.path().filename().string();
    if (name.find(".code") == std::string::npos) continue;
    const uint64_t bytes = entry.file_size(gone);
    if (gone) continue;
    const auto used = entry.last_write_time(gone);
    if (gone) continue;
    total += bytes;
    files.push_back({used, bytes, entry.path()});
  }
  if (total <= limit_) return;
  std::sort(files.begin(), files.end(),
            [](const File& x, const File& y) { return x.used < y.used; });
  for (const File& file : files) {
    if (total <= limit_ / 4 * 3) break;
    std::error_code gone;
    fs::remove(file.path, gone);
    total -= file.bytes;
  }
}

}  // namespace novaphy::gpu
