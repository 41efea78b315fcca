// Storage: one allocation on a device, shared by every view of it. Ranges: the byte ranges of an
// allocation that somebody looks at. A range carries a version, which every write to any
// overlapping range raises, so that a tape can tell that an input was overwritten.
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

// A byte range of an allocation. Two views of the same bytes share one Range.
class NOVAPHY_CORE_API Range {
 public:
  Storage& storage() const { return *storage_; }
  Device device() const { return device_; }
  size_t offset() const { return offset_; }
  size_t bytes() const { return bytes_; }
  void* data() const { return data_; }
  uint64_t version() const { return version_.load(std::memory_order_relaxed); }
  // Says that the bytes were written: raises the version of this and of every overlapping range.
  void mark_written();
  bool overlaps(const Range& other) const;
  // The first other range of the allocation that shares bytes with this one and passes the test, or
  // null.
  const Range* find_overlap(bool (*test)(const Range&, void* context), void* context) const;

  // Whoever attaches a gradient to a range keeps it here (the tensor runtime; core does not look
  // inside).
  std::shared_ptr<void> attachment;

  // A writable export (NumPy, DLPack) can change the bytes behind the engine's back for as long as
  // it lives: readers that depend on the value compare checksums. It counts for every overlapping
  // range, also for one that is made later. The first lasts for ever, the second as long as the
  // handle, which keeps the memory alive.
  void mark_writable_export();
  std::shared_ptr<void> writable_export_scope();
  // Whether one lives.
  bool writable_export() const { return living_exports_.load(std::memory_order_acquire) != 0; }
  // Whether one lives, or lived while the range had its present version.
  bool was_exported() const {
    const uint64_t now = version();
    return writable_export() || exported_version() == now ||
           export_end_.load(std::memory_order_acquire) == now;
  }
  uint64_t exports() const { return exports_.load(std::memory_order_relaxed); }  // so far
  // Of the value with which the first export of that version began.
  uint64_t exported_version() const { return exported_version_.load(std::memory_order_acquire); }
  uint64_t exported_checksum() const { return exported_checksum_; }
  // Of the bytes now; computed on their device.
  uint64_t checksum() const;

 private:
  friend class Storage;
  Storage* storage_ = nullptr;
  void* data_ = nullptr;
  size_t offset_ = 0, bytes_ = 0;
  Device device_;
  std::atomic<uint64_t> version_{0};
  void export_begins();  // this and what follows: under the storage's mutex
  void export_ends();
  int64_t own_exports_ = 0;                 // living ones of exactly this range
  std::atomic<int64_t> living_exports_{0};  // of this and of overlapping ranges
  std::atomic<uint64_t> exports_{0};
  std::atomic<uint64_t> exported_version_{UINT64_MAX};
  std::atomic<uint64_t> export_end_{UINT64_MAX};  // the version when the last one ended
  uint64_t exported_checksum_ = 0;
  std::atomic<bool> has_overlaps_{false};
  std::vector<Range*>
      overlaps_;  // the other ranges that share bytes with this one; guarded by the storage's mutex
};

class NOVAPHY_CORE_API Storage : public std::enable_shared_from_this<Storage> {
 public:
  // Allocates, zero filled, 256-byte aligned. Freed blocks are kept for reuse (see
  // release_cached_memory). `zeroed` false leaves the contents undefined: for memory that the next
  // launch writes in full.
  static std::shared_ptr<Storage> allocate(size_t bytes, Device device, bool zeroed = true);
  // Wraps memory that belongs to `owner`.
  static std::shared_ptr<Storage> external(void* data, size_t bytes, Device device,
                                           std::shared_ptr<void> owner);
  ~Storage();
  Storage(const Storage&) = delete;
  Storage& operator=(const Storage&) = delete;

  void* data() const { return data_; }
  size_t bytes() const { return bytes_; }
  Device device() const { return device_; }
  bool is_external() const { return external_; }
  // The Range of [offset, offset + bytes): found, or made. The handle keeps the storage alive.
  // ErrorKind::Index when it does not lie inside.
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

// Gives the blocks that freed storages left for reuse back to the device.
NOVAPHY_CORE_API void release_cached_memory();

// Watches what happens to arrays on the current thread: the tensor runtime's tape and capture
// install one.
class NOVAPHY_CORE_API ArrayObserver {
 public:
  virtual ~ArrayObserver();
  // The bytes are about to be read by the host (numpy(), item(), ...).
  virtual void host_read(const char* what) = 0;
  // A write that is no recorded launch is about to happen (host assignment, clear, a forward
  // solver, ...).
  virtual void untracked_write(Range& target, const char* what) = 0;
  // A device copy of the whole of source to target is wanted; returns true when the observer did it
  // itself.
  virtual bool copy(const std::shared_ptr<Range>& target, const std::shared_ptr<Range>& source,
                    bool is_float) = 0;
  // An operation that this thread may not record or differentiate is about to run, e.g. a forward
  // solver's step.
  virtual void untracked_operation(const char* what) = 0;
};
NOVAPHY_CORE_API ArrayObserver* array_observer();  // of this thread, or null
NOVAPHY_CORE_API ArrayObserver* set_array_observer(
    ArrayObserver* observer);  // returns the one before

// While one is alive no tape or capture follows what this thread does: for writes to memory that
// nobody else has seen yet, and host reads of what stays as it is while a capture records.
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
