// Argument structs of hand-written kernels. The members are access types, which say what a launch
// does to each array. The kernel reads the same struct as pointers and numbers.
//
//   struct ScaleArguments {
//     NOVAPHY_ARGUMENTS(ReadsRow<float> x; WritesRow<float> y; Number<float> factor;)
//   };
//   NOVAPHY_ROW_KERNEL(scale, ScaleArguments) { a.y[row] = a.factor.value * a.x[row]; }
//   run(kScale, n, {.x = x, .y = y, .factor = 2.0f});
//
// Access types have no default constructor. Three mistakes therefore fail to compile: a missing
// argument, an array of another element type, and a kernel that writes an argument declared as
// read. The folder core/device/ has versions of these types for device code: plain pointers.
#pragma once

#include <array>
#include <concepts>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>
#include <type_traits>
#include <utility>
#include <vector>

#include "novaphy/core/device_array.h"

namespace novaphy {

// Bits that say what a launch does to an argument.
namespace access {
constexpr uint8_t kNumber = 0, kRead = 1, kWrite = 2, kOptional = 4, kDifferentiable = 8;
}  // namespace access

using ArgumentWord [[gnu::may_alias]] = uint64_t;
constexpr uint64_t kArrayBit = 1;  // marks the word of a range before a launch resolves its address
inline uint64_t word_of(const std::shared_ptr<Range>& range) {
  return range == nullptr ? 0 : reinterpret_cast<uint64_t>(range.get()) | kArrayBit;
}
// Returns the range of an argument word. Returns null if the word is a number, an address, or an
// array without rows.
inline Range* range_of(uint64_t word) {
  return (word & kArrayBit) == 0 ? nullptr : reinterpret_cast<Range*>(word - kArrayBit);
}

// One argument word of a kernel.
struct ArgumentInfo {
  const char* name = "";
  uint32_t row_bytes = 0;  // row i accesses only bytes [i, i + 1) * row_bytes; 0: any bytes
  uint8_t access = access::kNumber;
};

// An argument whose element type the compiler cannot check: bytes, flat floats, a range, or memory
// of the host. The caller is responsible for the type.
struct Untyped {
  explicit Untyped(const Array& of) : word(word_of(of.range())) {}
  explicit Untyped(Array&&) = delete;
  explicit Untyped(const std::shared_ptr<Range>& range) : word(word_of(range)) {}
  explicit Untyped(const void* memory) : word(reinterpret_cast<uint64_t>(memory)) {}
  uint64_t word;
};

// Returns the array {of(0), ..., of(n - 1)} as arguments.
template <size_t n, class Of>
std::array<Untyped, n> each(const Of& of) {
  return [&]<size_t... k>(std::index_sequence<k...>) { return std::array<Untyped, n>{of(k)...}; }
  (std::make_index_sequence<n>());
}

// Host memory as an argument. Valid for a launch that runs at once on the CPU, and for a row
// function that the host calls. Launches on other devices and recorded launches refuse host memory.
template <class T>
struct Direct {
  T* rows;
};
template <class T>
Direct<T> direct(T* rows) {
  return {rows};
}
template <class T>
Direct<const T> direct(const std::vector<T>& rows) {
  return {rows.data()};
}
template <class T>
Direct<T> direct(std::vector<T>& rows) {
  return {rows.data()};
}

namespace detail {

// Collects the argument words of a struct, in the order of its members. Each member is constructed
// from a Probe, which adds the words of the member.
struct ArgumentCollector {
  std::array<ArgumentInfo, 128> words = {};
  std::array<size_t, 128> member = {};  // index of the member that each word belongs to
  size_t count = 0;
};
struct Probe {
  ArgumentCollector* to;
  size_t member;
  constexpr void add(const ArgumentInfo& info) const {
    to->member[to->count] = member;
    to->words[to->count++] = info;
  }
};

// The element type of an array whose rows a kernel sees as T.
template <class T>
struct ElementOf {
  using type = T;
};
template <>
struct ElementOf<int64_t> {
  using type = uint64_t;
};
template <class T>
requires requires { typename T::Element; }
struct ElementOf<T> {
  using type = typename T::Element;
};
template <class T>
using ArrayOf = DeviceArray<typename ElementOf<std::remove_const_t<T>>::type>;

template <class T>
constexpr bool kIsFloat = true;
template <std::integral T>
constexpr bool kIsFloat<T> = false;
template <>
inline constexpr bool kIsFloat<Vec2i> = false;
template <>
inline constexpr bool kIsFloat<Vec3i> = false;
template <>
inline constexpr bool kIsFloat<Vec4i> = false;

// One argument word. In the caller the word is the address of the array's range plus kArrayBit, or
// 0. In the kernel the word is the address of the memory. A launch replaces the address of the
// range by the address of the memory.
template <class T, uint8_t kAccess, bool kOwnRow>
class Argument {
 public:
  using Value = T;
  static constexpr uint8_t kWhat = kAccess;
  static constexpr bool kRow = kOwnRow;
  static constexpr bool kMayMiss = (kAccess & access::kOptional) != 0;

