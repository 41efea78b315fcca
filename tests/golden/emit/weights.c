// weights
// Program e9ffa7a9e0791fbb, 9 instructions. Argument words:
//   0  x: f32{1}, own row; 1  its rows
//   2  w: f32{1}, row of the sum's step; 3  its rows
//   4  out sum: f32{1}
//   5  parameter 0: the number of steps of sum 0
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_weights_e9ffa7a9e0791fbb(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  char* const out0 = (char*)args[4];
  const int32_t extent0 = uparam_i(args[5]);
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 4];
    char* const o0 = i == done ? out0 : scratch0 - 4 * i;
    const vf v2 = load_columnf(s0 + 4 * i, 1);
    vf sum0_0 = splatf(0.0f);
    for (int32_t r0 = 0; r0 < extent0; ++r0) {
      const float u4 = uloadf(s1, n1, r0, 1, 0, splatb(1), 1, i, sink);
      const float u6 = u4 * 2.0f;
      const vf v7 = v2 * u6;
      sum0_0 = sum0_0 + v7;
    }
    store_columnf(o0 + 4 * i, 1, sum0_0);
    if (i != done) copy_tail(out0, scratch0, 4, i, done);
  }
  return i;
}
