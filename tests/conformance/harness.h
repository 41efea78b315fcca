// Shared by all conformance tests: the C table of the tested backend, owners for its handles, and a
// function that runs a Program on the backend and in the reference evaluator.
#pragma once

#include <cstdint>
#include <cstdio>
#include <optional>
#include <string>
#include <vector>

#include "novaphy/abi/backend.h"
#include "novaphy/program/ir.h"

namespace conformance {

namespace ir = nova::ir;

// The backend chosen on the command line and its first device.
struct Backend {
  const novaphy_backend_api* api = nullptr;
  novaphy_device* device = nullptr;
  novaphy_stream* stream = nullptr;
  int32_t device_total = 0;
  std::FILE* collected = nullptr;       // receives the words of every Program that is tested
  int64_t native = 0, interpreted = 0;  // Programs, by the reported way to run
};
Backend& backend();

inline novaphy_error make_error() { return {sizeof(novaphy_error), 0, {0}}; }

// Device memory with the bytes of a host vector.
class Buffer {
 public:
  explicit Buffer(const std::vector<uint32_t>& words);
  ~Buffer();
  Buffer(const Buffer&) = delete;
  Buffer& operator=(const Buffer&) = delete;
  uint64_t word() const { return reinterpret_cast<uint64_t>(pointer_); }
  std::vector<uint32_t> read() const;

 private:
  void* pointer_ = nullptr;
  size_t words_ = 0;
};

// Everything that a launch reads.
struct Inputs {
  std::vector<std::vector<uint32_t>> sources;         // tightly packed rows
  std::vector<std::vector<uint32_t>> offsets, items;  // per CSR loop; items empty with null_items
  bool null_items = false;
  std::vector<uint32_t> parameters;
};

struct Result {
  novaphy_status status = NOVAPHY_OK;
  std::string message;
  std::vector<std::vector<uint32_t>> outputs;
};

// A compiled Program (or builtin).
class Module {
 public:
  explicit Module(const ir::Program& program);
  explicit Module(const char* builtin);
  ~Module();
  Module(const Module&) = delete;
  Module& operator=(const Module&) = delete;
  Result launch(int64_t n, const std::vector<uint64_t>& arguments) const;  // outputs are left empty
  novaphy_kernel* kernel() const { return kernel_; }

 private:
  void create(int32_t format, const void* data, uint64_t bytes);
  void count_form() const;
  novaphy_module* module_ = nullptr;
  novaphy_kernel* kernel_ = nullptr;
};

Result run(const ir::Program& program, int64_t n, const Inputs& inputs);
Result run(const Module& module, const ir::Program& program, int64_t n, const Inputs& inputs);

// The reference: every value of every row by the definition in program.h, in plain scalar C++.
std::vector<std::vector<uint32_t>> reference(const ir::Program& program, int64_t n,
                                             const Inputs& inputs);

// Empty when equal, else the first difference. Floats compare by bits, but NaN equals NaN.
std::string difference(const ir::Program& program,
                       const std::vector<std::vector<uint32_t>>& expected,
                       const std::vector<std::vector<uint32_t>>& got);
// Runs both and compares.
std::string check(const ir::Program& program, int64_t n, const Inputs& inputs);

uint32_t bits(float value);
uint32_t bits(int32_t value);

// Builds Programs by hand.
struct Builder {
  ir::Program p;
  Builder() { p.name = "test"; }
  ir::Value op(ir::Op op, int32_t a = ir::kNone, int32_t b = ir::kNone, int32_t c = ir::kNone) {
    p.instrs.push_back({op, a, b, c});
    return static_cast<ir::Value>(p.instrs.size()) - 1;
  }
  ir::Value f(float value) { return op(ir::Op::CONST_F, static_cast<int32_t>(bits(value))); }
  ir::Value i(int32_t value) { return op(ir::Op::CONST_I, value); }
  ir::Value index() { return op(ir::Op::INDEX); }
  int32_t source(ir::Type type, int32_t width, ir::Access access = ir::Access::Direct) {
    p.sources.push_back({"s" + std::to_string(p.sources.size()), type, width, access});
    return static_cast<int32_t>(p.sources.size()) - 1;
  }
  ir::Value load(int32_t source, ir::Value row, int32_t column = 0) {
    const bool is_float = p.sources[static_cast<size_t>(source)].type == ir::Type::F32;
    return op(is_float ? ir::Op::LOAD_F : ir::Op::LOAD_I, source, row, column);
  }
  void output(std::vector<ir::Value> values) {
    const ir::Type type = ir::result_type(p.instrs[static_cast<size_t>(values[0])].op);
    p.outputs.push_back({"o" + std::to_string(p.outputs.size()), type, std::move(values)});
  }
};

}  // namespace conformance