  Argument(const ArrayOf<T>& array) : word_(word_of(array.range())) {}
  Argument(ArrayOf<T>&&) = delete;
  template <class Other>
  Argument(const DeviceArray<Other>&) {
    static_assert(!sizeof(Other), "an array of another element type than the kernel declares");
  }
  Argument(const ArrayOf<T>* array) requires kMayMiss
      : word_(array == nullptr ? 0 : word_of(array->range())) {}
  Argument(std::nullptr_t) requires kMayMiss : word_(0) {}
  Argument(const Untyped& untyped) : word_(untyped.word) {}
  template <class U>
  requires std::convertible_to<U*, T*> Argument(const Direct<U>& memory)
      : word_(reinterpret_cast<uint64_t>(memory.rows)) {}
  // Passes the array of another argument on, with a different access.
  template <class U, uint8_t kOther, bool kOtherRow>
  requires std::convertible_to<U*, T*> Argument(const Argument<U, kOther, kOtherRow>& other)
      : word_(other.word()) {}
  constexpr Argument(const Probe& probe) : word_(0) {
    probe.add({"", kOwnRow ? static_cast<uint32_t>(sizeof(T)) : 0, kAccess});
  }
  // Returns the pointer to the rows, for the kernel.
  T* rows() const { return reinterpret_cast<T*>(word_); }
  operator T*() const { return rows(); }
  T* operator->() const { return rows(); }
  uint64_t word() const { return word_; }

 private:
  uint64_t word_;
};

template <class T>
constexpr uint8_t kReadOf = access::kRead | (kIsFloat<T> ? access::kDifferentiable : 0);

}  // namespace detail

// The access types. With Reads, Writes and Updates any row of the kernel may access any row of the
// array. With ...Row, row i accesses only row i of the array, which needs at least as many rows as
// the launch. Float arrays that are read are differentiable (see LaunchArgument).
template <class T>
struct Reads : detail::Argument<const T, detail::kReadOf<T>, false> {
  using detail::Argument<const T, detail::kReadOf<T>, false>::Argument;
};
template <class T>
struct ReadsRow : detail::Argument<const T, detail::kReadOf<T>, true> {
  using detail::Argument<const T, detail::kReadOf<T>, true>::Argument;
};
template <class T>
struct Writes : detail::Argument<T, access::kWrite, false> {
  using detail::Argument<T, access::kWrite, false>::Argument;
};
template <class T>
struct WritesRow : detail::Argument<T, access::kWrite, true> {
  using detail::Argument<T, access::kWrite, true>::Argument;
};
template <class T>
struct Updates : detail::Argument<T, access::kWrite | detail::kReadOf<T>, false> {
  using detail::Argument<T, access::kWrite | detail::kReadOf<T>, false>::Argument;
};
template <class T>
struct UpdatesRow : detail::Argument<T, access::kWrite | detail::kReadOf<T>, true> {
  using detail::Argument<T, access::kWrite | detail::kReadOf<T>, true>::Argument;
};
// An argument that may be null or an array without rows.
template <class A>
struct Optional : detail::Argument<typename A::Value, A::kWhat | access::kOptional, A::kRow> {
  using detail::Argument<typename A::Value, A::kWhat | access::kOptional, A::kRow>::Argument;
};
// An argument whose values carry no gradient on purpose.
template <class A>
struct Detached
    : detail::Argument<typename A::Value, A::kWhat & ~access::kDifferentiable & 0xff, A::kRow> {
  using detail::Argument<typename A::Value, A::kWhat & ~access::kDifferentiable & 0xff,
                         A::kRow>::Argument;
};

template <class T, size_t kBytes = sizeof(T)>
struct Number;
template <class T>
struct Number<T, 8> {
  T value;
  template <class U>
  constexpr Number(U v) : value(static_cast<T>(v)) {
    static_assert(std::integral<U> == std::integral<T>,
                  "a number of another type than the kernel declares");
  }
  constexpr Number(const detail::Probe& probe) : value{} { probe.add({}); }
  operator T() const { return value; }
};
template <class T>
struct Number<T, 4> {
  T value;
  uint32_t unused = 0;
  template <class U>
  constexpr Number(U v) : value(v) {
    static_assert(std::same_as<U, T>, "a number of another type than the kernel declares");
  }
  constexpr Number(const detail::Probe& probe) : value{} { probe.add({}); }
  operator T() const { return value; }
};

// An array of n arguments with the same access.
template <class A, size_t n>
struct Each {
  A of[n];
  template <class Array>
  Each(const Array (&arrays)[n]) : Each(arrays, std::make_index_sequence<n>()) {}
  template <class Array>
  Each(const std::array<Array, n>& arrays) : Each(arrays, std::make_index_sequence<n>()) {}
  constexpr Each(const detail::Probe& probe) : Each(probe, std::make_index_sequence<n>()) {}
  const A& operator[](size_t k) const { return of[k]; }

