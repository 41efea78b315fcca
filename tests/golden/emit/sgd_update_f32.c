// sgd_update_f32
// Program e7ccf396a43bc5a1, 6 instructions. Argument words:
//   0  param: f32{1}, own row; 1  its rows
//   2  grad: f32{1}, own row; 3  its rows
//   4  out param: f32{1}
//   5  parameter 0
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_sgd_update_f32_e7ccf396a43bc5a1(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  char* const out0 = (char*)args[4];
  const float pf0 = uparam_f(args[5]);
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  if (n1 < last) last = n1;
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 4];
    char* const o0 = i == done ? out0 : scratch0 - 4 * i;
    const vf v1 = load_columnf(s0 + 4 * i, 1);
    const vf v2 = load_columnf(s1 + 4 * i, 1);
    const vf v4 = v2 * pf0;
    const vf v5 = v1 - v4;
    store_columnf(o0 + 4 * i, 1, v5);
    if (i != done) copy_tail(out0, scratch0, 4, i, done);
  }
  return i;
}
