/* The serialized form of a Program: the SSA of one kernel, a pure function of an index.
 *
 * out[i] = f(i) for i in [0, n). A Program has sources (read only), outputs (written at row i
 * only), loops (only for ordered sums) and instructions in an order in which operands precede their
 * users.
 *
 * Words are 32 bit, little endian:
 *   header      NOVAPHY_PROGRAM_HEADER_WORDS words, see the enum
 *   name        header[NAME_BYTES] bytes, padded with zeros to a whole word
 *   sources     per source:  type, width, access, varies (0 or 1), name bytes, name (padded)
 *   outputs     per output:  type, width, carried (a source, or -1), name bytes, name (padded),
 *               then `width` value ids
 *   loops       per loop:    kind, extent parameter (FIXED only, else 0), number of sums, then per
 *               sum the value ids of its initial value and of its term
 *   instructions  per instruction: op, a, b, c
 *
 * Launch arguments, 8 bytes each, in this order:
 *   per source: pointer, number of rows      per output: pointer
 *   per CSR loop: pointer to offsets[n + 1], pointer to items (null: item = position)
 *   per parameter: the 32-bit value in the low half
 *
 * Reading: LOAD takes (source, row value, column). A negative row reads 0 (an absent neighbor). A
 * row at or past the end fails the launch with INDEX_OUT_OF_RANGE. Rows are tightly packed.
 *
 * Loops: loop l runs r = 0 .. extent-1. The extent is an i32 parameter (FIXED) or the length of row
 * i (CSR, where SLOT is the item). The sums of a loop are left folds: acc = init; acc = acc +
 * term(r). SUM gives the final value. A value that depends on REDUCE_INDEX or SLOT of loop l exists
 * inside loop l only.
 *
 * Scan: in a row of successive launches, the next launch reads a `carried` output at its own row as
 * the given source. A source that `varies` may have another array in each launch. Names are for
 * people and have no effect. An adjoint that carries gradients in this way has the hash of its
 * primal, and begins with the primal's sources.
 *
 * Arithmetic: IEEE binary32, round to nearest even, no contraction, no flush to zero. FMA rounds
 * once. i32 arithmetic wraps. Shifts use the low five bits of the count. IDIV and IMOD truncate and
 * give 0 for a zero divisor. F_TO_I truncates, saturates, and maps NaN to 0. MIN is a <= b ? a : b,
 * MAX is a >= b ? a : b, SIGN is a < 0 ? -1 : +1. SELECT reads b if a is true, else c. Code of a
 * side that no row of a group takes may be skipped. */
#ifndef NOVAPHY_ABI_PROGRAM_H
#define NOVAPHY_ABI_PROGRAM_H

#define NOVAPHY_PROGRAM_MAGIC 0x5250564Eu /* "NVPR" */
#define NOVAPHY_PROGRAM_VERSION 2u

enum {
  NOVAPHY_PROGRAM_HEADER_MAGIC = 0,
  NOVAPHY_PROGRAM_HEADER_VERSION = 1,
  NOVAPHY_PROGRAM_HEADER_WORD_COUNT = 2, /* words of the whole Program */
  NOVAPHY_PROGRAM_HEADER_NAME_BYTES = 3,
  NOVAPHY_PROGRAM_HEADER_SOURCES = 4,
  NOVAPHY_PROGRAM_HEADER_OUTPUTS = 5,
  NOVAPHY_PROGRAM_HEADER_LOOPS = 6,
  NOVAPHY_PROGRAM_HEADER_PARAMETERS = 7,
  NOVAPHY_PROGRAM_HEADER_INSTRUCTIONS = 8,
  NOVAPHY_PROGRAM_HEADER_FLAGS = 9, /* bit 0: contraction to fused multiply-adds allowed */
  NOVAPHY_PROGRAM_HEADER_PRIMAL_LOW = 10,
  NOVAPHY_PROGRAM_HEADER_PRIMAL_HIGH = 11,
  NOVAPHY_PROGRAM_HEADER_WORDS = 12
};

/* X(name, signature): result type, then one letter per operand a, b, c.
 * f = f32, i = i32, b = bool value; # = an immediate; - = unused. */
