// <novaphy/core/row_kernel.h> for device code: the kernel calls the function of the row on each
// thread.
namespace novaphy {
struct FloatWord {
  float value;
  uint32_t unused;
};
}  // namespace novaphy

#define NOVAPHY_ROW_KERNEL(NAME, WORDS, ARGUMENTS)                                     \
  static_assert(sizeof(ARGUMENTS) == 8 * (WORDS));                                     \
  inline void NAME##_row(const ARGUMENTS& a, const int64_t row, const int64_t n);      \
  NOVAPHY_KERNEL NAME(const ARGUMENTS arguments, const int64_t n, const device_sink) { \
    const int64_t row = NOVAPHY_ROW;                                                   \
    if (row < n) NAME##_row(arguments, row, n);                                        \
  }                                                                                    \
  inline void NAME##_row(const ARGUMENTS& a, const int64_t row, const int64_t n)

#define NOVAPHY_BLOCK_KERNEL(NAME, WORDS, ARGUMENTS) static_assert(sizeof(ARGUMENTS) == 8 * (WORDS))
#define NOVAPHY_BLOCK_BODY(NAME, ARGUMENTS)                                                      \
  inline void NAME##_block(const ARGUMENTS& a, const int64_t block, const int64_t blocks);       \
  NOVAPHY_KERNEL NAME(const ARGUMENTS arguments, const int64_t, const device_sink) {             \
    NAME##_block(arguments, (int64_t)blockIdx.x, (int64_t)gridDim.x);                            \
  }                                                                                              \
  inline void NAME##_block(const ARGUMENTS& a, const int64_t block, const int64_t blocks)
