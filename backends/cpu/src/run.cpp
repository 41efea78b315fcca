// Runs an executable: one row at a time if there are few rows, or else in fixed chunks of blocks.
// Chunks do not depend on the number of threads, and the result of a row does not depend on its
// chunk.
#include <algorithm>
#include <cstdlib>
#include <new>

#include "module.h"
#include "novaphy/cpu/float_mode.h"

namespace novaphy::cpu {
namespace {

constexpr size_t kStackScalars = 1024;  // a scalar form with more scalars uses the thread's scratch
                                        // memory

struct Scratch {
  uint32_t* words = nullptr;
  size_t count = 0;
  ~Scratch() { std::free(words); }
};
thread_local Scratch t_scratch;

// Sets the scalars at the start of a launch: constants, then parameters.
inline void set_leaves(uint32_t* scalars, const std::vector<uint32_t>& constants,
                       const std::vector<uint32_t>& parameter_words, const uint64_t* arguments) {
  uint32_t* next = std::copy(constants.begin(), constants.end(), scalars);
  for (const uint32_t word : parameter_words) *next++ = static_cast<uint32_t>(arguments[word]);
}

void run_blocks(BlockContext& context, const BlockInstr* code, int64_t begin, int64_t end) {
  for (int64_t base = begin; base < end; base += kLanes) {
    context.base = base;
    context.count = static_cast<int32_t>(std::min<int64_t>(kLanes, end - base));
    context.lanes = (context.count + kLaneGroup - 1) / kLaneGroup * kLaneGroup;
    const BlockInstr* next = code;
    while (next != nullptr) next = next->run(context, *next);
  }
}

struct Launch {
  const BlockForm* block;
  const uint64_t* arguments;
  const uint32_t* scalars;  // after the prologue
  ErrorSink* sink;
  int64_t n;
};

BlockContext make_context(const Launch& launch) {
  const BlockForm& block = *launch.block;
  const size_t register_words = static_cast<size_t>(block.register_count) * kLanes;
  const auto scalar_count = static_cast<size_t>(block.scalar_count);
  uint32_t* words = thread_scratch(register_words + scalar_count);
  BlockContext context{};
  context.registers = words;
  context.scalars = words + register_words;
  context.arguments = launch.arguments;
  context.tables = block.tables();
  context.sink = launch.sink;
  return context;
}

void run_rows(const Launch& launch, int64_t begin, int64_t end) {
  const BlockForm& block = *launch.block;
  BlockContext context = make_context(launch);
  std::copy_n(launch.scalars, block.scalar_count, context.scalars);
  run_blocks(context, block.code.data(), begin, end);
}

void run_chunk(void* opaque, int64_t chunk) {
  const Launch& launch = *static_cast<const Launch*>(opaque);
  const FloatMode mode;
  const int64_t begin = chunk * kChunkRows;
  run_rows(launch, begin, std::min(launch.n, begin + kChunkRows));
}

// Prepares a launch of the block form and passes it to `run`. Each chunk copies the scalars,
// because its loops write some of them.
template <class Run>
void with_launch(const BlockForm& block, int64_t n, const uint64_t* arguments, ErrorSink& sink,
                 const Run& run) {
  std::vector<uint32_t> large;
  uint32_t small[kStackScalars];
  uint32_t* scalars = small;
  if (static_cast<size_t>(block.scalar_count) > kStackScalars) {
    large.resize(static_cast<size_t>(block.scalar_count));
    scalars = large.data();
  }
  set_leaves(scalars, block.constants, block.parameter_words, arguments);
  Launch launch{&block, arguments, scalars, &sink, n};
  {
    BlockContext context{};
    context.scalars = scalars;
    context.arguments = arguments;
    context.tables = block.tables();
    context.sink = &sink;
    context.count = 1;
    const BlockInstr* next = block.prologue.data();
    while (next != nullptr) next = next->run(context, *next);
  }
  run(launch);
}

void run_block_form(const BlockForm& block, const novaphy_host_api& host, int64_t n,
                    const uint64_t* arguments, ErrorSink& sink) {
  with_launch(block, n, arguments, sink, [&](Launch& launch) {
    const int64_t chunks = (n + kChunkRows - 1) / kChunkRows;
    if (chunks == 1) {
      run_chunk(&launch, 0);
    } else {
      host.parallel_for(chunks, run_chunk, &launch);
    }
  });
}

void run_scalar_form(const Executable& executable, int64_t n, const uint64_t* arguments,
                     ErrorSink& sink) {
  const ScalarForm& scalar = executable.interpreted().scalar;
  uint32_t small[kStackScalars];
  uint32_t* scalars = small;
  if (static_cast<size_t>(scalar.scalar_count) > kStackScalars) {
    scalars = thread_scratch(static_cast<size_t>(scalar.scalar_count));
  }
  set_leaves(scalars, scalar.constants, scalar.parameter_words, arguments);
  const ScalarCode code = {scalar.code.data(),
                           scalar.loops.data(),
                           scalar.sums.data(),
                           scalar.source_widths.data(),
                           scalar.output_widths.data(),
                           static_cast<int32_t>(executable.first_output),
                           scalar.index};
  executable.isa.run_scalar(code, arguments, 0, n, scalars, &sink);
}

}  // namespace

novaphy_status out_of_range(const Executable& executable, const ErrorSink& sink,
                            const uint64_t* arguments, novaphy_error* error) {
  const auto source = static_cast<size_t>(sink.source);
  return fail(error, NOVAPHY_INDEX_OUT_OF_RANGE,
              "kernel '%s': row i = %lld reads row %lld of source '%s', which has %lld rows",
              executable.program.name.c_str(), static_cast<long long>(sink.index),
              static_cast<long long>(sink.row), executable.program.sources[source].name.c_str(),
              static_cast<long long>(arguments[2 * source + 1]));
}

uint32_t* thread_scratch(size_t words) {
  Scratch& scratch = t_scratch;
  if (scratch.count < words) [[unlikely]] {
    const size_t rounded = (words + 1023) / 1024 * 1024;
    auto* fresh = static_cast<uint32_t*>(std::aligned_alloc(4096, rounded * sizeof(uint32_t)));
    if (fresh == nullptr) throw std::bad_alloc();
    std::free(scratch.words);
    scratch.words = fresh;
    scratch.count = rounded;
  }
  return scratch.words;
}

void interpret_rows(const Executable& executable, int64_t begin, int64_t end,
                    const uint64_t* arguments, ErrorSink& sink) {
  with_launch(executable.interpreted().block, end, arguments, sink,
              [&](const Launch& launch) { run_rows(launch, begin, end); });
}

novaphy_status run_executable(const Executable& executable, const novaphy_host_api& host, int64_t n,
                              const uint64_t* arguments, novaphy_error* error) {
  const FloatMode mode;
  ErrorSink sink;
  if (executable.native.rows != nullptr) {
    run_native(executable, host, n, arguments, sink);
  } else if (n <= executable.isa.scalar_rows && executable.interpreted().scalar.usable) {
    run_scalar_form(executable, n, arguments, sink);
  } else {
    run_block_form(executable.interpreted().block, host, n, arguments, sink);
  }
  if (sink.index != INT64_MAX) [[unlikely]]
    return out_of_range(executable, sink, arguments, error);
  return NOVAPHY_OK;
}

}  // namespace novaphy::cpu
