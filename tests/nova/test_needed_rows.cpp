// Which elements each part of their sums needs.
#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <vector>

#include "needed_rows.h"

namespace novaphy::testing {
namespace {

using nova::detail::Demand;
using nova::detail::even_shares;
using nova::detail::Gathering;
using nova::detail::items_among;
using nova::detail::rows_needed;
using nova::detail::Shares;

// A strip of cells between rows of `width` nodes, a cell per node of each row but the last: it
// pulls at the nodes below and above it.
struct Strip {
  explicit Strip(int32_t width, int32_t height) : nodes(width * height), cells(nodes - width) {
    offsets.push_back(0);
    for (int32_t node = 0; node < nodes; ++node) {
      if (node >= width) items.push_back(2 * (node - width) + 1);
      if (node < cells) items.push_back(2 * node);
      offsets.push_back(static_cast<int32_t>(items.size()));
    }
  }
  Gathering gathering() const { return {offsets.data(), items.data(), nodes, 2}; }
  int32_t nodes, cells;
  std::vector<int32_t> offsets, items;
};

size_t longest(const Strip& strip, const Shares& shares) {
  const Gathering gathering = strip.gathering();
  size_t most = 0;
  for (const auto& list : rows_needed({&gathering, 1}, {&shares, 1}, strip.cells))
    most = std::max(most, list.size());
  return most;
}

TEST(NeededRows, AreThoseOfTheSumsInWholeGroups) {
  const Strip strip(10, 10);
  const Gathering gathering = strip.gathering();
  const Shares shares{4, 1};
  const auto lists = rows_needed({&gathering, 1}, {&shares, 1}, strip.cells);
  ASSERT_EQ(lists.size(), 4u);
  // Nodes 25 to 49 have the cells 15 to 49; the last 25 those from 65 to 89.
  ASSERT_EQ(lists[1].size(), 48u);
  for (int32_t k = 0; k < 48; ++k)
    EXPECT_EQ(lists[1][static_cast<size_t>(k)], std::min(15 + k, 49));
  ASSERT_EQ(lists[3].size(), 32u);
  EXPECT_EQ(lists[3].front(), 65);
  EXPECT_EQ(lists[3].back(), 89);
  // The same items, counted within the list.
  const std::vector<int32_t> items = items_among(gathering, 25, 50, lists[1]);
  ASSERT_EQ(static_cast<int32_t>(items.size()), strip.offsets[50] - strip.offsets[25]);
  for (size_t k = 0; k < items.size(); ++k)
    EXPECT_EQ(items[k] + 2 * 15, strip.items[static_cast<size_t>(strip.offsets[25]) + k]);
}

TEST(NeededRows, OfSeveralSumsAreThoseThatAnyNeeds) {
  const Strip strip(10, 10);
  std::vector<int32_t> backwards(strip.items.rbegin(), strip.items.rend());
  const std::vector<Gathering> both = {strip.gathering(),
                                       {strip.offsets.data(), backwards.data(), strip.nodes, 2}};
  const std::vector<Shares> shares(2, Shares{4, 1});
  const auto lists = rows_needed(both, shares, strip.cells);
  ASSERT_EQ(lists.size(), 4u);
  for (size_t part = 0; part < 4; ++part) {
    EXPECT_TRUE(std::is_sorted(lists[part].begin(), lists[part].end()));
    for (const Gathering& g : both)
      for (int32_t k = g.offsets[25 * part]; k < g.offsets[25 * (part + 1)]; ++k)
        EXPECT_TRUE(std::binary_search(lists[part].begin(), lists[part].end(), g.items[k] / 2));
  }
}

TEST(NeededRows, AreNoneWhereItDoesNotPay) {
  const Shares shares{8, 1};
  const auto lists = [&](const std::vector<int32_t>& items, int64_t n) {
    std::vector<int32_t> offsets(161);
    for (int32_t k = 0; k < 161; ++k)
      offsets[static_cast<size_t>(k)] = k * static_cast<int32_t>(items.size()) / 160;
    const Gathering gathering{offsets.data(), items.data(), 160, 1};
    return rows_needed({&gathering, 1}, {&shares, 1}, n);
  };
  std::vector<int32_t> own(320), all(320), far(320);
  for (int32_t k = 0; k < 320; ++k) {
    own[static_cast<size_t>(k)] = k;
    all[static_cast<size_t>(k)] = k % 40;       // every part needs every row
    far[static_cast<size_t>(k)] = k * 7 % 160;  // each row is in two parts
  }
  EXPECT_EQ(lists(own, 320).size(), 8u);
  EXPECT_EQ(lists(far, 160).size(), 8u);
  EXPECT_TRUE(lists(all, 40).empty());
  EXPECT_TRUE(lists(own, 321).empty()) << "a row that no sum needs may be one that fails";
  EXPECT_TRUE(lists(own, 319).empty()) << "an item behind the last row";
  own[5] = -1;
  EXPECT_TRUE(lists(own, 320).empty());
}

TEST(NeededRows, SharesAreSuchThatNoPartNeedsMuchMore) {
  const Strip strip(17, 17);  // as the particles of a cloth
  const Demand demand{strip.gathering(), strip.cells, 1};
  for (const uint32_t parts : {3u, 4u, 8u, 12u, 16u}) {
    const Shares even{parts, 1}, found = even_shares({&demand, 1}, even);
    EXPECT_LE(longest(strip, found), longest(strip, even)) << parts;
    int64_t all = 0;
    for (uint32_t part = 0; part < parts; ++part) {
      const int64_t rows = found.begin(289, part + 1) - found.begin(289, part);
      EXPECT_GT(rows, 0);
      all += rows;
    }
    EXPECT_EQ(all, 289);
  }
  // Six rows of nodes for four parts: the parts within have cells on both sides.
  const Strip six(48, 6);
  const Demand of_six{six.gathering(), six.cells, 1};
  const Shares found = even_shares({&of_six, 1}, {4, 1});
  EXPECT_GT(found.margin, 0);
  EXPECT_EQ(longest(six, {4, 1}), 128u);
  EXPECT_EQ(longest(six, found), 112u);
  // Whole groups stay, and two parts are alike.
  EXPECT_EQ(even_shares({&of_six, 1}, {4, 16}).margin, 0);
  EXPECT_EQ(even_shares({&of_six, 1}, {2, 1}).margin, 0);
}

}  // namespace
}  // namespace novaphy::testing
