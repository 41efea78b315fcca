// forces
// Program 1e1f83ba37c33500, 11 instructions. Argument words:
//   0  x: f32{3}, own row; 1  its rows
//   2  f: f32{3}, row of the CSR item; 3  its rows
//   4  out sum: f32{3}
//   5  sum 0: CSR offsets; 6  its items
// Computes the rows [begin, end) in groups of LANES; returns the first that it left.
static int64_t k_forces_1e1f83ba37c33500(const uint64_t* args, int64_t begin, int64_t end,
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
  return csr_sums(narrow(s0, n0, 3, 0), narrow(s1, n1, 3, 1), offsets0, items0, i, last, sink, out0);
}
