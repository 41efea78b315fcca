// The floating-point mode of the arithmetic contract: round to nearest, no flush to zero. A library
// or the application may have changed the mode of a thread (-ffast-math does so at start-up).
// Computing code therefore sets the mode and restores the caller's mode afterwards.
#pragma once

#include <stdint.h>

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

namespace novaphy::cpu {

class FloatMode {
 public:
  FloatMode() : before_(read()) {
    if (wanted(before_) != before_) [[unlikely]]
      write(wanted(before_));
  }
  ~FloatMode() {
    if (wanted(before_) != before_) [[unlikely]]
      write(before_);
  }
  FloatMode(const FloatMode&) = delete;
  FloatMode& operator=(const FloatMode&) = delete;

 private:
#if defined(__x86_64__)
  using Word = uint32_t;
  // MXCSR: keeps the sticky flags, masks all exceptions, rounds to nearest, clears FTZ (15) and DAZ
  // (6).
  static Word wanted(Word mode) { return (mode & 0x3Fu) | 0x1F80u; }
  static Word read() { return _mm_getcsr(); }
  static void write(Word mode) { _mm_setcsr(mode); }
#elif defined(__aarch64__)
  using Word = uint64_t;
  // FPCR: clears the trap enables (8-12, 15), FZ16 (19), rounding (22-23), FZ (24) and DN (25).
  static Word wanted(Word mode) { return mode & ~Word{0x03C89F00}; }
  static Word read() {
    Word mode;
    __asm__ volatile("mrs %0, fpcr" : "=r"(mode));
    return mode;
  }
  static void write(Word mode) { __asm__ volatile("msr fpcr, %0" : : "r"(mode)); }
#else
#error "the floating-point control register of this processor is not known"
#endif
  const Word before_;
};

}  // namespace novaphy::cpu
