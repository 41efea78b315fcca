// neighbors
// Program 9b43e32f5b9a80f9, 16 instructions. Argument words:
//   0  x: f32{3}, own row; 1  its rows
//   2  other: i32{1}, row of the CSR item; 3  its rows
//   4  position: f32{3}, rows by index; 5  its rows
//   6  out sum: f32{1}
//   7  sum 0: CSR offsets; 8  its items
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_neighbors_9b43e32f5b9a80f9(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  const char* const s2 = (const char*)args[4];
  const int64_t n2 = (int64_t)args[5];
  char* const out0 = (char*)args[6];
  const int32_t* const offsets0 = (const int32_t*)args[7];
  const int32_t* const items0 = (const int32_t*)args[8];
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 4];
    char* const o0 = i == done ? out0 : scratch0 - 4 * i;
    vf v5, v8, v12;
    load3f(s0 + 12 * i, &v5, &v8, &v12);
    vf sum0_0 = splatf(0.0f);
    const csr_rows csr0 = csr_begin(offsets0, i);
    for (int32_t r0 = 0; r0 < csr0.longest; ++r0) {
      const vb on0 = csr_on(&csr0, r0);
      const vi slot0 = csr_slot(&csr0, items0, r0, on0);
      const row_lanes rows1_0 = look_at_rows(slot0);
      const vi v2 = gather_columni(s1, n1, &rows1_0, 1, 0, on0, 1, i, sink);
      const row_lanes rows2_0 = look_at_rows(v2);
      vf v3, v7, v11;
      gather3f(s2, n2, &rows2_0, on0, 2, i, sink, &v3, &v7, &v11);
      const vf v6 = v3 - v5;
      const vf v9 = v7 - v8;
      const vf v10 = v6 + v9;
      const vf v13 = v11 - v12;
      const vf v14 = v10 + v13;
      sum0_0 = vselectf(on0, sum0_0 + v14, sum0_0);
    }
    store_columnf(o0 + 4 * i, 1, sum0_0);
    if (i != done) copy_tail(out0, scratch0, 4, i, done);
  }
  return i;
}
