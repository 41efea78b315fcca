// Internal to core: writes events to a file for chrome://tracing and ui.perfetto.dev.
#pragma once

#include <cstdint>
#include <mutex>
#include <string>
#include <string_view>

namespace novaphy {

// The file is valid JSON at any time, even if the process ends early, because each write replaces
// the closing bracket. Events are buffered.
class TraceFile {
 public:
  explicit TraceFile(const char* path);  // throws ErrorKind::Value if the file cannot be written
  TraceFile(const TraceFile&) = delete;
  TraceFile& operator=(const TraceFile&) = delete;
  // Adds an event; times are in nanoseconds. Any thread may call this function. Calls in a child
  // process after fork are ignored, because the file belongs to the parent.
  void add(std::string_view name, int64_t rows, std::string_view device, int64_t begin,
           int64_t end) noexcept;
  void flush() noexcept;

 private:
  void write();  // needs the lock

  std::mutex mutex_;
  int file_ = -1;
  int64_t offset_ = 0;  // end of the array in the file
  std::string buffer_;  // buffered events, not yet in the file
  const int32_t process_;
};

}  // namespace novaphy
