// wide
// Program c9fcccd74841408c, 26 instructions. Argument words:
//   0  x: f32{9}, own row; 1  its rows
//   2  y: f32{7}, own row; 3  its rows
//   4  out z: f32{6}
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_wide_c9fcccd74841408c(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  char* const out0 = (char*)args[4];
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  if (n1 < last) last = n1;
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 24];
    char* const o0 = i == done ? out0 : scratch0 - 24 * i;
    const vf v1 = load_columnf(s1 + 28 * i, 7);
    vf x1_3_again, v6, v11, v16;
    load_columns4f(s1 + 28 * i + 12, 7, &x1_3_again, &v6, &v11, &v16);
    vf v4, v9, v14, v2;
    load_columns4f(s0 + 36 * i, 9, &v4, &v9, &v14, &v2);
    vf v7, v12, v17, v20;
    load_columns4f(s0 + 36 * i + 16, 9, &v7, &v12, &v17, &v20);
    const vf v23 = load_columnf(s0 + 36 * i + 32, 9);
    const vf v3 = v1 * v2;
    const vf v5 = v3 + v4;
    const vf v8 = v6 * v7;
    const vf v10 = v8 + v9;
    const vf v13 = v11 * v12;
    const vf v15 = v13 + v14;
    const vf v18 = v16 * v17;
    const vf v19 = v18 + v4;
    const vf v21 = v1 * v20;
    const vf v22 = v21 + v9;
    const vf v24 = v6 * v23;
    const vf v25 = v24 + v14;
    store_columns4f(o0 + 24 * i, 6, v5, v10, v15, v19);
    store_columns4f(o0 + 24 * i + 8, 6, v15, v19, v22, v25);
    if (i != done) copy_tail(out0, scratch0, 24, i, done);
  }
  return i;
}
