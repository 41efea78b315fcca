// A scan: launches of one Program, one after the other, in which each reads at its own row what the
// one before has written. The steps of a rollout are one, and so are their adjoints. A reader can
// run all launches of a few rows with the state in registers, and load what does not change once.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "novaphy/program/ir.h"

namespace nova::ir {

struct Scan {
  std::vector<int32_t> carried;  // per output: the source that the next launch reads it as
  std::vector<int32_t> varying;  // sources of which every launch may have another array
};

// Whether rows of such words may be written past the caches, and kept near by where they are
// needed.
inline bool handed_over(Type type, int32_t width) { return type == Type::F32 && width == 3; }

// What a row of so many carried sources takes in the memory where a scan keeps, for each launch,
// what it read as carried.
int32_t room_bytes(const Program& program, std::span<const int32_t> carried);

// What the Program says of itself: Output::carried and Source::varies. All other sources, tables
// and parameters have to be the same in every launch. None: an output is not carried, or to a
// source that is read at other rows as well, or the Program is so small that nothing is gained.
std::optional<Scan> find_scan(const Program& program);

}  // namespace nova::ir
