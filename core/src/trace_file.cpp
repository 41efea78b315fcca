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

constexpr size_t kBufferBytes = 1 << 16;
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
  buffer_.reserve(kBufferBytes + 1024);
  char name[128];
  std::snprintf(name, sizeof(name),
                "[\n{\"name\":\"process_name\",\"ph\":\"M\",\"pid\":%" PRId32
                ",\"args\":{\"name\":\"novaphy\"}}",
                process_);
  buffer_ = name;
  write();
}

void TraceFile::add(std::string_view name, int64_t rows, std::string_view device, int64_t begin,
                    int64_t end) noexcept {
  const std::lock_guard lock(mutex_);
  if (getpid() != process_) return;
  try {
    buffer_ += ",\n{\"name\":\"";
    append_escaped(buffer_, name);
    char rest[256];
    std::snprintf(rest, sizeof(rest),
                  "\",\"cat\":\"launch\",\"ph\":\"X\",\"ts\":%.3f,\"dur\":%.3f,\"pid\":%" PRId32
                  ",\"tid\":%" PRId32 ",\"args\":{\"rows\":%" PRId64 ",\"device\":\"%.*s\"}}",
                  microseconds(begin), microseconds(end - begin), process_, this_thread(), rows,
                  static_cast<int>(device.size()), device.data());
    buffer_ += rest;
    if (buffer_.size() >= kBufferBytes) write();
  } catch (...) {  // no memory: the event is dropped
    buffer_.clear();
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
  const size_t events = buffer_.size();
  buffer_ += kEnd;
  const ssize_t written = pwrite(file_, buffer_.data(), buffer_.size(), offset_);
  // On a full disk a partial write is repeated with the next events.
  if (written == static_cast<ssize_t>(buffer_.size())) {
    offset_ += static_cast<int64_t>(events);
    buffer_.clear();
  } else {
    buffer_.resize(events);
  }
}

}  // namespace novaphy
