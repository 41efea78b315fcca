// Storage: one allocation on a device, shared by all of its views. Range: a byte range of an
// allocation that a view uses. Every write to a range raises the version of each overlapping range.
// A tape uses the version to detect an overwritten input.
#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <vector>

#include "novaphy/core/device.h"
#include "novaphy/core/export.h"

namespace novaphy {

class Storage;

// A byte range of an allocation. Two views of the same bytes share one Range object.
class NOVAPHY_CORE_API Range {
 public:
  Storage& storage() const { return *storage_; }
  Device device() const { return device_; }
  size_t offset() const { return offset_; }
  size_t bytes() const { return bytes_; }
  void* data() const { return data_; }
  uint64_t version() const { return version_.load(std::memory_order_relaxed); }
  // Records a write: raises the version of this range and of every overlapping range.
  void mark_written();
  bool overlaps(const Range& other) const;
  // Returns the first other range of the allocation that overlaps this range and passes `test`, or
  // null.
  const Range* find_overlap(bool (*test)(const Range&, void* context), void* context) const;

  // The gradient of this range. The tensor runtime (nova) sets the pointer; core does not read it.
  std::shared_ptr<void> attachment;

  // Records a writable export: memory that NumPy or DLPack may write. The holder of an export can
  // change the bytes without a new version, so readers compare checksums while an export lives. An
  // export counts for every overlapping range, also for ranges that are made later. The export of
  // mark_writable_export never ends. The export of writable_export_scope ends with the returned
  // handle, which keeps the memory alive.
  void mark_writable_export();
  std::shared_ptr<void> writable_export_scope();
  // Returns whether a writable export exists.
  bool writable_export() const { return living_exports_.load(std::memory_order_acquire) != 0; }
  // Returns whether a writable export exists, or existed at the present version.
  bool was_exported() const {
    const uint64_t now = version();
    return writable_export() || exported_version() == now ||
           export_end_.load(std::memory_order_acquire) == now;
  }
  // number of exports so far, ended ones included
  uint64_t exports() const { return exports_.load(std::memory_order_relaxed); }
  // The version of the range when the first export of that version began; exported_checksum() is
  // the checksum at that time.
  uint64_t exported_version() const { return exported_version_.load(std::memory_order_acquire); }
  uint64_t exported_checksum() const { return exported_checksum_; }
  // Returns the checksum of the present bytes, computed on their device.
  uint64_t checksum() const;

 private:
  friend class Storage;
  Storage* storage_ = nullptr;
  void* data_ = nullptr;
  size_t offset_ = 0, bytes_ = 0;
  Device device_;
  std::atomic<uint64_t> version_{0};
  void export_begins();  // these functions need the storage's mutex
  void export_ends();
  int64_t own_exports_ = 0;                 // living exports of exactly this range
  std::atomic<int64_t> living_exports_{0};  // living exports of this and of overlapping ranges
  std::atomic<uint64_t> exports_{0};
  std::atomic<uint64_t> exported_version_{UINT64_MAX};
  std::atomic<uint64_t> export_end_{UINT64_MAX};  // version when the last export ended
  uint64_t exported_checksum_ = 0;
  std::atomic<bool> has_overlaps_{false};
  std::vector<Range*>
      overlaps_;  // the other ranges that share bytes with this one; guarded by the storage's mutex
};

class NOVAPHY_CORE_API Storage : public std::enable_shared_from_this<Storage> {
 public:
  // Allocates memory filled with zeros, aligned to 256 bytes. Freed blocks are kept for reuse (see
  // release_cached_memory). `zeroed` false leaves the contents undefined, for memory that the next
  // launch overwrites completely.
  static std::shared_ptr<Storage> allocate(size_t bytes, Device device, bool zeroed = true);
  // Makes a Storage of existing memory, which `owner` keeps alive.
  static std::shared_ptr<Storage> external(void* data, size_t bytes, Device device,
                                           std::shared_ptr<void> owner);
  ~Storage();
  Storage(const Storage&) = delete;
  Storage& operator=(const Storage&) = delete;

  void* data() const { return data_; }
  size_t bytes() const { return bytes_; }
  Device device() const { return device_; }
  bool is_external() const { return external_; }
  // Returns the Range [offset, offset + bytes). The first call makes the Range. The handle keeps
  // the storage alive. ErrorKind::Index: the range does not lie inside the allocation.
  std::shared_ptr<Range> range(size_t offset, size_t bytes);
  std::shared_ptr<Range> range() { return range(0, bytes_); }

 private:
  Storage() = default;
  friend class Range;
  void begin_export(Range& range);
  void end_export(Range& range);

  Device device_;
  void* data_ = nullptr;
  size_t bytes_ = 0;
  bool external_ = false;
  std::shared_ptr<void> owner_;
  std::mutex mutex_;                            // guards ranges_
  std::vector<std::unique_ptr<Range>> ranges_;  // sorted by offset, then bytes
};

// Returns the cached blocks of freed storages to the device.
NOVAPHY_CORE_API void release_cached_memory();

// Observes reads and writes of arrays on the current thread. The tape and the capture of the tensor
// runtime install an observer.
class NOVAPHY_CORE_API ArrayObserver {
 public:
  virtual ~ArrayObserver();
  // The host is about to read the bytes (numpy(), item() and so on).
  virtual void host_read(const char* what) = 0;
  // A write that is not a recorded launch is about to happen, for example a host assignment,
  // clear() or a step of a forward solver.
  virtual void untracked_write(Range& target, const char* what) = 0;
  // A device copy of all of `source` to `target` is requested. Returns true if the observer made
  // the copy.
  virtual bool copy(const std::shared_ptr<Range>& target, const std::shared_ptr<Range>& source,
                    bool is_float) = 0;
  // An operation that cannot be recorded or differentiated is about to run, for example a step of a
  // forward solver.
  virtual void untracked_operation(const char* what) = 0;
};
NOVAPHY_CORE_API ArrayObserver* array_observer();  // this thread's observer, or null
NOVAPHY_CORE_API ArrayObserver* set_array_observer(
    ArrayObserver* observer);  // returns the previous observer

// Removes the observer of this thread for the lifetime of the object. Used for writes to memory
// that is not shared yet, and for host reads of values that stay constant while a capture records.
class UntrackedScope {
 public:
  UntrackedScope() : before_(set_array_observer(nullptr)) {}
  ~UntrackedScope() { set_array_observer(before_); }
  UntrackedScope(const UntrackedScope&) = delete;
  UntrackedScope& operator=(const UntrackedScope&) = delete;

 private:
  ArrayObserver* before_;
};

}  // namespace novaphy
