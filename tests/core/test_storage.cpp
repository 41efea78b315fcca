#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <optional>
#include <thread>
#include <vector>

#include "novaphy/core/assert.h"
#include "novaphy/core/error.h"
#include "novaphy/core/exclusive_use.h"
#include "novaphy/core/storage.h"

namespace novaphy {
namespace {

TEST(Storage, IsAlignedAndZeroFilledAlsoWhenTheBlockIsReused) {
  void* first = nullptr;
  for (int round = 0; round < 3; ++round) {
    const auto storage = Storage::allocate(1000, Device::cpu());
    EXPECT_EQ(reinterpret_cast<uintptr_t>(storage->data()) % 256, 0u);
    if (round == 0) first = storage->data();
    if (round == 1) {
      EXPECT_EQ(storage->data(), first) << "freed blocks are kept";
    }
    auto* bytes = static_cast<unsigned char*>(storage->data());
    for (int k = 0; k < 1000; ++k) ASSERT_EQ(bytes[k], 0);
    std::memset(bytes, 0xAB, 1000);
    if (round == 1) release_cached_memory();
  }
}

// The preset debug finds reads of unwritten memory.
TEST(Storage, UndefinedMemoryHoldsSignalingNaNInADebugBuild) {
#ifdef NOVAPHY_DEBUG
  Storage::allocate(1000, Device::cpu());  // leaves a block of zeros behind
  const auto storage = Storage::allocate(1000, Device::cpu(), false);
  const auto* const words = static_cast<const uint32_t*>(storage->data());
  for (int k = 0; k < 250; ++k) ASSERT_EQ(words[k], 0x7fa00000u);
#else
  GTEST_SKIP() << "NOVAPHY_DEBUG is off";
#endif
}

TEST(Assert, ABrokenInvariantEndsTheProcessInADebugBuild) {
  int calls = 0;
  const auto broken = [&] { return ++calls < 0; };
#ifdef NOVAPHY_DEBUG
  EXPECT_DEATH(NOVAPHY_ASSERT(broken()), R"(NOVAPHY_ASSERT\(broken\(\)\) does not hold)");
#else
  NOVAPHY_ASSERT(broken());
#endif
  EXPECT_EQ(calls, 0) << "not evaluated here";
}

TEST(Storage, ZeroBytesAreLegal) {
  const auto storage = Storage::allocate(0, Device::cpu());
  EXPECT_EQ(storage->bytes(), 0u);
  EXPECT_EQ(storage->range()->bytes(), 0u);
  EXPECT_EQ(storage->range()->checksum(), storage->range()->checksum());
}

TEST(Storage, MoreMemoryThanThereIsIsAnError) {
  EXPECT_THROW(Storage::allocate(size_t{1} << 60, Device::cpu()), Error);
  EXPECT_THROW(Storage::allocate(~size_t{0}, Device::cpu()), Error);
}

TEST(Storage, WrapsExternalMemoryAndKeepsItsOwner) {
  auto owner = std::make_shared<std::vector<float>>(16, 1.0f);
  std::weak_ptr<std::vector<float>> watch = owner;
  auto storage = Storage::external(owner->data(), 64, Device::cpu(), owner);
  EXPECT_TRUE(storage->is_external());
  EXPECT_EQ(storage->data(), owner->data());
  owner.reset();
  EXPECT_FALSE(watch.expired());
  storage.reset();
  EXPECT_TRUE(watch.expired());
  EXPECT_THROW(Storage::external(nullptr, 4, Device::cpu(), nullptr), Error);
}

TEST(Range, TwoViewsOfTheSameBytesShareOne) {
  const auto storage = Storage::allocate(1024, Device::cpu());
  const auto a = storage->range(0, 64), b = storage->range(64, 64), again = storage->range(0, 64);
  EXPECT_EQ(a.get(), again.get());
  EXPECT_NE(a.get(), b.get());
  EXPECT_EQ(b->data(), static_cast<char*>(storage->data()) + 64);
  EXPECT_EQ(b->offset(), 64u);
}

TEST(Range, OutsideOfTheStorageIsAnError) {
  const auto storage = Storage::allocate(100, Device::cpu());
  EXPECT_NO_THROW(storage->range(100, 0));
  for (const auto& [offset, bytes] :
       {std::pair<size_t, size_t>{0, 101}, {101, 0}, {50, 51}, {~size_t{0}, 2}}) {
    try {
      storage->range(offset, bytes);
      ADD_FAILURE();
    } catch (const Error& error) {
      EXPECT_EQ(error.kind(), ErrorKind::Index);
    }
  }
}

TEST(Range, AWriteRaisesTheVersionOfEveryOverlappingRangeAndOfNoOther) {
  const auto storage = Storage::allocate(1000, Device::cpu());
  const auto whole = storage->range(), left = storage->range(0, 500),
             right = storage->range(500, 500), middle = storage->range(400, 200),
             empty = storage->range(450, 0);
  left->mark_written();
  EXPECT_EQ(left->version(), 1u);
  EXPECT_EQ(whole->version(), 1u);
  EXPECT_EQ(middle->version(), 1u);
  EXPECT_EQ(right->version(), 0u);
  EXPECT_EQ(empty->version(), 0u);
  right->mark_written();
  EXPECT_EQ(left->version(), 1u);
  EXPECT_EQ(middle->version(), 2u);
  whole->mark_written();
  EXPECT_EQ(left->version(), 2u);
  EXPECT_EQ(right->version(), 2u);
  EXPECT_EQ(whole->version(), 3u);
  EXPECT_TRUE(left->overlaps(*middle));
  EXPECT_FALSE(left->overlaps(*right));
  EXPECT_FALSE(left->overlaps(*empty));
  EXPECT_FALSE(left->overlaps(*Storage::allocate(1000, Device::cpu())->range(0, 500)));
}

TEST(Range, TheHandleKeepsTheStorage) {
  std::shared_ptr<Range> range;
  {
    const auto storage = Storage::allocate(64, Device::cpu());
    range = storage->range(0, 32);
  }
  std::memset(range->data(), 1, range->bytes());
  EXPECT_EQ(range->storage().bytes(), 64u);
}

TEST(Range, AWritableExportMarksOverlappingRangesAndTheChecksumSeesTheWrite) {
  const auto storage = Storage::allocate(1000, Device::cpu());
  const auto a = storage->range(0, 100), b = storage->range(50, 100), c = storage->range(500, 100);
  a->mark_written();
  a->mark_writable_export();
  EXPECT_TRUE(a->writable_export());
  EXPECT_TRUE(b->writable_export());
  EXPECT_FALSE(c->writable_export());
  EXPECT_TRUE(storage->range(90, 20)->writable_export()) << "made later";
  EXPECT_EQ(a->exported_version(), 1u);
  EXPECT_EQ(a->exported_checksum(), a->checksum());
  static_cast<char*>(storage->data())[99] = 1;
  EXPECT_NE(a->exported_checksum(), a->checksum());
  EXPECT_NE(b->exported_checksum(), b->checksum());
}

TEST(Range, AnExportThatEndedCountsUntilTheNextWrite) {
  const auto storage = Storage::allocate(1000, Device::cpu());
  const auto a = storage->range(0, 100), b = storage->range(50, 100);
  auto first = a->writable_export_scope(), second = b->writable_export_scope();
  EXPECT_EQ(a->exports(), 2u);
  first.reset();
  for (const auto& range : {a, b, storage->range(90, 20)}) EXPECT_TRUE(range->writable_export());
  a->mark_written();
  second.reset();
  for (const auto& range : {a, b}) {
    EXPECT_FALSE(range->writable_export());
    EXPECT_TRUE(range->was_exported()) << "the present version could be written";
  }
  EXPECT_FALSE(storage->range(95, 10)->was_exported()) << "nobody saw its value before";
  a->mark_written();
  for (const auto& range : {a, b}) EXPECT_FALSE(range->was_exported());
}

TEST(Range, AnExportKeepsTheChecksumOfTheFirstOfItsVersion) {
  const auto range = Storage::allocate(64, Device::cpu())->range();
  const uint64_t zero = range->checksum();
  range->writable_export_scope().reset();
  static_cast<char*>(range->data())[5] = 1;
  range->writable_export_scope().reset();
  EXPECT_EQ(range->exported_checksum(), zero);
  range->mark_written();
  range->writable_export_scope().reset();
  EXPECT_EQ(range->exported_checksum(), range->checksum());
  EXPECT_EQ(range->exported_version(), 1u);
}

TEST(Range, AnExportKeepsTheMemory) {
  std::shared_ptr<void> handle;
  std::weak_ptr<Storage> watch;
  {
    const auto storage = Storage::allocate(64, Device::cpu());
    watch = storage;
    handle = storage->range()->writable_export_scope();
  }
  EXPECT_FALSE(watch.expired());
  handle.reset();
  EXPECT_TRUE(watch.expired());
}

TEST(ExclusiveUse, ASecondCallIsRefusedUntilTheFirstEnds) {
  ExclusiveUse use;
  std::optional<ExclusiveUse::Scope> first(std::in_place, use, "solver.step", "the solver");
  try {
    const ExclusiveUse::Scope second(use, "solver.step", "the solver");
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.kind(), ErrorKind::Runtime);
    EXPECT_STREQ(error.what(),
                 "solver.step: the solver is in use by another call; give every thread one of its "
                 "own");
  }
  first.reset();
  EXPECT_NO_THROW(ExclusiveUse::Scope(use, "solver.step", "the solver"));
  EXPECT_NO_THROW(ExclusiveUse::Scope(use, "solver.step", "the solver")) << "given back";
}

TEST(ExclusiveUse, OfSeveralAllAreTakenOrNone) {
  const auto a = std::make_shared<ExclusiveUse>(), b = std::make_shared<ExclusiveUse>();
  ExclusiveUses both;
  both.add(a);
  both.add(b);
  both.add(a);
  {
    const ExclusiveUse::Scope taken(*b, "first", "b");
    EXPECT_THROW(both.take("second", "a and b"), Error);
    EXPECT_NO_THROW(ExclusiveUse::Scope(*a, "third", "a")) << "given back";
  }
  EXPECT_EQ(both.take("fourth", "a and b").size(), 2u);
}

TEST(Range, TheChecksumSeesEveryBitAndTheirOrder) {
  for (const size_t bytes : {1u, 7u, 8u, 31u, 32u, 33u, 200u}) {
    const auto range = Storage::allocate(bytes, Device::cpu())->range();
    auto* data = static_cast<unsigned char*>(range->data());
    const uint64_t zero = range->checksum();
    std::vector<uint64_t> seen = {zero};
    for (size_t bit = 0; bit < bytes * 8; ++bit) {
      data[bit / 8] ^= static_cast<unsigned char>(1u << (bit % 8));
      seen.push_back(range->checksum());
      data[bit / 8] = 0;
    }
    std::sort(seen.begin(), seen.end());
    EXPECT_EQ(std::adjacent_find(seen.begin(), seen.end()), seen.end()) << bytes;
    EXPECT_EQ(range->checksum(), zero);
  }
  const auto range = Storage::allocate(64, Device::cpu())->range();
  auto* words = static_cast<uint64_t*>(range->data());
  words[0] = 1;
  const uint64_t first = range->checksum();
  std::swap(words[0], words[4]);
  EXPECT_NE(range->checksum(), first);
}

TEST(Range, ThreadsMayMakeAndWriteRangesTogether) {
  const auto storage = Storage::allocate(4096, Device::cpu());
  std::vector<std::thread> threads;
  for (size_t t = 0; t < 4; ++t) {
    threads.emplace_back([&, t] {
      for (size_t k = 0; k < 200; ++k) storage->range((k * 13 + t) % 2000, 100)->mark_written();
    });
  }
  for (std::thread& thread : threads) thread.join();
  const auto whole = storage->range();
  EXPECT_EQ(whole->version(), 0u);
  storage->range(0, 100)->mark_written();
  EXPECT_EQ(whole->version(), 1u);
}

TEST(Allocator, ThreadsMayAllocateTogether) {
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([] {
      for (size_t k = 0; k < 300; ++k) {
        const auto storage = Storage::allocate(k * 37 % 5000, Device::cpu());
        if (storage->bytes() != 0) static_cast<char*>(storage->data())[storage->bytes() - 1] = 1;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  release_cached_memory();
}

}  // namespace
}  // namespace novaphy
