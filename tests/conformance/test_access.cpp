// Loads of every access kind, loops, skipped sides of a select, and rows out of range.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstring>

#include "harness.h"

namespace conformance {
namespace {

using ir::Access;
using ir::LoopKind;
using ir::Op;
using ir::Type;
using ir::Value;

std::vector<uint32_t> floats(size_t count, uint32_t seed = 1) {
  std::vector<uint32_t> words;
  uint32_t state = seed;
  for (size_t k = 0; k < count; ++k) {
    state = state * 1664525u + 1013904223u;
    words.push_back(bits(static_cast<float>(static_cast<int32_t>(state)) * 1e-9f));
  }
  return words;
}

const int64_t kCounts[] = {1, 2, 3, 4, 5, 15, 16, 17, 255, 256, 257, 513, 4099};

TEST(Access, DirectReadsTheColumnsOfTheOwnRowForEveryWidth) {
  for (int32_t width = 1; width <= 9; ++width) {
    Builder b;
    const int32_t source = b.source(Type::F32, width);
    const Value row = b.index();
    std::vector<Value> values;
    for (int32_t c = width - 1; c >= 0; --c) values.push_back(b.load(source, row, c));
    b.output(values);
    for (const int64_t n : kCounts) {
      Inputs in;
      in.sources = {floats(static_cast<size_t>(n * width))};
      ASSERT_EQ(check(b.p, n, in), "") << "width " << width << ", n " << n;
    }
  }
}

TEST(Access, IndexedReadsTheRowOfATableAndZeroForANegativeRow) {
  for (int32_t width = 1; width <= 7; ++width) {
    Builder b;
    const int32_t table = b.source(Type::I32, 1),
                  source = b.source(Type::F32, width, Access::Indexed);
    const Value row = b.load(table, b.index());
    std::vector<Value> values;
    for (int32_t c = 0; c < width; ++c) values.push_back(b.load(source, row, c));
    b.output(values);
    b.output({row});
    for (const bool negative : {false, true}) {
      for (const int64_t n : kCounts) {
        Inputs in;
        std::vector<uint32_t> rows;
        for (int64_t i = 0; i < n; ++i)
          rows.push_back(bits(static_cast<int32_t>(i * 7 % 23) - (negative ? 2 : 0)));
        in.sources = {rows, floats(static_cast<size_t>(23 * width))};
        ASSERT_EQ(check(b.p, n, in), "") << "width " << width << ", n " << n;
      }
    }
  }
}

// The inputs of elements: a table whose columns name the rows of two sources, and two own values.
struct ElementBuilder : Builder {
  explicit ElementBuilder(int32_t corners) : table(source(Type::I32, corners)) {}
  const int32_t table, own = source(Type::F32, 2), q = source(Type::F32, 3, Access::Indexed),
                       v = source(Type::F32, 3, Access::Indexed);
};

// Elements: the columns of a table name the rows of two sources. The computation is long enough to
// be skipped where the first own value is not below the parameter. The part of the second source is
// skipped where the second own value is 0. The table itself is always read.
ir::Program elements(int32_t corners) {
  ElementBuilder b(corners);
  b.p.sources[static_cast<size_t>(b.q)].name = "particle_q";
  b.p.param_count = 1;
  const Value i = b.index(), mine = b.load(b.own, i), damping = b.load(b.own, i, 1);
  const Value takes = b.op(Op::LT, mine, b.op(Op::PARAM_F, 0));
  const Value undamped = b.op(Op::EQ, damping, b.f(0.0f));
  std::vector<Value> out, rows;
  for (int32_t k = 0; k < corners; ++k) rows.push_back(b.load(b.table, i, k));
  for (const Value row : rows) out.push_back(b.op(Op::I_TO_F, row));
  for (const Value row : rows)
    for (int32_t c = 0; c < 3; ++c) {
      Value x = b.op(Op::SUB, b.load(b.q, row, c), b.load(b.q, rows[0], c));
      const Value damped = b.op(Op::FMA, b.load(b.v, row, c), damping, x);
      x = b.op(Op::SELECT_F, undamped, x, damped);
      for (int t = 0; t < 3; ++t) x = b.op(Op::ADD, b.op(Op::MUL, x, mine), b.f(0.25f));
      out.push_back(b.op(Op::SELECT_F, takes, x, mine));
    }
  b.output(out);
  return b.p;
}

// The elements that have a damping.
enum class Damped : uint8_t { None, Some, All };

Inputs element_inputs(int32_t corners, int64_t n, int64_t rows, int32_t first, Damped damped) {
  Inputs in;
  std::vector<uint32_t> table, own = floats(static_cast<size_t>(2 * n), 3);
  for (int64_t i = 0; i < n; ++i) {
    for (int32_t k = 0; k < corners; ++k)
      table.push_back(bits(static_cast<int32_t>((i * 7 + k * k) % (rows - first)) + first));
    const bool some = i / 40 % 2 == 1 && i / 80 % 4 != i % 4;
    if (damped == Damped::None || (damped == Damped::Some && !some))
      own[static_cast<size_t>(2 * i + 1)] = bits(i % 3 == 0 ? -0.0f : 0.0f);
  }
  const auto words = static_cast<size_t>(3 * rows);
  in.sources = {table, own, floats(words, 7), floats(words, 9)};
  in.parameters = {bits(0.5f)};
  return in;
}

TEST(Access, TheColumnsOfATableNameRowsTheLastOneAndAbsentOnesToo) {
  for (int32_t corners = 2; corners <= 4; ++corners) {
    const ir::Program p = elements(corners);
    for (const Damped damped : {Damped::None, Damped::Some, Damped::All})
      for (const int64_t rows : {1, 2, 23})
        for (const int32_t first : {0, -2})
          for (const int64_t n : kCounts)
            ASSERT_EQ(check(p, n, element_inputs(corners, n, rows, first, damped)), "")
                << corners << " corners, " << n << " elements, rows " << first << " to " << rows;
  }
}

// The values that elements write for their corners: forces, and values that are 0 without a
// damping. The signs of factors may become those of products, or of the terms that these are added
// to.
ir::Program corner_rows(int32_t corners) {
  ElementBuilder b(corners);
  const Value i = b.index(), mine = b.load(b.own, i), damping = b.load(b.own, i, 1);
  const Value undamped = b.op(Op::EQ, damping, b.f(0.0f)), back = b.op(Op::NEG, mine);
  std::vector<Value> forces, slowed, rows;
  for (int32_t k = 0; k < corners; ++k) rows.push_back(b.load(b.table, i, k));
  for (const Value row : rows)
    for (int32_t c = 0; c < 3; ++c) {
      const Value d = b.op(Op::SUB, b.load(b.q, row, c), b.load(b.q, rows[0], c));
      const Value pulled = b.op(Op::MUL, back, d), half = b.op(Op::MUL, pulled, b.f(0.5f));
      Value x = b.op(Op::ADD, b.op(Op::ADD, d, pulled), half);
      x = b.op(Op::SUB, x, b.op(Op::MUL, x, b.op(Op::DIV, back, b.f(3.0f))));
      x = b.op(Op::ADD, b.op(Op::MUL, b.op(Op::MUL, back, x), x), b.op(Op::MUL, d, back));
      forces.push_back(b.op(Op::SUB, b.op(Op::NEG, b.op(Op::MUL, back, x)), back));
    }
  for (const Value row : rows)
    for (int32_t c = 0; c < 3; ++c) {
      const Value y = b.op(Op::MUL, b.load(b.v, row, c), damping);
      slowed.push_back(
          b.op(Op::SELECT_F, undamped, b.f(0.0f), b.op(Op::ADD, b.op(Op::MUL, y, y), y)));
    }
  b.output(forces);
  b.output(slowed);
  return b.p;
}
TEST(Access, RowsOfAllCornersAreWrittenAtOnce) {
  for (int32_t corners = 2; corners <= 4; ++corners) {
    const ir::Program p = corner_rows(corners);
    for (const Damped damped : {Damped::None, Damped::Some, Damped::All})
      for (const int32_t first : {0, -2})
        for (const int64_t n : kCounts) {
          Inputs in = element_inputs(corners, n, 23, first, damped);
          in.parameters.clear();
          ASSERT_EQ(check(p, n, in), "")
              << corners << " corners, " << n << " elements, rows from " << first;
        }
  }
}

// A length that is needed only where it is above a limit, because it is a divisor there.
TEST(Access, ElementsDivideByALengthWhereItIsAboveALimit) {
  ElementBuilder b(2);
  b.p.param_count = 1;
  const Value i = b.index(), limit = b.op(Op::PARAM_F, 0);
  std::vector<Value> d, out = {b.load(b.own, i), b.load(b.v, b.load(b.table, i, 0))};
  for (int32_t c = 0; c < 3; ++c)
    d.push_back(b.op(Op::SUB, b.load(b.q, b.load(b.table, i, 0), c),
                     b.load(b.q, b.load(b.table, i, 1), c)));
  Value square = b.op(Op::MUL, d[0], d[0]);
  for (const Value x : {d[1], d[2]}) square = b.op(Op::ADD, square, b.op(Op::MUL, x, x));
  const Value length = b.op(Op::SQRT, square), above = b.op(Op::LT, limit, length),
              k = b.op(Op::DIV, limit, length);
  for (const Value x : d) out.push_back(b.op(Op::SELECT_F, above, b.op(Op::MUL, x, k), x));
  b.output(out);
  for (const int64_t n : kCounts)
    for (const float most : {0.0f, 0.5f, 2.0f, 1e9f}) {
      Inputs in = element_inputs(2, n, 23, 0, Damped::All);
      in.parameters = {bits(most)};
      ASSERT_EQ(check(b.p, n, in), "") << n << " elements, limit " << most;
    }
}
// Rows of velocities that are needed where two conditions hold, and an output that is not 0 where
// the inner one does.
TEST(Access, WhatIsZeroWithoutDampingMayBeNestedElsewhere) {
  ElementBuilder b(2);
  b.p.param_count = 1;
  const Value i = b.index(), zero = b.f(0.0f), first = b.load(b.table, i, 0),
              second = b.load(b.table, i, 1),
              outer = b.op(Op::LT, b.load(b.own, i), b.op(Op::PARAM_F, 0)),
              damped = b.op(Op::LT, zero, b.load(b.own, i, 1));
  std::vector<Value> d, nested, other;
  for (int32_t c = 0; c < 3; ++c)
    d.push_back(b.op(Op::SUB, b.load(b.q, first, c), b.load(b.q, second, c)));
  for (int32_t c = 0; c < 3; ++c) {
    const Value y = b.op(Op::SUB, b.load(b.v, first, c), b.load(b.v, second, c));
    nested.push_back(
        b.op(Op::SELECT_F, outer, b.op(Op::SELECT_F, damped, b.op(Op::MUL, y, y), zero), zero));
    const Value ratio = b.op(Op::DIV, b.op(Op::MUL, d[static_cast<size_t>(c)], d[0]),
                             d[static_cast<size_t>(2 - c)]);
    other.push_back(
        b.op(Op::SELECT_F, damped, b.op(Op::DIV, ratio, b.op(Op::ADD, ratio, d[1])), zero));
  }
  b.output(nested);
  b.output(other);
  for (const int64_t n : kCounts)
    for (const Damped some : {Damped::None, Damped::Some, Damped::All})
      for (const float limit : {-1e9f, 0.5f, 1e9f}) {
        Inputs in = element_inputs(2, n, 23, 0, some);
        in.parameters = {bits(limit)};
        ASSERT_EQ(check(b.p, n, in), "") << n << " elements, limit " << limit;
      }
}

// The first column names rows of a source that is longer than the one that the second column names.
TEST(Access, TheColumnsOfATableNameRowsOfSourcesOfUnequalLength) {
  Builder b;
  const int32_t table = b.source(Type::I32, 2), q = b.source(Type::F32, 3, Access::Indexed),
                v = b.source(Type::F32, 3, Access::Indexed);
  const Value own = b.index(), long_row = b.load(table, own, 0), short_row = b.load(table, own, 1);
  std::vector<Value> out;
  for (int32_t c = 0; c < 3; ++c)
    out.push_back(b.op(Op::SUB, b.load(q, long_row, c), b.load(v, short_row, c)));
  b.output(out);
  for (const int32_t rows : {5, 6, 23})
    for (const int64_t n : kCounts) {
      Inputs in;
      std::vector<uint32_t> of_both;
      for (int64_t i = 0; i < n; ++i) {
        of_both.push_back(bits(static_cast<int32_t>(i * 7 % rows)));
        of_both.push_back(bits(static_cast<int32_t>(i * 3 % 5)));
      }
      in.sources = {of_both, floats(static_cast<size_t>(3 * rows), 7), floats(15, 9)};
      ASSERT_EQ(check(b.p, n, in), "") << rows << " rows and 5, " << n << " elements";
    }
}

TEST(Access, ANegativeRowOfAnEmptySourceReadsZero) {
  Builder b;
  const int32_t source = b.source(Type::F32, 3, Access::Indexed);
  const Value row = b.op(Op::ISUB, b.i(-1), b.index());
  b.output({b.load(source, row, 0), b.load(source, row, 1), b.load(source, row, 2)});
  const Value constant = b.i(-1);
  b.output({b.load(source, constant, 2)});
  Inputs in;
  in.sources = {{}};
  for (const int64_t n : kCounts) ASSERT_EQ(check(b.p, n, in), "") << n;
}

TEST(Access, UniformReadsOneRowForAllAndOutputsMayBeUniform) {
  Builder b;
  const int32_t source = b.source(Type::F32, 3, Access::Uniform),
                other = b.source(Type::I32, 1, Access::Uniform);
  b.p.param_count = 1;
  const Value zero = b.i(0);
  const Value x = b.load(source, zero, 0), y = b.load(source, zero, 2);
  b.output(
      {b.op(Op::ADD, x, y), b.op(Op::MUL, x, b.op(Op::PARAM_F, 0)), b.op(Op::I_TO_F, b.index())});
  b.output({b.load(other, zero)});
  b.output({b.index(), b.op(Op::IADD, b.index(), b.i(1))});
  Inputs in;
  in.sources = {floats(3), {42}};
  in.parameters = {bits(2.5f)};
  for (const int64_t n : kCounts) ASSERT_EQ(check(b.p, n, in), "") << n;
}

// sum over r of source[r].x * own, and the count, with init values.
ir::Program fixed_loop() {
  Builder b;
  const int32_t shared = b.source(Type::F32, 3, Access::Reduced), own = b.source(Type::F32, 1);
  b.p.param_count = 1;
  b.p.loops.push_back({LoopKind::Fixed, 0, {}});
  const Value mine = b.load(own, b.index());
  const Value r = b.op(Op::REDUCE_INDEX, 0);
  const Value x = b.load(shared, r, 0), y = b.load(shared, r, 1);
  const Value product = b.op(Op::MUL, x, mine);
  const Value counted = b.op(Op::I_TO_F, r);
  b.p.loops[0].sums = {{mine, product}, {b.f(-0.0f), y}, {b.f(1.0f), counted}, {mine, b.f(0.1f)}};
  b.output({b.op(Op::SUM, 0, 0), b.op(Op::SUM, 0, 1), b.op(Op::SUM, 0, 2), b.op(Op::SUM, 0, 3)});
  b.output({mine});
  return b.p;
}

TEST(Loops, FixedFoldsInOrderFromTheInitialValueForEveryExtent) {
  const ir::Program p = fixed_loop();
  for (const int32_t extent : {0, 1, 2, 7, -3}) {
    for (const int64_t n : kCounts) {
      Inputs in;
      in.sources = {floats(7 * 3), floats(static_cast<size_t>(n), 5)};
      in.parameters = {bits(extent)};
      ASSERT_EQ(check(p, n, in), "") << "extent " << extent << ", n " << n;
    }
  }
}

ir::Program csr_loop() {
  Builder b;
  const int32_t own = b.source(Type::F32, 3), other = b.source(Type::F32, 3, Access::CsrRow);
  b.p.loops.push_back({LoopKind::Csr, 0, {}});
  const Value row = b.index();
  const Value slot = b.op(Op::SLOT, 0), k = b.op(Op::REDUCE_INDEX, 0);
  Value terms[3];
  for (int32_t c = 0; c < 3; ++c) {
    const Value difference = b.op(Op::SUB, b.load(other, slot, c), b.load(own, row, c));
    terms[c] = b.op(Op::MUL, difference, b.op(Op::I_TO_F, b.op(Op::IADD, k, slot)));
  }
  for (int32_t c = 0; c < 3; ++c) b.p.loops[0].sums.push_back({b.load(own, row, c), terms[c]});
  b.p.loops[0].sums.push_back({b.f(0.0f), b.f(1.0f)});
  b.output({b.op(Op::SUM, 0, 0), b.op(Op::SUM, 0, 1), b.op(Op::SUM, 0, 2), b.op(Op::SUM, 0, 3)});
  return b.p;
}

// Own rows, and up to six items each of 11 rows, or of as many as there are items.
Inputs csr_inputs(int64_t n, size_t width, bool null_items) {
  Inputs in;
  in.null_items = null_items;
  std::vector<uint32_t> offsets = {0}, items;
  for (int64_t i = 0; i < n; ++i) {
    const int64_t length = i % 5 == 0 ? 0 : i % 7;
    for (int64_t k = 0; k < length; ++k) items.push_back(static_cast<uint32_t>((i * 3 + k) % 11));
    offsets.push_back(static_cast<uint32_t>(items.size()));
  }
  in.sources = {floats(width * static_cast<size_t>(n)),
                floats(width * (null_items ? items.size() : 11), 9)};
  in.offsets = {offsets};
  in.items = {items};
  return in;
}

TEST(Loops, CsrRowsOfDifferentLengthsFoldTheirOwnItems) {
  const ir::Program p = csr_loop();
  for (const bool null_items : {false, true})
    for (const int64_t n : kCounts)
      ASSERT_EQ(check(p, n, csr_inputs(n, 3, null_items)), "")
          << "n " << n << ", null items " << null_items;
}

// Nothing but the own row and those of the items.
ir::Program row_sums(int32_t width) {
  Builder b;
  const int32_t own = b.source(Type::F32, width),
                other = b.source(Type::F32, width, Access::CsrRow);
  b.p.loops.push_back({LoopKind::Csr, 0, {}});
  const Value row = b.index(), slot = b.op(Op::SLOT, 0);
  std::vector<Value> out;
  for (int32_t c = 0; c < width; ++c)
    b.p.loops[0].sums.push_back({b.load(own, row, c), b.load(other, slot, c)});
  for (int32_t c = 0; c < width; ++c) out.push_back(b.op(Op::SUM, 0, c));
  b.output(out);
  return b.p;
}

TEST(Loops, RowsOfEveryWidthAreAddedToTheOwnRow) {
  for (int32_t width = 1; width <= 5; ++width) {
    const ir::Program p = row_sums(width);
    for (const bool null_items : {false, true})
      for (const int64_t n : kCounts)
        ASSERT_EQ(check(p, n, csr_inputs(n, static_cast<size_t>(width), null_items)), "")
            << "width " << width << ", n " << n << ", null items " << null_items;
    Inputs in = csr_inputs(300, static_cast<size_t>(width), false);
    in.items[0][100] = 11;
    const auto row = std::upper_bound(in.offsets[0].begin(), in.offsets[0].end(), 100u) - 1;
    const Result result = run(p, 300, in);
    ASSERT_EQ(result.status, NOVAPHY_INDEX_OUT_OF_RANGE) << width;
    const std::string i = "i = " + std::to_string(row - in.offsets[0].begin()) + " ";
    for (const std::string& part : {i, std::string("row 11 ")})
      EXPECT_NE(result.message.find(part), std::string::npos)
          << part << "is not in: " << result.message;
  }
}

TEST(Loops, RowsThatAreAllEmptyGiveTheInitialValue) {
  const ir::Program p = csr_loop();
  Inputs in;
  in.sources = {floats(300), {}};
  in.offsets = {std::vector<uint32_t>(101, 0)};
  in.items = {{}};
  for (const int64_t n : {1, 4, 100}) ASSERT_EQ(check(p, n, in), "");
}

// select(own < limit, expensive(other[table]), own): the side is long enough to be skipped, and
// holds a load.
ir::Program guarded(bool in_loop) {
  Builder b;
  const int32_t own = b.source(Type::F32, 1), table = b.source(Type::I32, 1),
                other = b.source(Type::F32, 1, Access::Indexed);
  b.p.param_count = 2;
  if (in_loop) b.p.loops.push_back({LoopKind::Csr, 0, {}});
  const Value row = b.index();
  const Value mine = b.load(own, row);
  const Value wanted = in_loop ? b.op(Op::SLOT, 0) : b.load(table, row);
  const Value key = in_loop ? b.op(Op::ADD, mine, b.op(Op::I_TO_F, wanted)) : mine;
  const Value condition = b.op(Op::LT, key, b.op(Op::PARAM_F, 0));
  Value v = b.load(other, wanted);
  for (int k = 0; k < 8; ++k) v = b.op(Op::ADD, b.op(Op::MUL, v, mine), b.f(0.25f));
  Value w = mine;
  for (int k = 0; k < 8; ++k) w = b.op(Op::SUB, b.op(Op::MUL, w, mine), b.f(0.125f));
  const Value result = b.op(Op::SELECT_F, condition, v, w);
  if (in_loop) {
    b.p.loops[0].sums = {{mine, result}};
    b.output({b.op(Op::SUM, 0, 0)});
  } else {
    b.output({result});
  }
  return b.p;
}

TEST(Select, SkippingAnUnusedSideChangesNothing) {
  const ir::Program p = guarded(false);
  const int64_t n = 700;
  Inputs in;
  std::vector<uint32_t> own, table;
  for (int64_t i = 0; i < n; ++i) {
    own.push_back(bits(static_cast<float>(i)));
    table.push_back(static_cast<uint32_t>(i % 10));
  }
  in.sources = {own, table, floats(10)};
  for (const float limit : {-1.0f, 0.5f, 3.0f, 256.0f, 300.0f, 1000.0f}) {
    in.parameters = {bits(limit), 0};
    ASSERT_EQ(check(p, n, in), "") << "limit " << limit;
  }
}

// Whether a load fails depends on the row alone, not on its neighbors: rows that do not take the
// side with the load may hold any row number.
TEST(OutOfRange, ARowThatIsNotReadMayBeAnything) {
  for (const bool in_loop : {false, true}) {
    const ir::Program p = guarded(in_loop);
    for (const int64_t n : {2, 20, 600}) {
      Inputs in;
      std::vector<uint32_t> own, table, offsets = {0}, items;
      for (int64_t i = 0; i < n; ++i) {
        const bool takes = i % 2 == 0;
        own.push_back(bits(takes ? -100000.0f : 1.0f));
        table.push_back(takes ? 3u : 5000u);
        for (int64_t k = 0; k < i % 4; ++k) items.push_back(takes ? 3u : 5000u);
        offsets.push_back(static_cast<uint32_t>(items.size()));
      }
      in.sources = {own, table, floats(10)};
      in.offsets = {offsets};
      in.items = {items};
      in.parameters = {bits(0.0f), 0};
      ASSERT_EQ(check(p, n, in), "") << "n " << n << ", in a loop " << in_loop;
    }
  }
}

TEST(OutOfRange, TheFirstRowThatReadsPastTheEndIsNamed) {
  Builder b;
  const int32_t table = b.source(Type::I32, 1), source = b.source(Type::F32, 3, Access::Indexed);
  b.p.sources[static_cast<size_t>(source)].name = "particle_q";
  b.p.name = "spring_forces";
  const Value row = b.load(table, b.index());
  b.output({b.load(source, row, 0), b.load(source, row, 1)});
  for (const int64_t n : {1, 2, 4, 5, 300, 9000}) {
    Inputs in;
    std::vector<uint32_t> rows(static_cast<size_t>(n), 1);
    const int64_t first = n * 2 / 3;
    for (int64_t i = first; i < n; ++i)
      rows[static_cast<size_t>(i)] = static_cast<uint32_t>(10 + i - first);
    in.sources = {rows, floats(30)};
    const Result result = run(b.p, n, in);
    ASSERT_EQ(result.status, NOVAPHY_INDEX_OUT_OF_RANGE) << n;
    for (const std::string& part : {std::string("spring_forces"), std::string("particle_q"),
                                    "i = " + std::to_string(first) + " ", std::string("row 10 ")}) {
      EXPECT_NE(result.message.find(part), std::string::npos)
          << part << " is not in: " << result.message;
    }
  }
}

TEST(OutOfRange, RowsThatATableNamesAreReadAheadAndFailWhereTheyAreNeeded) {
  const ir::Program p = elements(4);
  for (const int64_t n : {1, 16, 17, 50, 300, 9000})
    for (const int64_t wrong : {int64_t{0}, n / 2, n - 1}) {
      Inputs in = element_inputs(4, n, 23, 0, Damped::Some);
      in.sources[0][static_cast<size_t>(4 * wrong + 2)] = 1000;
      in.sources[1][static_cast<size_t>(2 * wrong)] = bits(100.0f);
      ASSERT_EQ(check(p, n, in), "") << "not needed, n " << n << ", row " << wrong;
      in.sources[1][static_cast<size_t>(2 * wrong)] = bits(-100.0f);
      in.sources[1][static_cast<size_t>(2 * wrong + 1)] = 0;  // only one source needs the row
      const Result result = run(p, n, in);
      ASSERT_EQ(result.status, NOVAPHY_INDEX_OUT_OF_RANGE) << n;
      for (const std::string& part :
           {std::string("particle_q"), "i = " + std::to_string(wrong) + " ", std::string("1000 ")})
        EXPECT_NE(result.message.find(part), std::string::npos)
            << part << " is not in: " << result.message;
    }
}

// A row past its own end takes no part in an iteration.
TEST(OutOfRange, RowsOfUnequalLengthOnlyReadInTheirOwnIterations) {
  Builder b;
  const int32_t other = b.source(Type::F32, 1, Access::CsrRow);
  b.p.loops.push_back({LoopKind::Csr, 0, {}});
  const Value slot = b.op(Op::SLOT, 0), k = b.op(Op::REDUCE_INDEX, 0);
  const Value mirrored = b.load(other, b.op(Op::ISUB, b.i(10), slot));  // slots 8 .. 10
  const Value counted =
      b.load(other, b.op(Op::ISUB, b.i(2), b.op(Op::IMUL, k, b.i(-1))));  // rows 2, 3, ...
  b.p.loops[0].sums = {{b.f(0.0f), mirrored}, {b.f(0.0f), counted}};
  b.output({b.op(Op::SUM, 0, 0), b.op(Op::SUM, 0, 1)});
  for (const int64_t n : {1, 4, 40, 300}) {
    Inputs in;
    std::vector<uint32_t> offsets = {0}, items;
    for (int64_t i = 0; i < n; ++i) {
      for (int64_t r = 0; r < i % 4; ++r) items.push_back(static_cast<uint32_t>(8 + r));
      offsets.push_back(static_cast<uint32_t>(items.size()));
    }
    in.sources = {floats(5)};
    in.offsets = {offsets};
    in.items = {items};
    ASSERT_EQ(check(b.p, n, in), "") << n;
  }
}

TEST(OutOfRange, TheFirstRowIsNamedAlsoWhenALaterReadOfTheProgramFindsIt) {
  Builder b;
  const int32_t first = b.source(Type::I32, 1), second = b.source(Type::I32, 1),
                small = b.source(Type::F32, 1, Access::Indexed);
  const Value row = b.index();
  const Value x = b.load(small, b.load(first, row)), y = b.load(small, b.load(second, row));
  b.output({b.op(Op::SUB, x, y)});
  Inputs in;
  std::vector<uint32_t> late(200, 0), early(200, 0);
  late[150] = 7;
  early[20] = 9;
  in.sources = {late, early, floats(5)};
  const Result result = run(b.p, 200, in);
  EXPECT_EQ(result.status, NOVAPHY_INDEX_OUT_OF_RANGE);
  EXPECT_NE(result.message.find("i = 20 "), std::string::npos) << result.message;
  EXPECT_NE(result.message.find("row 9 "), std::string::npos) << result.message;
}

TEST(OutOfRange, DirectUniformAndLoopReadsAreCheckedToo) {
  {
    Builder b;
    const int32_t source = b.source(Type::F32, 2);
    b.output({b.load(source, b.index(), 1)});
    for (const int64_t n : {1, 3, 300}) {
      Inputs in;
      in.sources = {floats(static_cast<size_t>(2 * (n - 1)))};
      const Result result = run(b.p, n, in);
      EXPECT_EQ(result.status, NOVAPHY_INDEX_OUT_OF_RANGE);
      EXPECT_NE(result.message.find("i = " + std::to_string(n - 1)), std::string::npos)
          << result.message;
    }
  }
  {
    Builder b;
    const int32_t source = b.source(Type::F32, 1, Access::Uniform);
    b.output({b.load(source, b.i(0))});
    Inputs in;
    in.sources = {{}};
    for (const int64_t n : {1, 100}) EXPECT_EQ(run(b.p, n, in).status, NOVAPHY_INDEX_OUT_OF_RANGE);
  }
  {
    const ir::Program p = fixed_loop();
    Inputs in;
    in.sources = {floats(9), floats(100)};
    in.parameters = {bits(4)};
    for (const int64_t n : {1, 100}) EXPECT_EQ(run(p, n, in).status, NOVAPHY_INDEX_OUT_OF_RANGE);
  }
}

// More than fit into the registers, or the fast memory, of any device.
TEST(Launch, ManyValuesMayLiveAtTheSameTime) {
  Builder b;
  const int32_t source = b.source(Type::F32, 1);
  const Value x = b.load(source, b.index());
  std::vector<Value> values;
  for (int k = 0; k < 500; ++k)
    values.push_back(b.op(Op::MUL, x, b.f(static_cast<float>(k) - 250.0f)));
  Value sum = x;
  for (size_t k = values.size(); k-- > 0;) sum = b.op(Op::SUB, values[k], sum);
  b.output({sum});
  for (const int64_t n : kCounts) {
    Inputs in;
    in.sources = {floats(static_cast<size_t>(n))};
    ASSERT_EQ(check(b.p, n, in), "") << n;
  }
}

TEST(Launch, AnOutputMayBeTheSourceWhenEachRowOnlyReadsItself) {
  Builder b;
  const int32_t source = b.source(Type::F32, 3);
  const Value row = b.index();
  const Value x = b.load(source, row, 0), y = b.load(source, row, 1), z = b.load(source, row, 2);
  b.output({b.op(Op::ADD, z, y), b.op(Op::MUL, x, z), b.op(Op::SUB, y, x)});
  const Module module(b.p);
  for (const int64_t n : kCounts) {
    Inputs in;
    in.sources = {floats(static_cast<size_t>(3 * n))};
    const Buffer buffer(in.sources[0]);
    const Result result =
        module.launch(n, {buffer.word(), static_cast<uint64_t>(n), buffer.word()});
    ASSERT_EQ(result.status, NOVAPHY_OK) << result.message;
    ASSERT_EQ(difference(b.p, reference(b.p, n, in), {buffer.read()}), "") << n;
  }
}

}  // namespace
}  // namespace conformance
