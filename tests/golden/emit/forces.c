// forces
// Program 26af7b50d3722cfe, 11 instructions. Argument words:
//   0  x: f32{3}, own row; 1  its rows
//   2  f: f32{3}, row of the CSR item; 3  its rows
//   4  out sum: f32{3}
//   5  sum 0: CSR offsets; 6  its items
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_forces_26af7b50d3722cfe(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  char* const out0 = (char*)args[4];
  const int32_t* const offsets0 = (const int32_t*)args[5];
  const int32_t* const items0 = (const int32_t*)args[6];
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char room0[LANES * 12];
    char* const o0 = i == done ? out0 : room0 - 12 * i;
    vf v1, v5, v8;
    load3f(s0 + 12 * i, &v1, &v5, &v8);
    vf sum0_0 = v1;
    vf sum0_1 = v5;
    vf sum0_2 = v8;
    csr_add3(s1, n1, offsets0, items0, 1, i, sink, &sum0_0, &sum0_1, &sum0_2);
    store3f(o0 + 12 * i, sum0_0, sum0_1, sum0_2);
    if (i != done) copy_tail(out0, room0, 12, i, done);
  }
  return i;
}