#define NOVAPHY_PROGRAM_OPS(X)                                                    \
  /* leaves: CONST a = bits; PARAM a = parameter; SUM a = loop, b = sum */        \
  X(CONST_F, "f#--") X(CONST_I, "i#--") X(CONST_B, "b#--")                        \
  X(PARAM_F, "f#--") X(PARAM_I, "i#--")                                           \
  X(INDEX, "i---") X(REDUCE_INDEX, "i#--") X(SLOT, "i#--") X(SUM, "f##-")         \
  X(LOAD_F, "f#i#") X(LOAD_I, "i#i#")                                             \
  /* f32 arithmetic */                                                            \
  X(ADD, "fff-") X(SUB, "fff-") X(MUL, "fff-") X(DIV, "fff-")                     \
  X(NEG, "ff--") X(ABS, "ff--") X(SIGN, "ff--") X(MIN, "fff-") X(MAX, "fff-")     \
  X(SQRT, "ff--") X(FMA, "ffff") X(FLOOR, "ff--")                                 \
  /* i32 arithmetic */                                                            \
  X(IADD, "iii-") X(ISUB, "iii-") X(IMUL, "iii-") X(IDIV, "iii-") X(IMOD, "iii-") \
  X(IMIN, "iii-") X(IMAX, "iii-") X(IAND, "iii-") X(IOR, "iii-") X(IXOR, "iii-")  \
  X(ISHL, "iii-") X(ISHR, "iii-") X(IUSHR, "iii-")                                \
  /* comparisons; with a NaN all are false except NE */                           \
  X(LT, "bff-") X(LE, "bff-") X(EQ, "bff-") X(NE, "bff-")                         \
  X(ILT, "bii-") X(ILE, "bii-") X(IEQ, "bii-") X(INE, "bii-")                     \
  X(AND, "bbb-") X(OR, "bbb-") X(NOT, "bb--")                                     \
  X(SELECT_F, "fbff") X(SELECT_I, "ibii") X(SELECT_B, "bbbb")                     \
  /* casts and bit patterns */                                                    \
  X(F_TO_I, "if--") X(I_TO_F, "fi--") X(F_BITS, "if--") X(BITS_F, "fi--")         \
  /* tracing only, removed before a backend sees the Program:                     \
   * PARTIAL = a, and its derivative with respect to b is c; DETACH = a, constant \
   * for the derivative */                                                        \
  X(PARTIAL, "ffff") X(DETACH, "ff--")

/* BUILTIN modules: data = name, one kernel "main", launch arguments as listed (8-byte words).
 *
 * row_sum_f32          n = rows; source, offsets, items, init, out, width, stride
 *   out[r, :] = init[r, :] (or +0 if init is null) + the sum of source[items[k], :] for k in
 *   [offsets[r], offsets[r + 1]). Null items: item = k. Null offsets: row r has the items
 *   [r * stride, (r + 1) * stride).
 *   The row-sum rule, the same on every device, fixes the order of additions. A row of up to 256
 *   items is a left fold that starts from init. A longer row is cut into consecutive chunks of 256,
 *   each folded from +0. The chunk sums are folded from +0 by the same rule, and the result is
 *   added to init. out may equal init.
 * row_sum_pair_f32     n = rows; the words of row_sum_f32, then source, init, out of a second sum
 *   of the same items, width and rule. A backend may lack this builtin: then two sums are launched.
 * exclusive_scan_i32   n = length; in, out (out may equal in)
 * sort_by_key_i32      n = length; keys, order: the permutation that sorts keys ascending, stable
 * incidence_i32        n = rows; table, slots, offsets[n + 1], items[slots]
 *   The inverse of an index table: row r lists, ascending, the slots s with table[s] == r. Negative
 *   entries belong to no row; an entry >= n fails with INDEX_OUT_OF_RANGE.
 * checksum_u64         n = ceil(bytes / 8), at least 1; data (at any address), bytes, out (8 bytes)
 *   The sum modulo 2^64 of mix(mix(w[k] + k * 0x9E3779B97F4A7C15)) over k < n. w[k] are the bytes
 *   as little-endian words, the last word padded with zeros, and mix(x) = y ^ (y >> 32) with
 *   y = (x ^ (x >> 32)) * 0xD6E8FEB86659FD93. A backend may lack this builtin: then the bytes are
 *   copied to the host. */
#define NOVAPHY_ROW_SUM_CHUNK 256

#endif
