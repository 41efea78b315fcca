#include "trace_file.h"

#include <fcntl.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <cerrno>
#include <cinttypes>
#include <cstdio>
#include <cstring>

#include "novaphy/core/error.h"

namespace novaphy {
namespace {

constexpr size_t kKeptBytes = 1 << 16;
constexpr std::string_view kEnd = "\n]\n";

int32_t this_thread() {
  thread_local const auto id = static_cast<int32_t>(syscall(SYS_gettid));
  return id;
}

void append_escaped(std::string& text, std::string_view part) {
  for (const char c : part) {
    if (c == '"' || c == '\\') text += '\\';
    text += static_cast<unsigned char>(c) < ' ' ? ' ' : c;
  }
}

double microseconds(int64_t nanoseconds) { return static_cast<double>(nanoseconds) * 1e-3; }

}  // namespace

TraceFile::TraceFile(const char* path) : process_(getpid()) {
  file_ = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
  require(file_ >= 0, ErrorKind::Value,
          "NOVAPHY_TRACE: expected a file that can be written, got \"", path,
          "\": ", std::strerror(errno));
  kept_.reserve(kKeptBytes + 1024);
  char name[128];
  std::snprintf(name, sizeof(name),
                "[\n{\"name\":\"process_name\",\"ph\":\"M\",\"pid\":%" PRId32
                ",\"args\":{\"name\":\"novaphy\"}}",
                process_);
  kept_ = name;
  write();
}

void TraceFile::add(std::string_view name, int64_t rows, std::string_view device, int64_t begin,
                    int64_t end) noexcept {
  const std::lock_guard lock(mutex_);
  if (getpid() != process_) return;
  try {
    kept_ += ",\n{\"name\":\"";
    append_escaped(kept_, name);
    char rest[256];
    std::snprintf(rest, sizeof(rest),
                  "\",\"cat\":\"launch\",\"ph\":\"X\",\"ts\":%.3f,\"dur\":%.3f,\"pid\":%" PRId32
                  ",\"tid\":%" PRId32 ",\"args\":{\"rows\":%" PRId64 ",\"device\":\"%.*s\"}}",
                  microseconds(begin), microseconds(end - begin), process_, this_thread(), rows,
                  static_cast<int>(device.size()), device.data());
    kept_ += rest;
    if (kept_.size() >= kKeptBytes) write();
  } catch (...) {  // no memory: the event is dropped
    kept_.clear();
  }
}

void TraceFile::flush() noexcept {
  const std::lock_guard lock(mutex_);
  if (getpid() != process_) return;
  try {
    write();
  } catch (...) {
  }
}

void TraceFile::write() {
  const size_t events = kept_.size();
  kept_ += kEnd;
  const ssize_t written = pwrite(file_, kept_.data(), kept_.size(), offset_);
  // On a full disk a partial write is repeated with the next events.
  if (written == static_cast<ssize_t>(kept_.size())) {
    offset_ += static_cast<int64_t>(events);
    kept_.clear();
  } else {
    kept_.resize(events);
  }
}

}  // namespace novaphy
