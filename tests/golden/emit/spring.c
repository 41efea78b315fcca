// spring
// Program f85e30c33e67a848, 19 instructions. Argument words:
//   0  indices: i32{2}, own row; 1  its rows
//   2  q: f32{3}, rows by index; 3  its rows
//   4  stiffness: f32{1}, own row; 5  its rows
//   6  out f: f32{6}
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_spring_f85e30c33e67a848(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  const char* const s2 = (const char*)args[4];
  const int64_t n2 = (int64_t)args[5];
  char* const out0 = (char*)args[6];
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  if (n2 < last) last = n2;
  // Rows through the table are prefetched by one group: [here] is this one's, [next] the one's at k.
  int64_t fewest = n1;
  const int32_t limit = prefetch_limit(fewest);
  if (limit < 0) last = begin;
  vf gathered[2][6], *here = gathered[0], *next = gathered[1];
  vi next4, next2;
  rows_prefetched prefetch2, prefetch4;
  int odd = 0;
  int64_t k = i;
  if (last - begin >= LANES) {
    load2i(s0 + 8 * k, &next4, &next2);
    odd |= prefetch_look(&prefetch2, next2, limit);
    odd |= prefetch_look(&prefetch4, next4, limit);
    gather3f_prefetched(s1, &prefetch2, next + 0);
    gather3f_prefetched(s1, &prefetch4, next + 3);
  }
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 24];
    char* const o0 = i == done ? out0 : scratch0 - 24 * i;
    vf* const now = next;
    next = here, here = now;
    const vi v4 = next4;
    const vi v2 = next2;
    if (rarely(odd)) {
      odd = 0;
      if (!gather3f_again(here + 0, s1, n1, limit, v2)) return done;
      if (!gather3f_again(here + 3, s1, n1, limit, v4)) return done;
    }
    k = i + 2 * LANES <= last ? i + LANES : last - LANES;
    const vf v1 = load_columnf(s2 + 4 * i, 1);
    const vf v3 = here[0];
    const vf v8 = here[1];
    const vf v12 = here[2];
    const vf v5 = here[3];
    const vf v9 = here[4];
    const vf v13 = here[5];
    load2i(s0 + 8 * k, &next4, &next2);
    const vf v6 = v3 - v5;
    odd |= prefetch_look(&prefetch2, next2, limit);
    const vf v7 = v1 * v6;
    const vf v10 = v8 - v9;
    const vf v16 = -v7;
    odd |= prefetch_look(&prefetch4, next4, limit);
    const vf v14 = v12 - v13;
    const vf v11 = v1 * v10;
    const vf v15 = v1 * v14;
    const vf v17 = -v11;
    gather3f_prefetched(s1, &prefetch2, next + 0);
    const vf v18 = -v15;
    gather3f_prefetched(s1, &prefetch4, next + 3);
    store_columns4f(o0 + 24 * i, 6, v7, v11, v15, v16);
    store_columns4f(o0 + 24 * i + 8, 6, v15, v16, v17, v18);
    if (i != done) copy_tail(out0, scratch0, 24, i, done);
  }
  return i;
}
