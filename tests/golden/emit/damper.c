// damper
// Program b1c447978d989088, 33 instructions. Argument words:
//   0  indices: i32{2}, own row; 1  its rows
//   2  q: f32{3}, rows by index; 3  its rows
//   4  qd: f32{3}, rows by index; 5  its rows
//   6  damping: f32{1}, own row; 7  its rows
//   8  out f: f32{3}
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_damper_b1c447978d989088(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  const char* const s2 = (const char*)args[4];
  const int64_t n2 = (int64_t)args[5];
  const char* const s3 = (const char*)args[6];
  const int64_t n3 = (int64_t)args[7];
  char* const out0 = (char*)args[8];
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  if (n3 < last) last = n3;
  // Rows through the table are prefetched by one group: [here] is this one's, [next] the one's at k.
  int64_t fewest = n1;
  if (n2 < fewest) fewest = n2;
  const int32_t limit = prefetch_limit(fewest);
  if (limit < 0) last = begin;
  vf gathered[2][12], *here = gathered[0], *next = gathered[1];
  vi next3, next1;
  rows_prefetched prefetch1, prefetch3;
  int odd = 0;
  int took0 = 0, fetch0 = 0, ready0 = 0;
  int64_t k = i;
  if (last - begin >= LANES) {
    load2i(s0 + 8 * k, &next3, &next1);
    odd |= prefetch_look(&prefetch1, next1, limit);
    odd |= prefetch_look(&prefetch3, next3, limit);
    gather3f_prefetched(s1, &prefetch1, next + 0);
    gather3f_prefetched(s1, &prefetch3, next + 3);
  }
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 12];
    char* const o0 = i == done ? out0 : scratch0 - 12 * i;
    vf* const now = next;
    next = here, here = now;
    const vi v3 = next3;
    const vi v1 = next1;
    ready0 = fetch0, fetch0 = took0, took0 = 0;
    if (rarely(odd)) {
      odd = 0;
      if (!gather3f_again(here + 0, s1, n1, limit, v1)) return done;
      if (!gather3f_again(here + 3, s1, n1, limit, v3)) return done;
      if (ready0 && !gather3f_again(here + 6, s2, n2, limit, v1)) return done;
      if (ready0 && !gather3f_again(here + 9, s2, n2, limit, v3)) return done;
    }
    k = i + 2 * LANES <= last ? i + LANES : last - LANES;
    const vf v6 = load_columnf(s3 + 4 * i, 1);
    const vb v8 = veq(v6, splatf(0.0f));
    const vf v2 = here[0];
    const vf v15 = here[1];
    const vf v24 = here[2];
    vf v12 = splatf(0.0f);
    vf v21 = splatf(0.0f);
    vf v30 = splatf(0.0f);
    if (any(vnot(v8))) {
      took0 = 1;
      vf v9, v18, v27;
      if (ready0) {
        v9 = here[6];
        v18 = here[7];
        v27 = here[8];
      } else {
        const row_lanes rows = look_at_rows(v1);
        gather3f(s2, n2, &rows, vnot(v8), 2, i, sink, &v9, &v18, &v27);
      }
      vf v10, v19, v28;
      if (ready0) {
        v10 = here[9];
        v19 = here[10];
        v28 = here[11];
      } else {
        const row_lanes rows = look_at_rows(v3);
        gather3f(s2, n2, &rows, vnot(v8), 2, i, sink, &v10, &v19, &v28);
      }
      const vf v11 = v9 - v10;
      v12 = v6 * v11;
      const vf v20 = v18 - v19;
      const vf v29 = v27 - v28;
      v21 = v6 * v20;
      v30 = v6 * v29;
    }
    const vf v4 = here[3];
    const vf v16 = here[4];
    const vf v25 = here[5];
    load2i(s0 + 8 * k, &next3, &next1);
    odd |= prefetch_look(&prefetch1, next1, limit);
    const vf v5 = v2 - v4;
    const vf v17 = v15 - v16;
    const vf v26 = v24 - v25;
    const vf v13 = vselectf(v8, splatf(0.0f), v12);
    odd |= prefetch_look(&prefetch3, next3, limit);
    const vf v22 = vselectf(v8, splatf(0.0f), v21);
    const vf v31 = vselectf(v8, splatf(0.0f), v30);
    const vf v14 = v5 + v13;
    const vf v23 = v17 + v22;
    gather3f_prefetched(s1, &prefetch1, next + 0);
    const vf v32 = v26 + v31;
    gather3f_prefetched(s1, &prefetch3, next + 3);
    if (fetch0) {
      gather3f_prefetched(s2, &prefetch1, next + 6);
      gather3f_prefetched(s2, &prefetch3, next + 9);
    }
    store3f(o0 + 12 * i, v14, v23, v32);
    if (i != done) copy_tail(out0, scratch0, 12, i, done);
  }
  return i;
}
