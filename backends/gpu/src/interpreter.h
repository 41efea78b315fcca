// Programs for the interpreter on the device (interpreter.cuh), which runs them if no run-time
// compiler is available and no ahead-of-time code exists.
#pragma once

#include <cstdint>
#include <vector>

#include "device.h"
#include "novaphy/program/ir.h"

struct novaphy_kernel;

namespace novaphy::gpu {

inline constexpr uint32_t kMaxArgumentWords = 500;  // a kernel takes 4 KiB of arguments

// The operations of the flat list, besides the operations of Programs.
#define NOVAPHY_INTERPRETER_OPS(X) \
  X(MOVE) X(SELECT) X(LOAD) X(LOAD_OWN) X(STORE) X(SKIP) X(LOOP) X(AGAIN) X(END)
enum class InterpreterOp : int32_t {
  kFirst = nova::ir::kOpCount - 1,
#define NOVAPHY_INTERPRETER_OP(name) name,
  NOVAPHY_INTERPRETER_OPS(NOVAPHY_INTERPRETER_OP)
#undef NOVAPHY_INTERPRETER_OP
};

// The struct interpreter_instruction of interpreter.cuh, which describes the operations. Operands
// and results are numbers of values.
struct InterpreterInstruction {
  int32_t op, d = 0, a = 0, b = 0, c = 0, e = 0;
};

struct InterpreterCode {
  std::vector<InterpreterInstruction> instructions;
  int32_t values = 0;  // words per thread
};
// Returns the instructions in the order of schedule(). Values whose lifetimes do not overlap share
// a word.
InterpreterCode interpreter_code(const nova::ir::Program& program);

// Returns whether NOVAPHY_DEVICE_INTERPRETER=1 requests the interpreter although Programs can be
// compiled.
bool interpreter_is_forced();
// Prints once per process that kernels are interpreted, and why.
void say_interpreted(const char* why);
// Makes an interpreted kernel of the Program.
novaphy_status make_interpreted(novaphy_device* device, const nova::ir::Program& program,
                                novaphy_kernel& kernel, novaphy_error* error);
// Launches an interpreted kernel. `active` is the address of novaphy_backend_api::launch_active, or
// 0.
novaphy_status run_interpreted(novaphy_stream* stream, const novaphy_kernel& kernel, int64_t n,
                               DevicePointer active, const uint64_t* arguments,
                               novaphy_error* error);

}  // namespace novaphy::gpu
