#include "novaphy/core/storage.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <utility>

#include "allocator.h"
#include "novaphy/core/backend.h"
#include "novaphy/core/error.h"

namespace novaphy {
namespace {

thread_local ArrayObserver* t_observer = nullptr;

uint64_t mix(uint64_t h) {
  h ^= h >> 32;
  h *= 0xD6E8FEB86659FD93ull;
  h ^= h >> 32;
  return h;
}

// Four independent lanes of multiply-and-rotate over 8-byte words (the rounds of xxHash64), so that
// the multiplications overlap. A word is multiplied before it enters, or a flipped top bit would
// look like a flipped bit of the word that follows.
uint64_t hash_bytes(const void* data, size_t bytes) {
  constexpr uint64_t kPrime = 0x9E3779B185EBCA87ull, kWordPrime = 0xC2B2AE3D27D4EB4Full;
  std::array<uint64_t, 4> lanes = {kPrime, ~kPrime, kPrime << 1, bytes};
  const auto* p = static_cast<const unsigned char*>(data);
  size_t left = bytes;
  std::array<uint64_t, 4> words;
  const auto round = [&] {
    for (size_t k = 0; k < 4; ++k) {
      lanes[k] += words[k] * kWordPrime;
      lanes[k] = ((lanes[k] << 31) | (lanes[k] >> 33)) * kPrime;
    }
  };
  for (; left >= sizeof(words); left -= sizeof(words), p += sizeof(words)) {
    std::memcpy(words.data(), p, sizeof(words));
    round();
  }
  if (left != 0) {
    words = {};
    std::memcpy(words.data(), p, left);
    round();
  }
  uint64_t h = bytes;
  for (const uint64_t lane : lanes) h = mix(h ^ lane) + kPrime;
  return mix(h);
}

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

void Range::mark_writable_export() {
  const std::lock_guard lock(storage_->mutex_);
  storage_->mark_exported(*this);
  for (Range* other : overlaps_) storage_->mark_exported(*other);
}

uint64_t Range::checksum() const {
  if (bytes_ == 0) return hash_bytes(nullptr, 0);
  const DeviceContext& context = device_context(storage_->device());
  novaphy_error error = make_error();
  if (context.host_accessible) {
    check(context.api->stream_synchronize(context.stream, &error), error, "checksum");
    return hash_bytes(data_, bytes_);
  }
  std::vector<unsigned char> host(bytes_);
  check(context.api->memory_copy(context.stream, NOVAPHY_COPY_DEVICE_TO_HOST, host.data(), data_,
                                 bytes_, &error),
        error, "checksum");
  return hash_bytes(host.data(), bytes_);
}

void Storage::mark_exported(Range& range) {
  if (range.writable_export())
    return;  // what the first export saw counts: a later one may come after a hidden write
  range.exported_version_ = range.version();
  range.exported_checksum_ = range.checksum();
  range.writable_export_.store(true, std::memory_order_release);
}

std::shared_ptr<Storage> Storage::allocate(size_t bytes, Device device, bool zeroed) {
  const DeviceContext& context = device_context(device);
  std::shared_ptr<Storage> storage(new Storage);
  storage->device_ = device;
  storage->bytes_ = bytes;
  storage->data_ = Allocator::get().allocate(context, bytes);
  if (bytes != 0 && zeroed) {
    novaphy_error error = make_error();
    // Whole words: a block is at least a multiple of 8 bytes.
    check(
        context.api->memory_fill(context.stream, storage->data_, 0, 8, (bytes + 7) / 8 * 8, &error),
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
  // Gradients that ranges carry go first: they may look at the storage.
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
    bool exported = external_;  // its owner can write it at any time
    for (const auto& other : ranges_) {
      if (!made->overlaps(*other)) continue;
      made->overlaps_.push_back(other.get());
      other->overlaps_.push_back(made.get());
      other->has_overlaps_.store(true, std::memory_order_release);
      exported = exported || other->writable_export();
    }
    made->has_overlaps_.store(!made->overlaps_.empty(), std::memory_order_release);
    if (exported) mark_exported(*made);
    at = ranges_.insert(at, std::move(made));
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
