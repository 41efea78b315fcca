#include "novaphy/core/storage.h"

#include <algorithm>
#include <utility>

#include "allocator.h"
#include "novaphy/core/assert.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"

namespace novaphy {
namespace {

thread_local ArrayObserver* t_observer = nullptr;

// The pattern that fills memory with undefined contents. 0 means that the memory is not filled.
#ifdef NOVAPHY_DEBUG
constexpr uint64_t kPoison = 0x7fa0'0000'7fa0'0000;  // two signaling NaNs
#else
constexpr uint64_t kPoison = 0;
#endif

bool overlap(size_t offset_a, size_t bytes_a, size_t offset_b, size_t bytes_b) {
  return offset_a < offset_b + bytes_b && offset_b < offset_a + bytes_a && bytes_a != 0 &&
         bytes_b != 0;
}

}  // namespace

void Range::mark_written() {
  version_.fetch_add(1, std::memory_order_relaxed);
  if (!has_overlaps_.load(std::memory_order_acquire)) return;
  const std::lock_guard lock(storage_->mutex_);
  for (Range* other : overlaps_) other->version_.fetch_add(1, std::memory_order_relaxed);
}

bool Range::overlaps(const Range& other) const {
  return storage_ == other.storage_ && overlap(offset_, bytes_, other.offset_, other.bytes_);
}

const Range* Range::find_overlap(bool (*test)(const Range&, void*), void* context) const {
  if (!has_overlaps_.load(std::memory_order_acquire)) return nullptr;
  const std::lock_guard lock(storage_->mutex_);
  for (const Range* other : overlaps_)
    if (test(*other, context)) return other;
  return nullptr;
}

void Range::mark_writable_export() { storage_->begin_export(*this); }

std::shared_ptr<void> Range::writable_export_scope() {
  storage_->begin_export(*this);
  return {this,
          [storage = storage_->shared_from_this()](Range* range) { storage->end_export(*range); }};
}

void Range::export_begins() {
  // The first export of a version records the checksum. When a later export begins, the bytes may
  // have changed already.
  if (!was_exported()) {
    exported_checksum_ = checksum();
    exported_version_.store(version(), std::memory_order_release);
  }
  exports_.fetch_add(1, std::memory_order_relaxed);
  living_exports_.fetch_add(1, std::memory_order_release);
}

void Range::export_ends() {
  export_end_.store(version(), std::memory_order_release);
  living_exports_.fetch_sub(1, std::memory_order_release);
}

void Storage::begin_export(Range& range) {
  const std::lock_guard lock(mutex_);
  range.export_begins();
  ++range.own_exports_;
  for (Range* other : range.overlaps_) other->export_begins();
}

void Storage::end_export(Range& range) {
  const std::lock_guard lock(mutex_);
  --range.own_exports_;
  range.export_ends();
  for (Range* other : range.overlaps_) other->export_ends();
}

std::shared_ptr<Storage> Storage::allocate(size_t bytes, Device device, bool zeroed) {
  const DeviceContext& context = device_context(device);
  std::shared_ptr<Storage> storage(new Storage);
  storage->device_ = device;
  storage->bytes_ = bytes;
  storage->data_ = Allocator::get().allocate(context, bytes);
  if (bytes != 0 && (zeroed || kPoison != 0)) {
    novaphy_error error = make_error();
    // Fills whole 8-byte words, since a block is a multiple of 8 bytes.
    check(context.api->memory_fill(context.stream, storage->data_, zeroed ? 0 : kPoison, 8,
                                   (bytes + 7) / 8 * 8, &error),
          error, "Storage.allocate");
  }
  return storage;
}

std::shared_ptr<Storage> Storage::external(void* data, size_t bytes, Device device,
                                           std::shared_ptr<void> owner) {
  require(data != nullptr || bytes == 0, ErrorKind::Value,
          "Storage.external: expected a pointer for ", bytes, " bytes, got null");
  device_context(device);
  std::shared_ptr<Storage> storage(new Storage);
  storage->device_ = device;
  storage->data_ = data;
  storage->bytes_ = bytes;
  storage->external_ = true;
  storage->owner_ = std::move(owner);
  return storage;
}

Storage::~Storage() {
  // Attached gradients are destroyed first, because they may use the storage.
  for (const auto& range : ranges_) range->attachment.reset();
  if (!external_ && data_ != nullptr)
    Allocator::get().release(device_context(device_), data_, bytes_);
}

std::shared_ptr<Range> Storage::range(size_t offset, size_t bytes) {
  require(offset <= bytes_ && bytes <= bytes_ - offset, ErrorKind::Index,
          "Storage.range: expected a range inside of ", bytes_, " bytes, got offset ", offset,
          " and ", bytes, " bytes");
  const std::lock_guard lock(mutex_);
  const auto before = [](const std::unique_ptr<Range>& r, const std::pair<size_t, size_t>& key) {
    return std::pair(r->offset_, r->bytes_) < key;
  };
  auto at = std::lower_bound(ranges_.begin(), ranges_.end(), std::pair(offset, bytes), before);
  if (at == ranges_.end() || (*at)->offset_ != offset || (*at)->bytes_ != bytes) {
    auto made = std::make_unique<Range>();
    made->storage_ = this;
    made->data_ = static_cast<unsigned char*>(data_) + offset;
    made->offset_ = offset;
    made->bytes_ = bytes;
    made->device_ = device_;
    int64_t exports = external_ ? 1 : 0;  // the owner of external memory can write it at any time
    for (const auto& other : ranges_) {
      if (!made->overlaps(*other)) continue;
      made->overlaps_.push_back(other.get());
      other->overlaps_.push_back(made.get());
      other->has_overlaps_.store(true, std::memory_order_release);
      exports += other->own_exports_;
    }
    made->has_overlaps_.store(!made->overlaps_.empty(), std::memory_order_release);
    for (; exports > 0; --exports) made->export_begins();
    at = ranges_.insert(at, std::move(made));
    NOVAPHY_ASSERT(std::is_sorted(ranges_.begin(), ranges_.end(), [](const auto& a, const auto& b) {
      return std::pair(a->offset_, a->bytes_) < std::pair(b->offset_, b->bytes_);
    }));
  }
  return std::shared_ptr<Range>(shared_from_this(), at->get());
}

void release_cached_memory() { Allocator::get().release_cached(); }

ArrayObserver::~ArrayObserver() = default;
ArrayObserver* array_observer() { return t_observer; }
ArrayObserver* set_array_observer(ArrayObserver* observer) {
  return std::exchange(t_observer, observer);
}

}  // namespace novaphy