 private:
  template <class Arrays, size_t... k>
  Each(const Arrays& arrays, std::index_sequence<k...>) : of{arrays[k]...} {}
  template <size_t... k>
  constexpr Each(const detail::Probe& probe, std::index_sequence<k...>)
      : of{(static_cast<void>(k), A(probe))...} {}
};

template <class T>
struct Part;

namespace detail {

template <class A, size_t... k>
constexpr bool takes_probes(std::index_sequence<k...>) {
  return requires(Probe probe) { A{(static_cast<void>(k), probe)...}; };
}
// Counts the members of an argument struct. A member with several words counts once.
template <class A, size_t n = sizeof(A) / sizeof(uint64_t)>
constexpr size_t count_members() {
  static_assert(n > 0, "expected members of access types, Number, Each and Part only");
  if constexpr (takes_probes<A>(std::make_index_sequence<n>())) {
    return n;
  } else {
    return count_members<A, n - 1>();
  }
}
template <class A, size_t... k>
constexpr ArgumentCollector collect(std::index_sequence<k...>) {
  ArgumentCollector found;
  static_cast<void>(A{Probe{&found, k}...});
  return found;
}

// The names of the members, read from the text of the struct. A name is the word before a comma or
// a semicolon.
template <size_t bytes>
struct MemberNames {
  char text[bytes] = {};
  size_t at[bytes] = {}, count = 0;
};
template <size_t bytes>
constexpr MemberNames<bytes> member_names(const char (&text)[bytes]) {
  MemberNames<bytes> names;
  size_t word = 0, letters = 0, end = 0, nested = 0;
  bool in_word = false;
  for (size_t k = 0; k + 1 < bytes; ++k) {
    const char c = text[k];
    const bool is_letter =
        (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
    if (is_letter && !in_word) word = k, letters = 0;
    letters += is_letter;
    in_word = is_letter;
    nested += c == '<';
    nested -= c == '>';
    if (nested != 0 || (c != ',' && c != ';')) continue;
    names.at[names.count++] = end;
    for (size_t i = 0; i < letters; ++i) names.text[end++] = text[word + i];
    ++end;
  }
  return names;
}

// The compile-time table of a kernel's arguments: words, members, names and access.
template <class A>
struct ArgumentTable {
  static_assert(std::is_trivially_copyable_v<A> && sizeof(A) % sizeof(uint64_t) == 0);
  static constexpr size_t kWords = sizeof(A) / sizeof(uint64_t), kMembers = count_members<A>();
  static constexpr MemberNames<sizeof(A::kText)> kNames = member_names(A::kText);
  static_assert(kNames.count == kMembers, "expected all members within NOVAPHY_ARGUMENTS");
  static constexpr std::array<ArgumentInfo, kWords> make() {
    const ArgumentCollector found = collect<A>(std::make_index_sequence<kMembers>());
    std::array<ArgumentInfo, kWords> infos;
    for (size_t k = 0; k < kWords; ++k) {
      infos[k] = found.words[k];
      if (infos[k].name[0] == 0) infos[k].name = kNames.text + kNames.at[found.member[k]];
    }
    return infos;
  }
  static constexpr std::array<ArgumentInfo, kWords> kInfos = make();
};

// Reinterprets the words of a launch as the argument struct of the kernel, without a copy.
template <class A>
const A& arguments_of(const uint64_t* words) {
  return *std::launder(reinterpret_cast<const A*>(words));
}

}  // namespace detail

// The argument struct of another kernel as one member.
template <class T>
struct Part : T {
  Part(const T& of) : T(of) {}
  constexpr Part(const detail::Probe& probe) : Part(probe, kMembers()) {
    for (const ArgumentInfo& info : detail::ArgumentTable<T>::kInfos) probe.add(info);
  }

 private:
  static constexpr auto kMembers() {
    return std::make_index_sequence<detail::ArgumentTable<T>::kMembers>();
  }
  template <size_t... k>
  constexpr Part(const detail::Probe&, std::index_sequence<k...>,
                 detail::ArgumentCollector unused = {})
      : T{(static_cast<void>(k), detail::Probe{&unused, 0})...} {}
};

// Returns the arguments with addresses of CPU memory in place of ranges, for row functions that the
// host calls directly. Written arrays count as written.
template <class A>
A in_memory(const A& arguments) {
  A made = arguments;
  auto* const words = reinterpret_cast<ArgumentWord*>(&made);
  const auto resolve = [](ArgumentWord& word, bool writes) {
    Range* const range = range_of(word);
    if (range == nullptr) return;
    word = reinterpret_cast<uint64_t>(range->data());
    if (writes) range->mark_written();
  };
  [&]<size_t... k>(std::index_sequence<k...>) {
    constexpr auto& infos = detail::ArgumentTable<A>::kInfos;
    ((infos[k].access == access::kNumber
          ? void()
          : resolve(words[k], (infos[k].access & access::kWrite) != 0)),
     ...);
  }
  (std::make_index_sequence<detail::ArgumentTable<A>::kWords>());
  return made;
}

}  // namespace novaphy

#define NOVAPHY_ARGUMENTS(...) \
  __VA_ARGS__                  \
  static constexpr char kText[] = #__VA_ARGS__;
