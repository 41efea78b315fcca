// A Program or a builtin, ready to run.
#pragma once

#include <stdint.h>

#include <mutex>
#include <string>
#include <string_view>
#include <vector>

#include "executable.h"
#include "native_tables.h"
#include "novaphy/abi/backend.h"
#include "novaphy/program/ir.h"

namespace novaphy::cpu {

struct BlockForm {
  std::vector<uint32_t> constants;
  std::vector<uint32_t> parameter_words;  // argument words of the parameters, in the scalars after
                                          // the constants
  int32_t register_count = 0, scalar_count = 0;
  std::vector<BlockInstr> prologue, code;
  std::vector<LoadCode> loads;
  std::vector<StoreCode> stores;
  std::vector<Operand> store_values;
  std::vector<LoopCode> loops;
  std::vector<SumSlots> sums;
  std::vector<GuardCode> guards;
  BlockTables tables() const {
    return {loads.data(), stores.data(), store_values.data(),
            loops.data(), sums.data(),   guards.data()};
  }
};

struct ScalarForm {
  bool usable = false;  // false: the Program is too large for 16-bit operands
  std::vector<uint32_t> constants;
  std::vector<uint32_t> parameter_words;
  int32_t scalar_count = 0;
  int32_t index = 0;
  std::vector<ScalarInstr> code;
  std::vector<LoopCode> loops;
  std::vector<SumSlots> sums;
  std::vector<int32_t> source_widths, output_widths;
};

// The Program in the two forms that the interpreter runs.
struct Interpreted {
  BlockForm block;
  ScalarForm scalar;
};

class Executable {
 public:
  Executable(nova::ir::Program program, const IsaTable& isa);

  const nova::ir::Program program;
  const uint32_t argument_count;
  const uint32_t first_output;
  const IsaTable& isa;
  const NativeCode native;
  const double operations;  // operations per row without sums; a load counts as several
  // Built immediately if there is no native code, or else when a launch first needs it.
  const Interpreted& interpreted() const;

 private:
  mutable std::once_flag once_;
  mutable Interpreted interpreted_;
};

BlockForm make_block_form(const nova::ir::Program& program,
                          const std::vector<nova::ir::Step>& steps, const IsaTable& isa);
ScalarForm make_scalar_form(const nova::ir::Program& program,
                            const std::vector<nova::ir::Step>& steps);

// Returns scratch memory of the calling thread, of at least `words` words with 64-byte alignment.
// The memory is kept between calls.
uint32_t* thread_scratch(size_t words);

// The largest number of rows per chunk of a parallel launch: a multiple of the size of every lane
// group.
constexpr int64_t kChunkRows = 8 * kLanes;

novaphy_status run_executable(const Executable& executable, const novaphy_host_api& host, int64_t n,
                              const uint64_t* arguments, novaphy_error* error);
// Runs the native code. Rows that the native code does not support go to the interpreter.
void run_native(const Executable& executable, const novaphy_host_api& host, int64_t n,
                const uint64_t* arguments, ErrorSink& sink);
// Runs some rows of a launch on the calling thread.
void run_native_rows(const Executable& executable, const uint64_t* arguments, int64_t begin,
                     int64_t end, ErrorSink& sink);
// Writes an error message about the out-of-range read in the sink.
novaphy_status out_of_range(const Executable& executable, const ErrorSink& sink,
                            const uint64_t* arguments, novaphy_error* error);
// Runs the interpreter on the calling thread.
void interpret_rows(const Executable& executable, int64_t begin, int64_t end,
                    const uint64_t* arguments, ErrorSink& sink);

// A builtin: its number of arguments and its function.
struct Builtin {
  const char* name;
  uint32_t argument_count;
  novaphy_status (*run)(const novaphy_host_api& host, const IsaTable& isa, int64_t n,
                        const uint64_t* arguments, novaphy_error* error);
};
const Builtin* find_builtin(std::string_view name);

novaphy_status fail(novaphy_error* error, novaphy_status status, const char* format, ...)
    __attribute__((format(printf, 3, 4)));

}  // namespace novaphy::cpu
