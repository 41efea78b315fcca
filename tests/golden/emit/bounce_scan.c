// The same for launches that follow each other. `large`: they have scratch memory or notes.
LANE_FN int64_t k_bounce_scan_rows(const novaphy_native_launches* all, int64_t begin,
                  int64_t end, novaphy_error_sink* sink, const int large) {
  const uint64_t* const args = all->args;
  const int streams = large && all->streams;
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  const int32_t* const offsets0 = (const int32_t*)args[5];
  const int32_t* const items0 = (const int32_t*)args[6];
  const float pf0 = uparam_f(args[7]);
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  for (; i + LANES <= last; i += LANES) {
    const csr_rows csr0 = csr_begin(offsets0, i);
    if (csr0.longest > KEPT_ITEMS) return i;
    vf held4[KEPT_ITEMS];
    novaphy_error_sink probe0 = {INT64_MAX, 0, 0, 0};
    for (int32_t r0 = 0; r0 < csr0.longest; ++r0) {
      const vb on0 = csr_on(&csr0, r0);
      const vi slot0 = csr_slot(&csr0, items0, r0, on0);
      const row_lanes rows3_0 = look_at_rows(slot0);
      const vf v4 = gather_columnf(s1, n1, &rows3_0, 1, 0, on0, 1, i, &probe0);
      held4[r0] = v4;
    }
    if (probe0.index != INT64_MAX) return i;
    vf state0_0;
    state0_0 = load_columnf(s0 + 4 * i, 1);
    char* const scratch = large ? group_scratch(all, i) : NULL;
    char* const noted = large ? group_notes(all, i) : NULL;
    for (const uint64_t *launch = all->table, *const stop = launch + 2 * all->count; launch != stop; launch += 2) {
      unsigned char acted = 0;
      const vf v1 = state0_0;
      vf sum0_0 = v1;
      for (int32_t r0 = 0; r0 < csr0.longest; ++r0) {
        const vb on0 = csr_on(&csr0, r0);
        const vf v4 = held4[r0];
        const vf v5 = v1 - v4;
        const vb v6 = vlt(splatf(0.0f), v5);
        vf v14 = splatf(0.0f);
        if (rarely(any(vand(vnot(v6), on0)))) {
          acted |= 1;
          const vf v9 = pf0 / v5;
          const vf v11 = v5 * v5;
          const vf v12 = 1.0f + v11;
          const vf v13 = vsqrt(v12);
          v14 = v9 / v13;
          const vf v15 = vselectf(v6, splatf((-0.0f)), v14);
          sum0_0 = vselectf(on0, sum0_0 + v15, sum0_0);
        }
      }
      if (noted != NULL) {
        noted[launch[1]] = (char)acted;
        char* const near = launch_scratch(scratch, launch[1], 4);
      }
      char* const o0 = (char*)launch[0];
      if (o0 != NULL) {
        prefetch_rows(launch[2 * PREFETCH_LAUNCHES + 0], 4, i, 1);
        store_columnf(o0 + 4 * i, 1, sum0_0);
      }
      state0_0 = sum0_0;
    }
  }
  return i;
}
static int64_t k_bounce_scan(const novaphy_native_launches* all, int64_t begin,
                  int64_t end, novaphy_error_sink* sink) {
  return all->scratch != NULL || all->notes != NULL ? k_bounce_scan_rows(all, begin, end, sink, 1)
                                                 : k_bounce_scan_rows(all, begin, end, sink, 0);
}
