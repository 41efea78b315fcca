// The builtin modules: row sums by the stated order, scan, stable sort, incidence, checksum.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>
#include <numeric>

#include "harness.h"
#include "novaphy/abi/program.h"
#include "novaphy/core/parallel.h"

namespace conformance {
namespace {

uint32_t next_random() {
  static uint32_t state = 7;
  return state = state * 1664525u + 1013904223u;
}

std::vector<float> random_floats(size_t count) {
  std::vector<float> values(count);
  for (float& v : values) v = static_cast<float>(static_cast<int32_t>(next_random())) * 1e-8f;
  return values;
}

std::vector<uint32_t> words_of(const std::vector<float>& values) {
  std::vector<uint32_t> words(values.size());
  std::transform(values.begin(), values.end(), words.begin(), [](float v) { return bits(v); });
  return words;
}
std::vector<uint32_t> words_of(const std::vector<int32_t>& values) {
  return {values.begin(), values.end()};
}

// The rule of program.h on the items of one column.
float ordered_sum(float init, const std::vector<float>& items) {
  constexpr size_t kChunk = NOVAPHY_ROW_SUM_CHUNK;
  if (items.size() <= kChunk) return std::accumulate(items.begin(), items.end(), init);
  std::vector<float> level = items;
  while (level.size() > kChunk) {
    std::vector<float> sums;
    for (size_t k = 0; k < level.size(); k += kChunk) {
      float acc = 0.0f;
      for (size_t j = k; j < std::min(level.size(), k + kChunk); ++j) acc += level[j];
      sums.push_back(acc);
    }
    level = sums;
  }
  return init + std::accumulate(level.begin(), level.end(), 0.0f);
}

struct RowSumCase {
  std::vector<int64_t> lengths;
  bool with_items, with_init;
};

std::vector<uint32_t> expected_sums(const RowSumCase& c, int64_t width,
                                    const std::vector<int32_t>& offsets,
                                    const std::vector<int32_t>& items,
                                    const std::vector<float>& source,
                                    const std::vector<float>& init) {
  std::vector<uint32_t> result;
  for (size_t row = 0; row < c.lengths.size(); ++row) {
    for (int64_t column = 0; column < width; ++column) {
      std::vector<float> values;
      for (int32_t k = offsets[row]; k < offsets[row + 1]; ++k) {
        const int64_t item = c.with_items ? items[static_cast<size_t>(k)] : k;
        values.push_back(source[static_cast<size_t>(item * width + column)]);
      }
      const float start =
          c.with_init ? init[row * static_cast<size_t>(width) + static_cast<size_t>(column)] : 0.0f;
      result.push_back(bits(ordered_sum(start, values)));
    }
  }
  return result;
}

TEST(RowSum, FollowsTheRuleOfChunksForEveryLengthAndWidth) {
  const Module module("row_sum_f32");
  const int before = novaphy::num_threads();
  for (const bool with_items : {false, true}) {
    for (const bool with_init : {false, true}) {
      RowSumCase c{{0, 1, 255, 256, 257, 600, 3, 70000, 0, 5}, with_items, with_init};
      for (int k = 0; k < 600; ++k) c.lengths.push_back(k % 9);
      for (const int64_t width : {1, 2, 3, 4, 5, 6, 7, 9, 12}) {
        std::vector<int32_t> offsets = {0};
        for (const int64_t length : c.lengths)
          offsets.push_back(offsets.back() + static_cast<int32_t>(length));
        const auto total = static_cast<size_t>(offsets.back());
        std::vector<int32_t> items(total);
        for (int32_t& item : items) item = static_cast<int32_t>(next_random() % total);
        const std::vector<float> source = random_floats(total * static_cast<size_t>(width));
        const std::vector<float> init =
            random_floats(c.lengths.size() * static_cast<size_t>(width));
        const std::vector<uint32_t> expected =
            expected_sums(c, width, offsets, items, source, init);

        const Buffer d_source(words_of(source)), d_offsets(words_of(offsets)),
            d_items(words_of(items)), d_init(words_of(init));
        for (const int threads : {1, 2, 7}) {
          novaphy::set_num_threads(threads);
          const Buffer d_out(std::vector<uint32_t>(expected.size(), 0xFFFFFFFFu));
          const Result result = module.launch(
              static_cast<int64_t>(c.lengths.size()),
              {d_source.word(), d_offsets.word(), with_items ? d_items.word() : 0,
               with_init ? d_init.word() : 0, d_out.word(), static_cast<uint64_t>(width), 0});
          ASSERT_EQ(result.status, NOVAPHY_OK) << result.message;
          ASSERT_EQ(d_out.read(), expected) << "width " << width << ", threads " << threads;
        }
        if (!with_init) continue;  // out may be init
        const Result result =
            module.launch(static_cast<int64_t>(c.lengths.size()),
                          {d_source.word(), d_offsets.word(), with_items ? d_items.word() : 0,
                           d_init.word(), d_init.word(), static_cast<uint64_t>(width), 0});
        ASSERT_EQ(result.status, NOVAPHY_OK) << result.message;
        ASSERT_EQ(d_init.read(), expected) << "in place, width " << width;
      }
    }
  }
  novaphy::set_num_threads(before);
}

// Returns whether the backend has an optional builtin.
bool has_builtin(const char* name) {
  novaphy_error error = make_error();
  novaphy_module* known = nullptr;
  if (backend().api->module_create(backend().device, NOVAPHY_CODE_BUILTIN, name, std::strlen(name),
                                   &known, &error) != NOVAPHY_OK)
    return false;
  backend().api->module_destroy(known);
  return true;
}

// Two sums over the same items.
TEST(RowSum, OfAPairAreThoseOfEach) {
  if (!has_builtin("row_sum_pair_f32")) GTEST_SKIP() << "the backend lacks row_sum_pair_f32";
  const Module pair("row_sum_pair_f32");
  std::vector<int64_t> lengths = {0, 1, 257, 3, 600, 2};
  for (int k = 0; k < 400; ++k) lengths.push_back(k % 9);
  std::vector<int32_t> offsets = {0};
  for (const int64_t length : lengths)
    offsets.push_back(offsets.back() + static_cast<int32_t>(length));
  const auto total = static_cast<size_t>(offsets.back());
  std::vector<int32_t> items(total);
  for (int32_t& item : items) item = static_cast<int32_t>(next_random() % total);
  items[0] = 0;
  for (const int64_t width : {1, 3, 4})
    for (const int with_init : {0, 1, 2, 3}) {
      const RowSumCase first{lengths, true, (with_init & 1) != 0},
          second{lengths, true, (with_init & 2) != 0};
      const auto words = static_cast<size_t>(width);
      const std::vector<float> a = random_floats(total * words), b = random_floats(total * words),
                               init_a = random_floats(lengths.size() * words),
                               init_b = random_floats(lengths.size() * words);
      const Buffer d_a(words_of(a)), d_b(words_of(b)), d_offsets(words_of(offsets)),
          d_items(words_of(items)), d_init_a(words_of(init_a)), d_init_b(words_of(init_b)),
          out_a(std::vector<uint32_t>(init_a.size(), 1)),
          out_b(std::vector<uint32_t>(init_b.size(), 1));
      const Result result = pair.launch(
          static_cast<int64_t>(lengths.size()),
          {d_a.word(), d_offsets.word(), d_items.word(), first.with_init ? d_init_a.word() : 0,
           out_a.word(), static_cast<uint64_t>(width), 0, d_b.word(),
           second.with_init ? d_init_b.word() : 0, out_b.word()});
      ASSERT_EQ(result.status, NOVAPHY_OK) << result.message;
      EXPECT_EQ(out_a.read(), expected_sums(first, width, offsets, items, a, init_a)) << width;
      EXPECT_EQ(out_b.read(), expected_sums(second, width, offsets, items, b, init_b)) << width;
    }
}

TEST(RowSum, WithoutOffsetsEveryRowHasTheStrideAsLength) {
  const Module module("row_sum_f32");
  for (const int64_t stride : {0, 1, 4, 300, 100000}) {
    const int64_t rows = stride > 1000 ? 1 : 5;
    RowSumCase c{std::vector<int64_t>(static_cast<size_t>(rows), stride), false, false};
    std::vector<int32_t> offsets;
    for (int64_t row = 0; row <= rows; ++row) offsets.push_back(static_cast<int32_t>(row * stride));
    const std::vector<float> source = random_floats(static_cast<size_t>(rows * stride * 3));
    const std::vector<uint32_t> expected = expected_sums(c, 3, offsets, {}, source, {});
    const Buffer d_source(words_of(source)), d_out(std::vector<uint32_t>(expected.size(), 1));
    const Result result = module.launch(
        rows, {d_source.word(), 0, 0, 0, d_out.word(), 3, static_cast<uint64_t>(stride)});
    ASSERT_EQ(result.status, NOVAPHY_OK) << result.message;
    EXPECT_EQ(d_out.read(), expected) << "stride " << stride;
  }
}

TEST(ExclusiveScan, SumsWhatStandsBeforeAndMayRunInPlace) {
  const Module module("exclusive_scan_i32");
  for (const size_t n : {1u, 2u, 255u, 256u, 257u, 100000u}) {
    std::vector<uint32_t> in(n), expected(n);
    for (uint32_t& v : in) v = next_random();  // the sums wrap
    std::exclusive_scan(in.begin(), in.end(), expected.begin(), 0u);
    const Buffer d_in(in), d_out(std::vector<uint32_t>(n, 9));
    ASSERT_EQ(module.launch(static_cast<int64_t>(n), {d_in.word(), d_out.word()}).status,
              NOVAPHY_OK);
    EXPECT_EQ(d_out.read(), expected);
    ASSERT_EQ(module.launch(static_cast<int64_t>(n), {d_in.word(), d_in.word()}).status,
              NOVAPHY_OK);
    EXPECT_EQ(d_in.read(), expected);
  }
}

TEST(SortByKey, GivesTheStablePermutation) {
  const Module module("sort_by_key_i32");
  for (const size_t n : {1u, 2u, 64u, 65u, 1000u, 50000u}) {
    for (const uint32_t range : {3u, 1000u, 0u}) {
      std::vector<int32_t> keys(n), expected(n);
      for (int32_t& key : keys) {
        key = range != 0 ? static_cast<int32_t>(next_random() % range) - 1
                         : static_cast<int32_t>(next_random());
      }
      std::iota(expected.begin(), expected.end(), 0);
      std::stable_sort(expected.begin(), expected.end(), [&](int32_t a, int32_t b) {
        return keys[static_cast<size_t>(a)] < keys[static_cast<size_t>(b)];
      });
      const Buffer d_keys(words_of(keys)), d_order(std::vector<uint32_t>(n, 77));
      ASSERT_EQ(module.launch(static_cast<int64_t>(n), {d_keys.word(), d_order.word()}).status,
                NOVAPHY_OK);
      EXPECT_EQ(d_order.read(), words_of(expected)) << "n " << n << ", range " << range;
    }
  }
}

TEST(Incidence, ListsTheSlotsOfEveryRowInOrderWithoutTheNegativeOnes) {
  const Module module("incidence_i32");
  for (const size_t slots : {0u, 1u, 3u, 1000u, 30000u}) {
    const int32_t rows = 37;
    std::vector<int32_t> table(slots);
    for (int32_t& entry : table) entry = static_cast<int32_t>(next_random() % 39u) - 2;
    std::vector<int32_t> offsets = {0}, items;
    for (int32_t row = 0; row < rows; ++row) {
      for (size_t s = 0; s < slots; ++s) {
        if (table[s] == row) items.push_back(static_cast<int32_t>(s));
      }
      offsets.push_back(static_cast<int32_t>(items.size()));
    }
    const Buffer d_table(words_of(table)), d_offsets(std::vector<uint32_t>(rows + 1, 5)),
        d_items(std::vector<uint32_t>(slots, 5));
    const Result result =
        module.launch(rows, {d_table.word(), slots, d_offsets.word(), d_items.word()});
    ASSERT_EQ(result.status, NOVAPHY_OK) << result.message;
    EXPECT_EQ(d_offsets.read(), words_of(offsets));
    std::vector<uint32_t> got = d_items.read();
    got.resize(items.size());
    EXPECT_EQ(got, words_of(items));
  }
}

TEST(Incidence, ATableEntryPastTheLastRowFails) {
  const Module module("incidence_i32");
  const Buffer table({0, 1, 2, 4, 3}), offsets(std::vector<uint32_t>(5)),
      items(std::vector<uint32_t>(5));
  const Result result = module.launch(4, {table.word(), 5, offsets.word(), items.word()});
  EXPECT_EQ(result.status, NOVAPHY_INDEX_OUT_OF_RANGE);
  EXPECT_FALSE(result.message.empty());
}

// The rule of program.h.
uint64_t expected_checksum(const unsigned char* data, size_t bytes) {
  const auto mix = [](uint64_t x) {
    x = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93ull;
    return x ^ (x >> 32);
  };
  uint64_t sum = 0;
  for (size_t k = 0; k * 8 < bytes; ++k) {
    uint64_t word = 0;
    std::memcpy(&word, data + 8 * k, std::min<size_t>(8, bytes - 8 * k));
    sum += mix(mix(word + k * 0x9E3779B97F4A7C15ull));
  }
  return sum;
}

TEST(Checksum, IsThatOfTheRuleForEveryLengthAndAddressAndNumberOfThreads) {
  if (!has_builtin("checksum_u64")) GTEST_SKIP() << "the backend lacks checksum_u64";
  const Module module("checksum_u64");
  std::vector<uint32_t> words(200000);
  for (uint32_t& word : words) word = next_random() * 2654435761u;
  const Buffer data(words), out({0, 0});
  const int before = novaphy::num_threads();
  for (const size_t offset : {0u, 1u, 4u, 7u})
    for (const size_t bytes : {1u, 7u, 8u, 9u, 64u, 2047u, 70001u, 799992u})
      for (const int threads : {1, 2, 7}) {
        novaphy::set_num_threads(threads);
        const Result result = module.launch(static_cast<int64_t>((bytes + 7) / 8),
                                            {data.word() + offset, bytes, out.word()});
        ASSERT_EQ(result.status, NOVAPHY_OK) << result.message;
        const std::vector<uint32_t> got = out.read();
        ASSERT_EQ(
            got[0] | uint64_t{got[1]} << 32,
            expected_checksum(reinterpret_cast<const unsigned char*>(words.data()) + offset, bytes))
            << bytes << " bytes at " << offset;
      }
  novaphy::set_num_threads(before);
  EXPECT_EQ(module.launch(2, {data.word(), 8, out.word()}).status, NOVAPHY_INVALID_ARGUMENT);
}

TEST(Builtins, AnUnknownNameAndAWrongArgumentCountAreRefused) {
  novaphy_error error = make_error();
  novaphy_module* module = nullptr;
  EXPECT_EQ(backend().api->module_create(backend().device, NOVAPHY_CODE_BUILTIN, "nonsense", 8,
                                         &module, &error),
            NOVAPHY_INVALID_ARGUMENT);
  EXPECT_EQ(module, nullptr);
  EXPECT_NE(std::strstr(error.message, "nonsense"), nullptr) << error.message;
  EXPECT_EQ(Module("row_sum_f32").launch(1, {0, 0}).status, NOVAPHY_INVALID_ARGUMENT);
}

}  // namespace
}  // namespace conformance
