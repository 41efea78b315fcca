// The interpreter of Programs, for devices whose code cannot be compiled. A thread per row runs the
// instructions of interpreter.h on words in memory. The build appends this source to
// device_prelude.cuh and the names of the operations. The arithmetic calls the same functions as
// emitted code.
#define kInterpretedWords 500
struct interpreter_arguments {
  uint64_t word[kInterpretedWords];
};
struct interpreter_instruction {
  int32_t op, d, a, b, c, e;
};
// Value k of this thread. Neighboring threads have neighboring words.
#define VALUE(k) values[(int64_t)(k)*threads]
#define FLOAT(k) ubits_f(VALUE(k))
#define RUN(name, result) \
  case OP_##name:         \
    VALUE(in.d) = result; \
    break
#define RUN_F(name, result) RUN(name, uf_bits(result))

// `scratch` is memory for the values of all threads. If null, the values fit into the shared memory
// of the block.
VENDOR_ENTRY __launch_bounds__(64) novaphy_interpreter(
    const __grid_constant__ interpreter_arguments args,
    const interpreter_instruction* const code, int32_t* const scratch, const int64_t n,
    const device_sink sink) {
  VENDOR_SHARED(int32_t, shared_values);
  const int64_t all = (int64_t)gridDim.x * blockDim.x;
  const int64_t first = (int64_t)blockIdx.x * blockDim.x + threadIdx.x;
  const int64_t threads = scratch != 0 ? all : blockDim.x;
  int32_t* const values = scratch != 0 ? scratch + first : shared_values + threadIdx.x;
  const int64_t rows = active_rows(sink, n);
  for (int64_t i = first; i < rows; i += all) {
    row_failure failure = begin_row(sink);
    int32_t counter = 0, extent = 0, start = 0;  // state of the running loop; loops do not nest
    const int32_t* items = 0;
    for (int32_t pc = 0; pc >= 0;) {
      const interpreter_instruction in = code[pc++];
      switch (in.op) {
        RUN(CONST_F, in.a);
        RUN(CONST_I, in.a);
        RUN(CONST_B, in.a != 0);
        RUN(PARAM_F, uparam_i(args.word[in.a]));
        RUN(PARAM_I, uparam_i(args.word[in.a]));
        RUN(INDEX, (int32_t)i);
        RUN(REDUCE_INDEX, counter);
        RUN(SLOT, items != 0 ? __ldg(items + (start + counter)) : start + counter);
        RUN(MOVE, VALUE(in.a));
        RUN_F(ADD, FLOAT(in.a) + FLOAT(in.b));
        RUN_F(SUB, FLOAT(in.a) - FLOAT(in.b));
        RUN_F(MUL, FLOAT(in.a) * FLOAT(in.b));
        RUN_F(DIV, FLOAT(in.a) / FLOAT(in.b));
        RUN_F(NEG, -FLOAT(in.a));
        RUN_F(ABS, uabs(FLOAT(in.a)));
        RUN_F(SIGN, usign(FLOAT(in.a)));
        RUN_F(MIN, umin(FLOAT(in.a), FLOAT(in.b)));
        RUN_F(MAX, umax(FLOAT(in.a), FLOAT(in.b)));
        RUN_F(SQRT, usqrt(FLOAT(in.a)));
        RUN_F(FMA, ufma(FLOAT(in.a), FLOAT(in.b), FLOAT(in.c)));
        RUN_F(FLOOR, ufloor(FLOAT(in.a)));
        RUN(IADD, uiadd(VALUE(in.a), VALUE(in.b)));
        RUN(ISUB, uisub(VALUE(in.a), VALUE(in.b)));
        RUN(IMUL, uimul(VALUE(in.a), VALUE(in.b)));
        RUN(IDIV, uidiv(VALUE(in.a), VALUE(in.b)));
        RUN(IMOD, uimod(VALUE(in.a), VALUE(in.b)));
        RUN(IMIN, uimin(VALUE(in.a), VALUE(in.b)));
        RUN(IMAX, uimax(VALUE(in.a), VALUE(in.b)));
        RUN(IAND, VALUE(in.a) & VALUE(in.b));
        RUN(IOR, VALUE(in.a) | VALUE(in.b));
        RUN(IXOR, VALUE(in.a) ^ VALUE(in.b));
        RUN(ISHL, uishl(VALUE(in.a), VALUE(in.b)));
        RUN(ISHR, uishr(VALUE(in.a), VALUE(in.b)));
        RUN(IUSHR, uiushr(VALUE(in.a), VALUE(in.b)));
        RUN(LT, ult(FLOAT(in.a), FLOAT(in.b)));
        RUN(LE, ule(FLOAT(in.a), FLOAT(in.b)));
        RUN(EQ, ueq(FLOAT(in.a), FLOAT(in.b)));
        RUN(NE, une(FLOAT(in.a), FLOAT(in.b)));
        RUN(ILT, uilt(VALUE(in.a), VALUE(in.b)));
        RUN(ILE, uile(VALUE(in.a), VALUE(in.b)));
        RUN(IEQ, uieq(VALUE(in.a), VALUE(in.b)));
        RUN(INE, uine(VALUE(in.a), VALUE(in.b)));
        RUN(AND, uand(VALUE(in.a), VALUE(in.b)));
        RUN(OR, uor(VALUE(in.a), VALUE(in.b)));
        RUN(NOT, unot(VALUE(in.a)));
        RUN(SELECT, VALUE(VALUE(in.a) != 0 ? in.b : in.c));
        RUN(F_TO_I, uf_to_i(FLOAT(in.a)));
        RUN_F(I_TO_F, ui_to_f(VALUE(in.a)));
        case OP_LOAD: {  // loads column c of row b of source a, whose rows have e words
          const source_rows table = {(const char*)args.word[2 * in.a],
                                     (int64_t)args.word[2 * in.a + 1]};
          VALUE(in.d) = uloadi(table, VALUE(in.b), in.e, in.c, 1, in.a, i, failure);
          break;
        }
        case OP_LOAD_OWN: {
          const source_rows own = {(const char*)args.word[2 * in.a],
                                   (int64_t)args.word[2 * in.a + 1]};
          VALUE(in.d) = own_columni(own, in.e, in.c, 1, in.a, i, failure);
          break;
        }
        case OP_STORE: {  // stores value b into column c of the output whose pointer is word a
          const output_rows own = {(char*)args.word[in.a]};
          put_columni(own, in.e, in.c, i, VALUE(in.b));
          break;
        }
        case OP_SKIP:  // jumps to c unless a == b
          if ((VALUE(in.a) != 0) != (in.b != 0)) pc = in.c;
          break;
        case OP_LOOP:  // jumps to c if there are no steps; b: steps over a CSR row, else word a
          counter = 0;
          if (in.b != 0) {
            const csr_rows row = csr_begin((const int32_t*)args.word[in.a], i);
            start = row.start;
            extent = row.longest;
            items = (const int32_t*)args.word[in.a + 1];
          } else {
            extent = uparam_i(args.word[in.a]);
          }
          if (extent <= 0) pc = in.c;
          break;
        case OP_AGAIN:  // jumps to c for the next step
          if (++counter < extent) pc = in.c;
          break;
        default:  // OP_END
          pc = -1;
      }
    }
    end_row(failure, sink, i);
  }
}
