// Replaces <novaphy/core/row_kernel.h> in device code. Each thread of a kernel calls the row
// function with its row.
namespace novaphy {
// The access types of <novaphy/core/launch_arguments.h> as plain pointers. Device code does not
// need to know which arrays a launch reads or writes.
template <class T>
using Reads = const T*;
template <class T>
using ReadsRow = const T*;
template <class T>
using Writes = T*;
template <class T>
using WritesRow = T*;
template <class T>
using Updates = T*;
template <class T>
using UpdatesRow = T*;
template <class A>
using Optional = A;
template <class A>
using Detached = A;
template <class A>
using Part = A;
template <class T>
struct alignas(8) Number {
  T value;
  operator T() const { return value; }
};
template <class A, int n>
struct Each {
  A of[n];
  const A& operator[](const int64_t k) const { return of[k]; }
};
}  // namespace novaphy

#define NOVAPHY_ARGUMENTS(...) __VA_ARGS__

#define NOVAPHY_ROW_KERNEL(NAME, ARGUMENTS)                                            \
  static_assert(sizeof(ARGUMENTS) % 8 == 0);                                           \
  inline void NAME##_row(const ARGUMENTS& a, const int64_t row, const int64_t n);      \
  NOVAPHY_KERNEL NAME(const ARGUMENTS arguments, const int64_t n, const device_sink) { \
    const int64_t row = NOVAPHY_ROW;                                                   \
    if (row < n) NAME##_row(arguments, row, n);                                        \
  }                                                                                    \
  inline void NAME##_row(const ARGUMENTS& a, const int64_t row, const int64_t n)

#define NOVAPHY_BLOCK_KERNEL(NAME, ARGUMENTS) static_assert(sizeof(ARGUMENTS) % 8 == 0)
#define NOVAPHY_BLOCK_BODY(NAME, ARGUMENTS)                                                \
  inline void NAME##_block(const ARGUMENTS& a, const int64_t block, const int64_t blocks); \
  NOVAPHY_KERNEL NAME(const ARGUMENTS arguments, const int64_t, const device_sink) {       \
    NAME##_block(arguments, (int64_t)blockIdx.x, (int64_t)gridDim.x);                      \
  }                                                                                        \
  inline void NAME##_block(const ARGUMENTS& a, const int64_t block, const int64_t blocks)
