// Internal to core: events as a file that chrome://tracing and ui.perfetto.dev read.
#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <string_view>

namespace novaphy {

// The file is valid JSON from the beginning on, whenever the process ends: a write replaces the end
// of the array. Events are kept back to be written many at a time.
class TraceFile {
 public:
  explicit TraceFile(const char* path);  // throws ErrorKind::Value when it cannot be written
  TraceFile(const TraceFile&) = delete;
  TraceFile& operator=(const TraceFile&) = delete;
  // Times in nanoseconds. By any thread; ignored in a child process, whose parent has the file.
  void add(std::string_view name, int64_t rows, std::string_view device, int64_t begin,
           int64_t end) noexcept;
  void flush() noexcept;

 private:
  void write();  // under the lock

  std::mutex mutex_;
  int file_ = -1;
  int64_t offset_ = 0;  // of the end of the array
  std::string kept_;    // events that are not written yet
  const int32_t process_;
};

}  // namespace novaphy
