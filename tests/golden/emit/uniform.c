// uniform
// Program 8b4d11860afc874e, 12 instructions. Argument words:
//   0  x: f32{2}, own row; 1  its rows
//   2  u: f32{3}, row 0 for all; 3  its rows
//   4  out y: f32{2}
//   5  parameter 0
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_uniform_8b4d11860afc874e(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  char* const out0 = (char*)args[4];
  const float pf0 = uparam_f(args[5]);
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  const float u3 = uloadf(s1, n1, 0, 3, 0, splatb(1), 1, i, sink);
  const float u6 = uloadf(s1, n1, 0, 3, 2, splatb(1), 1, i, sink);
  const float u5 = u3 * pf0;
  const float u7 = u5 - u6;
  const float u10 = usqrt(u7);
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 8];
    char* const o0 = i == done ? out0 : scratch0 - 8 * i;
    vf v1, v9;
    load2f(s0 + 8 * i, &v1, &v9);
    const vf v8 = v1 * u7;
    const vf v11 = v9 + u10;
    store2f(o0 + 8 * i, v8, v11);
    if (i != done) copy_tail(out0, scratch0, 8, i, done);
  }
  return i;
}
