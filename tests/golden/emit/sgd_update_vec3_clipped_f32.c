// sgd_update_vec3_clipped_f32
// Program 6ef567023190fa83, 60 instructions. Argument words:
//   0  param: f32{3}, own row; 1  its rows
//   2  grad: f32{3}, own row; 3  its rows
//   4  out param: f32{3}
//   5  parameter 0
//   6  parameter 1
//   7  parameter 2
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_sgd_update_vec3_clipped_f32_6ef567023190fa83(const uint64_t* args, int64_t begin, int64_t end,
                  novaphy_error_sink* sink) {
  const char* const s0 = (const char*)args[0];
  const int64_t n0 = (int64_t)args[1];
  const char* const s1 = (const char*)args[2];
  const int64_t n1 = (int64_t)args[3];
  char* const out0 = (char*)args[4];
  const float pf1 = uparam_f(args[6]);
  const float pf2 = uparam_f(args[7]);
  const float pf0 = uparam_f(args[5]);
  int64_t i = begin, last = end;
  if (n0 < last) last = n0;
  if (n1 < last) last = n1;
  const int u14 = ult(0.0f, pf1);
  const int u17 = ult(0.0f, pf2);
  for (; i < last && last - begin >= LANES; i += LANES) {
    const int64_t done = i;
    if (i + LANES > last) i = last - LANES;
    char scratch0[LANES * 12];
    char* const o0 = i == done ? out0 : scratch0 - 12 * i;
    vf v1, v5, v8;
    load3f(s1 + 12 * i, &v1, &v5, &v8);
    const vf v3 = v1 * 0.0f;
    const vb v4 = veq(v3, splatf(0.0f));
    const vf v6 = v5 * 0.0f;
    const vb v7 = veq(v6, splatf(0.0f));
    const vf v9 = v8 * 0.0f;
    const vb v10 = veq(v9, splatf(0.0f));
    const vb v11 = vand(v7, v10);
    const vb v12 = vand(v4, v11);
    vf v15, v33, v40;
    load3f(s0 + 12 * i, &v15, &v33, &v40);
    vf v52 = splatf(0.0f);
    vf v55 = splatf(0.0f);
    vf v58 = splatf(0.0f);
    if (any(v12)) {
      const vf v18 = v1 * v1;
      const vf v19 = v5 * v5;
      const vf v20 = v18 + v19;
      const vf v21 = v8 * v8;
      const vf v22 = v20 + v21;
      const vf v23 = vsqrt(v22);
      const vb v24 = vlt(splatf(pf2), v23);
      const vb v25 = vand(splatb(u17), v24);
      vf v27 = splatf(0.0f);
      vf v34 = splatf(0.0f);
      vf v41 = splatf(0.0f);
      if (any(v25)) {
        const vf v26 = pf2 / v23;
        v27 = v1 * v26;
        v34 = v5 * v26;
        v41 = v8 * v26;
      }
      const vf v28 = vselectf(v25, v27, v1);
      const vf v30 = v28 * pf0;
      const vf v31 = v15 - v30;
      const vf v32 = v31 * v31;
      const vf v35 = vselectf(v25, v34, v5);
      const vf v36 = v35 * pf0;
      const vf v37 = v33 - v36;
      const vf v38 = v37 * v37;
      const vf v39 = v32 + v38;
      const vf v42 = vselectf(v25, v41, v8);
      const vf v43 = v42 * pf0;
      const vf v44 = v40 - v43;
      const vf v45 = v44 * v44;
      const vf v46 = v39 + v45;
      const vf v47 = vsqrt(v46);
      const vb v48 = vlt(splatf(pf1), v47);
      const vb v49 = vand(splatb(u14), v48);
      vf v51 = splatf(0.0f);
      vf v54 = splatf(0.0f);
      vf v57 = splatf(0.0f);
      if (any(v49)) {
        const vf v50 = pf1 / v47;
        v51 = v31 * v50;
        v54 = v37 * v50;
        v57 = v44 * v50;
      }
      v52 = vselectf(v49, v51, v31);
      v55 = vselectf(v49, v54, v37);
      v58 = vselectf(v49, v57, v44);
    }
    const vf v53 = vselectf(v12, v52, v15);
    const vf v56 = vselectf(v12, v55, v33);
    const vf v59 = vselectf(v12, v58, v40);
    store3f(o0 + 12 * i, v53, v56, v59);
    if (i != done) copy_tail(out0, scratch0, 12, i, done);
  }
  return i;
}
