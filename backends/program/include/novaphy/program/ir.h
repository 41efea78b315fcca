// Program: the SSA form of one kernel as a plain value, with serialization, validation, printing,
// hashing, sections, guards and the schedule. <novaphy/abi/program.h> defines the meaning of the
// format. This header adds the C++ form, shared by the runtime and the CPU backend.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "novaphy/abi/program.h"

namespace nova::ir {

enum class Op : uint8_t {
#define NOVA_IR_OP(name, signature) name,
  NOVAPHY_PROGRAM_OPS(NOVA_IR_OP)
#undef NOVA_IR_OP
};

inline constexpr const char* kOpNames[] = {
#define NOVA_IR_OP(name, signature) #name,
    NOVAPHY_PROGRAM_OPS(NOVA_IR_OP)
#undef NOVA_IR_OP
};
inline constexpr const char* kOpSignatures[] = {
#define NOVA_IR_OP(name, signature) signature,
    NOVAPHY_PROGRAM_OPS(NOVA_IR_OP)
#undef NOVA_IR_OP
};
inline constexpr int kOpCount = sizeof(kOpNames) / sizeof(kOpNames[0]);

// The declarations below belong to the API of nova, which exports them.
#pragma GCC visibility push(default)

enum class Type : uint8_t { F32 = 0, I32 = 1, Bool = 2 };
enum class Access : uint8_t { Direct = 0, Uniform = 1, Indexed = 2, CsrRow = 3, Reduced = 4 };
enum class LoopKind : uint8_t { Fixed = 0, Csr = 1 };

using Value = int32_t;  // index of the instruction that computes the value
inline constexpr Value kNone = -1;

struct Instr {
  Op op;
  int32_t a = kNone, b = kNone, c = kNone;
  bool operator==(const Instr&) const = default;
};

struct Source {
  std::string name;
  Type type = Type::F32;
  int32_t width = 1;
  Access access = Access::Direct;
  bool varies = false;  // each launch of a scan may have another array, see scan.h
};

struct Output {
  std::string name;
  Type type = Type::F32;
  std::vector<Value> values;  // one per column
  int32_t carried = kNone;    // source through which the next launch of a scan reads the output
};

struct Sum {
  Value init = kNone;
  Value term = kNone;
};

struct Loop {
  LoopKind kind = LoopKind::Fixed;
  int32_t extent_param = 0;  // Fixed only
  std::vector<Sum> sums;
};

struct Program {
  std::string name;
  std::vector<Source> sources;
  std::vector<Output> outputs;
  std::vector<Loop> loops;
  int32_t param_count = 0;
  bool contract = false;
  // For the adjoint of a scan: the hash of its primal, whose sources come first. Otherwise 0.
  uint64_t primal = 0;
  std::vector<Instr> instrs;

  // Launch argument words: see <novaphy/abi/program.h>.
  uint32_t argument_count() const;
  uint32_t source_argument(size_t source) const { return static_cast<uint32_t>(2 * source); }
  uint32_t output_argument(size_t output) const;
  uint32_t loop_argument(size_t loop) const;  // argument of a Csr loop
  uint32_t param_argument(size_t param) const;
};

Type result_type(Op op);
// Calls f(value) for each operand that is a value; immediates are skipped.
template <class F>
void for_each_operand(const Instr& instr, F&& f) {
  const char* s = kOpSignatures[static_cast<int>(instr.op)];
  if (s[1] != '#' && s[1] != '-') f(instr.a);
  if (s[2] != '#' && s[2] != '-') f(instr.b);
  if (s[3] != '#' && s[3] != '-') f(instr.c);
}

// Returns an empty text if the Program satisfies every rule of the format, or else the violated
// rule.
std::string validate(const Program& program, bool allow_trace_ops = false);

std::vector<uint32_t> serialize(const Program& program);
// Returns false and a reason if the words are not a valid Program.
bool deserialize(std::span<const uint32_t> words, Program& program, std::string& reason);

std::string to_string(const Program& program);

// Returns a 64-bit hash of a canonical Program without its names. Equal computations have equal
// hashes, although C++ compilers evaluate operands in different orders during tracing.
uint64_t hash(const Program& program);

// Rebuilds the Program depth first from its outputs. This removes dead code and makes the order
// canonical. With strip_trace_ops, PARTIAL and DETACH are replaced by their value.
Program canonicalise(const Program& program, bool strip_trace_ops);

// Returns the section of each value: 2l for values before loop l that come after loop l-1, and 2l+1
// for values inside of loop l.
std::vector<int32_t> sections(const Program& program);
// Returns the source whose rows a Program only sums over CSR items, or -1. The gradient of such a
// source at an item equals the gradient of the output at the item's row.
int32_t summed_source(const Program& program);
// The two sources of a Program that only adds rows of CSR items (`source`) to its own row (`init`).
// added_rows returns {-1, -1} for any other Program.
struct AddedRows {
  int32_t init = -1, source = -1;
};
AddedRows added_rows(const Program& program);

// Guards. If all uses of a value are on one side of the same select, rows that take the other side
// do not need the value: it has a guard. Guard 0 always holds. Guard g holds if its parent holds
// and cond == polarity.
struct Guard {
  int32_t parent = -1;
  Value cond = kNone;
  bool polarity = true;
};
struct Guards {
  std::vector<Guard> nodes;    // nodes[0] is the root
  std::vector<int32_t> guard;  // per value
  int32_t find_or_add(int32_t parent, Value cond, bool polarity);
  int32_t common(int32_t g, int32_t h) const;
};
Guards guards(const Program& program);

// One step of the order in which an interpreter or compiler runs a Program. SkipIfNone jumps to
// `target` unless some lane of a group has value (a bool) == polarity. LoopBegin and LoopEnd
// enclose loop `value`.
struct Step {
  enum class Kind : uint8_t { Compute, SkipIfNone, LoopBegin, LoopEnd } kind;
  int32_t value = kNone;
  bool polarity = true;
  int32_t target = -1;  // SkipIfNone: index of the first step after the region
};
std::vector<Step> schedule(const Program& program);

#pragma GCC visibility pop

}  // namespace nova::ir
