// The conversion of Programs to code for the interpreter on the device. The conformance suite tests
// that the interpreter gives the bits of the reference, on the fake driver too.
#include <gtest/gtest.h>

#include "interpreter.h"

namespace novaphy::gpu {
namespace {

namespace ir = nova::ir;
using ir::Op;

TEST(InterpreterCodeTest, ValuesThatDoNotLiveAtTheSameTimeShareAWord) {
  ir::Program p;
  p.sources.push_back({"x", ir::Type::F32, 2, ir::Access::Direct});
  p.instrs = {{Op::INDEX}, {Op::LOAD_F, 0, 0, 0}, {Op::LOAD_F, 0, 0, 1}};
  for (int32_t k = 2; k < 100; ++k) p.instrs.push_back({Op::ADD, k, 1});
  p.outputs.push_back({"y", ir::Type::F32, {100}});
  ASSERT_EQ(ir::validate(p), "");
  const InterpreterCode code = interpreter_code(p);
  EXPECT_EQ(code.values, 2);
  EXPECT_EQ(code.instructions.size(), p.instrs.size() + 2);  // a store and the end
}

TEST(InterpreterCodeTest, AValueFromBeforeALoopKeepsItsWordUntilTheLastStep) {
  ir::Program p;  // y = sum over k of (x + k), and k has no right to the word of x
  p.sources.push_back({"x", ir::Type::F32, 1, ir::Access::Direct});
  p.param_count = 1;
  p.instrs = {{Op::INDEX},     {Op::LOAD_F, 0, 0, 0}, {Op::CONST_F, 0}, {Op::REDUCE_INDEX, 0},
              {Op::I_TO_F, 3}, {Op::ADD, 1, 4},       {Op::SUM, 0, 0}};
  p.loops.push_back({ir::LoopKind::Fixed, 0, {{2, 5}}});
  p.outputs.push_back({"y", ir::Type::F32, {6}});
  ASSERT_EQ(ir::validate(p), "");
  const InterpreterCode code = interpreter_code(p);
  int32_t x = -1;
  for (const InterpreterInstruction& in : code.instructions) {
    if (in.op == static_cast<int32_t>(InterpreterOp::LOAD_OWN)) {
      x = in.d;
      continue;
    }
    if (in.op == static_cast<int32_t>(InterpreterOp::AGAIN)) break;
    if (x >= 0) {
      EXPECT_FALSE(in.d == x && in.op != static_cast<int32_t>(InterpreterOp::LOOP));
    }
  }
  EXPECT_GE(x, 0);
}

}  // namespace
}  // namespace novaphy::gpu
