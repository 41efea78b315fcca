// The arithmetic of the CPU backend, shared by the block form and the scalar form: OPk(name, result
// type, operand types, expression). The types are F for float, I for int32 and U for uint32. A bool
// is an I with all bits 0 or all bits 1. Registers hold words, so reinterpreting bits needs no
// operation.

#ifndef NOVAPHY_CPU_OPS
#define NOVAPHY_CPU_OPS(OP1, OP2, OP3)                  \
  OP1(NEG, F, F, -a)                                    \
  OP1(ABS, F, F, __builtin_fabsf(a))                    \
  OP1(SIGN, F, F, a < 0.0f ? -1.0f : 1.0f)              \
  OP1(SQRT, F, F, __builtin_sqrtf(a))                   \
  OP1(FLOOR, F, F, floor_f32(a))                        \
  OP1(NOT, I, I, ~a)                                    \
  OP1(F_TO_I, I, F, f32_to_i32(a))                      \
  OP1(I_TO_F, F, I, static_cast<float>(a))              \
  OP2(ADD, F, F, F, a + b)                              \
  OP2(SUB, F, F, F, a - b)                              \
  OP2(MUL, F, F, F, a * b)                              \
  OP2(DIV, F, F, F, a / b)                              \
  OP2(MIN, F, F, F, a <= b ? a : b)                     \
  OP2(MAX, F, F, F, a >= b ? a : b)                     \
  OP2(IADD, U, U, U, a + b)                             \
  OP2(ISUB, U, U, U, a - b)                             \
  OP2(IMUL, U, U, U, a * b)                             \
  OP2(IDIV, I, I, I, divide_i32(a, b))                  \
  OP2(IMOD, I, I, I, modulo_i32(a, b))                  \
  OP2(IMIN, I, I, I, a <= b ? a : b)                    \
  OP2(IMAX, I, I, I, a >= b ? a : b)                    \
  OP2(IAND, I, I, I, a & b)                             \
  OP2(IOR, I, I, I, a | b)                              \
  OP2(IXOR, I, I, I, a ^ b)                             \
  OP2(ISHL, U, U, U, a << (b & 31u))                    \
  OP2(ISHR, I, I, U, a >> (b & 31u))                    \
  OP2(IUSHR, U, U, U, a >> (b & 31u))                   \
  OP2(LT, I, F, F, a < b ? -1 : 0)                      \
  OP2(LE, I, F, F, a <= b ? -1 : 0)                     \
  OP2(EQ, I, F, F, a == b ? -1 : 0)                     \
  OP2(NE, I, F, F, a != b ? -1 : 0)                     \
  OP2(ILT, I, I, I, a < b ? -1 : 0)                     \
  OP2(ILE, I, I, I, a <= b ? -1 : 0)                    \
  OP2(IEQ, I, I, I, a == b ? -1 : 0)                    \
  OP2(INE, I, I, I, a != b ? -1 : 0)                    \
  OP3(FMA, F, F, F, F, fma_f32(a, b, c))                \
  OP3(SELECT, I, I, I, I, a != 0 ? b : c)               \
  OP3(MUL_ADD, F, F, F, F, a * b + c)                   \
  OP3(MUL_SUB, F, F, F, F, a * b - c)                   \
  OP3(SUB_MUL, F, F, F, F, c - a * b)
#endif
